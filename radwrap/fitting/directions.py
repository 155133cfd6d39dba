"""In words, what captures do not determine."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_ZERO: Final = 1e-3  # of the largest part of a direction: a key that has no part in it
_WHOLE: Final = 0.01  # an exponent so near a simple one is that one
_SIMPLE: Final = (1.0, -1.0, 2.0, -2.0, 0.5, -0.5)


def in_words(null: Array, keys: Sequence[str], values: Array, scales: Array) -> list[str]:
    """A sentence for each direction that is not determined.

    Parameters
    ----------
    null : ndarray, shape (directions, keys)
        In units of the keys' scales.
    keys : sequence of str
        Names.
    values, scales : ndarray, shape (keys,)
        In the keys' units.
    """
    return [_sentence(direction * scales, keys, values, scales) for direction in reduced(null)]


def reduced(null: Array) -> Array:
    """Directions of the same space with as few keys in each as elimination leaves."""
    rows = np.array(null, dtype=np.float64)
    done = 0
    for column in range(rows.shape[1] - 1, -1, -1):
        if done == len(rows):
            break
        pivot = done + int(np.argmax(np.abs(rows[done:, column])))
        if abs(rows[pivot, column]) <= _ZERO * np.abs(rows[done:]).max():
            continue
        rows[[done, pivot]] = rows[[pivot, done]]
        rows[done] /= rows[done, column]
        for other in range(len(rows)):
            if other != done:
                rows[other] -= rows[other, column] * rows[done]
        done += 1
    return rows


def _sentence(change: Array, keys: Sequence[str], values: Array, scales: Array) -> str:
    # A value may have come to nearly nothing: a change of it is then not larger than all others.
    size = np.abs(change / np.maximum(np.abs(values), scales))
    parts = [number for number in np.argsort(-size, kind="stable") if size[number] > _ZERO * size.max()]
    parts.sort()
    names = [keys[number] for number in parts]
    if len(parts) == 1:
        return f"{names[0]} changes nothing that the captures show"
    # A change that goes with the values themselves is one of a product.
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = change[parts] / values[parts]
    if len(parts) == 2 and np.isfinite(relative).all():
        exponent = _simple(-relative[0] / relative[1])
        if exponent is not None:
            if exponent > 0:
                return f"{names[0]} and {names[1]} only as a product, {names[0]} x {_power(names[1], exponent)}"
            return f"{names[0]} and {names[1]} only as a quotient, {names[0]} / {_power(names[1], -exponent)}"
    # Its levels as one factor: all of some keys grow together, and the others fall.
    if np.isfinite(relative).all():
        first = np.abs(relative) / np.abs(relative[0])
        if np.all(np.abs(first - 1) < _WHOLE):
            grow = [name for name, part in zip(names, relative, strict=True) if part * relative[0] > 0]
            fall = [name for name, part in zip(names, relative, strict=True) if part * relative[0] < 0]
            if fall:
                return (
                    f"{', '.join(names[:-1])} and {names[-1]} only up to a factor on {' and '.join(grow)} that "
                    f"{' and '.join(fall)} {'takes' if len(fall) == 1 else 'take'} back: only as a product"
                )
    told = ", ".join(f"{name} by {part:+.3g}" for name, part in zip(names, change[parts], strict=True))
    return f"{', '.join(names[:-1])} and {names[-1]} only together: the prediction stays as it is where {told}"


def _simple(exponent: float) -> float | None:
    return next((simple for simple in _SIMPLE if abs(exponent - simple) < _WHOLE * abs(simple)), None)


def _power(name: str, exponent: float) -> str:
    return name if exponent == 1 else f"{name}^{exponent:g}"
