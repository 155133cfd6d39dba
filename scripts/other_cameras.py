"""What follows of an image without a ray, and of joined pixels, against images that were rendered for it.

    .venv/bin/python scripts/other_cameras.py --templates ring,backlight,darkfield

First, the exposure of a rendered image is changed by `with_exposure`, and held against a fresh render: rms difference,
what both certify, and processor time. It is made longer by a fifth, and by so much that pixels saturate. Made shorter
again, what was saturated when it was rendered must have no bound. Templates of `radwrap init` are looked at by joined
pixels; each cell of rad_scenes/cells gets a linear camera of 8 bits, as in default_tolerance.py. Second, three small
scenes get such a camera of 48 x 40 pixels: `scale = "1/4"` is held against the whole sensor whose pixels were joined
afterwards, in electrons and in the noise of 1000 frames. Diffraction is off there, as both have the same. A pixel
gets 2^14 rays eight times at most, which of so few pixels suffices for 0.02 gray levels in fig11_edge only.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

import radwrap
from default_tolerance import FILLED, FULL_WELL, cpu, exposed, linear_sensor
from radwrap import Rendered
from radwrap.imaging.response.noise import fixed_pattern, linear_of, noisy_frame

Array = NDArray[np.float64]

BITS: Final = 8
LONGER: Final = 1.2  # times the exposure
SATURATING: Final = 4.0  # times the exposure, by which pixels of every scene are full
JOINED: Final = 8  # pixels of a template a side become one
CHEAPER: Final = 1000  # times less processor time
PIXELS: Final = 4  # a side become one
TOLERANCE: Final = 0.02  # gray
OF_FULL_WELL: Final = 1e-3
OF_NOISE: Final = 0.02
FRAMES: Final = 1000
REPEATS: Final = 5
SEED: Final = 7
TEMPLATES: Final = Path(radwrap.__file__).parent / "data" / "templates"
SCENES: Final = Path(__file__).parents[1] / "rad_scenes"
SIZE: Final = (40, 48)  # pixels


def exposure_row(scene: radwrap.Scene, times: float) -> dict[str, float]:
    """Another exposure of one image, and a fresh render of it."""
    first = radwrap.render(scene)
    longer = f"{times * scene.camera.exposure_time!r} s"
    changed = radwrap.with_value(scene, "camera.exposure_time", longer)
    start = cpu()
    # Errors grow with the light: as fine as the first, in terms of it.
    fresh = radwrap.render(changed, tolerance=times * (first.run.tolerance or 0.0))
    rendering = cpu() - start
    start = cpu()
    for _ in range(REPEATS):
        made = first.with_exposure(longer)
    taken = (cpu() - start) / REPEATS
    off = made.gray.values - fresh.gray.values
    back = fresh.with_exposure(f"{scene.camera.exposure_time!r} s")
    return {
        "rms": float(np.sqrt(np.mean(off**2))),
        "certified": float(np.hypot(made.error.rms_gray_upper95, fresh.error.rms_gray_upper95)),
        "saturated": fresh.run.saturated_fraction,
        "saturated_made": made.run.saturated_fraction,
        "back_certified": back.error.rms_gray_upper95,
        "back_met": float(back.met),
        "rendering_s": rendering,
        "making_s": taken,
    }


def exposure_told(name: str, row: dict[str, float], times: float) -> bool:
    """Print a row; whether it keeps what it must."""
    cheaper = row["rendering_s"] / row["making_s"]
    unknown = row["saturated"] == 0 or (math.isinf(row["back_certified"]) and not row["back_met"])
    print(
        f"{name}: exposure times {times:g}: off by {row['rms']:.3f} gray rms, certified {row['certified']:.3f}; "
        f"saturated {row['saturated_made']:.2%}, {row['saturated']:.2%} where rendered, and made shorter again "
        f"certified {row['back_certified']:.3f}; {row['making_s'] * 1e3:.1f} ms for {row['rendering_s']:.1f} s, "
        f"{cheaper:.0f} times less",
        flush=True,
    )
    return row["rms"] < row["certified"] and cheaper > CHEAPER and unknown


def template(name: str) -> radwrap.Scene:
    """A template of `radwrap init` by joined pixels."""
    return radwrap.load_scene(TEMPLATES / f"{name}.toml", {"camera.sensor.scale": f"1/{JOINED}"})


def joined(values: Array) -> Array:
    """Sums over squares of pixels; what is over was cropped evenly."""
    rows, columns = (size // PIXELS for size in values.shape)
    top, left = ((size % PIXELS) // 2 for size in values.shape)
    inside = values[top : top + rows * PIXELS, left : left + columns * PIXELS]
    return np.asarray(inside.reshape(rows, PIXELS, columns, PIXELS).sum(axis=(1, 3)))


def frames_of(image: Rendered) -> NDArray[np.float64]:
    """Noisy frames that are not rounded: rounding takes another part of joined pixels' noise."""
    sensor = replace(image.scene.camera.sensor, rounding=False)
    pattern = fixed_pattern(sensor)
    return np.array(
        [noisy_frame(image.radiant_exposure, sensor, pattern, 7, number).values for number in range(FRAMES)]
    )


