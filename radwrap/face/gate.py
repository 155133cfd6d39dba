"""Who may ask the page's server, and what: judged before any work, by rules that need no state.

A page of another site may send requests to this machine through its user's browser. It cannot choose the headers
Host, Origin and Sec-Fetch-Site, cannot read what it is not allowed to, and does not know the token.
"""

from __future__ import annotations

import asyncio
import hmac
from collections.abc import Awaitable, Callable, Mapping, MutableMapping
from dataclasses import dataclass
from typing import Any, Final

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

LARGEST_BODY: Final = 1 << 18  # byte; levels of 4096 sources take a third of it
BODY_PATIENCE: Final = 5.0  # s until a body is whole
LARGE_BODY_PATIENCE: Final = 30.0  # s until one is whole that may be larger
POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; "
    "worker-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
# On every answer, refusals too.
HEADERS: Final = (
    (b"content-security-policy", POLICY.encode()),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-embedder-policy", b"require-corp"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cache-control", b"no-store"),
)
PAGE: Final = "/"
JSON: Final = b"application/json"
OCTETS: Final = b"application/octet-stream"


@dataclass(frozen=True, slots=True)
class Door:
    """How a path may be asked for.

    Attributes
    ----------
    method : str
        The one method.
    guarded : bool
        Whether the token is needed.
    content : bytes
        Type of what it takes.
    largest : int
        So many bytes it takes.
    """

    method: str
    guarded: bool
    content: bytes = JSON
    largest: int = LARGEST_BODY

    @property
    def is_wide(self) -> bool:
        """Whether it takes more than others; one such body is held at a time."""
        return self.largest > LARGEST_BODY


class Gate:
    """A pure ASGI application before another one, which sees only requests that pass.

    Parameters
    ----------
    app : callable
        What answers.
    table : Mapping[str, Door]
        Every path there is.
    port : int
        On which the server listens.
    token : str
        That the page knows.
    """

    def __init__(self, app: App, table: Mapping[str, Door], *, port: int, token: str) -> None:
        self._app, self._table = app, table
        self._hosts = {f"{name}:{port}".encode() for name in ("127.0.0.1", "localhost", "[::1]")}
        self._token = f"Bearer {token}".encode()
        self._wide = asyncio.Lock()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or let it in."""
        if scope["type"] != "http":
            if scope["type"] == "websocket":
                await send({"type": "websocket.close", "code": 1008})
            return
        refused = self._judged(scope)
        door = self._table.get(scope["path"])
        if refused is None and door is not None and door.is_wide:
            async with self._wide:
                await self._passed(scope, receive, send, largest=door.largest, patience=LARGE_BODY_PATIENCE)
            return
        await self._passed(scope, receive, send, largest=LARGEST_BODY, patience=BODY_PATIENCE, refused=refused)

    async def _passed(
        self,
        scope: Scope,
        receive: Receive,
        send: Send,
        *,
        largest: int,
        patience: float,
        refused: tuple[int, str] | None = None,
    ) -> None:
        """Read a body, and let the request in with it, or tell why not."""
        try:
            # A connection that is closed before its request was read is reset, and the refusal lost with it.
            body = await asyncio.wait_for(_whole(receive, largest), patience)
        except TimeoutError:
            refused = refused or (408, "the request did not come in time")
            body = None
        if refused is not None:
            await _refuse(send, *refused)
            return
        if body is None:
            await _refuse(send, 413, _too_long(largest))
            return
        await self._app(scope, _again(body, receive), _with_headers(send))

    def _judged(self, scope: Scope) -> tuple[int, str] | None:
        headers: list[tuple[bytes, bytes]] = scope["headers"]

        def all_of(name: bytes) -> list[bytes]:
            return [value for key, value in headers if key.lower() == name]

        hosts = all_of(b"host")
        if len(hosts) != 1 or hosts[0] not in self._hosts:
            return 403, "this server answers on its own address only"
        raw: bytes = scope["raw_path"]
        if not raw.startswith(b"/"):
            return 403, "name a path"
        origins = all_of(b"origin")
        if origins and origins != [b"http://" + hosts[0]]:
            return 403, "was asked by another site's page"
        if not _same_site(scope, all_of):
            return 403, "was asked by another site's page"
        door = self._table.get(scope["path"]) if b"%" not in raw and raw == scope["path"].encode() else None
        if door is None:
            return 404, "there is nothing here"
        if scope["method"] != door.method:
            return 403, f"ask by {door.method}"
        if door.guarded:
            tokens = all_of(b"authorization")
            given = tokens[0] if len(tokens) == 1 else b""
            if not hmac.compare_digest(given, self._token):
                return 401, "open the link that the command printed"
            if [kind.split(b";")[0].strip().lower() for kind in all_of(b"content-type")] != [door.content]:
                return 403, f"send {door.content.decode()}"
        lengths = all_of(b"content-length")
        if lengths and (len(lengths) > 1 or not lengths[0].isdigit() or int(lengths[0][:12]) > door.largest):
            return 413, _too_long(door.largest)
        return None


def _same_site(scope: Scope, all_of: Callable[[bytes], list[bytes]]) -> bool:
    """Whether the browser says that the server's own page asks, or its user; a program that is none says nothing."""
    sites = all_of(b"sec-fetch-site")
    if all(site in (b"same-origin", b"none") for site in sites):
        return True
    # The user's browser opens the empty page from the file that holds the link: a navigation of the whole window,
    # whose answer nobody else can read or frame, and which holds nothing.
    return (
        scope["path"] == PAGE
        and all_of(b"sec-fetch-mode") == [b"navigate"]
        and all_of(b"sec-fetch-dest") == [b"document"]
    )


def _too_long(largest: int) -> str:
    return f"a request may have {largest} bytes"


async def _whole(receive: Receive, largest: int) -> bytes | None:
    """The body; None where it is too large."""
    parts, size = [], 0
    while True:
        message = await receive()
        if message["type"] != "http.request":
            return b""  # it has gone: the answer goes nowhere
        size += len(message.get("body", b""))
        if size > largest:
            return None
        parts.append(message.get("body", b""))
        if not message.get("more_body"):
            return b"".join(parts)


def _again(body: bytes, receive: Receive) -> Receive:
    """Receives the body in one piece, then what comes after it."""
    told = False

    async def next_message() -> Message:
        nonlocal told
        if not told:
            told = True
            return {"type": "http.request", "body": body, "more_body": False}
        return await receive()

    return next_message


def _with_headers(send: Send) -> Send:
    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            message = {**message, "headers": [*message.get("headers", []), *HEADERS]}
        await send(message)

    return sent


async def _refuse(send: Send, status: int, why: str) -> None:
    headers = [(b"content-type", b"text/plain; charset=utf-8"), (b"connection", b"close"), *HEADERS]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": f"{why}\n".encode()})
