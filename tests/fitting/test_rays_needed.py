"""Rays of the unbiased image of a fit: as many, and where, as its intervals take."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np
import pytest

from radwrap.fitting.covariance import PredictionErrors, spread
from radwrap.fitting.prediction import Prediction
from radwrap.fitting.rays_needed import WIDER, rays_needed, shared_out, widening
from radwrap.fitting.settled import Settled
from radwrap.fitting.solution import settle
from radwrap.imaging.relight.relit import Basis
from radwrap.imaging.relight.source_images import AimedRays, SourceImages
from radwrap.random_streams import generator
from radwrap.scene.scene import Scene
from tests.fitting.conftest import EXPOSURE, begun, taken

Array = np.ndarray[Any, np.dtype[np.float64]]
REPLICATES: Final = 12
FALLS: Final = 1.2  # of a variance with its rays
FEW: Final = 16  # rays of each pixel by which it is learned how many it needs
COARSE: Final = AimedRays(100.0, REPLICATES)  # that it is met takes no ray
LOOSE: Final = (
    0.25  # numbers of rays are powers of 2, and 4 replicates with their neighbours know a scatter by some 15 %
)
LARGE: Final = 1 << 30  # share of the few: no limit
EXACT: Final = 1e-9


def test_rays_widen_an_interval_by_no_more_than_is_told() -> None:
    """One key of 100 pixels; the mean of 12 images scatters by exactly the variance that is allowed."""
    jacobian, signs = np.ones((100, 1)), np.tile([1.0, -1.0], REPLICATES // 2)
    # Over noise, whose variance is 1/100: each image is off in all pixels alike.
    allowed = widening(WIDER, REPLICATES) / 100
    off = signs * np.sqrt(allowed * (REPLICATES - 1))
    quiet, seen = (PredictionErrors(one[:, np.newaxis] * np.ones(100)) for one in (0 * signs, off))
    ratio = spread(jacobian, seen).half_width / spread(jacobian, quiet).half_width
    assert ratio == pytest.approx(1.1, rel=EXACT)


def test_rays_go_where_they_take_most_from_the_sum() -> None:
    """Needs of 2^(2.2 k) are best met by 2^k times as many rays, and here by 8 of the least."""
    needs = 2.0 ** (2.2 * np.arange(6.0))
    needs *= 8**FALLS / (2.0 ** np.arange(6.0)).sum()
    found = shared_out(needs[np.newaxis])
    assert found.tolist() == [8, 16, 32, 64, 128, 256]
    assert (needs * found**-FALLS).sum() == pytest.approx(1.0, rel=EXACT)
    even = needs.sum() ** (1 / FALLS)  # of each pixel, for the same sum
    assert found.sum() < 0.6 * 6 * even
    assert shared_out(needs[np.newaxis], found.sum() / 4).tolist() == [4, 4, 8, 16, 32, 64]
    # Of two sums the larger one decides, and none is more than it may be.
    assert shared_out(np.stack([needs / 2, needs / 2])).tolist() == shared_out(needs[np.newaxis] / 2).tolist()


@pytest.mark.parametrize(("scatter", "captures"), [(20.0, 1), (60.0, 1), (20.0, 3)])
def test_intervals_are_as_wide_as_they_may_be(bench: Scene, basis: Basis, scatter: float, captures: int) -> None:
    """Pixels scatter up to 16 times as much to the left; an offset and the time are free, with noise of one level.

    Several captures are seen in one light, whose rays they have in common.
    """
    keys, single = begun(bench, basis, ["camera.sensor.offset", EXPOSURE])
    prediction = Prediction(single.shots * captures)
    place = np.array([key.value for key in keys.keys])
    rows, columns = basis.images.shape[2:]
    clean = Settled(single, keys.keys, place, [basis])
    shown = clean.at(place).unclipped - bench.camera.sensor.dark_gray
    one_ray = scatter * 16.0 ** -np.linspace(0.0, 1.0, columns) * np.ones((rows, 1))

    def seen(numbers: Array, replicates: int, seed: int) -> SourceImages:
        mean = basis.images.astype(np.float64).mean(axis=1, keepdims=True)
        off = one_ray * numbers ** (-FALLS / 2) * generator(seed, 3).standard_normal((replicates, rows, columns))
        images = mean * (1 + off / shown)
        return SourceImages(basis.sources, images.astype(np.float32), 0, numbers.astype(np.intp))

    few = seen(np.full((rows, columns), FEW), 4, 1)
    near = Settled(prediction, keys.keys, place, [few])
    capture = taken(single.at(place).unclipped, bench)
    solved, grained = settle(keys.keys, near, [capture] * captures, 1.0, robust=False, begin=place)
    (numbers,) = rays_needed(prediction, [few], near, solved, grained, aimed=COARSE, share=LARGE)
    assert numbers is not None and (np.log2(numbers) % 1 == 0).all()
    used = solved.weighed.used
    assert numbers[:, : columns // 2].mean() > 2 * numbers[:, columns // 2 :].mean()
    many = 400  # images, to know their scatter
    errors = Settled(prediction, keys.keys, place, [seen(numbers, many, 2)]).replicates(solved.values)[:, used]
    noise = solved.weighed.sigma[used]
    whole = spread(solved.jacobian, PredictionErrors(errors / noise))
    share = float(np.mean(np.diag(whole.prediction * many / REPLICATES) / np.diag(whole.noise)))
    assert share == pytest.approx(widening(WIDER, REPLICATES), rel=LOOSE)
    (limited,) = rays_needed(prediction, [few], near, solved, grained, aimed=COARSE, share=1)
    assert limited is not None and limited.sum() < 1.5 * FEW * rows * columns * 4 / REPLICATES  # powers of 2
    # Where the verdict takes a finer image than intervals, that decides.
    fine = replace(COARSE, rms=0.05)
    (finer,) = rays_needed(prediction, [few], near, solved, grained, aimed=fine, share=LARGE)
    assert finer is not None  # rays are told by pixels
    rms = float(np.sqrt((one_ray**2 * finer**-FALLS / REPLICATES)[used[:rows]].mean()))
    assert rms == pytest.approx(fine.rms, rel=LOOSE)


def test_a_pixel_that_is_left_out_keeps_its_rays(bench: Scene, basis: Basis) -> None:
    """By fewer it would be seen below saturation now and then, and count just where its rays are off."""
    keys, prediction = begun(bench, basis, ["camera.sensor.offset"])
    place = np.array([key.value for key in keys.keys])
    few = SourceImages(basis.sources, basis.images, 0, np.full(basis.images.shape[2:], 64))
    near = Settled(prediction, keys.keys, place, [few])
    mask = np.ones(few.images.shape[2:], dtype=np.bool_)
    mask[5, 7] = False
    capture = replace(taken(prediction.at(place).unclipped, bench), mask=mask)
    solved, grained = settle(keys.keys, near, [capture], 5.0, robust=False, begin=place)
    (numbers,) = rays_needed(prediction, [few], near, solved, grained, aimed=COARSE, share=LARGE)
    assert numbers is not None and numbers[5, 7] == 64 and np.count_nonzero(numbers >= 64) == 1
