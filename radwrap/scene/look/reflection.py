"""How much of what falls on a surface goes to a viewer: L/E_perp by closed form."""

from __future__ import annotations

import math
from typing import assert_never

import numpy as np
from numpy.typing import NDArray

from radwrap.frames import Vector
from radwrap.scene.materials import (
    GLASS_BEAD_ENTRANCE_SCALE,
    GLASS_BEAD_OBSERVATION,
    GLASS_BEAD_PROFILE,
    Anisotropic,
    CoefficientTable,
    Glass,
    GlassBeads,
    Lambertian,
    Material,
    MeasuredBrdf,
    Mirror,
    PerturbedNormal,
    PrintedImage,
    PrintedSheeting,
    Specular,
    TwoSided,
)

Array = NDArray[np.float64]


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


def _table_of(material: MeasuredBrdf, normals: Array, to_light: Array, to_eye: Array) -> Array:
    """Values of f [sr^-1], straight between the table's nodes and held beyond."""
    flat = [away - (away * normals).sum(axis=1, keepdims=True) * normals for away in (to_light, to_eye)]
    length = np.maximum(np.linalg.norm(flat[0], axis=1) * np.linalg.norm(flat[1], axis=1), 1e-6)
    beta, nu = (np.arccos(np.clip((away * normals).sum(axis=1), -1.0, 1.0)) for away in (to_light, to_eye))
    turn = np.arccos(np.clip((flat[0] * flat[1]).sum(axis=1) / length, -1.0, 1.0))
    axes = tuple(np.asarray(nodes) for nodes in (material.incidence, material.viewing, material.azimuth))
    table = np.asarray(material.values).reshape(tuple(map(len, axes)))
    total: Array = np.zeros_like(beta)
    places = [np.interp(angle, of, np.arange(len(of))) for angle, of in zip((beta, nu, turn), axes, strict=True)]
    lows = [np.minimum(np.floor(place).astype(int), len(of) - 2) for place, of in zip(places, axes, strict=True)]
    for corner in range(8):
        steps = [corner >> bit & 1 for bit in range(3)]
        weight = np.ones_like(beta)
        index = []
        for place, low, step, nodes in zip(places, lows, steps, axes, strict=True):
            weight = weight * (place - low if step else 1 - (place - low))
            index.append(np.minimum(low + step, len(nodes) - 1))
        total += weight * table[tuple(index)]
    return total


def radiance_factor(
    material: Material,
    normals: Array,
    to_light: Array,
    to_eye: Array,
    *,
    solid_angle: Array | float = 0.0,
    grain: Vector | Array = (1.0, 0.0, 0.0),
) -> Array:
    """Radiance towards a viewer for each unit of irradiance at right angles to the light.

    Parameters
    ----------
    material : Material
        Of the surface.
    normals, to_light, to_eye : ndarray, shape (n, 3)
        Unit vectors; the normal of the front.
    solid_angle : float or ndarray, shape (n,), optional
        Of the light [sr]: on a flat face Radiance widens the Gaussian lobe by it, a^2 + omega/(4 pi).
    grain : tuple of float or ndarray, shape (n, 3), optional
        The target's x in the world, for a lobe that has a direction.

    Returns
    -------
    ndarray, shape (n,)
        L/E_perp [sr^-1]; 0 where the light is behind the surface, or the eye behind sheeting.
    """
    if isinstance(material, TwoSided):
        # Paint has no back: what counts is the side that the eye sees.
        normals = normals * np.where((to_eye * normals).sum(axis=1) < 0, -1.0, 1.0)[:, np.newaxis]
    cos_nu = (to_eye * normals).sum(axis=1)
    cos_beta = (to_light * normals).sum(axis=1)
    # From the chord: acos loses half the digits at the small angles that matter here.
    alpha = 2 * np.arcsin(np.minimum(np.linalg.norm(to_light - to_eye, axis=1) / 2, 1.0))
    beta = np.arccos(np.clip(cos_beta, -1.0, 1.0))
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
            a_square = a**2 + solid_angle / (4 * math.pi)
            lobe = np.exp(-(square - along) / along / a_square) * square / (math.pi * along**2 * a_square)
            factor = (diffuse / math.pi + specular * lobe) * cos_beta
        case Anisotropic(diffuse, specular, x, y):
            half_way = to_eye + to_light
            along = np.maximum((half_way * normals).sum(axis=1), 1e-12) ** 2
            square = (half_way**2).sum(axis=1)
            side = np.cross(normals, np.broadcast_to(grain, normals.shape))
            side = side / np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-300)
            on_y = (half_way * side).sum(axis=1) ** 2
            on_x = np.maximum(square - along - on_y, 0.0)
            x_square, y_square = (a**2 + solid_angle / (4 * math.pi) for a in (x, y))
            lobe = np.exp(-(on_x / x_square + on_y / y_square) / along)
            lobe = lobe * square / (math.pi * along**2 * np.sqrt(x_square * y_square))
            factor = (diffuse / math.pi + specular * lobe) * cos_beta
        case PrintedImage(_, rows):
            factor = max(map(max, rows)) / math.pi * cos_beta
        case PrintedSheeting(sheeting, coverage, reflectance):
            below = radiance_factor(sheeting, normals, to_light, to_eye)
            factor = coverage * reflectance / math.pi * cos_beta + (1 - coverage) * below
        case MeasuredBrdf():
            factor = _table_of(material, normals, to_light, to_eye) * cos_beta
        case Mirror() | Glass():
            factor = np.zeros_like(cos_beta)
        case _:
            assert_never(material)
    result: Array = np.where((cos_nu > 0) & (cos_beta > 0), factor, 0.0)
    return result
