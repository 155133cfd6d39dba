"""The worst case within tolerances: corners of what the bench may be off by, without a ray and by renders."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from radwrap.cli.main import main
from radwrap.designing.candidates import candidate_of, corners
from radwrap.designing.document import read_problem
from radwrap.designing.told import Designed
from radwrap.designing.trials import Trial
from radwrap.errors import InputError
from radwrap.scene.file.keys import found
from radwrap.study.seen import Answer
from tests.designing.conftest import Write

pytestmark = pytest.mark.usefixtures("one_thread")

TEXT = """
budget = 20
case = "worst"
[render]
tolerance = 4
[keys.time]
key = "camera.exposure_time"
choices = ["50 ms", "100 ms", "140 ms"]
[tolerances.clock]
key = "camera.exposure_time"
by = "10 %"
[responses.mean]
measure = "mean_gray"
[[objectives]]
of = "mean"
aim = "maximise"
[[constraints]]
of = "exposure_time"
at_most = "140 ms"
"""
PLACE = """
[tolerances.place]
keys = ["targets[0].edge_position"]
by = "0.5 mm"
"""
DARK = 20.0


def test_corners_are_all_combinations(design_file: Write) -> None:
    problem = read_problem(design_file(TEXT + PLACE))
    assert problem.images_each == 5
    candidate = candidate_of(problem, (1,))
    made = corners(problem, candidate)
    times = [found(one.document, "camera.exposure_time") for one in made]
    places = [found(one.document, "targets[0].edge_position") for one in made]
    assert [(time, place) for time, place in zip(times, places, strict=True)] == [
        (time, place) for time in ("90.0 ms", "110.0 ms") for place in ("0.5 mm", "1.5 mm")
    ]
    assert [one.own["exposure_time"].value for one in made] == pytest.approx([0.09, 0.09, 0.11, 0.11])
    # What the candidate is stays.
    assert found(candidate.document, "camera.exposure_time") == "100 ms"
    assert all(one.values == candidate.values for one in made)


def test_the_worst_corner_counts_for_objective_and_limits(design_file: Write) -> None:
    problem = read_problem(design_file(TEXT))
    corner = [
        {"mean": Answer(value, 0.5), "exposure_time": Answer(time, 0.0)} for value, time in ((80, 0.1), (96, 0.15))
    ]
    centre = {"mean": Answer(90, 0.2), "exposure_time": Answer(0.13, 0.0)}
    trial = Trial(1, "search", 0, (1,), {}, centre, 1.0, True, True, "", "", {}, {}, tuple(corner))
    (objective,) = trial.objectives(problem) or []
    assert (objective.value, objective.error) == (80, 0.5)
    assert trial.violations(problem) == pytest.approx([0.01 / 0.14]) and not trial.is_feasible(problem)
    # Which limit only a corner breaks.
    told = Designed(problem, None, None, (), (), (), (trial,), 3, "", 4.0).lines()
    assert "exposure_time at most 140 ms, within tolerances it is 150 ms" in told[1]
    lost = Trial(1, "search", 0, (1,), {}, centre, 1.0, True, True, "", "", {}, {}, (corner[0], {}))
    assert lost.objectives(problem) is None and not lost.may_be_feasible(problem)


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ('case = "worst"\n', "", 'go with case = "worst"'),
        ('by = "10 %"', 'by = "0 %"', "between 0 and 100"),
        ('by = "10 %"', 'by = "-1 ms"', "above zero"),
        ('by = "10 %"', 'by = "1 mm"', "another unit"),
        ('by = "10 %"', "by = 3", "another unit"),
        ('by = "10 %"', 'by = "600 ms"', "does not take it"),
        (
            'key = "camera.exposure_time"\nby = "10 %"',
            'key = "camera.position[0]"\nby = "10 %"',
            "is 0, of which a share is 0 too",
        ),
        ("budget = 20", "budget = 8", "each candidate takes 3 images"),
        ('key = "camera.exposure_time"\nby', 'key = "camera.sensor.kind"\nby', "no number"),
    ],
)
def test_tolerances_that_do_not_fit_are_refused(design_file: Write, before: str, after: str, words: str) -> None:
    assert before in TEXT
    with pytest.raises(InputError, match=words):
        read_problem(design_file(TEXT.replace(before, after, 1)))


@pytest.mark.long
def test_a_design_keeps_its_limits_in_the_worst_case(
    design_file: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """140 ms may be 154 ms: 100 ms is best, whose mean above dark is nine tenths in the darkest corner."""
    out = tmp_path / "out"
    assert main(["design", "run", str(design_file(TEXT)), "--out", str(out), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["case"] == "worst" and told["best"]["values"] == {"camera.exposure_time": "100 ms"}
    assert not told["doubts"]
    mean, time = (told["best"]["quantities"][name] for name in ("mean", "exposure_time"))
    assert (time["least"], time["most"]) == (pytest.approx(90.0), pytest.approx(110.0))
    assert mean["least"] - DARK == pytest.approx(0.9 * (mean["value"] - DARK), rel=0.01)
    assert mean["most"] - DARK == pytest.approx(1.1 * (mean["value"] - DARK), rel=0.01)
    with (out / "trials.csv").open() as file:
        rows = list(csv.DictReader(file))
    # 50 and 100 ms with two corners each, 140 ms by itself and in the corner of 126 ms; one is decided and checked.
    assert [row["feasible"] for row in rows] == ["1", "1", "0", "1", "1"] and told["renders"] == 3 + 3 + 2 + 3 + 3
    assert rows[1]["mean_least"] and "within tolerances 90 ms to 110 ms" in _again(design_file, out, capsys)


def _again(design_file: Write, out: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """What is said of the finished design."""
    assert main(["design", "run", str(design_file(TEXT)), "--out", str(out)]) == 0
    return capsys.readouterr().out
