"""``radwrap calibrate camera IMAGES... --target FILE``: views of a target by what detectors find in images."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from radwrap.calibrate.views import CalibrationView
from radwrap.cli import raw_mosaic
from radwrap.errors import InputError
from radwrap.images import GrayImage
from radwrap.measure.targets import PointsNotFound
from radwrap.progress import Progress
from radwrap.scene.file.target_file import load_target
from radwrap.study.target_points import Detector, detector_of, finder_of

_MOST_NAMED: Final = 3


def views_of(
    images: Sequence[Path], target: Path, detector: Detector | None, image_size: tuple[int, int] | None
) -> tuple[list[CalibrationView], tuple[int, int], Detector]:
    """Views as a table has them, from images.

    Parameters
    ----------
    images : sequence of Path
        One view each.
    target : Path
        A scene with the target, or the target's own file.
    detector : str, optional
        Default that of the target's kind.
    image_size : tuple of int, optional
        Columns and rows that all images must have.

    Returns
    -------
    list of CalibrationView, tuple of int, str
        Named as the images are; columns and rows; the detector.

    Raises
    ------
    InputError
        If an image cannot be read, stands twice or has another size, or nothing is found in some; it names them.
    """
    _, layout = load_target(target)
    chosen = detector_of(layout, detector, target=f"--target {target}", where="--detector")
    find = finder_of(layout, chosen)
    _check_once(images)
    found: list[CalibrationView] = []
    failed: list[tuple[Path, PointsNotFound]] = []
    progress = Progress("looking for the target", len(images))
    try:
        for path in images:
            image = raw_mosaic.one_colour(path)
            image_size = _same_size(path, image, images[0], image_size)
            try:
                places, shown = find(image)
            except PointsNotFound as error:
                failed.append((path, error))
            except InputError as error:
                raise InputError(error.what, where=error.where or str(path), remedy=error.remedy) from error
            else:
                points = np.column_stack([np.array(places), np.zeros(len(places))])
                found.append(CalibrationView(points, shown, str(path)))
            progress.add(1)
    finally:
        progress.close()
    if failed:
        raise _nothing_in(failed, len(images))
    if image_size is None:
        raise InputError("no image is given", where="IMAGES")
    return found, image_size, chosen


def _check_once(images: Sequence[Path]) -> None:
    seen: set[Path] = set()
    for path in images:
        if (place := path.resolve()) in seen:
            raise InputError("is given twice", where=str(path), remedy="give each image once")
        seen.add(place)


def _same_size(path: Path, image: GrayImage, first: Path, size: tuple[int, int] | None) -> tuple[int, int]:
    rows, columns = image.values.shape
    if size is None or size == (columns, rows):
        return columns, rows
    due = f"{size[0]} x {size[1]}"
    raise InputError(
        f"has {columns} x {rows} pixels, not {due} as {first if path != first else '--image-size'} says",
        where=str(path),
        remedy="one camera's images have one size",
    )


def _nothing_in(failed: Sequence[tuple[Path, PointsNotFound]], images: int) -> InputError:
    names = ", ".join(str(path) for path, _ in failed[:_MOST_NAMED])
    more = f" and {len(failed) - _MOST_NAMED} more" if len(failed) > _MOST_NAMED else ""
    (_, first), *_ = failed
    whole = f" ({len(failed)} of {images} images)" if images > 1 else ""
    return InputError(f"{first.what}{whole}", where=f"{names}{more}", remedy=f"{first.remedy}, or leave them out")
