"""Parts that cross, hold or miss each other; where they do is known by the sizes of the block."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

import pytest

from radwrap.dataset.collisions import Body, Standing, body_of
from radwrap.dataset.document import read_dataset
from radwrap.dataset.drawn import drawn_image
from radwrap.dataset.one_image import draw_standing
from radwrap.errors import EnvironmentFailure, InputError
from radwrap.scene.file.load import load_scene
from radwrap.scene.mesh import mesh_of
from radwrap.scene.targets import MeshPart
from tests.dataset.conftest import Write


@pytest.fixture
def block(dataset_file: Write) -> MeshPart:
    """12 x 8 x 6 mm about its origin."""
    scene = load_scene(dataset_file("images = 1").parent / "scene.toml")
    return next(target for target in scene.targets if isinstance(target, MeshPart))


def table(name: str, x: float, turn: float = 0.0) -> dict[str, Any]:
    return {"name": name, "position": [f"{x} mm", "0 mm", "0 mm"], "rotation": ["0 deg", "0 deg", f"{turn} deg"]}


def stands(bodies: dict[str, Body], *others: tuple[dict[str, Any], str]) -> list[bool]:
    standing = Standing(bodies)
    return [standing.place(*one) for one in others]


def test_blocks_cross_where_their_sizes_say(block: MeshPart) -> None:
    bodies = {"block": body_of(block)}
    first = table("a", 0), "block"
    assert stands(bodies, first, (table("b", 11.9), "block")) == [True, False]
    assert stands(bodies, first, (table("b", 12.1), "block")) == [True, True]
    # Turned by 90 degrees it is 8 mm along x: they meet at 6 + 4.
    assert stands(bodies, first, (table("b", 9.9, 90), "block")) == [True, False]
    assert stands(bodies, first, (table("b", 10.1, 90), "block")) == [True, True]
    # One that was refused may be asked for again, and hides nothing of where it was.
    assert stands(bodies, first, (table("b", 5), "block"), (table("b", 13), "block"), (table("c", -13), "block")) == [
        True,
        False,
        True,
        True,
    ]


@pytest.mark.parametrize("small_first", [True, False])
def test_a_part_wholly_inside_another_is_found(block: MeshPart, small_first: bool) -> None:
    """No surfaces cross: FCL sees nothing of it."""
    tiny = replace(block, mesh=mesh_of(block.mesh.vertices / 10, block.mesh.faces))
    bodies = {"large": body_of(block), "small": body_of(tiny)}
    pair = [(table("a", 0), "large"), (table("b", 2), "small")]
    assert stands(bodies, *(pair[::-1] if small_first else pair)) == [True, False]
    assert stands(bodies, pair[0], (table("b", 7), "small")) == [True, True]


def test_an_open_mesh_is_taken_for_its_box(block: MeshPart) -> None:
    open_part = replace(block, mesh=mesh_of(block.mesh.vertices, block.mesh.faces[:10]), closed=False)
    body = body_of(open_part)
    assert body.is_box and body.solid.is_watertight and body.solid.volume == pytest.approx(12 * 8 * 6)
    tiny = replace(block, mesh=mesh_of(block.mesh.vertices / 10, block.mesh.faces))
    bodies = {"large": body, "small": body_of(tiny)}
    assert stands(bodies, (table("a", 0), "large"), (table("b", 2), "small")) == [True, False]


def test_drawn_parts_stand_free_and_too_many_are_an_error(dataset_file: Write, block: MeshPart) -> None:
    text = 'images = 1\n[[parts]]\ntarget = "block"\ncount = {}\nx = ["-15 mm", "15 mm"]\ny = ["-15 mm", "15 mm"]'
    dataset = read_dataset(dataset_file(text.format(3)))
    bodies = {"block": body_of(block)}
    tables = [draw_standing(dataset, number)[0].document["targets"][1:] for number in range(4)]
    assert all(all(stands(bodies, *((one, "block") for one in image))) for image in tables)
    careless = [drawn_image(dataset, number).document["targets"][1:] for number in range(4)]
    assert not all(all(stands(bodies, *((one, "block") for one in image))) for image in careless)
    with pytest.raises(InputError, match="found no place in 1000 tries"):
        draw_standing(read_dataset(dataset_file('images = 1\n[[parts]]\ntarget = "block"\ncount = 2')), 0)


def test_without_the_library_it_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "fcl", None)
    with pytest.raises(EnvironmentFailure, match="parts that must not overlap: fcl is not installed") as told:
        Standing({})
    assert told.value.remedy == 'pip install "radwrap[dataset]"'
