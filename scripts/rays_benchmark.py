"""What `rays` costs to a fifth of a gray level, against plain random rays, as many for each pixel, in the same run.

rad_scenes/bench_board with fewer, larger pixels. Both errors are measured
against rays that neither used. Plain sampling is given its best: the fewest
rays a pixel with that error, no search and no certificate. Writes
out/rays_benchmark.json; exit code 1 if plain sampling is as fast.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import radwrap
from bench import ROOT, SCENE, finer
from radwrap.imaging.demand import Demand
from radwrap.imaging.optics.view import View, trace_rays
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.tolerance.planner import render_to_tolerance
from radwrap.imaging.tolerance.replicates import Work
from radwrap.imaging.tracing import traced_scene
from radwrap.process import Programs
from radwrap.progress import Progress
from radwrap.study.reference import Reference, distance, take_reference

SIZE = (32, 28)
TOLERANCE = 0.2
REFERENCE_PIXELS, REFERENCE_RAYS = 400, 8192
PILOT = 64  # plain rays a pixel that tell how many are needed
RAYS_HELD = 1 << 20


def plain(view: View, pixels: np.ndarray, number: int, seed: int) -> np.ndarray:
    """Mean of L cos^4(theta) over so many plain random rays of each pixel; the opening is a disc."""
    random = np.random.default_rng(seed)
    row, column = np.divmod(pixels, view.camera.sensor.columns)
    means = np.empty(len(pixels))
    step = max(1, RAYS_HELD // number)
    for start in range(0, len(pixels), step):
        part = slice(start, start + step)
        count = len(pixels[part])
        draws = random.random((4, count * number))
        radius = view.camera.aperture.diameter / 2 * np.sqrt(draws[0])
        opening = np.stack([radius * np.cos(2 * np.pi * draws[1]), radius * np.sin(2 * np.pi * draws[1])], axis=1)
        u, v = (np.repeat(place[part], number) + draw - 0.5 for place, draw in ((column, draws[2]), (row, draws[3])))
        values, _ = trace_rays(view, opening, u, v)
        means[part] = values.reshape(count, number).mean(axis=1)
    return means


def rms(view: View, reference: Reference, radiance: np.ndarray) -> float:
    """Error at the reference's pixels [gray level]."""
    gray = gray_levels(radiance * view.exposure_of_radiance, view.camera.sensor)
    return distance(reference, gray).rms_gray


def main() -> int:
    """Measure, print, judge."""
    scene = radwrap.load_scene(SCENE, finer(*SIZE))
    with traced_scene(scene) as view, Programs() as programs, tempfile.TemporaryDirectory() as folder:
        reference = take_reference(view, pixels=REFERENCE_PIXELS, rays=REFERENCE_RAYS, seed=1)
        pixels = reference.sample.pixels
        work = Work(view, Path(folder), programs, Progress("", 1, shown=False), "bench", 0)
        start = time.perf_counter()
        outcome = render_to_tolerance(work, Demand(TOLERANCE, method="rays"))
        ours = {"seconds": time.perf_counter() - start, "rays": float(outcome.record.rays)}
        ours |= {"rms_gray": rms(view, reference, outcome.radiance.ravel()[pixels])}
        ours |= {"rms_gray_upper95": outcome.certificate.rms_gray_upper95}
        first = rms(view, reference, plain(view, pixels, PILOT, 2))
        number = round(PILOT * (first / ours["rms_gray"]) ** 2)
        start = time.perf_counter()
        reached = rms(view, reference, plain(view, pixels, number, 3))
        scale = scene.camera.sensor.pixels / len(pixels)
        seconds = (time.perf_counter() - start) * scale
    other = {"seconds": seconds, "rays": number * scene.camera.sensor.pixels, "rms_gray": reached}
    ratios = {key: other[key] / ours[key] for key in ("seconds", "rays")}
    print(f"rays to {TOLERANCE}: {ours}")
    print(f"plain random, {number} rays a pixel, on {len(pixels)} pixels, scaled: {other}")
    passed = ratios["seconds"] > 1
    verdict = "ok  " if passed else "MISS"
    print(f"{verdict} plain sampling takes {ratios['seconds']:.2f} x the time, {ratios['rays']:.2f} x the rays")
    report = ROOT / "out" / "rays_benchmark.json"
    report.parent.mkdir(exist_ok=True)
    report.write_text(json.dumps({"rays": ours, "plain": other, "ratios": ratios}, indent=2) + "\n")
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
