"""Where a fit settles: slopes that have a grain, light of the same rays, and a search whose place is off."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final
from unittest.mock import create_autospec

import numpy as np
import pytest

from radwrap.fitting.covariance import GRAIN, PULLED, PredictionErrors, inverse_of, spread
from radwrap.fitting.fit import Ended, _gone, ended
from radwrap.fitting.free_keys import FreeScene, free_scene
from radwrap.fitting.places import Places
from radwrap.fitting.prediction import Predicted, Prediction, Steepness, _grain_of
from radwrap.fitting.settled import Grained, Settled
from radwrap.fitting.solution import Solution, settle
from radwrap.fitting.weights import Weighed
from radwrap.imaging.relight.relit import Basis
from radwrap.imaging.relight.source_images import AimedRays, SourceImages
from radwrap.imaging.response.exposure import exposure_of_radiance
from radwrap.random_streams import generator
from radwrap.scene.scene import Scene
from tests.fitting.conftest import EXPOSURE, LEVELS, begun, changed, taken

Array = np.ndarray[Any, np.dtype[np.float64]]
PIXELS: Final = 4000
DRAWS: Final = 40
EXACT: Final = 1e-9
FEW: Final = 8  # rounds
BLUR: Final = 1.5  # px
PIXEL: Final = 2.0  # mm on the target
WEAK_PULL: Final = 3.0  # expected deviations that noise may pull by
AIMED: Final = AimedRays(0.75, 12)
LEVEL: Final = 0.1  # W/m^2/sr, some 100 gray levels


def test_a_slope_with_grain_is_as_steep_as_it_is() -> None:
    """J + D of one key, all alike: J+ = (J + D)^T / (J^T J), and not divided by (J + D)^T (J + D)."""
    slope = np.full((PIXELS, 1), 0.5)
    grained = slope + 0.25 * np.where(np.arange(PIXELS) % 2, 1.0, -1.0)[:, np.newaxis]
    found = inverse_of(grained, 1e-2, np.array([[PIXELS * 0.25**2]]))
    assert found.matrix == pytest.approx(grained.T / (PIXELS * 0.5**2), rel=EXACT)
    assert found.square == pytest.approx(1 / (PIXELS * 0.5**2), rel=EXACT)
    assert (found.matrix @ slope)[0, 0] == pytest.approx(1.0, rel=EXACT)
    assert (inverse_of(grained).matrix @ slope)[0, 0] == pytest.approx(0.8, rel=EXACT)


def test_values_scatter_as_is_told_where_slopes_have_a_grain() -> None:
    """Two keys that look nearly alike: the grain decides how well they are told apart."""
    random = generator(8, 1)
    one = random.standard_normal(PIXELS)
    slopes = np.stack([one, one + 0.06 * random.standard_normal(PIXELS)], axis=1)
    grain, values, told = 0.02, [], []
    for _ in range(DRAWS):
        seen = slopes + grain * random.standard_normal(slopes.shape)
        inverse = inverse_of(seen, 1e-3, np.eye(2) * PIXELS * grain**2).matrix
        values.append(inverse @ (slopes @ [3.0, -3.0] + random.standard_normal(PIXELS)))
        told.append(np.sqrt(np.diag(inverse @ inverse.T)))
    bias = np.mean(values, axis=0) - [3.0, -3.0]
    deviation = np.mean(told, axis=0)
    assert (np.abs(bias) < 4 * deviation / np.sqrt(DRAWS)).all(), bias / deviation
    # 40 draws know a deviation to 11 %; what the grain itself adds to the scatter is first order in it.
    assert (np.std(values, axis=0) < 1.5 * deviation).all()


def test_a_direction_of_grain_is_not_determined() -> None:
    random = generator(8, 2)
    one = random.standard_normal(PIXELS)
    seen = np.stack([one, one], axis=1) + 0.05 * random.standard_normal((PIXELS, 2))
    quiet = PredictionErrors(np.zeros((2, PIXELS)))
    assert np.isfinite(spread(seen, quiet, 1e-3).half_width).all()
    found = spread(seen, quiet, 1e-3, grain=np.eye(2) * PIXELS * 0.05**2)
    assert np.isnan(found.half_width).all() and found.rank == 1
    (null,) = found.null
    assert null[0] / null[1] == pytest.approx(-1.0, abs=0.05)


def test_keys_of_which_nothing_shows_are_not_determined() -> None:
    found = spread(np.zeros((50, 2)), PredictionErrors(np.zeros((2, 50))))
    assert np.isnan(found.half_width).all() and found.rank == 0


def test_a_key_that_leans_on_what_is_not_determined_is_not_either() -> None:
    """Two keys differ by .03 of what a third one does, in more grain than that: the third goes along."""
    random = generator(8, 3)
    one, third, fourth = (random.standard_normal(PIXELS) for _ in range(3))
    slopes = np.stack([one, one + 0.03 * third, third, fourth], axis=1)
    seen = slopes + 0.03 * random.standard_normal(slopes.shape) * [1, 1, 0, 0]
    quiet = PredictionErrors(np.zeros((2, PIXELS)))
    found = spread(seen, quiet, 1e-2, grain=np.diag([1.0, 1.0, 0.0, 0.0]) * PIXELS * 0.03**2)
    assert np.isnan(found.half_width).tolist() == [True, True, True, False]
    # Its share of that direction is small: what it may go along is not.
    (null,) = found.null
    assert abs(null[2] / null[0]) < 0.05


@pytest.mark.parametrize(("pulled", "is_lost"), [(0.0, False), (1.0, False), (2.0, True)])
def test_a_key_is_lost_where_captures_pull_along_what_it_leans_on(pulled: float, is_lost: bool) -> None:
    """The last two differ by .05 of an image of their own, all grain, and by .008 of what the first one does.

    A deviation along that is a twentieth of the first key's variance; of two, it is a fifth.
    """
    first, second, own = np.eye(3, 50)
    jacobian = np.stack([first, second, second + 0.05 * own + 0.0079 * first], axis=1)
    null = np.array([0.0079, 1.0, -1.0])
    grain = 0.6 * 0.05**2 / 4 * np.outer(null, null)  # over what shows: .6
    left = pulled * own + 3.0 * np.eye(4, 50)[3]
    all_alike = Weighed(np.ones(50), np.ones(50, dtype=np.bool_), np.zeros(50, dtype=np.bool_), np.zeros(50))
    solved = Solution(np.ones(3), Predicted(()), all_alike, left, jacobian, converged=True, rounds=1)
    grained = create_autospec(Grained, instance=True)
    grained.over.return_value.slopes = grain
    found = Ended(solved, PredictionErrors(np.zeros((2, 50))), grained).spread(1e-2, None)
    assert len(found.null) == 1
    assert np.isnan(found.half_width).tolist() == [is_lost, True, True]


def test_what_all_replicates_have_in_common_is_bounded_pixel_by_pixel() -> None:
    """A bound at one pixel moves the mean of n by its n-th part, at most."""
    common = np.zeros(500)
    common[7] = 2.0
    found = spread(np.ones((500, 1)), PredictionErrors(np.zeros((2, 500)), common))
    assert found.bound[0] == pytest.approx(2.0 / 500, rel=EXACT)


def test_replicates_that_go_by_what_some_of_them_show_are_less_sure(bench: Scene, basis: Basis) -> None:
    """With three times the variance more, all are twice as far from their mean."""
    keys, prediction = begun(bench, basis, [EXPOSURE])
    place = np.array([key.value for key in keys.keys])
    images = basis.images[:, :1] + basis.images.std() * generator(5).standard_normal((3, 3, 20, 24)).astype(np.float32)
    plain, carried = (
        Settled(prediction, keys.keys, place, [SourceImages(basis.sources, images, 0, carrying=more)])
        for more in (0.0, 3.0)
    )
    apart = plain.replicates(place) - plain.replicates(place).mean(axis=0)
    assert np.array_equal(plain.replicates(place), carried.replicates(place)) and np.abs(apart).max() > 1
    assert plain.errors(place) == pytest.approx(plain.replicates(place), abs=EXACT)
    errors = carried.errors(place)
    assert errors - errors.mean(axis=0) == pytest.approx(2 * apart, abs=1e-6)


def test_what_a_key_does_to_all_light_is_counted_once(bench: Scene, basis: Basis) -> None:
    """A focal length scales the light of every pixel, here by nothing else: its slope has that, the light has not."""
    keys = free_scene(bench, ["camera.focal_length", LEVELS.replace("*", "0")])
    prediction = Prediction([(keys, Places(keys, [True, False], lambda _: basis))])
    place = np.array([key.value for key in keys.keys])
    near = Settled(prediction, keys.keys, place, [basis])
    way = np.array([0.25, 0.0])  # 2 %
    change = near.at(place + way).unclipped - near.at(place).unclipped
    expected = near.slopes(place)[0] * way[0] / keys.keys[0].scale
    assert change == pytest.approx(expected, rel=1e-6, abs=1e-9)
    assert np.abs(near.replicates(place + way).mean(axis=0) - near.at(place + way).unclipped).max() < EXACT
    exact = prediction.at(place + way).unclipped - prediction.at(place).unclipped
    # Light goes as 1/f^2: what is of second order is 3 % of the change, and what the slope's wide step adds 2 %.
    assert change == pytest.approx(exact, rel=0.06)


def _grained(basis: Basis) -> Basis:
    """Twelve replicates; the first source's light in each pixel is by chance: exponential, as its mean is."""
    mean = np.repeat(basis.images.mean(axis=1, keepdims=True).astype(np.float64), 12, axis=1)
    mean[0] *= generator(9, 1).standard_exponential(mean[0].shape)
    return replace(basis, images=mean.astype(np.float32))


