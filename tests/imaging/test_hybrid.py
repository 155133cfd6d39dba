"""A kernel with corrections where it errs: unbiased behind edges, certified, and the same bytes whoever makes it."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import pytest

import radwrap
from radwrap.imaging.demand import Budget, Demand
from radwrap.imaging.methods import hybrid
from radwrap.imaging.methods.depth_steps import cost_of_steps
from radwrap.imaging.methods.hybrid import (
    PAIRS,
    HybridPlan,
    Needs,
    _near_steps,
    corrections,
    pilot,
    signed_numbers,
)
from radwrap.imaging.methods.kernel import layer_shares, plan_kernel
from radwrap.imaging.methods.pairs import paired
from radwrap.imaging.methods.pieces import CALL_LOG
from radwrap.imaging.methods.rays import ORDER, rays_over
from radwrap.imaging.optics.footprint import reach_px
from radwrap.imaging.optics.view import View, trace_rays
from radwrap.imaging.tolerance.certificate import independent_errors
from radwrap.imaging.tolerance.corrected_replicates import tile_numbers, trace_plan
from radwrap.imaging.tolerance.foreseen import foresee, seen_by
from radwrap.imaging.tolerance.planner import Outcome, render_to_tolerance
from radwrap.imaging.tolerance.replicates import Replicates, Work, discretisation
from radwrap.imaging.tolerance.survey import met_by, survey
from radwrap.process import Programs
from radwrap.progress import Progress
from radwrap.scene.camera import Aperture
from tests.imaging.planes import Array, Planes, gray, pixel_axes, view

ROUND: Final = Aperture("round", 1.2e-4)
NEAR, FAR = 0.015, 1.0  # m
# Where the far plane's radiance changes from left to right [m], and by how much: bright behind the near plane's edge,
# where the opening's centre does not see it, and striped beside it.
HIDDEN: Final = 1.0
CHANGES: Final = ((0.0, -0.8), *((0.014 + 0.004 * k, 0.6 * (-1) ** k) for k in range(8)))
TOLERANCE: Final = 0.5


def blind(x: Array, y: Array) -> Array:
    """Black, up to its edge."""
    return np.where(x < 0, 0.0, np.nan)


def striped(x: Array, y: Array) -> Array:
    return HIDDEN + sum(change * (x > at) for at, change in CHANGES)


def behind_an_edge(rows: int = 8, columns: int = 72) -> View:
    """What each point of the opening sees of the bright part is hidden from its centre."""
    return view(ROUND, (NEAR, blind), (FAR, striped), rows=rows, columns=columns)


def exact(seen: View) -> Array:
    """Mean radiance of each pixel: shares of a disc beyond lines, in closed form; over the pixel by 200 points."""
    camera, radius = seen.camera, ROUND.diameter / 2
    columns, _, (pitch, _) = pixel_axes(camera)
    x = columns[:, np.newaxis] + pitch * ((np.arange(200) + 0.5) / 200 - 0.5)

    def beyond(limit: Array) -> Array:
        t = np.clip(limit / radius, -1.0, 1.0)
        share: Array = 0.5 - (np.arcsin(t) + t * np.sqrt(1 - t**2)) / np.pi
        return share

    def passing(depth: float, at: float) -> Array:
        """Point q of the opening whose ray passes a place: it meets the plane z at q + z (x + q)/f."""
        limit: Array = (at - depth * x / camera.focal_length) / (1 + depth / camera.focal_length)
        return limit

    edge = passing(NEAR, 0.0)
    mean = HIDDEN * beyond(edge) + sum(change * beyond(np.maximum(edge, passing(FAR, at))) for at, change in CHANGES)
    return np.broadcast_to(mean.mean(axis=1), (camera.sensor.rows, camera.sensor.columns))


def search(seen: View, folder: Path, demand: Demand, seed: int = 0) -> Outcome:
    folder.mkdir(exist_ok=True)
    with Programs() as programs:
        return render_to_tolerance(Work(seen, folder, programs, Progress("", 1, shown=False), "none", seed), demand)


def error_of(seen: View, outcome: Outcome) -> float:
    """True rms error [gray level]; cos^4 is 1 to 1e-3 in these views."""
    return float(np.sqrt(np.mean(gray(seen, outcome.radiance - exact(seen)) ** 2)))


def planned(seen: View, least: float = 0.05, aim: float = TOLERANCE) -> HybridPlan:
    found = survey(seen, 0)
    kernel = plan_kernel(seen, met_by(seen, found.magnification), aim)
    return HybridPlan(kernel, aim, least, 0.05, seen_by(seen, found)[0])


@pytest.mark.long
def test_a_kernel_alone_misses_what_only_the_openings_rim_sees(tmp_path: Path) -> None:
    seen = behind_an_edge()
    kernel = search(seen, tmp_path, Demand(TOLERANCE, method="kernel"))
    assert not kernel.met and kernel.method == "kernel"
    assert error_of(seen, kernel) > 5 * TOLERANCE


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.long), pytest.param(2, marks=pytest.mark.long)])
def test_what_only_the_openings_rim_sees_is_there(tmp_path: Path, seed: int) -> None:
    """Light that the central image lacks: a kernel would be off by seven times the tolerance, see above."""
    seen = behind_an_edge()
    made = search(seen, tmp_path, Demand(TOLERANCE), seed)
    assert made.met and made.method == "hybrid"
    assert error_of(seen, made) < made.certificate.rms_gray_upper95 + 0.05


def test_it_is_chosen_by_its_forecast_and_takes_fewer_rays(tmp_path: Path) -> None:
    seen = behind_an_edge()
    made = search(seen, tmp_path / "auto", Demand(TOLERANCE))
    rays = search(seen, tmp_path / "rays", Demand(TOLERANCE, method="rays"))
    assert made.record.expected_rays["hybrid"] < made.record.expected_rays["rays"]
    assert made.record.rays < rays.record.rays / 2
    assert rays.method == "rays"


@pytest.mark.parametrize(("number", "rays"), [(12, 2048), pytest.param(36, 8192, marks=pytest.mark.long)])
def test_corrections_are_unbiased(number: int, rays: int) -> None:
    """The mean of many, pixel by pixel, is what pairs and rays tell.

    Twelve are enough where the model is known from fewer rays. Where pairs seldom differ twelve means of four may all
    be 0: their deviation is no less than what the pilot's pairs around say.
    """
    seen = behind_an_edge(rows=2)
    plan = planned(seen)
    found, _ = pilot(seen, plan, 0, (1,), lambda _: None)
    signed = signed_numbers(plan, found, len(found.due)).reshape(2, -1)
    assert (signed != 0).any() and (signed == 0).any()
    values = np.stack([corrections(seen, plan, 0, signed, seed=(2, k), progress=lambda _: None) for k in range(number)])
    by_rays, model = signed > 0, _model(seen, plan, rays)
    truth = np.where(by_rays, exact(seen), exact(seen) - model)
    _, of_pairs = found.spread.reshape(2, 2, -1)
    expected = np.where(by_rays, 0.0, of_pairs / np.sqrt(np.maximum(np.abs(signed), 1)))
    deviation = np.maximum(values.std(axis=0, ddof=1), expected)[signed != 0] / math.sqrt(number)
    allowed = 5 * deviation + 2e-3  # cos^4, and the model's own noise
    assert (np.abs(values.mean(axis=0) - truth)[signed != 0] < allowed).all()
    without = np.where(by_rays, model, 0.0)  # what the kernel gives
    assert (np.abs(without - truth)[signed != 0] > 2 * allowed).mean() > 0.2


def _model(seen: View, plan: HybridPlan, rays: int) -> Array:
    """What the kernel's model gives each pixel, by many rays."""
    v, u = (grid.ravel().astype(float) for grid in np.indices((seen.camera.sensor.rows, seen.camera.sensor.columns)))
    values, differences = paired(
        seen, plan.kernel.layers, *rays_over(seen.camera, u, v, rays, np.random.default_rng(5))
    )
    return (values - differences).reshape(len(u), -1).mean(axis=1).reshape(seen.camera.sensor.rows, -1)


