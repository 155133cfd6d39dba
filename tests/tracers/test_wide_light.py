"""Wide lights behind an edge: their half shadows against quadrature over the part that is not hidden."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba")

from radwrap.frames import Pose, aim
from radwrap.scene.materials import Lambertian
from radwrap.scene.sources import Beam, WideSource
from radwrap.scene.targets import Sheet
from radwrap.scene.wide_shapes import Annulus, Rectangle, WideShape, Zone, area
from radwrap.tracers.compiled.arrays import Cover, Tree, rows
from radwrap.tracers.compiled.arrays import Floats as Array
from radwrap.tracers.compiled.cover_rows import Wardrobe
from radwrap.tracers.compiled.shape_rows import sorted_shapes
from radwrap.tracers.compiled.tree import DEPTH
from radwrap.tracers.compiled.wide_beam import CUTS
from radwrap.tracers.compiled.wide_cells import ALL_CELLS, CELLS, bits_of, cell_of, hiding_cells, memory, within_cells
from radwrap.tracers.compiled.wide_light import MOST_POINTS
from radwrap.tracers.compiled.wide_points import key_of_ray, spread_point
from radwrap.tracers.compiled.wide_rows import cell_rows, shines_whole, wide_row
from radwrap.tracers.compiled.wide_shape import may_light, meets, point_on, unhidden
from radwrap.tracers.compiled.wide_shine import sent
from radwrap.tracers.compiled.wide_ways import WAYS
from radwrap.tracers.noise import FALL
from radwrap.tracers.text_frame import TextFrame

FRAME = TextFrame(length=1.0)
UP = (0.0, 0.0, 1.0)
KEYS = 3000
# Of the light: what is asked of half shadows.
HALF_SHADOW = 2e-3
SURE = 4.0  # standard errors
BRUTE = 2e-4  # of the light: the quadrature's own error at an edge
# A sheet's normal along x.
ON_EDGE = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))
PLACE = 1e-3  # m
LIGHTS: dict[str, tuple[WideShape, Pose]] = {
    "bar": (Rectangle(0.6, 0.1), aim((0.1, 0.2, 1.0), (0.0, 0.0, 0.0))),
    "disc": (Annulus(0.0, 0.3), aim((0.0, 0.0, 1.0), (0.0, 0.0, 0.0))),
    "area_ring": (Annulus(0.2, 0.3), aim((0.3, 0.0, 1.0), (0.0, 0.0, 0.0))),
    "dome": (Zone(1.0, 0.2, math.pi / 2), aim((0.0, 0.0, 0.05), (0.0, 0.0, 0.0))),
}


def wide(name: str) -> WideSource:
    shape, pose = LIGHTS[name] if name in LIGHTS else (Zone(1.0, 0.0, math.pi), Pose((0.1, 0.2, 0.3)))
    return WideSource(name, "rectangle", pose, shape, 2.0, Beam("lambertian"), 0.1, 1)


def sheets(poses: Sequence[Pose]) -> Tree:
    """Sheets of 2 m x 2 m."""
    tables: list[float] = []
    wardrobe = Wardrobe({"gray": Lambertian(0.5)}, FRAME, tables)
    pieces = [p for k, pose in enumerate(poses) for p in wardrobe.pieces(Sheet(f"s{k}", pose, "gray", 2.0, 2.0))]
    return sorted_shapes(pieces, FRAME, tables)


def area_points(shape: WideShape, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points of a shape evenly by area, and normals: a grid would lie along the edge of a shadow."""
    k = np.arange(count)
    u, v = (k + 0.5) / count, np.mod(k * (math.sqrt(5) - 1) / 2, 1.0)
    turn, up = 2 * math.pi * v, np.tile([0.0, 0.0, 1.0], (count, 1))
    match shape:
        case Rectangle(width, height):
            return np.stack([(u - 0.5) * width, (v - 0.5) * height, 0 * u], axis=1), up
        case Annulus(inner, outer):
            r = np.sqrt(inner**2 + u * (outer**2 - inner**2))
            return np.stack([r * np.cos(turn), r * np.sin(turn), 0 * u], axis=1), up
        case Zone(radius, least, most):
            c = math.cos(least) + u * (math.cos(most) - math.cos(least))
            s = np.sqrt(1 - c**2)
            outwards = np.stack([s * np.cos(turn), s * np.sin(turn), -c], axis=1)
            return radius * outwards, -outwards


