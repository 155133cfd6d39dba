"""Fig. 4 as a virtual experiment: one LED, a series of exposures through the tracer, K and gamma fitted.

Writes frames.csv, response.json, response.png and runs.json into out/sensor_experiment (or --out) and prints what
came back beside what went in. Three runs: the scene (0.8 m, where the frames saturate) without noise and with seeded
noise, and Eq. 6 on the printed numbers at 0.91 and 1 m, where saturation is hardly or not reached and is given.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

import radwrap
from radwrap.calibrate.response import Response, energy_in_cone, exposure_at_distance, fit_response
from radwrap.calibrate.response_fits import Array
from radwrap.cli.calibrate_sensor import plot, report
from radwrap.files import make_folder, write_bytes
from radwrap.imaging.response.sensor import gray_levels
from radwrap.manifest import json_text

ROOT = Path(__file__).resolve().parent.parent
SCENE = ROOT / "rad_scenes" / "fig04_sensor_calibration" / "scene.toml"

RADIANT_INTENSITY = 0.0471  # W/sr, Sec. 4.1
CONE_ANGLE = np.radians(7.0)  # Sec. 4.1
DISTANCE = 0.8  # m, LED to sensor in the scene
LONGEST = 0.032  # s, Sec. 4.1
VIEWPOINTS = 127  # with 4 x 4 rays a pixel the mean exposure of the patch comes within 1e-3 of tau P_s/D^2
WRONG_STARTS = (0.05, 0.3, 2.0, 8.0)


def exposed(scene: radwrap.Scene, exposure_time: float) -> Array:
    """Radiant exposure on the patch [J m^-2], through the tracer; no light without exposure."""
    if exposure_time == 0:
        return np.zeros((scene.camera.sensor.rows, scene.camera.sensor.columns))
    timed = radwrap.with_value(scene, "camera.exposure_time", f"{exposure_time!r} s")
    rendered = radwrap.render(timed, viewpoints=VIEWPOINTS, layout="sunflower", pixel_samples=4)
    return rendered.radiant_exposure.values


def captured(patch: Array, scene: radwrap.Scene, noise: float, random: np.random.Generator) -> float:
    """Mean gray level of one frame: Eq. 5, saturation, noise behind it, 8 bits."""
    sensor = scene.camera.sensor
    gray = gray_levels(patch, sensor) + noise * random.standard_normal(patch.shape)
    return float(np.clip(np.rint(gray), 0, 2**sensor.bit_depth - 1).mean())


def series(scene: radwrap.Scene, times: Array) -> list[Array]:
    """The patch's exposure at each time."""
    return [exposed(scene, float(time)) for time in times]


def frames(
    patches: list[Array], times: Array, scene: radwrap.Scene, *, noise: float, repeats: int, seed: int
) -> tuple[Array, Array]:
    """Exposure time [s] and mean gray level of each frame."""
    random = np.random.default_rng(seed)
    gray = [captured(patch, scene, noise, random) for patch in patches for _ in range(repeats)]
    return np.repeat(times, repeats), np.array(gray)


def summary(response: Response, gain: float, gamma: float) -> dict[str, Any]:
    """What came back, and how many standard errors it is off."""
    result: dict[str, Any] = {}
    for name, fit in (("direct", response.direct), ("eq7", response.eq7)):
        result[name] = {
            "K": fit.gain,
            "sigma_K": fit.sigma["K"],
            "K_off_sigmas": (fit.gain - gain) / fit.sigma["K"],
            "gamma": fit.gamma,
            "sigma_gamma": fit.sigma["gamma"],
            "gamma_off_sigmas": (fit.gamma - gamma) / fit.sigma["gamma"],
        }
    result |= {"dark_gray": response.dark_gray, "saturation_gray": response.saturation_gray}
    return result | {"residual_rms_gray": response.residual_rms_gray, "K_unit": response.gain_unit}


def printed_numbers(distance: float, sensor: Any) -> dict[str, Any]:
    """Eq. 6 on the printed numbers, both readings, with whole gray levels and without."""
    times = np.linspace(0, LONGEST, 33)
    exposure = exposure_at_distance(times, RADIANT_INTENSITY, distance)
    gray = gray_levels(exposure, sensor)
    result = {}
    for name, levels, step in (("exact", gray, 0.0), ("eight_bits", np.rint(gray), 1.0)):
        known = {"dark": None, "saturation": sensor.saturation_gray, "quantisation": step}
        result[name] = summary(fit_response(exposure, levels, **known), sensor.gain, sensor.gamma)
        energy = energy_in_cone(times, RADIANT_INTENSITY, float(CONE_ANGLE))
        literal = fit_response(energy, levels, **known, exposure_unit="J")
        result[f"{name}_eq6_as_printed"] = {"K": literal.gain, "K_unit": literal.gain_unit, "gamma": literal.gamma}
    return result


def main() -> int:
    """Render, fit, write, print; exit code 1 if K or gamma are off by more than 3 standard errors."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "sensor_experiment")
    parser.add_argument("--noise", type=float, default=1.5, help="of a pixel [gray] (default 1.5)")
    parser.add_argument("--repeats", type=int, default=4, help="frames at each exposure (default 4)")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    make_folder(arguments.out)
    scene = radwrap.load_scene(str(SCENE))
    sensor = scene.camera.sensor
    times = np.linspace(0, LONGEST, 17)
    patches = series(scene, times)
    theory = exposure_at_distance(times, RADIANT_INTENSITY, DISTANCE)
    means = np.array([patch.mean() for patch in patches])
    off = np.abs(means[1:] / theory[1:] - 1).max()
    runs: dict[str, Any] = {"closed_form": {"exposure_32ms": theory[-1], "largest_relative_difference": off}}
    for name, noise, repeats in (("noise_free", 0.0, 1), ("noisy", arguments.noise, arguments.repeats)):
        time, gray = frames(patches, times, scene, noise=noise, repeats=repeats, seed=arguments.seed)
        exposure = exposure_at_distance(time, RADIANT_INTENSITY, DISTANCE)
        response = fit_response(exposure, gray)
        starts = [fit_response(exposure, gray, start_gamma=start) for start in WRONG_STARTS]
        runs[name] = summary(response, sensor.gain, sensor.gamma) | {
            "largest_change_by_wrong_starts": max(abs(other.gain / response.gain - 1) for other in starts)
        }
    text = "exposure_time,gray\n" + "".join(f"{t!r},{g!r}\n" for t, g in zip(time.tolist(), gray.tolist(), strict=True))
    write_bytes(arguments.out / "frames.csv", text.encode())
    lines = tuple(range(2, len(gray) + 2))
    write_bytes(arguments.out / "response.json", json_text(report(response, exposure, gray, lines)).encode())
    write_bytes(arguments.out / "response.png", plot(response, exposure, gray))
    runs |= {f"printed_at_{distance:g}_m": printed_numbers(distance, sensor) for distance in (0.91, 1.0)}
    write_bytes(arguments.out / "runs.json", json_text(runs).encode())
    print(json_text(runs), end="")
    fits = [runs[name][fit] for name in ("noise_free", "noisy") for fit in ("direct", "eq7")]
    worst = max(max(abs(fit["K_off_sigmas"]), abs(fit["gamma_off_sigmas"])) for fit in fits)
    print(f"K {sensor.gain:g} and gamma {sensor.gamma:g} come back within {worst:.2f} standard errors")
    return int(worst > 3)


if __name__ == "__main__":
    sys.exit(main())
