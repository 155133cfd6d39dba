"""Materials of targets as rows of numbers, with their tables."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import assert_never

import numpy as np
from numpy.typing import NDArray

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
from radwrap.scene.targets import DotBoard, EdgeTarget, PatternTarget, Sheet, Target, surfaces
from radwrap.tracers.compiled.arrays import (
    BEADS,
    BRDF,
    BRUSHED,
    COEFFICIENTS,
    DOTS,
    EDGE,
    NOTHING,
    PATTERN,
    TURNED_NORMAL,
    WARD,
    Cover,
    Decal,
    put,
    rows,
)
from radwrap.tracers.compiled.shape_rows import Piece
from radwrap.tracers.text_frame import TextFrame


@dataclass(slots=True)
class Wardrobe:
    """Covers as they are collected, target by target.

    Attributes
    ----------
    materials : Mapping[str, Material]
        Name -> material.
    frame : TextFrame
        Origin and unit of the places.
    tables : list of float
        To which their tables are added.
    parts : list of str
        Name of the part of each cover, such as "board.dots".
    """

    materials: Mapping[str, Material]
    frame: TextFrame
    tables: list[float]
    parts: list[str] = field(default_factory=list)
    _covers: list[NDArray[np.void]] = field(default_factory=list)
    _decals: list[NDArray[np.void]] = field(default_factory=list)
    _places: dict[tuple[str, str], int] = field(default_factory=dict)

    def pieces(self, target: Target) -> list[Piece]:
        """The shapes of a target, dressed."""
        found = surfaces(target)
        materials = {surface.part: surface.material for surface in found}
        covers = {part: self._cover(target, part, name) for part, name in materials.items()}
        decal = -1
        if isinstance(target, DotBoard | EdgeTarget | PatternTarget):
            decal = len(self._decals)
            painted = next(cover for part, cover in covers.items() if part != "surface")
            first = len(self.tables)
            if isinstance(target, PatternTarget):
                self.tables += target.partition.nodes.ravel().tolist()
            self._decals.append(_decal(target, painted, first, self.frame))
        return [Piece(surface.shape, covers["surface"], decal) for surface in found if not surface.is_decal]

    @property
    def covers(self) -> NDArray[np.void]:
        """`rows` of `arrays.Cover`."""
        return np.concatenate([rows(Cover, 0), *self._covers])

    @property
    def decals(self) -> NDArray[np.void]:
        """`rows` of `arrays.Decal`."""
        return np.concatenate([rows(Decal, 0), *self._decals])

    def _cover(self, target: Target, part: str, name: str) -> int:
        material = self.materials[name]
        base = material.sheeting if isinstance(material, PrintedSheeting) else material
        cover = rows(Cover, 1)
        kind, diffuse, weight, own = _kind(base)
        if isinstance(material, PrintedSheeting):
            diffuse, weight = material.coverage * material.reflectance, weight * (1 - material.coverage)
        cover["kind"], cover["two_sided"] = kind, isinstance(material, TwoSided)
        put(cover, "diffuse weight a b c", [diffuse / math.pi, weight, *own])
        cover["fine"] = _fine(base)
        cover["table"] = self._table(name, "table", lambda: _table(base))
        if isinstance(material, Anisotropic):
            put(cover, "gx gy gz", target.pose.x_axis)
        if isinstance(material, PrintedImage):
            cover["image"] = self._table(name, "image", lambda: [value for row in material.rows for value in row])
            _print(cover, material, target, self.frame)
        self._covers.append(cover)
        self.parts.append(f"{target.name}.{part}")
        return len(self._covers) - 1

    def _table(self, name: str, kind: str, values: Callable[[], list[float]]) -> int:
        """Where a material's values begin: once for all targets that wear it."""
        if (name, kind) not in self._places:
            self._places[name, kind] = len(self.tables)
            self.tables += values()
        return self._places[name, kind]


