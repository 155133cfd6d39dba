"""What the library calls by its parameters, the command calls by its options."""

from pathlib import Path

import pytest

from radwrap.cli.spelling import spell
from radwrap.errors import EnvironmentFailure, InputError, RadwrapError
from radwrap.imaging.render_options import RenderOptions
from tests.cli.conftest import here

BENCH = Path(__file__).parents[2] / "rad_scenes/bench_board/scene.toml"
OPTIONS = {"tolerance": "--tolerance", "max_pixels": "--max-pixels", "budget": "--budget", "povray": "--povray"}


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (InputError("must be a number", where="tolerance"), "--tolerance: must be a number"),
        (InputError("must be a number", where="budget_seconds"), "--budget: must be a number"),
        (InputError("must be a number", where="angle"), "angle: must be a number"),
        (InputError("is damaged", where="tolerance.png: row=1"), "tolerance.png: row=1: is damaged"),
        (InputError("large", remedy="raise `max_pixels`"), "large; raise --max-pixels"),
        (InputError("more than `max_pixels=64`", remedy="see `angle=1`"), "more than --max-pixels 64; see `angle=1`"),
        (InputError("no", remedy='say `tolerance=True` or `povray="x y"`'), "no; say --tolerance or --povray x y"),
        (EnvironmentFailure("failed", where="povray"), "povray: failed"),
        (EnvironmentFailure("failed", where="povray=/a b/c"), "--povray /a b/c: failed"),
    ],
    ids=str,
)
def test_parameters_become_options(error: RadwrapError, told: str) -> None:
    spell(error, OPTIONS)
    assert str(error) == told


def test_one_fault_has_the_words_of_who_made_it(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InputError) as refused:
        RenderOptions(method="kernel", viewpoints=7)
    assert str(refused.value) == 'viewpoints: there are no sub-viewpoints with `method="kernel"`; leave it out'
    told = here(["render", BENCH, "--dry-run", "--method", "kernel", "--viewpoints", 7], capsys).refusal(2)
    assert "--viewpoints: there are no sub-viewpoints with --method kernel; leave it out" in told
