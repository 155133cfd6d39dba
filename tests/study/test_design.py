"""Designs: what they expand to, and what is refused before the first ray."""

from __future__ import annotations

import json
import socket
from pathlib import Path

import numpy as np
import pytest

from radwrap.errors import EnvironmentFailure, InputError
from radwrap.manifest import STUDY_PACKAGES, versions
from radwrap.study import pool
from radwrap.study.design import Design, read_design
from radwrap.study.light import reference_levels, split_light, with_levels
from radwrap.study.runs import Run, check_design, runs_of
from radwrap.study.study import StudyOptions, plan_steps, take_possession
from tests.cli.conftest import here, scene_text
from tests.study.conftest import EDGE, RESPONSES, SMALL, DesignWriter

TABLE2 = Path(__file__).parents[2] / "rad_scenes" / "study_table2" / "design.toml"


def expanded(path: Path) -> tuple[Design, tuple[Run, ...]]:
    design = read_design(path)
    check_design(design, {})
    return design, runs_of(design)


def test_table_2_is_sixteen_runs_in_the_order_of_table_3() -> None:
    _, runs = expanded(TABLE2)
    assert ["".join(level.name for level in run.levels) for run in runs] == [
        a + b + c + d for a in "LH" for b in "LH" for c in "LH" for d in "LH"
    ]
    ring = runs[-1].document["sources"][0]
    assert ring["misalignment"] == {"about_y": "1.2 deg", "about_z": "-85 deg"}
    factors = [led["radiance_factor"] for led in ring["leds"]]
    assert len(set(factors)) == 12 and all(0.85 <= factor <= 1.15 for factor in factors)
    assert all(0.1 <= float(led["axis_tilt"].split()[0]) <= 1.9 for led in ring["leds"])
    assert all(
        "radiance_factor" in led and led["radiance_factor"] == 1.0 for led in runs[0].document["sources"][0]["leds"]
    )


def test_draws_are_uniform_and_each_run_has_its_own(design: DesignWriter) -> None:
    text = SMALL.replace("seed = 5", "seed = 5\nreplicates = 100")
    _, runs = expanded(design(text))
    drawn = np.array(
        [
            [led["beam_width_factor"] for led in run.document["sources"][0]["leds"]]
            for run in runs
            if run.levels[1].name == "H"
        ]
    )
    assert drawn.shape == (200, 3) and len(np.unique(drawn)) == drawn.size
    # Mean and standard deviation of a uniform draw, 600 of them: within 4 standard errors.
    sigma = 0.2 / np.sqrt(12)
    assert drawn.mean() == pytest.approx(1.0, abs=4 * sigma / np.sqrt(600))
    assert drawn.std() == pytest.approx(sigma, rel=0.1)


def test_draws_once_are_shared_by_the_runs_of_a_replicate(design: DesignWriter) -> None:
    text = SMALL.replace("seed = 5", "seed = 5\nreplicates = 2") + 'draws = "once"\n'
    _, runs = expanded(design(text))
    drawn = [run.document["sources"][0]["leds"] for run in runs if run.levels[1].name == "H"]
    assert drawn[0] == drawn[1] and drawn[2] == drawn[3] and drawn[0] != drawn[2]


def test_a_latin_hypercube_has_one_run_in_each_part_of_each_range(design: DesignWriter) -> None:
    text = """
[design]
kind = "latin_hypercube"
runs = 10
[factors.x]
key = "targets[0].edge_position"
range = ["1 mm", "2 mm"]
[factors.t]
key = "camera.exposure_time"
range = ["50 ms", "100 ms"]
"""
    _, runs = expanded(design(text))
    for factor, (low, size) in enumerate(((1, 1), (50, 50))):
        shares = [(float(run.levels[factor].name.split()[0]) - low) / size for run in runs]
        assert sorted(int(10 * share) for share in shares) == list(range(10))


