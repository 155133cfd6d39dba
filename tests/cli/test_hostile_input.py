"""Broken and hostile input: one line that names the place, the right exit code, nothing under a final name."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from tests.cli.conftest import (
    REMOVE,
    children,
    files_in,
    here,
    inhabitants,
    run,
    scene_text,
    scene_with,
    side_by_side,
    write_scene,
)


@dataclass(frozen=True, eq=False)
class Case:
    """A command that must be refused.

    Attributes
    ----------
    name : str
        What is wrong.
    says : tuple of str
        What its one line must hold.
    changes : Mapping
        How the scene differs from the small one.
    options : tuple
        Further options of `radwrap render`.
    text : bytes, optional
        The whole scene file instead.
    """

    name: str
    says: tuple[str, ...]
    changes: Mapping[str, Any] = field(default_factory=dict)
    options: tuple[object, ...] = ()
    text: bytes | None = None


def _lay(folder: Path, case: Case) -> Path:
    folder.mkdir()
    if case.text is None:
        return write_scene(folder, case.changes)
    path = folder / "scene.toml"
    path.write_bytes(case.text)
    return path


def _argv(case: Case, scene: Path) -> list[object]:
    return ["render", scene, "--out", scene.parent / "out", "--viewpoints", 7, *case.options]


def _changed(name: str, key: str, value: Any, *says: str, **more: Any) -> Case:
    """One key changed; the message names it, or what it says."""
    return Case(name, says, {key: value, **more})


def _named(key: str) -> str:
    """Key path of a change, as messages write it."""
    return "scene.toml: " + re.sub(r"\.(\d+)", r"[\1]", key)


LENGTH = "camera.focal_length"
QUANTITIES = [
    Case(f"length {text!r}", (_named(LENGTH),), {LENGTH: text})
    for text in ("12,5 mm", "12.5mm", "12.5  mm", "12 5 mm", "1e999 mm", "nan mm", "inf mm", math.nan, math.inf, 12.5)
]

RING = {
    "type": "ring",
    "name": "ring",
    "position": ["0 mm", "0 mm", "500 mm"],
    "look_at": ["0 mm", "0 mm", "0 mm"],
    "count": 3,
    "diameter": "25 mm",
    "led_diameter": "5 mm",
    "radiance": "2324 W/m^2/sr",
    "beam": {"profile": "gaussian", "width": "20 deg"},
}
TABLE = {
    "type": "retroreflective",
    "model": "coefficient",
    "observation_angles": ["0.1 deg", "0.2 deg"],
    "entrance_angles": ["0 deg", "30 deg"],
    "coefficients": [["300 cd/lx/m^2", "180 cd/lx/m^2"], ["250 cd/lx/m^2", "150 cd/lx/m^2"]],
}
SHEET = {"type": "sheet", "name": "sheet", "material": "white", "size": ["100 mm", "100 mm"]}
AT_CAMERA = {"name": "thing", "material": "white", "position": ["0 mm", "0 mm", "500 mm"]}


def _polygon(*vertices: tuple[int, int]) -> dict[str, Any]:
    return {"type": "polygon", "material": "white", "vertices": [[f"{x} mm", f"{y} mm"] for x, y in vertices]}


SCENES = [
    # Units
    _changed(
        "unit of power for intensity", "sources.0.radiant_intensity", "47 W", "sources[0].radiant_intensity", "W/sr"
    ),
    _changed("angle in mm", "targets.0.rotation", ["1 mm", "0 deg", "0 deg"], "targets[0].rotation[0]", '"mm"'),
    # Sizes
    _changed("focal length zero", "camera.focal_length", "0 mm", "camera.focal_length"),
    _changed("pinhole negative", "camera.aperture.diameter", "-0.1 mm", "camera.aperture.diameter"),
    _changed("exposure negative", "camera.exposure_time", "-1 ms", "camera.exposure_time"),
    _changed("no rows", "camera.sensor.rows", 0, "camera.sensor.rows"),
    _changed("rows of a fraction", "camera.sensor.rows", 20.5, "camera.sensor.rows"),
    _changed("gamma nan", "camera.sensor.gamma", math.nan, "camera.sensor.gamma"),
    _changed("reflectance above 1", "materials.white.reflectance", 1.1, "materials.white.reflectance"),
    _changed("a number of 400 digits", "camera.sensor.gamma", 10**400, "camera.sensor.gamma"),
    # Unknown keys
    _changed("unknown table", "extra", {"a": 1}, "scene.toml: extra", "unknown key"),
    _changed("unknown key of the camera", "camera.zoom", 1, "camera.zoom", "unknown key"),
    _changed("unknown key of the aperture", "camera.aperture.zoom", 1, "camera.aperture.zoom", "unknown key"),
    _changed("unknown key of the sensor", "camera.sensor.zoom", 1, "camera.sensor.zoom", "unknown key"),
    _changed("unknown key of a source", "sources.0.zoom", 1, "sources[0].zoom", "unknown key"),
    _changed("unknown key of a beam", "sources.0.beam.zoom", 1, "sources[0].beam.zoom", "unknown key"),
    _changed("unknown key of a material", "materials.white.zoom", 1, "materials.white.zoom", "unknown key"),
    _changed("unknown key of a target", "targets.0.zoom", 1, "targets[0].zoom", "unknown key"),
    # Missing keys
    _changed("no camera", "camera", REMOVE, "scene.toml: camera", "is missing"),
    _changed("no focal length", "camera.focal_length", REMOVE, "camera.focal_length", "is missing"),
    _changed("no position", "camera.position", REMOVE, "scene.toml: camera", "position"),
    _changed("no attitude", "camera.look_at", REMOVE, "scene.toml: camera", "look_at"),
    _changed("no columns", "camera.sensor.columns", REMOVE, "camera.sensor.columns", "is missing"),
    _changed("no beam", "sources.0.beam", REMOVE, "sources[0].beam", "is missing"),
    _changed("no position of a source", "sources.0.position", REMOVE, "sources[0].position", "is missing"),
    _changed("no level of a source", "sources.0.radiance", REMOVE, "sources[0]", "radiance"),
    _changed("no type", "targets.0.type", REMOVE, "targets[0]", "type"),
    _changed("no pitch", "targets.0.pitch", REMOVE, "targets[0].pitch", "is missing"),
    # Wrong types
    _changed("array for a quantity", "camera.focal_length", ["12.5 mm"], "camera.focal_length"),
    _changed("bool for a number", "materials.white.reflectance", True, "materials.white.reflectance"),
    _changed("number for a table", "camera.aperture", 3, "camera.aperture"),
    _changed("table for an array", "targets", {"a": 1}, "scene.toml: targets"),
    _changed("string for a number", "camera.sensor.gamma", "0.85", "camera.sensor.gamma"),
    _changed("name with a command", "targets.0.name", "board !touch touched", "targets[0].name"),
    # A whole scene
    _changed("empty scene", "targets", REMOVE, "scene.toml: targets", "empty"),
    _changed("no light", "sources", REMOVE, "scene.toml: sources", "no light"),
    _changed("all sources dark", "sources.0.radiance", "0 W/m^2/sr", "scene.toml: sources", "no light"),
    _changed("same name twice", "sources.0.name", "board", "targets[0].name", '"board"', "twice"),
    _changed("unknown material", "targets.0.dot_material", "gold", "targets[0].dot_material", '"gold"'),
    _changed("unknown preset", "camera.sensor.preset", "fvis", "camera.sensor", '"fvis"', "fivs"),
    _changed("unknown type", "targets.0.type", "torus", "targets[0]", "torus"),
    # Camera
    _changed(
        "camera in a box", "targets.0", {"type": "box", "size": ["1 mm"] * 3, **AT_CAMERA}, "camera.position", "inside"
    ),
    _changed(
        "camera in a sphere",
        "targets.0",
        {"type": "sphere", "diameter": "1 mm", **AT_CAMERA},
        "camera.position",
        "inside",
    ),
    _changed(
        "camera in a cylinder",
        "targets.0",
        {"type": "cylinder", "diameter": "1 mm", "length": "1 mm", **AT_CAMERA},
        "camera.position",
        "inside",
    ),
    _changed(
        "camera on the board",
        "camera.position",
        ["0 mm", "0 mm", "0 mm"],
        "camera.position",
        "board",
        **{"camera.look_at": ["0 mm", "0 mm", "1 m"]},
    ),
    _changed("camera looks at itself", "camera.look_at", ["0 mm", "0 mm", "500 mm"], "camera.look_at"),
    _changed("up along the view", "camera.up", [0, 0, 2], "camera", "up", "parallel"),
    _changed("annular without inner diameter", "camera.aperture.shape", "annular", "camera.aperture", "inner_diameter"),
    # Sensor
    _changed(
        "gain with another exponent", "camera.sensor.gain", "3.38e4 (J/m^2)^-0.9", "camera.sensor", "gain", "gamma"
    ),
    _changed("gain without unit", "camera.sensor.gain", "3.38e4", "camera.sensor", "gain"),
    _changed("gain negative", "camera.sensor.gain", "-1 (J/m^2)^-0.85", "camera.sensor", "gain"),
    _changed("saturation below dark", "camera.sensor.saturation_gray", 21, "camera.sensor", "saturation_gray"),
    _changed(
        "saturation beyond the bits", "camera.sensor.saturation_gray", 256, "camera.sensor", "saturation_gray", "8 bits"
    ),
    # Targets
    _changed("polygon without area", "targets.0", _polygon((0, 0), (10, 10), (20, 20)), "targets[0].vertices", "area"),
    _changed(
        "polygon that crosses itself",
        "targets.0",
        _polygon((0, 0), (10, 10), (10, 0), (0, 12)),
        "targets[0].vertices",
        "cross",
    ),
    _changed("polygon of two points", "targets.0", _polygon((0, 0), (10, 10)), "targets[0].vertices"),
    _changed(
        "polygon that crosses itself in a corner",
        "targets.0",
        _polygon((0, 0), (30, 30), (30, 0), (10, 10), (0, 20)),
        "targets[0].vertices",
        "cross",
    ),
    _changed("dots overlap", "targets.0.dot_diameter", "41 mm", "targets[0]", "dots overlap"),
    _changed(
        "edge outside",
        "targets.0",
        {**SHEET, "type": "edge", "edge_material": "black", "edge_position": "60 mm"},
        "targets[0]",
        "edge_position",
    ),
    # Sources
    _changed("LED that the ring has not", "sources.0", {**RING, "leds": [{"index": 3}]}, "sources[0]", "index 3"),
    _changed("LED twice", "sources.0", {**RING, "leds": [{"index": 1}, {"index": 1}]}, "sources[0]", "twice"),
    _changed(
        "unknown key of an LED", "sources.0", {**RING, "leds": [{"index": 1, "zoom": 1}]}, "leds[0].zoom", "unknown key"
    ),
    _changed("source too wide", "sources.0.diameter", "200 mm", "sources[0]", '"lamp"', "too wide"),
    _changed("two levels of a source", "sources.0.radiant_intensity", "1 W/sr", "sources[0]", "radiant_intensity"),
    # Sheeting
    _changed("sheeting seen where its table ends", "materials.white", TABLE, "materials.white", "observation angles"),
    _changed(
        "sheeting's table of another shape",
        "materials.white",
        {**TABLE, "coefficients": [["1 1/sr"]]},
        "materials.white",
        "coefficients",
    ),
    # Size
    _changed(
        "sensor of 1.6e9 pixels",
        "camera.sensor.rows",
        40000,
        "camera.sensor",
        "1.6e+09 pixels",
        "GiB of memory",
        " minutes",
        **{"camera.sensor.columns": 40000},
    ),
]


FILES = [
    Case("no TOML", ("scene.toml", "is not TOML", "line 1"), text=b"camera = {\n"),
    Case("key twice", ("scene.toml", "is not TOML"), text=b"title = 'a'\ntitle = 'b'\n"),
    Case("no UTF-8", ("scene.toml", "is not UTF-8"), text=b"title = '\xff\xfe'\n"),
    Case("NUL", ("scene.toml", "holds a NUL byte"), text=b"title = 'a\0b'\n"),
    Case("empty file", ("scene.toml: camera", "is missing"), text=b""),
    Case("date", ("scene.toml: title", "date"), text=b"title = 2020-01-01\n"),
    Case("array in 10000 arrays", ("scene.toml", "nested more than 64 levels"), text=b"title = " + b"[" * 10000),
    Case("number of 5000 digits", ("scene.toml", "an integer of more than 64 bits"), text=b"title = 1" + b"0" * 5000),
    Case("terminal commands", ("camera.focal_length",), {"camera.focal_length": "\u001b[2J mm"}),
    Case("17 MiB", ("scene.toml", "16 MiB"), text=b"#" * (17 << 20)),
]

OPTIONS = [
    Case("viewpoints 0", ("--viewpoints",), options=("--viewpoints", 0)),
    Case("viewpoints -1", ("--viewpoints",), options=("--viewpoints", -1)),
    Case("viewpoints 1e9", ("--viewpoints",), options=("--viewpoints", "1e9")),
    Case("viewpoints 1000000000", ("--viewpoints",), options=("--viewpoints", 1_000_000_000)),
    Case("pixel samples 0", ("--pixel-samples",), options=("--pixel-samples", 0)),
    Case("workers 0", ("--workers",), options=("--workers", 0)),
    Case("seed -1", ("--seed",), options=("--seed", -1)),
    Case("max pixels 0", ("--max-pixels",), options=("--max-pixels", 0)),
    Case("max pixels nan", ("--max-pixels",), options=("--max-pixels", "nan")),
    Case("timeout abc", ("--tracer-timeout", "abc"), options=("--tracer-timeout", "abc")),
    Case("timeout negative", ("--tracer-timeout",), options=("--tracer-timeout", "-1 s")),
    Case("layout unknown", ("--layout", "spiral"), options=("--layout", "spiral")),
    Case("option unknown", ("--zoom",), options=("--zoom",)),
    Case("hexagonal with 8", ("hexagonal", "--viewpoints"), options=("--viewpoints", 8, "--layout", "hexagonal")),
    Case(
        "viewpoints of an infinitesimal pinhole",
        ("--method pinhole",),
        {"camera.aperture.diameter": "0 mm"},
        ("--method", "viewpoints"),
    ),
    Case("viewpoints with one alone", ("--viewpoints: there are no", "pinhole"), options=("--method", "pinhole")),
    Case(
        "viewpoints of no diameter", ("--viewpoints: there are no", "is 0"), {"camera.aperture": {"diameter": "0 mm"}}
    ),
    Case("set without value", ("--set", "nonsense"), options=("--set", "nonsense")),
    Case("set an unknown key", ("scene.toml: camera.zoom", "unknown key"), options=("--set", "camera.zoom=1")),
    Case(
        "set 5000 digits",
        ("--set: ", "an integer of more than 64 bits"),
        options=("--set", f"camera.sensor.rows={'1' * 5000}"),
    ),
    Case("set what is not there", ("scene.toml: targets[9].pitch",), options=("--set", 'targets[9].pitch="1 mm"')),
    Case("set no path", ("scene.toml: camera..x",), options=("--set", "camera..x=1")),
    Case("set not finite", ("scene.toml: camera.sensor.gamma",), options=("--set", "camera.sensor.gamma=nan")),
    Case(
        "set a wrong unit",
        ("scene.toml: camera.exposure_time", '"mm"'),
        options=("--set", "camera.exposure_time=64 mm"),
    ),
]


ALL = [*QUANTITIES, *SCENES, *FILES, *OPTIONS]


@pytest.mark.parametrize("case", [pytest.param(case, id=case.name) for case in ALL])
def test_bad_input_is_refused_in_one_line(case: Case, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    home = tmp_path / "home"
    line = here(_argv(case, _lay(home, case)), capsys).refusal(2)
    assert [text for text in case.says if text not in line] == [], line
    assert len(line) < 1000
    # Where it is the number of sub-viewpoints that is wrong the folder was taken already.
    assert set(files_in(tmp_path)) <= {"home/scene.toml", "home/out/.radwrap.lock"}
    assert children() == []


@pytest.mark.parametrize("chosen", [90, pytest.param(15, marks=pytest.mark.long)])
def test_the_command_itself_refuses_in_the_same_words(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], chosen: int
) -> None:
    cases = ALL[::chosen]
    scenes = [_lay(tmp_path / str(number), case) for number, case in enumerate(cases)]
    argv = [_argv(case, scene) for case, scene in zip(cases, scenes, strict=True)]
    for words, done in zip(argv, side_by_side(lambda words: run(*words), argv), strict=True):
        assert done.refusal(2) == here(words, capsys).refusal(2)
    assert {Path(name).name for name in files_in(tmp_path)} <= {"scene.toml", ".radwrap.lock"}
    assert inhabitants(tmp_path) == []


def test_what_is_no_scene_file_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pipe, out = tmp_path / "pipe", tmp_path / "out"
    os.mkfifo(pipe)
    for name in (tmp_path, tmp_path / "missing.toml", pipe, Path("/dev/zero"), tmp_path / ("long" * 100)):
        for verb in (["render", name, "--out", out], ["explain", name], ["convert", name, tmp_path / "out.rad"]):
            assert str(name) in here(verb, capsys).refusal(2)
    assert files_in(tmp_path) == {} and not out.exists()


def test_places_that_cannot_be_written_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Read-only folders are left out: to root they are not."""
    scene = write_scene(tmp_path)
    before = files_in(tmp_path)
    for place, code in {
        scene / "out": 2,
        scene / "deep" / "out": 2,
        scene: 2,
        Path("/dev/null/out"): 2,
        Path("/proc/out"): 4,
        tmp_path / ("long" * 100): 4,
    }.items():
        assert str(place) in here(["render", scene, "--out", place, "--viewpoints", 7], capsys).refusal(code)
        assert str(place) in here(["convert", scene, place / "out.rad"], capsys).refusal(code)
        assert str(place) in here(["convert", scene, place / "out.vf"], capsys).refusal(code)
        assert str(place) in here(["init", place], capsys).refusal(code)
    assert "--out" in here(["render", scene], capsys).refusal(2)
    assert "--out" in here(["render", scene, "--out", ""], capsys).refusal(2)
    assert "out.txt" in here(["convert", scene, tmp_path / "out.txt"], capsys).refusal(2)
    assert files_in(tmp_path) == before
    # A name that is no text: OpenImageIO takes only UTF-8.
    assert "--out" in here(["render", scene, "--out", os.fsdecode(bytes(tmp_path) + b"/\xff")], capsys).refusal(2)
    assert {name for name in files_in(tmp_path) if Path(name).suffix} == {"scene.toml"}


