"""One tracer for all runs of a study, decided once."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Final

import pytest

from radwrap.imaging import tracer_choice
from radwrap.study.design import read_design
from radwrap.study.journal import read_table
from radwrap.study.one_tracer import one_tracer
from radwrap.study.runs import runs_of
from tests.cli.conftest import here
from tests.study.conftest import TINY_SMALL, DesignWriter

# Two runs.
TWO: Final = """
analysis = "none"
set = { "camera.sensor.rows" = 20, "camera.sensor.columns" = 24 }
render.tolerance = 1.0
[design]
kind = "full"
[factors.x]
key = "targets[0].edge_position"
levels = ["1 mm", "2 mm"]
"""
# Radiance answers in float32: of gray levels up to 255, and of pixels.
SAME: Final = 1e-3


def test_it_is_the_one_that_the_scene_asks_for(design: DesignWriter, monkeypatch: pytest.MonkeyPatch) -> None:
    told = read_design(design(TINY_SMALL))
    runs = runs_of(told)
    assert one_tracer(told, runs, {}) == "radiance"  # a few hundred pixels
    assert one_tracer(told, runs, {"tracer": "compiled"}) == "compiled"
    monkeypatch.setattr(tracer_choice, "WORTH_COMPILED", 1)
    assert one_tracer(told, runs, {}) == "compiled"
    assert one_tracer(told, runs, {"tracer": "radiance"}) == "radiance"


def test_a_run_that_only_radiance_can_show_decides_for_all(
    design: DesignWriter, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tracer_choice, "WORTH_COMPILED", 1)
    told = read_design(design(TINY_SMALL))
    runs = runs_of(told)
    for more in (
        {"materials": {"pane": {"type": "glass", "transmittance": 0.9, "refractive_index": 1.5}}},
        {"materials": {"pane": {"type": "mirror", "reflectance": 0.9}}},
        {"targets": [{"name": "room", "rad": "room.rad", "length_unit": "1 mm"}]},
    ):
        other = replace(runs[1], document={**runs[1].document, **more})
        assert one_tracer(told, [runs[0], other], {}) == "radiance"
    # What is wrong in a run's own file the run itself says.
    broken = replace(runs[1], document={**runs[1].document, "materials": 3, "targets": None})
    assert one_tracer(told, [runs[0], broken], {}) == "compiled"


@pytest.mark.long
@pytest.mark.usefixtures("one_process")
def test_both_tracers_give_the_same_table(design: DesignWriter, capsys: pytest.CaptureFixture[str]) -> None:
    """The plan says who traced; who is asked for later must be the same, or nobody."""
    path, tables = design(TWO), []
    for name in ("radiance", "compiled"):
        out = path.parent / name
        here(["study", "run", path, "--out", out, "--no-report", "--tracer", name], capsys).success()
        assert json.loads((out / "plan.json").read_bytes())["tracer"] == name
        tables.append(read_table(out / "results.csv").rows)
    for first, second in zip(*tables, strict=True):
        assert first.keys() == second.keys() and not first["error"]
        for column in ("u [px]", "mean"):
            assert float(first[column]) == pytest.approx(float(second[column]), abs=SAME)
    out = path.parent / "compiled"
    here(["study", "run", path, "--out", out, "--no-report"], capsys).success()  # auto: as it was begun
    other = here(["study", "run", path, "--out", out, "--no-report", "--tracer", "radiance"], capsys)
    assert other.code == 2 and "holds another study" in other.stderr
