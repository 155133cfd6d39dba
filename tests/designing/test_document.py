"""DESIGN.toml: what is wrong is told with file and key, before the first ray."""

from __future__ import annotations

import pytest

from radwrap.cli.main import main
from radwrap.designing.document import read_problem
from radwrap.designing.keys import read_key
from radwrap.designing.tables import KeyModel
from tests.designing.conftest import Write

GOOD = """
budget = 20
[keys.time]
key = "camera.exposure_time"
low = "10 ms"
high = "110 ms"
[responses.u]
measure = "edge_position"
[responses.mean]
measure = "mean_gray"
[[objectives]]
of = "mean"
aim = "maximise"
[[constraints]]
of = "peak_gray"
at_most = 200
"""

TIME = 'key = "camera.exposure_time"\nlow = "10 ms"\nhigh = "110 ms"'

FAULTS = {
    "no budget": ("budget = 20", "", "budget"),
    "budget too small": ("budget = 20", "budget = 2", "budget"),
    "worst case": ("budget = 20", 'budget = 20\ncase = "worst"', 'go with case = "worst", and that needs them'),
    "no aim": ('aim = "maximise"', "", "objectives[0].aim"),
    "unknown aim": ('"maximise"', '"best"', "objectives[0].aim"),
    "unknown response": ('of = "mean"', 'of = "maen"', '"maen" is not a response of this file'),
    "unknown measure": ('"mean_gray"', '"mean_grey"', "must be one of focal_length"),
    "unknown key": ('"camera.exposure_time"', '"camera.exposure"', "keys.time, 10.0 ms"),
    "no such entry": ('"camera.exposure_time"', '"sources[7].radiance"', "the scene has no such place"),
    "no such list": ('"camera.exposure_time"', '"lamps[*].radiance"', "names no entry of a list of the scene"),
    "bounds crossed": ('low = "10 ms"', 'low = "200 ms"', "keys.time: low must lie below high"),
    "other units": ('low = "10 ms"', 'low = "10 mm"', "low and high have different units, mm and ms"),
    "one bound without unit": ('high = "110 ms"', "high = 110", "low and high have different units, ms and none"),
    "a bound of text": ('low = "10 ms"', 'low = "soon"', "keys.time.low: must be a number, or a number with a unit"),
    "whole numbers without a step": (
        TIME,
        'key = "camera.sensor.rows"\nlow = 40\nhigh = 60',
        "keys.time: takes whole numbers only; add step = 1",
    ),
    "a value of what is searched": (
        "[keys.time]",
        '[set]\n"camera.exposure_time" = "30 ms"\n[keys.time]',
        "set: camera.exposure_time: keys.time searches it",
    ),
    "a limit beyond the bounds": (
        'of = "peak_gray"\nat_most = 200',
        'of = "exposure_time"\nat_most = "5 ms"',
        "constraints[0]: nothing can keep exposure_time at most 5 ms: it goes from 10 ms to 110 ms",
    ),
    "a limit beyond white": (
        "at_most = 200",
        "at_least = 256",
        "it goes from 0 to 255 gray levels, the sensor's saturation_gray",
    ),
    "a limit below all costs": (
        'low = "10 ms"\nhigh = "110 ms"',
        'choices = ["20 ms", "30 ms"]\ncost = [2, 3]\n[[constraints]]\nof = "cost"\nat_most = 1',
        "constraints[0]: nothing can keep cost at most 1: it goes from 2 to 3",
    ),
    "a bound that is not a scene": ('low = "10 ms"', 'low = "-10 ms"', "keys.time, -10.0 ms"),
    "log from zero": ('low = "10 ms"', 'scale = "log"\nlow = "0 ms"', "a logarithm needs bounds above zero"),
    "step and log": ('low = "10 ms"', 'scale = "log"\nstep = "1 ms"\nlow = "1 ms"', "step goes with a linear scale"),
    "choices and bounds": ('low = "10 ms"', 'choices = ["1 ms", "2 ms"]\nlow = "10 ms"', "keys.time"),
    "cost without choices": ('low = "10 ms"', 'cost = [1, 2]\nlow = "10 ms"', "cost goes with choices"),
    "step of another unit": ('low = "10 ms"', 'step = "1 mm"\nlow = "10 ms"', "keys.time.step"),
    "no limit": ("at_most = 200", "", "needs at_least, at_most, or both"),
    "limits crossed": ("at_most = 200", "at_most = 200\nat_least = 300", "at_least lies above at_most"),
    "limit without unit": ('of = "peak_gray"', 'of = "exposure_time"', "constraints[0].at_most"),
    "limit of text": ("at_most = 200", 'at_most = "200"', "must be a number"),
    "cost of nothing": ('of = "peak_gray"', 'of = "cost"', "no choice has a cost"),
    "a name twice": ("[responses.u]", "[responses.time]", "names another one already"),
    "name of a column": ("[keys.time]", "[keys.leds]", "names another one already"),
    "the same objective twice": (
        "[[constraints]]",
        '[[objectives]]\nof = "mean"\naim = "minimise"\n[[constraints]]',
        "are the same twice",
    ),
    "nothing to measure it on": ('"edge_position"', '"dot_error"', "the scene has no board of dots"),
    "frames without noise": ('"edge_position"', '"edge_position"\nframes = 5', "responses.u.frames"),
    "unknown table": ("[responses.u]", "[surprise]\n[responses.u]", "surprise"),
    "code without trust": ('"edge_position"', '"python:own.py:look"\nkeys = ["u"]', "is code that would be run"),
    "the same key twice": (
        "[responses.u]",
        '[keys.again]\nkey = "camera"\nchoices = [1, 2]\n[responses.u]',
        "which keys.time sets already",
    ),
    "levels below zero": (
        TIME,
        'key = "sources[0].radiance"\nlow = "-1 W/m^2/sr"\nhigh = "2 W/m^2/sr"',
        "levels are not negative",
    ),
    "levels by the paper's method": (
        TIME,
        'key = "sources[0].radiance"\nlow = "1 W/m^2/sr"\nhigh = "2 W/m^2/sr"\n[render]\nmethod = "pinhole"',
        "solved for on a light basis",
    ),
    "a level twice": (
        TIME,
        'key = "sources[0].radiance"\nlow = "1 W/m^2/sr"\nhigh = "2 W/m^2/sr"\n'
        '[keys.led]\nkey = "sources[0].leds[1].radiance_factor"\nlow = 0.0\nhigh = 1.0',
        "scales ring.led01",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_told_with_its_place(name: str, design_file: Write, capsys: pytest.CaptureFixture[str]) -> None:
    before, after, told = FAULTS[name]
    assert before in GOOD
    path = design_file(GOOD.replace(before, after, 1))
    (path.parent / "own.py").write_text("def look(gray, manifest, truth):\n    return {'u': 1.0}\n")
    assert main(["design", "run", str(path), "--out", str(path.parent / "out")]) == 2
    error = capsys.readouterr().err
    assert told in error and "design.toml" in error and "Traceback" not in error
    assert not (path.parent / "out" / "plan.json").exists()


def test_a_good_file_is_read(design_file: Write) -> None:
    problem = read_problem(design_file(GOOD))
    assert [key.name for key in problem.keys] == ["time"] and not problem.levels
    assert [one.quantity.name for one in problem.constraints] == ["peak_gray"]
    assert [one.name for one in problem.quantities] == ["u", "mean", "peak_gray", "exposure_time", "leds", "cost"]
    assert (problem.budget, problem.batch, problem.coarse) == (20, 8, 4.0)


def test_limits_at_a_bound_and_changes_beside_a_key_are_kept(design_file: Write) -> None:
    """The table that holds a searched key may be changed, and a limit may be what the longest exposure just keeps."""
    text = GOOD.replace('of = "peak_gray"\nat_most = 200', 'of = "exposure_time"\nat_least = "110 ms"')
    problem = read_problem(design_file(text.replace("[keys.time]", '[set]\n"camera.sensor.rows" = 40\n[keys.time]')))
    assert problem.changes == {"camera.sensor.rows": 40}
    assert problem.constraints[0].low == pytest.approx(0.110)


def test_levels_are_told_from_what_is_searched(design_file: Write) -> None:
    for text, is_level in (
        ('key = "sources[0].leds[*].radiance_factor"\nlow = 0.1\nhigh = 1.0', True),
        ('key = "sources[0].radiance"\nlow = "1 W/m^2/sr"\nhigh = "2 W/m^2/sr"', True),
        ('key = "sources[0].leds[*].radiance_factor"\nlow = 0.0\nhigh = 1.0\nstep = 0.5', False),
        ('key = "sources[0].diameter"\nlow = "30 mm"\nhigh = "40 mm"', False),
    ):
        changed = GOOD.replace(TIME, text)
        if text.endswith("step = 0.5"):  # a scene in which no LED shines is refused, as any other choice would be
            changed = changed.replace("low = 0.0", "low = 0.5")
        assert bool(read_problem(design_file(changed)).levels) == is_level


def test_steps_end_at_the_upper_bound_and_whole_numbers_stay_whole() -> None:
    key = read_key("k", KeyModel(key="a", low="1 mm", high="2 mm", step="0.25 mm"), "here")
    assert key.labels == ("1.0 mm", "1.25 mm", "1.5 mm", "1.75 mm", "2.0 mm")
    assert read_key("k", KeyModel(key="a", low=4, high=12, step=4), "here").choices == ((4,), (8,), (12,))
    assert read_key("k", KeyModel(key="a", low=0.5, high=1.4, step=0.5), "here").choices == ((0.5,), (1.0,))
