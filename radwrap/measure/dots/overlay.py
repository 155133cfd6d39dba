"""The picture of what was found, for the eye."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from radwrap.images import GrayImage
from radwrap.measure.dots.result import Dots

# Small pictures are enlarged to about this width, so that crosses leave the dots visible [px].
COMFORTABLE_WIDTH = 800
FOUND = (0, 200, 0)  # blue, green, red
SPLIT = (0, 200, 255)
SATURATED = (255, 0, 255)
MISSING = (0, 0, 255)


def overlay_png(
    image: GrayImage, found: NDArray[np.float64] | Dots, missing: NDArray[np.float64] | None = None
) -> bytes:
    """Draw what was found over the picture.

    Parameters
    ----------
    image : GrayImage
        The picture; shown from its darkest to its brightest level.
    found : Dots or ndarray of shape (n, 2)
        Dots with their numbers, or (u, v) of what was found of them [px]:
        green, yellow where split, magenta where saturated.
    missing : ndarray of shape (m, 2), optional
        Where dots should be [px]: red circles.

    Returns
    -------
    bytes
        A PNG file.
    """
    import cv2

    enlarged = max(1, round(COMFORTABLE_WIDTH / image.values.shape[1]))
    lowest, highest = float(image.values.min()), float(image.values.max())
    shown = np.rint((image.values - lowest) * (255 / max(highest - lowest, 1e-12))).astype(np.uint8)
    large = np.repeat(np.repeat(shown, enlarged, axis=0), enlarged, axis=1)
    canvas = np.ascontiguousarray(np.repeat(large[:, :, None], 3, axis=2))

    def at(u: float, v: float) -> tuple[int, int]:
        return round((u + 0.5) * enlarged - 0.5), round((v + 0.5) * enlarged - 0.5)

    if isinstance(found, Dots):
        for dot in found.dots:
            colour = SATURATED if dot.saturated_fraction > 0 else SPLIT if dot.split else FOUND
            place = at(dot.u, dot.v)
            radius = math.sqrt(dot.area / math.pi) * enlarged
            cv2.drawMarker(canvas, place, colour, cv2.MARKER_CROSS, max(7, round(0.6 * radius)))
            if radius > 12:
                label = (place[0] + round(0.1 * radius) + 2, place[1] - 3)
                size = min(max(radius / 45, 0.3), 1.0)
                cv2.putText(canvas, f"{dot.row},{dot.column}", label, cv2.FONT_HERSHEY_PLAIN, 2 * size, colour)
    else:
        for u, v in found:
            cv2.drawMarker(canvas, at(u, v), FOUND, cv2.MARKER_CROSS, 11)
    for u, v in missing if missing is not None else ():
        cv2.circle(canvas, at(u, v), 9, MISSING, 2)
    written, content = cv2.imencode(".png", canvas)
    if not written:
        raise ValueError("the picture cannot be encoded")
    return bytes(content)
