"""The page's server: on this machine alone, with limits for who is slow, and gone with the command."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import secrets
import signal
import socket
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from radwrap.errors import EnvironmentFailure
from radwrap.face.recipe import Recipe
from radwrap.face.ring import HeldRing, Opened
from radwrap.face.session import Session
from radwrap.files import disk_in_memory
from radwrap.process import Child
from radwrap.scene.scene import Scene

LOOPBACK: Final = "127.0.0.1"
HEADER_PATIENCE: Final = 5.0  # s until the head of a request is whole
READ_PATIENCE: Final = 20.0  # s in which a client must take something of what we send
_HEAD: Final = 32 << 10  # byte of all headers of a request
_CONNECTIONS: Final = 64
_FAREWELL: Final = 1  # s for answers that are under way when the server ends


class _Bounded(H11Protocol):
    """A connection that is closed when the head of a request, or the reading of an answer, takes too long."""

    _waiting: asyncio.TimerHandle | None = None
    _sending: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._await_head()

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        if self.cycle is not None and not self.cycle.response_complete:
            self._heard()

    def on_response_complete(self) -> None:
        super().on_response_complete()
        if not self.transport.is_closing() and (self.cycle is None or self.cycle.response_complete):
            self._await_head()

    def pause_writing(self) -> None:
        super().pause_writing()
        self._sending = self.loop.call_later(READ_PATIENCE, self.transport.abort)

    def resume_writing(self) -> None:
        super().resume_writing()
        if self._sending is not None:
            self._sending.cancel()
            self._sending = None

    def connection_lost(self, exc: Exception | None) -> None:
        self._heard()
        if self._sending is not None:
            self._sending.cancel()
        super().connection_lost(exc)

    def _await_head(self) -> None:
        self._heard()
        self._waiting = self.loop.call_later(HEADER_PATIENCE, self.transport.abort)

    def _heard(self) -> None:
        if self._waiting is not None:
            self._waiting.cancel()
            self._waiting = None


class _Server(uvicorn.Server):
    """Leaves signals to us."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield


def listening(port: int) -> socket.socket:
    """A socket on this machine's own address; port 0 is any free one.

    Raises
    ------
    EnvironmentFailure
        If the port is taken, or not ours to take.
    """
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((LOOPBACK, port))
        listener.listen()  # who follows the link at once waits for the server to be up
    except OSError as error:
        listener.close()
        what = f"cannot be used: {error.strerror or error}"
        raise EnvironmentFailure(what, where=f"port {port}", remedy="choose another `port`") from error
    return listener


def serve(
    scene: Scene,
    options: Mapping[str, Any],
    *,
    port: int,
    out: Path | None,
    recipe: Recipe | None,
    study: Mapping[str, Any] | None,
    ring: Opened | None,
    opened: Callable[[Path], object] | None,
    ahead: Child | None = None,
) -> None:
    """Serve a scene until a signal comes.

    Parameters
    ----------
    scene : Scene
        What is there.
    options : Mapping
        Of `RenderOptions`.
    port : int
        0 is any free one.
    out : Path or None
        For results.
    recipe : Recipe or None
        How the basis is made without the page.
    study : Mapping or None
        Results of a study, see `study_told`.
    ring : callable or None
        Opens the LED ring; without it the page has none.
    opened : callable or None
        Opens a file in the user's browser.
    ahead : Child, optional
        See `Renderer`.

    Raises
    ------
    KeyboardInterrupt
        Once all has ended, as it always does by a signal.
    EnvironmentFailure
        If the port cannot be had.
    """
    token = secrets.token_urlsafe(32)
    with (
        contextlib.closing(listening(port)) as listener,
        _own_folder() as folder,
        _own_folder(disk_in_memory()) as quick,
    ):
        work = Path(folder)
        at = listener.getsockname()[1]
        session = Session(
            scene, options, work=work, out=out, recipe=recipe, study=study, ahead=ahead, quick=Path(quick)
        )
        stack = contextlib.ExitStack()
        before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            held = None if ring is None else stack.enter_context(HeldRing(ring))
            session.trace()
            _tell_link(work, f"http://{LOOPBACK}:{at}/#{token}", opened)
            from radwrap.face.app import gated  # while the renderer works already: it loads what makes pictures
            from radwrap.face.traced import get_ready

            threading.Thread(target=get_ready, daemon=True).start()
            asyncio.run(_served(gated(session, port=at, token=token, ring=held), listener, held))
        finally:
            for number in before:  # one interrupt is enough: the rest is short, and must be whole
                signal.signal(number, signal.SIG_IGN)
            stack.close()
            session.close()
            for number, handler in before.items():
                signal.signal(number, handler)
    raise KeyboardInterrupt


def _own_folder(place: Path | None = None) -> tempfile.TemporaryDirectory[str]:
    """Of the server, which removes it; where the server is killed its renderer does."""
    return tempfile.TemporaryDirectory(prefix="radwrap-face-", dir=place, ignore_cleanup_errors=True)


async def _served(app: Any, listener: socket.socket, ring: HeldRing | None) -> None:
    logging.getLogger("uvicorn").setLevel(logging.CRITICAL)  # what a stranger sends is no news
    config = uvicorn.Config(
        app,
        http=_Bounded,
        ws="none",
        lifespan="off",
        log_config=None,
        access_log=False,
        server_header=False,
        date_header=False,
        proxy_headers=False,
        limit_concurrency=_CONNECTIONS,
        h11_max_incomplete_event_size=_HEAD,
        timeout_graceful_shutdown=_FAREWELL,
        loop="asyncio",
    )
    server = _Server(config)

    def end() -> None:
        server.force_exit = server.should_exit
        server.should_exit = True
        if ring is not None:  # at once, and not after answers that are under way
            threading.Thread(target=ring.close, daemon=True).start()

    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, end)
    await server.serve(sockets=[listener])


def _tell_link(work: Path, link: str, opened: Callable[[Path], object] | None) -> None:
    """Tell the link to a terminal, which nobody else reads, or to a file that only its owner may read."""
    page = _private(work / "open.html", f'<!doctype html><meta http-equiv="refresh" content="0;url={link}">\n')
    if sys.stderr.isatty():
        print(f"radwrap: open {link}", file=sys.stderr)
    else:
        place = _private(work / "link", f"{link}\n")
        print(f"radwrap: the link to open is in {place}", file=sys.stderr)
    if opened is not None:
        threading.Thread(target=opened, args=(page,), daemon=True).start()


def _private(path: Path, text: str) -> Path:
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as stream:
        stream.write(text)
    return path