def test_levels_are_not_dimmed_by_the_noise_of_their_own_images(bench: Scene, basis: Basis) -> None:
    """A regression on noisy images falls short by the noise over the signal: here a twelfth, several deviations."""
    keys, prediction = begun(bench, basis, ["sources[0].leds[0].radiance_factor"])
    truth = np.array([1.2])
    capture = taken(prediction.at(truth).unclipped, bench)
    near = Settled(prediction, keys.keys, truth, [_grained(basis)])
    solved, grained = settle(keys.keys, near, [capture], 1.0, robust=False, begin=truth)
    used = solved.weighed.used
    grain = grained.over(used, solved.weighed.sigma[used])
    errors = PredictionErrors(near.replicates(solved.values)[:, used] / solved.weighed.sigma[used])
    sure = spread(solved.jacobian, errors, grain=grain.slopes)
    deviation = float(np.sqrt(sure.covariance[0, 0]))
    assert abs(solved.values[0] - truth[0]) < 2 * deviation
    # What is taken away of the pull of its own noise.
    short = float(grain.pull[0] * inverse_of(solved.jacobian).square[0, 0])
    assert short == pytest.approx(1.2 / 12, rel=0.3) and short > 4 * deviation


@pytest.mark.long
def test_a_robust_fit_ends_at_one_place_wherever_it_begins(bench: Scene, basis: Basis) -> None:
    """Far off all pixels look like outliers; where it ends an eighth of them are. What noise of the images takes from
    the pull is that of the pixels that count there."""
    keys, prediction = begun(bench, basis, ["sources[0].leds[0].radiance_factor"])
    truth = np.array([1.2])
    seen = prediction.at(truth).unclipped.copy()
    seen[:, ::8] += np.where(np.arange(20) % 2, 60, -60)[:, np.newaxis]
    capture = taken(np.clip(seen, 0, 254), bench)
    near = Settled(prediction, keys.keys, truth, [_grained(basis)])
    found = [settle(keys.keys, near, [capture], 8.0, robust=True, begin=np.array([one]))[0] for one in (0.3, 1.2)]
    assert all(one.converged for one in found)
    assert found[0].values == pytest.approx(found[1].values, rel=1e-3)
    # A twelfth would be .1.
    assert found[1].values == pytest.approx(truth, abs=0.07)


