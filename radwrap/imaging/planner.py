"""From a tolerance in gray levels to an image that is certified to keep it, by the cheapest method.

All decisions are made by counted rays and measured errors, never by a clock,
so that the same scene, tolerance and seed give the same bytes. Only a budget
in seconds breaks that.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.imaging.bounds import NOTHING, Bounded
from radwrap.imaging.certificate import (
    Certificate,
    PixelErrors,
    PixelSample,
    draw_pixels,
    model_errors,
    places_of,
    root,
)
from radwrap.imaging.footprint import reach_px
from radwrap.imaging.kernel import KernelPlan, plan_kernel
from radwrap.imaging.rays import ORDER, PILOT, RaysPlan, gray_deviation, plan_rays, sampled_radiance
from radwrap.imaging.replicates import Replicates, Work, discretisation, replicates_needed, trace_replicates
from radwrap.imaging.sensor import gray_levels
from radwrap.imaging.view import View, magnifications_at

ToleranceMethod = Literal["kernel", "rays"]

_SURVEY_SIDE: Final = 128  # rows and columns of the survey's grid of central rays, which are told distances alone
_SURVEY_PIXELS: Final = 192
_SURVEY_PAIRS: Final = 4
# Share of the tolerance that the predicted error takes: the bound lies above the error by 10 to 30 %.
_AIM_SHARE: Final = 0.75
# Where the model's error takes more than this share of the tolerance, rays are asked instead.
_MODEL_SHARE: Final = 0.85
# A step in depth costs about this share of its difference in magnification and of the contrast (measured).
_STEP_COST: Final = 0.32
# Pixels where that may reach this share of the tolerance are looked at apart.
_RISK_SHARE: Final = 0.1
_ATTEMPTS: Final = 8
# Where the size of the grid's cells takes more than this share of the tolerance they are halved, so often at most.
_GRID_SHARE: Final = 0.5
_FINEST: Final = 2
# Below this tolerance the usual cells are too coarse at any contrast that matters [gray level].
_COARSE_TOLERANCE: Final = 0.2
# Pixels of the model's certificate, and pairs of each: where depth is even, and near steps; tried in turn.
_EFFORTS: Final = ((512, 4, 16), (1024, 16, 128), (2048, 64, 1024))
# A 99 % quantile without an exceedance among so many: 97.5 % sure of each half's 99.5 %.
_QUANTILE_PIXELS: Final = 1024
_QUANTILE: Final = 0.995


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
        "kernel" or "rays"; default the cheapest that will do.
    budget : Budget
        What it may cost.
    """

    tolerance: float
    max_error: float | None = None
    method: ToleranceMethod | None = None
    budget: Budget = Budget()

    def is_met(self, certificate: Certificate) -> bool:
        """Whether an image keeps the tolerance."""
        quantile = certificate.p99_gray_upper95
        return certificate.rms_gray_upper95 <= self.tolerance and (
            self.max_error is None or (quantile is not None and quantile <= self.max_error)
        )


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """What a few thousand rays tell beforehand.

    Attributes
    ----------
    magnification : ndarray, shape (rows, columns)
        m = 1 + f/z of what a grid of central rays met, 1 where nothing.
    model : Bounded
        Mean square error of the kernel's model [gray level^2].
    deviations : ndarray
        Standard deviation of one ray at pixels drawn at random [gray level].
    rays : int
        What it took.
    """

    magnification: NDArray[np.float64]
    model: Bounded
    deviations: NDArray[np.float64]
    rays: int


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """An image with its certificate, and how it came about.

    Attributes
    ----------
    radiance : ndarray, shape (rows, columns)
        Mean of L cos^4(theta) [W m^-2 sr^-1].
    replicates : Replicates
        Whose mean it is.
    certificate : Certificate
        Its error.
    met : bool
        Whether it keeps the tolerance.
    method : str
        "kernel" or "rays".
    plan : dict
        For the manifest: why this method, what was tried.
    reused : int
        Pieces that were found on the disk.
    ray_plan : KernelPlan or RaysPlan
        What was traced.
    sample : PixelSample or None
        Pixels of the model's certificate.
    """

    radiance: NDArray[np.float64]
    replicates: Replicates
    certificate: Certificate
    met: bool
    method: ToleranceMethod
    plan: dict[str, Any]
    reused: int
    ray_plan: KernelPlan | RaysPlan
    sample: PixelSample | None


