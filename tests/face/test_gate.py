"""Who may ask: what real local servers were broken by is refused, and no work is begun for it."""

from __future__ import annotations

import asyncio
import hmac
import json
import os
import re
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Final

import psutil
import pytest

import radwrap
from radwrap.face import app
from radwrap.face import gate as module
from radwrap.face.assets import assets
from radwrap.face.gate import HEADERS, LARGEST_BODY, Door, Gate
from radwrap.face.session import Session
from tests.cli.conftest import SMALL
from tests.face.conftest import HOSTILE_TITLE, Served

GUARDED: Final = [
    f"/api/{name}"
    for name in "watch planes turn pixel profile measure photo compare matters layout png scene save trace stop".split()
] + ["/api/trade"]
OPEN: Final = sorted(assets())
NAME: Final = "127.0.0.1"


def head(served: Served, first: str, *lines: str, host: str | None = "") -> bytes:
    own = f"{NAME}:{served.port}"
    told = [] if host is None else [f"Host: {host or own}"]
    return "\r\n".join([first, *told, *lines, "", ""]).encode()


def status(said: bytes) -> int:
    return int(said.split()[1]) if said else 0


@pytest.fixture(autouse=True)
def _no_work(served: Served) -> Iterator[None]:
    """Whatever is refused here has begun nothing: neither a process nor a file."""
    served.ready()
    before = {process.pid for process in served.family()}, sorted(served.out.iterdir())
    yield
    assert ({process.pid for process in served.family()}, sorted(served.out.iterdir())) == before


HOSTS: Final = ["evil.test", "evil.test:{port}", "127.0.0.1.evil.test:{port}", "127.0.0.1", "127.0.0.1:1", "[::1]:1"]


@pytest.mark.parametrize("host", [*HOSTS, "0.0.0.0:{port}", "127.0.0.1:{port}@evil.test", "LOCALHOST.:{port}"])
@pytest.mark.parametrize("path", ["/", "/api/stop"])
def test_a_host_that_is_not_ours_is_refused(served: Served, host: str, path: str) -> None:
    """DNS rebinding: the browser believes that it talks to evil.test."""
    told = {"Host": host.format(port=served.port)}
    answer = served.post(path, {}, **told) if path != "/" else served.ask("GET", path, **told)
    assert answer.status == 403


def test_hosts_of_bad_form_are_refused(served: Served) -> None:
    own = f"{NAME}:{served.port}"
    assert status(served.raw(head(served, "GET / HTTP/1.1", host=None))) in (400, 403)
    assert status(served.raw(head(served, "GET / HTTP/1.0", host=None))) == 403
    assert status(served.raw(head(served, "GET / HTTP/1.1", f"Host: {own}"))) in (400, 403)
    assert status(served.raw(head(served, f"GET http://evil.test/ HTTP/1.1\r\nHost: {own}", host=None))) == 403
    assert status(served.raw(head(served, f"GET http://{own}/ HTTP/1.1"))) == 403
    assert status(served.raw(head(served, "OPTIONS * HTTP/1.1"))) == 403
    for name in ("127.0.0.1", "localhost", "[::1]"):
        assert served.ask("GET", "/", Host=f"{name}:{served.port}").status == 200


@pytest.mark.parametrize("origin", ["http://evil.test", "null", "https://127.0.0.1:{port}", "http://127.0.0.1:1", ""])
@pytest.mark.parametrize("path", ["/", "/api/stop"])
def test_another_sites_page_is_refused(served: Served, origin: str, path: str) -> None:
    told = {"Origin": origin.format(port=served.port)}
    answer = served.post(path, {}, **told) if path != "/" else served.ask("GET", path, **told)
    assert answer.status == 403
    assert "access-control-allow-origin" not in answer.headers
    assert served.post("/api/stop", {}, Origin=f"http://{NAME}:{served.port}").status == 200


