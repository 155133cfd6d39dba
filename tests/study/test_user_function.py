"""The user's own code as a response, and repeatability: what it gives, what it costs, and what it may not do."""

from __future__ import annotations

import csv
import json
import math
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from radwrap.descendants import _marked
from radwrap.errors import InputError
from radwrap.images import GrayImage
from radwrap.imaging.response.noise import noise_variance, without_pattern
from radwrap.imaging.response.sensor import radiant_exposure_of
from radwrap.scene.file.load import load_scene
from radwrap.study.design import read_design
from radwrap.study.runs import check_design
from radwrap.study.study import StudyOptions, run_study
from radwrap.study.user_call import Called, call_user_function
from radwrap.study.user_function import UserFunction, read_user_function
from tests.cli.conftest import here, write_scene
from tests.study.test_gauge_responses import SCENE, SMALL_POWER_LAW, written

CODE = """
import numpy as np
from helper import middle

def look(gray, manifest, truth):
    assert not gray.flags.writeable and gray.dtype == np.uint16
    return {"middle": (middle(gray), 0.25), "depth": truth["targets"]["coin"]["camera_from_target"][2][3]}
"""
HELPER = "def middle(gray):\n    return gray[30, 36]\n"
DESIGN = """
scene = "scene.toml"
analysis = "none"
seed = 3
[render]
tolerance = 4.0
[design]
kind = "full"
[factors.light]
key = "sources[0].radiance"
levels = ["1 kW/m^2/sr", "2 kW/m^2/sr"]
[responses.mine]
measure = "python:code/gauge.py:look"
keys = ["middle", "depth"]
unit = "DN"
[responses.mean]
measure = "region_mean"
region = [34, 26, 40, 32]
frames = 40
"""
GRAY = GrayImage(np.arange(12.0).reshape(3, 4), 8)


def study(folder: Path, text: str = DESIGN, code: str = CODE) -> Path:
    path = written(folder, text)
    (folder / "code").mkdir(exist_ok=True)
    (folder / "code" / "gauge.py").write_text(code)
    (folder / "code" / "helper.py").write_text(HELPER)
    return path


def function(folder: Path, code: str, keys: list[str] | None = None, **limits: str) -> UserFunction:
    (folder / "own.py").write_text(code)
    return read_user_function("python:own.py:f", {"keys": keys or ["a"], **limits}, folder, "responses.mine")


def called(folder: Path, code: str, keys: list[str] | None = None, images: int = 1, **limits: str) -> list[Called]:
    own = function(folder, code, keys, **limits)
    told: dict[str, Any] = {"manifest": {"x": 1}, "truth": {"y": [2]}}
    return call_user_function(own, folder, [GRAY] * images, rounded=True, **told)


@pytest.mark.long
@pytest.mark.usefixtures("one_process")
def test_own_code_and_repeatability_are_columns(tmp_path: Path) -> None:
    path = study(tmp_path)
    run_study(read_design(path), tmp_path / "out", StudyOptions(workers=1, trust=True))
    rows = list(csv.DictReader((tmp_path / "out" / "results.csv").read_text().splitlines()))
    assert [row["error"] for row in rows] == ["", ""]
    sensor = load_scene(tmp_path / "scene.toml").camera.sensor
    depth = json.loads((tmp_path / "out" / "study.json").read_text())
    assert depth["responses"]["middle"]["measure"] == "python:code/gauge.py:look"
    for row in rows:
        mean, scatter, unsure = (
            float(row[name]) for name in ("mean", "mean_repeatability", "mean_repeatability_error")
        )
        assert float(row["middle [DN]"]) == pytest.approx(mean, rel=0.05)
        # The function's own .25, and what the image's error does to one pixel.
        assert 0.25 <= float(row["middle_error [DN]"]) < 10
        assert 0.2 < float(row["depth [DN]"]) < 2 and float(row["depth_error [DN]"]) == 0
        # 49 pixels, whose means differ by their noise; that of the specimen is the same in each frame.
        one = noise_variance(radiant_exposure_of(np.array(mean), sensor), without_pattern(sensor))
        assert scatter == pytest.approx(math.sqrt(float(one) / 49), rel=4 / math.sqrt(2 * 39))
        assert unsure == pytest.approx(scatter / math.sqrt(2 * 39))
    assert float(rows[1]["mean_repeatability"]) > float(rows[0]["mean_repeatability"])


