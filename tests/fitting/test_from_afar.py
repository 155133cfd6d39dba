"""Fits that begin pixels away, and slopes by renders whose rays have a grain: images are those of a formula."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from scipy.special import erf

import radwrap
from radwrap.errors import InputError
from radwrap.fitting import fit as fitting
from radwrap.fitting.approach import approached
from radwrap.fitting.captured import captured
from radwrap.fitting.free_keys import free_scene
from radwrap.fitting.light import Light
from radwrap.fitting.places import Places
from radwrap.fitting.prediction import Prediction
from radwrap.images import GrayImage
from radwrap.imaging.relight.relit import Basis
from radwrap.random_streams import generator
from radwrap.scene.scene import Scene
from tests.fitting.conftest import OPTIONS, changed, taken

Array = np.ndarray[Any, np.dtype[np.float64]]
FAR: Final = 30.0  # times a value: nothing is to be found there
PIXEL: Final = 2.0  # mm on the target: 50 um, 12.5 mm and 500 mm, to a hundredth
BLUR: Final = 1.0  # px: sigma of an edge, or of a spot
LEVEL: Final = 0.1  # W/m^2/sr, some 100 gray levels
TRIED: Final = 0.02  # of a key's scale: the step that is tried first
DIM: Final = 0.04  # of the level, by a turn of a radian
ROUNDED: Final = 0.05  # half a gray level of the 24 that are missing, and steps that end where a third of one is left
GRAIN: Final = 0.02  # of the level: what neighbouring renders differ by


def _shift(scene: Scene) -> tuple[float, float]:
    """Of the target's origin [px]."""
    x, y, _ = scene.targets[0].pose.position
    return x * 1e3 / PIXEL, y * 1e3 / PIXEL


def _spot(x: float, y: float) -> Array:
    rows, columns = np.mgrid[0:20, 0:24]
    return np.asarray(np.exp(-((columns - 11.5 - x) ** 2 + (rows - 9.5 - y) ** 2) / (2 * BLUR**2)))


def _edge(x: float, _: float) -> Array:
    columns = np.tile(np.arange(24.0), (20, 1))
    return np.asarray(0.5 + 0.5 * erf((columns - 11.5 - x) / BLUR / np.sqrt(2)))


def _grain(x: float, y: float) -> Array:
    """Another one for each place, the same whenever it is come back to."""
    seed = int.from_bytes(hashlib.sha256(repr((x, y)).encode()).digest()[:4], "big")
    return np.asarray(GRAIN * generator(seed, 1).standard_normal((20, 24)))


def _prediction(bench: Scene, basis: Basis, image: Callable[[float, float], Array], *, grain: bool) -> Prediction:
    """Whose target only shifts."""
    free = free_scene(bench, ["pose:edge"])

    def trace(scene: Scene) -> Basis:
        shown = LEVEL * (image(*_shift(scene)) + (_grain(*_shift(scene)) if grain else 0.0))
        share = np.broadcast_to(shown / len(basis.sources), basis.images.shape)
        return replace(basis, images=share.astype(np.float32))

    return Prediction([(free, Places(free, [True] * 6, trace))])


def test_the_slope_of_an_edge_stands_out_of_the_grain(bench: Scene, basis: Basis) -> None:
    """A pose has no scale of its own: a step of half a unit, .25 px, would show half as much grain as slope."""
    prediction = _prediction(bench, basis, _edge, grain=True)
    here = np.zeros(6)
    range_of = float(np.ptp(_prediction(bench, basis, _edge, grain=False).at(here).unclipped))
    found = prediction.slopes(here)[0]
    exact = -range_of * np.exp(-((np.arange(24.0) - 11.5) ** 2) / (2 * BLUR**2)) / np.sqrt(2 * np.pi) / BLUR / PIXEL
    share = float((found * exact).sum() / (exact**2).sum() / 20)
    # A wide step sees an edge that is 1 % less steep; 20 rows of grain add 3 %.
    assert share == pytest.approx(1.0, abs=0.08)
    noise = float(np.linalg.norm(found - exact) / np.linalg.norm(np.tile(exact, (20, 1))))
    assert noise < 0.35


def test_slopes_are_seen_anew_where_a_key_has_gone_far(bench: Scene, basis: Basis) -> None:
    prediction = _prediction(bench, basis, _edge, grain=False)
    first = prediction.slopes(np.zeros(6))
    places = prediction.renders
    near = np.array([0.05, 0, 0, 0, 0, 0.0])
    assert np.array_equal(prediction.slopes(near), first) and prediction.renders == places
    far = np.array([6.0, 0, 0, 0, 0, 0.0])
    moved = prediction.slopes(far)[0]
    assert prediction.renders > places
    # 6 mm are 3 px: the edge's slope has gone along.
    assert np.abs(moved).sum(axis=0).argmax() - np.abs(first[0]).sum(axis=0).argmax() in (2, 3, 4)


