"""A scene as a user writes it: tables and the files beside them, and how to read and change them."""

from __future__ import annotations

import copy
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any, Final

import numpy as np

from radwrap.frames import Pose, Rotation, Vector, aim, fixed_axis_angles, rotation_about_fixed_axes
from radwrap.images import read_image
from radwrap.units import ANGLE, LENGTH, Dimension, parse_quantity

Table = dict[str, Any]

# Sources that shine from discs or points, by which a level is told in the same keys.
LEVELS: Final = ("radiance", "radiant_intensity", "radiant_flux")
WIDE: Final = ("rectangle", "area_ring", "dome", "coaxial", "surround")
ORIGIN: Final = ["0 m", "0 m", "0 m"]
# Sources without a pose of their own.
UNPLACED: Final = ("coaxial", "surround")


@dataclass(frozen=True, slots=True)
class Written:
    """A scene document and the files that it names, neither of which is ever changed in place."""

    document: Table
    files: dict[str, bytes]

    def copied(self) -> Written:
        """One that may be changed before it is handed on."""
        return Written(copy.deepcopy(self.document), dict(self.files))

    def save(self, folder: Path) -> None:
        """Write the files beside which the document is read."""
        for name, content in self.files.items():
            (folder / name).write_bytes(content)

    @property
    def camera(self) -> Table:
        """The camera's table."""
        table: Table = self.document["camera"]
        return table

    @property
    def sources(self) -> list[Table]:
        """Tables of the sources."""
        tables: list[Table] = self.document["sources"]
        return tables

    @property
    def targets(self) -> list[Table]:
        """Tables of the targets."""
        tables: list[Table] = self.document["targets"]
        return tables

    @property
    def materials(self) -> dict[str, Table]:
        """Tables of the materials."""
        tables: dict[str, Table] = self.document["materials"]
        return tables

    def has_source(self, *kinds: str) -> bool:
        """Whether a source is of one of these kinds."""
        return any(source["type"] in kinds for source in self.sources)

    def has_target(self, *kinds: str) -> bool:
        """Whether a target is of one of these kinds."""
        return any(target["type"] in kinds for target in self.targets)

    def has_material(self, *kinds: str) -> bool:
        """Whether a material is of one of these kinds."""
        return any(material["type"] in kinds for material in self.materials.values())


def metres(text: str) -> float:
    """A length [m]."""
    return parse_quantity(text, LENGTH)


def radians(text: str) -> float:
    """An angle [rad]."""
    return parse_quantity(text, ANGLE)


def point(texts: list[str]) -> Vector:
    """A point [m]."""
    x, y, z = (metres(text) for text in texts)
    return x, y, z


def length(value: float) -> str:
    """A length as text, to the last digit."""
    return f"{float(value)!r} m"


def angle(value: float) -> str:
    """An angle as text, to the last digit."""
    return f"{float(value)!r} rad"


def lengths(values: Any) -> list[str]:
    """A point or sizes as text."""
    return [length(value) for value in values]


def scaled(text: str, factor: float) -> str:
    """A quantity times a factor, in its own unit."""
    number, unit = text.split(" ")
    return f"{float(number) * factor!r} {unit}"


def in_unit(text: str, dimension: Dimension, unit: str) -> str:
    """The same quantity in another unit, exactly."""
    number, old = text.split(" ")
    value = Decimal(number) * Decimal(repr(dimension.units[old])) / Decimal(repr(dimension.units[unit]))
    return f"{value} {unit}"


def matrix(rotation: Rotation) -> np.ndarray[Any, Any]:
    """A rotation as an array."""
    return np.array(rotation, dtype=np.float64)


def picture(content: bytes) -> np.ndarray[Any, Any]:
    """Codes of a PNG file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "picture.png"
        path.write_bytes(content)
        return read_image(path)[0]


def rotation_of(values: np.ndarray[Any, Any]) -> Rotation:
    """An array as a rotation."""
    a, b, c = ((float(row[0]), float(row[1]), float(row[2])) for row in values)
    return a, b, c


def read_pose(table: Table) -> Pose:
    """Pose of a target, a source or the camera."""
    position = point(table.get("position", ORIGIN))
    if "look_at" in table:
        up = table.get("up")
        return aim(position, point(table["look_at"]), None if up is None else tuple(up))
    turns = [radians(text) for text in table.get("rotation", ["0 deg"] * 3)]
    return Pose(position, rotation_about_fixed_axes(turns, table.get("rotation_order", "xyz")))


def write_pose(table: Table, pose: Pose) -> None:
    """Say the pose by position and rotation."""
    for key in ("look_at", "up", "rotation_order"):
        table.pop(key, None)
    table["position"] = lengths(pose.position)
    table["rotation"] = [angle(value) for value in fixed_axis_angles(pose.rotation)]


def placed(written: Written) -> Iterator[Table]:
    """All tables that have a pose."""
    yield written.camera
    yield from (source for source in written.sources if source["type"] not in UNPLACED)
    yield from written.targets


def changed(value: Any, change: Callable[[str, str], str], key: str = "") -> Any:
    """Tables in which each quantity (number, blank, unit) was changed by a function of its key and text."""
    if isinstance(value, dict):
        return {name: changed(inner, change, name) for name, inner in value.items()}
    if isinstance(value, list):
        return [changed(inner, change, key) for inner in value]
    if isinstance(value, str) and value.count(" ") == 1 and value[0] in "-.0123456789":
        return change(key, value)
    return value