def test_code_is_not_run_unless_the_user_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = study(tmp_path, code="open('ran', 'w')\n" + CODE)
    done = here(["study", "run", path, "--out", tmp_path / "out"], capsys)
    assert done.code == 2 and "responses.mine" in done.stderr and "--trust" in done.stderr
    assert not list(tmp_path.rglob("ran"))


def test_other_code_is_another_study(tmp_path: Path) -> None:
    first = read_design(study(tmp_path))
    (tmp_path / "code" / "helper.py").write_text(HELPER + "# another\n")
    assert read_design(tmp_path / "design.toml") != first


@pytest.mark.parametrize(
    ("was", "becomes", "message"),
    [
        ("python:code/gauge.py:look", "python:../gauge.py:look", "outside of the design's folder"),
        ("python:code/gauge.py:look", "python:/etc/gauge.py:look", "outside of the design's folder"),
        ("python:code/gauge.py:look", "python:code/nobody.py:look", "no such Python file"),
        ("python:code/gauge.py:look", "python:code/gauge.py:nobody", 'no function "nobody"'),
        ("python:code/gauge.py:look", "python:code/gauge.txt:look", "names no function"),
        ('keys = ["middle", "depth"]', "", "array of names"),
        ('keys = ["middle", "depth"]', 'keys = ["mean"]', "each name once"),
        ('keys = ["middle", "depth"]', 'keys = ["a b"]', "letters, digits"),
        ('unit = "DN"', 'unit = "[DN]"', "cannot be used in"),
        ('unit = "DN"', "threshold = 3", "unknown option of a Python function"),
        ('unit = "DN"', 'time_limit = "0 s"', "must lie between"),
        ('unit = "DN"', 'memory_limit = "4 GB"', "not an amount of memory"),
        ('unit = "DN"', 'memory_limit = "4 MiB"', "256 MiB at least"),
        ("frames = 40", "frames = 1", "whole number from 2"),
        ("frames = 40", "frames = true", "whole number from 2"),
    ],
)
def test_what_cannot_be_called_is_refused(tmp_path: Path, was: str, becomes: str, message: str) -> None:
    assert DESIGN.count(was) == 1
    with pytest.raises(InputError, match=message) as told:
        read_design(study(tmp_path, DESIGN.replace(was, becomes)))
    assert "design.toml" in str(told.value)


def test_frames_need_a_camera_with_noise(tmp_path: Path) -> None:
    path = study(tmp_path)
    write_scene(tmp_path, {**SCENE, "camera.sensor": SMALL_POWER_LAW})
    with pytest.raises(InputError, match="no noise") as told:
        check_design(read_design(path), {"trust": True})
    assert "responses.mean.frames" in str(told.value)


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("def f(g, m, t): raise ValueError('lost it')", "ValueError: lost it"),
        ("def f(g, m, t): raise SystemExit", "SystemExit"),
        ("def f(g, m, t): return 3", "not a dict"),
        ("def f(g, m, t): return {'a': 1, 'b': 2}", '"b", which is not among'),
        ("def f(g, m, t): return {}", "not among what"),
        ("def f(g, m, t): return {'a': float('nan')}", "is not finite"),
        ("def f(g, m, t): return {'a': (1, float('inf'))}", "is not finite"),
        ("def f(g, m, t): return {'a': (1, -1)}", "negative sigma"),
        ("def f(g, m, t): return {'a': 'three'}", "neither a number"),
        ("def f(g, m, t): return {'a': True}", "neither a number"),
        ("def f(g, m, t): g[0, 0] = 1", "read-only"),
        ("import nowhere\ndef f(g, m, t): return {'a': 1}", "cannot be loaded: ModuleNotFoundError"),
        ("import os\ndef f(g, m, t): os.abort()", "ended with exit code"),
        ("def f(g, m, t): return {'a': len(bytearray(1 << 30))}", "MemoryError"),
        (
            "import importlib\ndef f(g, m, t): return {'a': importlib.import_module('hid' + 'den').A}",
            "imports hidden.py",
        ),
    ],
)
def test_what_fails_costs_the_answer_and_says_why(tmp_path: Path, code: str, message: str) -> None:
    (tmp_path / "hidden.py").write_text("A = 1\n")
    found = called(tmp_path, code, memory_limit="512 MiB")
    assert len(found) == 1
    with pytest.raises(InputError, match=message):
        found[0].of("a")


