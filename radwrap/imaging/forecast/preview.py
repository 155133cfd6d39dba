"""What the pinhole's centre sees, by closed form: one reflection, no shadows.

Unlike a grid over the image, the search for the brightest point also starts
where each beam meets each target, and where it would be mirrored to the eye:
a spot may be smaller than the distance of the rays.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.forecast.closed_form import radiance
from radwrap.imaging.optics.view import central_weights
from radwrap.scene.look.geometry import SurfacePoints, directions, in_view, project
from radwrap.scene.look.intersections import Bounded, first_hit, in_polygon, reached
from radwrap.scene.look.probes import beam_rays, lit_points, material_number, materials_of, surface_points
from radwrap.scene.look.superposed import summed, superposed
from radwrap.scene.materials import Anisotropic, Glass, Specular
from radwrap.scene.scene import Scene
from radwrap.scene.sources import Emitter, Luminaire, Patch
from radwrap.scene.targets import Target

Array = NDArray[np.float64]

_MOST_RAYS: Final = 20_000  # of the search's first look at the sensor, and from special places
_FEWEST_SPREAD: Final = 500  # rays of a look that finds out what is in sight
_MOST_SPREAD: Final = 10_000
_SPREAD_VALUES: Final = 400_000  # rays times sources of that look: some tenths of a second
_MOST_VALUES: Final = 2_000_000  # rays times sources of a first look: a few seconds
_MOST_BEAMS: Final = 200  # sources, spread over all, whose beams are followed
_MOST_PAIRS: Final = 20_000  # of targets and sources whose beams are followed to them: a few seconds
_STARTS: Final = 8  # brightest rays from which the search goes on
_FINER: Final = 9  # rays along each side of a finer look, which is a quarter as wide as the one before
_LOOKS: Final = 7


@dataclass(frozen=True, slots=True)
class Brightest:
    """The brightest point in view.

    Attributes
    ----------
    target, material : str
        What it lies on; for a source that is seen itself its name and "light".
    radiance : float
        What the sensor's plane receives of it [W m^-2 sr^-1]: L cos^4(theta); behind a lens L times its falloff's mean
        over the opening, and times the stretch where it distorts.
    """

    target: str
    material: str
    radiance: float


@dataclass(frozen=True, slots=True, eq=False)
class _Known:
    """What each look needs of a scene, made once for many looks.

    Attributes
    ----------
    scene : Scene
        What is there.
    lit : tuple of Emitter
        What shines, those in one place as one.
    solid : Bounded
        Targets that are not of glass.
    """

    scene: Scene
    lit: tuple[Emitter, ...]
    solid: Bounded

    @classmethod
    def of(cls, scene: Scene) -> _Known:
        panes = {name for name, material in scene.materials.items() if isinstance(material, Glass)}
        solid = Bounded.of(target for target in scene.targets if panes.isdisjoint(materials_of(target)))
        return cls(scene, tuple(summed(group) for group in superposed(scene.emitters)), solid)


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What rays from the pinhole's centre see.

    Attributes
    ----------
    value : ndarray, shape (n,)
        L cos^4(theta), or L times the weights [W m^-2 sr^-1]; NaN where a ray meets nothing.
    number : ndarray of int, shape (n,)
        Place of what is seen in `names`; -1 for nothing.
    names : tuple of tuple of str
        (target, material), or (source, "light").
    distance : ndarray, shape (n,)
        Along the ray [m]; infinite where it meets nothing.
    """

    value: Array
    number: NDArray[np.intp]
    names: tuple[tuple[str, str], ...]
    distance: Array


def look(scene: Scene, rays: Array, weights: Array | None = None) -> Seen:
    """What is seen along rays from the pinhole's centre.

    Parameters
    ----------
    scene : Scene
        What is there; of included Radiance files nothing is known.
    rays : ndarray, shape (n, 3)
        Unit vectors.
    weights : ndarray, shape (n,), optional
        What counts of each ray's radiance; default cos^4(theta).
    """
    return _looked(_Known.of(scene), rays, weights)


