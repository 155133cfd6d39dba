"""Wide sources as rows of the compiled tracer."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from radwrap.scene.sources import WideSource
from radwrap.scene.wide_shapes import Annulus, Rectangle, Zone, area
from radwrap.tracers.compiled.arrays import WIDE_ANNULUS, WIDE_RECTANGLE, WIDE_ZONE, Wide, put, rows
from radwrap.tracers.text_frame import TextFrame


def wide_row(source: WideSource, frame: TextFrame) -> NDArray[np.void]:
    """The row of a wide source of even radiance, in the frame of the text; shape (1,).

    Raises
    ------
    ValueError
        If its beam is not Lambertian.
    """
    if source.beam.profile != "lambertian":
        raise ValueError("a wide light without patches needs a Lambertian beam")
    row, units = rows(Wide, 1), frame.units
    match source.shape:
        case Rectangle(width, height):
            row["kind"], sizes = WIDE_RECTANGLE, (width * units, height * units, 0.0)
            half, low, high = (width / 2, height / 2), 0.0, 0.0
        case Annulus(inner, outer):
            row["kind"], sizes = WIDE_ANNULUS, (inner * units, outer * units, 0.0)
            half, low, high = (outer, outer), 0.0, 0.0
        case Zone(radius, least, most):
            low, high = -radius * math.cos(least), -radius * math.cos(most)
            row["kind"], sizes = WIDE_ZONE, (radius * units, low * units, high * units)
            half = (radius, radius)
    turned = np.asarray(source.pose.rotation)
    put(row, "x y z", frame.point(source.pose.position))
    put(row, "ux uy uz vx vy vz nx ny nz", turned.T.ravel())
    put(row, "a b c area radiance", (*sizes, area(source.shape) * units**2, source.radiance))
    local = [(x, y, z) for x in (-half[0], half[0]) for y in (-half[1], half[1]) for z in (low, high)]
    corners = frame.points(np.array(local) @ turned.T + source.pose.position)
    put(row, "x0 y0 z0 x1 y1 z1", np.concatenate([corners.min(axis=0), corners.max(axis=0)]))
    return row
