"""Honest certificates: random scenes to random tolerances, each image held against independent rays.

Tilt, distance, focal length, pinhole of any shape, dots, spheres and boxes in
front of sheets, saturation. For each scene the true rms error, from independent
values of 2048 rays at every pixel (their cross products), is compared with
`rms_gray_upper95`; values are added until the comparison is no matter of their
own noise, or there are eight. Writes out/certificates.json; exit code 1 if
the bound holds in less than 91 % of the scenes, if it is idle (median of
bound / truth above 1.5), if too few scenes break the kernel's model, or if a
planted error of 1 % goes unseen.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import radwrap
from radwrap.imaging.methods.rays import sampled_radiance
from radwrap.imaging.optics.view import View, trace_rays
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.tolerance.certificate import draw_pixels, independent_errors, root
from radwrap.imaging.tracing import traced_scene
from radwrap.manifest import plain

OUT = Path(__file__).resolve().parent.parent / "out"
COVERAGE = 0.91
IDLE = 1.5
BROKEN = 0.2  # share of the scenes that the kernel cannot do
ROWS, COLUMNS = 44, 48
TRUTH_RAYS = 2048
FEWEST_TRUTHS, MOST_TRUTHS = 4, 16
# Standard errors between truth and bound that make more values needless. They are looked at after each value: at two of
# them one bound in ten was called broken by chance.
SURE = 4.0
PLANTED = 0.01  # relative error of the radiant exposure


def draw(random: np.random.Generator) -> dict[str, Any]:
    """A scene's document."""
    f = random.uniform(6, 25)
    distance = math.exp(random.uniform(math.log(100), math.log(2000)))
    pitch = random.uniform(6, 20)  # um
    opening = math.exp(random.uniform(math.log(0.02), math.log(2.0)))
    seen = COLUMNS * pitch * 1e-3 * distance / f  # width of what is in view [mm]
    dot = seen / random.uniform(3, 9)
    targets: list[dict[str, Any]] = [
        {
            "type": "board",
            "name": "board",
            "rotation": [
                f"{random.uniform(-50, 50):.3f} deg",
                f"{random.uniform(-30, 30):.3f} deg",
                f"{random.uniform(-40, 40):.3f} deg",
            ],
            "material": "dark",
            "dot_material": str(random.choice(["white", "sheeting"])),
            "rows": 9,
            "columns": 9,
            "pitch": f"{dot * random.uniform(1.05, 1.6):.5f} mm",
            "dot_diameter": f"{dot:.5f} mm",
        }
    ]
    # A part of the scenes has something in front of the board, near enough to hide differently from each viewpoint.
    if random.random() < 0.75:
        nearness = random.uniform(0.1, 0.6)
        depth = distance * nearness
        size = seen * nearness * random.uniform(0.15, 0.5)
        z = distance - depth
        place = [f"{random.uniform(-0.3, 0.3) * seen * nearness:.5f} mm" for _ in range(2)] + [f"{z:.5f} mm"]
        part: dict[str, Any] = {"name": "part", "position": place, "material": "gray"}
        if random.random() < 0.5:
            part |= {"type": "sphere", "diameter": f"{size:.5f} mm"}
        else:
            turn = [f"{random.uniform(0, 90):.3f} deg" for _ in range(3)]
            part |= {"type": "box", "size": [f"{size * k:.5f} mm" for k in random.uniform(0.3, 1, 3)], "rotation": turn}
        targets.append(part)
    shape = str(random.choice(["round", "square", "annular", "half_disc"]))
    aperture = {"shape": shape, "diameter": f"{opening:.6f} mm", "rotation": f"{random.uniform(0, 90):.3f} deg"}
    if shape == "annular":
        aperture["inner_diameter"] = f"{opening * random.uniform(0.2, 0.8):.6f} mm"
    if shape == "round":
        del aperture["rotation"]
    side = max(20.0, opening)
    return {
        "camera": {
            "position": ["0 mm", "0 mm", f"{distance:.5f} mm"],
            "look_at": ["0 mm", "0 mm", "0 mm"],
            "focal_length": f"{f:.5f} mm",
            "exposure_time": "100 ms",
            "aperture": aperture,
            "diffraction": "off",  # the truth is rays
            "sensor": {
                "rows": ROWS,
                "columns": COLUMNS,
                "pixel_width": f"{pitch:.5f} um",
                "pixel_height": f"{pitch * random.uniform(0.8, 1.25):.5f} um",
                "gain": "3.38e4 (J/m^2)^-0.85",
                "gamma": 0.85,
                "dark_gray": 22,
                "saturation_gray": 181,
                "rounding": False,
            },
        },
        "sources": [
            {
                "type": "lamp",
                "name": "lamp",
                "position": [f"{side:.4f} mm", f"{side / 2:.4f} mm", f"{distance:.4f} mm"],
                "look_at": ["0 mm", "0 mm", "0 mm"],
                "diameter": "2 mm",
                "radiance": "1000 W/m^2/sr",
                "beam": {"profile": "lambertian"},
            }
        ],
        "materials": {
            "dark": {"type": "lambertian", "reflectance": 0.05},
            "white": {"type": "lambertian", "reflectance": 0.9},
            "gray": {"type": "lambertian", "reflectance": 0.4},
            "sheeting": {"type": "retroreflective", "model": "perturbed_normal", "reflectance": 0.6, "roughness": 0.2},
        },
        "targets": targets,
    }