def test_a_fraction_and_a_list(design: DesignWriter) -> None:
    three = SMALL + '[factors.t]\nkey = "camera.exposure_time"\nlevels = ["50 ms", "100 ms"]\n'
    _, runs = expanded(design(three.replace('kind = "full"', 'kind = "fractional"\ngenerators = "a b ab"')))
    signs = np.array(
        [
            [1 if level is factor else -1 for level, factor in zip(run.levels, runs[-1].levels, strict=True)]
            for run in runs
        ]
    )
    assert len(runs) == 4 and (signs.prod(axis=1) == 1).all()
    _, runs = expanded(design(SMALL.replace('kind = "full"', 'kind = "list"\nruns = [["2 mm", "L"], ["1 mm", "H"]]')))
    assert [[level.name for level in run.levels] for run in runs] == [["2 mm", "L"], ["1 mm", "H"]]


def test_runs_that_differ_only_in_the_algorithm_share_one_render(design: DesignWriter, tmp_path: Path) -> None:
    path = design(
        """
analysis = "none"
[design]
kind = "full"
[factors.gamma]
key = "responses.u.gamma"
levels = [0.8, 1.0, "sensor"]
"""
    )
    study, runs = expanded(path)
    steps, made = plan_steps(study, runs, tmp_path, StudyOptions())
    assert len({run.image for run in runs}) == 1 and made.renders == 1
    assert [step.after for step in steps] == [None, "run1", "run1"]


def test_levels_of_sources_are_split_off_and_put_back(design: DesignWriter) -> None:
    _, runs = expanded(design(SMALL.replace("beam_width_factor", "radiance_factor")))
    bare, levels = split_light(runs[1].document)
    other, _ = split_light(runs[0].document)
    assert bare == other and list(levels) == ["ring.led00", "ring.led01", "ring.led02"]
    again = split_light(with_levels(bare, levels))[1]
    assert again == pytest.approx(levels, rel=1e-15)
    # The brightest of the runs is as bright as the reference, and no source is dark in it that one run needs.
    reference = reference_levels([{"a": 1.0, "b": 0.0}, {"a": 0.0, "b": 3.0}])
    assert reference == {"a": 0.75, "b": 2.25}


ANOVA_OF_TWO = 'analysis = "anova"\n[design]\nkind = "list"\nruns = [["1 mm", "L"], ["2 mm", "H"]]'

LED = "sources[0].leds[0].beam_width_factor"

