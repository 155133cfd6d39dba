"""The bench of real cells: what it solves, what it runs, and what it gives Mitsuba to render."""

from __future__ import annotations

import json
import math
import sys
import time
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
import trimesh

import bench_cells
import radwrap
from cell_bench.cases import BOARD, CELLS, TENT, case_of, sizes_of
from cell_bench.kept import kept
from cell_bench.measured import measured
from cell_bench.mitsuba_runs import find_mitsuba, gray_of, llvm_libraries, mitsuba_row
from cell_bench.report import comparisons
from cell_bench.solving import solved
from cell_bench.translation import MM, NotTranslated, beam_picture, sensor, translated, wide_mesh
from radwrap.imaging.optics.view import rays_through
from radwrap.scene.wide_shapes import Annulus, Zone, area

# Time and error of a tracer that starts in 2 s, takes 0.3 s a sample and has 8 gray levels of noise after one.
SAMPLES, CONVERGED = (4, 16), 64
SECONDS = [2 + 0.3 * n for n in (*SAMPLES, CONVERGED)]
RMS = [8 * math.sqrt(1 / n + 1 / CONVERGED) for n in SAMPLES]


def test_time_and_error_are_solved_from_runs_of_several_lengths() -> None:
    speed = solved(SAMPLES, SECONDS, RMS, CONVERGED)
    found = (speed.start_s, speed.sample_s, speed.noise_gray)
    assert found == pytest.approx((2, 0.3, 8), rel=1e-9)
    assert max(speed.time_residual, speed.noise_residual) < 1e-9
    assert speed.seconds_to(0.5) == pytest.approx(2 + 0.3 * 256)
    assert speed.seconds_to(100) == pytest.approx(2.3)  # one sample of each pixel at least
    assert speed.rms_after(2 + 0.3 * 16) == pytest.approx(2)
    assert speed.rms_after(2.2) is None


def test_what_runs_differ_from_the_solution_is_told() -> None:
    speed = solved(SAMPLES, SECONDS, [RMS[0] * 1.1, RMS[1] / 1.1], CONVERGED)
    assert speed.noise_gray == pytest.approx(8) and speed.noise_residual == pytest.approx(0.1)
    late = [SECONDS[0], SECONDS[1] * 1.2, SECONDS[2]]
    assert solved(SAMPLES, late, RMS, CONVERGED).time_residual > 0.05


def test_runs_that_take_no_longer_with_more_samples_are_refused() -> None:
    with pytest.raises(ValueError, match="did not take longer"):
        solved(SAMPLES, SECONDS[::-1], RMS, CONVERGED)


def test_a_render_is_compared_at_its_own_error_and_where_it_did_not_end_at_the_tolerance() -> None:
    at = {"case": "ring", "megapixels": 0.3}
    speed = {"start_s": 2.0, "sample_s": 0.3, "noise_gray": 8.0, "time_residual": 0.0, "noise_residual": 0.0}
    measured_speed = {"samples": [*SAMPLES, CONVERGED], "cpu_s": SECONDS, "rms_to_converged_gray": RMS}
    ours = {**at, "by": "radwrap", "cpu_s": 9.0, "tolerance": 0.5, "tracer": "auto", "budget_s": None, "wall_s": 6.8}
    ended = {**ours, "true_rms_gray": 0.25, "truth_noise_rms_gray": 0.01, "mean_gray": 50.0}
    rows = [
        ended,
        {**ours, "failure": "did not end in 7 s"},
        {**at, "by": "mitsuba", "speed": speed, "mean_gray": 40.0, **measured_speed},
    ]
    first, second = comparisons(rows)
    assert first["mitsuba_s"] == pytest.approx(2 + 0.3 * 1024) and second["mitsuba_s"] == pytest.approx(2 + 0.3 * 256)
    assert first["mitsuba_rms_after_same_time"] == pytest.approx(2)
    assert first["mitsuba_cpu_s"] == pytest.approx(first["mitsuba_s"]) and first["radwrap_cpu_s"] == 9
    assert first["mean_gray_ratio"] == 1.25 and not second["ended"]


