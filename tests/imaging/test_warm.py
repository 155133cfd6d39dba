"""A scene that stays laid out: its renders are those of a cold one, byte by byte."""

from __future__ import annotations

import inspect
import json
import shutil
import threading
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap import files
from radwrap.imaging import tracer_choice, tracing
from radwrap.imaging import warm as warm_module
from radwrap.imaging.demand import SamplingPlan
from radwrap.imaging.output.run_manifest import read_run_manifest
from radwrap.imaging.relight.relit import read_basis
from radwrap.imaging.tracing import LaidOutScene
from radwrap.kept import Kept, of_kept
from radwrap.manifest import plain
from radwrap.process import Programs
from radwrap.tracers.agreement import Agreement
from radwrap.tracers.compiled import tracer as compiled_tracer
from tests.cli.conftest import children

SCENES = Path(__file__).parents[2] / "rad_scenes"
# Two gray levels: what is kept hangs on no tolerance, and a render takes a third of the rays of the usual one.
OPTIONS = radwrap.RenderOptions(tracer="compiled", tolerance=2.0)
SMALL = {"rows": 44, "columns": 51, "pixel_width": "28 um", "pixel_height": "28 um"}


def document(name: str) -> dict[str, Any]:
    found = tomllib.loads((SCENES / name / "scene.toml").read_text())
    found["camera"]["sensor"] |= SMALL
    return found


def board(**changes: Any) -> radwrap.Scene:
    return radwrap.scene_from_document(document("bench_board"), changes)


def told(result: radwrap.Rendered) -> dict[str, Any]:
    """All that a result says, but for its times."""
    return {key: value for key, value in result.manifest.items() if key != "timing"}


def assert_same(warm: radwrap.Rendered, cold: radwrap.Rendered) -> None:
    assert told(warm) == told(cold)
    assert np.array_equal(warm.radiant_exposure.values, cold.radiant_exposure.values)
    assert np.array_equal(warm.gray.values, cold.gray.values)


@pytest.fixture(scope="module")
def live() -> Iterator[radwrap.WarmScene]:
    """One scene for all changes: each comes after others, whose values are kept."""
    with radwrap.warm(board(), OPTIONS) as live:
        live.render()
        yield live


CHANGES: Mapping[str, Mapping[str, Any]] = {
    "nothing": {},
    "level": {"sources[0].radiance": "2400 W/m^2/sr"},
    "factor of an LED": {"sources[0].leds": [{"index": 3, "radiance_factor": 0.5}]},
    "axis of an LED": {"sources[0].leds": [{"index": 3, "axis_tilt": "3 deg"}]},
    "dark LED": {"sources[0].leds": [{"index": 3, "radiance_factor": 0}]},
    "beam": {"sources[0].beam.width": "9 deg"},
    "place of the light": {"sources[0].diameter": "26 mm"},
    "reflectance": {"materials.black.reflectance": 0.06},
    "roughness": {"materials.sheeting.roughness": 0.03},
    "exposure": {"camera.exposure_time": "200 ms"},
    "gamma": {"camera.sensor.gamma": 0.9, "camera.sensor.gain": "3e4 (J/m^2)^-0.9"},
    "dark level": {"camera.sensor.dark_gray": 12},
    "bits": {"camera.sensor.bit_depth": 12},
    "rounding": {"camera.sensor.rounding": False},
    "pixels": {"camera.sensor.rows": 40},
    "pinhole": {"camera.aperture.diameter": "0.2 mm"},
    "pose of the target": {"targets[0].rotation": ["40 deg", "6 deg", "-2 deg"]},
    "pose of the camera": {"camera.position": ["2 mm", "0 mm", "790 mm"]},
    "dots": {"targets[0].dot_diameter": "12 mm"},
}
# One of each thing that is kept: light, materials, sensor, what rays meet.
SOME = ("level", "beam", "reflectance", "exposure", "pinhole", "pose of the target")


@pytest.mark.parametrize(
    "name", [name if name in SOME else pytest.param(name, marks=pytest.mark.long) for name in CHANGES]
)
def test_a_changed_scene_gives_the_bytes_of_a_cold_one(name: str, live: radwrap.WarmScene) -> None:
    assert_same(live.render(CHANGES[name]), radwrap.render(board(**CHANGES[name]), options=OPTIONS))


