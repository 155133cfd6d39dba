"""Measured distributions of light: beam tables as CSV, and luminaires as IES LM-63 (Type C).

Between the file's angles the curve is smooth and has no waves of its own
(PCHIP), in steps of a quarter of a degree: straight lines through steps of 10
degrees miss a narrow beam by half. How far straight lines are from it is told.
"""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.reading import FileKind, csv_rows, read_bytes, shortened
from radwrap.scene.sources import IntensityTable, TableBeam

Array = NDArray[np.float64]

STEP: Final = 0.25  # deg
_BEAM_STEP: Final = 0.05  # deg; of a Gaussian 7 deg wide, straight lines over it miss 1e-4 at a tenth of the peak
_AZIMUTH_STEP: Final = 1.0  # deg
_LARGEST_FILE: Final = 1 << 20
_MOST_ANGLES: Final = 1000
_HEADER: Final = ["angle_deg", "relative_intensity"]
# A table that ends above this share of its peak says nothing of what comes after.
_DARK: Final = 0.01
_MOST_OF_AXIS: Final = 1e6
_LARGEST: Final = 1e30  # so that products of a few do not overflow
_SMALLEST: Final = 1e-30
_LEAST_APART: Final = 1e-6  # deg; no goniometer tells angles apart that are nearer
_TYPES: Final = {2: "B", 3: "A"}
_EDITION: Final = re.compile(r"(?i)\s*IES(?:NA)?:?(?:LM-63-)?(\d+)")
_YEAR_DIGITS: Final = 4
_CODED: Final = 2019  # from this edition on the number after the ballast factor tells how the file was made
_TILT: Final = re.compile(r"(?im)^[ \t]*TILT[ \t]*=[ \t]*(.*)$")


def read_beam(path: Path) -> TableBeam:
    """Read a beam table: the header ``angle_deg,relative_intensity``, angles from 0 to 90.

    Raises
    ------
    InputError
        If it is no such table.
    """
    text, digest = table_text(path, _LARGEST_FILE)
    rows = table_rows(text, path)
    if not rows or [cell.strip() for cell in rows[0]] != _HEADER:
        raise InputError(f'its first line must be "{",".join(_HEADER)}"', where=str(path))
    if any(len(row) != len(_HEADER) for row in rows):
        raise InputError("each line needs an angle and a relative intensity", where=str(path))
    angle, value = _numbers([cell for row in rows[1:] for cell in row], path).reshape(-1, 2).T
    _check_angles(angle, "angles", path)
    if angle[0] != 0 or angle[-1] > 90:
        raise InputError("angles must go from 0 to at most 90", where=str(path))
    if value[0] < _SMALLEST or value.min() < 0:
        raise InputError(
            f"relative intensities must be at least 0, on the axis above 0 (at least {_SMALLEST:g})", where=str(path)
        )
    if value.max() > _MOST_OF_AXIS * value[0]:
        raise InputError(
            f"is more than {_MOST_OF_AXIS:g} times as bright aside as on the axis, to which it is relative",
            where=str(path),
        )
    if angle[-1] < 90 and value[-1] > _DARK * value.max():
        raise InputError(
            f"ends at {angle[-1]:g} deg with {value[-1] / value.max():.0%} of its peak",
            where=str(path),
            remedy="continue to 90 deg, or end with a line of intensity 0",
        )
    grid = np.arange(0, 90 + _BEAM_STEP / 2, _BEAM_STEP)
    smooth, doubt = _resampled(angle, value[np.newaxis], grid)
    return TableBeam("table", 1.0, digest, doubt, tuple((smooth[0] / value[0]).tolist()))


