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
from radwrap.imaging.certificate import Certificate, PixelErrors, PixelSample, draw_pixels, model_errors, root
from radwrap.imaging.kernel import KernelPlan, plan_kernel
from radwrap.imaging.rays import ORDER, PILOT, RaysPlan, gray_deviation, plan_rays, sampled_radiance
from radwrap.imaging.replicates import Replicates, Work, discretisation, trace_replicates
from radwrap.imaging.sensor import gray_levels
from radwrap.imaging.view import View, trace_rays

ToleranceMethod = Literal["kernel", "rays"]

_SURVEY_SIDE: Final = 48  # rows and columns of the survey's grid of central rays
_SURVEY_PIXELS: Final = 192
_SURVEY_PAIRS: Final = 4
# Share of the tolerance that the predicted error takes: the bound lies above the error by 10 to 30 %.
_AIM_SHARE: Final = 0.75
# Where the model's error takes more than this share of the tolerance, rays are asked instead.
_MODEL_SHARE: Final = 0.85
_REPLICATES: Final = 2
_ATTEMPTS: Final = 8
# Pixels and pairs of the model's certificate, tried in turn.
_EFFORTS: Final = ((512, 4), (1024, 16), (4096, 64))
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
    magnifications : ndarray
        m = 1 + f/z of all that a grid of central rays met.
    model : Bounded
        Mean square error of the kernel's model [gray level^2].
    deviations : ndarray
        Standard deviation of one ray at pixels drawn at random [gray level].
    rays : int
        What it took.
    """

    magnifications: NDArray[np.float64]
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
    model : PixelErrors or None
        Samples of the model's error, where the method has a model.
    ray_plan : KernelPlan or RaysPlan
        What was traced.
    effort : tuple of int
        Pixels and pairs of the model's certificate.
    """

    radiance: NDArray[np.float64]
    replicates: Replicates
    certificate: Certificate
    met: bool
    method: ToleranceMethod
    plan: dict[str, Any]
    reused: int
    model: PixelErrors | None
    ray_plan: KernelPlan | RaysPlan
    effort: tuple[int, int]


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
    values, magnification = trace_rays(view, np.zeros((1, 2)), u, v, with_depth=True)
    met = magnification[magnification > 1]
    drawn = np.random.default_rng((seed, 6)).choice(sensor.pixels, min(sensor.pixels, _SURVEY_PIXELS), replace=False)
    sample = PixelSample(drawn, np.zeros(len(drawn), dtype=np.intp), np.ones(1))
    places = sample.places(sensor.columns)
    pilot = sampled_radiance(view, *places, PILOT, np.random.default_rng((seed, 7)))
    deviations = gray_deviation(pilot, plan_rays(view, 1.0))
    rays = len(values) + pilot.size
    model = NOTHING
    if not view.camera.aperture.is_infinitesimal:
        try:
            layers = plan_kernel(view, met, 1.0).layers
        except InputError:
            return Survey(met, Bounded(math.inf, math.inf), deviations, rays)
        errors = model_errors(view, layers, sample, pilot.mean(axis=1), pairs=_SURVEY_PAIRS, seed=(seed, 8))
        model = errors.mean_square(sample, (seed, 9))
        rays += errors.rays
    return Survey(met, model, deviations, rays)


def predicted_rays(view: View, found: Survey, tolerance: float) -> dict[str, float]:
    """Rays that each method is expected to take for an rms error: a model, good to a factor of about two."""
    sensor = view.camera.sensor
    aim = _AIM_SHARE * tolerance * math.sqrt(_REPLICATES)
    numbers = np.clip((found.deviations / aim) ** (1 / ORDER), 4, 1 << 14)
    rays = _REPLICATES * sensor.pixels * (PILOT + float(numbers.mean()))
    if not math.isfinite(found.model.mean):
        return {"rays": rays, "kernel": math.inf}
    plan = plan_kernel(view, found.magnifications, aim)
    reach = view.camera.aperture.reach * plan.layers[-1]
    covered = (sensor.columns + 2 * reach / sensor.pixel_width) * (sensor.rows + 2 * reach / sensor.pixel_height)
    # About as many again where cells are cut.
    kernel = 2 * _REPLICATES * covered / plan.grid.base**2
    return {"rays": rays, "kernel": kernel}


