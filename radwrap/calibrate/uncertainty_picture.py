"""A calibration's uncertainty of projection, as a picture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from radwrap.calibrate.projection_uncertainty import uncertainty_over_image
from radwrap.calibrate.several_views import ViewsCalibration
from radwrap.figure_png import figure_png

_ACROSS: Final = 49  # places along the longer side
_LEVELS: Final = 12
_WIDTH: Final = 5.5  # inch, of each map
_MARGIN: Final = 1.2  # inch, for titles and axes


def uncertainty_picture(found: ViewsCalibration, distances: Sequence[float]) -> bytes:
    """Maps of the projection's standard error in its worst direction, one for each distance, all on one scale.

    Parameters
    ----------
    found : ViewsCalibration
        Its points' places are not marked: what matters is how far they hold the whole image.
    distances : sequence of float
        From the camera [m]; infinite for directions.

    Returns
    -------
    bytes
        A PNG file, the same for the same calibration.

    Raises
    ------
    InputError
        As `uncertainty_over_image`.
    """
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure

    wide, high = found.image_size
    step = max(wide, high) / (_ACROSS - 1)
    across, down = (max(2, round(size / step) + 1) for size in (wide, high))
    over = [uncertainty_over_image(found, far, (across, down)) for far in distances]
    maps = [np.array(one.sigma) for one in over]
    low, high_end = min(float(one.min()) for one in maps), max(float(one.max()) for one in maps)
    # Errors in the corners are often ten times those in the middle: steps of equal ratio show both.
    levels = np.geomspace(low, max(high_end, low * (1 + 1e-6)), _LEVELS + 1)
    figure = Figure(figsize=(_WIDTH * len(maps), _WIDTH * high / wide + _MARGIN), layout="constrained")
    every = figure.subplots(1, len(maps), squeeze=False)[0]
    for axes, one, values in zip(every, over, maps, strict=True):
        filled = axes.contourf(
            one.columns, one.rows, values, levels=levels, norm=LogNorm(levels[0], levels[-1]), cmap="viridis"
        )
        lines = axes.contour(one.columns, one.rows, values, levels=levels[1:-1:2], colors="white", linewidths=0.7)
        axes.clabel(lines, fmt="%.2g")
        axes.set_aspect("equal")
        axes.set_xlim(0, wide - 1)
        axes.set_ylim(high - 1, 0)
        axes.set_title(f"at {one.distance:.3g} m" if math.isfinite(one.distance) else "at infinity")
        axes.set_xlabel("u [px]")
    every[0].set_ylabel("v [px]")
    figure.colorbar(filled, ax=list(every), label="standard error of the projection [px]", format="%.2g")
    return figure_png(figure)
