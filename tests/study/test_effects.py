"""Effects in closed form: planted coefficients come back, and designs that are not whole are said so."""

from __future__ import annotations

import json
import tracemalloc
from collections.abc import Sequence
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from radwrap.errors import InputError
from radwrap.study.effects import Analysis, analyse, as_json, sentences
from radwrap.study.figures import figures
from radwrap.study.levels import read_data
from radwrap.study.report import cell
from radwrap.study.table import csv_text

EXACT = 1e-9  # of sums of a few numbers of order 10


Rows = list[dict[str, object]]


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
        ("A,y\n1,2\n2,x\n", "not a finite number"),
        ("A,y\n1,nan\n2,3\n", "not a finite number"),
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


def effects_of(found: Analysis) -> dict[str, float]:
    return {effect.name: effect.effect for effect in found.effects}


def noise(count: int, size: float) -> list[float]:
    return (size * np.random.default_rng(6).normal(size=count)).tolist()


def test_words_of_three_levels_do_not_blur_the_others(tmp_path: Path) -> None:
    """Unbalanced, so that t and the method hang together: y = 1 t + 10 for ellipse + 20 for gray, against edge."""
    methods = {"edge": 0, "ellipse": 10, "gray": 20}
    runs = [("gray", 0)] * 3 + [("gray", 1)] * 3 + [("ellipse", 0)] + [("ellipse", 1)] * 3 + [("edge", 1)] * 3
    rows: Rows = [
        {"M": method, "t": t, "y": methods[method] + t + e}
        for (method, t), e in zip(runs, noise(len(runs), 0.01), strict=True)
    ]
    found = analysed(tmp_path / "t.csv", rows)
    assert effects_of(found) == pytest.approx({"M=ellipse": 10, "M=gray": 20, "t": 1}, abs=0.05)
    told = as_json(found)["effects"]
    assert (told["M=gray"]["from"], told["M=gray"]["to"]) == ("edge", "gray") and told["M=gray"]["significant"]
    assert sentences(found)[0].endswith("from edge to gray.")
    # Edge was never seen at t = 0, so that the analysis of variance cannot tell what both do together, and says so.
    assert any("without Mt" in note for note in found.notes)


def with_plan(folder: Path, levels: Sequence[str], analysis: str | None = None) -> None:
    factor = {"name": "D", "label": "lens", "levels": [{"name": level} for level in levels]}
    plan = {"schema_version": 1, "design": {"factors": [factor], "analysis": analysis}}
    (folder / "plan.json").write_text(json.dumps(plan))


@pytest.mark.parametrize("backwards", [False, True])
def test_the_sign_of_an_effect_does_not_hang_on_the_order_of_rows(tmp_path: Path, backwards: bool) -> None:
    rows: Rows = [{"D": d, "y": y} for d, y in (("short", 1.0), ("long", 3.0), ("short", 1.1), ("long", 3.1))]
    rows = rows[::-1] if backwards else rows
    alone = analysed(tmp_path / "t.csv", rows).effects[0]
    assert (alone.effect, alone.start, alone.end) == (pytest.approx(-2), "long", "short")  # by the alphabet
    with_plan(tmp_path, ["short", "long"])
    planned = analysed(tmp_path / "t.csv", rows)
    effect = as_json(planned)["effects"]["D"]
    assert (effect["effect"], effect["from"], effect["to"]) == (pytest.approx(2), "short", "long")
    assert "from short to long" in sentences(planned)[0]


def test_a_failed_first_row_turns_no_sign(tmp_path: Path) -> None:
    with_plan(tmp_path, ["short", "long"])
    rows: Rows = [{"D": d, "y": y} for d, y in (("short", ""), ("long", 3.0), ("short", 1.1), ("long", 3.1))]
    assert analysed(tmp_path / "t.csv", rows).effects[0].effect == pytest.approx(1.95)


def test_equal_quantities_are_one_level(tmp_path: Path) -> None:
    cells = [("100 ms", 1, 1.0), ("0.1 s", 2, 2.1), ("200 ms", 2, 3.3), ("0.2 s", 1, 3.0)]
    rows: Rows = [{"A": a, "B": b, "y": y} for a, b, y in cells]
    found = analysed(tmp_path / "t.csv", rows)
    assert found.data.factors[0].levels == ("100 ms", "200 ms")
    assert effects_of(found)["A"] == pytest.approx((3.3 + 3.0) / 2 - (1.0 + 2.1) / 2)
    with pytest.raises(InputError, match="one level only"):
        analysed(tmp_path / "t.csv", [row for row in rows if row["A"] in ("100 ms", "0.1 s")])


def test_plackett_burman_tells_every_main_effect(tmp_path: Path) -> None:
    """12 runs, 11 factors: interactions lie across main effects, which are orthogonal for all that."""
    from pyDOE3 import pbdesign

    signs = pbdesign(11)
    rows: Rows = [
        {f"x{k}": int(sign) for k, sign in enumerate(row)} | {"y": 5 + 2 * row[0] + 3 * row[4] + e}
        for row, e in zip(signs, noise(12, 0.05), strict=True)
    ]
    found = analysed(tmp_path / "t.csv", rows)
    assert found.method == "lenth" and len(found.effects) == 11
    assert {effect.name for effect in found.effects if effect.significant} == {"x0", "x4"}
    assert effects_of(found)["x4"] == pytest.approx(6, abs=0.2)
    assert not any("not orthogonal" in note for note in found.notes)
    assert any("Plackett-Burman" in note for note in found.notes)


