"""Pages, messages and help are written in plain English: phrasings that a technical writer would not use stay out."""

from __future__ import annotations

import argparse
import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pytest

from radwrap.cli.main import whole_parser
from radwrap.scene.file.described import described_schema

HERE: Final = Path(__file__).resolve().parent.parent
PAGES: Final = [
    HERE / "README.md",
    *sorted((HERE / "docs").glob("*.md")),
    *sorted((HERE / "docs").glob("tutorials/*.md")),
]
MODULES: Final = sorted((HERE / "radwrap").rglob("*.py"))
CODE: Final = re.compile(r"```.*?```|`[^`]*`|^ {4}.*$", re.DOTALL | re.MULTILINE)
QUOTED: Final = re.compile(r"`[^`]*`")
BANNED: Final = {
    r"\b(tell|tells|told)\b": "report, say, give or show",
    r"(?<!\bthere )\b(is|are) no (?!longer\b)[a-z{]": "is not a",
}
BANNED_IN_MESSAGES: Final = {**BANNED, r"(?<!--)\balone\b": "only"}


def faults(text: str, banned: dict[str, str] = BANNED, code: re.Pattern[str] = CODE) -> list[str]:
    """Phrasings of a text that are banned, in small and capital letters, and what stands for them."""
    prose = code.sub(" ", text)
    return [
        f'"{found[0]}": {better}'
        for pattern, better in banned.items()
        for found in re.finditer(pattern, prose, re.IGNORECASE)
    ]


def messages(source: str) -> Iterator[tuple[int, str]]:
    """Line and text of each string of a module that has a blank and documents nothing; {} for a value within it."""
    tree = ast.parse(source)
    rest: list[ast.AST] = [tree]
    while rest:
        node = rest.pop()
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            continue  # a docstring, or the line below a field, which is read in the schema
        text = None
        if isinstance(node, ast.JoinedStr):
            text = "".join(str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values)
            rest += [part for part in node.values if not isinstance(part, ast.Constant)]
        else:
            rest += ast.iter_child_nodes(node)
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                text = node.value
        if text is not None and " " in text:
            yield node.lineno, text  # type: ignore[attr-defined]


def helps(parser: argparse.ArgumentParser) -> Iterator[str]:
    """Texts of a parser, and of those below it."""
    yield from filter(None, (parser.description, parser.epilog))
    for action in parser._actions:  # argparse has no public way to its texts
        yield from filter(None, (action.help,))
        if isinstance(action, argparse._SubParsersAction):
            yield from (line.help for line in action._choices_actions if line.help)
            for below in dict.fromkeys(action.choices.values()):
                yield from helps(below)


def descriptions(table: Any) -> Iterator[str]:
    """Each description in a schema."""
    if isinstance(table, dict):
        if isinstance(text := table.get("description"), str):
            yield text
        for value in table.values():
            yield from descriptions(value)
    elif isinstance(table, list):
        for value in table:
            yield from descriptions(value)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_is_in_plain_english(page: Path) -> None:
    found = faults(page.read_text("utf-8"))
    assert not found, found


def test_messages_are_in_plain_english() -> None:
    found = [
        f"{module.relative_to(HERE)}:{line}: {fault}"
        for module in MODULES
        for line, text in messages(module.read_text("utf-8"))
        for fault in faults(text, BANNED_IN_MESSAGES, QUOTED)
    ]
    assert not found, "\n".join(found)


def test_help_is_in_plain_english() -> None:
    texts = list(helps(whole_parser()))
    assert len(texts) > 400, "the verbs' texts are not found any more"
    found = [f"{text}: {fault}" for text in texts for fault in faults(text, BANNED_IN_MESSAGES, QUOTED)]
    assert not found, "\n".join(found)


def test_the_schema_is_in_plain_english() -> None:
    texts = list(descriptions(described_schema()))
    assert len(texts) > 200, "the keys' texts are not found any more"
    found = [f"{text}: {fault}" for text in texts for fault in faults(text, BANNED_IN_MESSAGES, QUOTED)]
    assert not found, "\n".join(found)


def test_what_is_banned_is_seen() -> None:
    assert len(faults("The manifest tells it. A link is no file. Told so, it ends.")) == 3
    assert faults("There is no file. It is no longer so. `told = 1`") == []
    assert len(faults("of one view alone", BANNED_IN_MESSAGES)) == 1
    assert faults("play it with --alone", BANNED_IN_MESSAGES) == []


def test_messages_of_a_module_are_found() -> None:
    source = '"""It tells."""\nx: int\n"""It tells."""\nsay(f"{x} is no {y or \'a b\'} file", "is" " told", "told")\n'
    found = sorted(messages(source))
    assert found == [(4, "a b"), (4, "is told"), (4, "{} is no {} file")]
    assert [len(faults(text, BANNED_IN_MESSAGES)) for _, text in found] == [0, 1, 1]
