"""Figs. 8 and 9: the retroreflective field by a CAD package's model, by cones and by a Gaussian beam."""

from __future__ import annotations

import sys

from replication.figure import Made, Task, figure, main, show
from replication.images import largest_step, lit_area, peak, predicted

PANELS = {
    "a": ("a_cad", "(a) diffuse surface,\ninfinitesimal pinhole"),
    "b": ("b_infinitesimal_cone", "(b) sheeting, cone,\ninfinitesimal pinhole"),
    "c": ("c_finite_gaussian", "(c) sheeting, Gaussian,\nfinite pinhole"),
    "d": ("d_finite_cone", "(d) sheeting, cone,\nfinite pinhole"),
}


def make(task: Task) -> Made:
    """Render the four fields, compare, draw."""
    images = {
        key: predicted(f"fig09_retro_field/{folder}", f"fig09_{key}", task.out, quick=task.quick)
        for key, (folder, _) in PANELS.items()
    }
    dark, top = images["a"].scene.camera.sensor.dark_gray, max(float(image.gray.max()) for image in images.values())
    picture, panels = figure(7.2, 4.3, 2, 4, height_ratios=(1.25, 1))
    for place, (key, (_, title)) in enumerate(PANELS.items()):
        image = images[key]
        show(panels[0, place], image, title, top)
        panels[1, place].plot(image.gray[image.axis_row], lw=0.9)
        panels[1, place].set(ylim=(dark - 2, top + 3), xlabel="column [px]")
    panels[1, 0].set_ylabel("gray, row of the axis")
    for axes in panels[1, 1:]:
        axes.set_yticklabels([])
    picture.suptitle(f"Figs. 8 and 9: pictures show gray {dark:g} to {top:.0f}")
    area = {key: lit_area(image) for key, image in images.items()}
    return Made(
        title="Retroreflective field",
        picture=picture,
        ours={
            "a_black": peak(images["a"]).over(peak(images["c"])),
            "b_small": area["b"].over(area["c"]),
            "b_sharp": largest_step(images["b"]).over(largest_step(images["d"])),
            "d_small": area["d"].over(area["c"]),
        },
        assumed=("beam", "lobe", "pinhole", "exposure"),
        more={
            "images": {
                key: {
                    "peak_gray": float(image.gray.max()),
                    "certified_rms_gray": image.bound,
                    "lit_pixels": area[key].value,
                    "largest_step": largest_step(image).value,
                }
                for key, image in images.items()
            }
        },
    )


if __name__ == "__main__":
    sys.exit(main("fig08_09", make, __doc__))
