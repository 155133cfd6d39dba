"""``radwrap led`` as users run it, from a scene to a ring that calibrates itself; all on emulators."""

from __future__ import annotations

import csv
import json
import signal
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

import radwrap
from radwrap.errors import EnvironmentFailure
from radwrap.images import read_image
from radwrap.led.calibration import scaled, write_calibration
from radwrap.led.connect import EmulatorProcess
from radwrap.led.from_scene import leds_of
from radwrap.scene.file.ring_calibration import RingCalibration, read_calibration
from tests.cli.conftest import PATIENCE, here, inhabitants, inside, run, scene_text, scene_with, start, wait_for
from tests.led.test_calibration import RING
from tests.led.test_ring import DRIVE_FILE

LEDS: Final = 4
FULL: Final = 0.06  # W/sr, of the emulated LEDs
NOMINAL: Final = 0.05  # W/sr, in the scene
FACTORS: Final = (1.13, 0.88, 1.0, 0.94)
STEP: Final = FULL / NOMINAL / 4096
# A camera that takes each frame once, in a twentieth of a second.
FILM: Final = ("sh", "-c", 'set -C; : > "$0"; sleep 0.05')
# Of a rendered image at the tolerance below, in the light of one LED.
GRAY_ERROR: Final = 0.5
SENSOR: Final = {
    "rows": 40, "columns": 48, "pixel_width": "50 um", "pixel_height": "55 um", "gain": "3.38e4 (J/m^2)^-0.85",
    "gamma": 0.85, "dark_gray": 22, "saturation_gray": 181,
}  # fmt: skip


def scene_file(folder: Path, name: str, **changes: Any) -> Path:
    """A board under a ring of four LEDs."""
    source = {**RING, "count": LEDS, "diameter": "40 mm", **changes}
    source = {key: value for key, value in source.items() if value is not None}
    camera = {"camera.sensor": SENSOR, "camera.exposure_time": "30 s", "camera.aperture.diameter": "0.1 mm"}
    path = folder / name
    path.write_text(scene_text(scene_with({"sources": [source], **camera})))
    return path


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with blanks in its name: scene, drive, rows, and the light basis of the scene."""
    folder = tmp_path_factory.mktemp("a led bench")
    scene = scene_file(folder, "scene.toml")
    text = DRIVE_FILE.replace("12", str(LEDS), 1).replace("max_level = 0.8", "max_level = 1.0")
    (folder / "drive.toml").write_text(text)
    rng = np.random.default_rng(2)
    rows = [["name", *(f"ring.led{n:02d}" for n in range(LEDS))]]
    rows += [[f"row{k:02d}", *(f"{value:.4f}" for value in rng.uniform(0, 1.2, LEDS))] for k in range(16)]
    with (folder / "rows.csv").open("w", newline="") as stream:
        csv.writer(stream).writerows(rows)
    inside("render", scene, "--basis", "--tolerance", 0.2, "--out", folder / "basis").success()
    return folder


def led(bench: Path, verb: str, *more: object) -> list[object]:
    options = ["--emulate", "--drive", bench / "drive.toml", "--full-scale", "60 mW/sr"]
    return ["led", verb, *options, *more]


def table(path: Path) -> dict[str, np.ndarray]:
    with path.open(newline="") as stream:
        return {row[0]: np.array(row[1:], dtype=float) for row in list(csv.reader(stream))[1:]}


def test_a_scene_lights_the_ring(bench: Path, capsys: pytest.CaptureFixture[str]) -> None:
    argv = led(bench, "set", "--scene", bench / "scene.toml", "--for", "0 s", "--json")
    told = here(argv, capsys).success().json
    assert told["device"]["emulated"] and told["verified"]
    assert told["held"] == pytest.approx([NOMINAL / FULL] * LEDS, abs=0.5 / 4096)
    assert told["steps"] == [round(4096 * NOMINAL / FULL)] * LEDS


def test_levels_intensities_and_single_leds(bench: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words, held in (
        ((0.25,), [0.25] * LEDS),
        ((0, 0.5, 0, 1), [0, 0.5, 0, 1]),
        (("30 mW/sr",), [0.5] * LEDS),
    ):
        assert here(led(bench, "set", *words, "--for", "0 s", "--json"), capsys).success().json["held"] == held
    told = here(led(bench, "frame", 2, "--level", 0.5, "--for", "0 s", "--json"), capsys).json
    assert told["held"] == [0, 0, 0.5, 0]
    assert here(led(bench, "frame", "dark", "--for", "0 s", "--json"), capsys).json["held"] == [0] * LEDS


def test_an_emulator_is_named_from_the_folder_of_the_command(
    bench: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The guardian works in another folder."""
    with EmulatorProcess("mcp2221a_pca9685", LEDS) as running:
        socket = Path(running.socket)
        monkeypatch.chdir(socket.parent)
        argv = [
            "led",
            "set",
            0.25,
            "--emulator",
            socket.name,
            "--drive",
            bench / "drive.toml",
            "--for",
            "0 s",
            "--json",
        ]
        assert here(argv, capsys).success().json["held"] == [0.25] * LEDS


