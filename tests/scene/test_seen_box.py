"""The largest rectangle that shows a target alone, against geometry."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from radwrap.errors import InputError
from radwrap.scene.file.load import load_scene
from radwrap.scene.look.seen_box import _largest, seen_box
from radwrap.scene.scene import Scene
from tests.cli.conftest import here

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from radwrap.cli.main import main

    folder = tmp_path_factory.mktemp("cell") / "it"
    assert main(["init", str(folder), "--template", "ring"]) == 0
    return folder / "scene.toml"


def brute(some: np.ndarray) -> int:
    rows, columns = some.shape
    sums = np.pad(some.astype(int).cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    best = 0
    for a in range(rows):
        for b in range(a + 1, rows + 1):
            for c in range(columns):
                for d in range(c + 1, columns + 1):
                    size = (b - a) * (d - c)
                    if size > best and sums[b, d] - sums[a, d] - sums[b, c] + sums[a, c] == size:
                        best = size
    return best


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_no_rectangle_is_larger(share: float) -> None:
    dice = np.random.default_rng(5)
    for _ in range(20):
        some = dice.random((7, 9)) < share
        found = _largest(some)
        if found is None:
            assert not some.any()
            continue
        left, top, right, bottom = found
        assert some[top : bottom + 1, left : right + 1].all()
        assert (right - left + 1) * (bottom - top + 1) == brute(some)
    assert _largest(np.zeros((3, 4), dtype=bool)) is None


def places(scene: Scene, box: tuple[int, int, int, int]) -> np.ndarray:
    """Distance of the box's corners from the washer's axis, on its face [m]."""
    camera = scene.camera
    u, v = np.array([box[0], box[2], box[0], box[2]]), np.array([box[1], box[1], box[3], box[3]])
    depth = 0.29745
    x = (u - camera.principal_point[0]) * camera.pitch[0] * depth
    y = -(v - camera.principal_point[1]) * camera.pitch[1] * depth
    return np.hypot(x - 0.004, y + 0.003)


@pytest.mark.parametrize("scale", ["1/1", "1/4", "1/8"])
def test_it_lies_on_the_washer_clear_of_its_rims(cell: Path, scale: str) -> None:
    scene = load_scene(cell, {"camera.sensor.scale": scale})
    box = seen_box(scene.camera, scene.targets, "washer")
    pixel = 0.29745 * scene.camera.pitch[0]
    away = places(scene, box)
    assert away.min() > 0.0065 + pixel and away.max() < 0.012 - pixel
    # The largest in a ring of 6.5 to 12 mm has some 40 mm^2; the margin takes a part.
    area = (box[2] - box[0] + 1) * (box[3] - box[1] + 1) * pixel**2
    assert area > (20e-6 if scale != "1/8" else 10e-6)


def test_the_belt_is_free_of_the_washer(cell: Path) -> None:
    scene = load_scene(cell)
    box = seen_box(scene.camera, scene.targets, "belt")
    assert (box[2] - box[0]) * (box[3] - box[1]) > 0.25 * scene.camera.sensor.pixels
    left, top, right, bottom = (np.array(box) - [*scene.camera.principal_point] * 2) * scene.camera.pitch[0] * 0.29745
    gap = math.hypot(max(left - 0.004, 0.004 - right, 0), max(top - 0.003, 0.003 - bottom, 0))
    assert gap > 0.012


def test_what_is_hidden_has_none(cell: Path) -> None:
    scene = load_scene(cell, {"targets[1].position": ["500 mm", "0 mm", "0 mm"]})
    with pytest.raises(InputError, match='no pixel shows "washer"'):
        seen_box(scene.camera, scene.targets, "washer")


@pytest.mark.long
def test_regions_go_by_the_scenes_truth(cell: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    here(
        ["render", cell, "--scale", "1/8", "--set", "camera.diffraction=off", "--tracer", "compiled", "--out", out],
        capsys,
    ).success()
    words = ["--scene", cell, "--scale", "1/8", "--truth", "washer"]
    told = here(["measure", "region", out / "gray.png", *words, "--against-truth", "belt"], capsys).success().stdout
    assert told.startswith("region: mean 3") and "against: mean 6" in told
    # The scene's own dark level: reflectances of .5 and .1 in nearly the same light.
    assert 0.6 < float(told.split("contrast (Michelson): ")[1].split()[0]) < 0.72
    even = here(["measure", "uniformity", out / "gray.png", *words], capsys).success().stdout
    assert float(even.split("1 - sd/mean: ")[1].split()[0]) > 0.98
    refused = here(["measure", "region", out / "gray.png", "--truth", "washer"], capsys)
    assert refused.code == 2 and "give --scene" in refused.stderr
    both = here(["measure", "region", out / "gray.png", *words, "--region", "0", "0", "5", "5"], capsys)
    assert both.code == 2 and "leave one of them out" in both.stderr