def survey(view: View, seed: int) -> Survey:
    """Look at depths, at the kernel's model and at the spread of rays at a few pixels."""
    sensor = view.camera.sensor
    rows, columns = (
        (np.arange(n) + 0.5) / n * size - 0.5
        for size, n in (
            (sensor.rows, min(sensor.rows, _SURVEY_SIDE)),
            (sensor.columns, min(sensor.columns, _SURVEY_SIDE)),
        )
    )
    u, v = (grid.ravel() for grid in np.meshgrid(columns, rows))
    magnification = magnifications_at(view, u, v).reshape(len(rows), len(columns))
    drawn = np.random.default_rng((seed, 6)).choice(sensor.pixels, min(sensor.pixels, _SURVEY_PIXELS), replace=False)
    pilot = sampled_radiance(view, *places_of(drawn, sensor.columns), PILOT, np.random.default_rng((seed, 7)))
    deviations = gray_deviation(pilot, plan_rays(view, 1.0))
    rays = magnification.size + pilot.size
    model = NOTHING
    if not view.camera.aperture.is_infinitesimal:
        try:
            layers = plan_kernel(view, met_by(magnification), 1.0).layers
        except InputError:
            return Survey(magnification, Bounded(math.inf, math.inf), deviations, rays)
        every = np.zeros(len(drawn), dtype=np.intp)
        sample = PixelSample(drawn, every, np.ones(1), every + _SURVEY_PAIRS)
        errors = model_errors(view, layers, sample, pilot.mean(axis=1), seed=(seed, 8))
        model = errors.mean_square(sample, (seed, 9))
        rays += errors.rays
    return Survey(magnification, model, deviations, rays)


def met_by(magnification: NDArray[np.float64]) -> NDArray[np.float64]:
    """Magnifications of what was met."""
    return magnification[magnification > 1]


