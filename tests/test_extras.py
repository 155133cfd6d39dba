"""What a plain installation lacks is said before work begins, with the line that installs it."""

from __future__ import annotations

import re
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

import radwrap
from radwrap.errors import EnvironmentFailure
from radwrap.extras import EXTRAS, lack_of, missing, require
from tests.cli.conftest import here

PROJECT = tomllib.loads((Path(__file__).parent.parent / "pyproject.toml").read_text("utf-8"))["project"]


def _name(distribution: str) -> str:
    """As package indexes compare names."""
    return distribution.lower().replace("-", "_")


def _distributions(extra: str) -> set[str]:
    """Distributions of an extra, with those of the extras that it names."""
    found = set()
    for line in PROJECT["optional-dependencies"][extra]:
        name = re.match(r"[\w.-]+", line)[0]  # type: ignore[index]
        if name == "radwrap":
            found |= {one for inner in re.search(r"\[(.*)\]", line)[1].split(",") for one in _distributions(inner)}  # type: ignore[index]
        else:
            found.add(_name(name))
    return found


@pytest.mark.parametrize("extra", EXTRAS)
def test_the_list_is_that_of_the_project(extra: str) -> None:
    known = packages_distributions()
    told = {_name(known[module][0]) for module in EXTRAS[extra]}
    assert told <= _distributions(extra)
    own = {line for line in PROJECT["optional-dependencies"][extra] if not line.startswith("radwrap[")}
    assert {_name(re.match(r"[\w.-]+", line)[0]) for line in own} <= told  # type: ignore[index]


def test_all_holds_every_extra() -> None:
    assert _distributions("all") == {one for extra in EXTRAS for one in _distributions(extra)}


def test_what_is_missing_is_named_with_the_line_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    require("measure", "measure")
    monkeypatch.setitem(sys.modules, "cv2", None)
    assert missing("measure") == ("cv2",)
    with pytest.raises(EnvironmentFailure, match=r'cv2 is not installed; pip install "radwrap\[study\]"') as error:
        require("study", "study")
    assert error.value.where == "study" and error.value.exit_code == 4
    assert "reinstall radwrap" in str(lack_of("numpy", ""))


def test_only_one_piece_knows_how_to_install_an_extra() -> None:
    package = Path(radwrap.__file__).parent
    texts = {path.relative_to(package).as_posix(): path.read_text("utf-8") for path in package.rglob("*.py")}
    assert {name for name, text in texts.items() if re.search(r"pip install .{0,3}radwrap", text)} == {"extras.py"}


VERBS = {
    "measure": ["measure", "circle", "nothing.png"],
    "calibrate": ["calibrate", "camera", "nothing.csv"],
    "study": ["study", "run", "nothing.toml", "--out", "out"],
    "validate": ["validate", "--out", "out"],
}


@pytest.mark.parametrize("verb", VERBS)
def test_a_verb_without_its_extra_does_not_begin(
    verb: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    told = here(VERBS[verb], capsys).refusal(4)
    assert re.search(r'matplotlib is not installed; pip install "radwrap\[(measure|study)\]"', told)


def test_a_key_of_a_scene_without_its_extra_is_one_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """OpenCV knows the marks of a ChArUco board."""
    scene = Path(__file__).parent.parent / "rad_scenes" / "crosscheck" / "pattern" / "scene.toml"
    monkeypatch.setitem(sys.modules, "cv2", None)
    told = here(["explain", scene, "--no-rays"], capsys).refusal(4)
    assert 'cv2 is not installed; pip install "radwrap[measure]"' in told


def test_doctor_lists_what_is_missing(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "statsmodels", None)
    checks = {check["name"]: check for check in here(["doctor", "--json"], capsys).success().json["checks"]}
    assert not checks["extra study"]["found"] and checks["extra study"]["remedy"] == 'pip install "radwrap[study]"'
    assert checks["extra measure"]["found"]