def test_list_show_and_off(capsys: pytest.CaptureFixture[str]) -> None:
    assert "uaccess" in here(["led", "list", "--udev"], capsys).success().stdout
    assert here(["led", "show", "--emulate", "--json"], capsys).json["device"]["readback"] is True
    assert here(["led", "show", "--emulate", "lamparray", "--json"], capsys).json["held"] is None
    done = here(["led", "off", "--emulate", "lamparray"], capsys).success()
    assert "as commanded" in done.stdout and "emulated" in done.stderr


@pytest.mark.long
def test_doctor_knows_the_way_to_the_ring(capsys: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def row() -> dict[str, Any]:
        told = here(["doctor", "--json"], capsys).success().json
        (one,) = (check for check in told["checks"] if check["name"] == "hidapi")
        return dict(one)

    assert row()["found"] and row()["version"] == version("hidapi") and "hid" in row()["place"]
    monkeypatch.setitem(sys.modules, "hid", None)
    monkeypatch.setitem(sys.modules, "hidraw", None)
    assert not row()["found"] and not row()["needed"] and 'pip install "radwrap[led]"' in row()["remedy"]


BAD: Final = {
    "no drive": (["set", 0.5, "--emulate"], "rated current is not known"),
    "too bright": (["set", "70 mW/sr"], "lies outside what was measured"),
    "not a level": (["set", "bright"], "write 0.25"),
    "count": (["set", 0.1, 0.2], "2 levels for 4 LEDs"),
    "nothing": (["set"], "give levels, or --scene"),
    "no such LED": (["frame", 4], "neither an LED, 0 to 3"),
    "other count": (["set", 0.5, "--count", 5], "--count has 5 LEDs; --drive has 4 LEDs"),
    "no ring": (["set", 0.5, "--device", "none", "--emulator", "/nowhere"], "no emulator answers"),
    "nothing to play": (["play", "SCENE", "--out", "OUT"], "there is nothing to play"),
    "ripple": (["set", "--scene", "BRIEF"], "makes an exposure of 0.001 s uncertain"),
    "factor of nothing": (["set", 0.25, "--factor", 3], "--factor: is on the radiant intensities of a scene"),
    "negative factor": (["set", "--scene", "SCENE", "--factor=-1"], '--factor: "-1" is not a number of 0 or more'),
    "less than a step": (["set", 1e-5], "LED 0: level 1e-05 is not a whole step"),
    "foreign digits": (["frame", "٣"], "neither an LED, 0 to 3"),
    "an underscore": (["frame", 1, "--level", "1_0e-2"], '--level: "1_0e-2" is not a number of 0 or more'),
    "light backwards": (["set", 0.25, "--for", "-1 s"], '--for: "-1 s" is negative'),
    "light for ever": (["set", 0.25, "--for", "1e300 s"], '--for: "1e300 s" is more than a year'),
    "settling backwards": (["play", "SCENE", "--alone", "--out", "OUT", "--settle", "-1 s"], '--settle: "-1 s"'),
}


@pytest.mark.parametrize("fault", list(BAD))
def test_bad_commands_are_refused(bench: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], fault: str) -> None:
    words, expected = BAD[fault]
    places = {"SCENE": bench / "scene.toml", "OUT": tmp_path / "out", "BRIEF": tmp_path / "brief.toml"}
    brief = (bench / "scene.toml").read_text().replace('"30 s"', '"1 ms"')
    places["BRIEF"].write_text(brief)
    words = [places.get(word, word) for word in words]
    argv = ["led", *words] if fault == "no drive" else led(bench, words[0], *words[1:])
    if fault == "no ring":
        argv.remove("--emulate")
    done = here(argv, capsys)
    assert done.code in (2, 4)
    (line,) = done.stderr.splitlines()
    assert expected in line and done.stdout == ""


