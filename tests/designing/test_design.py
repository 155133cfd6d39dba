"""Designs from file to best scene, in this process; what hangs on processes is in test_resume."""

from __future__ import annotations

import csv
import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

import radwrap
from radwrap.cli.main import main
from radwrap.designing.best_levels import best_levels
from radwrap.designing.convex import unevenness
from radwrap.designing.document import read_problem
from radwrap.designing.light import CONVEX, LOCAL, LightAim, LitBy, levels_of, time_of
from radwrap.designing.trials import write_record
from radwrap.errors import InputError
from radwrap.files import sha256_of
from radwrap.imaging.relight.relit import read_basis
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.synthesis import render
from radwrap.study.factors import in_si
from radwrap.study.worker import failed
from tests.designing.conftest import COMMENT, Write, sheet, write_problem

pytestmark = pytest.mark.usefixtures("one_thread")

# The mean above dark is linear in the exposure time, so that the best time within a limit of the peak is known.
TIMES = """
budget = 8
[render]
tolerance = 4
[keys.time]
key = "camera.exposure_time"
choices = ["50 ms", "100 ms", "150 ms", "200 ms", "400 ms"]
cost = [5, 4, 3, 2, 1]
[responses.mean]
measure = "mean_gray"
[[objectives]]
of = "mean"
aim = "maximise"
[[constraints]]
of = "exposure_time"
at_most = "200 ms"
"""

LEVELS = """
budget = 3
[render]
tolerance = 1
[keys.level]
key = "sources[0].leds[*].radiance_factor"
low = 0.0
high = 2.0
[responses.even]
measure = "uniformity"
[responses.mean]
measure = "mean_gray"
[[objectives]]
of = "{of}"
aim = "maximise"
[[constraints]]
of = "peak_gray"
at_most = {peak}
"""


def read(path: Path) -> Any:
    return json.loads(path.read_text())


def rows(out: Path) -> list[dict[str, str]]:
    with (out / "trials.csv").open() as file:
        return list(csv.DictReader(file))


def contents(out: Path) -> dict[str, str]:
    """Hash of each result."""
    return {name: sha256_of(out / name) for name in ("design.json", "trials.csv", "best.toml", "index.html")}


def starts(out: Path) -> int:
    """How often a worker began with something."""
    return len((out / "started.log").read_text().splitlines())


