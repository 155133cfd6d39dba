"""A scene in Mitsuba's words, as far as it has them: what `mitsuba.load_dict` takes, with matrices as lists.

Lengths are in mm: Mitsuba moves the start of a shadow ray by a share of the
unit. Radiances stay W m^-2 sr^-1, so an intensity [W sr^-1] is that of mm.

What is not the same, and is why each renderer is held against its own
converged image: Ward's lobe becomes a Beckmann lobe of the same slope, sheeting
becomes Lambertian with the brightness that the scene's middle has, and a
pinhole loses its diameter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import trimesh
from numpy.typing import NDArray

from radwrap.frames import Pose, Vector, aim, dot, normalised
from radwrap.images import write_exr
from radwrap.scene.camera import Camera
from radwrap.scene.materials import Lambertian, Material, PerturbedNormal, Specular
from radwrap.scene.scene import Scene
from radwrap.scene.sources import Emitter, WideSource, emitters, half_width
from radwrap.scene.targets import DiscShape, MeshShape, PolygonShape, Shape, SphereShape, Surface, TubeShape, surfaces
from radwrap.scene.wide_shapes import Annulus, Rectangle, Zone

Array = NDArray[np.float64]
Entry = dict[str, Any]

MM: Final = 1e3  # a metre
_LIFT: Final = 0.02  # mm, of what is painted on a surface and lies in its plane
_WIDEST_SPOT: Final = math.radians(80)  # its picture lies in a plane before it
_SPOT_WIDTHS: Final = 4  # half widths of a beam that are kept
_SPOT_PIXELS: Final = 1024
_TURN_SIDES, _ARC_SIDES = 384, 96
_BLACK: Final[Entry] = {"type": "diffuse", "reflectance": 0.0}


class NotTranslated(Exception):
    """A scene holds what this translation has no words for."""


def translated(scene: Scene, folder: Path, *, bounces: bool = False) -> Entry:
    """A scene for `mitsuba.load_dict`.

    Parameters
    ----------
    scene : Scene
        What is seen.
    folder : Path
        Takes meshes and pictures of beams.
    bounces : bool
        Whether light goes from surface to surface.

    Raises
    ------
    NotTranslated
        If the scene holds what has no translation here.
    """
    lights = _lights(scene, folder)
    shapes = {
        f"{'decal' if surface.is_decal else 'shape'}_{number}": _surface(surface, scene, folder, f"shape_{number}")
        for number, surface in enumerate(surface for target in scene.targets for surface in surfaces(target))
    }
    return {
        "type": "scene",
        "integrator": _integrator(lights, bounces=bounces),
        "sensor": sensor(scene.camera),
        **lights,
        **shapes,
    }


def _integrator(lights: dict[str, Entry], *, bounces: bool) -> Entry:
    if bounces:
        return {"type": "path", "max_depth": -1}
    # A spot has no area that a ray of the material's lobe could meet.
    points = all(light["type"] == "spot" for light in lights.values())
    return {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0 if points else 1}


def sensor(camera: Camera) -> Entry:
    """The camera: a thin lens, or a pinhole without a diameter.

    Raises
    ------
    NotTranslated
        If its pixels are not square, its axis is off the sensor's centre, or it distorts.
    """
    chip = camera.sensor
    centre = ((chip.columns - 1) / 2, (chip.rows - 1) / 2)
    if not math.isclose(chip.pixel_width, chip.pixel_height, rel_tol=1e-9):
        raise NotTranslated("the pixels are not square")
    if camera.distortion is not None or any(
        abs(a - b) > 1e-9 for a, b in zip(camera.principal_point, centre, strict=True)
    ):
        raise NotTranslated("the camera distorts, or its axis is off the sensor's centre")
    entry: Entry = {
        "type": "perspective",
        "fov_axis": "x",
        "fov": 2 * math.degrees(math.atan(chip.width / 2 / camera.image_distance)),
        "near_clip": 1.0,
        "far_clip": 1e5,
        "to_world": _matrix(_mitsuba_axes(camera.pose), camera.pose.position),
        "film": {
            "type": "hdrfilm",
            "width": chip.columns,
            "height": chip.rows,
            "pixel_format": "luminance",
            "component_format": "float32",
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": "independent"},
    }
    if camera.lens is not None:
        entry |= {
            "type": "thinlens",
            "aperture_radius": camera.aperture.diameter / 2 * MM,
            "focus_distance": camera.lens.focus_distance * MM,
        }
    return entry


def _mitsuba_axes(pose: Pose) -> Array:
    """Its cameras have x to the left and y up."""
    return np.asarray(pose.rotation) * [-1.0, -1.0, 1.0]


def _matrix(rotation: Array, position: Vector | Array, scale: Sequence[float] = (1.0, 1.0, 1.0)) -> list[list[float]]:
    """Of homogeneous coordinates; the position is in m, scales are in mm."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation * np.asarray(scale)
    matrix[:3, 3] = np.asarray(position) * MM
    return matrix.tolist()


