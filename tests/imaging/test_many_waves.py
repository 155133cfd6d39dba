"""Diffraction of many images: of a light basis, of a plan of sampling, of a scene that stays laid out."""

from __future__ import annotations

import math
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from numpy.typing import NDArray

import radwrap
from radwrap.errors import InputError
from radwrap.imaging.demand import FINEST_CELL, Demand, SamplingPlan, sampling_plan
from radwrap.imaging.mosaicked import plane_of
from radwrap.imaging.optics.view import View, trace_rays
from radwrap.imaging.other_camera import check_same_light
from radwrap.imaging.relight.relit import read_basis, relit
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.tolerance.kept_replicates import read_replicates
from radwrap.imaging.tolerance.replicates import Work
from radwrap.imaging.tolerance.sampling import Pilot, strictest
from radwrap.imaging.tolerance.wave_far import far_change, far_light
from radwrap.imaging.tolerance.wave_gather import kept_transforms
from radwrap.imaging.tolerance.wave_light import lit_layers
from radwrap.imaging.tolerance.wave_parts import wave_cells, wave_parts, wave_tile
from radwrap.imaging.tolerance.wave_plan import WavePlan, plan_waves
from radwrap.imaging.tracing import LaidOutScene, laid_out
from radwrap.imaging.with_waves import even_waves
from radwrap.process import Programs
from radwrap.progress import Progress
from tests.cli.conftest import scene_with
from tests.imaging.test_basis import DEEP, SOURCES

CHART: Final = Path(__file__).parents[2] / "rad_scenes" / "colour_chart" / "scene.toml"
BENCH: Final = Path(__file__).parents[2] / "rad_scenes" / "bench_board" / "scene.toml"
COARSE: Final = {"rows": 44, "columns": 51, "pixel_width": "28 um", "pixel_height": "28 um"}
FLOAT32: Final = 1e-5  # of the largest value: sums of a few values that are rounded so
ROUNDING: Final = 1e-10  # of sums of a few thousand values
Array = NDArray[np.float64]
NAMES: Final = ("left", "front", "rear", "low")
DARK: Final = "0 W/m^2/sr"


def board(diffraction: str = "on", **changes: Any) -> radwrap.Scene:
    document = tomllib.loads(BENCH.read_text())
    document["camera"]["sensor"] |= COARSE
    document["camera"]["diffraction"] = diffraction
    return radwrap.scene_from_document(document, changes)


def lamps(factors: tuple[float, ...] = (1.0,) * 4, **changes: Any) -> radwrap.Scene:
    document = scene_with({"sources": SOURCES, "camera.diffraction": "on", **changes})
    scene = radwrap.scene_from_document(document)
    sources = tuple(
        replace(source, emitter=replace(source.emitter, radiance=source.emitter.radiance * factor))
        for source, factor in zip(scene.sources, factors, strict=True)
    )
    return replace(scene, sources=sources)


def changes_of(view: View, of_all: View, plan: WavePlan, *, sources: int, alone: bool) -> Array:
    """What waves add to each source, shape (sources, rows, columns)."""
    sensor = of_all.camera.sensor
    found = np.zeros((sources, sensor.rows, sensor.columns))
    for tile, (r0, r1, c0, c1) in enumerate(plan.kernel.tiles):
        cells = wave_cells(of_all, plan, tile, int)
        traced = wave_tile(
            view,
            [plan] * sources,
            (tile, 0),
            cells,
            int,
            transforms=kept_transforms(),
            of_all=of_all if alone else None,
        )
        found[:, r0:r1, c0:c1] = [change for change, *_ in traced]
    return found + [far_change(plan, around)[0] for around in far_light(view, plan, 0, int)]


def test_layers_without_light_are_left_out() -> None:
    """Rounding leaves something of a flat face in the layer beside its own; a dark tile has none."""
    light = {number: np.full((2, 3), level) for number, level in enumerate((5.0, 5e-12, 0.0, -3.0))}
    assert [*lit_layers(light)] == [0, 3]
    assert not lit_layers({2: np.zeros((2, 3)), 3: np.zeros((2, 3))})


