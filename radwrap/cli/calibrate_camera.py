"""``radwrap calibrate camera``: focal length, pose and distortion from views of known points.

POINTS.csv has the header ``x,y,z,u,v`` (in any order, no other column) and one
line a point: x, y, z in the world, in --length-unit; u, v its image in pixels,
u to the right, v down. Results are in SI units, angles in degrees; the camera
frame is x right, y down, z forward. One view gets Tsai's camera, R = Rz Ry Rx,
Xu = Xd (1 + kappa1 r^2), and needs --pixel-width, --pixel-height and --centre.
With a column ``view`` more the table holds several views of a target, and gets
OpenCV's camera in pixels; it needs --image-size. With --target the files are
images, one a view, in which a detector looks for the target of FILE.toml, a
scene or a target's own table (docs/targets.md).
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.calibrate.tsai import SOLVERS, CameraCalibration, as_json, calibrate_camera
from radwrap.calibrate.views import MODELS
from radwrap.cli import calibrate_views
from radwrap.cli import options as shared
from radwrap.errors import InputError
from radwrap.manifest import json_text
from radwrap.reading import FileKind, csv_rows, read_text, shortened, unusable
from radwrap.study.target_points import DETECTORS
from radwrap.units import LENGTH, PIXEL, Dimension, parse_quantity

_COLUMNS: Final = ("x", "y", "z", "u", "v")
_VIEW: Final = "view"
_POINTS: Final = FileKind("file of points", 64 << 20, "give a CSV file with the columns x,y,z,u,v")
_OF_POINTS: Final = ("points", "image", "the points")  # the places of errors that lie in the file


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = verbs.add_parser(
        "camera",
        help="find focal length, pose and distortion from known points",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "points",
        metavar="POINTS.csv | IMAGE",
        nargs="+",
        help="a table with columns x,y,z,u,v, or view,x,y,z,u,v; with --target images",
    )
    parser.add_argument("--target", metavar="FILE.toml", help="for images: the target that they show")
    parser.add_argument(
        "--detector",
        choices=DETECTORS,
        help="for images: the detector: refined (default), sb or corners of a chessboard, charuco, dots (ours, default "
        "of a symmetric grid) or circles (OpenCV's)",
    )
    parser.add_argument("--csv", metavar="FILE", help="for images: table of the points that were found")
    parser.add_argument("--pixel-width", metavar="LENGTH", help='for one view: width of a pixel, such as "13.75 um"')
    parser.add_argument("--pixel-height", metavar="LENGTH", help='for one view: height of a pixel, such as "16 um"')
    parser.add_argument(
        "--centre", metavar=("U", "V"), nargs=2, help="for one view: image centre [px]; a start value where free"
    )
    parser.add_argument("--length-unit", choices=LENGTH.units, help="for tables: unit of x, y, z (default m)")
    parser.add_argument("--solver", choices=SOLVERS, help="for one view: the solver (default tsai)")
    parser.add_argument(
        "--free",
        metavar="NAMES",
        help="for one view: what to find beside the pose, separated by commas: focal_length, distortion, centre, sx "
        '(default focal_length; "" for the pose only)',
    )
    parser.add_argument("--focal-length", metavar="LENGTH", help="its value where it is not free")
    parser.add_argument(
        "--kappa1", metavar="K", type=shared.number(), help="distortion where it is not free [1/m^2] (default 0)"
    )
    parser.add_argument(
        "--sx", metavar="S", type=shared.number(1e-3, 1e3), help="horizontal scale where it is not free (default 1)"
    )
    parser.add_argument("--model", choices=MODELS, help="for several views: distortion (default brown)")
    parser.add_argument(
        "--image-size",
        metavar=("COLUMNS", "ROWS"),
        nargs=2,
        type=int,
        help="for several views: the sensor's pixels; images have their own",
    )
    parser.add_argument(
        "--picture",
        metavar="FILE.png",
        help="for several views: maps of the projection's standard error over the image",
    )
    parser.add_argument(
        "--noise",
        metavar="PX",
        type=shared.number(1e-6, 1e3),
        help="for several views: standard deviation of u and v (default: by the residuals)",
    )
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the verb."""
    if arguments.target is not None:
        return calibrate_views.of_images(arguments)
    for name in ("detector", "csv"):
        if getattr(arguments, name) is not None:
            raise InputError(
                "belongs to images", where=f"--{name}", remedy="name their target by --target, or leave it out"
            )
    table, *others = arguments.points
    if others:
        raise InputError("is one table too many", where=others[0], remedy="name the target of images by --target")
    unit = LENGTH.units[arguments.length_unit or "m"]
    views, points, image = read_points(Path(table), unit)
    if views is not None:
        return calibrate_views.of_table(arguments, views, points, image)
    for name in ("model", "image_size", "noise", "picture"):
        if getattr(arguments, name) is not None:
            raise InputError(
                "belongs to a table of several views",
                where=f"--{name.replace('_', '-')}",
                remedy=f"give {table} a column view, or leave it out",
            )
    for name in ("pixel_width", "pixel_height", "centre"):
        if getattr(arguments, name) is None:
            raise InputError("is needed with a table of one view", where=f"--{name.replace('_', '-')}")
    pixel_width = _quantity(arguments.pixel_width, LENGTH, "--pixel-width")
    pixel_height = _quantity(arguments.pixel_height, LENGTH, "--pixel-height")
    u, v = (_pixels(text) for text in arguments.centre)
    focal_length = arguments.focal_length and _quantity(arguments.focal_length, LENGTH, "--focal-length")
    free = "focal_length" if arguments.free is None else arguments.free
    try:
        found = calibrate_camera(
            points,
            image,
            pixel_width=pixel_width,
            pixel_height=pixel_height,
            centre=(u, v),
            solver=arguments.solver or "tsai",
            free=[name.strip() for name in free.split(",")] if free.strip() else [],
            focal_length=focal_length,
            kappa1=arguments.kappa1,
            sx=arguments.sx,
        )
    except InputError as error:
        where = f"{table}: {error.where}" if error.where in _OF_POINTS else error.where
        raise InputError(error.what, where=where, remedy=error.remedy) from error
    told = {**as_json(found), "pixel_width": pixel_width, "pixel_height": pixel_height}
    print(json_text(told) if arguments.json else "\n".join(_lines(found)) + "\n", end="")
    return 0


