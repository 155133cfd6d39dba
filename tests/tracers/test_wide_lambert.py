"""Wide lights of even radiance against textbook numbers and against quadrature over their true shape."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip("numba")

from radwrap.scene.wide_shapes import Annulus, Rectangle, WideShape, Zone, first_cells, halves, nodes
from radwrap.tracers.compiled.wide_lambert import annulus_irradiance, rectangle_irradiance, zone_irradiance

UP, DOWN = (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)
# What sums of angles of the size of 1 leave of digits where they cancel.
DIGITS = 1e-12
# Where the horizon cuts points of a grid, quadrature itself is right to this share of a hemisphere.
CUT = 2e-4
# Of the light, as was asked for, where no horizon cuts it.
SMOOTH = 1e-4


def irradiance(shape: WideShape, p: tuple[float, float, float], n: tuple[float, float, float]) -> float:
    match shape:
        case Rectangle(width, height):
            return rectangle_irradiance(width, height, p, n)
        case Annulus(inner, outer):
            return annulus_irradiance(inner, outer, p, n)
        case Zone(radius, least, most):
            return zone_irradiance(radius, -radius * math.cos(least), -radius * math.cos(most), p, n)


def brute(shape: WideShape, p: tuple[float, float, float], n: tuple[float, float, float]) -> float:
    """By many points of the true shape."""
    cells = first_cells(shape)
    for _ in range(9):
        cells = [half for cell in cells for half in halves(shape, cell)]
    points, normals, areas = nodes(shape, np.array(cells), 4)
    away = np.asarray(p) - points
    square = (away**2).sum(axis=-1)
    leaving, arriving = (away * normals).sum(axis=-1), -(away * n).sum(axis=-1)
    return float((np.maximum(leaving, 0) * np.maximum(arriving, 0) / square**2 * areas).sum())


@pytest.mark.parametrize("ratio", [0.001, 0.05, 0.5, 2.0, 50.0])
def test_below_the_middle_of_a_disc(ratio: float) -> None:
    """E = pi L sin^2 of the half angle."""
    due = math.pi * ratio**2 / (1 + ratio**2)
    assert annulus_irradiance(0.0, ratio, UP, DOWN) == pytest.approx(due, rel=DIGITS)
    hole = math.pi * (ratio / 2) ** 2 / (1 + (ratio / 2) ** 2)
    assert annulus_irradiance(ratio / 2, ratio, UP, DOWN) == pytest.approx(due - hole, rel=10 * DIGITS)


@pytest.mark.parametrize("offset", [0.0, 0.3, 1.0, 4.0])
def test_a_parallel_surface_off_the_axis_of_a_disc(offset: float) -> None:
    """E = pi L/2 (1 - (1 + Z - 2 X)/sqrt(...)), with Z of Siegel and Howell's differential element to a disc."""
    h, r = 1 / 1.0, 0.7
    z = 1 + offset**2 + r**2
    due = math.pi / 2 * (1 - (1 + offset**2 - r**2) / math.sqrt(z**2 - 4 * offset**2 * r**2))
    assert annulus_irradiance(0.0, r, (offset, 0.0, h), DOWN) == pytest.approx(due, rel=DIGITS * 10)


def test_a_surface_upright_in_the_axis_of_a_disc() -> None:
    """Half of the disc is above its horizon: E = L (arctan(r/h) - (r/h)/(1 + (r/h)^2))."""
    r = 0.8
    due = math.atan(r) - r / (1 + r**2)
    assert annulus_irradiance(0.0, r, UP, (1.0, 0.0, 0.0)) == pytest.approx(due, rel=DIGITS)


