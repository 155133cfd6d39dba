"""How far what goes into a prediction may be off its stated value."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

# A tolerance is the half-width of the interval that holds the true value in 95 of 100 cases, a normal distribution.
TO_STANDARD: Final = 1 / 1.959963984540054


@dataclass(frozen=True, slots=True)
class Tolerances:
    """Half-widths of 95 % intervals; 0 where a value is taken as exact.

    Attributes
    ----------
    source_radiance : float
        Of all sources together, as a share: the standard that they were measured against.
    each_source_radiance : float
        Of each emitter for itself, as a share.
    aperture_diameter : float
        Of d_p, or of the diameter that sets the exposure of an infinitesimal pinhole [m].
    exposure_time : float
        [s].
    sensor_gain : float
        Of K in Eq. 5, as a share; of a linear camera's responsivity.
    dark_gray : float
        Of the gray level without light [gray level].
    """

    source_radiance: float = 0.0
    each_source_radiance: float = 0.0
    aperture_diameter: float = 0.0
    exposure_time: float = 0.0
    sensor_gain: float = 0.0
    dark_gray: float = 0.0
