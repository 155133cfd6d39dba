"""Try on the page's server what other local servers were broken by, and count the requests.

    .venv/bin/python scripts/face_incidents.py

Each class of incident has a public case (see docs/face.md); its requests are sent to a server as users run it. One
that is let in, or that begins any work, ends the script with 1.
"""

from __future__ import annotations

import itertools
import json
import socket
import sys
import tempfile
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import psutil

ROOT: Final = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from radwrap.face.app import PHOTO  # noqa: E402
from radwrap.face.assets import assets  # noqa: E402  (the tests' own server is used)
from radwrap.face.gate import OCTETS  # noqa: E402
from tests.face.conftest import Served, serving  # noqa: E402
from tests.face.test_photo import bombs  # noqa: E402

API: Final = [
    f"/api/{name}"
    for name in "watch planes turn pixel profile measure photo compare matters layout png scene save trace stop".split()
]
OPEN: Final = sorted(assets())
HOSTS: Final = ["evil.test", "evil.test:{port}", "127.0.0.1.evil.test:{port}", "127.0.0.1:1", "0.0.0.0:{port}", "x", ""]
ORIGINS: Final = [
    "http://evil.test",
    "null",
    "https://127.0.0.1:{port}",
    "http://127.0.0.1:1",
    "file://",
    "http://127.0.0.1",
]
SECRET: Final = b"root:"  # of /etc/passwd
FILES: Final = [
    "/etc/passwd",
    "../../../../etc/passwd",
    "file:///etc/passwd",
    "\\\\evil.test\\share",
    "/proc/self/environ",
]


@dataclass(frozen=True, slots=True)
class Sent:
    """A request as octets, and what it must not get."""

    octets: bytes
    allowed: tuple[int, ...] = (400, 401, 403, 404, 405, 408, 413, 431, 0)


def _octets(served: Served, method: str, path: str, body: bytes = b"", **headers: str | None) -> bytes:
    told: dict[str, str | None] = {"Host": f"127.0.0.1:{served.port}", "Connection": "close"}
    told |= {name.replace("_", "-"): value for name, value in headers.items()}
    if body or method == "POST":
        told["Content-Length"] = str(len(body))
    lines = [f"{method} {path} HTTP/1.1", *(f"{name}: {value}" for name, value in told.items() if value is not None)]
    return "\r\n".join([*lines, "", ""]).encode() + body


def _own(served: Served) -> dict[str, str]:
    return {"Authorization": f"Bearer {served.token}", "Content_Type": "application/json"}


def _rebinding(served: Served) -> Iterator[Sent]:
    for host, path in itertools.product(HOSTS, [*API, *OPEN]):
        method = "POST" if path in API else "GET"
        told = {"Host": host.format(port=served.port), **(_own(served) if path in API else {})}
        yield Sent(_octets(served, method, path, b"{}" if path in API else b"", **told))


def _origins(served: Served) -> Iterator[Sent]:
    for origin, path in itertools.product(ORIGINS, [*API, *OPEN]):
        told = {"Origin": origin.format(port=served.port), **(_own(served) if path in API else {})}
        yield Sent(_octets(served, "POST" if path in API else "GET", path, b"{}" if path in API else b"", **told))
    for site, path in itertools.product(("cross-site", "same-site"), API):
        yield Sent(_octets(served, "POST", path, b"{}", Sec_Fetch_Site=site, **_own(served)))
    for path in API:  # a preflight gets no leave
        yield Sent(_octets(served, "OPTIONS", path, Origin="http://evil.test", Access_Control_Request_Method="POST"))


def _websockets(served: Served) -> Iterator[Sent]:
    upgrade = {
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec_WebSocket_Key": "eA==",
        "Sec_WebSocket_Version": "13",
    }
    for path, origin in itertools.product([*API, "/ws", "/terminal/ws", "/"], ("http://evil.test", None)):
        page = (200,) if path == "/" and origin is None else ()
        more = {"Connection": "close", "Upgrade": None} if page else {}
        yield Sent(_octets(served, "GET", path, Origin=origin, **{**upgrade, **more}), (400, 401, 403, 404, 426, *page))


