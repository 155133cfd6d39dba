"""The command as users run it: its own process, its own folder; what it left is looked at afterwards."""

from __future__ import annotations

import importlib.util
import json
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import redirect_stderr, redirect_stdout
from copy import deepcopy
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any, Final

import psutil
import pytest

from radwrap.cli.main import main

COMMAND: Final = Path(sys.executable).with_name("radwrap")
FINAL_NAMES: Final = ("gray.png", "radiant_exposure.exr", "manifest.json")
# No command of these tests takes longer than a few seconds, on a busy machine ten times that.
PATIENCE: Final = 60.0
GONE_WITHIN: Final = 2.0  # s after a kill

# 24 x 20 pixels, a pinhole wide enough to blur over several of them, gray levels well between dark and saturation.
SMALL: Final[dict[str, Any]] = {
    "camera": {
        "position": ["0 mm", "0 mm", "500 mm"],
        "look_at": ["0 mm", "0 mm", "0 mm"],
        "focal_length": "12.5 mm",
        "exposure_time": "387 ms",
        "aperture": {"diameter": "0.4 mm"},
        "diffraction": "off",  # it has its own tests
        "sensor": {
            "rows": 20,
            "columns": 24,
            "pixel_width": "100 um",
            "pixel_height": "110 um",
            "gain": "3.38e4 (J/m^2)^-0.85",
            "gamma": 0.85,
            "dark_gray": 22,
            "saturation_gray": 181,
        },
    },
    "sources": [
        {
            "type": "led",
            "name": "lamp",
            "position": ["30 mm", "100 mm", "450 mm"],
            "look_at": ["0 mm", "0 mm", "0 mm"],
            "radiance": "100 kW/m^2/sr",
            "beam": {"profile": "gaussian", "width": "20 deg", "width_definition": "fwhm"},
        }
    ],
    "materials": {
        "black": {"type": "lambertian", "reflectance": 0.1},
        "white": {"type": "lambertian", "reflectance": 0.9},
    },
    "targets": [
        {
            "type": "board",
            "name": "board",
            "rotation": ["20 deg", "6 deg", "-2 deg"],
            "material": "black",
            "dot_material": "white",
            "rows": 2,
            "columns": 2,
            "pitch": "40 mm",
            "dot_diameter": "25 mm",
        }
    ],
}


# The same with more pixels, so that a run lasts some seconds.
SLOWER: Final[dict[str, Any]] = {
    "camera.sensor.rows": 120,
    "camera.sensor.columns": 144,
    "camera.sensor.pixel_width": "16 um",
    "camera.sensor.pixel_height": "16 um",
}

REMOVE: Final = "REMOVE"  # a key that is taken away


def scene_with(changes: Mapping[str, Any]) -> dict[str, Any]:
    """The small scene with some keys changed: path such as "targets.0.pitch" -> value, or REMOVE."""
    document = deepcopy(SMALL)
    for key, shared in changes.items():
        value = deepcopy(shared)
        *path, last = key.split(".")
        place: Any = document
        for step in path:
            place = place[int(step)] if isinstance(place, list) else place.setdefault(step, {})
        if isinstance(place, list):
            place[int(last) : int(last) + 1] = [] if value == REMOVE else [value]
        elif value == REMOVE:
            del place[last]
        else:
            place[last] = value
    return document


def toml(value: Any) -> str:
    """A value of a scene as TOML, in one line."""
    match value:
        case bool():
            return str(value).lower()
        case dict():
            return "{" + ", ".join(f"{json.dumps(key)} = {toml(item)}" for key, item in value.items()) + "}"
        case list() | tuple():
            return "[" + ", ".join(map(toml, value)) + "]"
        case str():
            return json.dumps(value, ensure_ascii=False)
    return repr(value)  # numbers; nan and inf are the same in both languages


def scene_text(document: Mapping[str, Any]) -> str:
    """A scene file."""
    return "".join(f"{json.dumps(key)} = {toml(value)}\n" for key, value in document.items())


@dataclass(frozen=True, slots=True)
class Done:
    """What a command said, and what it left.

    Attributes
    ----------
    code : int
        Exit code.
    stdout, stderr : str
        What it wrote.
    wall : float
        How long it took [s].
    """

    code: int
    stdout: str
    stderr: str
    wall: float

    def refusal(self, code: int) -> str:
        """The one line on stderr of a command that had to end with `code`."""
        assert self.code == code, (self.code, self.stdout, self.stderr)
        assert "Traceback" not in self.stderr
        assert self.stdout == ""
        lines = self.stderr.splitlines()
        assert len(lines) == 1 and self.stderr.endswith("\n"), self.stderr
        assert lines[0].startswith("radwrap: ")
        assert lines[0].isprintable()
        return lines[0]

    def success(self) -> Done:
        """Itself, once it is sure that the command did what it was asked."""
        assert self.code == 0, self.stderr
        assert "Traceback" not in self.stderr
        return self

    @property
    def json(self) -> Any:
        """What stands on stdout, which holds nothing else."""
        return json.loads(self.stdout)


def clean_environment(extra: Mapping[str, str] | None = None) -> dict[str, str]:
    """The user's environment, without what would lead to another Radiance."""
    kept = {key: value for key, value in os.environ.items() if key not in ("RADWRAP_RADIANCE", "RAYPATH")}
    return {**kept, **(extra or {})}


def here(argv: Sequence[object], capsys: pytest.CaptureFixture[str]) -> Done:
    """The command in this process: a tenth of a second sooner, and as good for what never starts a program."""
    begin = time.monotonic()
    code = _main(argv)
    said = capsys.readouterr()
    return Done(code, said.out, said.err, time.monotonic() - begin)


