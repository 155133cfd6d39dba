"""Images of which most is looked up between few rays: thin things are found, and certificates see what is off."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("numba")

import radwrap
from radwrap import Caliper, GrayImage
from radwrap.imaging.methods.central import CentralImage
from radwrap.imaging.methods.kernel import gather, plan_kernel
from radwrap.imaging.methods.smooth_blocks import in_other_light, smooth_field
from radwrap.imaging.optics.smooth import BLOCK
from radwrap.imaging.optics.view import View, trace_rays
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.rendered import Rendered
from radwrap.imaging.synthesis import render
from radwrap.imaging.tolerance.certificate import PixelErrors, independent_errors, root
from radwrap.imaging.tracing import laid_out
from radwrap.scene.scene import Scene
from tests.tracers.belt import FLAT, at, scene_of

COMPILED = RenderOptions(tracer="compiled")
LENS: dict[str, Any] = {**FLAT["camera"], "lens": {"focus_distance": "400 mm", "f_number": 8}}
del LENS["aperture"]


def true_errors(scene: Scene, made: Rendered, pixels: np.ndarray, rays: int = 256) -> PixelErrors:
    with laid_out(scene, COMPILED) as traced:
        view = traced.view()
        radiance = made.radiant_exposure.values.ravel()[pixels] / view.exposure_of_radiance
        return independent_errors(view, pixels, radiance, rays=rays, seed=(7, 7))


def rms(errors: PixelErrors) -> float:
    return root(float((errors.first * errors.second).mean()))


def test_between_corners_lies_what_rays_see() -> None:
    scene = scene_of(camera=LENS)
    with laid_out(scene, COMPILED) as traced:
        view = traced.view()
        found = smooth_field(view, 3.0, 0.5)
        assert found is not None
        assert found.share == 1.0
        random = np.random.default_rng(1)
        u, v = random.uniform(-0.5, 119.5, 4000), random.uniform(-0.5, 95.5, 4000)
        assert found.holds(u, v).all()
        value, depth = trace_rays(view, None, u, v, with_depth=True)
        seen, magnification = found.at(u, v)
        scale = view.exposure_of_radiance * scene.camera.sensor.gain
        assert float(np.abs(seen - value).max()) * scale < 2 * found.square**0.5 + 1e-9 < 0.05
        assert magnification == pytest.approx(depth, abs=1e-12)  # 1/z is linear in the image of a plane
        assert not found.holds(np.array([-9.0 - BLOCK, 1e6]), np.array([0.0, 0.0])).any()
        # In the light of one LED the same blocks are known.
        other = in_other_light(found, traced.view_of("ring.led03"))
        value, _ = trace_rays(traced.view_of("ring.led03"), None, u, v)
        assert other.at(u, v)[0] == pytest.approx(value, rel=1e-3)
        assert other.sha256 == found.sha256


def test_blocks_are_those_of_doubled_pixels_too() -> None:
    with laid_out(scene_of(camera=LENS), COMPILED) as traced:
        found = smooth_field(traced.view(), 3.0, 0.5)
    assert found is not None
    found = replace(found, smooth=found.smooth & (np.indices(found.smooth.shape).sum(axis=0) % 3 > 0))
    u, v = np.random.default_rng(1).uniform(-0.5, 90.0, (2, 1000))
    half = found.in_doubled_pixels
    halves = (u + 0.5) / 2 - 0.5, (v + 0.5) / 2 - 0.5
    np.testing.assert_array_equal(half.holds(*halves), found.holds(u, v))
    assert 0 < half.holds(*halves).mean() < 1
    for one, other in zip(half.at(*halves), found.at(u, v), strict=True):
        assert one == pytest.approx(other, rel=1e-12)


def test_radiance_proves_nothing() -> None:
    with laid_out(scene_of(), replace(COMPILED, tracer="radiance")) as traced:
        assert smooth_field(traced.view(), 1.0, 0.5) is None


def test_an_empty_belt_takes_few_rays_and_keeps_its_bound(tmp_path: Path) -> None:
    scene = scene_of(camera=LENS)
    made = render(scene, tmp_path / "out", COMPILED, tolerance=0.2)
    pixels = np.random.default_rng(2).choice(96 * 120, 400, replace=False)
    assert [attempt["rays"] for attempt in made.manifest["plan"]["attempts"]] == [0]  # the lattice told all
    assert rms(true_errors(scene, made, pixels)) < made.manifest["error"]["rms_gray_upper95"] < 0.2


WIRE: dict[str, Any] = {
    "type": "cylinder",
    "name": "wire",
    "material": "dark",
    "position": at(0, -8.5, 61),
    "rotation": ["0 deg", "90 deg", "0 deg"],
    "diameter": "0.15 mm",
    "length": "40 mm",
}


def test_a_shadow_line_one_pixel_wide_is_resolved_or_certified(tmp_path: Path) -> None:
    """One LED, a wire out of sight: a dark line about a pixel wide crosses an even belt."""
    led = {
        "type": "led",
        "name": "led",
        "position": at(0, -30, 300),
        "look_at": at(0, 0, 0),
        "diameter": "3 mm",
        "radiant_intensity": "20 W/sr",
        "beam": {"profile": "lambertian"},
    }
    scene = scene_of(WIRE, camera=LENS, sources=[led])
    made = render(scene, tmp_path / "out", COMPILED, tolerance=0.5)
    gray = made.gray.values
    line = gray[:, 40:80].mean(axis=1)
    assert line.min() < 0.8 * np.median(line)  # it is there, in each column
    assert (gray[int(line.argmin()), :] < 0.9 * np.median(line)).all()
    pixels = np.flatnonzero(np.ones(96 * 120))[::7]
    assert rms(true_errors(scene, made, pixels)) < made.manifest["error"]["rms_gray_upper95"]


@pytest.mark.parametrize("sources", [None, 3])
@pytest.mark.parametrize("coarser", [1, 2])
def test_sums_gather_what_transforms_do(sources: int | None, coarser: int) -> None:
    """A deep scene before a lens: eleven layers, footprints on both sides of the focus."""
    scene = scene_of(camera=LENS)
    view = View(scene.camera, tracer=None)  # type: ignore[arg-type]
    plan = plan_kernel(view, scene.camera.magnification(np.array([0.37, 0.43])), 0.5)
    by_sums = replace(plan, grid=replace(plan.grid, smooth="known"))
    cell, place = plan.grid.cell * coarser, plan.tiles[-1]
    assert len(plan.layers) > 3 and cell < 1
    random = np.random.default_rng(1)
    reach = 4 + int(max(plan.reach_px) / cell)
    first = (int(place[0] / cell) - reach, int(place[2] / cell) - reach)
    shape = tuple(int((place[axis + 1] - place[axis]) / cell) + 2 * reach + axis for axis in (0, 2))
    depth = random.uniform(plan.layers[0], plan.layers[-1], shape)
    values = random.random(shape if sources is None else (sources, *shape))
    central = CentralImage((first[0], first[1]), values, depth, 0)
    expected, found = (gather(one, central, cell, place) for one in (plan, by_sums))
    assert found == pytest.approx(expected, abs=1e-13)
    assert found.min() > 0


@pytest.mark.long
def test_hard_edges_that_are_left_whole_stand_in_the_certificate() -> None:
    """Cells of a pixel are not cut where few are off: what all replicates have in common would be seen by none."""
    roof = {
        "type": "sheet",
        "name": "roof",
        "material": "dark",
        "size": ["6 mm", "4 mm"],
        "position": at(-7, -3, 3),
        "rotation": ["20 deg", "10 deg", "17 deg"],
    }
    scene = scene_of(roof, camera=LENS)
    within = []
    pixels = np.arange(96 * 120)[::3]
    for seed in range(4):
        made = render(scene, None, COMPILED, tolerance=1.0, seed=seed)
        assert made.manifest["plan"]["method"] == "kernel"
        within.append(rms(true_errors(scene, made, pixels, 64)) / made.manifest["error"]["rms_gray_upper95"])
    assert max(within) < 1.0
    assert min(within) > 0.3  # and it is not a bound for safety's sake


@pytest.mark.long
def test_a_circle_lies_where_it_lies_whatever_the_seed() -> None:
    """By a linear camera at its default tolerance: rays move the gauge by less than a third of a frame's noise.

    So much is two standard deviations of what was drawn.
    """
    pixels, gain, dark = 192, 0.025, 5.0
    sensor = {
        "model": "linear",
        "rows": pixels,
        "columns": pixels,
        "pixel_width": "10 um",
        "pixel_height": "10 um",
        "bit_depth": 8,
        "wavelength": "630 nm",
        "quantum_efficiency": 0.6,
        "system_gain": f"{gain} DN/e",
        "offset": dark,
        "full_well": "10000 e",
        "read_noise": "6 e",
    }
    peg = {"type": "cylinder", "name": "peg", "material": "dark", "diameter": "24 mm", "length": "1 mm"}
    camera = {**LENS, "exposure_time": "1.6 ms", "sensor": sensor}
    scene = scene_of({**peg, "position": at(0, 0, 0.5), "rotation": ["0 deg", "0 deg", "0 deg"]}, camera=camera)
    caliper = Caliper(((pixels - 1) / 2, (pixels - 1) / 2), 63.5, 5.0)
    found = []
    for seed in range(6):
        made = radwrap.render(scene, tracer="compiled", seed=seed)
        seen = radwrap.measure_circle(GrayImage(made.electrons * gain + dark), caliper)  # neither noise nor rounding
        found.append((seen.diameter, *seen.centre))
    frames = [radwrap.measure_circle(frame, caliper) for frame in made.frames(4, seed=1)]
    sigmas = np.mean([(one.diameter_sigma, *one.centre_sigma) for one in frames], axis=0)
    assert (np.std(found, axis=0, ddof=1) < sigmas / 6).all()