def _without_token(served: Served) -> Iterator[Sent]:
    bad = [
        "",
        "Bearer",
        f"Bearer {served.token[:-1]}",
        f"Bearer {served.token}0",
        f"Basic {served.token}",
        f"bearer {served.token}",
    ]
    bad += [f"Bearer {served.process.pid}", "Bearer null", "Bearer undefined"]
    for path in API:
        for given in bad:
            yield Sent(_octets(served, "POST", path, b"{}", Authorization=given, Content_Type="application/json"))
        yield Sent(_octets(served, "POST", f"{path}?token={served.token}", b"{}", Content_Type="application/json"))
        yield Sent(
            _octets(served, "POST", path, b"{}", Cookie=f"token={served.token}", Content_Type="application/json")
        )
        yield Sent(_octets(served, "GET", f"{path}?token={served.token}"))


def _bad_hosts_and_targets(served: Served) -> Iterator[Sent]:
    for host in (
        f"127.0.0.1:{served.port}/api/stop?",
        f"a@127.0.0.1:{served.port}",
        f"127.0.0.1:{served.port}#",
        "[::1",
    ):
        yield Sent(_octets(served, "GET", "/", Host=host))
    for target in (
        "http://evil.test/",
        f"http://127.0.0.1:{served.port}/",
        "*",
        "//evil.test/",
        "/\\evil.test",
        "/%2f%2fevil.test",
    ):
        yield Sent(_octets(served, "GET", target))
        yield Sent(_octets(served, "OPTIONS", target))


def _traversals(served: Served) -> Iterator[Sent]:
    ups = ["../", "..%2f", "%2e%2e/", "%2e%2e%2f", "..%5c", "..\\", "....//", "%252e%252e%252f", "..%c0%af", "..;/"]
    for up, depth, before in itertools.product(ups, (1, 4, 8), ("/", "/vendor/", "/api/")):
        yield Sent(_octets(served, "GET", f"{before}{up * depth}etc/passwd"))
    for path in (
        "/static/../main.js",
        "/vendor",
        "/vendor/LICENSE",
        "/main.js%00.css",
        "/main.js/",
        "/.",
        "/%6dain.js",
        "/app.py",
    ):
        yield Sent(_octets(served, "GET", path))


def _file_routes(served: Served) -> Iterator[Sent]:
    for name, route in itertools.product(
        FILES, ("/file=", "/gradio_api/file=", "/@fs/", "/proxy=", "/?file=", "/main.js?path=")
    ):
        known = (200,) if "?" in route else ()  # what stands behind ? is nobody's: the page's own file is all there is
        yield Sent(_octets(served, "GET", f"{route}{name.replace(chr(92), '%5c')}"), (400, 403, 404, *known))
    for name, path, key in itertools.product(FILES, API, ("path", "file", "folder", "name", "scene", "out")):
        if path not in ("/api/trace", "/api/stop", "/api/save", "/api/watch"):
            body = json.dumps({key: name, "basis": name, "turn": {key: name}}).encode()
            kind = {"Content_Type": OCTETS.decode()} if path == PHOTO else {}
            yield Sent(_octets(served, "POST", path, body, **{**_own(served), **kind}), (422,))


def _ranges(served: Served) -> Iterator[Sent]:
    many = "bytes=" + ",".join(f"{k}-" for k in range(2000))
    for path, told in itertools.product(OPEN, (many, "bytes=0-0,0-0", "bytes=-1", "bytes=9-1", "x" * 20_000)):
        yield Sent(_octets(served, "GET", path, Range=told), (200, 400, 431))


