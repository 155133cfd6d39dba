"""From the tables of a lens's aberrations, and the files that they name, to frozen values in SI."""

from __future__ import annotations

import math
from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.manifest import sha256_of_value
from radwrap.scene.aberrations import ContrastTable, LensGlass, PointSpread, Wavefront
from radwrap.scene.file.beside import named_file
from radwrap.scene.file.border import LONGEST_PATH
from radwrap.scene.file.material_files import columns_of
from radwrap.scene.zernike import HIGHEST_ORDER, Convention, Order, order_of, rms

if TYPE_CHECKING:
    from radwrap.scene.file.document import CameraModel
    from radwrap.scene.file.optics_tables import ContrastModel, FieldModel, LensModel, PointSpreadModel, WavefrontModel

Array = NDArray[np.float64]

_COLUMNS: Final = ("field_height_mm", "index", "coefficient")
_MM: Final = 1e-3
# What a design program writes for nothing, rms over the pupil [m].
_NOTHING: Final = 1e-9
_MOST_HEIGHTS: Final = 1000
_CONTRAST: Final = ("frequency_per_mm", "tangential", "sagittal")
_HEIGHT: Final = "field_height_mm"
# Readings of a data sheet's curves, of contrast.
_READING: Final = 0.02
_SAME_OPENING: Final = 0.02
# Of the highest frequency that passes: beyond it, contrast over the limit's says nothing.
_TELLING: Final = 0.95
# Of a picture of a point: pixels; light at its border over the brightest; light that its reach holds; contrast that
# may be left at the highest frequency that its pixels tell.
_MOST_PIXELS: Final = 512 * 512
_AT_BORDER: Final = 0.02
_HELD: Final = 0.999
_AT_HIGHEST: Final = 0.05
_SAME: Final = 1 + 1e-9  # diameters that rounding makes two of


def glass_from_table(
    table: LensModel, camera: CameraModel, corner: float, where: str, *, folder: Path, assumed: dict[str, str]
) -> LensGlass | None:
    """How a lens differs from a perfect one; None where its table does not say that.

    Parameters
    ----------
    table : LensModel
        Of a camera.
    camera : CameraModel
        It, for the opening.
    corner : float
        How far the sensor's corner lies from the axis [m].
    where : str
        Place for messages.
    folder : Path
        The scene's.
    assumed : dict
        Gets what is taken because the table is silent.

    Raises
    ------
    InputError
        Where values that are right one by one do not go together, or a file is no such table.
    """
    if table.mtf is not None:
        return _contrast(table.mtf, camera, corner, f"{where}.mtf", folder=folder, assumed=assumed)
    if table.psf is not None:
        return _point_spread(table.psf, f"{where}.psf", folder=folder, assumed=assumed)
    if table.wavefront is None:
        return None
    opening = camera.opening_diameter * (math.sqrt(2) if camera.aperture.shape == "square" else 1.0)
    return _wavefront(table.wavefront, (opening, corner), f"{where}.wavefront", folder=folder, assumed=assumed)


def _wavefront(
    table: WavefrontModel, reach: tuple[float, float], where: str, *, folder: Path, assumed: dict[str, str]
) -> Wavefront:
    """Of a validated ``[camera.lens.wavefront]``, for the disc around an opening and a corner so far off [m]."""
    opening, corner = reach
    pupil = table.pupil_diameter or opening
    if table.pupil_diameter is None:
        assumed["camera.lens.wavefront.pupil_diameter"] = f"{opening * 1e3:.6g} mm"
    elif opening > pupil * _SAME:
        raise InputError(
            f"is smaller than the opening of {opening * 1e3:.4g} mm, and the polynomial is not known beyond it",
            where=f"{where}.pupil_diameter",
            remedy="stop the lens down, or give the diameter that the coefficients belong to",
        )
    if table.coefficients is not None:
        told = {int(number): path for number, path in table.coefficients.items()}
        orders, (row,) = _by_order(table.convention, [told], f"{where}.coefficients")
        return Wavefront(pupil, orders, (row,))
    if table.fields is not None:
        key = f"{where}.fields"
        heights, rows = _listed(table.fields, key)
    else:
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


