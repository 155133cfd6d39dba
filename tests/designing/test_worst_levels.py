"""Levels that keep their limits in the corners of tolerances too: against closed forms, and as a user has it."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize

from radwrap.cli.main import main
from radwrap.designing.document import Problem, read_problem
from radwrap.designing.light import CONVEX, LOCAL, FoundLevels, LightAim, best_levels, levels_of, time_of
from radwrap.errors import InputError
from radwrap.imaging.relight.relit import Basis, read_basis
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.synthesis import render
from radwrap.scene.file.keys import set_key
from radwrap.study.factors import in_si
from tests.designing.conftest import sheet, write_problem

Array = NDArray[np.float64]
Lit = tuple[Callable[[str], Problem], Basis]

TEXT = """
budget = 15
case = "worst"
coarse = 1
[render]
tolerance = 1
[keys.level]
key = "sources[0].leds[*].radiance_factor"
low = 0.0
high = 2.0
[tolerances.lamp]
key = "sources[0].radiance"
by = "10 %"
[responses.even]
measure = "uniformity"
[responses.mean]
measure = "mean_gray"
[[objectives]]
of = "even"
aim = "maximise"
[[constraints]]
of = "peak_gray"
at_most = 200
"""
TIME = '[keys.time]\nkey = "camera.exposure_time"\nlow = "1 ms"\nhigh = "900 ms"\n'
DARK, ROOM = 20.0, 180.0  # gray levels below the limit


@pytest.fixture(scope="module")
def lit(tmp_path_factory: pytest.TempPathFactory) -> Lit:
    """A function that reads a problem, and a basis of its scene."""
    folder = tmp_path_factory.mktemp("lit")

    def read(text: str) -> Problem:
        return read_problem(write_problem(folder, text, sheet()))

    problem = read(TEXT)
    render(problem.scene(problem.study.document), folder / "basis", RenderOptions(tolerance=1, workers=1), basis=True)
    return read, read_basis(folder / "basis")


def brighter(basis: Basis, *factors: float) -> Basis:
    """A corner, in which the light of each source is so many times brighter."""
    by = np.broadcast_to(np.array(factors, dtype=np.float32), len(basis.sources))
    return replace(basis, images=basis.images * by[:, np.newaxis, np.newaxis, np.newaxis])


def solved(problem: Problem, basis: Basis, corners: list[Basis], **time: Any) -> FoundLevels:
    scene = problem.scene(problem.study.document)
    levels = levels_of(problem.levels, problem.study.document, scene, "design.toml")
    aim = LightAim(levels, problem.objectives[0], problem.constraints, problem.study.responses, **time)
    return best_levels(aim, basis, scene, [(one, scene) for one in corners])


def peak(basis: Basis, found: FoundLevels) -> float:
    """Of the image, above the dark level."""
    return float(np.tensordot(list(found.factors.values()), _light(basis), axes=1).max())


def _light(basis: Basis) -> Array:
    """Gray levels by each source above the dark level."""
    return np.asarray(basis.images.mean(axis=1, dtype=np.float64) * basis.exposure_of_radiance * 1e5)


def test_levels_leave_the_room_that_the_brightest_corner_needs(lit: Lit) -> None:
    """All light may be a tenth brighter: all levels are a tenth lower, and as even."""
    read, basis = lit
    problem = read(TEXT)
    before = solved(problem, basis, [])
    assert before.way == CONVEX and peak(basis, before) == pytest.approx(ROOM, rel=1e-6)
    corners = [brighter(basis, 0.9), brighter(basis, 1.1)]
    found = solved(problem, basis, corners)
    assert found.value == pytest.approx(before.value, abs=1e-7)
    ratios = [found.levels[path] / before.levels[path] for path in before.levels]
    assert ratios == pytest.approx([1 / 1.1] * 3, rel=1e-5)
    assert [peak(one, found) for one in (basis, *corners)] == pytest.approx([ROOM / 1.1, ROOM * 0.9 / 1.1, ROOM])
    assert [dict(one) for one in found.around] == [dict(found.factors)] * 2


@pytest.mark.long
def test_where_a_corner_changes_one_source_the_program_is_that_of_both(lit: Lit) -> None:
    """One LED may be three tenths brighter, and the mean is held above what even light gives: SLSQP on the ratio."""
    read, basis = lit
    floor = '[[constraints]]\nof = "mean"\nat_least = 132\n'
    problem = read(TEXT + floor)
    corner = brighter(basis, 1.3, 1.0, 1.0)
    found = solved(problem, basis, [corner])
    assert peak(corner, found) == pytest.approx(ROOM, rel=1e-6) and peak(basis, found) < ROOM
    here, there = _light(basis), _light(corner)

    def uneven(levels: Array) -> float:
        image = np.tensordot(levels, here, axes=1)
        rows, columns = (np.rint(np.linspace(0, size, 17)[1:-1]).astype(int) for size in image.shape)
        blocks = [block for row in np.split(image, rows, axis=0) for block in np.split(row, columns, axis=1)]
        means, counts = np.array([one.mean() for one in blocks]), [one.size for one in blocks]
        mean = np.average(means, weights=counts)
        return float(np.sqrt(np.average((means - mean) ** 2, weights=counts)) / mean)

    limits = [
        {"type": "ineq", "fun": lambda x: ROOM - np.tensordot(x, there, axes=1).max()},
        {"type": "ineq", "fun": lambda x: np.tensordot(x, here, axes=1).mean() - 112},
    ]
    ends = [
        minimize(
            lambda x: 1e2 * uneven(x) ** 2,
            np.array(list(found.factors.values())) * start,
            method="SLSQP",
            bounds=[(0.0, 2.0)] * 3,
            constraints=limits,
            options={"ftol": 1e-15, "maxiter": 300},
        )
        for start in (0.8, 0.95, 1.1)
    ]
    best = min(uneven(one.x) for one in ends if one.success)
    assert 1 - found.value == pytest.approx(best, abs=1e-6)


def test_limits_that_no_levels_keep_in_all_corners_are_refused(lit: Lit) -> None:
    """The peak may be 200 and the mean 130 where nothing is off, not where light is a fifth more and a fifth less."""
    read, basis = lit
    problem = read(TEXT + '[[constraints]]\nof = "mean"\nat_least = 130\n')
    solved(problem, basis, [])
    with pytest.raises(InputError, match="no levels keep all limits"):
        solved(problem, basis, [brighter(basis, 0.8), brighter(basis, 1.2)])


@pytest.mark.long
def test_a_local_search_keeps_limits_in_corners_too(lit: Lit) -> None:
    read, basis = lit
    problem = read(TEXT.replace('of = "even"', 'of = "mean"'))
    corner = brighter(basis, 1.25)
    found = solved(problem, basis, [corner])
    assert found.way == LOCAL
    assert peak(corner, found) == pytest.approx(ROOM, rel=1e-3)


def test_a_limit_of_the_time_holds_in_its_longest_corner(lit: Lit) -> None:
    """The clock may be a tenth slow: of 30 ms at most 30/1.1 are set, as less time than the peak allows is left."""
    read, basis = lit
    limit = '[[constraints]]\nof = "exposure_time"\nat_most = "30 ms"\n'
    problem = read(TEXT + TIME + limit + '[tolerances.clock]\nkey = "camera.exposure_time"\nby = "10 %"\n')
    assert problem.time is not None
    scene = problem.scene(problem.study.document)
    document: dict[str, Any] = json.loads(json.dumps(problem.study.document))
    set_key(document, "camera.exposure_time", f"{1.1 * scene.camera.exposure_time!r} s", "design.toml")
    levels = levels_of(problem.levels, problem.study.document, scene, "design.toml")
    time = time_of(problem.time, scene)
    aim = LightAim(levels, problem.objectives[0], problem.constraints, problem.study.responses, time)
    longest = (brighter(basis, 1.1), problem.scene(document))
    for corners, expected in (([], 0.03), ([longest], 0.03 / 1.1)):
        found = best_levels(aim, basis, scene, corners)
        assert in_si(found.levels["camera.exposure_time"]) == pytest.approx(expected, rel=1e-6)


def test_a_tolerance_of_what_is_solved_for_is_a_share(lit: Lit) -> None:
    read, _ = lit
    text = TEXT + TIME + '[tolerances.clock]\nkey = "camera.exposure_time"\nby = "{}"\n'
    assert read(text.format("5 %")).images_each == 5
    with pytest.raises(InputError, match="give a share of the value"):
        read(text.format("1 ms"))


@pytest.mark.long
@pytest.mark.usefixtures("one_thread")
def test_a_design_of_levels_keeps_its_limits_in_the_worst_case(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The peak in the brightest corner is the limit; the check, by other rays, agrees."""
    out, path = tmp_path / "out", write_problem(tmp_path, TEXT, sheet())
    assert main(["design", "run", str(path), "--out", str(out), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert not told["doubts"] and told["best"]["levels_by"]["way"] == CONVEX
    found = told["best"]["quantities"]["peak_gray"]
    assert found["most"] == pytest.approx(200, abs=1.5)
    assert found["value"] - DARK == pytest.approx((found["most"] - DARK) / 1.1, abs=1.5)
    assert found["least"] - DARK == pytest.approx(0.9 * (found["value"] - DARK), abs=1.5)
    check = told["check"]["quantities"]["peak_gray"]
    assert check["most"] == pytest.approx(found["most"], abs=4 * check["error"] + 1.5)
    with (out / "trials.csv").open() as file:
        # The check's levels are those that were found: it lies on the limit, on either side of it.
        assert next((row["stage"], row["feasible"]) for row in csv.DictReader(file)) == ("search", "1")
    assert told["renders"] == 6 and len(list(out.glob("renders/*"))) == 6
    # The same command again renders and measures nothing.
    before = {one: one.stat().st_mtime_ns for one in out.glob("records/*.json")}
    assert main(["design", "run", str(path), "--out", str(out)]) == 0
    assert {one: one.stat().st_mtime_ns for one in out.glob("records/*.json")} == before