def _kind(material: Material) -> tuple[int, float, float, tuple[float, float, float]]:
    """What a material reflects besides its diffuse part, its diffuse reflectance, factor on the rest, its numbers."""
    match material:
        case Lambertian(reflectance):
            return NOTHING, reflectance, 0.0, (0.0, 0.0, 0.0)
        case PrintedImage():
            return NOTHING, 1.0, 0.0, (0.0, 0.0, 0.0)
        case Specular(diffuse, specular, roughness):
            return WARD, diffuse, specular, (roughness**2, 0.0, 0.0)
        case Anisotropic(diffuse, specular, along, across):
            return BRUSHED, diffuse, specular, (along**2, across**2, 0.0)
        case PerturbedNormal(reflectance, roughness):
            return TURNED_NORMAL, 0.0, reflectance, (roughness**2, 0.0, 0.0)
        case CoefficientTable(observation, entrance):
            return COEFFICIENTS, 0.0, 1.0, (len(observation), len(entrance), float(material.interpolation == "log"))
        case GlassBeads(anchor):
            scale = GLASS_BEAD_ENTRANCE_SCALE * math.radians(1) ** 2
            return BEADS, 0.0, 1.0, (len(GLASS_BEAD_OBSERVATION), anchor, scale)
        case MeasuredBrdf(_, incidence, viewing, azimuth):
            return BRDF, 0.0, 1.0, (len(incidence), len(viewing), len(azimuth))
        case Mirror() | Glass() | PrintedSheeting():
            raise TypeError("not a cover of one kind")
        case _:
            assert_never(material)


def _fine(material: Material) -> float:
    """See `Cover`."""
    match material:
        case Specular(_, _, roughness) | PerturbedNormal(_, roughness):
            return roughness
        case Anisotropic(_, _, along, across):
            return min(along, across)
        case CoefficientTable(observation):
            return _least_step(observation)
        case GlassBeads():
            return math.radians(_least_step(GLASS_BEAD_OBSERVATION))
        case MeasuredBrdf(_, incidence, viewing, azimuth):
            return min(map(_least_step, (incidence, viewing, azimuth)))
        case _:
            return math.pi / 2


def _least_step(nodes: Sequence[float]) -> float:
    """Least distance of a table's nodes; of one node a quarter of a turn."""
    return min((b - a for a, b in pairwise(nodes)), default=math.pi / 2)


def _table(material: Material) -> list[float]:
    """Nodes [rad] and values of a material that has a table."""
    match material:
        case CoefficientTable():
            values = [value for row in material.coefficient for value in row]
            if material.interpolation == "log":
                values = list(map(math.log, values))
            return [*material.observation, *material.entrance, *values]
        case GlassBeads():
            return [*map(math.radians, GLASS_BEAD_OBSERVATION), *map(math.log, GLASS_BEAD_PROFILE)]
        case MeasuredBrdf():
            return [*material.incidence, *material.viewing, *material.azimuth, *material.values]
        case _:
            return []


def _print(cover: NDArray[np.void], material: PrintedImage, target: Target, frame: TextFrame) -> None:
    if not isinstance(target, Sheet):
        raise TypeError("a print lies on a sheet")
    cover["columns"], cover["rows"] = len(material.rows[0]), len(material.rows)
    put(cover, "x y z", frame.point(target.pose.position))
    put(cover, "ux uy uz", np.array(target.pose.x_axis) / (target.width * frame.units))
    put(cover, "vx vy vz", np.array(target.pose.y_axis) / (target.height * frame.units))


def _decal(
    target: DotBoard | EdgeTarget | PatternTarget, painted: int, first: int, frame: TextFrame
) -> NDArray[np.void]:
    """What is painted on a target with that cover; a pattern's nodes begin at `first` in the tables."""
    decal = rows(Decal, 1)
    x, y = np.array(target.pose.x_axis), np.array(target.pose.y_axis)
    decal["cover"] = painted
    put(decal, "x y z", frame.point(target.pose.position))
    if isinstance(target, EdgeTarget):
        decal["kind"], decal["a"] = EDGE, target.edge_position * frame.units
    elif isinstance(target, PatternTarget):
        x, y = x / frame.units, y / frame.units
        decal["kind"], decal["a"] = PATTERN, first
    else:
        pitch = target.pitch * frame.units
        x, y = x / pitch, y / pitch
        decal["kind"] = DOTS
        put(decal, "a b c", [target.columns, target.rows, (target.dot_diameter / 2 / target.pitch) ** 2])
    put(decal, "ux uy uz", x)
    put(decal, "vx vy vz", y)
    return decal
