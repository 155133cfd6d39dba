"""Radiance of lit surfaces by closed form: one reflection, no shadows.

It tells what to expect before a ray is traced, and stands beside the tracer as
a second opinion.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radwrap.scene.look.geometry import SurfacePoints
from radwrap.scene.look.reflection import radiance_factor
from radwrap.scene.materials import Material
from radwrap.scene.sources import Emitter

Array = NDArray[np.float64]


def perpendicular_irradiance(emitter: Emitter, points: Array) -> Array:
    """E_perp = I(theta)/d^2 at points, shape (n,) [W m^-2]; the source counts as a point."""
    square = ((points - np.asarray(emitter.position)) ** 2).sum(axis=1)
    irradiance: Array = emitter.radiant_intensity * emitter.relative_intensity_at(points) / square
    return irradiance


def radiance(material: Material, group: SurfacePoints, emitter: Emitter, eye: Array) -> Array:
    """Radiance towards the eye at points of a surface under one source.

    Parameters
    ----------
    material : Material
        Of the surface.
    group : SurfacePoints
        Points and normals, n of them.
    emitter : Emitter
        The source.
    eye : ndarray, shape (3,)
        The pinhole's centre [m].

    Returns
    -------
    ndarray, shape (n,)
        L [W m^-2 sr^-1]; 0 where the light is behind the surface, or the eye behind sheeting.
    """
    to_eye = eye - group.points
    to_eye = to_eye / np.linalg.norm(to_eye, axis=1, keepdims=True)
    to_light = np.asarray(emitter.position) - group.points
    to_light = to_light / np.linalg.norm(to_light, axis=1, keepdims=True)
    factor = radiance_factor(material, group.normals, to_light, to_eye, grain=group.grain)
    return perpendicular_irradiance(emitter, group.points) * factor