def _looked(known: _Known, rays: Array, weights: Array | None = None) -> Seen:
    scene = known.scene
    eye = np.asarray(scene.camera.pose.position)
    nearest = np.full(len(rays), math.inf)
    number = np.full(len(rays), -1, dtype=np.intp)
    normal, grain = np.zeros((2, len(rays), 3))
    names: list[tuple[str, str]] = []
    for target, numbers in reached(known.solid, scene.camera.pose.position, rays):
        distance, normals = first_hit(target, eye, rays[numbers])
        closer = distance < nearest[numbers]
        if not closer.any():
            continue
        met = numbers[closer]
        nearest[met], normal[met], grain[met] = distance[closer], normals[closer], target.pose.x_axis
        number[met] = len(names) + material_number(target, eye + distance[closer, np.newaxis] * rays[met])
        names += [(target.name, material) for material in materials_of(target)]
    value = np.full(len(rays), math.nan)
    hit = np.flatnonzero(number >= 0)
    which = np.array([material for _, material in names])[number[hit]]
    for material in np.unique(which):  # of many targets few materials
        of = hit[which == material]
        points = eye + nearest[of, np.newaxis] * rays[of]
        value[of] = _reflected(known, SurfacePoints("", str(material), points, normal[of], grain[of]), eye)
    for emitter in known.lit:
        distance, shown = _disc(emitter, eye, rays)
        closer = distance < nearest
        nearest[closer], value[closer], number[closer] = distance[closer], shown[closer], len(names)
        names.append((emitter.name, "light"))
    if weights is None:
        weights = (rays @ np.asarray(scene.camera.pose.z_axis)) ** 4
    return Seen(value * weights, number, tuple(names), nearest)


def _reflected(known: _Known, group: SurfacePoints, eye: Array) -> Array:
    material = known.scene.materials[group.material]
    total = np.zeros(len(group.points))
    for emitter in known.lit:
        total += radiance(material, group, emitter, eye)
    return total


