"""From a tolerance in gray levels to an image that is certified to keep it, by the cheapest method.

All decisions are made by counted rays and measured errors, never by a clock,
so that the same scene, tolerance and seed give the same bytes. Only a budget
in seconds breaks that.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.demand import Demand, SamplingPlan, ToleranceMethod
from radwrap.imaging.methods.depth_steps import steps
from radwrap.imaging.methods.kernel import KernelPlan
from radwrap.imaging.methods.rays import ORDER, ORDER_OF_WALKS
from radwrap.imaging.optics.smooth import SmoothField
from radwrap.imaging.response.sensor import GrayWhereAsked
from radwrap.imaging.tolerance.bounds import NOTHING, Bounded
from radwrap.imaging.tolerance.certificate import (
    Certificate,
    PixelErrors,
    PixelSample,
    certificate_of,
    draw_pixels,
    model_errors,
    rays_of_lacks,
    root,
)
from radwrap.imaging.tolerance.corrected_replicates import trace_plan
from radwrap.imaging.tolerance.pace import FIRST_SHARE, Pace
from radwrap.imaging.tolerance.plans import (
    COARSE_TOLERANCE,
    MODEL_SHARE,
    NEGLIGIBLE_SHARE,
    RISK_SHARE,
    Plans,
    choose,
    kernel_of,
    method_of,
)
from radwrap.imaging.tolerance.replicates import Plan, Replicates, TooManyRays, Work, discretisation, noise_beside
from radwrap.imaging.tolerance.search_record import Attempt, GivenUp, SearchRecord
from radwrap.imaging.tolerance.survey import AIM_SHARE, survey, with_smooth_blocks
from radwrap.kept import of_kept
from radwrap.manifest import sha256_of_value
from radwrap.random_streams import Rendering
from radwrap.tracers.timed import OutOfTime, TimedTracer

_ATTEMPTS: Final = 8
# Mean squares fall as the cube of the cells' size, and cells are as many as its inverse square. Measured on
# rad_scenes/data_sheet_camera from 8 to 0.5 gray: 0.77.
_ORDER_OF_KERNEL: Final = 0.75
# By what the fewest rays of a pixel grow from one attempt by rays to the next, and where that ends.
_MORE: Final = 4
_MOST_FEWEST: Final = 1 << 12
_LITTLE_ABOVE: Final = 2.0  # of what is wanted; an attempt with more pairs makes such a bound small enough
_SPARED: Final = 0.85  # of the aim of rays that would just do: a bound differs from attempt to attempt
_HALVINGS: Final = 24  # of the accuracy, until a budget suffices
_COARSE_AIM: Final = 16.0  # gray levels of eight bits; what is made where nothing better was finished in time
# Where the size of the grid's cells takes more than this share of the tolerance they are halved, so often at most.
_GRID_SHARE: Final = 0.5
_FINEST: Final = 2
# Pixels of the model's certificate, and pairs of each: where depth is even, and near steps; tried in turn.
EFFORTS: Final = ((512, 4, 16), (1024, 8, 32), (1024, 16, 128), (2048, 64, 1024))
# Where a tolerance is kept already more pairs are traced if the model's bound is mostly of what few pairs cannot see:
# that is so much of all other squares. They may take so much of the rays so far, or a few in any case.
_UNSEEN_SHARE: Final = 0.25
_TELLING_SHARE: Final = 0.25
_FEW_RAYS: Final = 1 << 17
# A 99 % quantile without an exceedance among so many: 97.5 % sure of each half's 99.5 %.
_QUANTILE_PIXELS: Final = 1024
_QUANTILE: Final = 0.995


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
        "kernel", "rays" or "hybrid".
    record : SearchRecord
        Why this method, what was tried.
    reused : int
        Pieces that were found on the disk.
    ray_plan : KernelPlan, RaysPlan or HybridPlan
        What was traced.
    sample : PixelSample or None
        Pixels of the model's certificate.
    smooth : SmoothField or None
        Blocks that were looked up.
    parts : tuple of Bounded
        Mean squares of what the certificate holds: of the model's error, and of noise [gray level^2].
    """

    radiance: NDArray[np.float64]
    replicates: Replicates
    certificate: Certificate
    met: bool
    method: ToleranceMethod
    record: SearchRecord
    reused: int
    ray_plan: Plan
    sample: PixelSample | None
    smooth: SmoothField | None
    parts: tuple[Bounded, ...]


