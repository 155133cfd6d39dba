"""Half shadows of wide lights are looked up between few rays, and the certificate holds what that is off."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("numba")

from radwrap.imaging.methods.smooth_blocks import smooth_field
from radwrap.imaging.optics.smooth import BLOCK
from radwrap.imaging.optics.view import central_rays, central_weights, trace_rays
from radwrap.imaging.synthesis import render
from radwrap.imaging.tolerance.points_noise import points_noise
from radwrap.imaging.tolerance.sampled_blocks import with_sampled_blocks
from radwrap.imaging.tracing import laid_out
from radwrap.scene.scene import Scene
from tests.imaging.test_smooth_blocks import COMPILED, LENS, rms, true_errors
from tests.tracers.belt import FLAT, at, scene_of

LAMP: dict[str, Any] = {
    "type": "rectangle",
    "name": "lamp",
    "position": at(60, 0, 80),
    "look_at": at(0, 0, 0),
    "size": ["60 mm", "40 mm"],
    "radiance": "1 kW/m^2/sr",
    "irradiance_error": 0.05,
}
# Out of sight, it shades the middle of the belt: half of the lamp there, and more or less of it beside.
ROOF: dict[str, Any] = {
    "type": "sheet",
    "name": "roof",
    "material": "dark",
    "size": ["30 mm", "60 mm"],
    "position": at(45, 0, 40),
}
FINE: dict[str, Any] = {"camera": {**LENS, "sensor": {**FLAT["camera"]["sensor"], "gain": "3e4 (J/m^2)^-1"}}}


def shaded(*more: dict[str, Any]) -> Scene:
    return scene_of(ROOF, *more, sources=[LAMP], **FINE)


@pytest.mark.long
def test_half_shadows_take_few_rays_and_keep_their_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = shaded()
    for name in ("_FEW_RAYS", "_TELLING_SHARE"):  # no more pairs of rays, of which only the last look is told
        monkeypatch.setattr(f"radwrap.imaging.tolerance.planner.{name}", 0)
    made, all_traced = (render(scene, None, COMPILED, tolerance=0.3, max_error=most) for most in (None, 50.0))
    gray = made.gray.values
    assert gray.max() > 1.3 * gray.min() > 20  # all of it lies in the half shadow
    # Beside those that look at the kernel's model, which both take alike.
    rays, of_all = (one.manifest["rays"] - one.manifest["error"]["certificate_rays"] for one in (made, all_traced))
    assert rays < 0.5 * of_all
    pixels = np.random.default_rng(2).choice(gray.size, 200, replace=False)
    assert rms(true_errors(scene, made, pixels)) < made.manifest["error"]["rms_gray_upper95"] < 0.3


def test_what_a_sample_finds_is_how_far_values_are_off() -> None:
    """By rays of its own, as many as the sample has by far."""
    with laid_out(shaded(), COMPILED) as traced:
        view = traced.view()
        field = smooth_field(view, 3.0, 0.3)
        assert field is not None and np.count_nonzero(field.likely) > 100
        found = with_sampled_blocks(view, field, 0.3, 0)
        assert np.count_nonzero(found.smooth) > 0.8 * np.count_nonzero(field.likely)
        scale = view.exposure_of_radiance * view.camera.sensor.gain
        random = np.random.default_rng(1)
        row, column = (axis[random.integers(len(axis), size=20000)] for axis in np.nonzero(found.smooth))
        first_row, first_column = found.first
        v = BLOCK * (first_row + row + random.random(len(row))) - 0.5
        u = BLOCK * (first_column + column + random.random(len(column))) - 0.5
        inside = found.holds(u, v)
        halves = [
            (trace_rays(view, None, u[inside] + shift, v[inside])[0] - found.at(u[inside], v[inside])[0]) * scale
            for shift in (-1e-3, 1e-3)
        ]
        assert float((halves[0] * halves[1]).mean()) < found.upper < (0.5 * 0.3) ** 2


BRICK: dict[str, Any] = {
    "type": "box",
    "name": "brick",
    "material": "dark",
    "size": ["1 mm", "1 mm", "0.5 mm"],
    "position": at(-6, -5, 0.25),
}


def test_smaller_blocks_lie_nearer_to_what_shades_them_and_are_as_exact() -> None:
    with laid_out(shaded(BRICK), COMPILED) as traced:
        view = traced.view()
        field = smooth_field(view, 3.0, 0.5)
        assert field is not None
        large = with_sampled_blocks(view, field, 0.5, 0)
        assert large.finer is not None and large.finer.finer is not None
        middle, smallest = large.finer, large.finer.finer
        assert (large.block, middle.block, smallest.block) == (BLOCK, BLOCK // 2, BLOCK // 4)
        assert not (np.repeat(np.repeat(large.smooth, 2, axis=0), 2, axis=1) & middle.smooth).any()
        assert middle.smooth.any() and smallest.smooth.any()
        scale, random = view.exposure_of_radiance * view.camera.sensor.gain, np.random.default_rng(3)
        row, column = np.nonzero(smallest.smooth)
        v, u = (
            smallest.block * (first + place + random.random(len(place))) - 0.5
            for first, place in zip(smallest.first, (row, column), strict=True)
        )
        assert large.holds(u, v).all()
        exact = view.with_noise(-5)  # so many points that their noise does not count
        off = (trace_rays(exact, None, u, v)[0] - large.at(u, v)[0]) * scale
        assert float((off**2).mean()) * float(smallest.smooth.mean()) < large.upper


def test_noise_of_points_is_that_of_rays_that_ask_others() -> None:
    with laid_out(shaded(), COMPILED) as traced:
        view = traced.view()
        sensor, random = view.camera.sensor, np.random.default_rng(4)
        u, v = (random.uniform(-0.5, size - 0.5, 2000) for size in (sensor.columns, sensor.rows))
        rays = central_rays(view.camera, u, v)
        lengths = (1.0 + 2.0**-8 * np.arange(8))[:, np.newaxis] * np.repeat([0.0, 1.0], 3) + np.repeat([1.0, 0.0], 3)
        seen = np.stack(list(view.tracer.trace(rays * length for length in lengths)))
        gray = seen * central_weights(view.camera, u, v) * view.exposure_of_radiance * sensor.gain
        found, taken = points_noise(view, 0)
        assert taken > 0
        assert found == pytest.approx(float(gray.var(axis=0, ddof=1).mean()), rel=0.3)


def test_small_lights_have_no_points() -> None:
    with laid_out(scene_of(**FINE), COMPILED) as traced:
        assert points_noise(traced.view(), 0) == (0.0, 0)


WIRE: dict[str, Any] = {
    "type": "cylinder",
    "name": "wire",
    "material": "dark",
    "rotation": ["0 deg", "90 deg", "0 deg"],
    "diameter": "0.3 mm",
    "length": "16 mm",
}


@pytest.mark.parametrize("height", [0.5, pytest.param(4.0, marks=pytest.mark.long)])
def test_a_thin_shadow_on_one_face_is_resolved_or_certified(height: float) -> None:
    """A wire along the lamp's light, a pixel and a half wide and near the belt."""
    scene = shaded({**WIRE, "position": at(-2, 1.3, height)})
    made = render(scene, None, COMPILED, tolerance=0.6, seed=3)
    pixels = np.arange(made.gray.values.size)[::29]
    assert rms(true_errors(scene, made, pixels)) < made.manifest["error"]["rms_gray_upper95"]


@pytest.mark.long
@pytest.mark.parametrize("more", [{"basis": True}, {"max_error": 50.0}])
def test_what_is_relit_or_bounded_by_pixels_has_no_sampled_blocks(tmp_path: Path, more: dict[str, Any]) -> None:
    """Their error is known in one light, and as a mean square only: rays as many as pixels are traced."""
    made = render(shaded(), tmp_path / "out", COMPILED, tolerance=1.2, **more)
    assert made.manifest["plan"]["attempts"][0]["rays"] > made.gray.values.size
