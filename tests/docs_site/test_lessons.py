"""Tutorials run as they stand, and what runs them finds what is wrong."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from docs_site.lessons import LessonFailed, as_notebook, page, parts, run

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


@pytest.mark.parametrize("path", TUTORIALS, ids=lambda path: path.stem)
def test_a_tutorial_runs_as_it_stands(path: Path, tmp_path: Path) -> None:
    done = run(path.read_text("utf-8"), tmp_path, path.name)
    assert sum(part.kind in ("python", "console") for part in done) >= 3
    assert any(part.kind == "check" for part in done), "its numbers are checked"
    shown = page(done, "pictures", "one.ipynb")
    for picture in (line.split("](pictures/")[1].split(")")[0] for line in shown.split("![")[1:]):
        assert (tmp_path / picture).is_file()


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
    shown = page(done, "/there", "/there/small.ipynb")
    assert ":class: output\nx is 42\n```" in shown
    assert "Its value is 43, ![picture](/there/one.png)" in shown
    assert "$ radwrap --version\nradwrap 0." in shown
    assert "assert" not in shown and "untouched = true" in shown
    cells = json.loads(as_notebook(done))["cells"]
    assert [cell["cell_type"] for cell in cells if cell["cell_type"] == "code"] == ["code"] * 3
    assert cells[2]["source"].startswith("%%writefile some.toml") or "%%writefile some.toml\nkey = 1" in str(cells)
    assert "!radwrap --version" in [cell["source"] for cell in cells]


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