@pytest.mark.long
@pytest.mark.parametrize("tolerance", [20.0, 4.0])
def test_radiance_gives_the_same_bytes_too(tolerance: float) -> None:
    options = radwrap.RenderOptions(tracer="radiance", tolerance=tolerance)
    with radwrap.warm(board(), options) as live:
        for name in ("level", "pose of the camera")[: 1 if tolerance > 4 else 2]:
            assert_same(live.render(CHANGES[name]), radwrap.render(board(**CHANGES[name]), options=options))
        assert_same(
            live.render(tolerance=2 * tolerance), radwrap.render(board(), options=options, tolerance=2 * tolerance)
        )


@pytest.mark.parametrize(
    "how",
    [
        {"tolerance": 4.0},
        pytest.param({"tolerance": 0.5}, marks=pytest.mark.long),
        pytest.param({"seed": 1}, marks=pytest.mark.long),
        {"method": "rays", "tolerance": 3.0},
        {"method": "kernel", "max_error": 6.0},
        *(pytest.param(how, marks=pytest.mark.long) for how in ({"viewpoints": 7}, {"truth": True})),
        {"workers": 1},
        {"sampling": SamplingPlan("rays", rays=16)},
    ],
    ids=str,
)
def test_other_options_give_the_bytes_of_a_cold_render(how: dict[str, Any], live: radwrap.WarmScene) -> None:
    assert_same(live.render(**how), radwrap.render(board(), options=OPTIONS, **how))


@pytest.mark.long
def test_files_are_the_same_too(live: radwrap.WarmScene, tmp_path: Path) -> None:
    live.render({"sources[0].radiance": "2000 W/m^2/sr"}, tmp_path / "warm", basis=True)
    radwrap.render(board(**{"sources[0].radiance": "2000 W/m^2/sr"}), tmp_path / "cold", basis=True, options=OPTIONS)
    names = [path.relative_to(tmp_path / "cold") for path in (tmp_path / "cold").rglob("*.*") if path.is_file()]
    assert len(names) > 12
    for name in names:
        if name.suffix != ".json":
            assert (tmp_path / "warm" / name).read_bytes() == (tmp_path / "cold" / name).read_bytes()