def test_answers_that_are_right(tmp_path: Path) -> None:
    code = (
        "def f(gray, manifest, truth):\n"
        "    print('no answer')\n"
        "    manifest['x'] += 1; truth['y'].append(3)\n"
        "    return {'a': gray.sum(), 'b': (gray[2, 3], 0.5), 'c': manifest['x'], 'd': len(truth['y'])}\n"
    )
    for one in called(tmp_path, code, ["a", "b", "c", "d"], images=2):
        assert dict(one.values) == {"a": (66, 0), "b": (11, 0.5), "c": (2, 0), "d": (2, 0)}


def test_a_call_that_hangs_is_ended_with_what_it_started(tmp_path: Path) -> None:
    code = (
        "import subprocess, sys, time\n"
        "def f(gray, manifest, truth):\n"
        "    subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)'], start_new_session=True)\n"
        "    time.sleep(60)\n"
    )
    start = time.monotonic()
    found = called(tmp_path, code, images=2, time_limit="1 s")
    assert time.monotonic() - start < 20
    for one in found:
        with pytest.raises(InputError, match="silent for 1 s"):
            one.of("a")
    # Marks begin with who made them: other tests have programs of their own beside this one.
    assert not list(_marked(f"{os.getpid()}-")), "nothing that carries a mark of ours is left"


def test_code_that_changed_since_is_not_run(tmp_path: Path) -> None:
    own = function(tmp_path, "def f(g, m, t): return {'a': 1}")
    (tmp_path / "own.py").write_text("def f(g, m, t): return {'a': 2}")
    with pytest.raises(InputError, match="was changed since"):
        call_user_function(own, tmp_path, [GRAY], rounded=True, manifest={}, truth={})


def test_all_local_modules_belong_to_the_study(tmp_path: Path) -> None:
    package = tmp_path / "package"
    package.mkdir()
    (package / "__init__.py").write_text("from .inner import one\n")
    (package / "inner.py").write_text("from . import other\nimport numpy\none = 1\n")
    (package / "other.py").write_text("")
    (tmp_path / "unused.py").write_text("")
    own = function(tmp_path, "def f(g, m, t):\n    from package import one\n    return {'a': one}\n")
    assert [file for file, _ in own.sha256] == ["own.py", "package/__init__.py", "package/inner.py", "package/other.py"]
    found = call_user_function(own, tmp_path, [GRAY], rounded=True, manifest={}, truth={})
    assert found[0].of("a") == (1, 0)


@pytest.mark.usefixtures("one_process")
@pytest.mark.long
def test_the_whole_command_goes_through_with_own_code(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = study(tmp_path, DESIGN.replace("frames = 40", "frames = 3"))
    done = here(["study", "run", path, "--out", tmp_path / "out", "--trust", "--workers", 1], capsys).success()
    assert "2 runs, 0 failed" in done.stdout
    page = (tmp_path / "out" / "index.html").read_text()
    assert "python:code/gauge.py:look" in page and "standard deviation over 3 frames: mean gray level" in page
