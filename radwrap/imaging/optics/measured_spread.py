"""What passes of each frequency through a lens of which it was measured how it spreads the light of a point in focus.

The picture of a point holds what diffraction and aberrations do together, so
it stands in place of waves: its transform, times that of the opening's
magnified shape out of focus, which rays see. The picture is erect and shows
where a point's light goes; what a pixel gathers from is that turned by half a
turn. Samples are taken for those of a curve that has no frequency above theirs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.optics.transfer import Transfer
from radwrap.scene.aberrations import PointSpread
from radwrap.scene.camera import Aperture

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class MeasuredSpread:
    """A measured point spread.

    Attributes
    ----------
    spread : PointSpread
        As the scene has it.
    """

    spread: PointSpread

    @property
    def highest_frequency(self) -> float:
        """Above it samples tell nothing [m^-1]."""
        return 0.5 / self.spread.pitch

    def transfer_up_to(
        self,
        aperture: Aperture,
        image_distance: float,
        wavelength: float,
        magnification: float,
        *,
        perfect: Callable[[float], Transfer],
    ) -> Transfer:
        """As of `PupilPath`; what is perfect here is rays."""
        del aperture, image_distance, wavelength  # they are in what was measured
        values = np.array(self.spread.rows)
        y, x = (
            (np.arange(size) - middle) * self.spread.pitch
            for size, middle in zip(values.shape, self.spread.middle, strict=True)
        )
        return partial(self._passed, values / values.sum(), x, y, defocused=perfect(magnification))

    def _passed(self, values: Array, x: Array, y: Array, across: Array, down: Array, *, defocused: Transfer) -> Complex:
        across, down = np.asarray(across, dtype=np.float64), np.asarray(down, dtype=np.float64)
        # Turned: what lies at x in the picture is gathered at -x.
        of_columns = np.exp(2j * np.pi * across[..., np.newaxis] * x)
        of_rows = np.exp(2j * np.pi * down[..., np.newaxis] * y) @ values
        if across.ndim == 2 and across.shape[0] == 1 and down.shape[1] == 1:
            found = of_rows[:, 0] @ of_columns[0].T
        else:
            found = (of_rows * of_columns).sum(axis=-1)
        known = (np.abs(across) <= self.highest_frequency) & (np.abs(down) <= self.highest_frequency)
        passed: Complex = np.where(known, found, 0.0) * defocused(across, down)
        return passed