def test_pairs_of_many_layers_ask_distances_first_and_find_the_same() -> None:
    seen = behind_an_edge()
    layers = tuple(np.linspace(*seen.camera.magnification(np.array([NEAR, FAR])), 7).tolist())
    random = np.random.default_rng(1)
    v, u = (random.uniform(0, size, 500) for size in (seen.camera.sensor.rows, seen.camera.sensor.columns))
    opening, u, v = rays_over(seen.camera, u, v, 4, random)
    values, differences = paired(seen, layers, opening, u, v)
    expected = trace_rays(seen, opening, u, v)[0]
    assert np.array_equal(values, expected)
    for number, layer in enumerate(layers):
        at = (u + layer * opening[:, 0] / 1e-5, v + layer * opening[:, 1] / 1.2e-5)
        central, magnification = trace_rays(seen, None, *at, with_depth=True)
        expected = expected - central * layer_shares(layers, magnification)[number]
    assert np.abs(differences - expected).max() < 1e-12
    assert np.abs(differences).max() > 0.5


def test_numbers_bring_the_expected_error_to_the_aim() -> None:
    """Of rays like n^-0.6, of pairs like n^-0.5; pixels that are not due add nothing."""
    random = np.random.default_rng(3)
    plan = planned(behind_an_edge(), aim=0.4)
    count = 4000
    deviation = random.lognormal(2.0, 1.0, (2, count))
    due = random.random(count) < 0.3
    found = Needs(np.full(count, 0.5), np.zeros((2, count)), deviation, due)
    signed = signed_numbers(plan, found, 2 * count)
    assert ((signed != 0) == due).all() and (signed > 0).any() and (signed < 0).any()
    rays, pairs = signed > 0, signed < 0
    errors = np.concatenate(
        [0.8 * deviation[0, rays] * signed[rays] ** -ORDER, deviation[1, pairs] / np.sqrt(-signed[pairs])]
    )
    rms = math.sqrt(float((errors**2).sum()) / (2 * count))
    assert rms == pytest.approx(0.4, rel=0.15)
    # What serves a pixel is the cheaper of both, to a power of two.
    level = np.median(errors)
    cost = np.stack([(0.8 * deviation[0] / level) ** (1 / ORDER), plan.pair_rays * (deviation[1] / level) ** 2])
    clear = due & (np.abs(np.log2(cost[0] / cost[1])) > 1)
    assert ((cost[0] < cost[1]) == rays)[clear].mean() > 0.98


