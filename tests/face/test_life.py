"""How the server begins, stops, is killed and ends: nothing outlives it, and its page lives through what it can."""

from __future__ import annotations

import json
import os
import pickle
import signal
import socket
import stat
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import Any, Final

import psutil
import pytest

import radwrap
from radwrap import own_modules
from radwrap.cli import main as verbs
from radwrap.face.renderer import Renderer, _answered, _Ears
from radwrap.files import make_folder
from radwrap.process import Child
from tests.cli.conftest import SLOWER, here, inside, scene_with, start, write_scene
from tests.face.conftest import PATIENCE, TWO, Served, gone, serving
from tests.face.test_turns import RING

# Traces for some ten seconds, by processes of its own.
LONG: Final = {**TWO, **SLOWER}
LONG_OPTIONS: Final = ("--tolerance", 0.02)
OBEYS: Final = 0.5  # s, as promised; a busy machine gets as much again for the answer


def tracers(served: Served) -> list[psutil.Process]:
    """Programs of the renderer."""
    found = []
    for process in served.family():
        with suppress(psutil.NoSuchProcess):
            if process.name().startswith("rtrace"):
                found.append(process)
    return found


def cpu_s(served: Served) -> float:
    """Processor time of the server and of those that it started [s]."""
    seconds = 0.0
    for process in served.family():
        with suppress(psutil.NoSuchProcess):
            seconds += sum(process.cpu_times()[:2])
    return seconds


def wait_for_tracers(served: Served) -> list[psutil.Process]:
    end = time.monotonic() + PATIENCE
    while not (found := tracers(served)):
        assert time.monotonic() < end, "nothing was traced"
        served.post("/api/watch", {"done": -1})  # a page looks on: what nobody watches is stopped
    return found


def warm_folders() -> set[Path]:
    """Folders of warm scenes, of whichever process."""
    return {place for parent in ("/dev/shm", tempfile.gettempdir()) for place in Path(parent).glob("radwrap-*")}  # noqa: S108


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.long)])
def test_a_signal_ends_all(tmp_path: Path, number: int) -> None:
    with serving(tmp_path, LONG, *LONG_OPTIONS) as served:
        wait_for_tracers(served)
        family = served.family()
        served.process.send_signal(number)
        assert served.process.wait(PATIENCE) == 130
        assert gone(family, 0.05)  # the server has waited for them, they need not notice its end
        _, said = served.process.communicate(timeout=PATIENCE)
        assert said.splitlines()[-1].startswith("radwrap: interrupted") and "Traceback" not in said
        assert not served.link.parent.exists()
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", served.port), timeout=1)


def test_a_killed_server_leaves_nothing(tmp_path: Path) -> None:
    """The renderer notices, ends its tracers, and removes the folder with the link."""
    with serving(tmp_path, LONG, *LONG_OPTIONS) as served:
        wait_for_tracers(served)
        family = served.family()
        served.process.kill()
        assert gone(family, 3.0)
        end = time.monotonic() + 3.0
        while served.link.parent.exists() and time.monotonic() < end:
            time.sleep(0.02)
        assert not served.link.parent.exists()
        assert inside(
            "render", served.scene, "--tolerance", 8, "--out", tmp_path / "free"
        ).success()  # no lock is stuck


def test_a_trace_is_stopped_begun_again_killed_and_goes_on(tmp_path: Path) -> None:
    before = warm_folders()
    with serving(tmp_path, LONG, *LONG_OPTIONS) as served:
        wait_for_tracers(served)
        (renderer,) = psutil.Process(served.process.pid).children()
        begin = time.monotonic()
        assert served.post("/api/stop", {}).status == 200
        assert served.settled()["state"] == "stopped"
        assert time.monotonic() - begin < 2 * OBEYS
        assert not tracers(served) and renderer.is_running()  # asked, not killed: it stays warm

        assert served.post("/api/trace", {}).status == 200
        assert served.post("/api/trace", {}).json["error"] == "is under way"
        tracing = wait_for_tracers(served)
        warm = warm_folders() - before
        assert warm
        renderer.kill()
        last = served.settled()
        assert last["state"] == "failed" and "renderer: ended by itself, or was killed" in last["error"]
        assert gone(tracing, 1.0)
        end = time.monotonic() + 3.0
        while all(place.exists() for place in warm) and time.monotonic() < end:
            time.sleep(0.02)
        assert not all(place.exists() for place in warm)  # others' may stay

        assert served.post("/api/trace", {}).status == 200
        with ThreadPoolExecutor(1) as watching:
            seen = watching.submit(served.settled)
            while not seen.done():  # one that is killed at its very end has done its work
                for process in tracers(served):
                    with suppress(psutil.NoSuchProcess):
                        process.kill()
                time.sleep(0.02)
        assert seen.result()["state"] == "failed" and "rtrace" in seen.result()["error"]
        assert served.ask("GET", "/").status == 200

        assert served.post("/api/trace", {}).status == 200
        tracing = wait_for_tracers(served)
        (renderer,) = psutil.Process(served.process.pid).children()
        renderer.send_signal(signal.SIGSTOP)
        begin = time.monotonic()
        served.post("/api/stop", {})
        assert served.settled()["state"] == "stopped"
        assert time.monotonic() - begin < 2 * OBEYS + 1
        assert gone([renderer, *tracing], 1.0)  # who does not obey is killed


