"""``radwrap fit`` as users have it."""

from __future__ import annotations

import json
import math
import tomllib
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.fitting.captured import captured
from radwrap.fitting.free_keys import free_scene
from radwrap.fitting.light import Light
from radwrap.fitting.places import need_renders
from radwrap.fitting.poses import aimed_keys
from radwrap.fitting.scene_text import with_values
from radwrap.images import GrayImage, write_png
from radwrap.random_streams import generator
from radwrap.scene.scene import Scene
from tests.cli.conftest import here, scene_text
from tests.fitting.conftest import EXPOSURE, LEVELS, OPTIONS, changed, tables

LARGEST: Final = 16  # rays of a pixel and replicate on average, of the one image
SIGMAS: Final = 4.0  # of each of five keys: 1 of 3000 fits is missed


def _capture(scene: Scene, changes: dict[str, Any], seed: int = 5) -> GrayImage:
    """A frame of the changed scene, at a third of the fit's tolerance: its own rays add a twentieth to a deviation."""
    return radwrap.render(changed(scene, changes), method="rays", tolerance=0.33, seed=seed, workers=1).frames(1)[0]


def test_a_twin_is_found_and_its_files_are_whole(
    bench: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = f"# our bench\n{scene_text(tables())}"
    path = tmp_path / "scene.toml"
    path.write_text(text)
    truth = {f"sources[0].leds[{k}].radiance_factor": factor for k, factor in enumerate((1.2, 0.7, 1.1))}
    truth["camera.sensor.offset"] = 7.0
    write_png(tmp_path / "capture.png", _capture(bench, truth).codes)
    argv: list[object] = ["fit", path, tmp_path / "capture.png", "--free", LEVELS]
    argv += ["--free", "camera.sensor.offset=0:20"]
    argv += ["--out", tmp_path / "out", "--tolerance", 1, "--workers", 1, "--json"]
    told = here(argv, capsys).success().json
    assert told["explained"] and told["converged"] and told["undetermined"] == []
    for key, true in zip(told["keys"], truth.values(), strict=True):
        assert abs(key["value"] - true) < SIGMAS * key["sigma"]
        assert key["interval_95"][0] < key["value"] < key["interval_95"][1]
    out = tmp_path / "out"
    assert json.loads((out / "fit.json").read_text()) == told
    assert {file.name for file in out.iterdir() if not file.name.startswith(".")} == {
        *("fit.json", "scene.toml", "residual.png", "residual.exr", "index.html")
    }
    written = (out / "scene.toml").read_text()
    assert "# our bench" in written
    found = radwrap.load_scene(out / "scene.toml")
    assert found.camera.sensor.dark_gray == pytest.approx(told["keys"][3]["value"], rel=1e-12)
    assert found.emitters[1].radiance / bench.emitters[1].radiance == pytest.approx(told["keys"][1]["value"], rel=1e-12)
    page = (out / "index.html").read_text()
    assert "yes" in page and "http" not in page
    # The user's own scene is not replaced, nor another file of theirs.
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "index.html").write_text("mine")
    argv[argv.index("--out") + 1] = tmp_path / "mine"
    assert "holds index.html, which was not written by any fit" in here(argv, capsys).refusal(2)
    argv[argv.index("--out") + 1] = tmp_path / "out"
    argv[argv.index("--out") + 1] = tmp_path
    assert "holds scene.toml, which was not written by any fit" in here(argv, capsys).refusal(2)
    assert path.read_text() == text