@pytest.mark.parametrize("site", ["cross-site", "same-site", "whatever"])
def test_what_the_browser_says_of_the_asking_site_counts(served: Served, site: str) -> None:
    assert served.post("/api/stop", {}, Sec_Fetch_Site=site).status == 403
    assert served.ask("GET", "/", Sec_Fetch_Site=site).status == 403
    frame = {"Sec_Fetch_Site": site, "Sec_Fetch_Mode": "navigate", "Sec_Fetch_Dest": "iframe"}
    assert served.ask("GET", "/", **frame).status == 403
    window = {**frame, "Sec_Fetch_Dest": "document"}
    assert served.ask("GET", "/", **window).status == 200  # the file with the link opens the empty page
    assert served.ask("GET", OPEN[-1], **window).status == 403
    for own in ("same-origin", "none"):
        assert served.post("/api/stop", {}, Sec_Fetch_Site=own).status == 200


@pytest.mark.parametrize("path", GUARDED)
def test_every_route_needs_the_token(served: Served, path: str) -> None:
    bad = ["", "Bearer", "Bearer ", f"Bearer {served.token[:-1]}", f"Bearer {served.token}x", f"bearer {served.token}"]
    bad += [served.token, f"Basic {served.token}", f"Bearer {served.token[::-1]}", f"Bearer  {served.token}"]
    for given in bad:
        assert served.post(path, {}, Authorization=given).status == 401, given
    json_only = {"Content_Type": "application/json"}
    assert served.ask("POST", path, b"{}", **json_only).status == 401
    assert served.ask("POST", f"{path}?token={served.token}", b"{}", **json_only).status == 401
    assert served.ask("POST", path, b"{}", Cookie=f"token={served.token}", **json_only).status == 401
    twice = head(served, f"POST {path} HTTP/1.1", *[f"Authorization: Bearer {served.token}"] * 2, "Content-Length: 0")
    assert status(served.raw(twice)) == 401