def expected_rays(view: View, demand: Demand, seed: int) -> float:
    """Rays that a run is expected to take."""
    found = survey(view, seed)
    expected = predicted_rays(view, found, demand.tolerance)
    if demand.method is not None:
        return expected[demand.method]
    holds = math.isfinite(found.model.upper) and root(found.model.upper) <= _MODEL_SHARE * demand.tolerance
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
        self.effort = 0 if demand.max_error is None else 1
        self.replicates = _REPLICATES

    def run(self) -> Outcome:
        method, why = self._choose()
        aim = self._first_aim(method)
        best: Outcome | None = None
        for _ in range(_ATTEMPTS):
            outcome = self._attempt(method, aim, why)
            if best is None or outcome.certificate.rms_gray_upper95 < best.certificate.rms_gray_upper95:
                best = outcome
            if outcome.met or self._is_spent(outcome):
                break
            method, aim, why = self._next(outcome, aim, why)
        assert best is not None  # noqa: S101  (the loop ran)
        return best

    def _choose(self) -> tuple[ToleranceMethod, str]:
        if self.demand.method is not None:
            return self.demand.method, "asked for"
        model = root(self.found.model.upper) if math.isfinite(self.found.model.upper) else math.inf
        if model > _MODEL_SHARE * self.demand.tolerance:
            return "rays", f"the kernel's model may be off by {model:.3g} gray rms"
        if self.considered["rays"] < self.considered["kernel"]:
            return "rays", "fewer rays are expected than for the kernel"
        return "kernel", "fewest rays are expected, and its model holds"

    def _first_aim(self, method: ToleranceMethod) -> float:
        """Rms error of one replicate to aim at."""
        model = max(self.found.model.mean, 0.0) if method == "kernel" else 0.0
        left = self.demand.tolerance**2 - (model if math.isfinite(model) else 0.0)
        share = math.sqrt(max(left, (0.3 * self.demand.tolerance) ** 2))
        return _AIM_SHARE * share * math.sqrt(self.replicates)

    def _attempt(self, method: ToleranceMethod, aim: float, why: str) -> Outcome:
        plan: KernelPlan | RaysPlan = (
            plan_kernel(self.view, self.found.magnifications, aim) if method == "kernel" else plan_rays(self.view, aim)
        )
        replicates = trace_replicates(self.work, plan, self.replicates)
        self.reused += replicates.reused
        self.spent += replicates.rays
        certificate, model = self._certify(plan, replicates)
        self.attempts.append(
            {
                "method": method,
                "aim_gray": aim,
                "replicates": self.replicates,
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
            model=model,
            ray_plan=plan,
            effort=_EFFORTS[self.effort],
        )

    def _certify(self, plan: KernelPlan | RaysPlan, replicates: Replicates) -> tuple[Certificate, PixelErrors | None]:
        view, seed = self.view, self.work.seed
        noise, errors = discretisation(view, replicates)
        if isinstance(plan, RaysPlan) or view.camera.aperture.is_infinitesimal:
            quantile = noise_quantile(errors, noise) if self.demand.max_error is not None else None
            return certificate_of(NOTHING, noise, quantile, pixels=0, rays=0), None
        radiance = replicates.mean
        gray = gray_levels(radiance * view.exposure_of_radiance, view.camera.sensor)
        while True:
            pixels, pairs = _EFFORTS[self.effort]
            if self.demand.max_error is not None:
                pixels = max(pixels, _QUANTILE_PIXELS)
            sample = draw_pixels(gray, pixels, (seed, 10, self.effort))
            found = model_errors(
                view, plan.layers, sample, radiance.ravel()[sample.pixels], pairs=pairs, seed=(seed, 11, self.effort)
            )
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
        return certificate_of(model, noise, quantile, pixels=len(sample.pixels), rays=found.rays), found

    def _is_spent(self, outcome: Outcome) -> bool:
        """Whether another attempt, which takes about twice the rays at least, would pass the budget."""
        budget = self.demand.budget
        elapsed = time.monotonic() - self.start
        if not math.isinf(budget.seconds) and elapsed * (1 + 2 / len(self.attempts)) > budget.seconds:
            return True
        return self.spent + 2 * outcome.replicates.rays > budget.rays

    def _next(self, outcome: Outcome, aim: float, why: str) -> tuple[ToleranceMethod, float, str]:
        """What to try after an image that does not keep the tolerance."""
        certificate, wanted = outcome.certificate, self.demand.tolerance
        noise = certificate.discretisation_rms_gray
        if outcome.method == "kernel":
            rest = math.sqrt(max(certificate.rms_gray_upper95**2 - noise**2, 0.0))
            stuck = len(self.attempts) >= 2 and noise > 0.7 * self._noise_before(outcome)
            if self.demand.method is None and (
                certificate.model_rms_gray > _MODEL_SHARE * wanted or rest > wanted or stuck
            ):
                self.attempts[-1]["left_because"] = "model" if not stuck else "grid"
                return "rays", self._first_aim("rays"), "the kernel's certificate did not hold"
        self.attempts[-1]["noise"] = noise
        return outcome.method, aim / 2, why

    def _noise_before(self, outcome: Outcome) -> float:
        before = self.attempts[-2].get("noise", math.inf)
        return float(before)


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
    shares = sample.shares
    weights = (shares / np.bincount(sample.stratum, minlength=len(shares)))[sample.stratum]
    order = np.argsort(-size)
    above = np.cumsum(weights[order])
    # Half of the share that may lie above, for what the sample did not see.
    place = int(np.searchsorted(above, (1 - _QUANTILE) / 2))
    return float(size[order[min(place, len(order) - 1)]])
