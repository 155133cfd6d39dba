"""Each request that may come, and its answer."""

from __future__ import annotations

import asyncio
import json
import sys
import threading
import time
import traceback
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import suppress
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Final, TypeVar

import numpy as np
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from radwrap.errors import InputError, RadwrapError
from radwrap.face.assets import Asset, assets
from radwrap.face.decoder import LARGEST
from radwrap.face.gate import LARGEST_BODY, OCTETS, App, Door, Gate
from radwrap.face.layout import layout
from radwrap.face.matters import parts_of
from radwrap.face.photo import Photos, compared
from radwrap.face.profile import ends_of, profile_table, width_of
from radwrap.face.ring import HeldRing
from radwrap.face.saving import save, scene_text, turned_scene
from radwrap.face.session import Session, Status
from radwrap.face.traced import Image, Traced
from radwrap.face.trading import longest_of
from radwrap.images import png_bytes
from radwrap.imaging.page.turn import Turn, changes_of, turn_of
from radwrap.scene.file.load import with_camera

if TYPE_CHECKING:
    from radwrap.face.measuring import Measured

_BLOCK: Final = 1 << 20  # byte; a client that reads slowly makes us hold no more than a few
_LOOK: Final = 0.005  # s between looks at whether there is another picture
_STEP: Final = 0.1  # s between words on how far a trace is
_LONGEST_WATCH: Final = 1.0  # s
_GRACE: Final = 2.0  # s for a page that is loaded again
MOST_PLANES: Final = 512 << 20  # byte; a page with more of them leaves mixing to the server
PHOTO: Final = "/api/photo"

Numbers = np.ndarray[Any, Any]
_T = TypeVar("_T")
Answer = Callable[[Request], Awaitable[Response]]


def gated(session: Session, *, port: int, token: str, ring: HeldRing | None = None) -> App:
    """All of the server behind its gate."""
    shipped = assets()
    answers = _Answers(session, ring)
    posts: dict[str, Answer] = {
        f"/api/{name}": _careful(answer)
        for name, answer in (
            ("watch", answers.watch),
            ("planes", answers.planes),
            ("turn", answers.turn),
            ("pixel", answers.pixel),
            ("profile", answers.profile),
            ("png", answers.png),
            ("scene", answers.scene),
            ("measure", answers.measure),
            ("photo", answers.photo),
            ("compare", answers.compare),
            ("matters", answers.matters),
            ("trade", answers.trade),
            ("layout", answers.layout),
            ("save", answers.save),
            ("trace", answers.trace),
            ("stop", answers.stop),
            *([] if ring is None else [("ring", answers.ring)]),
        )
    }
    routes = [Route(path, _shipped(asset), methods=["GET"]) for path, asset in shipped.items()]
    routes += [Route(path, answer, methods=["POST"]) for path, answer in posts.items()]
    app = Starlette(routes=routes)
    app.router.redirect_slashes = False
    table = {path: Door("GET", guarded=False) for path in shipped} | {
        path: Door("POST", guarded=True) for path in posts
    }
    table[PHOTO] = Door("POST", guarded=True, content=OCTETS, largest=LARGEST + LARGEST_BODY)
    return Gate(app, table, port=port, token=token)


def _shipped(asset: Asset) -> Answer:
    async def answer(_: Request) -> Response:
        return Response(asset.content, media_type=asset.media_type)

    return answer


def _careful(answer: Answer) -> Answer:
    """An answer whose errors are told as JSON: to the page what is wrong, to stderr what is our fault."""

    async def careful(request: Request) -> Response:
        try:
            return await answer(request)
        except _Gone:
            return Response(status_code=499)
        except Exception as error:  # noqa: BLE001  (the page lives on)
            told, status = _refusal(error)
            return JSONResponse(told, status)

    return careful


def _refusal(error: Exception) -> tuple[dict[str, str], int]:
    """What the page is told of an error, and the status; what is our fault goes to stderr."""
    if isinstance(error, RadwrapError):
        return {"error": error.what, "where": error.where, "remedy": error.remedy, "text": str(error)}, 422
    what, status = "not enough memory", 507
    if not isinstance(error, MemoryError):
        traceback.print_exception(error, file=sys.stderr)
        what, status = "this is an error in radwrap itself; please report it", 500
    return {"error": what, "where": "", "remedy": "", "text": what}, status


class _Gone(Exception):
    """Who asked has gone, and wants no answer."""