def test_pairs_that_differ_by_more_than_the_sensor_shows_are_counted_whole() -> None:
    """Glints at the centre, of a thousand times the light: gray levels of such pairs end at dark and say little."""
    plan = planned(behind_an_edge())
    values = np.full((2, hybrid.PAIRS), 0.5)
    differences = np.zeros((2, hybrid.PAIRS))
    differences[1, 3] = -500.0
    found = hybrid.of_pairs(plan, values, differences).needs(plan, lambda each: each)
    spread = 500 / math.sqrt(hybrid.PAIRS)
    # 100 gray levels for the radiance 1.
    assert found.deviation[1, 1] == pytest.approx(100 * spread, rel=0.05)
    assert found.due.tolist() == [False, True]


@pytest.mark.parametrize("number", [2, 8])
def test_noise_that_ends_at_dark_is_told_whole(number: int) -> None:
    """Half of such images are black: the mean of all is off by more than their gray levels differ."""
    seen = behind_an_edge(rows=40)
    truth, noise = 0.05, 2.0
    random = np.random.default_rng(4)
    images = random.normal(truth, noise, (number, 40, 72)).astype(np.float32)
    own = np.ones(images.shape[1:], dtype=bool)
    made = Replicates(images, np.zeros_like(images[0]), 0, 0, (1, 1), own_rays=own, uncorrected=np.zeros_like(images))
    off = gray(seen, made.mean - truth)
    found, _ = discretisation(seen, made)
    assert float((off**2).mean()) < found.upper
    assert found.mean == pytest.approx((100 * noise) ** 2 / number, rel=0.15)


@pytest.mark.parametrize("shape", [(1, 1), (3, 17), (40, 23)])
@pytest.mark.parametrize("far", [[0, 0], [1, 2], [5, 4]])
def test_what_lies_nearby_is_found_as_by_looking(shape: tuple[int, int], far: list[int]) -> None:
    camera = behind_an_edge().camera
    random = np.random.default_rng(7)
    far = [min(steps, size - 1) for steps, size in zip(far, shape, strict=True)]
    magnification, seen = random.random((2, *shape))
    seen[random.random(shape) < 0.1] = np.nan
    seen[0, 0] = 0.5
    got = cost_of_steps(camera, magnification, seen, far)
    for row, column in np.ndindex(shape):
        near = tuple(
            slice(max(0, place - steps), place + steps + 1) for place, steps in zip((row, column), far, strict=True)
        )
        if np.isnan(seen[near]).all():
            continue
        light = np.nanmax(seen[near]) - camera.sensor.dark_gray
        share = np.ptp(magnification[near]) / magnification[near].max()
        assert got[row, column] == pytest.approx(share * light / math.pi)


