"""Gray levels made linear in light, and back; what rounding to whole gray levels means there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LinearLight:
    """Inverse of Eq. 5, odd about dark so that noise there stays unbiased, scaled to the gray range.

    Attributes
    ----------
    dark : float
        Gray level without light.
    span : float
        Gray levels above dark of which light and gray have the same number.
    gamma : float
        Exponent of Eq. 5; 1 leaves gray levels as they are.
    sign : float
        -1 turns bright parts dark.
    """

    dark: float = 0.0
    span: float = 1.0
    gamma: float = 1.0
    sign: float = 1.0

    def light(self, gray: Array) -> Array:
        """Light of gray levels."""
        if self.gamma == 1:
            return self.sign * gray
        above = (gray - self.dark) / self.span
        return self.sign * self.span * np.sign(above) * np.abs(above) ** (1 / self.gamma)

    def gray(self, light: Array) -> Array:
        """Gray levels of light."""
        if self.gamma == 1:
            return self.sign * light
        above = self.sign * light / self.span
        return self.dark + self.span * np.sign(above) * np.abs(above) ** self.gamma

    def slope(self, light: Array) -> Array:
        """Light for each gray level; at dark, where it has no limit, that of half a gray level above."""
        if self.gamma == 1:
            return np.ones_like(light)
        above = np.maximum(np.abs(self.gray(light) - self.dark), 0.5) / self.span
        return above ** (1 / self.gamma - 1) / self.gamma
