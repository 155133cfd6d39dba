"""Meshes from files that nobody vouches for; the door to trimesh for scenes.

A mesh file is data: it runs nothing and opens nothing. It must lie in the
scene's folder, the counts in its header must fit its size, and materials or
textures that it names are not read.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import math
import re
import struct
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError, TracerError
from radwrap.extras import require
from radwrap.process import Programs
from radwrap.reading import FileKind, read_bytes, shortened
from radwrap.scene.mesh_files.glb_checks import check_glb
from radwrap.scene.mesh_files.mesh_texts import Polygons, read_obj, read_off
from radwrap.scene.mesh_files.normals import leaning
from radwrap.scene.mesh_files.polygons import checked, triangulated

Array = NDArray[np.float64]
Index = NDArray[np.intp]

SUFFIXES: Final = (".stl", ".obj", ".ply", ".off", ".glb", ".step", ".stp")
# glTF is in metres by its standard, and STEP files name their unit; the others hold bare numbers.
_IN_METRES: Final = frozenset({".glb", ".step", ".stp"})
MESH: Final = FileKind("mesh file", 1 << 30)
MOST_FACES: Final = 10_000_000
_LARGEST: Final = 1e9  # m
# Triangles of a smaller area, relative to the square of the mesh's size, show nothing and are left out.
_NO_AREA: Final = 1e-14
_MOST_DIGITS: Final = 18
_TOO_MANY: Final = 10**_MOST_DIGITS
_PLY_COUNT: Final = re.compile(rb"element\s+(\w+)\s+(\d+)")
_MATERIAL_FILE: Final = re.compile(rb"^[ \t]*mtllib[ \t]+(\S[^\r\n]*?)[ \t]*\r?$", re.MULTILINE)


@dataclass(frozen=True, slots=True, eq=False)
class PartFile:
    """What a mesh file holds.

    Attributes
    ----------
    groups : dict
        Name of the material, or of the body, -> (vertices [m], shape (n, 3); faces, shape (m, 3)).
    sha256 : str
        Of the file.
    material_files : tuple of str
        Files with materials that it names and that were not read.
    leaning : dict
        Group -> angle [rad] by which the normals of corners that an OBJ file gives lean against its flat faces.
    """

    groups: dict[str, tuple[Array, Index]]
    sha256: str
    material_files: tuple[str, ...] = ()
    leaning: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Cleaned:
    """What was left out of a mesh: numbers of triangles."""

    degenerate: int
    duplicate: int


def read_part_file(path: Path, *, folder: Path, length_unit: float | None, where: str) -> PartFile:
    """Read a mesh file.

    Parameters
    ----------
    path : Path
        .stl, .obj, .ply, .off, .glb, or .step where cascadio is installed.
    folder : Path
        Folder in which it must lie, symbolic links resolved.
    length_unit : float, optional
        Length of the file's unit [m]; must be given where the format has none, and only there.
    where : str
        What named the file, for messages.

    Raises
    ------
    InputError
        If it lies elsewhere, is not whole, or holds no triangles, NaN, or more than its size allows.
    EnvironmentFailure
        If it is STEP and cascadio is not installed.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f'"{path.name}" is not a mesh file', where=where, remedy=f"use {', '.join(SUFFIXES)}")
    unit = _unit(suffix, length_unit, path, where)
    content = _content(path, folder, where)
    _check_counts(suffix, content, where)
    names = tuple(name.decode(errors="replace") for name in _MATERIAL_FILE.findall(content)) if suffix == ".obj" else ()
    for name in names:
        _check_inside(name, path, where)
    found, leanings = _loaded(suffix, content, where)
    groups = {name: _scaled(vertices, faces, unit, where) for name, (vertices, faces) in found.items() if len(faces)}
    if not groups:
        raise InputError(f'"{path.name}" holds no triangles', where=where, remedy="name another file")
    return PartFile(groups, hashlib.sha256(content).hexdigest(), names, leanings)


