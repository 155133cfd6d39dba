"""Every file and number that a user names, wrong in every way: one line, the right exit code, at once."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

from radwrap.images import write_exr, write_png
from radwrap.study.study import PLAN
from tests.cli.conftest import here, write_scene

if sys.platform == "win32":
    pytest.skip("no FIFOs and devices there", allow_module_level=True)

EDGE: Final = np.repeat([[20, 20, 60, 140, 180, 180]], 60, axis=0).repeat(10, axis=1).astype(np.uint8)
CAMERA: Final = ["--pixel-width", "13.75 um", "--pixel-height", "16 um", "--centre", "95.5", "82"]
RING: Final = ["led", "set", "--level", "0.1", "--emulate", "lamparray"]

# What a verb reads, FILE being the hostile one; all else is as it should be.
DOORS: Final[dict[str, list[str]]] = {
    "scene": ["render", "FILE", "--out", "out"],
    "scene of explain": ["explain", "FILE"],
    "mesh": ["convert", "FILE.stl", "a.rad", "--length-unit", "1 mm"],
    "luminaire": ["convert", "FILE.ies", "a.rad"],
    "image of dots": ["measure", "dots", "FILE", "--grid", "5x5"],
    "image of edge": ["measure", "edge", "FILE"],
    "image of parts": ["measure", "parts", "FILE"],
    "frames of emva": ["measure", "emva", "FILE"],
    "captured": ["compare", "FILE", "edge.png"],
    "predicted": ["compare", "edge.png", "FILE"],
    "mask": ["compare", "edge.png", "edge.png", "--mask", "FILE"],
    "truth": ["compare", "edge.png", "edge.png", "--mask", "mask.png", "--truth", "FILE"],
    "points": ["calibrate", "camera", "FILE", *CAMERA],
    "frames of sensor": ["calibrate", "sensor", "FILE"],
    "design": ["study", "run", "FILE", "--out", "out"],
    "results": ["study", "analyse", "FILE", "--response", "x"],
    "drive": [*RING, "--drive", "FILE"],
    "ring": [*RING, "--calibration", "FILE"],
    "photodiode": ["led", "calibrate", "--table", "FILE", "--drive", "drive.toml", "--out", "ring.json"],
    "data sheet": ["explain", "scene.toml", "--set", 'camera.sensor.data_sheet="FILE"'],
    "calibration": ["explain", "scene.toml", "--set", 'camera.calibration="FILE"'],
    "beam": ["explain", "scene.toml", "--set", 'sources[0].beam={file="FILE"}'],
    "spectrum": ["explain", "scene.toml", "--set", 'camera.spectral_response={file="FILE"}'],
    "print": [
        "explain",
        "scene.toml",
        "--set",
        'materials.white={type="print",file="FILE",encoding="linear",black_reflectance=0.1,white_reflectance=0.9}',
    ],
    "BRDF": ["explain", "scene.toml", "--set", 'materials.white={type="measured_brdf",file="FILE"}'],
    "part": ["explain", "scene.toml", "--set", 'targets[0]={type="mesh",file="FILE.stl",material="white"}'],
}
DEEP: Final = "[" * 5000


def _fifo(path: Path) -> None:
    os.mkfifo(path)


def _identity(path: Path) -> tuple[int, ...]:
    """What a program changes that writes to a name; a look at it changes only when it was last looked at."""
    found = path.lstat()
    return found.st_mode, found.st_ino, found.st_size, found.st_mtime_ns


HOSTILE: Final[dict[str, Callable[[Path], object]]] = {
    "FIFO": _fifo,
    "device": lambda path: path.symlink_to("/dev/zero"),
    "folder": lambda path: path.mkdir(),
    "loop": lambda path: path.symlink_to(path.name),
    "huge": lambda path: (path.touch(), os.truncate(path, 1 << 40)),
    "NUL": lambda path: path.write_bytes(b"x,y\0,z\n"),
    "not UTF-8": lambda path: path.write_bytes(b"\xff\xfe\x00a\x00"),
    "long cell": lambda path: path.write_text("a,b\n" + "1" * 200_000 + ",2\n"),
    "deep": lambda path: path.write_text(DEEP),
    "deep object": lambda path: path.write_text('{"parts": ' * 3000),
    "long number": lambda path: path.write_text("9" * 5000),
}


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    write_scene(tmp_path)
    write_png(tmp_path / "edge.png", EDGE)
    write_png(tmp_path / "mask.png", (EDGE > 100).astype(np.uint8))
    (tmp_path / "drive.toml").write_text(
        'count = 2\nwavelength = "850 nm"\nrated_current = "100 mA"\ndrive_current = "50 mA"\n'
        'max_level = 0.5\nmax_sum = 1.0\nmax_on_time = "20 s"\n'
    )
    return tmp_path


@pytest.mark.parametrize("door", DOORS)
def test_no_door_takes_a_hostile_file(door: str, bench: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wrong = []
    for name, make in HOSTILE.items():
        for suffix in ("", ".stl", ".ies"):
            path = bench / f"hostile {name}{suffix}"
            if any(f"FILE{suffix}" in word for word in DOORS[door]) and not os.path.lexists(path):
                make(path)
        argv = [word.replace("FILE", f"hostile {name}") for word in DOORS[door]]
        done = here(argv, capsys)
        if done.code != 2 or done.stdout or done.stderr.count("\n") != 1 or done.wall > 5 or len(done.stderr) > 1000:
            wrong.append((name, done))
    assert wrong == []


def test_the_same_commands_with_sound_files_get_further(bench: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The other files of the commands above are right: what was refused there was the hostile one."""
    here(["compare", "edge.png", "edge.png", "--mask", "mask.png"], capsys).success()
    here(["explain", "scene.toml", "--no-rays"], capsys).success()