def _listed(fields: tuple[FieldModel, ...], where: str) -> tuple[tuple[float, ...], list[dict[int, float]]]:
    """Heights [m], and of each the path of numbered terms [m]; a term that is not there is 0."""
    heights = tuple(one.height for one in fields)
    if any(a >= b for a, b in pairwise(heights)):
        raise InputError("needs heights that increase", where=where)
    if not any(one.coefficients for one in fields):
        raise InputError(
            "has no term at any height, which is a perfect lens",
            where=where,
            remedy="give coefficients, or leave `wavefront` out",
        )
    return heights, [{int(number): path for number, path in one.coefficients.items()} for one in fields]


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
                    f"{index} is not the number of a term of the convention {convention}, up to order {HIGHEST_ORDER}",
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
        raise InputError("needs heights of 0 or more, and whole numbers of terms", where=where)
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


def _contrast(
    table: ContrastModel, camera: CameraModel, corner: float, where: str, *, folder: Path, assumed: dict[str, str]
) -> ContrastTable:
    """Of a validated ``[camera.lens.mtf]``, for a sensor whose corner lies so far from the axis [m]."""
    number = camera.focal_length / camera.opening_diameter
    if abs(table.f_number / number - 1) > _SAME_OPENING:
        raise InputError(
            f"is {table.f_number:g}, and the camera's {number:.4g}: contrast of another opening does not apply",
            where=f"{where}.f_number",
            remedy="give the table of this opening, or open the lens as the table says",
        )
    if camera.aperture.shape != "round":
        raise InputError("is known of round openings", where=where, remedy='set camera.aperture.shape = "round"')
    key = f"{where}.file"
    columns, _ = columns_of(named_file(folder, table.file, key), _CONTRAST, _HEIGHT)
    height = columns.get(_HEIGHT, np.zeros(len(columns["tangential"])))
    heights = np.unique(height)
    per_mm = np.unique(columns["frequency_per_mm"])
    (place, frequency), times = Counter(zip(height, columns["frequency_per_mm"], strict=True)).most_common(1)[0]
    if times > 1:
        at = f" at the height {place:g} mm" if len(heights) > 1 else ""
        raise InputError(f"has the frequency {frequency:g} per mm {times} times{at}, and needs it once", where=key)
    of_each = [np.argsort(columns["frequency_per_mm"] + np.where(height == one, 0.0, np.inf)) for one in heights]
    if len(height) != len(heights) * len(per_mm) or any(
        not np.array_equal(columns["frequency_per_mm"][order[: len(per_mm)]], per_mm) for order in of_each
    ):
        raise InputError("needs the same frequencies at each height", where=key)
    if per_mm[0] < 0 or heights[0] < 0 or not (per_mm > 0).any():
        raise InputError("needs frequencies above 0, and heights of 0 or more", where=key)
    if len(heights) > 1 and (heights[0] != 0 or heights[-1] * _MM < corner):
        raise InputError(
            f"has heights from {heights[0]:g} to {heights[-1]:g} mm, the sensor from 0 to {corner * 1e3:.4g} mm from "
            "the axis",
            where=key,
            remedy="add the axis and a height as large as that",
        )
    places = [f" at {one:g} mm" for one in heights] if len(heights) > 1 else [""]
    share = {
        name: [
            _share_of_limit(columns[name][order[: len(per_mm)]], per_mm / _MM, table, f"{key}: {name}{place}")
            for order, place in zip(of_each, places, strict=True)
        ]
        for name in ("tangential", "sagittal")
    }
    tangential, sagittal = ([values for _, values in share[name]] for name in ("tangential", "sagittal"))
    frequencies, _ = share["tangential"][0]
    if np.abs(np.subtract(tangential[0], sagittal[0])).max() > 2 * _READING:
        raise InputError(
            f"differs on the axis by direction, where there is none, by more than {2 * _READING:g}",
            where=key,
            remedy="give the mean of both at the height 0",
        )
    assumed["camera.lens.mtf.phase"] = "none: a point spread that is alike from both sides"
    assumed["camera.lens.mtf.beyond"] = f"above {frequencies[-1] * _MM:.4g} per mm the same share of the limit"
    tangential[0] = sagittal[0] = tuple(np.mean([tangential[0], sagittal[0]], axis=0).tolist())
    in_metres = tuple(float(one) * _MM for one in heights) if len(heights) > 1 else None
    return ContrastTable(frequencies, tuple(tangential), tuple(sagittal), in_metres)


