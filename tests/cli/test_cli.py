"""The contract of the command: verbs, options, JSON, what is written where, and files that other programs read."""

from __future__ import annotations

import argparse
import fcntl
import gc
import json
import math
import os
import pty
import re
import struct
import subprocess
import sys
import termios
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np
import OpenImageIO as oiio  # noqa: N813  (its own short name)
import pytest

from radwrap.cli.main import _parser
from radwrap.scene.file.load import load_scene
from tests.cli.conftest import (
    COMMAND,
    SLOWER,
    clean_environment,
    files_in,
    here,
    run,
    side_by_side,
    write_scene,
)

REPOSITORY: Final = Path(__file__).parents[2]
EXIT_CODES: Final = (
    "0 done, 1 a check failed, 2 bad input, 3 tolerance not met, 4 environment or tracer, 130 interrupted"
)


def _verbs() -> dict[str, list[str]]:
    """Verbs that the parser knows, each with the verbs below it."""
    return {verb: list(_below(_below(_parser([verb]))[verb])) for verb in _below(_parser([]))}


def _below(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    found = [action.choices for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return dict(found[0]) if found else {}


def _words(text: str) -> str:
    return " ".join(text.split())


# ------------------------------------------------------------------------------------------------ Help, version, init


def test_help_tells_verbs_options_and_exit_codes(capsys: pytest.CaptureFixture[str]) -> None:
    top = here(["--help"], capsys).success()
    assert EXIT_CODES in _words(top.stdout)
    for verb, below in _verbs().items():
        assert re.search(rf"^ +{verb}\s+\w", top.stdout, re.MULTILINE)
        told = here([verb, "--help"], capsys).success()
        assert told.stdout.startswith(f"usage: radwrap {verb}")
        assert told.stderr == top.stderr == ""
        # Prose for people, no mark-up for machines.
        shown = [told, *(here([verb, word, "--help"], capsys).success() for word in below)]
        assert not [help_ for help_ in shown if "``" in help_.stdout]
    assert here(["--version"], capsys).success().stdout == f"radwrap {version('radwrap')}\n"


def test_the_package_is_the_program_too() -> None:
    done = subprocess.run([sys.executable, "-m", "radwrap", "rendre"], capture_output=True, text=True, check=False)
    assert done.returncode == 2 and "render" in done.stderr and "Traceback" not in done.stderr


def test_readme_names_every_verb_and_no_other() -> None:
    """A row for each in the table of verbs, with the verbs below it; and no command in README that is none."""
    text = (REPOSITORY / "README.md").read_text("utf-8")
    verbs = _verbs()
    assert len(verbs) > 8 and verbs["study"]
    for verb, below in verbs.items():
        rows = re.findall(rf"^\| (`radwrap {verb}\b.*?) \|", text, re.MULTILINE)
        assert rows, f"README has no row of {verb}"
        for word in below:
            assert any(re.search(rf"[` ]{word}[` ]", row) for row in rows), f"README does not name {verb} {word}"
    named = re.findall(r"(?:`|^ +\.venv/bin/)radwrap ([a-z]+)", text, re.MULTILINE)
    assert set(named) == verbs.keys()


def test_the_installed_command_answers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The verbs once as programs of their own, without a home or a terminal."""
    argv: list[list[object]] = [["--version"], ["doctor", "--json"], ["init", tmp_path / "new"]]
    argv.append(["explain", REPOSITORY / "rad_scenes" / "bench_board" / "scene.toml", "--no-rays", "--json"])
    bare = {"PATH": "/usr/bin:/bin"}
    for words, done in zip(
        argv, side_by_side(lambda words: run(*words, environment=bare, cwd=tmp_path), argv), strict=True
    ):
        done.success()
        assert done.stderr == "" and done.stdout, words
    assert files_in(tmp_path).keys() == {"new/scene.toml"}
    for words in ([], ["paint"], ["render"], ["init"], ["schema", "too much"]):
        here(words, capsys).refusal(2)


def test_a_command_in_this_process_keeps_no_garbage_from_being_found(capsys: pytest.CaptureFixture[str]) -> None:
    before = gc.get_freeze_count()
    here(["schema"], capsys).success()
    assert gc.get_freeze_count() <= before


@pytest.mark.long
def test_a_process_that_ends_with_its_command_holds_what_it_has_loaded() -> None:
    code = (
        "import atexit, gc, sys; sys.argv[1:] = ['schema']; atexit.register(lambda: print(gc.get_freeze_count()));"
        "from radwrap.cli.program import program; program()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(done.stdout.splitlines()[-1]) > 10_000


def test_init_writes_a_scene_that_renders(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "new" / "er"
    told = here(["init", folder], capsys).success()
    scene = folder / "scene.toml"
    assert str(scene) in told.stdout
    text = scene.read_text("utf-8")
    small = ["--set", "camera.sensor.rows=20", "--set", "camera.sensor.columns=24", "--method", "pinhole"]
    here(["render", scene, "--out", folder / "out", *small], capsys).success()
    assert {"gray.png", "radiant_exposure.exr", "manifest.json"} <= set(files_in(folder / "out"))
    # Never over somebody's work.
    scene.write_text(text + "# mine\n", "utf-8")
    assert "there already" in here(["init", folder], capsys).refusal(2)
    assert scene.read_text("utf-8") == text + "# mine\n"


@pytest.mark.long
def test_what_the_first_scene_holds_in_comments_is_right(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    here(["init", tmp_path], capsys).success()
    lines = (tmp_path / "scene.toml").read_text("utf-8").splitlines()
    assignment = re.compile(r"# ((?:[a-z_]+ = |\[\[).*)")
    silent = [number for number, line in enumerate(lines) if assignment.fullmatch(line)]
    assert len(silent) > 15
    spoken = [assignment.sub(r"\1", line) for line in lines]
    path = tmp_path / "all.toml"
    path.write_text("\n".join(spoken), "utf-8")
    everything = here(["explain", path, "--json"], capsys).success().json["scene"]
    assert everything["sources"][0]["changes"] and everything["camera"]["sensor"]["rows"] == 165
    # What "or" offers in a remark, in place of what stands there.
    for old, new in re.findall(r'^(\w+ = "[^"]*") +# or (\w+ = "[^"]*")$', "\n".join(lines), re.MULTILINE):
        path.write_text("\n".join(lines).replace(old, new), "utf-8")
        here(["explain", path], capsys).success()
        break
    else:
        pytest.fail("no alternative is offered")
    for kind in (
        "led",
        "lamp",
        "disc",
        "sheet",
        "edge",
        "polygon",
        "sphere",
        "cylinder",
        "box",
        "rad",
        "coefficient",
        "half_disc",
    ):
        assert kind in "\n".join(lines), kind


# ------------------------------------------------------------------------------------------------------------- Schema


def _fits(value: Any, schema: dict[str, Any], root: dict[str, Any]) -> bool:
    """Whether a value fits a JSON schema, as far as ours goes; an unknown key word is an error."""
    if "$ref" in schema:
        name = schema["$ref"].removeprefix("#/$defs/")
        if not _fits(value, root["$defs"][name], root):
            return False
    types = {"string": str, "boolean": bool, "object": dict, "array": list, "null": type(None), "number": (int, float)}
    for key, rule in schema.items():
        match key:
            case "type":
                is_flag = isinstance(value, bool)
                whole = isinstance(value, int) and not is_flag if rule == "integer" else isinstance(value, types[rule])
                good = whole and (rule == "boolean" or not is_flag)
            case "const":
                good = value == rule
            case "enum":
                good = value in rule
            case "pattern":
                good = not isinstance(value, str) or re.search(rule, value) is not None
            case "minimum" | "maximum" | "exclusiveMinimum":
                sign = -1 if key == "maximum" else 1
                number = isinstance(value, int | float)
                good = not number or sign * value > sign * rule or (value == rule and key != "exclusiveMinimum")
            case "minLength" | "minItems":
                good = not isinstance(value, str | list) or len(value) >= rule
            case "maxLength" | "maxItems":
                good = not isinstance(value, str | list) or len(value) <= rule
            case "required":
                good = all(name in value for name in rule)
            case "properties":
                good = all(_fits(value[name], part, root) for name, part in rule.items() if name in value)
            case "additionalProperties":
                others = [item for name, item in value.items() if name not in schema.get("properties", {})]
                good = all(rule is not False and _fits(item, rule, root) for item in others)
            case "propertyNames":
                good = all(_fits(name, rule, root) for name in value)
            case "patternProperties":
                good = all(
                    _fits(item, part, root)
                    for pattern, part in rule.items()
                    for name, item in value.items()
                    if re.search(pattern, name)
                )
            case "items":
                good = rule is False or all(_fits(item, rule, root) for item in value)
            case "prefixItems":
                good = all(_fits(item, part, root) for item, part in zip(value, rule, strict=False))
            case "anyOf":
                good = any(_fits(value, part, root) for part in rule)
            case "oneOf":
                good = sum(_fits(value, part, root) for part in rule) == 1
            case (
                "$ref"
                | "$defs"
                | "$schema"
                | "$id"
                | "title"
                | "description"
                | "default"
                | "discriminator"
                | "examples"
            ):
                good = True
            case _:
                raise AssertionError(f"what is {key} in a schema?")
        if not good:
            return False
    return True


def _scenes() -> list[Path]:
    return [
        *sorted((REPOSITORY / "rad_scenes").rglob("scene.toml")),
        REPOSITORY / "radwrap" / "data" / "init" / "scene.toml",
    ]


def test_the_schema_says_what_the_loader_says(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    schema = here(["schema"], capsys).success().json
    assert here(["schema", "--json"], capsys).success().json == schema
    references = set(re.findall(r'"#/\$defs/(\w+)"', json.dumps(schema)))
    assert references <= set(schema["$defs"]) and len(references) > 20
    assert all(
        part.get("additionalProperties") is False for part in schema["$defs"].values() if part["type"] == "object"
    )
    # Only quantities are written as strings with a pattern; each says its units.
    assert '"description": "length: one number, one blank, one unit of m, cm, mm' in json.dumps(schema)
    for path in _scenes():
        assert _fits(json.loads(load_scene(path).document), schema, schema), path
    good = json.loads(load_scene(write_scene(tmp_path)).document)
    assert _fits(good, schema, schema)
    wrong: dict[str, Any] = {
        "camera.focal_length": "12,5 mm",
        "camera.exposure_time": "12.5 mm",
        "camera.sensor.rows": 2.5,
        "camera.sensor.gamma": "0.85",
        "camera.zoom": 1,
        "camera.look_at": ["0 mm", "0 mm"],
        "sources.0.type": "sun",
        "materials.white.reflectance": 1.5,
        "targets.0.rows": 0,
        "targets.0.name": "a b",
        "camera.focal_length ": "1 mm",
    }
    for key, value in wrong.items():
        document = json.loads(json.dumps(good))
        *steps, last = key.split(".")
        place = document
        for step in steps:
            place = place[int(step)] if isinstance(place, list) else place[step]
        place[last] = value
        assert not _fits(document, schema, schema), key


# --------------------------------------------------------------------------------------------------------------- JSON


def test_json_is_all_that_stands_on_stdout(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, out = write_scene(tmp_path, {"sources.0.diameter": "40 mm"}), tmp_path / "out"
    render = ["render", scene, "--out", out, "--viewpoints", 7, "--json"]
    done = here(render, capsys).success()
    manifest = done.json
    assert manifest == json.loads((out / "manifest.json").read_bytes())
    promised = {
        *("schema_version", "scene_sha256", "method", "viewpoints", "rays_per_pixel", "seed", "versions", "assumed"),
        *("gray", "saturated_fraction", "dark_fraction", "timing"),
    }
    assert promised <= set(manifest)
    assert set(manifest["gray"]) >= {"min", "max", "mean"} and set(manifest["timing"]) >= {"wall_s", "tracer_cpu_s"}
    assert {"radwrap", "python", "radiance", "numpy"} <= set(manifest["versions"])
    assert not [key for key, _ in _paths(manifest) if key.endswith("_s") and not key.startswith("timing.")]
    # Warnings go to stderr, and into the JSON.
    assert ["lamp" in line or "diffraction" in line for line in manifest["warnings"]] == [True, True]
    assert all(line in done.stderr for line in manifest["warnings"])
    # The last line puts what is left out beside the certified number.
    last = done.stderr.splitlines()[-1]
    assert f"below {manifest['error']['rms_gray_upper95']:.2g} gray rms" in last
    assert f"diffraction {manifest['left_out']['diffraction']['rms_gray']:.2g} (at most" in last
    gray = oiio.ImageInput.open(str(out / "gray.png")).read_image("uint8")
    assert manifest["gray"] == {"min": gray.min(), "max": gray.max(), "mean": pytest.approx(gray.mean(), rel=1e-12)}

    forecast = here([*render, "--dry-run"], capsys).success().json
    assert forecast["rays"] == 24 * 20 * 7 and forecast["memory_bytes"] > 0 and forecast["timing"]["wall_s"] > 0
    told = here(["explain", scene, "--json"], capsys).success().json
    assert {"scene", "f_number", "targets", "rings", "expected_peak", "advice", "warnings", "assumed"} <= set(told)
    assert told["f_number"] == pytest.approx(12.5 / 0.4) and told["scene"]["camera"]["focal_length"] == 0.0125
    assert told["targets"][0]["blur_radius_px"][0] == pytest.approx(0.2e-3 * (1 + 12.5 / 500) / 1e-4)
    assert {"gray", "radiant_exposure"} <= set(told["expected_peak"])
    assert told["tracer"]["name"] == "radiance" and "rays times sources" in told["tracer"]["reason"]
    by_ours = here(["explain", scene, "--tracer", "compiled"], capsys).success().stdout
    assert re.search(r"^tracer: compiled \(asked for\); both were compared: 0 of 512 rays differ$", by_ours, re.M)
    doctor = here(["doctor", "--json"], capsys).success().json
    assert doctor["ok"] and doctor["checks"][0]["name"] == "Radiance" and doctor["checks"][0]["found"]
    ours = here(["doctor", "--warm", "--json"], capsys).success().json["checks"][1]
    assert ours["name"] == "compiled tracer" and ours["found"] and not ours["needed"]
    assert re.fullmatch(r"numba [0-9.]+, compiled", ours["version"])
    # On one core: rtrace has traced 0.05 to 0.5 million rays a second of a ring's board, the compiled tracer several.
    assert 0.005 < doctor["checks"][0]["mrays_per_s"] < ours["mrays_per_s"] < 1000
    assert " Mrays/s on one core" in here(["doctor"], capsys).success().stdout
    converted = here(["convert", scene, tmp_path / "a.rad", "--json"], capsys).success().json
    assert str(tmp_path / "a.rad") in converted["files"]


def _paths(value: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for name, item in value.items():
            yield from _paths(item, f"{key}.{name}" if key else name)
    else:
        yield key, value


@pytest.mark.long
def test_explain_advises(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    advice = {}
    for exposure in ("10 ms", "900 ms", "10 s"):
        scene = write_scene(tmp_path, {"camera.exposure_time": exposure})
        told = here(["explain", scene], capsys).success().stdout
        assert "F number 31.25" in told and "blur radius" in told
        advice[exposure] = here(["explain", scene, "--json"], capsys).json["advice"]
    assert "dim" in advice["10 ms"] and "fits" in advice["900 ms"] and "saturated" in advice["10 s"]
    ring = REPOSITORY / "rad_scenes" / "fig13_oriented_board" / "scene.toml"
    angle = here(["explain", ring, "--json"], capsys).json["rings"][0]["observation_angle_deg"]["board"]
    assert angle == pytest.approx(math.degrees(math.atan(12.5 / 790)), abs=1e-3)  # 0.906 degrees, physics.md section 4
    assert "0.907 deg" in here(["explain", ring], capsys).stdout


# -------------------------------------------------------------------------------------------------- Options of render

# Frames need a camera whose noise is known.
LINEAR: Final = (
    'camera.sensor={model="linear", rows=20, columns=24, pixel_width="0.1 mm", pixel_height="0.1 mm", offset=4, '
    'wavelength="650 nm", quantum_efficiency=0.5, system_gain="0.01 DN/e", full_well="20 ke", read_noise="9 e"}'
)
MOSAIC: Final = LINEAR.replace(
    "quantum_efficiency=0.5",
    'mosaic="RGGB", filters={red={quantum_efficiency=0.5}, green={quantum_efficiency=0.3}, '
    "blue={quantum_efficiency=0.1}}",
)
# Each option that takes part, with what its use must change in the manifest.
# Options that can be tried in one render, then words and what the manifest holds; the first has all defaults.
OPTIONS: Final[dict[str, tuple[list[object], dict[str, Any]]]] = {
    "--out": ([], {}),
    "--set --seed --layout --workers --truth --json": (
        [
            "--set",
            "camera.exposure_time=100 ms",
            "--seed",
            5,
            "--layout",
            "sunflower",
            "--workers",
            3,
            "--truth",
            "--json",
        ],
        {"camera.exposure_time": 0.1, "seed": 5, "layout": "sunflower", "timing.workers": 3},
    ),
    "--pixel-samples --pixel-sampling --max-pixels --radiance --trust --tracer-timeout": (
        [
            *("--pixel-samples", 2, "--pixel-sampling", "jitter", "--max-pixels", "1e3", "--radiance", "WHEEL"),
            *("--trust", "--tracer-timeout", "1e3 s"),
        ],
        {"pixel_samples": 2, "rays_per_pixel": 28, "rays": 28 * 480, "pixel_sampling": "jitter", "trust": True},
    ),
    "--scale": (["--scale", "1/4"], {"camera.sensor.rows": 5, "camera.sensor.pixel_width": 4e-4}),
    "--roi": (["--roi", 2, 3, 11, 7], {"camera.sensor.rows": 5, "camera.sensor.columns": 10}),
    "--method": (["--method", "pinhole"], {"method": "pinhole", "viewpoints": 1, "rays_per_pixel": 1}),
    "--viewpoints": (["--viewpoints", 3], {"viewpoints": 3, "rays_per_pixel": 3}),
    "--tolerance --max-error --budget --basis": (
        ["--method", "kernel", "--tolerance", 2, "--max-error", 50, "--budget", "1e9", "--basis"],
        {"method": "kernel", "tolerance": 2.0, "max_error": 50.0},
    ),
    "--keep-viewpoints": (["--keep-viewpoints"], {}),
    "--bounces": (["--method", "rays", "--bounces", 1, "--tolerance", 5], {"method": "rays", "bounces.orders": 1}),
    "--frames": (["--frames", 2, "--set", LINEAR], {"camera.sensor.linear.read_noise": 9.0}),
    "--demosaic": (["--demosaic", "--set", MOSAIC], {"mosaic.pattern": "RGGB"}),
    "--photo-realistic": (["--photo-realistic", "point"], {}),
    "--dry-run": (["--dry-run"], {}),
    "--tracer": (["--tracer", "compiled"], {"tracer.name": "compiled", "tracer.probe.agree": True}),
}


def _at(manifest: dict[str, Any], key: str) -> Any:
    for step in key.split("."):
        manifest = manifest.get(step, {})
    return manifest


def test_a_dry_run_refuses_frames_as_the_run_does(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, told = write_scene(tmp_path), []
    for more in ([], ["--dry-run"]):
        done = here(["render", scene, "--out", tmp_path / "out", "--frames", 1, *more], capsys)
        assert done.code == 2
        told.append(done.stderr)
    assert told[0] == told[1] and "camera.sensor.model: the power law has no noise" in told[0]


@pytest.mark.long
def test_every_option_of_render_works(tmp_path: Path, capsys: pytest.CaptureFixture[str], radiance: Path) -> None:
    told = here(["render", "--help"], capsys).stdout
    options = set(re.findall(r"^  (?:-\w, )?(--[a-z-]+)", told, re.MULTILINE)) - {"--help"}
    assert options == {name for names in OPTIONS for name in names.split()}
    scene = write_scene(tmp_path)
    defaults: dict[str, Any] = {}
    for names, (words, expected) in OPTIONS.items():
        out, tried = tmp_path / names, names.split()
        argv = [radiance if word == "WHEEL" else word for word in words]
        number = [] if "--method" in argv else ["--viewpoints", 7]
        done = here(["render", scene, "--out", out, *number, *argv], capsys).success()
        if "--dry-run" in tried:
            assert not out.exists() and "rays" in done.stdout and "GiB" in done.stdout
            continue
        manifest = json.loads((out / "manifest.json").read_bytes())
        defaults = defaults or json.loads(json.dumps(manifest))
        for key, value in expected.items():
            assert _at(manifest, key) == value != _at(defaults, key), names
        assert len(list(out.glob("frame_*.png"))) == (2 if "--frames" in tried else 0)
        assert (out / "viewpoints").is_dir() == ("--keep-viewpoints" in tried)
        assert (out / "truth.json").exists() == (out / "depth.exr").exists() == ("--truth" in tried)
        assert (out / "colour.png").exists() == ("--demosaic" in tried)
        assert (out / "comparison.png").exists() == ("--photo-realistic" in tried)
        assert done.stdout.startswith("{") == ("--json" in tried)
    # What was kept is not in the manifest, and goes with the next run that keeps nothing; both are told.
    kept = tmp_path / "--keep-viewpoints"
    assert len(list((kept / "viewpoints").glob("*.exr"))) == 7
    assert not [file for file in json.loads((kept / "manifest.json").read_bytes())["files"] if "viewpoint" in file]
    here(["render", scene, "--out", kept, "--viewpoints", 7], capsys).success()
    assert not (kept / "viewpoints").exists()
    assert "not listed in manifest.json, and deleted by a later run" in _words(told)
    for layout in ("rings", "hexagonal", "sunflower", "uneven"):
        here(["render", scene, "--out", tmp_path / layout, "--viewpoints", 7, "--layout", layout], capsys).success()
    # A limit that is too low refuses; other verbs take their options, too.
    assert "--max-pixels" in here(["render", scene, "--out", tmp_path / "x", "--max-pixels", 479], capsys).refusal(2)
    more = ["--set", "camera.exposure_time=1 s", "--radiance", radiance, "--trust", "--tracer-timeout", "9 s", "--json"]
    here(["convert", scene, tmp_path / "b.rad", *more], capsys).success()
    assert here(["doctor", "--radiance", radiance, "--json"], capsys).success().json["ok"]


def test_set_takes_values_as_the_file_does(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = write_scene(tmp_path)
    changes = {
        'camera.exposure_time="64 ms"': ("camera.exposure_time", 0.064),
        "camera.exposure_time=64 ms": ("camera.exposure_time", 0.064),
        "camera.sensor.rows=10": ("camera.sensor.rows", 10),
        "camera.sensor.rounding=false": ("camera.sensor.rounding", False),
        'camera.principal_point=["3 px", "4 px"]': ("camera.principal_point", [3.0, 4.0]),
        'camera.aperture={ diameter = "0.2 mm" }': ("camera.aperture.diameter", 0.0002),
        "targets[0].rows=3": ("targets", None),
    }
    words = [word for change in changes for word in ("--set", change)]
    found = here(["explain", scene, "--json", *words], capsys).success().json["scene"]
    for key, value in changes.values():
        assert value is None or _at(found, key) == value
    assert found["targets"][0]["rows"] == 3


def test_a_dry_run_writes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = write_scene(tmp_path / "home", {"camera.sensor.rows": 2000, "camera.sensor.columns": 2000})
    (tmp_path / "tmp").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))
    monkeypatch.setattr("tempfile.tempdir", None)
    monkeypatch.chdir(tmp_path / "home")
    before = files_in(tmp_path)
    for out in ([], ["--out", tmp_path / "out"]):
        told = here(["render", scene, "--dry-run", "--viewpoints", 37, *out], capsys).success()
        assert "1.48e+08 rays" in told.stdout and "GiB" in told.stdout
    assert files_in(tmp_path) == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["home", "tmp"] and not list(
        (tmp_path / "tmp").iterdir()
    )


# ------------------------------------------------------------------------------------------------- Streams of the run


def test_progress_goes_to_the_terminal_alone(tmp_path: Path) -> None:
    scene = write_scene(tmp_path, SLOWER)
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    words = [COMMAND, "render", scene, "--out", tmp_path / "out", "--viewpoints", "37", "--json"]
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=theirs, stdin=subprocess.DEVNULL, env=clean_environment()
    ) as p:
        os.close(theirs)
        seen = b""
        # Linux answers with an error once the other side is closed.
        try:
            while block := os.read(ours, 4096):
                seen += block
        except OSError:
            pass
        finally:
            os.close(ours)
        stdout = p.stdout.read() if p.stdout else b""
    assert p.returncode == 0
    assert json.loads(stdout)["viewpoints"] == 37
    shares = [int(share) for share in re.findall(rb"tracing +(\d+) %", seen)]
    assert shares and shares == sorted(shares) and shares[-1] <= 100
    assert b"s left" in seen
    bar, _, rest = seen.rpartition(b"\r\x1b[K")
    assert not rest or rest.startswith(b"radwrap: "), "the bar goes when the work is done, before warnings"
    assert all(len(line) < 80 for line in bar.replace(b"\x1b[K", b"").split(b"\r"))


def test_output_that_nobody_takes(tmp_path: Path) -> None:
    """A pipe that is closed: no traceback, and no success either; of a device that is full test_signals knows."""
    reading, writing = os.pipe()
    os.close(reading)
    closed = run("schema", stdout=writing)
    os.close(writing)
    assert closed.code == 4 and "Traceback" not in closed.stderr and "Exception" not in closed.stderr


def test_a_folder_without_a_name_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert "DIR: has no name" in here(["init", ""], capsys).refusal(2)


def test_a_folder_that_is_a_file_is_named_as_the_verb_names_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, taken = write_scene(tmp_path), tmp_path / "taken"
    taken.write_text("")
    for words, name in ((["init", taken], "DIR"), (["render", scene, "--out", taken], "--out")):
        assert here(words, capsys).refusal(2).endswith(f"a file is where a folder is needed; choose another {name}")


# ------------------------------------------------------------------------------------------- Files for other programs

TRACE: Final = "-h -ab 0 -dt 0 -dc 1 -dj 0 -ds 0 -st 1 -lr 0 -lw 0".split()


def _radiance(folder: Path, *argv: object, at: Path, stdin: bytes = b"") -> bytes:
    environment = {"PATH": str(folder / "bin"), "RAYPATH": f".:{folder / 'lib'}"}
    words = [str(folder / "bin" / str(argv[0])), *map(str, argv[1:])]
    done = subprocess.run(words, cwd=at, env=environment, input=stdin, capture_output=True, check=True, timeout=60)
    assert done.stderr == b"", done.stderr
    return done.stdout


SHEETING: Final = {
    "type": "retroreflective",
    "model": "coefficient",
    "function": "glass_beads",
    "anchor": "95 cd/lx/m^2",
    "outside": "hold",
}
PINHOLE: Final[dict[str, Any]] = {
    "camera.aperture": {"diameter": "0 mm", "exposure_diameter": "0.4 mm"},
    "camera.position": ["20 mm", "-30 mm", "500 mm"],
    "camera.look_at": ["0 mm", "5 mm", "0 mm"],
    "camera.up": [0.2, 1, 0],
    "camera.principal_point": ["10.25 px", "11 px"],
    "materials.white": SHEETING,
    "targets.1": {"type": "rad", "name": "room", "rad": "room.rad", "position": ["-15 mm", "0 mm", "20 mm"]},
}


def _converted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> tuple[Path, Path]:
    home = tmp_path / "home"
    scene = write_scene(home, PINHOLE)
    (home / "room.rad").write_text("void plastic p 0 0 5 .5 .5 .5 0 0\np sphere ball 0 0 4 0 0 0 .01\n", "ascii")
    for name in ("out.rad", "out.vf"):
        here(["convert", scene, tmp_path / "files" / name], capsys).success()
    return scene, tmp_path / "files"


def test_plain_radiance_renders_a_converted_scene_alike(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], radiance: Path
) -> None:
    scene, files = _converted(tmp_path, capsys)
    here(["render", scene, "--out", tmp_path / "out", "--method", "pinhole"], capsys).success()
    ours = oiio.ImageInput.open(str(tmp_path / "out" / "radiant_exposure.exr")).read_image("float")[:, :, 0]

    (files / "scene.oct").write_bytes(_radiance(radiance, "oconv", "out.rad", at=files))
    rays = _radiance(radiance, "vwrays", "-fd", "-vf", "out.vf", "-x", 24, "-y", 20, "-pa", 0, "-pj", 0, at=files)
    answer = _radiance(radiance, "rtrace", *TRACE, "-fdf", "scene.oct", at=files, stdin=rays)
    radiances = np.frombuffer(answer, np.float32).reshape(20, 24, 3)[:, :, 0].astype(np.float64)
    # H = tau A / f^2 L cos^4, with the angle of each pixel's own ray.
    x = (np.arange(24) - 10.25) * 1e-4
    y = (np.arange(20) - 11.0) * 1.1e-4
    f = 0.0125
    cos4 = (f**2 / (f**2 + x**2 + y[:, np.newaxis] ** 2)) ** 2
    theirs = 0.387 * math.pi * 2e-4**2 / f**2 * radiances * cos4
    # A ray that differs in its last digit may fall on the other side of a rim.
    off = np.abs(ours - theirs) > 1e-5 * theirs + 1e-12
    assert off.sum() <= 2
    assert len(np.unique(ours)) > 100 and (ours > 0).mean() > 0.3

    picture = _radiance(
        radiance,
        "rpict",
        *TRACE[1:-4],
        "-ps",
        1,
        "-pj",
        0,
        "-x",
        24,
        "-y",
        20,
        "-pa",
        0,
        "-vf",
        "out.vf",
        "scene.oct",
        at=files,
    )
    (files / "picture.hdr").write_bytes(picture)
    rgbe = oiio.ImageInput.open(str(files / "picture.hdr")).read_image("float")[:, :, 0]
    assert rgbe.shape == radiances.shape
    assert (np.abs(rgbe - radiances) > radiances / 128 + 1e-9).sum() <= 2  # RGBE cuts after 8 bits


def test_the_converted_view_has_our_central_rays(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], radiance: Path
) -> None:
    _, files = _converted(tmp_path, capsys)
    answer = _radiance(radiance, "vwrays", "-fd", "-vf", "out.vf", "-x", 24, "-y", 20, "-pa", 0, "-pj", 0, at=files)
    rays = np.frombuffer(answer, np.float64).reshape(20, 24, 6)
    position, target, up = np.array([0.02, -0.03, 0.5]), np.array([0.0, 0.005, 0.0]), np.array([0.2, 1.0, 0.0])
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, up) / np.linalg.norm(np.cross(forward, up))
    down = np.cross(forward, right)
    u, v = np.meshgrid((np.arange(24) - 10.25) * 1e-4, (np.arange(20) - 11.0) * 1.1e-4)
    ours = u[..., np.newaxis] * right + v[..., np.newaxis] * down + 0.0125 * forward
    ours /= np.linalg.norm(ours, axis=-1, keepdims=True)
    theirs = rays[..., 3:] / np.linalg.norm(rays[..., 3:], axis=-1, keepdims=True)
    unit = np.linalg.norm(rays[0, 0, :3]) / np.linalg.norm(position)
    assert unit == pytest.approx(1) or unit == pytest.approx(1000)  # a file may be in mm, like the scene beside it
    assert np.abs(rays[..., :3] / unit - position).max() < 1e-12
    assert np.linalg.norm(ours - theirs, axis=-1).max() < 1e-6
