"""What the default tolerance of a linear camera costs and changes: the real cells at 8, 10 and 12 bits.

    .venv/bin/python scripts/default_tolerance.py --out out/default_tolerance.json

Each cell of rad_scenes/cells gets a linear sensor, and the exposure that puts its 99.9 % quantile at 80 % of the range.
It is rendered at the default tolerance with each number of bits, by another seed each, and once at a quarter of the
least of these tolerances in light: 0.5 gray of 12 bits takes an hour. Beside rays and processor time stands what the
coarser image does to three measurements: diameter of the washer, place of the plate's edge, contrast of washer and
belt. Each is measured in both images without noise or rounding; the shift is held against the standard error of one
frame. What differs from seed to seed is the noise of rays; what all seeds have in common is not. With --seeds there is
no finer image, and the shift is that from the mean of the seeds.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
from pathlib import Path
from typing import Any, Final

import numpy as np

import radwrap
from cell_bench.cases import CELLS, case_of
from radwrap import Box, Caliper, GrayImage, Rendered, StraightCaliper
from radwrap.files import write_bytes

BITS: Final = (8, 10, 12)
OFFSET: Final = 0.02  # of the range
FILLED: Final = 0.8  # of the range, by the brightest thousandth
FULL_WELL: Final = 10_000  # electrons, of a pixel of 3.45 um
LOOK: Final = 1e-5  # ms; no pixel of a coarse look is full then
FRAMES: Final = 5  # with noise, of which the standard errors are the mean
FINER: Final = 4
LIMIT: Final = 1 / 3  # of one frame's standard error
WASHER: Final = (22.0, -18.0, 2.55)  # mm in the world: middle of its upper face
PLATE_EDGE: Final = (-12 + 12 * math.sin(math.radians(12)), 22 - 12 * math.cos(math.radians(12)), 4.05)
EDGE_NORMAL: Final = math.radians(90 - 12)  # from u towards v
BELT: Final = (0.0, -30.0, 0.0)
EYE: Final = 400.0  # mm above the belt


def linear_sensor(bits: int) -> dict[str, Any]:
    """Keys of a linear sensor without its pixels."""
    top = 2**bits - 1
    return {
        "model": "linear",
        "bit_depth": bits,
        "wavelength": "630 nm",
        "quantum_efficiency": 0.6,
        "system_gain": f"{top * (1 - OFFSET) / FULL_WELL!r} DN/e",
        "offset": round(top * OFFSET),
        "full_well": f"{FULL_WELL} e",
        "read_noise": "6 e",
    }


def linear_scene(cell: str, megapixels: float, bits: int, exposure_ms: float) -> radwrap.Scene:
    """The cell by a linear sensor."""
    case = case_of(cell, megapixels)
    scene = radwrap.load_scene(case.file, case.overrides)
    pixels = {key.rpartition(".")[2]: value for key, value in case.overrides.items()}
    sensor = {**pixels, **linear_sensor(bits)}
    scene = radwrap.with_value(scene, "camera.sensor", sensor)
    return radwrap.with_value(scene, "camera.exposure_time", f"{exposure_ms!r} ms")


def exposed(cell: str, megapixels: float, bits: int) -> radwrap.Scene:
    """With the exposure that fills the range as far as is wanted."""
    look = radwrap.render(linear_scene(cell, 0.001, bits, LOOK), tolerance="0.1 %")
    electrons = float(np.quantile(look.electrons, 0.999)) or 1.0
    wanted = FILLED * FULL_WELL
    # Pixels of 0.001 megapixels collect more light, in the ratio of their areas.
    area = (case_of(cell, megapixels).width / case_of(cell, megapixels).columns) ** 2 / (
        case_of(cell, 0.001).width / case_of(cell, 0.001).columns
    ) ** 2
    return linear_scene(cell, megapixels, bits, LOOK * wanted / (electrons * area))


def cpu() -> float:
    """Processor time of this process and those it has waited for [s]."""
    return sum(
        used.ru_utime + used.ru_stime
        for used in (resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN))
    )


def pixel_of(scene: radwrap.Scene, point: tuple[float, float, float]) -> tuple[float, float, float]:
    """Column, row and pixels per millimetre of a point of the world [mm], seen from straight above."""
    camera = scene.camera
    per_mm = camera.image_distance / camera.sensor.pixel_width / (EYE - point[2])
    rows, columns = camera.sensor.rows, camera.sensor.columns
    return (columns - 1) / 2 + per_mm * point[0], (rows - 1) / 2 - per_mm * point[1], per_mm


def measured(image: GrayImage, scene: radwrap.Scene, dark: float) -> dict[str, tuple[float, float]]:
    """Value and standard error of noise of each measurement; NaN where there is none."""
    found: dict[str, tuple[float, float]] = {}
    u, v, per_mm = pixel_of(scene, WASHER)
    try:
        circle = radwrap.measure_circle(image, Caliper((u, v), 12 * per_mm, 1.5 * per_mm))
        found["diameter_px"] = (circle.diameter, circle.diameter_sigma)
    except radwrap.InputError:
        found["diameter_px"] = (math.nan, math.nan)
    b = (round(u + 9.25 * per_mm), round(v), round(1.2 * per_mm))
    washer = radwrap.measure_region(image, Box(b[0] - b[2], b[1] - b[2], b[0] + b[2], b[1] + b[2]))
    u, v, per_mm = pixel_of(scene, BELT)
    b = (round(u), round(v), round(3 * per_mm))
    belt = radwrap.measure_region(image, Box(b[0] - b[2], b[1] - b[2], b[0] + b[2], b[1] + b[2]))
    contrast = radwrap.contrast_of(washer, belt, dark=dark)
    found["contrast"] = (contrast.michelson, contrast.michelson_sigma)
    u, v, per_mm = pixel_of(scene, PLATE_EDGE)
    try:
        line = radwrap.measure_line(image, StraightCaliper((u, v), EDGE_NORMAL, 30 * per_mm, 2 * per_mm))
        found["edge_px"] = (line.offset, line.position_sigma)
    except radwrap.InputError:
        found["edge_px"] = (math.nan, math.nan)
    return found


def without_noise(result: Rendered) -> GrayImage:
    """Gray levels, neither rounded nor cut."""
    sensor = result.scene.camera.sensor
    gain = (sensor.saturation_gray - sensor.dark_gray) / FULL_WELL
    return GrayImage(result.electrons * gain + sensor.dark_gray, sensor.bit_depth)


def rendered(scene: radwrap.Scene, seed: int, tolerance: float | None = None) -> tuple[Rendered, dict[str, Any]]:
    """A render, and what it took."""
    start = cpu()
    result = radwrap.render(scene, tolerance=tolerance, seed=seed)
    return result, {
        "asked_gray": result.run.tolerance,
        "certified_gray": result.error.rms_gray_upper95,
        "rays": result.run.rays,
        "method": result.run.method,
        "cpu_s": cpu() - start,
    }


def finer(
    cell: str, megapixels: float, bits: tuple[int, ...], rows: list[dict[str, Any]], shares: list[float]
) -> tuple[dict[str, float], dict[str, Any]]:
    """Measurements of an image finer than all, and what it took."""
    finest = int(np.argmin(shares))
    scene = exposed(cell, megapixels, bits[finest])
    result, told = rendered(scene, 0, rows[finest]["default"]["asked_gray"] / FINER)
    found = measured(without_noise(result), scene, scene.camera.sensor.dark_gray)
    return {key: value for key, (value, _) in found.items()}, told | {"bits": bits[finest]}


def rows_of(cell: str, megapixels: float, bits: tuple[int, ...], *, seeds: bool) -> list[dict[str, Any]]:
    """Renders of a cell, and what the measurements make of them."""
    rows, values, shares = [], [], []
    for one in bits:
        scene = exposed(cell, megapixels, one)
        dark = scene.camera.sensor.dark_gray
        result, told = rendered(scene, seed=one)
        frames = [measured(frame, scene, dark) for frame in result.frames(FRAMES, seed=1)]
        sigmas = {key: float(np.mean([frame[key][1] for frame in frames])) for key in frames[0]}
        rows.append({"cell": cell, "megapixels": megapixels, "bits": one, "default": told, "sigma": sigmas})
        values.append(measured(without_noise(result), scene, dark))
        shares.append(told["asked_gray"] / 2**one)
    if seeds:
        reference = {key: float(np.mean([value[key][0] for value in values])) for key in values[0]}
        told = {}
    else:
        reference, told = finer(cell, megapixels, bits, rows, shares)
    for each, value in zip(rows, values, strict=True):
        each["finer"] = told
        each["shift"] = {key: value[key][0] - reference[key] for key in reference}
    return rows


def main() -> int:
    """Print a line for each cell and number of bits, and keep all as JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cells", default=",".join(CELLS))
    parser.add_argument("--bits", default=",".join(map(str, BITS)))
    parser.add_argument("--megapixels", type=float, default=0.3)
    parser.add_argument("--seeds", action="store_true", help="no finer image: only what differs from seed to seed")
    parser.add_argument("--out", type=Path, default=Path("out/default_tolerance.json"))
    asked = parser.parse_args()
    asked.out.parent.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    worst = 0.0
    bits = tuple(map(int, asked.bits.split(",")))
    for cell in asked.cells.split(","):
        for last in rows_of(cell, asked.megapixels, bits, seeds=asked.seeds):
            rows.append(last)
            shares = {key: abs(shift) / last["sigma"][key] for key, shift in last["shift"].items()}
            worst = max(worst, *(share for share in shares.values() if not math.isnan(share)))
            text = "  ".join(
                f"{name}: {last[name]['asked_gray']:.3g} gray, certified {last[name]['certified_gray']:.3g}, "
                f"{last[name]['rays']:.3g} rays, {last[name]['cpu_s']:.1f} s"
                for name in ("default", "finer")
                if last[name]
            )
            told = ", ".join(f"{key} {last['shift'][key]:+.4f} ({share:.2f})" for key, share in shares.items())
            print(f"{cell} {last['bits']} bits  {text}  shift (over sigma) {told}", flush=True)
        write_bytes(asked.out, json.dumps(rows, indent=1).encode())
    print(f"largest shift {worst:.2f} of one frame's standard error, limit {LIMIT:.2f}")
    return 0 if worst < LIMIT else 1


if __name__ == "__main__":
    raise SystemExit(main())