def edge_under_blur(x: Array, radius: float) -> Array:
    """What lies beyond an edge, of the light that a round opening's blur of that radius gathers at a distance x."""
    t = np.clip(x / radius, -1, 1)
    return 0.5 + (np.arcsin(t) + t * np.sqrt(1 - t**2)) / math.pi


# Blur of the magnification 1 [px], the magnifications, and how good an estimate that is made for small steps is there.
@pytest.mark.parametrize(
    ("blur", "near", "apart", "within"),
    [
        (8.0, 1.1, 0.05, 0.1),
        (8.0, 1.1, 0.4, 0.35),
        (400.0, 0.02, 0.005, 0.25),
        (400.0, 0.02, 0.02, 0.5),
        (0.1, 1.1, 0.3, 0.1),
        (30.0, 0.02, 0.01, 0.1),
    ],
)
def test_a_step_costs_what_the_far_light_is_spread_wrongly(
    blur: float, near: float, apart: float, within: float
) -> None:
    """The near thing is as bright as the far one: there is no contrast to see, and the kernel is off all the same."""
    camera, light = behind_an_edge().camera, 100.0
    wide = camera.aperture.diameter * blur / max(reach_px(camera, 1.0))
    camera = replace(camera, aperture=replace(camera.aperture, diameter=wide))
    gray_levels = np.full((1, 4), light + camera.sensor.dark_gray)
    magnification = np.array([[near, near, near - apart, near - apart]])
    (got,) = np.unique(cost_of_steps(camera, magnification, gray_levels, [0, 3]))
    x = np.linspace(-30.0, 30.0, 60001)
    radii = (max(one * blur, 1e-9) for one in (near - apart, near))  # in focus there is no blur
    one, other = (edge_under_blur(x, radius) for radius in radii)
    width = round(1 / (x[1] - x[0]))  # a pixel
    seen = np.convolve(one - other, np.full(width, 1 / width), mode="same")
    assert got == pytest.approx(light * np.abs(seen).max(), rel=within)


def test_rays_in_the_kernels_place_have_no_error_of_its_cells(tmp_path: Path) -> None:
    """A sharp picture in cells of a quarter of a pixel, of which rays take the place or pairs are added."""
    seen = behind_an_edge(rows=6)
    plan = planned(seen)
    with Programs() as programs:
        work = Work(seen, tmp_path, programs, Progress("", 1, shown=False), "none", 0)
        made, kernel = trace_plan(work, plan, 2), trace_plan(work, plan.kernel, 2)
        signed = tile_numbers(work, plan, 0)
    assert len(plan.tiles) == 1
    assert (signed > 0).any()
    assert (kernel.grid_squares[signed > 0] > 0).any()
    assert not made.grid_squares[signed > 0].any()
    assert np.array_equal(made.grid_squares[signed <= 0], kernel.grid_squares[signed <= 0])


def test_a_coarse_survey_is_looked_at_more_nearly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pixels that gather across the step are all looked at; of the others none that lies two pixels farther away."""
    monkeypatch.setattr("radwrap.imaging.tolerance.survey._SURVEY_SIDE", 24)
    seen = behind_an_edge(columns=200)
    plan = planned(seen)
    assert plan.seen.cost.shape == (8, 24)
    looked_at: list[Array] = []
    asked = paired

    def noted(view: View, layers: tuple[float, ...], opening: Array, u: Array, v: Array) -> tuple[Array, Array]:
        looked_at.append(np.rint(u))
        return asked(view, layers, opening, u, v)

    monkeypatch.setattr(hybrid, "paired", noted)
    for tile in range(len(plan.tiles)):
        pilot(seen, plan, tile, (1, tile), lambda _: None)
    columns = np.unique(np.concatenate(looked_at))
    middle, reach = seen.camera.principal_point[0], plan.reach_px[0]
    assert columns.min() <= middle - reach + 1 and columns.max() >= middle + reach - 1
    assert columns.min() >= middle - reach - 3 and columns.max() <= middle + reach + 3


def test_it_is_foreseen_how_many_pixels_lie_near_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the survey's coarse grid they were several times as many, and rays were taken in their place."""
    monkeypatch.setattr("radwrap.imaging.tolerance.survey._SURVEY_SIDE", 24)
    seen = behind_an_edge(rows=24, columns=600)
    plan = planned(seen)
    found = foresee(seen, plan, 0)
    near = sum(int(_near_steps(seen, plan, tile)[0].sum()) for tile in range(len(plan.tiles)))
    assert found.near == pytest.approx(near, rel=0.1)
    assert found.asked > 1.5 * near
    assert found.corrections(plan, plan.aim, 2) > found.asked + near * PAIRS * plan.pair_rays * 0.9


