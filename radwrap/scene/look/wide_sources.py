"""Wide sources cut into patches, each of which shines from its middle, until that is as good as was asked for.

A source that may shine as a whole first gets an outline of a few patches: to cut it takes seconds, and nobody may ask.

What each patch gives is held against quadrature over the true shape, at points
of the targets that the camera sees: irradiance of a diffuse surface, and what
another one sends to the camera. Patches that miss most are halved.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.frames import Pose, Vector
from radwrap.scene.look.geometry import SurfacePoints, in_view
from radwrap.scene.look.probes import feet, materials_of, merged, seen_points, surface_points
from radwrap.scene.look.reflection import radiance_factor
from radwrap.scene.materials import (
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
    Sheeting,
    Specular,
    TwoSided,
)
from radwrap.scene.scene import Scene
from radwrap.scene.sources import Patch, WideSource, emitters
from radwrap.scene.targets import (
    DiscShape,
    Flat,
    MeshShape,
    PolygonShape,
    SphereShape,
    Surface,
    TubeShape,
)
from radwrap.scene.wide_shapes import Cell, Zone, corners, first_cells, halves, nodes

Array = NDArray[np.float64]

MOST_PATCHES: Final = 4096
# Patches of an outline at most, but where a source's first cells are more.
_OUTLINE: Final = 64
# What is found at some points may be exceeded between them.
_MARGIN: Final = 0.5
_NODES: Final = 4  # along each side of a patch
_PROBES: Final = 144  # of each target and material
_ALL_PROBES: Final = 1000
_MOST_FEET: Final = 576  # of each target
# A point that gets less than this share of what the best lit one gets counts as if it got so much.
_FLOOR: Final = 0.02
# Patches are halved together down to this share of the worst one's error.
_TOGETHER: Final = 0.3
# Patches may be as wide as so many standard deviations of a lobe before quadrature is trusted to see it.
_LOBE_STEP: Final = 2.0
_LOBE_REACH: Final = 4.0
_GRAZING: Final = 1e-6
_GRAZING_LOBE: Final = 0.17  # cos 80 deg: beyond, a Gaussian lobe grows without bound and no patches will do
_ROOM: Final = 2.0  # of a surround about all that is there


def outlined(scene: Scene) -> Scene:
    """The scene with an outline for each wide source that may shine as a whole, and patches for all others.

    Raises
    ------
    InputError
        As `divided`.
    """
    if not any(isinstance(source, WideSource) for source in scene.sources):
        return scene
    sources = [
        _enclosing(scene, source, index) if isinstance(source, WideSource) else source
        for index, source in enumerate(scene.sources)
    ]
    whole = may_shine_whole(scene)
    outlines = (_outline(source) if isinstance(source, WideSource) and whole else source for source in sources)
    return divided(replace(scene, sources=tuple(outlines)), outlines_too=False)


def may_shine_whole(scene: Scene) -> bool:
    """Whether wide sources may shine as a whole: nothing mirrors them, or lets them through."""
    names = {name for target in scene.targets for name in materials_of(target)}
    return not any(isinstance(scene.materials[name], Mirror | Glass) for name in names)


def divided(scene: Scene, *, outlines_too: bool = True) -> Scene:
    """The scene with patches for its wide sources; the same scene where it needs none.

    Parameters
    ----------
    scene : Scene
        With `outlined` sources, or with none.
    outlines_too : bool
        Whether outlines become patches.

    Raises
    ------
    InputError
        If an error cannot be kept with `MOST_PATCHES` patches.
    """
    wanted = [
        isinstance(source, WideSource) and (not source.patches or (outlines_too and source.is_outline))
        for source in scene.sources
    ]
    if not any(wanted):
        return scene
    probes = _probes(scene)
    sources = tuple(
        _cut(source, scene, probes, f"{scene.origin}: sources[{index}]")
        if isinstance(source, WideSource) and wanted[index]
        else source
        for index, source in enumerate(scene.sources)
    )
    return replace(scene, sources=sources)


def _outline(source: WideSource) -> WideSource:
    """The source with a few patches."""
    cells = first_cells(source.shape)
    while 2 * len(cells) <= _OUTLINE:
        cells = [half for cell in cells for half in halves(source.shape, cell)]
    patches = tuple(_patch(source, cell, number) for number, cell in enumerate(sorted(cells)))
    return replace(source, patches=patches, is_outline=True)


def _enclosing(scene: Scene, source: WideSource, index: int) -> WideSource:
    """A surround about everything; other sources as they are."""
    if source.kind != "surround":
        return source
    where = f"{scene.origin}: sources[{index}]"
    if scene.included:
        raise InputError("does not know how large an included file is", where=where, remedy="use a dome")
    for surface in scene.surfaces:
        if isinstance(scene.materials[surface.material], Sheeting | PrintedSheeting):
            raise InputError(
                f'light from all sides falls on "{surface.material}", sheeting whose data cover '
                "small observation angles only",
                where=where,
                remedy="light it by sources of known place",
            )
    points = [np.array([scene.camera.pose.position])]
    points += [np.atleast_2d(emitter.position) for other in scene.sources for emitter in emitters(other)]
    points += [_extent(other) for other in scene.sources if isinstance(other, WideSource) and other is not source]
    points += [_corners(surface) for surface in scene.surfaces]
    together = np.vstack(points)
    low, high = together.min(axis=0), together.max(axis=0)
    x, y, z = ((low + high) / 2).tolist()
    pose = Pose((x, y, z), source.pose.rotation)
    return replace(source, pose=pose, shape=Zone(_ROOM * float(np.linalg.norm(high - low)) / 2, 0.0, math.pi))


def _extent(source: WideSource) -> Array:
    local = np.vstack([corners(source.shape, cell) for cell in first_cells(source.shape)])
    placed: Array = local @ np.asarray(source.pose.rotation).T + source.pose.position
    return placed


def _corners(surface: Surface) -> Array:
    match surface.shape:
        case PolygonShape(vertices):
            return np.array(vertices)
        case DiscShape(centre, _, radius) | SphereShape(centre, radius):
            return np.asarray(centre) + radius * np.vstack([np.eye(3), -np.eye(3)])
        case TubeShape(start, end, radius):
            around = radius * np.vstack([np.eye(3), -np.eye(3)])
            return np.vstack([np.asarray(start) + around, np.asarray(end) + around])
        case MeshShape(vertices, _):
            return vertices


@dataclass(frozen=True, slots=True, eq=False)
class _Probe:
    """Points of one material of one target: where light counts, and what becomes of it."""

    material: Material
    flat: bool
    grain: Vector | Array
    points: Array
    normals: Array
    to_eye: Array


def _probes(scene: Scene) -> list[_Probe]:
    """Points that the camera sees, or all where it sees none; the front is the side that it sees."""
    groups = merged(
        group
        for target in scene.targets
        for group in (*surface_points(target, scene.camera.pose.position), *seen_points(target, scene.camera))
    )
    return _watched(scene, groups, max(9, min(_PROBES, _ALL_PROBES // max(len(groups), 1))))


def _watched(scene: Scene, groups: Iterable[SurfacePoints], most: int, *, seen_only: bool = False) -> list[_Probe]:
    """At most so many probes of each group, where the camera sees some, those."""
    eye = np.asarray(scene.camera.pose.position)
    found: list[_Probe] = []
    for group in groups:
        seen = in_view(scene.camera, group.points)
        if not seen.any() and seen_only:
            continue
        points, normals = (of[seen] if seen.any() else of for of in (group.points, group.normals))
        step = math.ceil(len(points) / most)
        points, normals = points[::step], normals[::step]
        to_eye = eye - points
        to_eye = to_eye / np.linalg.norm(to_eye, axis=1, keepdims=True)
        found += _facing(scene, group, points, normals, to_eye)
    return found


def _facing(scene: Scene, group: SurfacePoints, points: Array, normals: Array, to_eye: Array) -> Iterator[_Probe]:
    material = scene.materials[group.material]
    towards = (to_eye * normals).sum(axis=1)
    flat = any(target.name == group.target and isinstance(target, Flat) for target in scene.targets)
    least = _GRAZING if isinstance(material, Lambertian | PrintedImage) else _GRAZING_LOBE
    keep = np.abs(towards) > least if flat and isinstance(material, TwoSided) else towards > least
    normals = normals * np.where(towards < 0, -1.0, 1.0)[:, np.newaxis]
    if keep.any():
        yield _Probe(material, flat, group.grain, points[keep], normals[keep], to_eye[keep])


class _Division:
    """Cells of a source, what their patches give at the probes, and what they should."""

    def __init__(self, source: WideSource, probes: list[_Probe]) -> None:
        self.source = source
        self.probes = probes
        self.cells: list[Cell] = []
        self.positions = np.empty((0, 3))
        self.areas = np.empty(0)
        count = sum(len(probe.points) for probe in probes)
        self.given = np.empty((count, 0))
        self.due = np.empty((count, 0))
        self.add(first_cells(source.shape))

    def add(self, cells: list[Cell]) -> None:
        """Take cells in."""
        given, due = _exchanged(self.source, self.probes, cells)
        self.given, self.due = np.hstack([self.given, given]), np.hstack([self.due, due])
        positions, _, areas = _middles(self.source, cells)
        self.cells += cells
        self.positions, self.areas = np.vstack([self.positions, positions]), np.append(self.areas, areas)

    def halve(self, which: NDArray[np.bool_]) -> None:
        """Halve some of the cells."""
        new = [
            half for cell, cut in zip(self.cells, which, strict=True) if cut for half in halves(self.source.shape, cell)
        ]
        self.cells = [cell for cell, cut in zip(self.cells, which, strict=True) if not cut]
        self.given, self.due = self.given[:, ~which], self.due[:, ~which]
        self.positions, self.areas = self.positions[~which], self.areas[~which]
        self.add(new)

    def misses(self) -> tuple[Array, Array]:
        """Relative error at each probe, and what each cell has of it at the probes that are worst off."""
        return _apart(self.given, self.due, 0.0)

    def misses_below(self, scene: Scene) -> tuple[Array, Array]:
        """The same right below patches and their corners: bright and dark spots lie there, between probes.

        At its foot a patch of side s at distance h gives about (s/h)^2/3 too much. Where that is little, nothing is
        looked at, and of many places some that are spread over the source.
        """
        places, widths = [], []
        for middle, cell in zip(self.positions, self.cells, strict=True):
            around = _world(self.source, cell)
            places.append(np.vstack([middle, around[:: math.ceil(len(around) / 4)]]))
            width = math.sqrt(2) * float(np.linalg.norm(around - middle, axis=1).max())
            widths.append(np.full(len(places[-1]), width))
        reach = np.concatenate(widths) / math.sqrt(3 * _MARGIN * self.source.irradiance_error)
        given, due = [np.empty((0, len(self.cells)))], [np.empty((0, len(self.cells)))]
        for target in scene.targets:
            for group in feet(target, np.vstack(places), reach, _MOST_FEET):
                for part in _parts(group):
                    found = _exchanged(self.source, _watched(scene, [part], _PROBES, seen_only=True), self.cells)
                    given.append(found[0])
                    due.append(found[1])
        return _apart(np.vstack(given), np.vstack(due), float(self.due.sum(axis=1).max(initial=0.0)))

    def step(self) -> float:
        """Largest share of one patch in what a probe gets."""
        total = self.given.sum(axis=1)
        lit = total > _FLOOR * total.max(initial=0.0)
        return float((self.given[lit].max(axis=1) / total[lit]).max(initial=0.0))


def _exchanged(source: WideSource, probes: list[_Probe], cells: list[Cell]) -> tuple[Array, Array]:
    """What patches of cells give at probes, and what the cells should, both of shape (probes, cells)."""
    given, due = [np.empty((0, len(cells)))], [np.empty((0, len(cells)))]
    positions, normals, areas = _middles(source, cells)
    points, facing, sizes = _true(source, cells)
    for probe in probes:
        given.append(_received(source, probe, positions, normals, areas, widened=probe.flat))
        fine = _received(source, probe, points, facing, sizes)
        due.append(fine.reshape(len(probe.points), len(cells), -1).sum(axis=2))
    return np.vstack(given), np.vstack(due)


def _parts(group: SurfacePoints) -> Iterator[SurfacePoints]:
    """The same points in portions, so that memory stays small."""
    for start in range(0, len(group.points), _PROBES):
        of = slice(start, start + _PROBES)
        yield replace(group, points=group.points[of], normals=group.normals[of])


def _apart(given: Array, due: Array, best: float) -> tuple[Array, Array]:
    """Relative error at each probe, and each cell's share; `best` is what a probe elsewhere gets."""
    total = due.sum(axis=1)
    total = np.maximum(total, _FLOOR * total.max(initial=best))
    total = np.where(total > 0, total, 1.0)
    apart = (given - due) / total[:, np.newaxis]
    return np.abs(apart.sum(axis=1)), np.abs(apart)


