"""A scene as a .glb file, to be looked at from all sides: shapes and reflectances, no light."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final, assert_never

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.files import make_folder, write_bytes
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
from radwrap.scene.mesh_files.polygons import ears
from radwrap.scene.scene import Scene
from radwrap.scene.targets import DiscShape, MeshShape, PolygonShape, Shape, SphereShape, TubeShape

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_ROUND: Final = 64  # corners of a circle
_SOURCE: Final = (255, 220, 90, 255)
# What is later in a plane is drawn this much nearer to its front [m].
_LIFT: Final = 2e-5


def write_preview(scene: Scene, path: Path) -> tuple[Path, ...]:
    """Write a scene's targets and sources as glTF binary, in metres.

    Raises
    ------
    InputError
        If it includes Radiance files, whose shapes are not known here.
    """
    trimesh = _library()
    if scene.included:
        raise InputError(
            f'the shapes of "{scene.included[0].name}", a Radiance file, are not known',
            where=scene.origin,
            remedy="a preview shows only targets of the scene file",
        )
    scene = divided(scene)
    preview = trimesh.Scene()
    for surface in scene.surfaces:
        lift = _LIFT if surface.is_decal else 0.0
        colour = colour_of(scene.materials[surface.material])
        _add(preview, surface.name, surface.shape, colour, lift)
    for emitter in scene.emitters:
        _add(preview, emitter.name, DiscShape(emitter.position, emitter.axis, emitter.radius), _SOURCE, 0.0)
    content: bytes = preview.export(file_type="glb")
    make_folder(path.parent)
    write_bytes(path, content)
    return (path,)


def _library() -> Any:
    """Trimesh, most of which has no types."""
    import trimesh

    return trimesh


def _add(preview: Any, name: str, shape: Shape, colour: tuple[int, int, int, int], lift: float) -> None:
    trimesh = _library()
    vertices, faces = triangles(shape)
    if lift:
        first = vertices[faces[0]]
        across = np.cross(first[1] - first[0], first[2] - first[0])
        vertices = vertices + lift * across / np.linalg.norm(across)
    material = trimesh.visual.material.PBRMaterial(
        name=name, baseColorFactor=colour, doubleSided=True, metallicFactor=0.0, roughnessFactor=1.0
    )
    body = trimesh.Trimesh(vertices, faces, process=False, visual=trimesh.visual.TextureVisuals(material=material))
    preview.add_geometry(body, node_name=name, geom_name=name)


def colour_of(material: Material) -> tuple[int, int, int, int]:
    """Red, green, blue and opacity of 255 that stand for a material: its reflectance, or a colour of its kind."""
    match material:
        case Lambertian(reflectance):
            share = reflectance
        case Specular(diffuse, specular, _) | Anisotropic(diffuse, specular, _, _):
            share = diffuse + specular
        case Mirror(reflectance):
            share = reflectance
        case Glass(transmittance, _):
            return (200, 220, 220, round(255 * (1 - transmittance)))
        case PrintedImage(_, rows):
            share = sum(map(sum, rows)) / (len(rows) * len(rows[0]))
        case MeasuredBrdf():
            share = 0.5  # only how it looks
        case PerturbedNormal() | CoefficientTable() | GlassBeads() | PrintedSheeting():
            return (140, 190, 255, 255)
        case _:
            assert_never(material)
    level = round(255 * min(share, 1.0))
    return (level, level, level, 255)


def triangles(shape: Shape) -> tuple[Array, Index]:
    """Vertices, shape (n, 3) [m], and numbers of each triangle's three, shape (m, 3); circles have 64 corners."""
    match shape:
        case MeshShape(vertices, faces):
            return vertices, faces
        case PolygonShape(vertices):
            corners = np.asarray(vertices)
            return corners, ears(corners)
        case DiscShape(centre, normal, radius):
            rim = np.asarray(centre) + radius * _circle(np.asarray(normal))
            return rim, _fan(len(rim))
        case SphereShape(centre, radius):
            return _sphere(np.asarray(centre), radius)
        case TubeShape(start, end, radius):
            axis = np.asarray(end) - np.asarray(start)
            circle = radius * _circle(axis / np.linalg.norm(axis))
            a = np.arange(_ROUND)
            b = (a + 1) % _ROUND
            sides = np.vstack([np.column_stack([a, b, b + _ROUND]), np.column_stack([a, b + _ROUND, a + _ROUND])])
            return np.vstack([circle + start, circle + end]), sides


def _circle(normal: Array) -> Array:
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    first = first / np.linalg.norm(first)
    angle = 2 * np.pi * np.arange(_ROUND) / _ROUND
    circle: Array = np.outer(np.cos(angle), first) + np.outer(np.sin(angle), np.cross(normal, first))
    return circle


def _fan(number: int) -> Index:
    after = np.arange(1, number - 1)
    return np.column_stack([np.zeros_like(after), after, after + 1])


def _sphere(centre: Array, radius: float) -> tuple[Array, Index]:
    ball = _library().creation.icosphere(subdivisions=3, radius=radius)
    return np.asarray(ball.vertices) + centre, np.asarray(ball.faces)
