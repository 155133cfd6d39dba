"""OBJ and OFF files, face by face.

Mesh libraries fan polygons whatever their shape, and count vertices backwards
from the end of the file; so these two texts are read here.
"""

from __future__ import annotations

import io
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.intp]

# What spans a surface that is no polygon.
_FREE_FORM: Final = frozenset({b"surf", b"curv2", b"cstype"})


def _whole_numbers() -> array[int]:
    return array("q")


@dataclass(frozen=True, slots=True)
class Polygons:
    """Faces of one material: numbers of their vertices one after the other, how many each has, and of normals.

    `normals` is empty as long as the file has none; -1 is a corner without one.
    """

    corners: array[int] = field(default_factory=_whole_numbers)
    counts: array[int] = field(default_factory=_whole_numbers)
    normals: array[int] = field(default_factory=_whole_numbers)

    def add(self, corners: Sequence[int], normals: Sequence[int] = ()) -> None:
        """Add a face."""
        if normals and not self.normals:
            self.normals.extend([-1] * len(self.corners))
        self.normals.extend(normals or [-1] * len(corners) * bool(self.normals))
        self.corners.extend(corners)
        self.counts.append(len(corners))

    @property
    def triangles(self) -> int:
        """How many triangles they are cut into."""
        return len(self.corners) - 2 * len(self.counts)


def read_obj(content: bytes, where: str) -> tuple[Array, dict[str, Polygons], Array]:
    """Read an OBJ file: its vertices, the faces of each material ("part" before any is named), and normals.

    Raises
    ------
    InputError
        Naming the line that is none of OBJ's, or holds a free-form surface.
    """
    vertices, normals = array("d"), array("d")
    groups: dict[str, Polygons] = {}
    name = "part"
    for number, line in _logical_lines(content):
        words = line.partition(b"#")[0].split()
        if not words:
            continue
        try:
            match words[0]:
                case b"v":
                    x, y, z = map(float, words[1:4])
                    vertices.extend((x, y, z))
                case b"f":
                    known, corners = len(normals) // 3, [_place(word, len(vertices) // 3) for word in words[1:]]
                    groups.setdefault(name, Polygons()).add(corners, [_normal(w, known) for w in words[1:] if known])
                case b"vn":
                    x, y, z = map(float, words[1:4])
                    normals.extend((x, y, z))
                case b"usemtl":
                    # A name may hold any letter but a line's end.
                    name = line.split(None, 1)[1].strip().decode(errors="replace") if len(words) > 1 else "part"
                case word if word in _FREE_FORM:
                    raise InputError(f"line {number} begins a free-form surface", where=where, remedy="mesh it before")
        except (ValueError, OverflowError) as error:
            raise InputError(f"is not a complete OBJ file: line {number}: {str(error)[:80]}", where=where) from error
    return np.array(vertices).reshape(-1, 3), groups, np.array(normals).reshape(-1, 3)


def _logical_lines(content: bytes) -> Iterator[tuple[int, bytes]]:
    """Lines with their numbers; a backslash at the end goes on in the next."""
    begun = b""
    for number, line in enumerate(_lines(content), start=1):
        if line.endswith(b"\\"):
            begun += line[:-1] + b" "
            continue
        yield number, begun + line
        begun = b""
    if begun:
        yield number, begun


def _lines(content: bytes) -> Iterator[bytes]:
    """Lines one by one; a file without line feeds has carriage returns."""
    return (line.rstrip() for line in io.BytesIO(content if b"\n" in content else content.replace(b"\r", b"\n")))


def _place(word: bytes, known: int) -> int:
    """Number of a vertex, from 0; backwards from those that stand before the face."""
    number = int(word.partition(b"/")[0])
    if number == 0:
        raise ValueError("vertices are counted from 1")
    if number < -known:
        raise ValueError(f"there is no vertex {number} before it")
    return number - 1 if number > 0 else known + number


def _normal(word: bytes, known: int) -> int:
    """Number of a corner's normal, from 0; -1 for none."""
    text = word.rpartition(b"/")[2] if word.count(b"/") == 2 else b""
    number = int(text) if text else 0
    return number - 1 if number > 0 else max(known + number, -1) if number < 0 else -1


def read_off(content: bytes, where: str) -> tuple[Array, Polygons]:
    """Read an OFF or COFF file: its vertices and faces; colours are left out.

    Raises
    ------
    InputError
        If it is none, or holds fewer or more vertices and faces than it claims.
    """
    lines = (words for line in _lines(content) if (words := line.partition(b"#")[0].split()))
    vertices, faces = array("d"), Polygons()
    try:
        kind, *head = next(lines)
        if kind not in (b"OFF", b"COFF"):
            raise ValueError("it does not begin with OFF or COFF")
        vertex_number, face_number = map(int, (head or next(lines))[:2])
        claimed = max(vertex_number, face_number)
        if claimed > len(content):
            raise InputError(f"claims {claimed} elements, more than it can hold", where=where, remedy="correct it")
        for _ in range(vertex_number):
            x, y, z = map(float, next(lines)[:3])
            vertices.extend((x, y, z))
        for _ in range(face_number):
            words = next(lines)
            corners = [int(word) for word in words[1 : int(words[0]) + 1]]
            if len(corners) != int(words[0]):
                raise ValueError(f"a face claims {int(words[0])} corners and has {len(corners)}")
            faces.add(corners)
        if next(lines, None) is not None:
            raise ValueError("it holds more than it claims")
    except StopIteration as error:
        raise InputError("is not a complete OFF file: it holds less than it claims", where=where) from error
    except (ValueError, OverflowError) as error:
        raise InputError(f"is not a complete OFF file: {str(error)[:100]}", where=where) from error
    return np.array(vertices).reshape(-1, 3), faces
