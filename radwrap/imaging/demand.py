"""What is asked of an image: how far its gray levels may be off, what it may cost, or how it is sampled."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Final, Literal

from radwrap.errors import InputError
from radwrap.manifest import ONLY_WHERE_USED

ToleranceMethod = Literal["kernel", "rays", "hybrid"]
EvenMethod = Literal["kernel", "rays"]
# Rays of a pixel.
FEWEST: Final = 4
MOST: Final = 1 << 14
# What is measured on them tells its own error by so many less one degrees of freedom: 1.96 of such standard
# deviations hold 92 % of the errors, where 8 replicates would hold 91 % and 2 would hold 70 %.
REPLICATES: Final = 12
FINEST_CELL: Final = 1 / 16  # px
COARSEST_CELL: Final = 64.0  # px
_MOST_REPLICATES: Final = 1000
_CELLS: Final = f"must be a power of 2 from {FINEST_CELL:g} to {COARSEST_CELL:g} px"
_OPTIONAL: Final = frozenset({"wave_cell", "wave_far"})


@dataclass(frozen=True, slots=True)
class Budget:
    """What a run may cost.

    Attributes
    ----------
    rays : float
        Rays in all.
    seconds : float
        Wall time [s]; an image that it stops cannot be made again.
    """

    rays: float = math.inf
    seconds: float = math.inf


@dataclass(frozen=True, slots=True)
class Demand:
    """What is asked for.

    Attributes
    ----------
    tolerance : float
        Largest rms error [gray level].
    max_error : float, optional
        Largest error of 99 % of the pixels [gray level].
    method : str, optional
        "kernel", "rays" or "hybrid"; default the cheapest that will do.
    budget : Budget
        What it may cost.
    """

    tolerance: float
    max_error: float | None = None
    method: ToleranceMethod | None = None
    budget: Budget = Budget()

    def is_met(self, rms: float, quantile: float | None) -> bool:
        """Whether bounds on an image's rms error, and on that of 99 % of its pixels, keep the tolerance."""
        return rms <= self.tolerance and (
            self.max_error is None or (quantile is not None and quantile <= self.max_error)
        )


@dataclass(frozen=True, slots=True)
class SamplingPlan:
    """How images that are compared are sampled, all alike.

    Attributes
    ----------
    method : str
        "kernel" or "rays".
    cell : float or None
        Of the kernel: cell of its grid, each with one ray, a power of 2 [px].
    layered : bool
        Of the kernel: whether depths are told apart.
    rays : int or None
        Of rays: how many each pixel gets in each replicate, a power of 2.
    replicates : int
        Independent images; their mean is the result, their differences its error.
    wave_cell : float or None
        Cell of the grid by which diffraction is taken, as `cell`; None where no image of the plan needs it: then only
        those have it whose scene says "on".
    wave_far : float or None
        Share of the light that diffraction may send farther than is looked at cell by cell; by None, and at least, what
        goes farther than some widths of its blur.
    """

    method: EvenMethod
    cell: float | None = None
    layered: bool = False
    rays: int | None = None
    replicates: int = REPLICATES
    wave_cell: float | None = field(default=None, metadata=ONLY_WHERE_USED)
    wave_far: float | None = field(default=None, metadata=ONLY_WHERE_USED)

    def __post_init__(self) -> None:
        if self.method not in ("kernel", "rays"):
            raise InputError('must be "kernel" or "rays"', where="method")
        cell_due = self.method == "kernel"
        if (self.cell is not None) != cell_due or (cell_due and not _is_power(self.cell, FINEST_CELL, COARSEST_CELL)):
            raise InputError(_CELLS, where="cell")
        if self.wave_cell is not None and not _is_power(self.wave_cell, FINEST_CELL, COARSEST_CELL):
            raise InputError(_CELLS, where="wave_cell")
        if self.wave_far is not None and not _is_share(self.wave_far):
            raise InputError("must be a number above 0 and at most 1", where="wave_far")
        if (self.rays is not None) == cell_due or not (cell_due or _is_power(self.rays, FEWEST, MOST)):
            raise InputError(f"must be a power of 2 from {FEWEST} to {MOST}", where="rays")
        if not isinstance(self.layered, bool):
            raise InputError("must be true or false", where="layered")
        if type(self.replicates) is not int or not 2 <= self.replicates <= _MOST_REPLICATES:
            raise InputError(f"must be a whole number from 2 to {_MOST_REPLICATES}", where="replicates")

    @property
    def rays_per_pixel(self) -> float:
        """In all replicates; what lies beside the image is not counted."""
        each = float(self.rays or 0) if self.cell is None else 1 / self.cell**2
        return self.replicates * each

    def as_json(self) -> dict[str, Any]:
        """As `sampling_plan` reads it."""
        return {key: value for key, value in asdict(self).items() if key not in _OPTIONAL or value is not None}


def sampling_plan(told: Any, where: str) -> SamplingPlan:
    """Read what `SamplingPlan.as_json` gave.

    Raises
    ------
    InputError
        Naming the key.
    """
    keys = set(SamplingPlan.__slots__)
    if not isinstance(told, Mapping) or {*told, *_OPTIONAL} != keys:
        raise InputError(f"must be a table of {', '.join(sorted(keys - _OPTIONAL))}", where=where)
    if told["rays"] is not None and type(told["rays"]) is not int:
        raise InputError("must be a whole number", where=f"{where}.rays")
    try:
        return SamplingPlan(**told)
    except InputError as error:
        raise InputError(error.what, where=f"{where}.{error.where}") from error


def _is_share(value: Any) -> bool:
    return type(value) in (int, float) and 0 < value <= 1


def _is_power(value: Any, low: float, high: float) -> bool:
    """Whether it is a power of 2 between limits."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        return False
    return math.frexp(value)[0] == 0.5
