"""Gray levels: the power law of Eq. 5 and the linear camera of EMVA 1288."""

from __future__ import annotations

from decimal import Decimal, localcontext
from typing import Any, Final

PLANCK, LIGHT_SPEED = 6.62607015e-34, 299792458.0  # J s, m s^-1: exact in the SI
ROUNDING: Final = 1 / 12  # variance of rounding to whole gray levels [DN^2]
_PRECISION: Final = 40  # decimal digits


def power_law(exposure: float, *, gain: float, gamma: float, dark_gray: float) -> float:
    """Eq. 5 without saturation, G = K H^gamma + G0, in 40 decimal digits.

    Parameters
    ----------
    exposure : float
        H [J m^-2].
    gain, gamma, dark_gray : float
        K [(J m^-2)^-gamma], gamma and G0.

    Returns
    -------
    float
        [gray level].
    """
    with localcontext() as context:
        context.prec = _PRECISION
        return float(Decimal(gain) * Decimal(exposure) ** Decimal(gamma) + Decimal(dark_gray))


def photons(exposure: Any, area: float, wavelength: float) -> Any:
    """mu_p = H A lambda/(h c): photons on a pixel (EMVA 1288, Eq. 2).

    Parameters
    ----------
    exposure : float or ndarray
        H [J m^-2].
    area, wavelength : float
        Of the pixel [m^2], of the light [m].
    """
    return exposure * area * wavelength / (PLANCK * LIGHT_SPEED)


def transfer_mean(electrons: Any, *, gain: float, offset: float) -> Any:
    """mu_y = mu_0 + K mu_e [DN] (EMVA 1288)."""
    return offset + gain * electrons


def transfer_variance(electrons: Any, *, gain: float, read_noise: float) -> Any:
    """sigma_y^2 = K^2 (sigma_d^2 + mu_e) + 1/12 (EMVA 1288).

    Parameters
    ----------
    electrons : float or ndarray
        mu_e, of which the variance is mu_e as well.
    gain, read_noise : float
        K [DN] for each electron; sigma_d [electrons].

    Returns
    -------
    float or ndarray
        [DN^2], with that of rounding.
    """
    return gain**2 * (read_noise**2 + electrons) + ROUNDING
