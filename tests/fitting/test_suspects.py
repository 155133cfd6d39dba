"""What captures that are not explained look like: planted by a formula, and as a user has it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

import radwrap
from radwrap.fitting.covariance import PredictionErrors, spread
from radwrap.fitting.solution import solve
from radwrap.fitting.suspects import Suspect, changes_of, suspects
from radwrap.images import GrayImage
from radwrap.imaging.relight.relit import Basis
from radwrap.random_streams import generator
from radwrap.scene.scene import Scene
from tests.fitting.conftest import EXPOSURE, begun, changed, taken

Array = np.ndarray[Any, np.dtype[np.float64]]
NOISE: Final = 0.5  # gray levels
ROWS, COLUMNS = 20, 24
CORNER: Final = float(np.hypot(ROWS, COLUMNS)) / 2


def _around() -> Array:
    """Places of the pixels from the middle, rows and columns [px]."""
    return np.asarray(np.mgrid[0:ROWS, 0:COLUMNS] - np.array([9.5, 11.5])[:, np.newaxis, np.newaxis])


def _share() -> Array:
    """Squared distance from the middle, 1 at a corner."""
    return np.asarray((_around() ** 2).sum(axis=0) / CORNER**2)


def _moved(image: Array, way: Array) -> Array:
    """An image whose points went some way [px]."""
    places = np.mgrid[0:ROWS, 0:COLUMNS] - way
    return np.asarray(map_coordinates(image, places, order=3, mode="nearest"))


def _named(bench: Scene, basis: Basis, free: list[str], wrong: Callable[[Array], Array]) -> tuple[Suspect, ...]:
    """Of a capture of the scene that something was done to."""
    keys, prediction = begun(bench, basis, free)
    start = np.array([key.value for key in keys.keys])
    seen = wrong(prediction.at(start).unclipped) + NOISE * generator(3, 1).standard_normal((ROWS, COLUMNS))
    solved = solve(keys.keys, prediction, [taken(seen, bench)], NOISE, robust=False)
    errors = PredictionErrors(np.zeros((2, len(solved.jacobian))))
    found = spread(solved.jacobian, errors)
    return suspects(solved.predicted.parts, solved.residual, solved.weighed.sigma, found.basis, errors)


def test_nothing_is_named_where_nothing_is_wrong(bench: Scene, basis: Basis) -> None:
    assert not _named(bench, basis, [EXPOSURE], lambda image: image)


@pytest.mark.parametrize("percent", [7.0, -4.0])
def test_vignetting_is_named(bench: Scene, basis: Basis, percent: float) -> None:
    """Though the free exposure takes its mean away."""
    dark = bench.camera.sensor.dark_gray
    (found,) = _named(bench, basis, [EXPOSURE], lambda image: dark + (image - dark) * (1 - percent / 100 * _share()))
    assert found.name == "falloff" and found.amount == pytest.approx(percent, abs=0.6)
    assert ("more than the scene says" if percent > 0 else "less than the scene says") in found.told()


@pytest.mark.parametrize("corner", [0.5, -0.8])
def test_distortion_is_named(bench: Scene, basis: Basis, corner: float) -> None:
    dark = bench.camera.sensor.dark_gray

    def bent(image: Array) -> Array:
        spread = 1 - 4 * corner / CORNER * _share()
        return dark + (_moved(image, corner * _around() * _share() / CORNER) - dark) * spread

    found = _named(bench, basis, [EXPOSURE], bent)
    named = {one.name: one for one in found}
    assert "distortion" in named, found
    assert named["distortion"].amount == pytest.approx(corner, rel=0.25)
    assert ("outwards" if corner > 0 else "inwards") in named["distortion"].told()


@pytest.mark.parametrize("lens", [{"falloff": "none"}, {"relative_illumination": [["0 mm", 1.0], ["2 mm", 0.7]]}])
def test_distortion_dims_nothing_where_the_falloff_is_given(bench: Scene, basis: Basis, lens: dict[str, Any]) -> None:
    """What a distortion does to the light is in it: an even image stays as it is, and corners go as far as before."""
    _, prediction = begun(bench, basis, [EXPOSURE])
    (part,) = prediction.at([100.0]).parts
    even = replace(part, unclipped=np.full((ROWS, COLUMNS), 90.0))
    given = changed(bench, {"camera.lens": {"focus_distance": "500 mm", **lens}})
    assert changes_of(even)["distortion"].min() < -10
    assert not changes_of(replace(even, scene=given))["distortion"].any()
    amount = 0.3
    ramp = 90 + 2 * _around()[1]
    expected = _moved(ramp, amount * _around() * _share() / CORNER) - ramp
    change = amount * changes_of(replace(even, scene=given, unclipped=ramp))["distortion"]
    assert change[2:-2, 2:-2] == pytest.approx(expected[2:-2, 2:-2], abs=0.02)


@pytest.mark.parametrize(
    ("name", "wrong", "amount"),
    [
        ("shift along u", lambda image: _moved(image, np.array([0, 0.3])[:, None, None] * np.ones((2, 1, 1))), 0.3),
        ("light along v", lambda image: image * (1 + 0.05 * _around()[0] / (ROWS / 2)), 5.0),
        ("offset", lambda image: image + 1.5, 1.5),
    ],
)
def test_other_suspects_are_named(
    bench: Scene, basis: Basis, name: str, wrong: Callable[[Array], Array], amount: float
) -> None:
    found = _named(bench, basis, [EXPOSURE], wrong)
    assert found and found[0].name == name, found
    assert found[0].amount == pytest.approx(amount, rel=0.2)


def test_what_a_free_key_does_is_no_suspect(bench: Scene, basis: Basis) -> None:
    found = _named(bench, basis, [EXPOSURE, "camera.sensor.offset"], lambda image: image * 1.1 + 2.0)
    assert not found


def test_a_single_row_has_suspects_too(bench: Scene, basis: Basis) -> None:
    keys, prediction = begun(bench, basis, [EXPOSURE])
    (part,) = prediction.at([keys.keys[0].value]).parts
    row = changes_of(replace(part, unclipped=part.unclipped[:1]))
    assert all(np.isfinite(image).all() and image.shape == (1, COLUMNS) for image in row.values())
    assert not row["shift along v"].any() and row["shift along u"].any()


def test_a_key_at_its_bound_hides_no_suspect(bench: Scene, basis: Basis) -> None:
    """The time that was allowed is a tenth too short: all is brighter than it can be."""
    keys, prediction = begun(bench, basis, [EXPOSURE])
    (time,) = keys.keys
    dark = bench.camera.sensor.dark_gray
    seen = dark + 1.1 * (prediction.at([time.value]).unclipped - dark)
    capture = GrayImage(np.rint(seen + NOISE * generator(3, 1).standard_normal(seen.shape)), 8)
    free = [f"{EXPOSURE}={0.5 * time.value} {time.unit}:{time.value} {time.unit}", "camera.sensor.offset"]
    options = radwrap.RenderOptions(tolerance=1.0, workers=1)
    found = radwrap.fit(bench, [capture], free, noise=NOISE, options=options)
    assert found.keys[0].at_bound and not found.explained
    assert any(one["name"] == "brightness" for one in found.manifest["looks_like"]), found.manifest["looks_like"]


@pytest.mark.long
@pytest.mark.parametrize(("kind", "words"), [("vignetting", "falls off"), ("distortion", "distortion")])
def test_a_lens_that_the_scene_does_not_state_is_told(bench: Scene, kind: str, words: str) -> None:
    """A lens that dims corners by 8 %, and one that moves them by .8 px."""
    options = radwrap.RenderOptions(method="rays", tolerance=0.15, seed=5, workers=1)
    if kind == "distortion":
        # kappa1 r^2 at a corner of .78 mm: .8 of 15.6 px.
        shown = changed(bench, {"camera.distortion": {"model": "tsai", "kappa1": "84000 1/m^2"}})
        capture = radwrap.render(shown, options=options).frames(1)[0]
    else:
        made = radwrap.render(bench, options=options)
        dark = bench.camera.sensor.dark_gray
        dimmed = dark + (made.frames(1)[0].values - dark) * (1 - 0.08 * _share())
        capture = GrayImage(np.rint(dimmed), 8)
    fine = radwrap.RenderOptions(tolerance=0.4, workers=1)
    found = radwrap.fit(bench, [capture], [EXPOSURE], options=fine)
    assert not found.explained
    told = "\n".join(found.lines())
    assert "errors: no" in told and "rows" in told and words in told, told
    assert found.manifest["looks_like"]