def _lights(scene: Scene, folder: Path) -> dict[str, Entry]:
    lights: dict[str, Entry] = {}
    for source in scene.sources:
        if isinstance(source, WideSource):
            lights[f"light_{len(lights)}"] = _wide(source, folder, f"light_{len(lights)}")
            continue
        for emitter in emitters(source):
            lights[f"light_{len(lights)}"] = _disc_light(emitter, folder)
    return lights


def _wide(source: WideSource, folder: Path, name: str) -> Entry:
    if source.kind == "surround" or source.beam.profile != "lambertian":
        raise NotTranslated(f"source {source.name}: only surfaces of even radiance")
    shape, rotation = source.shape, np.asarray(source.pose.rotation)
    light: Entry = {"bsdf": _BLACK, "emitter": {"type": "area", "radiance": source.radiance}}
    if isinstance(shape, Rectangle):
        size = (shape.width / 2 * MM, shape.height / 2 * MM, 1.0)
        return {"type": "rectangle", "to_world": _matrix(rotation, source.pose.position, size), **light}
    if isinstance(shape, Annulus) and shape.inner_radius == 0:
        radius = shape.radius * MM
        return {"type": "disk", "to_world": _matrix(rotation, source.pose.position, (radius, radius, 1.0)), **light}
    points, faces = wide_mesh(shape)
    return {**_ply(points @ rotation.T + source.pose.position, faces, folder / f"{name}.ply"), **light}


def wide_mesh(shape: Annulus | Zone) -> tuple[Array, NDArray[np.intp]]:
    """Triangles of a ring or of a dome in its own frame, counter-clockwise from where it shines to [m]."""
    turn = 2 * np.pi * np.arange(_TURN_SIDES) / _TURN_SIDES
    if isinstance(shape, Annulus):
        radii, heights = np.array([shape.radius, shape.inner_radius]), np.zeros(2)
    else:
        polar = np.linspace(shape.least, shape.most, _ARC_SIDES + 1)
        radii, heights = shape.radius * np.sin(polar), -shape.radius * np.cos(polar)
    rows = len(radii)
    points = np.stack(
        [
            np.outer(radii, np.cos(turn)).ravel(),
            np.outer(radii, np.sin(turn)).ravel(),
            np.repeat(heights, _TURN_SIDES),
        ],
        axis=1,
    )
    grid = np.arange(rows * _TURN_SIDES).reshape(rows, _TURN_SIDES)
    here, after = grid, np.roll(grid, -1, axis=1)
    a, b, c, d = (part.ravel() for part in (here[:-1], after[:-1], after[1:], here[1:]))
    if isinstance(shape, Zone):
        b, d = d, b  # shines inwards
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    area = trimesh.triangles.area(points[faces])
    return points, faces[area > 1e-12 * area.max()]


def _disc_light(emitter: Emitter, folder: Path) -> Entry:
    """A disc: where it is Lambertian with its area, else as a point with its beam."""
    pose = aim(emitter.position, _plus(emitter.position, emitter.axis))
    rotation = np.asarray(pose.rotation)
    if emitter.beam.profile == "lambertian":
        radius = emitter.radius * MM
        return {
            "type": "disk",
            "to_world": _matrix(rotation, emitter.position, (radius, radius, 1.0)),
            "bsdf": _BLACK,
            "emitter": {"type": "area", "radiance": emitter.radiance},
        }
    spot: Entry = {
        "type": "spot",
        "to_world": _matrix(rotation, emitter.position),
        "intensity": emitter.radiant_intensity * MM**2,
    }
    if emitter.beam.profile == "cone":
        # Mitsuba's spots fall off between two angles.
        edge = math.degrees(emitter.beam.spread)
        return {**spot, "cutoff_angle": edge, "beam_width": 0.9999 * edge}
    widest = min(_WIDEST_SPOT, _SPOT_WIDTHS * half_width(emitter.beam))
    picture = folder / f"beam_{emitter.beam.profile}_{emitter.beam.spread:.9g}.exr"
    if not picture.exists():
        write_exr(picture, beam_picture(emitter, widest), channel="Y")
    edge = math.degrees(widest)
    texture = {"type": "bitmap", "filename": str(picture), "raw": True, "filter_type": "bilinear"}
    return {**spot, "cutoff_angle": edge, "beam_width": 0.9999 * edge, "texture": texture}


