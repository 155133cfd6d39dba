"""What may be tried: plans of each method for an aim, what they are expected to take, and the advice of a survey."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from radwrap.imaging.demand import FEWEST, Demand, ToleranceMethod
from radwrap.imaging.methods.hybrid import HybridPlan, Seen
from radwrap.imaging.methods.kernel import KernelPlan, plan_kernel
from radwrap.imaging.methods.rays import plan_rays
from radwrap.imaging.optics.view import View
from radwrap.imaging.tolerance.bounds import Bounded
from radwrap.imaging.tolerance.certificate import root
from radwrap.imaging.tolerance.foreseen import Foreseen, foresee, seen_by
from radwrap.imaging.tolerance.points_noise import points_noise
from radwrap.imaging.tolerance.replicates import Plan, replicates_needed
from radwrap.imaging.tolerance.survey import AIM_SHARE, Survey, met_by, middle_of, predicted_rays
from radwrap.manifest import finite
from radwrap.tracers.noise import halvings_for

# What costs less than this share of the tolerance is left out: errors add as squares, so it takes 5 % of the tolerance.
NEGLIGIBLE_SHARE: Final = 0.3
# What one layer lacks lies at few edges, of which a survey sees too little. Several layers take as many rays, and only
# some more time to gather.
_ONE_LAYER_SHARE: Final = 0.1
# Where the model's error takes more than this share of the tolerance, rays are asked instead.
MODEL_SHARE: Final = 0.85
# Pixels where that may reach this share of the tolerance are looked at apart.
RISK_SHARE: Final = 0.1
# Of the square of a hybrid's aim so much goes to its kernel, the rest to its corrections; and where a kernel is there
# already, at most so much of it may be that kernel's noise.
_KERNEL_SHARE: Final = 0.5
# Of the square of a kernel's aim, for the noise of wide lights' points.
POINTS_SHARE: Final = 0.5
# Below this tolerance the usual cells are too coarse at any contrast that matters, and so are the fewest pairs: an edge
# of 100 gray that is shifted by 0.2 differs in one of 500 [gray level].
COARSE_TOLERANCE: Final = 0.25


@dataclass(frozen=True, slots=True)
class Choice:
    """What a survey advises.

    Attributes
    ----------
    method : str
        "kernel", "rays" or "hybrid".
    why : str
        The reason.
    one_layer : bool
        Whether the spread of depths is left out.
    model : Bounded
        Mean square error of that kernel's model [gray level^2].
    expected_rays : Mapping[str, int or None]
        What each method is expected to take; None where it cannot be used.
    """

    method: ToleranceMethod
    why: str
    one_layer: bool
    model: Bounded
    expected_rays: Mapping[str, int | None]

    def as_manifest(self) -> dict[str, Any]:
        """What is expected, before an image is made."""
        known = {key: value for key, value in self.expected_rays.items() if value is not None}
        return {"expected_rays": known, "expected_model_rms_gray": finite(root(self.model.mean))}


class Plans:
    """Plans for one image; what is learned from an attempt changes those of the next.

    Parameters
    ----------
    view : View
        Who traces.
    found : Survey
        Of it.
    demand : Demand
        What is asked for.
    seed : int
        Of what is looked at.

    Attributes
    ----------
    finer : int
        How often the kernel's cells are halved.
    one_layer : bool
        Whether the kernel leaves the spread of depths out.
    fewest : int
        Rays of a pixel at least.
    everywhere : bool
        Whether a hybrid looks at all pixels, not only at those near steps in depth.
    kernel : tuple, optional
        The last kernel that was made, its replicates, and the mean square of their noise where it would not be
        corrected [gray level^2].
    rays : int
        What was traced to look at steps.
    """

    def __init__(self, view: View, found: Survey, demand: Demand, seed: int) -> None:
        self.view, self.found, self.demand = view, found, demand
        self.finer = 1 if demand.tolerance < COARSE_TOLERANCE else 0
        self.one_layer = root(found.one_layer.upper) <= _ONE_LAYER_SHARE * demand.tolerance
        self.fewest = FEWEST
        self.everywhere = False
        self.kernel: tuple[KernelPlan, int, float] | None = None
        self._seed = seed
        self._points_square, self.rays = points_noise(view, seed)
        self._seen: Seen | None = None
        self._foreseen: dict[bool, Foreseen] = {}

    @property
    def model(self) -> Bounded:
        """Mean square error of the kernel that is planned [gray level^2]."""
        return self.found.one_layer if self.one_layer else self.found.model

    def first_aim(self, method: ToleranceMethod) -> float:
        """Rms error of the result to aim at."""
        model = max(self.model.mean, 0.0) if method == "kernel" else 0.0
        left = self.demand.tolerance**2 - (model if math.isfinite(model) else 0.0)
        return AIM_SHARE * math.sqrt(max(left, (0.3 * self.demand.tolerance) ** 2))

    def forecast(self, method: ToleranceMethod, aim: float) -> float:
        """Rays that are expected for an aim."""
        if method == "hybrid":
            plan, number = self.planned(method, aim)
            assert isinstance(plan, HybridPlan)  # noqa: S101  (of that method)
            kernel = self.forecast("kernel", math.sqrt(_KERNEL_SHARE) * aim)
            return kernel + self._foreseen_by(plan).corrections(plan, plan.aim, number)
        rays, kernel = predicted_rays(self.view, self.found, aim / AIM_SHARE, self.finer)
        return rays if method == "rays" else kernel

    def hybrid_rays(self) -> float:
        """Rays that a kernel with corrections is expected to take for what is asked; infinite where there is none."""
        if not math.isfinite(self.model.mean) or self.view.camera.aperture.is_infinitesimal:
            return math.inf
        self.everywhere = self.everywhere or self._fails_elsewhere()
        return self.forecast("hybrid", self.first_aim("hybrid"))

    def _fails_elsewhere(self) -> bool:
        """Whether the kernel's model fails at pixels of the survey that lie away from steps in depth too."""
        sensor, cost = self.view.camera.sensor, self._look().cost
        places = np.divmod(self.found.pixels, sensor.columns)
        at = tuple(
            place * number // size
            for place, number, size in zip(places, cost.shape, (sensor.rows, sensor.columns), strict=True)
        )
        rest = np.where(cost[at] > RISK_SHARE * self.demand.tolerance, 0.0, self.found.lacks)
        return root(float(rest.mean())) > MODEL_SHARE * self.demand.tolerance

    def _look(self) -> Seen:
        """What the survey's grid sees; looked at once."""
        if self._seen is None:
            self._seen, rays = seen_by(self.view, self.found)
            self.rays += rays
        return self._seen

    def _foreseen_by(self, plan: HybridPlan) -> Foreseen:
        if self.everywhere not in self._foreseen:
            self._foreseen[self.everywhere] = found = foresee(self.view, plan, self._seed)
            self.rays += found.rays
        return self._foreseen[self.everywhere]

    def _plan(self, method: ToleranceMethod, aim: float) -> Plan:
        if method == "hybrid":
            kernel = self._plan("kernel", math.sqrt(_KERNEL_SHARE) * aim)
            assert isinstance(kernel, KernelPlan)  # noqa: S101  (of that method)
            return self._hybrid(kernel, math.sqrt(1 - _KERNEL_SHARE) * aim)
        if method == "rays":
            return plan_rays(self.view, aim, self.fewest)
        met = met_by(self.view, self.found.magnification)
        plan = plan_kernel(self.view, middle_of(met) if self.one_layer else met, aim, self.finer)
        halvings = halvings_for(self._points_square, POINTS_SHARE * aim**2)
        # Of a power law's frame no noise is known that a length would have to be held against.
        edges = None if self.view.camera.sensor.linear is None else True
        return replace(plan, grid=replace(plan.grid, halvings=halvings, edges=edges))

    def _hybrid(self, kernel: KernelPlan, aim: float) -> HybridPlan:
        risk = RISK_SHARE * self.demand.tolerance
        return HybridPlan(kernel, aim, -1.0 if self.everywhere else risk, risk, self._look(), self.fewest)

    def planned(self, method: ToleranceMethod, aim: float) -> tuple[Plan, int]:
        """A plan for an rms error of the result, and how many replicates of it."""
        if method == "hybrid" and self.kernel is not None and self.kernel[2] <= _KERNEL_SHARE * aim**2:
            plan, number, noise = self.kernel
            return self._hybrid(plan, math.sqrt(aim**2 - noise) * math.sqrt(number)), number
        number = replicates_needed(self._plan(method, aim))
        return self._plan(method, aim * math.sqrt(number)), number


