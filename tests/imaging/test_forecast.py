"""What a run will take: held against tracers whose time is known, and against runs."""

from __future__ import annotations

import math
import time
import tomllib
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import radwrap
from radwrap.imaging import forecasting
from radwrap.imaging.forecast.rehearsal import Rehearsed, Stopwatch, rehearsed, rehearsed_viewpoints, seconds_per_ray
from radwrap.imaging.forecast.wave_rehearsal import rehearsed_waves
from radwrap.imaging.forecasting import forecast
from radwrap.imaging.mean_radiance import viewpoint_plan
from radwrap.imaging.tolerance import planner
from radwrap.imaging.tolerance.planner import Search
from radwrap.imaging.tolerance.replicates import Work, trace_replicates
from radwrap.imaging.tracing import traced_scene
from radwrap.process import Programs
from radwrap.progress import Progress
from radwrap.tracers.tracer import Tracer

COAXIAL = Path(__file__).parents[2] / "rad_scenes" / "cells" / "coaxial.toml"
START = Path(__file__).parents[2] / "radwrap" / "data" / "init" / "scene.toml"
_COST = 1e-4  # s of processor time that a slow tracer takes for a ray; all else takes a fifth of it at most
_SLACK = 1.5  # of what else is done beside that, which takes longer beside other tests; as good as a forecast must be
# s of a tile in one thread, of which four are made: all else then takes an eighth of what a slow tracer takes, so that
# a forecast that is 15 % too short or 40 % too long is seen.
_LONGEST = 0.5
_LONG = 1000.0  # s that nothing here takes
Array = NDArray[np.float64]


def scene(times: int = 1, **changes: Any) -> radwrap.Scene:
    """The board of `radwrap init` with so many times the rows and columns, on the same field of view."""
    document = tomllib.loads(START.read_text())
    document["camera"]["sensor"] |= {
        "rows": 33 * times,
        "columns": 48 * times,
        "pixel_width": f"{55 / times} um",
        "pixel_height": f"{80 / times} um",
    }
    document["camera"]["diffraction"] = "off"  # it would be most of so small an image
    return radwrap.scene_from_document(document, changes)


@dataclass(frozen=True, slots=True)
class Slow:
    """Answers as another tracer, and takes a known processor time for each ray more; satisfies `Tracer`."""

    tracer: Tracer

    def trace(self, rays: Iterable[Array]) -> Generator[Array]:
        for values, _ in self.trace_with_distances(rays):
            yield values

    def trace_with_distances(self, rays: Iterable[Array]) -> Generator[tuple[Array, Array]]:
        for found in self.tracer.trace_with_distances(rays):
            self._burn(len(found[0]))
            yield found

    def distances(self, rays: Iterable[Array]) -> Generator[Array]:
        return self.tracer.distances(rays)

    def _burn(self, rays: int) -> None:
        end = time.thread_time() + rays * _COST
        while time.thread_time() < end:
            pass


def slowed(work: Work) -> Work:
    return replace(work, view=replace(work.view, tracer=Slow(work.view.tracer)))


@contextmanager
def working(shown: radwrap.Scene, folder: Path, *, slow: bool) -> Iterator[Work]:
    with traced_scene(shown) as traced, Programs() as programs:
        folder.mkdir(exist_ok=True)
        work = Work(replace(traced, workers=1), folder, programs, Progress("", 1, shown=False), "test", 0)
        yield slowed(work) if slow else work


def test_a_stopwatch_counts_the_work_of_this_machine_only() -> None:
    clock = Stopwatch()
    time.sleep(0.2)  # another program has the processor
    assert clock.lap() < 0.05
    end = time.thread_time() + 0.2
    while time.thread_time() < end:
        pass
    assert clock.lap() == pytest.approx(0.2, rel=0.2)


def test_a_slow_tracer_is_seen(tmp_path: Path) -> None:
    with working(scene(), tmp_path, slow=True) as work:
        assert _COST <= seconds_per_ray(work.view) <= _SLACK * _COST
        plan = viewpoint_plan(scene(), radwrap.RenderOptions(viewpoints=7), "viewpoints", "")
        found = rehearsed_viewpoints(work.view, plan)
        assert found.rays == 7 * 33 * 48
        assert found.rays * _COST <= found.seconds <= _SLACK * found.rays * _COST


