"""Fits of one edge, of two that face each other, and of a stripe, in a caliper."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.images import GrayImage
from radwrap.measure.gauges.calipers import Side, StraightCaliper
from radwrap.measure.gauges.contour import Contour, fit_contour
from radwrap.measure.gauges.dead import light_that_is_seen
from radwrap.measure.gauges.narrow import NarrowFit, fit_narrow
from radwrap.measure.gauges.points import PointFit, fit_points, robust_line
from radwrap.measure.gauges.response import Light, Response
from radwrap.measure.gauges.rims import Shape
from radwrap.measure.gauges.scale import Plane
from radwrap.measure.gauges.scan import Crossings, ScanLines, Way, check_unsaturated, crossings
from radwrap.measure.gauges.straight_shapes import line_shape, stripe_in_plane_shape, stripe_shape

Array = NDArray[np.float64]

_FEWEST_SHARE: Final = 0.3  # of the scan lines, that must cross the edge
_LARGEST_TURN: Final = math.radians(30)  # between the caliper and the edge
_BEYOND_BOX: Final = 8.0  # px beyond the caliper, where a plane's map is still followed


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Crossings of two edges, the one at lower offsets first, and what lies between them."""

    low: Crossings
    high: Crossings
    inside: Side

    @property
    def gap(self) -> float:
        """Their distance [px]."""
        return float(np.median(self.high.offsets) - np.median(self.low.offsets))