class _Answers:
    """The answers of a session; images are made one at a time, and none for who has gone."""

    def __init__(self, session: Session, ring: HeldRing | None) -> None:
        self._session, self._ring = session, ring
        self._one = asyncio.Lock()
        self._measuring = asyncio.Lock()
        self._photos = Photos(session.work)
        self._ring_told = None if ring is None else ring.described()
        self._watchers = 0
        self._watched = 0.0

    async def watch(self, request: Request) -> Response:
        """How far the trace is: once that, or its picture, is another than the page knows, or after a second.

        No answer lasts longer, so that any number of tabs get theirs: browsers hold six connections to a server.
        """
        told = _told(await request.body())
        known = told.get("done"), told.get("basis", self._basis)
        self._watchers += 1
        try:
            begun = time.monotonic()
            while (status := self._session.status).state == "tracing":
                await asyncio.sleep(_LOOK)
                waited = time.monotonic() - begun
                if self._basis != known[1] or (waited > _STEP and status.done != known[0]) or waited > _LONGEST_WATCH:
                    break
                if await request.is_disconnected():
                    break
        finally:
            self._watchers -= 1
            self._watched = time.monotonic()
            asyncio.get_running_loop().call_later(_GRACE, self._stop_unwatched)
        return JSONResponse(self._known(status))

    @property
    def _basis(self) -> int:
        """Number of the present one."""
        traced = self._session.present
        return 0 if traced is None else traced.number

    def _known(self, status: Status) -> dict[str, Any]:
        told: dict[str, Any] = {"state": status.state, "done": status.done, "of": status.of}
        if status.error is not None:
            told["error"] = str(status.error)
        traced = self._session.present
        if traced is not None:
            size = len(traced.sources) * traced.relighter.basis.sensor.pixels * 5
            mixes, saves = size <= MOST_PLANES, self._session.out is not None
            told["described"] = _finite({**traced.described(), "mixes": mixes, "saves": saves})
            if self._ring is not None:
                told["described"]["ring"] = self._ring_told
            if self._session.study is not None:
                told["described"]["study"] = _finite(self._session.study)
        return told

    def _stop_unwatched(self) -> None:
        alone = not self._watchers and time.monotonic() - self._watched > _GRACE - _STEP  # no page has asked since
        if alone and self._session.status.state == "tracing":
            self._session.stop()

    async def planes(self, request: Request) -> Response:
        """What each source adds, see `Traced.plane`."""
        traced, _ = await self._asked(request)
        pixels = traced.relighter.basis.sensor.pixels
        sizes = [1 + pixels + -(-pixels // 4)] * len(traced.sources)

        async def planes() -> AsyncIterator[Numbers]:
            for number in range(len(sizes)):  # one at a time: all of a large sensor take hundreds of megabytes
                yield await asyncio.to_thread(traced.plane, number)

        return _octets({"pixels": pixels}, sizes, planes())

    async def turn(self, request: Request) -> Response:
        """An image: its error in a line of JSON, then thresholds, radiant exposure and deviations as float32."""
        traced, told = await self._asked(request)
        turn = _turn(told, traced)
        image = await self._image(request, traced, turn)
        blocks = (image.thresholds.values, image.relit.radiant_exposure.values, image.sigma)

        async def each() -> AsyncIterator[Numbers]:
            for block in blocks:
                yield block

        return _octets(traced.told(turn, image), [block.size for block in blocks], each())

    async def pixel(self, request: Request) -> Response:
        """All that is known of a pixel."""
        traced, told = await self._asked(request)
        column, row = told.get("column"), told.get("row")
        if type(column) is not int or type(row) is not int:
            raise InputError("needs column and row", where="pixel")
        image = await self._image(request, traced, _turn(told, traced))
        return JSONResponse(traced.pixel(image, column, row))

    async def profile(self, request: Request) -> Response:
        """A profile as CSV."""
        traced, told = await self._asked(request)
        image = await self._image(request, traced, _turn(told, traced))
        ends = ends_of(told.get("profile"), *image.sigma.shape)
        table = profile_table(image, ends, width_of(told.get("width")))
        return Response(table, media_type="text/csv; charset=utf-8")

    async def measure(self, request: Request) -> Response:
        """What an algorithm reads from an image, with its error; one image at a time, beside those of the knobs."""
        traced, told = await self._asked(request, kept=True)
        image = await self._image(request, traced, _turn(told, traced))
        async with self._measuring:
            if await request.is_disconnected():
                raise _Gone
            found = await left_behind(lambda: _measured(traced, image))
        return JSONResponse({"measured": [_finite(asdict(one)) for one in found]})

    async def photo(self, request: Request) -> Response:
        """Take a photo, whose bytes follow a line of JSON that tells basis and turn; its gray levels come back."""
        body = await request.body()
        head, _, _ = body[:LARGEST_BODY].partition(b"\n")
        told = _told(head)
        traced = self._session.finished(_number(told))
        image = await self._image(request, traced, _turn(told, traced))
        sensor, content = image.relighter.basis.sensor, memoryview(body)[len(head) + 1 :]
        photo = await asyncio.to_thread(self._photos.take, content, sensor)

        async def each() -> AsyncIterator[Numbers]:
            yield photo.values

        answer = {"photo": photo.number, "bit_depth": photo.bit_depth, "notes": photo.notes}
        return _octets(answer, [photo.values.size], each())

    async def compare(self, request: Request) -> Response:
        """How a photo differs from an image."""
        traced, told = await self._asked(request, kept=True)
        photo = self._photos.kept(told.get("photo"))
        image = await self._image(request, traced, _turn(told, traced))
        async with self._measuring:
            if await request.is_disconnected():
                raise _Gone
            found = await left_behind(lambda: compared(photo, image))
        return JSONResponse(_finite(found))

    async def matters(self, request: Request) -> Response:
        """What matters to an image: causes of its deviation, and effects that are measured anew in its light."""
        traced, told = await self._asked(request, kept=True)
        turn = _turn(told, traced)
        image = await self._image(request, traced, turn)
        found = await left_behind(lambda: self._session.effects(traced, turn))
        return JSONResponse(_finite({"parts": parts_of(image), **found}))

    async def trade(self, request: Request) -> Response:
        """What accuracy costs in the light of a turn: lines of JSON that tell how far it is, then what was found.

        It ends when who asked has gone.
        """
        traced, told = await self._asked(request, kept=True)
        turn, longest = _turn(told, traced), longest_of(told.get("longest"))
        return StreamingResponse(self._traded(request, traced, turn, longest), media_type=OCTETS.decode())

    async def _traded(self, request: Request, traced: Traced, turn: Turn, longest: float) -> AsyncIterator[bytes]:
        loop, steps = asyncio.get_running_loop(), asyncio.Queue[Mapping[str, Any]]()
        gone = threading.Event()  # who asked

        def heard(progress: Mapping[str, Any]) -> None:
            with suppress(RuntimeError):  # the server has ended
                loop.call_soon_threadsafe(steps.put_nowait, progress)

        job = asyncio.ensure_future(left_behind(lambda: self._session.trade(traced, turn, longest, heard, gone.is_set)))
        try:
            yield _line({"progress": None})
            while not (job.done() and steps.empty()):
                with suppress(asyncio.TimeoutError):
                    yield _line({"progress": await asyncio.wait_for(steps.get(), _STEP)})
                if await request.is_disconnected():
                    return
            try:
                yield _line({"found": _finite(await job)})
            except Exception as error:  # noqa: BLE001  (the page lives on)
                yield _line({"refused": _refusal(error)[0]})
        finally:
            gone.set()
            # Not here: a trace that ends another measurement holds what this waits for, and all tabs would stand still.
            loop.run_in_executor(None, self._session.end_trade, heard)
            job.add_done_callback(_heeded)

    async def layout(self, request: Request) -> Response:
        """Where things stand."""
        traced, _ = await self._asked(request)
        return JSONResponse(await asyncio.to_thread(layout, traced.scene))

    async def png(self, request: Request) -> Response:
        """The image as gray.png has it."""
        traced, told = await self._asked(request, kept=True)
        image = await self._image(request, traced, _turn(told, traced))
        return Response(await asyncio.to_thread(png_bytes, image.relit.gray.codes), media_type="image/png")

    async def scene(self, request: Request) -> Response:
        """The turned scene as a file."""
        traced, told = await self._asked(request, kept=True)
        turn = _turn(told, traced)
        image = await self._image(request, traced, turn)
        return Response(scene_text(turned_scene(traced, turn, image)), media_type="application/toml; charset=utf-8")

    async def save(self, request: Request) -> Response:
        """Save the turn into the folder of --out."""
        traced, told = await self._asked(request, kept=True)
        out = self._session.out
        if out is None:
            raise InputError("has no folder", where="save", remedy="start the page with a folder for results")
        turn = _turn(told, traced)
        image = await self._image(request, traced, turn)
        ends = None if told.get("profile") is None else ends_of(told["profile"], *image.sigma.shape)
        line = None if ends is None else (ends, width_of(told.get("width")))
        folder, note = await asyncio.to_thread(save, out, traced, turn, image, line)
        return JSONResponse({"folder": str(folder), "note": note})

    async def trace(self, request: Request) -> Response:
        """Begin to trace: with other values where rays are needed, in the light of a turn, else the scene again."""
        told = _told(await request.body())
        if "rays" in told:
            self._session.traced(_number(told))
            await asyncio.to_thread(self._session.trace_with, told["rays"])
            return JSONResponse({})
        turn = None
        if told.get("turn") is not None:
            turn = turn_of(told["turn"], self._session.finished(_number(told)).sources)
        await asyncio.to_thread(self._session.trace, turn)
        return JSONResponse({})

    async def stop(self, request: Request) -> Response:
        """Stop tracing."""
        del request
        self._session.stop()
        return JSONResponse({})

    async def ring(self, request: Request) -> Response:
        """Light the ring as the knobs stand, hear that the tab which holds it is there, or turn it off."""
        assert self._ring is not None  # noqa: S101  (there is no such route without it)
        told = _told(await request.body())
        tab, what = told.get("tab"), told.get("do")
        if what == "beat":
            return JSONResponse(await asyncio.to_thread(self._ring.beat, tab))
        if what == "dark":
            await asyncio.to_thread(self._ring.dark, tab)
            return JSONResponse({})
        if what != "light":
            raise InputError('must be "light", "beat" or "dark"', where="do")
        traced = self._session.finished(_number(told))
        turn = _turn(told, traced)
        scene = with_camera(traced.scene, changes_of(turn, traced.scene.camera))
        factors = dict(zip(traced.sources, turn.factors, strict=True))
        lit = await asyncio.to_thread(self._ring.light, tab, scene, factors, scene.camera.exposure_time)
        return JSONResponse(lit)

    async def _asked(self, request: Request, *, kept: bool = False) -> tuple[Traced, dict[str, Any]]:
        """The basis that is asked for, of a picture that is to be kept no coarse one; and what else is told."""
        told = _told(await request.body())
        find = self._session.finished if kept else self._session.traced
        return find(_number(told)), told

    async def _image(self, request: Request, traced: Traced, turn: Turn) -> Image:
        async with self._one:
            if await request.is_disconnected():
                raise _Gone
            return await asyncio.to_thread(traced.image, turn)


def _measured(traced: Traced, image: Image) -> list[Measured]:
    from radwrap.face.measuring import measured  # with OpenCV and SciPy, which the first picture need not wait for

    return measured(with_camera(traced.scene, image.changes), image.relit)


def _heeded(job: asyncio.Future[Any]) -> None:
    """What nobody waits for may fail."""
    if not job.cancelled():
        job.exception()


async def left_behind(work: Callable[[], _T]) -> _T:
    """Work in a thread that the server's end does not wait for."""
    loop = asyncio.get_running_loop()
    done: asyncio.Future[_T] = loop.create_future()

    def tell(set_to: Callable[[Any], None], what: Any) -> None:
        if not done.done():
            set_to(what)

    def carry_out() -> None:
        try:
            told: tuple[Callable[[Any], None], Any] = (done.set_result, work())
        except Exception as error:  # noqa: BLE001  (raised where it is waited for)
            told = (done.set_exception, error)
        with suppress(RuntimeError):  # the server has ended
            loop.call_soon_threadsafe(tell, *told)

    threading.Thread(target=carry_out, daemon=True).start()
    return await done


def _told(body: bytes) -> dict[str, Any]:
    try:
        told = json.loads(body or b"{}")
    except (ValueError, RecursionError) as error:
        raise InputError("is not JSON", where="request") from error
    if not isinstance(told, dict):
        raise InputError("must be an object", where="request")
    return told


def _number(told: Mapping[str, Any]) -> int:
    number = told.get("basis")
    if type(number) is not int:
        raise InputError("must be the number of a basis", where="basis")
    return number


def _turn(told: Mapping[str, Any], traced: Traced) -> Turn:
    return turn_of(told.get("turn", {}), traced.sources)


def _line(told: Mapping[str, Any]) -> bytes:
    return json.dumps(told, allow_nan=False).encode() + b"\n"


def _octets(told: Mapping[str, Any], sizes: list[int], blocks: AsyncIterator[Numbers]) -> StreamingResponse:
    """A line of JSON that tells how long the blocks are, then their numbers as float32, little-endian."""

    async def parts() -> AsyncIterator[bytes | memoryview]:
        yield _line({**_finite(told), "blocks": sizes})
        async for block in blocks:
            octets = np.ascontiguousarray(block, dtype="<f4").reshape(-1).view(np.uint8).data
            for start in range(0, len(octets), _BLOCK):
                yield octets[start : start + _BLOCK]

    return StreamingResponse(parts(), media_type=OCTETS.decode())


def _finite(value: Any) -> Any:
    """JSON knows no infinity: what has no bound is null."""
    if isinstance(value, Mapping):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(one) for one in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
