"""``radwrap validate`` as users run it: a case that misses is a miss, the report is whole, names are checked."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from radwrap.errors import InputError
from radwrap.validate import runner
from radwrap.validate.case import Case, Check, Missing
from radwrap.validate.runner import CHECKS, SECTIONS, chosen
from tests.cli.conftest import here


def test_every_section_has_cases_and_every_case_one_name() -> None:
    names = [case for check in CHECKS for case in check.cases]
    assert len(set(names)) == len(names)
    assert {int(name.split(".")[0]) for name in names} == set(SECTIONS)
    for check in CHECKS:
        assert all(case.split(".")[0] == check.name.split(".")[0] for case in check.cases)


@pytest.mark.long
def test_lamps_pass_and_the_report_is_whole(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "a card"
    done = here(["validate", "--only", "1", "--only", "2.point_source", "--json", "--out", out], capsys).success()
    cases = {case["name"]: case for case in done.json["cases"]}
    floor = {f"2.point_source_{distance}_m" for distance in range(6)}
    assert set(cases) == {"1.lambertian_100_lm", "1.isotropic_100_lm", "1.lambertian_flux", *floor}
    lamp = cases["1.lambertian_100_lm"]
    assert (lamp["reference"], lamp["pass"]) == (31.831, True)
    assert 0 < lamp["error"] < lamp["limit"]
    assert {"name", "source", "reference", "ours", "error", "limit", "pass"} <= set(lamp)
    assert json.loads((out / "validate.json").read_bytes()) == done.json
    page = (out / "index.html").read_text("utf-8")
    assert page.endswith("</html>\n") and "data:image/png;base64," in page and "http" not in page.split("<body>")[1]


@pytest.fixture
def _three_checks(monkeypatch: pytest.MonkeyPatch) -> None:
    def off(bench: Any) -> Iterator[Case]:
        yield Case("1.off", "by hand", 1.0, 1.02, 0.01)
        yield Case("1.good", "by hand", 1.0, 1.005, 0.01)

    def absent(bench: Any) -> Iterator[Case]:
        yield Case("2.first", "by hand", 1.0, 1.0, 0.01)
        raise Missing("a feature")

    def broken(bench: Any) -> Iterator[Case]:
        yield Case("3.nan", "by hand", 1.0, float("nan"), 0.01)
        raise ZeroDivisionError("nothing")

    checks = (
        Check("1.off", ("1.off", "1.good"), off),
        Check("2.absent", ("2.first", "2.second"), absent),
        Check("3.broken", ("3.nan", "3.rest"), broken),
    )
    monkeypatch.setattr(runner, "CHECKS", checks)


@pytest.mark.usefixtures("_three_checks")
def test_what_is_off_missing_or_broken_is_a_miss(capsys: pytest.CaptureFixture[str]) -> None:
    done = here(["validate", "--json"], capsys)
    assert done.code == 1
    verdicts = {case["name"]: case["pass"] for case in done.json["cases"]}
    passing = {"1.good", "2.first"}
    assert verdicts == {name: name in passing for name in ("1.off", "1.good", "2.first", "2.second", "3.nan", "3.rest")}
    notes = {case["name"]: case.get("note", "") for case in done.json["cases"]}
    assert notes["2.second"] == "missing: a feature"
    assert "ZeroDivisionError" in notes["3.rest"]
    assert done.json["missed"] == 4
    assert here(["validate", "--only", "1.good"], capsys).code == 0


def test_a_name_that_is_none_is_told() -> None:
    with pytest.raises(InputError, match="there is no"):
        chosen(["9"])
    assert [check.name for check in chosen(["4.merge_linear"])] == ["4.merging"]


def test_without_radiance_it_is_the_environment(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert here(["validate", "--only", "1.lamps", "--radiance", tmp_path], capsys).code == 4


def test_numbers_of_numpy_are_numbers_of_json() -> None:
    case = Case("1.numpy", "by hand", 1.0, np.float64(1.001), 0.01)
    assert json.loads(json.dumps(case.as_json()))["pass"] is True


def test_extremes_are_on_the_card(capsys: pytest.CaptureFixture[str]) -> None:
    asked = ("10.levels", "10.refusals")
    done = here(["validate", "--json", *(word for name in asked for word in ("--only", name))], capsys).success()
    names = [name for check in CHECKS if check.name in asked for name in check.cases]
    assert [case["name"] for case in done.json["cases"]] == names
    assert all(case["pass"] for case in done.json["cases"])