@pytest.mark.long
def test_waves_are_linear_in_one_pass_and_source_by_source(tmp_path: Path) -> None:
    """Two depths, so that shares of layers hang on the light: they are those of the light of all sources."""
    pytest.importorskip("numba")
    scene = lamps(**DEEP)
    options = radwrap.RenderOptions(tracer="compiled")
    with Programs() as programs:
        traced = LaidOutScene(scene, options, programs, tmp_path)
        of_all = traced.view()
        (together,) = traced.views_of(NAMES)
        plan = plan_waves(of_all, 550e-9, 1.0, seed=3)
        assert len(plan.kernel.layers) > 1
        in_one_pass = changes_of(together.view, of_all, plan, sources=4, alone=False)
        (whole,) = changes_of(of_all, of_all, plan, sources=1, alone=False)
        single = [changes_of(traced.view_of(name), of_all, plan, sources=1, alone=True)[0] for name in NAMES]
    largest = np.abs(whole).max()
    assert np.abs(in_one_pass - np.stack(single)).max() < FLOAT32 * largest
    assert np.abs(in_one_pass.sum(axis=0) - whole).max() < FLOAT32 * largest
    # "rear" is hidden behind "front".
    assert [bool(np.abs(one).max() > FLOAT32 * largest) for one in single] == [True, True, False, True]


def test_light_from_far_away_adds_up_over_the_sources_of_a_basis(tmp_path: Path) -> None:
    """By levels of sources it is that of a scene with these levels, by the same rays, and so is how far it is off."""
    pytest.importorskip("numba")
    options, factors = radwrap.RenderOptions(tracer="compiled"), (0.3, 1.5, 0.0, 0.7)
    with Programs() as programs:
        traced = LaidOutScene(lamps(), options, programs, tmp_path / "basis")
        plan = plan_waves(traced.view(), 550e-9, 1.0, seed=3)
        (together,) = traced.views_of(NAMES)
        each = [far_change(plan, light) for light in far_light(together.view, plan, 0, int)]
        lit = LaidOutScene(lamps(factors), options, programs, tmp_path / "levels").view()
        (whole,) = [far_change(plan, light) for light in far_light(lit, plan, 0, int)]
    for number, known in enumerate(whole):  # what it adds, and how far that may be off
        found = sum(factor * one[number] for factor, one in zip(factors, each, strict=True))
        assert np.abs(known).min() > 0
        assert found == pytest.approx(known, rel=ROUNDING)


@pytest.mark.parametrize("tracer", ["compiled", pytest.param("radiance", marks=pytest.mark.long)])
def test_a_basis_has_the_waves_of_each_source(tracer: Any, tmp_path: Path) -> None:
    """All factors one give the image itself; others that of another scene, within both errors."""
    options = radwrap.RenderOptions(tolerance=3.0, tracer=tracer, basis=True, seed=3)
    made = radwrap.render(lamps(), tmp_path, options)
    basis = read_basis(tmp_path)
    assert basis.waves is not None and made.manifest["diffraction"]["wavelength"] == 550e-9
    factors = (0.3, 1.5, 0.0, 0.7)
    itself, other = relit(basis, [[1.0] * 4, factors])
    exposure = made.radiant_exposure.values
    assert np.abs(itself.radiant_exposure.values - exposure).max() < FLOAT32 * exposure.max()
    assert itself.certificate.diffraction_gray is not None
    assert 0 < itself.certificate.diffraction_gray < 3.0
    plain = replace(options, basis=False, tolerance=1.0, seed=4)
    fresh = radwrap.render(lamps(factors), options=plain)
    without = radwrap.render(lamps(factors, **{"camera.diffraction": "off"}), options=plain)

    def apart(image: radwrap.Rendered) -> float:
        return math.sqrt(float(((image.gray.values - other.gray.values) ** 2).mean()))

    bound = math.hypot(fresh.error.rms_gray_upper95, other.certificate.rms_gray_upper95)
    assert apart(fresh) < bound < 4.0
    assert apart(without) > apart(fresh)


