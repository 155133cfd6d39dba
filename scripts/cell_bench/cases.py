"""Scenes that are measured, at several numbers of pixels on the same field of view."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import radwrap

ROOT: Final = Path(__file__).resolve().parents[2]
SCENES: Final = ROOT / "rad_scenes"
CELLS: Final = ("ring", "area_ring", "two_bars", "dome", "backlight", "coaxial")
BOARD: Final = "bench_board"
TENT: Final = "white_tent"
NAMES: Final = (*CELLS, BOARD, TENT)

# Of the whole sensor, which stays as it is [um].
_CELL_WIDTH: Final = 2448 * 3.45
_BOARD_WIDTH: Final = 192 * 13.75
_TENT_WIDTH: Final = 60 * 60.0

# Columns and rows by megapixels as the command line says them.
_CELL_SIZES: Final = {0.001: (38, 32), 0.3: (612, 512), 5.0: (2448, 2048)}
_BOARD_SIZES: Final = {0.001: (38, 33), 0.03: (192, 165), 0.3: (612, 526), 0.9: (1024, 880), 5.0: (2448, 2104)}
_TENT_SIZES: Final = {0.08: (306, 256), 5.0: (2448, 2048)}


@dataclass(frozen=True, slots=True)
class Case:
    """A scene at a number of pixels.

    Attributes
    ----------
    name : str
        One of `NAMES`.
    megapixels : float
        As asked for.
    columns, rows : int
        Of the sensor.
    width : float
        Of the sensor [um].
    """

    name: str
    megapixels: float
    columns: int
    rows: int
    width: float

    @property
    def file(self) -> Path:
        """The scene file."""
        return SCENES / "cells" / f"{self.name}.toml" if self.name in CELLS else SCENES / self.name / "scene.toml"

    @property
    def overrides(self) -> dict[str, object]:
        """Keys that give the sensor its pixels; they are square, as those of Mitsuba's film."""
        pitch = f"{self.width / self.columns!r} um"
        return {
            "camera.sensor.columns": self.columns,
            "camera.sensor.rows": self.rows,
            "camera.sensor.pixel_width": pitch,
            "camera.sensor.pixel_height": pitch,
        }

    @property
    def bounces(self) -> bool:
        """Whether light between surfaces counts."""
        return self.name == TENT

    def scene(self) -> radwrap.Scene:
        """The scene, loaded."""
        return radwrap.load_scene(self.file, self.overrides)

    def described(self) -> dict[str, Any]:
        """What the results depend on: the files beside the scene, and the overrides."""
        beside = sorted(path for path in self.file.parent.iterdir() if path.suffix in {".toml", ".obj", ".rad"})
        mine = [path for path in beside if path.suffix != ".toml" or path == self.file]
        hashes = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in mine}
        return {"name": self.name, "files": hashes, "overrides": self.overrides}


def sizes_of(name: str) -> dict[float, tuple[int, int]]:
    """Megapixels that a scene can be measured at, with columns and rows."""
    return {BOARD: _BOARD_SIZES, TENT: _TENT_SIZES}.get(name, _CELL_SIZES)


def case_of(name: str, megapixels: float) -> Case:
    """A scene by its name, at about so many megapixels.

    Raises
    ------
    ValueError
        If the name or the number is not known.
    """
    if name not in NAMES:
        raise ValueError(f"there is no cell {name!r}; there are {', '.join(NAMES)}")
    sizes = sizes_of(name)
    if megapixels not in sizes:
        raise ValueError(f"{name} is not measured at {megapixels:g} MP; it is at {', '.join(f'{s:g}' for s in sizes)}")
    width = {BOARD: _BOARD_WIDTH, TENT: _TENT_WIDTH}.get(name, _CELL_WIDTH)
    return Case(name, megapixels, *sizes[megapixels], width)


def digest(value: object) -> str:
    """Hash of what JSON can hold."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def sources_sha256(folder: Path) -> str:
    """Hash of all Python sources below a folder."""
    found = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        found.update(str(path.relative_to(folder)).encode() + b"\0" + path.read_bytes())
    return found.hexdigest()
