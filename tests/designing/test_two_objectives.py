"""Levels between two objectives: a front that is known by hand, and designs whose front needs one light."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from radwrap.cli.main import main
from radwrap.designing import light
from radwrap.designing.best_levels import FoundLevels, best_levels
from radwrap.designing.document import Problem, read_problem
from radwrap.designing.keys import BALANCE, STEPS_OF_BALANCE
from radwrap.designing.light import CONVEX, LOCAL, LightAim, levels_of, time_of
from radwrap.designing.quantities import Objective
from radwrap.errors import InputError
from radwrap.study.responses import Response, answer
from radwrap.study.seen import Answer, Seen
from tests.designing.conftest import basis_of, sheet, write_problem
from tests.designing.test_design import LEVELS
from tests.designing.test_resume import contents, kill_after, whole

MEAN = '[[objectives]]\nof = "mean"\naim = "maximise"\n[[constraints]]'
EVEN, DARK = 50.0, 20.0  # gray levels
EXACT = 3e-5  # of evenness: where all is even, its square is what the program makes small
SEARCHED = 1e-3  # of levels, where the end of a front is searched locally
TWO = LEVELS.format(of="even", peak=200).replace("[[constraints]]", MEAN)

CONSTANT = TWO.replace(MEAN, MEAN.replace('"mean"', '"exposure_time"').replace("maximise", "minimise"))
SHOWN = '[responses.shown]\nmeasure = "contrast"\n[responses.even]'


def two_lights() -> dict[str, Any]:
    bench = sheet()
    bench["sources"][0]["count"] = 2
    return bench


def problem_of(folder: Path, text: str = TWO) -> Problem:
    return read_problem(write_problem(folder, text.replace("high = 2.0", "high = 1.0"), two_lights()))


def found_at(problem: Problem, share: float, first: int = 0, off: tuple[float, ...] = ()) -> FoundLevels:
    """Levels on a light that no ray has made: one LED lights all alike, the other only the left half, twice as much.

    In corners this other LED is so many times brighter.
    """
    scene = problem.scene(problem.study.document)
    light = np.zeros((2, 20, 24))
    light[0] = EVEN
    light[1, :, :12] = 2 * EVEN
    around = [(basis_of(light * [[[1.0]], [[times]]], scene), scene) for times in off]
    objectives: list[Objective] = list(problem.objectives)
    aim = LightAim(
        levels_of(problem.levels, problem.study.document, scene, "design.toml"),
        objectives[first],
        problem.constraints,
        problem.study.responses,
        time=None if problem.time is None else time_of(problem.time, scene),
        second=objectives[1 - first],
        share=share,
    )
    return best_levels(aim, basis_of(light, scene), scene, around)


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 1.0])
@pytest.mark.parametrize("first", [0, 1])
def test_the_front_is_that_by_hand(tmp_path: Path, share: float, first: int) -> None:
    """With levels a and b unevenness is b/(a + b) and the mean 50 (a + b): on the front a is 1, and evenness 1/(1 + b).

    Means lie at equal steps. Whichever objective comes first, the front is the same, from its other end.
    """
    problem = problem_of(tmp_path)
    found = found_at(problem, share, first)
    b = share if first == 0 else 1 - share
    assert found.way == CONVEX
    assert list(found.factors.values()) == pytest.approx([1.0, b], abs=EXACT)
    wanted = 1 / (1 + b) if first == 0 else DARK + EVEN * (1 + b)
    assert found.value == pytest.approx(wanted, rel=EXACT)


@pytest.mark.parametrize("share", [0.0, 0.25, 1.0])
@pytest.mark.parametrize("first", [0, 1])
def test_the_front_of_the_worst_case_is_that_by_hand(tmp_path: Path, share: float, first: int) -> None:
    """The other LED may be a fifth brighter or darker: the one is least even, the other has the smallest mean.

    The worst mean goes in equal steps from 50 to 50 (1 + .8), with the evenness 1/(1 + 1.2 b).
    """
    found = found_at(problem_of(tmp_path), share, first, off=(0.8, 1.2))
    b = share if first == 0 else 1 - share
    assert list(found.factors.values()) == pytest.approx([1.0, b], abs=SEARCHED)
    wanted = 1 / (1 + 1.2 * b) if first == 0 else DARK + EVEN * (1 + 0.8 * b)
    assert found.value == pytest.approx(wanted, rel=SEARCHED)
    assert [dict(one) for one in found.around] == [dict(found.factors)] * 2


@pytest.mark.parametrize("share", [0.25, 1.0])
def test_levels_that_do_not_change_the_other_objective_are_those_of_the_one(tmp_path: Path, share: float) -> None:
    problem = problem_of(tmp_path, CONSTANT)
    assert found_at(problem, share).levels == found_at(problem, 0.0).levels


def test_last_digits_of_the_other_objective_move_no_level(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Made up: it grows by a millionth of a millionth with each gray level."""
    monkeypatch.setattr(light, "answer", lambda asked, seen: Answer(1 + 1e-12 * float(seen.gray.mean()), 0.0))
    text = TWO.replace(MEAN, MEAN.replace('"mean"', '"shown"')).replace("[responses.even]", SHOWN)
    problem = problem_of(tmp_path, text)
    assert found_at(problem, 0.5).levels == found_at(problem, 0.0).levels


