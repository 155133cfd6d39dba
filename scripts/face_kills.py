"""Kill the page's server, its renderer, its tracers and the browser, 50 times in all, and look for what is left.

    .venv/bin/python scripts/face_kills.py [--rounds 50]

Each kill is a SIGKILL while a trace goes on, or while the LED ring (an emulator) shines. Afterwards no process of the
server's may be left, nor a folder of its own or of a warm scene, nor a lock on the folder for results; what lives must
take another request; and the ring must be dark within 2 s. Anything else ends the script with 1. Needs Chromium. Other
programs of radwrap may run: a folder of a warm scene counts as left once it is there two minutes after the last kill.
"""

from __future__ import annotations

import argparse
import itertools
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

import psutil

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))  # the tests' own server

from radwrap.files import sole_owner
from radwrap.led.connect import EmulatorProcess
from radwrap.led.emulated_port import EmulatedPort
from tests.face.conftest import Served, serving
from tests.face.test_life import LONG, LONG_OPTIONS, tracers, wait_for_tracers, warm_folders
from tests.face.test_ring import COUNT, SCENE, ring_options

GONE_WITHIN: Final = 5.0  # s
DARK_WITHIN: Final = 2.0  # s
_OTHERS: Final = 120.0  # s that other programs have for their folders
_BROWSER_WITHIN: Final = 15.0  # s until a trace that nobody watches is stopped
CHROMIUM: Final = shutil.which("chromium") or shutil.which("chromium-browser")


class Found(list[str]):
    """What was wrong, and how long things took [s]."""

    def __init__(self) -> None:
        super().__init__()
        self.longest = 0.0
        self.dark = 0.0
        self.suspects: set[Path] = set()  # folders of warm scenes, ours or of other programs

    def until(self, done: Callable[[], bool], within: float, what: str) -> float:
        """Wait, and note the time, or that it never came."""
        begin = time.monotonic()
        while not done():
            if time.monotonic() - begin > within:
                self.append(what)
                break
            time.sleep(0.02)
        took = time.monotonic() - begin
        self.longest = max(self.longest, took)
        return took


def _lives(process: psutil.Process) -> bool:
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def _folders(places: set[Path]) -> set[Path]:
    """Locks of rings are files that stay, and hold nothing."""
    return {place for place in places if place.is_dir()}


def _nothing_left(found: Found, family: list[psutil.Process], served: Served, warm: set[Path]) -> None:
    found.until(lambda: not any(map(_lives, family)), GONE_WITHIN, "a process is left")
    found.until(lambda: not served.link.parent.exists(), GONE_WITHIN, "the server's folder is left")
    found.suspects |= _folders(warm)
    try:
        with sole_owner(served.out):
            pass
    except Exception as error:  # noqa: BLE001  (whatever it is, the folder cannot be used)
        found.append(f"a lock is stuck: {error}")


def kill_server(found: Found, folder: Path, _: EmulatorProcess) -> None:
    """While it traces."""
    before = warm_folders()
    with serving(folder, LONG, *LONG_OPTIONS) as served:
        wait_for_tracers(served)
        family, warm = served.family(), warm_folders() - before
        served.process.kill()
        _nothing_left(found, family, served, warm)


def kill_lit_server(found: Found, folder: Path, emulator: EmulatorProcess) -> None:
    """While the ring shines."""
    before = warm_folders()
    with serving(folder, SCENE, *ring_options(folder, emulator)) as served:
        told = {"basis": served.ready()["basis"], "turn": {"levels": [1.0] * COUNT}}
        served.post("/api/ring", {"do": "light", "tab": "one", **told})
        port = EmulatedPort(emulator.socket)
        if not any(port.history()[-1][1]):
            found.append("the ring did not shine")
        family, warm = served.family(), warm_folders() - before
        served.process.kill()
        took = found.until(lambda: not any(port.history()[-1][1]), DARK_WITHIN, "the ring shines on")
        found.dark = max(found.dark, took)
        port.close()
        _nothing_left(found, family, served, warm)


def kill_renderer(found: Found, folder: Path, _: EmulatorProcess) -> None:
    """The page's server says so, and traces again."""
    before = warm_folders()
    with serving(folder, LONG, *LONG_OPTIONS) as served:
        running = wait_for_tracers(served)
        (renderer,) = psutil.Process(served.process.pid).children()
        warm = warm_folders() - before
        renderer.kill()
        if "renderer" not in served.settled().get("error", ""):
            found.append("its end was not said")
        found.until(lambda: not any(map(_lives, [renderer, *running])), GONE_WITHIN, "a process is left")
        found.suspects |= _folders(warm)
        if served.post("/api/trace", {}).status != 200 or not wait_for_tracers(served):
            found.append("it traces no more")
        _end(found, served, before)


