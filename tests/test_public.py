"""The public names: help lists them, and the example of each runs as it stands."""

from __future__ import annotations

import doctest
import inspect
import pydoc
from importlib.resources import files
from pathlib import Path

import pytest

import radwrap
from radwrap.imaging import tracer_choice

FUNCTIONS = sorted(name for name in radwrap.__all__ if inspect.isfunction(getattr(radwrap, name)))


def test_help_lists_every_public_name() -> None:
    text = pydoc.render_doc(radwrap, renderer=pydoc.plaintext)
    for name in radwrap.__all__:
        assert f"{name}(" in text or f"class {name}" in text, name


# What they show has short tests of its own; the examples take two seconds each.
SLOW = ("fit", "design", "relight")
EXAMPLES = [
    "",
    "Rendered",
    *(name if name not in SLOW else pytest.param(name, marks=pytest.mark.long) for name in FUNCTIONS),
]


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_example_runs(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    if name != "render":  # one is traced as users' is; the compiled tracer, loaded here once, takes a fifth of the time
        monkeypatch.setattr(tracer_choice, "WORTH_COMPILED", 1)
    (tmp_path / "scene.toml").write_bytes((files("radwrap") / "data" / "init" / "scene.toml").read_bytes())
    one = getattr(radwrap, name) if name else radwrap
    tests = doctest.DocTestFinder(recurse=False).find(one, name or "radwrap", globs={} if name else None)
    assert tests[0].examples, "has an example"
    assert not any(doctest.SKIP in example.options for example in tests[0].examples)
    home = inspect.getmodule(one)
    tests[0].globs = dict(vars(home)) if home is not None else {}
    assert doctest.DocTestRunner().run(tests[0]).failed == 0