def test_a_command_has_its_time_its_processor_time_and_its_memory() -> None:
    work = "import time; kept = bytearray(b'1') * 100_000_000\nwhile time.process_time() < .4: 0"
    done = measured(
        [sys.executable, "-c", f"import subprocess, sys; subprocess.run([sys.executable, '-c', {work!r}])"], 30
    )
    assert done.failure is None and done.code == 0
    # Of a child of the child, too.
    assert done.cpu_s > 0.3 and done.peak_memory > 100_000_000


def test_a_command_that_takes_too_long_is_ended_with_its_children() -> None:
    child = "import os, subprocess, sys; p = subprocess.Popen(['sleep', '60']); print(p.pid, flush=True); p.wait()"
    start = time.perf_counter()
    done = measured([sys.executable, "-c", child], 1)
    assert done.failure == "did not end in 1 s" and time.perf_counter() - start < 20
    child_id = int(done.output)
    # Where nobody asks for an orphan's end it stays on the list.
    assert not psutil.pid_exists(child_id) or psutil.Process(child_id).status() == psutil.STATUS_ZOMBIE


def test_a_crash_is_a_reason() -> None:
    done = measured([sys.executable, "-c", "import os; os.abort()"], 30)
    assert done.failure is not None and "signal 6" in done.failure
    failed = measured([sys.executable, "-c", "raise SystemExit('no such thing')"], 30)
    assert failed.failure == "exit code 1: no such thing"


def test_a_finished_row_is_read_and_another_key_is_measured(tmp_path: Path) -> None:
    rows = [
        kept(tmp_path, key, lambda key=key: {"of": key["n"], "at": time.monotonic()}) for key in ({"n": 1}, {"n": 2})
    ]
    again = kept(tmp_path, {"n": 1}, lambda: pytest.fail("measured again"))
    assert again == rows[0] and rows[1]["of"] == 2
    kept(tmp_path, {"n": 3}, lambda: {"retry": True})
    assert kept(tmp_path, {"n": 3}, lambda: {"of": 3}) == {"of": 3}


@pytest.mark.parametrize("name", [*CELLS, BOARD, TENT])
def test_all_sizes_of_a_scene_are_of_one_field(name: str) -> None:
    coarsest = min(sizes_of(name).values())
    for megapixels in sizes_of(name):
        case = case_of(name, megapixels)
        pitch = float(str(case.overrides["camera.sensor.pixel_width"]).removesuffix(" um"))
        assert case.overrides["camera.sensor.pixel_height"] == case.overrides["camera.sensor.pixel_width"]
        assert pitch * case.columns == pytest.approx(case.width)
        # The rows fill the height to less than a pixel of the coarsest size.
        assert abs(case.rows / case.columns - coarsest[1] / coarsest[0]) < 1 / coarsest[0]


def test_a_name_or_size_that_is_not_there_is_one_error(capsys: pytest.CaptureFixture[str]) -> None:
    for words, said in (
        (["--cells", "tunnel"], "there is no cell 'tunnel'"),
        (["--sizes", "7"], "not measured at 7 MP"),
    ):
        assert bench_cells.main([*words, "--no-mitsuba"]) == 2
        assert said in capsys.readouterr().err


