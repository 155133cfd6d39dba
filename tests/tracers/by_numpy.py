"""Direct light by closed forms for whole arrays: a third opinion on the few rays about which two tracers differ."""

from __future__ import annotations

import math

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from radwrap.frames import Pose, aim, points_to_local
from radwrap.scene.look.intersections import first_hit, in_polygon
from radwrap.scene.look.reflection import radiance_factor
from radwrap.scene.look.superposed import summed, superposed
from radwrap.scene.materials import Lambertian, Material, PerturbedNormal, PrintedImage, PrintedSheeting
from radwrap.scene.patterns.marks import FlatDisc, Mark
from radwrap.scene.scene import Scene
from radwrap.scene.sources import Emitter, Luminaire, Patch, WideSource
from radwrap.scene.targets import (
    Box,
    Cylinder,
    Disc,
    DotBoard,
    EdgeTarget,
    Flat,
    PatternTarget,
    Polygon,
    Sheet,
    Sphere,
    Target,
)

# What is nearer than Radiance's 1e-6 mm is where a ray began [m].
START = 1e-9


def radiance_by_numpy(scene: Scene, rays: np.ndarray) -> np.ndarray:
    """Radiance along rays, shape (n, 6)."""
    emitters = [summed(group) for group in superposed(scene.emitters)]
    stands = [standing(emitter) for emitter in emitters]
    eyes, along = rays[:, :3], rays[:, 3:] / np.linalg.norm(rays[:, 3:], axis=1, keepdims=True)
    which, distance, normals = _first([*scene.targets, *stands], eyes, along)
    skies = [one.radiance for one in scene.sources if isinstance(one, WideSource) and one.kind == "surround"]
    values = np.where(np.isfinite(distance), 0.0, math.fsum(skies))
    places = eyes + np.where(np.isfinite(distance), distance, 0.0)[:, np.newaxis] * along
    asked = []
    for number in np.unique(which[np.isfinite(distance)]):
        here = np.flatnonzero((which == number) & np.isfinite(distance))
        if number < len(scene.targets):
            target, to_eye = scene.targets[number], -along[here]
            asked += _unhidden(
                scene, emitters, target, rays=here, places=places[here], normals=normals[here], to_eye=to_eye
            )
        else:
            values[here] = _seen(emitters[number - len(scene.targets)], along[here])
    if asked:
        ray, light, start, to_light, away, value = map(np.concatenate, zip(*asked, strict=True))
        hidden = np.zeros(len(ray), dtype=bool)
        for number, target in enumerate([*scene.targets, *stands], -len(scene.targets)):
            others = np.flatnonzero((light != number) & ~hidden)  # no light hides its own centre
            before, _ = first_hit(target, start[others], to_light[others])
            hidden[others] = before < away[others] - 2 * START
        np.add.at(values, ray, np.where(hidden, 0.0, value))
    return values


def standing(emitter: Emitter) -> Target:
    """An emitter as a target that hides."""
    pose = Pose(emitter.position, aim((0.0, 0.0, 0.0), emitter.axis).rotation)
    if isinstance(emitter, Luminaire):
        return Sphere(emitter.name, pose, "", 2 * emitter.radius)
    if isinstance(emitter, Patch):
        return Polygon(
            emitter.name, pose, "", tuple(map(tuple, points_to_local(pose, np.array(emitter.corners))[:, :2]))
        )
    return Disc(emitter.name, pose, "", 2 * emitter.radius)