def read_luminaire(path: Path) -> IntensityTable:
    """Read an LM-63 file of Type C.

    Raises
    ------
    InputError
        If it is no such file; Types A and B and a tilt in another file are refused by name.
    """
    text, digest = table_text(path, _LARGEST_FILE)
    tilt = _TILT.search(text)
    if tilt is None:
        raise InputError("is not a luminaire file: it has no TILT", where=str(path), remedy="name an IES LM-63 file")
    kind = tilt[1].strip().upper()
    if kind not in ("NONE", "INCLUDE"):
        raise InputError("names another file for its tilt", where=str(path), remedy="write TILT=NONE or TILT=INCLUDE")
    values = _numbers(re.split(r"[\s,]+", text[tilt.end() :].strip()), path)
    reader = _Reader(values, path)
    factor = _tilt(reader, path) if kind == "INCLUDE" else 1.0
    _, _, multiplier = reader.take(3)
    vertical_count, horizontal_count, form = (reader.count() for _ in range(3))
    if form != 1:
        known = f"is photometry of Type {_TYPES[form]}" if form in _TYPES else f"is of no known type ({form})"
        raise InputError(f"{known}: only Type C is read", where=str(path), remedy="convert it to Type C")
    reader.take(4)  # units, width, length, height: light comes from the middle
    ballast, photometric, _ = reader.take(3)
    vertical, horizontal = reader.take(vertical_count), reader.take(horizontal_count)
    candela = reader.take(vertical_count * horizontal_count).reshape(horizontal_count, vertical_count)
    reader.end()
    candela = candela * multiplier * ballast * _lamp_factor(text, float(photometric), path) * factor
    if candela.min() < 0 or not _SMALLEST < candela.max() < _LARGEST:
        raise InputError(
            f"intensities must be at least 0, the largest from {_SMALLEST:g} to {_LARGEST:g}", where=str(path)
        )
    return _table(vertical, horizontal, candela, path, digest)


def _lamp_factor(text: str, told: float, path: Path) -> float:
    """The ballast-lamp photometric factor, which the editions of 1986 and 1991 have."""
    edition = _EDITION.match(text)
    if edition and len(edition[1]) > _YEAR_DIGITS:
        raise InputError(f'"{shortened(edition[1])}" is not a year of an edition', where=str(path))
    year = int(edition[1]) if edition else 1986
    if year in (1986, 1991, 91):
        return told
    if year < _CODED and told != 1:
        raise InputError(
            f"gives {told:g} for a factor that its edition of LM-63 ({year}) does not have",
            where=str(path),
            remedy="make it 1, and multiply the intensities if it is meant",
        )
    return 1.0


def table_rows(text: str, path: Path) -> list[list[str]]:
    """Lines of a table, without comments and empty ones.

    Raises
    ------
    InputError
        If it is no CSV.
    """
    return [row for _, row in numbered_rows(text, path)]


def numbered_rows(text: str, path: Path) -> list[tuple[int, list[str]]]:
    """As `table_rows`, each with the line of the file, from 1, that it ends in."""
    return [(line, row) for line, row in csv_rows(text, str(path)) if not row[0].lstrip().startswith("#")]


class _Reader:
    """Numbers, taken one after the other."""

    def __init__(self, values: Array, path: Path) -> None:
        self._values = values
        self._path = path

    def take(self, number: int) -> Array:
        if len(self._values) < number:
            raise InputError("ends too early: it holds fewer numbers than it says", where=str(self._path))
        taken, self._values = self._values[:number], self._values[number:]
        return taken

    def count(self) -> int:
        (value,) = self.take(1)
        if value != int(value) or not 1 <= value <= _MOST_ANGLES:
            raise InputError(
                f"gives {value:g} where a number from 1 to {_MOST_ANGLES} is expected", where=str(self._path)
            )
        return int(value)

    def end(self) -> None:
        if len(self._values):
            raise InputError("continues after its last intensity", where=str(self._path))


def _tilt(reader: _Reader, path: Path) -> float:
    """The factor of a lamp that is not tilted."""
    reader.take(1)
    number = reader.count()
    angles, factors = reader.take(number), reader.take(number)
    if not (np.diff(angles) > 0).all():
        raise InputError("the angles of its tilt must increase", where=str(path))
    return float(np.interp(0.0, angles, factors))


def _table(vertical: Array, horizontal: Array, candela: Array, path: Path, digest: str) -> IntensityTable:
    _check_angles(vertical, "vertical angles", path)
    if vertical[0] not in (0, 90) or vertical[-1] not in (90, 180):
        raise InputError("vertical angles must go from 0 or 90 to 90 or 180", where=str(path))
    horizontal, candela = _all_round(horizontal, candela, path)
    height = np.arange(0, 180 + STEP / 2, STEP)
    smooth, doubt = _resampled(vertical, candela, height)
    if len(horizontal) > 1:
        turn = np.arange(0, 360 + _AZIMUTH_STEP / 2, _AZIMUTH_STEP)
        across, beside = _around(horizontal, smooth, turn)
        smooth, doubt = across, max(doubt, beside)
    else:
        turn = np.zeros(1)
    peak = float(smooth.max())
    rows = tuple(tuple(row) for row in (smooth / peak).tolist())
    return IntensityTable(digest, peak, doubt, rows)