def test_lenths_noise_is_not_that_of_a_camera(tmp_path: Path) -> None:
    """Of predictions, which tell the error of their images, a note says what small effects stand for."""
    signs = list(product((-1, 1), repeat=3))
    rows: Rows = [
        {"a": a, "b": b, "c": c, "y": 5 + a + 0.01 * b * c + e, "y_error": 0.001}
        for (a, b, c), e in zip(signs, noise(8, 0.001), strict=True)
    ]
    predicted = analysed(tmp_path / "t.csv", rows)
    assert predicted.method == "lenth"
    assert any("without a camera's noise" in note for note in predicted.notes)
    measured = analysed(tmp_path / "u.csv", [{k: v for k, v in row.items() if k != "y_error"} for row in rows])
    assert not any("without a camera's noise" in note for note in measured.notes)


def test_a_curve_is_no_effect_of_chance(tmp_path: Path) -> None:
    """y = (t - 1)^2 at 0, 1, 2: no straight line, but far beyond the scatter of repeats, which is the noise then."""
    rows: Rows = [
        {"t": t, "y": (t - 1) ** 2 + e} for t, e in zip([0, 0, 0, 1, 1, 1, 2, 2, 2], noise(9, 1e-3), strict=True)
    ]
    found = analysed(tmp_path / "t.csv", rows)
    assert any("lack of fit" in note for note in found.notes)
    values = np.array([row["y"] for row in rows], dtype=float).reshape(3, 3)
    variance = values.var(axis=1, ddof=1).mean()  # 6 degrees of freedom
    # The slope's variance is s^2/sum (t - 1)^2 = s^2/6, and the effect over the range of 2 is twice the slope.
    assert found.standard_error == pytest.approx(2 * np.sqrt(variance / 6), rel=1e-9)
    assert any("not along a straight line" in line for line in sentences(found))
    assert not any("chance by itself" in line for line in sentences(found))


def test_an_analysis_of_variance_that_a_design_asks_for_is_made(tmp_path: Path) -> None:
    rows: Rows = [{"D": d, "y": y} for d, y in (("short", 1.0), ("long", 3.0), ("short", 1.1), ("long", 3.1))]
    for row, b in zip(rows, (0, 0, 1, 1), strict=True):
        row["y"] = float(str(row["y"])) + b
        row["B"] = b
    rows = [{"D": row["D"], "B": row["B"], "y": row["y"]} for row in rows]
    with_plan(tmp_path, ["short", "long"], "anova")
    plan = json.loads((tmp_path / "plan.json").read_text())
    plan["design"]["factors"].append({"name": "B", "label": "B", "levels": [{"name": "0"}, {"name": "1"}]})
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    found = analysed(tmp_path / "t.csv", rows)
    assert found.method == "regression" and [row.term for row in found.anova] == ["D", "B", "residual"]


def test_lenths_method_that_a_design_asks_for_takes_repeated_runs_too(tmp_path: Path) -> None:
    factors = [{"name": name, "label": name, "levels": [{"name": "-1"}, {"name": "1"}]} for name in "ABC"]
    plan = {"schema_version": 1, "design": {"factors": factors, "analysis": "lenth"}}
    rows: Rows = [
        {"A": a, "B": b, "C": c, "y": a + e}
        for (a, b, c), e in zip(list(product((-1, 1), repeat=3)) * 2, noise(16, 0.1), strict=True)
    ]
    assert analysed(tmp_path / "t.csv", rows).method == "replicates"
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    found = analysed(tmp_path / "t.csv", rows)
    assert found.method == "lenth" and found.lenth is not None and len(found.lenth.t) == 7


def test_a_label_of_no_factor_is_refused(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("A,y\n1,2\n2,3\n")
    with pytest.raises(InputError, match='no factor "Z"'):
        read_data(tmp_path / "t.csv", "y", labels={"Z": "foo"})
    assert read_data(tmp_path / "t.csv", "y", labels={"A": "foo"}).factors[0].label == "foo"


def test_labels_are_text_and_no_formulas(tmp_path: Path) -> None:
    r"""Between two dollars matplotlib reads TeX, and stops at what it does not know."""
    (tmp_path / "t.csv").write_text("A,B,y\n$\\bad$,1,2\n$\\bad$,2,2.5\nb,1,3\nb,2,3.75\n")
    data = read_data(tmp_path / "t.csv", "y", labels={"A": r"cost $\bad$ x"})
    assert set(figures(analyse(data))) == {"main_effects", "pareto", "half_normal", "interactions"}


def test_a_report_shows_seeds_with_all_digits() -> None:
    assert cell("seed", "123456789")["shown"] == "123456789"
    assert cell("mean", "88.123456789")["shown"] == "88.1235"


def test_a_factor_that_differs_from_run_to_run_takes_little_memory(tmp_path: Path) -> None:
    """A column for each of its levels would take the square of the runs: 200 MB here."""
    rows = [f"{'LH'[i % 2]},{i / 7},{i % 3}" for i in range(5000)]
    (tmp_path / "table.csv").write_text("\n".join(["A,B,y", *rows, ""]))
    data = read_data(tmp_path / "table.csv", "y")
    tracemalloc.start()
    try:
        found = analyse(data)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert "there are too few runs for an analysis of variance" in found.notes
    assert peak < 50e6
