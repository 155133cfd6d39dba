"""Wide lights behind an edge: their half shadows against quadrature over the part that is not hidden."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest

pytest.importorskip("numba")

from radwrap.frames import Pose, aim
from radwrap.scene.materials import Lambertian
from radwrap.scene.sources import Beam, WideSource
from radwrap.scene.targets import Sheet
from radwrap.scene.wide_shapes import Annulus, Rectangle, WideShape, Zone, area
from radwrap.tracers.compiled.arrays import Tree
from radwrap.tracers.compiled.cover_rows import Wardrobe
from radwrap.tracers.compiled.shape_rows import sorted_shapes
from radwrap.tracers.compiled.tree import DEPTH
from radwrap.tracers.compiled.wide_light import POINTS, kept_back, unhidden
from radwrap.tracers.compiled.wide_points import key_of_ray, spread_point
from radwrap.tracers.compiled.wide_rows import wide_row
from radwrap.tracers.text_frame import TextFrame

FRAME = TextFrame(length=1.0)
UP = (0.0, 0.0, 1.0)
KEYS = 3000
# Of the light: what is asked of half shadows.
HALF_SHADOW = 2e-3
LIGHTS: dict[str, tuple[WideShape, Pose]] = {
    "bar": (Rectangle(0.6, 0.1), aim((0.1, 0.2, 1.0), (0.0, 0.0, 0.0))),
    "disc": (Annulus(0.0, 0.3), aim((0.0, 0.0, 1.0), (0.0, 0.0, 0.0))),
    "area_ring": (Annulus(0.2, 0.3), aim((0.3, 0.0, 1.0), (0.0, 0.0, 0.0))),
    "dome": (Zone(1.0, 0.2, math.pi / 2), aim((0.0, 0.0, 0.05), (0.0, 0.0, 0.0))),
}


def wide(name: str) -> WideSource:
    shape, pose = LIGHTS[name]
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


@pytest.mark.parametrize("x", [-0.1, 0.0, 0.04])
@pytest.mark.parametrize("name", LIGHTS)
def test_half_shadow_behind_an_edge(name: str, x: float) -> None:
    source, edge, height = wide(name), 0.01, 0.3
    light, tree = wide_row(source, FRAME)[0], sheets([Pose((edge + 1.0, 0.0, height))])
    stack, p = np.empty(DEPTH, dtype=np.int64), (x, 0.0, 0.0)
    open_light = unhidden(light, p, UP)
    hidden = [
        kept_back(
            light,
            tree.shapes,
            tree.nodes,
            np.zeros(1),
            p,
            UP,
            -1,
            key_of_ray(float(k), 0.0, 0.0, 0.0, 0.0, 1.0, 0),
            stack,
        )
        for k in range(KEYS)
    ]
    assert open_light - np.mean(hidden) == pytest.approx(brute(source, x, edge, height), abs=HALF_SHADOW * open_light)


@pytest.mark.parametrize("name", LIGHTS)
def test_no_noise_where_nothing_hides(name: str) -> None:
    light, tree = wide_row(wide(name), FRAME)[0], sheets([Pose((0.0, 0.0, -0.5)), Pose((9.0, 0.0, 0.0))])
    stack = np.empty(DEPTH, dtype=np.int64)
    for key in range(50):
        assert kept_back(light, tree.shapes, tree.nodes, np.zeros(1), (0.0, 0.0, 0.0), UP, -1, key, stack) == 0


@pytest.mark.parametrize("key", [0, 1, 0xFFFFFFFF, 123456789])
def test_each_elementary_box_holds_one_point(key: int) -> None:
    points = np.array([spread_point(i, key) for i in range(POINTS)])
    assert points.min() > 0
    assert points.max() < 1
    for cuts in (1, 2, 4, 8, 16):
        boxes = {(int(u * cuts), int(v * (POINTS // cuts))) for u, v in points.tolist()}
        assert len(boxes) == POINTS


def test_keys_give_independent_even_points() -> None:
    first = np.array([spread_point(0, key_of_ray(float(k), 0.5, 2.0, 0.0, 1.0, 0.0, 3)) for k in range(4000)])
    # Means of 4000 even numbers have a standard deviation of 0.0046: five of them.
    assert np.abs(first.mean(axis=0) - 0.5).max() < 0.023
    assert np.abs(np.corrcoef(first.T)[0, 1]) < 0.08
    assert key_of_ray(1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 0) != key_of_ray(1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 1)
    assert key_of_ray(0.1, 2.0, 3.0, 4.0, 5.0, 6.0, 0) == key_of_ray(0.1 + 1e-12, 2.0, 3.0, 4.0, 5.0, 6.0, 0)


def test_other_beams_are_refused() -> None:
    source = WideSource("bar", "rectangle", Pose(), Rectangle(1.0, 1.0), 1.0, Beam("gaussian", 0.3), 0.1, 1)
    with pytest.raises(ValueError, match="Lambertian"):
        wide_row(source, FRAME)