def test_the_table_of_these_tests_is_the_servers(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    tables = []
    monkeypatch.setattr(app, "Gate", lambda inner, table, **_: tables.append(table))
    scene = radwrap.scene_from_document(SMALL)
    app.gated(Session(scene, {}, work=tmp_path, out=None, recipe=None), port=1, token="")
    (table,) = tables
    assert {path for path, door in table.items() if door.guarded} == set(GUARDED)
    assert all(door.method == "POST" for door in table.values() if door.guarded)
    assert {path for path, door in table.items() if not door.guarded} == set(OPEN) >= {"/"}


async def _call(gate: Gate, authorization: bytes) -> int:
    said = []
    scope = {
        "type": "http",
        "method": "POST",
        "path": "/api/stop",
        "raw_path": b"/api/stop",
        "headers": [(b"host", b"localhost:1"), (b"authorization", authorization)],
    }

    async def send(message: object) -> None:
        said.append(message)

    async def receive() -> dict[str, object]:
        return {"type": "http.request", "body": b"", "more_body": False}

    await gate(scope, receive, send)  # type: ignore[arg-type]
    return said[0]["status"]  # type: ignore[index]


@pytest.mark.parametrize("given", [b"", b"Bearer x", b"Bearer " + b"k" * 43, b"\xff"])
def test_tokens_are_compared_in_constant_time(monkeypatch: pytest.MonkeyPatch, given: bytes) -> None:
    """Always by hmac's comparison, also where nothing is given: the first wrong letter takes as long as the last."""
    compared, compare = [], hmac.compare_digest

    def watched(one: bytes, other: bytes) -> bool:
        compared.append(one)
        return compare(one, other)

    monkeypatch.setattr(module, "hmac", SimpleNamespace(compare_digest=watched))
    gate = Gate(None, {"/api/stop": Door("POST", guarded=True)}, port=1, token="t" * 43)  # type: ignore[arg-type]
    assert asyncio.run(_call(gate, given)) == 401
    assert compared == [given]


@pytest.mark.parametrize("path", GUARDED)
def test_only_json_by_post(served: Served, path: str) -> None:
    for method in ("GET", "HEAD", "PUT", "DELETE", "OPTIONS", "PATCH", "TRACE"):
        given = {"Authorization": f"Bearer {served.token}", "Content_Type": "application/json"}
        assert served.ask(method, path, **given).status == 403, method
    for kind in ("text/plain", "application/x-www-form-urlencoded", "multipart/form-data; boundary=x", ""):
        assert served.post(path, {}, Content_Type=kind).status == 403, kind


@pytest.mark.parametrize("path", OPEN)
def test_what_is_open_is_the_pages_own_files(served: Served, path: str) -> None:
    answer = served.ask("GET", path)
    assert answer.status == 200 and answer.body == assets()[path].content
    assert served.token.encode() not in answer.body
    for name, value in HEADERS:
        assert answer.headers[name.decode()] == value.decode()
    assert {"set-cookie", "access-control-allow-origin", "server"}.isdisjoint(answer.headers)
    assert served.ask("POST", path, b"{}", Content_Type="application/json").status == 403


def test_refusals_have_the_same_headers(served: Served) -> None:
    for answer in (
        served.ask("GET", "/nothing"),
        served.ask("GET", "/", Origin="null"),
        served.ask("POST", "/api/turn"),
    ):
        assert answer.status >= 400
        assert {name.decode() for name, _ in HEADERS} <= answer.headers.keys()


TRAVERSALS: Final = [
    "/../etc/passwd",
    "/..%2f..%2fetc/passwd",
    "/%2e%2e/%2e%2e/etc/passwd",
    "/..%5c..%5cetc%5cpasswd",
    "//etc/passwd",
    "/vendor/../index.html",
    "/vendor//uPlot.iife.min.js",
    "/vendor/",
    "/vendor",
    "/index.html",
    "/main.js/",
    "/%6dain.js",
    "/main.js%00",
    "/./main.js",
    "/vendor/../../session.py",
    "/api/turn/",
    "/api//turn",
    "/api/%74urn",
    "/API/turn",
    "/main.js;x",
    "/etc/passwd",
    "/favicon.ico",
    "/vendor/LICENSE",
]


@pytest.mark.parametrize("path", TRAVERSALS)
def test_a_path_is_a_word_of_a_table(served: Served, path: str) -> None:
    assert status(served.raw(head(served, f"GET {path} HTTP/1.1", "Connection: close"))) == 404
    posted = head(served, f"POST {path} HTTP/1.1", f"Authorization: Bearer {served.token}", "Content-Length: 0")
    assert status(served.raw(posted)) == 404


def test_no_websocket(served: Served) -> None:
    upgrade = ("Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Key: eA==", "Sec-WebSocket-Version: 13")
    for path in ("/", "/api/watch"):
        said = served.raw(head(served, f"GET {path} HTTP/1.1", *upgrade, "Connection: close"))
        assert status(said) in (200, 403) and b"101" not in said.split(b"\r\n")[0]


def test_bodies_have_a_limit(served: Served) -> None:
    own = f"Authorization: Bearer {served.token}", "Content-Type: application/json"
    announced = head(served, "POST /api/turn HTTP/1.1", *own, f"Content-Length: {LARGEST_BODY + 1}")
    assert status(served.raw(announced)) == 413
    assert status(served.raw(head(served, "POST /api/turn HTTP/1.1", *own, "Content-Length: 9" + "0" * 300))) in (
        400,
        413,
    )
    chunk = b"8000\r\n" + b" " * 0x8000 + b"\r\n"
    chunked = head(served, "POST /api/turn HTTP/1.1", *own, "Transfer-Encoding: chunked")
    assert status(served.raw(chunked + chunk * (LARGEST_BODY // 0x8000 + 1))) in (
        0,
        413,
    )  # it may hang up while we send
    for text in (b"[" * 100_000, b"{", b"\xff", b"[]", b"NaN", b'{"basis": 1e999}', b"null"):
        given = {"Authorization": f"Bearer {served.token}", "Content_Type": "application/json"}
        answer = served.ask("POST", "/api/turn", text, **given)
        assert answer.status == 422 and answer.json["error"], text


def test_heads_have_a_limit(served: Served) -> None:
    lines = [f"X-{k}: {'y' * 20}" for k in range(100_000)]
    assert status(served.raw(head(served, "GET / HTTP/1.1", *lines))) in (0, 400)
    assert status(served.raw(head(served, f"GET /{'a' * 100_000} HTTP/1.1"))) in (0, 400, 404)
    assert served.ask("GET", "/").status == 200


def test_who_is_slow_is_hung_up(served: Served) -> None:
    """Three at a time: half a head, half a body, and a connection that says nothing."""
    own = f"Authorization: Bearer {served.token}", "Content-Type: application/json", "Content-Length: 10"
    begun = (b"GET / HTTP/1.1\r\nHost: ", head(served, "POST /api/turn HTTP/1.1", *own) + b"{", b"")
    slow = [socket.create_connection((NAME, served.port), timeout=15) for _ in begun]
    start = time.monotonic()
    for connection, octets in zip(slow, begun, strict=True):
        connection.sendall(octets)
    assert served.ask("GET", "/").status == 200  # nobody else waits
    said = [connection.recv(65536) for connection in slow]
    assert time.monotonic() - start < 12
    assert said[0] == said[2] == b"" and status(said[1]) == 408
    for connection in slow:
        connection.close()


def test_it_listens_on_this_machine_alone(served: Served) -> None:
    listening = [
        line.split()[1]
        for name in ("tcp", "tcp6")
        for line in Path(f"/proc/net/{name}").read_text().splitlines()[1:]
        if line.split()[3] == "0A" and int(line.split()[1].rpartition(":")[2], 16) == served.port
    ]
    assert listening == [f"0100007F:{served.port:04X}"]
    for process in served.family():
        assert all(one.laddr.ip == NAME for one in process.net_connections() if one.laddr)


def test_the_token_stands_nowhere_but_in_its_own_file(served: Served) -> None:
    assert len(served.token) >= 43  # 256 bits in base64
    assert served.link.stat().st_mode & 0o777 == 0o600 and served.link.parent.stat().st_mode & 0o777 == 0o700
    assert (served.link.parent / "open.html").stat().st_mode & 0o777 == 0o600
    for process in served.family():
        assert served.token not in " ".join(process.cmdline())
        assert served.token.encode() not in Path(f"/proc/{process.pid}/environ").read_bytes()
    told = served.ready()
    assert served.token not in json.dumps(told)
    served.post("/api/save", {"basis": told["basis"]})
    saved = [path for path in served.out.rglob("*") if path.is_file()]
    assert saved and not [path for path in saved if served.token.encode() in path.read_bytes()]
    for path in sorted(served.out.glob("turn_*/*"), reverse=True):
        path.unlink()
    for path in served.out.glob("turn_*"):
        path.rmdir()
    (served.out / ".radwrap.lock").unlink()


def test_a_title_is_text(served: Served) -> None:
    """As JSON it comes, as text the page shows it (see test_page)."""
    assert served.ready()["title"] == HOSTILE_TITLE
    assert b"alert(1)" not in b"".join(asset.content for asset in assets().values())


def test_the_page_loads_nothing_from_elsewhere() -> None:
    for path, asset in assets().items():
        if "/vendor/" not in path:
            found = re.findall(rb"(?:https?:)?//[a-z0-9.-]+\.[a-z]{2,}", asset.content)
            assert set(found) <= {b"http://www.w3.org"}, (path, found)  # the name of a language, no address


def test_nothing_of_the_family_serves_else(served: Served) -> None:
    assert os.getpid() not in {process.pid for process in served.family()}
    assert all(process.status() != psutil.STATUS_ZOMBIE for process in served.family())
