"""What a search for an image to a tolerance says of itself: what was expected, what was tried."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from radwrap.imaging.demand import SamplingPlan, ToleranceMethod
from radwrap.manifest import ONLY_WHERE_USED
from radwrap.written import Count, NotNegative, Positive, Rays

GivenUp = Literal["out of time", "out of rays"]


@dataclass(frozen=True, slots=True)
class Attempt:
    """An image that was made, and its bounds.

    Attributes
    ----------
    method : str
        "kernel", "rays" or "hybrid".
    aim_gray : float or None
        Rms error that was aimed at [gray level]; None where a plan was given.
    replicates : int
        Whose mean it is.
    rays : int
        That they took.
    rms_gray_upper95, p99_gray_upper95 : float or None
        As in its certificate [gray level].
    """

    method: ToleranceMethod
    aim_gray: Positive | None
    replicates: Count
    rays: Rays
    rms_gray_upper95: NotNegative
    p99_gray_upper95: NotNegative | None


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchRecord:
    """How an image came about; the manifest's ``plan``.

    Attributes
    ----------
    method : str
        "kernel", "rays" or "hybrid".
    why : str
        Why this method.
    expected_rays : Mapping[str, int]
        Method -> rays that were expected of it, where it can be used.
    expected_model_rms_gray : float or None
        Error of the kernel's model that was expected; None where that is not finite [gray level].
    one_layer_rms_gray : float
        Error of a kernel of one layer that was expected [gray level].
    layers : int or None
        Of the kernel, also of one that is corrected.
    base_cell_px, grid_cell_px : float or None
        Size of the kernel's coarsest and finest cells [px].
    met : bool
        Whether the tolerance is kept.
    reproducible : bool
        Whether the same input gives the same bytes: not within a budget of time.
    sampling : SamplingPlan or None
        The plan that was given.
    attempts : tuple of Attempt
        In their order.
    rays : int
        Of all of them, certificates and survey with them.
    given_up : str or None
        Why the last attempt was left.
    """

    method: ToleranceMethod
    why: str
    expected_rays: Mapping[ToleranceMethod, Rays]
    expected_model_rms_gray: NotNegative | None
    one_layer_rms_gray: NotNegative
    layers: Rays | None
    base_cell_px: Positive | None
    grid_cell_px: Positive | None
    met: bool
    reproducible: bool
    sampling: SamplingPlan | None = field(default=None, metadata=ONLY_WHERE_USED)
    attempts: tuple[Attempt, ...] = ()
    rays: Rays = 0
    given_up: GivenUp | None = field(default=None, metadata=ONLY_WHERE_USED)
