"""The linear camera of EMVA 1288 (release 4.0): from photons to electrons to gray levels.

::

    mu_p = H A lambda / (h c)              photons on the pixel's area A
    mu_e = eta mu_p + mu_d                 electrons; mu_d = mu_I tau, the dark signal
    mu_y = offset + K min(mu_e, full well) gray level (digital number, DN)

Its mean is Eq. 5 with gamma 1, so that all that is known of Eq. 5 holds for
it; what it adds is noise. Source: key emva1288.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

PLANCK: Final = 6.62607015e-34  # J s, exact
LIGHT: Final = 299792458.0  # m/s, exact


@dataclass(frozen=True, slots=True)
class LinearSensor:
    """What a data sheet tells of a linear camera, in electrons.

    Attributes
    ----------
    wavelength : float
        Of the light [m].
    quantum_efficiency : float
        eta at that wavelength, electrons a photon on the whole pixel: fill factor and microlens are in it.
    system_gain : float
        K [DN/e].
    offset : float
        Gray level of no electrons.
    full_well : float
        Electrons at which the pixel saturates.
    dark_signal : float
        mu_d, electrons of the dark current in one exposure.
    read_noise : float
        Standard deviation [e].
    dsnu, prnu : float
        Standard deviation between pixels of the dark signal [e], and of the responsivity (a share).
    hot_share, dead_share : float
        Shares of the pixels that always saturate, and that never see light.
    device_seed : int
        Decides which specimen it is: its DSNU, PRNU and defects.
    """

    wavelength: float
    quantum_efficiency: float
    system_gain: float
    offset: float
    full_well: float
    dark_signal: float
    read_noise: float
    dsnu: float
    prnu: float
    hot_share: float
    dead_share: float
    device_seed: int

    def photons_of_exposure(self, pixel_area: float) -> float:
        """Photons on a pixel for each J/m^2: A lambda/(h c) [m^2 J^-1]."""
        return pixel_area * self.wavelength / (PLANCK * LIGHT)

    def electrons_of_exposure(self, pixel_area: float) -> float:
        """Electrons in a pixel for each J/m^2 [m^2 J^-1]."""
        return self.quantum_efficiency * self.photons_of_exposure(pixel_area)

    def dark_gray(self) -> float:
        """Mean gray level without light."""
        return self.offset + self.system_gain * self.dark_signal

    def saturation_gray(self, bit_depth: int) -> float:
        """Highest gray level: of the full well, or of the converter."""
        return min(self.offset + self.system_gain * self.full_well, 2.0**bit_depth - 1)


def dark_current_at(current: float, temperature: float, reference: float, doubling: float) -> float:
    """Dark current [e/s] at a temperature, from that at a reference; it doubles every `doubling` kelvin.

    Infinite where that overflows.
    """
    if current == 0:
        return 0.0
    try:
        return current * math.pow(2.0, (temperature - reference) / doubling)
    except OverflowError:
        return math.inf
