"""The report of a study in a real browser: `make test-report`. Not part of `make test`, as it needs Chromium."""

from __future__ import annotations

import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import pytest

from tests.study.conftest import SMALL, DesignWriter, command

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
# What a reader does: click on a heading, look at the first row. The page's own script does the sorting.
CLICK = '<script>document.querySelectorAll("#runs thead th")[{column}].click();</script>'


class Cells(HTMLParser):
    """Texts of the cells of the table of runs, row by row."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self._inside = self._cell = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "table":
            self._inside = ("id", "runs") in attrs
        elif tag == "tr" and self._inside:
            self.rows.append([])
        elif tag == "td" and self._inside:
            self.rows[-1].append("")
            self._cell = True

    def handle_endtag(self, tag: str) -> None:
        if tag == "td":
            self._cell = False
        elif tag == "table":
            self._inside = False

    def handle_data(self, data: str) -> None:
        if self._cell and self._inside:
            self.rows[-1][-1] += data


def browse(page: Path, *words: str) -> str:
    """What the browser makes of a page, after its scripts ran."""
    assert BROWSER is not None, "install Chromium: make chromium"
    argv = [
        BROWSER,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        f"--user-data-dir={page.parent / 'browser'}",
        *words,
    ]
    done = subprocess.run([*argv, page.as_uri()], capture_output=True, text=True, timeout=120, check=True)
    return done.stdout


@pytest.fixture
def report(design: DesignWriter) -> Path:
    path = design(SMALL)
    command("study", "run", path, "--out", path.parent / "out").success()
    return path.parent / "out" / "index.html"


def cells(page: str) -> list[list[str]]:
    parser = Cells()
    parser.feed(page)
    return [row for row in parser.rows if row]


def test_a_click_sorts_and_the_values_are_those_of_the_table(report: Path) -> None:
    text = report.read_text()
    headings = re.findall(r"<th>([^<]*)</th>", text[text.index('id="runs"') :])
    column = headings.index("mean")
    unsorted = cells(browse(report, "--dump-dom"))
    assert [row[0] for row in unsorted] == ["1", "2", "3", "4"]
    clicked = report.with_name("clicked.html")
    clicked.write_text(text.replace("</body>", CLICK.format(column=column) + "</body>"))
    values = [float(row[column]) for row in cells(browse(clicked, "--dump-dom"))]
    assert values == sorted(values) and len(values) == 4
    assert sorted(values) == sorted(float(row[column]) for row in unsorted)
    twice = report.with_name("twice.html")
    twice.write_text(text.replace("</body>", 2 * CLICK.format(column=column) + "</body>"))
    assert [float(row[column]) for row in cells(browse(twice, "--dump-dom"))] == values[::-1]


def test_pictures_are_drawn(report: Path) -> None:
    """Every picture of the page is inside it and has a size once the browser has read it."""
    sizes = (
        '<script>window.addEventListener("load", () => { for (const i of document.images) i.loading = "eager";'
        "document.title = Array.from(document.images, i => i.complete && i.naturalWidth > 0).join(); });</script>"
    )
    page = report.with_name("sizes.html")
    page.write_text(report.read_text().replace(' loading="lazy"', "").replace("</body>", sizes + "</body>"))
    (title,) = re.findall(r"<title>([^<]*)</title>", browse(page, "--dump-dom", "--virtual-time-budget=5000"))
    assert title and set(title.split(",")) == {"true"} and len(title.split(",")) >= 4