def _spot(x: float, y: float) -> Array:
    rows, columns = np.mgrid[0:20, 0:24]
    return np.asarray(np.exp(-((columns - 11.5 - x) ** 2 + (rows - 9.5 - y) ** 2) / (2 * BLUR**2)))


def test_a_search_that_is_off_settles_where_unbiased_rays_lead(bench: Scene, basis: Basis) -> None:
    """Renders of the search show the spot .3 px off, as cells of a kernel may; those that settle do not."""
    keys = free_scene(bench, ["pose:edge"])

    def traced(scene: Scene, off: float) -> Basis:
        x, y, _ = scene.targets[0].pose.position
        shown = LEVEL * _spot(x * 1e3 / PIXEL + off, y * 1e3 / PIXEL)
        share = np.broadcast_to(shown / len(basis.sources), basis.images.shape)
        return replace(basis, images=share.astype(np.float32))

    places = Places(keys, [True] * 6, lambda scene: traced(scene, 0.3))
    prediction = Prediction([(keys, places)])
    truth = np.array([3.0, -1.0, 0, 0, 0, 0.0])
    seen = prediction_of(keys, lambda scene: traced(scene, 0.0)).at(truth)
    begin = truth - [0.6, 0, 0, 0, 0, 0]  # where the search agrees best
    prediction.slopes(begin)
    near = Settled(prediction, keys.keys, begin, [traced(places.scene(begin), 0.0)])
    solved, _ = settle(keys.keys, near, [taken(seen.unclipped, bench)], 1.0, robust=False, begin=begin)
    assert solved.converged and near.reaches(solved.values)
    # The way is .3 px, over which the slopes of a spot of 1.5 px change by a few percent.
    assert solved.values[:2] == pytest.approx(truth[:2], abs=0.06)
    assert not near.reaches(begin + np.array([20.0, 0, 0, 0, 0, 0]))