def brute(source: WideSource, x: float, edge: float, height: float) -> float:
    """Irradiance of (x, 0, 0) by what is seen beside a sheet that begins at x = edge."""
    points, normals = area_points(source.shape, 1 << 20)
    turned = np.asarray(source.pose.rotation).T
    points, normals = points @ turned + source.pose.position, normals @ turned
    away = np.array([x, 0.0, 0.0]) - points
    leaving, arriving = np.maximum((away * normals).sum(axis=-1), 0), np.maximum(-away[..., 2], 0)
    at = height / np.maximum(points[..., 2], 1e-9)
    crossing, aside = x + (points[..., 0] - x) * at, points[..., 1] * at
    stopped = (at < 1) & (crossing > edge) & (crossing < edge + 2) & (np.abs(aside) < 1)
    f = leaving * arriving / (away**2).sum(axis=-1) ** 2 * area(source.shape)
    return float(source.radiance * f[~stopped].sum() / len(f))


def open_light(source: WideSource, p: tuple[float, float, float]) -> float:
    """What a point gets with nothing between."""
    return unhidden(wide_row(source, FRAME)[0], np.zeros(1), p, UP, np.empty(CUTS))


def received(
    source: WideSource,
    tree: Tree,
    p: tuple[float, float, float],
    n: tuple[float, float, float],
    halvings: int = 0,
) -> Array:
    """Irradiances of a point by many keys: radiances of a surface of reflectance pi."""
    light, none, stack = wide_row(source, FRAME)[0], sheets(()), np.empty(DEPTH, dtype=np.int64)
    cells, known, chosen = cell_rows([source], FRAME), memory(), np.empty(CELLS * CELLS, dtype=np.int64)
    rest = (PLACE, halvings, False, rows(Cover, 1)[0], 1.0, *tree, *none, np.zeros(1), p, n, n, -1)
    room, ways = np.empty(CUTS), np.empty(WAYS, dtype=np.int64)
    keys = [key_of_ray(float(k), 0.0, 0.0, 0.0, 0.0, 1.0, 0) for k in range(KEYS)]
    return np.array([sent(light, 0, cells, *rest, key, known, chosen, room, ways, stack) for key in keys])


@pytest.mark.parametrize("x", [0.0, *(pytest.param(x, marks=pytest.mark.long) for x in (-0.1, 0.04))])
@pytest.mark.parametrize("name", LIGHTS)
def test_half_shadow_behind_an_edge(name: str, x: float) -> None:
    source, edge, height = wide(name), 0.01, 0.3
    tree = sheets([Pose((edge + 1.0, 0.0, height))])
    found = received(source, tree, (x, 0.0, 0.0), UP).mean()
    assert found == pytest.approx(brute(source, x, edge, height), abs=HALF_SHADOW * open_light(source, (x, 0.0, 0.0)))


@pytest.mark.parametrize("halvings", [*(pytest.param(number, marks=pytest.mark.long) for number in (-2, 2)), 9])
@pytest.mark.parametrize("name", ["bar", "dome"])
def test_any_number_of_points_has_the_right_mean(name: str, halvings: int) -> None:
    source, edge, height = wide(name), 0.01, 0.3
    tree, p = sheets([Pose((edge + 1.0, 0.0, height))]), (0.0, 0.0, 0.0)
    values = received(source, tree, p, UP, halvings)
    close = max(HALF_SHADOW * open_light(source, p), SURE * values.std() / math.sqrt(KEYS))
    assert values.mean() == pytest.approx(brute(source, p[0], edge, height), abs=close)


