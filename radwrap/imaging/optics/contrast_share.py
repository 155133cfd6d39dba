"""What waves pass of each frequency through a lens of which a data sheet tells the contrast.

The optical transfer of defocus at this opening, times the share that the table
has of the diffraction limit's contrast. A contrast does not tell the phase: the
point spread that belongs to it without any is one choice of many, alike from
both sides, and may fall a little below zero.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.optics.transfer import Transfer
from radwrap.scene.camera import Aperture

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_HALF: Final = 0.5


@dataclass(frozen=True, slots=True)
class ContrastShare:
    """Share of the diffraction limit's contrast, at one place of the field.

    Attributes
    ----------
    frequencies : tuple of float
        From 0 on, increasing [m^-1].
    tangential, sagittal : tuple of float
        Shares along the radius of the field and across it, 1 at the frequency 0.
    azimuth : float
        Of that radius, from x to the right towards y up [rad].
    """

    frequencies: tuple[float, ...]
    tangential: tuple[float, ...]
    sagittal: tuple[float, ...]
    azimuth: float

    @property
    def reach(self) -> float:
        """About how far light is spread: half a period of the frequency of which half is left, 0 where none is [m]."""
        low = np.minimum(self.tangential, self.sagittal) < _HALF
        return 0.5 / self.frequencies[int(low.argmax())] if low.any() else 0.0

    def transfer_up_to(
        self,
        aperture: Aperture,
        image_distance: float,
        wavelength: float,
        magnification: float,
        *,
        perfect: Callable[[float], Transfer],
    ) -> Transfer:
        """As of `PupilPath`."""
        # Curves by scipy, which is loaded where a lens has a table only. Mirrored, they begin level.
        from scipy.interpolate import PchipInterpolator

        nodes = np.array(self.frequencies)
        both = np.concatenate([-nodes[:0:-1], nodes])
        curves = [
            PchipInterpolator(both, np.concatenate([values[:0:-1], values]))
            for values in (np.array(self.tangential), np.array(self.sagittal))
        ]
        return partial(self._passed, curves, perfect(magnification))

    def _passed(
        self, curves: list[Callable[[Array], Array]], defocused: Transfer, across: Array, down: Array
    ) -> Complex:
        frequency = np.minimum(np.hypot(across, down), self.frequencies[-1])
        along = np.cos(np.arctan2(-down, across) - self.azimuth) ** 2
        tangential, sagittal = (curve(frequency) for curve in curves)
        found: Complex = defocused(across, down) * (along * tangential + (1 - along) * sagittal)
        return found
