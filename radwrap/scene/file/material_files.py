"""Measured materials from files: R_A of sheeting and BRDF as CSV, and images that are printed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.manifest import sha256_of_value
from radwrap.scene.file.intensity_files import numbered_rows, table_text
from radwrap.scene.materials import MeasuredBrdf, PrintedImage

Array = NDArray[np.float64]

_LARGEST_FILE: Final = 16 << 20
_SHOWN: Final = 60  # characters of what a table has in place of its columns
_MOST_PIXELS: Final = 2_000_000
_SHEETING: Final = ("observation_deg", "entrance_deg", "coefficient")
_BRDF: Final = ("incidence_deg", "viewing_deg", "azimuth_deg", "brdf_per_sr")
# A table of f must reach so far; beyond it holds its last value.
_LEAST_REACH: Final = 80.0
# No surface reflects more than it gets; straight lines between nodes may add a little.
_MOST_ALBEDO: Final = 1.01
# Along the normal there is no azimuth: a measurement may scatter over it by so much of its mean.
_SCATTER: Final = 0.02
_COEFFICIENTS: Final = (1e-9, 1e9)  # cd lx^-1 m^-2; as in a scene file


@dataclass(frozen=True, slots=True)
class CoefficientFile:
    """R_A as a file has it.

    Attributes
    ----------
    observation, entrance : tuple of float
        Nodes [rad].
    coefficient : tuple of tuple of float
        A row for each observation angle [cd lx^-1 m^-2]; the mean over rotations.
    rotations : int
        At how many rotation angles it was measured.
    spread : float
        By what share of the mean single rotations differ from it at most.
    """

    observation: tuple[float, ...]
    entrance: tuple[float, ...]
    coefficient: tuple[tuple[float, ...], ...]
    rotations: int
    spread: float


def read_coefficients(path: Path) -> CoefficientFile:
    """Read R_A: columns observation_deg, entrance_deg, coefficient [cd lx^-1 m^-2], in any order, on a full grid.

    A column rotation_deg may stand beside them, the grid then whole at each of its angles. How a sheet is turned to
    light and viewer off the coplanar bench no such table tells: their mean is taken.

    Raises
    ------
    InputError
        If it is no such table.
    """
    columns, _ = columns_of(path, _SHEETING, optional="rotation_deg")
    turns = columns.get("rotation_deg", np.zeros(len(columns["coefficient"]))) % 360  # 360 deg is 0
    grids = [
        _grid({name: columns[name][turns == turn] for name in _SHEETING}, _SHEETING, path) for turn in np.unique(turns)
    ]
    if not grids:
        raise InputError("holds no values", where=str(path))
    axes = grids[0][0]
    if any(not np.array_equal(one, other) for found, _ in grids for one, other in zip(found, axes, strict=True)):
        raise InputError("needs the same angles at each rotation", where=str(path))
    values = np.stack([found for _, found in grids])
    low, high = _COEFFICIENTS
    if values.min() < low or values.max() > high:
        raise InputError(f"needs coefficients from {low:g} to {high:g} cd/lx/m^2", where=str(path))
    if min(map(len, axes)) < 2 or max(axis[-1] for axis in axes) >= 88.8:
        raise InputError("needs two or more angles each, below 88.8 deg", where=str(path))
    observation, entrance = (tuple(map(math.radians, axis)) for axis in axes)
    mean = values.mean(axis=0)
    spread = float(np.abs(values / mean - 1).max())
    return CoefficientFile(observation, entrance, tuple(map(tuple, mean.tolist())), len(grids), spread)


def read_brdf(path: Path) -> MeasuredBrdf:
    """Read f: columns incidence_deg, viewing_deg, azimuth_deg (0 to 180), brdf_per_sr, on a full grid.

    Raises
    ------
    InputError
        If it is no such table, or reflects more than falls on it.
    """
    columns, digest = columns_of(path, _BRDF)
    if min(float(columns[name].min(initial=0.0)) for name in _BRDF[:-1]) < 0:
        raise InputError("angles must be at least 0", where=str(path), remedy="give the side by the azimuth, 0 to 180")
    axes, values = _grid(columns, _BRDF, path)
    incidence, viewing, azimuth = axes
    if incidence[0] != 0 or viewing[0] != 0 or min(incidence[-1], viewing[-1]) < _LEAST_REACH:
        raise InputError(f"incidence and viewing must go from 0 to {_LEAST_REACH:g} deg or more", where=str(path))
    if max(incidence[-1], viewing[-1]) > 90 or azimuth[0] != 0 or azimuth[-1] != 180:
        raise InputError("angles must end at 90 deg at most, azimuth go from 0 to 180", where=str(path))
    if values.min() < 0:
        raise InputError("f must be at least 0", where=str(path))
    for axis, along in (("incidence", values[0]), ("viewing", values[:, 0])):
        if (np.ptp(along, axis=-1) > _SCATTER * along.mean(axis=-1)).any():
            raise InputError(
                f"depends on the azimuth at {axis} 0, where there is none",
                where=str(path),
                remedy="write its mean over the azimuth on those lines",
            )
    albedo = directional_albedo(np.radians(viewing), np.radians(azimuth), values)
    worst = int(albedo.argmax())
    if albedo[worst] > _MOST_ALBEDO:
        raise InputError(
            f"reflects {albedo[worst]:.3g} of what falls on it at {incidence[worst]:g} deg", where=str(path)
        )
    beta, nu, turn = (tuple(map(math.radians, axis)) for axis in axes)
    return MeasuredBrdf(digest, beta, nu, turn, tuple(values.ravel().tolist()))


def directional_albedo(viewing: Array, azimuth: Array, values: Array) -> Array:
    """Share of light that is reflected, for each incidence: the integral of f cos(nu) over the half space."""
    height = np.linspace(0, math.pi / 2, 181)
    turn = np.linspace(0, math.pi, 91)
    albedo = np.empty(len(values))
    for number, table in enumerate(values):
        along = np.array([np.interp(height, viewing, column) for column in table.T])
        full = np.array([np.interp(turn, azimuth, row) for row in along.T])
        ring = np.trapezoid(full, turn, axis=1) * 2
        albedo[number] = np.trapezoid(ring * np.cos(height) * np.sin(height), height)
    return albedo


def read_print(path: Path, encoding: str, black: float, white: float) -> PrintedImage:
    """Read an image as reflectances between those of black and of white.

    Raises
    ------
    InputError
        If it is no gray image, or too large.
    """
    from radwrap.images import read_gray

    image = read_gray(path, most_pixels=_MOST_PIXELS)
    # Files of floats hold shares as they are.
    share = image.values / (2**image.bit_depth - 1) if image.provenance["whole_numbers"] else image.values
    low, high = float(share.min()), float(share.max())
    if low < 0 or high > 1:
        raise InputError(
            f"holds values from {low:.4g} to {high:.4g}",
            where=str(path),
            remedy="floats go from 0, black, to 1, white, in a print",
        )
    if encoding == "srgb":
        share = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    # Radiance takes no data of one row or column: two alike say the same.
    share = np.repeat(share, [2 if len(share) == 1 else 1] * len(share), axis=0)
    share = np.repeat(share, [2 if share.shape[1] == 1 else 1] * share.shape[1], axis=1)
    rows = tuple(map(tuple, (black + (white - black) * share).tolist()))
    return PrintedImage(sha256_of_value(rows), rows)


def columns_of(path: Path, names: tuple[str, ...], optional: str = "") -> tuple[dict[str, Array], str]:
    """Columns of a CSV table, in any order, by name, and the SHA-256 of its file.

    Raises
    ------
    InputError
        If it is no table of finite numbers with these columns.
    """
    text, digest = table_text(path, _LARGEST_FILE)
    rows = numbered_rows(text, path)
    head = [cell.strip() for cell in rows[0][1]] if rows else []
    if sorted(head) not in (sorted(names), sorted((*names, optional))):
        told = f"{', '.join(names)}{f', and {optional} where it has them' if optional else ''}"
        there = ", ".join(head)[:_SHOWN] or "none"  # of a hostile file it may be long
        raise InputError(f"its first line must name the columns {told}; it names {there}", where=str(path))
    if len(rows) < 2:
        raise InputError("has no line of numbers", where=str(path))
    values = np.array([_finite(row, len(head), f"{path}: line {line}") for line, row in rows[1:]], dtype=np.float64)
    return dict(zip(head, values.T, strict=True)), digest


def _finite(row: list[str], columns: int, where: str) -> list[float]:
    """Numbers of a line."""
    if len(row) != columns:
        raise InputError(f"has {len(row)} cells, and there are {columns} columns", where=where)
    try:
        numbers = [float(cell) for cell in row]
    except ValueError as error:
        raise InputError("holds what is not a number", where=where) from error
    if not np.isfinite(numbers).all():
        raise InputError("holds what is not a finite number", where=where)
    return numbers


def _grid(columns: dict[str, Array], names: tuple[str, ...], path: Path) -> tuple[list[Array], Array]:
    """Nodes of each angle, without sign, and values on their grid, the last angle fastest."""
    axes, places = [], []
    for name in names[:-1]:
        nodes, place = np.unique(np.abs(columns[name]), return_inverse=True)
        axes.append(nodes)
        places.append(place)
    shape = tuple(map(len, axes))
    count = len(columns[names[-1]])
    values = np.full(shape, np.nan)
    values[tuple(places)] = columns[names[-1]]
    if count != math.prod(shape) or np.isnan(values).any():
        raise InputError(
            f"needs each combination of its {' x '.join(map(str, shape))} angles once, and has {count} lines",
            where=str(path),
        )
    return axes, values