@pytest.mark.parametrize(
    "away",
    [pytest.param((3.0, 0.0), marks=pytest.mark.long), pytest.param((-5.0, 4.0), marks=pytest.mark.long), (7.0, -5.0)],
)
def test_a_spot_that_is_many_blurs_away_is_found(bench: Scene, basis: Basis, away: tuple[float, float]) -> None:
    """Its own images have nothing in common: the sum of squares is flat there."""
    prediction = _prediction(bench, basis, _spot, grain=False)
    truth = np.array([away[0] * PIXEL, away[1] * PIXEL, 0, 0, 0, 0.0])
    capture = taken(np.rint(prediction.at(truth).unclipped), bench)
    free = free_scene(bench, ["pose:edge"])
    found = approached(free.keys, prediction, [capture], 1.0)
    assert np.abs(found[:2] - truth[:2]).max() < PIXEL * BLUR


def test_a_beginning_that_is_right_is_left(bench: Scene, basis: Basis) -> None:
    prediction = _prediction(bench, basis, _spot, grain=False)
    capture = taken(np.rint(prediction.at(np.zeros(6)).unclipped), bench)
    free = free_scene(bench, ["pose:edge"])
    assert not approached(free.keys, prediction, [capture], 1.0).any()
    assert prediction.renders == 1


def test_what_both_images_cut_is_no_difference(bench: Scene, basis: Basis) -> None:
    """A spot that saturates where it is predicted and where it is captured."""
    prediction = _prediction(bench, basis, lambda x, y: 4 * _spot(x, y), grain=False)
    shown = prediction.at(np.zeros(6)).unclipped
    top = bench.camera.sensor.saturation_gray
    assert shown.max() > 1.5 * top
    free = free_scene(bench, ["pose:edge"])
    assert not approached(free.keys, prediction, [taken(np.minimum(np.rint(shown), top), bench)], 1.0).any()
    assert prediction.renders == 1


def test_what_is_masked_draws_nothing(bench: Scene, basis: Basis) -> None:
    """A lamp in a corner of the capture, which the scene does not have."""
    prediction = _prediction(bench, basis, _spot, grain=False)
    seen = np.rint(prediction.at(np.zeros(6)).unclipped)
    seen[:6, :8] = 250.0
    mask = np.ones(seen.shape, dtype=np.bool_)
    mask[:6, :8] = False
    sensor = bench.camera.sensor
    capture = captured([GrayImage(seen, sensor.bit_depth)], ["capture"], sensor, mask)
    free = free_scene(bench, ["pose:edge"])
    assert not approached(free.keys, prediction, [capture], 1.0).any()
    assert prediction.renders == 1


def test_a_wide_blur_is_looked_at_with_wide_steps(bench: Scene, basis: Basis) -> None:
    prediction = _prediction(bench, basis, _edge, grain=False)
    steps = []
    for blur in (0.0, 4.0):
        prediction.slopes(np.zeros(6), blur)
        steps.append(prediction.steps[0])
    # An edge that is blurred by 1 and by hypot(1, 4) px.
    assert 2 < steps[1] / steps[0] < 8


def test_a_step_that_the_scene_does_not_take_is_made_smaller(bench: Scene, basis: Basis) -> None:
    free = free_scene(bench, ["pose:edge"])

    def trace(scene: Scene) -> Basis:
        x, y = _shift(scene)
        if abs(x) > 0.1:
            raise InputError("stands in the wall", where="targets[0]")
        share = np.broadcast_to(LEVEL * _edge(x, y) / len(basis.sources), basis.images.shape)
        return replace(basis, images=share.astype(np.float32))

    prediction = Prediction([(free, Places(free, [True] * 6, trace))])
    assert np.abs(prediction.slopes(np.zeros(6))[0]).max() > 0
    assert 0 < prediction.steps[0] <= 0.1 * PIXEL


def test_few_rays_lead_the_way(bench: Scene, tmp_path: Path) -> None:
    light = Light(bench, OPTIONS, tmp_path, is_even=True)
    light.at(bench)  # all that is known of an image is told of the first one
    taken = [light.rays]
    for times, replicates in ((1.0, 4), (2.0, 4), (4.0, 2)):
        light.roughly(bench, times, replicates)
        taken.append(light.rays)
    fine, rough, roughest = np.diff(taken)
    assert roughest < rough < fine < taken[0]
    shown = []
    for trace in (partial(light.at, replicates=2), partial(light.unbiased, share=4), light.unbiased):
        shown.append(trace(bench).images.shape[1])
        taken.append(light.rays)
    assert shown == [2, 4, 12]
    half, first, last = np.diff(taken)[3:]
    assert half < fine and first < last / 2


