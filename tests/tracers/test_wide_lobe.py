"""Gaussian lobes before wide lights, against quadrature over the light, and in a white furnace."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba")

from radwrap.frames import Pose, aim
from radwrap.scene.materials import (
    Anisotropic,
    CoefficientTable,
    GlassBeads,
    Lambertian,
    Material,
    MeasuredBrdf,
    PerturbedNormal,
    Specular,
)
from radwrap.scene.sources import WideSource
from radwrap.scene.targets import Sheet
from radwrap.scene.wide_shapes import Annulus, Rectangle, area
from radwrap.tracers.compiled.arrays import Cover, Floats
from radwrap.tracers.compiled.compiler import compiled
from radwrap.tracers.compiled.cover_rows import Wardrobe
from radwrap.tracers.compiled.covers import reflected
from radwrap.tracers.compiled.tree import DEPTH
from radwrap.tracers.compiled.wide_contour import Place
from radwrap.tracers.compiled.wide_lobe import Grain, grain_of, lobe_density, mirrored, sampled_lobe
from radwrap.tracers.compiled.wide_nodes import nodes_along, whole_lobe
from radwrap.tracers.compiled.wide_points import key_of_ray, spread_point
from radwrap.tracers.compiled.wide_rows import wide_row
from radwrap.tracers.compiled.wide_shape import meets
from tests.tracers.test_wide_light import FRAME, LIGHTS, SURE, area_points, sheets, wide

UP = (0.0, 0.0, 1.0)
TO_LIGHT = (0.25, 0.15, math.sqrt(1 - 0.085))  # of a retroreflector
KEYS = 4000
SLANTED = (-0.3, 0.2, math.sqrt(1 - 0.13))
GLOSSY: dict[str, Material] = {
    "sharp": Specular(0.1, 0.2, 0.02),
    "middle": Specular(0.1, 0.2, 0.1),
    "broad": Specular(0.1, 0.2, 0.3),
    "brushed": Anisotropic(0.1, 0.2, 0.05, 0.3),
}
ANGLES = tuple(np.radians([0.0, 10.0, 20.0, 35.0, 50.0, 65.0, 80.0, 90.0]).tolist())
HEIGHTS = (2.0, 0.5, 0.2, 0.1, 0.5, 0.1, 0.05)
TURNS = tuple(np.radians([0.0, 45.0, 90.0, 135.0, 150.0, 165.0, 180.0]).tolist())
BRDF_VALUES = tuple(
    0.05 + 0.2 * math.exp(-((a - b) ** 2 + 0.5 * (math.pi - c) ** 2) / 0.2)
    for a in ANGLES
    for b in ANGLES
    for c in TURNS
)
OTHERS: dict[str, Material] = {
    "retro_sharp": PerturbedNormal(0.6, 0.02),
    "retro": PerturbedNormal(0.6, 0.1),
    "retro_broad": PerturbedNormal(0.6, 0.3),
    "beads": GlassBeads(30.0, "hold"),
    "table": CoefficientTable(
        tuple(np.radians([0.2, 0.5, 1.0, 2.0, 5.0]).tolist()),
        tuple(np.radians([0.0, 20.0, 40.0]).tolist()),
        ((60.0, 50.0, 30.0), (40.0, 30.0, 20.0), (12.0, 10.0, 6.0), (3.0, 2.0, 1.0), (0.5, 0.4, 0.2)),
        "log",
        "hold",
    ),
    "brdf": MeasuredBrdf("x", ANGLES, ANGLES, TURNS, BRDF_VALUES),
}
# As measured tables are: straight over steps within which a lobe falls to a fifth.
COARSE = CoefficientTable(
    tuple(np.radians([0.1, 0.5, 2.0, 10.0, 85.0]).tolist()),
    tuple(np.radians([0.0, 30.0, 60.0, 85.0]).tolist()),
    (
        (500.0, 300.0, 100.0, 20.0),
        (300.0, 200.0, 60.0, 15.0),
        (60.0, 50.0, 20.0, 5.0),
        (5.0, 4.0, 2.0, 1.0),
        (0.2, 0.1, 0.1, 0.05),
    ),
    "linear",
    "hold",
)
STEPS = tuple(np.radians([0.0, 24.0, 30.0, 90.0]).tolist())
BENT = MeasuredBrdf(
    "x",
    STEPS,
    STEPS,
    TURNS,
    tuple(a * b * c for a in (1.0, 3.0, 0.5, 0.1) for b in (1.0, 2.0, 3.0, 1.0) for c in HEIGHTS),
)
ALL = {**GLOSSY, **OTHERS}
BENDING = {**{name: OTHERS[name] for name in ("table", "beads", "brdf")}, "coarse": COARSE, "bent": BENT}


def cover_and_tables(material: Material) -> tuple[np.void, Floats]:
    tables: list[float] = []
    wardrobe = Wardrobe({"m": material}, FRAME, tables)
    list(wardrobe.pieces(Sheet("s", Pose(), "m", 2.0, 2.0)))
    return wardrobe.covers[0], np.array([*tables, 0.0])


def cover_of(material: Material) -> np.void:
    return cover_and_tables(material)[0]


def shines(name: str, material: Material, v: tuple[float, float, float], *, keys: int = KEYS) -> np.ndarray:
    """Radiances that a lobe sends to the eye by many keys, with nothing between."""
    light, none, (cover, tables) = wide_row(wide(name), FRAME)[0], sheets(()), cover_and_tables(material)
    stack, rest = np.empty(DEPTH, dtype=np.int64), (tables, (0.0, 0.0, 0.0), UP, v, -1, 0)
    found = [key_of_ray(float(k), 0.0, 0.0, 0.0, 0.0, 1.0, 0) for k in range(keys)]
    return np.array([sampled_lobe(light, cover, *none, *none, *rest, 0, key, stack) for key in found])


@compiled
def lobes(cover: Cover, tables: Floats, v: Place, directions: Floats, found: Floats) -> None:
    """What a lobe of a face upwards adds for light from each direction."""
    n = UP
    for i in range(len(directions)):
        d = directions[i]
        found[i] = reflected(cover, tables, 0.0, n[0], n[1], n[2], v[0], v[1], v[2], d[0], d[1], d[2], 0.0)


@compiled
def lobe_densities(grain: Grain, n: Place, v: Place, directions: Floats, found: Floats) -> None:
    """Density of what is drawn at each direction."""
    for i in range(len(directions)):
        d = directions[i]
        found[i] = lobe_density(grain, n, v, (d[0], d[1], d[2]))


def brute(name: str, material: Material, v: Place) -> float:
    return at_even_points(wide(name), material, v)


def at_even_points(source: WideSource, material: Material, v: Place) -> float:
    """By 2^18 points of the light."""
    cover, tables = cover_and_tables(material)
    points, normals = area_points(source.shape, 1 << 18)
    turned = np.asarray(source.pose.rotation).T
    points, normals = points @ turned + source.pose.position, normals @ turned
    away = np.linalg.norm(points, axis=1)
    leaving = np.maximum(-(points * normals).sum(axis=1) / away, 0.0)
    each = np.empty(len(points))
    lobes(cover, tables, v, points / away[:, np.newaxis], each)
    return float(source.radiance * area(source.shape) * np.mean(each * leaving / away**2))


# Each light and each material with every second of the others; the rest is long.
@pytest.mark.parametrize(
    ("name", "material"),
    [
        pytest.param(name, material, marks=[pytest.mark.long] if (i + j) % 3 else [])
        for i, name in enumerate(LIGHTS)
        for j, material in enumerate(ALL)
    ],
)
def test_lobe_against_quadrature(name: str, material: str) -> None:
    v = SLANTED if material in GLOSSY or name == "dome" else TO_LIGHT
    values = shines(name, ALL[material], v)
    due, error = brute(name, ALL[material], v), values.std() / math.sqrt(KEYS)
    largest = max(0.2 * wide(name).radiance, due)
    assert error < 2e-3 * largest
    assert values.mean() == pytest.approx(due, abs=SURE * error + 1e-3 * due)


@pytest.mark.parametrize("material", ["broad", "middle"])
@pytest.mark.parametrize("name", LIGHTS)
def test_broad_lobe_by_nodes(name: str, material: str) -> None:
    light, cover, p = wide_row(wide(name), FRAME)[0], cover_of(GLOSSY[material]), (0.0, 0.0, 0.0)
    for v in (SLANTED, (0.6, -0.3, math.sqrt(1 - 0.45)), UP):
        first, second = nodes_along(light, cover, np.zeros(1), p, UP, v)
        if material == "broad" and v != (0.6, -0.3, math.sqrt(1 - 0.45)):
            assert first >= 4
            assert second >= 4
        if first:
            found = whole_lobe(light, cover, np.zeros(1), p, UP, v, first, second)
            assert found == pytest.approx(brute(name, GLOSSY[material], v), rel=1e-4, abs=1e-5)


@pytest.mark.parametrize(
    ("material", "width", "aside"),
    [(Specular(0.1, 0.2, 0.1), 0.4, 0.6), (Specular(0.1, 0.2, 0.2), 0.4, 1.2), (PerturbedNormal(0.6, 0.1), 0.4, 0.4)],
)
def test_the_foot_of_a_lobe_by_nodes(material: Material, width: float, aside: float) -> None:
    # Three standard deviations aside a lobe changes several times its own height across a light.
    toward = (-0.3, 0.2, math.sqrt(1 - 0.13))
    source = replace(wide("dome"), shape=Rectangle(width, 0.9 * width), pose=aim(toward, (0.0, 0.0, 0.0)))
    peak = np.array(toward) * ((1, 1, 1) if isinstance(material, PerturbedNormal) else (-1, -1, 1))
    across = np.array([-peak[2], 0.0, peak[0]]) / math.hypot(peak[2], peak[0])
    x, y, z = (math.cos(aside) * peak + math.sin(aside) * across).tolist()
    light, (cover, tables) = wide_row(source, FRAME)[0], cover_and_tables(material)
    nodes = nodes_along(light, cover, tables, (0.0, 0.0, 0.0), UP, (x, y, z))
    assert nodes != (0, 0)
    found = whole_lobe(light, cover, tables, (0.0, 0.0, 0.0), UP, (x, y, z), *nodes)
    assert found == pytest.approx(at_even_points(source, material, (x, y, z)), rel=3e-4)


def test_a_narrow_lobe_is_not_left_to_nodes() -> None:
    light, tables = wide_row(wide("dome"), FRAME)[0], np.zeros(1)
    assert nodes_along(light, cover_of(GLOSSY["sharp"]), tables, (0.0, 0.0, 0.0), UP, UP) == (0, 0)
    assert nodes_along(light, cover_of(GLOSSY["broad"]), tables, (0.0, 0.0, 0.05), UP, UP) != (0, 0)
    assert nodes_along(light, cover_of(GLOSSY["broad"]), tables, (0.0, 0.95, 0.05), UP, UP) == (0, 0)  # too near


def in_the_open(source: WideSource, material: Material, v: Place, keys: int = 400) -> tuple[float, float]:
    """What a face upwards sends to the eye as the tracer has it, by nodes or samples, and its standard error."""
    light, none, (cover, tables) = wide_row(source, FRAME)[0], sheets(()), cover_and_tables(material)
    p, stack = (0.0, 0.0, 0.0), np.empty(DEPTH, dtype=np.int64)
    if (nodes := nodes_along(light, cover, tables, p, UP, v)) != (0, 0):
        return whole_lobe(light, cover, tables, p, UP, v, *nodes), 0.0
    found = [key_of_ray(float(k), 0.0, 0.0, 0.0, 0.0, 1.0, 0) for k in range(keys)]
    values = [sampled_lobe(light, cover, *none, *none, tables, p, UP, v, -1, 0, 0, key, stack) for key in found]
    return float(np.mean(values)), float(np.std(values)) / math.sqrt(keys)


@pytest.mark.parametrize("material", ["table", "coarse", "beads", "brdf", "bent"])
def test_a_table_that_bends_within_a_small_light(material: str) -> None:
    """Nodes as far apart as those of the table were off by up to 2 per cent where it bends, and without any noise."""
    by_nodes = 0
    for seed in range(12):
        random = np.random.default_rng([5, seed])
        size, turn = 0.003 * 2 ** random.uniform(0, 5), random.uniform(0, 2 * math.pi)
        shape = Rectangle(size, size / 3) if seed % 2 else Annulus(size / 8, size / 2)
        to = np.array([0.4 * math.cos(turn), 0.4 * math.sin(turn), math.sqrt(0.84)])
        source = replace(wide("bar"), shape=shape, pose=aim(tuple(to.tolist()), (0.1, 0.0, 0.0)))
        v = to + random.normal(size=3) * 10 ** random.uniform(-3, -1)
        eye = tuple((v / np.linalg.norm(v)).tolist())
        found, error = in_the_open(source, BENDING[material], eye)
        by_nodes += error == 0
        due = at_even_points(source, BENDING[material], eye)
        assert error < 5e-3 * due
        assert found == pytest.approx(due, abs=SURE * error, rel=2e-4), seed
    assert 0 < by_nodes < 12


@pytest.mark.parametrize("material", ["middle", "broad", "retro_sharp", "retro", "retro_broad"])
def test_nodes_leave_nothing_out(material: str) -> None:
    """One node for each standard deviation of a lobe missed a thousandth of its light, and no noise showed it."""
    cover, by_nodes = GLOSSY.get(material) or OTHERS[material], 0
    assert isinstance(cover, Specular | PerturbedNormal)
    roughness = cover.roughness
    for seed in range(24):
        random = np.random.default_rng([6, seed])
        size, turn = min(roughness * 2 ** random.uniform(0, 4.3), 1.5), random.uniform(0, 2 * math.pi)
        shape = Rectangle(size, size * random.uniform(0.2, 1)) if seed % 3 else Annulus(size / 5, size / 2)
        to = np.array([0.4 * math.cos(turn), 0.4 * math.sin(turn), math.sqrt(0.84)])
        source = replace(wide("bar"), shape=shape, pose=aim(tuple(to.tolist()), (0.1, 0.0, 0.0)))
        seen = to * (1, 1, 1) if material in OTHERS else to * (-1, -1, 1)
        v = seen + random.normal(size=3) * roughness * 2 ** random.uniform(-2, 1.5)
        eye, best = tuple((v / np.linalg.norm(v)).tolist()), tuple(seen.tolist())
        light, (row, tables) = wide_row(source, FRAME)[0], cover_and_tables(cover)
        if (nodes := nodes_along(light, row, tables, (0.0, 0.0, 0.0), UP, eye)) == (0, 0):
            continue
        by_nodes += 1
        found = whole_lobe(light, row, tables, (0.0, 0.0, 0.0), UP, eye, *nodes)
        due, peak = at_even_points(source, cover, eye), at_even_points(source, cover, best)
        assert found == pytest.approx(due, abs=1e-4 * peak), (seed, nodes)
    assert by_nodes > 8


def on_a_wall(v: Place, half: float, height: float, radiance: float) -> float:
    """What a wall with its normal along x sends of a square light below it: Ward's lobe by 10^7 even places."""
    steps = (np.arange(3200) + 0.5) / 3200 * 2 * half - half
    total = 0.0
    for x in steps[steps > 0]:  # below the wall's horizon there is nothing to see
        d = np.stack([np.full(steps.shape, x), steps, np.full(steps.shape, -height)], axis=1)
        square = (d**2).sum(axis=1)
        d /= np.sqrt(square)[:, np.newaxis]
        middle = d + np.array(v)
        length, up = (middle**2).sum(axis=1), middle[:, 0]
        lobe = np.exp(-(length / up**2 - 1) / 0.3**2) / (math.pi * 0.3**2) * length / up**4
        total += float((0.2 * lobe * d[:, 0] * -d[:, 2] / square).sum())
    return radiance * total * (2 * half / 3200) ** 2