def _first(targets: list[Target], origins: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    best, which, normals = np.full(len(along), np.inf), np.zeros(len(along), dtype=int), np.zeros_like(along)
    for number, target in enumerate(targets):
        distance, normal = first_hit(target, origins, along)
        nearer = distance < best
        best[nearer], which[nearer], normals[nearer] = distance[nearer], number, normal[nearer]
    return which, best, normals


def _seen(emitter: Emitter, along: np.ndarray) -> np.ndarray:
    """The intensity goes by the direction: that of a place far along it."""
    if isinstance(emitter, Luminaire):
        return emitter.radiance * emitter.relative_intensity_at(np.asarray(emitter.position) - along)
    cosine = -(along @ np.asarray(emitter.axis))
    share = emitter.relative_intensity_at(np.asarray(emitter.position) - along)
    return np.where(cosine > 0, emitter.radiance * share / np.where(cosine > 0, cosine, 1.0), 0.0)


def _unhidden(
    scene: Scene,
    emitters: list[Emitter],
    target: Target,
    *,
    rays: np.ndarray,
    places: np.ndarray,
    normals: np.ndarray,
    to_eye: np.ndarray,
) -> list[tuple[np.ndarray, ...]]:
    """What each emitter would bring to rays: their numbers, its own, where from, which way, how far, and radiance."""
    found = []
    for number, emitter in enumerate(emitters):
        towards = np.asarray(emitter.position) - places
        away = np.linalg.norm(towards, axis=1)
        to_light = towards / away[:, np.newaxis]
        irradiance = emitter.radiant_intensity * emitter.relative_intensity_at(places) / away**2
        cosine = 1.0 if isinstance(emitter, Luminaire) else -(to_light @ np.asarray(emitter.axis))
        omega = math.pi * emitter.radius**2 * np.maximum(cosine, 0.0) / away**2
        flat = omega if isinstance(target, Flat | Box) else np.zeros(len(away))
        if isinstance(target, Cylinder):  # its ends are flat
            flat = np.where(np.abs(normals @ np.asarray(target.pose.z_axis)) > 0.5, omega, 0.0)
        value = irradiance * _factor(
            scene, target, places=places, normals=normals, to_light=to_light, to_eye=to_eye, omega=flat
        )
        lit = value > 0
        start = places[lit] + START * to_light[lit]
        found.append((rays[lit], np.full(lit.sum(), number), start, to_light[lit], away[lit], value[lit]))
    return found


def _factor(
    scene: Scene,
    target: Target,
    *,
    places: np.ndarray,
    normals: np.ndarray,
    to_light: np.ndarray,
    to_eye: np.ndarray,
    omega: np.ndarray,
) -> np.ndarray:
    local = points_to_local(target.pose, places)
    grain = target.pose.x_axis

    def of(material: Material) -> np.ndarray:
        if isinstance(material, PrintedSheeting):
            ink = radiance_factor(Lambertian(material.reflectance), normals, to_light, to_eye)
            front = (normals * to_eye).sum(axis=1) > 0
            return front * (material.coverage * ink + (1 - material.coverage) * of(material.sheeting))
        if isinstance(material, PerturbedNormal):  # as Radiance: without a horizon, to the front
            front = (normals * to_eye).sum(axis=1) > 0
            return np.where(front, radiance_factor(material, to_eye, to_light, to_eye), 0.0)
        if isinstance(material, PrintedImage):
            assert isinstance(target, Sheet)
            return _printed(material, target, local) * radiance_factor(Lambertian(1.0), normals, to_light, to_eye)
        return radiance_factor(material, normals, to_light, to_eye, solid_angle=omega, grain=grain)

    value = of(scene.materials[target.material])
    if isinstance(target, DotBoard):
        centres = np.array([centre[:2] for _, _, centre in target.dot_centres()])
        near = np.linalg.norm(local[:, np.newaxis, :2] - centres, axis=2).min(axis=1) < target.dot_diameter / 2
        value = np.where(near, of(scene.materials[target.dot_material]), value)
    if isinstance(target, PatternTarget):
        on_mark = np.zeros(len(local), dtype=bool)
        for mark in target.layout.marks():
            on_mark |= _on(mark, local)
        value = np.where(on_mark, of(scene.materials[target.pattern_material]), value)
    if isinstance(target, EdgeTarget):
        value = np.where(local[:, 0] > target.edge_position, of(scene.materials[target.edge_material]), value)
    return value


def _on(mark: Mark, local: np.ndarray) -> np.ndarray:
    if isinstance(mark, FlatDisc):
        return np.hypot(local[:, 0] - mark.x, local[:, 1] - mark.y) < mark.radius
    return in_polygon(np.array(mark.vertices), local[:, :2])


def _printed(material: PrintedImage, target: Sheet, local: np.ndarray) -> np.ndarray:
    table = np.array(material.rows)[::-1]
    y, x = ((np.arange(n) + 0.5) / n - 0.5 for n in table.shape)
    place = np.stack([local[:, 1] / target.height, local[:, 0] / target.width], axis=1)
    place = np.clip(place, [y[0], x[0]], [y[-1], x[-1]])
    return RegularGridInterpolator((y, x), table)(place)
