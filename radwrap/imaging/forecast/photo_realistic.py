"""The other way of Fig. 3: an image that only looks like a photograph, beside the predicted one.

One parallel or isotropic point light without shadows, Lambertian and Phong
reflection, an infinitesimal pinhole, and no sensor: white that faces the light
gets full scale, and everything else its share of that. It needs no tracer.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.files import sha256_of
from radwrap.images import write_png
from radwrap.manifest import SCHEMA_VERSION, plain, write_manifest
from radwrap.scene.file.material_files import directional_albedo
from radwrap.scene.look.geometry import directions
from radwrap.scene.look.intersections import first_hit
from radwrap.scene.look.probes import material_number, materials_of
from radwrap.scene.look.wide_sources import divided
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
    Specular,
)
from radwrap.scene.scene import Scene
from radwrap.scene.targets import Sheet, Target

Array = NDArray[np.float64]
LightKind = Literal["parallel", "point"]

PICTURE: Final = "photo_realistic.png"
COMPARISON: Final = "comparison.png"
TOLD: Final = "photo_realistic.json"
FILES: Final = (PICTURE, COMPARISON, TOLD)
# Sheeting looks white in a room; whoever draws such pictures knows nothing else of it.
_SHEETING: Final = 0.8
_ROWS_AT_ONCE: Final = 64


@dataclass(frozen=True, slots=True)
class Light:
    """The one light.

    Attributes
    ----------
    kind : str
        "parallel" or "point".
    position : tuple of float
        Where a point light is; a parallel one comes from there to `reference` [m].
    reference : tuple of float
        Where white that faces the light gets full scale [m].
    """

    kind: LightKind
    position: tuple[float, float, float]
    reference: tuple[float, float, float]

    def at(self, points: Array) -> tuple[Array, Array]:
        """Unit vectors towards the light, shape (n, 3), and its level, 1 at `reference`, shape (n,)."""
        there, here = np.asarray(self.position), np.asarray(self.reference)
        if self.kind == "parallel":
            away = there - here
            return np.broadcast_to(away / np.linalg.norm(away), points.shape), np.ones(len(points))
        away = there - points
        distance = np.maximum(np.linalg.norm(away, axis=1), 1e-300)
        return away / distance[:, np.newaxis], float(np.linalg.norm(there - here)) ** 2 / distance**2


def one_light(scene: Scene, kind: LightKind) -> Light:
    """A light in the middle of the scene's own, weighted by radiant intensity; at the camera where that is no place."""
    reference = np.mean([target.pose.position for target in scene.targets], axis=0)
    lit = [emitter for emitter in divided(scene).emitters if emitter.radiance > 0]
    weights = np.array([emitter.radiant_intensity for emitter in lit])
    place = np.asarray(scene.camera.pose.position)
    if lit:
        middle = np.average([emitter.position for emitter in lit], axis=0, weights=weights / weights.max())
        if np.linalg.norm(middle - reference) > 1e-3 * np.linalg.norm(place - reference):
            place = middle
    x, y, z = place.tolist()
    u, v, w = reference.tolist()
    return Light(kind, (x, y, z), (u, v, w))


@dataclass(frozen=True, slots=True)
class _Phong:
    """I = I_light (diffuse cos(beta) + specular cos^exponent(angle to the mirror direction))."""

    diffuse: float
    specular: float = 0.0
    exponent: float = 1.0
    image: PrintedImage | None = None


def check_drawable(scene: Scene) -> dict[str, _Phong]:
    """How each material is drawn.

    Raises
    ------
    InputError
        If the scene includes a Radiance file, or has a material that neither Lambert nor Phong can draw.
    """
    if scene.included:
        raise InputError(
            "what an included file holds cannot be drawn this way",
            where=f'{scene.origin}: target "{scene.included[0].name}"',
            remedy="leave out the photo-realistic image, or the file",
        )
    return {name: _phong(material, f"{scene.origin}: materials.{name}") for name, material in scene.materials.items()}