@pytest.fixture(scope="module")
def brief(live: radwrap.WarmScene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a basis that was left for another process."""
    folder = tmp_path_factory.mktemp("brief")
    how: dict[str, Any] = {"tolerance": 4.0, "basis": True, "cancelled": lambda: False, "progress": lambda _: None}
    live.leave(board(), folder, brief=True, **how)
    return folder


def test_a_basis_in_one_file_is_the_one_in_pictures(live: radwrap.WarmScene, brief: Path, tmp_path: Path) -> None:
    whole = live.render(board(), tmp_path, tolerance=4.0, basis=True)
    one, many = read_basis(brief), read_basis(tmp_path)
    assert len(list((tmp_path / "basis").iterdir())) > 24 and len(list((brief / "basis").iterdir())) == 1
    assert one.waves is not None and one.sample is not None and one.grid.any()  # each kind of part is there
    for name in ("images", "grid", "lacks", "waves"):
        assert np.array_equal(getattr(one, name), getattr(many, name)), name
    run, alone = whole.run, replace(read_run_manifest(brief), timing=whole.run.timing)
    assert plain(replace(run, files={})) == plain(replace(alone, files={}))  # without pictures, of which all is told


@pytest.mark.parametrize("name", ["basis/parts.f32", "basis.json"])
def test_a_basis_in_one_file_that_was_changed_is_refused(name: str, brief: Path, tmp_path: Path) -> None:
    shutil.copytree(brief, tmp_path, dirs_exist_ok=True)
    content = bytearray((tmp_path / name).read_bytes())
    content[len(content) // 2] ^= 1
    (tmp_path / name).write_bytes(content)
    with pytest.raises(radwrap.InputError, match=r"not the file|not as it was made|not JSON"):
        read_basis(tmp_path)


@pytest.mark.parametrize(
    ("name", "level"),
    [
        pytest.param("ring", {"sources[0].leds": [{"index": 1, "radiance_factor": 0.5}]}, marks=pytest.mark.long),
        pytest.param("two_bars", {"sources[0].radiance": "900 W/m^2/sr"}, marks=pytest.mark.long),
    ],
)
def test_cells_of_a_factory_give_the_bytes_of_a_cold_one(name: str, level: dict[str, Any]) -> None:
    """Meshes with holes, a lens; with bars, wide lights and effects that Radiance measures, which is long."""
    folder = SCENES / "cells"
    cell = tomllib.loads((folder / f"{name}.toml").read_text())
    changes: dict[str, Any] = {"camera.sensor.rows": 33, "camera.sensor.columns": 40}
    scene = radwrap.scene_from_document(cell, changes, folder=folder)
    shorter = radwrap.scene_from_document(cell, changes | {"camera.exposure_time": "3 ms"}, folder=folder)
    dimmer = radwrap.scene_from_document(cell, changes | level, folder=folder)
    options = radwrap.RenderOptions(tracer="compiled", tolerance=4.0)
    with radwrap.warm(scene, options) as live:
        for one in (scene, shorter, dimmer, scene):
            assert_same(live.render(one), radwrap.render(one, options=options))


class _Followed:
    """Blocks of rays that the compiled tracer was asked for, and those that it followed to what they meet."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.asked: dict[bytes, int] = {}
        self.followed: set[bytes] = set()
        self._keep(monkeypatch, "trace", lambda block: self.asked.update({block.tobytes(): len(block)}))
        self._keep(monkeypatch, "meet", lambda block: self.followed.add(block.tobytes()))

    @staticmethod
    def _keep(monkeypatch: pytest.MonkeyPatch, name: str, seen: Callable[[np.ndarray], object]) -> None:
        function = getattr(compiled_tracer, name)
        place = list(inspect.signature(getattr(function, "py_func", function)).parameters).index("rays")

        def counted(*arguments: Any) -> Any:
            seen(arguments[place])
            return function(*arguments)

        monkeypatch.setattr(compiled_tracer, name, counted)


@pytest.mark.parametrize(
    "name",
    [
        *("level", "exposure"),
        *(
            pytest.param(name, marks=pytest.mark.long)
            for name in ("reflectance", "factor of an LED", "beam", "roughness")
        ),
    ],
)
@pytest.mark.parametrize(
    ("how", "rays"), [({"viewpoints": 3}, 3), ({"sampling": SamplingPlan("kernel", cell=0.5)}, 48)], ids=str
)
def test_the_same_rays_are_not_followed_again(
    name: str, how: dict[str, Any], rays: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In other light, by other materials: where no light decides the rays, none of the image's is new."""
    with radwrap.warm(board(), radwrap.RenderOptions(tracer="compiled", **how)) as live:
        seen = _Followed(monkeypatch)
        live.render()
        first, followed = dict(seen.asked), set(seen.followed)
        seen.asked.clear()
        seen.followed.clear()
        live.render(CHANGES[name])
    assert len(followed) > 3
    assert not followed & seen.followed, "blocks that were followed again"
    known = sum(count for block, count in seen.asked.items() if block in first)
    # What was seen by the same rays in the same light is known too, and not asked for again.
    assert known >= rays * 44 * 51 or name == "exposure"
    assert sum(seen.asked.values()) < sum(first.values()) or name != "exposure"


@pytest.mark.long
def test_what_is_known_of_the_tracers_is_asked_again_where_it_may_have_changed(monkeypatch: pytest.MonkeyPatch) -> None:
    programs: list[str] = []
    start = Programs._enter

    def entered(self: Programs, argv: Any, *more: Any) -> Any:
        programs.append(Path(argv[0]).name)
        return start(self, argv, *more)

    monkeypatch.setattr(Programs, "_enter", entered)
    with radwrap.warm(board(), radwrap.RenderOptions(tracer="compiled")) as live:
        assert "rtrace" in programs
        for change, asked in (({}, False), (CHANGES["exposure"], False), (CHANGES["level"], True), ({}, False)):
            programs.clear()
            live.render(change)
            assert ("rtrace" in programs) == asked


def test_errors_of_the_scene_come_when_it_is_laid_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "_MEMORY", tmp_path)
    monkeypatch.setattr(files, "_ROOM", 0)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(radwrap.EnvironmentFailure):
        radwrap.warm(board(), radwrap.RenderOptions(radiance=str(SCENES)))
    assert list(tmp_path.iterdir()) == []


def test_nothing_stays_once_it_is_closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    memory, others = tmp_path / "memory", tmp_path / "others"
    memory.mkdir()
    others.mkdir()
    monkeypatch.setattr(files, "_MEMORY", memory)
    monkeypatch.setattr(files, "_ROOM", 0)
    monkeypatch.setattr("tempfile.tempdir", str(others))
    with radwrap.warm(board(), OPTIONS) as live:
        live.render()
        assert live._kept.held > 0
        (folder,) = memory.iterdir()
        assert list(folder.iterdir()) == []  # of a render nothing is left, but what is kept
    assert [*memory.iterdir(), *others.iterdir()] == [] and live._kept.held == 0
    assert children() == []
    with pytest.raises(radwrap.InputError, match="closed"):
        live.render()
    live.close()


def test_a_cancelled_render_leaves_the_scene_warm_and_right(live: radwrap.WarmScene) -> None:
    wish = threading.Event()
    with pytest.raises(radwrap.Cancelled):
        live.render(CHANGES["pinhole"], tolerance=0.02, cancelled=wish.is_set, progress=lambda _: wish.set())
    assert_same(live.render(), radwrap.render(board(), options=OPTIONS))


def test_memory_is_bounded_and_what_was_not_used_for_longest_goes_first() -> None:
    kept = Kept(100)
    for number in range(10):
        kept.put(number, f"value {number}", 30)
        kept.get(0)
    assert kept.held == 90
    assert [number for number in range(10) if kept.get(number)] == [0, 8, 9]
    kept.put("large", "too large by itself", 101)
    assert kept.get("large") is None and kept.held == 90
    kept.put(0, "smaller", 10)
    assert kept.held == 70
    assert of_kept(kept, lambda: 0, lambda: "made", len) == "smaller"
    assert of_kept(kept, lambda: 1, lambda: "made", len) == "made" == kept.get(1)
    assert of_kept(None, lambda: 0, lambda: "made", len) == "made"
    kept.clear()
    assert kept.held == 0 and kept.get(0) is None


@pytest.mark.long
def test_a_small_memory_changes_no_byte(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(warm_module, "KEPT_AT_MOST", 200_000)
    options = radwrap.RenderOptions(tracer="compiled")
    with radwrap.warm(board(), options) as live:
        for name in ("level", "exposure"):
            assert_same(live.render(CHANGES[name]), radwrap.render(board(**CHANGES[name]), options=options))
            assert live._kept.held <= 200_000


def test_a_warm_scene_is_what_a_scene_laid_out_alone_says(tmp_path: Path) -> None:
    """The hash that a run is known by hangs on nothing that is kept."""
    scene, options = board(), radwrap.RenderOptions(tracer="compiled")
    with Programs() as programs:
        cold = LaidOutScene(scene, options, programs, tmp_path).sha256()
        kept = Kept(1 << 20)
        warm = [LaidOutScene(scene, options, programs, tmp_path, kept=kept) for _ in range(2)]
    assert [one.sha256() for one in warm] == [cold, cold]
    assert warm[1].tracer_used == warm[0].tracer_used
    assert json.dumps(dict(warm[1].tracer_versions)) == json.dumps(dict(warm[0].tracer_versions))


@pytest.mark.long
def test_what_was_traced_before_the_tracers_were_found_to_differ_does_not_stand(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The comparison goes on while an image is traced; where it fails, Radiance makes the image, as without that."""
    options = radwrap.RenderOptions(tracer="auto", tolerance=4.0)
    monkeypatch.setattr(tracer_choice, "WORTH_COMPILED", 1)
    with radwrap.warm(board(), options) as live:
        assert live.render().run.tracer.name == "compiled"
        monkeypatch.setattr(tracing, "probed", lambda *_: Agreement(512, 100, 1e-5, 0.1, agree=False))
        scene = board(**CHANGES["level"])
        cold, warm = radwrap.render(scene, options=options), live.render(scene)
        assert warm.run.tracer.name == "radiance" and "differ on 100 of 512" in warm.run.tracer.reason
        assert_same(warm, cold)
        with pytest.raises(radwrap.EnvironmentFailure, match="differ on 100"):
            live.render(scene, tracer="compiled")
        assert live.render().run.tracer.name == "compiled"  # what is kept of the first scene still holds