def two_colours(red: str = "650 nm", **changes: Any) -> radwrap.Scene:
    """A blue lamp and a red one."""
    lines = ({"line": "450 nm", "width": "2 nm"}, {"line": red, "width": "2 nm"})
    sources = [{**SOURCES[number], "spectrum": line} for number, line in zip((0, 3), lines, strict=True)]
    return radwrap.scene_from_document(scene_with({"sources": sources, "camera.diffraction": "on", **changes}))


@pytest.mark.parametrize("tracer", ["compiled", pytest.param("radiance", marks=pytest.mark.long)])
def test_each_colour_has_its_own_waves(tracer: Any, tmp_path: Path) -> None:
    """Those of both lamps are those of each at its own wavelength, by the same rays."""
    scene = two_colours()
    with Programs() as programs:
        traced = LaidOutScene(scene, radwrap.RenderOptions(tracer=tracer), programs, tmp_path)
        view, lights = traced.view(), traced.lights()
        assert [set(light.names or ()) for light in lights] == [{"left"}, {"low"}]
        assert [light.wavelength for light in lights] == pytest.approx([450e-9, 650e-9], rel=1e-5)
        assert max(light.spread for light in lights) < 1e-5
        plan = plan_waves(view, 550e-9, 1.0, seed=3)

        def added(*lit: tuple[View, float]) -> Array:
            plans = [(each, plan.at(wavelength)) for each, wavelength in lit]
            return wave_parts(view, plans, 2, progress=lambda _: None).change

        views = [light.view for light in lights]
        both = added(*zip(views, (450e-9, 650e-9), strict=True))
        apart = both - added((views[0], 450e-9)) - added((views[1], 650e-9))
        swapped = added(*zip(views, (650e-9, 450e-9), strict=True))
    largest = np.abs(both).max()
    assert np.abs(apart).max() < FLOAT32 * largest
    assert np.abs(swapped - both).max() > 1e3 * FLOAT32 * largest


@pytest.mark.long
def test_a_basis_has_the_waves_of_each_colour(tmp_path: Path) -> None:
    options: dict[str, Any] = {"tolerance": 2.0, "tracer": "compiled"}
    made = radwrap.render(two_colours(), tmp_path, basis=True, seed=3, **options)
    assert made.manifest["diffraction"]["wavelengths"] == pytest.approx([450e-9, 650e-9], rel=1e-5)
    itself, blue = relit(read_basis(tmp_path), [[1.0, 1.0], [1.0, 0.0]])
    exposure = made.radiant_exposure.values
    assert np.abs(itself.radiant_exposure.values - exposure).max() < FLOAT32 * exposure.max()
    alone = radwrap.render(two_colours(**{"sources.1.radiance": DARK}), seed=4, **options)
    bound = math.hypot(alone.error.rms_gray_upper95, blue.certificate.rms_gray_upper95)
    assert math.sqrt(float(((blue.gray.values - alone.gray.values) ** 2).mean())) < bound
    assert alone.manifest["diffraction"].get("wavelengths") is None


@pytest.mark.long
def test_what_one_wavelength_leaves_out_of_a_wide_line_is_in_relit_errors(tmp_path: Path) -> None:
    """The same rays in both: a line of 130 nm leaves out half of its variance, over its mean squared, of the waves."""
    errors = []
    for width in ("1 nm", "130 nm"):
        lamp = {**SOURCES[0], "spectrum": {"line": "550 nm", "width": width}}
        scene = radwrap.scene_from_document(scene_with({"sources": [lamp], "camera.diffraction": "on"}))
        made = radwrap.render(scene, tmp_path / width, tolerance=2.0, tracer="compiled", basis=True)
        (again,) = relit(read_basis(tmp_path / width), [[1.0]])
        errors.append(again.certificate.diffraction_gray)
    assert scene.spectral is not None and errors[0] is not None and errors[1] is not None
    left = scene.spectral.wavelength_spread * made.manifest["diffraction"]["about_rms_gray"]
    # What waves change was measured by few rays before they were taken.
    assert errors[1] - errors[0] == pytest.approx(left, rel=0.35)


