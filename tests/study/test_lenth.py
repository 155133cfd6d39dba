"""Lenth's method: the paper's Table 4 from its Table 3, to the printed digits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from radwrap.errors import InputError
from radwrap.study.effects import analyse, as_json, sentences
from radwrap.study.lenth import lenth, pseudo_standard_error
from radwrap.study.levels import read_data
from radwrap.study.table import csv_text, read_table

TABLE3 = Path(__file__).parents[2] / "rad_scenes" / "study_table2" / "table3.csv"
NOMINAL = 12.5  # mm, against which the errors of Table 3 are taken

# Table 4 as printed, in its order: t of f and of the absolute percent error.
TABLE4 = {
    "A": ("-5.91", "5.02"),
    "B": ("1.58", "-1.32"),
    "C": ("-0.21", "-0.33"),
    "D": ("5.15", "-3.83"),
    "AB": ("-0.47", "-0.82"),
    "AC": ("-0.96", "0.21"),
    "AD": ("5.42", "-4.34"),
    "BC": ("-0.26", "0.75"),
    "BD": ("-1.84", "1.06"),
    "CD": ("-0.26", "-0.16"),
    "ABC": ("0.48", "0.21"),
    "ABD": ("-2.28", "1.42"),
    "ACD": ("-1.54", "0.58"),
    "BCD": ("-0.13", "0.76"),
    "ABCD": ("0.85", "-0.24"),
}
ROUNDING = 1e-12  # of sixteen sums in double precision


@pytest.fixture
def both(tmp_path: Path) -> Path:
    """Table 3 with the errors computed from f: the printed ones are rounded, which changes two entries of Table 4."""
    rows = [
        {**row, "error_percent": abs(float(row["f [mm]"]) - NOMINAL) / NOMINAL * 100} for row in read_table(TABLE3).rows
    ]
    path = tmp_path / "both.csv"
    path.write_text(csv_text(("A", "B", "C", "D", "f [mm]", "error_percent"), rows))
    return path


@pytest.mark.parametrize(("response", "column", "pse"), [("f", 0, 0.1003125), ("error_percent", 1, 0.9090)])
def test_table_4_follows_from_table_3(both: Path, response: str, column: int, pse: float) -> None:
    found = as_json(analyse(read_data(both, response, ["A", "B", "C", "D"])))
    assert list(found["effects"]) == list(TABLE4)
    assert {name: f"{effect['t']:.2f}" for name, effect in found["effects"].items()} == {
        name: printed[column] for name, printed in TABLE4.items()
    }
    assert found["pse"] == pytest.approx(pse, rel=1e-9)
    assert found["t_limit"] == pytest.approx(2.5706, abs=5e-5)  # t(0.975; 5)
    assert [name for name, effect in found["effects"].items() if effect["significant"]] == ["A", "D", "AD"]


def test_the_designers_sentence() -> None:
    data = read_data(TABLE3, "f", labels={"A": "ring misalignment"})
    assert sentences(analyse(data))[0] == "Ring misalignment (A) moves f by -0.59 +- 0.26 mm, from L to H."


def test_levels_may_be_words_numbers_or_quantities(tmp_path: Path) -> None:
    expected = as_json(analyse(read_data(TABLE3, "f")))["effects"]
    for low, high in (("low", "high"), ("-1", "1"), ("2324", "2672.6"), ("900 um", "1.2 mm")):
        rows = [
            {key: {"L": low, "H": high}.get(value, value) for key, value in row.items()}
            for row in read_table(TABLE3).rows
        ]
        path = tmp_path / "words.csv"
        # Backwards, so that the first level that is met is the high one.
        path.write_text(csv_text(("A", "B", "C", "D", "f [mm]"), rows[::-1]))
        found = as_json(analyse(read_data(path, "f")))["effects"]
        for name, effect in expected.items():
            assert found[name]["effect"] == pytest.approx(effect["effect"], abs=ROUNDING)


def test_pse_by_hand() -> None:
    # |c| = 1 ... 8 and 100: s0 = 1.5 x 5 = 7.5, all but 100 lie below 18.75, their median is 4.5.
    contrasts = np.array([1.0, -2, 3, -4, 5, -6, 7, -8, 100])
    assert float(pseudo_standard_error(contrasts)) == 1.5 * 4.5


def test_simulated_limits_hold_their_false_alarm_rate() -> None:
    """Fresh noise: 5 % of single contrasts, and in 5 % of designs any of them, exceed the limits."""
    found = lenth(np.arange(1.0, 16.0))
    assert found.simulated_limit == pytest.approx(2.16, abs=0.03)  # ERRATA: individual 5 % limit about 2.16
    assert found.simulated_limit_simultaneous == pytest.approx(4.24, abs=0.1)
    noise = np.random.default_rng(5).standard_normal((20_000, 15))
    ratios = np.abs(noise) / pseudo_standard_error(noise)[:, np.newaxis]
    assert (ratios > found.simulated_limit).mean() == pytest.approx(0.05, abs=0.004)  # 300 000, correlated by design
    assert (ratios.max(axis=1) > found.simulated_limit_simultaneous).mean() == pytest.approx(0.05, abs=0.008)
    # What the paper's limit really does (ERRATA): 2.9 % and 24.6 %.
    assert (ratios > found.t_limit).mean() == pytest.approx(0.029, abs=0.003)
    assert (ratios.max(axis=1) > found.t_limit).mean() == pytest.approx(0.246, abs=0.015)


@pytest.mark.parametrize("contrasts", [[1.0, 2.0, 3.0], [0.0] * 15, [float("nan")] * 15])
def test_what_lenth_cannot_judge_is_refused(contrasts: list[float]) -> None:
    with pytest.raises(InputError):
        lenth(contrasts)