@pytest.mark.long
def test_an_image_takes_as_long_as_its_rays_and_four_times_the_pixels_four_times_as_long(tmp_path: Path) -> None:
    seconds = []
    for times in (1, 2):
        with working(scene(times), tmp_path, slow=False) as work:
            search = Search(work, radwrap.RenderOptions(method="rays", tolerance=16.0).demand)
            plan, number = search.first_plan()
            expected = search.choice.expected_rays["rays"]
            assert expected is not None
            found = rehearsed(slowed(work), plan, number, expected, longest=_LONGEST)
            assert found.rays * _COST <= found.seconds <= _SLACK * found.rays * _COST
            seconds.append(found.seconds)
    # Smaller pixels see less change in each; both have eight rays to decide and four at least.
    assert 2.5 < seconds[1] / seconds[0] < 4.5


def test_some_tiles_stand_for_all(tmp_path: Path) -> None:
    """A kernel's image of 16 tiles, of which four or more are made."""
    with working(scene(12), tmp_path, slow=False) as work:
        search = Search(work, radwrap.RenderOptions(method="kernel", tolerance=0.5).demand)
        plan, number = search.first_plan()
        tiles = tuple(
            (row, row + 99, column, column + 144) for row in range(0, 396, 99) for column in range(0, 576, 144)
        )
        small = replace(plan, tiles=tiles)
        found = rehearsed(work, small, number, search.choice.expected_rays["kernel"] or 0)
        made = trace_replicates(work, small, number)
    assert 1 / 1.5 < found.rays / made.rays < 1.5


def test_a_shutter_that_never_opens_is_forecast_without_a_warning() -> None:
    cost = forecast(scene(**{"camera.exposure_time": "0 s"}), radwrap.RenderOptions(workers=1), started=0.0)
    assert 0 < cost.seconds < 60 and cost.rays > 0


def test_parts_add_up() -> None:
    cost = forecast(scene(1), radwrap.RenderOptions(workers=1), started=1.0)
    assert cost.seconds == pytest.approx(sum(cost.parts.values())) and cost.parts["start"] == 1.0
    before, after = {"start", "layout", "light between surfaces", "survey"}, {"what is left out", "files"}
    assert before | {"image and certificate"} | after == set(cost.parts)


@pytest.mark.long
def test_a_run_takes_about_as_long(tmp_path: Path) -> None:
    cost = forecast(scene(4), radwrap.RenderOptions(workers=1), started=1.0)
    clock = Stopwatch()
    radwrap.render(scene(4), tmp_path / "out", workers=1)
    # A tenth of a second more or less is the start of the tracer's programs.
    assert cost.seconds - 1.0 == pytest.approx(clock.lap(), rel=0.5, abs=0.2)


def test_waves_of_each_source_count_in_a_basis(monkeypatch: pytest.MonkeyPatch) -> None:
    """With waves a basis has rays again, around the image and where it has edges; without, the image's own."""

    def long(*asked: Any, **lit: Any) -> Rehearsed:
        found = rehearsed_waves(*asked, **lit)
        assert found.seconds > 0
        return replace(found, seconds=_LONG)

    monkeypatch.setattr(forecasting, "rehearsed_waves", long)
    options = radwrap.RenderOptions(workers=1, tolerance=2.0, basis=True, tracer="compiled")
    without, with_waves = (
        forecast(scene(1, **{"camera.diffraction": word}), options, started=0.0) for word in ("off", "on")
    )
    assert "diffraction" in with_waves.parts and "diffraction" not in without.parts
    assert with_waves.parts["basis"] > _LONG > without.parts["basis"]


