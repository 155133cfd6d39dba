"""Radiant intensities from captures: right within the stated standard error, which is neither too small nor vain."""

from __future__ import annotations

from typing import Final

import numpy as np
import pytest
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.imaging.response.sensor import gray_levels
from radwrap.led.self_calibration import check_dark, factor
from radwrap.scene.camera import Sensor

FIVS: Final = Sensor(
    rows=50, columns=60, pixel_width=13.75e-6, pixel_height=16e-6, gain=3.38e4, gamma=0.85, dark_gray=22.0,
    saturation_gray=181.0, bit_depth=8, rounding=True, channel="equal",
)  # fmt: skip
TRIALS: Final = 200
# Mean square of TRIALS errors over their standard errors; 5 sigma of chi square.
LARGEST_MEAN_SQUARE: Final = 1 + 5 * np.sqrt(2 / TRIALS)

# On a ramp the rounding errors of neighbours cancel over more than a block, which the standard error does not know.
LEAST_MEAN_SQUARE: Final = 0.03


def exposure_for(gray: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.power((gray - FIVS.dark_gray) / FIVS.gain, 1 / FIVS.gamma)


def captured(exposure: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.rint(gray_levels(exposure, FIVS))


def images() -> dict[str, NDArray[np.float64]]:
    """Gray levels of scenes: many levels, a few, one, and mostly dark."""
    rows, columns = np.mgrid[0:50, 0:60]
    return {
        "ramp": 30 + 100 * columns / 59 + rows / 49,
        "spots": 22 + 40 * np.exp(-((columns % 15 - 7) ** 2 + (rows % 12 - 6) ** 2) / 8),
        "steps": 40.0 + 25 * (columns // 20),
        "flat": np.full((50, 60), 41.3),
    }


@pytest.mark.parametrize("name", ["ramp", "spots", "steps", "flat"])
def test_factors_are_within_their_standard_error(name: str) -> None:
    predicted = exposure_for(images()[name])
    rng = np.random.default_rng(5)
    scores = []
    for true in rng.uniform(0.85, 1.15, TRIALS):
        found = factor(captured(true * predicted), predicted, FIVS)
        scores.append((found.value - true) / found.standard_error)
    mean_square = float(np.mean(np.square(scores)))
    assert mean_square < LARGEST_MEAN_SQUARE, f"{name}: the standard error is too small, {mean_square:.2f}"
    assert mean_square > LEAST_MEAN_SQUARE, f"{name}: the standard error says nothing, {mean_square:.2f}"


def test_an_even_image_has_the_error_of_a_single_rounding() -> None:
    """3000 pixels that all round alike know no more than one: 1/sqrt(12) gray levels of the 19.3 above dark."""
    found = factor(captured(exposure_for(images()["flat"])), exposure_for(images()["flat"]), FIVS)
    assert found.standard_error == pytest.approx(1 / np.sqrt(12) / 19.3 / FIVS.gamma, rel=0.05)


def test_noise_that_hangs_together_is_in_the_standard_error() -> None:
    predicted = exposure_for(images()["ramp"])
    rng = np.random.default_rng(6)
    scores = []
    for _ in range(TRIALS):
        clouds = np.kron(rng.normal(0, 1, (50, 60))[:10, :12], np.ones((5, 5)))
        gray = np.rint(gray_levels(predicted, FIVS) + clouds)
        found = factor(gray, predicted, FIVS)
        scores.append((found.value - 1) / found.standard_error)
    assert 0.5 < np.mean(np.square(scores)) < 2.0  # blocks of 8 px hold clouds of 5 px in part


def test_saturated_pixels_are_left_out_without_bias() -> None:
    predicted = exposure_for(30 + 140 * np.mgrid[0:50, 0:60][1] / 59)
    found = factor(captured(1.4 * predicted), predicted, FIVS)
    assert found.pixels < predicted.size
    assert found.value == pytest.approx(1.4, abs=4 * found.standard_error)
    assert found.standard_error < 2e-3


def test_what_cannot_tell_is_refused() -> None:
    predicted = exposure_for(images()["ramp"])
    with pytest.raises(InputError, match="is dark"):
        factor(np.full((50, 60), 22.0), predicted, FIVS)
    for other in (np.full((50, 60), 181.0), captured(predicted[:, ::-1])):
        with pytest.raises(InputError, match="does not look like"):
            factor(other, predicted, FIVS)
    with pytest.raises(InputError, match="has the shape"):
        factor(np.zeros((5, 6)), predicted, FIVS)
    check_dark(np.full((5, 6), 22.0), FIVS)
    with pytest.raises(InputError, match=r"its mean is 24.00"):
        check_dark(np.full((5, 6), 24.0), FIVS)
