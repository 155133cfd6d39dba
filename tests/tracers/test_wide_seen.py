"""Wide lights that shine as a whole as rays see them: their true shape, which also hides what is behind it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

pytest.importorskip("numba")

from radwrap.tracers.compiled.layout import CompiledScene, compiled_scene
from radwrap.tracers.compiled.tracer import CompiledTracer
from radwrap.tracers.text_frame import TextFrame
from tests.tracers.belt import at, scene_of

RADIANCE = 7.0
DOWN = {"look_at": at(0, 0, 0), "radiance": f"{RADIANCE} W/m^2/sr", "irradiance_error": 0.2}
DOME = {"type": "dome", "name": "dome", "position": at(0, 0, 20), "diameter": "200 mm", "opening_diameter": "60 mm"}
RING = {
    "type": "area_ring",
    "name": "area",
    "position": at(0, 0, 100),
    "diameter": "80 mm",
    "inner_diameter": "40 mm",
}
BAR = {"type": "rectangle", "name": "bar", "position": at(0, 0, 100), "size": ["60 mm", "20 mm"]}
RELATIVE = 1e-12


def lit_by(*sources: dict[str, Any]) -> CompiledScene:
    return compiled_scene(scene_of(sources=[{**source, **DOWN} for source in sources]), TextFrame(), whole=True)


def seen(scene: CompiledScene, *rays: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Radiances and distances [mm] along rays: places [mm] and directions."""
    block = np.array(rays) * [1e-3, 1e-3, 1e-3, 1, 1, 1]
    values, distances = next(CompiledTracer(scene).trace_with_distances([block]))
    return values, distances * 1e3


@pytest.mark.parametrize("turn", [0.0, 0.7, 2.0, 4.0])
def test_a_dome_is_a_part_of_a_sphere(turn: float) -> None:
    scene, hole = lit_by(DOME), math.asin(30 / 100)
    for angle, is_met in ((hole * 0.999, False), (hole * 1.001, True), (1.0, True), (math.pi / 2 * 0.9999, True)):
        ray = (math.sin(angle) * math.cos(turn), math.sin(angle) * math.sin(turn), math.cos(angle))
        values, distances = seen(scene, (0, 0, 20, *ray))
        assert values[0] == (RADIANCE if is_met else 0.0)
        assert distances[0] == pytest.approx(100 if is_met else math.inf, rel=RELATIVE)


def test_a_dome_is_black_from_outside_and_hides_the_belt() -> None:
    values, distances = seen(lit_by(DOME), (70, 0, 300, 0, 0, -1), (0, 0, 300, 0, 0, -1))
    top = 20 + math.sqrt(100**2 - 70**2)
    assert values[0] == 0 and distances[0] == pytest.approx(300 - top, rel=RELATIVE)
    assert values[1] > 0 and distances[1] == pytest.approx(300, rel=RELATIVE)


@pytest.mark.parametrize(("x", "is_met"), [(19.99, False), (20.01, True), (39.99, True), (40.01, False)])
def test_a_ring_has_round_edges(x: float, is_met: bool) -> None:
    scene = lit_by(RING)
    for turn in (0.0, 0.3, 1.1, 5.0):
        values, distances = seen(scene, (x * math.cos(turn), x * math.sin(turn), 50, 0, 0, 1))
        assert values[0] == (RADIANCE if is_met else 0.0)
        assert distances[0] == pytest.approx(50 if is_met else math.inf, rel=RELATIVE)


def test_a_bar_shines_from_its_front_only() -> None:
    values, distances = seen(lit_by(BAR), (29, 9, 50, 0, 0, 1), (29, 9, 150, 0, 0, -1), (31, 9, 50, 0, 0, 1))
    assert values.tolist() == [RADIANCE, 0, 0]
    assert distances == pytest.approx([50, 50, math.inf], rel=RELATIVE)


def test_a_wide_light_has_the_part_number_of_its_source() -> None:
    scene = lit_by(DOME, BAR)
    rays = np.array([[0.05, 0, 0.02, 0, 0, 1], [0, 0, 0.05, 0, 0, 1], [0, 0, 0.05, 0, 0, -1]])
    numbers = next(CompiledTracer(scene).parts([rays]))
    assert [scene.parts[number - 1] for number in numbers] == ["dome", "bar", "belt.surface"]


def test_lights_in_one_place_shine_as_one() -> None:
    """Neither hides the other, and each can be switched."""
    both = lit_by(BAR, {**BAR, "name": "second"})
    ray = ((5, 0, 300, 0.3, 0, -1), (0, 0, 50, 0, 0, 1))
    alone, together = seen(lit_by(BAR), *ray)[0], seen(both, *ray)[0]
    assert together == pytest.approx(2 * alone, rel=RELATIVE)
    assert seen(both.in_light({"second"}), *ray)[0] == pytest.approx(alone, rel=RELATIVE)
    assert both.whole == ("bar", "second")


def test_a_light_hides_another_but_not_itself() -> None:
    """The bar stands between the ring's middle and the belt: less light than from both."""
    low = {**BAR, "position": at(0, 0, 50)}
    ray = (0, 0, 20, 0.2, 0, -1)
    both = seen(lit_by(RING, low), ray)[0]
    ring, bar = seen(lit_by(RING), ray)[0], seen(lit_by(low), ray)[0]
    assert bar < both < 0.7 * ring + bar
