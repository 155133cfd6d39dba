"""What each pixel of a cross-check shows, and what closed forms expect there of either tracer.

Terms: "diffuse", "specular", "mirror" and "included" by what the pixel's
centre sees; "shadow", diffuse but darker than its closed form without shadows;
"source", a disc that shines; within the blur of an outline or a shadow's rim
"aperture", or "edges" where the pinhole is infinitesimal. What a mirror shows
counts as "mirror" alone. What sees nothing is "background".
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.forecast.explain import blur_radius
from radwrap.imaging.forecast.preview import look
from radwrap.scene.camera import Camera
from radwrap.scene.look.geometry import directions
from radwrap.scene.look.intersections import first_hit
from radwrap.scene.look.probes import material_number, materials_of
from radwrap.scene.materials import Lambertian, Material, Specular
from radwrap.scene.scene import Scene
from radwrap.scene.sources import Emitter, Patch
from radwrap.scene.targets import RadFile
from radwrap.tracers.povray_included import mirrors_in
from radwrap.tracers.povray_text import highlight
from radwrap.tracers.radiance import PreparedScene

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

TERMS: Final = ("diffuse", "shadow", "specular", "mirror", "included", "source", "aperture", "edges", "background")
# Where a line through three pixels bends by more than this share of the brightest of them there is an edge.
_EDGE: Final = 0.05
# A diffuse pixel this much darker than its closed form lies in a shadow, of one LED of many at least.
_SHADOW: Final = 0.01
_DISC_POINTS: Final = 32  # along each side of the grid on which a source's disc is integrated


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What is known of each pixel, shape (rows, columns).

    Attributes
    ----------
    terms : dict of ndarray of bool
        Term -> its pixels; every pixel has one.
    closed_form : ndarray
        L cos^4(theta) at the pixel's centre without shadows [W m^-2 sr^-1]; NaN where nothing is known.
    expected : dict of ndarray
        Reason -> difference, POV-Ray's less Radiance's, that closed forms expect [W m^-2 sr^-1]; 0 elsewhere.
    """

    terms: dict[str, Mask]
    closed_form: Array
    expected: dict[str, Array]


def sees(
    scene: Scene,
    area_samples: int,
    radiance: Array,
    maps: tuple[NDArray[np.float32], NDArray[np.uint16]],
    prepared: PreparedScene,
) -> Seen:
    """Sort the pixels of a scene.

    Parameters
    ----------
    scene : Scene
        As it was traced.
    area_samples : int
        Whether POV-Ray's sources were extended, see `CrosscheckOptions`.
    radiance : ndarray, shape (rows, columns)
        What Radiance gave.
    maps : tuple of ndarray
        Depth and part of what each pixel's centre sees, see `central_maps`.
    prepared : PreparedScene
        For the names of the parts, and included files.
    """
    depth, parts = maps
    shape = radiance.shape
    rays = directions(scene.camera, _pixels(shape))
    closed = look(scene, rays).value.reshape(shape)
    kinds = _kinds(scene, prepared)
    kind = np.array(["", *kinds], dtype=object)[parts]
    smooth = ~_near_edges(scene.camera, radiance, depth, parts)
    edge = "edges" if scene.camera.aperture.is_infinitesimal else "aperture"
    dark = (kind == "diffuse") & (radiance < (1 - _SHADOW) * np.nan_to_num(closed))
    terms = {name: smooth & (kind == name) & ~dark for name in ("diffuse", "specular", "included", "source")}
    terms["shadow"] = smooth & dark
    terms["mirror"] = kind == "mirror"
    terms[edge] = ~smooth & ~terms["mirror"]
    terms["background"] = ~np.any(list(terms.values()), axis=0)
    expected = {"highlight": _highlights(scene, rays).reshape(shape)}
    if area_samples:
        expected["extended source"] = _extended(scene, rays).reshape(shape)
    # A highlight in a shadow is not expected.
    lit = np.nan_to_num(closed) > 0
    expected = {reason: np.where(lit, values, 0.0) for reason, values in expected.items() if values.any()}
    return Seen({name: terms[name] for name in TERMS if name in terms and terms[name].any()}, closed, expected)


def _pixels(shape: tuple[int, ...]) -> Array:
    row, column = np.indices(shape)
    return np.column_stack([column.ravel(), row.ravel()]).astype(np.float64)


def _kinds(scene: Scene, prepared: PreparedScene) -> list[str]:
    """Kind of each part, in the order of their numbers."""
    targets = {target.name: target for target in scene.targets}
    surfaces = {f"{surface.name.split('.')[0]}.{surface.part}": surface.material for surface in scene.surfaces}
    kinds = []
    for part in prepared.parts:
        if isinstance(targets.get(part), RadFile):
            kinds.append("mirror" if mirrors_in(prepared.included[part]) else "included")
        elif part in surfaces:
            kinds.append(_kind(scene.materials[surfaces[part]]))
        else:
            kinds.append("source")
    return kinds


def _kind(material: Material) -> str:
    return "specular" if isinstance(material, Specular) and material.specular_reflectance > 0 else "diffuse"


