"""Wide sources as rows of the compiled tracer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import Final, TypeGuard

import numpy as np
from numpy.typing import NDArray

from radwrap.scene.sources import Beam, Source, WideSource
from radwrap.scene.wide_shapes import Annulus, Rectangle, Zone, area
from radwrap.tracers.compiled import arrays
from radwrap.tracers.compiled.arrays import (
    BEAMS,
    DISC,
    RECTANGLE,
    WIDE_ANNULUS,
    WIDE_RECTANGLE,
    WIDE_ZONE,
    ZONE,
    Cluster,
    Floats,
    Light,
    Shape,
    Wide,
    put,
    rows,
)
from radwrap.tracers.compiled.intersect import padded
from radwrap.tracers.compiled.wide_cells import ALL_CELLS
from radwrap.tracers.text_frame import TextFrame

# Angles at which a beam is looked at, the share of its peak below which it has ended, and the steepest slope of
# exp(-x^2/2).
_ANGLES: Final = 3601
_DARK: Final = 1e-8
_STEEPEST_GAUSSIAN: Final = math.exp(-0.5)
# At the rows of a table its curvature jumps, which a Gaussian's never does: quadrature takes shorter steps.
_OF_TABLE: Final = 0.5


def shines_whole(source: Source) -> TypeGuard[WideSource]:
    """Whether a source is wide and shines; only flat ones have another beam than the Lambertian."""
    if not isinstance(source, WideSource) or source.radiance == 0:
        return False
    return source.beam.profile == "lambertian" or not isinstance(source.shape, Zone)


def beam_reach(beam: Beam) -> tuple[float, float]:
    """Angle over which a beam changes as a Gaussian does over its standard deviation, and where it ends [rad]."""
    angles = np.linspace(0, math.pi / 2, _ANGLES)
    shares = beam.relative_intensity(angles)
    lit = np.flatnonzero(shares > _DARK)
    reach = float(angles[min(lit[-1] + 1, _ANGLES - 1)]) if len(lit) else float(angles[-1])
    match beam.profile:
        case "gaussian" | "cosine_power":
            return beam.spread, min(reach, math.pi / 2)
        case "cone":
            return math.pi / 2, min(beam.spread, math.pi / 2)
        case "table":
            # By its steepest slope: that of a Gaussian is .61 over its standard deviation.
            slope = float(np.abs(np.gradient(shares, angles)).max())
            return min(_OF_TABLE * _STEEPEST_GAUSSIAN / max(slope, 1e-300), math.pi / 2), reach
        case _:
            return math.pi / 2, math.pi / 2


def wide_row(source: WideSource, frame: TextFrame) -> NDArray[np.void]:
    """The row of a source that `shines_whole`, in the frame of the text, without a table; shape (1,)."""
    row, units = rows(Wide, 1), frame.units
    match source.shape:
        case Rectangle(width, height):
            row["kind"], sizes = WIDE_RECTANGLE, (width * units, height * units, 0.0)
        case Annulus(inner, outer):
            row["kind"], sizes = WIDE_ANNULUS, (inner * units, outer * units, 0.0)
        case Zone(radius, least, most):
            low, high = -radius * math.cos(least), -radius * math.cos(most)
            row["kind"], sizes = WIDE_ZONE, (radius * units, low * units, high * units)
    turned = np.asarray(source.pose.rotation)
    put(row, "x y z", frame.point(source.pose.position))
    put(row, "ux uy uz vx vy vz nx ny nz", turned.T.ravel())
    put(row, "a b c area radiance", (*sizes, area(source.shape) * units**2, source.radiance))
    put(row, "x0 y0 z0 x1 y1 z1", _box(source, frame, (0.0, 1.0, 0.0, 1.0)))
    row["beam"], row["spread"] = BEAMS[source.beam.profile], source.beam.spread
    put(row, "narrow reach", beam_reach(source.beam))
    return row


def shape_row(wide: NDArray[np.void], owner: int) -> tuple[NDArray[np.void], Floats]:
    """The shape of a wide light, given its row, and its box; shapes (1,) and (1, 6)."""
    row, light = rows(Shape, 1), wide[0]
    at = np.array([light["x"], light["y"], light["z"]])
    height = float(at @ [light["nx"], light["ny"], light["nz"]])
    for name in ("x", "y", "z", "ux", "uy", "uz", "vx", "vy", "vz", "nx", "ny", "nz"):
        row[name] = light[name]
    a, b, c = float(light["a"]), float(light["b"]), float(light["c"])
    match int(light["kind"]):
        case arrays.WIDE_RECTANGLE:
            row["kind"], sizes = RECTANGLE, (a / 2, b / 2, height)
        case arrays.WIDE_ANNULUS:
            row["kind"], sizes = DISC, (b * b, a * a, height)
        case _:
            row["kind"], sizes = ZONE, (a, b, c)
    put(row, "a b c", sizes)
    row["owner"], row["decal"] = owner, -1
    return row, np.array([[light[name] for name in ("x0", "y0", "z0", "x1", "y1", "z1")]])


def light_row(wide: NDArray[np.void]) -> NDArray[np.void]:
    """The row of a wide light among all lights, without its radiance; shape (1,)."""
    row = rows(Light, 1)
    for name in ("x", "y", "z", "nx", "ny", "nz", "area", "beam", "spread", "table", "columns"):
        row[name] = wide[name]
    return row


def cell_rows(sources: Sequence[WideSource], frame: TextFrame) -> NDArray[np.void]:
    """Boxes of the cells of wide lights, see `wide_cells`: rows of `Cluster`, `ALL_CELLS` of each light."""
    made = rows(Cluster, len(sources) * ALL_CELLS)
    cells = [(i / n, (i + 1) / n, j / n, (j + 1) / n) for n in (1, 2, 4, 8) for i in range(n) for j in range(n)]
    if sources:
        boxes = [_box(source, frame, cell) for source in sources for cell in cells]
        put(made, "x0 y0 z0 x1 y1 z1", boxes)
    return made


def _box(source: WideSource, frame: TextFrame, cell: tuple[float, float, float, float]) -> Floats:
    """The box about a cell of a light's even coordinates, in the frame of the text."""
    u0, u1, v0, v1 = cell
    match source.shape:
        case Rectangle(width, height):
            x, y, z = ((u0 - 0.5) * width, (u1 - 0.5) * width), ((v0 - 0.5) * height, (v1 - 0.5) * height), (0.0, 0.0)
        case Annulus(inner, outer):
            radii = [math.sqrt(inner**2 + u * (outer**2 - inner**2)) for u in (u0, u1)]
            x, y, z = *_ranges(radii, v0, v1), (0.0, 0.0)
        case Zone(radius, least, most):
            low, high = -radius * math.cos(least), -radius * math.cos(most)
            z = (low + u0 * (high - low), low + u1 * (high - low))
            heights = [*z, 0.0] if z[0] < 0 < z[1] else list(z)
            x, y = _ranges([math.sqrt(max(radius**2 - at**2, 0.0)) for at in heights], v0, v1)
    local = np.array(list(product(x, y, z)))
    corners = frame.points(local @ np.asarray(source.pose.rotation).T + source.pose.position)
    low_corner, high_corner = padded(corners.min(axis=0), corners.max(axis=0))
    return np.concatenate([low_corner, high_corner])


def _ranges(radii: Sequence[float], v0: float, v1: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Least and largest x and y of places at radii and between shares of a turn."""
    quarters = [k / 4 for k in range(math.ceil(4 * v0), math.floor(4 * v1) + 1)]
    turns = [2 * math.pi * v for v in (v0, v1, *quarters)]
    x = [r * math.cos(turn) for r in radii for turn in turns]
    y = [r * math.sin(turn) for r in radii for turn in turns]
    return (min(x), max(x)), (min(y), max(y))