def photo_realistic(scene: Scene, light: Light) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Codes of the picture, shape (rows, columns); full scale is that of the scene's sensor.

    Raises
    ------
    InputError
        As `check_drawable`.
    """
    phong = check_drawable(scene)
    sensor = scene.camera.sensor
    scale = 2**sensor.bit_depth - 1
    codes = np.zeros((sensor.rows, sensor.columns), dtype=np.uint8 if sensor.bit_depth <= 8 else np.uint16)
    for first in range(0, sensor.rows, _ROWS_AT_ONCE):
        rows = np.arange(first, min(first + _ROWS_AT_ONCE, sensor.rows))
        v, u = (grid.ravel() for grid in np.meshgrid(rows, np.arange(sensor.columns), indexing="ij"))
        shade = _shade(scene, phong, light, directions(scene.camera, np.column_stack([u, v]).astype(np.float64)))
        codes[rows] = np.rint(np.clip(shade, 0.0, 1.0) * scale).reshape(len(rows), -1)
    return codes


def _phong(material: Material, where: str) -> _Phong:
    match material:
        case Lambertian(reflectance) | PerturbedNormal(reflectance, _):
            return _Phong(reflectance)
        case Specular(diffuse, specular, roughness):
            # Both lobes have the same curvature at their peak: exp(-delta^2/a^2) with the angle 2 delta.
            return _Phong(diffuse, specular, max(1.0, 1 / (2 * roughness**2)))
        case Anisotropic(diffuse, specular, x, y):
            return _Phong(diffuse, specular, max(1.0, 1 / (2 * x * y)))
        case PrintedImage():
            return _Phong(1.0, image=material)
        case PrintedSheeting(_, coverage, reflectance):
            return _Phong(coverage * reflectance + (1 - coverage) * _SHEETING)
        case MeasuredBrdf():
            shape = (len(material.incidence), len(material.viewing), len(material.azimuth))
            table = np.asarray(material.values).reshape(shape)[:1]
            return _Phong(float(directional_albedo(np.array(material.viewing), np.array(material.azimuth), table)[0]))
        case Mirror() | Glass():
            raise InputError("mirrors and glass cannot be drawn this way", where=where, remedy="use another material")
        case CoefficientTable() | GlassBeads():
            return _Phong(_SHEETING)


def _shade(scene: Scene, phong: Mapping[str, _Phong], light: Light, rays: Array) -> Array:
    eye = np.asarray(scene.camera.pose.position)
    nearest = np.full(len(rays), math.inf)
    shade = np.zeros(len(rays))
    for target in scene.targets:
        distance, normals = first_hit(target, eye, rays)
        closer = np.isfinite(distance) & (distance <= nearest)
        if not closer.any():
            continue
        nearest[closer] = distance[closer]
        points = eye + distance[closer, np.newaxis] * rays[closer]
        which = material_number(target, points)
        parts = np.zeros(len(points))
        for number, name in enumerate(materials_of(target)):
            of = which == number
            parts[of] = _level(phong[name], target, light, points[of], normals[closer][of], rays[closer][of])
        shade[closer] = parts
    return shade


def _level(phong: _Phong, target: Target, light: Light, points: Array, normals: Array, rays: Array) -> Array:  # noqa: PLR0917
    normals = normals * np.where((rays * normals).sum(axis=1) > 0, -1.0, 1.0)[:, np.newaxis]
    towards, level = light.at(points)
    cosine = (towards * normals).sum(axis=1)
    diffuse = phong.diffuse if phong.image is None else _printed(phong.image, target, points)
    mirrored = 2 * cosine[:, np.newaxis] * normals - towards
    highlight = np.maximum(-(mirrored * rays).sum(axis=1), 0.0) ** phong.exponent
    shade: Array = np.where(cosine > 0, level * (diffuse * cosine + phong.specular * highlight), 0.0)
    return shade


def _printed(image: PrintedImage, target: Target, points: Array) -> Array:
    """Reflectance of the nearest pixel of a print."""
    if not isinstance(target, Sheet):
        raise TypeError("a print lies on a sheet")
    table = np.asarray(image.rows)
    local = (points - np.asarray(target.pose.position)) @ np.asarray(target.pose.rotation)
    place = np.column_stack([0.5 - local[:, 1] / target.height, 0.5 + local[:, 0] / target.width]) * table.shape
    row, column = np.clip(place.astype(int), 0, np.array(table.shape) - 1).T
    values: Array = table[row, column]
    return values


def write_beside(scene: Scene, out: Path, codes: NDArray[Any], kind: LightKind, run_sha256: str) -> dict[str, Any]:
    """Draw the scene the other way beside a predicted image in its folder, and compare both.

    Parameters
    ----------
    scene : Scene
        What is there.
    out : Path
        The run's folder: ``photo_realistic.png``, ``comparison.png`` (drawn, predicted, and their difference as
        mid-gray plus half of it) and ``photo_realistic.json``, which is also the result.
    codes : ndarray, shape (rows, columns)
        The predicted image.
    kind : str
        "parallel" or "point".
    run_sha256 : str
        Of the run that predicted it.

    Raises
    ------
    InputError
        As `photo_realistic`.
    """
    (out / TOLD).unlink(missing_ok=True)
    light = one_light(scene, kind)
    drawn = photo_realistic(scene, light)
    difference = drawn.astype(np.float64) - codes
    scale = 2**scene.camera.sensor.bit_depth - 1
    panels = [drawn / scale, codes / scale, 0.5 + difference / (2 * scale)]
    write_png(out / PICTURE, drawn)
    write_png(out / COMPARISON, np.rint(255 * np.hstack(panels)).astype(np.uint8))
    told = {
        "schema_version": SCHEMA_VERSION,
        "run_sha256": run_sha256,
        "light": light,
        "gray_difference": {
            "mean": float(difference.mean()),
            "rms": float(np.sqrt((difference**2).mean())),
            "largest": float(np.abs(difference).max()),
        },
        "materials": {name: _phong(m, name) for name, m in scene.materials.items() if not isinstance(m, PrintedImage)},
        "files": {name: sha256_of(out / name) for name in (PICTURE, COMPARISON)},
    }
    result: dict[str, Any] = plain(told)
    write_manifest(out / TOLD, result)
    return result