def test_a_page_that_is_closed_ends_its_trace(tmp_path: Path) -> None:
    with serving(tmp_path, LONG, *LONG_OPTIONS) as served:
        wait_for_tracers(served)
        assert served.post("/api/watch", {}).json["state"] == "tracing"  # and no more: the page has gone
        assert idle(served, 15.0)
        assert served.settled()["state"] == "stopped"


def idle(served: Served, within: float) -> bool:
    """Whether within a time nothing is traced for a second, nor computed, as it is between two tracers."""
    end, seen, used = time.monotonic() + within, time.monotonic(), cpu_s(served)
    while time.monotonic() < end:
        if tracers(served) or cpu_s(served) > used + 0.1:
            seen, used = time.monotonic(), cpu_s(served)
        if time.monotonic() - seen > 1.0:
            return True
        time.sleep(0.05)
    return False


def test_tabs_do_not_disturb_each_other(served: Served) -> None:
    """Seven watch, two ask for turns of their own by turns; none waits for another."""
    basis = served.ready()["basis"]
    bright, dim = ({"basis": basis, "turn": {"levels": levels}} for levels in ([2, 0], [0.1, 0.1]))
    first = [served.post("/api/turn", told).body for told in (bright, dim)]
    open_tabs = [socket.create_connection(("127.0.0.1", served.port), timeout=PATIENCE) for _ in range(7)]
    try:
        assert [served.post("/api/turn", told).body for told in (bright, dim, bright, dim)] == first * 2
    finally:
        for tab in open_tabs:
            tab.close()
    assert first[0] != first[1]


@pytest.mark.long
def test_a_client_that_does_not_read_holds_little(tmp_path: Path) -> None:
    """Six answers of 48 MB that nobody takes: of each a plane of 2 MB is held; others are answered meanwhile."""
    wide = {"sources": [{**RING, "count": 24}], "camera.sensor.rows": 700, "camera.sensor.columns": 700}
    wide |= {"camera.sensor.pixel_width": "3.2 um", "camera.sensor.pixel_height": "3.2 um"}
    with serving(tmp_path, wide, "--tolerance", 8) as served, ExitStack() as opened:
        basis = served.ready()["basis"]
        body = json.dumps({"basis": basis}).encode()
        lines = [f"Host: 127.0.0.1:{served.port}", f"Authorization: Bearer {served.token}"]
        lines += [f"Content-Length: {len(body)}", "Content-Type: application/json", "", ""]
        head = "\r\n".join(["POST /api/planes HTTP/1.1", *lines]).encode()
        assert len(served.post("/api/planes", {"basis": basis}).body) > 47e6
        pixel = {"basis": basis, "column": 5, "row": 5}
        assert served.post("/api/pixel", pixel).status == 200
        process = psutil.Process(served.process.pid)
        before = process.memory_info().rss
        for _ in range(6):
            connection = opened.enter_context(closing(socket.socket()))
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            connection.connect(("127.0.0.1", served.port))
            connection.sendall(head + body)
        begin = time.monotonic()
        assert served.post("/api/pixel", pixel).status == 200
        assert time.monotonic() - begin < 5
        time.sleep(0.5)
        assert process.memory_info().rss - before < 6 * 15e6


