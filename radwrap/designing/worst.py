"""The worst case within tolerances: each candidate is also looked at in the corners of what a bench may be off by."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, Final

from radwrap.designing.tables import ToleranceModel
from radwrap.errors import InputError
from radwrap.scene.file.keys import expanded, found, set_key
from radwrap.study.factors import in_si, quantity, written
from radwrap.units import DIMENSIONS

PERCENT: Final = "%"
MOST: Final = 4  # tolerances: sixteen corners


@dataclass(frozen=True, slots=True)
class Allowed:
    """What something of the scene may be off by, up and down.

    Attributes
    ----------
    name : str
        Of its table.
    keys : tuple of str
        Key paths that are off together.
    by : float
        How much: in SI, or a share of the value.
    unit : str
        As it is written; "%" where it is a share.
    """

    name: str
    keys: tuple[str, ...]
    by: float
    unit: str

    def moved(self, document: Mapping[str, Any], sign: float, where: str) -> dict[str, Any]:
        """Tables in which the keys are off; of a value that is 0, a share is 0 too.

        Raises
        ------
        InputError
            If a key has no number in them, or one of another kind.
        """
        made: dict[str, Any] = deepcopy(dict(document))
        for path in self.paths(document):
            number, unit = _told(document, path, where)
            if self.unit == PERCENT:
                off = number * self.by
            elif not _are_alike(unit, self.unit):
                raise InputError(f"{path} is {found(document, path)}, and by has another unit", where=f"{where}.by")
            else:
                off = self.by / ((in_si(f"1 {unit}") or 1.0) if unit else 1.0)
            set_key(made, path, written(number + sign * off, unit), where)
        return made

    def paths(self, document: Mapping[str, Any]) -> list[str]:
        """Key paths of single values."""
        return [one for key in self.keys for one in expanded(key, document)]

    def refuse_nothing(self, document: Mapping[str, Any], where: str) -> None:
        """Refuse a share of what is 0 in the scene's own file.

        Raises
        ------
        InputError
            If it is one.
        """
        for path in self.paths(document) if self.unit == PERCENT else ():
            if not _told(document, path, where)[0]:
                raise InputError(
                    f"{path} is 0, of which a share is 0 too", where=f"{where}.by", remedy="give an amount"
                )


def _told(document: Mapping[str, Any], path: str, where: str) -> tuple[float, str]:
    """Number and unit at a key path."""
    value = found(document, path)
    told = None if value is None or isinstance(value, bool) else quantity(value, f"{where}: {path}")
    if told is None:
        raise InputError(f"{path} has no number in the scene file", where=where, remedy="write it there, with its unit")
    return told


def read_allowed(name: str, table: ToleranceModel, where: str) -> Allowed:
    """A tolerance from its table.

    Raises
    ------
    InputError
        If `by` is not a number above zero, with a unit or "%".
    """
    keys = (table.key,) if table.key is not None else table.keys or ()
    text = table.by
    if isinstance(text, str) and text.strip().endswith(PERCENT):
        return Allowed(name, keys, _share(text, f"{where}.by"), PERCENT)
    plain = quantity(text, f"{where}.by")
    size = None if plain is None else in_si(text)
    if plain is None or size is None or not size > 0:
        raise InputError("must be above zero", where=f"{where}.by", remedy='such as "0.5 mm", "3 %", or a bare number')
    return Allowed(name, keys, size, plain[1])


def _are_alike(one: str, other: str) -> bool:
    """Whether two units are of one dimension; two plain numbers are."""
    return one == other or any(one in kind.units and other in kind.units for kind in DIMENSIONS)


def _share(text: str, where: str) -> float:
    try:
        share = float(text.strip()[:-1]) / 100
    except ValueError:
        share = 0.0
    if not 0 < share < 1:
        raise InputError("must be a share between 0 and 100 %", where=where)
    return share
