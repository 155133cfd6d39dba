"""What noise the points of wide lights give an image with one ray a pixel."""

from __future__ import annotations

from typing import Final

import numpy as np

from radwrap.imaging.optics.view import View, central_rays, central_weights
from radwrap.imaging.response.sensor import unclipped_gray
from radwrap.random_streams import Rendering, generator

# Places, drawn where rays go: they know the noise to a tenth.
_PLACES: Final = 512
# A ray of another length asks other points.
_LONGER: Final = 1.0 + 2.0**-10


def points_noise(view: View, seed: int) -> tuple[float, int]:
    """Mean square over the image [gray level^2], but for smooth blocks, and how many rays told it; 0 without points.

    Parameters
    ----------
    view : View
        Who traces.
    seed : int
        Of the places.
    """
    if view.with_noise(1) is view:
        return 0.0, 0
    sensor = view.camera.sensor
    random = generator(seed, Rendering.POINTS_NOISE)
    u, v = (random.uniform(-0.5, size - 0.5, 16 * _PLACES) for size in (sensor.columns, sensor.rows))
    rest = np.full(len(u), True) if view.smooth is None else ~view.smooth.holds(u, v)
    share = float(rest.mean())
    u, v = (axis[rest][:_PLACES] for axis in (u, v))
    if not len(u):
        return 0.0, 0
    rays, weights = central_rays(view.camera, u, v), central_weights(view.camera, u, v)
    longer = rays * np.repeat([1.0, _LONGER], 3)
    scale = weights * view.exposure_of_radiance
    one, other = (unclipped_gray(radiance * scale, sensor) for radiance in view.tracer.trace([rays, longer]))
    return share * float(((one - other) ** 2).mean()) / 2, 2 * len(u)
