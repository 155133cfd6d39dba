"""Fig. 13: the calibration board at 46, 6 and -2 degrees, and the focal length by Tsai's calibration on it."""

from __future__ import annotations

import sys

from radwrap.measure.dots import DotsNotFound, find_dots
from replication.figure import Made, Task, figure, main, show
from replication.images import Measured, focal_lengths, predicted
from replication.published import claims
from replication.studies import NOMINAL_METHOD


def make(task: Task) -> Made:
    """Render, find the dots, calibrate, draw."""
    image = predicted("fig13_oriented_board", "fig13", task.out, quick=task.quick)
    try:
        dots = find_dots(image.result.gray, 5, 5, method=NOMINAL_METHOD).dots
    except DotsNotFound:
        dots = ()
    found = focal_lengths(image, quick=task.quick)
    nominal = found.get(NOMINAL_METHOD)
    dark = image.scene.camera.sensor.dark_gray
    printed = claims("fig13")["focal_length"].printed
    top = float(image.gray.max())
    picture, panels = figure(6.4, 3.0, 1, 2, width_ratios=(1.1, 1))
    show(panels[0, 0], image, f"Fig. 13, gray {dark:g} to {top:.0f}", top)
    panels[0, 0].plot([dot.u for dot in dots], [dot.v for dot in dots], "+", color="C3", ms=4, mew=0.7)
    names = list(found)
    values, errors = ([getattr(found[name], what) * 1e3 for name in names] for what in ("value", "error"))
    panels[0, 1].errorbar(values, range(len(names)), xerr=errors, fmt="o", ms=4, capsize=2, label="ours")
    panels[0, 1].axvline(printed, color="C3", lw=1, label="printed (Table 3, LLLL)")
    panels[0, 1].axvline(image.scene.camera.focal_length * 1e3, color="0.6", lw=1, ls=":", label="true")
    panels[0, 1].set(yticks=range(len(names)), yticklabels=names, xlabel="f [mm]", ylim=(-0.5, len(names) + 0.8))
    panels[0, 1].legend(loc="upper right")
    return Made(
        title="Oriented board",
        picture=picture,
        ours={
            "dots": float(len(dots)),
            "focal_length": None if nominal is None else Measured(nominal.value * 1e3, nominal.error * 1e3),
        },
        assumed=(
            *("beam", "lobe", "pinhole", "exposure", "threshold", "axes", "tilt_sign", "centre_method", "solver"),
            *("dots", "black", "tolerance"),
        ),
        more={
            "certified_rms_gray": image.bound,
            "focal_length_mm": {
                name: {"value": one.value * 1e3, "error": one.error * 1e3} for name, one in found.items()
            },
        },
    )


if __name__ == "__main__":
    sys.exit(main("fig13", make, __doc__))
