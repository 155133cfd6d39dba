"""Levels that keep their limits in the corners of tolerances too: against closed forms, and as a user has it."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import linprog, minimize

from radwrap.cli.main import main
from radwrap.designing.best_levels import FoundLevels, best_levels
from radwrap.designing.candidates import candidate_of, corners
from radwrap.designing.document import Problem, read_problem
from radwrap.designing.light import CONVEX, LOCAL, LightAim, levels_of, time_of
from radwrap.designing.worker import CandidateJob
from radwrap.errors import InputError
from radwrap.imaging.relight.relit import Basis
from radwrap.scene.file.keys import found as value
from radwrap.scene.file.keys import set_key
from radwrap.scene.scene import Scene
from radwrap.study.factors import in_si
from radwrap.study.worker import Outcome
from tests.designing.conftest import basis_of, sheet, write_problem
from tests.designing.test_resume import contents, whole

Array = NDArray[np.float64]
Lit = tuple[Callable[..., Problem], Basis]

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


@pytest.fixture
def lit(tmp_path: Path) -> Lit:
    """A function that reads a problem, and a basis that no ray has made: spots of three LEDs, in gray levels."""

    def read(text: str, scene: dict[str, Any] | None = None) -> Problem:
        return read_problem(write_problem(tmp_path, text, scene or sheet()))

    problem = read(TEXT)
    v, u = np.mgrid[-1:1:20j, -1:1:24j]
    turns = np.arange(3)[:, np.newaxis, np.newaxis] * 2 * np.pi / 3
    light = 90 * np.exp(-((u - 0.8 * np.cos(turns) - 0.2) ** 2 + (v - 0.8 * np.sin(turns)) ** 2) / 3)
    return read, basis_of(light, problem.scene(problem.study.document))


def brighter(basis: Basis, *factors: float) -> Basis:
    """A corner, in which the light of each source is so many times brighter."""
    by = np.broadcast_to(np.array(factors, dtype=np.float32), len(basis.sources))
    return replace(basis, images=basis.images * by[:, np.newaxis, np.newaxis, np.newaxis])


def aimed(problem: Problem, basis: Basis, around: list[tuple[Basis, Scene]]) -> FoundLevels:
    scene = problem.scene(problem.study.document)
    levels = levels_of(problem.levels, problem.study.document, scene, "design.toml")
    aim = LightAim(levels, problem.objectives[0], problem.constraints, problem.study.responses)
    return best_levels(aim, basis, scene, around)


def solved(problem: Problem, basis: Basis, around: list[Basis]) -> FoundLevels:
    """Levels, where the corners are those of the light only."""
    scene = problem.scene(problem.study.document)
    return aimed(problem, basis, [(one, scene) for one in around])


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
    around = [brighter(basis, 0.9), brighter(basis, 1.1)]
    found = solved(problem, basis, around)
    assert found.value == pytest.approx(before.value, abs=1e-7)
    ratios = [found.levels[path] / before.levels[path] for path in before.levels]
    assert ratios == pytest.approx([1 / 1.1] * 3, rel=1e-5)
    assert [peak(one, found) for one in (basis, *around)] == pytest.approx([ROOM / 1.1, ROOM * 0.9 / 1.1, ROOM])
    assert [dict(one) for one in found.around] == [dict(found.factors)] * 2


def uneven(image: Array) -> float:
    """Standard deviation over mean of cells, 16 a side."""
    rows, columns = (np.rint(np.linspace(0, size, 17)[1:-1]).astype(int) for size in image.shape)
    blocks = [block for row in np.split(image, rows, axis=0) for block in np.split(row, columns, axis=1)]
    means, counts = np.array([one.mean() for one in blocks]), [one.size for one in blocks]
    mean = np.average(means, weights=counts)
    return float(np.sqrt(np.average((means - mean) ** 2, weights=counts)) / mean)


@pytest.mark.long
def test_where_a_corner_changes_one_source_levels_are_best_for_both(lit: Lit) -> None:
    """One LED may be a half brighter, and the mean is held above what even light gives: SLSQP on the ratios."""
    read, basis = lit
    problem = read(TEXT + '[[constraints]]\nof = "mean"\nat_least = 124\n')
    corner = brighter(basis, 1.5, 1.0, 1.0)
    found = solved(problem, basis, [corner])
    lights = [_light(basis), _light(corner)]
    assert peak(corner, found) == pytest.approx(ROOM, rel=1e-6) and peak(basis, found) < ROOM
    limits = [
        {"type": "ineq", "fun": lambda x, light=light, lit=lit: lit(np.tensordot(x[:3], light, axes=1), x[3])}
        for light in lights
        for lit in (
            lambda image, _: ROOM - image.max(),
            lambda image, _: image.mean() - 104,
            lambda image, worst: 1e2 * (worst - uneven(image)),
        )
    ]
    best = np.inf
    for start in (0.8, 0.95, 1.1):
        begin = np.array(list(found.factors.values())) * start
        first = max(uneven(np.tensordot(begin, light, axes=1)) for light in lights)
        ended = minimize(
            lambda x: 1e2 * x[3],
            np.append(begin, first),
            method="SLSQP",
            bounds=[*[(0.0, 2.0)] * 3, (0, 1)],
            constraints=limits,
            options={"ftol": 1e-14, "maxiter": 300},
        )
        if all(one["fun"](ended.x) > -1e-7 for one in limits):
            best = min(best, *(max(uneven(np.tensordot(ended.x[:3], light, axes=1)) for light in lights),))
    assert 1 - found.value == pytest.approx(best, abs=1e-6)
    # What is told is the worst of all, also where that is not the scene as it stands.
    around = [brighter(basis, 0.6, 1.4, 1.0), brighter(basis, 1.4, 0.6, 1.0)]
    middle = solved(read(TEXT), basis, around)
    own, *others = (
        uneven(np.tensordot(list(middle.factors.values()), _light(one), axes=1)) for one in (basis, *around)
    )
    assert own < 0.95 * max(others) and 1 - middle.value == pytest.approx(max(others), abs=1e-9)
    # The levels that are best in the scene as it stands are worse there.
    before = solved(problem, basis, [])
    assert uneven(np.tensordot(list(before.factors.values()), lights[1], axes=1)) > best + 1e-4


def test_limits_that_only_corners_break_are_said_to_be_theirs(lit: Lit) -> None:
    """The peak may be 200 and the mean 130 where nothing is off, not where light is a fifth more and a fifth less."""
    read, basis = lit
    problem = read(TEXT + '[[constraints]]\nof = "mean"\nat_least = 130\n')
    solved(problem, basis, [])
    with pytest.raises(InputError, match="no levels keep all limits in all corners of the tolerances"):
        solved(problem, basis, [brighter(basis, 0.8), brighter(basis, 1.2)])
    with pytest.raises(InputError, match=r"no levels keep all limits$"):
        solved(read(TEXT + '[[constraints]]\nof = "mean"\nat_least = 199\n'), basis, [])


@pytest.mark.long
def test_a_local_search_finds_the_best_worst_case_within_limits_of_all_corners(lit: Lit) -> None:
    """The least mean of all corners, as large as the peaks of all allow: a linear program."""
    read, basis = lit
    problem = read(TEXT.replace('of = "even"', 'of = "mean"'))
    images = [basis, brighter(basis, 1.3, 1.2, 1.0), brighter(basis, 0.8, 0.7, 0.9)]
    found = solved(problem, basis, images[1:])
    assert found.way == LOCAL
    lights = [_light(one).reshape(3, -1) for one in images]
    best = linprog(
        [0, 0, 0, -1],
        np.vstack(
            [
                *(np.hstack([light.T, np.zeros((light.shape[1], 1))]) for light in lights),
                *(np.append(-light.mean(axis=1), 1.0) for light in lights),
            ]
        ),
        np.append(np.full(sum(light.shape[1] for light in lights), ROOM), np.zeros(len(lights))),
        bounds=[*[(0, 2)] * 3, (None, None)],
    )
    assert found.value - DARK == pytest.approx(-best.fun, rel=2e-3)
    assert max(peak(one, found) for one in images) <= ROOM * (1 + 1e-3)


GAMMA = TEXT.replace("sources[0].radiance", "camera.sensor.gamma").replace("10 %", "2 %")


def linear() -> dict[str, Any]:
    """The sheet before a linear camera; its gamma keeps dark level and saturation."""
    scene = sheet()
    size = {name: scene["camera"]["sensor"][name] for name in ("rows", "columns", "pixel_width", "pixel_height")}
    scene["camera"]["sensor"] = {
        **{**size, "model": "linear", "wavelength": "550 nm", "quantum_efficiency": 0.5, "rounding": False},
        **{"system_gain": "7e-6 DN/e", "full_well": "40000 ke", "offset": DARK, "read_noise": "10 e", "gamma": 1.0},
    }
    return scene


def gammas(problem: Problem, basis: Basis) -> tuple[Basis, list[tuple[Basis, Scene]]]:
    """The basis before a linear camera, and in the corners of its gamma."""
    documents = [problem.allowed[0].moved(problem.study.document, sign, "design.toml") for sign in (-1.0, 1.0)]
    own, *around = (problem.scene(one) for one in (problem.study.document, *documents))
    assert [one.camera.sensor.gamma for one in around] == [0.98, 1.02]
    return replace(basis, camera=own.camera), [(replace(basis, camera=one.camera), one) for one in around]


def test_a_corner_of_gamma_has_its_own_inverse(lit: Lit) -> None:
    """Light of a share g of the range above dark is g^(1/gamma) of that of a full pixel: least where gamma is least."""
    read, basis = lit
    problem = read(GAMMA, linear())
    own, around = gammas(problem, basis)
    before, found = aimed(problem, own, []), aimed(problem, own, around)
    assert before.way == found.way == CONVEX and not before.at_high
    ratios = [found.levels[path] / before.levels[path] for path in before.levels]
    share = ROOM / (own.sensor.saturation_gray - DARK)
    assert ratios == pytest.approx([share ** (1 / 0.98 - 1)] * 3, rel=1e-5)


@pytest.mark.long
def test_where_a_corner_of_gamma_bends_a_limit_levels_are_searched_locally(lit: Lit) -> None:
    """The mean of gray levels is linear in light for a gamma of 1 only; it is held where gamma makes it least."""
    read, basis = lit
    problem = read(GAMMA + '[[constraints]]\nof = "mean"\nat_least = 122\n', linear())
    own, around = gammas(problem, basis)
    assert aimed(problem, own, []).way == CONVEX
    found = aimed(problem, own, around)
    assert found.way == LOCAL
    sensor = own.sensor
    light = np.tensordot(list(found.factors.values()), basis.images.mean(axis=1, dtype=np.float64), axes=1)
    share = light * basis.exposure_of_radiance * sensor.gain / (sensor.saturation_gray - DARK)
    grays = [DARK + (sensor.saturation_gray - DARK) * share**gamma for gamma in (0.98, 1.0, 1.02)]
    assert max(one.max() for one in grays) <= 200 * (1 + 1e-3)
    assert min(one.mean() for one in grays) >= 122 * (1 - 1e-3)


def test_a_level_of_0_is_0_in_its_corners(lit: Lit) -> None:
    read, _ = lit
    scene = sheet()
    scene["sources"][0]["leds"] = [{"index": k, "radiance_factor": 1.0} for k in range(3)]
    text = TEXT.replace("sources[0].radiance", "sources[0].leds[*].radiance_factor")
    problem = read(text, scene)
    path = "sources[0].leds[{}].radiance_factor"
    levels = {path.format(0): 0.0, path.format(1): 0.5, path.format(2): 2.0}
    made = corners(problem, candidate_of(problem, (), levels))
    assert [[value(one.document, path.format(k)) for k in range(3)] for one in made] == [
        [0.0, pytest.approx(0.45), pytest.approx(1.8)],
        [0.0, pytest.approx(0.55), pytest.approx(2.2)],
    ]
    assert [one.own["leds"].value for one in made] == [2, 2]


def test_a_limit_of_the_time_holds_in_its_longest_corner(lit: Lit) -> None:
    """The clock may be a tenth slow: of 36.8 ms at most 36.8/1.1 are set, as less time than the peak allows is left.

    The scene holds nine digits of it, 33.4545455 ms, whose corner is beyond by a billionth: that breaks no limit.
    """
    read, basis = lit
    limit = '[[constraints]]\nof = "exposure_time"\nat_most = "36.8 ms"\n'
    problem = read(TEXT + TIME + limit + '[tolerances.clock]\nkey = "camera.exposure_time"\nby = "10 %"\n')
    assert problem.time is not None
    scene = problem.scene(problem.study.document)
    document: dict[str, Any] = json.loads(json.dumps(problem.study.document))
    set_key(document, "camera.exposure_time", f"{1.1 * scene.camera.exposure_time!r} s", "design.toml")
    levels = levels_of(problem.levels, problem.study.document, scene, "design.toml")
    time = time_of(problem.time, scene)
    aim = LightAim(levels, problem.objectives[0], problem.constraints, problem.study.responses, time)
    longest = (brighter(basis, 1.1), problem.scene(document))
    for around, expected in (([], 0.0368), ([longest], 0.0368 / 1.1)):
        found = best_levels(aim, basis, scene, around)
        assert in_si(found.levels["camera.exposure_time"]) == pytest.approx(expected, rel=1e-6)
    made = [one.own["exposure_time"].value for one in corners(problem, candidate_of(problem, (), found.levels))]
    assert max(made) > 0.0368 and not any(problem.constraints[-1].violation(one) for one in made)
    assert problem.constraints[-1].violation(0.0368 * (1 + 1e-7)) > 0


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
    # Without its last records, as a kill leaves it: all is measured again, and nothing is rendered.
    images = {one: one.stat().st_mtime_ns for one in out.glob("renders/*/*")}
    kept = {one: one.read_bytes() for one in out.glob("records/*-worst*.json")}
    assert len(kept) == 3
    for one in list(kept)[:2]:
        one.unlink()
    assert main(["design", "run", str(path), "--out", str(out)]) == 0
    assert {one: one.read_bytes() for one in kept} == kept
    assert {one: one.stat().st_mtime_ns for one in out.glob("renders/*/*")} == images


SHARED = """
[keys.time]
key = "camera.exposure_time"
choices = ["90 ms", "110 ms"]
[tolerances.clock]
key = "camera.exposure_time"
by = "10 ms"
"""


@pytest.mark.long
def test_two_workers_render_a_shared_corner_once(tmp_path: Path) -> None:
    """100 ms is a corner of 90 and of 110 ms: other workers, the same bytes."""
    text = TEXT[: TEXT.index("[tolerances.lamp]")] + SHARED + TEXT[TEXT.index("[responses.even]") :]
    path = write_problem(tmp_path, text, sheet())
    for workers in (1, 2):
        whole(path, tmp_path / str(workers), workers)
        # Of each of two candidates a pilot, a basis, and it in the levels that are best there; of 80, 100 and 120 ms a
        # pilot and a basis; six images in the levels of the worst case; of three of the check a pilot and a render.
        assert len((tmp_path / str(workers) / "started.log").read_text().splitlines()) == 6 + 6 + 6 + 6
    assert contents(tmp_path / "1") == contents(tmp_path / "2")


@pytest.mark.long
@pytest.mark.usefixtures("one_thread")
def test_what_only_corners_break_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = TEXT.replace('"10 %"', '"20 %"') + '[[constraints]]\nof = "mean"\nat_least = 130\n'
    out, path = tmp_path / "out", write_problem(tmp_path, text, sheet())
    assert main(["design", "run", str(path), "--out", str(out)]) == 1
    assert "no levels keep all limits in all corners of the tolerances" in capsys.readouterr().out


@pytest.mark.long
@pytest.mark.usefixtures("one_thread")
def test_an_image_that_misses_its_tolerance_is_made_again(tmp_path: Path) -> None:
    """As if each image missed it by its first plan: a finer one of each corner has a folder of its own, and is used."""
    out, path = tmp_path / "out", write_problem(tmp_path, TEXT, sheet())

    def missed(job: CandidateJob, outcome: Outcome) -> CandidateJob:
        is_corner = not job.runs or len(job.runs) == 1
        return replace(job, share=1) if is_corner and not job.share else job

    with patch("radwrap.designing.bench.finer", missed):
        assert main(["design", "run", str(path), "--out", str(out)]) == 0
    assert len(list(out.glob("renders/*-1"))) == 2
