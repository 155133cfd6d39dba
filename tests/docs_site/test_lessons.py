"""Tutorials run as they stand, and what runs them finds what is wrong."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from docs_site.lessons import LessonFailed, as_notebook, page, parts, run
from docs_site.pictures import shown

TUTORIALS = sorted((Path(__file__).parents[2] / "docs" / "tutorials").glob("*.md"))
SMALL = """# A title

Text before.

```python
x = 6 * 7
print("x is", x)
```

% assert x == 42

```{code-block} toml
:caption: some.toml
key = 1
```

```console
$ radwrap --version
```

Its value is {value}`x + 1`, ![picture](one.png).

```toml
untouched = true
```
"""


# These run in some seconds together; the others take half a minute of a quiet machine, and run with `make docs` too.
QUICK = ("calibrate", "drive_the_ring")


@pytest.mark.parametrize(
    "path",
    [pytest.param(path, marks=[] if path.stem in QUICK else [pytest.mark.long], id=path.stem) for path in TUTORIALS],
)
def test_a_tutorial_runs_as_it_stands(path: Path, tmp_path: Path) -> None:
    done = run(path.read_text("utf-8"), tmp_path, path.name)
    assert sum(part.kind in ("python", "console") for part in done) >= 2
    assert any(part.kind == "check" for part in done), "its numbers are checked"
    text = page(done, "pictures", "one.ipynb")
    for picture in (line.split("](pictures/")[1].split(")")[0] for line in text.split("![")[1:]):
        assert (tmp_path / picture).is_file()


def test_pictures_are_for_eyes(tmp_path: Path) -> None:
    """Of twelve bits, which a browser would show nearly black."""
    gray = np.array([[0, 819, 4095], [4095, 1638, 0]], dtype=np.uint16)
    cv2.imwrite(str(tmp_path / "deep.png"), gray)
    shown(tmp_path / "deep.png", tmp_path / "shown.png")
    found = cv2.imread(str(tmp_path / "shown.png"), cv2.IMREAD_UNCHANGED)
    assert found.dtype == np.uint8 and found.shape == (320, 480)
    assert found[::160, ::160].tolist() == [[0, 51, 255], [255, 102, 0]]


def test_parts_come_in_order_with_their_lines() -> None:
    found = [(part.kind, part.line) for part in parts(SMALL)]
    assert found == [
        ("text", 1),
        ("python", 5),
        ("text", 9),
        ("check", 10),
        ("text", 11),
        ("file", 12),
        ("text", 16),
        ("console", 17),
        ("text", 20),
        ("text", 23),
    ]


def test_a_run_tutorial_shows_what_it_prints(tmp_path: Path) -> None:
    done = run(SMALL, tmp_path, "small.md")
    assert (tmp_path / "some.toml").read_text() == "key = 1\n"
    text = page(done, "/there", "/there/small.ipynb")
    assert ":class: output\nx is 42\n```" in text
    assert "Its value is 43, ![picture](/there/one.png)" in text
    assert "$ radwrap --version\nradwrap 0." in text
    assert "assert" not in text and "untouched = true" in text
    cells = json.loads(as_notebook(done))["cells"]
    assert [cell["cell_type"] for cell in cells if cell["cell_type"] == "code"] == ["code"] * 3
    sources = [cell["source"] for cell in cells]
    assert "%%writefile some.toml\nkey = 1" in sources and "!radwrap --version" in sources


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("# T\n\n```python\n1 / 0\n```\n", 3, "division by zero"),
        ("# T\n\n% assert 1 == 2\n", 3, "AssertionError"),
        ("# T\n\n```console\n$ radwrap render nowhere.toml --out x\n```\n", 3, "exit code 2"),
        ("# T\n\n```console\n$ rm -r /\n```\n", 3, "rm is not a command of ours"),
        ("# T\n\nValue {value}`unknown`.\n", 1, "NameError"),
    ],
)
def test_what_is_wrong_is_located(text: str, line: int, message: str, tmp_path: Path) -> None:
    with pytest.raises(LessonFailed, match=rf"^one\.md:{line}: .*{message}"):
        run(text, tmp_path, "one.md")
