"""Links between the pages lead somewhere: to a file that is there, and to a heading of it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent.parent
DOCS = HERE / "docs"
PAGES = sorted(
    [*HERE.glob("*.md"), *DOCS.glob("*.md"), *DOCS.glob("tutorials/*.md"), *(HERE / "rad_scenes").rglob("*.md")]
)
# Pages of the site and pictures of a tutorial are not in the repository: `make docs` makes them and follows the links,
# and tests/docs_site runs the tutorials.
MADE = re.compile(r"(\.\./)?generated/|\w+\.png$")
LINK = re.compile(r"\]\(([^)\s]+)\)")
CODE = re.compile(r"```.*?```", re.DOTALL)


def anchors(page: Path) -> set[str]:
    """Of its headings, as the usual forges make them."""
    headings = re.findall(r"^#+ (.+)$", CODE.sub("", page.read_text("utf-8")), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(HERE)))
def test_links_of_a_page_resolve(page: Path) -> None:
    wrong = []
    for link in LINK.findall(CODE.sub("", page.read_text("utf-8"))):
        if re.match(r"[a-z]+:", link):
            continue  # elsewhere
        if MADE.match(link) and (link.endswith(".md") or page.parent.name == "tutorials"):
            continue
        name, _, anchor = link.partition("#")
        target = (page.parent / name) if name else page
        if not target.exists() or (anchor and anchor not in anchors(target)):
            wrong.append(link)
    assert not wrong, wrong


def test_there_are_links_and_a_wrong_one_is_seen(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# A title: here\n[a](#a-title-here) [b](#nowhere)\n")
    with pytest.raises(AssertionError, match="nowhere"):
        test_links_of_a_page_resolve(page)
    assert len(PAGES) > 20
