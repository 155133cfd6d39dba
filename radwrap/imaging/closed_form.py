"""Radiance of lit surfaces by closed form: one reflection, no shadows.

It tells what to expect before a ray is traced, and stands beside the tracer as
a second opinion.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from radwrap.scene.checks import sheeting_angles
from radwrap.scene.geometry import SurfacePoints
from radwrap.scene.materials import (
    GLASS_BEAD_ENTRANCE_SCALE,
    GLASS_BEAD_OBSERVATION,
    GLASS_BEAD_PROFILE,
    CoefficientTable,
    GlassBeads,
    Lambertian,
    Material,
    PerturbedNormal,
    Specular,
)
from radwrap.scene.sources import Emitter

Array = NDArray[np.float64]


def perpendicular_irradiance(emitter: Emitter, points: Array) -> Array:
    """E_perp = I(theta)/d^2 at points, shape (n,) [W m^-2]; the source counts as a point."""
    square = ((points - np.asarray(emitter.position)) ** 2).sum(axis=1)
    irradiance: Array = emitter.radiant_intensity * emitter.relative_intensity_at(points) / square
    return irradiance


def coefficient_of_retroreflection(material: CoefficientTable | GlassBeads, alpha: Array, beta: Array) -> Array:
    """R_A [cd lx^-1 m^-2 = sr^-1] at angles alpha and beta [rad]; held at the edge of the data."""
    if isinstance(material, GlassBeads):
        profile = np.exp(np.interp(np.degrees(alpha), GLASS_BEAD_OBSERVATION, np.log(GLASS_BEAD_PROFILE)))
        beads: Array = material.anchor * profile * np.exp(-(np.degrees(beta) ** 2) / GLASS_BEAD_ENTRANCE_SCALE)
        return beads
    table = np.asarray(material.coefficient)
    values = np.log(table) if material.interpolation == "log" else table
    across = np.array([np.interp(alpha, material.observation, column) for column in values.T])
    nodes = np.asarray(material.entrance)
    place = np.interp(beta, nodes, np.arange(len(nodes)))
    low = np.minimum(np.floor(place).astype(int), len(nodes) - 2)
    share = place - low
    column = np.arange(len(alpha))
    result: Array = across[low, column] * (1 - share) + across[low + 1, column] * share
    return np.exp(result) if material.interpolation == "log" else result


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
    normals = group.normals
    if isinstance(material, Lambertian | Specular):
        # Paint has no back: what counts is the side that the eye sees.
        normals = normals * np.where((to_eye * normals).sum(axis=1) < 0, -1.0, 1.0)[:, np.newaxis]
    cos_nu = (to_eye * normals).sum(axis=1)
    cos_beta = (to_light * normals).sum(axis=1)
    alpha, beta = sheeting_angles(group.points, normals, np.asarray(emitter.position), eye)
    irradiance = perpendicular_irradiance(emitter, group.points)
    match material:
        case Lambertian(reflectance):
            factor = reflectance / math.pi * cos_beta
        case PerturbedNormal(reflectance, a):
            half = alpha / 2
            factor = reflectance * np.exp(-((np.tan(half) / a) ** 2)) * np.maximum(np.cos(alpha), 0.0)
            factor = factor / (4 * math.pi * a**2 * np.cos(half) ** 6)
        case CoefficientTable() | GlassBeads():
            factor = coefficient_of_retroreflection(material, alpha, beta) / np.maximum(cos_nu, 1e-12)
        case Specular(diffuse, specular, a):
            half_way = to_eye + to_light
            along = np.maximum((half_way * normals).sum(axis=1), 1e-12) ** 2
            square = (half_way**2).sum(axis=1)
            lobe = np.exp(-(square - along) / along / a**2) * square / (math.pi * along**2 * a**2)
            factor = (diffuse / math.pi + specular * lobe) * cos_beta
    result: Array = np.where((cos_nu > 0) & (cos_beta > 0), irradiance * factor, 0.0)
    return result
