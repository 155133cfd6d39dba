"""Targets: what the camera looks at, and the surfaces they consist of.

A flat target lies in its own xy plane, centred on its origin, and faces +z.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from radwrap.frames import Pose, Vector, to_world
from radwrap.scene.mesh import Mesh
from radwrap.scene.patterns.layouts import Layout
from radwrap.scene.patterns.marks import FlatDisc
from radwrap.scene.patterns.partition import Partition


@dataclass(frozen=True, slots=True)
class Sheet:
    """A flat rectangle; width along x, height along y [m]."""

    name: str
    pose: Pose
    material: str
    width: float
    height: float


@dataclass(frozen=True, slots=True)
class DotBoard:
    """A calibration board: a grid of discs on a rectangle.

    Attributes
    ----------
    rows, columns : int
        Number of dots along -y and x.
    pitch : float
        Distance of neighbouring centres [m].
    dot_diameter : float
        Diameter of each dot [m].
    margin : float
        From the outermost dots' rims to the board's edge [m].
    material, dot_material : str
        Names of the two materials.
    """

    name: str
    pose: Pose
    material: str
    dot_material: str
    rows: int
    columns: int
    pitch: float
    dot_diameter: float
    margin: float

    @property
    def width(self) -> float:
        """Size along x [m]."""
        return (self.columns - 1) * self.pitch + self.dot_diameter + 2 * self.margin

    @property
    def height(self) -> float:
        """Size along y [m]."""
        return (self.rows - 1) * self.pitch + self.dot_diameter + 2 * self.margin

    def dot_centres(self) -> tuple[tuple[int, int, Vector], ...]:
        """(row, column, centre on the board [m]); row 0 is at the top (+y), column 0 on the left (-x)."""
        return tuple(
            (row, column, self._centre(row, column)) for row in range(self.rows) for column in range(self.columns)
        )

    def _centre(self, row: int, column: int) -> Vector:
        x = (column - (self.columns - 1) / 2) * self.pitch
        y = ((self.rows - 1) / 2 - row) * self.pitch
        return x, y, 0.0


@dataclass(frozen=True, slots=True)
class EdgeTarget:
    """A straight edge between two materials.

    Attributes
    ----------
    material : str
        On the side x < edge_position.
    edge_material : str
        On the side x > edge_position.
    edge_position : float
        Where the edge crosses the target's x axis [m]; it runs along y.
    """

    name: str
    pose: Pose
    material: str
    edge_material: str
    width: float
    height: float
    edge_position: float


@dataclass(frozen=True, slots=True)
class PatternTarget:
    """A plate with a pattern of another material.

    Attributes
    ----------
    material, pattern_material : str
        Names of the plate's material and that of its marks.
    layout : Layout
        What is where.
    partition : Partition
        Which of the two lies at a place.
    """

    name: str
    pose: Pose
    material: str
    pattern_material: str
    layout: Layout
    partition: Partition = field(compare=False, repr=False)

    @property
    def width(self) -> float:
        """Size along x [m]."""
        return self.layout.size[0]

    @property
    def height(self) -> float:
        """Size along y [m]."""
        return self.layout.size[1]


@dataclass(frozen=True, slots=True)
class Polygon:
    """A flat polygon; vertices (x, y) in its plane [m], without crossing sides."""

    name: str
    pose: Pose
    material: str
    vertices: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class Disc:
    """A flat disc."""

    name: str
    pose: Pose
    material: str
    diameter: float


@dataclass(frozen=True, slots=True)
class Sphere:
    """A sphere about its origin."""

    name: str
    pose: Pose
    material: str
    diameter: float


@dataclass(frozen=True, slots=True)
class Cylinder:
    """A closed cylinder about its z axis, centred on its origin."""

    name: str
    pose: Pose
    material: str
    diameter: float
    length: float


@dataclass(frozen=True, slots=True)
class Box:
    """A box centred on its origin; size along x, y, z [m]."""

    name: str
    pose: Pose
    material: str
    size: Vector


@dataclass(frozen=True, slots=True)
class RadFile:
    """A Radiance scene file, included under the trust rule.

    Attributes
    ----------
    file : str
        Name of the file, against the scene's folder.
    length_unit : float
        Length of the file's unit [m].
    """

    name: str
    pose: Pose
    file: str
    length_unit: float


@dataclass(frozen=True, slots=True)
class MeshPart:
    """A triangle mesh from a file.

    Attributes
    ----------
    file : str
        Name of the file, against the scene's folder.
    sha256 : str
        Of the file and its unit of length.
    mesh : Mesh
        The triangles in the part's own frame, which is that of the file [m].
    closed : bool
        Whether each side belongs to two triangles, so that there is an inside.
    leaning : float
        Angle by which normals of corners lean against the triangles in the file [rad]; they are not used.
    """

    name: str
    pose: Pose
    material: str
    file: str
    sha256: str
    mesh: Mesh = field(compare=False, repr=False)
    closed: bool = True
    leaning: float = field(default=0.0, compare=False, repr=False)


Flat = Sheet | DotBoard | EdgeTarget | PatternTarget | Polygon | Disc
Solid = Sphere | Cylinder | Box
Target = Flat | Solid | MeshPart | RadFile


@dataclass(frozen=True, slots=True)
class PolygonShape:
    """Vertices in the world [m], counter-clockwise seen from the front."""

    vertices: tuple[Vector, ...]


@dataclass(frozen=True, slots=True)
class DiscShape:
    """Centre [m], unit normal, radius [m] in the world."""

    centre: Vector
    normal: Vector
    radius: float


@dataclass(frozen=True, slots=True)
class SphereShape:
    """Centre and radius in the world [m]."""

    centre: Vector
    radius: float


@dataclass(frozen=True, slots=True)
class TubeShape:
    """Side of a cylinder: ends of its axis and radius in the world [m]."""

    start: Vector
    end: Vector
    radius: float


@dataclass(frozen=True, slots=True, eq=False)
class MeshShape:
    """Triangles in the world: vertices, shape (n, 3) [m], and faces, shape (m, 3)."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.intp]


