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
from radwrap.scene.sources import Emitter, Luminaire, Patch, TableBeam, WideSource, emitters
from radwrap.tracers.compiled import arrays
from radwrap.tracers.compiled.arrays import Cluster, Floats, Light, Tree, Whole, Wide, put, rows
from radwrap.tracers.compiled.before import nothing_before, own_shapes
from radwrap.tracers.compiled.cover_rows import Wardrobe
from radwrap.tracers.compiled.shadows import TOGETHER
from radwrap.tracers.compiled.shape_rows import Piece, area_vector, emitter_shape, sorted_shapes
from radwrap.tracers.compiled.shine import side_by_side
from radwrap.tracers.compiled.wide_rows import cell_rows, shines_whole, wide_row
from radwrap.tracers.compiled.wide_shine import WHOLE_COVERS
from radwrap.tracers.text_frame import TextFrame

_MOST_TOGETHER: Final = 64  # lights of a cluster: LEDs of a ring follow each other around it
_PLACE: Final = 8.0  # pixels
_APART: Final = -1  # in place of a kind of beam
_FIRST_GROUP: Final = -2  # of shapes, see `arrays.Shape`
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
    wides : ndarray
        `rows` of `Wide`: lights that shine as a whole; their patches are in no cluster.
    cells : ndarray
        `rows` of `Cluster`: the boxes of their cells.
    pitch : float
        Size of a place, all of whose points ask for the same cells.
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
    whole : tuple of (str, float)
        Of each wide light its name and its radiance.
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
    wides: NDArray[np.void]
    cells: NDArray[np.void]
    pitch: float
    background: float
    tables: Floats
    parts: tuple[str, ...]
    part_of_cover: Whole
    part_of_light: Whole
    members: tuple[tuple[tuple[str, float], ...], ...]
    skies: tuple[tuple[str, float], ...]
    whole: tuple[tuple[str, float], ...]
    frame: TextFrame

    def in_light(self, names: Collection[str]) -> CompiledScene:
        """The scene in the light of some sources or LEDs; the others are black, and hide all the same."""
        lights = self.lights.copy()
        lights["radiance"] = [math.fsum(level for name, level in group if name in names) for group in self.members]
        wides = self.wides.copy()
        wides["radiance"] = [level if name in names else 0.0 for name, level in self.whole]
        background = math.fsum(level for name, level in self.skies if name in names)
        return replace(self, lights=lights, beside=side_by_side(lights), wides=wides, background=background)


def compiled_scene(scene: Scene, frame: TextFrame, *, whole: bool = False) -> CompiledScene:
    """Write a scene as arrays, in the frame of its Radiance text; it must be expressible.

    Parameters
    ----------
    scene : Scene
        What to write.
    frame : TextFrame
        Origin and unit of the places.
    whole : bool
        Whether wide lights shine as a whole where that is known; else from the middles of their patches, as Radiance's.
    """
    groups = superposed(scene.emitters)
    shown = [group[0] for group in groups]
    tables: list[float] = []
    discs = sorted_shapes((Piece(emitter_shape(emitter), i) for i, emitter in enumerate(shown)), frame, tables)
    wardrobe = Wardrobe(scene.materials, frame, tables)
    targets = sorted_shapes((piece for part in scene.targets for piece in wardrobe.pieces(part)), frame, tables)
    lights = _lights(shown, frame, tables)
    lights["radiance"] = [math.fsum(member.radiance for member in group) for group in groups]
    lights["own"] = own_shapes(shown, lights, discs, frame)
    wide_lights = list(filter(shines_whole, scene.sources)) if whole and _are_sampled(wardrobe) else []
    wides = _wides(wide_lights, groups, targets, discs, frame)
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
        *clusters_of(lights, _in_groups(len(lights), discs)),
        wides,
        cell_rows(wide_lights, frame),
        _pitch(scene, targets, frame),
        math.fsum(level for _, level in skies),
        np.array(tables, dtype=np.float64),
        (*names, *wardrobe.parts),
        np.arange(len(names) + 1, len(names) + len(wardrobe.parts) + 1),
        np.array([number[emitter.name] for emitter in shown], dtype=np.int64),
        tuple(tuple((member.source, member.radiance) for member in group) for group in groups),
        skies,
        tuple((light.name, light.radiance) for light in wide_lights),
        frame,
    )


def _are_sampled(wardrobe: Wardrobe) -> bool:
    return bool(np.isin(wardrobe.covers["kind"], WHOLE_COVERS).all())


def _wides(
    lights: Sequence[WideSource],
    groups: Sequence[Sequence[Emitter]],
    targets: Tree,
    discs: Tree,
    frame: TextFrame,
) -> NDArray[np.void]:
    """Rows of wide lights, whose patches become their own groups of shapes; lights in one place have the same."""
    wides = np.concatenate([rows(Wide, 0), *(wide_row(light, frame) for light in lights)])
    names = [[member.source for member in group] for group in groups]
    for number, light in enumerate(lights):
        own = np.array([light.name in group for group in names])
        first = int(np.flatnonzero(own)[0])
        wides[number]["first"], wides[number]["group"] = first, _FIRST_GROUP - first
        discs.shapes["group"][own[discs.shapes["owner"]]] = _FIRST_GROUP - first
    for wide in wides:
        wide["may_be_hidden"] = not nothing_before(wide, targets, discs)
    return wides


def _pitch(scene: Scene, targets: Tree, frame: TextFrame) -> float:
    """Size of a place: that of some pixels of the camera in the middle of the targets."""
    camera = scene.camera
    if not len(targets.nodes):
        return 1.0
    box = targets.nodes[0]
    middle = np.array([box["x0"] + box["x1"], box["y0"] + box["y1"], box["z0"] + box["z1"]]) / 2
    away = float(np.linalg.norm(middle - frame.point(camera.pose.position)))
    pixel = min(camera.sensor.pixel_width, camera.sensor.pixel_height) / camera.image_distance
    return _PLACE * pixel * away


def _in_groups(count: int, discs: Tree) -> NDArray[np.bool_]:
    """Whether each light is a patch of one that shines as a whole."""
    found = np.zeros(count, dtype=bool)
    found[discs.shapes["owner"]] = discs.shapes["group"] <= _FIRST_GROUP
    return found


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


def clusters_of(
    lights: NDArray[np.void], apart: NDArray[np.bool_] | None = None
) -> tuple[NDArray[np.void], NDArray[np.void]]:
    """Groups of lights, and their parts, of `TOGETHER` lights each.

    Lights of a group follow each other and have one kind of beam; those that are to be `apart` are in none.
    """
    kinds = lights["beam"] if apart is None else np.where(apart, _APART, lights["beam"])
    changes = np.flatnonzero(np.diff(kinds)) + 1
    spans = [(a, b) for a, b in pairwise([0, *changes.tolist(), len(lights)]) if a < b and kinds[a] != _APART]
    clusters = [(a, min(a + _MOST_TOGETHER, end)) for first, end in spans for a in range(first, end, _MOST_TOGETHER)]
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