@pytest.mark.parametrize("cosine", [0.9, 0.5, 0.2, 0.05, 0.02])
def test_a_wall_above_a_light_at_grazing_eyes(cosine: float) -> None:
    """The lobe's light comes from a band above the horizon, which cuts the light: nodes lost up to four fifths."""
    v, half, height = (cosine, 0.0, math.sqrt(1 - cosine * cosine)), 0.06, 0.042
    source = replace(wide("bar"), shape=Rectangle(2 * half, 2 * half), pose=Pose((0.0, 0.0, -height)))
    light, none, (cover, tables) = wide_row(source, FRAME)[0], sheets(()), cover_and_tables(GLOSSY["broad"])
    p, n, stack = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), np.empty(DEPTH, dtype=np.int64)
    due, error = on_a_wall(v, half, height, source.radiance), 0.0
    if (nodes := nodes_along(light, cover, tables, p, n, v)) != (0, 0):
        found = whole_lobe(light, cover, tables, p, n, v, *nodes)
    else:
        keys = [key_of_ray(float(k), 0.0, 0.0, 0.0, 0.0, 1.0, 0) for k in range(KEYS)]
        rest = (tables, p, n, v, -1, 0)
        values = np.array([sampled_lobe(light, cover, *none, *none, *rest, 0, key, stack) for key in keys])
        found, error = float(values.mean()), float(values.std()) / math.sqrt(KEYS)
        assert error < 5e-3 * due
    assert found == pytest.approx(due, abs=SURE * error + 1e-3 * due)