def _cut(source: WideSource, scene: Scene, probes: list[_Probe], where: str) -> WideSource:
    division = _Division(source, probes)
    while True:
        error, shares = division.misses()
        worst = float(error.max(initial=0.0))
        wanted = _unresolved(division) | _blamed(error, shares, source)
        if not wanted.any() and len(division.cells) < source.least_patches:
            wanted = division.areas > 0.9 * division.areas.max()
        if not wanted.any():
            error, shares = division.misses_below(scene)
            worst = max(worst, float(error.max(initial=0.0)))
            wanted = _blamed(error, shares, source)
        if not wanted.any():
            break
        if len(division.cells) + int(wanted.sum()) > MOST_PATCHES:
            raise InputError(
                f"would need more than {MOST_PATCHES} patches: after {len(division.cells)} of them its light is still "
                f"off by up to {worst:.2%} at points that the camera sees",
                where=f"{where}.irradiance_error",
                remedy="ask for less, move it away from what it lights, or make it smaller",
            )
        division.halve(wanted)
    order = sorted(division.cells)
    patches = tuple(_patch(source, cell, number) for number, cell in enumerate(order))
    return replace(source, patches=patches, is_outline=False, reached=worst, step=division.step())


def _blamed(error: Array, shares: Array, source: WideSource) -> NDArray[np.bool_]:
    """Cells that have most of an error that is too large."""
    worst = error > _MARGIN * source.irradiance_error
    blame = shares[worst].max(axis=0, initial=0.0)
    blamed: NDArray[np.bool_] = (blame > _TOGETHER * blame.max()) & worst.any()
    return blamed