def wire(x: Array, y: Array) -> Array:
    """Too thin for the survey, and brighter than what it hides."""
    return np.where(np.abs(x - 2e-3) < 1.5e-4, 2.5, np.nan)


def stripes(x: Array, y: Array) -> Array:
    return np.where(np.sin(4e3 * y) > 0, 1.0, 0.2)


@pytest.mark.long
def test_what_the_survey_missed_is_corrected_too(tmp_path: Path) -> None:
    """The kernel's certificate tells, and then pilot pairs look at all pixels."""
    seen = view(Aperture("round", 2e-4), (0.5, wire), (1.0, stripes))
    outcome = search(seen, tmp_path, Demand(0.4))
    kernel, corrected = (
        [one for one in outcome.record.attempts if one.method == method] for method in ("kernel", "hybrid")
    )
    assert outcome.met and outcome.record.attempts[0].method == "kernel"
    assert min(one.rms_gray_upper95 for one in corrected) < kernel[0].rms_gray_upper95 / 3
    # Near steps first, then everywhere, for the same aim.
    first, everywhere, *_ = corrected
    assert everywhere.aim_gray == first.aim_gray and everywhere.rays > 4 * first.rays
    some = np.arange(0, seen.camera.sensor.pixels, 7)
    truth = independent_errors(seen, some, outcome.radiance.ravel()[some], rays=512, seed=(9,))
    square = float((truth.first * truth.second).mean())
    assert math.sqrt(max(square, 0.0)) < outcome.certificate.rms_gray_upper95 + 0.05


@dataclass(frozen=True)
class Glossy(Planes):
    """A plane that sends more light to the opening's rim than to its centre: 1 + (q/R)^2."""

    def trace(self, rays: Iterable[Array]) -> Generator[Array]:
        for block in rays:
            (found,) = super().trace([block])
            yield found * (1 + ((block[:, :2] / (ROUND.diameter / 2)) ** 2).sum(axis=1))


def test_a_model_that_fails_away_from_steps_is_corrected_everywhere_at_once(tmp_path: Path) -> None:
    """One depth, and half more light than the centre sees: 3/2 is the mean of 1 + s^2 over a disc."""

    def dots(x: Array, y: Array) -> Array:
        return np.where(np.sin(4e3 * x) * np.sin(4e3 * y) > 0, 1.0, 0.2)

    plain = view(ROUND, (FAR, dots), rows=12, columns=16)
    seen = replace(plain, tracer=Glossy(((FAR, dots),)))
    made = search(seen, tmp_path / "hybrid", Demand(1.0, method="hybrid"))
    assert made.met and made.method == "hybrid" and made.record.why == "asked for"
    assert made.replicates.own_rays is not None and made.replicates.own_rays.all()
    even = search(plain, tmp_path / "even", Demand(0.2, method="kernel"))
    off = gray(seen, made.radiance - 1.5 * even.radiance)
    assert math.sqrt(float((off**2).mean())) < 1.5 * (
        made.certificate.rms_gray_upper95 + even.certificate.rms_gray_upper95
    )
    assert gray(seen, 0.5 * even.radiance).mean() > 20 * TOLERANCE


@pytest.fixture(scope="module")
def dear(tmp_path_factory: pytest.TempPathFactory) -> int:
    """Rays that a fine image takes."""
    return search(behind_an_edge(), tmp_path_factory.mktemp("dear"), Demand(0.15)).record.rays


@pytest.mark.long
def test_a_budget_of_rays_is_kept(tmp_path: Path, dear: int) -> None:
    budget, seen = dear // 2, behind_an_edge()
    outcome = search(seen, tmp_path / "tight", Demand(0.15, method="hybrid", budget=Budget(rays=budget)))
    assert outcome.record.rays <= budget and not outcome.met
    assert outcome.method == "hybrid"
    again = search(seen, tmp_path / "tight", Demand(0.15, method="hybrid", budget=Budget(rays=budget)))
    assert again.record == outcome.record and np.array_equal(again.radiance, outcome.radiance)