def test_every_choice_is_looked_at_and_the_best_one_written(
    design_file: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, path = tmp_path / "out", design_file(TIMES)
    assert main(["design", "run", str(path), "--out", str(out), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told == read(out / "design.json")
    assert told["best"]["values"] == {"camera.exposure_time": "200 ms"}
    assert (
        told["limited_by"] == ["exposure_time at most 200 ms: it is 200 ms"]
        and told["candidates_by"] == "every combination"
    )
    assert told["feasible"] and told["met"] and not told["doubts"]
    # Five were asked for, four needed an image, and the last was decided and checked by finer ones.
    assert [row["stage"] for row in rows(out)] == ["search"] * 5 + ["decide", "check"]
    assert told["renders"] == 6
    late = rows(out)[4]
    assert (late["time"], late["mean"], late["feasible"], late["cost"]) == ("400 ms", "", "0", "1.0")

    # The mean above dark is as the time, within the errors of both.
    means = {row["time"]: (float(row["mean"]) - 20, float(row["mean_error"])) for row in rows(out)[:4]}
    error = math.hypot(2 * means["50 ms"][1], means["100 ms"][1])
    assert abs(means["100 ms"][0] - 2 * means["50 ms"][0]) < 4 * error + 0.01  # longer ones saturate

    text = (out / "best.toml").read_text()
    assert text.startswith(COMMENT) and '"exposure_time" = "200 ms"' in text
    assert radwrap.load_scene(out / "best.toml").camera.exposure_time == 0.2
    assert "<script" not in (out / "index.html").read_text() and "http" not in (out / "index.html").read_text()

    # The same again makes nothing, and changes no byte.
    before, begun = contents(out), starts(out)
    assert main(["design", "run", str(path), "--out", str(out)]) == 0
    assert contents(out) == before and starts(out) == begun
    assert "limited by exposure_time at most 200 ms" in capsys.readouterr().out

    # Another design does not go into its folder; a larger budget is the same one.
    design_file(TIMES.replace("at_most = ", "at_least = "))
    assert main(["design", "run", str(path), "--out", str(out)]) == 2
    assert "holds another design" in capsys.readouterr().err
    design_file(TIMES.replace("budget = 8", "budget = 12"))
    assert main(["design", "run", str(path), "--out", str(out)]) == 0
    assert starts(out) == begun


@pytest.mark.long  # some twenty renders
def test_a_render_that_failed_is_made_again_when_asked_for(
    design_file: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, path = tmp_path / "out", design_file(TIMES)
    command = ["design", "run", str(path), "--out", str(out)]
    assert main(command) == 0
    before, first = contents(out), rows(out)[0]
    error = float(first["image_error"])
    record = next(one for one in (out / "records").glob("*.json") if read(one)["image_error"] == error)
    write_record(record, failed(0, "the tracer died"))
    assert main(command) == 0
    assert rows(out)[0]["error"] == "the tracer died" and rows(out)[0]["feasible"] == "0"
    assert main([*command, "--retry-failed"]) == 0
    assert contents(out) == before

    record.write_text(record.read_text().replace('"met": true', '"met": false'))
    capsys.readouterr()
    assert main(command) == 2
    assert "is not as it was written" in capsys.readouterr().err


@pytest.mark.long
def test_what_keeps_no_limit_is_exit_code_1(
    design_file: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, path = tmp_path / "out", design_file(TIMES + '[[constraints]]\nof = "mean"\nat_least = 250\n')
    assert main(["design", "run", str(path), "--out", str(out)]) == 1
    told = capsys.readouterr()
    assert "no trial keeps all limits" in told.out and "nearest is trial 4: mean at least 250, it is" in told.out
    assert not read(out / "design.json")["feasible"] and not (out / "best.toml").exists()
    # With a smaller budget not all are looked at, and it says so; what is kept back for the next stages is used.
    path = design_file(TIMES.replace("budget = 8", "budget = 5") + '[[constraints]]\nof = "mean"\nat_least = 250\n')
    assert main(["design", "run", str(path), "--out", str(tmp_path / "few")]) == 1
    told = capsys.readouterr()
    assert re.search(r"limits; [1-9] combinations were not looked at", told.out), told.out
    assert read(tmp_path / "few" / "design.json")["renders"] == 3


@pytest.mark.long
def test_what_the_budget_does_not_decide_is_told(
    design_file: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A target that is larger than the field looks the same at any size."""
    text = (
        TIMES.replace("camera.exposure_time", "targets[0].size[0]")
        .replace("ms", "mm")
        .replace("budget = 8", "budget = 7")
    )
    text = text.replace(text[text.index("[[constraints]]") :], "")
    text = text.replace('["50 mm", "100 mm", "150 mm", "200 mm", "400 mm"]', '["50 mm", "300 mm", "350 mm", "400 mm"]')
    text = text.replace("[5, 4, 3, 2, 1]", "[4, 3, 2, 1]")
    out = tmp_path / "out"
    assert main(["design", "run", str(design_file(text)), "--out", str(out)]) == 0
    told = read(out / "design.json")
    assert told["best"]["values"] == {"targets[0].size[0]": "300 mm"} and told["undecided"] == [3, 4]
    assert "not decided, as the budget is spent: trial 3, 4 may be as good" in capsys.readouterr().out


def test_a_users_own_best_scene_is_not_replaced(design_file: Write, tmp_path: Path) -> None:
    path = design_file(TIMES)
    (tmp_path / "best.toml").write_text("mine")
    assert main(["design", "run", str(path), "--out", str(tmp_path)]) == 2
    assert (tmp_path / "best.toml").read_text() == "mine"


@pytest.mark.long  # some twenty renders
def test_two_objectives_have_a_front(design_file: Write, tmp_path: Path) -> None:
    """Longer times are brighter and cheaper here, so that the cost is turned round: then all are on the front."""
    out = tmp_path / "out"
    text = (
        TIMES.replace("[5, 4, 3, 2, 1]", "[1, 2, 3, 4, 5]")
        .replace("[[constraints]]", '[[objectives]]\nof = "cost"\naim = "minimise"\n[[constraints]]')
        .replace("budget = 8", "budget = 24")
    )
    assert main(["design", "run", str(design_file(text)), "--out", str(out)]) == 0
    told = read(out / "design.json")
    times = {one["values"]["camera.exposure_time"] for one in told["front"]}
    assert times == {"50 ms", "100 ms", "150 ms", "200 ms"}
    assert told["best"]["values"]["camera.exposure_time"] in ("100 ms", "150 ms")


@pytest.mark.long
def test_a_search_between_bounds_finds_the_limit(design_file: Write, tmp_path: Path) -> None:
    """The mean grows with the time: of the times that were looked at the longest one within the limit is best."""
    out, choices = (
        tmp_path / "out",
        'choices = ["50 ms", "100 ms", "150 ms", "200 ms", "400 ms"]\ncost = [5, 4, 3, 2, 1]',
    )
    text = TIMES.replace(choices, 'low = "20 ms"\nhigh = "400 ms"').replace("budget = 8", "budget = 10\nbatch = 3")
    assert main(["design", "run", str(design_file(text)), "--out", str(out)]) == 0
    told = read(out / "design.json")
    assert told["candidates_by"] == "optuna's TPE" and told["renders"] <= 10
    searched = [float(row["exposure_time [ms]"]) for row in rows(out) if row["stage"] == "search"]
    assert told["best"]["quantities"]["exposure_time"]["value"] == max(one for one in searched if one <= 200)


# -------------------------------------------------------------------------------------------------------------- levels


def test_levels_are_the_quadratic_programs_and_the_scene_keeps_its_comments(tmp_path: Path) -> None:
    out, path = tmp_path / "out", write_problem(tmp_path, LEVELS.format(of="even", peak=200), sheet())
    assert main(["design", "run", str(path), "--out", str(out)]) == 0
    told = read(out / "design.json")
    assert told["best"]["levels_by"]["way"] == CONVEX and not told["doubts"]
    assert told["best"]["quantities"]["peak_gray"]["value"] <= 200
    # Seen by other rays, the best scene is as good.
    check, best = (told[name]["quantities"]["even"] for name in ("check", "best"))
    assert abs(check["value"] - best["value"]) < 4 * math.hypot(check["error"], best["error"]) + 1e-4
    text = (out / "best.toml").read_text()
    assert text.startswith(COMMENT)
    levels = told["best"]["values"]
    scene = radwrap.load_scene(out / "best.toml")
    assert [f"{one.radiance:.6g}" for one in scene.emitters] == [
        f"{3e5 * levels[f'sources[0].leds[{k}].radiance_factor']:.6g}" for k in range(3)
    ]


@pytest.mark.long
def test_each_candidate_has_levels_of_its_own(tmp_path: Path) -> None:
    """LEDs that stand wider apart light a sheet more evenly; each place of the ring has its own best levels."""
    text = LEVELS.format(of="even", peak=200).replace("budget = 3", "budget = 6")
    text += '[keys.wide]\nkeys = ["sources[0].diameter", "sources[0].count"]\n'
    text += 'choices = [["20 mm", 2], ["90 mm", 5]]\n'
    out, path = tmp_path / "out", write_problem(tmp_path, text, sheet())
    assert main(["design", "run", str(path), "--out", str(out)]) == 0
    told = read(out / "design.json")
    assert [row["stage"] for row in rows(out)] == ["search", "search", "decide", "check"]
    assert told["best"]["values"]["sources[0].diameter"] == "90 mm"
    even = [float(row["even"]) for row in rows(out)[:2]]
    assert even[1] > even[0] + 0.01
    levels = [row["sources[0].leds[0].radiance_factor"] for row in rows(out)]
    assert levels[0] != levels[1] and all(levels)
    last = [row["sources[0].leds[4].radiance_factor"] for row in rows(out)]
    assert not last[0] and all(last[1:])
    assert len(radwrap.load_scene(out / "best.toml").emitters) == 5


@pytest.fixture(scope="module")
def lit(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, Any, Path]:
    """A problem, a basis of its scene and the folder of both."""
    folder = tmp_path_factory.mktemp("lit")
    problem = read_problem(write_problem(folder, LEVELS.format(of="even", peak=200), sheet()))
    scene = problem.scene(problem.study.document)
    render(scene, folder / "basis", RenderOptions(tolerance=1, workers=1), basis=True)
    return problem, read_basis(folder / "basis"), folder


def aim_of(problem: Any) -> LightAim:
    scene = problem.scene(problem.study.document)
    levels = levels_of(problem.levels, problem.study.document, scene, "design.toml")
    return LightAim(levels, problem.objectives[0], problem.constraints, problem.study.responses)


@pytest.mark.long
def test_the_uniformity_of_a_basis_is_the_optimum_to_a_millionth(lit: tuple[Any, Any, Path]) -> None:
    """The same light, made even by SLSQP on the ratio itself, from the images of the basis and nothing of ours."""
    problem, basis, _ = lit
    scene = problem.scene(problem.study.document)
    found = best_levels(aim_of(problem), basis, scene)
    light = basis.images.mean(axis=1, dtype=np.float64) * basis.exposure_of_radiance * 1e5

    def uneven(levels: Any) -> float:
        image = np.tensordot(levels, light, axes=1)
        rows, columns = (np.rint(np.linspace(0, size, 17)[1:-1]).astype(int) for size in image.shape)
        blocks = [np.split(row, columns, axis=1) for row in np.split(image, rows, axis=0)]
        means = np.array([[block.mean() for block in row] for row in blocks])
        counts = np.array([[block.size for block in row] for row in blocks])
        mean = np.average(means, weights=counts)
        return float(np.sqrt(np.average((means - mean) ** 2, weights=counts)) / mean)

    bounds = [(0.0, 2.0)] * 3
    limit = {"type": "ineq", "fun": lambda x: 180.0 - np.tensordot(x, light, axes=1).max()}  # gray 200 less dark
    ends = [
        minimize(
            lambda x: 1e2 * uneven(x) ** 2,
            np.full(3, start),
            method="SLSQP",
            bounds=bounds,
            constraints=limit,
            options={"ftol": 1e-15, "maxiter": 300},
        )
        for start in (0.2, 0.5)
    ]
    ways = LitBy(aim_of(problem), basis, scene)
    held = unevenness(ways.even_light(), np.array(list(found.factors.values())), "deviation")
    assert found.value == pytest.approx(1 - held, abs=1e-12)
    assert found.value == pytest.approx(1 - min(uneven(one.x) for one in ends), abs=1e-6)
    # The brightest such light: a pixel is at its limit, or an LED is.
    image = np.tensordot(list(found.factors.values()), light, axes=1)
    assert image.max() == pytest.approx(180, rel=1e-6) or found.at_high


TIME = """
[keys.time]
key = "camera.exposure_time"
low = "1 ms"
high = "5000 ms"
[[constraints]]
of = "mean"
at_least = 120
"""


def test_the_time_is_solved_for_with_the_levels(lit: tuple[Any, Any, Path]) -> None:
    """As even as before, as the ratio of levels is the same; the brightest LED at its bound, and so the time short."""
    _, basis, folder = lit
    before = best_levels(aim_of(lit[0]), basis, lit[0].scene(lit[0].study.document))
    problem = read_problem(write_problem(folder, LEVELS.format(of="even", peak=200) + TIME, sheet()))
    assert problem.time is not None and not problem.keys
    scene = problem.scene(problem.study.document)
    aim = replace(aim_of(problem), time=time_of(problem.time, scene))
    assert aim.way([basis.sensor]) == CONVEX
    found = best_levels(aim, basis, scene)
    assert found.value == pytest.approx(before.value, abs=1e-7)
    levels = [found.levels[f"sources[0].leds[{k}].radiance_factor"] for k in range(3)]
    assert max(levels) == pytest.approx(2.0, rel=1e-6)
    time = in_si(found.levels["camera.exposure_time"]) / scene.camera.exposure_time
    assert list(found.factors.values()) == pytest.approx([time * level for level in levels], rel=1e-7)
    light = basis.images.mean(axis=1, dtype=np.float64) * basis.exposure_of_radiance * 1e5
    assert np.tensordot(list(found.factors.values()), light, axes=1).max() == pytest.approx(180, rel=1e-6)
    # A limit of the time is one of its bounds.
    limit = f'[[constraints]]\nof = "exposure_time"\nat_most = "{0.5 * time * scene.camera.exposure_time!r} s"\n'
    problem = read_problem(write_problem(folder, LEVELS.format(of="even", peak=200) + TIME + limit, sheet()))
    with pytest.raises(InputError, match="no levels keep"):
        best_levels(replace(aim_of(problem), time=aim.time), basis, scene)


def test_a_time_on_which_more_than_light_hangs_is_searched(tmp_path: Path) -> None:
    """Dark current grows with it; and without levels it is a key like any other."""
    text = LEVELS.format(of="even", peak=200) + TIME
    dark = sheet()
    dark["camera"]["sensor"] = {
        **{name: dark["camera"]["sensor"][name] for name in ("rows", "columns", "pixel_width", "pixel_height")},
        **{"model": "linear", "wavelength": "550 nm", "quantum_efficiency": 0.5, "system_gain": "0.02 DN/e"},
        **{"full_well": "20 ke", "dark_current": "500 e/s", "offset": 5.0, "read_noise": "10 e"},
    }
    problem = read_problem(write_problem(tmp_path, text, dark))
    assert problem.time is None and [key.name for key in problem.keys] == ["time"]


@pytest.mark.long
def test_a_design_finds_levels_and_time(tmp_path: Path) -> None:
    text = LEVELS.format(of="even", peak=200) + TIME
    out, path = tmp_path / "out", write_problem(tmp_path, text, sheet())
    assert main(["design", "run", str(path), "--out", str(out)]) == 0
    told = read(out / "design.json")
    assert told["best"]["levels_by"]["way"] == CONVEX and not told["doubts"] and told["renders"] == 2
    scene = radwrap.load_scene(out / "best.toml")
    assert told["best"]["quantities"]["exposure_time"]["value"] == pytest.approx(scene.camera.exposure_time * 1e3)
    assert 150 < told["check"]["quantities"]["peak_gray"]["value"] <= 200


@pytest.mark.long
def test_what_is_no_convex_program_is_searched_locally(lit: tuple[Any, Any, Path]) -> None:
    """The mean is linear, so that its largest value is known by a linear program."""
    from scipy.optimize import linprog

    _, basis, folder = lit
    problem = read_problem(write_problem(folder, LEVELS.format(of="mean", peak=150), sheet()))
    aim, scene = aim_of(problem), problem.scene(problem.study.document)
    assert aim.way([basis.sensor]) == LOCAL
    found = best_levels(aim, basis, scene)
    light = basis.images.mean(axis=1, dtype=np.float64) * basis.exposure_of_radiance * 1e5
    flat = light.reshape(3, -1)
    best = linprog(-flat.mean(axis=1), flat.T, np.full(flat.shape[1], 130.0), bounds=[(0, 2)] * 3)
    assert found.value == pytest.approx(20 - best.fun, rel=1e-3)