def _middles(source: WideSource, cells: list[Cell]) -> tuple[Array, Array, Array]:
    """Where patches shine from, shape (m, 3) [m], their unit normals, and areas [m^2]."""
    patches = [_patch(source, cell, 0) for cell in cells]
    positions = np.array([patch.position for patch in patches])
    normals = np.array([patch.axis for patch in patches])
    return positions, normals, np.array([math.pi * patch.radius**2 for patch in patches])


def _true(source: WideSource, cells: list[Cell]) -> tuple[Array, Array, Array]:
    """Points, normals, shape (m * 16, 3), and areas of quadrature over the true shape in the world."""
    rotation = np.asarray(source.pose.rotation)
    points, normals, areas = nodes(source.shape, np.array(cells), _NODES)
    world = points.reshape(-1, 3) @ rotation.T + source.pose.position
    return world, normals.reshape(-1, 3) @ rotation.T, areas.ravel()


def _received(
    source: WideSource, probe: _Probe, positions: Array, normals: Array, areas: Array, *, widened: bool = False
) -> Array:
    """What points of light give at probes: for each unit of radiance, shape (probes, points of light)."""
    # By products of matrices, about the source's middle so that no digits are lost: vectors only where a lobe asks.
    middle = positions.mean(axis=0)
    light, at = positions - middle, probe.points - middle
    square = (light**2).sum(axis=1) + (at**2).sum(axis=1)[:, np.newaxis] - 2 * at @ light.T
    square = np.maximum(square, 1e-300)
    distance = np.sqrt(square)
    cosine = (at @ normals.T - (light * normals).sum(axis=1)) / distance
    if source.beam.profile == "lambertian":
        shining = np.maximum(cosine, 0.0)
    else:
        shining = source.beam.relative_intensity(np.arccos(np.clip(cosine, -1.0, 1.0)))
    perpendicular: Array = shining * areas / square
    if isinstance(probe.material, Lambertian | PrintedImage):
        falling = (probe.normals @ light.T - (at * probe.normals).sum(axis=1)[:, np.newaxis]) / distance
        diffuse: Array = perpendicular * np.maximum(falling, 0.0)
        return diffuse
    to_light = ((light[np.newaxis] - at[:, np.newaxis]) / distance[..., np.newaxis]).reshape(-1, 3)
    normal, eye = (np.repeat(vectors, len(positions), axis=0) for vectors in (probe.normals, probe.to_eye))
    solid_angle = (areas * np.maximum(cosine, 0.0) / square).ravel() if widened else 0.0
    factor = radiance_factor(probe.material, normal, to_light, eye, solid_angle=solid_angle, grain=probe.grain)
    received: Array = perpendicular * factor.reshape(perpendicular.shape)
    return received


