"""A scene as POV-Ray 3.7 text, the second opinion beside Radiance.

POV-Ray knows no radiometry. A light of colour C that fades gives a diffuse
surface of share rho the value rho C cos(beta) 2/(1 + (d/D)^2), D being the
fade distance, without Radiance's 1/pi. With D far below every d that is
2 rho C cos(beta) D^2/d^2, so C = I/(2 pi D^2) makes the value a radiance,
L = rho/pi I cos(beta)/d^2. A spotlight multiplies C by cos(theta)^n.

A highlight of POV-Ray is S C' cos(delta)^n with delta between the normal and
the bisector of eye and light. n = 2/a^2 has the curvature of the Gaussian
exp(-tan^2(delta)/a^2) of Radiance, and S = rho_s/(4 a^2) its height at normal
incidence; `highlights` tells what is left between the two.

What POV-Ray cannot express is refused by name.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np

from radwrap.errors import InputError
from radwrap.frames import Vector, cross, dot, subtract
from radwrap.scene.camera import Camera
from radwrap.scene.geometry import in_view
from radwrap.scene.materials import Lambertian, Material, PrintedSheeting, Sheeting, Specular
from radwrap.scene.probes import LIT_SHARE
from radwrap.scene.scene import Scene
from radwrap.scene.sight import shared_planes
from radwrap.scene.sources import Emitter, Luminaire, Patch, WideSource
from radwrap.scene.targets import (
    DiscShape,
    DotBoard,
    EdgeTarget,
    MeshShape,
    PolygonShape,
    SphereShape,
    Surface,
    Target,
    TubeShape,
)
from radwrap.scene.targets import surfaces as surfaces_of
from radwrap.tracers.povray_included import included_text
from radwrap.tracers.radiance_text import scales_of

# Fade distance in units of length, which are mm: light from nearer than 1 unit would be off by 1e-8.
_FADE: Final = 1e-4
# Of surfaces in one plane POV-Ray shows either; the later one is lifted by so many units towards the eye. As little as
# possible: a hundred times more, and one ray of 57 000 fell on the other side of a dot's rim.
_LIFT: Final = 1e-6
# POV-Ray sees nothing beyond 1e7 units.
_FARTHEST: Final = 1e6

_HEADER: Final = """\
// POV-Ray 3.7 scene written by radwrap. Lengths in units of {unit:g} m; values are radiances in W/m^2/sr times Scale.
global_settings {{ assumed_gamma 1.0 max_trace_level 32 adc_bailout 0 ambient_light rgb 0 }}
#default {{ finish {{ ambient 0 diffuse 0 emission 0 }} }}
background {{ color rgb 0 }}
"""


def povray_scene(scene: Scene, included: Mapping[str, str], *, area_samples: int = 0) -> str:
    """Write what is there, without a camera.

    Parameters
    ----------
    scene : Scene
        What is there.
    included : Mapping[str, str]
        Target name -> checked Radiance text of an included file, moved to its pose, in units of `scales_of`.
    area_samples : int
        0: each source shines from its centre, as Radiance's does here; n: from n x n points of its disc.

    Returns
    -------
    str
        Text that needs ``#declare Scale`` and a camera before it.

    Raises
    ------
    InputError
        Naming what POV-Ray cannot express.
    """
    _check(scene)
    unit = scales_of(scene).length
    parts = [_HEADER.format(unit=unit)]
    for source in scene.sources:
        if isinstance(source, WideSource) and source.kind == "surround":
            parts.append(f"background {{ color rgb {_number(source.radiance)}*Scale }}\n")
    for emitter in scene.emitters:
        if emitter.radiance > 0:
            parts.append(_light(scene, emitter, unit, area_samples))
    for name, material in scene.materials.items():
        if any(surface.material == name for surface in scene.surfaces):
            parts.append(f"#declare {_identifier(name)} = {_texture(material, f'{scene.origin}: materials.{name}')}")
    for target in scene.targets:
        if target.name in included:
            parts.append(included_text(included[target.name], f'{scene.origin}: target "{target.name}"'))
        else:
            parts += _target(target, scene.camera, unit)
    return "\n".join(parts)


def povray_camera(camera: Camera, opening_point: tuple[float, float], unit: float) -> str:
    """The view through a point of the opening: `direction`, `right` and `up` are not at right angles.

    Parameters
    ----------
    camera : Camera
        Pose, focal length, pixels.
    opening_point : tuple of float
        (u, v) in the pinhole plane, camera's x and y [m].
    unit : float
        Unit of length [m].
    """
    sensor, pose = camera.sensor, camera.pose
    u, v = opening_point
    x, y, z = (np.asarray(axis) for axis in (pose.x_axis, pose.y_axis, pose.z_axis))
    place = np.asarray(pose.position) + u * x + v * y
    # The middle of the sensor, which need not be the principal point.
    across = ((sensor.columns - 1) / 2 - camera.principal_point[0]) * sensor.pixel_width + u
    down = ((sensor.rows - 1) / 2 - camera.principal_point[1]) * sensor.pixel_height + v
    middle = camera.focal_length * z + across * x + down * y
    # Lengths of the window do not matter; in units of the focal length they are of the order of 1.
    window = {"direction": middle, "right": sensor.width * x, "up": -sensor.height * y}
    words = [f"{key} {_vector(value / camera.focal_length)}" for key, value in window.items()]
    return f"camera {{ perspective location {_vector(place / unit)} {' '.join(words)} }}\n"


def _check(scene: Scene) -> None:
    for line in shared_planes(scene):
        raise InputError(
            f"{line.split(': ')[0]}, and of such POV-Ray shows either", where=scene.origin, remedy="move one of them"
        )
    unit = scales_of(scene).length
    points = [scene.camera.pose.position, *(emitter.position for emitter in scene.emitters)]
    points += [point for surface in scene.surfaces for point in _corners(surface)]
    if max(abs(value) for point in points for value in point) > _FARTHEST * unit:
        raise InputError(
            f"lies beyond {_FARTHEST * unit:g} m from the origin, where POV-Ray loses it",
            where=scene.origin,
            remedy="move the scene to the origin, or make it smaller",
        )


def _corners(surface: Surface) -> tuple[Vector, ...]:
    match surface.shape:
        case PolygonShape(vertices):
            return vertices
        case TubeShape(start, end, _):
            return start, end
        case MeshShape(vertices, _):
            low, high = vertices.min(axis=0), vertices.max(axis=0)
            return (low[0], low[1], low[2]), (high[0], high[1], high[2])
        case _:
            return (surface.shape.centre,)


def _identifier(name: str) -> str:
    """A POV-Ray identifier; names of scenes may hold "-", and words of POV-Ray's own."""
    return f"Material_{name.replace('-', '_M_')}"