BAD = [
    ('key = "targets[0].edge_position"', 'key = "targets[0].place"', "unknown key"),
    ('key = "targets[0].edge_position"', 'key = "targets[7].edge_position"', "no such place"),
    ('["1 mm", "2 mm"]', '["1 mm", "2 deg"]', "not a unit of length"),
    ('["1 mm", "2 mm"]', "[1, 2]", "has no unit"),
    ('["1 mm", "2 mm"]', '["1 mm", "900 mm"]', "outside the target"),
    ('["1 mm", "2 mm"]', '["1 mm"]', "two or more"),
    ('["1 mm", "2 mm"]', '["1 mm", "1 mm"]', "two or more different"),
    ("[0.9, 1.1]", "[-0.5, 1.1]", "must be above 0"),
    ("[0.9, 1.1]", "[1.1, 0.9]", "lower value first"),
    ("[0.9, 1.1]", '[0.9, "1.1 mm"]', "same unit"),
    ("uniform", "cauchy", "not a draw"),
    ('kind = "full"', 'kind = "latin"', "design.kind: 'latin' is not one of 'full', 'fractional'"),
    ('kind = "full"', 'kind = "fractional"\ngenerators = "a"', "1 generators for 2 factors"),
    ('kind = "full"', 'kind = "list"\nruns = [["3 mm", "L"]]', "no level"),
    ('analysis = "none"', "", "too few for Lenth"),
    ('analysis = "none"', 'analysis = "magic"', "must be"),
    ('analysis = "none"\nseed = 5\n[design]\nkind = "full"', ANOVA_OF_TWO, "too few for an analysis of variance"),
    ("seed = 5", "seed = -5", "whole number"),
    ("seed = 5", "sead = 5", "unknown key"),
    ("seed = 5", "replicates = 0", "whole number"),
    ("seed = 5", "[render]\ntolerance = 0.0", "must lie between"),
    ("seed = 5", "[render]\nspeed = 3", "unknown"),
    ('key = "targets[0].edge_position"', 'key = "responses.z.gamma"', 'no response "z"'),
    ('key = "targets[0].edge_position"', 'key = "responses.u.gama"', "unknown option"),
    ('key = "targets[0].edge_position"', 'key = "render.tolerance"', "tolerance: must be gray levels, so that levels"),
    ("label = ", "lable = ", 'unknown key; did you mean "label"?'),
    ('key = "targets[0].edge_position"', "keys = []", "keys: must have at least 1"),
    ('key = "targets[0].edge_position"', "key = 3", "key: must be a string, not 3"),
    ('["1 mm", "2 mm"]', '["1 mm", "2 mm"]\nrange = [1, 2]', "exactly one of levels and range, not 2"),
    ("seed = 5", "seed = true", "whole number"),
    ("seed = 5", "set = 3", "set: must be a table, not 3"),
    ('kind = "full"', 'kind = ["full"]', "is not one of 'full', 'fractional'"),
    ('kind = "full"', 'kind = "fractional"', "design.generators: is missing"),
    ('kind = "full"', 'kind = "full"\nruns = 3', "design.runs: unknown key"),
    ('kind = "full"', 'kind = "latin_hypercube"\nruns = 1', "design.runs: must be a whole number from 2"),
    ("seed = 5", '[render]\nmethod = "magic"', "render.method: 'magic' is not one of 'pinhole'"),
    ("seed = 5", '[render]\nbasis = "yes"', "render.basis: must be true or false"),
    ("[0.9, 1.1]", f"[0.9, 1{'0' * 400}]", "more than 64 bits"),
    ("[0.9, 1.1]", "[0.9, inf]", "not a number that a computer holds"),
    ("{ L = 1.0, H", '{ "" = 1.0, H', "cannot name a level"),
    ("{ L = 1.0, H", '{ " H" = 1.0, H', "cannot name a level"),
    ("seed = 5", f"[render]\ntolerance = 1{'0' * 400}", "more than 64 bits"),
    ('["1 mm", "2 mm"]', f"[1{'0' * 400}, 2]", "more than 64 bits"),
    *(
        ('key = "targets[0].edge_position"\nlevels = ["1 mm", "2 mm"]', f"{keys}\nlevels = {levels}", complaint)
        for keys, levels, complaint in (
            (f'key = "{LED}"', "[0.8, 1.2]", f"factors.s: sets {LED}, which factors.x sets already"),
            (f'key = "{LED.replace("0", "00")}"', "[0.8, 1.2]", f"factors.s: sets {LED}, which factors.x"),
            (
                f'keys = ["{LED}", "{LED}"]',
                "[[1, 2], [2, 1]]",
                f"factors.x: sets {LED}, which factors.x sets already",
            ),
            (
                'keys = ["targets[0].rotation", "targets[0].rotation[2]"]',
                '[[["0 deg", "0 deg", "8 deg"], "7 deg"], [["0 deg", "0 deg", "9 deg"], "6 deg"]]',
                "factors.x: sets targets[0].rotation[2], which factors.x sets already",
            ),
            (
                'keys = ["targets[0].rotation[2]", "targets[0].rotation"]',
                '[["7 deg", ["0 deg", "0 deg", "8 deg"]], ["6 deg", ["0 deg", "0 deg", "9 deg"]]]',
                "factors.x: sets targets[0].rotation, which factors.x sets already",
            ),
        )
    ),
]


@pytest.mark.parametrize(("old", "new", "complaint"), BAD)
def test_bad_designs_are_refused_before_the_first_ray(
    design: DesignWriter, capsys: pytest.CaptureFixture[str], old: str, new: str, complaint: str
) -> None:
    assert old in SMALL
    path = design(SMALL.replace(old, new, 1))
    out = path.parent / "out"
    line = here(["study", "run", path, "--out", out], capsys).refusal(2)
    assert complaint in line and "design.toml" in line
    assert not out.exists()