def _unresolved(division: _Division) -> NDArray[np.bool_]:
    """Cells near a lobe's direction and too wide for quadrature to see it."""
    wanted = np.zeros(len(division.cells), dtype=bool)
    for probe in division.probes:
        lobe = lobe_of(probe.material, probe.normals, probe.to_eye)
        if lobe is None:
            continue
        direction, width = lobe
        away = division.positions[np.newaxis] - probe.points[:, np.newaxis]
        distance = np.maximum(np.linalg.norm(away, axis=-1), 1e-300)
        size = np.sqrt(division.areas) / distance
        off = np.linalg.norm(away / distance[..., np.newaxis] - direction[:, np.newaxis], axis=-1)
        near = off < size + _LOBE_REACH * width
        wanted |= (near & (size > _LOBE_STEP * width)).any(axis=0)
    return wanted


def lobe_of(material: Material, normals: Array, to_eye: Array) -> tuple[Array, float] | None:
    """Where light must come from to be sent to the eye, unit vectors, and the lobe's standard deviation [rad]."""
    match material:
        case Lambertian() | PrintedImage() | MeasuredBrdf() | Mirror() | Glass():
            return None
        case PrintedSheeting():
            return lobe_of(material.sheeting, normals, to_eye)
        case Anisotropic(_, specular, x, y):
            return lobe_of(Specular(0.0, specular, min(x, y)), normals, to_eye)
        case Specular(_, specular, roughness):
            mirrored = 2 * (to_eye * normals).sum(axis=1, keepdims=True) * normals - to_eye
            return (mirrored, math.sqrt(2) * roughness) if specular > 0 else None
        case PerturbedNormal(_, roughness):
            return to_eye, math.sqrt(2) * roughness
        case CoefficientTable(observation):
            return to_eye, min(b - a for a, b in pairwise(observation))
        case GlassBeads():
            return to_eye, math.radians(0.17)  # their curve's steepest piece


def _patch(source: WideSource, cell: Cell, number: int) -> Patch:
    world = _world(source, cell)
    # Newell's normal, of twice the area's length.
    x, y, z = (world - world[0]).T
    doubled = np.array(
        [y[:-1] @ z[1:] - z[:-1] @ y[1:], z[:-1] @ x[1:] - x[:-1] @ z[1:], x[:-1] @ y[1:] - y[:-1] @ x[1:]]
    )
    length = float(np.linalg.norm(doubled))
    return Patch(
        name=f"{source.name}.patch{number:04d}",
        position=_vector(world.mean(axis=0)),
        axis=_vector(doubled / length),
        radius=math.sqrt(length / 2 / math.pi),
        radiance=source.radiance,
        beam=source.beam,
        corners=tuple(map(_vector, world)),
        whole=source.name,
    )


def _world(source: WideSource, cell: Cell) -> Array:
    """Corners of a cell's patch in the world, shape (n, 3) [m]."""
    placed: Array = corners(source.shape, cell) @ np.asarray(source.pose.rotation).T + source.pose.position
    return placed


def _vector(values: Array) -> Vector:
    x, y, z = values.tolist()
    return x, y, z
