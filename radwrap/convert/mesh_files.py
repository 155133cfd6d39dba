"""Mesh files as Radiance scenes: polygons, or Radiance's own compiled mesh; with a report of what was repaired."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.convert.radiance_files import side_stem
from radwrap.errors import InputError
from radwrap.files import make_folder, write_bytes
from radwrap.process import Programs
from radwrap.reading import check_regular
from radwrap.scene.materials import Lambertian, Material
from radwrap.scene.mesh_files.normals import told_of
from radwrap.scene.mesh_files.parts import MESH, PartFile, cleaned, read_part_file
from radwrap.scene.mesh_files.winding import wound
from radwrap.scene.targets import MeshShape
from radwrap.tracers.radiance import RadianceOptions, compiled_mesh
from radwrap.tracers.radiance_materials import material_text
from radwrap.tracers.radiance_text import function_file
from radwrap.tracers.text_frame import TextFrame

Array = NDArray[np.float64]
Index = NDArray[np.intp]

# What a mesh is made of where nobody says: middle gray.
DEFAULT_MATERIAL: Final = Lambertian(0.5)
_NOT_PLAIN: Final = re.compile(r"[^A-Za-z0-9_]+")
# Radiance's text holds no more; the compiled mesh does.
MOST_POLYGONS: Final = 200_000


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Triangles of one material, repaired.

    Attributes
    ----------
    name : str
        As the file has it.
    word : str
        The same as Radiance can hold it.
    vertices, faces : ndarray
        Corners [m] and triangles.
    report : dict
        Triangles left out and turned over, holes, volume [m^3] (None where there is no inside), area [m^2], bounds [m].
    warning : str, optional
        What a user should know of normals that are not used.
    """

    name: str
    word: str
    vertices: Array
    faces: Index
    report: dict[str, Any]
    warning: str | None = None


def read_groups(path: Path, length_unit: float | None) -> tuple[Group, ...]:
    """Read and repair a mesh file, group by group.

    Raises
    ------
    InputError
        See `read_part_file`; or if nothing with an area is left.
    """
    # Whoever names a file on the command line may name a link to it.
    check_regular(path, MESH)
    found = read_part_file(path, folder=path.resolve().parent, length_unit=length_unit, where=str(path))
    groups = tuple(
        _group(name, word, *found.groups[name], found.leaning.get(name, 0.0)) for name, word in _words(found).items()
    )
    groups = tuple(group for group in groups if len(group.faces))
    if not groups:
        raise InputError("its triangles have no area", where=str(path), remedy="name another file")
    return groups


def _words(found: PartFile) -> dict[str, str]:
    """Names that Radiance can hold, each its own."""
    words: dict[str, str] = {}
    for name in found.groups:
        word = base = _NOT_PLAIN.sub("_", name).strip("_")[:40] or "part"
        base = word = word if word[0].isalpha() else f"m_{word}"
        number = 2
        while word in words.values() or word == "void":
            word, number = f"{base}_{number}", number + 1
        words[name] = word
    return words


def _group(name: str, word: str, vertices: Array, faces: Index, leaning: float) -> Group:
    vertices, faces, left_out = cleaned(vertices, faces)
    if not len(faces):
        return Group(name, word, vertices, faces, {})
    order = wound(vertices, faces)
    corners = vertices[order.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    middle = vertices.mean(axis=0)
    volume = float(np.einsum("ij,ij->", corners.mean(axis=1) - middle, across)) / 6
    used = vertices[np.unique(order.faces)]
    report = {
        "triangles": len(order.faces),
        "left_out": asdict(left_out),
        "flipped": order.flipped,
        "bodies": order.bodies,
        "open_sides": order.open_sides,
        "holes": order.holes,
        "crowded_sides": order.crowded_sides,
        "volume_m3": volume if order.closed else None,
        "area_m2": float(np.linalg.norm(across, axis=1).sum()) / 2,
        "bounds_m": [used.min(axis=0).tolist(), used.max(axis=0).tolist()],
    }
    return Group(name, word, vertices, order.faces, report, told_of(name, leaning))


def write_mesh(
    groups: tuple[Group, ...],
    out: Path,
    materials: Mapping[str, Material],
    options: RadianceOptions,
    *,
    polygons: bool = False,
) -> tuple[Path, ...]:
    """Write groups as a Radiance scene in mm.

    Parameters
    ----------
    groups : tuple of Group
        What to write.
    out : Path
        The .rad file; compiled meshes and function files lie beside it, named after it.
    materials : Mapping[str, Material]
        Name of a group -> its material; `DEFAULT_MATERIAL` for others.
    options : RadianceOptions
        Which Radiance compiles.
    polygons : bool
        Write each triangle as a polygon, which any program reads, in place of a compiled mesh.

    Raises
    ------
    InputError
        If there are too many polygons, or a material is named that the mesh has not.
    """
    unknown = sorted(set(materials) - {group.name for group in groups})
    if unknown:
        raise InputError(
            f'the mesh has no material "{unknown[0]}"',
            where="materials",
            remedy=f"it has: {', '.join(group.name for group in groups)}",
        )
    number = sum(len(group.faces) for group in groups)
    if polygons and number > MOST_POLYGONS:
        raise InputError(f"{number} polygons are too many", where="polygons", remedy="leave it out")
    stem, frame = side_stem(out), TextFrame()
    functions, files = function_file(stem)
    parts = [f"# Radiance mesh written by radwrap. Lengths in mm.\n# {number} triangles\n"]
    with Programs() as programs, tempfile.TemporaryDirectory(prefix="radwrap-") as work:
        for group in groups:
            material = materials.get(group.name, DEFAULT_MATERIAL)
            text, data = material_text(group.word, f"{stem}.{group.word}", functions, material)
            files.update(data)
            parts.append(text)
            if polygons:
                parts.append(_polygon_text(group, frame))
                continue
            name = f"{stem}.{group.word}.rtm"
            shape = MeshShape(group.vertices, group.faces)
            files[name] = compiled_mesh(shape, frame, options, programs, Path(work), where=group.name)
            parts.append(f"{group.word} mesh {group.word}.mesh\n1 {name}\n0\n0\n")
    content = "\n".join(parts)
    make_folder(out.parent)
    # A function file that no material names is left out.
    needed = sorted(name for name in files if name in content)
    for name in needed:
        write_bytes(out.parent / name, files[name])
    write_bytes(out, content.encode())
    return (*(out.parent / name for name in needed), out)


def _polygon_text(group: Group, frame: TextFrame) -> str:
    corners = frame.points(group.vertices)[group.faces].reshape(-1, 9).tolist()
    return "".join(
        f"{group.word} polygon {group.word}.{number}\n0\n0\n9 {' '.join(map(repr, numbers))}\n"
        for number, numbers in enumerate(corners)
    )
