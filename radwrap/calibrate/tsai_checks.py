"""What one view of known points cannot tell, said before or after the least squares."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from radwrap.calibrate.camera_model import Array, Camera, fold_margin, to_camera
from radwrap.calibrate.tsai_linear import cloud_of
from radwrap.calibrate.tsai_refine import FREE, Minimum, physical_columns
from radwrap.errors import InputError

# The radial alignment constraint has 5 unknowns for coplanar points, 7 for others (Tsai 1987).
FEWEST_COPLANAR: Final = 5
FEWEST_SPATIAL: Final = 7

# Thickness over length below which points count as coplanar: a board's own flatness, and not enough depth to tell sx.
COPLANAR: Final = 1e-3

# Width over length below which points count as collinear: of the order of the noise of image points over their extent.
COLLINEAR: Final = 1e-3

# Distance over extent below which two points are one: the rounding of a file of points.
DUPLICATE: Final = 1e-6

# Tilt of a board [rad] below which its focal length and its distance are one number. Tsai asks for 30 degrees; at 10
# the standard error of f is 4 times that at 46, and still a number worth having; below, it grows as 1/tilt^2 and the
# distribution of f is no longer a normal one.
SMALLEST_TILT: Final = math.radians(9.0)

# Condition number of the scaled Jacobian above which free values cannot be told apart: round-off of 1e-16 would move
# them by more than 1e-5 of themselves even without noise. The long lens of the benchmark has 1e3.
LARGEST_CONDITION: Final = 1e10

# Residuals over the image's extent above which points and images cannot belong together, and above which something is
# not in the model: dots are found to 1e-3 of a board's image or better.
LARGEST_MISFIT: Final = 0.1
DOUBTFUL_MISFIT: Final = 0.01

# Standard errors by which distortion must differ from 0 before one planar view can give the image centre.
SIGNIFICANT: Final = 3.0


def check_request(free: Iterable[str], solver: str, solvers: tuple[str, ...], **held: float | None) -> frozenset[str]:
    """The names of what is to be found, checked against what is to be held.

    Raises
    ------
    InputError
        If a name is unknown or comes twice, a value is given for what is free, or none for a held focal length.
    """
    if solver not in solvers:
        raise InputError(f'"{solver}" is not a solver', where="solver", remedy=f"use one of: {', '.join(solvers)}")
    names = [free] if isinstance(free, str) else list(free)
    for name in names:
        if name not in FREE:
            raise InputError(f'"{name}" cannot be free', where="free", remedy=f"use some of: {', '.join(FREE)}")
        if names.count(name) > 1:
            raise InputError(f"names {name} twice", where="free")
    for name, value in held.items():
        if value is not None:
            if ("distortion" if name == "kappa1" else name) in names:
                raise InputError(f"is free, so that the value {value:g} has no effect", where=name, remedy="drop one")
            if not math.isfinite(value) or (name != "kappa1" and value <= 0.0):
                raise InputError(
                    f"{value:g} is not a {'finite number' if name == 'kappa1' else 'number above 0'}", where=name
                )
    if "focal_length" not in names and held["focal_length"] is None:
        raise InputError("is not free and has no value", where="focal_length", remedy="give its value, or free it")
    return frozenset(names)


def check_points(
    points: ArrayLike,
    image: ArrayLike,
    free: frozenset[str],
    *,
    pixel: tuple[float, float],
    centre: tuple[float, float],
    kappa1: float | None,
) -> tuple[Array, Array, bool]:
    """The points as arrays, and whether they are coplanar.

    Raises
    ------
    InputError
        If numbers are missing, not finite, too few, duplicate or collinear, or cannot tell what is free.
    """
    world, seen = np.asarray(points, dtype=np.float64), np.asarray(image, dtype=np.float64)
    for values, width, where in ((world, 3, "points"), (seen, 2, "image")):
        if values.ndim != 2 or values.shape[1] != width:
            raise InputError(f"needs the shape (n, {width}), not {values.shape}", where=where)
        if not np.isfinite(values).all():
            row = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0]) + 1
            raise InputError(f"point {row} holds NaN or infinity", where=where)
    if len(world) != len(seen):
        raise InputError(f"{len(world)} points but {len(seen)} images", where="points")
    if not all(map(_is_size, pixel)):
        raise InputError(
            "must be finite and above 0", where="pixel_width" if not _is_size(pixel[0]) else "pixel_height"
        )
    if len(centre) != 2 or not all(map(math.isfinite, centre)):
        raise InputError("needs two finite numbers", where="centre")

    count = len(world)
    if count < FEWEST_COPLANAR:
        raise InputError(f"{count} are too few", where="points", remedy="give at least 5 in a plane, or 7 in space")
    _check_duplicates(world, "points")
    sizes = cloud_of(world).sizes
    if sizes[1] <= COLLINEAR * sizes[0]:
        raise InputError("lie on one line, which leaves the rotation about it undetermined", where="points")
    flat = bool(sizes[2] <= COPLANAR * sizes[0])
    if not flat and count < FEWEST_SPATIAL:
        raise InputError(
            f"{count} are too few", where="points", remedy="give at least 7 where they are not in one plane"
        )
    across = np.linalg.svd(seen - seen.mean(axis=0), compute_uv=False)
    if across[1] <= COLLINEAR * across[0]:
        raise InputError(
            "the points appear on one line: a board is seen edge on, or the columns are mixed up", where="image"
        )
    if flat:
        _check_duplicates(seen, "image")
        _check_flat(free, kappa1 or 0.0)
    unknowns = len(physical_columns(free))
    if 2 * count <= unknowns:
        raise InputError(
            f"{count} give {2 * count} equations for {unknowns} unknowns, too few to estimate their errors",
            where="points",
            remedy="give more points, or free less",
        )
    return world, seen, flat


def _is_size(side: float) -> bool:
    return math.isfinite(side) and side > 0.0


def _check_duplicates(values: Array, where: str) -> None:
    """Refuse the same point twice: an error of the list, and no evidence."""
    from scipy.spatial import KDTree

    limit = DUPLICATE * float(np.ptp(values, axis=0).max())
    # Equal points, which a tree cannot part, would each be held against all others.
    distinct, place, times = np.unique(values, axis=0, return_inverse=True, return_counts=True)
    close = times > 1
    if len(distinct) > 1:
        close |= KDTree(distinct).query(distinct, k=2, p=np.inf)[0][:, 1] <= limit
    if not close.any():
        return
    first = int(close[place.ravel()].argmax())
    second = first + 1 + int((np.max(np.abs(values[first + 1 :] - values[first]), axis=1) <= limit).argmax())
    raise InputError(f"points {first + 1} and {second + 1} are the same", where=where, remedy="each point once")


def _check_flat(free: frozenset[str], kappa1: float) -> None:
    """What one view of one plane can never tell."""
    if "sx" in free:
        raise InputError(
            "cannot be determined from coplanar points: it trades off against the board's pose",
            where="sx",
            remedy="hold it, or use points in space",
        )
    if {"centre", "focal_length"} <= free and "distortion" not in free and kappa1 == 0.0:
        raise InputError(
            "cannot be freed with the focal length in one undistorted view of a plane: 9 unknowns, and the plane's 8 "
            "constraints; the Jacobian is exactly singular",
            where="centre",
            remedy="hold the centre or the focal length, free the distortion too, or use points in space",
        )


def check_found(
    found: Minimum,
    points: Array,
    image: Array,
    free: frozenset[str],
    *,
    tilt: float | None,
    kappa1_error: float,
) -> None:
    """Refuse a minimum that does not tell what was asked for.

    Raises
    ------
    InputError
        If points lie behind the camera, a board is too nearly fronto-parallel, the image folds over, the unknowns
        cannot be told apart, or no minimum was reached.
    """
    camera = found.camera
    behind = np.flatnonzero(to_camera(camera, points)[:, 2] <= 0.0) + 1
    if behind.size:
        raise InputError(
            f"{behind.size} of them, such as point {behind[0]}, would lie behind the camera",
            where="points",
            remedy="check that u runs to the right and v down, the units, and which image belongs to which point",
        )
    if tilt is not None and "focal_length" in free and tilt < SMALLEST_TILT:
        raise InputError(
            f"the board is tilted by {math.degrees(tilt):.1f} degrees only: nearly parallel to the image plane, its "
            f"focal length and its distance are one number",
            where="points",
            remedy="tilt it by 30 degrees or more (10 at the least), or hold the focal length",
        )
    if fold_margin(camera, points) <= 0.0:
        raise InputError(
            f"kappa1 {camera.kappa1:.4g} /m^2 folds the image over within the points",
            where="distortion",
            remedy="check pixel size and centre, or hold the distortion",
        )
    _check_told(found, camera, free, tilt is not None, kappa1_error)
    if (share := misfit(found, image)) > LARGEST_MISFIT:
        raise InputError(
            f"do not fit the images: {100.0 * share:.0f} % of the image's size is left over",
            where="points",
            remedy="check which image belongs to which point, units, pixel size and centre",
        )


def misfit(found: Minimum, image: Array) -> float:
    """Root mean square residual over the root mean square extent of the image, shape (n, 2) [px]."""
    return math.sqrt(found.sse / float(np.sum((image - image.mean(axis=0)) ** 2)))


def _check_told(found: Minimum, camera: Camera, free: frozenset[str], flat: bool, kappa1_error: float) -> None:
    if flat and {"centre", "focal_length", "distortion"} <= free and abs(camera.kappa1) < SIGNIFICANT * kappa1_error:
        raise InputError(
            f"cannot be determined from one view of a plane whose distortion, kappa1 {camera.kappa1:.3g} +- "
            f"{kappa1_error:.2g} /m^2, does not differ from 0: undistorted, the Jacobian is singular",
            where="centre",
            remedy="hold the centre, or use points in space",
        )
    if not found.converged:
        raise InputError(
            f"the sum of squares has no minimum near {found.sse:.3g} px^2 (focal length {camera.focal_length:.3g} m, "
            f"depth {camera.position[2]:.3g} m): the points show too little perspective, or the wrong one",
            where="points",
            remedy="check units, pixel size and that the image is not mirrored (u right, v down); tilt more, or hold f",
        )
    if not found.condition < LARGEST_CONDITION:
        raise InputError(
            f"cannot determine {', '.join(sorted(free)) or 'the pose'}: the condition number is {found.condition:.1e}",
            where="points",
            remedy="free less, or use more points, farther from one plane and from fronto-parallel",
        )
