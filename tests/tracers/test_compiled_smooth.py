"""Blocks that are proved smooth hold one face in full light, whatever small thing lies between their rays."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("numba")

from radwrap.imaging.optics.smooth import BLOCK
from radwrap.imaging.optics.view import central_rays
from radwrap.scene.materials import Lambertian
from radwrap.tracers.compiled.layout import compiled_scene
from radwrap.tracers.compiled.tracer import CompiledTracer
from radwrap.tracers.engine import BlockLight
from radwrap.tracers.text_frame import TextFrame
from tests.tracers.belt import FLAT, at, block_of, lattice, light_in, proved, scene_of


def test_an_empty_belt_is_smooth_everywhere() -> None:
    assert proved(scene_of()).all()


def test_some_blocks_are_found_as_among_all() -> None:
    ball = {"type": "sphere", "name": "ball", "material": "dark", "position": at(2.6, 1.6, 1), "diameter": "1 mm"}
    scene = scene_of(ball)
    found = proved(scene)
    assert found.any() and not found.all()
    some = np.random.default_rng(7).random(found.shape) < 0.3
    some[block_of(2.6, 1.6)] = True
    assert ((light_in(scene, some) == BlockLight.PROVED) == (found & some)).all()
    assert not light_in(scene, np.zeros_like(some)).any()


@pytest.mark.parametrize(
    "thing",
    [
        # Thinner than a pixel, and between all rays of the lattice.
        {
            "type": "cylinder",
            "material": "dark",
            "position": at(2.6, 1.6, 1),
            "diameter": "0.04 mm",
            "length": "0.3 mm",
        },
        {"type": "sphere", "material": "dark", "position": at(2.6, 1.6, 1), "diameter": "0.06 mm"},
        # Of the belt's own material, all but in its plane, and smaller than a block.
        {"type": "sheet", "material": "belt", "size": ["0.3 mm", "0.3 mm"], "position": at(2.6, 1.6, 0.01)},
        {"type": "sheet", "material": "dark", "size": ["0.3 mm", "0.3 mm"], "position": at(2.6, 1.6, 0.02)},
    ],
)
def test_a_block_with_something_small_in_it_is_not_smooth(thing: dict[str, Any]) -> None:
    found = proved(scene_of({"name": "thing", **thing}))
    assert not found[block_of(2.6, 1.6)]
    assert found.mean() > 0.5


def test_a_block_with_a_thin_shadow_in_it_is_not_smooth() -> None:
    """A wire far above: what it shades is seen beside it, in twelve lines of a fifth of a pixel."""
    wire = {"type": "cylinder", "name": "wire", "material": "dark", "position": at(-1, -4.35, 40)}
    scene = scene_of({**wire, "rotation": ["0 deg", "90 deg", "0 deg"], "diameter": "0.04 mm", "length": "2 mm"})
    found = proved(scene)
    for emitter in scene.emitters:
        x, y, z = (1e3 * value for value in emitter.position)
        t = z / (z - 40)
        row, column = block_of(x + t * (0 - x), y + t * (-4.35 - y))
        if 0 <= row < found.shape[0] and 0 <= column < found.shape[1]:
            assert not found[row, column]
    assert found.any()


@pytest.mark.parametrize(
    ("target", "why"),
    [
        ({"type": "sheet", "material": "polished", "size": ["100 mm", "100 mm"]}, "its highlight may be small"),
        (
            {
                "type": "polygon",
                "material": "belt",
                "vertices": [["-40 mm", "-40 mm"], ["40 mm", "-40 mm"], ["40 mm", "40 mm"], ["0.1 mm", "0.1 mm"]],
            },
            "it has a notch",
        ),
    ],
)
def test_faces_of_which_nothing_is_proved(target: dict[str, Any], why: str) -> None:
    found = proved(scene_of({"name": "top", "position": at(0, 0, 1), **target}))
    assert not found[block_of(5, -5)], why


def test_a_broad_lobe_under_lights_far_away_is_as_good_as_its_middle_says() -> None:
    """No place of a block is farther from straight lines between its corners than three times the middle, and noise."""
    scene = scene_of(
        {"type": "sheet", "name": "top", "material": "shiny", "size": ["30 mm", "30 mm"]} | {"position": at(0, 0, 1)}
    )
    found = proved(scene)
    assert found.all()
    tracer = CompiledTracer(compiled_scene(scene, TextFrame()))
    at_corners, at_middles = (next(tracer.trace([rays.reshape(-1, 6)])) for rays in lattice(scene))
    corner = at_corners.reshape(found.shape[0] + 1, -1)
    four = np.stack([corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]])
    middle = np.abs(at_middles.reshape(found.shape) - four.mean(axis=0))
    row, column = np.indices(found.shape)
    for down in np.linspace(0.1, 0.9, 5):
        for right in np.linspace(0.1, 0.9, 5):
            u, v = (BLOCK * (axis + share) - 0.5 for axis, share in ((column, right), (row, down)))
            seen = next(tracer.trace([central_rays(scene.camera, u.ravel(), v.ravel())])).reshape(found.shape)
            weights = np.array([(1 - down) * (1 - right), (1 - down) * right, down * (1 - right), down * right])
            off = np.abs(seen - np.tensordot(weights, four, axes=1))
            assert (off <= 3 * middle + 2e-4 * corner.max()).all()


def test_a_lobe_is_not_smooth_under_a_light_nearby() -> None:
    led = {
        "type": "led",
        "name": "led",
        "position": at(2, 2, 6),
        "look_at": at(2, 2, 0),
        "diameter": "0.1 mm",
        "radiant_intensity": "0.2 W/sr",
        "beam": {"profile": "lambertian"},
    }
    top = {"type": "sheet", "name": "top", "material": "shiny", "size": ["30 mm", "30 mm"], "position": at(0, 0, 1)}
    assert not proved(scene_of(top, sources=[*FLAT["sources"], led])).any()


def test_dots_between_the_rays_of_a_block() -> None:
    board = {
        "type": "board",
        "name": "board",
        "material": "belt",
        "dot_material": "dark",
        "rows": 5,
        "columns": 5,
        "pitch": "4 mm",
        "dot_diameter": "0.3 mm",
        "position": at(0.7, 0.6, 2),
    }
    scene = scene_of(board)
    found = proved(scene)
    t = 400 / 398  # seen on the belt's plane
    for row in range(-2, 3):
        for column in range(-2, 3):
            assert not found[block_of(t * (0.7 + 4 * column), t * (0.6 + 4 * row))]
    assert found.mean() > 0.5


def test_a_block_with_a_light_before_it_is_not_smooth() -> None:
    led = {
        "type": "led",
        "name": "led",
        "position": at(2.6 / 20, 1.6 / 20, 380),
        "look_at": at(0, 0, 500),
        "diameter": "0.002 mm",
        "radiant_intensity": "0.2 W/sr",
        "beam": {"profile": "lambertian"},
    }
    found = proved(scene_of(sources=[*FLAT["sources"], led]))
    assert not found[block_of(2.6, 1.6)]
    assert found.mean() > 0.5


def test_a_cone_of_light_ends_at_once() -> None:
    ring = {**FLAT["sources"][0], "beam": {"profile": "cone", "width": "10 deg", "width_definition": "fwhm"}}
    assert not proved(scene_of(sources=[ring])).any()


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"position": at(3, 20, 30), "look_at": at(20, 20, 30)}, "a Gaussian ends at a right angle"),
        ({"position": at(3, 2, 4), "look_at": at(3, 2, 0), "diameter": "0.05 mm"}, "it is as near as a block is wide"),
        ({"position": at(3, 2, 300), "look_at": at(3, 2, 0), "width": 0.2}, "its beam is as narrow as a block"),
    ],
)
def test_a_beam_that_changes_over_a_block_proves_nothing(changes: dict[str, Any], why: str) -> None:
    width = f"{changes.pop('width', 120)} deg"
    led = {"type": "led", "name": "led", "diameter": "1 mm", "radiant_intensity": "0.2 W/sr"}
    led |= {"beam": {"profile": "gaussian", "width": width, "width_definition": "fwhm"}, **changes}
    assert not proved(scene_of(sources=[led]))[block_of(3, 2)], why


@pytest.mark.parametrize("seed", range(6))
def test_what_is_proved_is_so(seed: int) -> None:
    """All over the blocks, in random crowds: radiance is that of the bare face, with nothing else in the world."""
    random = np.random.default_rng(seed)
    kinds: list[dict[str, Any]] = []
    for number in range(12):
        place, size = random.uniform(-11, 11, 2), 10 ** random.uniform(-1.5, 0.6)
        height = float(10 ** random.uniform(-1, 1.5))
        material = str(random.choice(["belt", "dark", "shiny"]))
        common = {"name": f"t{number}", "material": material}
        angle = [f"{value} deg" for value in random.uniform(-60, 60, 3)]
        kind = number % 4
        if kind == 0:
            kinds.append({**common, "type": "sphere", "position": at(*place, height), "diameter": f"{size} mm"})
        elif kind == 1:
            kinds.append(
                {
                    **common,
                    "type": "sheet",
                    "size": [f"{size} mm", f"{2 * size} mm"],
                    "position": at(*place, height),
                    "rotation": angle,
                }
            )
        elif kind == 2:
            kinds.append(
                {
                    **common,
                    "type": "cylinder",
                    "position": at(*place, height),
                    "rotation": angle,
                    "diameter": f"{size / 5} mm",
                    "length": f"{size} mm",
                }
            )
        else:
            kinds.append({**common, "type": "box", "size": [f"{size} mm"] * 3, "position": at(*place, height)})
    scene = scene_of(*kinds)
    found = proved(scene)
    assert 0.02 < found.mean() < 0.98
    bare = replace(scene, targets=scene.targets[:1])
    row, column = (np.repeat(axis, 40) for axis in np.nonzero(found))
    u, v = (BLOCK * (axis + random.random(len(axis))) - 0.5 for axis in (column, row))
    rays = central_rays(scene.camera, u, v)
    seen, alone = (next(CompiledTracer(compiled_scene(s, TextFrame())).trace([rays])) for s in (scene, bare))
    on_belt = seen == alone
    # Blocks of a sheet or box of their own are smooth too: there the light of the bare sheet is not known here.
    others = np.unique(np.stack([row, column], axis=1)[~on_belt], axis=0)
    for r, c in others:
        inside = (row == r) & (column == c)
        assert not on_belt[inside].any()
        assert seen[inside].std() < 0.02 * seen[inside].mean()
    assert on_belt.mean() > 0.5


def test_nothing_at_all_is_smooth_too() -> None:
    found = proved(replace(scene_of(), targets=()))
    assert found.all()
    assert isinstance(scene_of().materials["belt"], Lambertian)
