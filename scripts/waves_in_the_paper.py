"""What diffraction does to the paper's figures: each scene with it and without, same seed, same tolerance.

Prints a table, and writes out/waves_in_the_paper.json.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any, Final

import numpy as np

import radwrap
from radwrap.imaging.response.sensor import gray_levels
from radwrap.measure.dots import find_dots
from radwrap.measure.edges import measure_edge
from radwrap.scene.targets import DotBoard, EdgeTarget

ROOT: Final = Path(__file__).resolve().parent.parent
SCENES: Final = {
    "Fig. 9 (c)": "fig09_retro_field/c_finite_gaussian",
    "Fig. 10": "fig10_calibration_board",
    "Fig. 11, 12": "fig11_edge",
    "Fig. 13": "fig13_oriented_board",
    "Table 1, ambient": "table1_ambient",
}


def looked_at(path: Path, diffraction: str, tolerance: float, wavelength: str) -> tuple[np.ndarray, dict[str, float]]:
    """Gray levels before rounding, and what is measured in the rounded image."""
    changes = {"camera.diffraction": diffraction}
    if diffraction == "on":
        changes["camera.wavelength"] = wavelength
    scene = radwrap.load_scene(path / "scene.toml", changes)
    made = radwrap.render(scene, tolerance=tolerance)
    sensor, camera = scene.camera.sensor, scene.camera
    found: dict[str, float] = {"certified": made.error.rms_gray_upper95}
    for target in scene.targets:
        if isinstance(target, EdgeTarget):
            edge = measure_edge(
                made.gray,
                dark=sensor.dark_gray,
                gamma=sensor.gamma,
                pixel_aspect=sensor.pixel_height / sensor.pixel_width,
                saturation=sensor.saturation_gray,
            )
            found |= {"edge position [px]": edge.offset, "edge blur radius [px]": edge.radius}
        elif isinstance(target, DotBoard):
            for method in ("gray", "conic"):
                dots = find_dots(
                    made.gray,
                    target.rows,
                    target.columns,
                    method=method,
                    dark=sensor.dark_gray,
                    pitch=target.pitch,
                    dot_diameter=target.dot_diameter,
                    saturation=sensor.saturation_gray,
                )
                places = {(row, column): centre for row, column, centre in target.dot_centres()}
                points = np.array([places[dot.row, dot.column] for dot in dots.dots])
                try:
                    f = radwrap.calibrate_camera(
                        points,
                        dots.centres,
                        pixel_width=sensor.pixel_width,
                        pixel_height=sensor.pixel_height,
                        centre=camera.principal_point,
                    ).focal_length
                except radwrap.InputError:  # a board that is not tilted does not tell it
                    continue
                found[f"f by {method} [mm]"] = f * 1e3
    return gray_levels(made.radiant_exposure.values, sensor), found


def main() -> int:
    """Render each scene twice."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tolerance", type=float, default=0.2)
    parser.add_argument("--wavelength", default="550 nm")
    asked = parser.parse_args()
    rows: dict[str, dict[str, Any]] = {}
    for name, folder in SCENES.items():
        path = ROOT / "rad_scenes" / folder
        images, found = zip(
            *(looked_at(path, how, asked.tolerance, asked.wavelength) for how in ("off", "on")), strict=True
        )
        off = images[1] - images[0]
        rows[name] = {
            "gray_rms": float(np.sqrt((off**2).mean())),
            "gray_largest": float(np.abs(off).max()),
            "peaks": [float(image.max()) for image in images],
            "without": found[0],
            "with": found[1],
        }
        told = ", ".join(f"{key} {found[0][key]:.4g} -> {found[1][key]:.4g}" for key in found[0])
        row = rows[name]
        print(
            f"{name}: rms {row['gray_rms']:.2f}, largest {row['gray_largest']:.1f}, "
            f"peak {row['peaks'][0]:.1f} -> {row['peaks'][1]:.1f}; {told}",
            flush=True,
        )
    out = ROOT / "out"
    out.mkdir(exist_ok=True)
    (out / "waves_in_the_paper.json").write_text(json.dumps(rows, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