@pytest.mark.long
def test_slopes_with_grain_neither_shorten_the_way_nor_swing(bench: Scene, basis: Basis) -> None:
    """A way of .5 px by slopes nearly half of which is grain: as far as by slopes without any, in a few steps."""
    keys = free_scene(bench, ["pose:edge"])

    def traced(scene: Scene, grain: float) -> Basis:
        x, y, _ = scene.targets[0].pose.position
        shown = LEVEL * (0.5 + _spot(x * 1e3 / PIXEL, y * 1e3 / PIXEL))
        seed = int.from_bytes(hashlib.sha256(repr((x, y)).encode()).digest()[:4], "big")
        shown = shown + grain * LEVEL * generator(seed, 2).standard_normal((4, *shown.shape))
        share = np.broadcast_to(shown / len(basis.sources), (len(basis.sources), 4, *shown.shape[1:]))
        return replace(basis, images=share.astype(np.float32))

    truth, begin = np.array([1.0, 0, 0, 0, 0, 0.0]), np.zeros(6)
    found = []
    for grain in (0.0, 0.031):
        places = Places(keys, [True] * 6, lambda scene, grain=grain: traced(scene, grain))
        prediction = Prediction([(keys, places)])
        prediction.slopes(begin)
        # The image itself has no grain: what is seen is that of the slopes.
        near = Settled(prediction, keys.keys, begin, [traced(places.scene(begin), 0.0)])
        seen = taken(prediction_of(keys, lambda scene: traced(scene, 0.0)).at(truth).unclipped, bench)
        solved, hindered = settle(keys.keys, near, [seen], 1.0, robust=False, begin=begin)
        assert solved.converged and solved.rounds < FEW
        used = solved.weighed.used
        slopes = hindered.over(used, solved.weighed.sigma[used]).slopes
        share = slopes[0, 0] / float((solved.jacobian[:, 0] ** 2).sum())
        found.append((float(solved.values[0]), share))
    assert found[0][1] == 0 and 0.15 < found[1][1] < 0.5, found
    # Else it would be shorter by that share.
    assert found[1][0] == pytest.approx(found[0][0], rel=0.12)


def _shaded(basis: Basis, scene: Scene) -> Basis:
    """A spot where the edge is, each source brighter on a side of its own."""
    x, y, _ = scene.targets[0].pose.position
    columns = np.mgrid[0:20, 0:24][1] / 24
    sides = np.stack([1 + columns, 2 - columns, np.full_like(columns, 0.5)]) / 3.5
    shown = LEVEL * sides * (0.5 + _spot(x * 1e3 / PIXEL, y * 1e3 / PIXEL))
    return replace(basis, images=np.repeat(shown[:, np.newaxis], 2, axis=1).astype(np.float32))


def test_slopes_go_with_the_light_that_they_are_seen_in(bench: Scene, basis: Basis) -> None:
    """Slopes of the place before, where the time was half as long and one LED twice as bright."""
    led = LEVELS.replace("*", "0")
    keys = free_scene(bench, ["targets[0].position[0]=-0.1 m:0.1 m", EXPOSURE, led])
    places = Places(keys, [True, False, False], lambda scene: _shaded(basis, scene))
    prediction = Prediction([(keys, places)])
    start = np.array([key.value for key in keys.keys])
    first = Settled(prediction, keys.keys, start, [_shaded(basis, places.scene(start))])
    there = start * [1.0, 2.0, 0.5] + [5e-5, 0, 0]
    then = Settled(prediction, keys.keys, there, [_shaded(basis, places.scene(there))], first)
    assert then.steep is first.steep
    # Those of the search only lead to a place: there they are seen anew.
    early = Settled(prediction, keys.keys, start, [_shaded(basis, places.scene(start))], is_last=False)
    last = Settled(prediction, keys.keys, start, [_shaded(basis, places.scene(start))], early)
    assert last.steep is not early.steep
    columns = np.mgrid[0:20, 0:24][1] / 24
    brighter = 2 * (0.5 * (1 + columns) + 2 - columns + 0.5) / 3.5
    slope = first.slopes(start)[0]
    assert then.slopes(there)[0] == pytest.approx(brighter * slope, rel=1e-5, abs=1e-6 * float(np.abs(slope).max()))
    # Near there too light and place act as a product: twice the time doubles what a shift does.
    dark = bench.camera.sensor.dark_gray
    shifted = there + np.array([4e-4, 0, 0])
    longer = shifted * [1.0, 2.0, 1.0]
    once, twice = (then.at(values).unclipped - dark for values in (shifted, longer))
    assert twice == pytest.approx(2 * once, rel=1e-5)
    assert np.abs(then.replicates(longer).mean(axis=0) - then.at(longer).unclipped).max() < 1e-4