# ---------------------------------------------------------------------------------------------- every key, in process

EVERYTHING: dict[str, Any] = {
    "camera.principal_point": ["11.5 px", "9.5 px"],
    "camera.aperture": {"shape": "annular", "diameter": "0.4 mm", "inner_diameter": "0.1 mm", "rotation": "3 deg"},
    "sources.1": {
        **RING,
        "first_angle": "3 deg",
        "misalignment": {"about_y": "1 deg", "about_z": "2 deg"},
        "leds": [{"index": 1, "axis_tilt": "1 deg", "axis_azimuth": "2 deg"}],
    },
    "sources.2": {
        "type": "disc",
        "name": "disc",
        "position": ["0 mm", "1 m", "1 m"],
        "look_at": ["0 mm"] * 3,
        "radiant_intensity": "1 W/sr",
        "diameter": "5 mm",
    },
    "sources.3": {
        "type": "lamp",
        "name": "bulb",
        "position": ["0 mm", "1 m", "1 m"],
        "rotation": ["180 deg"] * 3,
        "radiance": "1 W/m^2/sr",
        "diameter": "5 mm",
        "beam": {"profile": "cone", "width": "20 deg"},
    },
    "materials.table": {**TABLE, "outside": "hold"},
    "materials.beads": {
        "type": "retroreflective",
        "model": "coefficient",
        "function": "glass_beads",
        "anchor": "95 cd/lx/m^2",
        "outside": "hold",
    },
    "targets.0.margin": "1 mm",
    "targets.0.position": ["0 mm", "0 mm", "1 mm"],
    "targets.1": SHEET,
    "targets.2": {**SHEET, "name": "edge", "type": "edge", "edge_material": "black", "edge_position": "1 mm"},
    "targets.2.position": ["0 mm", "0 mm", "2 mm"],
    "targets.3": {**_polygon((0, 0), (10, 0), (10, 10)), "position": ["0 mm", "0 mm", "3 mm"]},
    "targets.4": {"type": "disc", "material": "white", "diameter": "9 mm", "position": ["0 mm", "0 mm", "5 mm"]},
    "targets.5": {"type": "sphere", "material": "white", "diameter": "9 mm"},
    "targets.6": {"type": "cylinder", "material": "white", "diameter": "9 mm", "length": "8 mm"},
    "targets.7": {"type": "box", "material": "white", "size": ["9 mm"] * 3},
}
# Keys that may be zero or negative; all others are sizes.
SIGNED = re.compile(
    r"position|look_at|rotation|principal_point|first_angle|axis_|about_|vertices|_angles|edge_position"
)
MAY_BE_ZERO = re.compile(r"aperture\.diameter|inner_diameter|exposure_time|margin|radiance|radiant_intensity")
WRONG_UNIT = {"mm": "deg", "m": "deg", "um": "deg", "deg": "mm", "ms": "mm", "px": "mm"}
FORMS = (
    "12,5 {}",
    "12.5{}",
    "12.5  {}",
    " 12.5 {}",
    "12.5 {} ",
    "12 5 {}",
    "12.5\t{}",
    "1e999 {}",
    "1e-999 {}",
    "nan {}",
    "inf {}",
    "1_0 {}",
    "0x10 {}",
    "\u0661 {}",
    "12.5 {}; 3",
    "{}",
    "",
    "12.5",
)


