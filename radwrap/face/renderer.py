"""The process that traces for the page: one at a time, asked to stop rather than killed, so that it stays warm.

The server's side starts it, tells it what to render and hears how far it is. The child answers in lines of JSON. It
learns of the server's end by the end of its stdin, however that went, ends its own tracers, and removes the server's
working folders, which nobody else can do then.
It may be started before there are such folders: it loads its libraries until it is told of them.
Run as ``python -m radwrap.face.renderer``.
"""

from __future__ import annotations

import gc
import json
import pickle
import queue
import shutil
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from radwrap.errors import Cancelled, EnvironmentFailure, InputError, RadwrapError, TracerError
from radwrap.files import write_bytes
from radwrap.own_modules import start_module
from radwrap.process import Child

OBEYS_WITHIN: Final = 0.5  # s in which a render that is told to stop has to
_START: Final = 60.0  # s, on a busy machine
_LISTEN: Final = 0.05  # s between looks at whether to stop
_FAREWELL: Final = 3.0  # s
_STOP, _BYE, _RENDER, _FOLDERS = "stop", "bye", "render", "folders"
EFFECTS: Final = "effects"
TRADE: Final = "trade"
_ERRORS: Final[dict[str, type[RadwrapError]]] = {
    kind.__name__: kind for kind in (InputError, EnvironmentFailure, TracerError, Cancelled)
}


class Renderer:
    """The server's side.

    Parameters
    ----------
    folder : Path
        Where requests are left for the child, which removes it once the server is gone.
    ahead : Child, optional
        One that was started already; whoever did so ends it too.
    more : tuple of Path
        What the child removes likewise.
    """

    def __init__(self, folder: Path, ahead: Child | None = None, more: tuple[Path, ...] = ()) -> None:
        self._folder, self._more = folder, more
        self._ahead = ahead
        if ahead is not None:  # at once: from now on somebody is there who removes them
            self._tell_folders(ahead)
        self._child: Child | None = None
        self._warm: Path | None = None  # where its warm scene lies
        self._asked = 0
        self._stop = threading.Event()
        self._one = threading.Lock()

    def begin(self) -> None:
        """What follows is not to end: an earlier `stop` is forgotten."""
        self._stop.clear()

    def stop(self) -> None:
        """Tell the render that is under way, and those that follow, to end."""
        self._stop.set()

    def effects(self, request: Mapping[str, Any]) -> Mapping[str, Any]:
        """Measure what effects of a scene are worth, see `measured_effects`; as `render`, one of them at a time."""
        return self._answer({**request, "what": EFFECTS}, lambda _: None)

    def trade(self, request: Mapping[str, Any], told: Callable[[Mapping[str, Any]], object]) -> Mapping[str, Any]:
        """Measure what accuracy costs, see `measured_trade`; as `render`, one of them at a time."""
        return self._answer({**request, "what": TRADE}, told)

    def render(self, request: Mapping[str, Any], told: Callable[[Mapping[str, Any]], object]) -> None:
        """Render, in the caller's thread; one at a time.

        Parameters
        ----------
        request : Mapping
            ``scene`` in an absolute folder, ``out``, ``options`` of `RenderOptions`, and whether it is
            ``brief``, see `WarmScene.leave`. The scene goes as it is: its document took .05 s of the first picture.
        told : callable
            Is told how far it is.

        Raises
        ------
        RadwrapError
            What the render raised; `Cancelled` after `stop`.
        """
        self._answer(request, told)

    def _answer(self, request: Mapping[str, Any], told: Callable[[Mapping[str, Any]], object]) -> Mapping[str, Any]:
        with self._one:
            return self._heard(request, told)

    def _heard(self, request: Mapping[str, Any], told: Callable[[Mapping[str, Any]], object]) -> Mapping[str, Any]:
        again = "measure again" if "what" in request else "trace again"
        if self._stop.is_set():
            raise _stopped(again)
        self._asked += 1
        path = self._folder / f"request_{self._asked}.pickle"
        write_bytes(path, pickle.dumps(request))
        child = self._started(again)
        if not child.tell(f"{_RENDER} {path.name}"):
            self.kill()
            raise _gone(again)
        asked_to_stop = None
        while True:
            line = child.hear(_LISTEN)
            if line is None:
                if child.ended:
                    self.kill()
                    raise _gone(again)
                if self._stop.is_set():
                    now = time.monotonic()
                    if asked_to_stop is None:
                        asked_to_stop = now
                        child.tell(_STOP)
                    elif now - asked_to_stop > OBEYS_WITHIN:
                        self.kill()
                        raise _stopped(again)
                continue
            answer = json.loads(line) if line.startswith("{") else {}
            if "done" in answer:
                found: Mapping[str, Any] = answer.get("found", {})
                return found
            if "error" in answer:
                kind = _ERRORS.get(answer["kind"], EnvironmentFailure)
                if kind is Cancelled:
                    raise _stopped(again)
                raise kind(answer["error"], where=answer["where"], remedy=answer["remedy"])
            if "lies" in answer:
                self._warm = Path(answer["lies"])
            if "progress" in answer:
                told(answer["progress"])

    def _started(self, again: str) -> Child:
        if self._child is None or self._child.ended:
            self.kill()
            ahead, self._ahead = self._ahead, None
            self._child = ahead if ahead is not None and not ahead.ended else start_module("radwrap.face.renderer")
            if not self._tell_folders(self._child) or self._child.hear(_START) != "ready":
                self.kill()
                raise _gone(again)
        return self._child

    @property
    def pid(self) -> int | None:
        """Of the child, if there is one."""
        return None if self._child is None else self._child.pid

    def _tell_folders(self, child: Child) -> bool:
        return child.tell(f"{_FOLDERS} {json.dumps([str(one) for one in (self._folder, *self._more)])}")

    def kill(self) -> None:
        """End the child, and all that it has started, at once."""
        child, self._child = self._child, None
        if child is not None:
            child.kill()
        if self._warm is not None:
            shutil.rmtree(self._warm, ignore_errors=True)
            self._warm = None

    def close(self) -> None:
        """Let the child end; it is killed where it does not."""
        if self._child is not None and not self._child.ended:
            self._child.tell(_BYE)
            self._child.close(_FAREWELL)
        self.kill()