def choose(plans: Plans) -> Choice:
    """Pick the cheapest method whose model is expected to hold."""
    demand, model = plans.demand, plans.model
    rays, kernel = predicted_rays(plans.view, plans.found, demand.tolerance)
    expected = {"kernel": kernel, "rays": rays}
    method: ToleranceMethod = "rays"
    if demand.method is not None:
        method, why = demand.method, "asked for"
        if method == "hybrid":
            expected["hybrid"] = plans.hybrid_rays()
    elif math.isinf(kernel) or math.isinf(model.mean):
        why = "the scene is too deep for one central image"
    elif root(model.mean) > MODEL_SHARE * demand.tolerance:
        why = f"the kernel's model may be off by {root(model.mean):.3g} gray rms"
        expected["hybrid"] = plans.hybrid_rays()
        method = "rays" if rays < expected["hybrid"] else "hybrid"
    elif rays < kernel:
        why = "fewer rays are expected than for the kernel"
    else:
        method, why = "kernel", "fewest rays are expected, and its model holds"
    known = {name: math.ceil(value) if math.isfinite(value) else None for name, value in expected.items()}
    return Choice(method, why, plans.one_layer, model, known)


def kernel_of(plan: Plan) -> KernelPlan | None:
    """The kernel of a plan that has one."""
    if isinstance(plan, HybridPlan):
        return plan.kernel
    return plan if isinstance(plan, KernelPlan) else None


def method_of(plan: Plan) -> ToleranceMethod:
    """What a plan is called."""
    if isinstance(plan, HybridPlan):
        return "hybrid"
    return "kernel" if isinstance(plan, KernelPlan) else "rays"