@pytest.mark.parametrize("rests", [True, pytest.param(False, marks=pytest.mark.long)])
def test_a_fit_that_still_goes_elsewhere_has_not_converged(bench: Scene, basis: Basis, rests: bool) -> None:
    """Light that shows the spot now here, now there, has no place where a search could end."""
    keys = free_scene(bench, ["targets[0].position[0]=-0.1 m:0.1 m"])

    def traced(scene: Scene, off: float) -> Basis:
        x, y, _ = scene.targets[0].pose.position
        shown = LEVEL * _spot(x * 1e3 / PIXEL + off, y * 1e3 / PIXEL)
        return replace(basis, images=np.broadcast_to(shown / 3, basis.images.shape).astype(np.float32))

    class Restless:
        places = 0
        aimed = AIMED

        def unbiased(self, scene: Scene, share: int, near: object, needed: object) -> Basis:
            assert share == (1 if self.places else 4)  # few rays first
            assert (near is None) == (self.places < 2)  # whole ones are compared with each other
            self.places += 1
            return traced(scene, 0.0 if rests else 0.15 * (-1) ** self.places)

    light = Restless()
    prediction = prediction_of(keys, lambda scene: traced(scene, 0.0))
    begin = np.zeros(1)
    seen = taken(prediction.at(begin + 3e-4).unclipped, bench)
    prediction.slopes(begin)
    found = ended(keys.keys, prediction, light, [seen], begin, noise=0.3, robust=False)  # type: ignore[arg-type]
    assert found.solved.converged == rests
    assert (light.places < 7) == rests and 2 <= light.places <= 7


def prediction_of(keys: FreeScene, trace: Callable[[Scene], Basis]) -> Prediction:
    """By another tracer."""
    return Prediction([(keys, Places(keys, [True] * len(keys.keys), trace))])


def test_keys_that_nearly_cancel_are_moved_together(bench: Scene, basis: Basis) -> None:
    """Two keys shift a spot alike, and dim it a little by their difference: that is not lost in the grain of each."""
    keys = free_scene(bench, ["pose:edge"])
    rows, columns = np.mgrid[0:20, 0:24]

    def traced(scene: Scene) -> Basis:
        x, y, _ = (one * 1e3 / PIXEL for one in scene.targets[0].pose.position)
        # Along (1, 1) the spot goes; along (1, -1) it dims by a fiftieth for each pixel.
        away = (columns - 11.5 - x - y) ** 2 + (rows - 9.5) ** 2
        shown = LEVEL * (0.5 + (1 + 0.02 * (x - y)) * np.exp(-away / (2 * BLUR**2)))
        seed = int.from_bytes(hashlib.sha256(repr((x, y)).encode()).digest()[:4], "big")
        grained = shown + 0.002 * LEVEL * generator(seed, 2).standard_normal((4, *shown.shape))
        return replace(basis, images=np.broadcast_to(grained / 3, (3, *grained.shape)).astype(np.float32))

    prediction = prediction_of(keys, traced)
    steep = prediction.steepness(np.zeros(6))
    scale = exposure_of_radiance(bench.camera)
    # Shifts are along the target's own axes.
    own = np.array(bench.targets[0].pose.rotation)[:2, :2].T @ [1.0, -1.0]
    dims = np.tensordot(own, steep.changes[:2].mean(axis=1), axes=1) / scale
    spot = np.exp(-((columns - 11.5) ** 2 + (rows - 9.5) ** 2) / (2 * BLUR**2))
    exact = LEVEL * 0.02 * 2 * spot / PIXEL  # for a millimetre of one, and one back of the other
    share = float((dims * exact).sum() / (exact**2).sum())
    assert share == pytest.approx(1.0, abs=0.05)
    # Nor does what single steps leave out of each slope show in it.
    assert float(np.linalg.norm(dims - exact) / np.linalg.norm(exact)) < 0.3


