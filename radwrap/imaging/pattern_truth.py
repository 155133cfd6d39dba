"""Where points of calibration and resolution targets are in the image, by projection through the pinhole's centre."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radwrap.frames import to_world
from radwrap.scene.camera import Camera
from radwrap.scene.look.geometry import in_view, project
from radwrap.scene.patterns.layouts import Charuco, Chessboard, CircleGrid, SiemensStar, Usaf1951
from radwrap.scene.patterns.marks import Place
from radwrap.scene.targets import PatternTarget

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class TruePoints:
    """Points of a plate and their images.

    Attributes
    ----------
    places : ndarray, shape (n, 2)
        x, y on the plate [m].
    image : ndarray, shape (n, 2)
        u, v [px]; meaningless of what lies behind the camera, which is not in view.
    in_view : ndarray of bool, shape (n,)
        Whether that lies on the sensor and before the camera; what stands before it is not asked.
    """

    places: Array
    image: Array
    in_view: NDArray[np.bool_]

    def entries(self) -> list[dict[str, Any]]:
        """Each point as JSON."""
        rows = zip(self.places.tolist(), self.image.tolist(), self.in_view.tolist(), strict=True)
        return [{"x": x, "y": y, "u": u, "v": v, "in_view": seen} for (x, y), (u, v), seen in rows]


def true_points(camera: Camera, target: PatternTarget, places: Sequence[Place]) -> TruePoints:
    """Images of points of a plate, (x, y) [m]."""
    world = np.array([to_world(target.pose, (x, y, 0.0)) for x, y in places]).reshape(-1, 3)
    uv, _ = project(camera, world)
    return TruePoints(np.array(places, dtype=np.float64).reshape(-1, 2), uv, in_view(camera, world))


def ellipse_centres(camera: Camera, target: PatternTarget, centres: Sequence[Place], diameter: float) -> TruePoints:
    """Centres of the ellipses that discs are seen as, which are not where their own centres are seen.

    The centre of a conic is the pole of the line at infinity. On the plate that is the line of depth 0, and its pole
    to a circle of radius r about c is c - (a, b) r^2/z, the depth near c being z + a dx + b dy. Where the lens
    distorts, this place of the undistorted image is put through the distortion.
    """
    axis = np.asarray(camera.pose.rotation)[:, 2]
    slope = np.array([axis @ target.pose.x_axis, axis @ target.pose.y_axis])
    world = np.array([to_world(target.pose, (x, y, 0.0)) for x, y in centres]).reshape(-1, 3)
    _, depth = project(camera, world)
    safe = np.where(depth > 0, depth, 1.0)
    poles = np.asarray(centres) - slope * ((diameter / 2) ** 2 / safe)[:, np.newaxis]
    found = true_points(camera, target, [(x, y) for x, y in poles.tolist()])
    # A circle that reaches behind the camera is no ellipse.
    whole = depth > diameter / 2 * np.hypot(*slope)
    return TruePoints(found.places, found.image, found.in_view & whole)


def pattern_truth(camera: Camera, target: PatternTarget) -> dict[str, Any]:
    """What truth.json says of a target: its points' places on the plate x, y [m], and in the image u, v [px].

    Returns
    -------
    dict
        Of a chessboard ``corners``, those of ChArUco with their ``id``; of a grid of discs ``circles``, with
        ``ellipse_u``, ``ellipse_v`` besides; of a Siemens star ``star``; of a USAF target ``elements``, each with
        the middles of its ``upright`` and ``level`` bars.
    """
    layout = target.layout
    match layout:
        case Chessboard() | Charuco():
            corners = layout.corners()
            entries = true_points(camera, target, [place for *_, place in corners]).entries()
            numbered = isinstance(layout, Charuco)
            return {
                "corners": [
                    {**({"id": number} if numbered else {}), "row": row, "column": column, **entry}
                    for number, ((row, column, _), entry) in enumerate(zip(corners, entries, strict=True))
                ]
            }
        case CircleGrid():
            centres = layout.centres()
            places = [place for *_, place in centres]
            entries = true_points(camera, target, places).entries()
            ellipses = ellipse_centres(camera, target, places, layout.dot_diameter).image.tolist()
            return {
                "circles": [
                    {"row": row, "column": column, **entry, "ellipse_u": u, "ellipse_v": v}
                    for (row, column, _), entry, (u, v) in zip(centres, entries, ellipses, strict=True)
                ]
            }
        case SiemensStar(spokes, diameter, inner_diameter, _):
            (middle,) = true_points(camera, target, [(0.0, 0.0)]).entries()
            return {"star": {**middle, "spokes": spokes, "diameter": diameter, "inner_diameter": inner_diameter}}
        case Usaf1951():
            elements = layout.elements()
            upright = true_points(camera, target, [one.upright for one in elements]).entries()
            level = true_points(camera, target, [one.level for one in elements]).entries()
            return {
                "elements": [
                    {
                        "group": one.group,
                        "element": one.element,
                        "line_pairs_per_mm": 1e-3 / (2 * one.bar_width),
                        "upright": along_y,
                        "level": along_x,
                    }
                    for one, along_y, along_x in zip(elements, upright, level, strict=True)
                ]
            }
