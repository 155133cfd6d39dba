"""A study of a scene that changes in the course of its exposure: each run is the render of its scene."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any, Final

import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.imaging.demand import SamplingPlan
from radwrap.manifest import read_manifest
from radwrap.measure.edges import measure_edge
from radwrap.study.design import read_design
from radwrap.study.pilots import asked
from radwrap.study.runs import runs_of
from radwrap.study.sampled import sampled
from radwrap.study.study import Made, Study, StudyOptions, plan_steps, run_study
from radwrap.study.table import read_table
from tests.cli.conftest import scene_text
from tests.study.conftest import EDGE, RESPONSES

DESIGN: Final = """
scene = "scene.toml"
analysis = "none"
[render]
tolerance = 6
{render}
[design]
{kind}
[factors.{name}]
key = "{key}"
levels = [{levels}]
"""
SMALL: Final = {"rows": 12, "columns": 60}
SHUTTER: Final = {"shutter": "rolling", "line_time": "1 ms"}
FULL: Final = 'kind = "full"'
pytestmark = pytest.mark.usefixtures("one_process")


def written(
    folder: Path,
    key: str,
    levels: str,
    *,
    kind: str = FULL,
    render: str = "",
    shutter: Mapping[str, str] = SHUTTER,
    **camera: Any,
) -> Path:
    document = deepcopy(EDGE)
    document["camera"] |= {"diffraction": "off", "exposure_time": "100 ms", **camera}
    document["camera"]["sensor"] |= {**shutter, **SMALL}
    document["targets"][0]["velocity"] = ["10 mm/s", "0 mm/s", "0 mm/s"]
    (folder / "scene.toml").write_text(scene_text(document))
    path = folder / "design.toml"
    path.write_text(DESIGN.format(render=render, kind=kind, name="x", key=key, levels=levels) + RESPONSES)
    return path


def carried_out(path: Path) -> Study:
    return run_study(read_design(path), path.parent / "out", StudyOptions(workers=1, tracer="compiled"))


@pytest.mark.long
def test_its_numbers_are_those_of_the_render(tmp_path: Path) -> None:
    """Of a shutter: some rows see the edge where it was, others where it goes."""
    path = written(tmp_path, "camera.sensor.line_time", '"0.1 ms", "2 ms"', kind='kind = "list"\nruns = [["2 ms"]]')
    carried_out(path)
    (row,) = read_table(tmp_path / "out" / "results.csv").rows
    assert row["error"] == "" and row["met"] == "1"
    (made,) = (tmp_path / "out" / "renders").glob("*/manifest.json")
    told = read_manifest(made)
    assert told["in_time"]["instants"] > 1 and not list((tmp_path / "out").glob("pilots/*"))
    scene = radwrap.load_scene(tmp_path / "scene.toml", {"camera.sensor.line_time": "2 ms"})
    image = radwrap.render(scene, tolerance=6, seed=told["seed"], tracer="compiled", workers=1)
    sensor = scene.camera.sensor
    edge = measure_edge(image.gray, gamma=sensor.gamma, dark=sensor.dark_gray)
    assert float(row["mean"]) == pytest.approx(image.gray.values.mean(), abs=1e-9)
    assert float(row["u [px]"]) == pytest.approx(edge.offset, abs=1e-6)


def test_levels_of_what_moves_are_renders_of_their_own(tmp_path: Path) -> None:
    """A basis knows one instant: what else would come from one is rendered."""
    path = written(tmp_path, "sources[0].radiance", ", ".join(f'"{n} kW/m^2/sr"' for n in range(50, 60)))
    for still in (False, True):
        if still:
            (tmp_path / "scene.toml").write_text(scene_text(EDGE))
        design = read_design(path)
        _, made = plan_steps(design, runs_of(design), tmp_path / "out", StudyOptions(workers=1))
        assert made == (Made(0, 1, 10) if still else Made(10, 0, 0))


def test_only_runs_that_stand_still_share_a_plan(tmp_path: Path) -> None:
    speeds = ", ".join(f'["{speed}", "0 m/s", "0 m/s"]' for speed in ("0 m/s", "10 mm/s"))
    design = read_design(written(tmp_path, "targets[0].velocity", speeds, shutter={}))
    steps, _ = plan_steps(design, runs_of(design), tmp_path / "out", StudyOptions(workers=1))
    plan = SamplingPlan("kernel", cell=0.5)
    found = sampled(steps, {asked(step.job.options): plan for step in steps})
    assert [step.job.options.sampling for step in found] == [plan, None]


@pytest.mark.parametrize(
    ("render", "camera", "told"),
    [
        ('method = "pinhole"', {}, "method.*knows one instant only"),
        ("basis = true", {}, "a light basis of a study knows one instant"),
        ("", {"diffraction": "auto"}, "scenes that change in the course of an exposure have no pilots"),
    ],
)
def test_what_knows_one_instant_is_refused(tmp_path: Path, render: str, camera: dict[str, Any], told: str) -> None:
    path = written(tmp_path, "camera.exposure_time", '"90 ms", "100 ms"', render=render, **camera)
    with pytest.raises(InputError, match=told):
        carried_out(path)
