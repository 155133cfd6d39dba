"""What the compiled functions work on: arrays of rows with named numbers, in the unit of length of Radiance's text.

A class lists a row's numbers, and `rows` makes the arrays. A row is a bare
place in memory for the compiler; tuples of arrays, or views of parts of them,
cost it more than the arithmetic.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple, get_type_hints

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

# Kinds of shapes, and what their numbers a, b, c are.
TRIANGLE: Final = 0  # 1 where its normal is sure, 0 where it is so thin that rounding turns it
RECTANGLE: Final = 1  # half width, half height, height of its plane
POLYGON: Final = 2  # where its corners begin in `tables`, number of corners, height of its plane
DISC: Final = 3  # squares of the radius and of its hole's, height of its plane
SPHERE: Final = 4  # radius
TUBE: Final = 5  # radius, length
ZONE: Final = 6  # radius of the sphere, least and largest height over its middle, along the normal

# Kinds of beams.
LAMBERTIAN: Final = 0
GAUSSIAN: Final = 1
COSINE_POWER: Final = 2
CONE: Final = 3
TABLE_BEAM: Final = 4
LUMINAIRE: Final = 5
BEAMS: Final = {
    "lambertian": LAMBERTIAN,
    "gaussian": GAUSSIAN,
    "cosine_power": COSINE_POWER,
    "cone": CONE,
    "table": TABLE_BEAM,
}

# Kinds of what a cover reflects besides its diffuse part, and what its numbers a, b, c are.
NOTHING: Final = 0
WARD: Final = 1  # square of the roughness
BRUSHED: Final = 2  # squares of the roughness along the grain and across
TURNED_NORMAL: Final = 3  # square of the roughness
COEFFICIENTS: Final = 4  # numbers of observation and entrance angles; 1 where the table holds logarithms
BEADS: Final = 5  # number of observation angles; anchor, entrance scale [rad^2]
BRDF: Final = 6  # numbers of incidence, viewing and azimuth angles

# Kinds of what is painted on a flat target, and what its numbers a, b, c are.
DOTS: Final = 0  # columns, rows, square of radius over pitch
EDGE: Final = 1  # where the edge lies
PATTERN: Final = 2  # where the nodes of its partition begin in the tables, places being in metres
NODE: Final = 6  # numbers of a partition's node

# Shapes of wide lights, and what `a`, `b` and `c` mean.
WIDE_RECTANGLE: Final = 0  # width, height
WIDE_ANNULUS: Final = 1  # inner and outer radius
WIDE_ZONE: Final = 2  # radius of the sphere, least and largest height over its middle


class Shape:
    """A shape of a target or an emitter.

    Attributes
    ----------
    kind : int
        Which shape.
    owner : int
        The cover of a target's shape, or the number of the emitter.
    decal : int
        Row of what is painted on it, or -1.
    x, y, z : float
        Corner of a triangle or polygon, centre of the others, an end of a tube's axis.
    ux, uy, uz, vx, vy, vz : float
        Sides of a triangle from that corner; unit vectors in the plane of a rectangle or polygon.
    nx, ny, nz : float
        Unit normal; of a tube, its axis.
    a, b, c : float
        Sizes, see the kinds.
    """

    kind: int
    owner: int
    decal: int
    x: float
    y: float
    z: float
    ux: float
    uy: float
    uz: float
    vx: float
    vy: float
    vz: float
    nx: float
    ny: float
    nz: float
    a: float
    b: float
    c: float


class Node:
    """A box of the tree over shapes.

    Attributes
    ----------
    x0, y0, z0, x1, y1, z1 : float
        Its least and largest places.
    first, count : int
        The shapes in it; no count: it holds two boxes, the next one in the array, and `second`.
    second : int
        The other box.
    """

    x0: float
    y0: float
    z0: float
    x1: float
    y1: float
    z1: float
    first: int
    count: int
    second: int


class Cover:
    """A material as a part of a target wears it.

    Attributes
    ----------
    kind : int
        What it reflects besides its diffuse part.
    two_sided : int
        1 where both sides look alike, 0 where the back is black.
    diffuse : float
        Diffuse reflectance over pi.
    weight : float
        Factor on the rest.
    a, b, c : float
        The rest's own numbers, see the kinds.
    fine : float
        The smallest angle over which the rest changes much: of a lobe its roughness, of a table its least step [rad].
    gx, gy, gz : float
        Direction of the grain.
    table : int
        Where its angles and values begin in `tables`.
    image, columns, rows : int
        Where a print begins there, and its size; without columns there is none.
    x, y, z, ux, uy, uz, vx, vy, vz : float
        Middle of the print, its x over its width, its y over its height.
    """

    kind: int
    two_sided: int
    diffuse: float
    weight: float
    a: float
    b: float
    c: float
    fine: float
    gx: float
    gy: float
    gz: float
    table: int
    image: int
    columns: int
    rows: int
    x: float
    y: float
    z: float
    ux: float
    uy: float
    uz: float
    vx: float
    vy: float
    vz: float


class Decal:
    """What is painted on a flat target.

    Attributes
    ----------
    kind : int
        Dots, all beyond an edge, or a pattern.
    cover : int
        What it looks like.
    x, y, z, ux, uy, uz, vx, vy, vz : float
        Middle of the target, its x and y, of dots over their pitch, of a pattern over a metre.
    a, b, c : float
        See the kinds.
    """

    kind: int
    cover: int
    x: float
    y: float
    z: float
    ux: float
    uy: float
    uz: float
    vx: float
    vy: float
    vz: float
    a: float
    b: float
    c: float


class Light:
    """An emitter, which shines from its centre.

    Attributes
    ----------
    beam : int
        Kind of beam.
    x, y, z : float
        Centre.
    nx, ny, nz, ux, uy, uz, vx, vy, vz : float
        Unit vectors: axis, and x and y of a luminaire.
    area : float
        Of the disc or patch, or of a luminaire's silhouette.
    radiance : float
        Along the axis [W m^-2 sr^-1]; 0 of what is switched off, which still hides.
    spread : float
        Of the beam, see `scene.sources.Beam`.
    table, rows, columns : int
        Where a measured beam begins in `tables`, and its size.
    own : int
        Its own shape where another emitter may stand before its centre; else -1.
    column : int
        Of the answer, to which its light is added.
    """

    beam: int
    x: float
    y: float
    z: float
    nx: float
    ny: float
    nz: float
    ux: float
    uy: float
    uz: float
    vx: float
    vy: float
    vz: float
    area: float
    radiance: float
    spread: float
    table: int
    rows: int
    columns: int
    own: int
    column: int


class Cluster:
    """Lights that follow each other in their array, all of one kind of beam, and the box of their centres.

    Attributes
    ----------
    first, end : int
        The lights.
    beam : int
        Kind of their beams.
    part : int
        Its first part, a cluster of fewer lights, among the parts.
    may_be_hidden : int
        1 where another emitter may stand before one of them.
    x0, y0, z0, x1, y1, z1 : float
        Least and largest places of their centres.
    """

    first: int
    end: int
    beam: int
    part: int
    may_be_hidden: int
    x0: float
    y0: float
    z0: float
    x1: float
    y1: float
    z1: float


class Wide:
    """A wide light, which shines as a whole.

    Attributes
    ----------
    kind : int
        Kind of its shape, see above.
    light : int
        Its number among the lights.
    own : int
        Its own shape, which does not hide it, among those of emitters.
    may_be_hidden : int
        1 where another emitter may stand between it and a target.
    x, y, z : float
        Origin of its frame.
    ux, uy, uz, vx, vy, vz, nx, ny, nz : float
        Unit vectors of its frame; it shines along the last, a zone to its origin.
    a, b, c : float
        Sizes of its shape.
    area, radiance : float
        Area, and radiance along the normal [W m^-2 sr^-1].
    beam, spread, table, columns
        As those of a `Light`; round ones are Lambertian.
    narrow : float
        Angle over which its beam changes as a Gaussian does over its standard deviation [rad].
    reach : float
        Angle beyond which next to nothing of its beam is left [rad].
    x0, y0, z0, x1, y1, z1 : float
        The box about it.
    """

    kind: int
    light: int
    own: int
    may_be_hidden: int
    x: float
    y: float
    z: float
    ux: float
    uy: float
    uz: float
    vx: float
    vy: float
    vz: float
    nx: float
    ny: float
    nz: float
    a: float
    b: float
    c: float
    area: float
    radiance: float
    beam: int
    spread: float
    table: int
    columns: int
    narrow: float
    reach: float
    x0: float
    y0: float
    z0: float
    x1: float
    y1: float
    z1: float


class Tree(NamedTuple):
    """Shapes in the order of a tree's leaves, and the tree; `rows` of `Shape` and `Node`."""

    shapes: NDArray[np.void]
    nodes: NDArray[np.void]


def _numbers(row: type) -> np.dtype[np.void]:
    kinds = {int: np.int64, float: np.float64}
    return np.dtype([(name, kinds[kind]) for name, kind in get_type_hints(row).items()])


_ROWS: Final[dict[type, np.dtype[np.void]]] = {
    row: _numbers(row) for row in (Shape, Node, Cover, Decal, Light, Cluster, Wide)
}


def rows(row: type, count: int) -> NDArray[np.void]:
    """That many rows of a class above, all numbers 0."""
    return np.zeros(count, dtype=_ROWS[row])


def put(array: NDArray[np.void], names: str, values: Any) -> None:
    """Fill the numbers of those names, parted by blanks, with the last axis of values."""
    for name, column in zip(names.split(), np.moveaxis(np.asarray(values), -1, 0), strict=True):
        array[name] = column


# Arrays of rows, as the compiled functions see them: `array[i].name`, which numpy's own types do not know.
Shapes = Any
Nodes = Any
Covers = Any
Decals = Any
Lights = Any
Clusters = Any
Wides = Any