@pytest.mark.parametrize("share", [0.2, 0.7])
def test_a_bound_that_is_near_changes_no_slope(bench: Scene, basis: Basis, share: float) -> None:
    """Keys that do nearly the same are moved one by one there: together they would go another way than is counted."""
    rows, columns = np.mgrid[0:20, 0:24]

    def traced(scene: Scene) -> Basis:
        x, y, _ = (one * 1e3 for one in scene.targets[0].pose.position)
        shown = LEVEL * (2 + (1 + x) * columns / 24 + y * (columns / 24 + 0.3 * rows / 20))
        return replace(basis, images=np.broadcast_to(shown / 3, (3, 4, *shown.shape)).astype(np.float32))

    names = [f"targets[0].position[{axis}]" for axis in (0, 1)]

    def found(free: list[str]) -> tuple[Array, Array]:
        keys = free_scene(bench, free)
        steep = prediction_of(keys, traced).steepness(np.zeros(2))
        scales = np.array([key.scale for key in keys.keys])
        return steep.changes / scales[:, np.newaxis, np.newaxis, np.newaxis], steep.reach

    slopes, reach = found(names)
    bounded, _ = found([f"{names[0]}={-share * reach[0]} m:1 m", names[1]])
    assert bounded == pytest.approx(slopes, rel=1e-3, abs=1e-4 * float(np.abs(slopes).max()))


# Of the search by two replicates, of what takes twice as many rays, and which of both and of all rays are asked.
@pytest.mark.parametrize(
    ("grain", "next_grain", "asked"),
    [(0.0, 0.0, (True, False)), (0.3, 0.0, (False, True)), (0.0, 0.3, (True, True))],
)
def test_slopes_of_few_rays_do_unless_they_are_grain(
    bench: Scene, basis: Basis, grain: float, next_grain: float, asked: tuple[bool, bool]
) -> None:
    """The search says how many rays a slope takes; where it was too few of them, all are traced."""
    keys = free_scene(bench, ["targets[0].position[0]"])

    def traced(off: float, asked: list[float]) -> Callable[[Scene], Basis]:
        def trace(scene: Scene) -> Basis:
            x = scene.targets[0].pose.position[0] * 1e3 / PIXEL
            asked.append(x)
            seed = int.from_bytes(hashlib.sha256(repr(x).encode()).digest()[:4], "big")
            shown = LEVEL * (_spot(x, 0.0) + off * generator(seed, 2).standard_normal((4, 20, 24)))
            return replace(basis, images=np.broadcast_to(shown / 3, (3, 4, 20, 24)).astype(np.float32))

        return trace

    few: list[float] = []
    more: list[float] = []
    many: list[float] = []
    rough = prediction_of(keys, traced(grain, few))
    look = Prediction([(keys, Places(keys, [True], traced(next_grain, more)))], rough=rough)
    places = Places(keys, [True], traced(0.0, many))
    prediction = Prediction([(keys, places)], rough=rough, looks=[(2.0, look)])
    rough.slopes(np.zeros(1))
    before = len(few)
    first = prediction.steepness(np.zeros(1), is_last=False)
    assert len(few) == before and not more and not many  # it takes what the search has seen
    steep = prediction.steepness(np.zeros(1))
    assert (bool(more), bool(many)) == asked

    def wrong(steep: Steepness) -> float:
        step = float(steep.reach[0]) * 1e3 / PIXEL
        wanted = (_spot(step, 0.0) - _spot(-step, 0.0)) / 2
        found = steep.changes[0].mean(axis=0) * float(steep.reach[0]) / keys.keys[0].scale
        factor = float((found * wanted).sum() / (wanted**2).sum()) / (LEVEL * exposure_of_radiance(bench.camera))
        assert abs(factor - 1) < 0.02  # of a step that is not infinitesimal
        off = found / factor / LEVEL / exposure_of_radiance(bench.camera) - wanted
        return float(np.abs(off).max() / np.ptp(wanted))

    assert wrong(steep) < 0.02
    assert grain or wrong(first) < 0.02