OUTPUTS: Final[dict[str, list[str]]] = {
    "plot": ["calibrate", "sensor", "frames.csv", "--plot", "OUT.png"],
    "overlay": ["measure", "parts", "edge.png", "--overlay", "OUT.png"],
    "table": ["measure", "dots", "edge.png", "--grid", "5x5", "--csv", "OUT"],
    "plot of emva": ["measure", "emva", "frames.csv", "--plot", "OUT.png"],
    "view": ["convert", "scene.toml", "OUT.vf"],
    "preview": ["convert", "scene.toml", "OUT.glb"],
    "calibration": ["led", "calibrate", "--table", "led.csv", "--drive", "drive.toml", "--out", "OUT"],
}
TAKEN: Final[dict[str, Callable[[Path], object]]] = {
    "FIFO": _fifo,
    "device": lambda path: path.symlink_to("/dev/full"),
    "stdout": lambda path: path.symlink_to("/proc/self/fd/1"),
    "link": lambda path: path.symlink_to("edge.png"),
    "folder": lambda path: path.mkdir(),
}


@pytest.mark.parametrize("kind", TAKEN)
@pytest.mark.parametrize("output", OUTPUTS)
def test_results_go_to_regular_files_or_new_names(
    output: str, kind: str, bench: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (bench / "frames.csv").write_text("radiant_exposure,gray\n0,20\n1,40\n2,60\n4,90\n8,150\n")
    (bench / "led.csv").write_text("led,level,radiant_intensity\n0,0,0 W/sr\n0,1,1 W/sr\n")
    argv = [word.replace("OUT", "result") for word in OUTPUTS[output]]
    name = next(word for word in argv if word.startswith("result"))
    TAKEN[kind](bench / name)
    before = _identity(bench / name)
    line = here(argv, capsys).refusal(2)
    assert "result" in line and ("regular file" in line or "is not the name of a" in line)
    assert _identity(bench / name) == before


@pytest.mark.parametrize("name", ["gray.png", "radiant_exposure.exr", "manifest.json"])
def test_a_render_replaces_no_device(name: str, bench: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (bench / "out").mkdir()
    (bench / "out" / name).symlink_to("/dev/full")
    line = here(["render", "scene.toml", "--out", "out", "--viewpoints", 7], capsys).refusal(2)
    assert f"out/{name}: is not a regular file" in line
    assert (bench / "out" / name).readlink() == Path("/dev/full")


NUMBERS: Final = [
    ["measure", "parts", "edge.png", "--gamma", "0.9", "--dark={}"],
    ["measure", "parts", "edge.png", "--threshold={}"],
    ["measure", "parts", "edge.png", "--gamma={}", "--dark=10"],
    ["measure", "parts", "edge.png", "--pixel-aspect={}"],
    ["measure", "parts", "edge.png", "--min-area={}"],
    ["measure", "edge", "edge.png", "--dark={}"],
    ["measure", "edge", "edge.png", "--saturation={}"],
    ["measure", "edge", "edge.png", "--pixel-aspect={}"],
    ["measure", "dots", "edge.png", "--grid", "5x5", "--dark={}"],
    ["compare", "edge.png", "edge.png", "--dark={}"],
    ["compare", "edge.png", "edge.png", "--tolerance={}"],
    ["calibrate", "sensor", "frames.csv", "--dark={}"],
    ["calibrate", "sensor", "frames.csv", "--saturation={}"],
    ["calibrate", "sensor", "frames.csv", "--noise={}"],
    ["calibrate", "sensor", "frames.csv", "--quantisation={}"],
    ["calibrate", "sensor", "frames.csv", "--source-uncertainty={}"],
    ["calibrate", "camera", "points.csv", *CAMERA, "--kappa1={}"],
    ["calibrate", "camera", "points.csv", *CAMERA, "--sx={}"],
    ["explain", "scene.toml", "--no-rays", "--seed={}"],
    ["explain", "scene.toml", "--no-rays", "--set", "targets[{}].pitch=1"],
]


# A fit takes half a second: of the numbers each third.
FITS = [argv for argv in NUMBERS if "points.csv" in argv]


@pytest.mark.parametrize(
    ("argv", "each"),
    [(argv, 3 if argv in FITS else 1) for argv in NUMBERS]
    + [pytest.param(argv, 1, marks=pytest.mark.long) for argv in FITS],
    ids=lambda argv: " ".join(argv[:2] + argv[-1:]) if isinstance(argv, list) else str(argv),
)
def test_numbers_of_the_command_line_end_in_a_result_or_one_line(
    argv: list[str], each: int, bench: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (bench / "frames.csv").write_text("radiant_exposure,gray\n" + "".join(f"{k},{20 + 9 * k}\n" for k in range(12)))
    places = [(x, y, 0.1 * x * y) for x in (-0.05, 0, 0.05) for y in (-0.05, 0, 0.05)]
    rows = [f"{x},{y},{z},{95 + 900 * x / (1 - y - z)},{82 + 900 * y / (1 - y - z)}\n" for x, y, z in places]
    (bench / "points.csv").write_text("x,y,z,u,v\n" + "".join(rows))
    numbers = (
        "nan",
        "inf",
        "-1e300",
        "1e300",
        "-1e12",
        "1e12",
        "1e9",
        "-1e-300",
        "1e-300",
        "0",
        "9" * 5000,
        "1_0",
    )
    for number in numbers[::each]:
        done = here([word.replace("{}", number) for word in argv], capsys)
        refused = done.code == 2 and not done.stdout and done.stderr.count("\n") == 1 and len(done.stderr) < 1000
        assert refused or (done.code in (0, 1, 3) and "Traceback" not in done.stderr), (number, done)
        assert refused or number not in ("nan", "1e300", "-1e300", "9" * 5000), (number, done)


@pytest.mark.parametrize(("low", "high", "code"), [(0.0, 1.0, 0), (-0.1, 1.0, 2), (0.0, 1.1, 2)])
def test_a_print_of_floats_holds_shares(
    low: float, high: float, code: int, bench: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_exr(bench / "p.exr", np.linspace(low, high, 12, dtype=np.float32).reshape(3, 4), channel="Y")
    argv = [word.replace("FILE", "p.exr") for word in DOORS["print"]]
    sheet = 'targets=[{type="sheet",name="s",material="white",size=["100 mm","100 mm"]}]'
    done = here([*argv, "--set", sheet, "--no-rays"], capsys)
    assert done.code == code, done
    assert code == 0 or "holds values from" in done.stderr


@pytest.mark.parametrize("size", [(20_000, 20_000), (9_000, 9_000)])
def test_a_large_picture_is_judged_by_its_header(
    size: tuple[int, int], bench: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A header alone: reading the pixels would end otherwise."""
    columns, rows = size
    (bench / "big.pgm").write_bytes(b"P5\n%d %d\n255\n" % (columns, rows))
    for door in ("print", "captured", "image of parts", "image of dots", "image of edge"):
        line = here([word.replace("FILE", "big.pgm") for word in DOORS[door]], capsys).refusal(2)
        assert f"big.pgm: is {columns} x {rows} pixels, the limit is" in line


@pytest.mark.parametrize(
    "vertices",
    [
        [(0, 0), (50, 0), (50, 0), (50, 50), (0, 50)],
        [(0, 0), (50, 0), (50.000001, 0), (50, 50), (0, 50)],
        [(0, 0), (50, 0), (50, 50), (0, 50), (0, 0)],
    ],
)
def test_vertices_of_a_polygon_stand_apart(
    vertices: list[tuple[float, float]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    corners: list[Any] = [[f"{x} mm", f"{y} mm"] for x, y in vertices]
    target = {"type": "polygon", "name": "p", "material": "white", "vertices": corners}
    scene = write_scene(tmp_path, {"targets": [target]})
    for argv in (["render", scene, "--out", tmp_path / "out"], ["explain", scene]):
        assert "scene.toml: targets[0].vertices: vertex" in here(argv, capsys).refusal(2)


@pytest.mark.parametrize("name", ["a\0b.mtl", "loop.mtl", "m" * 5000])
def test_a_mesh_names_sound_material_files(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "loop.mtl").symlink_to("loop.mtl")
    (tmp_path / "a.obj").write_bytes(f"mtllib {name}\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n".encode())
    done = here(["convert", tmp_path / "a.obj", tmp_path / "a.rad", "--length-unit", "1 mm"], capsys)
    assert done.code in (0, 2) and "Traceback" not in done.stderr
    assert done.code == 0 or "not a file in its folder" in done.stderr


def test_the_damaged_plan_of_a_study_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "results.csv").write_text("a,b,y\nL,L,1\nH,L,2\nL,H,3\nH,H,4\n")
    for plan in ([], {"design": 3}, {"design": {"factors": [{"name": 1}]}}, {"design": {"factors": "abc"}}):
        (tmp_path / PLAN).write_text(json.dumps({"schema_version": 1, **plan} if isinstance(plan, dict) else plan))
        line = here(["study", "analyse", tmp_path / "results.csv", "--response", "y"], capsys).refusal(2)
        assert f"{PLAN}: " in line


@pytest.mark.parametrize("led", ["9" * 5000, "1_0", "\u0663"])
def test_numbers_of_leds_are_short(led: str, capsys: pytest.CaptureFixture[str]) -> None:
    done = here(["led", "frame", led, "--emulate", "lamparray"], capsys)
    assert done.code == 2 and "is neither an LED" in done.stderr and len(done.stderr) < 1000
