"""Fig. 10: the calibration board through an infinitesimal and through the finite pinhole."""

from __future__ import annotations

import sys

from radwrap.measure.dots import DotsNotFound, find_dots
from replication.figure import Made, Task, figure, main, show
from replication.images import largest_step, middle_share, predicted


def make(task: Task) -> Made:
    """Render both, find the dots, draw."""
    scene = "fig10_calibration_board"
    finite = predicted(scene, "fig10_c", task.out, quick=task.quick)
    changes = {"camera.aperture.diameter": "0 mm", "camera.aperture.exposure_diameter": "0.1 mm"}
    sharp = predicted(scene, "fig10_b", task.out, quick=task.quick, changes=changes)
    try:
        dots = find_dots(finite.result.gray, 5, 5).dots
    except DotsNotFound:
        dots = ()
    dark, top = finite.scene.camera.sensor.dark_gray, max(float(sharp.gray.max()), float(finite.gray.max()))
    picture, panels = figure(7.2, 2.6, 1, 3)
    show(panels[0, 0], sharp, "(b) infinitesimal pinhole", top)
    show(panels[0, 1], finite, "(c) finite pinhole, dots found", top)
    panels[0, 1].plot([dot.u for dot in dots], [dot.v for dot in dots], "+", color="C3", ms=4, mew=0.7)
    panels[0, 2].plot(sharp.gray[sharp.axis_row], lw=0.8, label="(b)")
    panels[0, 2].plot(finite.gray[finite.axis_row], lw=1.2, label="(c)")
    panels[0, 2].set(xlabel="column [px]", ylabel="gray, row of the axis")
    panels[0, 2].legend()
    picture.suptitle(f"Fig. 10: pictures show gray {dark:g} to {top:.0f}")
    return Made(
        title="Calibration board",
        picture=picture,
        ours={
            "softer": largest_step(sharp).over(largest_step(finite)),
            "grays": middle_share(finite).over(middle_share(sharp)),
            "dots": float(len(dots)),
        },
        assumed=("beam", "lobe", "pinhole", "exposure", "dots", "black"),
        more={
            "certified_rms_gray": {"b": sharp.bound, "c": finite.bound},
            "peak_gray": {"b": float(sharp.gray.max()), "c": float(finite.gray.max())},
        },
    )


if __name__ == "__main__":
    sys.exit(main("fig10", make, __doc__))
