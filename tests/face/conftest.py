"""The page's server as users run it, and requests as browsers and others send them."""

from __future__ import annotations

import http.client
import json
import re
import signal
import socket
import subprocess
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import psutil
import pytest

from tests.cli.conftest import SMALL, start, write_scene

# On a busy machine a server starts in ten times the second that it takes.
PATIENCE: Final = 30.0
SECOND: Final = {**SMALL["sources"][0], "name": "second", "position": ["-60 mm", "-90 mm", "450 mm"]}
HOSTILE_TITLE: Final = "</script><script>alert(1)</script>"
TWO: Final = {"sources.1": SECOND, "title": HOSTILE_TITLE}


@dataclass(frozen=True, slots=True)
class Answer:
    """What came back."""

    status: int
    headers: Mapping[str, str]
    body: bytes

    @property
    def json(self) -> Any:
        return json.loads(self.body)

    def blocks(self) -> tuple[Any, list[np.ndarray]]:
        """The line of JSON, and the numbers after it."""
        head, _, octets = self.body.partition(b"\n")
        told = json.loads(head)
        sizes = np.cumsum(told["blocks"])[:-1]
        return told, np.split(np.frombuffer(octets, dtype="<f4"), sizes)


@dataclass(frozen=True, slots=True)
class Served:
    """A running server."""

    process: subprocess.Popen[str]
    port: int
    token: str
    link: Path
    scene: Path
    out: Path

    def ask(self, method: str, path: str, body: bytes | None = None, **headers: str) -> Answer:
        """A request with headers of one's own; underscores stand for hyphens."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE)
        try:
            told = {name.replace("_", "-"): value for name, value in headers.items()}
            connection.request(method, path, body, told)
            answer = connection.getresponse()
            return Answer(answer.status, {k.lower(): v for k, v in answer.getheaders()}, answer.read())
        finally:
            connection.close()

    def post(self, path: str, told: Mapping[str, Any], **headers: str) -> Answer:
        """As the page asks."""
        given = {"Authorization": f"Bearer {self.token}", "Content_Type": "application/json", **headers}
        return self.ask("POST", path, json.dumps(told).encode(), **given)

    def raw(self, octets: bytes) -> bytes:
        """What the server says to octets that no client of good manners sends; empty where it only hangs up."""
        with socket.create_connection(("127.0.0.1", self.port), timeout=PATIENCE) as connection:
            said = b""
            try:
                connection.sendall(octets)  # a server that has refused may hang up before all is sent
                while block := connection.recv(65536):
                    said += block
            except ConnectionError:
                pass
            return said

    def ready(self) -> Any:
        """What the page is told once the basis is there."""
        last = self.settled()
        assert last["state"] == "ready", last
        return last["described"]

    def settled(self) -> Any:
        """What the page is told once nothing is traced any more."""
        while (told := self.post("/api/watch", {}).json)["state"] == "tracing":
            pass
        return told

    def family(self) -> list[psutil.Process]:
        """The server and all that it has started."""
        one = psutil.Process(self.process.pid)
        return [one, *one.children(recursive=True)]


@contextmanager
def serving(folder: Path, changes: Mapping[str, Any] | None = None, *more: object) -> Iterator[Served]:
    scene, out = write_scene(folder, changes or TWO), folder / "out"
    argv = ["face", scene, "--no-browser", "--tolerance", 2, "--tracer", "radiance", "--out", out, *more]
    process = start(argv)
    try:
        assert process.stderr is not None
        line = process.stderr.readline()
        found = re.fullmatch(r"radwrap: the link to open is in (/.+/link)\n", line)
        if not found:
            process.kill()  # else its last word would be waited for
        assert found, line + process.stderr.read()
        link = Path(found[1])
        address, _, token = link.read_text().strip().partition("/#")
        yield Served(process, int(address.rpartition(":")[2]), token, link, scene, out)
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
        try:
            process.communicate(timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            raise


@pytest.fixture(scope="module")  # no longer: other tests look at this process' children
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with serving(tmp_path_factory.mktemp("face")) as found:
        yield found


def gone(processes: list[psutil.Process], within: float) -> bool:
    """Whether processes end in a time; what nobody has waited for yet has ended too."""
    end = time.monotonic() + within
    while time.monotonic() < end:
        if not any(_lives(process) for process in processes):
            return True
        time.sleep(0.02)
    return False


def _lives(process: psutil.Process) -> bool:
    try:
        return process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