def read_points(path: Path, unit: float) -> tuple[list[str] | None, NDArray[np.float64], NDArray[np.float64]]:
    """Read known points and their images.

    Parameters
    ----------
    path : Path
        CSV file with the columns x, y, z, u, v, and perhaps view.
    unit : float
        Unit of x, y, z [m].

    Returns
    -------
    list of str or None
        Of each point the name of its view; None where the table has no such column.
    ndarray, shape (n, 3)
        Points in the world [m].
    ndarray, shape (n, 2)
        Their images u, v [px].

    Raises
    ------
    InputError
        If the file cannot be read, a column is missing, unknown or twice, a view has no name, or a line does not hold
        five finite numbers; the error names the line.
    """
    lines = read_text(path, _POINTS).splitlines()
    if not lines:
        raise InputError("is empty", where=str(path), remedy="begin with the header x,y,z,u,v")
    header = [name.strip() for name in next(csv_rows(lines[0], str(path)), (1, []))[1]]
    named = _VIEW in header
    due = (_VIEW, *_COLUMNS) if named else _COLUMNS
    if sorted(header) != sorted(due):
        raise InputError(
            f'the header is "{shortened(lines[0])}"',
            where=f"{path}:1",
            remedy="it must name x,y,z,u,v, each once, and no more but view",
        )
    order = [header.index(name) for name in due]
    rows = [_row(cells, order, due, f"{path}:{number}") for number, cells in _cells(lines, path)]
    values = np.array([numbers for _, numbers in rows], dtype=np.float64).reshape(-1, len(_COLUMNS))
    return [name for name, _ in rows] if named else None, values[:, :3] * unit, values[:, 3:]


