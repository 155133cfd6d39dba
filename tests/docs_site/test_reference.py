"""Pages of the reference: every verb, option, table and key stands there, with what it is."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from pathlib import Path

import radwrap
from docs_site.reference import scene_pages, verb_pages
from radwrap.cli.main import whole_parser
from radwrap.scene.file.described import described_schema

DOCS = Path(__file__).parents[2] / "docs"


def _parsers(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                yield from _parsers(below)


def test_every_option_of_every_verb_stands_there() -> None:
    whole = whole_parser()
    text = "\n".join(page for _, page in verb_pages(whole))
    for parser in _parsers(whole):
        if parser is not whole:
            assert re.search(rf"^#+ {parser.prog}$", text, re.MULTILINE), parser.prog
        for action in parser._actions:
            for option in action.option_strings if parser is not whole else ():
                assert f"`{option}" in text, (parser.prog, option)
    assert not re.search(r"^\| [^|]*(?<!\\)\| *\|$", text, re.MULTILINE), "an argument says what it does"


def test_every_key_of_every_table_stands_there_with_what_it_is() -> None:
    schema = described_schema()
    pages = dict(scene_pages(schema))
    assert set(pages) >= {"index", "camera", "sources", "materials", "targets"}
    text = "\n".join(pages.values())
    for name, table in schema["$defs"].items():
        assert f"(keys-{name.lower()})=" in text, name
        for key in table.get("properties", {}):
            assert f"| `{key}` |" in text, (name, key)
    assert "one number, one blank, one unit of" not in text, "units stand in their own table"
    assert "| length | m, cm, mm" in pages["index"]
    labels, links = set(re.findall(r"^\((keys-\w+)\)=", text, re.MULTILINE)), set(re.findall(r"\(#(keys-\w+)\)", text))
    assert links <= labels


def test_every_public_name_stands_in_the_interface() -> None:
    text = (DOCS / "api.md").read_text("utf-8")
    assert sorted(re.findall(r"^\.\. auto\w+:: (\w+)", text, re.MULTILINE)) == sorted(radwrap.__all__)


def test_every_page_stands_in_the_index() -> None:
    text = (DOCS / "index.md").read_text("utf-8")
    pages = {
        path.relative_to(DOCS).with_suffix("").as_posix() for path in (*DOCS.glob("*.md"), *DOCS.glob("tutorials/*.md"))
    }
    assert {name for name in pages - {"index"} if not re.search(rf"^{name}$", text, re.MULTILINE)} == set()