BAD_RESPONSES = [
    ('[responses.u]\nmeasure = "edge"', "must be one of"),
    ('[responses.u]\nmeasure = "edge_position"\nunit = "mm"', "not a unit of position"),
    ('[responses.u]\nmeasure = "edge_position"\ngamma = "high"', "must be a number"),
    ('[responses.u]\nmeasure = "mean_gray"\nunit = "mm"', "has no unit"),
    ('[responses.f]\nmeasure = "focal_length"', "no board of dots"),
    ('[responses.f]\nmeasure = "focal_length"\nmethod = "best"', "not one of"),
    ('[responses.x]\nmeasure = "mean_gray"', "cannot name a column"),
    ('[responses.f]\nmeasure = ["mean_gray"]', "must be one of"),
    ('[responses.u]\nmeasure = "edge_position"\nunit = ["px"]', "not a unit of position"),
    (f'[responses.u]\nmeasure = "edge_position"\ngamma = 1{"0" * 400}', "more than 64 bits"),
    ('[responses.m]\nmeasure = "mean_gray"\n[responses.m_error]\nmeasure = "contrast"', "column already"),
]


@pytest.mark.parametrize(("responses", "complaint"), BAD_RESPONSES)
def test_bad_responses_are_refused(
    design: DesignWriter, capsys: pytest.CaptureFixture[str], responses: str, complaint: str
) -> None:
    path = design(SMALL)
    path.write_text(path.read_text().partition("[responses.u]")[0] + responses)
    assert complaint in here(["study", "run", path, "--out", path.parent / "out"], capsys).refusal(2)


@pytest.mark.parametrize("count", [10, pytest.param(16, marks=pytest.mark.long)])
def test_jobs_of_many_images_read_their_basis_a_few_times(design: DesignWriter, count: int) -> None:
    """1000 or 4096 images: as many jobs as keep some workers busy, and each image once."""
    led = '[factors.L{0}]\nkey = "sources[0].leds[{0}].radiance_factor"\nlevels = [{1}]\n'
    levels = ", ".join(f"{n / count:g}" for n in range(1, count + 1))
    path = design('analysis = "none"\n[design]\nkind = "full"\n' + "".join(led.format(n, levels) for n in range(3)))
    study, runs = expanded(path)
    (_, *steps), made = plan_steps(study, runs, path.parent / "out", StudyOptions())
    assert made.relit == count**3 and 16 <= len(steps) <= 32
    assert sorted(run.run for step in steps for run in step.job.runs) == list(range(1, count**3 + 1))


def test_a_study_that_is_too_large_is_refused_with_its_replicates(design: DesignWriter) -> None:
    """7 GiB without what is kept beside each image, which takes 40 GiB."""
    text = """
analysis = "none"
set = { "camera.sensor.columns" = 100 }
[design]
kind = "full"
[factors.r]
key = "camera.sensor.rows"
levels = [50, 1000000]
"""
    with pytest.raises(InputError, match=r"level 1000000: .*1e\+08 pixels .* 4\d GiB of memory"):
        check_design(read_design(design(text)), {})


def test_a_folder_of_another_study_is_refused(design: DesignWriter, capsys: pytest.CaptureFixture[str]) -> None:
    path = design(SMALL)
    out = path.parent / "out"
    out.mkdir()
    (out / "results.csv").write_text("mine\n1\n")
    assert "something else" in here(["study", "run", path, "--out", out], capsys).refusal(2)
    assert (out / "results.csv").read_text() == "mine\n1\n"


@pytest.mark.parametrize(
    ("address", "code"),
    [("nonsense", 2), ("tcp://[::1", 2), ("tcp://127.0.0.1:1", 4), ("tcp://nowhere.invalid:8786", 4)],
)
def test_a_scheduler_that_is_not_there_is_told(
    design: DesignWriter, capsys: pytest.CaptureFixture[str], address: str, code: int
) -> None:
    """What is no address is a wrong option; where nobody listens the address may be right."""
    path = design(SMALL)
    told = here(["study", "run", path, "--out", path.parent / "out", "--dask", address], capsys)
    assert "--dask" in told.refusal(code)


def test_a_server_that_says_nothing_is_no_scheduler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "_GRACE", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        with pytest.raises(EnvironmentFailure, match=r"no answer from tcp://127.* within 0\.2 s"):
            pool.DaskPool(address, tmp_path, None)


