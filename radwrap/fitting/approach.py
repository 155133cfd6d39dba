"""From far to near: where edges are pixels apart, images are blurred first, and few rays suffice.

An edge that is farther off than its own blur says not in which direction it lies. A blur of both images lets it say
so. The widest blur is a share of the image; each further one is half as wide, and the last one a pixel.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.fitting.captured import Captured
from radwrap.fitting.free_keys import FreeKey
from radwrap.fitting.prediction import Part, Prediction
from radwrap.fitting.steps import STILL, Weights, through_grain
from radwrap.fitting.weights import floor_gray

Array = NDArray[np.float64]
COARSER: Final = 8.0  # times the fit's tolerance
_WIDEST: Final = 1 / 4  # of the shorter side: the sigma of a Gaussian blur
_NARROWEST: Final = 1.0  # px
# Deviations of the whole image: so much it counts that a key has gone by its own value at one blur. What shows less, as
# a beam's width, is led to infinity by images that do not lie on each other yet. Where it counted 1, a focal length
# went from 12 mm to 21 mm.
_HELD: Final = 4.0
_NOTHING: Final = 1e-6  # share of a blur's weight on pixels that count: such a mean is of none


def approached(
    keys: Sequence[FreeKey], prediction: Prediction, captured: Sequence[Captured], tolerance: float
) -> Array:
    """Values from which the fit itself may begin.

    Parameters
    ----------
    keys : sequence of FreeKey
        With the values where the user begins.
    prediction : Prediction
        By few rays.
    captured : sequence of Captured
        One for each state of the bench.
    tolerance : float
        Of that prediction [gray level]: nothing smaller is looked at.

    Returns
    -------
    ndarray, shape (keys,)
        Those of the user, where none agree better.
    """
    begun = np.array([key.value for key in keys])
    scales = np.array([key.scale for key in keys])
    bounds = np.array([[key.low, key.high] for key in keys]).T
    values = begun
    held_by = np.array([_held(key) for key in keys])
    for width in _widths(min(captured[0].mean.shape)):
        blurred = _Blurred(prediction, tuple(captured), width, tolerance)
        if blurred.rms(values) > STILL:
            values = through_grain(blurred, values, scales, bounds, held_by=held_by).values
    sharp = _Blurred(prediction, tuple(captured), 0.0, tolerance)
    return values if sharp.rms(values) < sharp.rms(begun) else begun


def _held(key: FreeKey) -> float:
    """What it counts that a key has gone by its scale, in deviations of the whole image."""
    if key.value or np.isfinite(key.high - key.low):
        return _HELD
    # A value of 0 without bounds, a pose's say, has no scale of its own; a turn has, as it comes to its begin again.
    return _HELD * math.radians(1.0) if key.unit == "deg" else 0.0


def _widths(side: int) -> Iterator[float]:
    width = side * _WIDEST
    while width >= _NARROWEST:
        yield width
        width /= 2


@dataclass(frozen=True, slots=True, eq=False)
class _Blurred:
    """Captures and predictions, both as the sensor gives them, both blurred.

    Attributes
    ----------
    prediction : Prediction
        By few rays.
    captured : tuple of Captured
        One for each state.
    width : float
        Sigma of the blur [px].
    tolerance : float
        The deviation of the whole that is one [gray level].
    """

    prediction: Prediction
    captured: tuple[Captured, ...]
    width: float
    tolerance: float

    def rms(self, values: Array) -> float:
        """Of what is left, over the tolerance."""
        return float(np.linalg.norm(self.left(values, self.weights(values))))

    def weights(self, values: Array) -> Weights:
        """All pixels that count, alike: a step is one where the rms difference is the tolerance."""
        used = np.concatenate([one.mask for one in self.captured])
        count = int(np.count_nonzero(used))
        return Weights(used, np.full(count, self.tolerance * np.sqrt(count)))

    def left(self, values: Array, weights: Weights) -> Array:
        """Blurred (captured - predicted)/sigma of the used pixels."""
        parts = self.prediction.at(values).parts
        off = [self._blur(one.mean - _shown(part), one) for part, one in zip(parts, self.captured, strict=True)]
        return np.asarray(np.concatenate(off)[weights.used] / weights.sigma)

    def slopes(self, values: Array, weights: Weights) -> Array:
        """Change of the blurred prediction with each key's scale, over sigma; none where the sensor cuts."""
        parts = self.prediction.at(values).parts
        found = []
        for slope in self.prediction.slopes(values, self.width):
            images = np.split(slope, len(parts))
            seen = [
                self._blur(np.where(_shown(part) == part.unclipped, image, 0.0), one)
                for image, part, one in zip(images, parts, self.captured, strict=True)
            ]
            found.append(np.concatenate(seen)[weights.used] / weights.sigma)
        return np.stack(found, axis=1)

    def _blur(self, image: Array, captured: Captured) -> Array:
        """Means over the pixels that count near each."""
        from scipy.ndimage import gaussian_filter

        counted = captured.mask.astype(np.float64)
        if not self.width:
            return np.asarray(image * counted)
        share = gaussian_filter(counted, self.width)
        return np.asarray(gaussian_filter(image * counted, self.width) / np.maximum(share, _NOTHING))


def _shown(part: Part) -> Array:
    """Gray levels as the sensor cuts them."""
    return np.asarray(np.clip(part.unclipped, floor_gray(part.sensor), part.sensor.saturation_gray))
