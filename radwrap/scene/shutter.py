"""When the rows of a sensor are exposed, and when a pulsed source shines.

Time 0 is the start of row 0. Where a rolling read-out goes up, the other rows are exposed before that.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Readout = Literal["down", "up"]


@dataclass(frozen=True, slots=True)
class Shutter:
    """A shutter that does not expose all rows at once; without one they are.

    Attributes
    ----------
    kind : str
        "rolling": each row is exposed as long, one line time after the row before it; "global_reset": all rows begin
        at time 0, and each is read out, which ends it, one line time after the row before it.
    line_time : float
        From one row to the next [s].
    readout : str
        "down" from the first row to the last, or "up".
    """

    kind: Literal["rolling", "global_reset"]
    line_time: float
    readout: Readout = "down"


@dataclass(frozen=True, slots=True)
class Strobe:
    """Pulses of a source, whose level is that of the pulse.

    Attributes
    ----------
    delay : float
        Start of the first pulse [s].
    width : float
        Length of each pulse [s].
    period : float, optional
        From one pulse to the next, without an end [s]; without it there is one pulse.
    """

    delay: float
    width: float
    period: float | None = None


def row_windows(shutter: Shutter | None, rows: int, exposure_time: float) -> tuple[Array, Array]:
    """Start and end of each row's exposure [s], each of shape (rows,)."""
    start, end = np.zeros(rows), np.full(rows, exposure_time)
    if shutter is None:
        return start, end
    later = np.arange(rows) * shutter.line_time
    if shutter.kind == "rolling":
        later = -later if shutter.readout == "up" else later
        return start + later, end + later
    return start, end + (later[::-1] if shutter.readout == "up" else later)


def lit_moments(strobe: Strobe | None, time: Array) -> tuple[Array, Array]:
    """Integrals of 1 and of t over the time up to `time` [s, s^2] in which a source shines.

    Without a strobe it always does; both integrals are then counted from time 0.
    """
    time = np.asarray(time, dtype=np.float64)
    if strobe is None:
        return time, time**2 / 2
    after = np.maximum(time - strobe.delay, 0.0)
    width = strobe.width
    if strobe.period is None:
        part = np.minimum(after, width)
        zeroth, first = part, part**2 / 2
    else:
        whole = np.floor(after / strobe.period)
        part = np.clip(after - whole * strobe.period, 0.0, width)
        zeroth = whole * width + part
        first = strobe.period * width * whole * (whole - 1) / 2 + whole * width**2 / 2
        first = first + part * whole * strobe.period + part**2 / 2
    return zeroth, first + strobe.delay * zeroth


def lit_time(strobe: Strobe | None, start: Array, end: Array) -> Array:
    """How long a source shines between two times [s]."""
    found: Array = lit_moments(strobe, end)[0] - lit_moments(strobe, start)[0]
    return np.maximum(found, 0.0)


def shares_of_times(strobe: Strobe | None, start: Array, end: Array, times: Array) -> Array:
    """How long each of some times counts, where light goes straight from one time to the next.

    Parameters
    ----------
    strobe : Strobe, optional
        Of the source.
    start, end : ndarray, shape (rows,)
        Of each row's exposure [s].
    times : ndarray, shape (n,)
        Increasing [s]; the first and the last light hold beyond them.

    Returns
    -------
    ndarray, shape (rows, n)
        Weights w [s] with sum_k w_k L(t_k) = integral over the row's exposure of L, while the source shines.
    """
    weights = np.zeros((len(start), len(times)))
    inner = np.clip(times[np.newaxis, :], start[:, np.newaxis], end[:, np.newaxis])
    edges = np.concatenate([start[:, np.newaxis], inner, end[:, np.newaxis]], axis=1)
    zeroth, first = (np.diff(moment, axis=1) for moment in lit_moments(strobe, edges))
    weights[:, 0] += zeroth[:, 0]
    weights[:, -1] += zeroth[:, -1]
    if len(times) > 1:
        low, high = times[:-1], times[1:]
        between = zeroth[:, 1:-1], first[:, 1:-1]
        weights[:, :-1] += (high * between[0] - between[1]) / (high - low)
        weights[:, 1:] += (between[1] - low * between[0]) / (high - low)
    return np.maximum(weights, 0.0)