def inside(*argv: object) -> Done:
    """The command in this process, where there is no `capsys`: in fixtures that many tests share."""
    begin = time.monotonic()
    with redirect_stdout(StringIO()) as out, redirect_stderr(StringIO()) as err:
        code = _main(argv)
    return Done(code, out.getvalue(), err.getvalue(), time.monotonic() - begin)


def _main(argv: Sequence[object]) -> int:
    """Its exit code; signals then are whose they were before."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        return main([str(word) for word in argv])
    except SystemExit as end:
        return int(end.code or 0)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def start(argv: Sequence[object], **changes: Any) -> subprocess.Popen[str]:
    """The command, running; at its end all of its group must be gone."""
    options: dict[str, Any] = {
        "stdin": subprocess.DEVNULL,
        "stdout": subprocess.PIPE,
        "stderr": subprocess.PIPE,
        "text": True,
        "env": clean_environment(),
        **changes,
    }
    return subprocess.Popen([str(COMMAND), *map(str, argv)], **options)


def run(*argv: object, environment: Mapping[str, str] | None = None, **changes: Any) -> Done:
    """The command, to its end."""
    begin = time.monotonic()
    with start(argv, env=clean_environment(environment), **changes) as process:
        try:
            stdout, stderr = process.communicate(timeout=PATIENCE)
        except BaseException:
            process.kill()
            raise
    return Done(process.returncode, stdout or "", stderr or "", time.monotonic() - begin)


def inhabitants(folder: Path) -> list[str]:
    """Processes that work in a folder or name it in their arguments, but for this one and its ancestors.

    Those that are killed already need a moment to be gone on a busy machine.
    """
    end = time.monotonic() + GONE_WITHIN
    while (found := _inhabitants(folder)) and time.monotonic() < end:
        time.sleep(0.05)
    return found


def _inhabitants(folder: Path) -> list[str]:
    family = {os.getpid(), *(parent.pid for parent in psutil.Process().parents())}
    place = str(folder)
    found = []
    for process in psutil.process_iter(["pid", "cwd", "cmdline", "status"]):
        info = process.info
        words = [info["cwd"] or "", *(info["cmdline"] or [])]
        if info["pid"] not in family and any(place in word for word in words):
            found.append(f"{info['pid']} {info['status']} {shlex.join(info['cmdline'] or [])}")
    return found


def children() -> list[list[str]]:
    """Programs that this process started and that still run; not what Python keeps after a pool of workers."""
    family = [child.cmdline() for child in psutil.Process().children()]
    return [words for words in family if "resource_tracker" not in str(words)]


def files_in(folder: Path) -> dict[str, bytes]:
    """Relative name -> content of every file below a folder."""
    if not folder.is_dir():
        return {}
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not path.is_symlink()
    }


def without_timing(manifest: bytes) -> dict[str, Any]:
    """A manifest as far as equal runs must agree on it."""
    content: dict[str, Any] = json.loads(manifest)
    del content["timing"]
    return content


def products(out: Path) -> dict[str, Any]:
    """What equal runs must agree on: the bytes of all images, the manifest but for its timing."""
    files = {name: content for name, content in files_in(out).items() if "/" not in name and not name.startswith(".")}
    return {name: without_timing(content) if name == "manifest.json" else content for name, content in files.items()}


def traced(out: Path) -> list[int]:
    """Numbers of the sub-viewpoints that an unfinished run gave to a tracer, in the order of its log."""
    log = out / "viewpoints" / "tracer_calls.log"
    return [int(line) for line in log.read_text("ascii").split()] if log.is_file() else []


def finished(out: Path) -> set[int]:
    """Numbers of the sub-viewpoints whose files stand under their final names."""
    return {int(path.stem.split("_")[1]) for path in (out / "viewpoints").glob("viewpoint_*.exr")}


def stamps(out: Path) -> dict[int, tuple[int, int]]:
    """What tells a sub-viewpoint's file from one that was made again in its place, by its number."""
    places = {number: out / "viewpoints" / f"viewpoint_{number:05d}.exr" for number in finished(out)}
    return {number: (place.stat().st_ino, place.stat().st_mtime_ns) for number, place in places.items()}


def made_since(out: Path, before: dict[int, tuple[int, int]]) -> set[int]:
    """Numbers of the sub-viewpoints that were made after those stamps were taken."""
    return {number for number, stamp in stamps(out).items() if before.get(number) != stamp}


def wait_for(
    condition: Callable[[], bool], process: subprocess.Popen[str], patience: float = PATIENCE, look: float = 0.001
) -> bool:
    """Wait until something is so, looked at each `look` seconds; False if the process ended before."""
    end = time.monotonic() + patience
    while not condition():
        if process.poll() is not None:
            return False
        if time.monotonic() > end:
            process.kill()
            raise AssertionError(f"nothing happened within {patience:g} s")
        time.sleep(look)
    return True


def write_scene(folder: Path, changes: Mapping[str, Any] | None = None, name: str = "scene.toml") -> Path:
    """Write the small scene, changed, into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / name
    path.write_text(scene_text(scene_with(changes or {})), "utf-8")
    return path


def side_by_side(work: Callable[[Any], Any], items: Sequence[Any], *, at_once: int | None = None) -> list[Any]:
    """Carry out the same for all items, as many at a time as there are cores."""
    with ThreadPoolExecutor(max_workers=at_once or len(os.sched_getaffinity(0))) as pool:
        return list(pool.map(work, items))


@pytest.fixture(scope="session")
def radiance() -> Path:
    """Folder of the wheel's Radiance, with bin and lib; found without importing it."""
    spec = importlib.util.find_spec("pyradiance")
    assert spec is not None and spec.origin is not None
    return Path(spec.origin).parent
