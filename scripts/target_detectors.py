"""How well detectors find calibration targets in predicted images: what is found, bias and scatter against truth.

python scripts/target_detectors.py [--views N] [--noise G] [--json FILE]

N poses of each of four targets (default 13, 52 renders), turned by up to 40 degrees, on 320 x 256 pixels, in focus,
with Gaussian noise of G gray levels (default 1). Distances are from the true points, in pixels; of OpenCV's circles
from the centres of the ellipses, and from those of the discs.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, get_args

import numpy as np
from numpy.typing import NDArray

import radwrap
from radwrap.errors import InputError
from radwrap.images import GrayImage
from radwrap.imaging.truth import geometry
from radwrap.measure.dots import find_dots
from radwrap.measure.targets import CharucoBoard, ChessboardMethod, charuco_corners, chessboard_corners, circle_centres
from radwrap.scene.file.target_file import layout_of

TARGETS: Final = Path(__file__).parents[1] / "rad_scenes" / "targets"
NAMES: Final = ("chessboard", "charuco", "circles", "circles_asymmetric")
TOLERANCE: Final = 0.7  # gray level rms, below the noise
TILT: Final = 40.0  # degrees at most
Points = NDArray[np.float64]


def scenes(name: str, count: int) -> list[radwrap.Scene]:
    """A target in random poses, wholly in view."""
    random = np.random.default_rng(len(name))
    found: list[radwrap.Scene] = []
    while len(found) < count:
        tilt, azimuth, roll = random.uniform(0, TILT), random.uniform(0, 360), random.uniform(-25, 25)
        about = [tilt * np.cos(np.radians(azimuth)), tilt * np.sin(np.radians(azimuth)), roll]
        place = [*random.uniform(-6, 6, 2), random.uniform(-30, 5)]
        scene = radwrap.load_scene(
            TARGETS / f"{name}.toml",
            {
                "targets[0].rotation": [f"{angle:.4f} deg" for angle in about],
                "targets[0].position": [f"{length:.4f} mm" for length in place],
                "camera.diffraction": "off",
            },
        )
        if all(point["in_view"] for point in points_of(scene)):
            found.append(scene)
    return found


def points_of(scene: radwrap.Scene) -> list[dict[str, Any]]:
    """The target's true points."""
    told = geometry(scene, ())["targets"]["target"]
    points: list[dict[str, Any]] = told.get("corners") or told["circles"]
    return points


def detectors(scene: radwrap.Scene) -> dict[str, Callable[[GrayImage], tuple[Points, Points]]]:
    """Name -> what it finds, and what is true of it, point by point."""
    (target,) = scene.targets
    layout: Any = layout_of(target)
    points = points_of(scene)
    true = np.array([(point["u"], point["v"]) for point in points])
    match type(layout).__name__:
        case "Chessboard":
            return {
                method: lambda image, method=method: (
                    chessboard_corners(image, layout.rows, layout.columns, method),
                    true,
                )
                for method in get_args(ChessboardMethod)
            }
        case "Charuco":
            share = layout.marker_size / layout.square_size
            board = CharucoBoard(layout.rows, layout.columns, share, layout.dictionary, layout.first_marker)

            def charuco(image: GrayImage) -> tuple[Points, Points]:
                ids, found = charuco_corners(image, board)
                return found, true[ids]

            return {"charuco": charuco}
    ellipses = np.array([(point["ellipse_u"], point["ellipse_v"]) for point in points])

    def opencv(image: GrayImage) -> Points:
        return circle_centres(image, layout.rows, layout.columns, asymmetric=layout.asymmetric)

    found: dict[str, Callable[[GrayImage], tuple[Points, Points]]] = {
        "circles, of ellipses": lambda image: (opencv(image), ellipses),
        "circles, of discs": lambda image: (opencv(image), true),
    }
    if not layout.asymmetric:
        sizes = {"pitch": layout.pitch, "dot_diameter": layout.dot_diameter}
        found["dots"] = lambda image: (
            find_dots(image, layout.rows, layout.columns, method="conic", **sizes).centres,
            true,
        )
    return found


def nearer(found: Points, true: Points) -> Points:
    """Distances; a board that looks the same after a half turn may be found turned."""
    ways = [found - true, found[::-1] - true] if len(found) == len(true) else [found - true]
    return min(ways, key=lambda away: float(np.abs(away).max()))


def measured(name: str, count: int, noise: float) -> dict[str, dict[str, Any]]:
    """For each detector of a target: views found, points, bias along u and v, scatter, largest distance [px]."""
    away: dict[str, list[Points]] = {}
    failed: dict[str, list[str]] = {}
    points = 0
    for number, scene in enumerate(scenes(name, count)):
        image = radwrap.render(scene, tolerance=TOLERANCE, seed=number, workers=1).gray
        random = np.random.default_rng(1000 + number)
        noisy = np.clip(np.rint(image.values + noise * random.standard_normal(image.values.shape)), 0, 255)
        points += len(points_of(scene))
        for detector, find in detectors(scene).items():
            away.setdefault(detector, [])
            try:
                away[detector].append(nearer(*find(GrayImage(noisy))))
            except InputError as error:
                failed.setdefault(detector, []).append(f"view {number}: {error.what}")
    result = {}
    for detector, parts in away.items():
        every = np.concatenate(parts)
        radius = np.hypot(*every.T)
        result[detector] = {
            "views": count,
            "views_found": len(parts),
            "points": points,
            "points_found": len(every),
            "bias_px": every.mean(axis=0).tolist(),
            "rms_px": float(np.sqrt((every**2).mean())),
            "median_px": float(np.median(radius)),
            "largest_px": float(radius.max()),
            "failed": failed.get(detector, []),
        }
    return result


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--views", type=int, default=13)
    parser.add_argument("--targets", nargs="+", choices=NAMES, default=NAMES)
    parser.add_argument("--noise", type=float, default=1.0)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    result = {}
    for name in arguments.targets:
        result[name] = measured(name, arguments.views, arguments.noise)
        for detector, told in result[name].items():
            u, v = told["bias_px"]
            print(
                f"{name}, {detector}: {told['views_found']} of {told['views']} views, {told['points_found']} of "
                f"{told['points']} points, bias {u:+.4f} {v:+.4f}, rms {told['rms_px']:.4f}, median distance "
                f"{told['median_px']:.4f}, largest {told['largest_px']:.3f} px",
                flush=True,
            )
            for line in told["failed"]:
                print(f"    {line}")
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
