"""How often a calibration's standard errors hold, and whether its projection spreads as it says.

    python scripts/calibration_coverage.py [--calibrations 200] [--views 20] [--model brown] [--seed 1]

The same boards of 10 x 8 points are calibrated again and again, each time with other Gaussian noise of .1 px, which is
found from the residuals. Prints JSON: in which share of the calibrations fx, fy, cx, cy and k1 lie within one and two
of their standard errors; over a grid on the image the true spread of the projection (as mrcal defines it: a point is
held by its place beside the boards) over the one that was computed, at the boards' mean distance and at infinity; the
largest cost over OpenCV's, and the largest gradient. Returns 1 where a limit below is not met.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.calibrate.camera_model import turn
from radwrap.calibrate.opencv_views import project_points
from radwrap.calibrate.projection_uncertainty import projection_uncertainty
from radwrap.calibrate.several_views import ViewsCalibration, calibrate_views
from radwrap.calibrate.views import CalibrationView
from radwrap.random_streams import generator

Array = NDArray[np.float64]
SIZE: Final = (1280, 960)
CAMERA: Final = (1100.0, 1090.0, 655.0, 495.0, -0.2, 0.1, 0.001, -0.0005, 0.02)  # fx fy cx cy k1 k2 p1 p2 k3
THIN_PRISM: Final = (0.0, 0.0, 0.0, 0.004, -0.002, 0.003, 0.001)  # k4 k5 k6 s1 s2 s3 s4
NAMES: Final = ("fx", "fy", "cx", "cy", "k1")
NOISE: Final = 0.1  # px
ONE: Final = (0.61, 0.75)
TWO: Final = (0.91, 0.98)
SPREAD: Final = 0.15
COST: Final = 1e-8


def main() -> int:
    """Calibrate, count, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--calibrations", type=int, default=200)
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--model", choices=("brown", "thin_prism"), default="brown")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    random = generator(given.seed)
    camera = np.zeros(16)
    camera[: len(CAMERA)] = CAMERA
    if given.model == "thin_prism":
        camera[9:] = THIN_PRISM
    board = _board()
    poses = _poses(camera, board, given.views, random)
    exact = [project_points(board, camera, pose)[0] for pose in poses]
    u, v = np.meshgrid(np.linspace(0, SIZE[0] - 1, 7), np.linspace(0, SIZE[1] - 1, 5))
    places = np.column_stack([u.ravel(), v.ravel()])
    rays = _rays(camera, places)
    distances = {"board": float(np.mean([np.linalg.norm(pose[3:]) for pose in poses])), "infinity": math.inf}
    away, cost, gradient = [], [], []
    shifts: dict[str, list[Array]] = {name: [] for name in distances}
    computed: dict[str, list[Array]] = {name: [] for name in distances}
    for _ in range(given.calibrations):
        views = [
            CalibrationView(board, seen + NOISE * random.standard_normal(seen.shape), str(k))
            for k, seen in enumerate(exact)
        ]
        found = calibrate_views(views, SIZE, model=given.model)
        values = _values(found)
        away.append([(values[k] - camera[k]) / found.sigma[name] for k, name in enumerate(NAMES)])
        cost.append(found.cost / found.opencv_cost - 1)
        gradient.append(found.gradient_norm)
        for name, distance in distances.items():
            shifts[name].append(_shown(found, poses, rays, distance) - places)
            covariance = projection_uncertainty(found, places, distance)
            computed[name].append(np.trace(covariance, axis1=1, axis2=2))
    z = np.abs(away)
    told: dict[str, Any] = {
        "calibrations": given.calibrations,
        "views": given.views,
        "model": given.model,
        "within_1_sigma": dict(zip(NAMES, (z < 1).mean(axis=0).tolist(), strict=True)),
        "within_2_sigma": dict(zip(NAMES, (z < 2).mean(axis=0).tolist(), strict=True)),
        "largest_cost_over_opencvs": max(cost),
        "largest_gradient": max(gradient),
    }
    for name in distances:
        true = np.sqrt(np.mean(np.square(shifts[name]).sum(axis=2), axis=0))
        ratio = true / np.sqrt(np.mean(computed[name], axis=0))
        told[f"true_over_computed_spread_{name}"] = {"least": float(ratio.min()), "most": float(ratio.max())}
    told["missed"] = list(_missed(told))
    print(json.dumps(told, indent=2))
    return bool(told["missed"])


def _missed(told: dict[str, Any]) -> list[str]:
    found = [
        f"{name} within {key[7]} sigma"
        for key, (low, high) in (("within_1_sigma", ONE), ("within_2_sigma", TWO))
        for name, share in told[key].items()
        if not low <= share <= high
    ]
    for name in ("board", "infinity"):
        ends = told[f"true_over_computed_spread_{name}"]
        if ends["least"] < 1 - SPREAD or ends["most"] > 1 + SPREAD:
            found.append(f"projection, {name}")
    return [*found, *(["cost"] if told["largest_cost_over_opencvs"] > COST else [])]


def _board() -> Array:
    x, y = np.meshgrid(np.arange(10) * 0.02, np.arange(8) * 0.02)
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])


def _poses(camera: Array, board: Array, count: int, random: np.random.Generator) -> list[Array]:
    """Boards that are tilted by up to some 50 degrees, wholly in view."""
    found: list[Array] = []
    while len(found) < count:
        vector = np.array([*random.uniform(-0.6, 0.6, 2), random.uniform(-0.4, 0.4)])
        middle = np.array([random.uniform(-0.12, 0.12), random.uniform(-0.1, 0.1), random.uniform(0.2, 0.4)])
        pose = np.array([*vector, *(middle - turn(vector)[0] @ board.mean(axis=0))])
        seen, _ = project_points(board, camera, pose)
        if (seen > 0).all() and (seen < SIZE).all():
            found.append(pose)
    return found


def _rays(camera: Array, places: Array) -> Array:
    """Directions that the true camera sees at pixels, by steps of a fixed slope: small distortions let them arrive."""
    flat = (places - camera[2:4]) / camera[:2]
    for _ in range(500):
        shown = project_points(np.column_stack([flat, np.ones(len(flat))]), camera, np.zeros(6))[0]
        flat = flat - (shown - places) / camera[:2]
    rays = np.column_stack([flat, np.ones(len(flat))])
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def _values(found: ViewsCalibration) -> Array:
    values, matrix = np.zeros(16), found.camera_matrix
    values[:4] = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
    values[4 : 4 + len(found.distortion_coefficients)] = found.distortion_coefficients
    return values


def _shown(found: ViewsCalibration, poses: list[Array], rays: Array, distance: float) -> Array:
    """Where points at a distance are seen that each board holds where it holds them in truth; mean of all boards."""
    moved = np.zeros_like(rays)
    for view, pose in zip(found.views, poses, strict=True):
        back = turn(pose[:3])[0]
        if math.isinf(distance):
            moved += rays @ back @ view.rotation.T
        else:
            moved += (distance * rays - pose[3:]) @ back @ view.rotation.T + view.translation
    return np.asarray(project_points(moved / len(poses), _values(found), np.zeros(6))[0])


if __name__ == "__main__":
    sys.exit(main())