@pytest.mark.long
def test_a_short_bench(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--cells", BOARD, "--sizes", ".001", "--tolerances", "8", "--no-mitsuba", "--out", str(tmp_path)]
    few = ["--truth-pixels", "64", "--truth-rays", "16"]
    assert bench_cells.main([*words, *few]) == 0
    first = capsys.readouterr().out
    (row,) = json.loads((tmp_path / "bench_cells.json").read_text())["rows"]
    assert row["true_rms_gray"] < row["tolerance"] and row["certified_rms_gray"] < row["tolerance"]
    assert row["cpu_s"] > 0 and row["wall_s"] > 0.1 and row["peak_memory_bytes"] > 2**20
    assert row["forecast_rays"] > 0 and row["forecast_over_actual"] > 0
    # The second time nothing is measured.
    start = time.perf_counter()
    assert bench_cells.main([*words, *few]) == 0
    assert time.perf_counter() - start < 1
    assert capsys.readouterr().out.splitlines()[1:] == first.splitlines()[1:]


# ---- the translation, without Mitsuba


def matrix(entry: dict[str, Any]) -> np.ndarray[Any, Any]:
    return np.array(entry["to_world"])


@pytest.mark.parametrize("name", ["ring", BOARD, TENT])
def test_the_camera_sees_the_same_field(name: str) -> None:
    camera = case_of(name, min(sizes_of(name))).scene().camera
    chip, entry = camera.sensor, sensor(camera)
    # Mitsuba's cameras have x to the left and y up; the film's first pixel is at its upper left.
    half = math.tan(math.radians(entry["fov"]) / 2)
    for u, v in ((-0.5, -0.5), (chip.columns - 0.5, -0.5), (0, chip.rows - 1)):
        across = half * (1 - 2 * (u + 0.5) / chip.columns)
        up = half * (1 - 2 * (v + 0.5) / chip.rows) * chip.rows / chip.columns
        theirs = matrix(entry)[:3, :3] @ [across, up, 1]
        (ours,), _ = rays_through(camera.without_lens, (0.0, 0.0), np.array([float(u)]), np.array([float(v)]))
        direction = ours[3:] / np.linalg.norm(ours[3:])
        assert theirs / np.linalg.norm(theirs) == pytest.approx(direction, abs=1e-12)
        assert matrix(entry)[:3, 3] == pytest.approx(ours[:3] * MM)
    if camera.lens is not None:
        assert entry["aperture_radius"] == pytest.approx(25 / 8 / 2) and entry["focus_distance"] == pytest.approx(396)


def test_leds_keep_their_intensity(tmp_path: Path) -> None:
    scene = case_of("ring", 0.001).scene()
    lights = [value for key, value in translated(scene, tmp_path).items() if key.startswith("light_")]
    for light, emitter in zip(lights, scene.emitters, strict=True):
        # W/sr against lengths in mm: 1e6 times as much, so that the irradiance is in W m^-2.
        assert light["intensity"] == pytest.approx(0.2e6) and emitter.radiant_intensity == pytest.approx(0.2)
        assert matrix(light)[:3, 2] == pytest.approx(emitter.axis)
        assert matrix(light)[:3, 3] == pytest.approx(np.array(emitter.position) * MM)


def test_bars_keep_their_radiance_and_size(tmp_path: Path) -> None:
    case = case_of("two_bars", 0.001)
    coarse = {f"sources[{number}].irradiance_error": 0.2 for number in (0, 1)}  # is loaded in less time
    found = translated(radwrap.load_scene(case.file, {**case.overrides, **coarse}), tmp_path)
    for side, light in ((-1, found["light_0"]), (1, found["light_1"])):
        assert light["emitter"] == {"type": "area", "radiance": 1500.0}
        half = matrix(light)[:3, :2]
        assert np.linalg.norm(half, axis=0) == pytest.approx([75, 10])
        assert matrix(light)[:3, 3] == pytest.approx([180 * side, 0, 60])
        # Shines towards the middle.
        assert np.cross(*half.T) @ [-180 * side, 0, -60] > 0
    assert found["integrator"]["bsdf_samples"] == 1


@pytest.mark.parametrize(
    ("shape", "inwards"), [(Annulus(0.05, 0.08), (0.0, 0.0, 1.0)), (Zone(0.2, 0.2, math.pi / 2), None)]
)
def test_wide_lights_have_their_area_and_shine_to_their_front(
    shape: Annulus | Zone, inwards: tuple[float, float, float] | None
) -> None:
    mesh = trimesh.Trimesh(*wide_mesh(shape), process=False)
    # A polygon of 384 sides has 4.5e-5 less area than its circle.
    assert mesh.area == pytest.approx(area(shape), rel=2e-4)
    front = np.asarray(inwards) if inwards is not None else -mesh.triangles_center
    assert (np.einsum("ij,ij->i", np.broadcast_to(front, mesh.face_normals.shape), mesh.face_normals) > 0).all()


def test_the_picture_of_a_beam_is_its_intensity() -> None:
    emitter = case_of("ring", 0.001).scene().emitters[0]
    widest = math.radians(70)
    picture = beam_picture(emitter, widest)
    count = len(picture)
    # tan(30 deg) off the axis, where a beam of 60 deg FWHM has half its intensity.
    place = round((math.tan(math.radians(30)) / math.tan(widest) + 1) / 2 * count - 0.5)
    assert picture[count // 2, place] == pytest.approx(0.5, abs=0.01)  # a pixel is 0.3 deg wide there
    assert picture[count // 2, count // 2] == pytest.approx(1, abs=1e-3)


def test_parts_lie_where_they_are_and_keep_their_materials(tmp_path: Path) -> None:
    found = translated(case_of("ring", 0.001).scene(), tmp_path)
    shapes = [value for key, value in found.items() if key.startswith("shape_")]
    assert len(shapes) == 4
    belt = trimesh.load_mesh(shapes[0]["filename"], process=False)
    assert belt.area == pytest.approx(180 * 150)
    plate = trimesh.load_mesh(shapes[1]["filename"])
    assert plate.is_watertight and plate.bounds[:, 2] == pytest.approx([0.05, 4.05])
    blend = shapes[1]["bsdf"]["of"]
    parts = (
        blend["below"]["reflectance"] * (1 - blend["weight"]),
        blend["lobe"]["specular_reflectance"] * blend["weight"],
    )
    assert parts == pytest.approx((0.1, 0.12))


def test_what_mitsuba_has_no_word_for_is_said(tmp_path: Path) -> None:
    scene = case_of("ring", 0.001).scene()
    chip = replace(scene.camera.sensor, pixel_height=1e-5)
    with pytest.raises(NotTranslated, match="not square"):
        translated(replace(scene, camera=replace(scene.camera, sensor=chip)), tmp_path)


def test_the_newest_llvm_comes_first(tmp_path: Path) -> None:
    for name in ("libLLVM-14.so.1", "libLLVM.so.19.1", "libLLVM-15.so"):
        (tmp_path / name).touch()
    (tmp_path / "libLLVM-9.so").symlink_to(tmp_path / "libLLVM-15.so")
    assert [path.name for path in llvm_libraries([tmp_path])] == ["libLLVM.so.19.1", "libLLVM-15.so", "libLLVM-14.so.1"]


# ---- with Mitsuba


@pytest.mark.skipif(find_spec("mitsuba") is None, reason='Mitsuba is not installed: pip install "radwrap[bench]"')
def test_mitsuba_shows_the_same_scene(tmp_path: Path) -> None:
    mitsuba = find_mitsuba()
    if isinstance(mitsuba, str):
        pytest.skip(mitsuba)
    case = case_of("ring", 0.001)
    row = mitsuba_row(case, mitsuba, (16, 64, 512), 60, tmp_path / "picture.npy")
    short, long = row["rms_to_converged_gray"]
    assert short / long == pytest.approx(math.sqrt((1 / 16 + 1 / 512) / (1 / 64 + 1 / 512)), rel=0.15)
    ours = radwrap.render(case.scene(), tolerance=2).gray.values - 4
    theirs = np.load(tmp_path / "picture.npy") - 4
    # Of the belt and of the matte parts; the plate's lobe is another one.
    assert ours.mean() == pytest.approx(theirs.mean(), rel=0.03)
    off = [float(((ours - other) ** 2).mean()) for other in (theirs, theirs[::-1], theirs[:, ::-1], theirs[::-1, ::-1])]
    assert off[0] < min(off[1:]) / 4


def test_no_radiance_is_the_dark_level() -> None:
    scene = case_of("ring", 0.001).scene()
    black = gray_of(np.zeros((32, 38), dtype=np.float32), scene)
    assert (black == 4).all()
    bright = gray_of(np.full((32, 38), 10.0, dtype=np.float32), scene)
    # Darker towards the corners, as cos^4.
    corner = math.atan(math.hypot(15.5, 18.5) * scene.camera.pitch[0])
    middle = math.atan(math.hypot(0.5, 0.5) * scene.camera.pitch[0])
    ratio = (bright[0, 0] - 4) / (bright[15, 18] - 4)
    assert ratio == pytest.approx((math.cos(corner) / math.cos(middle)) ** 4, rel=1e-3)