def _number(value: float) -> str:
    return repr(float(value) + 0.0)


def _vector(values: Vector | np.ndarray) -> str:
    return f"<{', '.join(_number(value) for value in values)}>"


def _light(scene: Scene, emitter: Emitter, unit: float, area_samples: int) -> str:
    where = f'{scene.origin}: source "{emitter.name}"'
    position = np.asarray(emitter.position) / unit
    axis = np.asarray(emitter.axis)
    colour = emitter.radiant_intensity / (2 * math.pi * (_FADE * unit) ** 2)
    words = [f"{_vector(position)} color rgb {_number(colour)}*Scale", _spot(emitter, position + 1000 * axis, where)]
    words.append(f"fade_distance {_number(_FADE)} fade_power 2")
    if area_samples and not isinstance(emitter, Patch):
        first = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
        first = first / np.linalg.norm(first)
        # POV-Ray's grid reaches from rim to rim; as much smaller it has the second moment of the disc.
        size = 2 * emitter.radius / unit * math.sqrt((area_samples - 1) / (area_samples + 1))
        sides = f"{_vector(first * size)}, {_vector(np.cross(axis, first) * size)}, {area_samples}, {area_samples}"
        words.append(f"area_light {sides} circular area_illumination on")
    return f"// {emitter.name}\nlight_source {{ {' '.join(words)} }}\n" + _disc(scene, emitter, unit, where)


def _spot(emitter: Emitter, towards: np.ndarray, where: str) -> str:
    beam = emitter.beam
    if isinstance(emitter, Luminaire):
        raise InputError("POV-Ray has no luminaire of a table", where=f"{where}.file", remedy="use a lamp with a beam")
    match beam.profile:
        case "lambertian":
            rim, power = 90.0, 1.0
        case "cosine_power":
            rim, power = 90.0, beam.spread**-2
        case "cone":
            rim, power = math.degrees(beam.spread), 0.0
        case "table":
            raise InputError(
                "POV-Ray has no beam of a table", where=f"{where}.beam", remedy='use profile = "cosine_power"'
            )
        case "gaussian":
            raise InputError(
                "POV-Ray has no Gaussian beam",
                where=f"{where}.beam",
                remedy='use profile = "cosine_power", or let `radwrap crosscheck` put it in its place',
            )
    return (
        f"spotlight point_at {_vector(towards)} radius {_number(rim)} falloff {_number(rim)} tightness {_number(power)}"
    )


def _disc(scene: Scene, emitter: Emitter, unit: float, where: str) -> str:
    """The disc of a source: it hides what is behind it, and shines to its front where its radiance is even."""
    eye = scene.camera.pose.position
    seen = bool(in_view(scene.camera, np.array([emitter.position]))[0])
    facing = dot(subtract(eye, emitter.position), emitter.axis) > 0
    even = emitter.beam.profile == "lambertian"
    if seen and facing and not even and emitter.relative_intensity_at(np.array([eye]))[0] > LIT_SHARE:
        raise InputError(
            f"its disc is in view: POV-Ray has none that shines with a {emitter.beam.profile} beam",
            where=where,
            remedy="turn it away, or move it out of view",
        )
    front = f"pigment {{ color rgb {_number(emitter.radiance)}*Scale }} finish {{ emission 1 }}"
    black = "pigment { color rgb 0 }"
    outer = f"texture {{ {front if even else black} }} interior_texture {{ {black} }}"
    if isinstance(emitter, Patch):
        return _patch(emitter, unit, outer)
    place = f"{_vector(np.asarray(emitter.position) / unit)}, {_vector(emitter.axis)}, {_number(emitter.radius / unit)}"
    return f"disc {{ {place} {outer} }}\n"