def test_a_step_is_the_less_linear_the_farther_it_goes(bench: Scene, basis: Basis) -> None:
    keys = free_scene(bench, ["targets[0].position[0]"])

    def trace(scene: Scene) -> Basis:
        shown = LEVEL * _spot(scene.targets[0].pose.position[0] * 1e3 / PIXEL, 0.0)
        return replace(basis, images=np.broadcast_to(shown / 3, basis.images.shape).astype(np.float32))

    prediction = prediction_of(keys, trace)
    near = Settled(prediction, keys.keys, np.zeros(1), [trace(bench)])
    reach = prediction.steepness(np.zeros(1)).reach
    assert near.bent(np.zeros(1)) == 0
    assert near.bent(0.5 * reach) == pytest.approx(0.5) and near.bent(-0.1 * reach) == pytest.approx(0.1)


def test_grain_counts_beside_what_other_keys_do_as_well() -> None:
    """Of a slope (3, 2, 0) the first part is another key's; two replicates are off by .5 both ways."""
    images = np.array([[3.0, 2.0, 0.5], [3.0, 2.0, -0.5]])
    assert _grain_of(images, np.array([[1.0], [0.0], [0.0]])) == pytest.approx(0.5**2 / 2**2)
    assert _grain_of(images, np.zeros((3, 0))) == pytest.approx(0.5**2 / (3**2 + 2**2))


def test_a_step_by_slopes_that_are_off_is_not_the_last_one(bench: Scene, basis: Basis) -> None:
    """Few rays show the spot a tenth too far: after the first steps more than a tenth of a deviation is left."""
    keys = free_scene(bench, ["targets[0].position[0]=-0.1 m:0.1 m"])

    def traced(scene: Scene, times: float) -> Basis:
        shown = LEVEL * _spot(times * scene.targets[0].pose.position[0] * 1e3 / PIXEL, 0.0)
        return replace(basis, images=np.broadcast_to(shown / 3, basis.images.shape).astype(np.float32))

    class Unbiased:
        places = 0
        aimed = AIMED

        def unbiased(self, scene: Scene, share: int, near: object, needed: object) -> Basis:
            self.places += 1
            return traced(scene, 1.0)

    rough, light = prediction_of(keys, lambda scene: traced(scene, 1.1)), Unbiased()
    prediction = Prediction([(keys, Places(keys, [True], lambda scene: traced(scene, 1.0)))], rough=rough)
    truth = np.array([3e-4])
    seen = taken(prediction.at(truth).unclipped, bench)
    found = ended(keys.keys, prediction, light, [seen], np.zeros(1), noise=1.5, robust=False)  # type: ignore[arg-type]
    off = (found.solved.values - truth) / keys.keys[0].scale * np.linalg.norm(found.solved.jacobian)
    assert found.solved.converged and light.places == 3
    assert abs(off[0]) < 0.1


@pytest.mark.long
def test_no_step_is_longer_than_slopes_reach(bench: Scene, basis: Basis) -> None:
    """Light that lies 12 px off is come to by more than six steps, by few rays but for the last two."""
    keys = free_scene(bench, ["targets[0].position[0]=-0.1 m:0.1 m"])
    asked: list[float] = []
    shares: list[int] = []

    def traced(scene: Scene) -> Basis:
        x = scene.targets[0].pose.position[0] * 1e3 / PIXEL
        shown = 0.7 * LEVEL * (1.2 + np.tanh((np.mgrid[0:20, 0:24][1] - 11.5 - x) / 6))
        return replace(basis, images=np.broadcast_to(shown / 3, basis.images.shape).astype(np.float32))

    class Unbiased:
        aimed = AIMED

        def unbiased(self, scene: Scene, share: int, near: object, needed: object) -> Basis:
            asked.append(scene.targets[0].pose.position[0])
            shares.append(share)
            return traced(scene)

    prediction = prediction_of(keys, traced)
    reach = float(prediction.steepness(np.zeros(1)).reach[0])
    truth = np.array([12 * PIXEL * 1e-3])
    seen = taken(prediction.at(truth).unclipped, bench)
    found = ended(keys.keys, prediction, Unbiased(), [seen], np.zeros(1), noise=1.5, robust=False)  # type: ignore[arg-type]
    assert found.solved.converged and found.solved.values == pytest.approx(truth, abs=1e-4)
    assert asked[0] == 0 and (np.diff(asked) > 0).all() and (np.diff(asked) <= reach).all()
    assert len(shares) > 8 and shares == [4] * (len(shares) - 2) + [1, 1]


