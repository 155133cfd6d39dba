"""What share of a ray's radiance counts, behind a pinhole and behind a lens: cos^4, or a measured falloff.

Of light between lens and sensor the angle theta to the axis decides, that of
the direction (x' + q, v): H = tau T/v^2 * integral over the opening of
L cos^4(theta) dA, whatever the focus. Where the falloff towards the corners
was measured it takes the place of what theta says of x', and the opening's
point q alone decides theta: L cos^4(q) g(|x'|), g(0) = 1. It was measured on
the sensor, so it holds the area that distortion adds or takes.

The kernel takes one image, what the opening's centre sees, for what all its
points see. Each of its values gets the mean of the factor over the opening,
and each point of the opening its share on the axis. For a pinhole as small
beside f as pinholes are, both are the central ray's cos^4, and 1.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.optics.aperture import place, turn
from radwrap.scene.camera import Aperture, Camera

Array = NDArray[np.float64]

# Gauss nodes in the share of area; points on a full turn, Gauss nodes on half of one; Gauss nodes along a square's
# sides. The mean of cos^4 is then right to 1e-7 at f/1.4, 30 degrees off the axis.
_RADII: Final = 4
_TURN: Final = 10
_HALF_TURN: Final = 8
_SIDE: Final = 6


def cos4_of(local: Array) -> Array:
    """cos^4 of the angle between directions, shape (n, 3), and the third axis."""
    cos4: Array = (local[0, 2] ** 2 / np.einsum("ij,ij->i", local, local)) ** 2 if len(local) else np.empty(0)
    return cos4


def falloff(camera: Camera, image_side: Array, opening: Array) -> Array:
    """Share of the radiance that counts.

    Parameters
    ----------
    camera : Camera
        For its lens.
    image_side : ndarray, shape (n, 3)
        (x' + u, y' + v, image distance) of each ray [m].
    opening : ndarray, shape (1, 2) or (n, 2)
        Points of the opening [m].

    Returns
    -------
    ndarray, shape (n,)
        cos^4(theta), or what was measured.
    """
    if camera.lens is None or camera.lens.relative_illumination is None:
        return cos4_of(image_side)
    factor: Array = axis_cos4(camera, opening) * _measured(camera, image_side[:, :2] - opening)
    return factor


def whole_falloff(camera: Camera, image_side: Array) -> Array:
    """Mean of `falloff` over the opening for central rays, shape (n,); that of its centre for a pinhole."""
    if camera.lens is None:
        return cos4_of(image_side)
    points, weights = _nodes(camera.aperture)
    if camera.lens.relative_illumination is not None:
        mean = float(weights @ axis_cos4(camera, points))
        return mean * _measured(camera, image_side[:, :2])
    total = np.zeros(len(image_side))
    if len(total):
        # By columns, each a block of memory: a tenth of the time of `cos4_of` for each of the points.
        x, y, square = *np.ascontiguousarray(image_side[:, :2].T), image_side[0, 2] ** 2
        for (p, q), weight in zip(points.tolist(), weights.tolist(), strict=True):
            cosine2 = square / ((x + p) ** 2 + square + (y + q) ** 2)
            total += weight * cosine2**2
    return total


def opening_shares(camera: Camera, opening: Array) -> Array:
    """What points of the opening, shape (n, 2), weigh on the axis, in terms of its mean; 1 for a pinhole."""
    if camera.lens is None:
        return np.ones(len(opening))
    points, weights = _nodes(camera.aperture)
    shares: Array = axis_cos4(camera, opening) / float(weights @ axis_cos4(camera, points))
    return shares


def axis_cos4(camera: Camera, opening: Array) -> Array:
    """cos^4 of rays from points of the opening to the sensor's point on the axis."""
    square = camera.image_distance**2
    cos4: Array = (square / (square + (opening**2).sum(axis=1))) ** 2
    return cos4


def _measured(camera: Camera, place: Array) -> Array:
    """At undistorted places, shape (n, 2) [m]; heights are those of the sensor."""
    x, y = place.T
    if camera.distortion is not None:
        x, y = (camera.image_distance * one for one in camera.distortion.distorted(*(place.T / camera.image_distance)))
    assert camera.lens is not None and camera.lens.relative_illumination is not None  # noqa: S101  (callers know)
    heights, shares = np.transpose(camera.lens.relative_illumination)
    return np.asarray(np.interp(np.hypot(x, y), heights, shares), dtype=np.float64)


def _nodes(aperture: Aperture) -> tuple[Array, Array]:
    """Points of an opening, and weights, that integrate smooth functions over it; the weights' sum is 1."""
    if aperture.is_infinitesimal:
        return np.zeros((1, 2)), np.ones(1)
    if aperture.shape == "square":
        side, share = np.polynomial.legendre.leggauss(_SIDE)
        x, y = np.meshgrid(side, side)
        points = np.stack([x.ravel(), y.ravel()], axis=1) * (aperture.diameter / 2)
        weights = np.outer(share, share).ravel() / 4
    else:
        s, of_s = _unit_gauss(_RADII)
        if aperture.shape == "half_disc":
            t, of_t = _unit_gauss(_HALF_TURN)
        else:
            t, of_t = (np.arange(_TURN) + 0.5) / _TURN, np.full(_TURN, 1 / _TURN)
        points = place(aperture, *(grid.ravel() for grid in np.meshgrid(s, t)))
        weights = np.outer(of_t, of_s).ravel()
    return points @ turn(aperture.rotation).T, weights


def _unit_gauss(number: int) -> tuple[Array, Array]:
    """Gauss nodes and weights on [0, 1]."""
    nodes, weights = np.polynomial.legendre.leggauss(number)
    return (nodes + 1) / 2, weights / 2