def _gone(again: str) -> EnvironmentFailure:
    return EnvironmentFailure("ended by itself, or was killed", where="renderer", remedy=again)


def _stopped(again: str) -> Cancelled:
    return Cancelled("was stopped", where="renderer", remedy=again)


def main() -> int:
    """Render what is asked for, until the server says farewell or is gone."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # the server decides when we end
    ears = _Ears()
    ears.start()
    gc.disable()  # among what is loaded here there is no garbage: to look for it is time lost
    from radwrap.face.warmth import Warmth, load_tracer

    with suppress(OSError):  # the server is gone already, and its folders are to be removed
        print("ready", flush=True)
    load_tracer()
    gc.freeze()  # what is loaded stays: to look through it took a tenth of the first picture's time
    gc.enable()
    with Warmth() as warmth:
        while (name := ears.asked.get()) is not None:
            _tell(_answered(warmth, ears.folders[0] / name, ears))
    if ears.orphaned:
        for folder in ears.folders:
            shutil.rmtree(folder, ignore_errors=True)
    return 0


def _answered(warmth: Any, path: Path, ears: _Ears) -> dict[str, Any]:
    try:
        request = pickle.loads(path.read_bytes())  # noqa: S301  (of the server, in a folder that only its user may enter)
        if request.get("what") == EFFECTS:
            from radwrap.face.effects import measured_effects  # which the first picture does not need

            return {"done": True, "found": measured_effects(request)}
        if request.get("what") == TRADE:
            from radwrap.face.trading import measured_trade

            return {"done": True, "found": measured_trade(request, ears.stop.is_set, _tell)}
        warmth.render(
            request,
            ears.stop.is_set,
            lambda state: _tell({"progress": asdict(state)}),
            lambda place: _tell({"lies": str(place)}),
        )
    except RadwrapError as error:
        return {"kind": type(error).__name__, "error": error.what, "where": error.where, "remedy": error.remedy}
    except OSError as error:
        return {"kind": "", "error": error.strerror or str(error), "where": str(error.filename or ""), "remedy": ""}
    except MemoryError:
        return {"kind": "", "error": "not enough memory", "where": "renderer", "remedy": "render by fewer pixels"}
    except Exception as error:  # noqa: BLE001  (the page is told, and what is warm stays)
        traceback.print_exception(error, file=sys.stderr)
        return {"kind": "", "error": "this is an error in radwrap itself; please report it", "where": "", "remedy": ""}
    return {"done": True}


def _tell(answer: Mapping[str, Any]) -> None:
    with suppress(OSError):  # the server is gone, as our stdin is about to say
        sys.stdout.write(f"{json.dumps(answer)}\n")
        sys.stdout.flush()


class _Ears(threading.Thread):
    """Hears the server while the main thread renders."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.asked: queue.Queue[str | None] = queue.Queue()
        self.stop = threading.Event()
        self.orphaned = False
        self.folders: list[Path] = []  # of the server, that of requests first

    def run(self) -> None:
        """Listen until the end."""
        for line in sys.stdin:
            word, _, name = line.strip().partition(" ")
            if word == _STOP:
                self.stop.set()
            elif word == _RENDER:
                self.stop.clear()
                self.asked.put(name)
            elif word == _FOLDERS:
                self.folders = [Path(one) for one in json.loads(name)]
            elif word == _BYE:
                break
        else:
            self.orphaned = True
        self.stop.set()
        self.asked.put(None)


if __name__ == "__main__":
    sys.exit(main())
