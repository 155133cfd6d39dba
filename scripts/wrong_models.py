"""What gauges say of things that are of another shape or blur than their model's: how many are warned of.

Usage: wrong_models.py [--scenes 40] [--seed 2] [--kinds NAME ...] [--json FILE]

Of each kind and gauge: how many are warned of, refused, right without a warning (within four standard errors or 0.02
px of the truth, where there is one: a neighbour may well be left out), and wrong without a warning. Of an edge with
coma the truth is where the middle of the blur's light puts it: how far coma moves all light alike no image shows.
Levels, noise, place and direction are drawn.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.signal import oaconvolve

from gauges import FINE, frame, places, soft
from radwrap.cli.measure_edge import warnings_of
from radwrap.errors import InputError
from radwrap.images import GrayImage
from radwrap.measure.edges import measure_edge
from radwrap.measure.gauges import Caliper, StraightCaliper, measure_circle, measure_line, measure_width

Array = NDArray[np.float64]
Dice = np.random.Generator
# Value, standard error and warnings.
Said = tuple[float, float, tuple[str, ...]]

RIGHT_SIGMAS: Final = 4.0
RIGHT: Final = 0.02  # px
TAU, CORE = 1.0, 0.5  # px, of coma: an exponential tail to one side of a Gaussian


@dataclass(frozen=True)
class Case:
    """A picture, how it is measured, and the true value; NaN where the model has none."""

    light: Array
    measured: Callable[[GrayImage], Said]
    true: float = math.nan


def disc(radius: float) -> Array:
    """A disc of blur on fine places."""
    y, x = _around(math.ceil(radius * FINE) + 1)
    return np.asarray(np.clip(radius * FINE + 0.5 - np.hypot(x, y), 0, 1))


def coma(turn: float) -> Array:
    """A Gaussian with an exponential tail in one direction; the middle of its light is TAU that way."""
    y, x = _around(math.ceil(8 * TAU * FINE))
    along, across = (x * math.cos(turn) + y * math.sin(turn)) / FINE, (y * math.cos(turn) - x * math.sin(turn)) / FINE
    from scipy.special import erfcx

    tail = erfcx((CORE / TAU - along / CORE) / math.sqrt(2)) * np.exp(-(along**2) / (2 * CORE**2))
    return np.asarray(np.where(np.isfinite(tail), tail, 0.0) * np.exp(-(across**2) / (2 * CORE**2)))


def _around(half: int) -> tuple[Array, Array]:
    y, x = np.mgrid[-half : half + 1, -half : half + 1].astype(np.float64)
    return y, x


def pixels(sharp: Array, blur: Array) -> Array:
    """What pixels see of fine light."""
    half, side = blur.shape[0] // 2, sharp.shape[0] // FINE
    smooth = oaconvolve(np.pad(sharp, half, mode="edge"), blur / blur.sum(), mode="valid")
    return np.asarray(smooth.reshape(side, FINE, side, FINE).mean(axis=(1, 3)))


def levels(dice: Dice) -> tuple[float, float]:
    """Of the outside and of the inside."""
    low = dice.uniform(20, 60)
    high = low + dice.uniform(60, 150)
    return (low, high) if dice.random() < 0.5 else (high, low)


def lit(dice: Dice, inside: Array) -> Array:
    """Fine light of a thing."""
    out, within = levels(dice)
    return out + (within - out) * inside


def by_circle(centre: Array, radius: float, band: float = 6.0) -> Callable[[GrayImage], Said]:
    """Diameter by `measure circle`."""

    def measured(image: GrayImage) -> Said:
        found = measure_circle(image, Caliper((centre[0], centre[1]), radius, min(band, radius - 1.5)))
        return found.diameter, found.diameter_sigma, found.warnings

    return measured


def by_line(centre: Array, angle: float, band: float = 10.0, *, length: float = 36.0) -> Callable[[GrayImage], Said]:
    """Place of an edge relative to a centre, by `measure line`."""

    def measured(image: GrayImage) -> Said:
        found = measure_line(image, StraightCaliper((centre[0] + 0.4, centre[1] - 0.3), angle, length, band))
        away = np.array(found.centre) - centre
        return float(away @ [math.cos(angle), math.sin(angle)]), found.position_sigma, found.warnings

    return measured


def by_width(
    centre: Array, angle: float, size: float, *, length: float = 36.0, stripe: bool = False
) -> Callable[[GrayImage], Said]:
    """Width by `measure width`, or of a stripe by `measure line --stripe`."""

    def measured(image: GrayImage) -> Said:
        caliper = StraightCaliper((centre[0] + 0.4, centre[1] - 0.3), angle, length, size / 2 + 9)
        if not stripe:
            width = measure_width(image, caliper)
            return width.width or math.nan, width.width_sigma or math.nan, width.warnings
        line = measure_line(image, caliper, stripe=True)
        return line.width or math.nan, line.width_sigma or math.nan, line.warnings

    return measured


def by_edge(centre: Array, angle: float, *, gamma: float | None) -> Callable[[GrayImage], Said]:
    """Place of an edge by `measure edge`."""

    def measured(image: GrayImage) -> Said:
        found = measure_edge(image, dark=0.0, gamma=gamma)
        away = np.array(found.centre) - centre
        return float(away @ [math.cos(angle), math.sin(angle)]), found.sigma_position, tuple(warnings_of(found))

    return measured


def _straight(dice: Dice, side: int = 72) -> tuple[Array, float, Array, Array]:
    """Middle, direction, and fine places across and along."""
    centre, angle = side / 2 + dice.uniform(-2, 2, 2), dice.uniform(-math.pi, math.pi)
    u, v = places(side)
    x, y = u - centre[0], v - centre[1]
    return centre, angle, x * math.cos(angle) + y * math.sin(angle), y * math.cos(angle) - x * math.sin(angle)


def _round(dice: Dice, least: float = 12.0, most: float = 30.0) -> tuple[float, Array, Array, Array]:
    """Radius, middle, and fine places from it."""
    radius = dice.uniform(least, most)
    side = int(2 * radius + 38)
    centre = side / 2 + dice.uniform(-1, 1, 2)
    u, v = places(side)
    return radius, centre, u - centre[0], v - centre[1]


def coma_edge(dice: Dice) -> Case:
    """An edge with coma across it."""
    centre, angle, x, _ = _straight(dice)
    turn = angle + dice.uniform(-1, 1) + (math.pi if dice.random() < 0.5 else 0)
    return Case(
        pixels(lit(dice, soft(x)), coma(turn)), by_edge(centre, angle, gamma=None), TAU * math.cos(turn - angle)
    )


def coma_line(dice: Dice) -> Case:
    """The same, by the gauge."""
    centre, angle, x, _ = _straight(dice)
    turn = angle + dice.uniform(-1, 1) + (math.pi if dice.random() < 0.5 else 0)
    return Case(pixels(lit(dice, soft(x)), coma(turn)), by_line(centre, angle), TAU * math.cos(turn - angle))


def coma_circle(dice: Dice) -> Case:
    """A disc with coma in one direction."""
    radius, centre, x, y = _round(dice)
    return Case(
        pixels(lit(dice, soft(radius - np.hypot(x, y))), coma(dice.uniform(-3, 3))),
        by_circle(centre, radius),
        2 * radius,
    )


def _two_steps(dice: Dice, x: Array) -> tuple[Array, Array]:
    """Light of two steps, the weaker of a seventh to a half of the contrast, and the blur."""
    blur, share = dice.uniform(0.5, 2.5), dice.uniform(0.15, 0.5)
    apart = dice.uniform(1.0, 2.5) * blur + 1
    return lit(dice, (soft(x) + share * soft(x - math.copysign(apart, dice.uniform(-1, 1)))) / (1 + share)), disc(blur)


def two_edges_line(dice: Dice) -> Case:
    """A second, weaker step beside the first."""
    centre, angle, x, _ = _straight(dice)
    return Case(pixels(*_two_steps(dice, x)), by_line(centre, angle), 0.0)


def two_edges_edge(dice: Dice) -> Case:
    """The same, by `measure edge`."""
    centre, angle, x, _ = _straight(dice)
    return Case(pixels(*_two_steps(dice, x)), by_edge(centre, angle, gamma=1.0), 0.0)


def two_edges_width(dice: Dice) -> Case:
    """A bar with two steps on either side."""
    centre, angle, x, _ = _straight(dice)
    size = dice.uniform(16, 30)
    return Case(pixels(*_two_steps(dice, size / 2 - np.abs(x))), by_width(centre, angle, size), size)


def two_edges_circle(dice: Dice) -> Case:
    """A disc with two steps at its rim."""
    radius, centre, x, y = _round(dice)
    return Case(pixels(*_two_steps(dice, radius - np.hypot(x, y))), by_circle(centre, radius), 2 * radius)


def bent_line(dice: Dice) -> Case:
    """An edge that is an arc."""
    centre, angle, x, y = _straight(dice)
    bend = dice.uniform(25, 250)
    return Case(
        pixels(lit(dice, soft(np.hypot(x + bend, y) - bend)), disc(dice.uniform(0.3, 4))), by_line(centre, angle)
    )


def bent_width(dice: Dice) -> Case:
    """A bar with bent sides."""
    centre, angle, x, y = _straight(dice)
    bend, size = dice.uniform(25, 250), dice.uniform(14, 30)
    inside = bend + size / 2 - np.hypot(np.abs(x) + bend, y)
    return Case(pixels(lit(dice, soft(inside)), disc(dice.uniform(0.3, 3))), by_width(centre, angle, size))


def neighbours_circle(dice: Dice) -> Case:
    """Discs that touch it or nearly do."""
    radius, centre, x, y = _round(dice)
    inside = soft(radius - np.hypot(x, y))
    for _ in range(dice.integers(1, 4)):
        size, turn = dice.uniform(0.15, 0.5) * radius + 2, dice.uniform(0, 2 * math.pi)
        away = radius + size - dice.uniform(-3, 3)
        inside = np.maximum(inside, soft(size - np.hypot(x - away * math.cos(turn), y - away * math.sin(turn))))
    return Case(pixels(lit(dice, inside), disc(dice.uniform(0.3, 3.5))), by_circle(centre, radius), 2 * radius)


def neighbours_line(dice: Dice) -> Case:
    """Another thing of the same light beside the edge, over a part of its length."""
    centre, angle, x, y = _straight(dice)
    at, size = dice.uniform(-16, 16), dice.uniform(3, 9)
    gap = dice.uniform(-2, 3)
    inside = np.maximum(soft(x), soft(size - np.hypot(x + size + gap, y - at)))
    return Case(pixels(lit(dice, inside), disc(dice.uniform(0.3, 3.5))), by_line(centre, angle), 0.0)


def sector_circle(dice: Dice) -> Case:
    """Of whose rim 40 to 54 % are there."""
    radius, centre, x, y = _round(dice)
    turn, half = dice.uniform(0, 2 * math.pi), math.pi * dice.uniform(0.40, 0.54)
    a, away = np.abs(np.angle(np.exp(1j * (np.arctan2(y, x) - turn)))), np.hypot(x, y)
    side = np.where(np.abs(a - half) < math.pi / 2, away * np.sin(half - a), np.where(a < half, 1e3, -1e3))
    inside = soft(np.minimum(radius - away, side))
    return Case(pixels(lit(dice, inside), disc(dice.uniform(0.3, 3.5))), by_circle(centre, radius), 2 * radius)


def small_circle(dice: Dice) -> Case:
    """Smaller than its blur: the level lies above the brightest pixel."""
    radius, centre, x, y = _round(dice, 2.5, 5)
    blur = radius * dice.uniform(1.1, 1.6)
    return Case(pixels(lit(dice, soft(radius - np.hypot(x, y))), disc(blur)), by_circle(centre, blur), 2 * radius)


def small_stripe(dice: Dice) -> Case:
    """Smaller than its blur, likewise."""
    centre, angle, x, _ = _straight(dice)
    size = dice.uniform(2, 5)
    light = pixels(lit(dice, soft(size / 2 - np.abs(x))), disc(size * dice.uniform(0.7, 1.3)))
    return Case(light, by_width(centre, angle, size, stripe=True), size)


def shapes_circle(dice: Dice) -> Case:
    """Ellipses and polygons."""
    radius, centre, x, y = _round(dice, 14, 32)
    kind = dice.integers(5)
    if kind < 2:
        inside = radius - np.hypot(x, y / (0.97, 0.9)[kind])
    else:
        corners = (6, 8, 12)[kind - 2]
        turn = np.mod(np.arctan2(y, x), 2 * math.pi / corners) - math.pi / corners
        inside = radius * math.cos(math.pi / corners) - np.hypot(x, y) * np.cos(turn)
    return Case(pixels(lit(dice, soft(inside)), disc(dice.uniform(0.3, 4))), by_circle(centre, radius))


def coma_beside_circle(dice: Dice) -> Case:
    """A disc with coma, and another that touches it or nearly does."""
    radius, centre, x, y = _round(dice)
    size, turn = dice.uniform(0.15, 0.4) * radius + 2, dice.uniform(0, 2 * math.pi)
    away = radius + size - dice.uniform(-2, 1)
    beside = soft(size - np.hypot(x - away * math.cos(turn), y - away * math.sin(turn)))
    inside = np.maximum(soft(radius - np.hypot(x, y)), beside)
    return Case(pixels(lit(dice, inside), coma(dice.uniform(-3, 3))), by_circle(centre, radius), 2 * radius)


def coma_beside_line(dice: Dice) -> Case:
    """An edge with coma, and a disc that touches it or nearly does."""
    centre, angle, x, y = _straight(dice)
    at, size, gap = dice.uniform(-16, 16), dice.uniform(3, 9), dice.uniform(-2, 1)
    inside = np.maximum(soft(x), soft(size - np.hypot(x + size + gap, y - at)))
    turn = angle + dice.uniform(-1, 1) + (math.pi if dice.random() < 0.5 else 0)
    return Case(pixels(lit(dice, inside), coma(turn)), by_line(centre, angle), TAU * math.cos(turn - angle))


def burr_arc(dice: Dice) -> Case:
    """An arc of 25 to 110 degrees, by a caliper that is one, with a burr on it."""
    radius, centre, x, y = _round(dice, 14, 30)
    first, extent = dice.uniform(-math.pi, math.pi), math.radians(dice.uniform(25, 110))
    at, size = first + extent * dice.uniform(0.15, 0.85), dice.uniform(1.5, 5)
    away = radius + dice.uniform(-0.7, 0.7) * size
    burr = soft(size - np.hypot(x - away * math.cos(at), y - away * math.sin(at)))
    light = pixels(lit(dice, np.maximum(soft(radius - np.hypot(x, y)), burr)), disc(dice.uniform(0.3, 3)))

    def measured(image: GrayImage) -> Said:
        caliper = Caliper((centre[0] + 0.3, centre[1] - 0.2), radius + 0.3, 6.0, arc=(first, extent))
        found = measure_circle(image, caliper)
        return found.diameter, found.diameter_sigma, found.warnings

    return Case(light, measured, 2 * radius)


KINDS: Final[dict[str, Callable[[Dice], Case]]] = {
    name.replace("_", " by ", 1) if "_" in name else name: make
    for name, make in (
        ("coma_edge", coma_edge), ("coma_line", coma_line), ("coma_circle", coma_circle),
        ("two edges_edge", two_edges_edge), ("two edges_line", two_edges_line), ("two edges_width", two_edges_width),
        ("two edges_circle", two_edges_circle), ("bent edge_line", bent_line), ("bent sides_width", bent_width),
        ("neighbours_line", neighbours_line), ("neighbours_circle", neighbours_circle),
        ("sector_circle", sector_circle),
        ("below its blur_circle", small_circle), ("below its blur_stripe", small_stripe),
        ("ellipse or polygon_circle", shapes_circle),
        ("coma beside a neighbour_line", coma_beside_line), ("coma beside a neighbour_circle", coma_beside_circle),
        ("short arc with a burr_circle", burr_arc),
    )
}  # fmt: skip


def counted(make: Callable[[Dice], Case], seed: int, scenes: int, number: int) -> tuple[Counter[str], float]:
    """What is said of all scenes of a kind, and the largest error of those without a warning [px]."""
    counts: Counter[str] = Counter()
    largest = 0.0
    for scene in range(scenes):
        dice = np.random.default_rng((seed, 78, number, scene))
        case = make(dice)
        image = frame(case.light, dice, dice.uniform(0.01, 0.1), dice.uniform(0.3, 1.5))
        try:
            value, sigma, warnings = case.measured(image)
        except InputError:
            counts["refused"] += 1
            continue
        off = abs(value - case.true)
        if warnings:
            counts["warned"] += 1
        elif off < max(RIGHT_SIGMAS * sigma, RIGHT):
            counts["right"] += 1
        else:
            counts["wrong"] += 1
            largest = max(largest, off)
    return counts, largest


def main() -> int:
    """Count and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=40)
    parser.add_argument("--seed", type=int, default=2, help="1 was used while the gauges were made")
    parser.add_argument("--kinds", nargs="+", choices=tuple(KINDS), default=tuple(KINDS))
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    result: dict[str, Any] = {}
    for kind in given.kinds:
        counts, largest = counted(KINDS[kind], given.seed, given.scenes, list(KINDS).index(kind))
        result[kind] = {**counts, "largest_without_a_warning": largest}
        print(
            f"{kind:33s} of {given.scenes}: warned {counts['warned']}, refused {counts['refused']}, right "
            f"{counts['right']}, wrong {counts['wrong']}, by up to {largest:.3f} px",
            flush=True,
        )
    if given.json:
        given.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
