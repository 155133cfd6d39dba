"""Light from beyond the guard band: the coarse image, seen from pixels."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from radwrap.imaging.tolerance.wave_far import _interpolated


@pytest.mark.parametrize("shape", [(5, 7), (1, 3), (2, 2)])
def test_between_blocks_light_is_as_scipy_has_it(shape: tuple[int, int]) -> None:
    random = np.random.default_rng(1)
    values, rows, columns = random.random(shape), random.uniform(-2, 9, 13), random.uniform(-2, 9, 11)
    told = map_coordinates(values, np.meshgrid(rows, columns, indexing="ij"), order=1, mode="nearest")
    found = _interpolated(_interpolated(values, rows, 0), columns, 1)
    assert found == pytest.approx(told, rel=1e-14)
