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
from typing import Final, assert_never

import numpy as np

from radwrap.errors import InputError
from radwrap.frames import Vector, cross, dot, subtract
from radwrap.scene.camera import Camera
from radwrap.scene.look.geometry import in_view
from radwrap.scene.look.probes import LIT_SHARE
from radwrap.scene.look.superposed import summed, superposed
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
from radwrap.scene.sources import Emitter, Luminaire, Patch
from radwrap.scene.targets import (
    DiscShape,
    DotBoard,
    EdgeTarget,
    MeshShape,
    PatternTarget,
    PolygonShape,
    SphereShape,
    Surface,
    Target,
    TubeShape,
)
from radwrap.scene.targets import surfaces as surfaces_of
from radwrap.tracers.povray_included import included_text
from radwrap.tracers.text_frame import TextFrame

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


def povray_scene(scene: Scene, included: Mapping[str, str], frame: TextFrame, *, area_samples: int = 0) -> str:
    """Write what is there, without a camera.

    Parameters
    ----------
    scene : Scene
        What is there.
    included : Mapping[str, str]
        Target name -> checked Radiance text of an included file, moved to its pose in the text's frame.
    frame : TextFrame
        Origin and unit of the text.
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
    scene = divided(scene)
    _check(scene, frame)
    parts = [_HEADER.format(unit=frame.length)]
    skies = scene.surrounds
    if skies:
        parts.append(f"background {{ color rgb {_number(math.fsum(sky.radiance for sky in skies))}*Scale }}\n")
    for group in superposed(scene.emitters):
        parts.append(_light(scene, summed(group), frame, area_samples))
    # By numbers: POV-Ray's identifiers hold no "-" and 40 characters, and words of its own may stand among ours.
    words = {name: f"Material{number}" for number, name in enumerate(scene.materials)}
    for name, material in scene.materials.items():
        if any(surface.material == name for surface in scene.surfaces):
            parts.append(f"#declare {words[name]} = {_texture(material, f'{scene.origin}: materials.{name}')}")
    for target in scene.targets:
        parts.append(f"// {target.name}")
        if target.name in included:
            parts.append(included_text(included[target.name], f'{scene.origin}: target "{target.name}"'))
        else:
            parts += _target(target, scene.camera, frame, words)
    return "\n".join(parts)


def povray_camera(camera: Camera, opening_point: tuple[float, float], frame: TextFrame) -> str:
    """The view through a point of the opening: `direction`, `right` and `up` are not at right angles.

    Parameters
    ----------
    camera : Camera
        Pose, focal length, pixels.
    opening_point : tuple of float
        (u, v) in the pinhole plane, camera's x and y [m].
    frame : TextFrame
        Origin and unit of the scene's text.
    """
    sensor, pose = camera.sensor, camera.pose
    u, v = opening_point
    x, y, z = (np.asarray(axis) for axis in (pose.x_axis, pose.y_axis, pose.z_axis))
    place = np.asarray(frame.point(pose.position)) + (u * x + v * y) * frame.units
    # The middle of the sensor, which need not be the principal point.
    across = ((sensor.columns - 1) / 2 - camera.principal_point[0]) * sensor.pixel_width + camera.shear * u
    down = ((sensor.rows - 1) / 2 - camera.principal_point[1]) * sensor.pixel_height + camera.shear * v
    middle = camera.image_distance * z + across * x + down * y
    # Lengths of the window do not matter; in units of the image's distance they are of the order of 1.
    window = {"direction": middle, "right": sensor.width * x, "up": -sensor.height * y}
    words = [f"{key} {_vector(value / camera.image_distance)}" for key, value in window.items()]
    return f"camera {{ perspective location {_vector(place)} {' '.join(words)} }}\n"


def _check(scene: Scene, frame: TextFrame) -> None:
    if scene.camera.distortion is not None:
        raise InputError(
            "POV-Ray's camera has no distortion",
            where=f"{scene.origin}: camera.distortion",
            remedy="leave it out, and the calibration",
        )
    if scene.camera.sensor.window is not None:
        raise InputError(
            "POV-Ray's pixels are sensitive all over, this sensor's are not",
            where=f"{scene.origin}: camera.sensor",
            remedy="leave out fill_width, fill_height and sensitivity_across, sensitivity_down",
        )
    points = [scene.camera.pose.position, *(emitter.position for emitter in scene.emitters)]
    points += [point for surface in scene.surfaces for point in _corners(surface)]
    if max(abs(value) for point in points for value in frame.point(point)) > _FARTHEST:
        raise InputError(
            f"spans more than {_FARTHEST * frame.length:g} m, where POV-Ray loses it",
            where=scene.origin,
            remedy="make it smaller, or move the scene to the origin",
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
        case DiscShape(centre) | SphereShape(centre):
            return (centre,)


def _number(value: float) -> str:
    return repr(float(value) + 0.0)


def _vector(values: Vector | np.ndarray) -> str:
    return f"<{', '.join(_number(value) for value in values)}>"


def _light(scene: Scene, emitter: Emitter, frame: TextFrame, area_samples: int) -> str:
    where = f'{scene.origin}: source "{emitter.name}"'
    position = np.asarray(frame.point(emitter.position))
    axis = np.asarray(emitter.axis)
    colour = emitter.radiant_intensity / (2 * math.pi * (_FADE * frame.length) ** 2)
    words = [f"{_vector(position)} color rgb {_number(colour)}*Scale", _spot(emitter, position + 1000 * axis, where)]
    words.append(f"fade_distance {_number(_FADE)} fade_power 2")
    if area_samples and not isinstance(emitter, Patch):
        first = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
        first = first / np.linalg.norm(first)
        # POV-Ray's grid reaches from rim to rim; as much smaller it has the second moment of the disc.
        size = 2 * emitter.radius * frame.units * math.sqrt((area_samples - 1) / (area_samples + 1))
        sides = f"{_vector(first * size)}, {_vector(np.cross(axis, first) * size)}, {area_samples}, {area_samples}"
        words.append(f"area_light {sides} circular area_illumination on")
    return f"// {emitter.name}\nlight_source {{ {' '.join(words)} }}\n" + _disc(scene, emitter, frame, where)


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
        case _:
            assert_never(beam.profile)
    return (
        f"spotlight point_at {_vector(towards)} radius {_number(rim)} falloff {_number(rim)} tightness {_number(power)}"
    )


def _disc(scene: Scene, emitter: Emitter, frame: TextFrame, where: str) -> str:
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
        return _patch(emitter, frame, outer)
    radius = _number(emitter.radius * frame.units)
    place = f"{_vector(frame.point(emitter.position))}, {_vector(emitter.axis)}, {radius}"
    return f"disc {{ {place} {outer} }}\n"


def _patch(patch: Patch, frame: TextFrame, texture: str) -> str:
    """Triangles, of which POV-Ray knows front and back; of polygons it does not."""
    count = len(patch.corners)
    corners = ", ".join(_vector(frame.point(corner)) for corner in patch.corners)
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
        case Anisotropic() | Mirror() | Glass() | MeasuredBrdf() | PrintedImage():
            raise InputError(
                f"POV-Ray is not asked for a material of this kind ({type(material).__name__})",
                where=where,
                remedy="use lambertian, or specular of one roughness",
            )
        case PerturbedNormal() | CoefficientTable() | GlassBeads() | PrintedSheeting():
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


def _target(target: Target, camera: Camera, frame: TextFrame, words: Mapping[str, str]) -> Iterator[str]:
    """Surfaces; what lies on another one of the same target is lifted to the side that the eye is on."""
    lift = np.zeros(3)
    if isinstance(target, DotBoard | EdgeTarget | PatternTarget):
        normal = target.pose.z_axis
        side = dot(subtract(camera.pose.position, target.pose.position), normal)
        lift = np.asarray(normal) * math.copysign(_LIFT, side)
    for surface in surfaces_of(target):
        texture = f"texture {{ {words[surface.material]} }}"
        yield _geometry(surface, frame, lift if surface.is_decal else np.zeros(3), texture)


def _geometry(surface: Surface, frame: TextFrame, lift: np.ndarray, texture: str) -> str:

    def at(point: Vector) -> str:
        return _vector(np.asarray(frame.point(point)) + lift)

    match surface.shape:
        case PolygonShape(vertices):
            corners = ", ".join(map(at, (*vertices, vertices[0])))
            return f"polygon {{ {len(vertices) + 1}, {corners} {texture} }}"
        case MeshShape(vertices, faces):
            places = ", ".join(map(_vector, (frame.points(vertices) + lift)))
            corners = ", ".join(f"<{a}, {c}, {b}>" for a, b, c in faces.tolist())
            lists = f"vertex_vectors {{ {len(vertices)}, {places} }} face_indices {{ {len(faces)}, {corners} }}"
            return f"mesh2 {{ {lists} {texture} }}"
        case DiscShape(centre, normal, radius):
            return f"disc {{ {at(centre)}, {_vector(normal)}, {_number(radius * frame.units)} {texture} }}"
        case SphereShape(centre, radius):
            return f"sphere {{ {at(centre)}, {_number(radius * frame.units)} {texture} }}"
        case TubeShape(start, end, radius):
            return f"cylinder {{ {at(start)}, {at(end)}, {_number(radius * frame.units)} open {texture} }}"
