"""Picture of the parts that were found."""

from __future__ import annotations

import math

import numpy as np

from radwrap.errors import InputError
from radwrap.images import GrayImage
from radwrap.measure.parts.result import Parts


def overlay_png(image: GrayImage, parts: Parts) -> bytes:
    """The image as PNG with each part's rectangle, axis and number drawn in colour; twice its size below 800 px."""
    import cv2

    gray = image.values
    low, high = float(gray.min()), float(gray.max())
    scale = 1 if max(gray.shape) >= 800 else 2
    eight = np.rint((gray - low) * (255 / max(high - low, 1e-12))).astype(np.uint8)
    canvas = cv2.cvtColor(np.kron(eight, np.ones((scale, scale), np.uint8)), cv2.COLOR_GRAY2BGR)

    def at(u: float, v: float) -> tuple[int, int]:
        return round((u + 0.5) * scale - 0.5), round((v + 0.5) * scale - 0.5)

    for number, part in enumerate(parts.parts, start=1):
        colour = (0, 0, 255) if part.touches_border else (0, 200, 0)
        cu, cv, length, width = part.rectangle
        cos, sin = math.cos(part.rectangle_orientation), math.sin(part.rectangle_orientation)
        halves = ((length, width), (length, -width), (-length, -width), (-length, width))
        corners = [at(cu + (a * cos - b * sin) / 2, cv + (a * sin + b * cos) / 2) for a, b in halves]
        cv2.polylines(canvas, [np.array(corners, np.int32)], isClosed=True, color=colour, thickness=1)
        if not part.orientation_ambiguous:
            reach = part.major_axis / 2
            end = at(part.u + reach * math.cos(part.orientation), part.v + reach * math.sin(part.orientation))
            cv2.line(canvas, at(part.u, part.v), end, (255, 120, 0), 1)
        cv2.drawMarker(canvas, at(part.u, part.v), (0, 120, 255), cv2.MARKER_CROSS, 9, 1)
        cv2.putText(canvas, str(number), at(part.u + 3, part.v - 3), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 160, 255), 1)
    written, encoded = cv2.imencode(".png", canvas)
    if not written:
        raise InputError("cannot be drawn", where="the overlay")
    return bytes(encoded)
