"""What a tolerance costs, against the paper's sub-viewpoints in the same run, on three sizes of the same sensor.

Errors are measured against rays that no method used. The sub-viewpoints are
timed at their best: cheapest number, layout and pixel sampling of all that
were tried, one tracer process a core, summed in memory, no files, no
certificate. Writes out/bench_tolerance.json; exit code 1 if a limit is missed.

Names of sections as arguments ("table", "cost") run only these.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Generator, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import radwrap
from bench import ROOT, SCENE, command, finer, peak_memory
from radwrap.images import RadianceImage, read_image, write_exr, write_png
from radwrap.imaging.methods.kernel import plan_kernel
from radwrap.imaging.optics.aperture import LAYOUTS, Layout, sub_viewpoints
from radwrap.imaging.optics.view import PixelPlan, PixelSampling, View
from radwrap.imaging.output.run_manifest import run_manifest_of
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.response.exposure import radiant_exposure
from radwrap.imaging.response.sensor import GrayWhereAsked, gray_image, gray_levels
from radwrap.imaging.tolerance.certificate import draw_pixels, model_errors
from radwrap.imaging.tolerance.replicates import Work, discretisation, trace_replicates
from radwrap.imaging.tolerance.survey import AIM_SHARE, met_by, middle_of, survey
from radwrap.imaging.tracing import traced_scene
from radwrap.process import Programs
from radwrap.progress import Progress
from radwrap.study.paper_method import summed_viewpoints
from radwrap.study.reference import Reference, distance, take_reference
from radwrap.tracers.tracer import Tracer

SIZES = ((192, 165), (1024, 880), (2448, 2048))
TOLERANCES = (1.0, 0.5, 0.2, 0.1)
JUDGED = 0.5
LEDS = (1, 12, 64)
ROUNDS = 3

WHOLE_COMMAND_LIMIT = 1.5  # s, at 192 x 165
GAIN_LIMITS = {(192, 165): 10.0, (1024, 880): 100.0, (2448, 2048): 300.0}
GROWTH_LIMIT = 2.0  # time at 2448 x 2048 against 1024 x 880
MEMORY_LIMIT = 1.5 * 2**30

REFERENCE_PIXELS, REFERENCE_RAYS = 1500, 1024
HEXAGONAL_NUMBERS = [3 * k * (k + 1) + 1 for k in range(1, 20)]  # centred: 7, 19, 37, ... 1141
TRIAL_NUMBER = 61
# Pixel samples and sampling that are tried with the best layout.
SAMPLINGS: tuple[tuple[int, PixelSampling], ...] = ((2, "centre"), (1, "centre"), (1, "jitter"))
TIMED_RAYS = 2_500_000  # of the sub-viewpoints; where they are more, every n-th pixel is timed, and the time scaled


@dataclass(frozen=True, slots=True)
class Paper:
    """A setting of the paper's method, and its rms error [gray level]."""

    number: int
    layout: Layout
    samples: int
    sampling: PixelSampling
    rms: float

    @property
    def rays(self) -> int:
        """Rays a pixel."""
        return self.number * self.samples**2

    def __str__(self) -> str:
        return f"{self.number} {self.layout}, {self.samples}x{self.samples} {self.sampling}"