def beam_picture(emitter: Emitter, widest: float) -> NDArray[np.float32]:
    """I(theta)/I(0) in a plane before a point, out to an angle along its axes [rad], shape (n, n)."""
    edge = (np.arange(_SPOT_PIXELS) + 0.5) / _SPOT_PIXELS * 2 - 1
    slope = np.hypot(*np.meshgrid(edge, edge)) * math.tan(widest)
    return emitter.beam.relative_intensity(np.arctan(slope)).astype(np.float32)


def _surface(surface: Surface, scene: Scene, folder: Path, name: str) -> Entry:
    lift = _LIFT / MM if surface.is_decal else 0.0
    bsdf = {"type": "twosided", "of": bsdf_of(scene.materials[surface.material], scene)}
    return {**_shape(surface.shape, folder / f"{name}.ply", lift), "bsdf": bsdf}


def _shape(shape: Shape, file: Path, lift: float) -> Entry:
    match shape:
        case PolygonShape(vertices):
            points = np.asarray(vertices)
            corners = np.arange(1, len(points) - 1)
            faces = np.stack([np.zeros_like(corners), corners, corners + 1], axis=1)
            normals = np.cross(points[faces[:, 1]] - points[0], points[faces[:, 2]] - points[0])
            if (normals @ normals[0] <= 0).any():
                raise NotTranslated("a polygon that is not convex")
            return _ply(points + lift * normals[0] / np.linalg.norm(normals[0]), faces, file)
        case DiscShape(centre, normal, radius):
            rotation = np.asarray(aim((0.0, 0.0, 0.0), normal).rotation)
            place = np.asarray(centre) + lift * np.asarray(normal)
            return {"type": "disk", "to_world": _matrix(rotation, place, (radius * MM, radius * MM, 1.0))}
        case SphereShape(centre, radius):
            return {"type": "sphere", "center": [value * MM for value in centre], "radius": radius * MM}
        case TubeShape(start, end, radius):
            ends = {"p0": [value * MM for value in start], "p1": [value * MM for value in end]}
            return {"type": "cylinder", **ends, "radius": radius * MM}
        case MeshShape(vertices, faces):
            return _ply(vertices, faces, file)


def _ply(points: Array, faces: NDArray[np.intp], file: Path) -> Entry:
    """A mesh of places in m, with a normal for each face."""
    trimesh.Trimesh(points * MM, faces, process=False).export(file)
    return {"type": "ply", "filename": str(file), "face_normals": True}


def bsdf_of(material: Material, scene: Scene) -> Entry:
    """A material's nearest.

    Raises
    ------
    NotTranslated
        If there is none.
    """
    match material:
        case Lambertian(reflectance):
            return {"type": "diffuse", "reflectance": reflectance}
        case Specular(diffuse, specular, roughness):
            # A blend of two, so that a ray of the lobe goes to either by its share.
            total = diffuse + specular
            lobe = {
                "type": "roughconductor",
                "material": "none",
                "distribution": "beckmann",
                "alpha": roughness,
                "specular_reflectance": total,
            }
            plain = {"type": "diffuse", "reflectance": total}
            return {"type": "blendbsdf", "weight": specular / total, "below": plain, "lobe": lobe}
        case PerturbedNormal():
            return {"type": "diffuse", "reflectance": _as_bright(material, scene)}
        case _:
            raise NotTranslated(f"a material of kind {type(material).__name__}")


def _as_bright(material: PerturbedNormal, scene: Scene) -> float:
    """Reflectance of a diffuse surface as bright as sheeting in the scene's origin, lit straight on; often above 1."""
    to_camera = normalised(scene.camera.pose.position)
    to_light = normalised(scene.emitters[0].position)
    angle = math.acos(min(1.0, dot(to_camera, to_light)))
    lobe = math.exp(-((math.tan(angle / 2) / material.roughness) ** 2))
    return material.reflectance * lobe * math.cos(angle) / (4 * material.roughness**2 * math.cos(angle / 2) ** 6)


def _plus(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]
