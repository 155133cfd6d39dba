"""Where sub-viewpoints lie, and the area that each stands for (Sec. 3.1)."""

import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from radwrap.errors import InputError
from radwrap.imaging.optics.aperture import LAYOUTS, Viewpoints, sub_viewpoints
from radwrap.scene.camera import Aperture

UNIT_SUM = 1e-15  # asked for by the validation plan
ROUNDING = 1e-14  # of lengths in units of the radius; some hundreds of float64 operations
# The areas of a hexagonal layout are measured with 262144 points, those of a square's cells with 9216.
SAMPLED = 5e-5
HEXAGONAL_AREA = 5e-3  # the same samples, of which rows fall to one side or the other of a straight border

NUMBERS = (*range(1, 201), 4096)
FEWER_NUMBERS = (*range(1, 21), 37, 61, 64, 127)  # cells of a square cost half a millisecond each
HEXAGONAL_NUMBERS = (1, 7, 12, 19, 37)
SHAPES = {
    "round": Aperture(diameter=2.0),
    "square": Aperture(shape="square", diameter=2.0),
    "annular": Aperture(shape="annular", diameter=2.0, inner_diameter=0.8),
    "half_disc": Aperture(shape="half_disc", diameter=2.0),
}


@cache
def layouts_of(shape: str, layout: Any) -> list[Viewpoints]:
    """All that exist among the numbers; a hexagonal lattice fits some openings with some numbers only."""
    if layout != "hexagonal":
        numbers = FEWER_NUMBERS if shape == "square" else NUMBERS
        return [sub_viewpoints(SHAPES[shape], number, layout) for number in numbers]
    found = []
    for number in HEXAGONAL_NUMBERS:
        try:
            found.append(sub_viewpoints(SHAPES[shape], number, layout))
        except InputError as error:
            assert shape != "round" or number == 12, error
    assert found
    return found


def asymmetry(views: Viewpoints) -> float:
    """How far positions and weights are from those of the opening turned by half a turn."""
    distance, partner = cKDTree(views.positions).query(-views.positions)
    return float(max(distance.max(), np.abs(views.weights[partner] - views.weights).max()))


def centroid(views: Viewpoints) -> tuple[float, float]:
    u, v = (math.fsum(views.weights * views.positions[:, axis]) for axis in (0, 1))
    return u, v


@pytest.mark.parametrize(
    ("shape", "layout"),
    [
        pytest.param(shape, layout, marks=[pytest.mark.long] if (i + j) % 2 else [])
        for i, shape in enumerate(SHAPES)
        for j, layout in enumerate(LAYOUTS)
    ],
)
def test_weights_are_shares(shape: str, layout: Any) -> None:
    for views in layouts_of(shape, layout):
        assert math.fsum(views.weights) == pytest.approx(1.0, abs=UNIT_SUM)
        assert (views.weights > 0).all()
        if layout in ("rings", "sunflower"):  # equal areas are promised
            assert np.abs(views.weights * len(views) - 1).max() < ROUNDING * len(views)


@pytest.mark.parametrize(
    ("shape", "area"),
    [("round", math.pi), ("square", 4.0), ("annular", math.pi * (1 - 0.4**2)), ("half_disc", math.pi / 2)],
)
def test_area_that_sets_the_exposure(shape: str, area: float) -> None:
    assert sub_viewpoints(SHAPES[shape], 7).area == pytest.approx(area, rel=ROUNDING)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("shape", ["round", "square", "annular"])
def test_centroid_is_the_centre(shape: str, layout: Any) -> None:
    for views in layouts_of(shape, layout):
        assert centroid(views) == pytest.approx((0.0, 0.0), abs=ROUNDING)


@pytest.mark.parametrize(("layout", "tolerance"), [("rings", ROUNDING), ("uneven", ROUNDING), ("hexagonal", SAMPLED)])
def test_centroid_of_a_half_disc(layout: Any, tolerance: float) -> None:
    for views in layouts_of("half_disc", layout):
        assert centroid(views) == pytest.approx((4 / (3 * math.pi), 0.0), abs=tolerance)
    turned = sub_viewpoints(Aperture(shape="half_disc", diameter=2.0, rotation=math.radians(90)), 19, "rings")
    assert centroid(turned) == pytest.approx((0.0, 4 / (3 * math.pi)), abs=ROUNDING)