def test_corrections_that_cannot_be_paid_are_not_begun(tmp_path: Path, dear: int) -> None:
    """Few of them would be noisier than what the kernel lacks: rays are taken, as many as the budget allows."""
    seen = behind_an_edge()
    outcome = search(seen, tmp_path / "tight", Demand(0.15, budget=Budget(rays=dear // 3)))
    assert outcome.method == "rays" and not outcome.met
    assert error_of(seen, outcome) < outcome.certificate.rms_gray_upper95 + 0.05


@dataclass(frozen=True)
class Failing(Planes):
    """Planes whose tracer dies at a call."""

    left: list[int] = field(default_factory=lambda: [10**9])

    def trace(self, rays: Iterable[Array]) -> Generator[Array]:
        self.left[0] -= 1
        if self.left[0] < 0:
            raise radwrap.TracerError("died", where="test")
        yield from super().trace(rays)


@pytest.mark.long
def test_what_is_finished_is_not_traced_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("radwrap.imaging.methods.kernel._TILE_ROWS", 40)
    base, demand = behind_an_edge(), Demand(1.0, method="hybrid")
    good = search(base, tmp_path / "good", demand)
    log = (tmp_path / "good" / CALL_LOG).read_text().split("\n")
    assert {line.split("_")[0] for line in log if line} == {"cells", "piece", "pilot", "corrections"}
    calls, runs, folder = 1, 0, tmp_path / "broken"
    while True:
        tracer = Failing(((NEAR, blind), (FAR, striped)), [calls])
        try:
            made = search(replace(base, tracer=tracer), folder, demand)
            break
        except radwrap.TracerError:
            calls, runs = calls + 3, runs + 1
    assert runs > 3
    assert np.array_equal(made.radiance, good.radiance) and made.record == good.record
    begun = (folder / CALL_LOG).read_text().split("\n")
    assert len(begun) <= len(log) + runs  # but for the piece that was being made at each death


def board() -> dict[str, Any]:
    """Dots, and a box before them, near a wide pinhole."""
    return {
        "camera": {
            "position": ["0 mm", "0 mm", "200 mm"],
            "look_at": ["0 mm", "0 mm", "0 mm"],
            "focal_length": "10 mm",
            "exposure_time": "20 ms",
            "aperture": {"diameter": "0.4 mm"},
            "diffraction": "off",
            "sensor": {
                "rows": 24,
                "columns": 32,
                "pixel_width": "40 um",
                "pixel_height": "40 um",
                "gain": "1e5 (J/m^2)^-1",
                "gamma": 1.0,
                "dark_gray": 0,
                "saturation_gray": 255,
            },
        },
        "sources": [
            {
                "type": "lamp",
                "name": "lamp",
                "position": ["60 mm", "40 mm", "200 mm"],
                "look_at": ["0 mm", "0 mm", "0 mm"],
                "diameter": "2 mm",
                "radiance": "1000 W/m^2/sr",
                "beam": {"profile": "lambertian"},
            }
        ],
        "materials": {
            "dark": {"type": "lambertian", "reflectance": 0.05},
            "white": {"type": "lambertian", "reflectance": 0.9},
        },
        "targets": [
            {
                "type": "board",
                "name": "board",
                "material": "dark",
                "dot_material": "white",
                "rows": 3,
                "columns": 4,
                "pitch": "6 mm",
                "dot_diameter": "4 mm",
            },
            {
                "type": "box",
                "name": "box",
                "position": ["2 mm", "1 mm", "120 mm"],
                "size": ["3 mm", "3 mm", "3 mm"],
                "material": "white",
            },
        ],
    }


@pytest.mark.parametrize("tracer", ["radiance", "compiled"])
def test_the_same_bytes_whoever_makes_it(tmp_path: Path, tracer: Literal["radiance", "compiled"]) -> None:
    """And the manifest says hybrid."""
    if tracer == "compiled":
        pytest.importorskip("numba")
    scene = radwrap.scene_from_document(board())
    made = [
        radwrap.render(scene, tmp_path / str(workers), method="hybrid", tracer=tracer, tolerance=3.0, workers=workers)
        for workers in (1, 3)
    ]
    assert {one.run.method for one in made} == {"hybrid"}
    assert made[0].run.plan is not None and made[0].run.plan.method == "hybrid"
    files = [(tmp_path / name / "radiant_exposure.exr").read_bytes() for name in ("1", "3")]
    assert files[0] == files[1]