def _uploads(served: Served) -> Iterator[Sent]:
    for name, path in itertools.product(("../../x.sh", "C:\\x", "a\r\nb", "/etc/cron.d/x"), API):
        part = f'--b\r\nContent-Disposition: form-data; name="f"; filename="{name}"\r\n\r\nx\r\n--b--\r\n'.encode()
        given = {**_own(served), "Content_Type": "multipart/form-data; boundary=b"}
        yield Sent(_octets(served, "POST", path, part, **given))
    for kind, path in itertools.product(("text/plain", "application/x-www-form-urlencoded", "application/xml"), API):
        yield Sent(_octets(served, "POST", path, b"{}", **{**_own(served), "Content_Type": kind}))


def _photos(served: Served) -> Iterator[Sent]:
    """Bombs, pictures that are cut, in colour, of another size, and what is no picture."""
    head = json.dumps({"basis": served.ready()["basis"], "turn": {}}).encode() + b"\n"
    own = {**_own(served), "Content_Type": OCTETS.decode()}
    with tempfile.TemporaryDirectory() as folder:
        for content, _ in bombs(Path(folder)).values():
            yield Sent(_octets(served, "POST", PHOTO, head + content, **own), (422,))
            strange = {**own, "Authorization": "Bearer x"}
            yield Sent(_octets(served, "POST", PHOTO, head + content, **strange))


CLASSES: Final = {
    "DNS rebinding: a foreign Host": _rebinding,
    "another site's page: Origin, CORS, preflight": _origins,
    "WebSockets": _websockets,
    "no token, a wrong one, in the query, in a cookie": _without_token,
    "malformed Host and target, open redirect": _bad_hosts_and_targets,
    "traversal to files": _traversals,
    "routes and values that name files or other machines": _file_routes,
    "Range of many parts": _ranges,
    "uploads and forms": _uploads,
    "photos that do harm": _photos,
}


def _faults_of(served: Served, sent: Sent) -> str | None:
    said = served.raw(sent.octets)
    head, _, body = said.partition(b"\r\n\r\n")
    status = int(head.split()[1]) if head else 0
    low = head.lower()
    if status not in sent.allowed:
        return f"answered {status}"
    if b"access-control-allow" in low or b"set-cookie" in low or b"\nlocation:" in low or b" 101 " in head[:15]:
        return "let another page in"
    return "showed a file" if SECRET in body or served.token.encode() in said else None


def _elsewhere(served: Served) -> tuple[int, int]:
    """Connections to the machine's other addresses that were tried, and how many were taken."""
    found = {one.address for each in psutil.net_if_addrs().values() for one in each if one.family == socket.AF_INET}
    tried = [address for address in {*found, "127.0.0.2", "127.1.2.3"} if address != "127.0.0.1"]
    taken = 0
    for address in tried:
        with closing(socket.socket()) as one:
            one.settimeout(2)
            taken += one.connect_ex((address, served.port)) == 0
    return len(tried), taken


def main() -> int:
    """Try all; returns 1 where anything was let in."""
    bad = 0
    with tempfile.TemporaryDirectory() as folder, serving(Path(folder)) as served:
        served.ready()
        before = {one.pid for one in served.family()}, sorted(Path(folder).rglob("*"))
        total = 0
        for name, requests in CLASSES.items():
            sent = list(requests(served))
            faults = [(one, fault) for one in sent if (fault := _faults_of(served, one)) is not None]
            total, bad = total + len(sent), bad + len(faults)
            print(f"{len(sent):5} requests, {len(faults)} let in: {name}", flush=True)
            for one, fault in faults[:5]:
                print(f"      {fault}: {one.octets[:120]!r}")
        tried, taken = _elsewhere(served)
        print(f"{tried:5} connections to other addresses of this machine, {taken} taken")
        after = {one.pid for one in served.family()}, sorted(Path(folder).rglob("*"))
        others = [
            one
            for each in served.family()
            for one in each.net_connections()
            if one.laddr and one.laddr.ip != "127.0.0.1"
        ]
        began = before != after or served.settled()["state"] != "ready"
        work = "yes" if began else "none"
        print(f"{total} requests in all; work begun: {work}; connections beyond loopback: {len(others)}")
        return int(bool(bad or taken or began or others))


if __name__ == "__main__":
    sys.exit(main())
