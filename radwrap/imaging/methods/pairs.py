"""Paired rays: one through a point of the opening, and those through its centre that a kernel takes in its place.

They are equal where the kernel's model holds, so that few pairs tell much of
what it lacks; see `kernel`.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.methods.kernel import layer_shares
from radwrap.imaging.optics.falloff import opening_shares
from radwrap.imaging.optics.view import View, magnifications_at, trace_rays

Array = NDArray[np.float64]

# Of many layers few have a share in what a ray sees: distances, which cost less, are asked first.
_MANY_LAYERS: Final = 3


def paired(view: View, layers: tuple[float, ...], opening: Array, u: Array, v: Array) -> tuple[Array, Array]:
    """Values of rays, and these less what a kernel takes in the ray's place.

    Parameters
    ----------
    view : View
        Who traces.
    layers : tuple of float
        The kernel's magnifications.
    opening : ndarray, shape (n, 2)
        Points of the opening [m].
    u, v : ndarray, shape (n,)
        Places on the sensor [px].

    Returns
    -------
    values, differences : ndarray, shape (n,)
        [W m^-2 sr^-1]; with an axis of the sources before, where the view's tracer tells them apart.
    """
    camera = view.camera
    values = trace_rays(view, opening, u, v, alone=True)[0]
    differences = values.copy()
    shares = opening_shares(camera, opening)
    for number, layer in enumerate(layers):
        at = (
            u + layer * opening[:, 0] / camera.sensor.pixel_width,
            v + layer * opening[:, 1] / camera.sensor.pixel_height,
        )
        if len(layers) > _MANY_LAYERS:
            share = layer_shares(layers, magnifications_at(view, *at))[number]
            some = np.flatnonzero(share)
            central = trace_rays(view, None, at[0][some], at[1][some], alone=True)[0]
            differences[..., some] -= central * shares[some] * share[some]
            continue
        central, magnification = trace_rays(view, None, *at, with_depth=len(layers) > 1, alone=True)
        differences -= central * shares * layer_shares(layers, magnification)[number]
    return values, differences
