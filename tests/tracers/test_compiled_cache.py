"""Where compiled functions are kept, and what happens where they cannot be."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import pytest

pytest.importorskip("numba")

import numba

from radwrap.tracers.compiled import compiler
from radwrap.tracers.compiled.warm import is_warm, warm_up

FOLDER = Path(compiler.__file__).parent


def twice(x: float) -> float:
    return 2 * x


def thrice(x: float) -> float:
    return 3 * x


def door(folder: Path) -> ModuleType:
    """The compiler's door as it stands in another folder."""
    spec = importlib.util.spec_from_file_location("door", folder / "compiler.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def sources(tmp_path: Path) -> Iterator[Path]:
    shutil.copytree(FOLDER, tmp_path / "sources", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path / "sources"


def test_a_changed_source_is_compiled_anew(sources: Path) -> None:
    assert door(sources).SOURCES == compiler.SOURCES
    before = door(sources).cache_folder()
    for path in sorted(sources.glob("*.py")):
        kept = path.read_bytes()
        path.write_bytes(kept + b"\n# another formula\n")
        assert door(sources).cache_folder() != before, path.name
        path.write_bytes(kept)
    (sources / "new.py").write_text("")
    (sources / "new.py").rename(sources / "zzz.py")
    (sources / "zzz.py").write_text("X = 1\n")
    assert door(sources).cache_folder() != before


def test_another_compiler_has_another_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    assert numba.__version__ in compiler.cache_folder().name
    assert set(compiler.VERSIONS) == {"numba", "llvmlite"}
    before = compiler.cache_folder()
    monkeypatch.setattr(numba, "__version__", "0.0")
    assert compiler.cache_folder() != before


def test_what_is_compiled_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert not is_warm()
    before = numba.config.CACHE_DIR
    first: Any = compiler.compiled(twice)
    assert first(2.0) == 4.0
    assert before == numba.config.CACHE_DIR
    assert any(compiler.cache_folder().rglob("*.nbc"))
    assert tmp_path in compiler.cache_folder().parents
    again: Any = compiler.compiled(twice)
    assert again(3.0) == 6.0
    assert again.stats.cache_hits and not again.stats.cache_misses


@pytest.mark.parametrize("why", ["file", "read_only"])
def test_without_a_folder_each_process_compiles(why: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home = tmp_path / "home"
    if why == "file":
        home.touch()
    else:
        home.mkdir()
        # As a system that was mounted read-only answers; whoever runs tests as root may write everywhere else.
        monkeypatch.setattr(compiler.os, "access", lambda *_: False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(home))
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.setattr(compiler.sys, "prefix", str(home))
    made: Any = compiler.compiled(thrice)
    assert made(2.0) == 6.0
    assert not list(tmp_path.rglob("*.nb*"))
    assert not is_warm()


def test_without_a_home_it_is_kept_in_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "home").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.setattr(compiler.sys, "prefix", str(tmp_path))
    made: Any = compiler.compiled(thrice)
    assert made(2.0) == 6.0
    assert compiler.cache_folder().parent == tmp_path / "cache" / "radwrap"
    assert any(compiler.cache_folder().rglob("*.nbc"))


@pytest.mark.parametrize("kind", ["*.nbc", "*.nbi"])
@pytest.mark.parametrize("left", [0, 50, 300])
def test_half_a_file_is_compiled_anew(left: int, kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As a machine that stopped may leave it; afterwards it is whole again."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    first: Any = compiler.compiled(twice)
    assert first(2.0) == 4.0
    (path,) = compiler.cache_folder().rglob(kind)
    path.write_bytes(path.read_bytes()[:left])
    again: Any = compiler.compiled(twice)
    assert again(3.0) == 6.0 and again.stats.cache_misses
    third: Any = compiler.compiled(twice)
    assert third(3.0) == 6.0 and third.stats.cache_hits


def test_a_full_disk_costs_no_more_than_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    made: Any = compiler.compiled(thrice)
    shutil.rmtree(compiler.cache_folder())
    compiler.cache_folder().touch()  # nothing can be written below a file
    assert made(2.0) == 6.0
    assert made(2) == 6


def test_warming_up_is_seen() -> None:
    warm_up()
    assert is_warm()


_WARMED: Final = """
import sys, radwrap
from radwrap.tracers.compiled.compiler import cache_folder
from radwrap.tracers.compiled.warm import is_warm, warm_up
assert not is_warm()
warm_up()
assert is_warm()
before = {path.name for path in cache_folder().rglob("*.nb*")}
for path in sys.argv[1:]:
    cell = radwrap.load_scene(path)
    for key, value in {"rows": 32, "columns": 38, "pixel_width": "220.8 um", "pixel_height": "220.8 um"}.items():
        cell = radwrap.with_value(cell, f"camera.sensor.{key}", value)
    radwrap.render(cell, workers=1, tolerance=4.0)
    radwrap.render(cell, workers=1, tolerance=8.0, bounces=1)
after = {path.name for path in cache_folder().rglob("*.nb*")}
assert before == after, sorted(after - before)
"""


@pytest.mark.long
def test_after_warming_up_no_image_waits_for_the_compiler(tmp_path: Path) -> None:
    """In an empty folder of its own: in one that other images have filled nothing is lacking."""
    cells = sorted((Path(__file__).parents[2] / "rad_scenes" / "cells").glob("*.toml"))
    assert len(cells) >= 6
    done = subprocess.run(
        [sys.executable, "-c", _WARMED, *map(str, cells)],
        env=os.environ | {"XDG_CACHE_HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def test_windows_keeps_it_in_the_local_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiler.sys, "platform", "win32")
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path))
    assert compiler.cache_folder().parent == tmp_path / "radwrap"
    monkeypatch.delenv("LOCALAPPDATA")
    assert compiler.cache_folder().parent == Path.home() / "AppData" / "Local" / "radwrap"
