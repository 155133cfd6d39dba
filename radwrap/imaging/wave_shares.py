"""What of a tolerance an image leaves to its waves, and what more rays and smaller cells may do about either."""

from __future__ import annotations

import math
from typing import Final

from radwrap.imaging.mean_radiance import Made
from radwrap.imaging.tolerance.bounds import NOTHING
from radwrap.imaging.tolerance.certificate import Certificate
from radwrap.imaging.tolerance.wave_image import WaveError

LEAST_LEFT: Final = 0.3  # of the tolerance; where the image leaves less, it is made finer
OF_CELLS: Final = 0.5  # of what the image leaves, what the size of their cells may change
FINER: Final = 0.25  # of either, where it was too much
LESS: Final = 0.8  # of the tolerance is left to the rays' own image, where both together break it


def leaves(tolerance: float, made: Made) -> float:
    """What an image leaves of a tolerance for its waves [gray level]."""
    return math.sqrt(max(tolerance**2 - beside_waves(made).rms_gray_upper95 ** 2, 0.0))


def beside_waves(made: Made) -> Certificate:
    """The certificate of an image as it counts in that of one with waves."""
    return made.certificate.with_waves(NOTHING, 0.0, 0.0, 0.0, parts=made.outcome.parts if made.outcome else ())


def left_to_waves(tolerance: float, made: Made) -> float:
    """What waves may be off by [gray level]; of an image that misses the tolerance, as where a budget ended it, more.

    Waves that are surer than their image by far take rays for nothing.
    """
    return max(leaves(tolerance, made), LEAST_LEFT * max(tolerance, beside_waves(made).rms_gray_upper95))


def left_to_image(square: float, off: WaveError) -> float:
    """What the image may be off by where both have so much [gray level]; of waves that take more than half, half."""
    return math.sqrt(square - min(off.noise.upper + off.cells - off.lasting, square / 2))


def finer(tolerance: float, made: Made, off: WaveError, *, least: float) -> tuple[float, float]:
    """Shares of both aims, of noise and of cells, by which either is expected to be its part of what the rest leaves.

    Where one of them is not 1, it is at most `least`: what is made goes by steps.
    """
    rest = max(leaves(tolerance, made) ** 2 - off.tails**2 - off.lasting, 0.0)
    parts = (off.noise.upper, (1 - OF_CELLS**2) * rest), (off.cells - off.lasting, OF_CELLS**2 * rest)
    noise, cells = (
        1.0 if found <= most else min(least, max(FINER, LESS * math.sqrt(most / found))) for found, most in parts
    )
    return noise, cells