def test_a_step_counts_along_each_direction(bench: Scene, basis: Basis) -> None:
    """An offset of three deviations in all pixels, whatever else is free: the root mean square of 3 and nothing."""
    for others, expected in (([], 1.0), ([EXPOSURE], 0.5**0.5)):
        keys, prediction = begun(bench, basis, ["camera.sensor.offset", *others])
        place = np.array([key.value for key in keys.keys])
        near = Settled(prediction, keys.keys, place, [basis])
        seen = taken(prediction.at(place).unclipped, bench)
        solved, grained = settle(keys.keys, near, [seen], 1.0, robust=False, begin=place)
        way = np.zeros(len(place))
        way[0] = 3.0 / float(np.linalg.norm(solved.jacobian[:, 0]))
        assert _gone(solved, grained, way) == pytest.approx(3.0 * expected, rel=1e-6)


@pytest.mark.parametrize(
    ("apart", "is_last", "moves"),
    [(0.3, True, True), (0.02, True, False), (0.3, False, False)],
    ids=["pulls", "noise", "rough slopes"],
)
def test_what_is_weak_moves_only_where_captures_pull(
    bench: Scene, basis: Basis, apart: float, is_last: bool, moves: bool
) -> None:
    """Two LEDs differ by a twentieth over the image: beside renders, what noise may do leads nowhere."""
    bench = changed(bench, {"camera.sensor.rounding": False})
    free = ["targets[0].position[0]=-0.1 m:0.1 m", *(LEVELS.replace("*", led) for led in "01")]
    keys = free_scene(bench, free)
    tilt = 1 + 0.05 * (np.mgrid[0:20, 0:24][1] / 24 - 0.5)
    sides = np.stack([np.ones_like(tilt), tilt, 0.5 * np.ones_like(tilt)]) / 2.5

    def traced(scene: Scene) -> Basis:
        shown = LEVEL * sides * (0.5 + _spot(scene.targets[0].pose.position[0] * 1e3 / PIXEL, 0.0))
        return replace(basis, images=np.repeat(shown[:, np.newaxis], 2, axis=1).astype(np.float32))

    prediction = Prediction([(keys, Places(keys, [True, False, False], traced))])
    begin, truth = np.array([0.0, 1.0, 1.0]), np.array([0.0, 1 + apart, 1 - apart])
    near = Settled(prediction, keys.keys, begin, [traced(bench)], is_last=is_last)
    seen = taken(prediction.at(truth).unclipped, bench)
    solved, _ = settle(keys.keys, near, [seen], 0.2, robust=False, begin=begin)
    shares = np.linalg.svd(solved.jacobian / np.linalg.norm(solved.jacobian, axis=0), compute_uv=False)
    assert PULLED < shares[-1] / shares[0] < GRAIN
    gone = (solved.values[1] - solved.values[2]) / (2 * apart)
    pull = float(np.linalg.norm(solved.jacobian @ np.array([0.0, apart, -apart])))
    assert (pull > WEAK_PULL) == (apart > 0.1)
    # What is left of the pull is what noise may be, squared, over itself.
    assert gone == pytest.approx(1 - (WEAK_PULL / pull) ** 2 if moves else 0.0, abs=0.01)


def test_an_end_does_not_hang_on_where_settling_begins(bench: Scene, basis: Basis) -> None:
    """Levels and the exposure multiply: far from where it begins, the error of their rays has not gone along slopes."""
    free = [*(LEVELS.replace("*", led) for led in "01"), EXPOSURE]
    keys, prediction = begun(bench, basis, free)
    images = basis.images.mean(axis=1, keepdims=True) * (
        1 + 0.01 * generator(6).standard_normal((3, 12, 20, 24))
    ).astype(np.float32)
    traced = [SourceImages(basis.sources, images, 0)]
    truth = np.array([key.value for key in keys.keys])
    seen = taken(prediction.at(truth).unclipped, bench)
    ends = []
    for away in ([1.0, 1.0, 1.0], [1.6, 1.6, 0.65]):
        near = Settled(prediction, keys.keys, truth * away, traced)
        solved, _ = settle(keys.keys, near, [seen], None, robust=False, begin=truth * away)
        assert solved.converged
        ends.append(solved.values / truth)
    assert ends[1] == pytest.approx(ends[0], abs=1e-6)
    assert ends[0] == pytest.approx(1.0, abs=0.1)
