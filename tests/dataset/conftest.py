"""A small scene with one mesh part, and dataset files beside it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

import pytest

from radwrap.dataset import run
from radwrap.dataset.document import read_dataset
from radwrap.files import sha256_of
from tests.study.conftest import OneThread

SCENE: Final = """
[camera]
position = ["0 mm", "0 mm", "300 mm"]
look_at = ["0 mm", "0 mm", "0 mm"]
focal_length = "12.5 mm"
exposure_time = "100 ms"
diffraction = "off"

[camera.aperture]
diameter = "0.2 mm"

[camera.sensor]
rows = 40
columns = 48
pixel_width = "60 um"
pixel_height = "60 um"
gain = "1e5 (J/m^2)^-1"
gamma = 1.0
dark_gray = 20
saturation_gray = 255

[[sources]]
type = "ring"
name = "ring"
position = ["0 mm", "0 mm", "300 mm"]
look_at = ["0 mm", "0 mm", "0 mm"]
count = 4
diameter = "40 mm"
radiance = "200 kW/m^2/sr"
beam = { profile = "gaussian", width = "30 deg", width_definition = "fwhm" }

[materials.grey]
type = "lambertian"
reflectance = 0.5

[[targets]]
type = "sheet"
name = "table"
material = "grey"
size = ["200 mm", "200 mm"]
position = ["0 mm", "0 mm", "-40 mm"]

[[targets]]
name = "block"
part = "block.obj"
length_unit = "1 mm"
material = "grey"
"""

# A box of 12 x 8 x 6 mm about the origin; its sides are turned outwards.
_CORNERS: Final = [(x, y, z) for x in (-6, 6) for y in (-4, 4) for z in (-3, 3)]
_SIDES: Final = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
BLOCK: Final = "".join(f"v {x} {y} {z}\n" for x, y, z in _CORNERS) + "".join(
    f"f {' '.join(map(str, side))}\n" for side in _SIDES
)

# A dataset of two blocks at most.
TEXT: Final = """
images = {images}
shard = 4
tolerance = 8
formats = ["coco", "bop", "yolo"]

[[parts]]
target = "block"
count = [1, 2]
x = ["-15 mm", "15 mm"]
y = ["-10 mm", "10 mm"]
"""

Write = Callable[[str], Path]


@pytest.fixture
def dataset_file(tmp_path: Path) -> Write:
    """A function that writes a dataset's file beside the scene."""
    (tmp_path / "scene.toml").write_text(SCENE)
    (tmp_path / "block.obj").write_text(BLOCK)

    def write(text: str) -> Path:
        path = tmp_path / "dataset.toml"
        path.write_text(f'scene = "scene.toml"\n{text}')
        return path

    return write


def contents(out: Path) -> dict[str, str]:
    """Hash of each file but the lock; what begins with a dot otherwise would be left of a killed run."""
    found = (one for one in out.rglob("*") if one.is_file() and one.name != ".radwrap.lock")
    return {str(one.relative_to(out)): sha256_of(one) for one in found}


@pytest.fixture
def good(dataset_file: Write, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[int], dict[str, str]]:
    """What a run in this process writes of so many images."""

    def made(images: int) -> dict[str, str]:
        with monkeypatch.context() as patch:
            patch.setattr(run, "LocalPool", OneThread)
            run.run_dataset(read_dataset(dataset_file(TEXT.format(images=images))), tmp_path / "good", run.RunOptions())
        return contents(tmp_path / "good")

    return made
