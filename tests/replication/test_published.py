"""The file of claims: whole, and judged by its rules."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import pytest

from radwrap.errors import InputError
from radwrap.study.design import read_design
from radwrap.study.runs import check_design, runs_of
from replication.page import NAMES
from replication.published import Claim, claims, judge, published, reasons
from replication.studies import NEGATIVE, NOMINAL, design_of, toml_text

ALL = [claim for name in NAMES for claim in claims(name).values()]
EXACT = Claim("x.a", "x", "p", "c", "exact", "m", printed=[1.25, -3.0], digits=2)
IN_KIND = Claim("x.b", "x", "p", "c", "in_kind", "m", holds=(0.8, 1.0), reproduced=(0.9, 0.95))


def test_every_claim_is_whole_and_belongs_to_a_script() -> None:
    assert len(ALL) == len(published()["claims"]) == len({claim.id for claim in ALL})
    for claim in ALL:
        assert claim.place and claim.claim and claim.measure, claim.id
        assert (claim.digits is None) != (claim.holds is None and claim.reproduced is None), claim.id
        assert claim.digits is None or claim.printed is not None, claim.id
        assert (claim.kind == "exact") == (claim.holds is None), claim.id
        for interval in (claim.holds, claim.reproduced):
            assert interval is None or interval[0] <= interval[1], claim.id


def test_every_reason_is_of_a_claim() -> None:
    assert set(reasons()) <= {claim.id for claim in ALL}
    assert all(reasons().values())


@pytest.mark.parametrize(
    ("ours", "verdict"),
    [
        ([1.2549, -3.0049], "reproduced"),
        ([1.2551, -3.0], "not_reproduced"),  # rounds to 1.26
        ([1.25], "not_reproduced"),
        ([math.nan, -3.0], "not_reproduced"),
        (None, "not_reproduced"),
    ],
)
def test_digits(ours: list[float] | None, verdict: str) -> None:
    assert judge(EXACT, ours)[0] == verdict


@pytest.mark.parametrize(
    ("ours", "error", "verdict", "why"),
    [
        (0.92, 0.01, "reproduced", "lies within 0.9 to 0.95"),
        (0.92, 0.04, "in_kind", "lies within 0.8 to 1"),
        (0.92, 0.2, "not_reproduced", "its error leaves 0.8 to 1"),
        (0.7, 0.0, "not_reproduced", "lies outside 0.8 to 1"),
        (0.92, math.inf, "not_reproduced", "its error leaves 0.8 to 1"),
    ],
)
def test_intervals(ours: float, error: float, verdict: str, why: str) -> None:
    assert judge(IN_KIND, ours, error) == (verdict, why)


def test_minus_zero_is_zero() -> None:
    assert judge(replace(EXACT, printed=[0.0]), [-1e-9])[0] == "reproduced"


@pytest.mark.parametrize(
    ("changed", "told"),
    [({"measure": None}, "claims[0].measure: is missing"), ({"holding": 1}, "claims[0].holding: is unknown")],
)
def test_a_wrong_key_of_a_claim_is_told(changed: dict[str, object], told: str, monkeypatch: pytest.MonkeyPatch) -> None:
    first = {key: value for key, value in (published()["claims"][0] | changed).items() if value is not None}
    monkeypatch.setattr("replication.published.published", lambda: {"claims": [first]})
    with pytest.raises(InputError, match=re.escape(told)):
        claims("fig05")


def test_what_was_changed_after_the_first_run_is_told() -> None:
    assert all(set(one) == {"what", "why", "effect"} and all(one.values()) for one in published()["changed"])


def test_open_intervals_are_told_as_bounds() -> None:
    assert judge(replace(IN_KIND, holds=(1.5, math.inf), reproduced=None), 1.0)[1] == "lies outside at least 1.5"
    assert judge(replace(IN_KIND, holds=(-math.inf, 0.5), reproduced=None), 0.25)[1] == "lies within at most 0.5"


@pytest.mark.parametrize(
    "variant",
    [NOMINAL, NEGATIVE]
    + [
        pytest.param(variant, marks=[pytest.mark.long] if number % 3 else [])
        for number, variant in enumerate(published()["variants"])
    ],
    ids=lambda variant: variant["name"],
)
def test_every_variant_is_a_design_that_can_run(variant: dict[str, object], tmp_path: Path) -> None:
    path = tmp_path / "design.toml"
    path.write_text(toml_text(design_of(variant, 3, tmp_path)), "utf-8")
    design = read_design(path)
    check_design(design, {})
    runs = runs_of(design)
    assert len(runs) == 16
    assert {run.seed for run in runs} == {3}
    assert design.responses[0].options["method"] == "gray"


def test_a_variant_changes_the_scenes_it_names() -> None:
    nominal = design_of(NOMINAL, 1, Path("/x"))
    for variant in (NEGATIVE, *published()["variants"]):
        changed = design_of(variant, 1, Path("/x"))
        assert {key for key in nominal if nominal[key] != changed[key]} - {"title"}, variant["name"]