@pytest.mark.long
def test_the_light_of_a_turn_is_traced_anew(tmp_path: Path) -> None:
    with serving(tmp_path) as served:
        first = served.ready()
        turn = {"levels": [3.0, 0.0], "knobs": {"exposure_time": "100 ms"}}
        told, (_, before, _) = served.post("/api/turn", {"basis": first["basis"], "turn": turn}).blocks()
        assert served.post("/api/trace", {"basis": first["basis"], "turn": turn}).status == 200
        second = served.ready()
        assert second["basis"] == first["basis"] + 1 and second["exposure_time"] == 0.1
        assert second["dark_sources"] == ["second"] and [one["name"] for one in second["sources"]] == ["lamp"]
        anew, (_, after, _) = served.post("/api/turn", {"basis": second["basis"]}).blocks()
        assert abs(anew["gray"]["mean"] - told["gray"]["mean"]) < 1
        assert before.shape == after.shape
        stale = served.post("/api/turn", {"basis": first["basis"]})
        assert stale.status == 422 and "load the page again" in stale.json["text"]
        assert str(served.out / "basis_2") in anew["command"]


# ----------------------------------------------------------------------------------------------------------- Beginnings


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """What begins, in its order: processes of our own, and modules of verbs."""
    found: list[object] = []
    start_module, import_module = own_modules.start_module, verbs.import_module

    def starts(name: str, *arguments: str) -> Child:
        child = start_module(name, *arguments)
        found.append(child)
        return child

    def imports(name: str) -> Any:
        found.append(name)
        return import_module(name)

    monkeypatch.setattr(own_modules, "start_module", starts)
    monkeypatch.setattr(verbs, "import_module", imports)
    return found


