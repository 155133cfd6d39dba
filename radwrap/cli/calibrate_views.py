"""``radwrap calibrate camera`` with several views: a table with columns ``view,x,y,z,u,v``, or images of a target."""

from __future__ import annotations

import argparse
import csv
import io
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.calibrate.projection_uncertainty import NoPlace, UncertaintyOverImage, uncertainty_over_image
from radwrap.calibrate.several_views import ViewsCalibration, as_json, calibrate_views
from radwrap.calibrate.uncertainty_picture import uncertainty_picture
from radwrap.calibrate.views import CalibrationView
from radwrap.cli import options as shared
from radwrap.cli.calibrate_images import views_of
from radwrap.errors import InputError
from radwrap.files import write_bytes
from radwrap.manifest import json_text

# Options that only one view takes.
OF_ONE_VIEW: Final = ("pixel_width", "pixel_height", "centre", "solver", "focal_length", "kappa1", "sx", "free")
_OF_THE_FILE: Final = ("views", "view ", "OpenCV")  # how the places of errors begin that lie in the file
_LARGEST: Final = 1 << 16  # px


def of_table(
    arguments: argparse.Namespace, names: list[str], points: NDArray[np.float64], image: NDArray[np.float64]
) -> int:
    """Carry out the verb, on the lines of a table: their views, points [m], and pixels."""
    _refuse_of_one_view(arguments)
    picture = shared.file_to_write(arguments.picture, "--picture", ".png", others=arguments.points)
    size = _image_size(arguments)
    if size is None:
        raise InputError("is needed with a table of several views", where="--image-size", remedy="such as 2448 2048")
    of, (table,) = np.array(names), arguments.points
    with _placed(table):
        views = [CalibrationView(points[of == name], image[of == name], name) for name in dict.fromkeys(names)]
    return _told(arguments, views, size, table, {}, picture=picture)


def of_images(arguments: argparse.Namespace) -> int:
    """Carry out the verb, on images of the target that --target names."""
    _refuse_of_one_view(arguments)
    if arguments.length_unit is not None:
        raise InputError("belongs to a table", where="--length-unit", remedy="leave it out: the target has its units")
    images = [Path(name) for name in arguments.points]
    table = shared.file_to_write(arguments.csv, "--csv", others=[*images, arguments.target])
    picture = shared.file_to_write(
        arguments.picture, "--picture", ".png", others=[*images, arguments.target, arguments.csv]
    )
    views, size, detector = views_of(images, Path(arguments.target), arguments.detector, _image_size(arguments))
    if table is not None:
        write_bytes(table, _csv(views).encode())
    return _told(arguments, views, size, "images", {"target": arguments.target, "detector": detector}, picture=picture)


def _csv(views: list[CalibrationView]) -> str:
    """The points as `of_table` reads them, in metres."""
    text = io.StringIO()
    lines = csv.writer(text, lineterminator="\n")
    lines.writerow(("view", "x", "y", "z", "u", "v"))
    for view in views:
        for point, shown in zip(view.points.tolist(), view.image.tolist(), strict=True):
            lines.writerow((view.name, *point, *shown))
    return text.getvalue()


def _refuse_of_one_view(arguments: argparse.Namespace) -> None:
    for name in OF_ONE_VIEW:
        if getattr(arguments, name) is not None:
            raise InputError(
                "belongs to a table of one view", where=f"--{name.replace('_', '-')}", remedy="leave it out"
            )


def _image_size(arguments: argparse.Namespace) -> tuple[int, int] | None:
    if arguments.image_size is None:
        return None
    columns, rows = arguments.image_size
    if not (0 < columns <= _LARGEST and 0 < rows <= _LARGEST):
        raise InputError(f"must be columns and rows, 1 to {_LARGEST}", where="--image-size")
    return columns, rows


@contextmanager
def _placed(origin: str) -> Iterator[None]:
    """Errors within name the file, or the option."""
    try:
        yield
    except NoPlace as error:
        raise InputError(
            "was calibrated, but its distortion runs back on itself within the image, where the projection's error "
            "then has no value: the views do not determine the distortion",
            where=origin,
            remedy="take more views, up to the image's corners, or a model of fewer coefficients",
        ) from error
    except InputError as error:
        inside = error.where is not None and error.where.startswith(_OF_THE_FILE)
        where = f"{origin}: {error.where}" if inside else f"--{error.where}"
        raise InputError(error.what, where=where, remedy=error.remedy) from error


def _told(
    arguments: argparse.Namespace,
    views: list[CalibrationView],
    size: tuple[int, int],
    origin: str,
    how: dict[str, Any],
    *,
    picture: Path | None,
) -> int:
    with _placed(origin):
        found = calibrate_views(views, size, model=arguments.model or "brown", noise=arguments.noise)
        near = float(np.mean([view.distance for view in found.views]))
        over = [uncertainty_over_image(found, distance) for distance in (near, math.inf)]
        if picture is not None:
            write_bytes(picture, uncertainty_picture(found, (near, math.inf)))
    print(
        json_text({**as_json(found), **how, "projection_uncertainty": [_over(one) for one in over]})
        if arguments.json
        else "\n".join(_lines(found, over)) + "\n",
        end="",
    )
    return 0


def _over(one: UncertaintyOverImage) -> dict[str, Any]:
    """JSON has no infinity: there the distance is null."""
    return {
        "distance": one.distance if math.isfinite(one.distance) else None,
        "columns": list(one.columns),
        "rows": list(one.rows),
        "sigma_px": [list(row) for row in one.sigma],
    }


def _lines(found: ViewsCalibration, over: list[UncertaintyOverImage]) -> Iterator[str]:
    matrix, sigma = found.camera_matrix, found.sigma
    for name, value in zip(
        ("fx", "fy", "cx", "cy"), (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]), strict=True
    ):
        yield f"{name}: {value:.8g} px +- {sigma[name]:.2g} px"
    coefficients = dict(zip(found.coefficients, found.distortion_coefficients.tolist(), strict=True))
    for name in found.parameters[4:]:
        yield f"{name}: {coefficients[name]:.6g} +- {sigma[name]:.2g}"
    count = sum(view.points for view in found.views)
    yield f"residuals: {found.rms:.4g} px rms over {count} points in {len(found.views)} views, model {found.model}"
    whose = "as given" if found.noise_given else f"by {found.degrees_of_freedom} degrees of freedom"
    yield f"noise: {found.noise:.4g} px a coordinate, {whose}"
    yield (
        f"minimum: {found.cost:.8g} px^2, gradient {found.gradient_norm:.2g} of the residuals; OpenCV ends at "
        f"{found.opencv_cost:.8g} px^2"
    )
    for one in over:
        far = f"at {one.distance:.4g} m" if math.isfinite(one.distance) else "at infinity"
        middle = one.sigma[len(one.rows) // 2][len(one.columns) // 2]
        yield f"projection {far}: +- {middle:.2g} px in the middle, +- {max(map(max, one.sigma)):.2g} px at most"
    worst = max(found.views, key=lambda view: view.rms)
    yield f"worst view: {worst.name}, {worst.rms:.4g} px rms"
    for note in found.notes:
        yield f"note: {note}"