def _near_edges(camera: Camera, values: Array, depth: NDArray[np.float32], parts: NDArray[np.uint16]) -> Mask:
    """Pixels within the blur of an outline, or of a bend in the image such as a shadow's."""
    from scipy import ndimage

    rows, columns = values.shape
    padded = np.pad(values, 1, mode="edge")
    edge = ndimage.maximum_filter(parts, 3) != ndimage.minimum_filter(parts, 3)
    brightest = ndimage.maximum_filter(values, 3)
    for i, j in ((0, 1), (1, 0), (1, 1), (1, -1)):
        before = padded[1 - i : 1 - i + rows, 1 - j : 1 - j + columns]
        after = padded[1 + i : 1 + i + rows, 1 + j : 1 + j + columns]
        edge |= np.abs(before + after - 2 * values) > _EDGE * brightest
    seen = depth[depth > 0]
    ends = (float(seen.min(initial=np.inf)), float(seen.max(initial=0.0)) or np.inf)  # behind a lens either may blur
    blur = max(blur_radius(camera, end) for end in ends) / min(camera.sensor.pixel_width, camera.sensor.pixel_height)
    wide: Mask = ndimage.binary_dilation(edge, np.ones((3, 3), dtype=bool), iterations=1 + math.ceil(blur))
    return wide


@dataclass(frozen=True, slots=True, eq=False)
class _Hits:
    """Where rays first meet targets that are known here: points, normals to the viewer, materials; all of length n."""

    points: Array
    normals: Array
    cos4: Array
    material: NDArray[np.object_]


def _hits(scene: Scene, rays: Array) -> _Hits:
    eye = np.asarray(scene.camera.pose.position)
    nearest = np.full(len(rays), math.inf)
    normals = np.zeros_like(rays)
    material = np.full(len(rays), "", dtype=object)
    for target in scene.targets:
        distance, facing = first_hit(target, eye, rays)
        closer = np.isfinite(distance) & (distance <= nearest)
        points = eye + np.where(closer, distance, 0.0)[:, np.newaxis] * rays
        names = np.array(materials_of(target) or ("",), dtype=object)
        material[closer] = names[material_number(target, points)[closer]] if materials_of(target) else ""
        nearest[closer], normals[closer] = distance[closer], facing[closer]
    points = eye + np.where(np.isfinite(nearest), nearest, 0.0)[:, np.newaxis] * rays
    away = (rays * normals).sum(axis=1) > 0
    normals[away] *= -1
    cos4 = (rays @ np.asarray(scene.camera.pose.z_axis)) ** 4
    return _Hits(points, normals, cos4, material)


def _highlights(scene: Scene, rays: Array) -> Array:
    """What POV-Ray's cos^n highlight has more than Radiance's Gaussian lobe [W m^-2 sr^-1]."""
    total = np.zeros(len(rays))
    names = [name for name, material in scene.materials.items() if _kind(material) == "specular"]
    if not names:
        return total
    hits = _hits(scene, rays)
    for name in names:
        material = scene.materials[name]
        of = hits.material == name
        if isinstance(material, Specular) and of.any():
            for emitter in scene.emitters:
                total[of] += _highlight_difference(material, emitter, hits, of, rays[of]) * hits.cos4[of]
    return total


def _highlight_difference(material: Specular, emitter: Emitter, hits: _Hits, of: Mask, rays: Array) -> Array:
    points, normals = hits.points[of], hits.normals[of]
    away = np.asarray(emitter.position) - points
    distance = np.linalg.norm(away, axis=1)
    light = away / distance[:, np.newaxis]
    irradiance = emitter.radiant_intensity * emitter.relative_intensity_at(points) / distance**2
    half = light - rays
    square = (half**2).sum(axis=1)
    along = np.maximum((half * normals).sum(axis=1), 0.0) ** 2
    cosine = np.maximum((light * normals).sum(axis=1), 0.0)
    a = material.roughness
    power, height = highlight(material.specular_reflectance, a)
    povray = height / math.pi * (along / square) ** (power / 2)
    safe = np.maximum(along, 1e-12)
    lobe = np.exp(-(square - safe) / safe / a**2) * square / (math.pi * safe**2 * a**2)
    difference: Array = np.where(cosine > 0, irradiance * (povray - material.specular_reflectance * lobe * cosine), 0.0)
    return difference


def _extended(scene: Scene, rays: Array) -> Array:
    """What a source's whole disc gives diffuse surfaces more than its centre does [W m^-2 sr^-1]; no shadows."""
    hits = _hits(scene, rays)
    total = np.zeros(len(rays))
    reflectance = np.array([_reflectance(scene.materials.get(name)) for name in hits.material])
    side = (np.arange(_DISC_POINTS) + 0.5) / _DISC_POINTS
    share, turn = (grid.ravel() for grid in np.meshgrid(side, side))
    for emitter in scene.emitters:
        if isinstance(emitter, Patch):
            continue  # POV-Ray has it as a point too
        axis = np.asarray(emitter.axis)
        first = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
        first = first / np.linalg.norm(first)
        ring = np.outer(np.cos(2 * np.pi * turn), first) + np.outer(np.sin(2 * np.pi * turn), np.cross(axis, first))
        disc = np.asarray(emitter.position) + emitter.radius * np.sqrt(share)[:, np.newaxis] * ring
        whole = np.mean([_irradiance(emitter, place, hits) for place in disc], axis=0)
        total += (whole - _irradiance(emitter, np.asarray(emitter.position), hits)) * reflectance / math.pi
    return total * hits.cos4


def _reflectance(material: Material | None) -> float:
    return material.reflectance if isinstance(material, Lambertian) else 0.0


def _irradiance(emitter: Emitter, place: Array, hits: _Hits) -> Array:
    """Irradiance by all of a source's radiant intensity from one place [W m^-2]."""
    away = place - hits.points
    distance = np.maximum(np.linalg.norm(away, axis=1), 1e-300)
    cosine = np.maximum((away * hits.normals).sum(axis=1) / distance, 0.0)
    theta = np.arccos(np.clip(-(away @ np.asarray(emitter.axis)) / distance, -1.0, 1.0))
    irradiance: Array = emitter.radiant_intensity * emitter.beam.relative_intensity(theta) * cosine / distance**2
    return irradiance