def test_the_renderer_loads_its_libraries_meanwhile(
    started: list[object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is started before the verb is loaded, is what the server takes, and does not outlive the verb."""
    taken: list[Child] = []
    monkeypatch.setattr("radwrap.face.serve.serve", lambda *_, ahead, **__: taken.append(ahead))
    here(["face", write_scene(tmp_path, TWO), "--no-browser"], capsys).success()
    child, verb = started
    assert verb == "radwrap.cli.face" and taken == [child] and child.ended  # type: ignore[attr-defined]


@pytest.mark.parametrize("words", [["--help"], ["-h"], ["--export=page.html"], ["--export", "page.html"]])
def test_what_serves_nothing_starts_none(
    words: list[str], started: list[object], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    here(["face", tmp_path / "none.toml", *words], capsys)
    assert started == ["radwrap.cli.face"]


def test_who_was_started_ahead_renders(tmp_path: Path) -> None:
    """The next one is started where it has ended."""
    scene = radwrap.scene_from_document(scene_with(TWO))
    request = {"scene": scene, "options": {"tolerance": 8.0}, "brief": False}
    ahead = own_modules.start_module("radwrap.face.renderer")
    folder = tmp_path / "wo rk"
    folder.mkdir()
    renderer = Renderer(folder, ahead)
    try:
        for out in ("first", "second"):
            renderer.render({**request, "out": str(tmp_path / out)}, lambda _: None)
            assert (renderer.pid == ahead.pid) is (out == "first")
            assert (tmp_path / out / "basis").is_dir()
            ahead.kill()
    finally:
        renderer.close()
        ahead.kill()


def test_an_error_of_our_own_is_told_as_such(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The page is not left with a renderer that "ended by itself", and the terminal has the place of the fault."""

    class Broken:
        def render(self, *_: object) -> None:
            raise ValueError("zip() argument 2 is longer than argument 1")

    (tmp_path / "request").write_bytes(pickle.dumps({}))
    told = _answered(Broken(), tmp_path / "request", _Ears())
    assert told["error"] == "this is an error in radwrap itself; please report it" and told["kind"] == ""
    assert "ValueError: zip()" in capsys.readouterr().err


def test_who_waits_for_a_server_ends_with_it(tmp_path: Path) -> None:
    """Started ahead of a server that never came: it removes nothing, as it was told of no folder."""
    child = own_modules.start_module("radwrap.face.renderer")
    process = psutil.Process(child.pid)
    child.close(PATIENCE)
    assert gone([process], 1.0) and Path.cwd().is_dir()


@pytest.mark.parametrize("farewell", [False, True])
def test_who_loses_its_server_removes_that_ones_folders(tmp_path: Path, farewell: bool) -> None:
    """Not where the server says farewell: it may still read them, and removes them itself."""
    folders = [tmp_path / "work", tmp_path / "quick"]
    for folder in folders:
        folder.mkdir()
        (folder / "left").write_text("")
    child = own_modules.start_module("radwrap.face.renderer")
    child.tell(f"folders {json.dumps([str(folder) for folder in folders])}")
    if farewell:
        child.tell("bye")
    child.close(PATIENCE)
    assert [folder.exists() for folder in folders] == [farewell, farewell]


def test_a_renderer_that_is_there_already_knows_the_folders_at_once(tmp_path: Path) -> None:
    """Before the first trace is asked for, which takes the server half a second: it may be killed before."""
    folders = [tmp_path / "work", tmp_path / "quick"]
    for folder in folders:
        folder.mkdir()
    child = own_modules.start_module("radwrap.face.renderer")
    Renderer(folders[0], ahead=child, more=(folders[1],))
    child.close(PATIENCE)
    assert not any(folder.exists() for folder in folders)


def test_what_is_wrong_is_told_before_anything_is_served(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = write_scene(tmp_path, TWO)
    assert "no such scene file" in here(["face", tmp_path / "none.toml"], capsys).refusal(2)
    assert "tolerance" in here(["face", scene, "--tolerance", -1], capsys).refusal(2)
    assert "--port" in here(["face", scene, "--port", 70000], capsys).refusal(2)
    (tmp_path / "file").write_text("")
    assert "a file is where" in here(["face", scene, "--out", tmp_path / "file"], capsys).refusal(2)


def test_a_port_that_is_taken_is_told(served: Served, capsys: pytest.CaptureFixture[str]) -> None:
    line = here(["face", served.scene, "--no-browser", "--port", served.port], capsys).refusal(4)
    assert f"port {served.port}: cannot be used" in line and "--port" in line


def test_a_file_with_commands_is_not_run(tmp_path: Path) -> None:
    """The page has no way to trust it."""
    (tmp_path / "evil.rad").write_text(f"!touch {tmp_path}/ran\n")
    evil = {"type": "rad", "name": "evil", "rad": "evil.rad", "length_unit": "1 mm"}
    with serving(tmp_path, {**TWO, "targets.1": evil}) as served:
        for told in ({}, {"trust": True, "turn": None}):
            last = served.settled()
            assert last["state"] == "failed" and "trust" in last["error"]
            served.post("/api/trace", told)
        served.settled()
        assert not (tmp_path / "ran").exists()


@pytest.mark.long
def test_the_link_is_told_to_a_terminal_alone(tmp_path: Path) -> None:
    import pty

    ours, theirs = pty.openpty()
    with start(["face", write_scene(tmp_path, TWO), "--no-browser"], stderr=theirs) as process:
        os.close(theirs)
        said = b""
        while b"\n" not in said:
            said += os.read(ours, 4096)
        process.send_signal(signal.SIGTERM)
        assert process.wait(PATIENCE) == 130
    os.close(ours)
    assert said.startswith(b"radwrap: open http://127.0.0.1:") and len(said.split(b"/#")[1].strip()) >= 43


def test_the_browser_gets_a_file_and_no_token(tmp_path: Path) -> None:
    """What BROWSER names is started with the name of a file that its owner alone may read."""
    seen = tmp_path / "seen"
    browser = tmp_path / "browser"
    browser.write_text(
        f'#!/bin/sh\ncat "/proc/$$/cmdline" > {seen}.argv\nls -l "${{1#file://}}" > {seen}.mode\n'
        f'cat "${{1#file://}}" > {seen}.page\ntouch {seen}\n'
    )
    browser.chmod(stat.S_IRWXU)
    make_folder(tmp_path / "scene")
    environment = {**os.environ, "BROWSER": f"{browser} %s", "DISPLAY": ":99"}
    with start(["face", write_scene(tmp_path / "scene", TWO)], env=environment) as process:
        end = time.monotonic() + PATIENCE
        while not seen.exists() and time.monotonic() < end:
            time.sleep(0.02)
        process.send_signal(signal.SIGTERM)
        assert process.wait(PATIENCE) == 130
    page = Path(f"{seen}.page").read_text()
    token = page.partition("/#")[2].partition('"')[0]
    assert len(token) >= 43 and token not in Path(f"{seen}.argv").read_text()
    assert Path(f"{seen}.mode").read_text().startswith("-rw-------")
