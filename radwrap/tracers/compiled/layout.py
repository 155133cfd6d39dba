"""A scene as arrays: shapes with their trees, covers, lights."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.frames import Pose
from radwrap.scene.look.superposed import superposed
from radwrap.scene.look.wide_sources import may_shine_whole
from radwrap.scene.scene import Scene
from radwrap.scene.sources import Beam, Emitter, Luminaire, Patch, TableBeam, WideSource, emitters
from radwrap.scene.wide_shapes import WideShape
from radwrap.tracers.compiled import arrays
from radwrap.tracers.compiled.arrays import Cluster, Floats, Light, Tree, Whole, Wide, put, rows
from radwrap.tracers.compiled.before import nothing_before, own_shapes
from radwrap.tracers.compiled.cover_rows import Wardrobe
from radwrap.tracers.compiled.shadows import TOGETHER
from radwrap.tracers.compiled.shape_rows import Piece, area_vector, emitter_shape, sorted_shapes
from radwrap.tracers.compiled.shine import side_by_side
from radwrap.tracers.compiled.wide_rows import cell_rows, light_row, shape_row, shines_whole, wide_row
from radwrap.tracers.text_frame import TextFrame

_MOST_TOGETHER: Final = 64  # lights of a cluster: LEDs of a ring follow each other around it
_PLACE: Final = 8.0  # pixels
_APART: Final = -1  # in place of a kind of beam


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
        `rows` of `Wide`: lights that shine as a whole; they are the last of the lights, and in no cluster.
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
    whole : tuple of str
        Names of the sources that shine as a whole.
    frame : TextFrame
        Origin and unit of the places.
    halvings : int, optional
        How often the number of points is halved that rays ask of wide lights whether they are hidden.
    alike : bool, optional
        Whether all rays ask the same points, so that neighbours differ by what they see, and not by noise.
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
    whole: tuple[str, ...]
    frame: TextFrame
    halvings: int = 0
    alike: bool = False

    def in_light(self, names: Collection[str]) -> CompiledScene:
        """The scene in the light of some sources or LEDs; the others are black, and hide all the same."""
        lights = self.lights.copy()
        lights["radiance"] = [math.fsum(level for name, level in group if name in names) for group in self.members]
        wides = self.wides.copy()
        wides["radiance"] = lights["radiance"][wides["light"]]
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
    tables: list[float] = []
    wardrobe = Wardrobe(scene.materials, frame, tables)
    wholes = _in_places(filter(shines_whole, scene.sources)) if whole and may_shine_whole(scene) else []
    names_of_wholes = tuple(source.name for group in wholes for source in group)
    groups = superposed(emitter for emitter in scene.emitters if emitter.source not in names_of_wholes)
    members: list[list[tuple[str, float]]] = [[(each.source, each.radiance) for each in group] for group in groups]
    members += [[(source.name, source.radiance) for source in group] for group in wholes]
    shown = [group[0] for group in groups]
    wides = np.concatenate([rows(Wide, 0), *(wide_row(group[0], frame) for group in wholes)])
    places: dict[str, int] = {}  # of measured beams
    for wide, group in zip(wides, wholes, strict=True):
        if isinstance(beam := group[0].beam, TableBeam):
            wide["table"], wide["columns"] = _placed(beam.sha256, (beam.values,), places, tables), len(beam.values)
    pieces = (Piece(emitter_shape(emitter), i) for i, emitter in enumerate(shown))
    others = [shape_row(wides[i : i + 1], len(shown) + i) for i in range(len(wides))]
    discs = sorted_shapes(pieces, frame, tables, others)
    targets = sorted_shapes((piece for part in scene.targets for piece in wardrobe.pieces(part)), frame, tables)
    lights = np.concatenate(
        [_lights(shown, frame, places, tables), *(light_row(wides[i : i + 1]) for i in range(len(wides)))]
    )
    lights["radiance"] = [math.fsum(level for _, level in group) for group in members]
    lights["own"] = own_shapes(shown, wides, lights, discs, frame)
    _place_wides(wides, len(shown), lights, targets, discs)
    names = tuple(source.name for source in scene.sources)
    number = {emitter.name: index for index, source in enumerate(scene.sources, 1) for emitter in emitters(source)}
    number |= {name: names.index(name) + 1 for name in names_of_wholes}
    shining = [*(emitter.name for emitter in shown), *(group[0].name for group in wholes)]
    skies = tuple((sky.name, sky.patches[0].radiance) for sky in scene.surrounds)
    return CompiledScene(
        targets,
        discs,
        wardrobe.covers,
        wardrobe.decals,
        lights,
        side_by_side(lights),
        *clusters_of(lights, np.arange(len(lights)) >= len(shown)),
        wides,
        cell_rows([group[0] for group in wholes], frame),
        _pitch(scene, targets, frame),
        math.fsum(level for _, level in skies),
        np.array(tables, dtype=np.float64),
        (*names, *wardrobe.parts),
        np.arange(len(names) + 1, len(names) + len(wardrobe.parts) + 1),
        np.array([number[name] for name in shining], dtype=np.int64),
        tuple(map(tuple, members)),
        skies,
        names_of_wholes,
        frame,
    )


def _in_places(lights: Iterable[WideSource]) -> list[list[WideSource]]:
    """Lights in groups that fill the same place with the same beam."""
    groups: dict[tuple[Pose, WideShape, Beam], list[WideSource]] = {}
    for light in lights:
        groups.setdefault((light.pose, light.shape, light.beam), []).append(light)
    return list(groups.values())


def _place_wides(wides: NDArray[np.void], first: int, lights: NDArray[np.void], targets: Tree, discs: Tree) -> None:
    """Fill in which lights and shapes are those of wide lights, and what may hide them."""
    wides["light"] = first + np.arange(len(wides))
    wides["radiance"] = lights["radiance"][wides["light"]]
    shape_of = np.argsort(discs.shapes["owner"])
    wides["own"] = shape_of[wides["light"]]
    for wide in wides:
        wide["may_be_hidden"] = not nothing_before(wide, targets, discs)


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


def _lights(
    shown: Sequence[Emitter], frame: TextFrame, places: dict[str, int], tables: list[float]
) -> NDArray[np.void]:
    """Rows of `Light` without their radiance; values of measured beams are added to the tables."""
    found = [rows(Light, 0)]
    for emitter in shown:
        light = rows(Light, 1)
        light["beam"], light["spread"] = arrays.BEAMS[emitter.beam.profile], emitter.beam.spread
        centre, axis, area = _shining(emitter, frame)
        put(light, "x y z nx ny nz area", np.concatenate([centre, axis, [area]]))
        if isinstance(emitter, Luminaire):
            light["beam"] = arrays.LUMINAIRE
            put(light, "ux uy uz vx vy vz", np.concatenate([emitter.x_axis, emitter.y_axis]))
        if (measured := _table(emitter)) is not None:
            sha256, table = measured
            put(light, "table rows columns", [_placed(sha256, table, places, tables), len(table), len(table[0])])
        found.append(light)
    return np.concatenate(found)


def _placed(sha256: str, table: Sequence[Sequence[float]], places: dict[str, int], tables: list[float]) -> int:
    """Where a measured beam begins: once for all that have it."""
    if sha256 not in places:
        places[sha256] = len(tables)
        tables += [value for row in table for value in row]
    return places[sha256]


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
