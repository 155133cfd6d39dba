"""A new kind of target, material or beam cannot be forgotten anywhere: mypy names each place that does not know it."""

import re
import shutil
import subprocess
import sys
from itertools import chain
from pathlib import Path

import pytest

import radwrap

PACKAGE = Path(radwrap.__file__).parent

# Where a kind is told apart from others, and what does so.
PLACES = {
    "target": {
        "scene/look/geometry.py",
        "scene/look/intersections.py",
        "scene/look/planes.py",
        "scene/look/probes.py",
        "scene/look/smallness.py",
        "scene/targets.py",
    },
    "material": {
        "convert/preview_files.py",
        "imaging/forecast/photo_realistic.py",
        "scene/bands.py",
        "scene/look/reflection.py",
        "scene/look/wide_sources.py",
        "tracers/povray_text.py",
        "tracers/radiance_materials.py",
    },
    "beam": {
        "scene/sources.py",
        "scene/file/spectral.py",
        "tracers/povray_text.py",
        "tracers/radiance_text.py",
    },
    "shape": {
        "convert/preview_files.py",
        "scene/look/wide_checks.py",
        "scene/look/wide_sources.py",
        "tracers/povray_text.py",
        "tracers/radiance_text.py",
        "tracers/text_frame.py",
    },
}
DUMMY = "@dataclass(frozen=True, slots=True)\nclass {name}:\n    name: str\n    pose: Pose\n    material: str\n\n\n"
PLAIN = "@dataclass(frozen=True, slots=True)\nclass {name}:\n    value: float\n\n\n"
# Kind -> module, what stands there, and what takes its place.
CHANGES = {
    "target": ("scene/targets.py", "Target = Flat", DUMMY.format(name="NewTarget") + "Target = NewTarget | Flat"),
    "material": (
        "scene/materials.py",
        "Material = (\n",
        PLAIN.format(name="NewMaterial") + "Material = (\n    NewMaterial\n    | ",
    ),
    "beam": ("scene/sources.py", 'Profile = Literal["', 'Profile = Literal["new_beam", "'),
    "shape": ("scene/targets.py", "\nShape = ", "\n" + PLAIN.format(name="NewShape") + "Shape = NewShape | "),
}

# Only scenes, tracers and what else is named here are checked: all modules take twice as long. What other packages say
# of themselves tells no kind from another.
FAST = ("--follow-imports=skip", "--cache-dir=/dev/null")
NAMES = {"target": "NewTarget", "material": "NewMaterial", "beam": "new_beam", "shape": "NewShape"}


def changed(folder: Path, kind: str) -> None:
    module, here, there = CHANGES[kind]
    path = folder / "radwrap" / module
    text = path.read_text()
    assert text.count(here) == 1
    path.write_text(text.replace(here, there))


def refused(folder: Path) -> dict[str, set[str]]:
    """Kind -> modules of which mypy says something that names the new one, or that they lack an answer."""
    shutil.copy(PACKAGE.parent / "pyproject.toml", folder)
    outside = {place for place in chain(*PLACES.values()) if not place.startswith(("scene/", "tracers/"))}
    checked = [f"radwrap/{name}" for name in ("scene", "tracers", *sorted(outside))]
    done = subprocess.run(
        [sys.executable, "-m", "mypy", *FAST, *checked], cwd=folder, capture_output=True, text=True, check=False
    )
    said = re.findall(r"^radwrap/(\S+?):\d+: error: (.*)$", done.stdout, re.MULTILINE)
    assert said, done.stdout + done.stderr
    return {
        kind: {module for module, words in said if name in words or "Missing return" in words}
        for kind, name in NAMES.items()
    }


@pytest.mark.long
def test_mypy_names_each_place_that_lacks_a_kind(tmp_path: Path) -> None:
    """One run for all kinds, told apart by the names in its messages."""
    shutil.copytree(PACKAGE, tmp_path / "radwrap", ignore=shutil.ignore_patterns("__pycache__"))
    for kind in CHANGES:
        changed(tmp_path, kind)
    found = refused(tmp_path)
    for kind, places in PLACES.items():
        assert found[kind] >= places, kind
