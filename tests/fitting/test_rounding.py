"""Whole gray levels: what pixels of one level have in common, where little noise scatters them."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
import pytest
from scipy.stats import norm

from radwrap.fitting.settled import Settled
from radwrap.fitting.solution import settle, solve
from radwrap.fitting.weights import rounding_error
from radwrap.imaging.relight.relit import Basis
from radwrap.random_streams import generator
from radwrap.scene.file.load import scene_from_document
from radwrap.scene.scene import Scene
from tests.fitting.conftest import begun, tables, taken

OFFSET: Final = "camera.sensor.offset"
QUIET: Final = 0.2  # gray levels of noise: 10 electrons
CLOSE: Final = 2e-4  # gray level, of the harmonics that are left out
SURE: Final = 4.0  # deviations of a mean of all pixels


@pytest.mark.parametrize("deviation", [QUIET, 0.3, 0.5, 2.0])
def test_a_rounded_level_is_off_as_its_shares_say(deviation: float) -> None:
    """Sum of all whole levels by how often each is given."""
    gray = np.linspace(4.0, 6.0, 41)
    levels = np.arange(-20.0, 30.0)
    up, down = (norm.cdf((levels + half - gray[:, np.newaxis]) / deviation) for half in (0.5, -0.5))
    mean = ((up - down) * levels).sum(axis=1)
    assert rounding_error(gray, np.full(41, deviation)) == pytest.approx(mean - gray, abs=CLOSE)


def test_less_noise_than_any_says_no_more() -> None:
    """A stair of levels is none that steps could follow: what is said goes on as by the least noise."""
    gray = np.linspace(4.0, 6.0, 41)
    none, least = (rounding_error(gray, np.full(41, deviation)) for deviation in (0.0, QUIET))
    assert none == pytest.approx(least) and float(np.abs(none).max()) < 0.16


@pytest.fixture(scope="module")
def quiet() -> Scene:
    """The bench with little noise."""
    return scene_from_document(tables(read_noise=f"{QUIET / 0.02} e"))


@pytest.mark.parametrize("truth", [5.25, 5.1, 4.7])
@pytest.mark.parametrize("settles", [True, False])
def test_an_offset_of_a_dark_background_is_not_off(quiet: Scene, basis: Basis, truth: float, settles: bool) -> None:
    """All pixels have one level: at a fourth between two, rounding takes .145 of all of them."""
    dark = replace(basis, images=np.zeros_like(basis.images))
    keys, prediction = begun(quiet, dark, [OFFSET])
    place = np.array([5.0])
    gray = truth + QUIET * generator(3, round(100 * truth)).standard_normal((20, 24))
    seen = taken(np.rint(gray), quiet)
    if settles:
        near = Settled(prediction, keys.keys, place, [dark])
        solved, _ = settle(keys.keys, near, [seen], None, robust=False, begin=place)
    else:
        solved = solve(keys.keys, prediction, [seen], None, robust=False, begin=place)
    deviation = float(solved.weighed.sigma[0, 0]) / np.sqrt(gray.size)
    assert solved.converged
    assert abs(float(solved.values[0]) - truth) < SURE * deviation < 0.07