@pytest.mark.parametrize("layout", ["rings", "hexagonal", "sunflower"])
@pytest.mark.parametrize("shape", ["round", "square"])
def test_layouts_are_point_symmetric(shape: str, layout: Any) -> None:
    for views in layouts_of(shape, layout):
        assert asymmetry(views) < ROUNDING


@pytest.mark.parametrize("layout", LAYOUTS)
def test_viewpoints_lie_in_the_opening(layout: Any) -> None:
    """The centroids of an annular opening's cells too, once a ring has more than a few of them."""
    for shape in SHAPES:
        for views in layouts_of(shape, layout):
            u, v = np.abs(views.positions.T)
            assert (np.maximum(u, v) if shape == "square" else np.hypot(u, v)).max() < 1.0
            if shape == "half_disc":
                assert (views.positions[:, 0] > 0).all()
    for number in (6, 20, 62, 200):
        assert np.hypot(*sub_viewpoints(SHAPES["annular"], number).positions.T).min() > 0.4


def rings_of(views: Viewpoints) -> list[tuple[float, int, float]]:
    """(radius, number of viewpoints, weight of each) for each ring outwards."""
    radius = np.round(np.hypot(*views.positions.T), 9)
    rings = []
    for r in np.unique(radius):
        weights = views.weights[radius == r]
        assert np.ptp(weights) < ROUNDING
        rings.append((float(np.hypot(*views.positions[radius == r][0])), len(weights), float(weights[0])))
    return rings


def sector_centroid(inner: float, outer: float, share: float) -> float:
    """Distance of the centroid of a ring's sector from the centre; `share` of the full turn."""
    half = math.pi * share
    return 2 / 3 * math.sin(half) / half * (outer**3 - inner**3) / (outer**2 - inner**2)


@pytest.mark.parametrize("number", [2, 6, 12, 36, 61, 127, 200])
def test_uneven_areas_are_those_of_rings_of_equal_width(number: int) -> None:
    rings = rings_of(sub_viewpoints(SHAPES["round"], number, "uneven"))
    for place, (radius, cells, weight) in enumerate(rings):
        inner, outer = place / len(rings), (place + 1) / len(rings)
        assert weight == pytest.approx((outer**2 - inner**2) / cells, rel=ROUNDING * number)
        # A single cell is the whole disc, or one that all the others surround: its centroid is the centre.
        assert radius == pytest.approx(sector_centroid(inner, outer, 1 / cells), abs=ROUNDING)
    assert len({round(weight, 9) for _, _, weight in rings}) > 1 or len(rings) == 1


@pytest.mark.parametrize("number", [2, 6, 7, 12, 37, 61, 127, 200])
@pytest.mark.parametrize("stop", [0.0, 0.4])
def test_viewpoints_are_the_centroids_of_equal_areas(number: int, stop: float) -> None:
    """Rings whose bounds follow from how many equal areas lie further in."""
    shape = Aperture(shape="annular", diameter=2.0, inner_diameter=2 * stop) if stop else SHAPES["round"]
    inside = 0
    for radius, cells, _ in rings_of(sub_viewpoints(shape, number)):
        inner = math.sqrt(stop**2 + (1 - stop**2) * inside / number)
        outer = math.sqrt(stop**2 + (1 - stop**2) * (inside + cells) / number)
        assert radius == pytest.approx(sector_centroid(inner, outer, 1 / cells), abs=ROUNDING)
        inside += cells


def test_hexagonal_seven_are_one_among_six() -> None:
    """Areas by symmetry: six alike, and the middle hexagon between the lattice's six lines."""
    views = sub_viewpoints(SHAPES["round"], 7, "hexagonal")
    middle = int(np.hypot(*views.positions.T).argmin())
    others = np.delete(views.weights, middle)
    assert others == pytest.approx(np.full(6, others.mean()), rel=HEXAGONAL_AREA)
    angles = np.sort(np.degrees(np.arctan2(*np.delete(views.positions, middle, axis=0).T[::-1])) % 60)
    assert np.ptp(np.minimum(angles, 60 - angles)) < 0.1
    assert views.positions[middle] == pytest.approx([0.0, 0.0], abs=ROUNDING)


def test_layouts_that_do_not_exist_are_refused() -> None:
    with pytest.raises(InputError, match="no hexagonal layout has 8"):
        sub_viewpoints(SHAPES["round"], 8, "hexagonal")
    with pytest.raises(InputError, match="into 0 parts"):
        sub_viewpoints(SHAPES["round"], 0)
    with pytest.raises(InputError, match="no sub-viewpoints"):
        sub_viewpoints(Aperture(diameter=0.0), 7)