def _leaves(value: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for name, item in value.items():
            yield from _leaves(item, f"{key}.{name}" if key else name)
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from _leaves(item, f"{key}.{index}")
    else:
        yield key, value


def _quantities() -> list[tuple[str, str]]:
    """(key, unit) of every quantity of a scene that holds everything."""
    found = []
    for key, value in _leaves(scene_with(EVERYTHING)):
        match = re.fullmatch(r"-?[0-9.]+ ([a-zA-Z/^0-9]+)", value) if isinstance(value, str) else None
        if match:
            found.append((key, match[1]))
    return found


def _bad_values() -> Iterator[tuple[str, Any]]:
    seen: set[str] = set()
    for key, unit in _quantities():
        if key.endswith((".1", ".2")):
            continue  # read as the first of its vector is
        yield key, f"1 {WRONG_UNIT.get(unit, 'W')}"
        yield key, 12.5
        if not SIGNED.search(key):
            yield key, f"-1 {unit}"
            if not MAY_BE_ZERO.search(key):
                yield key, f"0 {unit}"
        if unit not in seen:
            seen.add(unit)
            yield from ((key, form.format(unit)) for form in FORMS)
            yield from ((key, value) for value in (math.nan, math.inf, True, [f"1 {unit}"], {"value": 1}))


def test_the_scene_that_holds_everything_is_right(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = write_scene(tmp_path, EVERYTHING)
    here(["explain", scene], capsys).success()
    keys = [key for key, _ in _quantities()]
    assert len(keys) > 80 and {"targets.7.size.2", "camera.exposure_time", "sources.1.leds.0.axis_tilt"} <= set(keys)


def test_every_bad_value_of_every_quantity_is_refused_by_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, out = tmp_path / "scene.toml", tmp_path / "out"
    wrong = []
    number = 0
    for key, value in _bad_values():
        number += 1
        scene.write_text(scene_text(scene_with({**EVERYTHING, key: value})), "utf-8")
        done = here(["render", scene, "--out", out], capsys)
        named = done.stderr.startswith(f"radwrap: {_named(key)}: ") and done.stderr.count("\n") == 1
        if done.code != 2 or not named or done.stdout:
            wrong.append((key, value, done))
    assert wrong == []
    assert number > 250
    assert not out.exists()