def test_a_plan_gives_waves_to_every_image_alike(tmp_path: Path) -> None:
    """A darker image, in which waves do not matter, has them by the same rays; each replicate has its own."""
    plan = SamplingPlan("kernel", cell=0.5, replicates=3, wave_cell=0.5)
    how = radwrap.RenderOptions(tracer="compiled", sampling=plan)
    bright = radwrap.render(board("auto"), tmp_path, options=how)
    dark = radwrap.render(board("auto", **{"camera.exposure_time": "1 ms"}), options=how)
    assert bright.manifest["diffraction"]["rays"] == dark.manifest["diffraction"]["rays"]
    assert dark.manifest["diffraction"]["about_rms_gray"] < 0.15 < bright.manifest["diffraction"]["about_rms_gray"]
    times = bright.scene.camera.exposure_time / 1e-3
    assert np.abs(times * dark.radiant_exposure.values - bright.radiant_exposure.values).max() < FLOAT32 * float(
        bright.radiant_exposure.values.max()
    )
    kept = read_replicates(tmp_path, 44)
    assert len(kept.images) == 3 and kept.change.any()
    exposure = bright.radiant_exposure.values
    assert np.abs(np.maximum(kept.images.mean(axis=0), 0.0) - exposure).max() < FLOAT32 * exposure.max()
    none = radwrap.render(board("auto"), options=how, sampling=replace(plan, wave_cell=None))
    assert none.manifest.get("diffraction") is None and none.left_out["diffraction"].needed
    with pytest.raises(InputError, match=r"sampling.wave_cell: is missing"):
        radwrap.render(board("on"), sampling=replace(plan, wave_cell=None))


def test_one_pilot_that_needs_waves_gives_them_to_all() -> None:
    pilots = [Pilot(0.5, False, 64, 3e3, 4e3, wave_cell) for wave_cell in (None, 0.5, 0.25)]
    assert strictest(pilots, Demand(0.5)).wave_cell == 0.25
    plan = strictest(pilots[:2], Demand(0.5, method="rays"))
    assert plan.wave_cell == 0.5 and sampling_plan(plan.as_json(), "sampling[0]") == plan
    assert strictest(pilots[:1], Demand(0.5)).wave_cell is None
    both = [replace(pilots[1], wave_far=share) for share in (0.02, 0.01)]
    plan = strictest([*pilots[:1], *both], Demand(0.5, method="rays"))
    assert plan.wave_far == 0.01 and sampling_plan(plan.as_json(), "sampling[0]") == plan
    assert "wave_far" not in strictest(pilots, Demand(0.5)).as_json()
    for share in (0.0, 1.5, "0.5"):
        with pytest.raises(InputError, match=r"wave_far: must be a number above 0 and at most 1"):
            sampling_plan({**plan.as_json(), "wave_far": share}, "sampling[0]")
    for value in (0.3, "0.5", -1):
        with pytest.raises(InputError, match=r"wave_cell: must be a power of 2"):
            sampling_plan({**plan.as_json(), "wave_cell": value}, "sampling[0]")


def test_a_warm_scene_gives_the_same_bytes() -> None:
    pytest.importorskip("numba")
    options = radwrap.RenderOptions(tolerance=3.0, tracer="compiled")
    with radwrap.warm(board(), options) as live:
        live.render()
        key = {"sources[0].radiance": "2400 W/m^2/sr"}
        warm, cold = live.render(key), radwrap.render(board(**key), options=options)
    assert np.array_equal(warm.radiant_exposure.values, cold.radiant_exposure.values)
    assert warm.run.run_sha256 == cold.run.run_sha256 and warm.error == cold.error
    assert warm.manifest["diffraction"] == cold.manifest["diffraction"]


def test_another_exposure_keeps_waves_and_another_wavelength_is_refused() -> None:
    made = radwrap.render(board(), tolerance=3.0)
    twice = made.with_exposure(2 * made.scene.camera.exposure_time)
    growth = twice.error.rms_gray_upper95 / made.error.rms_gray_upper95
    assert made.error.diffraction_gray and growth > 1.5
    assert twice.error.diffraction_gray == pytest.approx(growth * made.error.diffraction_gray)
    assert np.allclose(twice.radiant_exposure.values, 2 * made.radiant_exposure.values)
    assert twice.manifest["diffraction"] == made.manifest["diffraction"]
    camera = radwrap.load_scene(BENCH.parents[1] / "data_sheet_camera" / "scene.toml").camera
    assert camera.diffraction == "auto" and camera.sensor.linear is not None
    linear = replace(camera.sensor.linear, wavelength=1.2 * camera.sensor.linear.wavelength)
    other = replace(camera, sensor=replace(camera.sensor, linear=linear))
    with pytest.raises(InputError, match=r"camera.sensor.wavelength: changes what the opening's waves do"):
        check_same_light(camera, other)
    check_same_light(replace(camera, diffraction=None), replace(other, diffraction=None))