def test_noise_falls_as_points_to_the_power_of_three_quarters() -> None:
    """An edge's: variances over a fourth and over four times as many points differ as much as chance allows."""
    source, tree = wide("dome"), sheets([Pose((1.01, 0.0, 0.3))])
    few, usual, many = (received(source, tree, (0.0, 0.0, 0.0), UP, halvings).var() for halvings in (2, 0, -2))
    for ratio in (few / usual, usual / many):
        assert 4**FALL / 2 < ratio < 4**FALL * 2


@pytest.mark.parametrize("name", LIGHTS)
def test_no_noise_where_nothing_hides(name: str) -> None:
    tree, p = sheets([Pose((0.0, 0.0, -0.5)), Pose((9.0, 0.0, 0.0))]), (0.0, 0.0, 0.0)
    values = received(wide(name), tree, p, UP)
    assert np.ptp(values) == 0
    assert values[0] == open_light(wide(name), p)


@pytest.mark.parametrize("name", LIGHTS)
def test_no_light_where_all_is_hidden(name: str) -> None:
    assert not received(wide(name), sheets([Pose((0.0, 0.0, 0.03))]), (0.0, 0.0, 0.0), UP).any()


@pytest.mark.parametrize("halvings", [0, 2, 9])
def test_the_last_of_a_half_shadow_has_the_right_mean(halvings: int) -> None:
    """Few points leave less than nothing of it now and then; cut off at 0, the mean would be too large."""
    source, edge, height = wide("bar"), 0.01, 0.3
    tree = sheets([Pose((edge + 1.0, 0.0, height))])
    for x in (0.08, 0.1, 0.12):
        values = received(source, tree, (x, 0.0, 0.0), UP, halvings)
        due, error = brute(source, x, edge, height), values.std() / math.sqrt(KEYS)
        close = max(SURE * error, BRUTE * open_light(source, (x, 0.0, 0.0)))
        assert values.mean() == pytest.approx(due, abs=close)
        assert close < HALF_SHADOW * open_light(source, (x, 0.0, 0.0)) or halvings > 0


@pytest.mark.parametrize("halvings", [0, 2, 9])
@pytest.mark.parametrize("low", [-0.02, -0.06, 0.0, 0.01])
def test_a_bar_that_the_horizon_cuts_leaves_no_light_in_a_shadow(low: float, halvings: int) -> None:
    """Its lower part lights no level place, whatever stands between: cells of it are not what is left."""
    source = WideSource(
        "bar",
        "rectangle",
        aim((-0.4, 0.0, low + 0.05), (0.0, 0.0, low + 0.05)),
        Rectangle(0.6, 0.1),
        2.0,
        Beam("lambertian"),
        0.1,
        1,
    )
    p = (0.0, 0.0, 0.0)
    hidden = received(source, sheets([Pose((-0.05, 0.0, 0.99), rotation=ON_EDGE)]), p, UP, halvings)
    assert not hidden.any()
    # A sheet from above down to .03 m leaves what is seen below it.
    values = received(source, sheets([Pose((-0.05, 0.0, 1.003), rotation=ON_EDGE)]), p, UP, halvings)
    due, error = below(source, 0.05, 0.003), values.std() / math.sqrt(KEYS)
    assert values.mean() == pytest.approx(due, abs=max(SURE * error, BRUTE * open_light(source, p)))


def below(source: WideSource, away: float, height: float) -> float:
    """Irradiance of the origin by what is seen below a sheet on edge, so far away and so high."""
    points, normals = area_points(source.shape, 1 << 20)
    turned = np.asarray(source.pose.rotation).T
    points, normals = points @ turned + source.pose.position, normals @ turned
    leaving, arriving = np.maximum((-points * normals).sum(axis=-1), 0), np.maximum(points[..., 2], 0)
    stopped = points[..., 2] * away / -points[..., 0] > height
    f = leaving * arriving / (points**2).sum(axis=-1) ** 2 * area(source.shape)
    return float(source.radiance * f[~stopped].sum() / len(f))


