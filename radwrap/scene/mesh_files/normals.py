"""Normals that a mesh file gives to corners, which are not used: triangles here are flat."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.scene.mesh_files.mesh_texts import Polygons

Array = NDArray[np.float64]

# Rounded normals lean by less; a lobe of the least roughness that triangles can show is wider.
LEAST_LEANING: Final = math.radians(1.0)
# Slivers whose corners are rounded have any normal: so much of the area is not looked at.
_OF_AREA: Final = 1e-3


def leaning(vertices: Array, polygons: Polygons, normals: Array) -> float:
    """Angle [rad] by which normals of corners lean against flat faces; .1 % of the area may have a larger one.

    Parameters
    ----------
    vertices, normals : ndarray, shape (n, 3)
        Of the file; normals may have any length, and either side of a face.
    polygons : Polygons
        Checked faces; corners whose normal the file does not hold do not count.
    """
    counts, corners = np.array(polygons.counts, np.intp), np.array(polygons.corners, np.intp)
    given = np.array(polygons.normals, np.intp)
    if not len(given) or not len(normals):
        return 0.0
    ends = np.cumsum(counts)
    after = np.arange(1, len(corners) + 1)
    after[ends - 1] = ends - counts
    from_first = vertices[corners] - np.repeat(vertices[corners[ends - counts]], counts, axis=0)
    flat = np.add.reduceat(np.cross(from_first, from_first[after]), ends - counts)  # twice the area
    known = (given >= 0) & (given < len(normals))
    there = np.where(known[:, np.newaxis], normals[np.where(known, given, 0)], 0.0)
    face = np.repeat(flat, counts, axis=0)
    with np.errstate(all="ignore"):
        angle = np.arctan2(np.linalg.norm(np.cross(face, there), axis=1), np.abs((face * there).sum(axis=1)))
    each = np.maximum.reduceat(np.where(np.isfinite(angle), angle, 0.0), ends - counts)
    order = np.argsort(each)
    area = np.cumsum(np.linalg.norm(flat[order], axis=1))
    return float(each[order][np.searchsorted(area, (1 - _OF_AREA) * area[-1])]) if area[-1] > 0 else 0.0


def told_of(name: str, lean: float) -> str | None:
    """A line for a mesh whose normals would show something else, or None."""
    if lean <= LEAST_LEANING:
        return None
    return (
        f'"{name}": its file gives normals (vn) to corners that lean by up to {math.degrees(lean):.3g} deg against the '
        "triangles; they are not used, light is that of flat triangles: finer ones lean less"
    )
