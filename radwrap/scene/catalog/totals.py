"""Totals that a data sheet prints and that follow from its other numbers: computed anew, a misprint shows.

After EMVA 1288, all of electrons::

    mu_e.min = sqrt(sigma_d^2 + 1/(12 K^2)) + 1/2     absolute sensitivity threshold
    DR = 20 lg(mu_e.sat/mu_e.min)                      dynamic range [dB]
    SNR_max = 10 lg(mu_e.sat)                          [dB]
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from radwrap.errors import InputError
from radwrap.scene.catalog.component import Component
from radwrap.units import ELECTRONS, SYSTEM_GAIN, parse_quantity

# Honest sheets differ from their own totals: rounding, other noise in the threshold, another full well.
MARGIN_DB: Final = 1.0


@dataclass(frozen=True, slots=True)
class Total:
    """A published total, and what it follows from.

    Attributes
    ----------
    key, published : str
        As the file has it.
    computed : float
        From the file's other keys, in dB; a threshold in electrons.
    difference_db : float
        Published less computed [dB].
    allowed_db : float
        Rounding of the published number, and 1 dB.
    """

    key: str
    published: str
    computed: float
    difference_db: float
    allowed_db: float

    @property
    def agrees(self) -> bool:
        """Whether the difference is one of rounding and usage."""
        return abs(self.difference_db) <= self.allowed_db


def totals_of(component: Component, where: str) -> tuple[Total, ...]:
    """The published totals of a sensor, computed anew.

    Parameters
    ----------
    component : Component
        The sensor.
    where : str
        File, for messages.

    Raises
    ------
    InputError
        If a total is unknown, is no quantity, or lacks the keys that it follows from.
    """
    told = component.catalog.get("published", {})
    if not isinstance(told, dict):
        raise InputError("must be a table", where=f"{where}: catalog.published")
    return tuple(_total(key, told[key], component.values, f"{where}: catalog.published.{key}") for key in told)


def threshold(read_noise: float, system_gain: float) -> float:
    """Electrons at which the signal is as large as its noise.

    Parameters
    ----------
    read_noise : float
        sigma_d [e].
    system_gain : float
        K [DN/e].
    """
    return math.sqrt(read_noise**2 + 1 / (12 * system_gain**2)) + 0.5


def _total(key: str, published: object, values: Mapping[str, Any], where: str) -> Total:
    known = _KNOWN.get(key)
    if known is None:
        raise InputError("is not a known total", where=where, remedy=f"known: {', '.join(_KNOWN)}")
    unit, formula = known
    number, space, written = published.partition(" ") if isinstance(published, str) else ("", "", "")
    try:
        value = float(number)
        if not space or written != unit or not 0 < value < math.inf:
            raise ValueError
    except ValueError as error:
        raise InputError(f'must be a number above zero in {unit}, such as "70.5 {unit}"', where=where) from error
    computed = formula(values, where)
    half = 0.5 * 10.0 ** -len(number.partition(".")[2])
    if unit == "dB":
        return Total(key, f"{published}", computed, value - computed, half + MARGIN_DB)
    rounding = 20 * math.log10(1 + half / value)
    return Total(key, f"{published}", computed, 20 * math.log10(value / computed), rounding + MARGIN_DB)


def _electrons(values: Mapping[str, Any], key: str, where: str) -> float:
    return _positive(values, key, where, lambda text: parse_quantity(text, ELECTRONS))


def _positive(values: Mapping[str, Any], key: str, where: str, read: Callable[[str], float]) -> float:
    value = read(values[key]) if isinstance(values.get(key), str) else 0.0
    if not value > 0:
        raise InputError(f"follows from {key}, which the file lacks", where=where)
    return value


def _threshold(values: Mapping[str, Any], where: str) -> float:
    gain = _positive(values, "system_gain", where, lambda text: parse_quantity(text, SYSTEM_GAIN))
    return threshold(_electrons(values, "read_noise", where), gain)


def _dynamic_range(values: Mapping[str, Any], where: str) -> float:
    return 20 * math.log10(_electrons(values, "full_well", where) / _threshold(values, where))


def _snr_max(values: Mapping[str, Any], where: str) -> float:
    return 10 * math.log10(_electrons(values, "full_well", where))


_KNOWN: Final[Mapping[str, tuple[str, Callable[[Mapping[str, Any], str], float]]]] = {
    "dynamic_range": ("dB", _dynamic_range),
    "snr_max": ("dB", _snr_max),
    "absolute_sensitivity_threshold": ("e", _threshold),
}
