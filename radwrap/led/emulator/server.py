"""An emulated device behind a socket, for as long as somebody needs it."""

from __future__ import annotations

import dataclasses
import json
import socket
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from radwrap.led import emulated_port as wire
from radwrap.led.emulator.device import Frozen, Handles, Stall, Unit, Unplugged

# How long an emulator outlives the one who started it: a guardian must still find it.
LINGER: Final = 3.0  # s
_TRAFFIC: Final = (wire.WRITE, wire.READ, wire.SET_FEATURE, wire.GET_FEATURE)
_LONGEST_READ: Final = 60.0  # s that a read may wait
_TICK: Final = 5e-4  # s between looks for an input report


@dataclass(frozen=True, slots=True)
class _Handle:
    """A connection: its number, and how often the device had been plugged in when it was made."""

    number: int
    plug_count: int


class Server:
    """Answers any number of connections.

    Parameters
    ----------
    unit : Unit
        The device.
    path : Path
        Socket to listen at.
    """

    def __init__(self, unit: Unit, path: Path) -> None:
        self._unit = unit
        self._handles = Handles(unit)
        self._guard = threading.Lock()
        self._connections = 0
        self._last_end = time.monotonic()
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.bind(str(path))
        self._listener.listen()
        threading.Thread(target=self._accept, daemon=True).start()

    def serve(self) -> None:
        """Serve until stdin is closed, and then until nobody has been connected for a while."""
        sys.stdin.buffer.read()
        while self._connections or time.monotonic() - self._last_end < LINGER:
            time.sleep(0.05)

    def _accept(self) -> None:
        while True:
            connection, _ = self._listener.accept()
            threading.Thread(target=self._talk, args=(connection,), daemon=True).start()

    def _talk(self, connection: socket.socket) -> None:
        with self._guard:
            self._connections += 1
            handle = _Handle(id(connection), self._unit.plug_count)
            self._handles.open(handle.number)
        try:
            with connection:
                while (message := wire.receive(connection, wire.LONGEST_REQUEST)) is not None:
                    wire.send(connection, *self._answer(*message, handle))
        except OSError:
            pass  # the other side is gone
        finally:
            with self._guard:
                self._connections -= 1
                self._handles.close(handle.number)
                self._last_end = time.monotonic()

    def _answer(self, kind: bytes, content: bytes, handle: _Handle) -> tuple[bytes, bytes]:
        if kind in _TRAFFIC and handle.plug_count != self._unit.plug_count:
            return wire.GONE, b""  # a handle of a device that was unplugged stays dead
        try:
            if kind == wire.READ:
                patience = min(int.from_bytes(content, "little") / 1e3, _LONGEST_READ)
                return wire.DONE, self._read(patience, handle.number)
            with self._guard:
                return wire.DONE, self._do(kind, content)
        except Unplugged:
            return wire.GONE, b""
        except Stall:
            return wire.STALLED, b""
        except Frozen:
            return wire.FROZEN, b""
        except (LookupError, ValueError, TypeError, ArithmeticError):
            return wire.STALLED, b""  # no request that a device knows

    def _do(self, kind: bytes, content: bytes) -> bytes:
        unit = self._unit
        match kind:
            case wire.WRITE:
                unit.output(content[1:] if content[:1] == b"\0" else content)
            case wire.SET_FEATURE:
                unit.set_feature(content)
            case wire.GET_FEATURE:
                return unit.get_feature(content[0])
            case wire.MISBEHAVE:
                unit.misbehave(content.decode())
            case wire.HISTORY:
                return json.dumps(unit.history).encode()
            case wire.DESCRIBE:
                device = unit.device
                told = {"identity": dataclasses.asdict(device.identity), "descriptor": device.descriptor.hex()}
                return json.dumps({**told, "plugged": unit.plugged}).encode()
            case _:
                raise Stall
        return b""

    def _read(self, patience: float, handle: int) -> bytes:
        end = time.monotonic() + patience
        while True:
            with self._guard:
                if self._unit.frozen:
                    raise Frozen
                report = self._handles.input(handle)
            if report is not None:
                return report
            if time.monotonic() > end:
                return b""
            time.sleep(_TICK)