Shape = PolygonShape | DiscShape | SphereShape | TubeShape | MeshShape


@dataclass(frozen=True, slots=True)
class Surface:
    """One piece of a target with one material.

    Attributes
    ----------
    name : str
        Unique in the scene.
    part : str
        What it is of the target: "surface", "dots", "edge" or "pattern".
    material : str
        Name of the material.
    shape : Shape
        Geometry in the world.
    """

    name: str
    part: str
    material: str
    shape: Shape

    @property
    def is_decal(self) -> bool:
        """Whether it is painted on its target's flat surface, whose plane it shares."""
        return self.part != "surface"


def surfaces(target: Target) -> tuple[Surface, ...]:
    """Geometry of a target in the world.

    Decals come after the surface that they are painted on. A Radiance file has
    no surface that is known here.
    """
    match target:
        case RadFile():
            return ()
        case DotBoard():
            dots = (
                Surface(
                    f"{target.name}.dot_{row}_{column}",
                    "dots",
                    target.dot_material,
                    _disc(target.pose, centre, target.dot_diameter),
                )
                for row, column, centre in target.dot_centres()
            )
            return _plain(target, _rectangle(target.pose, target.width, target.height)), *dots
        case EdgeTarget():
            half = target.width / 2
            bright = (
                (target.edge_position, -target.height / 2),
                (half, -target.height / 2),
                (half, target.height / 2),
                (target.edge_position, target.height / 2),
            )
            return (
                _plain(target, _rectangle(target.pose, target.width, target.height)),
                Surface(f"{target.name}.edge", "edge", target.edge_material, _flat(target.pose, bright)),
            )
        case PatternTarget():
            marks = (
                Surface(
                    f"{target.name}.mark_{number}",
                    "pattern",
                    target.pattern_material,
                    _disc(target.pose, (mark.x, mark.y, 0.0), 2 * mark.radius)
                    if isinstance(mark, FlatDisc)
                    else _flat(target.pose, mark.vertices),
                )
                for number, mark in enumerate(target.layout.marks())
            )
            return _plain(target, _rectangle(target.pose, target.width, target.height)), *marks
        case Sheet():
            return (_plain(target, _rectangle(target.pose, target.width, target.height)),)
        case Polygon():
            return (_plain(target, _flat(target.pose, _counter_clockwise(target.vertices))),)
        case Disc():
            return (_plain(target, _disc(target.pose, (0.0, 0.0, 0.0), target.diameter)),)
        case Sphere():
            return (_plain(target, SphereShape(target.pose.position, target.diameter / 2)),)
        case Cylinder():
            return _cylinder(target)
        case Box():
            return _box(target)
        case MeshPart():
            vertices = target.mesh.vertices @ np.asarray(target.pose.rotation).T + target.pose.position
            shape = MeshShape(vertices, target.mesh.faces)
            return (Surface(target.name, "surface", target.material, shape),)


def _plain(target: Flat | Sphere, shape: Shape) -> Surface:
    return Surface(target.name, "surface", target.material, shape)


def _flat(pose: Pose, corners: tuple[tuple[float, float], ...]) -> PolygonShape:
    return PolygonShape(tuple(to_world(pose, (x, y, 0.0)) for x, y in corners))


def _rectangle(pose: Pose, width: float, height: float) -> PolygonShape:
    x, y = width / 2, height / 2
    return _flat(pose, ((-x, -y), (x, -y), (x, y), (-x, y)))


def _disc(pose: Pose, centre: Vector, diameter: float) -> DiscShape:
    return DiscShape(to_world(pose, centre), pose.z_axis, diameter / 2)


def signed_area(vertices: tuple[tuple[float, float], ...]) -> float:
    """Area of a flat polygon [m^2], positive where it runs counter-clockwise."""
    following = vertices[1:] + vertices[:1]
    return math.fsum(x0 * y1 - x1 * y0 for (x0, y0), (x1, y1) in zip(vertices, following, strict=True)) / 2


def _counter_clockwise(vertices: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    return vertices if signed_area(vertices) > 0 else vertices[::-1]


def _cylinder(target: Cylinder) -> tuple[Surface, ...]:
    half = target.length / 2
    top, bottom = to_world(target.pose, (0.0, 0.0, half)), to_world(target.pose, (0.0, 0.0, -half))
    z = target.pose.z_axis
    down = (-z[0], -z[1], -z[2])
    radius = target.diameter / 2
    shapes: dict[str, Shape] = {
        "side": TubeShape(bottom, top, radius),
        "top": DiscShape(top, z, radius),
        "bottom": DiscShape(bottom, down, radius),
    }
    return tuple(Surface(f"{target.name}.{part}", "surface", target.material, shape) for part, shape in shapes.items())


def _box(target: Box) -> tuple[Surface, ...]:
    half = tuple(side / 2 for side in target.size)
    faces = []
    for axis, name in enumerate("xyz"):
        after, last = (axis + 1) % 3, (axis + 2) % 3
        for sign, end in ((1, "plus"), (-1, "minus")):
            corners = []
            for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))[::sign]:
                corner = [0.0, 0.0, 0.0]
                corner[axis], corner[after], corner[last] = sign * half[axis], a * half[after], b * half[last]
                corners.append(to_world(target.pose, (corner[0], corner[1], corner[2])))
            faces.append(
                Surface(f"{target.name}.{name}_{end}", "surface", target.material, PolygonShape(tuple(corners)))
            )
    return tuple(faces)