@dataclass(frozen=True, slots=True, eq=False)
class StraightGauge:
    """Light, caliper and scan lines of a measurement, in pixel widths, and what to warn of dead pixels."""

    light: Light
    centre: Array
    angle: float
    lines: ScanLines
    length: float
    aspect: float
    dead: tuple[str, ...]

    @classmethod
    def of(cls, image: GrayImage, caliper: StraightCaliper, response: Response | None, aspect: float) -> StraightGauge:
        """A gauge on an image."""
        if not 0.01 <= aspect <= 100:
            raise InputError("must lie between 0.01 and 100", where="pixel_aspect", remedy="give height over width")
        centre = np.array([caliper.centre[0], caliper.centre[1] * aspect])
        normal = np.array([math.cos(caliper.angle), math.sin(caliper.angle)])
        count = max(8, math.ceil(caliper.length))
        along = ((np.arange(count) + 0.5) / count - 0.5) * caliper.length
        origins = centre + along[:, None] * np.array([-normal[1], normal[0]])
        lines = ScanLines(origins, np.tile(normal, (count, 1)), caliper.band, aspect)
        across, along_it = np.abs(caliper.band * normal), np.abs(caliper.length / 2 * normal[::-1])
        half = (float(across[0] + along_it[0]), float(across[1] + along_it[1]) / aspect)
        light, dead = light_that_is_seen(image, response, caliper.centre, half)
        return cls(light, centre, caliper.angle, lines, caliper.length, aspect, dead)

    def crossings(self, rising: bool | None, way: Way) -> Crossings:
        """Where the scan lines cross the strongest edge."""
        found = crossings(self.light.values, self.lines, "moment" if way == "moment" else "gradient", rising)
        if found is None and self._share_inside() < _FEWEST_SHARE:
            raise InputError("the caliper reaches beyond it", where="the image", remedy="move it, or narrow its band")
        if found is None or len(found.line) < _FEWEST_SHARE * len(self.lines.origins):
            raise InputError(
                "shows no edge in the caliper's band", where="the image", remedy="move the caliper, or widen its band"
            )
        if way != "model":
            check_unsaturated(self.light.usable, self.lines, found)
        return found

    def _share_inside(self) -> float:
        """Of the scan lines, those that lie in the image from end to end."""
        rows, columns = self.light.values.shape
        last = np.array([columns - 1, (rows - 1) * self.aspect])
        half = self.lines.half_length * self.lines.directions
        ends = np.stack([self.lines.origins - half, self.lines.origins + half])
        return float(((ends >= 0) & (ends <= last)).all(axis=(0, 2)).mean())

    def pair(self, way: Way, inside: Side | None = None) -> Pair:
        """The rising and the falling edge; of two kinds of object the one that is asked for."""
        up, down = self.crossings(True, way), self.crossings(False, way)
        between: Side = "bright" if np.median(up.offsets) < np.median(down.offsets) else "dark"
        if inside is not None and between != inside:
            raise InputError(
                f"shows what is {between} between its two strongest edges, not {inside}",
                where="the image",
                remedy="move the caliper",
            )
        return Pair(*((up, down) if between == "bright" else (down, up)), between)

    def points(self, found: Crossings) -> Array:
        """The same as places, in pixel widths."""
        at: Array = self.lines.origins[found.line] + found.offsets[:, None] * self.lines.directions[found.line]
        return at

    def start(self, found: Crossings) -> tuple[Array, Array]:
        """Shift and turn of the line through most of the points, and the points that lie on it."""
        points = self.points(found)
        middle, along, near = robust_line(points)
        angle = math.atan2(along[1], along[0]) - math.pi / 2
        turn = (angle - self.angle + math.pi / 2) % math.pi - math.pi / 2
        if near.sum() < _FEWEST_SHARE * len(self.lines.origins) or abs(turn) > _LARGEST_TURN:
            raise InputError(
                "shows no straight edge along the caliper", where="the image", remedy="turn or move the caliper"
            )
        normal = np.array([math.cos(self.angle + turn), math.sin(self.angle + turn)])
        return np.array([float((middle - self.centre) @ normal), turn]), points[near]

    def edge_fit(self, found: Crossings, way: Way, band: float) -> Contour | PointFit:
        """Shift and turn of one edge."""
        start, points = self.start(found)
        shape = line_shape(self.centre, self.angle, self.length, 1.0 if found.rising else -1.0, start)
        if way != "model":
            return fit_points(shape, points)
        return fit_contour(self.light, shape, 2 * found.width, band, self.aspect)

    def stripe_fit(self, both: Pair, way: Way, plane: Plane | None = None) -> NarrowFit | PointFit:
        """Shift, turn and width of a stripe; in a plane the width is in units of what a pixel across it is there."""
        first, points = self.start(both.low)
        second, others = self.start(both.high)
        start = np.array([(first[0] + second[0]) / 2, (first[1] + second[1]) / 2, abs(second[0] - first[0])])
        shape = self._stripe(start, plane)
        if way != "model":
            return _stripe_points(shape, points, others)
        return fit_narrow(shape, both.low.width + both.high.width, self._contour)

    def _stripe(self, start: Array, plane: Plane | None) -> Shape:
        if plane is None:
            return stripe_shape(self.centre, self.angle, self.length, start)
        reach = math.hypot(self.length / 2, self.lines.half_length) + _BEYOND_BOX
        local = plane.near(self.centre - reach, self.centre + reach, self.aspect)
        scale = self.pixel_in(plane)
        return stripe_in_plane_shape(self.centre, self.angle, self.length, start, local, scale=scale)

    def pixel_in(self, plane: Plane) -> float:
        """How long a pixel across the edges is in a plane, at the caliper's middle [m]."""
        return self.distance(np.array([-0.5, 0.0, 0.5, 0.0]), plane)

    def distance(self, parameters: Array, plane: Plane | None) -> float:
        """Of two edges at the caliper's middle, along their mean normal [px or, in a plane, m]."""
        ends = []
        for shift, turn in (parameters[:2], parameters[2:]):
            angle = self.angle + turn
            normal, along = np.array([math.cos(angle), math.sin(angle)]), np.array([-math.sin(angle), math.cos(angle)])
            middle = self.centre + shift * normal
            two = np.stack([middle - self.length / 4 * along, middle + self.length / 4 * along])
            ends.append(two if plane is None else plane.to_plane(two / np.array([1.0, self.aspect])))
        directions = [(two[1] - two[0]) / np.linalg.norm(two[1] - two[0]) for two in ends]
        mean = directions[0] + directions[1]
        mean = mean / np.linalg.norm(mean)
        across = np.array([mean[1], -mean[0]])
        # Where each passes the line through the middle of all four ends, along the mean normal.
        middle = np.concatenate(ends).mean(axis=0)
        places = [
            float((two[0] - middle) @ across - ((two[0] - middle) @ mean) * (d @ across) / (d @ mean))
            for two, d in zip(ends, directions, strict=True)
        ]
        return abs(places[1] - places[0])

    def _contour(self, shape: Shape, blur: float) -> Contour:
        return fit_contour(self.light, shape, blur, self.lines.half_length, self.aspect)


def _stripe_points(shape: Shape, low: Array, high: Array) -> PointFit:
    """Stripe through points on either edge."""
    parts = [fit_points(_one_rim(shape, number), points) for number, points in enumerate((low, high))]
    to = np.array([[0.5, 0.0, 0.5, 0.0], [0.0, 0.5, 0.0, 0.5], [-1.0, 0.0, 1.0, 0.0]])
    both = np.concatenate([part.parameters for part in parts])
    covariance = np.zeros((4, 4))
    covariance[:2, :2], covariance[2:, 2:] = parts[0].covariance, parts[1].covariance
    rms = math.hypot(parts[0].rms, parts[1].rms) / math.sqrt(2)
    return PointFit(to @ both, to @ covariance @ to.T, rms, parts[0].points + parts[1].points)


def _one_rim(shape: Shape, number: int) -> Shape:
    """One edge of a stripe as a shape of its own, with shift and turn."""
    side = -1.0 if number == 0 else 1.0

    def rims(parameters: Array, places: Array) -> list[Any]:
        return [shape.rims(np.array([parameters[0], parameters[1], 0.0]), places)[number]]

    start = np.array([shape.start[0] + side * shape.start[2] / 2, shape.start[1]])
    return Shape(rims, start, shape.units[:2], shape.length, closed=False)
