"""Options are checked where they are given: what is none is told, what NumPy calls a number is one."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.imaging.render_options import RenderOptions
from radwrap.manifest import json_text, plain

WRONG: list[tuple[str, Any]] = [
    ("method", "viewpoint"),
    ("method", "fast"),
    ("layout", "spiral"),
    ("pixel_sampling", "jiter"),
    ("bounces", "some"),
    ("bounces", -1),
    ("bounces", 1.5),
    ("viewpoints", 7.5),
    ("viewpoints", "7"),
    ("viewpoints", True),
    ("viewpoints", 0),
    ("seed", -1),
    ("seed", None),
    ("seed", np.float64("nan")),
    ("tolerance", "2"),
    ("tolerance", 10**5000),
    ("viewpoints", -(10**5000)),
    ("tolerance", 2 + 0j),
    ("tolerance", np.array([2.0])),
    ("tolerance", float("nan")),
    ("workers", 4096),
    ("frames", 1e300),
    ("keep_viewpoints", "no"),
    ("trust", 1),
]


@pytest.mark.parametrize(
    ("name", "value"), WRONG, ids=lambda value: str(value)[:9] if not isinstance(value, int) else "int"
)
def test_what_is_no_value_of_an_option_is_told(name: str, value: Any) -> None:
    with pytest.raises(InputError) as caught:
        RenderOptions(**{name: value})
    assert caught.value.where == name


def test_numbers_of_numpy_are_numbers() -> None:
    given = RenderOptions(
        seed=np.int64(3),
        tolerance=np.float32(2),
        bounces=np.uint8(2),
        budget_seconds=np.float64(1.5),
        truth=np.True_,
        max_pixels=64e6,
    )
    same = RenderOptions(seed=3, tolerance=2.0, bounces=2, budget_seconds=1.5, truth=True, max_pixels=64_000_000)
    assert json_text(plain(given)) == json_text(plain(same))


@pytest.mark.parametrize("change", [{"frames": 3}, {"basis": True}, {"keep_viewpoints": True}], ids=str)
def test_files_that_would_be_lost_are_not_made(change: dict[str, Any]) -> None:
    folder = Path(radwrap.__file__).parents[1] / "rad_scenes" / "bench_board"
    with pytest.raises(InputError, match="would be lost"):
        radwrap.render(radwrap.load_scene(folder / "scene.toml"), **change)


def test_what_bounces_may_be_besides_a_word_is_told() -> None:
    with pytest.raises(InputError, match='must be one of "all", "auto" or a whole number, not \'foo\''):
        RenderOptions(bounces="foo")  # type: ignore[arg-type]