def _patch(patch: Patch, unit: float, texture: str) -> str:
    """Triangles, of which POV-Ray knows front and back; of polygons it does not."""
    count = len(patch.corners)
    corners = ", ".join(_vector(np.asarray(corner) / unit) for corner in patch.corners)
    turns = [cross(subtract(b, a), subtract(c, b)) for a, b, c in _corners_in_turn(patch)]
    if all(dot(turn, patch.axis) >= 0 for turn in turns):
        faces = [(count - 1, i, i + 1) for i in range(count - 2)]
    else:  # a sector about a hole: its outer arc there, its inner one back
        quads = [(i, i + 1, count - 2 - i, count - 1 - i) for i in range(count // 2 - 1)]
        faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
    words = ", ".join(f"<{a}, {c}, {b}>" for a, b, c in faces)
    return f"mesh2 {{ vertex_vectors {{ {count}, {corners} }} face_indices {{ {len(faces)}, {words} }} {texture} }}\n"


def _corners_in_turn(patch: Patch) -> Iterator[tuple[Vector, Vector, Vector]]:
    first = patch.corners
    second = first[1:] + first[:1]
    return zip(first, second, second[1:] + second[:1], strict=True)


def _texture(material: Material, where: str) -> str:
    match material:
        case Lambertian(reflectance):
            return diffuse_texture(reflectance)
        case Specular(diffuse, specular, roughness):
            power, height = highlight(specular, roughness)
            return (
                f"texture {{ pigment {{ color rgb 1 }} finish {{ diffuse {_number(diffuse)} "
                f"specular {_number(height)} roughness {_number(1 / power)} }} }}\n"
            )
    if not isinstance(material, Sheeting | PrintedSheeting):
        raise InputError(
            f"POV-Ray is not asked for a material of this kind ({type(material).__name__})",
            where=where,
            remedy="use lambertian, or specular of one roughness",
        )
    raise InputError(
        "POV-Ray has no retroreflection: sheeting cannot be checked by it",
        where=where,
        remedy="check the geometry of retroreflection by corner cubes, see rad_scenes/crosscheck/corner_cubes",
    )


def diffuse_texture(reflectance: float) -> str:
    """Texture of a Lambertian surface."""
    return f"texture {{ pigment {{ color rgb 1 }} finish {{ diffuse {_number(reflectance)} }} }}\n"


def highlight(specular_reflectance: float, roughness: float) -> tuple[float, float]:
    """Power n of the cosine and height S of the highlight that stands for a lobe of width `roughness`."""
    return 2 / roughness**2, specular_reflectance / (4 * roughness**2)


def _target(target: Target, camera: Camera, unit: float) -> Iterator[str]:
    """Surfaces; what lies on another one of the same target is lifted to the side that the eye is on."""
    lift = np.zeros(3)
    if isinstance(target, DotBoard | EdgeTarget):
        normal = target.pose.z_axis
        side = dot(subtract(camera.pose.position, target.pose.position), normal)
        lift = np.asarray(normal) * math.copysign(_LIFT, side)
    yield f"// {target.name}"
    for surface in surfaces_of(target):
        yield _geometry(surface, unit, lift if surface.part != "surface" else np.zeros(3))


def _geometry(surface: Surface, unit: float, lift: np.ndarray) -> str:
    texture = f"texture {{ {_identifier(surface.material)} }}"

    def at(point: Vector) -> str:
        return _vector(np.asarray(point) / unit + lift)

    match surface.shape:
        case PolygonShape(vertices):
            corners = ", ".join(map(at, (*vertices, vertices[0])))
            return f"polygon {{ {len(vertices) + 1}, {corners} {texture} }}"
        case MeshShape(vertices, faces):
            places = ", ".join(map(_vector, (vertices / unit + lift)))
            corners = ", ".join(f"<{a}, {c}, {b}>" for a, b, c in faces.tolist())
            lists = f"vertex_vectors {{ {len(vertices)}, {places} }} face_indices {{ {len(faces)}, {corners} }}"
            return f"mesh2 {{ {lists} {texture} }}"
        case DiscShape(centre, normal, radius):
            return f"disc {{ {at(centre)}, {_vector(normal)}, {_number(radius / unit)} {texture} }}"
        case SphereShape(centre, radius):
            return f"sphere {{ {at(centre)}, {_number(radius / unit)} {texture} }}"
        case TubeShape(start, end, radius):
            return f"cylinder {{ {at(start)}, {at(end)}, {_number(radius / unit)} open {texture} }}"
