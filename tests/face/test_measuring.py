"""What algorithms read from a picture of the page is what a study reads, with its error."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.face.app import left_behind
from radwrap.face.measuring import Measured, kinds_of, measured
from radwrap.face.traced import Traced
from radwrap.imaging.output.run_manifest import read_run_manifest
from radwrap.imaging.page.turn import turn_of
from radwrap.imaging.relight.relit import Relighter, read_basis
from radwrap.scene.file.load import with_camera
from tests.cli.conftest import scene_with
from tests.face.conftest import PATIENCE, Served

BENCH: Final = Path(__file__).parents[2] / "rad_scenes" / "bench_board" / "scene.toml"
EDGE: Final = Path(__file__).parents[2] / "rad_scenes" / "fig11_edge" / "scene.toml"


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Traced:
    """A quarter of its pixels."""
    folder = tmp_path_factory.mktemp("measuring") / "basis"
    scene = radwrap.load_scene(BENCH, {"camera.sensor.scale": "1/2", "camera.diffraction": "off"})
    radwrap.render(scene, folder, basis=True, tolerance=2.0)
    return Traced(1, scene, folder, read_run_manifest(folder), Relighter(read_basis(folder)))


def read(traced: Traced, level: float, **knobs: str) -> Mapping[str, Measured]:
    turn = turn_of({"levels": [level] * len(traced.sources), "knobs": knobs}, traced.sources)
    image = traced.image(turn)
    return {one.name: one for one in measured(with_camera(traced.scene, image.changes), image.relit)}


@pytest.mark.long
def test_dots_are_where_the_scene_has_them(bench: Traced) -> None:
    """Within what the picture's error may move them; the focal length that they give is the camera's."""
    found = read(bench, 1.0)
    assert list(found) == ["dot_error", "focal_length", "contrast"]
    focal, dots = found["focal_length"], found["dot_error"]
    assert focal.value is not None and focal.error is not None and dots.value is not None
    camera = bench.scene.camera
    assert abs(focal.value - 1e3 * camera.focal_length) < 3 * focal.error < 0.1 * focal.value
    assert (focal.unit, dots.unit) == ("mm", "px")
    assert 0 < dots.value < 1  # of a lit board, whose dots are brighter on one side


@pytest.mark.long
def test_the_same_picture_is_measured_alike(bench: Traced) -> None:
    """Half the light for twice as long, and what is not the picture's: nothing changes."""
    once, twice = read(bench, 1.0), read(bench, 0.5, exposure_time=f"{2e3 * bench.scene.camera.exposure_time!r} ms")
    for name, one in once.items():
        other = twice[name]
        assert other.value == pytest.approx(one.value, rel=1e-6) and other.error == pytest.approx(one.error, rel=1e-3)


def test_what_a_picture_does_not_show_is_said(bench: Traced) -> None:
    found = read(bench, 0.0)
    for name in ("dot_error", "focal_length"):
        assert found[name].value is None and found[name].error is None and found[name].notes
    assert found["contrast"].value == 0.0


def test_targets_decide_what_there_is_to_measure() -> None:
    assert kinds_of(radwrap.load_scene(EDGE)) == ("edge_position", "edge_error", "edge_blur", "contrast")
    sheet = {"type": "disc", "name": "plate", "material": "white", "diameter": "9 mm"}
    bare = scene_with({"targets": [sheet]})
    assert kinds_of(radwrap.scene_from_document(bare)) == ("part_orientation", "contrast")


def test_the_servers_end_does_not_wait_for_a_measurement() -> None:
    hold = threading.Event()

    async def ends() -> None:
        work = asyncio.ensure_future(left_behind(lambda: hold.wait(PATIENCE)))
        await asyncio.sleep(0.05)
        work.cancel()

    start = time.monotonic()
    asyncio.run(ends())
    assert time.monotonic() - start < PATIENCE / 2
    hold.set()


def test_what_goes_wrong_in_a_thread_is_raised_where_it_is_waited_for() -> None:
    with pytest.raises(InputError, match="bad"):
        asyncio.run(left_behind(lambda: (_ for _ in ()).throw(InputError("bad"))))
    assert asyncio.run(left_behind(lambda: 7)) == 7


@pytest.mark.long
def test_the_server_measures_the_turn_that_is_asked_for(served: Served) -> None:
    basis = served.ready()["basis"]

    def contrast(levels: list[float]) -> Any:
        found = served.post("/api/measure", {"basis": basis, "turn": {"levels": levels}})
        assert found.status == 200, found.body
        return next(one for one in found.json["measured"] if one["name"] == "contrast")

    bright, none = contrast([1.0, 1.0]), contrast([0.0, 0.0])
    assert bright["value"] > 0.1 and none["value"] == 0.0
    assert served.post("/api/measure", {"basis": basis + 1}).status == 422
    assert served.post("/api/measure", {"basis": basis, "turn": {"levels": [1.0]}}).json["where"] == "levels"
