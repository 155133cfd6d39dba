"""The page's files: what is shipped is what was fetched, and no module is too long."""

from __future__ import annotations

import hashlib
import re
import shutil
import subprocess
from importlib.resources import files
from pathlib import Path
from typing import Final

import pytest

from tests.test_architecture import LONGEST_MODULE

PAGE: Final = Path(str(files("radwrap") / "data" / "face"))
# Of npm's uplot 1.6.32, as `npm pack uplot@1.6.32` gives it (MIT licence).
VENDORED: Final = {
    "uPlot.iife.min.js": "19c8d4c6ad88929a79f4ae49d6f7161566dfd0ba3d15cc495e974f787eb78f1f",
    "uPlot.min.css": "df630c6a8d6f8eeaff264b50f73ce5b114f646ffd9a0bb74f049b0a00135fa04",
    "LICENSE": "8f989229699b4fe2f1a0432d0e9edc338a8a911e250e2d1b01ecd770a5f5b1bd",
}
TESTS: Final = Path(__file__).parent / "modules"
NODE: Final = shutil.which("node")


def test_vendored_files_are_as_they_were_published() -> None:
    found = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in (PAGE / "vendor").iterdir()}
    assert found == VENDORED
    assert "The MIT License (MIT)" in (PAGE / "vendor" / "LICENSE").read_text()
    notice = (Path(__file__).parents[2] / "NOTICE").read_text()
    assert "uPlot" in notice and "1.6.32" in notice


def test_no_module_of_the_page_is_too_long() -> None:
    for path in PAGE.glob("*.*"):
        assert len(path.read_text("utf-8").splitlines()) <= LONGEST_MODULE, path.name


@pytest.mark.parametrize("path", sorted(PAGE.glob("*.js")), ids=lambda path: path.name)
def test_texts_stay_texts(path: Path) -> None:
    """Names and titles of scenes never become elements, and nothing is evaluated."""
    ways = r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\(|new Function|srcdoc|javascript:"
    assert not re.findall(ways, path.read_text("utf-8"))


def test_pure_modules_by_node() -> None:
    """Mixing, thresholds, state, units and statistics, against numbers that are known."""
    if NODE is None:
        pytest.skip("there is no node: the page's modules are not tested; on Debian: apt install nodejs")
    tests = sorted(map(str, TESTS.glob("*.test.mjs")))
    assert tests
    done = subprocess.run(
        [NODE, "--test", "--test-reporter=tap", *tests], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "# fail 0" in done.stdout