def _cells(lines: Sequence[str], path: Path) -> Iterator[tuple[int, list[str]]]:
    """Number and cells of each line below the header; empty lines at the end do not count."""
    last = max(number for number, line in enumerate(lines, 1) if line.strip() or number == 1)
    for number, line in enumerate(lines[1:last], 2):
        yield number, next(csv_rows(line, f"{path}:{number}"), (1, []))[1]


def _row(cells: Sequence[str], order: Sequence[int], due: Sequence[str], where: str) -> tuple[str, list[float]]:
    """The view's name, if it is due, and the numbers."""
    if len(cells) != len(due):
        count = "five" if len(due) == len(_COLUMNS) else "six"
        raise InputError(f"holds {len(cells)} values", where=where, remedy=f"{count} are needed: {','.join(due)}")
    told = [cells[index] for index in order]
    name = told.pop(0).strip() if due[0] == _VIEW else ""
    if due[0] == _VIEW and not name:
        raise InputError("the view has no name", where=where)
    return name, [_number(text, column, where) for text, column in zip(told, _COLUMNS, strict=True)]


def _number(text: str, name: str, where: str, remedy: str = "leave the point out") -> float:
    try:
        value = float(text)
    except ValueError as error:
        raise InputError(f'{name} "{shortened(text)}" is not a number', where=where) from error
    if why := unusable(value):
        raise InputError(f"{name} {shortened(text)} {why}", where=where, remedy=remedy)
    return value


def _quantity(text: str, dimension: Dimension, where: str) -> float:
    try:
        return parse_quantity(text, dimension)
    except InputError as error:
        raise InputError(str(error), where=where) from error


def _pixels(text: str) -> float:
    """A position on the sensor: bare as in the file's columns u, v, or with its unit as in a scene."""
    if "px" in text:
        return _quantity(text, PIXEL, "--centre")
    return _number(text, "position", "--centre", remedy="write columns and rows, such as 95.5 82")


def _lines(found: CameraCalibration) -> Iterator[str]:
    sigma = found.sigma
    degrees = [math.degrees(angle) for angle in found.angles]
    yield f"focal length: {found.focal_length * 1e3:.6g} mm{_error(sigma.focal_length, 1e3, 'mm')}"
    for axis, value, error in zip("xyz", found.translation, sigma.translation, strict=True):
        yield f"translation {axis}: {value * 1e3:.6g} mm{_error(error, 1e3, 'mm')}"
    for axis, value, error_ in zip("xyz", degrees, sigma.rotation or (None,) * 3, strict=True):
        yield f"rotation {axis}: {value:.6g} deg{_error(error_, math.degrees(1.0), 'deg')}"
    yield f"kappa1: {found.kappa1:.6g} /m^2{_error(sigma.kappa1, 1.0, '/m^2')}"
    yield f"sx: {found.sx:.8g}{_error(sigma.sx, 1.0, '')}"
    for axis, value, error_ in zip("uv", found.centre, sigma.centre or (None, None), strict=True):
        yield f"centre {axis}: {value:.6g} px{_error(error_, 1.0, 'px')}"
    yield (
        f"residuals: {found.rms:.4g} px rms over {found.points} {'coplanar ' if found.coplanar else ''}points, "
        f"sum of squares {found.sse:.6g} px^2"
    )
    yield (
        f"minimum: gradient norm {found.gradient_norm:.2g} px, condition {found.condition:.3g}, solver {found.solver}"
    )
    if (linear := found.linear_stage) is not None:
        yield f"linear stage only: focal length {linear.focal_length * 1e3:.6g} mm, {linear.rms:.4g} px rms"
    for note in found.notes:
        yield f"note: {note}"


def _error(sigma: float | None, factor: float, unit: str) -> str:
    return " (held)" if sigma is None else f" +- {sigma * factor:.2g} {unit}".rstrip()
