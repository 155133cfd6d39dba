"""Effects in closed form: planted coefficients come back, and designs that are not whole are said so."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pytest

from radwrap.errors import InputError
from radwrap.study.effects import Analysis, analyse, as_json
from radwrap.study.levels import read_data
from radwrap.study.table import csv_text

EXACT = 1e-9  # of sums of a few numbers of order 10


def analysed(path: Path, rows: list[dict[str, object]], response: str = "y") -> Analysis:
    path.write_text(csv_text(tuple(rows[0]), rows))
    return analyse(read_data(path, response))


def test_planted_effects_of_a_fraction_are_told_with_their_aliases(tmp_path: Path) -> None:
    """2^(4-1), D = ABC: AB and CD cannot be told apart, and their sum is what is found."""
    rows = [
        {"A": a, "B": b, "C": c, "D": a * b * c, "y": 10 + 3 * a - b + 0.5 * a * b + 0.25 * c * (a * b * c)}
        for a, b, c in product((-1, 1), repeat=3)
    ]
    found = analysed(tmp_path / "t.csv", rows)
    effects = {effect.name: effect for effect in found.effects}
    assert effects["A"].effect == pytest.approx(6, abs=EXACT)
    assert effects["B"].effect == pytest.approx(-2, abs=EXACT)
    assert effects["AB"].effect == pytest.approx(1.5, abs=EXACT)
    assert effects["AB"].aliases == ("CD",)
    assert len(effects) == 7
    assert any("not complete: 8 of 16" in note for note in found.notes)


def test_replicates_tell_the_noise(tmp_path: Path) -> None:
    """t of an effect is its size over 2 s/sqrt(N), F of the analysis of variance its square."""
    random = np.random.default_rng(3)
    rows: list[dict[str, object]] = [
        {"A": a, "B": b, "y": 5 + 2 * a + float(random.normal(0, 0.1))}
        for _ in range(6)
        for a, b in product((0, 1), (0, 1))
    ]
    found = analysed(tmp_path / "t.csv", rows)
    told = as_json(found)
    groups = {key: [row["y"] for row in rows if (row["A"], row["B"]) == key] for key in product((0, 1), (0, 1))}
    variance = float(np.mean([np.var(group, ddof=1) for group in groups.values()]))
    effect = told["effects"]["A"]
    assert effect["effect"] == pytest.approx(2, abs=0.2)  # 5 sigma of 0.1 x 2/sqrt(24)
    assert effect["t"] == pytest.approx(effect["effect"] / (2 * np.sqrt(variance / 24)), rel=1e-9)
    anova = {row["term"]: row for row in told["anova"]}
    assert anova["A"]["f"] == pytest.approx(effect["t"] ** 2, rel=1e-6)
    assert anova["residual"]["degrees_of_freedom"] == 20
    assert effect["significant"] and not told["effects"]["B"]["significant"]


def test_a_latin_hypercube_gives_the_planted_slopes(tmp_path: Path) -> None:
    random = np.random.default_rng(4)
    rows: list[dict[str, object]] = []
    for x, y in random.random((20, 2)):
        rows.append({"A": f"{100 + 100 * x} ms", "B": y, "y": 7 + 3 * x - 2 * y + float(random.normal(0, 1e-6))})
    found = analysed(tmp_path / "t.csv", rows)
    values = [(float(str(row["A"]).split()[0]) - 100) / 100 for row in rows]
    assert found.method == "regression"
    assert found.effects[0].effect == pytest.approx(3 * (max(values) - min(values)), abs=1e-4)
    assert found.effects[0].significant


def test_a_missing_run_is_said_and_the_rest_is_fitted(tmp_path: Path) -> None:
    rows: list[dict[str, object]] = [
        {"A": a, "B": b, "C": c, "y": 1 + a + 2 * b} for a, b, c in product((-1, 1), repeat=3)
    ]
    rows[3]["y"] = ""
    found = analysed(tmp_path / "t.csv", rows)
    assert {effect.name: round(effect.effect, 9) for effect in found.effects} == {"A": 2.0, "B": 4.0, "C": 0.0}
    text = " ".join(found.notes)
    assert "1 rows have no response" in text and "not complete" in text and "not orthogonal" in text


def test_image_errors_are_carried_into_effects(tmp_path: Path) -> None:
    """Error of a difference of two means of four values with independent errors of 0.3 each: 0.3/sqrt(2)."""
    rows: list[dict[str, object]] = [
        {"A": a, "B": b, "C": c, "y [mm]": float(a), "y_error [mm]": 0.3} for a, b, c in product((-1, 1), repeat=3)
    ]
    found = analysed(tmp_path / "t.csv", rows)
    assert found.effects[0].image_error == pytest.approx(0.3 / np.sqrt(2), rel=1e-12)
    assert found.data.unit == "mm"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("A,y\n1,2\n1,3\n", "one level only"),
        ("A,y\n1,2\n2,x\n", "no finite number"),
        ("A,y\n1,nan\n2,3\n", "no finite number"),
        ("A,z\n1,2\n2,3\n", 'no column "y"'),
        ("A,y\n1,2\n2,2\n", "same in all runs"),
        ("A,y\n1,2\n2\n", "cells"),
        ("", "header"),
    ],
)
def test_bad_tables_are_refused(tmp_path: Path, text: str, complaint: str) -> None:
    path = tmp_path / "t.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=complaint):
        analyse(read_data(path, "y"))