def steps(view: View, magnification: NDArray[np.float64], gray: NDArray[np.float64], least: float) -> NDArray[np.bool_]:
    """Pixels, shape (rows, columns), that gather light across a step in depth that may matter.

    Parameters
    ----------
    view : View
        For its camera.
    magnification : ndarray, shape (rows, columns)
        Of the survey's grid.
    gray : ndarray, shape (rows, columns)
        The image [gray level].
    least : float
        Smallest error that matters [gray level].
    """
    places = [_nearest(size, n) for size, n in zip(gray.shape, magnification.shape, strict=True)]
    seen = gray[np.ix_(*places)]
    # Where a survey's point lies between pixels, a step hides by so much: the reach, and a point more.
    reach = reach_px(view.camera, float(magnification.max()))[::-1]
    far = [
        min(math.ceil(reach[axis] * n / size) + 1, n - 1)
        for axis, (size, n) in enumerate(zip(gray.shape, magnification.shape, strict=True))
    ]
    cost = _STEP_COST * _range_nearby(magnification, far) * _range_nearby(seen, far)
    back = [np.arange(size) * n // size for size, n in zip(gray.shape, magnification.shape, strict=True)]
    wide: NDArray[np.bool_] = (cost > least)[np.ix_(*back)]
    return wide


def _nearest(size: int, number: int) -> NDArray[np.intp]:
    """Pixels in the middle of `number` equal parts of `size`."""
    return ((np.arange(number) + 0.5) / number * size).astype(np.intp)


def _range_nearby(values: NDArray[np.float64], far: list[int]) -> NDArray[np.float64]:
    """Largest less smallest within so many steps along each axis."""
    high = low = values
    for axis, steps_away in enumerate(far):
        high, low = _extreme(high, axis, steps_away, np.maximum), _extreme(low, axis, steps_away, np.minimum)
    return high - low


def _extreme(values: NDArray[np.float64], axis: int, far: int, choose: np.ufunc) -> NDArray[np.float64]:
    """Largest or smallest within so many steps along an axis."""
    values = np.moveaxis(values, axis, 0)
    framed = np.concatenate([values[:1].repeat(far, axis=0), values, values[-1:].repeat(far, axis=0)])
    windows = np.lib.stride_tricks.sliding_window_view(framed, 2 * far + 1, axis=0)
    return np.moveaxis(choose.reduce(windows, axis=-1), 0, axis)


def predicted_rays(view: View, found: Survey, tolerance: float) -> dict[str, float]:
    """Rays that each method is expected to take for an rms error: a model, good to a factor of about two."""
    sensor = view.camera.sensor
    aim = _AIM_SHARE * tolerance * math.sqrt(2)
    numbers = np.clip((found.deviations / aim) ** (1 / ORDER), 4, 1 << 14)
    rays = 2 * sensor.pixels * (PILOT + float(numbers.mean()))
    if not math.isfinite(found.model.mean):
        return {"rays": rays, "kernel": math.inf}
    plan = plan_kernel(view, met_by(found.magnification), aim)
    reach = view.camera.aperture.reach * plan.layers[-1]
    covered = (sensor.columns + 2 * reach / sensor.pixel_width) * (sensor.rows + 2 * reach / sensor.pixel_height)
    # About as many again where cells are cut.
    kernel = 2 * replicates_needed(plan) * covered / plan.grid.base**2
    return {"rays": rays, "kernel": kernel}


def expected_rays(view: View, demand: Demand, seed: int) -> float:
    """Rays that a run is expected to take."""
    found = survey(view, seed)
    expected = predicted_rays(view, found, demand.tolerance)
    if demand.method is not None:
        return expected[demand.method]
    holds = root(found.model.mean) <= _MODEL_SHARE * demand.tolerance
    return min(expected.values()) if holds else expected["rays"]


def render_to_tolerance(work: Work, demand: Demand) -> Outcome:
    """Make an image whose certified error keeps a tolerance, or the best that the budget allows.

    Raises
    ------
    TracerError, EnvironmentFailure
        If the tracer or the disk fails.
    """
    return _Search(work, demand).run()


class _Search:
    """One search for an image that keeps the tolerance."""

    def __init__(self, work: Work, demand: Demand) -> None:
        self.work, self.demand, self.view = work, demand, work.view
        self.start = time.monotonic()
        self.found = survey(work.view, work.seed)
        self.spent = self.found.rays
        self.considered = predicted_rays(work.view, self.found, demand.tolerance)
        work.progress.expect(int(min(self.considered.values())))
        self.attempts: list[dict[str, Any]] = []
        self.reused = 0
        self.finer = 0 if demand.tolerance >= _COARSE_TOLERANCE else 1
        self.effort = 0 if demand.max_error is None else 1

    def run(self) -> Outcome:
        method, why = self._choose()
        share = self._first_share(method)
        best: Outcome | None = None
        for _ in range(_ATTEMPTS):
            outcome = self._attempt(method, share, why)
            if best is None or outcome.certificate.rms_gray_upper95 < best.certificate.rms_gray_upper95:
                best = outcome
            if outcome.met or self._is_spent(outcome):
                break
            method, share, why = self._next(outcome, share, why)
        assert best is not None  # noqa: S101  (the loop ran)
        return best

    def _choose(self) -> tuple[ToleranceMethod, str]:
        if self.demand.method is not None:
            return self.demand.method, "asked for"
        model = root(self.found.model.mean)
        if model > _MODEL_SHARE * self.demand.tolerance:
            return "rays", f"the kernel's model may be off by {model:.3g} gray rms"
        if self.considered["rays"] < self.considered["kernel"]:
            return "rays", "fewer rays are expected than for the kernel"
        return "kernel", "fewest rays are expected, and its model holds"

    def _first_share(self, method: ToleranceMethod) -> float:
        """Rms error of the result to aim at."""
        model = max(self.found.model.mean, 0.0) if method == "kernel" else 0.0
        left = self.demand.tolerance**2 - (model if math.isfinite(model) else 0.0)
        return _AIM_SHARE * math.sqrt(max(left, (0.3 * self.demand.tolerance) ** 2))

    def _plan(self, method: ToleranceMethod, aim: float) -> KernelPlan | RaysPlan:
        if method == "rays":
            return plan_rays(self.view, aim)
        return plan_kernel(self.view, met_by(self.found.magnification), aim, self.finer)

    def _attempt(self, method: ToleranceMethod, share: float, why: str) -> Outcome:
        number = replicates_needed(self._plan(method, share))
        plan = self._plan(method, share * math.sqrt(number))
        replicates = trace_replicates(self.work, plan, number)
        self.reused += replicates.reused
        self.spent += replicates.rays
        certificate, sample = self._certify(plan, replicates)
        self.attempts.append(
            {
                "method": method,
                "aim_gray": share,
                "replicates": number,
                "rays": replicates.rays,
                "rms_gray_upper95": certificate.rms_gray_upper95,
            }
        )
        met = self.demand.is_met(certificate)
        return Outcome(
            radiance=replicates.mean,
            replicates=replicates,
            certificate=certificate,
            met=met,
            method=method,
            plan={
                "method": method,
                "why": why,
                "expected_rays": {key: value for key, value in self.considered.items() if math.isfinite(value)},
                "expected_model_rms_gray": root(self.found.model.mean)
                if math.isfinite(self.found.model.mean)
                else None,
                "attempts": list(self.attempts),
                "rays": self.spent,
                "layers": len(plan.layers) if isinstance(plan, KernelPlan) else None,
                "base_cell_px": plan.grid.base if isinstance(plan, KernelPlan) else None,
                "grid_cell_px": plan.grid.cell if isinstance(plan, KernelPlan) else None,
                "met": met,
                "reproducible": math.isinf(self.demand.budget.seconds),
            },
            reused=self.reused,
            ray_plan=plan,
            sample=sample,
        )

    def _certify(self, plan: KernelPlan | RaysPlan, replicates: Replicates) -> tuple[Certificate, PixelSample | None]:
        view, seed = self.view, self.work.seed
        noise, errors = discretisation(view, replicates)
        if isinstance(plan, RaysPlan) or view.camera.aperture.is_infinitesimal:
            quantile = noise_quantile(errors, noise) if self.demand.max_error is not None else None
            return certificate_of(NOTHING, noise, quantile, pixels=0, rays=0), None
        radiance = replicates.mean
        gray = gray_levels(radiance * view.exposure_of_radiance, view.camera.sensor)
        risky = steps(view, self.found.magnification, gray, _RISK_SHARE * self.demand.tolerance)
        while True:
            pixels, *pairs = _EFFORTS[self.effort]
            if self.demand.max_error is not None:
                pixels = max(pixels, _QUANTILE_PIXELS)
            sample = draw_pixels(gray, pixels, (seed, 10, self.effort), risky=risky, pairs=(pairs[0], pairs[1]))
            at = radiance.ravel()[sample.pixels]
            found = model_errors(view, plan.layers, sample, at, seed=(seed, 11, self.effort))
            self.spent += found.rays
            model = found.mean_square(sample, (seed, 12, self.effort))
            wanted = self.demand.tolerance**2
            enough = model.upper + noise.upper <= wanted or max(model.mean, 0.0) + noise.mean > wanted
            # More pairs help where the bound is wide, not the error large.
            if enough or noise.upper > wanted or self.effort == len(_EFFORTS) - 1:
                break
            self.effort += 1
        quantile = None
        if self.demand.max_error is not None:
            quantile = noise_quantile(errors, noise) + model_quantile(found, sample)
        return certificate_of(model, noise, quantile, pixels=len(sample.pixels), rays=found.rays), sample

    def _is_spent(self, outcome: Outcome) -> bool:
        """Whether another attempt, which takes about twice the rays at least, would pass the budget."""
        budget = self.demand.budget
        elapsed = time.monotonic() - self.start
        if not math.isinf(budget.seconds) and elapsed * (1 + 2 / len(self.attempts)) > budget.seconds:
            return True
        return self.spent + 2 * outcome.replicates.rays > budget.rays

    def _next(self, outcome: Outcome, share: float, why: str) -> tuple[ToleranceMethod, float, str]:
        """What to try after an image that does not keep the tolerance."""
        certificate, wanted = outcome.certificate, self.demand.tolerance
        if outcome.method == "rays":
            return "rays", share / 2, why
        grid = math.sqrt(outcome.replicates.grid_square)
        if grid > _GRID_SHARE * wanted and self.finer < _FINEST:
            self.finer += 1
            return "kernel", share, why
        rest = math.sqrt(max(certificate.rms_gray_upper95**2 - certificate.discretisation_rms_gray**2, 0.0))
        stuck = certificate.model_rms_gray > _MODEL_SHARE * wanted or rest > wanted or grid > _GRID_SHARE * wanted
        if self.demand.method is None and (stuck or share < wanted * _AIM_SHARE / 4):
            return "rays", self._first_share("rays"), "the kernel's certificate did not hold"
        return "kernel", share / 2, why


def certificate_of(model: Bounded, noise: Bounded, quantile: float | None, *, pixels: int, rays: int) -> Certificate:
    """Certificate from mean squares [gray level^2]: of the model's error, and of what the number of rays adds."""
    square = Bounded(max(model.mean, 0.0), max(model.upper, 0.0)) + noise
    return Certificate(
        rms_gray=root(square.mean),
        rms_gray_upper95=root(square.upper),
        p99_gray_upper95=quantile,
        model_rms_gray=root(model.mean),
        discretisation_rms_gray=root(noise.mean),
        certificate_pixels=pixels,
        certificate_rays=rays,
        method="pairs and replicates" if pixels else "replicates",
    )


def noise_quantile(errors: NDArray[np.float64], noise: Bounded) -> float:
    """Error that 99.5 % of the pixels stay below, raised as the rms error's bound is."""
    scale = math.sqrt(noise.upper / noise.mean) if noise.mean > 0 else 1.0
    return float(np.quantile(np.abs(errors), _QUANTILE)) * scale


def model_quantile(errors: PixelErrors, sample: PixelSample) -> float:
    """Error of the model that 99.5 % of the pixels stay below: the largest that was seen where few lie above it."""
    size = (np.abs(errors.first) + np.abs(errors.second)) / 2
    order = np.argsort(-size)
    above = np.cumsum(sample.weights[order])
    # Half of the share that may lie above, for what the sample did not see.
    place = int(np.searchsorted(above, (1 - _QUANTILE) / 2))
    return float(size[order[min(place, len(order) - 1)]])
