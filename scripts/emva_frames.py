"""Frames of a linear camera for photon transfer: even light of many exposures, and the dark frames beside them.

    .venv/bin/python scripts/emva_frames.py OUT
    .venv/bin/radwrap measure emva OUT/frames.csv --plot OUT/emva.png

The camera is that of rad_scenes/data_sheet_camera (its data sheet is invented), with pixels as many as --rows and
--columns say. OUT/truth.json holds what went in.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, Final

import numpy as np

from radwrap.files import make_folder, write_bytes
from radwrap.images import ExposureImage, write_png
from radwrap.imaging.response.noise import fixed_pattern, linear_of, noisy_frame
from radwrap.manifest import json_text, plain
from radwrap.scene.camera import Sensor
from radwrap.scene.file.load import load_scene

SCENE: Final = Path(__file__).parents[1] / "rad_scenes" / "data_sheet_camera" / "scene.toml"
_REACH: Final = 1.15  # of saturation, so that the largest variance is passed


def sensor_at(exposure_time: float, rows: int, columns: int, *, defects: bool) -> Sensor:
    """The camera with some exposure time [s], with its defect pixels or without."""
    changes: dict[str, Any] = {} if defects else {"camera.sensor.defects": {}}
    changes |= {
        "camera.exposure_time": f"{exposure_time!r} s",
        "camera.sensor.rows": rows,
        "camera.sensor.columns": columns,
    }
    return load_scene(SCENE, changes).camera.sensor


def main() -> None:
    """Write the frames."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--rows", type=int, default=480)
    parser.add_argument("--columns", type=int, default=640)
    parser.add_argument("--steps", type=int, default=50)
    parser.add_argument("--frames", type=int, default=2, help="of each exposure")
    parser.add_argument("--stack", type=int, default=16, help="frames half-way to saturation, for DSNU and PRNU")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--no-defects", action="store_false", dest="defects", help="a camera without defect pixels")
    arguments = parser.parse_args()
    make_folder(arguments.out)
    shape = (arguments.rows, arguments.columns)
    full = linear_of(sensor_at(0.1, *shape, defects=arguments.defects))
    top = _REACH * full.full_well / full.quantum_efficiency  # photons at the longest exposure
    longest = 0.1
    lines, number = ["file,exposure_time,dark"], 0
    for step in range(1, arguments.steps + 1):
        time = longest * step / arguments.steps
        sensor = sensor_at(time, *shape, defects=arguments.defects)
        linear, pattern = linear_of(sensor), fixed_pattern(sensor)
        level = top * time / longest / linear.photons_of_exposure(sensor.pixel_area)
        count = arguments.stack if step == round(arguments.steps / 2 / _REACH) else arguments.frames
        for dark in (0, 1):
            exposure = ExposureImage(np.full(shape, 0.0 if dark else level))
            for _ in range(count):
                name = f"{'dark' if dark else 'light'}_{number:05d}.png"
                write_png(arguments.out / name, noisy_frame(exposure, sensor, pattern, arguments.seed, number).codes)
                lines.append(f"{name},{time!r},{dark}")
                number += 1
    write_bytes(arguments.out / "frames.csv", ("\n".join(lines) + "\n").encode())
    truth = {"linear": plain(full), "photons_a_second": top / longest}
    write_bytes(arguments.out / "truth.json", json_text(truth).encode())


if __name__ == "__main__":
    main()