@pytest.mark.long
def test_light_that_goes_far_is_looked_at_as_far_as_a_tolerance_needs(tmp_path: Path) -> None:
    """Of light that a narrow pinhole sends beyond six blurs the law is off by .25 gray, which is all that is asked."""
    sharp = {"camera.aperture.diameter": "0.1373 mm", "camera.exposure_time": "85.7 ms"}
    scene = radwrap.load_scene(BENCH.parents[1] / "design_edge" / "scene.toml", sharp)
    options = radwrap.RenderOptions(tolerance=0.25)
    with laid_out(scene, options) as traced, Programs() as programs:
        work = Work(traced.view(), tmp_path, programs, Progress("", 1, shown=False), traced.sha256(), 0)
        waves = even_waves(scene, work, options)
    assert waves is not None and 0 < waves.wave_far < 0.02
    plan = SamplingPlan("kernel", cell=0.25, wave_cell=waves.wave_cell)
    near, far = (
        radwrap.render(scene, tolerance=0.25, sampling=replace(plan, wave_far=share))
        for share in (None, waves.wave_far)
    )
    assert near.error.diffraction_gray > 0.24 and not near.met
    assert far.error.diffraction_gray < 0.15 and far.met
    # What is looked at farther is within what the law was held to be off by.
    gray = scene.camera.sensor.gain * (near.radiant_exposure.values - far.radiant_exposure.values)
    assert 0 < np.sqrt((gray**2).mean()) < near.error.diffraction_gray


@pytest.mark.long
@pytest.mark.parametrize(("tolerance", "finest"), [(2.0, False), (0.02, True)])
def test_even_cells_of_waves_are_as_fine_as_a_tolerance_needs(tolerance: float, finest: bool, tmp_path: Path) -> None:
    """Waves blur by a thirtieth of a pixel here. Cells that resolve that are needed for a fine tolerance only."""
    sensor = {"rows": 15, "columns": 20, "pixel_width": "110.4 um", "pixel_height": "110.4 um"}
    changes = {f"camera.sensor.{key}": value for key, value in sensor.items()} | {
        "camera.diffraction": "on",
        "camera.exposure_time": "0.075 ms",
    }
    chart = radwrap.load_scene(CHART, changes)
    scene = plane_of(chart, "green")
    options = radwrap.RenderOptions(tolerance=tolerance)
    with laid_out(scene, options) as traced, Programs() as programs:
        view = traced.view()
        work = Work(view, tmp_path, programs, Progress("", 1, shown=False), traced.sha256(), 0)
        waves = even_waves(scene, work, options)
        assert waves is not None
        cell = waves.wave_cell
        plans = [plan_waves(view, 550e-9, 0.0, seed, even_cell=size) for seed, size in ((1, cell), (2, cell / 2))]
        blur = plans[0].waves.blur / plans[0].pitch
        if finest:
            assert cell == FINEST_CELL
            return
        assert cell > 2 * blur
        # Twelve replicates, as a plan has; half the size stands for what is there.
        v, u = np.indices((15, 20), dtype=np.float64)
        seen = trace_rays(view, None, u.ravel(), v.ravel())[0].reshape(15, 20)
        found = []
        for plan, replicates in zip(plans, (12, 4), strict=True):
            parts = wave_parts(view, [(view, plan)], replicates, progress=lambda _: None)
            light = np.maximum(seen + parts.change.mean(axis=0), 0.0) * view.exposure_of_radiance
            found.append(gray_levels(light, scene.camera.sensor))
    assert 0 < np.sqrt(((found[0] - found[1]) ** 2).mean()) < 0.4 * tolerance
