"""The pages are written in plain English: phrasings that a technical writer would not use stay out."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

import pytest

HERE: Final = Path(__file__).resolve().parent.parent
PAGES: Final = [
    HERE / "README.md",
    *sorted((HERE / "docs").glob("*.md")),
    *sorted((HERE / "docs").glob("tutorials/*.md")),
]
CODE: Final = re.compile(r"```.*?```|`[^`]*`|^ {4}.*$", re.DOTALL | re.MULTILINE)
BANNED: Final = {
    r"\b(tell|tells|told)\b": "report, say, give or show",
    r"(?<![Tt]here )\b(is|are) no (?!longer\b)[a-z]": "is not a",
}


def faults(text: str) -> list[str]:
    """Phrasings of a page that are banned, and what stands for them."""
    prose = CODE.sub(" ", text)
    return [f'"{found[0]}": {better}' for pattern, better in BANNED.items() for found in re.finditer(pattern, prose)]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_is_in_plain_english(page: Path) -> None:
    found = faults(page.read_text("utf-8"))
    assert not found, found


def test_what_is_banned_is_seen() -> None:
    assert len(faults("The manifest tells it. A link is no file.")) == 2
    assert faults("There is no file. It is no longer so. `told = 1`") == []
