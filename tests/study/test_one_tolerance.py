"""One tolerance for all runs of a study, in gray levels."""

from __future__ import annotations

import json

import pytest

from radwrap.study.design import read_design
from radwrap.study.one_tolerance import with_one_tolerance
from radwrap.study.runs import runs_of
from tests.cli.conftest import here
from tests.study.conftest import DesignWriter

TWO = """
analysis = "none"
[set]
"camera.sensor" = { model = "linear", rows = 20, columns = 24, pixel_width = "110 um", pixel_height = "132 um", \
bit_depth = 12, wavelength = "650 nm", quantum_efficiency = 0.5, system_gain = "0.3 DN/e", offset = 64, \
full_well = "12 ke", read_noise = "5 e" }
[design]
kind = "full"
"""
EXPOSURES = """
[factors.exposure]
key = "camera.exposure_time"
levels = ["0.005 ms", "0.02 ms"]
"""
DEPTHS = """
[factors.depth]
key = "camera.sensor.bit_depth"
levels = [12, 10]
"""


@pytest.mark.long
@pytest.mark.usefixtures("one_process")
def test_all_runs_keep_that_of_the_scene_of_the_design(
    design: DesignWriter, capsys: pytest.CaptureFixture[str]
) -> None:
    path = design(TWO + EXPOSURES)
    told = here(["study", "run", path, "--out", path.parent / "out", "--json"], capsys).json
    assert told["failed"] == 0
    plan = json.loads((path.parent / "out" / "plan.json").read_text())
    tolerance = plan["design"]["render"]["tolerance"]
    assert plan["tolerance_asked"]["asked"] == "default"
    assert tolerance >= 8.0  # 4095 x 0.5/255
    assert [kind["render"]["tolerance"] for kind in told["sampling"]] == [tolerance]
    again = here(["study", "run", path, "--out", path.parent / "out", "--json"], capsys).json
    assert {**again, "timing": 0} == {**told, "timing": 0}


def test_of_several_cameras_it_is_the_least(design: DesignWriter) -> None:
    told = read_design(design(TWO + DEPTHS))
    resolved, asked = with_one_tolerance(told, runs_of(told), {})
    assert asked is not None and asked.asked == "default"
    # Ten bits cannot hold this full well: their range ends at 1023.
    assert resolved.render["tolerance"] >= 2.0  # 1023 x 0.5/255
    share = read_design(design(TWO.replace("[set]", '[render]\ntolerance = "1 %"\n[set]') + DEPTHS))
    resolved, asked = with_one_tolerance(share, runs_of(share), {})
    assert resolved.render["tolerance"] == 9.5  # of 1023 - 64, rounded down
    assert asked is not None and (asked.asked, asked.rays) == ("1 %", 0)


def test_gray_levels_and_power_laws_stay_as_they_are(design: DesignWriter) -> None:
    for text in (
        TWO.replace("[set]", "[render]\ntolerance = 3.0\n[set]"),
        'analysis = "none"\n[design]\nkind = "full"\n',
    ):
        told = read_design(design(text + EXPOSURES))
        assert with_one_tolerance(told, runs_of(told), {}) == (told, None)
