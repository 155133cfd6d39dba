"""Edges that an image may show: outlines of objects, and creases of their surfaces."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.dataset.first_hits import FirstHits, ImageTruth
from radwrap.scene.look.geometry import project
from radwrap.scene.mesh import Mesh
from radwrap.scene.targets import MeshPart

OUTLINE: Final = 1
CREASE: Final = 2
CREASE_ANGLE: Final = math.radians(30)
_STEPS_PER_PIXEL: Final = 2
_MOST_STEPS: Final = 10_000  # along one edge


def edge_image(hits: FirstHits, truth: ImageTruth) -> NDArray[np.uint8]:
    """Where edges are: 1 for outlines, 2 for creases above 30 degrees, 0 elsewhere, shape (rows, columns).

    An outline is a pixel that sees an object while one of its four neighbours does not. A crease is a pixel that a
    visible point of a mesh edge falls into, where two faces turn by more than 30 degrees, or only one face is; it sees
    the same object.
    """
    found = np.zeros(truth.depth.shape, dtype=np.uint8)
    for one in truth.objects:
        points = _crease_points(hits, one.part)
        uv, depth = project(hits.camera, points)
        places = np.rint(uv).astype(np.int64)
        inside = (depth > 0) & (places >= 0).all(axis=1) & (places < found.shape[::-1]).all(axis=1)
        seen = places[inside][hits.reaches(points[inside])]
        seen = seen[one.visible[seen[:, 1], seen[:, 0]]]
        found[seen[:, 1], seen[:, 0]] = CREASE
    for one in truth.objects:
        found[outline_of(one.visible)] = OUTLINE
    return found


def outline_of(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels of a mask with a neighbour to the left, right, above or below that is not of it; the image has no rim."""
    padded = np.pad(mask, 1, mode="edge")
    inner = padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    outline: NDArray[np.bool_] = mask & ~inner
    return outline


def creases(mesh: Mesh) -> NDArray[np.intp]:
    """Edges where two faces turn by more than 30 degrees, or that only one face has; shape (n, 2), vertices."""
    sides = np.sort(np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]]), axis=1)
    owner = np.tile(np.arange(len(mesh.faces)), 3)
    edges, inverse, count = np.unique(sides, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(inverse.ravel(), kind="stable")
    starts = np.concatenate([[0], np.cumsum(count)[:-1]])
    first, last = owner[order[starts]], owner[order[starts + count - 1]]
    normals = mesh.normals
    cosine = (normals[first] * normals[last]).sum(axis=1)
    sharp: NDArray[np.intp] = edges[(count != 2) | (cosine < math.cos(CREASE_ANGLE))]
    return sharp


def _crease_points(hits: FirstHits, part: MeshPart) -> NDArray[np.float64]:
    """Points along all creases in the world [m], two for each pixel of their length."""
    corners = part.mesh.vertices @ np.asarray(part.pose.rotation).T + np.asarray(part.pose.position)
    ends = corners[creases(part.mesh)]
    if not len(ends):
        return np.empty((0, 3))
    uv, depth = project(hits.camera, ends.reshape(-1, 3))
    length = np.linalg.norm(np.diff(uv.reshape(-1, 2, 2), axis=1)[:, 0], axis=1)
    ends, length = ends[(depth > 0).reshape(-1, 2).all(axis=1)], length[(depth > 0).reshape(-1, 2).all(axis=1)]
    steps = np.clip(np.ceil(_STEPS_PER_PIXEL * length), 1, _MOST_STEPS).astype(np.intp)
    edge = np.repeat(np.arange(len(ends)), steps + 1)
    along = np.arange(len(edge)) - np.repeat(np.cumsum(steps + 1) - (steps + 1), steps + 1)
    share = (along / steps[edge])[:, np.newaxis]
    points: NDArray[np.float64] = ends[edge, 0] * (1 - share) + ends[edge, 1] * share
    return points
