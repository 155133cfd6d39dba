"""Claims of the paper with the rules of their verdicts, as rad_scenes/published.toml holds them."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any, Final, Literal

from radwrap.errors import InputError

ROOT: Final = Path(__file__).resolve().parents[2]
PUBLISHED: Final = ROOT / "rad_scenes" / "published.toml"
REASONS: Final = Path(__file__).with_name("reasons.toml")

Verdict = Literal["reproduced", "in_kind", "not_reproduced"]
Interval = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Claim:
    """A sentence or a number of the paper.

    Attributes
    ----------
    id, figure, place, claim, measure : str
        Which, of which script, where in print, what it says, what ours is.
    kind : str
        "exact" or "in_kind".
    printed : float, sequence of float or None
        As printed.
    unit, doubt : str
        Empty where there is none.
    digits : int or None
        Decimals to which ours must agree.
    reproduced, holds : tuple of float or None
        Intervals in which ours with its error must lie.
    """

    id: str
    figure: str
    place: str
    claim: str
    kind: Literal["exact", "in_kind"]
    measure: str
    printed: float | Sequence[float] | None = None
    unit: str = ""
    doubt: str = ""
    digits: int | None = None
    reproduced: Interval | None = None
    holds: Interval | None = None


@cache
def published() -> Mapping[str, Any]:
    """The file's tables."""
    return tomllib.loads(PUBLISHED.read_text("utf-8"))


@cache
def reasons() -> Mapping[str, str]:
    """What experiments told of claims that are not reproduced: id -> text."""
    tables = tomllib.loads(REASONS.read_text("utf-8"))["reasons"]
    return {claim: table["found"] for table in tables for claim in table["claims"]}


def claims(figure: str) -> dict[str, Claim]:
    """Claims of a figure or table, by what stands behind the point of their id."""
    found = [_claim(number, table) for number, table in enumerate(published()["claims"])]
    return {claim.id.partition(".")[2]: claim for claim in found if claim.figure == figure}


def _claim(number: int, table: Mapping[str, Any]) -> Claim:
    required = {field.name for field in fields(Claim) if field.default is MISSING}
    for wrong, what in ((required - set(table), "is missing"), (set(table) - set(Claim.__slots__), "is unknown")):
        if wrong:
            where = f"{PUBLISHED}: claims[{number}].{min(wrong)}"
            raise InputError(what, where=where, remedy=f"the claim is {table.get('id', 'not named')}")
    return Claim(**{**table, **_intervals(table)})


def _intervals(table: Mapping[str, Any]) -> dict[str, Interval]:
    return {name: (table[name][0], table[name][1]) for name in ("holds", "reproduced") if name in table}


def judge(claim: Claim, ours: float | Sequence[float] | None, error: float = 0.0) -> tuple[Verdict, str]:
    """Verdict by the claim's rule, and the reason in words; None is what could not be measured."""
    if ours is None or not all(math.isfinite(number) for number in _listed(ours)):
        return "not_reproduced", "could not be measured"
    if claim.digits is not None:
        return _by_digits(claim, _listed(ours))
    value = _listed(ours)[0]
    if claim.reproduced is not None and _within(value, error, claim.reproduced):
        return "reproduced", f"lies within {_told(claim.reproduced)}"
    if claim.holds is not None and _within(value, error, claim.holds):
        return "in_kind", f"lies within {_told(claim.holds)}"
    wanted = claim.holds or claim.reproduced
    assert wanted is not None  # noqa: S101  (a claim has one rule at least; a test reads the file)
    inside = wanted[0] <= value <= wanted[1]
    return "not_reproduced", f"{'its error leaves' if inside else 'lies outside'} {_told(wanted)}"


def _by_digits(claim: Claim, ours: Sequence[float]) -> tuple[Verdict, str]:
    printed = _listed(claim.printed)
    if len(printed) != len(ours):
        return "not_reproduced", f"{len(ours)} numbers for {len(printed)}"
    digits = claim.digits or 0
    same = [round(a, digits) == round(b, digits) for a, b in zip(ours, printed, strict=True)]
    if all(same):
        return "reproduced", f"agrees to the printed digits ({len(same)} of {len(same)})"
    return "not_reproduced", f"{sum(same)} of {len(same)} agree to the printed digits"


def _listed(values: Any) -> list[float]:
    return [float(value) for value in (values if isinstance(values, list | tuple) else [values])]


def _within(value: float, error: float, interval: Interval) -> bool:
    return interval[0] <= value - error and value + error <= interval[1]


def _told(interval: Interval) -> str:
    low, high = interval
    if math.isinf(low):
        return f"at most {high:g}"
    return f"at least {low:g}" if math.isinf(high) else f"{low:g} to {high:g}"
