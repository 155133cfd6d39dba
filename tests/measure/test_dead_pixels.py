"""Rows and columns of a sensor that see nothing: each gauge reports them, and what is dark by itself is none."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from radwrap.images import GrayImage
from radwrap.measure.gauges import Caliper, Response, StraightCaliper, measure_circle, measure_line, measure_width
from radwrap.measure.gauges.dead import dead_rows, light_that_is_seen
from tests.measure.pictures import edge_picture, noisy, ring_picture, stripe_picture

Array = NDArray[np.float64]
Measured = Callable[[GrayImage], tuple[float, float, tuple[str, ...]]]

SHAPE = (70, 72)
LEVELS = (35.0, 170.0)
BLUR = 1.1
AT = (35.0, 34.0)


def by_circle(image: GrayImage) -> tuple[float, float, tuple[str, ...]]:
    found = measure_circle(image, Caliper(AT, 18.5, 6.0))
    return found.diameter, found.diameter_sigma, found.warnings


def by_width(image: GrayImage) -> tuple[float, float, tuple[str, ...]]:
    found = measure_width(image, StraightCaliper(AT, 0.1, 40, 26))
    return found.width or math.nan, found.width_sigma or math.nan, found.warnings


def by_line(image: GrayImage) -> tuple[float, float, tuple[str, ...]]:
    found = measure_line(image, StraightCaliper(AT, 0.7, 36, 10))
    (u, v), (x, y) = found.centre, AT
    return (u - x) * math.cos(0.7) + (v - y) * math.sin(0.7), found.position_sigma, found.warnings


# Light, gauge, true value.
KINDS: dict[str, tuple[Array, Measured, float]] = {
    "circle": (ring_picture(SHAPE, (35.4, 34.2), (18.0,), BLUR, LEVELS), by_circle, 36.0),
    "width": (
        stripe_picture(SHAPE, 0.1, AT[0] * math.cos(0.1) + AT[1] * math.sin(0.1), 31.0, blur=BLUR, levels=LEVELS),
        by_width,
        31.0,
    ),
    "line": (
        edge_picture(SHAPE, 0.7, AT[0] * math.cos(0.7) + AT[1] * math.sin(0.7) + 0.4, BLUR, LEVELS),
        by_line,
        0.4,
    ),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("value", ["zero", "level", "dark"])
@pytest.mark.parametrize("columns", [False, True])
def test_dead_rows_are_reported_and_left_out(kind: str, value: str, columns: bool) -> None:
    """Six of them were an edge of their own to a gauge: widths by 25 px, lines by 9 px, without a warning."""
    light, measured, true = KINDS[kind]
    dice = np.random.default_rng(5)
    image = noisy(light, dice)
    first = 31
    part = image[:, first : first + 6] if columns else image[first : first + 6]
    part[:] = {"zero": 0.0, "level": 60.0, "dark": 5 + np.rint(dice.standard_normal(part.shape))}[value]
    found, sigma, warnings = measured(GrayImage(image))
    name = f"{'columns' if columns else 'rows'} {first} to {first + 5} are constant or dark"
    assert any(name in text for text in warnings)
    assert found == pytest.approx(true, abs=4 * sigma) and sigma < 0.1


@pytest.mark.parametrize("kind", KINDS)
def test_an_image_without_dead_rows_has_none(kind: str) -> None:
    light, measured, _ = KINDS[kind]
    for image in (light, np.rint(light), noisy(light, np.random.default_rng(6))):
        assert measured(GrayImage(image))[2] == ()


@pytest.mark.parametrize("blur", [0.3, 0.8])
@pytest.mark.parametrize("at", [30.0, 30.25, 30.5])
@pytest.mark.parametrize("noise", [0.0, 0.6])
def test_a_black_slit_is_no_dead_row(blur: float, at: float, noise: float) -> None:
    """Of a plate that ends to the left: its rows are constant, and those beside them see the blur."""
    plate = edge_picture(SHAPE, 0.0, 20.0, blur, (0.0, 1.0))
    slit = stripe_picture(SHAPE, math.pi / 2, at, 5.0, blur=blur, levels=(1.0, 0.0))
    light = 5 + 150 * plate * slit
    if noise:
        light = noisy(light, np.random.default_rng(7), read=noise)
    assert dead_rows(light) == [] and dead_rows(light.T) == []
    if blur > 0.5:  # else one that ends between two rows, and is clipped, is seen by none of those beside it
        assert dead_rows(np.maximum(light - 20, 0.0)) == [], "clipped at black"


def test_no_light_is_taken_from_dead_pixels() -> None:
    """Across them light runs straight from one row that sees to the other, to begin with; none of it is used."""
    light = edge_picture(SHAPE, math.pi / 2, 34.0, 6.0, LEVELS)
    image = np.rint(light + np.random.default_rng(8).normal(0, 0.7, SHAPE))
    image[33:36] = 0
    seen, warnings = light_that_is_seen(GrayImage(image), Response(), (35.0, 34.0), (20.0, 20.0))
    assert len(warnings) == 1
    assert not seen.usable[33:36, 15:56].any() and seen.usable[:33].all() and seen.usable[36:].all()
    share = np.array([0.25, 0.5, 0.75])[:, None]
    straight = np.rint((1 - share) * image[32] + share * image[36])[:, 20:50]
    assert np.array_equal(seen.values[33:36, 20:50], straight)