@dataclass(slots=True)
class PaperMethod:
    """The paper's method on one scene, with all errors that were looked up so far."""

    view: View
    programs: Programs
    reference: Reference
    known: dict[tuple[int, Layout, int, PixelSampling], Paper] = field(default_factory=dict)

    def at(self, number: int, layout: Layout, samples: int, sampling: PixelSampling) -> Paper:
        """Error of a setting; only the reference's pixels are traced."""
        key = (number, layout, samples, sampling)
        if key not in self.known:
            radiance = self._trace(*key, pixels=self.reference.sample.pixels)
            gray = gray_levels(radiance * self.view.exposure_of_radiance, self.view.camera.sensor)
            self.known[key] = Paper(*key, distance(self.reference, gray).rms_gray)
        return self.known[key]

    def _trace(
        self, number: int, layout: Layout, samples: int, sampling: PixelSampling, pixels: NDArray[np.intp]
    ) -> NDArray[np.float64]:
        viewpoints = sub_viewpoints(self.view.camera.aperture, number, layout)
        return summed_viewpoints(self.view, viewpoints, PixelPlan(samples, sampling), self.programs, pixels=pixels)

    def best_layout(self) -> Layout:
        """By the error at one number of sub-viewpoints."""
        return min(
            (self.at(TRIAL_NUMBER, layout, 1, "centre") for layout in LAYOUTS), key=lambda found: found.rms
        ).layout

    def cheapest(self, rms: float) -> Paper | None:
        """Fewest rays with at most this error; None where no number that is tried reaches it."""
        layout = self.best_layout()
        best: Paper | None = None
        for samples, sampling in SAMPLINGS:
            # A way of sampling that needs more rays than the best one so far is not looked at further.
            most = HEXAGONAL_NUMBERS[-1] if best is None else best.rays - 1
            numbers = [number for number in HEXAGONAL_NUMBERS if number * samples**2 <= most]
            best = self._fewest(numbers, layout, samples, sampling, rms) or best
        return best

    def _fewest(
        self, numbers: list[int], layout: Layout, samples: int, sampling: PixelSampling, rms: float
    ) -> Paper | None:
        """By bisection: the error falls with the number, but for chance."""
        if not numbers or self.at(numbers[-1], layout, samples, sampling).rms > rms:
            return None
        low, high = -1, len(numbers) - 1
        while high - low > 1:
            middle = (low + high) // 2
            if self.at(numbers[middle], layout, samples, sampling).rms <= rms:
                high = middle
            else:
                low = middle
        return self.at(numbers[high], layout, samples, sampling)

    def seconds(self, setting: Paper) -> tuple[float, str]:
        """Time for the whole sensor, and how it was taken."""
        pixels = self.view.camera.sensor.pixels
        stride = max(1, round(setting.rays * pixels / TIMED_RAYS))
        chosen = np.arange(stride // 2, pixels, stride)
        start = time.perf_counter()
        self._trace(setting.number, setting.layout, setting.samples, setting.sampling, chosen)
        seconds = (time.perf_counter() - start) * pixels / len(chosen)
        return seconds, "all pixels" if stride == 1 else f"every {stride}th pixel, scaled"


def commanded(overrides: dict[str, object], tolerance: float, reference: Reference) -> dict[str, float]:
    """Times of the whole command [s], best of several, and the error of its image [gray level]."""
    best: dict[str, float] = {"command_s": float("inf")}
    for _ in range(ROUNDS):
        with tempfile.TemporaryDirectory() as out:
            words = [*command(overrides, "--tolerance", repr(tolerance)), "--out", out]
            start = time.perf_counter()
            done = subprocess.run(words, capture_output=True, check=True, text=True)
            wall = time.perf_counter() - start
            if wall > best["command_s"]:
                continue
            made = run_manifest_of(json.loads(done.stdout), "the command's output")
            exposure = read_image(Path(out) / "radiant_exposure.exr")[0].astype(np.float64)
        sensor = radwrap.load_scene(SCENE, overrides).camera.sensor
        seen = distance(reference, gray_levels(exposure.ravel()[reference.sample.pixels], sensor))
        best = {
            "command_s": wall,
            "without_start_s": made.timing.wall_s,
            "start_s": wall - made.timing.wall_s,
            "rays": made.rays,
            "rms_gray": seen.rms_gray,
            "p99_gray": seen.p99_gray,
            "rms_gray_upper95": made.error.rms_gray_upper95,
        }
    return best


def table(size: tuple[int, int]) -> list[dict[str, Any]]:
    """A row for each tolerance: ours, and the cheapest sub-viewpoints with that error."""
    overrides = finer(*size)
    rows = []
    scene = radwrap.load_scene(SCENE, overrides)
    with traced_scene(scene, RenderOptions()) as view, Programs() as programs:
        reference = take_reference(view, pixels=REFERENCE_PIXELS, rays=REFERENCE_RAYS, seed=1)
        paper = PaperMethod(view, programs, reference)
        for tolerance in TOLERANCES:
            row: dict[str, Any] = {"size": size, "tolerance": tolerance, **commanded(overrides, tolerance, reference)}
            row["reference_rms_gray"] = reference.rms_gray
            wanted = {"paper": tolerance}
            if tolerance == JUDGED:
                wanted["paper_at_our_rms"] = row["rms_gray"]
            for name, rms in wanted.items():
                setting = paper.cheapest(rms)
                if setting is None:
                    row[name] = None
                    continue
                seconds, how = paper.seconds(setting)
                gain = seconds / row["without_start_s"]
                row[name] = {
                    "setting": str(setting),
                    "rms_gray": setting.rms,
                    "seconds": seconds,
                    "timed": how,
                    "gain": gain,
                }
            rows.append(row)
            print(_told(row), flush=True)
    return rows


def _told(row: dict[str, Any]) -> str:
    text = (
        f"{row['size'][0]:4} x {row['size'][1]:4}  tolerance {row['tolerance']:3}: command {row['command_s']:6.2f} s, "
        f"without start {row['without_start_s']:6.2f} s, rms {row['rms_gray']:.3f} (certified "
        f"{row['rms_gray_upper95']:.3f}), {row['rays']:.3g} rays"
    )
    for name, what in (("paper", "viewpoints for that tolerance"), ("paper_at_our_rms", "viewpoints for our rms")):
        if name not in row:
            continue
        found = row[name]
        if found is None:
            text += f"\n    {what}: not with {HEXAGONAL_NUMBERS[-1]} rays a pixel"
        else:
            text += (
                f"\n    {what}: {found['setting']}, rms {found['rms_gray']:.3f}, {found['seconds']:.1f} s "
                f"({found['timed']}): {found['gain']:.3g} x"
            )
    return text


@dataclass(frozen=True, slots=True)
class WatchedTracer:
    """A tracer that adds up how long its callers wait for it [s], over all threads."""

    tracer: Tracer
    waited: list[float]

    def trace(self, rays: Iterable[NDArray[np.float64]]) -> Generator[NDArray[np.float64]]:
        """As the tracer."""
        yield from self._watched(self.tracer.trace(rays))

    def trace_with_distances(
        self, rays: Iterable[NDArray[np.float64]]
    ) -> Generator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """As the tracer."""
        yield from self._watched(self.tracer.trace_with_distances(rays))

    def distances(self, rays: Iterable[NDArray[np.float64]]) -> Generator[NDArray[np.float64]]:
        """As the tracer."""
        yield from self._watched(self.tracer.distances(rays))

    def _watched(self, answers: Generator[Any]) -> Generator[Any]:
        while True:
            start = time.perf_counter()
            answer = next(answers, None)
            self.waited.append(time.perf_counter() - start)
            if answer is None:
                return
            yield answer


def profile(overrides: dict[str, object]) -> dict[str, float]:
    """Where the time of a render to half a gray level goes [s]: its stages one after the other, start apart."""
    scene = radwrap.load_scene(SCENE, overrides)
    spent: dict[str, float] = {}
    last = time.perf_counter()

    def passed(stage: str) -> None:
        nonlocal last
        now = time.perf_counter()
        spent[stage], last = now - last, now

    with tempfile.TemporaryDirectory() as place, traced_scene(scene) as bare, Programs() as programs:
        passed("scene and octree")
        waited: list[float] = []
        view = replace(bare, tracer=WatchedTracer(bare.tracer, waited))
        found = survey(view, 0)
        passed("survey")
        work = Work(view, Path(place), programs, Progress("", 1, shown=False), "bench", 0)
        # The aim of the planner's first attempt: its share of the tolerance, for the mean of two.
        plan = plan_kernel(view, middle_of(met_by(view, found.magnification)), AIM_SHARE * JUDGED * 2**0.5)
        waited.clear()
        replicates = trace_replicates(work, plan, 2)
        passed("tracer and gathering")
        # Both replicates wait and gather side by side.
        spent["of it waiting for the tracer"] = sum(waited) / min(2, view.workers)
        radiance = replicates.mean
        discretisation(view, replicates)
        gray = GrayWhereAsked(radiance, view.exposure_of_radiance, scene.camera.sensor)
        even = np.zeros(gray.shape, dtype=bool)
        sample = draw_pixels(gray, 512, (0, 10, 0), risky=even, pairs=(4, 4))
        errors = model_errors(view, plan.layers, sample, radiance.ravel()[sample.pixels], seed=(0, 11, 0))
        errors.mean_square(sample, (0, 12, 0))
        passed("certificate")
        exposure = radiant_exposure(RadianceImage(radiance), scene.camera)
        codes = gray_image(exposure, scene.camera.sensor).codes
        write_exr(Path(place) / "h.exr", exposure.values.astype(np.float32), channel="radiant_exposure")
        write_png(Path(place) / "g.png", codes)
        passed("files")
    return spent


def cost(size: tuple[int, int], leds: int) -> dict[str, Any]:
    """Time for each megapixel, memory, and where the time goes, with as much light from any number of LEDs."""
    overrides = {**finer(*size), "sources[0].count": leds, "sources[0].radiance": f"{2324 * 12 / leds!r} W/m^2/sr"}
    wall = without = float("inf")
    for _ in range(ROUNDS):
        with tempfile.TemporaryDirectory() as out:
            start = time.perf_counter()
            words = [*command(overrides, "--tolerance", repr(JUDGED)), "--out", out]
            done = subprocess.run(words, capture_output=True, check=True, text=True)
            wall = min(wall, time.perf_counter() - start)
            made = run_manifest_of(json.loads(done.stdout), "the command's output")
            without = min(without, made.timing.wall_s)
    row = {
        "size": size,
        "leds": leds,
        "command_s": wall,
        "without_start_s": without,
        "seconds_per_megapixel": without / (size[0] * size[1] / 1e6),
        "rays": made.rays,
        "peak_memory_bytes": peak_memory(overrides, "--tolerance", repr(JUDGED)),
        "stages_s": {"start": wall - without, **profile(overrides)},
    }
    stages = ", ".join(f"{stage} {seconds:.2f}" for stage, seconds in row["stages_s"].items())
    print(
        f"{size[0]:4} x {size[1]:4}, {leds:2} LEDs: {without:.2f} s without start, "
        f"{row['seconds_per_megapixel']:.3g} s a megapixel, {row['peak_memory_bytes'] / 2**20:.0f} MiB; {stages} s",
        flush=True,
    )
    return row


def judged(rows: list[dict[str, Any]], costs: list[dict[str, Any]]) -> list[tuple[str, str, str, bool]]:
    """What was measured against its limits."""
    at = {row["size"]: row for row in rows if row["tolerance"] == JUDGED}
    lines = []
    if rows:
        small = at[SIZES[0]]["command_s"]
        lines.append(
            ("whole command, 192 x 165", f"{small:.2f} s", f"< {WHOLE_COMMAND_LIMIT} s", small < WHOLE_COMMAND_LIMIT)
        )
        for size, limit in GAIN_LIMITS.items():
            gain = at[size]["paper"]["gain"] if at[size]["paper"] else 0.0
            what = f"viewpoints against --tolerance {JUDGED}, {size[0]} x {size[1]}"
            lines.append((what, f"{gain:.3g} x", f">= {limit:g}", gain >= limit))
        growth = at[SIZES[2]]["without_start_s"] / at[SIZES[1]]["without_start_s"]
        lines.append(
            ("time, 2448 x 2048 against 1024 x 880", f"{growth:.2f} x", f"<= {GROWTH_LIMIT}", growth <= GROWTH_LIMIT)
        )
    if costs:
        peak = max(row["peak_memory_bytes"] for row in costs)
        limit = f"< {MEMORY_LIMIT / 2**20:.0f} MiB"
        lines.append(("peak memory of a tolerance", f"{peak / 2**20:.0f} MiB", limit, peak < MEMORY_LIMIT))
    return lines


def main(sections: list[str]) -> int:
    """Measure, print, judge."""
    print(f"errors against 2 x {REFERENCE_RAYS} other rays at {REFERENCE_PIXELS} pixels, their noise taken out")
    rows = [row for size in SIZES for row in table(size)] if not sections or "table" in sections else []
    costs = []
    if not sections or "cost" in sections:
        costs = [cost(size, 12) for size in SIZES] + [cost(SIZES[1], leds) for leds in LEDS if leds != 12]
    lines = judged(rows, costs)
    for what, ours, limit, passed in lines:
        print(f"{'ok  ' if passed else 'MISS'} {what:52} {ours:>10}  {limit}")
    report = ROOT / "out" / "bench_tolerance.json"
    report.parent.mkdir(exist_ok=True)
    verdicts = [dict(zip(("what", "ours", "limit", "pass"), line, strict=True)) for line in lines]
    report.write_text(json.dumps({"table": rows, "cost": costs, "limits": verdicts}, indent=2))
    return 0 if all(line[3] for line in lines) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
