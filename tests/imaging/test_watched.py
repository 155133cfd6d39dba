"""Renders that their caller ends, and hears of meanwhile."""

from __future__ import annotations

import dataclasses
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import radwrap
from tests.cli.conftest import children
from tests.imaging.test_synthesis import scene

PROMPT = 5.0  # s from the wish to the end; half a second on a machine that has no other work
LARGE = {"camera.sensor.rows": 240, "camera.sensor.columns": 288}
# Far more than is traced before a render is ended.
LONG = {"viewpoints": 600}


class _Stopped(Exception):
    """Of a callback."""


def _results(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir() if path.suffix in {".png", ".exr", ".json"}}


class _Ended:
    """Ends a render once it has traced something, and knows when that was."""

    def __init__(self) -> None:
        self.wish = threading.Event()
        self.at = 0.0
        self.threads: set[int] = set()

    def told(self, state: radwrap.Progressed) -> None:
        self.threads.add(threading.get_ident())
        if state.done and not self.wish.is_set():
            self.at = time.monotonic()
            self.wish.set()


@pytest.mark.parametrize("tracer", ["radiance", "compiled"])
@pytest.mark.parametrize("how", [LONG, {"method": "kernel", "tolerance": 0.002}, {"method": "rays", "tolerance": 0.01}])
def test_a_cancelled_render_ends_at_once_and_leaves_nothing(tracer: str, how: dict[str, Any], tmp_path: Path) -> None:
    caller = _Ended()
    with pytest.raises(radwrap.Cancelled, match="was ended before"):
        radwrap.render(
            scene(**LARGE), tmp_path, tracer=tracer, cancelled=caller.wish.is_set, progress=caller.told, **how
        )
    assert time.monotonic() - caller.at < PROMPT
    assert children() == []
    assert _results(tmp_path) == set() and not (tmp_path / ".work").exists()
    assert caller.threads == {threading.get_ident()}


@pytest.mark.parametrize("tracer", [pytest.param("radiance", marks=pytest.mark.long), "compiled"])
def test_the_same_call_works_after_one_that_was_cancelled(tracer: str, tmp_path: Path) -> None:
    few = {"viewpoints": 60, "tracer": tracer}
    radwrap.render(scene(), tmp_path / "a", viewpoints=1)
    older = {name: (tmp_path / "a" / name).read_bytes() for name in _results(tmp_path / "a")}
    caller = _Ended()
    with pytest.raises(radwrap.Cancelled):
        radwrap.render(scene(), tmp_path / "a", cancelled=caller.wish.is_set, progress=caller.told, **few)
    assert {name: (tmp_path / "a" / name).read_bytes() for name in _results(tmp_path / "a")} == older
    again, cold = (radwrap.render(scene(), tmp_path / name, **few) for name in ("a", "b"))
    assert again.manifest["files"] == cold.manifest["files"]


def test_what_is_cancelled_before_it_begins_makes_nothing(tmp_path: Path) -> None:
    with pytest.raises(radwrap.Cancelled):
        radwrap.render(scene(), tmp_path / "out", cancelled=lambda: True)
    assert list(tmp_path.rglob("*.*")) == []


@pytest.mark.long
@pytest.mark.parametrize("viewpoints", [12, 60])
def test_a_caller_that_never_cancels_gets_the_same_bytes_and_hears_in_its_own_thread(viewpoints: int) -> None:
    heard: list[radwrap.Progressed] = []
    threads: set[int] = set()

    def told(state: radwrap.Progressed) -> None:
        heard.append(state)
        threads.add(threading.get_ident())

    how: dict[str, Any] = {"viewpoints": viewpoints, "tracer": "radiance"}
    watched = radwrap.render(scene(**LARGE), cancelled=lambda: False, progress=told, **how)
    assert watched.manifest["files"] == radwrap.render(scene(**LARGE), **how).manifest["files"]
    assert threads == {threading.get_ident()}
    done = [state.done for state in heard]
    assert done == sorted(done) and done[-1] > 0
    assert all(state.done <= state.of and (state.seconds_left or 0.0) >= 0 for state in heard)
    assert heard[-1].of == viewpoints * 240 * 288
    with pytest.raises(dataclasses.FrozenInstanceError):
        heard[0].done = 0  # type: ignore[misc]


@pytest.mark.parametrize("tracer", ["radiance", "compiled"])
def test_what_a_callback_raises_ends_the_render_and_comes_back(tracer: str, tmp_path: Path) -> None:
    begin: list[float] = []

    def told(state: radwrap.Progressed) -> None:
        begin.append(time.monotonic())
        raise _Stopped(state.done)

    with pytest.raises(_Stopped):
        radwrap.render(scene(**LARGE), tmp_path, tracer=tracer, progress=told, **LONG)
    assert len(begin) == 1 and time.monotonic() - begin[0] < PROMPT
    assert children() == [] and _results(tmp_path) == set()


def _of_input() -> bool:
    raise _Stopped


@pytest.mark.parametrize("cancelled", [_of_input, None])
def test_errors_of_either_side_come_as_they_are(cancelled: Callable[[], bool] | None, tmp_path: Path) -> None:
    """Frames are of linear cameras only: what is known once the scene is laid out."""
    with pytest.raises(_Stopped if cancelled else radwrap.InputError):
        radwrap.render(scene(), tmp_path, frames=2, cancelled=cancelled, progress=lambda _: None)