def exposed(document: dict[str, Any], gray: float, folder: Path = Path()) -> radwrap.Scene | None:
    """The scene with the exposure time that brings its brightest spots to a gray level; None where nothing is lit."""
    scene = radwrap.scene_from_document(document, folder=folder)
    with traced_scene(scene) as view:
        sensor = scene.camera.sensor
        v, u = np.divmod(np.arange(sensor.pixels, dtype=np.float64), sensor.columns)
        values, _ = trace_rays(view, None, u, v)
        bright = float(np.quantile(values, 0.9)) * view.exposure_of_radiance
    if bright <= 0 or values.std() < 0.1 * values.mean():
        return None
    wanted = ((gray - sensor.dark_gray) / sensor.gain) ** (1 / sensor.gamma)
    return radwrap.with_value(
        scene, "camera.exposure_time", f"{scene.camera.exposure_time * wanted / bright * 1e3!r} ms"
    )


def true_square(
    view: View,
    gray: np.ndarray[Any, Any],
    bound: float,
    seed: int,
    sampled: Callable[..., np.ndarray[Any, Any]] = sampled_radiance,
) -> tuple[float, float]:
    """Mean square error of an image over all its pixels, and that number's standard error [gray level^2].

    `sampled` gives independent values of pixels, as `sampled_radiance` does.
    """
    v, u = np.divmod(np.arange(gray.size, dtype=np.float64), gray.shape[1])
    random = np.random.default_rng((seed, 2))
    errors: list[np.ndarray[Any, Any]] = []
    while True:
        value = sampled(view, u, v, TRUTH_RAYS, random).mean(axis=1) * view.exposure_of_radiance
        errors.append(gray_levels(value, view.camera.sensor) - gray.ravel())
        count = len(errors)
        if count < FEWEST_TRUTHS:
            continue
        # The mean over all pairs of different values: their noise is in none of the products twice.
        total, squares = np.sum(errors, axis=0), np.sum(np.square(errors), axis=0)
        products = (total**2 - squares) / (count * (count - 1))
        # What scatters is the values' noise, not the pixels, which are all there are.
        noise = np.var(errors, axis=0, ddof=1)
        own = 2 * noise**2 / (count * (count - 1)) + 4 * np.maximum(products, 0.0) * noise / count
        square, error = float(products.mean()), float(np.sqrt(own.sum())) / gray.size
        if count == MOST_TRUTHS or abs(square - bound**2) > SURE * error:
            return square, error