def test_a_fit_begins_where_the_way_leads(bench: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """And moves its keys for slopes as far as was found there."""
    key = "targets[0].edge_position"
    steps: list[tuple[float, ...]] = []

    class Begun(Exception):
        pass

    def led(keys: Any, prediction: Prediction, *_: Any) -> Array:
        prediction.slopes(np.array([keys[0].value]))
        steps.append(prediction.steps)
        return np.array([3.5])

    def solve(_: Any, prediction: Prediction, *rest: Any, begin: Array, **more: Any) -> Any:
        steps.append(prediction.steps)
        assert begin.tolist() == [3.5]
        raise Begun

    monkeypatch.setattr(fitting, "approached", led)
    monkeypatch.setattr(fitting, "solve", solve)
    capture = GrayImage(np.full((20, 24), 90.0), 8)
    with pytest.raises(Begun):
        radwrap.fit(bench, [capture], [key], options=OPTIONS)
    assert steps[0] == steps[1] and steps[0][0] != TRIED


@pytest.mark.long
def test_where_the_way_leads_astray_the_users_beginning_stands(bench: Scene, basis: Basis) -> None:
    """A glow beside the spot, which the scene does not have, draws what is blurred."""
    prediction = _prediction(bench, basis, _spot, grain=False)
    rows, columns = np.mgrid[0:20, 0:24]
    glow = 60 * np.exp(-((columns - 22) ** 2 + (rows - 9.5) ** 2) / (2 * 6.0**2))
    seen = np.rint(prediction.at(np.zeros(6)).unclipped + glow)
    free = free_scene(bench, ["pose:edge"])
    assert not approached(free.keys, prediction, [taken(seen, bench)], 1.0).any()
    assert prediction.renders > 1


@pytest.mark.long
def test_an_edge_seven_pixels_off_is_found_by_renders(bench: Scene) -> None:
    truth = {"targets[0].edge_position": "15 mm"}
    capture = radwrap.render(changed(bench, truth), method="rays", tolerance=0.2, seed=5, workers=1).frames(1)
    found = radwrap.fit(bench, capture, list(truth), options=OPTIONS)
    (key,) = found.keys
    assert found.converged and found.explained and key.sigma is not None
    assert abs(key.value - 15.0) < 4 * key.sigma < 0.2


def test_a_key_that_hardly_shows_stays_near_the_scene(bench: Scene, basis: Basis) -> None:
    """A key makes the image a little brighter, the farther it goes the less; the capture is brighter than any."""
    free = free_scene(bench, ["camera.focal_length"])

    def trace(scene: Scene) -> Basis:
        less = bench.camera.focal_length / scene.camera.focal_length
        shown = LEVEL * (_spot(0, 0) + 0.3 - 0.1 * less) / less**2  # of an opening that goes along
        return replace(basis, images=np.broadcast_to(shown / 3, basis.images.shape).astype(np.float32))

    prediction = Prediction([(free, Places(free, [True], trace))])
    begin = free.keys[0].value
    seen = taken(np.rint(prediction.at([begin]).unclipped) + 20.0, bench)
    (found,) = approached(free.keys, prediction, [seen], 4.0)
    assert begin < found < FAR * begin


@pytest.mark.long
def test_a_turn_that_hardly_shows_is_held_by_a_radian(bench: Scene, basis: Basis) -> None:
    """It adds a deviation of the whole image a radian, and six are missing: unheld it would be gone round once.

    Held by four, it goes by 6/17 of a radian at the first blur, and by little less at each of the two others.
    """
    free = free_scene(bench, ["pose:edge"])
    there = np.array(bench.targets[0].pose.rotation)

    def trace(scene: Scene) -> Basis:
        turned = there.T @ np.array(scene.targets[0].pose.rotation)
        shown = LEVEL * (_edge(0, 0) + DIM * np.arctan2(turned[1, 0], turned[0, 0])) / len(basis.sources)
        return replace(basis, images=np.broadcast_to(shown, basis.images.shape).astype(np.float32))

    prediction = Prediction([(free, Places(free, [True] * 6, trace))])
    shown = prediction.at(np.zeros(6)).unclipped
    tolerance = DIM * float(np.ptp(shown))  # of one radian
    seen = taken(np.rint(shown + 6 * tolerance), bench)
    *_, turn = approached(free.keys, prediction, [seen], tolerance)
    assert np.radians(turn) == pytest.approx(6 * (1 - (16 / 17) ** 3), rel=ROUNDED)