def _all_round(horizontal: Array, candela: Array, path: Path) -> tuple[Array, Array]:
    """A full turn, by the symmetry that the angles tell; one plane where all are alike."""
    if len(horizontal) == 1:
        return np.zeros(1), candela
    _check_angles(horizontal, "horizontal angles", path)
    ends = (float(horizontal[0]), float(horizontal[-1]))
    if ends == (0, 90):
        horizontal, candela = _mirrored(horizontal, candela, 90)
        ends = (0, 180)
    if ends == (90, 270):
        horizontal, candela = _mirrored(horizontal, candela, 270)
        turned = (horizontal + 360) % 360
        order = np.argsort(turned[:-1])
        horizontal, candela = turned[:-1][order], candela[:-1][order]
        return np.append(horizontal, horizontal[0] + 360), np.vstack([candela, candela[:1]])
    if ends == (0, 180):
        return _mirrored(horizontal, candela, 180)
    if ends[0] == 0 and ends[1] == 360:
        return horizontal, candela
    raise InputError(
        "horizontal angles must be 0 only, or go from 0 to 90, 0 to 180, 90 to 270, or 0 to 360", where=str(path)
    )


def _mirrored(horizontal: Array, candela: Array, about: float) -> tuple[Array, Array]:
    return (
        np.concatenate([horizontal, 2 * about - horizontal[-2::-1]]),
        np.vstack([candela, candela[-2::-1]]),
    )


def _resampled(angle: Array, values: Array, grid: Array) -> tuple[Array, float]:
    """Smooth curves through values, shape (n, angles), on a grid; 0 beyond. And the most that straight lines differ."""
    from scipy.interpolate import PchipInterpolator

    inside = (grid >= angle[0] - 1e-9) & (grid <= angle[-1] + 1e-9)
    smooth = np.zeros((len(values), len(grid)))
    straight = np.zeros_like(smooth)
    if len(angle) == 1:
        return np.where(inside, values, 0.0), 0.0
    at = np.clip(grid[inside], angle[0], angle[-1])
    smooth[:, inside] = np.maximum(PchipInterpolator(angle, values, axis=1)(at), 0.0)
    straight[:, inside] = [np.interp(at, angle, row) for row in values]
    return smooth, float(np.abs(smooth - straight).max() / max(values.max(), 1e-300))


def _around(horizontal: Array, values: Array, turn: Array) -> tuple[Array, float]:
    """Smooth curves around a full turn, without a kink where it closes."""
    before, after = horizontal[:-1] - 360, horizontal[1:] + 360
    angle = np.concatenate([before, horizontal, after])
    rows = np.vstack([values[:-1], values, values[1:]])
    smooth, doubt = _resampled(angle, rows.T, turn)
    return smooth.T, doubt


def _check_angles(angle: Array, what: str, path: Path) -> None:
    if len(angle) < 2 or not (np.diff(angle) > _LEAST_APART).all():
        raise InputError(
            f"{what} must be two or more, and increase by more than {_LEAST_APART:g} deg each", where=str(path)
        )


def _numbers(words: list[str], path: Path) -> Array:
    values = np.empty(len(words))
    for place, word in enumerate(words):
        try:
            values[place] = float(word)
        except ValueError as error:
            raise InputError(f'"{word[:40]}" is not a number', where=str(path)) from error
    if not np.isfinite(values).all():
        raise InputError("holds NaN or infinity", where=str(path))
    if np.abs(values).max(initial=0.0) > _LARGEST:
        raise InputError(f"holds numbers beyond {_LARGEST:g}", where=str(path))
    return values


def table_text(path: Path, largest: int) -> tuple[str, str]:
    """Text of a table of so many bytes at most, and its SHA-256.

    Raises
    ------
    InputError
        If it cannot be read, is larger, or is no text.
    """
    content = read_bytes(path, FileKind("table", largest))
    if b"\0" in content:
        raise InputError("is not text: it holds a NUL byte", where=str(path))
    return content.decode("utf-8-sig", "replace"), hashlib.sha256(content).hexdigest()