def scale_row(scene: radwrap.Scene, tolerance: float) -> dict[str, float]:
    """Pixels joined by the sensor and joined afterwards."""
    coarse = radwrap.with_value(scene, "camera.sensor.scale", f"1/{PIXELS}")
    start = cpu()
    # Errors of pixels that are joined average out: theirs may be as many times larger as a side has pixels.
    one, many = radwrap.render(scene, tolerance=PIXELS * tolerance), radwrap.render(coarse, tolerance=tolerance)
    taken = cpu() - start
    full_well = linear_of(many.scene.camera.sensor).full_well
    sums = joined(one.electrons)
    free = (joined((one.electrons > 0.98 * linear_of(scene.camera.sensor).full_well).astype(float)) == 0) & (
        many.electrons < 0.98 * full_well
    )
    off = np.abs(many.electrons - sums)[free] / full_well
    # Gray levels stay: of joined pixels they are the mean.
    noise = frames_of(many).std(axis=0, ddof=1)
    alone = np.array([joined(frame) / PIXELS**2 for frame in frames_of(one)]).std(axis=0, ddof=1)
    ratio = (noise / alone)[free]
    return {
        "certified": max(one.error.rms_gray_upper95 / PIXELS, many.error.rms_gray_upper95),
        "largest": float(off.max()),
        "rms": float(np.sqrt(np.mean(off**2))),
        "noise": float(np.mean(ratio)),
        "left_out": float(1 - free.mean()),
        "cpu_s": taken,
    }


def small_scene(name: str) -> radwrap.Scene:
    """A scene of rad_scenes with a linear camera, so exposed that its brightest thousandth fills 80 % of the range."""
    file = SCENES / name / "scene.toml"
    sensor = radwrap.load_scene(file).camera.sensor
    rows, columns = SIZE
    small = {
        "rows": rows,
        "columns": columns,
        "pixel_width": f"{sensor.pixel_width * sensor.columns / columns * 1e6!r} um",
        "pixel_height": f"{sensor.pixel_height * sensor.rows / rows * 1e6!r} um",
        **linear_sensor(BITS),
    }
    changes = {"camera.sensor": small, "camera.diffraction": "off", "camera.exposure_time": "1 ns"}
    dark = radwrap.load_scene(file, changes)
    electrons = float(np.quantile(radwrap.render(dark, tolerance="0.1 %").electrons, 0.999))
    return radwrap.with_value(dark, "camera.exposure_time", f"{FILLED * FULL_WELL / electrons!r} ns")


def main() -> int:
    """Print a line for each scene and change."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--templates", default="ring,backlight,darkfield", help="of another exposure")
    parser.add_argument("--cells", default="", help="of another exposure")
    parser.add_argument("--megapixels", type=float, default=0.3, help="of another exposure")
    parser.add_argument("--scenes", default="bench_board,data_sheet_camera,fig11_edge", help="of joined pixels")
    parser.add_argument("--tolerance", type=float, default=TOLERANCE, help="of joined pixels [gray level]")
    asked = parser.parse_args()
    good = True
    scenes = [(name, template(name)) for name in filter(None, asked.templates.split(","))]
    scenes += [(cell, exposed(cell, asked.megapixels, BITS)) for cell in filter(None, asked.cells.split(","))]
    for name, scene in scenes:
        for times in (LONGER, SATURATING):
            good &= exposure_told(name, exposure_row(scene, times), times)
    for name in filter(None, asked.scenes.split(",")):
        row = scale_row(small_scene(name), asked.tolerance)
        good &= row["largest"] < OF_FULL_WELL and abs(row["noise"] - 1) < OF_NOISE
        print(
            f"{name}: {PIXELS} x {PIXELS} pixels joined, certified {row['certified']:.3f} gray: electrons off by "
            f"{row['largest']:.1e} of the full well at most, {row['rms']:.1e} rms; noise {row['noise']:.4f} of that of "
            f"{FRAMES} joined frames; {row['left_out']:.0%} saturated and left out; {row['cpu_s']:.1f} s",
            flush=True,
        )
    return 0 if good else 1


if __name__ == "__main__":
    raise SystemExit(main())