def test_what_needs_no_renders_takes_one_image(bench: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside what says who traces, with eight rays a pixel; its rays are aimed."""
    monkeypatch.setattr(Light, "at", None)
    capture = _capture(bench, {EXPOSURE: "90 ms"})
    found = radwrap.fit(bench, [capture], [EXPOSURE], options=OPTIONS).manifest
    assert found["places"] == 1 and found["held"]["method"] == "rays" and found["held"]["sampling"] is None
    assert found["held"]["settled"] == {"method": "rays", "rms": 0.75 * OPTIONS.gray_tolerance, "replicates": 12}
    pixels = bench.camera.sensor.pixels
    assert found["rays"] < 8 * pixels + LARGEST * 12 * pixels


def test_a_wrong_model_exits_with_1_and_says_where(
    bench: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The scene lacks an LED that was on."""
    write_png(tmp_path / "capture.png", _capture(bench, {}).codes)
    path = tmp_path / "scene.toml"
    path.write_text(scene_text(tables()))
    argv = ["fit", path, tmp_path / "capture.png", "--free", EXPOSURE, "--out", tmp_path / "out", "--tolerance", 0.3]
    done = here([*argv, "--set", "sources[0].leds[2].radiance_factor=0", "--workers", 1], capsys)
    assert done.code == 1
    assert "errors: no" in done.stdout and "rows" in done.stdout and "deviations" in done.stdout
    assert radwrap.load_scene(tmp_path / "out" / "scene.toml").emitters[2].radiance == 0


def test_what_cannot_be_judged_exits_with_1_and_says_so(
    bench: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two pixels count, and two values are fitted."""
    write_png(tmp_path / "capture.png", _capture(bench, {EXPOSURE: "110 ms"}).codes)
    path, mask = tmp_path / "scene.toml", np.zeros((20, 24), dtype=np.uint8)
    path.write_text(scene_text(tables()))
    mask[2, 2] = mask[17, 21] = 255
    write_png(tmp_path / "mask.png", mask)
    argv = ["fit", path, tmp_path / "capture.png", "--free", EXPOSURE, "--free", "camera.sensor.offset"]
    argv += ["--mask", tmp_path / "mask.png", "--tolerance", 4, "--workers", 1, "--out", tmp_path / "out"]
    done = here(argv, capsys)
    assert done.code == 1 and "cannot be judged: as many values were fitted as pixels count" in done.stdout
    told = json.loads((tmp_path / "out" / "fit.json").read_text())
    assert told["explained"] is None and told["pixels"]["degrees_of_freedom"] == 0 and told["converged"]
    assert told["pixels"]["passed"] is None and told["looks_like"] == [] and told["keys"][0]["interval_95"]
    page = (tmp_path / "out" / "index.html").read_text()
    assert "cannot be judged" in page and "its errors: yes" not in page and "its errors: no" not in page


def test_a_value_of_0_that_nothing_is_below_is_its_own_bound(bench: Scene) -> None:
    (dark,) = free_scene(bench, ["camera.sensor.dark_current"]).keys
    assert (dark.value, dark.low, dark.high) == (0, 0, math.inf)


@pytest.mark.parametrize(
    ("free", "words"),
    [
        ([], "is missing"),
        (["camera.sensor.rows"], "whole numbers"),
        (["sources[0].type"], "not a number"),
        (["camera.sensor.rounding"], "not a number"),
        (["pose:nobody"], "nothing that has a pose"),
        (["pose:camera=0 mm:1 mm"], "no bounds"),
        (["pose:camera", "pose:camera"], "twice"),
        (["pose:camera", "camera.position[0]"], "belongs to a pose"),
        ([f"{EXPOSURE}=2ms:4ms"], "after a blank"),
        ([EXPOSURE, EXPOSURE], "twice"),
        (["camera.exposure_time=1 ms:2 ms"], "outside"),
        (["camera.exposure_time=1 mm:2 m"], "unit"),
        (["camera.exposure_time=4 ms"], "low:high"),
        (["camera.nothing"], "no number in the scene"),
    ],
)
def test_what_cannot_be_fitted_is_refused(bench: Scene, free: list[str], words: str) -> None:
    with pytest.raises(InputError, match=words):
        need_renders(free_scene(bench, free))


def test_what_needs_renders_is_found_by_changing_the_scene(bench: Scene) -> None:
    free = [EXPOSURE, "sources[0].radiance", "camera.sensor.offset", "targets[0].edge_position", "materials.white"]
    free[4] = "materials.white.reflectance"
    assert need_renders(free_scene(bench, free)) == (False, False, False, True, True)


def test_a_pose_is_written_as_position_and_rotation(bench: Scene) -> None:
    """A camera that looks down from 500 mm: its z is the world's -z."""
    free = free_scene(bench, ["pose:camera"])
    assert free.scene.camera.pose.position == pytest.approx(bench.camera.pose.position)
    assert np.allclose(free.scene.camera.pose.rotation, bench.camera.pose.rotation, atol=1e-12)
    moved = free.at([0.0, 0.0, 10.0, 0.0, 0.0, 90.0]).camera.pose
    assert moved.position == pytest.approx((0.0, 0.0, 0.49), abs=1e-12)
    assert np.allclose(moved.x_axis, bench.camera.pose.y_axis, atol=1e-12)
    text = scene_text(tables())
    changes = free.written([0.0, 0.0, 10.0, 0.0, 0.0, 90.0])
    found = radwrap.scene_from_document(tomllib.loads(with_values(text, changes, aimed_keys(free.poses))))
    assert found.camera.pose.position == pytest.approx((0.0, 0.0, 0.49), abs=1e-12)


@pytest.mark.long
def test_a_place_is_found_by_renders(bench: Scene) -> None:
    """An edge 0.2 mm off, by bases whose rays lie alike; the twin's rays are others."""
    truth = {"targets[0].edge_position": "1.2 mm"}
    found = radwrap.fit(bench, [_capture(bench, truth)], list(truth), options=OPTIONS)
    (key,) = found.keys
    assert found.converged and found.explained
    assert key.sigma is not None and key.sigma_prediction
    assert abs(key.value - 1.2) < SIGMAS * key.sigma < 0.2


def test_bounds_are_read_in_any_unit_and_found_where_the_scene_has_them(bench: Scene) -> None:
    (exposure, efficiency) = free_scene(bench, [f"{EXPOSURE}=0.05 s:1 s", "camera.sensor.quantum_efficiency"]).keys
    assert (exposure.low, exposure.high, exposure.unit) == (pytest.approx(50.0), pytest.approx(1000.0), "ms")
    assert efficiency.high == pytest.approx(1.0, rel=1e-9) and 0 < efficiency.low < 1e-5


def test_the_unit_of_a_gain_goes_with_gamma() -> None:
    sensor = tables()["camera"]["sensor"]
    bent = tables()
    bent["camera"]["sensor"] = {
        **{name: sensor[name] for name in ("rows", "columns", "pixel_width", "pixel_height")},
        **{"gain": "1e5 (J/m^2)^-0.8", "gamma": 0.8, "dark_gray": 20, "saturation_gray": 255},
    }
    scene = radwrap.scene_from_document(bent)
    free = free_scene(scene, ["camera.sensor.gamma", "camera.sensor.gain"])
    found = free.at([0.75, 2e5]).camera.sensor
    assert (found.gamma, found.gain) == (0.75, 2e5)


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (GrayImage(np.zeros((20, 25))), "25 x 20"),
        (GrayImage(np.full((20, 24), 300.0), bit_depth=16), "16 bits"),
    ],
)
def test_captures_of_another_sensor_are_refused(bench: Scene, image: GrayImage, words: str) -> None:
    with pytest.raises(InputError, match=words):
        radwrap.fit(bench, [image], [EXPOSURE], options=OPTIONS)


