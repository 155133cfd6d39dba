"""Dots on rendered boards: `measure dots` against OpenCV's findCirclesGrid on the same pictures.

Draws poses, distances, pinholes, exposures, beams and noise from a seed,
renders each board, and compares both to the true projected centres. Prints
the table and all failures; writes out/dots_benchmark.json. Exit code 1 if
OpenCV finds more boards than we do, or `conic` is less accurate than OpenCV on the
boards that both find.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import radwrap
from radwrap.images import GrayImage
from radwrap.measure.dots import METHODS, DotsNotFound, find_dots_by

ROOT = Path(__file__).resolve().parent.parent
SCENE = ROOT / "rad_scenes" / "bench_board" / "scene.toml"
ROWS = COLUMNS = 5
PITCH, DIAMETER = 19.05e-3, 15.875e-3
SATURATION = 181.0
LARGEST_TILT = 60.0  # degrees
PINHOLES = (0.0, 0.05, 0.1, 0.15, 0.2)  # diameter [mm]
BEAMS = (7.6, 15.0, 30.0)  # full width at half maximum [degrees]
# A centre that is off by more than this is another thing than the dot [px].
ASTRAY = 2.0
# Rms of OpenCV's grid about its homography, from which on it is tried again with other parameters [px].
LARGEST_MISFIT = 0.7

Points = NDArray[np.float64]


def draw(random: np.random.Generator, scene: dict[str, Any]) -> dict[str, Any]:
    """Overrides of one case: drawn again until all dots lie in view."""
    camera = scene["camera"]
    while True:
        angles = [random.uniform(-60, 60), random.uniform(-45, 45), random.uniform(-30, 30)]
        distance = random.uniform(600, 1200)
        shift = random.uniform(-15, 15, 2)
        tilt = math.degrees(math.acos(math.cos(math.radians(angles[0])) * math.cos(math.radians(angles[1]))))
        reach = 61 * 12.5 / (distance - 50 * math.sin(math.radians(tilt)))  # half a board's diagonal on the sensor [mm]
        if tilt <= LARGEST_TILT and reach + 15 * 12.5 / distance < 0.5 * 165 * 16e-3 * 1.15:
            break
    pinhole = random.choice(PINHOLES)
    exposure = 387 * random.uniform(0.3, 2.5) * (0.1 / (pinhole or 0.1)) ** 2
    assert camera["sensor"]["preset"] == "fivs"  # noqa: S101  (its saturation is written above)
    return {
        "camera.position": ["0 mm", "0 mm", f"{distance:.3f} mm"],
        "sources[0].position": ["0 mm", "0 mm", f"{distance:.3f} mm"],
        "sources[0].count": 3,
        "sources[0].beam.width": f"{random.choice(BEAMS)} deg",
        "camera.aperture.diameter": f"{pinhole} mm",
        "camera.exposure_time": f"{exposure:.4g} ms",
        "targets[0].rotation": [f"{angle:.3f} deg" for angle in angles],
        "targets[0].position": [f"{shift[0]:.3f} mm", f"{shift[1]:.3f} mm", "0 mm"],
    }


def rendered(changes: dict[str, Any], random: np.random.Generator) -> tuple[GrayImage, Points] | None:
    """Noisy picture and true centres; None where a dot is out of view."""
    pinhole = float(changes["camera.aperture.diameter"].split()[0])
    # The finer pinhole needs rays within the pixel, the wider one enough sub-viewpoints to look smooth.
    how = {"method": "pinhole", "pixel_samples": 3} if pinhole == 0 else {"viewpoints": 19 if pinhole <= 0.1 else 37}
    with tempfile.TemporaryDirectory() as out:
        result = radwrap.render(radwrap.load_scene(SCENE, changes), out, truth=True, **how)
        truth = json.loads((Path(out) / "truth.json").read_text())
    dots = truth["targets"]["board"]["dots"]
    centres = np.array([(dot["u"], dot["v"]) for dot in dots])
    rows, columns = result.gray.values.shape
    if not ((centres > 13).all() and (centres < (columns - 14, rows - 14)).all()):
        return None
    noisy = result.gray.values + random.normal(0, random.uniform(0, 1.5), result.gray.values.shape)
    return GrayImage(np.rint(np.clip(noisy, 0, SATURATION)), 8), centres


def attempts(gray: Points) -> Iterator[tuple[str, NDArray[np.uint8], int, Any, int]]:
    """Ways to use findCirclesGrid well: contrast stretched, inverted, enlarged, detectors from strict to lenient."""
    lowest, highest = np.percentile(gray, 1), gray.max()
    dark_dots = np.clip(np.rint(255 * (1 - (gray - lowest) / (highest - lowest))), 0, 255).astype(np.uint8)
    for lenient, clustering, scale in itertools.product((False, True), (False, True), (4, 2, 1)):
        picture = cv2.resize(dark_dots, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        parameters = cv2.SimpleBlobDetector_Params()
        parameters.filterByColor = True
        parameters.blobColor = 0
        parameters.minThreshold, parameters.maxThreshold, parameters.thresholdStep = 5, 250, 5
        parameters.minRepeatability = 2
        parameters.minDistBetweenBlobs = 3 * scale
        parameters.minArea, parameters.maxArea = 8 * scale**2, 900 * scale**2
        parameters.filterByCircularity = False
        parameters.filterByInertia = not lenient
        parameters.minInertiaRatio = 0.05
        parameters.filterByConvexity = not lenient
        parameters.minConvexity = 0.8
        flags = cv2.CALIB_CB_SYMMETRIC_GRID | (cv2.CALIB_CB_CLUSTERING if clustering else 0)
        yield (
            f"x{scale} {'lenient' if lenient else 'strict'}{' clustering' if clustering else ''}",
            picture,
            scale,
            cv2.SimpleBlobDetector_create(parameters),
            flags,
        )


def by_opencv(gray: Points) -> tuple[Points | None, str]:
    """Centres by the first set of parameters that finds a grid, and which; or why none does."""
    most = crooked = 0
    board = np.array([(c, r) for r in range(ROWS) for c in range(COLUMNS)], dtype=np.float64)
    for name, picture, scale, detector, flags in attempts(gray):
        found, centres = cv2.findCirclesGrid(picture, (COLUMNS, ROWS), flags=flags, blobDetector=detector)
        if found:
            places = (centres.reshape(-1, 2).astype(np.float64) + 0.5) / scale - 0.5
            matrix, _ = cv2.findHomography(board, places)
            if matrix is not None:
                missed = cv2.perspectiveTransform(board[:, None], matrix)[:, 0] - places
                # A grid that no homography fits has other things for dots: the next attempt may do better.
                if np.sqrt(np.mean(np.sum(missed**2, axis=1))) < LARGEST_MISFIT:
                    return places, name
            crooked += 1
        most = max(most, len(detector.detect(picture)))
    return None, f"no grid; {crooked} crooked ones, at most {most} blobs of {ROWS * COLUMNS}"


def matched(centres: Points, truth: Points) -> Points:
    """Errors, after the turn or mirror that suits the centres best: OpenCV does not promise an order."""
    grid = centres.reshape(ROWS, COLUMNS, 2)
    turns = [
        turn for base in (grid, grid.transpose(1, 0, 2)) for turn in (base, base[::-1], base[:, ::-1], base[::-1, ::-1])
    ]
    return min((turn.reshape(-1, 2) - truth for turn in turns), key=lambda error: float((error**2).sum()))


def blur_over_pitch(changes: dict[str, Any], truth: Points) -> float:
    """Diameter of the pinhole's blur over the smallest step between neighbours.

    From 1.22 on the blur's transfer function is negative there: gaps are brighter than dots.
    """
    distance = float(changes["camera.position"][2].split()[0])
    pinhole = float(changes["camera.aperture.diameter"].split()[0])
    blur = pinhole * (1 + 12.5 / distance)  # on the sensor [mm]
    grid = (truth * (13.75e-3, 16e-3)).reshape(ROWS, COLUMNS, 2)
    steps = [np.linalg.norm(np.diff(grid, axis=axis), axis=2).min() for axis in (0, 1)]
    return float(blur / min(steps))


def case(changes: dict[str, Any], gray: GrayImage, truth: Points) -> dict[str, Any]:
    """Errors of all methods on one picture [px]; None where the dots are not found."""
    errors: dict[str, list[list[float]] | None] = {}
    why: dict[str, str] = {}
    try:
        ours = find_dots_by(gray, ROWS, COLUMNS, pitch=PITCH, dot_diameter=DIAMETER, saturation=SATURATION)
        split = any(dot.split for dot in ours["gray"].dots)
        for method, dots in ours.items():
            errors[method] = (dots.centres - truth).tolist()
    except DotsNotFound as error:
        errors |= dict.fromkeys(METHODS)
        why["ours"], split = error.what, False
    centres, how = by_opencv(gray.values)
    errors["opencv"] = None if centres is None else matched(centres, truth).tolist()
    if centres is None:
        why["opencv"] = how
    for name, error in errors.items():
        if error is not None and np.abs(error).max() > ASTRAY:
            why["opencv" if name == "opencv" else "ours"] = f"{name}: centres off by {np.abs(error).max():.1f} px"
            errors[name] = None
    return {
        "scene": changes,
        "pinhole_mm": float(changes["camera.aperture.diameter"].split()[0]),
        "blur_over_pitch": blur_over_pitch(changes, truth),
        "gray": [float(gray.values.min()), float(gray.values.max())],
        "split": split,
        "errors": errors,
        "failures": why,
    }


def rms(cases: list[dict[str, Any]], name: str) -> float:
    """Root mean square distance to the true centres over all dots of cases that are found [px]."""
    errors = [np.array(one["errors"][name]) for one in cases if one["errors"][name] is not None]
    return float(np.sqrt(np.mean(np.sum(np.concatenate(errors) ** 2, axis=1)))) if errors else math.nan


def main() -> int:
    """Draw, render, measure, print, judge."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    random = np.random.default_rng(arguments.seed)
    scene = tomllib.loads(SCENE.read_text())
    cases: list[dict[str, Any]] = []
    while len(cases) < arguments.cases:
        changes = draw(random, scene)
        made = rendered(changes, random)
        if made is None:
            continue
        cases.append(case(changes, *made))
        for who, reason in cases[-1]["failures"].items():
            blurred = f"pinhole {cases[-1]['pinhole_mm']} mm, blur {cases[-1]['blur_over_pitch']:.2f} of the pitch"
            print(f"case {len(cases) - 1}, {blurred}: {who}: {reason}", flush=True)
    names = [*METHODS, "opencv"]
    groups = {"all": cases} | {f"d_p {d} mm": [one for one in cases if one["pinhole_mm"] == d] for d in PINHOLES}
    table = []
    for label, group in groups.items():
        both = [one for one in group if all(one["errors"][name] is not None for name in names)]
        table.append(
            {
                "group": label,
                "cases": len(group),
                "found": {name: sum(one["errors"][name] is not None for one in group) for name in names},
                "rms_px": {name: rms(group, name) for name in names},
                "both_found": len(both),
                "rms_px_where_both_found": {name: rms(both, name) for name in names},
            }
        )
    print(f"\n{'':14}{'cases':>6} | " + "".join(f"{name:>16}" for name in names))
    for line in table:
        print(f"{line['group']:14}{line['cases']:6} | " + "".join(f"{line['found'][n]:>10} found" for n in names))
        print(f"{'':14}{'':6} | " + "".join(f"{line['rms_px'][n]:>13.4f} px" for n in names))
        both = line["rms_px_where_both_found"]
        print(f"{'  by all':14}{line['both_found']:6} | " + "".join(f"{both[n]:>13.4f} px" for n in names))
    report = ROOT / "out" / "dots_benchmark.json"
    report.parent.mkdir(exist_ok=True)
    clean = json.loads(
        json.dumps({"seed": arguments.seed, "table": table, "cases": cases}), parse_constant=lambda _: None
    )
    report.write_text(json.dumps(clean))
    whole = table[0]
    common = whole["rms_px_where_both_found"]
    found_as_often = min(whole["found"][name] for name in METHODS) >= whole["found"]["opencv"]
    return 0 if found_as_often and not common["conic"] > common["opencv"] else 1


if __name__ == "__main__":
    sys.exit(main())