def render_to_tolerance(
    work: Work, demand: Demand, before: Callable[[Search], None] | None = None, *, relit: bool = False
) -> Outcome:
    """Make an image whose certified error keeps a tolerance, or the best that the budget allows.

    `before` is told once a survey says what will be done. What is to be `relit` has no part whose error is known in
    this light only.

    Raises
    ------
    TracerError, EnvironmentFailure
        If the tracer or the disk fails.
    """
    search = Search(work, demand, relit=relit)
    if before is not None:
        before(search)
    return search.run()


class Search:
    """One search for an image that keeps the tolerance, or a survey and the image by a plan that others made.

    Smooth blocks are looked for, unless they are given.
    """

    def __init__(self, work: Work, demand: Demand, *, relit: bool = False, smooth: SmoothField | None = None) -> None:
        self.demand, self.tracer = demand, work.view.tracer
        self.pace = Pace(demand.budget.seconds)
        self.found = of_kept(
            work.kept,
            lambda: ("survey", sha256_of_value([work.traced_sha256, work.view.camera]), work.seed),
            lambda: survey(work.view, work.seed),
            lambda found: found.magnification.nbytes + found.deviations.nbytes,
        )
        # A sample of squared errors knows nothing of single pixels, either.
        sampled = demand.max_error is None and not relit
        self.view = (
            with_smooth_blocks(work.view, self.found, demand.tolerance, work.seed, sampled=sampled)
            if smooth is None
            else replace(work.view, smooth=smooth)
        )
        self.work = replace(work, view=self.view)
        self.traced_rays = self.found.rays + (self.view.smooth.rays if self.view.smooth else 0)
        self.plans = Plans(self.view, self.found, demand, work.seed)
        self.choice = choose(self.plans)
        work.progress.expect(self.choice.expected_rays[self.choice.method] or 1)
        self.attempts: list[Attempt] = []
        self.reused = 0
        self.effort = 1 if demand.tolerance < COARSE_TOLERANCE or demand.max_error is not None else 0
        self.last_model = NOTHING
        self.was_over = False
        self.counted: set[str] = set()
        self.coarse_aim = math.ldexp(_COARSE_AIM, max(0, work.view.camera.sensor.bit_depth - 8))
        self.pairs: dict[int, int] = {}  # of rays that a certificate took, by its effort

    @property
    def spent(self) -> int:
        """Rays until now."""
        return self.traced_rays + self.plans.rays

    def run(self) -> Outcome:
        """Try until one image keeps the tolerance, or the budget is spent."""
        method, why = self.choice.method, self.choice.why
        aim = self._affordable(method, self.plans.first_aim(method))
        best: Outcome | None = None
        given_up: GivenUp | None = None
        if aim < self.coarse_aim:
            self._limit_time(FIRST_SHARE)
        for _ in range(_ATTEMPTS):
            self.pace.begin()
            try:
                outcome = self._attempt(method, aim, why)
            except OutOfTime:
                given_up = "out of time"
                if best is not None:
                    break
                # Some image there must be: the coarsest, whatever it takes.
                self.pace.give_up(aim)
                self._limit_time(math.inf)
                aim, self.plans.finer, self.effort = self.coarse_aim, 0, 0
                continue
            except TooManyRays as found:
                given_up = "out of rays"
                self._count(found.parts, sum(found.parts.values()))
                if best is not None:
                    break
                if method == "hybrid" and self.demand.method is None:
                    # Few corrections add more noise than the kernel lacks; few rays are only noisy.
                    method, why = "rays", "corrections of the kernel take more rays than are left"
                    aim = self._affordable(method, self.plans.first_aim(method))
                    continue
                aim = self._coarser(method, aim, found.whole)
                self.plans.finer, self.effort = 0, 0
                continue
            self.pace.end()
            self._limit_time(1.0)
            if best is None or self._rank(outcome) < self._rank(best):
                best = outcome
            if outcome.met or self._is_spent(outcome):
                break
            last = aim
            method, aim, why = self._next(outcome, aim, why)
            if method == outcome.method:
                aim = min(aim, self.pace.next_aim(last))
        assert best is not None  # noqa: S101  (the loop ran)
        return replace(best, record=self.recorded(best.record, given_up=given_up))

    def times_as_many(self, share: float) -> float:
        """About how many times as many rays the same method takes for a share of the tolerance; more where few do."""
        order = (ORDER_OF_WALKS if self.view.walks else ORDER) if self.choice.method == "rays" else _ORDER_OF_KERNEL
        return float(share ** (-1 / order))

    def first_plan(self, method: ToleranceMethod | None = None) -> tuple[Plan, int]:
        """What is tried first, or first by a method, and how many replicates of it."""
        method = method or self.choice.method
        return self.plans.planned(method, self._affordable(method, self.plans.first_aim(method)))

    def recorded(
        self, record: SearchRecord, *, given_up: GivenUp | None = None, sampling: SamplingPlan | None = None
    ) -> SearchRecord:
        """An image's record, with all that was tried until now."""
        return replace(record, attempts=tuple(self.attempts), rays=self.spent, given_up=given_up, sampling=sampling)

    def _count(self, parts: Mapping[str, int], rays: int) -> int:
        """Count rays, but for those of parts that were counted already; gives how many they are."""
        new = rays - sum(number for name, number in parts.items() if name in self.counted)
        self.counted.update(parts)
        self.traced_rays += new
        return new

    def _limit_time(self, share: float) -> None:
        """Let what comes next be given up after a share of a budget of time."""
        deadline = self.pace.deadline(share)
        tracer = self.tracer if math.isinf(deadline) else TimedTracer(self.tracer, deadline)
        self.view = self.plans.view = replace(self.view, tracer=tracer)
        self.work = replace(self.work, view=self.view)

    def _rank(self, outcome: Outcome) -> float:
        """How many times what is asked for an image is off; the least is the best, and below 1 one that meets it."""
        demand, found = self.demand, outcome.certificate
        off = found.rms_gray_upper95 / demand.tolerance
        if demand.max_error is None:
            return off
        quantile = math.inf if found.p99_gray_upper95 is None else found.p99_gray_upper95
        return max(off, quantile / demand.max_error)

    def _affordable(self, method: ToleranceMethod, aim: float) -> float:
        """The aim, or a larger one that is expected to stay within the budget."""
        budget = min(self.demand.budget.rays - self.spent, self.pace.rays(self.found.rays))
        if self.plans.forecast(method, aim) > budget:
            self.plans.finer, self.effort = 0, 0
        # From some aim on, an image takes no fewer rays.
        fewest = self.plans.forecast(method, aim * 2**_HALVINGS)
        while self.plans.forecast(method, aim) > max(budget, fewest):
            aim *= 2
        return aim

    def _coarser(self, method: ToleranceMethod, aim: float, whole: int) -> float:
        """What to aim at once a plan needs more rays than are left: by its share of the forecast, then the coarsest."""
        often = whole / self.plans.forecast(method, aim)
        left = self.demand.budget.rays - self.spent
        while aim < self.coarse_aim and (self.was_over or often * self.plans.forecast(method, aim) > left):
            aim *= 2
        self.was_over = True
        return aim

    def _attempt(self, method: ToleranceMethod, aim: float, why: str) -> Outcome:
        plan, number = self.plans.planned(method, aim)
        forecast = self.plans.forecast(method, aim)
        if self.attempts and math.isfinite(forecast):  # the first one is what the whole was expected to take
            self.work.progress.left(round(forecast))
        # Some image there must be: the coarsest may take what it takes.
        most = (
            self.demand.budget.rays - self.spent - self._certificate_rays(plan) if aim < self.coarse_aim else math.inf
        )
        return self.made(plan, number, why, aim=aim, most=most)

    def made(self, plan: Plan, number: int, why: str, *, aim: float | None = None, most: float = math.inf) -> Outcome:
        """The image by a plan, with its certificate."""
        replicates = trace_plan(self.work, plan, number, most)
        self.reused += replicates.reused
        rays = self._count(replicates.parts, replicates.rays)
        method, kernel = method_of(plan), kernel_of(plan)
        radiance = replicates.mean
        certificate, sample, parts = self._certify(plan, replicates, radiance)
        self.attempts.append(
            Attempt(
                method=method,
                aim_gray=aim,
                replicates=number,
                rays=rays,
                rms_gray_upper95=certificate.rms_gray_upper95,
                p99_gray_upper95=certificate.p99_gray_upper95,
            )
        )
        met = self.demand.is_met(certificate.rms_gray_upper95, certificate.p99_gray_upper95)
        return Outcome(
            radiance=radiance,
            replicates=replicates,
            certificate=certificate,
            met=met,
            method=method,
            record=SearchRecord(
                method=method,
                why=why,
                **self.choice.as_manifest(),
                one_layer_rms_gray=root(self.found.one_layer.mean),
                layers=len(kernel.layers) if kernel else None,
                base_cell_px=kernel.grid.base if kernel else None,
                grid_cell_px=kernel.grid.cell if kernel else None,
                met=met,
                reproducible=self.pace.is_free,
            ),
            reused=self.reused,
            ray_plan=plan,
            sample=sample,
            smooth=self.view.smooth,
            parts=parts,
        )

    def _certify(
        self, plan: Plan, replicates: Replicates, radiance: NDArray[np.float64]
    ) -> tuple[Certificate, PixelSample | None, tuple[Bounded, ...]]:
        view, seed, kernel = self.view, self.work.seed, kernel_of(plan)
        noise, errors = discretisation(view, replicates)
        if kernel is not None and kernel.grid.smooth and view.smooth is not None:
            noise += Bounded(view.smooth.square, view.smooth.upper)
        if isinstance(plan, KernelPlan):
            self.plans.kernel = plan, len(replicates.images), noise.mean
        if kernel is None or view.camera.aperture.is_infinitesimal:
            quantile = noise_quantile(errors, noise) if self.demand.max_error is not None else None
            return certificate_of(NOTHING, noise, quantile, pixels=0, rays=0), None, (noise,)
        gray = GrayWhereAsked(radiance, view.exposure_of_radiance, view.camera.sensor)
        risky = steps(view.camera, self.found.magnification, gray, RISK_SHARE * self.demand.tolerance)
        if isinstance(plan, KernelPlan):
            self.plans.kernel = plan, len(replicates.images), noise_beside(replicates, errors, risky)
        wanted, met, first = self.demand.tolerance**2, False, self.effort
        for effort in range(first, len(EFFORTS)):
            pixels, pairs = self._pixels_and_pairs(effort)
            key = (seed, Rendering.MODEL_PIXELS, effort)
            drawn = draw_pixels(gray, pixels, key, risky=risky, pairs=pairs, exact=replicates.own_rays)
            all_pairs = int(drawn.pairs.sum())
            rays = rays_of_lacks(kernel.layers, all_pairs)
            enough = max(_TELLING_SHARE * self.spent, _FEW_RAYS) if met else math.inf
            dear = rays > min(enough, self.demand.budget.rays - self.spent)
            # The first must be, whatever it takes.
            if effort > first and dear:
                break
            sample = drawn
            if not met:  # what only tells more is not the least that the next image gets
                self.effort = effort
            self.pairs[effort] = all_pairs
            at = radiance.ravel()[sample.pixels]
            found = model_errors(view, kernel.layers, sample, at, seed=(seed, Rendering.MODEL_RAYS, effort))
            self.traced_rays += found.rays
            model = found.mean_square(sample, (seed, Rendering.MODEL_RESAMPLES, effort), self.work.kept)
            met = model.upper + noise.upper <= wanted
            # More pairs help where the bound is wide, not where the error is surely large: one pixel of few pairs on a
            # highlight may look like it.
            surely = 2 * model.mean - model.upper + noise.mean > wanted
            unseen = model.upper - max(model.mean, 0.0) > _UNSEEN_SHARE * (max(model.mean, 0.0) + noise.upper)
            if surely or (met and not unseen) or noise.upper > wanted:
                break
        self.last_model = model
        quantile = None
        if self.demand.max_error is not None:
            quantile = noise_quantile(errors, noise) + model_quantile(found, sample)
        certificate = certificate_of(model, noise, quantile, pixels=len(sample.pixels), rays=found.rays)
        return certificate, sample, (model, noise)

    def _pixels_and_pairs(self, effort: int) -> tuple[int, tuple[int, int]]:
        pixels, *pairs = EFFORTS[effort]
        return pixels if self.demand.max_error is None else max(pixels, _QUANTILE_PIXELS), (pairs[0], pairs[1])

    def _certificate_rays(self, plan: Plan) -> int:
        """What a certificate takes as the last one did, or the fewest where there was none."""
        kernel = kernel_of(plan)
        if kernel is None or plan.camera.aperture.is_infinitesimal:
            return 0
        pixels, (even, _) = self._pixels_and_pairs(self.effort)
        pairs = self.pairs.get(self.effort, even * min(pixels, plan.camera.sensor.pixels))
        return rays_of_lacks(kernel.layers, pairs)

    def _is_spent(self, outcome: Outcome) -> bool:
        """Whether another attempt, which takes about twice the rays at least, would pass the budget."""
        budget = self.demand.budget
        return self.pace.is_spent() or self.spent + 2 * outcome.replicates.rays > budget.rays

    def _next(self, outcome: Outcome, aim: float, why: str) -> tuple[ToleranceMethod, float, str]:
        """What to try after an image that does not keep the tolerance."""
        certificate, wanted = outcome.certificate, self.demand.tolerance
        if outcome.method == "rays":
            # Rays that decide may all have missed what a pixel sees: it then stays at the fewest, whatever the aim.
            self.plans.fewest = min(_MORE * self.plans.fewest, _MOST_FEWEST)
            return "rays", aim * share_of_aim(self.demand, certificate), why
        grid = math.sqrt(outcome.replicates.grid_square)
        coarse = grid > _GRID_SHARE * wanted and self.plans.finer < _FINEST
        model_fails = certificate.model_rms_gray > MODEL_SHARE * wanted
        # Cells matter most where one thing hides another: rays that correct the model there need none of them.
        if coarse and (outcome.method == "hybrid" or self.demand.method is not None or not model_fails):
            self.plans.finer += 1
            self.plans.kernel = None
            if not model_fails:
                return outcome.method, aim, why
        rest = root(self.last_model.upper)
        if outcome.method == "hybrid":
            return self._after_hybrid(certificate, aim, why)
        if self.plans.one_layer and rest > NEGLIGIBLE_SHARE * wanted and math.isfinite(self.found.model.mean):
            self.plans.one_layer = False
            return "kernel", aim, "depths differ more than the survey saw"
        # Where the number of rays fails by itself few pairs look at the model: the bound of an error that is not seen
        # is wide then, and may be a little above what is wanted.
        noisy = certificate.rms_gray_upper95**2 - rest**2 > wanted**2
        unseen = noisy and certificate.model_rms_gray <= NEGLIGIBLE_SHARE * wanted and rest < _LITTLE_ABOVE * wanted
        if self.demand.method is None and (model_fails or (rest > wanted and not unseen)):
            return self.instead_of_kernel()
        tried = [attempt for attempt in self.attempts[-2:] if attempt.method == "kernel"]
        idle = len(tried) == 2 and tried[0].rays == tried[1].rays and tried[0].aim_gray != tried[1].aim_gray
        finest = grid > _GRID_SHARE * wanted and not coarse
        # A smaller aim changes nothing, or the cells are as small as they may be and rays do not cost more than it.
        dearer = self.plans.forecast("rays", self.plans.first_aim("rays")) > self.plans.forecast("kernel", aim / 2)
        if self.demand.method is None and (idle or (finest and not dearer) or aim < wanted * AIM_SHARE / 4):
            aim = self._affordable("rays", self.plans.first_aim("rays"))
            return "rays", aim, "the kernel's certificate did not hold"
        return "kernel", aim / 2, why

    def instead_of_kernel(self) -> tuple[ToleranceMethod, float, str]:
        """The cheaper of what is left once a kernel's model was seen to fail."""
        methods: list[ToleranceMethod] = ["rays", "hybrid"]
        aims = {method: self.plans.first_aim(method) for method in methods}
        best = min(methods, key=lambda method: self.plans.forecast(method, aims[method]))
        return best, self._affordable(best, aims[best]), "the kernel's certificate did not hold"

    def _after_hybrid(self, certificate: Certificate, aim: float, why: str) -> tuple[ToleranceMethod, float, str]:
        """What to try after a kernel that was corrected in vain."""
        if certificate.model_rms_gray <= MODEL_SHARE * self.demand.tolerance and not (
            root(self.last_model.upper) > self.demand.tolerance
        ):
            self.plans.fewest = min(_MORE * self.plans.fewest, _MOST_FEWEST)
            return "hybrid", aim / 2, why
        if self.plans.everywhere and self.demand.method is not None:
            return "hybrid", aim / 2, why
        if self.plans.everywhere:
            return (
                "rays",
                self._affordable("rays", self.plans.first_aim("rays")),
                "pilot pairs missed what the kernel lacks",
            )
        self.plans.everywhere = True
        if self.demand.method is not None:
            return "hybrid", aim, why
        method, aim, _ = self.instead_of_kernel()
        return method, aim, "the kernel's model fails away from steps in depth too"


def share_of_aim(demand: Demand, certificate: Certificate) -> float:
    """What part of the last aim by rays to go on with: what is due, and a little less, but half of it at the least."""
    due, limit = demand.tolerance / certificate.rms_gray_upper95, demand.max_error
    if limit is not None and certificate.p99_gray_upper95:
        due = min(due, limit / certificate.p99_gray_upper95)
    return max(0.5, _SPARED * min(due, 1.0))


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