def outside(x: float, z: float) -> float:
    """Irradiance of a point beside a dome, of an upward face, by points of the dome that its own wall does not hide."""
    source = wide("dome")
    points, normals = area_points(source.shape, 1 << 20)
    turned = np.asarray(source.pose.rotation).T
    points, normals = points @ turned + source.pose.position, normals @ turned
    away = np.array([x, 0.0, z]) - points
    square = (away**2).sum(axis=-1)
    leaving, arriving = np.maximum((away * normals).sum(axis=-1), 0), np.maximum(-away[..., 2], 0)
    # The sphere about (0, 0, 0.05): where the way from the point enters it, a wall may be.
    at, unit = np.array([x, 0.0, z - 0.05]), -away / np.sqrt(square)[:, np.newaxis]
    along = -(unit @ at)
    foot = at + along[:, np.newaxis] * unit
    enters = along - np.sqrt(np.maximum(1 - (foot**2).sum(axis=-1), 0))
    up = (at + enters[:, np.newaxis] * unit)[:, 2]
    stopped = (enters > 0) & (up > 0) & (up < math.cos(0.2))
    f = leaving * arriving / square**2 * area(source.shape)
    return float(source.radiance * f[~stopped].sum() / len(f))


@pytest.mark.parametrize(
    ("x", "z"), [(1.1, -0.2), *(pytest.param(*at, marks=pytest.mark.long) for at in ((1.1, 0.0), (1.5, -0.3)))]
)
def test_a_dome_hides_its_own_light_from_outside(x: float, z: float) -> None:
    values = received(wide("dome"), sheets(()), (x, 0.0, z), UP)
    whole = open_light(wide("dome"), (x, 0.0, z))
    error = values.std() / math.sqrt(KEYS)
    assert error < HALF_SHADOW * whole
    assert values.mean() == pytest.approx(outside(x, z), abs=SURE * error)
    assert values.mean() < 0.9 * whole