def joined(groups: dict[str, tuple[Array, Index]]) -> tuple[Array, Index]:
    """All groups as one mesh."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in groups.values())])
    faces = [faces + start for (_, faces), start in zip(groups.values(), starts, strict=False)]
    return np.concatenate([vertices for vertices, _ in groups.values()]), np.concatenate(faces)


def cleaned(vertices: Array, faces: Index) -> tuple[Array, Index, Cleaned]:
    """A mesh with equal vertices joined, without triangles of no area and without repeated ones."""
    unique, inverse = np.unique(vertices, axis=0, return_inverse=True)
    faces = inverse.reshape(-1)[faces]
    corners = unique[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = float(np.ptp(vertices, axis=0).max())
    solid = np.linalg.norm(across, axis=1) / 2 > _NO_AREA * size**2
    whole = faces[solid]
    _, first = np.unique(np.sort(whole, axis=1), axis=0, return_index=True)
    kept = whole[np.sort(first)]
    return unique, kept, Cleaned(int((~solid).sum()), len(whole) - len(kept))


def _unit(suffix: str, length_unit: float | None, path: Path, where: str) -> float:
    if suffix in _IN_METRES:
        if length_unit is not None:
            raise InputError(f"{suffix} files have a unit of their own", where=where, remedy="leave length_unit out")
        return 1.0
    if length_unit is None:
        raise InputError(
            f'"{path.name}" does not say its unit of length', where=where, remedy='give `length_unit`, such as "1 mm"'
        )
    return length_unit


def _content(path: Path, folder: Path, where: str) -> bytes:
    try:
        real = path.resolve(strict=True)
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(f'no file "{path.name}"', where=where, remedy="name a file beside the scene") from error
    if not real.is_relative_to(folder.resolve()):
        raise InputError(f'"{path.name}" lies outside the folder', where=where, remedy="copy it there")
    return read_bytes(real, MESH, f'{where}: "{path.name}"', follow=False)


def _check_inside(name: str, path: Path, where: str) -> None:
    try:
        inside = (path.parent / name).resolve().is_relative_to(path.parent.resolve())
    except (OSError, RuntimeError, ValueError):  # links in a circle, a NUL, a name that is too long
        inside = False
    if Path(name).is_absolute() or not inside:
        raise InputError(
            f'"{path.name}" names the material file "{shortened(name)}", which is not a file in its folder',
            where=where,
            remedy="correct it",
        )


def _check_counts(suffix: str, content: bytes, where: str) -> None:
    """Refuse headers that claim more than the file can hold, before anybody makes room for it."""
    counts: list[int] = []
    match suffix:
        case ".stl" if not _is_text_stl(content):
            claimed = struct.unpack("<I", content[80:84])[0] if len(content) >= 84 else -1
            if len(content) != 84 + 50 * claimed:
                raise InputError("is not a complete STL file: its size does not fit its number of faces", where=where)
            counts = [claimed]
        case ".ply":
            found = _PLY_COUNT.findall(content[: content.find(b"end_header")])
            counts = [_TOO_MANY if len(count) > _MOST_DIGITS else int(count) for _, count in found]
    if any(count > min(len(content), 3 * MOST_FACES) for count in counts):
        raise InputError(f"claims {max(counts)} elements, more than it can hold", where=where, remedy="correct it")


def _is_text_stl(content: bytes) -> bool:
    return content[:5] == b"solid" and b"facet" in content[:1000]


def _loaded(suffix: str, content: bytes, where: str) -> tuple[dict[str, tuple[Array, Index]], dict[str, float]]:
    """Triangles by the name of their material, in the file's unit, and how far normals lean that are not used.

    Vertices that no triangle uses may be anything.
    """
    match suffix:
        case ".obj":
            vertices, groups, normals = read_obj(content, where)
            found = {name: (vertices, _triangles(vertices, faces, where)) for name, faces in groups.items()}
            return found, {name: leaning(vertices, faces, normals) for name, faces in groups.items()}
        case ".off":
            vertices, polygons = read_off(content, where)
            return {"part": (vertices, _triangles(vertices, polygons, where))}, {}
        case ".ply":
            vertices, polygons = _ply(content, where)
            return {"part": (vertices, _triangles(vertices, polygons, where))}, {}
    bodies: dict[str, dict[str, tuple[Array, Index]]] = {}
    for number, body in enumerate(_bodies(content, suffix[1:], where)):
        vertices, faces = np.asarray(body.vertices, dtype=np.float64), np.asarray(body.faces, dtype=np.intp)
        checked(vertices, faces.ravel(), where)
        name = _name_of(body) if suffix in _IN_METRES else "part"
        bodies.setdefault(name, {})[str(number)] = (vertices, faces)
    return {name: joined(parts) for name, parts in bodies.items()}, {}


def _triangles(vertices: Array, faces: Polygons, where: str) -> Index:
    if faces.triangles > MOST_FACES:
        raise _too_many(where)
    return triangulated(vertices, np.array(faces.corners, np.intp), np.array(faces.counts, np.intp), where)


def _too_many(where: str) -> InputError:
    return InputError(f"holds more than {MOST_FACES} triangles", where=where, remedy="simplify it")


def _bodies(content: bytes, kind: str, where: str) -> list[Any]:
    import trimesh

    if kind in ("step", "stp"):
        content, kind = _glb_of_step(content, where), "glb"
    if kind == "glb":
        check_glb(content, where)
    with _library(kind, where):
        scene = trimesh.load_scene(io.BytesIO(content), file_type=kind, process=False, resolver=None)
        # A mesh may stand in many places: they are counted before anybody makes room for them.
        placed = [scene.geometry[scene.graph[node][1]] for node in scene.graph.nodes_geometry]
    if sum(len(body.faces) for body in placed if isinstance(body, trimesh.Trimesh)) > MOST_FACES:
        raise _too_many(where)
    with _library(kind, where):
        return [body for body in scene.dump() if isinstance(body, trimesh.Trimesh)]


def _ply(content: bytes, where: str) -> tuple[Array, Polygons]:
    """Vertices and faces of a PLY file, as they stand in it: the library fans polygons, and does not count them."""
    from trimesh.exchange.ply import load_ply

    with _library("ply", where):
        found = load_ply(io.BytesIO(content), skip_materials=True)["metadata"]["_ply_raw"]
        if found.get("tristrips", {}).get("length"):
            raise ValueError("strips of triangles are not read here")
        vertices = np.column_stack([np.ravel(found["vertex"]["data"][axis]) for axis in "xyz"]).astype(np.float64)
        claims = {name: found[name]["length"] for name in found}
        faces = _ply_faces(found["face"]["data"]) if claims.get("face") else Polygons()
        if (claims["vertex"], claims.get("face", 0)) != (len(vertices), len(faces.counts)):
            raise ValueError("it holds less than it claims")
        head, _, body = content.partition(b"end_header")
        rows = sum(map(bool, map(bytes.strip, io.BytesIO(body))))
        if b"format ascii" in head and rows != sum(claims.values()):
            raise ValueError(f"it claims {sum(claims.values())} rows, and holds {rows}")
    return vertices, faces


def _ply_faces(data: Any) -> Polygons:
    names = data.dtype.names if isinstance(data, np.ndarray) else tuple(data)
    (name,) = [name for name in names if name in ("vertex_index", "vertex_indices")] or names[:1]
    lists = data[name]
    if isinstance(data, np.ndarray):
        lengths, lists = lists["f0"], lists["f1"].reshape(len(lists), -1)
        if (lengths != lists.shape[1]).any():
            raise ValueError("faces of different numbers of corners are read only from text")
    faces = Polygons()
    for corners in lists.tolist():
        faces.add(corners if isinstance(corners, list) else np.ravel(corners).tolist())
    return faces


@contextlib.contextmanager
def _library(kind: str, where: str) -> Iterator[None]:
    """Without a resolver no other file is opened. NaN and infinity are looked for afterwards."""
    try:
        with np.errstate(all="ignore"):
            yield
    except (MemoryError, RecursionError) as error:
        raise InputError("is too large for this machine's memory", where=where) from error
    except Exception as error:  # the library's parsers raise whatever a broken file makes them stumble over
        raise InputError(f"is not a complete {kind.upper()} file: {str(error)[:100]}", where=where) from error


def _glb_of_step(content: bytes, where: str) -> bytes:
    """A STEP file's triangles; in a process of its own, since a large C++ library reads a file nobody vouches for."""
    require("step", where)
    with tempfile.TemporaryDirectory(prefix="radwrap-") as folder, Programs() as programs:
        (Path(folder) / "part.step").write_bytes(content)
        made = Path(folder) / "part.glb"
        code = "import cascadio; cascadio.step_to_glb('part.step', 'part.glb')"
        try:
            programs.run([sys.executable, "-c", code], folder=Path(folder), environment={"LC_ALL": "C"})
        except TracerError as error:
            raise InputError(f"is not a complete STEP file: {error.what[-100:]}", where=where) from error
        if not made.is_file():
            raise InputError("is not a complete STEP file: it holds no shape", where=where)
        return made.read_bytes()


def _name_of(body: Any) -> str:
    material = getattr(getattr(body, "visual", None), "material", None)
    return str(getattr(material, "name", None) or body.metadata.get("name") or "part")


def _scaled(vertices: Array, faces: Index, unit: float, where: str) -> tuple[Array, Index]:
    """Vertices that are used [m], and faces that name them."""
    used = np.zeros(len(vertices), dtype=bool)
    used[faces.ravel()] = True
    number = np.cumsum(used) - 1
    vertices = vertices[used] * unit
    if float(np.abs(vertices).max()) > _LARGEST or not math.isfinite(float(np.ptp(vertices))):
        raise InputError(f"reaches beyond {_LARGEST:g} m", where=where, remedy="look at length_unit")
    return vertices, number[faces]