def _disc(emitter: Emitter, eye: Array, rays: Array) -> tuple[Array, Array]:
    """Distance to a source's disc, infinite where it is missed, and its radiance towards the eye; its back is black."""
    axis, centre = np.asarray(emitter.axis), np.asarray(emitter.position)
    if isinstance(emitter, Luminaire):  # a sphere: it looks like a disc that faces the eye
        axis = (eye - centre) / max(float(np.linalg.norm(eye - centre)), 1e-300)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = ((centre - eye) @ axis) / (rays @ axis)
        points = eye + distance[:, np.newaxis] * rays
        off = np.linalg.norm(points - centre, axis=1)
        inside = _in_patch(emitter, points) if isinstance(emitter, Patch) else off <= emitter.radius
    distance = np.where((distance > 0) & inside, distance, math.inf)
    cosine = -rays @ axis
    if isinstance(emitter, Luminaire):
        return distance, np.full(len(rays), emitter.radiance * emitter.relative_intensity_at(eye[np.newaxis])[0])
    towards = emitter.beam.relative_intensity(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return distance, emitter.radiance * towards / np.maximum(cosine, 1e-12)


def _in_patch(patch: Patch, points: Array) -> NDArray[np.bool_]:
    """Which points of a patch's plane lie in it."""
    corners = np.asarray(patch.corners) - patch.position
    first = corners[0] / np.linalg.norm(corners[0])
    across = np.stack([first, np.cross(patch.axis, first)], axis=1)
    away = points - np.asarray(patch.position)
    inside: NDArray[np.bool_] = np.linalg.norm(away, axis=1) <= np.linalg.norm(corners, axis=1).max()
    if inside.any():  # of most patches no point is near
        inside[inside] = in_polygon(corners @ across, away[inside] @ across)
    return inside


def brightest(scene: Scene) -> Brightest | None:
    """Brightest point in view; None where no ray meets anything that is known here."""
    known = _Known.of(scene)
    uv, width = _first_look(known)
    seen = _shown(known, uv)
    places = _brightest_rays(seen, uv, _STARTS if len(known.lit) <= _MOST_BEAMS else 2)
    starts = np.arange(len(places))
    found: list[tuple[int, float, tuple[str, str]]] = []
    for _ in range(_LOOKS):
        # All starts at once: with many sources a look takes its time for each of them, not for each ray.
        around = np.stack([_around(scene, place, width) for place in places]) if len(places) else np.empty((0, 1, 2))
        finer = _shown(known, around.reshape(-1, 2))
        value, number = (each.reshape(around.shape[:2]) for each in (finer.value, finer.number))
        met = (number >= 0).any(axis=1)  # the others are on the very border of what is seen
        starts, around, value, number = starts[met], around[met], value[met], number[met]
        rows, tops = np.arange(len(starts)), np.nanargmax(value, axis=1)
        for start, top, name in zip(starts, value[rows, tops], number[rows, tops], strict=True):
            found.append((int(start), float(top), finer.names[name]))
        places, width = around[rows, tops], width / 4
    if not found:
        return None
    _, most, name = max(sorted(found, key=lambda one: one[0]), key=lambda one: one[1])
    return Brightest(*name, most)


def spread_look(scene: Scene) -> tuple[Seen, Array]:
    """What is seen on rays that are spread evenly over the sensor, and how deep it lies along the axis [m]."""
    known = _Known.of(scene)
    sensor = scene.camera.sensor
    most = max(_FEWEST_SPREAD, min(_MOST_SPREAD, _SPREAD_VALUES // max(1, len(known.lit))))
    step = max(1.0, math.sqrt(sensor.pixels / most))
    u, v = (np.arange(step / 2 - 0.5, size - 0.5, step) for size in (sensor.columns, sensor.rows))
    uv = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    seen = _shown(known, uv)
    return seen, seen.distance * (directions(scene.camera, uv) @ np.asarray(scene.camera.pose.z_axis))


def _shown(known: _Known, uv: Array) -> Seen:
    """What the sensor receives at places, (column, row) [px], shape (n, 2)."""
    camera = known.scene.camera
    plain = camera.lens is None and camera.distortion is None
    weights = None if plain else central_weights(camera, uv[:, 0], uv[:, 1])
    return _blurred(known.scene, _looked(known, directions(camera, uv), weights))


def _blurred(scene: Scene, seen: Seen) -> Seen:
    """The same with the discs of sources as dim as a finite pinhole makes them.

    A disc is brighter than anything else and often smaller than its blur: a
    pixel sees it through the part of the opening that its pencil has of it.
    """
    camera, emitters = scene.camera, scene.emitters
    share = {}
    areas: dict[str, float] = {}  # of a wide source all patches, which fill the pencil together
    for emitter in emitters:
        areas[emitter.source] = areas.get(emitter.source, 0.0) + math.pi * emitter.radius**2
    for emitter in emitters:
        away = np.asarray(emitter.position) - camera.pose.position
        depth = float(away @ np.asarray(camera.pose.z_axis))
        pencil = 0.0 if camera.aperture.is_infinitesimal else camera.aperture.area * camera.pencil_scale(depth) ** 2
        slant = abs(float(away @ np.asarray(emitter.axis))) / max(float(np.linalg.norm(away)), 1e-300)
        disc = areas[emitter.source] * slant
        share[emitter.name] = min(1.0, disc / pencil) if pencil > 0 else 1.0
    factors = np.array([share.get(name, 1.0) for name, _ in seen.names] + [math.nan])
    return replace(seen, value=seen.value * factors[seen.number])


def _first_look(known: _Known) -> tuple[Array, float]:
    """Places on the sensor, (column, row) [px], shape (n, 2), and the distance of those that are evenly spread."""
    sensor = known.scene.camera.sensor
    most = max(1000, min(_MOST_RAYS, _MOST_VALUES // max(1, len(known.lit))))
    step = max(1.0, math.sqrt(sensor.pixels / most))
    counts = (max(1, math.ceil(sensor.columns / step)), max(1, math.ceil(sensor.rows / step)))
    u, v = (
        (np.arange(number) + 0.5) * size / number - 0.5
        for number, size in zip(counts, (sensor.columns, sensor.rows), strict=True)
    )
    grid = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    special = _special_places(known)
    return np.vstack([grid, special[:: math.ceil(max(len(special), 1) / most)]]), step


def _special_places(known: _Known) -> Array:
    """Where sources, what they light, and their mirror images are seen, (column, row) [px]."""
    scene, lit = known.scene, known.lit
    camera = scene.camera
    most = max(1, min(_MOST_BEAMS, _MOST_PAIRS // max(len(scene.targets), 1)))
    beams = [(emitter, beam_rays(emitter)) for emitter in lit[:: math.ceil(max(len(lit), 1) / most)]]
    points = [np.array([emitter.position for emitter in lit]).reshape(-1, 3)]
    for target in scene.targets:
        groups = surface_points(target, camera.pose.position)
        points += [group.points for group in groups]
        glossy = any(isinstance(scene.materials[name], Specular | Anisotropic) for name in materials_of(target))
        for emitter, beam in beams:
            points += [group.points for group in lit_points(target, emitter, beam)]
            if glossy:
                points.append(_highlight(scene, target, emitter))
    together = np.vstack(points)
    uv, _ = project(camera, together[in_view(camera, together)])
    return uv


def _highlight(scene: Scene, target: Target, emitter: Emitter) -> Array:
    """The point in view at which a target's normal halves the way from eye to source best, shape (0 or 1, 3) [m]."""
    camera = scene.camera
    eye = np.asarray(camera.pose.position)

    def aligned(uv: Array) -> tuple[Array, Array]:
        rays = directions(camera, uv)
        distance, normals = first_hit(target, eye, rays)
        met = np.isfinite(distance)
        points = eye + np.where(met, distance, 0.0)[:, np.newaxis] * rays
        to_light = np.asarray(emitter.position) - points
        half = to_light / np.maximum(np.linalg.norm(to_light, axis=1, keepdims=True), 1e-300) - rays
        length = np.maximum(np.linalg.norm(half, axis=1), 1e-300)
        return np.where(met, np.abs((half * normals).sum(axis=1)) / length, -1.0), points

    return _climb(scene, aligned)


def _climb(scene: Scene, objective: Callable[[Array], tuple[Array, Array]]) -> Array:
    """The point that has most of something smooth, by looks that are finer each time; shape (0 or 1, 3) [m]."""
    sensor = scene.camera.sensor
    place = np.array([sensor.columns - 1, sensor.rows - 1]) / 2
    width = max(sensor.columns, sensor.rows) / 2
    found = np.empty((0, 3))
    while width > 1e-3:
        uv = _around(scene, place, width)
        value, points = objective(uv)
        top = int(value.argmax())
        if value[top] < 0:
            break
        place, found, width = uv[top], points[top : top + 1], width / 2
    return found


def _around(scene: Scene, place: Array, width: float) -> Array:
    """A square of places about one, up to `width` to each side [px], those off the sensor drawn onto its rim."""
    sensor = scene.camera.sensor
    steps = np.linspace(-width, width, _FINER)
    uv = place + np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    return np.clip(uv, -0.5, [sensor.columns - 0.5, sensor.rows - 0.5])


def _brightest_rays(seen: Seen, uv: Array, number: int) -> Array:
    met = np.flatnonzero(seen.number >= 0)
    return uv[met[np.argsort(-seen.value[met], kind="stable")[:number]]]