def test_a_missing_design_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such design file"):
        read_design(tmp_path / "none.toml")


def test_a_study_does_not_go_on_with_other_files(tmp_path: Path) -> None:
    (tmp_path / "panel.rad").write_text("void plastic grey\n0\n0\n5 .3 .3 .3 0 0\n")
    document = dict(EDGE, targets=[*EDGE["targets"], {"name": "panel", "rad": "panel.rad"}])
    (tmp_path / "scene.toml").write_text(scene_text(document))
    (tmp_path / "design.toml").write_text(f'scene = "scene.toml"\n{SMALL}\n{RESPONSES}')
    design, out = read_design(tmp_path / "design.toml"), tmp_path / "out"
    out.mkdir()
    for _ in range(2):
        take_possession(out, design, runs_of(design), StudyOptions())
    (tmp_path / "panel.rad").write_text("void plastic grey\n0\n0\n5 .4 .4 .4 0 0\n")
    with pytest.raises(InputError, match="holds another study, or one made with other files"):
        take_possession(out, design, runs_of(design), StudyOptions())


def test_a_gain_may_be_drawn(design: DesignWriter) -> None:
    """Its unit has brackets and holds gamma; it is a quantity like any other."""
    gain = '"9e4 (J/m^2)^-1", "1.1e5 (J/m^2)^-1"'
    text = SMALL.replace("sources[0].leds[*].beam_width_factor", "camera.sensor.gain")
    text = text.replace("L = 1.0", 'L = "1e5 (J/m^2)^-1"').replace("[0.9, 1.1]", f"[{gain}]")
    _, runs = expanded(design(text))
    number, _, unit = runs[1].document["camera"]["sensor"]["gain"].partition(" ")
    assert 9e4 <= float(number) <= 1.1e5 and unit == "(J/m^2)^-1"
    other = text.replace("1.1e5 (J/m^2)^-1", "1.1e5 (J/m^2)^-0.9")
    with pytest.raises(InputError, match="same unit"):
        read_design(design(other))


def test_a_study_is_the_same_in_a_renamed_folder_and_on_another_kernel(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second, out = tmp_path / "first", tmp_path / "second", tmp_path / "out"
    first.mkdir()
    out.mkdir()
    (first / "scene.toml").write_text(scene_text(EDGE))
    (first / "design.toml").write_text(f'scene = "scene.toml"\n{SMALL}\n{RESPONSES}')
    study = read_design(first / "design.toml")
    take_possession(out, study, runs_of(study), StudyOptions())
    first.rename(second)
    study = read_design(second / "design.toml")
    known = versions(*STUDY_PACKAGES)
    assert {"scipy", "opencv-contrib-python-headless", "pyDOE3", "statsmodels"} <= set(known)
    monkeypatch.setattr("radwrap.study.study.versions", lambda *_: known | {"platform": "another kernel"})
    take_possession(out, study, runs_of(study), StudyOptions())
    # Other rays are another study: numpy, Radiance.
    for change in (
        ("radwrap.study.study.versions", lambda *_: known | {"numpy": "0.1"}),
        ("radwrap.study.study.radiance_version", lambda *_: "RADIANCE 1.0"),
    ):
        with monkeypatch.context() as changed:
            changed.setattr(*change)
            with pytest.raises(InputError, match="holds another study"):
                take_possession(out, study, runs_of(study), StudyOptions())


def test_a_file_outside_of_the_scene_is_not_read_without_trust(tmp_path: Path) -> None:
    scene, out = tmp_path / "scene", tmp_path / "out"
    scene.mkdir()
    out.mkdir()
    (tmp_path / "outside.txt").write_text("private")
    (scene / "scene.toml").write_text(scene_text(dict(EDGE, title=str(tmp_path / "outside.txt"))))
    (scene / "design.toml").write_text(f'scene = "scene.toml"\n{SMALL}\n{RESPONSES}')
    study = read_design(scene / "design.toml")
    take_possession(out, study, runs_of(study), StudyOptions())
    assert json.loads((out / "plan.json").read_text())["files"] == {}
