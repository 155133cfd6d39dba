"""Figures and tables of the paper: what is exact is exact, all scripts run, and a wrong constant turns a verdict."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fig10_board
import fig12_transition
import radwrap
import replicate
import table3_focal_length
import table4_lenth
from radwrap.measure.edges.profile import disc_edge
from radwrap.study import lenth
from radwrap.validate.closed_forms.aperture import share_beyond
from replication import figure
from replication.figure import Task, carry_out
from replication.page import NAMES
from replication.published import ROOT, claims, judge, published

EDGE = ROOT / "rad_scenes" / "fig11_edge" / "scene.toml"


def verdicts(folder: Path, name: str) -> dict[str, str]:
    content = json.loads((folder / f"{name}.json").read_text())
    return {claim["id"]: claim["verdict"] for claim in content["claims"]}


def test_table_4_is_exact(tmp_path: Path) -> None:
    list(carry_out("table4", table4_lenth.make, Task(tmp_path, quick=True)))
    assert set(verdicts(tmp_path, "table4").values()) == {"reproduced"}


def test_a_changed_constant_of_lenth_turns_table_4(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lenth, "_TO_SIGMA", 1.4826)  # 1/0.6745, where Lenth rounds to 1.5
    list(carry_out("table4", table4_lenth.make, Task(tmp_path, quick=True)))
    found = verdicts(tmp_path, "table4")
    assert found["table4.f"] == found["table4.error"] == "not_reproduced"
    assert found["table4.t_limit"] == "reproduced"


def test_an_effect_significant_in_one_response_alone_turns_table_4(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = table4_lenth.printed_table()
    odd = [{**row, "error_percent": float((5 * number + 3) ** 2 % 17)} for number, row in enumerate(rows)]
    monkeypatch.setattr(table4_lenth, "printed_table", lambda: odd)
    list(carry_out("table4", table4_lenth.make, Task(tmp_path, quick=True)))
    found = verdicts(tmp_path, "table4")
    assert found["table4.f"] == "reproduced" and found["table4.significant"] == "not_reproduced"


def test_printed_effects_of_table_3_are_the_claims() -> None:
    effects = table3_focal_length.printed_effects()
    for name in ("A", "D", "AD"):
        assert judge(replace(claims("table3")[f"{name}_size"], digits=3), effects[name])[0] == "reproduced"


def test_table_3_without_a_finished_seed_says_so(tmp_path: Path) -> None:
    list(carry_out("table3", table3_focal_length.make, Task(tmp_path, quick=False, finished_only=True)))
    content = json.loads((tmp_path / "table3.json").read_text())
    found = {claim["id"]: claim for claim in content["claims"]}
    assert found["table3.percent"]["verdict"] == "reproduced"
    assert found["table3.B"]["verdict"] == "not_reproduced"
    assert found["table3.B"]["why"] == "could not be measured, over 0 seeds, the rule wants 20"
    assert len(content["not_run"]) == 2 + len(published()["variants"])


def test_an_interrupt_is_one_line(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    def make(_: Task) -> figure.Made:
        raise KeyboardInterrupt

    monkeypatch.setattr("sys.argv", ["fig05", "--out", "never"])
    monkeypatch.setattr(figure, "make_folder", lambda _: None)
    assert figure.main("fig05", make, None) == 130
    assert capsys.readouterr().err == "interrupted; the same command goes on with what is finished\n"


def test_a_quick_run_does_not_lie_down_on_the_whole() -> None:
    assert figure.default_folder(True, "figures") != figure.default_folder(False, "figures")


def test_i_min_of_fig_12_is_of_pixels_that_the_transition_does_not_touch() -> None:
    scene = radwrap.load_scene(EDGE)
    radius = float(radwrap.explain(scene)["targets"][0]["pinhole_projection_radius"])
    step = scene.camera.sensor.pixel_width / scene.camera.focal_length / radius  # at 1 m
    assert 1 + 1.5 * step < fig12_transition.NEAR


def test_percent_errors_of_table_3_are_exact_and_a_changed_focal_length_shows() -> None:
    claim = claims("table3")["percent"]
    percent = [abs(float(str(row["f [mm]"])) - 12.5) / 12.5 * 100 for row in table4_lenth.printed_table()]
    assert judge(claim, percent)[0] == "reproduced"
    assert judge(claim, [percent[0] + 0.01, *percent[1:]])[0] == "not_reproduced"


def test_eq_8_and_9_are_exact_and_a_changed_focal_length_turns_eq_8() -> None:
    edge = claims("fig12")

    def radius(focal_length: str) -> float:
        scene = radwrap.load_scene(EDGE, {"camera.focal_length": focal_length})
        return float(radwrap.explain(scene)["targets"][0]["pinhole_projection_radius"]) * 1e3

    assert judge(edge["eq8"], radius("10.59 mm"))[0] == "reproduced"
    assert judge(edge["eq8"], radius("10.60 mm"))[0] == "not_reproduced"
    s = np.linspace(-1, 1, 9)
    assert (
        judge(edge["eq9"], share_beyond(s).tolist())[0]
        == judge(edge["eq9"], disc_edge(s, 1.0).tolist())[0]
        == "reproduced"
    )


@pytest.mark.long
def test_a_smaller_pinhole_turns_the_verdict_of_fig_10(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    task = Task(tmp_path, quick=True)
    list(carry_out("fig10", fig10_board.make, task))
    assert verdicts(tmp_path, "fig10")["fig10.softer"] == "in_kind"
    predicted = fig10_board.predicted

    def smaller(scene: str, name: str, out: Path, **options: Any) -> Any:
        tiny = {"camera.aperture.diameter": "0.02 mm", "camera.exposure_time": "3250 ms"}
        return predicted(scene, name, out, **{"changes": tiny, **options})

    monkeypatch.setattr(fig10_board, "predicted", smaller)
    list(carry_out("fig10", fig10_board.make, task))
    assert verdicts(tmp_path, "fig10")["fig10.softer"] == "not_reproduced"


def test_a_table_is_the_same_again(tmp_path: Path) -> None:
    """One that renders nothing; all figures, tables and their page are long, and equal renders have tests."""
    scripts = dict(zip(NAMES, replicate.SCRIPTS, strict=True))
    made = []
    for folder in (tmp_path / "first", tmp_path / "again"):
        list(carry_out("table4", scripts["table4"].make, Task(folder, quick=True)))
        made.append(contents(folder))
    assert len(made[0]) >= 2
    assert made[0] == made[1]


@pytest.mark.long
def test_the_quick_run_makes_everything_and_the_same_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    figures, out = tmp_path / "figures of the paper", tmp_path / "page"
    monkeypatch.setattr("sys.argv", ["replicate.py", "--quick", "--figures", str(figures), "--out", str(out)])
    assert replicate.main() == 0
    told = capsys.readouterr().out
    assert all(f"{claim['id']}: " in told for claim in published()["claims"])
    spent = [json.loads(path.read_text())["timing"]["wall_s"] for path in figures.glob("*.json")]
    assert len(spent) == len(replicate.SCRIPTS)
    page = (out / "index.html").read_text()
    assert page.count("data:image/png;base64,") == len(replicate.SCRIPTS) + 1
    assert 'src="http' not in page and "quick run" in page
    assert all(one["what"] in page for one in published()["changed"])
    assert page.count(" of seeds</td>") == 11
    first = contents(figures)
    assert {"fig09_a", "table1_controlled_46"} <= {path.name for path in (figures / "renders").iterdir()}
    scripts = dict(zip(NAMES, replicate.SCRIPTS, strict=True))
    for name in ("fig08_09", "fig10", "table3", "table4"):
        list(carry_out(name, scripts[name].make, Task(figures, quick=True)))
    assert contents(figures) == first


def contents(folder: Path) -> dict[str, Any]:
    """Pictures byte by byte, JSON files without their times."""
    found: dict[str, Any] = {path.name: path.read_bytes() for path in folder.glob("*.png")}
    for path in folder.glob("*.json"):
        content = json.loads(path.read_text())
        del content["timing"]
        found[path.name] = content
    return found


def test_bad_options_are_told_in_one_line(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["table3", "--seeds", "0"])
    assert figure.main("table3", table3_focal_length.make, None) == 2
    assert capsys.readouterr().err.startswith("error: --seeds: ")
