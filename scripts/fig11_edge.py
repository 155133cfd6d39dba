"""Fig. 11: the edge between a black diffuse surface and retroreflective sheeting."""

from __future__ import annotations

import math
import sys

import numpy as np

from radwrap.imaging.truth import edge_line
from radwrap.measure.edges import measure_edge
from radwrap.scene.targets import EdgeTarget
from replication.figure import Made, Task, figure, main, show
from replication.images import Image, Measured, predicted
from replication.published import claims


def make(task: Task) -> Made:
    """Render, fit the edge, measure the lit area, draw."""
    image = predicted("fig11_edge", "fig11", task.out, quick=task.quick)
    camera = image.scene.camera
    sensor = camera.sensor
    row = camera.principal_point[1]
    target = next(target for target in image.scene.targets if isinstance(target, EdgeTarget))
    line = edge_line(image.scene.camera, target)
    edge = measure_edge(
        image.result.gray,
        dark=sensor.dark_gray,
        gamma=sensor.gamma,
        pixel_aspect=sensor.pixel_height / sensor.pixel_width,
        saturation=sensor.saturation_gray,
    )
    true, seen = (_column(one, row) for one in ((line.angle, line.offset), (edge.angle, edge.offset)))
    height, width = lit_extent(image)
    picture, panels = figure(6.4, 3.0, 1, 2, width_ratios=(1.2, 1))
    top, printed = float(image.gray.max()), claims("fig11")["geometry"].printed
    show(panels[0, 0], image, f"gray {sensor.dark_gray:g} to {top:.0f}", top)
    panels[0, 0].contour(image.above_dark, levels=[0.5 * float(image.above_dark.max())], colors="C3", linewidths=0.6)
    near = np.arange(max(0, round(true) - 14), min(sensor.columns, round(true) + 15))
    panels[0, 1].plot(near, image.result.gray.values[image.axis_row, near], "o-", ms=2.5, lw=0.7)
    panels[0, 1].axvline(seen, color="C0", lw=0.8, label=f"measured {seen:.2f} px")
    panels[0, 1].axvline(true, color="C3", lw=0.8, ls="--", label=f"beta$_0$: {true:.2f} px (printed {printed})")
    panels[0, 1].set(xlabel="column [px]", ylabel="gray, row of the axis")
    panels[0, 1].legend(loc="lower right")
    picture.suptitle("Fig. 11(b): edge; red: half the peak above dark")
    return Made(
        title="Edge image",
        picture=picture,
        ours={
            "geometry": true,
            "position": Measured(seen, 3 * edge.sigma_position),
            "semicircle": Measured(height / width, height / width * (1 / height + 1 / width)),
        },
        assumed=("beam", "lobe", "exposure", "black"),
        more={"certified_rms_gray": image.bound, "lit_height_px": height, "lit_width_px": width},
    )


def lit_extent(image: Image) -> tuple[float, float]:
    """Height and width of what is brighter than half the peak above dark, both in pixel widths."""
    rows, columns = np.nonzero(image.above_dark > 0.5 * image.above_dark.max())
    sensor = image.scene.camera.sensor
    return float(np.ptp(rows) + 1) * sensor.pixel_height / sensor.pixel_width, float(np.ptp(columns) + 1)


def _column(line: tuple[float, float], row: float) -> float:
    """Where the edge u cos + v sin = offset crosses a row [px]."""
    angle, offset = line
    return (offset - row * math.sin(angle)) / math.cos(angle)


if __name__ == "__main__":
    sys.exit(main("fig11", make, __doc__))
