"""Irradiance by flat wide lights with other beams, against points of the light in great number."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

pytest.importorskip("numba")

from radwrap.frames import Pose
from radwrap.scene.sources import Beam, TableBeam, WideSource
from radwrap.scene.wide_shapes import Annulus, Rectangle, WideShape, area
from radwrap.tracers.compiled.arrays import Cover, rows
from radwrap.tracers.compiled.tree import DEPTH
from radwrap.tracers.compiled.wide_beam import CUTS, beam_irradiance
from radwrap.tracers.compiled.wide_cells import CELLS, bits_of, cell_of, lit_cells, memory
from radwrap.tracers.compiled.wide_points import key_of_ray, spread_point
from radwrap.tracers.compiled.wide_rows import beam_reach, cell_rows, wide_row
from radwrap.tracers.compiled.wide_shape import point_on, unhidden
from radwrap.tracers.compiled.wide_shine import sent
from radwrap.tracers.compiled.wide_ways import WAYS
from tests.tracers.test_wide_light import FRAME, PLACE, SURE, UP, area_points, sheets

# Of what would be received with the whole light before the point: asked of closed forms and quadrature.
SAME = 1e-4
# A beam that ends at once is found by 2^18 points to so much.
ENDING = 5e-4
# And one whose curvature jumps by quadrature.
JUMPS = 4e-4
# Beyond this share of its peak a beam has ended.
DARK = 1e-8
KEYS = 3000
TABLE = TableBeam("table", 1.0, "x", 0.0, tuple((np.cos(np.radians(np.arange(0, 90.5, 0.5))) ** 3).tolist()))
DEGREES = np.arange(0, 90.01, 0.05)
JUMPING = {
    name: tuple(PchipInterpolator(angle, value)(DEGREES).tolist())
    for name, angle, value in (
        ("ies", [0, 5, 10, 15, 20, 30, 40, 60, 90], [1.0, 0.98, 0.9, 0.7, 0.45, 0.2, 0.08, 0.02, 0.0]),
        ("step", [0, 20, 21, 60, 70, 90], [1.0, 1.0, 0.02, 0.02, 0.5, 0.4]),
    )
}
BEAMS = {
    "narrow": Beam("gaussian", math.radians(6)),
    "gaussian": Beam("gaussian", math.radians(25)),
    "power": Beam("cosine_power", math.radians(20)),
    "cone": Beam("cone", math.radians(35)),
    "table": TABLE,
    "even": Beam("lambertian"),
}
SHAPES: dict[str, WideShape] = {
    "bar": Rectangle(0.6, 0.1),
    "square": Rectangle(0.5, 0.5),
    "disc": Annulus(0.0, 0.3),
    "ring": Annulus(0.2, 0.3),
}


def wide(shape: WideShape, beam: Beam, pose: Pose | None = None) -> WideSource:
    return WideSource("light", "rectangle", pose or Pose((0.0, 0.0, 0.0)), shape, 2.0, beam, 0.1, 1)


def row_of(source: WideSource) -> tuple[np.void, np.ndarray]:
    """Its row, and all tables."""
    row = wide_row(source, FRAME)
    row["columns"] = len(TABLE.values)
    return row[0], np.array(TABLE.values)


def brute(source: WideSource, p: np.ndarray, n: np.ndarray, count: int = 1 << 18) -> float:
    """Irradiance over radiance."""
    points, _ = area_points(source.shape, count)
    away = points - p
    distance = np.linalg.norm(away, axis=1)
    theta = np.arctan2(np.hypot(away[:, 0], away[:, 1]), p[2])
    f = source.beam.relative_intensity(theta) * np.maximum(away @ n, 0) / distance**3
    return float(area(source.shape) * f.mean())


# Of each light one surface that faces its plane and two that do not; three more are long.
@pytest.mark.parametrize("number", [3, pytest.param(6, marks=pytest.mark.long)])
@pytest.mark.parametrize(
    ("shape", "beam"),
    [
        pytest.param(shape, beam, marks=[pytest.mark.long] if (i + j) % 2 else [])
        for i, shape in enumerate(SHAPES)
        for j, beam in enumerate(BEAMS)
    ],
)
def test_random_points_against_quadrature(shape: str, beam: str, number: int) -> None:
    source, random = wide(SHAPES[shape], BEAMS[beam]), np.random.default_rng(7)
    light, tables = row_of(source)
    room = np.empty(CUTS)
    for k in range(number):
        p = random.uniform([-0.4, -0.4, 0.15], [0.4, 0.4, 1.5])
        n = np.array([0.0, 0.0, -1.0]) if k % 3 == 0 else random.normal(size=3)
        n /= np.linalg.norm(n)
        found = beam_irradiance(light, tables, tuple(p.tolist()), tuple(n.tolist()), room)
        due = brute(source, p, n)
        best = brute(source, p, np.array([0.0, 0.0, -1.0]), 1 << 12)
        assert found == pytest.approx(due, abs=(ENDING if beam == "cone" else SAME) * max(due, best) + DARK), (p, n)


@pytest.mark.parametrize("rows", ["ies", "step"])
def test_a_table_whose_curvature_jumps_at_its_rows(rows: str) -> None:
    """As read from a file of few rows; in steps of the steepest slope it was off by up to .1 per cent."""
    beam, random, largest = TableBeam("table", 1.0, "x", 0.0, JUMPING[rows]), np.random.default_rng(11), 0.0
    for k in range(60):
        size, away, tilt, turn = random.uniform([0.05, 0.3, 0.0, 0.0], [0.9, 1.5, 1.1, 2 * math.pi])
        source = wide(Rectangle(size, size * 0.3) if k % 2 else Annulus(size / 6, size / 2), beam)
        row = wide_row(source, FRAME)
        row["columns"] = len(beam.values)
        p = away * np.array([math.sin(tilt) * math.cos(turn), math.sin(tilt) * math.sin(turn), math.cos(tilt)])
        n = -p / away
        found = beam_irradiance(row[0], np.array(beam.values), tuple(p.tolist()), tuple(n.tolist()), np.empty(CUTS))
        largest = max(largest, abs(found / brute(source, p, n) - 1))
    assert largest < JUMPS


def test_an_even_beam_is_lamberts_closed_form() -> None:
    random = np.random.default_rng(3)
    for shape in SHAPES.values():
        light, tables = row_of(wide(shape, BEAMS["even"]))
        for _ in range(40):
            p, n = random.uniform([-1.0, -1.0, 0.05], [1.0, 1.0, 2.0]), random.normal(size=3)
            n /= np.linalg.norm(n)
            place, normal = tuple(p.tolist()), tuple(n.tolist())
            room = np.empty(CUTS)
            closed, best = (unhidden(light, tables, place, to, room) / 2.0 for to in (normal, (0.0, 0.0, -1.0)))
            found = beam_irradiance(light, tables, place, normal, room)
            assert found == pytest.approx(closed, abs=SAME * max(closed, best))


def test_a_point_before_a_large_gaussian_light() -> None:
    """E = 2 pi L times the integral of sin exp(-theta^2/(2 s^2)), whatever the distance."""
    s = math.radians(5)
    light, tables = row_of(wide(Rectangle(4.0, 4.0), Beam("gaussian", s)))
    theta = np.linspace(0, math.pi / 2, 200001)
    due = 2 * math.pi * np.trapezoid(np.sin(theta) * np.exp(-(theta**2) / (2 * s * s)), theta)
    for p in ((0.0, 0.0, 0.1), (1.0, -0.7, 0.5), (0.3, 0.3, 1.0)):
        assert beam_irradiance(light, tables, p, (0.0, 0.0, -1.0), np.empty(CUTS)) == pytest.approx(due, rel=SAME)


def test_nothing_from_behind_and_beyond_the_beam() -> None:
    light, tables = row_of(wide(Rectangle(0.1, 0.1), BEAMS["cone"]))
    assert beam_irradiance(light, tables, (0.0, 0.0, -1.0), UP, np.empty(CUTS)) == 0
    assert beam_irradiance(light, tables, (2.0, 0.0, 1.0), (0.0, 0.0, -1.0), np.empty(CUTS)) == 0


def test_how_narrow_a_beam_is() -> None:
    narrow, reach = beam_reach(BEAMS["gaussian"])
    assert narrow == math.radians(25)
    assert reach == math.pi / 2
    assert beam_reach(BEAMS["narrow"])[1] == pytest.approx(math.radians(6) * math.sqrt(2 * math.log(1e8)), abs=1e-3)
    assert beam_reach(BEAMS["cone"]) == (math.pi / 2, math.radians(35))
    narrow, reach = beam_reach(TABLE)
    # cos^3 meets the Gaussian of standard deviation 3^-1/2, and ends sooner; tables count as twice as narrow.
    assert 0.85 * 3**-0.5 < 2 * narrow < 3**-0.5
    assert reach > math.radians(89)


def received(source: WideSource, edge: float, p: tuple[float, float, float]) -> np.ndarray:
    """Irradiances of a point below by many keys, behind a sheet that begins at x = edge, .3 m below the light."""
    light, tables = row_of(source)
    tree, none, stack = sheets([Pose((edge + 1.0, 0.0, -0.3))]), sheets(()), np.empty(DEPTH, dtype=np.int64)
    cells, known, chosen = cell_rows([source], FRAME), memory(), np.empty(CELLS * CELLS, dtype=np.int64)
    matte, room, ways = rows(Cover, 1)[0], np.empty(CUTS), np.empty(WAYS, dtype=np.int64)
    keys = [key_of_ray(float(k), 0.0, 0.0, 0.0, 0.0, 1.0, 0) for k in range(KEYS)]
    rest = matte, 1.0, *tree, *none, tables, p, UP, UP, -1
    last = known, chosen, room, ways, stack
    return np.array([sent(light, 0, cells, PLACE, 0, False, *rest, key, *last) for key in keys])


@pytest.mark.parametrize("beam", ["narrow", "gaussian", "table"])
def test_half_shadow_behind_an_edge(beam: str) -> None:
    down = Pose((0.0, 0.0, 0.0), ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)))
    source, edge = wide(SHAPES["bar"], BEAMS[beam], down), 0.01
    p = (0.02, 0.01, -1.0)
    values = received(source, edge, p)
    points, _ = area_points(source.shape, 1 << 19)
    points = points * [1.0, -1.0, 1.0]
    away = points - np.array(p)
    at = p[0] + away[:, 0] * 0.7
    theta = np.arctan2(np.hypot(away[:, 0], away[:, 1]), 1.0)
    f = source.beam.relative_intensity(theta) / np.linalg.norm(away, axis=1) ** 3 * (at < edge)
    due, error = 2.0 * area(source.shape) * float(f.mean()), values.std() / math.sqrt(KEYS)
    assert values.mean() == pytest.approx(due, abs=SURE * error)
    assert error < 0.01 * due
    assert not received(source, -1.0 + 0.5, (0.2, 0.0, -1.0)).any()


def test_cells_beyond_a_beam_send_nothing() -> None:
    source = wide(Rectangle(2.0, 1.0), BEAMS["narrow"])
    light, _ = row_of(source)
    cells, p = cell_rows([source], FRAME), (0.4, -0.2, 0.8)
    lit = lit_cells(light, 0, cells, p)
    chosen = np.empty(CELLS * CELLS, dtype=np.int64)
    assert 0 < bits_of(lit, chosen) < 48
    for i in range(4096):
        u, v = spread_point(i, 5)
        x, y, *_ = point_on(light, u, v)
        theta = math.atan2(math.hypot(x - p[0], y - p[1]), p[2])
        if source.beam.relative_intensity(np.array([theta]))[0] > 2e-8:
            assert lit >> cell_of(u, v) & 1
    assert lit_cells(row_of(wide(Rectangle(2.0, 1.0), BEAMS["even"]))[0], 0, cells, p) == -1
