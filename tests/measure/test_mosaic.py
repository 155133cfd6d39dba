"""One colour of a raw mosaic: where dots and edges lie, in raw pixels."""

from __future__ import annotations

import numpy as np
import pytest

from radwrap.errors import InputError
from radwrap.images import GrayImage
from radwrap.measure.dots import find_dots
from radwrap.measure.edges import measure_edge
from radwrap.measure.mosaic import COLOURS, PATTERNS, Colour, Pattern, colour_image

# Of an edge or a dot that is blurred over some pixels: half of what users ask of a monochrome image.
NEAR = 0.01  # px
SUPER = 8


def raw(values: dict[Colour, np.ndarray], pattern: Pattern) -> GrayImage:
    """Each pixel from the image of its own colour."""
    made = np.zeros_like(values["green"])
    colours: dict[str, Colour] = {"R": "red", "G": "green", "B": "blue"}
    for place, letter in enumerate(pattern):
        at = slice(place // 2, None, 2), slice(place % 2, None, 2)
        made[at] = values[colours[letter]][at]
    return GrayImage(made, 8)


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("colour", COLOURS)
def test_a_plane_in_the_image_stays_as_it_is(pattern: Pattern, colour: Colour) -> None:
    """Gray levels that change evenly are met between their pixels, but at the border; other colours play no part."""
    v, u = np.mgrid[0:9, 0:12].astype(float)
    values: dict[Colour, np.ndarray] = {name: np.full((9, 12), 200.0) for name in COLOURS}
    values[colour] = 10.5 + 3 * u + 2 * v
    image = raw(values, pattern)
    found = colour_image(image, pattern, colour).values
    assert found[1:-1, 1:-1] == pytest.approx(values[colour][1:-1, 1:-1], abs=1e-12)
    own = image.values == values[colour]
    assert (found[own] == values[colour][own]).all()


def blurred_dots(shift: float) -> np.ndarray:
    """Bright Gaussian-edged discs on a dark board, centres at 14.3 + shift + 30 k px both ways."""
    v, u = np.mgrid[0:90, 0:90].astype(float)
    made = np.full((90, 90), 20.0)
    for k in range(3):
        for n in range(3):
            away = np.hypot(u - 14.3 - shift - 30 * k, v - 14.7 - 30 * n)
            made += 160 / (1 + np.exp((away - 8) / 0.7))
    return made


@pytest.mark.parametrize("colour", COLOURS)
def test_dots_lie_where_their_colour_has_them(colour: Colour) -> None:
    """Each colour's dots are shifted by another amount, as lateral colour does."""
    shifts: dict[Colour, float] = {"red": 0.8, "green": 0.0, "blue": -0.6}
    image = raw({name: blurred_dots(shift) for name, shift in shifts.items()}, "GRBG")
    dots = find_dots(colour_image(image, "GRBG", colour), 3, 3)
    off = [dot.u - (14.3 + shifts[colour] + 30 * dot.column) for dot in dots.dots]
    assert np.abs(off).max() < NEAR
    assert np.abs([dot.v - (14.7 + 30 * dot.row) for dot in dots.dots]).max() < NEAR


@pytest.mark.parametrize("colour", COLOURS)
def test_an_edge_lies_where_its_colour_has_it(colour: Colour) -> None:
    v, u = np.mgrid[0:80, 0:80].astype(float)
    places: dict[Colour, float] = {"red": 38.2, "green": 40.0, "blue": 41.5}
    values = {
        name: 30 + 150 / (1 + np.exp(-((u - place) * np.cos(0.15) + (v - 39.5) * np.sin(0.15)) / 0.8))
        for name, place in places.items()
    }
    seen = colour_image(raw(values, "RGGB"), "RGGB", colour)
    # What the edge's model makes of this profile it must make of both.
    found, alone = (measure_edge(image, dark=0.0, gamma=1.0) for image in (seen, GrayImage(values[colour], 8)))
    places_found = [(edge.offset - 39.5 * np.sin(edge.angle)) / np.cos(edge.angle) for edge in (found, alone)]
    assert places_found[0] == pytest.approx(places_found[1], abs=NEAR)
    assert found.angle == pytest.approx(alone.angle, abs=NEAR / 20)
    assert alone.radius < found.radius < alone.radius + 1


def test_an_image_without_all_colours_is_refused() -> None:
    with pytest.raises(InputError, match="two rows"):
        colour_image(GrayImage(np.ones((1, 5))), "RGGB", "red")