@pytest.mark.parametrize("material", GLOSSY)
def test_the_density_is_that_of_what_is_drawn(material: str) -> None:
    """It is 1 over all directions, and the mean of any weight over draws is its integral."""
    cover = cover_of(GLOSSY[material])
    grain = grain_of(cover, UP)
    drawn = np.array([mirrored(grain, UP, SLANTED, *spread_point(i, 7)) for i in range(1 << 12)])
    density = np.array([lobe_density(grain, UP, SLANTED, tuple(d)) for d in drawn.tolist()])
    assert (density > 0).mean() > 0.99
    # A cone about the mirror direction holds as many draws as its integral of density says.
    axis = np.array([0.3, -0.2, SLANTED[2]])
    across = np.cross(axis, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    half = 0.3
    u, turn = np.meshgrid((np.arange(800) + 0.5) / 800, (np.arange(400) + 0.5) / 400)
    steep = u * half
    around = np.cos(2 * np.pi * turn)[..., None] * across + np.sin(2 * np.pi * turn)[..., None] * np.cross(axis, across)
    directions = np.cos(steep)[..., None] * axis + np.sin(steep)[..., None] * around
    weights = np.sin(steep) * half * 2 * math.pi / steep.size
    densities = np.empty(steep.size)
    lobe_densities(grain, UP, SLANTED, directions.reshape(-1, 3), densities)
    inside = float(weights.ravel() @ densities)
    share = (drawn @ axis > math.cos(half)).mean()
    assert share == pytest.approx(inside, abs=0.01)


def test_a_sharp_lobe_before_an_even_light_sends_its_reflectance() -> None:
    """Nearly a mirror: L = rho L_light, and next to no noise."""
    values = shines("dome", GLOSSY["sharp"], SLANTED, keys=200)
    assert values.mean() == pytest.approx(0.2 * 2.0, rel=5e-3)
    assert values.std() < 0.02 * values.mean()


def test_a_disc_is_met_in_its_circle_only() -> None:
    light = wide_row(wide("area_ring"), FRAME)[0]
    shape = wide("area_ring").shape
    assert isinstance(shape, Annulus)
    source = wide("area_ring")
    turned = np.asarray(source.pose.rotation)
    for radius, is_met in ((0.19, False), (0.21, True), (0.29, True), (0.31, False)):
        place = turned @ [radius, 0.0, 0.0] + source.pose.position
        away = float(np.linalg.norm(place))
        found, cosine = meets(light, (0.0, 0.0, 0.0), tuple((place / away).tolist()))
        assert math.isfinite(found) == is_met
        if is_met:
            assert found == pytest.approx(away, rel=1e-12)
            assert cosine == pytest.approx(float(-(turned[:, 2] @ place)) / away, rel=1e-12)


def test_only_glossy_covers_have_a_lobe() -> None:
    assert cover_of(Lambertian(0.5))["kind"] == 0
