"""Uncertainty of projection by radwrap and by mrcal, from the same points.

Usage: mrcal_uncertainty.py [--python /usr/bin/python3] [--views 20] [--seed 1]

mrcal is not on the package index: on Debian `apt install python3-mrcal`, which has its own Python. A camera with the
model brown sees boards of 10 x 8 points, whose images get Gaussian noise of .1 px. Both calibrate from scratch, mrcal
without regularization, rejection of outliers or a warp of the board. Then the standard error in the worst direction is
compared at a grid over the image, at the boards' mean distance and at infinity; 1 is returned where both differ by 5 %.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

SIZE = (1280, 960)
COLUMNS, ROWS, PITCH = 10, 8, 0.02  # of the board; m
NOISE = 0.1  # px
CAMERA = (1100.0, 1090.0, 655.0, 495.0, -0.2, 0.1, 0.001, -0.0005, 0.02)  # fx fy cx cy k1 k2 p1 p2 k3
LIMIT = 0.05


def main() -> int:
    """Compare, and print a line for each distance."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--python", default="/usr/bin/python3", help="Python that has mrcal")
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--by-mrcal", metavar="FILE", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.by_mrcal:
        print(json.dumps(_by_mrcal(json.loads(Path(arguments.by_mrcal).read_text()))))
        return 0
    ours, told = _by_radwrap(arguments.views, arguments.seed)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "views.json"
        file.write_text(json.dumps(told))
        ran = subprocess.run(
            [arguments.python, __file__, "--by-mrcal", str(file)], capture_output=True, text=True, check=False
        )
    if ran.returncode:
        print(f"error: mrcal did not run: {ran.stderr.strip().splitlines()[-1:]}", file=sys.stderr)
        return 4
    theirs = json.loads(ran.stdout)
    print(f"fx {ours['camera'][0]:.4f} (ours) {theirs['camera'][0]:.4f} (mrcal)")
    worst = 0.0
    for place in ("board", "infinity"):
        ratio = np.array(ours[place]) / np.array(theirs[place])
        worst = max(worst, float(np.abs(ratio - 1).max()))
        print(
            f"{place:8}: ours {min(ours[place]):.4f} to {max(ours[place]):.4f} px; "
            f"over mrcal's {ratio.min():.6f} to {ratio.max():.6f}"
        )
    return int(worst > LIMIT)


def _by_radwrap(views: int, seed: int) -> tuple[dict[str, Any], dict[str, Any]]:
    from radwrap.calibrate.camera_model import turn
    from radwrap.calibrate.opencv_views import project_points
    from radwrap.calibrate.projection_uncertainty import projection_uncertainty
    from radwrap.calibrate.several_views import calibrate_views
    from radwrap.calibrate.views import CalibrationView

    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(COLUMNS) * PITCH, np.arange(ROWS) * PITCH)
    board = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    camera, poses, shown = np.zeros(16), [], []
    camera[: len(CAMERA)] = CAMERA
    while len(shown) < views:
        vector = np.array([*rng.uniform(-0.6, 0.6, 2), rng.uniform(-0.4, 0.4)])
        middle = np.array([rng.uniform(-0.12, 0.12), rng.uniform(-0.1, 0.1), rng.uniform(0.2, 0.4)])
        pose = np.array([*vector, *(middle - turn(vector)[0] @ board.mean(axis=0))])
        seen, _ = project_points(board, camera, pose)
        if (seen > 0).all() and (seen < SIZE).all():
            poses.append(pose)
            shown.append(seen + NOISE * rng.standard_normal(seen.shape))
    found = calibrate_views(
        [CalibrationView(board, seen, str(k)) for k, seen in enumerate(shown)], SIZE, model="brown", noise=NOISE
    )
    u, v = np.meshgrid(np.linspace(0, SIZE[0] - 1, 7), np.linspace(0, SIZE[1] - 1, 5))
    grid = np.column_stack([u.ravel(), v.ravel()])
    distance = float(np.mean([np.linalg.norm(pose[3:]) for pose in poses]))
    ours: dict[str, Any] = {"camera": found.camera_matrix.ravel()[[0, 4, 2, 5]].tolist()}
    for name, far in (("board", distance), ("infinity", math.inf)):
        ours[name] = np.sqrt(np.linalg.eigvalsh(projection_uncertainty(found, grid, far))[:, -1]).tolist()
    told = {
        "shown": [seen.tolist() for seen in shown],
        "poses": [pose.tolist() for pose in poses],
        "grid": grid.tolist(),
        "distance": distance,
    }
    return ours, told


def _by_mrcal(told: dict[str, Any]) -> dict[str, Any]:
    import mrcal

    shown = np.array(told["shown"]).reshape(-1, ROWS, COLUMNS, 2)
    count = len(shown)
    inputs = {
        "lensmodel": "LENSMODEL_OPENCV5",
        "intrinsics": np.array([CAMERA]),
        "extrinsics_rt_fromref": np.zeros((0, 6)),
        "frames_rt_toref": np.array(told["poses"]),
        "points": None,
        "observations_board": np.ascontiguousarray(np.concatenate([shown, np.ones((*shown.shape[:3], 1))], axis=-1)),
        "indices_frame_camintrinsics_camextrinsics": np.array([[k, 0, -1] for k in range(count)], dtype=np.int32),
        "observations_point": None,
        "indices_point_camintrinsics_camextrinsics": None,
        "imagersizes": np.array([SIZE], dtype=np.int32),
        "calobject_warp": None,
        "calibration_object_spacing": PITCH,
        "do_optimize_intrinsics_core": True,
        "do_optimize_intrinsics_distortions": True,
        "do_optimize_extrinsics": True,
        "do_optimize_frames": True,
        "do_optimize_calobject_warp": False,
        "do_apply_regularization": False,
        "do_apply_outlier_rejection": False,
        "verbose": False,
    }
    mrcal.optimize(**inputs)
    model = mrcal.cameramodel(optimization_inputs=inputs, icam_intrinsics=0)
    rays = mrcal.unproject(np.array(told["grid"]), *model.intrinsics(), normalize=True)
    options = {"model": model, "what": "worstdirection-stdev", "observed_pixel_uncertainty": NOISE}
    return {
        "camera": model.intrinsics()[1][:4].tolist(),
        "board": mrcal.projection_uncertainty(rays * told["distance"], **options).tolist(),
        "infinity": mrcal.projection_uncertainty(rays, atinfinity=True, **options).tolist(),
    }


if __name__ == "__main__":
    sys.exit(main())
