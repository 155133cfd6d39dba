"""By how much standard errors of a calibration are too small where real detectors find the points.

    python scripts/detector_sigma.py [--views 60] [--group 10] [--noise G] [--json FILE]

Renders views of the chessboard and of the grid of circles as `target_detectors.py` does, takes groups of them for
calibrations, and holds what each found of fx, fy, cx and cy against the scene's camera: (found - true)/sigma, whose
rms is 1 where sigma says what it should. Beside each detector stands its control: true points with Gaussian noise of
the detector's own rms, of as many calibrations.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import radwrap
from radwrap.calibrate.several_views import calibrate_views
from radwrap.calibrate.views import CalibrationView
from radwrap.errors import InputError
from radwrap.images import GrayImage
from target_detectors import TOLERANCE, detectors, points_of, scenes

NAMES: Final = ("chessboard", "circles")
PARAMETERS: Final = ("fx", "fy", "cx", "cy")
LEFT_OUT: Final = ("circles, of ellipses",)  # whose truth is no pinhole's
FAR: Final = 2.0  # px; a view with a point that is farther off is left out, as a person would
Points = NDArray[np.float64]


def main() -> None:
    """Render, find, calibrate, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--views", type=int, default=60, help="renders of each target")
    parser.add_argument("--group", type=int, default=10, help="views of a calibration")
    parser.add_argument("--noise", type=float, default=1.0, help="of the pictures [gray level]")
    parser.add_argument("--targets", nargs="+", choices=NAMES, default=NAMES)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    told: dict[str, Any] = {}
    for name in given.targets:
        seen = views_of(name, given.views, given.noise)
        for detector, (camera, size, views) in seen.items():
            found = judged(camera, size, views, given.group)
            told[f"{name}, {detector}"] = found
            print(f"{name}, {detector}: {json.dumps(found)}", flush=True)
    if given.json is not None:
        given.json.write_text(json.dumps(told, indent=1))


def views_of(name: str, count: int, noise: float) -> dict[str, tuple[Any, tuple[int, int], list[tuple[Points, ...]]]]:
    """For each detector the camera, the picture's size, and of each view it finds points, true and found places."""
    result: dict[str, tuple[Any, tuple[int, int], list[tuple[Points, ...]]]] = {}
    for number, scene in enumerate(scenes(name, count)):
        image = radwrap.render(scene, tolerance=TOLERANCE, seed=number, workers=1).gray
        random = np.random.default_rng(1000 + number)
        noisy = np.clip(np.rint(image.values + noise * random.standard_normal(image.values.shape)), 0, 255)
        plate = np.array([(point["x"], point["y"], 0.0) for point in points_of(scene)])
        for detector, find in detectors(scene).items():
            if detector in LEFT_OUT:
                continue
            sensor = scene.camera.sensor
            kept = result.setdefault(detector, (scene.camera, (sensor.columns, sensor.rows), []))[2]
            try:
                found, true = find(GrayImage(noisy))
            except InputError:
                continue
            away = [np.abs(one - true).max() for one in (found, found[::-1])]
            if min(away) < FAR:
                kept.append((plate, true, found if away[0] <= away[1] else found[::-1]))
    return result


def judged(camera: Any, size: tuple[int, int], views: list[tuple[Points, ...]], group: int) -> dict[str, Any]:
    """Calibrations of groups of views against the camera, and those of true points with as much noise."""
    groups = [views[first : first + group] for first in range(0, len(views) - group + 1, group)]
    away = np.concatenate([found - true for _, true, found in views])
    rms = float(np.sqrt((away**2).mean()))
    random = np.random.default_rng(5)
    pulls: dict[str, list[list[float]]] = {"detector": [], "control": []}
    for members in groups:
        for kind, of in pulls.items():
            shown = [
                CalibrationView(
                    plate, found if kind == "detector" else true + rms * random.standard_normal(true.shape), str(number)
                )
                for number, (plate, true, found) in enumerate(members)
            ]
            made = calibrate_views(shown, size)
            width, height = camera.pitch
            truth = dict(zip(PARAMETERS, (1 / width, 1 / height, *camera.principal_point), strict=True))
            matrix = made.camera_matrix
            values = dict(zip(PARAMETERS, (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]), strict=True))
            of.append([(values[key] - truth[key]) / made.sigma[key] for key in PARAMETERS])
    return {
        "views": len(views),
        "calibrations": len(groups),
        "points_rms_px": rms,
        "points_bias_px": away.mean(axis=0).tolist(),
        **{kind: told_of(np.array(of)) for kind, of in pulls.items()},
    }


def told_of(pulls: Points) -> dict[str, Any]:
    """Rms of (found - true)/sigma over all, and of each parameter."""
    each = np.sqrt((pulls**2).mean(axis=0))
    return {
        "rms_pull": float(np.sqrt((pulls**2).mean())),
        **{key: float(value) for key, value in zip(PARAMETERS, each, strict=True)},
        "largest": float(np.abs(pulls).max()),
    }


if __name__ == "__main__":
    main()
