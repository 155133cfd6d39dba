"""From the tables of a lens's aberrations, and the files that they name, to frozen values in SI."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from radwrap.errors import InputError
from radwrap.scene.aberrations import Wavefront
from radwrap.scene.file.beside import named_file
from radwrap.scene.file.border import LONGEST_PATH
from radwrap.scene.file.material_files import columns_of
from radwrap.scene.zernike import HIGHEST_ORDER, Convention, Order, order_of, rms

if TYPE_CHECKING:
    from radwrap.scene.file.optics_tables import WavefrontModel

_COLUMNS: Final = ("field_height_mm", "index", "coefficient")
_MM: Final = 1e-3
# What a design program writes for nothing, rms over the pupil [m].
_NOTHING: Final = 1e-9
_MOST_HEIGHTS: Final = 1000
_SAME: Final = 1 + 1e-9  # diameters that rounding makes two of


def wavefront_from_table(
    table: WavefrontModel, reach: tuple[float, float], where: str, *, folder: Path, assumed: dict[str, str]
) -> Wavefront:
    """Convert a validated ``[camera.lens.wavefront]``.

    Parameters
    ----------
    table : WavefrontModel
        It.
    reach : tuple of float
        Diameter of the disc around the opening, and how far the sensor's corner lies from the axis [m].
    where : str
        Place for messages.
    folder : Path
        The scene's.
    assumed : dict
        Gets what is taken because the table is silent.

    Raises
    ------
    InputError
        Where values that are right one by one do not go together, or its file is no such table.
    """
    opening, corner = reach
    pupil = table.pupil_diameter or opening
    if table.pupil_diameter is None:
        assumed["camera.lens.wavefront.pupil_diameter"] = f"{opening * 1e3:.6g} mm"
    elif opening > pupil * _SAME:
        raise InputError(
            f"is smaller than the opening of {opening * 1e3:.4g} mm, and no polynomial is told beyond it",
            where=f"{where}.pupil_diameter",
            remedy="stop the lens down, or give the diameter that the coefficients belong to",
        )
    if table.coefficients is not None:
        told = {int(number): path for number, path in table.coefficients.items()}
        orders, (row,) = _by_order(table.convention, [told], f"{where}.coefficients")
        return Wavefront(pupil, orders, (row,))
    key = f"{where}.file"
    heights, rows = _read(named_file(folder, table.file or "", key), key)
    orders, values = _by_order(table.convention, rows, key)
    if heights[0] != 0 or heights[-1] < corner:
        raise InputError(
            f"has heights from {heights[0] * 1e3:g} to {heights[-1] * 1e3:g} mm, the sensor from 0 to "
            f"{corner * 1e3:.4g} mm from the axis",
            where=key,
            remedy="add the axis and a height as large as that",
        )
    lopsided = math.sqrt(sum(value**2 for (_, m), value in zip(orders, values[0], strict=True) if m))
    if lopsided > _NOTHING:
        raise InputError(
            f"has terms on the axis that are not alike from all sides, {lopsided * 1e9:.3g} nm rms, and turns them "
            "with the azimuth",
            where=key,
            remedy="set them 0 at the height 0, or give the same coefficients for all of the image by `coefficients`",
        )
    return Wavefront(pupil, orders, tuple(values), heights)


def _by_order(
    convention: Convention, rows: list[dict[int, float]], where: str
) -> tuple[tuple[Order, ...], list[tuple[float, ...]]]:
    """Orders of all terms and their mirror images, and of each row the coefficients of polynomials of rms 1 [m]."""
    found = []
    for row in rows:
        by_order = dict[Order, float]()
        for index, path in row.items():
            order = order_of(convention, index)
            if order is None:
                raise InputError(
                    f"{index} is no number of a term of the convention {convention}, up to order {HIGHEST_ORDER}",
                    where=where,
                )
            by_order[order] = path * (rms(order) if convention == "fringe" else 1.0)
        found.append(by_order)
    orders = tuple(sorted({(n, m) for by_order in found for n, either in by_order for m in (either, -either)}))
    return orders, [tuple(by_order.get(order, 0.0) for order in orders) for by_order in found]


def _read(path: Path, where: str) -> tuple[tuple[float, ...], list[dict[int, float]]]:
    """Heights [m], from the least on, and of each the path of numbered terms [m]; a term that is not there is 0."""
    columns, _ = columns_of(path, _COLUMNS)
    height, index, path_of = (columns[name] for name in _COLUMNS)
    if (height < 0).any() or (index != np.round(index)).any():
        raise InputError("needs heights from 0 on, and whole numbers of terms", where=where)
    if (np.abs(path_of) > LONGEST_PATH).any():
        raise InputError(
            f"has a coefficient of {path_of[np.abs(path_of).argmax()]:g} m",
            where=where,
            remedy="coefficients are paths in metres: 45 nm is 45e-9",
        )
    heights = sorted(set(height.tolist()))
    if len(heights) > _MOST_HEIGHTS:
        raise InputError(f"has more than {_MOST_HEIGHTS} heights", where=where)
    rows = list[dict[int, float]]()
    for one in heights:
        some = height == one
        terms = index[some].astype(int).tolist()
        if len(set(terms)) < len(terms):
            raise InputError(f"has a term twice at the height {one:g} mm", where=where)
        rows.append(dict(zip(terms, path_of[some].tolist(), strict=True)))
    return tuple(one * _MM for one in heights), rows