@pytest.mark.parametrize(("a", "b"), [(0.5, 0.3), (0.01, 2.0), (5.0, 7.0)])
def test_below_the_corner_of_a_rectangle(a: float, b: float) -> None:
    """The corner view factors of parallel and upright surfaces."""
    ra, rb = math.sqrt(1 + a * a), math.sqrt(1 + b * b)
    parallel = (a / ra * math.atan(b / ra) + b / rb * math.atan(a / rb)) / 2
    upright = (math.atan(b) - math.atan(b / ra) / ra) / 2
    corner = (-a / 2, -b / 2, 1.0)
    assert rectangle_irradiance(a, b, corner, DOWN) == pytest.approx(parallel, rel=1e-10)
    assert rectangle_irradiance(a, b, corner, (1.0, 0.0, 0.0)) == pytest.approx(upright, rel=1e-10)
    assert rectangle_irradiance(a, b, corner, (-1.0, 0.0, 0.0)) == pytest.approx(0.0, abs=DIGITS)


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (0.3, -0.2, 0.1), (0.0, 0.0, -0.9)])
def test_a_surround_lights_every_surface_by_pi(place: tuple[float, float, float]) -> None:
    for normal in (UP, DOWN, (0.6, 0.0, 0.8)):
        assert zone_irradiance(1.0, -1.0, 1.0, place, normal) == pytest.approx(math.pi, rel=DIGITS)


def test_in_the_middle_of_a_dome_with_a_hole() -> None:
    hole = 0.25  # sine of its half angle
    low = -math.sqrt(1 - hole**2)
    assert zone_irradiance(1.0, low, 0.0, (0.0, 0.0, 0.0), DOWN) == pytest.approx(math.pi * (1 - hole**2), rel=DIGITS)
    assert zone_irradiance(1.0, low, 0.0, (0.0, 0.0, 0.0), UP) == pytest.approx(0.0, abs=DIGITS)
    for tilt in (1e-15, 1e-12, 1e-10, 1e-8, 1e-6):  # a sheet in the opening, as good as even
        value = zone_irradiance(1.0, low, 0.0, (0.0, 0.0, 0.0), (tilt, 0.0, -1.0))
        assert value == pytest.approx(math.pi * (1 - hole**2), rel=1e-6 + 2 * tilt)


def test_nothing_comes_from_behind() -> None:
    assert rectangle_irradiance(1.0, 1.0, (0.0, 0.0, -1.0), UP) == 0
    assert annulus_irradiance(0.2, 1.0, (0.0, 0.0, -1.0), UP) == 0
    assert rectangle_irradiance(1.0, 1.0, UP, UP) == 0
    assert annulus_irradiance(0.2, 1.0, UP, UP) == 0


SHAPES = [
    Rectangle(1.0, 0.4),
    Rectangle(0.05, 2.0),
    Annulus(0.0, 0.6),
    Annulus(0.5, 0.6),
    Zone(1.0, 0.0, math.pi / 2),
    Zone(1.0, math.asin(0.25), math.pi / 2),
    Zone(1.0, 0.7, 2.2),
    Zone(1.0, 2.0, math.pi),
]


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_random_points_against_quadrature(shape: WideShape) -> None:
    random = np.random.default_rng(11)
    for k in range(40):
        p = random.uniform(-1, 1, 3) * (0.5 if k % 2 else 3.0)
        if abs(np.linalg.norm(p) - 1) < 0.1 or (not isinstance(shape, Zone) and p[2] < 0.1):
            continue
        n = random.normal(size=3)
        n /= np.linalg.norm(n)
        place, normal = tuple(p.tolist()), tuple(n.tolist())
        due = brute(shape, place, normal)
        assert irradiance(shape, place, normal) == pytest.approx(due, rel=SMOOTH, abs=CUT * math.pi), (place, normal)


@pytest.mark.parametrize("ratio", [0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0])
@pytest.mark.parametrize(
    "shape",
    [
        Rectangle(2.0, 1.0),
        Rectangle(2.0, 0.1),
        Annulus(0.0, 1.0),
        Annulus(0.6, 1.0),
        Zone(1.0, math.asin(0.25), math.pi / 2),
    ],
    ids=("rectangle", "bar", "disc", "area_ring", "dome"),
)
def test_the_geometries_of_the_published_table(shape: WideShape, ratio: float) -> None:
    """Those of scripts/wide_sources.py, whole above the horizon."""
    for x, y in ((0.0, 0.0), (0.137, 0.071), (0.43, -0.29), (-0.71, 0.33)):
        place = (x, y, 1 / ratio)
        assert irradiance(shape, place, DOWN) == pytest.approx(brute(shape, place, DOWN), rel=SMOOTH)
