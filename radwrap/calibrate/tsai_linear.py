"""Start values for Tsai's camera: the radial alignment constraint and what follows from it.

A point's image lies on the ray from the image centre towards the point's
(X, Y) in the camera frame, whatever the focal length, the depth and the
radial distortion: Xd Y - Yd X = 0. That is linear in the first two rows of the
pose. Tsai divides the equation by Ty, which fails where Ty is near 0 (a board
centred on the axis). Here it stays homogeneous, with the points about their
centroid: the solution is the null vector, nothing is divided by, and no
origin has to be moved. Source: Tsai (1987), key tsai1987, Sec. II.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Final

import numpy as np

from radwrap.calibrate.camera_model import Array, Camera, image_metric, moved, nearest_rotation, project, to_camera

# Second smallest singular value over the largest, below which the constraint leaves more than one pose.
_AMBIGUOUS: Final = 1e-9

# Depth in units of the object's size where a start value is needed and the linear stage has none; from the order of
# size of a close bench camera to that of a long lens.
_DEPTHS: Final = (5.0, 30.0)

# Smallest 1 + 3 kappa1 r^2 that a start value may have: the fold of the image must stay out of reach.
_SAFE_MARGIN: Final = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """The calibration points about their centroid.

    Attributes
    ----------
    centroid : ndarray, shape (3,)
        [m].
    axes : ndarray, shape (3, 3)
        world_from_plane: its columns are the two long directions and the normal of the best plane.
    sizes : ndarray, shape (3,)
        Root mean square extent along these [m], falling.
    """

    centroid: Array
    axes: Array
    sizes: Array


def cloud_of(points: Array) -> Cloud:
    """Centroid, best plane and extent of points, shape (n, 3) [m]."""
    centroid = points.mean(axis=0)
    _, sizes, vt = np.linalg.svd(points - centroid, full_matrices=False)
    axes = vt.T if np.linalg.det(vt) > 0 else -vt.T
    return Cloud(centroid, axes, sizes / np.sqrt(len(points)))


def start_values(
    camera: Camera, points: Array, image: Array, cloud: Cloud, free: frozenset[str], *, flat: bool
) -> tuple[list[Camera], list[Camera]]:
    """Cameras to start the least squares from.

    Parameters
    ----------
    camera : Camera
        Carries the values that are held, `origin` (the centroid) and the pixel; its pose does not matter.
    points : ndarray, shape (n, 3)
        [m].
    image : ndarray, shape (n, 2)
        u, v [px].
    cloud : Cloud
        Of `points`.
    free : frozenset of str
        What is to be found beside the pose.
    flat : bool
        Whether to use the coplanar form.

    Returns
    -------
    list of Camera
        The linear stage's own answers, best first.
    list of Camera
        Poses whose own focal length came out negative, as it does of a mirror pose or from noise, at assumed depths.
        Both lists are empty where the points leave the pose undetermined.
    """
    metric = image_metric(camera, image)
    poses = _coplanar(points, metric, cloud) if flat else _spatial(points, metric, cloud, "sx" in free)
    linear: list[Camera] = []
    others: list[Camera] = []
    for rotation, across, sx in poses:
        posed = moved(camera, rotation=rotation, position=np.array([*across, 0.0]), sx=camera.sx * sx)
        found = _with_depth(posed, points, image, free)
        (linear if found.focal_length > 0.0 and found.position[2] > 0.0 else others).append(found)
    if not flat and (direct := _direct(camera, points, metric, cloud, free)) is not None:
        linear.append(direct)
    guessed = [
        _at_depth(found, points, image, depth * float(cloud.sizes[0]), free)
        for found, depth in itertools.product(others, _DEPTHS)
    ]
    linear.sort(key=lambda found: float(np.sum((project(found, points) - image) ** 2)))
    return linear, guessed


_Pose = tuple[Array, tuple[float, float], float]  # rotation, position across the axis [m], correction of sx


def _null_vector(rows: Array) -> Array | None:
    """Unit vector that `rows` map nearest to zero; None where there are several."""
    _, sizes, vt = np.linalg.svd(rows, full_matrices=len(rows) < rows.shape[1])
    if sizes[vt.shape[0] - 2] <= _AMBIGUOUS * sizes[0]:
        return None
    vector: Array = vt[-1]
    return vector


def _alignment(local: Array, metric: Array) -> Array:
    """Rows of Xd (row_y . P + Ty) - Yd (row_x . P + Tx) = 0; the unknowns are row_x, Tx, row_y, Ty."""
    ones = np.column_stack([local, np.ones(len(local))])
    return np.hstack([-metric[:, 1:2] * ones, metric[:, 0:1] * ones])


def _facing(block: Array, across: Array, local: Array, metric: Array) -> float:
    """Sign that makes points and their images lie on the same side of the axis."""
    return 1.0 if float(np.sum((local @ block.T + across) * metric)) >= 0.0 else -1.0


def _coplanar(points: Array, metric: Array, cloud: Cloud) -> list[_Pose]:
    """Coplanar form: the pose and its mirror pose, which only the perspective tells apart.

    The 2x2 block of the rotation has the singular values 1 and |cos tilt|;
    the first sets the scale (Tsai's |Ty|, without his case distinctions and
    without the loss of digits of his root).
    """
    size = float(cloud.sizes[0])
    local = ((points - cloud.centroid) @ cloud.axes)[:, :2] / size
    vector = _null_vector(_alignment(local, metric / np.sqrt(np.mean(metric**2))))
    if vector is None:
        return []
    block, across = np.array([vector[0:2], vector[3:5]]), vector[[2, 5]]
    u, values, _ = np.linalg.svd(block)
    scale = _facing(block, across, local, metric) / values[0]
    cosine = values[1] / values[0]
    sine = np.sqrt(max(0.0, 1.0 - cosine**2))
    poses = []
    for sign in (1.0, -1.0):
        first, second = np.column_stack([block * scale, sign * sine * u[:, 1]])
        rotation = nearest_rotation(np.array([first, second, np.cross(first, second)]))
        tx, ty = across * scale * size
        poses.append((rotation @ cloud.axes.T, (float(tx), float(ty)), 1.0))
    return poses


def _spatial(points: Array, metric: Array, cloud: Cloud, find_sx: bool) -> list[_Pose]:
    """Non-coplanar form: both rows of the rotation, whose lengths differ by sx."""
    size = float(cloud.sizes[0])
    local = (points - cloud.centroid) / size
    vector = _null_vector(_alignment(local, metric / np.sqrt(np.mean(metric**2))))
    if vector is None:
        return []
    rows, across = np.array([vector[0:3], vector[4:7]]), vector[[3, 7]]
    lengths = np.linalg.norm(rows, axis=1)
    if not np.all(lengths > 0.0):
        return []
    sx = float(lengths[0] / lengths[1]) if find_sx else 1.0
    rows, across = rows / [[sx], [1.0]], across / [sx, 1.0]
    u, values, vt = np.linalg.svd(rows, full_matrices=False)
    sign = _facing(rows, across, local, metric)
    first, second = sign * u @ vt
    rotation = np.array([first, second, np.cross(first, second)])
    tx, ty = sign * across * size / values.mean()
    return [(rotation, (float(tx), float(ty)), sx)]


def _direct(camera: Camera, points: Array, metric: Array, cloud: Cloud, free: frozenset[str]) -> Camera | None:
    """Direct linear transformation: a second start, for sets that leave the radial constraint ambiguous.

    Such as the corners of a cube on the optical axis: they lie on quadrics
    that hold the axis, and the constraint cannot tell them from other poses.
    """
    size, spread = float(cloud.sizes[0]), float(np.sqrt(np.mean(metric**2)))
    ones = np.column_stack([(points - cloud.centroid) / size, np.ones(len(points))])
    x, y = metric.T / spread
    none = np.zeros_like(ones)
    vector = _null_vector(
        np.vstack([np.hstack([ones, none, -x[:, None] * ones]), np.hstack([none, ones, -y[:, None] * ones])])
    )
    if vector is None:
        return None
    rows = vector.reshape(3, 4)
    length = float(np.linalg.norm(rows[2, :3]))
    if length <= _AMBIGUOUS:
        return None
    rows = rows / (length * (1.0 if rows[2, 3] >= 0.0 else -1.0))
    ahead = rows[2, :3]
    across = rows[:2, :3] - np.outer(rows[:2, :3] @ ahead, ahead)
    lengths = np.linalg.norm(across, axis=1)
    if not np.all(lengths > 0.0) or np.linalg.det(np.vstack([across, ahead])) <= 0.0:
        return None
    offset = rows[:2, 3] - (rows[:2, :3] @ ahead) * rows[2, 3]
    found = moved(
        camera,
        rotation=nearest_rotation(np.vstack([across / lengths[:, None], ahead])),
        position=np.array([*(offset / lengths), rows[2, 3]]) * size,
    )
    if "focal_length" in free:
        found = moved(found, focal_length=float(lengths[1] * spread))
    if "sx" in free:
        found = moved(found, sx=camera.sx * float(lengths[0] / lengths[1]))
    return found if found.position[2] > 0.0 else None


def _with_depth(posed: Camera, points: Array, image: Array, free: frozenset[str]) -> Camera:
    """Focal length, depth and distortion of a pose whose rotation and (X, Y) stand, by linear equations.

    f x - Xd (1 + kappa1 r^2) (w + Tz) = 0, first with kappa1 as it is held, then with kappa1 where it is free.
    """
    metric = image_metric(posed, image)
    square = np.sum(metric**2, axis=1)
    straight = metric * (1.0 + posed.kappa1 * square)[:, None]
    inside = to_camera(posed, points)
    across, w = inside[:, :2].ravel(), np.repeat(inside[:, 2], 2)
    xu = straight.ravel()
    if "focal_length" not in free:
        depth = float(xu @ (posed.focal_length * across - xu * w) / (xu @ xu))
        return _placed(posed, posed.focal_length, depth)
    (f, depth), *_ = np.linalg.lstsq(np.column_stack([across, -xu]), xu * w, rcond=None)
    if "distortion" in free and f > 0.0 and depth > 0.0:
        bend = -metric.ravel() * np.repeat(square, 2) * (w + depth)
        scale = float(np.max(np.abs(bend)))
        columns = np.column_stack([across, -xu, bend / scale])
        (f2, depth2, bent), *_ = np.linalg.lstsq(columns, xu * w, rcond=None)
        kappa1 = float(bent / scale)
        if f2 > 0.0 and depth2 > 0.0 and 1.0 + 3.0 * kappa1 * float(square.max()) > _SAFE_MARGIN:
            return moved(_placed(posed, float(f2), float(depth2)), kappa1=kappa1)
    return _placed(posed, float(f), float(depth))


def _at_depth(posed: Camera, points: Array, image: Array, depth: float, free: frozenset[str]) -> Camera:
    """The pose at an assumed depth, with the focal length that gives the image its size."""
    if "focal_length" not in free:
        return _placed(posed, posed.focal_length, depth)
    metric = image_metric(posed, image).ravel()
    across = to_camera(posed, points)[:, :2].ravel()
    return _placed(posed, depth * abs(float(metric @ metric) / float(metric @ across)), depth)


def _placed(posed: Camera, focal_length: float, depth: float) -> Camera:
    return moved(posed, focal_length=focal_length, position=np.array([*posed.position[:2], depth]))