@pytest.mark.long
def test_finer_images_count_that_follow_one_which_keeps_no_tolerance() -> None:
    """The coaxial cell at a sixteenth takes three images, each of more rays than the one before."""
    small = radwrap.load_scene(COAXIAL)
    values = {"rows": 32, "columns": 38, "pixel_width": "220.8 um", "pixel_height": "220.8 um"}
    for key, value in {f"camera.sensor.{name}": value for name, value in values.items()}.items():
        small = radwrap.with_value(small, key, value)
    small = radwrap.with_value(small, "camera.diffraction", "off")
    options = radwrap.RenderOptions(workers=1, tolerance=0.5)
    made = radwrap.render(small, workers=1, tolerance=0.5)
    assert made.run.plan is not None and len(made.run.plan.attempts) > 1
    assert forecast(small, options, started=0.0).rays == made.run.plan.rays


@pytest.mark.parametrize(
    "options", [pytest.param({"method": "rays", "tolerance": 0.4}, marks=pytest.mark.long), {"viewpoints": 37}]
)
def test_a_long_run_says_so_before_and_what_is_cheaper(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, options: dict[str, Any]
) -> None:
    limits = ("_LONG", "_MANY", "_PERHAPS_LONG")
    for name in limits:
        monkeypatch.setattr(forecasting, name, math.inf)  # a busy machine made it long
    plain = radwrap.render(scene(), tmp_path / "plain", progress=True, **options)
    assert capsys.readouterr().err == "" and plain.run.timing.forecast is None
    for name in limits:
        monkeypatch.setattr(forecasting, name, 0.0)
    # Of so short a run what is left as it is may be most, and a rehearsal as long as the run.
    monkeypatch.setattr(forecasting, "_CHEAPER", 10.0)
    told = radwrap.render(scene(), tmp_path / "told", progress=True, **options)
    words = capsys.readouterr().err
    assert "this will take about" in words and "half as many columns and rows of pixels" in words
    assert told.run.timing.forecast is not None
    # Of the run's own files nothing hangs on that.
    assert told.run.files == plain.run.files
    assert {path.name for path in (tmp_path / "told").iterdir()} == {
        path.name for path in (tmp_path / "plain").iterdir()
    }
    found = {one.change: one.wall_s for one in told.run.timing.forecast.cheaper}
    whole = told.run.timing.forecast.wall_s
    assert all(0 < wall <= whole for wall in found.values())
    assert (
        "a tolerance of 0.8 gray in place of 0.4" if "method" in options else "19 viewpoints in place of 37"
    ) in found


def test_what_is_cheaper_looks_for_no_smooth_blocks_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """They took a quarter of a render under wide lights; at twice the tolerance and in larger pixels they stay."""
    pytest.importorskip("numba")
    from tests.tracers.belt import scene_of  # imports numba

    options = radwrap.RenderOptions(tolerance=0.5, tracer="compiled")
    with forecasting._stage(scene_of(), options) as stage:
        what = Search(stage.work, options.demand)
        assert what.view.smooth is not None
        parts = dict.fromkeys(("image", "certificate", "files"), 1.0)
        monkeypatch.setattr(planner, "with_smooth_blocks", None)
        monkeypatch.setattr(forecasting, "_SHORT_SEARCH", 0.0)  # what is short is rehearsed as a whole
        changes = [change for change, seconds in stage._changes(what, parts) if math.isfinite(seconds)]
    assert changes == ["a tolerance of 1 gray in place of 0.5", "half as many columns and rows of pixels"]


def test_diffraction_is_a_part_of_what_a_run_takes(tmp_path: Path) -> None:
    """By its rays, which no clock decides: as many as the run traces, to the factor that forecasts are good to."""
    pytest.importorskip("numba")
    made: dict[str, Any] = {}
    options = radwrap.RenderOptions(tolerance=4.0, tracer="compiled")
    for diffraction in ("on", "off"):
        seen = scene(**{"camera.diffraction": diffraction})
        cost = forecast(seen, options)
        made[diffraction] = cost.rays, radwrap.render(seen, tmp_path / diffraction, options).run
        assert ("diffraction" in cost.parts) == (diffraction == "on")
    (rays, run), (without, _) = made["on"], made["off"]
    assert run.diffraction is not None and run.diffraction.rays > 0.3 * run.rays
    assert run.diffraction.rays / 1.5 < rays - without < 1.5 * run.diffraction.rays
