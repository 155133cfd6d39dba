"""A scene as arrays: shapes with their trees, covers, lights."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.scene.look.superposed import superposed
from radwrap.scene.scene import Scene
from radwrap.scene.sources import Emitter, Luminaire, Patch, TableBeam, emitters
from radwrap.tracers.compiled import arrays
from radwrap.tracers.compiled.arrays import Cluster, Floats, Light, Tree, Whole, put, rows
from radwrap.tracers.compiled.before import own_shapes
from radwrap.tracers.compiled.cover_rows import Wardrobe
from radwrap.tracers.compiled.shadows import TOGETHER
from radwrap.tracers.compiled.shape_rows import Piece, area_vector, emitter_shape, sorted_shapes
from radwrap.tracers.compiled.shine import side_by_side
from radwrap.tracers.text_frame import TextFrame

_MOST_TOGETHER: Final = 64  # lights of a cluster: LEDs of a ring follow each other around it
_BEAMS: Final = {
    "lambertian": arrays.LAMBERTIAN,
    "gaussian": arrays.GAUSSIAN,
    "cosine_power": arrays.COSINE_POWER,
    "cone": arrays.CONE,
    "table": arrays.TABLE_BEAM,
}


@dataclass(frozen=True, slots=True, eq=False)
class CompiledScene:
    """All that the compiled functions need of a scene.

    Attributes
    ----------
    targets, emitters : Tree
        What hides; emitters apart, most of which hide nothing.
    covers, decals, lights : ndarray
        What targets wear, what is painted on them, and what emitters send; `rows` of the classes in `arrays`.
    beside : ndarray
        The lights' numbers `side_by_side`.
    clusters, parts_of_clusters : ndarray
        `rows` of `Cluster`: the lights, some that follow each other in each, and the same in smaller groups.
    background : float
        Radiance of what is seen where nothing is [W m^-2 sr^-1].
    tables : ndarray
        All tables.
    parts : tuple of str
        Names of what has a number in truth images, such as "board.dots"; the first has the number 1.
    part_of_cover, part_of_light : ndarray of int
        Their numbers.
    members : tuple of tuple of (str, float)
        Of each emitter: names by which its light is switched, and radiance of each.
    skies : tuple of (str, float)
        Names of surrounds and their radiance.
    frame : TextFrame
        Origin and unit of the places.
    """

    targets: Tree
    emitters: Tree
    covers: NDArray[np.void]
    decals: NDArray[np.void]
    lights: NDArray[np.void]
    beside: Floats
    clusters: NDArray[np.void]
    parts_of_clusters: NDArray[np.void]
    background: float
    tables: Floats
    parts: tuple[str, ...]
    part_of_cover: Whole
    part_of_light: Whole
    members: tuple[tuple[tuple[str, float], ...], ...]
    skies: tuple[tuple[str, float], ...]
    frame: TextFrame

    def in_light(self, names: Collection[str]) -> CompiledScene:
        """The scene in the light of some sources or LEDs; the others are black, and hide all the same."""
        lights = self.lights.copy()
        lights["radiance"] = [math.fsum(level for name, level in group if name in names) for group in self.members]
        background = math.fsum(level for name, level in self.skies if name in names)
        return replace(self, lights=lights, beside=side_by_side(lights), background=background)


def compiled_scene(scene: Scene, frame: TextFrame) -> CompiledScene:
    """Write a scene as arrays, in the frame of its Radiance text; it must be expressible."""
    groups = superposed(scene.emitters)
    shown = [group[0] for group in groups]
    tables: list[float] = []
    discs = sorted_shapes((Piece(emitter_shape(emitter), i) for i, emitter in enumerate(shown)), frame, tables)
    wardrobe = Wardrobe(scene.materials, frame, tables)
    targets = sorted_shapes((piece for part in scene.targets for piece in wardrobe.pieces(part)), frame, tables)
    lights = _lights(shown, frame, tables)
    lights["radiance"] = [math.fsum(member.radiance for member in group) for group in groups]
    lights["own"] = own_shapes(shown, lights, discs, frame)
    names = tuple(source.name for source in scene.sources)
    number = {emitter.name: index for index, source in enumerate(scene.sources, 1) for emitter in emitters(source)}
    skies = tuple((sky.name, sky.patches[0].radiance) for sky in scene.surrounds)
    return CompiledScene(
        targets,
        discs,
        wardrobe.covers,
        wardrobe.decals,
        lights,
        side_by_side(lights),
        *clusters_of(lights),
        math.fsum(level for _, level in skies),
        np.array(tables, dtype=np.float64),
        (*names, *wardrobe.parts),
        np.arange(len(names) + 1, len(names) + len(wardrobe.parts) + 1),
        np.array([number[emitter.name] for emitter in shown], dtype=np.int64),
        tuple(tuple((member.source, member.radiance) for member in group) for group in groups),
        skies,
        frame,
    )


def _lights(shown: Sequence[Emitter], frame: TextFrame, tables: list[float]) -> NDArray[np.void]:
    """Rows of `Light` without their radiance; values of measured beams are added to the tables."""
    found = [rows(Light, 0)]
    places: dict[str, int] = {}
    for emitter in shown:
        light = rows(Light, 1)
        light["beam"], light["spread"] = _BEAMS[emitter.beam.profile], emitter.beam.spread
        centre, axis, area = _shining(emitter, frame)
        put(light, "x y z nx ny nz area", np.concatenate([centre, axis, [area]]))
        if isinstance(emitter, Luminaire):
            light["beam"] = arrays.LUMINAIRE
            put(light, "ux uy uz vx vy vz", np.concatenate([emitter.x_axis, emitter.y_axis]))
        if (measured := _table(emitter)) is not None:
            sha256, table = measured
            if sha256 not in places:
                places[sha256] = len(tables)
                tables += [value for row in table for value in row]
            put(light, "table rows columns", [places[sha256], len(table), len(table[0])])
        found.append(light)
    return np.concatenate(found)


def clusters_of(lights: NDArray[np.void]) -> tuple[NDArray[np.void], NDArray[np.void]]:
    """Groups of lights that follow each other and have one kind of beam, and their parts, of `TOGETHER` lights each."""
    changes = np.flatnonzero(np.diff(lights["beam"])) + 1
    ends = [0, *changes.tolist(), len(lights)]
    clusters = [
        (a, min(a + _MOST_TOGETHER, end)) for first, end in pairwise(ends) for a in range(first, end, _MOST_TOGETHER)
    ]
    parts = [(a, min(a + TOGETHER, end)) for first, end in clusters for a in range(first, end, TOGETHER)]
    whole = _clusters(lights, clusters)
    whole["part"] = np.searchsorted([first for first, _ in parts], whole["first"])
    return whole, _clusters(lights, parts)


def _clusters(lights: NDArray[np.void], spans: Sequence[tuple[int, int]]) -> NDArray[np.void]:
    made = rows(Cluster, len(spans))
    for cluster, (first, end) in zip(made, spans, strict=True):
        some = lights[first:end]
        cluster["first"], cluster["end"], cluster["beam"] = first, end, some["beam"][0]
        cluster["may_be_hidden"] = (some["own"] >= 0).any()
        for axis in "xyz":
            cluster[f"{axis}0"], cluster[f"{axis}1"] = some[axis].min(), some[axis].max()
    return made


def _shining(emitter: Emitter, frame: TextFrame) -> tuple[Floats, Floats, float]:
    """From where, along which axis and with what area an emitter shines."""
    if isinstance(emitter, Patch):
        corners = np.array([frame.point(corner) for corner in emitter.corners])
        across = area_vector(corners)
        area = float(np.linalg.norm(across))
        return corners.mean(axis=0), across / area, area
    return (
        np.array(frame.point(emitter.position)),
        np.array(emitter.axis),
        math.pi * (emitter.radius * frame.units) ** 2,
    )


def _table(emitter: Emitter) -> tuple[str, Sequence[Sequence[float]]] | None:
    if isinstance(emitter, Luminaire):
        return emitter.table.sha256, emitter.table.rows
    if isinstance(emitter.beam, TableBeam):
        return emitter.beam.sha256, (emitter.beam.values,)
    return None