def _share_of_limit(
    contrast: Array, frequency: Array, table: ContrastModel, where: str
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Frequencies from 0 on [m^-1], and contrast over that of a perfect lens in the table's own light."""
    s = np.minimum(frequency * table.wavelength * table.f_number, 1.0)
    limit = 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s**2))
    outside = np.maximum(contrast - limit - _READING, -contrast)
    worst = int(outside.argmax())
    if outside[worst] > 0:
        raise InputError(
            f"is {contrast[worst]:.3g} at {frequency[worst] * _MM:g} per mm, and a perfect lens leaves "
            f"{limit[worst]:.3g} at f/{table.f_number:g} and {table.wavelength * 1e9:g} nm; it lies from 0 to that",
            where=where,
        )
    if (np.abs(contrast[frequency == 0] - 1) > _READING).any():
        raise InputError("must be 1 at the frequency 0", where=where)
    known = (frequency > 0) & (s < _TELLING)
    if not known.any():
        raise InputError("has no frequency that a perfect lens leaves contrast of", where=where)
    share = np.minimum(contrast[known] / limit[known], 1.0)
    return (0.0, *frequency[known].tolist()), (1.0, *share.tolist())


def _point_spread(table: PointSpreadModel, where: str, *, folder: Path, assumed: dict[str, str]) -> PointSpread:
    """Of a validated ``[camera.lens.psf]``."""
    from radwrap.images import read_gray

    key = f"{where}.file"
    picture = named_file(folder, table.file, key)
    try:
        light = read_gray(picture, most_pixels=_MOST_PIXELS).values
    except InputError as error:
        raise InputError(str(error), where=key) from error
    whole, brightest = float(light.sum()), float(light.max())
    if light.min() < 0 or not whole > 0:
        raise InputError(
            "needs values of 0 or more, some above 0", where=key, remedy="subtract the background, cut at 0"
        )
    border = max(float(side.max()) for side in (light[0], light[-1], light[:, 0], light[:, -1]))
    if border > _AT_BORDER * brightest:
        raise InputError(
            f"has {border / brightest:.2g} of its brightest at its border, where the light must have ended",
            where=key,
            remedy="subtract the background, or give a larger picture",
        )
    signs = (np.where(np.arange(size) % 2, -1.0, 1.0) for size in light.shape)
    left = max(abs(float(sign @ light.sum(axis=axis))) / whole for axis, sign in zip((1, 0), signs, strict=True))
    if left > _AT_HIGHEST:
        raise InputError(
            f"has a contrast of {left:.2g} at the highest frequency that its pixels resolve",
            where=f"{where}.pitch",
            remedy="measure it by finer pixels",
        )
    row, column = np.indices(light.shape)
    middle = float((light * row).sum() / whole), float((light * column).sum() / whole)
    radius = np.hypot(row - middle[0], column - middle[1]).ravel()
    order = np.argsort(radius, kind="stable")
    reach = radius[order][int(np.searchsorted(np.cumsum(light.ravel()[order]), _HELD * whole))]
    rows = tuple(map(tuple, (light / whole).tolist()))
    assumed["camera.lens.psf.middle"] = "the middle of its light"
    assumed["camera.lens.psf.light"] = "what it was measured by: the same for all light, all of the image"
    return PointSpread(sha256_of_value(rows), table.pitch, middle, float(reach) * table.pitch, rows)
