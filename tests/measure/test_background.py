"""Noise of an image whose light is not even, from its second differences."""

import numpy as np
import pytest

from radwrap.measure.background import noise_level


def test_noise_is_that_which_was_added() -> None:
    """On light that rises and bends, also across the bands that the image is looked at in."""
    random = np.random.default_rng(5)
    v, u = np.indices((200, 150))
    light = 50 + 0.4 * u + 2e-3 * (v - 90.0) ** 2
    # The median of 30 000 differences, which overlap, is known to a hundredth.
    assert noise_level(light + random.normal(0, 2.5, light.shape)) == pytest.approx(2.5, rel=0.03)
    assert noise_level(light) == pytest.approx(0, abs=1e-3)