def test_a_power_law_needs_its_noise_told() -> None:
    bent = tables()
    sensor = {name: bent["camera"]["sensor"][name] for name in ("rows", "columns", "pixel_width", "pixel_height")}
    power = {"gain": "1e5 (J/m^2)^-1", "gamma": 1.0, "dark_gray": 20, "saturation_gray": 255}
    bent["camera"]["sensor"] = sensor | power
    scene = radwrap.scene_from_document(bent)
    with pytest.raises(InputError, match="no noise"):
        radwrap.fit(scene, [GrayImage(np.full((20, 24), 90.0))], [EXPOSURE], options=OPTIONS)


def test_repeats_tell_their_noise() -> None:
    scene = radwrap.scene_from_document(tables())
    images = [GrayImage(90 + 2 * generator(k, 1).standard_normal((20, 24)), 8) for k in range(6)]
    found = captured(images, [str(k) for k in range(6)], scene.camera.sensor, None)
    assert found.variance is not None
    # 2400 degrees of freedom tell a variance to 3 %.
    assert found.variance.mean() == pytest.approx(4.0, rel=0.12)


def test_an_entry_of_a_list_that_the_text_leaves_out_brings_the_list() -> None:
    text = '[[targets]]\ntype = "sheet"  # ours\n'
    whole = {"targets": [{"type": "sheet", "position": ["2 mm", "0 mm", "0 mm"]}]}
    made = with_values(text, {"targets[0].position[0]": "2.5 mm"}, (), whole)
    assert "# ours" in made
    assert tomllib.loads(made)["targets"][0]["position"] == ["2.5 mm", "0 mm", "0 mm"]


def test_values_go_into_the_users_text() -> None:
    text = '# bench\n[camera]\nexposure_time = "1 ms"  # as set\n\n[[sources]]\ncount = 3\n'
    text += "leds = [{index = 2, radiance_factor = 1.0}]\n"
    changes = {"camera.exposure_time": "2.5 ms", "camera.sensor.offset": 4.0, "sources[0].leds[2].radiance_factor": 0.5}
    made = with_values(text, {**changes, "sources[0].leds[1].radiance_factor": 0.25})
    assert 'exposure_time = "2.5 ms"  # as set' in made and "# bench" in made
    found = tomllib.loads(made)
    assert found["camera"]["sensor"]["offset"] == 4.0
    leds = {led["index"]: led["radiance_factor"] for led in found["sources"][0]["leds"]}
    assert leds == {2: 0.5, 1: 0.25}


@pytest.mark.long
def test_what_the_compiled_tracer_cannot_show_is_fitted_by_radiance(bench: Scene) -> None:
    """A mirror beside the target: the tracer is decided once, and told."""
    document = json.loads(bench.document)
    document["materials"]["shiny"] = {"type": "mirror", "reflectance": 0.5}
    pane = {"type": "sheet", "name": "pane", "material": "shiny", "size": ["9 mm", "9 mm"]}
    document["targets"].append(pane | {"position": ["0 mm", "150 mm", "20 mm"]})
    scene = radwrap.scene_from_document(document)
    capture = radwrap.render(scene, tolerance=4, seed=5, workers=1).frames(1)
    coarse = radwrap.RenderOptions(tolerance=8.0, workers=1)
    held = [radwrap.fit(one, capture, [EXPOSURE], options=coarse).manifest["held"]["tracer"] for one in (scene, bench)]
    assert held == ["radiance", "compiled"]
