"""Fig. 5: gray level against exposure, K and gamma found again from the frames of Fig. 4; Eq. 6 in both readings."""

from __future__ import annotations

import sys

import numpy as np

import radwrap
from radwrap.calibrate.response import energy_in_cone, exposure_at_distance, fit_response
from radwrap.imaging.response.sensor import gray_levels
from replication.figure import OURS, PAPER, THIRD, Made, Task, figure, main
from replication.images import Measured
from sensor_experiment import CONE_ANGLE, DISTANCE, LONGEST, RADIANT_INTENSITY, SCENE, frames, series


def make(task: Task) -> Made:
    """Render the series, fit, draw."""
    scene = radwrap.load_scene(SCENE)
    sensor = scene.camera.sensor
    times = np.linspace(0, LONGEST, 17)
    if task.quick:
        times = times[[0, 2, 6, 10, 14, 16]]  # the last two saturate
    patches = series(scene, times)
    _, gray = frames(patches, times, scene, noise=0.0, repeats=1, seed=0)
    exposure = exposure_at_distance(times, RADIANT_INTENSITY, DISTANCE)
    fit = fit_response(exposure, gray)
    literal = gray_levels(energy_in_cone(times, RADIANT_INTENSITY, float(CONE_ANGLE)), sensor)
    picture, panels = figure(6.4, 2.8, 1, 2)
    fine = np.linspace(0, exposure[-1], 400)
    curve = np.minimum(fit.gain * fine**fit.gamma + fit.dark_gray, fit.saturation_gray)
    panels[0, 0].plot(fine * 1e3, gray_levels(fine, sensor), color=PAPER, lw=2.5, alpha=0.4, label="printed K, gamma")
    panels[0, 0].plot(fine * 1e3, curve, color=OURS, lw=1, label="fitted to our frames")
    panels[0, 0].plot(exposure * 1e3, gray, "o", color=OURS, ms=3, label="frames of Fig. 4, traced")
    panels[0, 0].plot(exposure * 1e3, literal, "s", color=THIRD, ms=3, label="Eq. 6 as printed (J)")
    panels[0, 0].set(xlabel="radiant exposure [mJ m$^{-2}$]", ylabel="gray level", title="Fig. 5: response")
    panels[0, 0].legend(loc="lower right", bbox_to_anchor=(1, 0.1))
    used = (exposure > 0) & (gray < fit.saturation_gray)
    log_h, log_g = np.log(exposure[used]), np.log(gray[used] - fit.dark_gray)
    panels[0, 1].plot(log_h, sensor.gamma * log_h + np.log(sensor.gain), color=PAPER, lw=2.5, alpha=0.4)
    panels[0, 1].plot(log_h, log_g, "o", color=OURS, ms=3)
    panels[0, 1].set(xlabel="ln H", ylabel="ln (G - G$_0$)", title=f"Eq. 7: slope {fit.gamma:.3f}")
    sigma = fit.sigma
    return Made(
        title="Response of the sensor",
        picture=picture,
        ours={
            "dark": float(gray[0]),
            "saturation": float(gray[-1]),
            "gain": Measured(fit.gain, sigma["K"]),
            "gamma": Measured(fit.gamma, sigma["gamma"]),
            "eq6": float(literal[-1]),
        },
        assumed=(),
        more={"exposure_J_m2": exposure.tolist(), "gray": gray.tolist(), "gray_eq6_as_printed": literal.tolist()},
    )


if __name__ == "__main__":
    sys.exit(main("fig05", make, __doc__))