def judged(
    number: int, budget: float, drawn: Callable[[np.random.Generator], dict[str, Any]] = draw
) -> dict[str, Any] | None:
    """One scene, rendered and held against the truth; None where there is nothing to see."""
    random = np.random.default_rng([2026, number])
    document = drawn(random)
    try:
        scene = exposed(document, float(random.uniform(60, 260)))
    except radwrap.InputError as error:  # drawn badly: too near a wide source, a part around the camera
        return {"number": number, "refused": str(error)}
    if scene is None:
        return None
    tolerance = float(random.choice([0.2, 0.5, 1.0, 2.0]))
    start = time.monotonic()
    with tempfile.TemporaryDirectory() as out:
        result = radwrap.render(scene, out, tolerance=tolerance, budget_rays=budget, seed=number)
    wall = time.monotonic() - start
    error, plan = result.run.error, result.run.plan
    assert plan is not None  # noqa: S101  (there is a tolerance)
    with traced_scene(scene) as view:
        radiance = result.radiant_exposure.values / view.exposure_of_radiance
        gray = gray_levels(radiance * view.exposure_of_radiance, scene.camera.sensor)
        square, noise = true_square(view, gray, error.rms_gray_upper95, 1000 + number)
        truth = root(square)
        # How the certificate of independent rays sees an image that is 1 % too bright.
        sample = draw_pixels(gray, 512, (number, 1))
        planted = (radiance * (1 + PLANTED)).ravel()[sample.pixels]
        found = independent_errors(view, sample.pixels, planted, rays=256, seed=(number, 2))
        caused = gray_levels(planted * view.exposure_of_radiance, scene.camera.sensor) - gray.ravel()[sample.pixels]
    weight = caused / max(float((caused**2).sum()), 1e-30)
    # Least-squares factor of the planted error in what was found: -1 where it is seen whole.
    parts = [float((weight * half).sum()) for half in (found.first, found.second)]
    return {
        "number": number,
        "tolerance": tolerance,
        "method": result.run.method,
        "met": plan.met,
        "attempts": [(attempt.method, attempt.rays) for attempt in plan.attempts],
        "expected_model_rms_gray": plan.expected_model_rms_gray,
        "true_rms_gray": truth,
        "truth_standard_error_gray": noise / (2 * max(truth, 1e-3)),
        "error": plain(error, named=False),
        "holds": truth <= error.rms_gray_upper95,
        "ratio": error.rms_gray_upper95 / max(truth, 1e-9),
        "planted": -sum(parts) / 2,
        "planted_spread": abs(parts[0] - parts[1]) / 2,
        "wall_s": wall,
    }


def judged_by(
    judge: Callable[[int, float], dict[str, Any] | None],
    in_words: Callable[[dict[str, Any]], str],
    words: str,
    budget: float,
) -> list[dict[str, Any]]:
    """Judge as many scenes as the command line asks for, and print a line of each.

    `judge` takes a scene's number and a budget of rays. What it refuses does not count, nor where nothing is to see.
    """
    parser = argparse.ArgumentParser(description=words.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--budget", type=float, default=budget)
    arguments = parser.parse_args()
    rows: list[dict[str, Any]] = []
    number = arguments.first
    while len(rows) < arguments.scenes:
        row = judge(number, arguments.budget)
        number += 1
        if row is None or "refused" in row:
            continue
        rows.append(row)
        print(in_words(row), flush=True)
    return rows


def kept(rows: list[dict[str, Any]]) -> tuple[float, float]:
    """Share of the scenes whose bound holds, and the median of bound over truth."""
    return float(np.mean([row["holds"] for row in rows])), float(np.median([row["ratio"] for row in rows]))


def concluded(rows: list[dict[str, Any]], name: str, **more: Any) -> int:
    """Print and write what all scenes showed; exit code 1 where bounds do not hold, or are idle."""
    holds, idle = kept(rows)
    methods, met = Counter(row["method"] for row in rows), sum(row["met"] for row in rows)
    print(f"bound holds in {holds:.1%} of {len(rows)}; median bound / truth {idle:.2f}; {dict(methods)}; met {met}")
    OUT.mkdir(exist_ok=True)
    (OUT / f"{name}.json").write_text(
        json.dumps({"coverage": holds, "median_ratio": idle, **more, "rows": rows}, indent=1)
    )
    return 0 if holds >= COVERAGE and idle <= IDLE else 1


def told(row: dict[str, Any]) -> str:
    """A line of a scene."""
    return (
        f"{row['number']:4d} tol {row['tolerance']:.1f} {row['method']:6} {'met ' if row['met'] else 'MISS'} "
        f"true {row['true_rms_gray']:.4f}+-{row['truth_standard_error_gray']:.4f} "
        f"upper {row['error']['rms_gray_upper95']:.4f} "
        f"model {row['error']['model_rms_gray']:.4f} noise {row['error']['discretisation_rms_gray']:.4f} "
        f"{'' if row['holds'] else 'BROKEN BOUND '}planted {row['planted']:.2f} {row['wall_s']:.1f} s "
        f"{row['attempts']}"
    )


def main() -> int:
    """Draw, judge, print."""
    rows = judged_by(judged, told, __doc__ or "", 2e7)
    broken = sum(row["method"] != "kernel" for row in rows)
    seen = float(np.mean([row["planted"] > 0.5 for row in rows]))
    code = concluded(rows, "certificates", broken=broken, planted=seen)
    print(f"planted {PLANTED:.0%} seen in {seen:.1%}")
    return code if broken >= BROKEN * len(rows) and seen >= 0.95 else 1


if __name__ == "__main__":
    sys.exit(main())