@pytest.mark.parametrize("verb", [["set", 0.25], ["play", "SCENE", "--alone", "--out", "OUT"]])
def test_without_stdin_there_is_no_enter(
    bench: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, verb: list[object]
) -> None:
    monkeypatch.setattr(sys, "stdin", None)  # as Python has it where the shell closed it: <&-
    places = {"SCENE": bench / "scene.toml", "OUT": tmp_path / "out"}
    refused = here(led(bench, *(places.get(str(word), word) for word in verb)), capsys).refusal(2)
    assert "stdin: is closed" in refused
    assert not (tmp_path / "out").exists()


def test_a_study_is_played_as_it_was_designed(bench: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """16 rows: the ring shows each to half a PWM step, and its light renders the design's image."""
    argv = led(bench, "play", bench / "scene.toml", "--rows", bench / "rows.csv", "--out", tmp_path / "play")
    here([*argv, "--settle", "0 s", "--camera", *FILM, "{name} {number}"], capsys).success()
    assert len(list((tmp_path / "play").glob("row*"))) == 16
    design, played = table(bench / "rows.csv"), table(tmp_path / "play" / "played.csv")
    assert list(played) == ["dark", *design]
    worst = max(np.abs(played[name] - design[name]).max() for name in design)
    assert worst <= 0.5 * STEP * (1 + 1e-9)
    record = json.loads((tmp_path / "play" / "play.json").read_text())
    assert record["emulated"] and record["complete"] and all(frame["verified"] for frame in record["frames"].values())
    grays = {}
    for name, path in (("design", bench / "rows.csv"), ("played", tmp_path / "play" / "played.csv")):
        here(["relight", bench / "basis", "--levels", path, "--out", tmp_path / name, "--exposure"], capsys).success()
        exposures = {row: read_image(tmp_path / name / f"{row}.exr")[0].astype(float) for row in design}
        grays[name] = {row: 3.38e4 * exposure**0.85 + 22 for row, exposure in exposures.items()}
    for row in design:
        # Half a step of each of the LEDs, through the slope of Eq. 5 at most gamma (G - G0) per share of the light.
        allowed = 0.85 * (grays["design"][row].max() - 22) * LEDS * 0.5 * STEP / max(design[row].sum(), 0.1) + 1e-3
        assert np.abs(grays["played"][row] - grays["design"][row]).max() < allowed
        assert allowed < 0.2


@pytest.mark.long
def test_an_interrupted_play_goes_on_where_it_was(
    bench: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    argv = led(bench, "play", bench / "scene.toml", "--rows", bench / "rows.csv", "--alone", "--out", tmp_path / "play")
    argv += ["--settle", "0 s", "--camera", *FILM, "{name}"]
    with start(argv) as process:
        assert wait_for((tmp_path / "play" / "row03").exists, process), "the run was too short"
        process.kill()
    assert process.returncode == -signal.SIGKILL
    record = json.loads((tmp_path / "play" / "play.json").read_text())
    assert not record["complete"] and "row02" in record["frames"]
    assert not (tmp_path / "play" / "played.csv").exists()
    for path in (tmp_path / "play").glob("row*"):
        if path.name not in record["frames"]:
            path.unlink()  # of a frame that was not done, whose file the camera writes anew
    here(argv, capsys).success()
    frames = json.loads((tmp_path / "play" / "play.json").read_text())["frames"]
    assert list(frames) == ["dark", *(f"led{n:02d}" for n in range(LEDS)), *(f"row{n:02d}" for n in range(16))]
    changed = [word if word != "60 mW/sr" else "61 mW/sr" for word in argv]
    assert "another sequence" in here(changed, capsys).stderr
    assert inhabitants(tmp_path) == []


def test_a_camera_may_leave_something_running(bench: Path, tmp_path: Path, capsys: Any) -> None:
    """A process in the background that holds what it inherited, as the camera's own service may."""
    argv = led(bench, "play", bench / "scene.toml", "--alone", "--out", tmp_path, "--settle", "0 s", "--camera")
    command = f"(sleep {PATIENCE:g} & setsid sleep 3 &); true"
    done = here([*argv, "sh", "-c", command], capsys).success()
    assert done.wall < PATIENCE / 2


def test_a_camera_that_takes_too_long_is_ended_with_the_light(bench: Path, tmp_path: Path, capsys: Any) -> None:
    text = (bench / "drive.toml").read_text().replace('"60 s"', '"0.3 s"')
    (tmp_path / "brief.toml").write_text(text)
    argv = led(bench, "play", bench / "scene.toml", "--alone", "--out", tmp_path / "play", "--settle", "0 s")
    argv[argv.index(bench / "drive.toml")] = tmp_path / "brief.toml"
    slow = f"import sys, time; time.sleep({PATIENCE} * (sys.argv[1] != 'dark'))"
    done = here([*argv, "--camera", sys.executable, "-c", slow, "{name}"], capsys)
    assert done.code == 4 and "was lit for max_on_time, 0.3 s" in done.stderr
    assert done.wall < PATIENCE / 2
    assert inhabitants(tmp_path / "play") == []


def test_the_runs_of_a_study_are_played(bench: Path, tmp_path: Path, capsys: Any) -> None:
    design = tmp_path / "design.toml"
    design.write_text(
        f"scene = {str(bench / 'scene.toml')!r}\n[design]\nkind = 'full'\n[responses.mean]\nmeasure = 'mean_gray'\n"
        "[factors.A]\nkey = 'sources[0].leds[1].radiance_factor'\nlevels = [0.5, 1.1]\n"
    )
    argv = led(bench, "play", bench / "scene.toml", "--design", design, "--out", tmp_path / "play")
    here([*argv, "--camera", "true"], capsys).success()
    played = table(tmp_path / "play" / "played.csv")
    assert list(played) == ["dark", "run0001", "run0002"]
    for name, factor in (("run0001", 0.5), ("run0002", 1.1)):
        assert played[name] == pytest.approx([1, factor, 1, 1], abs=0.5 * STEP)


def test_what_is_wrong_with_a_frame_is_told_without_gaps(bench: Path, tmp_path: Path, capsys: Any) -> None:
    argv = ["led", "play", bench / "scene.toml", "--alone", "--out", tmp_path, "--emulate", "--drive"]
    done = here([*argv, bench / "drive.toml", "--camera", "true"], capsys)
    assert 'frame "dark": radiant intensities need a calibration' in done.stderr


def test_a_camera_that_fails_ends_the_play(bench: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    argv = led(bench, "play", bench / "scene.toml", "--alone", "--out", tmp_path / "play")
    done = here([*argv, "--camera", "sh", "-c", "echo no film >&2; exit 1"], capsys)
    assert done.code == 4 and "no film" in done.stderr
    done = run(*argv)
    assert done.code == 2 and "--camera" in done.stderr, "stdin has no Enter to give"


@pytest.mark.long
def test_the_twin_calibrates_itself(bench: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A ring with factors of its own, seen in rendered captures of 8 bit; then a scene loads what was found."""
    changes = [{"index": n, "radiance_factor": factor} for n, factor in enumerate(FACTORS)]
    real = scene_file(tmp_path, "real.toml", leds=changes)
    here(["render", real, "--basis", "--tolerance", 0.2, "--seed", 9, "--out", tmp_path / "real"], capsys).success()
    names = [f"ring.led{n:02d}" for n in range(LEDS)]
    rows = [["name", *names], ["dark", *[0] * LEDS]]
    rows += [[f"led{n:02d}", *[int(n == m) for m in range(LEDS)]] for n in range(LEDS)]
    with (tmp_path / "alone.csv").open("w", newline="") as stream:
        csv.writer(stream).writerows(rows)
    here(
        ["relight", tmp_path / "real", "--levels", tmp_path / "alone.csv", "--out", tmp_path / "film"], capsys
    ).success()
    copy = "import shutil, sys; shutil.copy(sys.argv[1], '.')"
    film = tmp_path / "film" / "{name}.png"
    play = led(bench, "play", bench / "scene.toml", "--alone", "--out", tmp_path / "play", "--settle", "0 s")
    run(*play, "--camera", sys.executable, "-c", copy, film).success()
    argv = ["led", "calibrate", "--captures", tmp_path / "play", "--basis", bench / "basis", "--date", "2026-01-01"]
    told = here([*argv, "--out", tmp_path / "ring.json", "--json"], capsys).success().json
    assert told["emulated"]
    for found, true in zip(told["leds"], FACTORS, strict=True):
        assert abs(found["factor"] - true) < 4 * found["factor_standard_error"]
        assert found["factor_standard_error"] < 0.01
    calibration = read_calibration(tmp_path / "ring.json")
    assert calibration.emulated and calibration.serial == "EMULATED01" and calibration.current == 0.05
    twin = scene_file(tmp_path, "twin.toml", radiant_intensity=None, calibration="ring.json",
                      drive_levels=calibration.leds[0].levels[-1])  # fmt: skip
    for one, true in zip(leds_of(radwrap.load_scene(twin)), leds_of(radwrap.load_scene(real)), strict=True):
        assert one.radiant_intensity == pytest.approx(true.radiant_intensity, rel=0.01)
    (tmp_path / "play" / "led02.png").unlink()
    assert "led02.png: no such image" in here([*argv, "--out", tmp_path / "no.json"], capsys).refusal(2)
    assert not (tmp_path / "no.json").exists()


def test_a_table_becomes_a_calibration(bench: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "table.csv").write_text(
        "led,level,radiant_intensity\n" + "".join(f"{n},0,0 mW/sr\n{n},1,{50 + n} mW/sr\n" for n in range(LEDS))
    )
    argv = ["led", "calibrate", "--table", tmp_path / "table.csv", "--out", tmp_path / "ring.json"]
    assert "needs the current" in here(argv, capsys).refusal(2)
    argv += ["--drive", bench / "drive.toml", "--serial", "EMULATED01", "--temperature", 23, "--date", "2026-01-01"]
    cold = "not a temperature in degrees Celsius"
    for degrees, told in {"nan": "must be a number", "inf": "must be a number", "-273.15": cold, "-500": cold}.items():
        words = [degrees if word == 23 else word for word in argv]
        words[words.index("--temperature") : words.index("--date")] = [f"--temperature={degrees}"]
        assert told in here(words, capsys).refusal(2)
    here(argv, capsys).success()
    expected = RingCalibration(
        leds=scaled([float(f"0.0{50 + n}") for n in range(LEDS)], [0.0] * LEDS, [1.0] * LEDS),
        serial="EMULATED01", date="2026-01-01", temperature=296.15, current=0.05, emulated=False,
        source="table table.csv",
    )  # fmt: skip
    assert read_calibration(tmp_path / "ring.json") == expected
    write_calibration(tmp_path / "same.json", expected)
    assert (tmp_path / "same.json").read_bytes() == (tmp_path / "ring.json").read_bytes()
    options = ["--emulate", "--drive", bench / "drive.toml", "--calibration", tmp_path / "ring.json"]
    told = here(["led", "set", *options, "26 mW/sr", "--for", "0 s", "--json"], capsys).success().json
    assert told["held"] == pytest.approx([26 / (50 + n) for n in range(LEDS)], abs=0.5 / 4096)


def test_a_folder_too_deep_for_the_emulator_is_one_clear_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    deep = tmp_path / ("d" * 100)
    deep.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(deep))
    with pytest.raises(EnvironmentFailure, match="too long a name for a socket; set TMPDIR"):
        EmulatorProcess()
    assert not list(deep.iterdir())
