"""Frames of even light and of none: a table that names them, and what each exposure's frames say together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.images import read_gray
from radwrap.reading import FileKind, csv_rows, read_text, shortened, unusable

Array = NDArray[np.float64]
FILE: Final = "file"
DARK: Final = "dark"
EXPOSURES: Final = ("exposure_time", "radiant_exposure", "photons")
_TABLE: Final = FileKind("file of frames", 64 << 20, "give a CSV file that names the frames")
_YES_NO: Final = {"0": False, "1": True}


@dataclass(frozen=True, slots=True, eq=False)
class Stack:
    """Frames of one exposure.

    Attributes
    ----------
    exposure : float
        Of whatever quantity the table holds.
    dark : bool
        Whether no light fell.
    frames : int
        How many.
    mean : ndarray, shape (rows, columns)
        Mean of each pixel over the frames [gray level].
    temporal_variance : float
        Variance of a pixel from frame to frame, mean over the pixels; changes of the whole frame's level are not in it
        [gray level^2].
    """

    exposure: float
    dark: bool
    frames: int
    mean: Array
    temporal_variance: float

    @property
    def level(self) -> float:
        """Mean gray level."""
        return float(self.mean.mean())

    def spatial_variance(self, used: NDArray[np.bool_] | None = None) -> float:
        """Variance of the pixels' own means, free of what the finite number of frames adds [gray level^2].

        Parameters
        ----------
        used : ndarray of bool, shape (rows, columns), optional
            Pixels that count; default all.
        """
        values = self.mean if used is None else self.mean[used]
        return float(values.var(ddof=1)) - self.temporal_variance / self.frames


def read_stacks(
    path: Path, read: Callable[[Path], Array] | None = None, *, trust: bool = False
) -> tuple[str, tuple[Stack, ...]]:
    """Read a table of frames, and the frames.

    Parameters
    ----------
    path : Path
        CSV file with the columns file, one of `EXPOSURES`, and perhaps dark (0 or 1); without that, frames of exposure
        0 are dark. Files are named from its own folder.
    read : callable, optional
        Reads a frame [gray level]; default any gray image.
    trust : bool
        Whether the table may name files outside of its folder; else these are not so much as opened.

    Returns
    -------
    kind : str
        One of `EXPOSURES`: [s], [J m^-2], or photons a pixel.
    stacks : tuple of Stack
        Dark ones first, by rising exposure.

    Raises
    ------
    InputError
        If the table or a frame cannot be read or lies elsewhere, an exposure has one frame alone, or frames differ in
        size.
    """
    kind, groups = _groups(path)
    if not trust:
        for name, line in (file for files in groups.values() for file in files):
            _check_beside(path, name, line)
    load = read or (lambda file: read_gray(file).values)
    stacks = []
    shape: tuple[int, ...] | None = None
    for (is_light, exposure), files in sorted(groups.items()):
        if len(files) < 2:
            raise InputError(
                f"one frame of {kind} {exposure:g}{'' if is_light else ', dark'}: noise needs two",
                where=f"{path}: line {files[0][1]}",
            )
        stack = _stack(exposure, not is_light, [(path.parent / name, line) for name, line in files], path, load)
        if shape is not None and stack.mean.shape != shape:
            raise InputError(
                f"has {stack.mean.shape[1]} x {stack.mean.shape[0]} pixels, others {shape[1]} x {shape[0]}",
                where=str(path.parent / files[0][0]),
            )
        shape = stack.mean.shape
        stacks.append(stack)
    return kind, tuple(stacks)


def _groups(path: Path) -> tuple[str, dict[tuple[bool, float], list[tuple[str, int]]]]:
    """(light, exposure) -> names of its frames with their lines."""
    rows = csv_rows(read_text(path, _TABLE), str(path))
    groups: dict[tuple[bool, float], list[tuple[str, int]]] = {}
    named: dict[str, int] = {}
    header = [name.strip() for name in next(rows, (1, []))[1]]
    kind = _kind(header, path)
    for line, row in rows:
        if not any(cell.strip() for cell in row):
            continue
        where = f"{path}: line {line}"
        if len(row) != len(header):
            raise InputError(f"has {len(row)} cells, the first line has {len(header)}", where=where)
        cells = dict(zip(header, (cell.strip() for cell in row), strict=True))
        exposure = _exposure(cells[kind], kind, where)
        name = cells[FILE]
        if name in named:
            raise InputError(f'"{name}" is in line {named[name]} too', where=where)
        if not name:
            raise InputError("names no file", where=where)
        named[name] = line
        if DARK in cells and cells[DARK] not in _YES_NO:
            raise InputError(f'dark "{cells[DARK]}" is not 0 or 1', where=where)
        dark = _YES_NO[cells[DARK]] if DARK in cells else exposure == 0
        groups.setdefault((not dark, exposure), []).append((name, line))
    if not groups:
        raise InputError("names no frames", where=str(path), remedy="write a row for each frame below the first line")
    return kind, groups


def _check_beside(table: Path, name: str, line: int) -> None:
    """Refuse a frame outside of the table's folder, links followed."""
    where = f"{table}: line {line}"
    try:
        beside = (table.parent / name).resolve().is_relative_to(table.parent.resolve())
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(f'"{shortened(name)}" cannot be read', where=where) from error
    if not beside:
        raise InputError(
            f'"{shortened(name)}" lies outside the table\'s folder',
            where=where,
            remedy="copy it there, or `trust` the table",
        )


def _kind(header: Sequence[str], path: Path) -> str:
    kinds = [kind for kind in EXPOSURES if kind in header]
    if FILE not in header or len(kinds) != 1 or len(set(header)) != len(header) or set(header) - {FILE, DARK, *kinds}:
        raise InputError(
            f'has the columns "{shortened(",".join(header))}"',
            where=f"{path}: line 1",
            remedy=f"needs {FILE}, one of {', '.join(EXPOSURES)} (s, J/m^2, photons a pixel), and may have {DARK}",
        )
    return kinds[0]


def _exposure(cell: str, kind: str, where: str) -> float:
    try:
        value = float(cell)
    except ValueError as error:
        raise InputError(
            f'{kind} "{shortened(cell)}" is not a number', where=where, remedy="write 0.016, with a point"
        ) from error
    if why := unusable(value):
        raise InputError(f'{kind} "{shortened(cell)}" {why}', where=where)
    if value < 0:
        raise InputError(f'{kind} "{shortened(cell)}" is not a number of 0 or more', where=where)
    return value


def _stack(
    exposure: float, dark: bool, files: Sequence[tuple[Path, int]], table: Path, load: Callable[[Path], Array]
) -> Stack:
    """Sums over the frames, one in memory at a time."""
    first: Array | None = None
    levels, number = 0.0, len(files)
    for file, line in files:
        frame = load(file)
        level = float(frame.mean())
        if first is None:
            first, sums, squares = frame, np.zeros_like(frame), np.zeros_like(frame)
        if frame.shape != first.shape:
            where = f"{table}: line {line}"
            raise InputError(f'"{file.name}" differs in size from the frames before it', where=where)
        levels += level
        # From the first frame, so that the squares are small; each frame's own level is no noise of its pixels.
        difference = frame - first - (level - float(first.mean()))
        sums += difference
        squares += difference**2
    assert first is not None  # noqa: S101  (there are two frames at least)
    variance = float(np.mean(squares - sums**2 / number)) / (number - 1)
    mean = first + sums / number + (levels / number - float(first.mean()))
    return Stack(exposure, dark, number, mean, variance)