def kill_tracer(found: Found, folder: Path, _: EmulatorProcess) -> None:
    """The same."""
    before = warm_folders()
    with serving(folder, LONG, *LONG_OPTIONS) as served:
        end = time.monotonic() + 60.0
        while served.post("/api/watch", {"done": -1}).json["state"] == "tracing" and time.monotonic() < end:
            for process in tracers(served):
                with suppress(psutil.NoSuchProcess):
                    process.kill()
        if "rtrace" not in served.settled().get("error", ""):
            found.append("its end was not said")
        if served.post("/api/trace", {}).status != 200 or not wait_for_tracers(served):
            found.append("it traces no more")
        _end(found, served, before)


def kill_browser(found: Found, folder: Path, _: EmulatorProcess) -> None:
    """What nobody watches any more is stopped."""
    if CHROMIUM is None:
        raise SystemExit("there is no Chromium: on Debian, apt install chromium")
    before = warm_folders()
    with serving(folder, LONG, *LONG_OPTIONS) as served, tempfile.TemporaryDirectory(prefix="face-kills-") as profile:
        page = (served.link.parent / "open.html").as_uri()
        quiet = ["--disable-gpu", "--no-first-run", "--disable-background-networking", "--disable-component-update"]
        argv = [
            CHROMIUM,
            "--headless",
            "--no-sandbox",
            *quiet,
            f"--user-data-dir={profile}",
            "--remote-debugging-port=0",
        ]
        browser = subprocess.Popen([*argv, page], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        port = f":{served.port}"
        connected = psutil.Process(browser.pid)
        end = time.monotonic() + 30.0
        while not _talks(connected, served.port) and time.monotonic() < end:
            served.post("/api/watch", {"done": -1})
        if not _talks(connected, served.port):
            found.append(f"the browser did not open {port}")
        wait_for_tracers(served)
        everyone = [connected, *connected.children(recursive=True)]
        for process in everyone:
            with suppress(psutil.NoSuchProcess):
                process.kill()
        browser.wait()
        found.until(lambda: not any(map(_lives, everyone)), GONE_WITHIN, "a process of the browser is left")
        found.until(lambda: not tracers(served) and _idle(served), _BROWSER_WITHIN, "it traces on")
        if served.settled()["state"] != "stopped":
            found.append("the trace was not stopped")
        _end(found, served, before)


def _talks(browser: psutil.Process, port: int) -> bool:
    with suppress(psutil.Error):
        for process in (browser, *browser.children(recursive=True)):
            with suppress(psutil.Error):
                if any(one.raddr and one.raddr.port == port for one in process.net_connections("tcp")):
                    return True
    return False


def _idle(served: Served) -> bool:
    """Whether no tracer runs for a second: asking would be watching."""
    end = time.monotonic() + 1.0
    while time.monotonic() < end:
        if tracers(served):
            return False
        time.sleep(0.05)
    return True


def _end(found: Found, served: Served, before: set[Path]) -> None:
    """The server ends as users end it."""
    family, warm = served.family(), warm_folders() - before
    served.process.send_signal(signal.SIGTERM)
    served.process.wait(30.0)
    _nothing_left(found, family, served, warm)


KINDS: Final = (kill_server, kill_renderer, kill_tracer, kill_browser, kill_lit_server)


def main() -> int:
    """Kill one after the other; returns 1 where anything is left."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=50)
    rounds = parser.parse_args().rounds
    found = {kind: Found() for kind in KINDS}
    counts = dict.fromkeys(KINDS, 0)
    with tempfile.TemporaryDirectory(prefix="kills-") as own, EmulatorProcess("mcp2221a_pca9685", COUNT) as emulator:
        # Where this script's servers keep their files, unless that is in memory, which other programs share.
        os.environ["TMPDIR"] = tempfile.tempdir = own
        for kind in itertools.islice(itertools.cycle(KINDS), rounds):
            with tempfile.TemporaryDirectory(prefix="face-kills-") as folder:
                kind(found[kind], Path(folder), emulator)
            counts[kind] += 1
        # A browser that is killed leaves a folder of its own.
        kept = sorted(path.name for path in Path(own).iterdir() if not path.name.startswith("org.chromium"))
    end = time.monotonic() + _OTHERS
    while any(one.suspects & warm_folders() for one in found.values()) and time.monotonic() < end:
        time.sleep(1.0)
    for kind, one in found.items():
        one += [f"{place} is left" for place in sorted(one.suspects & warm_folders())]
        dark = f", dark after {one.dark:.2f} s at most" if one.dark else ""
        left = "; ".join(one) or "nothing left"
        print(f"{kind.__name__:16} {counts[kind]:3} kills: {left}; {one.longest:.2f} s at most{dark}", flush=True)
    if kept:
        print(f"left beside: {', '.join(kept)}")
    wrong = len(kept) + sum(map(len, found.values()))
    print(f"{sum(counts.values())} kills, {wrong} faults")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
