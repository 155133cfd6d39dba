"""All runs of a study are sampled by one plan, and their error bars are what renders scatter by."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

import radwrap
from radwrap.errors import InputError, TracerError
from radwrap.imaging.demand import SamplingPlan
from radwrap.scene.scene import Scene
from radwrap.study.design import read_design
from radwrap.study.effects import analyse
from radwrap.study.image_error import blur_radii, error_fields
from radwrap.study.levels import read_data
from radwrap.study.responses import Response, answer
from radwrap.study.sampled import read_plans
from radwrap.study.seen import Answer
from radwrap.study.study import STUDY, StudyOptions, run_study
from radwrap.study.table import read_table
from radwrap.study.worker import seen_of
from radwrap.tracers.installation import find_radiance
from tests.study.conftest import EDGE, DesignWriter, write_design

# Exposure alone: a darker image of the same edge, and of the same noise in share of its light.
DARKER = """
analysis = "none"
set = { "camera.sensor.rows" = 24, "camera.sensor.columns" = 30 }
[design]
kind = "full"
[factors.t]
key = "camera.exposure_time"
levels = ["13 ms", "100 ms"]
[render]
tolerance = 0.7
"""
BLUR = '[responses.b]\nmeasure = "edge_blur"\ndark = "sensor"\ngamma = "sensor"\n'
BLUR_OF = Response("b", "edge_blur", "px", {"dark": "sensor", "gamma": "sensor"})
ONE = StudyOptions(workers=1)
pytestmark = pytest.mark.usefixtures("one_process")


def manifests(out: Path) -> list[dict[str, Any]]:
    return [json.loads(path.read_text()) for path in sorted(out.glob("renders/*/manifest.json"))]


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory, one_process: None) -> Path:
    """Results of the darker study, which nothing disturbed; not to be changed."""
    folder = tmp_path_factory.mktemp("finished")
    run_study(read_design(write_design(folder, DARKER, BLUR)), folder / "out", ONE)
    return folder / "out"


def test_runs_share_a_plan_that_stands_in_the_study(finished: Path) -> None:
    out = finished
    told = json.loads((out / STUDY).read_text())["sampling"]
    assert len(told) == 1 and told[0]["render"]["tolerance"] == 0.7
    plans = [made["plan"]["sampling"] for made in manifests(out)]
    assert len(plans) == 2 and all({"render": told[0]["render"], **plan} == told[0] for plan in plans)
    # Equal rays of a darker scene: the same blur, to the rounding of float32.
    values = [float(row["b [px]"]) for row in read_table(out / "results.csv").rows]
    assert values[0] == pytest.approx(values[1], abs=1e-4)
    assert not (out / "pilots").exists()


@pytest.mark.long
def test_waves_that_one_run_needs_all_runs_have(design: DesignWriter) -> None:
    """In the darker run they do not matter: by itself it would go without."""
    darker = DARKER.replace("13 ms", "5 ms").replace("0.7", "2").replace("= 24", "= 16")
    path = design(darker.replace("set = {", 'set = { "camera.diffraction" = "auto",'), BLUR)
    out = path.parent / "out"
    run_study(read_design(path), out, ONE)
    (told,) = json.loads((out / STUDY).read_text())["sampling"]
    taken = [made["diffraction"] for made in manifests(out)]
    assert told["wave_cell"] <= 0.5 and len(taken) == 2
    assert taken[0]["rays"] == taken[1]["rays"]
    weak, strong = sorted(one["about_rms_gray"] for one in taken)
    assert weak < 0.3 * 2 < strong
    values = [float(row["b [px]"]) for row in read_table(out / "results.csv").rows]
    assert values[0] == pytest.approx(values[1], abs=1e-3)


def test_sub_viewpoints_of_a_study_do_not_decide_about_waves(design: DesignWriter) -> None:
    by_viewpoints = DARKER.replace("tolerance = 0.7", 'method = "viewpoints"\nviewpoints = 7')
    path = design(by_viewpoints.replace("set = {", 'set = { "camera.diffraction" = "auto",'), BLUR)
    with pytest.raises(InputError) as error:
        run_study(read_design(path), path.parent / "out", ONE)
    assert error.value.remedy == 'set it "on" or "off"' and "camera.diffraction" in str(error.value)


def test_the_plan_survives_a_kill_and_is_checked_when_it_is_read(design: DesignWriter, finished: Path) -> None:
    path = design(DARKER, BLUR)
    out = path.parent / "out"
    shutil.copytree(finished, out)
    table = out / "results.csv"
    whole, lines = table.read_bytes(), table.read_bytes().splitlines(keepends=True)
    # As a study leaves it that was killed after its first row: a plan that pilots would not choose is kept.
    told = json.loads((out / STUDY).read_text())
    begun = {key: told[key] for key in ("schema_version", "study_sha256", "sampling", "sampling_sha256")}
    (out / STUDY).write_text(json.dumps(begun))
    table.write_bytes(b"".join(lines[:2]))
    run_study(read_design(path), out, ONE)
    assert table.read_bytes() == whole and json.loads((out / STUDY).read_text())["sampling"] == told["sampling"]
    for key, value in (("cell", 0.3), ("replicates", -1), ("render", {})):
        bad = {**begun, "sampling": [{**begun["sampling"][0], key: value}]}
        (out / STUDY).write_text(json.dumps(bad))
        with pytest.raises(InputError) as error:
            run_study(read_design(path), out, ONE)
        assert f"sampling[0].{key}" in error.value.where
    # Another plan that would do is not the one by which the first row was made.
    coarser = {**begun, "sampling": [{**begun["sampling"][0], "cell": 2 * begun["sampling"][0]["cell"]}]}
    (out / STUDY).write_text(json.dumps(coarser))
    with pytest.raises(InputError, match="sampling_sha256"):
        run_study(read_design(path), out, ONE)
    (out / STUDY).write_text(json.dumps({**begun, "study_sha256": "0"}))
    with pytest.raises(InputError, match="another study"):
        read_plans(out / STUDY, "1")


def breakable_radiance(folder: Path, broken: Path, fails: str = "exit 1") -> Path:
    """Radiance whose rtrace says its version, and fails at all else as long as a file is there."""
    true = find_radiance()
    (folder / "bin").mkdir(parents=True)
    (folder / "lib").symlink_to(true.library)
    for name in ("oconv", "xform"):
        (folder / "bin" / name).symlink_to(true.program(name))
    rtrace = folder / "bin" / "rtrace"
    while_there = f'case "$*" in *-version*) ;; *) [ -e "{broken}" ] && {fails};; esac'
    rtrace.write_text(f'#!/bin/sh\n{while_there}\nexec "{true.program("rtrace")}" "$@"\n')
    rtrace.chmod(0o755)
    return folder


@pytest.mark.long
@pytest.mark.parametrize("every", [True, False])
def test_no_plan_is_made_where_a_pilot_failed_by_the_tracer(design: DesignWriter, finished: Path, every: bool) -> None:
    """It may have been the strictest; once the tracer is mended, the study is what it would have been without that."""
    path = design(DARKER, BLUR)
    broken = path.parent / "broken"
    out = path.parent / "out"
    fails = "exit 1" if every else f'/bin/rm "{broken}" && exit 1'  # all pilots, or the first
    options = StudyOptions(workers=1, radiance=str(breakable_radiance(path.parent / "radiance", broken, fails)))
    broken.touch()
    with pytest.raises(TracerError, match="exit code 1"):
        run_study(read_design(path), out, options)
    assert not (out / STUDY).exists() and broken.exists() == every
    broken.unlink(missing_ok=True)
    run_study(read_design(path), out, options)
    assert (out / "results.csv").read_bytes() == (finished / "results.csv").read_bytes()
    sampling = [json.loads((folder / STUDY).read_text())["sampling"] for folder in (out, finished)]
    assert sampling[0] == sampling[1] != []


@pytest.mark.long
def test_a_run_that_misses_its_tolerance_is_named(design: DesignWriter) -> None:
    """A budget that the brighter run cannot do with: it is named with its bound, and the plan stays as it is."""
    path = design(DARKER + "budget_rays = 16500\n", BLUR)
    out = path.parent / "out"
    study = run_study(read_design(path), out, ONE)
    rows = read_table(out / "results.csv").rows
    bad = {row["run"]: float(row["image_error"]) for row in rows if row["met"] == "0"}
    assert study.summary["missed"] == bad and list(bad) == ["2"] and bad["2"] > 0.7
    assert len({json.dumps(made["plan"]["sampling"]) for made in manifests(out)}) == 1


def test_an_effect_that_images_may_make_is_not_significant(tmp_path: Path) -> None:
    """Two replicates that agree to a thousandth, in images whose errors are ten times the effect."""
    lines = [f"{a},{b},{1 + 0.01 * a + 0.001 * (k % 2)},{{}}" for k in range(4) for a in (0, 1) for b in (0, 1)]
    path = tmp_path / "table.csv"
    said = []
    for error in (0.001, 0.1):
        path.write_text("\n".join(["a,b,y,y_error", *(line.format(error) for line in lines)]) + "\n")
        said.append(analyse(read_data(path, "y", ("a", "b"))).effects[0].significant)
    assert said == [True, False]


def small_edge() -> Scene:
    scene = radwrap.scene_from_document(EDGE)
    for key, size in (("rows", 24), ("columns", 30)):
        scene = radwrap.with_value(scene, f"camera.sensor.{key}", size)
    return scene


def answers_of(scene: Scene, out: Path, responses: list[Response], **how: Any) -> list[Answer]:
    made = radwrap.render(scene, out, workers=1, **how)
    seen = seen_of(scene, made, out, error_fields(made.gray.values.shape, blur_radii(scene)))
    with threadpool_limits(1):
        return [answer(one, seen) for one in responses]


@pytest.mark.long
def test_the_bar_of_a_blur_is_what_the_cells_add_to_it(tmp_path: Path) -> None:
    """Cells of half a pixel under a blur of two: an error of the second order, which cells of an eighth do not have."""
    (coarse,), (fine,) = (
        answers_of(small_edge(), tmp_path / str(cell), [BLUR_OF], sampling=SamplingPlan("kernel", cell=cell))
        for cell in (0.5, 0.125)
    )
    assert 0.7 < coarse.error / (coarse.value - fine.value) < 1.4


@pytest.mark.long
def test_error_bars_by_replicates_are_what_renders_scatter_by(tmp_path: Path) -> None:
    """Six renders with seeds of their own: their scatter is known to 32 %, the median of their bars to 10 %."""
    plan = SamplingPlan("kernel", cell=0.5)
    responses = [
        Response("u", "edge_position", "px", {"dark": "sensor", "gamma": "sensor"}),
        Response("m", "mean_gray"),
    ]
    found = [answers_of(small_edge(), tmp_path / str(seed), responses, sampling=plan, seed=seed) for seed in range(6)]
    for answers in zip(*found, strict=True):
        scatter = float(np.std([one.value for one in answers], ddof=1))
        stated = float(np.median([one.error for one in answers]))
        assert 0.5 < stated / scatter < 2.0
