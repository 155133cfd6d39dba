"""Distributions that a value of a scene is drawn from.

A value is drawn as the scene file would hold it, with the unit of the
distribution's own values and nine digits, so that a manifest shows what was
rendered.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.frames import Rotation, fixed_axis_angles
from radwrap.study.factors import Draw, quantity, read_draw, written

_ANY: Final = "any"


@dataclass(frozen=True, slots=True)
class LogUniform:
    """A value whose logarithm is uniform: between two values above zero, in `unit`."""

    low: float
    high: float
    unit: str

    def value(self, random: np.random.Generator) -> Any:
        """One value, as the scene file would hold it."""
        return written(math.exp(random.uniform(math.log(self.low), math.log(self.high))), self.unit)

    @property
    def ends(self) -> tuple[Any, ...]:
        """Values to be checked beforehand: the limits."""
        return written(self.low, self.unit), written(self.high, self.unit)


@dataclass(frozen=True, slots=True)
class Choice:
    """One of some values, each with its probability."""

    values: tuple[Any, ...]
    weights: tuple[float, ...]

    def value(self, random: np.random.Generator) -> Any:
        """One of the values."""
        return self.values[int(random.choice(len(self.values), p=self.weights))]

    @property
    def ends(self) -> tuple[Any, ...]:
        """Values to be checked beforehand: all."""
        return self.values


@dataclass(frozen=True, slots=True)
class RandomRotation:
    """A rotation that is uniform over SO(3), or over all angles about an axis.

    Attributes
    ----------
    axis : tuple of float, optional
        Unit vector in the world; without it the rotation is uniform over SO(3), by Haar's measure.
    """

    axis: tuple[float, float, float] | None = None

    def matrix(self, random: np.random.Generator) -> Rotation:
        """One rotation: of four equal normal numbers every direction is as likely, and so is every unit quaternion."""
        from scipy.spatial.transform import Rotation as Turn

        if self.axis is None:
            turn = Turn.from_quat(random.standard_normal(4))
        else:
            turn = Turn.from_rotvec(random.uniform(0.0, 2 * math.pi) * np.asarray(self.axis))
        rows: NDArray[np.float64] = turn.as_matrix()
        a, b, c = ((float(x), float(y), float(z)) for x, y, z in rows)
        return a, b, c

    def value(self, random: np.random.Generator) -> list[str]:
        """Three angles about the world's fixed axes x, y, z, carried out in this order."""
        return [written(math.degrees(angle), "deg") for angle in fixed_axis_angles(self.matrix(random))]

    @property
    def ends(self) -> tuple[Any, ...]:
        """A value to be checked beforehand."""
        return (["0.0 deg", "0.0 deg", "0.0 deg"],)


Distribution = Draw | LogUniform | Choice | RandomRotation


def read_distribution(kind: str, told: Any, weights: Any, where: str) -> Distribution:
    """A distribution as the dataset's file writes it.

    Raises
    ------
    InputError
        If it is none.
    """
    match kind:
        case "choice":
            return _choice(told, weights, where)
        case "rotation":
            return read_rotation(told, where)
        case "log_uniform":
            pair = read_draw({"uniform": told}, where)
            if pair.first <= 0:
                raise InputError("log_uniform needs values above zero", where=where)
            return LogUniform(pair.first, pair.second, pair.unit)
    return read_draw({kind: told}, where)


def read_rotation(told: Any, where: str) -> RandomRotation:
    """``"any"``, or ``{ axis = [x, y, z] }``; errors as `read_distribution`."""
    if told == _ANY:
        return RandomRotation()
    remedy = 'write "any" or { axis = [0, 0, 1] }'
    if not isinstance(told, Mapping) or set(told) != {"axis"} or not _is_direction(told["axis"]):
        raise InputError("is not a rotation", where=where, remedy=remedy)
    length = math.hypot(*told["axis"])
    if not 0 < length < math.inf:
        raise InputError("an axis needs a length above zero", where=where, remedy=remedy)
    x, y, z = (float(part) / length for part in told["axis"])
    return RandomRotation((x, y, z))


def _is_direction(told: Any) -> bool:
    return isinstance(told, Sequence) and len(told) == 3 and all(_is_number(part) for part in told)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < math.inf


def _choice(told: Any, weights: Any, where: str) -> Choice:
    if not isinstance(told, list) or not told:
        raise InputError("choice needs an array of values", where=where)
    if weights is None:
        return Choice(tuple(told), (1 / len(told),) * len(told))
    if not isinstance(weights, list) or len(weights) != len(told) or not all(map(_is_number, weights)):
        raise InputError(f"weights must be {len(told)} numbers, one for each value", where=where)
    total = math.fsum(weights)
    if min(weights) < 0 or not 0 < total < math.inf:
        raise InputError("weights must not be negative, and not all zero", where=where)
    return Choice(tuple(told), tuple(float(weight / total) for weight in weights))


def read_interval(told: Any, where: str) -> Draw | str:
    """Where a part may lie along an axis: a length, or two lengths of the same unit between which it is uniform."""
    if isinstance(told, list):
        return read_draw({"uniform": told}, where)
    found = quantity(told, where)
    if found is None or not found[1]:
        raise InputError("is not a length", where=where, remedy='write "5 mm" or ["-40 mm", "40 mm"]')
    return str(told)
