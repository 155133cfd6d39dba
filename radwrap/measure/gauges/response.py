"""From gray levels back to light: the inverse of G = K H^gamma + G0, and which pixels can be used."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.images import GrayImage

Array = NDArray[np.float64]
GAMMA_RANGE = (0.1, 5.0)


@dataclass(frozen=True, slots=True)
class Response:
    """What is known of the camera.

    Attributes
    ----------
    dark : float or None
        Gray level without light, G0 of Eq. 5; None where it is not known, which serves as long as gamma is 1.
    gamma : float
        Exponent of the response.
    saturation : float or None
        Gray level from which a pixel is left out; None for the largest of the image's bits.
    """

    dark: float | None = None
    gamma: float = 1.0
    saturation: float | None = None

    def __post_init__(self) -> None:
        for name in ("dark", "saturation"):
            value = getattr(self, name)
            if value is not None and not math.isfinite(value):
                raise InputError("is not a finite number", where=name)
        if not GAMMA_RANGE[0] <= self.gamma <= GAMMA_RANGE[1]:
            raise InputError(f"must lie between {GAMMA_RANGE[0]:g} and {GAMMA_RANGE[1]:g}", where="gamma")
        if self.gamma != 1 and self.dark is None:
            raise InputError("needs the gray level without light", where="gamma", remedy="give dark too")


@dataclass(frozen=True, slots=True, eq=False)
class Light:
    """Light on the pixels, in gray levels of a camera with gamma 1.

    Attributes
    ----------
    values : ndarray, shape (rows, columns)
        Above dark, where that is known.
    usable : ndarray of bool, shape (rows, columns)
        False where the pixel is saturated.
    slope : ndarray, shape (rows, columns)
        d values / d gray.
    """

    values: Array
    usable: NDArray[np.bool_]
    slope: Array


def light_of(image: GrayImage, response: Response) -> Light:
    """Undo the camera's response.

    Raises
    ------
    InputError
        If dark lies above full scale.
    """
    full = float(2**image.bit_depth - 1)
    usable = image.values < (full if response.saturation is None else response.saturation)
    dark = response.dark or 0.0
    if dark >= full:
        raise InputError(f"{dark:g} is not below full scale, gray {full:g}", where="dark")
    above = image.values - dark
    if response.gamma == 1:
        return Light(above, usable, np.ones_like(above))
    top, power = full - dark, 1 / response.gamma
    share = np.abs(above) / top
    # Below one gray level the slope of a gamma above 1 grows without end, and rounding hides it.
    slope = power * np.maximum(share, 1 / top) ** (power - 1)
    return Light(np.sign(above) * top * share**power, usable, slope)