@pytest.mark.long
def test_what_no_balance_changes_is_one_point(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, path = tmp_path / "out", write_problem(tmp_path, CONSTANT, sheet())
    assert main(["design", "run", str(path), "--out", str(out), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["trials"] == STEPS_OF_BALANCE + 1 and [one["trial"] for one in told["front"]] == [told["best"]["trial"]]
    assert told["ties"] == []


LEAST_SHOWN = 10.0  # gray levels above dark: below it the made-up measurement is lost


def shown(response: Response, seen: Seen) -> Answer:
    """A measurement that is the better the more light there is, and is lost in little of it."""
    if response.name != "shown":
        return answer(response, seen)
    level = float(seen.gray.mean()) - DARK
    if level < LEAST_SHOWN:
        raise InputError("is lost")
    return Answer(level**0.5, 0.0)


def test_a_front_ends_where_the_other_objective_can_be_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Least light is best for the mean; the root of light goes in equal steps from that of 10 gray levels on."""
    monkeypatch.setattr(light, "answer", shown)
    text = TWO.replace(MEAN, MEAN.replace("maximise", "minimise")).replace("[responses.even]", SHOWN)
    problem = problem_of(tmp_path, text.replace('of = "even"', 'of = "shown"'))
    low, high = LEAST_SHOWN**0.5, (2 * EVEN) ** 0.5
    for share in (0.0, 0.5, 1.0):
        found = found_at(problem, share, first=1)
        assert found.value - DARK == pytest.approx((low + share * (high - low)) ** 2, rel=2e-3)


def test_what_is_measured_in_no_levels_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(light, "answer", shown)
    monkeypatch.setattr(f"{__name__}.LEAST_SHOWN", 1e3)
    text = TWO.replace("[responses.even]", SHOWN).replace('of = "even"', 'of = "shown"')
    with pytest.raises(InputError, match="shown cannot be measured in any levels"):
        found_at(problem_of(tmp_path, text), 0.5, first=1)


def test_a_limit_holds_on_the_whole_front(tmp_path: Path) -> None:
    """The left half stays below 120 gray levels above dark, so that 50 + 100 b is at most 120: b at most .7."""
    problem = problem_of(tmp_path, TWO.replace("at_most = 200", f"at_most = {DARK + 120}"))
    for share in (0.5, 1.0):
        assert list(found_at(problem, share).factors.values()) == pytest.approx([1.0, 0.7 * share], abs=EXACT)


LEAST = f'[[constraints]]\nof = "mean"\nat_least = {DARK + 25}\n[[constraints]]'


def test_the_smallest_mean_is_not_made_brighter(tmp_path: Path) -> None:
    """The first light is even by itself, at any level from a half on."""
    text = TWO.replace(MEAN, MEAN.replace("maximise", "minimise").replace("[[constraints]]", LEAST))
    for share, a in ((0.0, 1.0), (0.5, 0.75), (1.0, 0.5)):
        found = found_at(problem_of(tmp_path, text), share)
        assert found.way == CONVEX and list(found.factors.values()) == pytest.approx([a, 0.0], abs=2 * EXACT)


@pytest.mark.parametrize(("share", "b"), [(2 / 3, 0.0), (5 / 6, 1 / 3), (1.0, 1.0)])
def test_a_shorter_time_takes_the_other_light_too(tmp_path: Path, share: float, b: float) -> None:
    """In a time t the mean is 50 (1 + b) t, 25 at least: from 1 to 1/4 of the scene's time, below 1/2 with b."""
    time = two_lights()["camera"]["exposure_time"]
    text = TWO.replace(MEAN, MEAN.replace('"mean"', '"exposure_time"').replace("maximise", "minimise"))
    text = text.replace("[[constraints]]", LEAST, 1)
    text += f'[keys.time]\nkey = "camera.exposure_time"\nlow = "0.1 ms"\nhigh = "{time}"\n'
    found = found_at(problem_of(tmp_path, text), share)
    t = 1 - 0.75 * share
    assert found.way == CONVEX
    assert list(found.factors.values()) == pytest.approx([t, b * t], abs=2 * EXACT)


@pytest.mark.long
def test_a_front_of_what_is_not_convex_is_said_to_be_searched(tmp_path: Path) -> None:
    """The smallest mean has no most even light: a brighter peak is better."""
    text = TWO.replace(MEAN, MEAN.replace('"mean"', '"peak_gray"'))
    found = found_at(problem_of(tmp_path, text), 0.5)
    assert found.way == LOCAL
    a, b = found.factors.values()
    # From 70 to 170 gray levels: half the way is 120, which is 50 a + 100 b = 100.
    assert a == pytest.approx(1.0, abs=0.01) and b == pytest.approx(0.5, abs=0.01)


def test_a_key_of_the_users_is_no_balance(tmp_path: Path) -> None:
    problem = problem_of(tmp_path)
    assert problem.keys == (BALANCE,) and problem.free == () and problem.is_balanced
    with pytest.raises(InputError, match="balance"):
        problem_of(
            tmp_path, TWO.replace("[keys.level]", '[keys.balance]\nkey = "camera.gain"\nlow=1\nhigh=2\n[keys.level]')
        )


@pytest.mark.long
def test_one_light_has_a_whole_front(tmp_path: Path) -> None:
    """Of two images, one is the check: the other nine points need no ray."""
    out, path = tmp_path / "out", write_problem(tmp_path, TWO, sheet())
    assert main(["design", "run", str(path), "--out", str(out)]) == 0
    told = json.loads((out / "design.json").read_text())
    assert told["renders"] == 2 and told["best"]["levels_by"]["way"] == CONVEX and not told["doubts"]
    front = [[one["quantities"][name]["value"] for name in ("even", "mean")] for one in told["front"]]
    assert len(front) == STEPS_OF_BALANCE
    even, mean = np.array(sorted(front)).T
    assert (np.diff(even) > 0).all() and (np.diff(mean) < 0).all()
    assert np.diff(mean) == pytest.approx(np.diff(mean).mean(), rel=0.02)  # equal steps, but for rounding


@pytest.mark.long
def test_kills_and_workers_change_no_byte(tmp_path: Path) -> None:
    text = TWO.replace("budget = 3", "budget = 8")
    text += '[keys.wide]\nkey = "sources[0].diameter"\nchoices = ["30 mm", "60 mm", "90 mm"]\n'
    path, out = write_problem(tmp_path, text, sheet()), tmp_path / "out"
    whole(path, tmp_path / "one", 1)
    expected = contents(tmp_path / "one")
    assert kill_after(path, out, 5, signal.SIGKILL) == -signal.SIGKILL
    images = {one: one.stat().st_mtime_ns for one in out.glob("renders/*/manifest.json")}
    assert images
    whole(path, out, 2)
    assert contents(out) == expected
    assert {one: one.stat().st_mtime_ns for one in images} == images
    assert len(json.loads((out / "design.json").read_text())["front"]) >= STEPS_OF_BALANCE - 1