@pytest.mark.parametrize("key", [0, 1, 0xFFFFFFFF, 123456789])
def test_each_elementary_box_holds_one_point(key: int) -> None:
    points = np.array([spread_point(i, key) for i in range(MOST_POINTS)])
    assert points.min() > 0
    assert points.max() < 1
    for count in (16, MOST_POINTS):
        for cuts in (1, 2, 4, 8, 16):
            boxes = {(int(u * cuts), int(v * (count // cuts))) for u, v in points[:count].tolist()}
            assert len(boxes) == count


def test_keys_give_independent_even_points() -> None:
    first = np.array([spread_point(0, key_of_ray(float(k), 0.5, 2.0, 0.0, 1.0, 0.0, 3)) for k in range(4000)])
    # Means of 4000 even numbers have a standard deviation of 0.0046: five of them.
    assert np.abs(first.mean(axis=0) - 0.5).max() < 0.023
    assert np.abs(np.corrcoef(first.T)[0, 1]) < 0.08
    assert key_of_ray(1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 0) != key_of_ray(1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 1)
    assert key_of_ray(0.1, 2.0, 3.0, 4.0, 5.0, 6.0, 0) == key_of_ray(0.1 + 1e-12, 2.0, 3.0, 4.0, 5.0, 6.0, 0)


@pytest.mark.parametrize("name", [*LIGHTS, "sky"])
def test_cells_hold_the_points_of_their_shares(name: str) -> None:
    source = wide(name)
    light, cells = wide_row(source, FRAME)[0], cell_rows([source], FRAME)
    assert len(cells) == ALL_CELLS
    random = np.random.default_rng(5)
    widest = 0.0
    for u, v in random.random((2000, 2)).tolist():
        x, y, z, *_ = point_on(light, u, v)
        base = 0
        for count in (1, 2, 4, 8):
            box = cells[base + int(u * count) * count + int(v * count)]
            assert box["x0"] <= x <= box["x1"]
            assert box["y0"] <= y <= box["y1"]
            assert box["z0"] <= z <= box["z1"]
            base += count * count
        assert cell_of(u, v) == int(u * 8) * 8 + int(v * 8)
        widest = max(widest, box["x1"] - box["x0"])
    assert widest < 0.7 * (cells[0]["x1"] - cells[0]["x0"])  # they are no larger than they must be


def test_even_points_of_some_cells() -> None:
    chosen, some = np.empty(CELLS * CELLS, dtype=np.int64), [0, 7, 9, 12, 35, 63]
    count = bits_of(sum(1 << cell if cell < 63 else -(1 << 63) for cell in some), chosen)
    assert count == len(some)
    found = [cell_of(*within_cells(*spread_point(i, 3), chosen, count)) for i in range(1 << 12)]
    assert sorted(set(found)) == some
    shares = np.array([found.count(cell) for cell in some]) / len(found)
    assert np.abs(shares * count - 1).max() < 0.01
    assert bits_of(-1, chosen) == CELLS * CELLS
    # Each is next to the one before it, or starts anew a step away.
    assert chosen[:4].tolist() == [0, 1, 8, 9]


def test_what_may_be_hidden_hangs_on_the_place_only() -> None:
    """Asked in any order, with anything remembered, a point gets the same cells."""
    source, tree, none = wide("disc"), sheets([Pose((1.01, 0.0, 0.3))]), sheets(())
    light, cells = wide_row(source, FRAME)[0], cell_rows([source], FRAME)
    stack, chosen = np.empty(DEPTH, dtype=np.int64), np.empty(CELLS * CELLS, dtype=np.int64)

    def asked(x: float, known: np.ndarray) -> tuple[int, bool]:
        return hiding_cells(light, 0, cells, *tree, *none, np.zeros(1), PLACE, (x, 0.0, 0.0), -1, known, chosen, stack)

    places = np.random.default_rng(1).uniform(-1.0, 1.0, 300).tolist()
    once = [asked(x, memory()) for x in places]
    known = memory()
    together = [asked(x, known) for x in places]
    again = [asked(x, known) for x in reversed(places)][::-1]
    assert once == together == again
    assert asked(-0.9, memory())[0] == 0  # the sheet is on the other side
    assert asked(0.9, memory())[0] == -1
    some = {bits for bits, _ in once} - {0, -1}
    assert len(some) > 3


@pytest.mark.parametrize("name", LIGHTS)
def test_rays_meet_a_light_where_its_points_are(name: str) -> None:
    light, random = wide_row(wide(name), FRAME)[0], np.random.default_rng(2)
    for u, v in random.random((200, 2)).tolist():
        x, y, z, nx, ny, nz = point_on(light, u, v)
        p = (0.05, -0.02, 0.04)
        away = math.dist((x, y, z), p)
        d = tuple((a - b) / away for a, b in zip((x, y, z), p, strict=True))
        found, cosine = meets(light, p, d)
        assert found == pytest.approx(away, rel=1e-9)
        assert cosine == pytest.approx(-(d[0] * nx + d[1] * ny + d[2] * nz), rel=1e-9)
        assert not math.isfinite(meets(light, p, tuple(-c for c in d))[0])


def test_below_the_horizon_nothing_is_asked() -> None:
    light = wide_row(wide("bar"), FRAME)[0]
    assert may_light(light, (0.0, 0.0, 0.0), UP)
    assert not may_light(light, (0.0, 0.0, 0.0), (0.0, 0.0, -1.0))
    assert may_light(light, (0.0, 0.0, 0.0), (-1.0, 0.0, 0.0))  # a part of it


def test_what_shines_as_a_whole() -> None:
    even = wide("bar")
    assert shines_whole(even)
    assert shines_whole(replace(even, beam=Beam("gaussian", 0.3)))
    assert not shines_whole(replace(even, radiance=0.0))
    assert not shines_whole(replace(wide("dome"), beam=Beam("gaussian", 0.3)))  # no scene has one
