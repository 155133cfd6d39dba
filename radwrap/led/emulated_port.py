"""The port to an emulated device in a process of its own: a socket, one request and one answer at a time.

A message is one letter, the length of its content in four bytes, the content.
"""

from __future__ import annotations

import json
import socket
import threading
from dataclasses import dataclass
from typing import Any, Final

from radwrap.led.backend import PortFailure

WRITE, READ, SET_FEATURE, GET_FEATURE, DESCRIBE, MISBEHAVE, HISTORY = b"w", b"r", b"s", b"g", b"d", b"m", b"h"
DONE, GONE, STALLED, FROZEN, NOTHING = b"k", b"u", b"s", b"f", b"n"
_HEADER: Final = 5
_LONGEST: Final = 1 << 28  # byte of a history
LONGEST_REQUEST: Final = 1 << 12  # byte; a report has 65 at most
# An emulator answers at once or, to a read, after the patience it was told.
_PATIENCE: Final = 10.0
_TROUBLE: Final = {GONE: "no such device", STALLED: "broken pipe", FROZEN: "does not answer"}


def send(connection: socket.socket, kind: bytes, content: bytes = b"") -> None:
    """Send one message."""
    connection.sendall(kind + len(content).to_bytes(4, "little") + content)


def receive(connection: socket.socket, longest: int = _LONGEST) -> tuple[bytes, bytes] | None:
    """Receive one message: its letter and its content; None at the end of the connection, or where it is too long."""
    header = _exactly(connection, _HEADER)
    if header is None or (size := int.from_bytes(header[1:], "little")) > longest:
        return None
    content = _exactly(connection, size)
    return None if content is None else (header[:1], content)


def _exactly(connection: socket.socket, size: int) -> bytes | None:
    parts = b""
    while len(parts) < size:
        part = connection.recv(size - len(parts))
        if not part:
            return None
        parts += part
    return parts


@dataclass(frozen=True, slots=True)
class Told:
    """What an emulator says of its device.

    Attributes
    ----------
    identity : Mapping
        Ids and strings.
    descriptor : bytes
        Report descriptor.
    plugged : bool
        Whether the device is there now.
    """

    identity: dict[str, Any]
    descriptor: bytes
    plugged: bool


class EmulatedPort:
    """A connection to an emulator.

    Parameters
    ----------
    path : str
        The emulator's socket.
    """

    def __init__(self, path: str) -> None:
        self._path, self._where = path, f"emulator:{path}"
        self._guard = threading.Lock()
        self._whole = True  # no exchange was broken off
        self._closed = False
        self._connection = self._connected()

    def write(self, report: bytes) -> None:
        """Send an output report, its id first (0 where reports have no numbers)."""
        self._ask(WRITE, report)

    def read(self, size: int, patience: float) -> bytes:
        """Wait for an input report for `patience` seconds."""
        # An emulator shares the processor with everything else; a real device has its own.
        report = self._ask(READ, round(1e3 * max(patience, _PATIENCE / 2)).to_bytes(4, "little"))
        if not report:
            raise PortFailure(f"did not answer within {patience:g} s", where=self._where)
        return report[:size]

    def set_feature(self, report: bytes) -> None:
        """Send a feature report, its id first."""
        self._ask(SET_FEATURE, report)

    def get_feature(self, report_id: int, size: int) -> bytes:
        """Ask for a feature report of at most `size` bytes, its id first."""
        return self._ask(GET_FEATURE, bytes((report_id,)))[:size]

    def descriptor(self) -> bytes:
        """Report descriptor."""
        return self.told().descriptor

    def told(self) -> Told:
        """What the emulator says of its device."""
        content = json.loads(self._ask(DESCRIBE))
        return Told(content["identity"], bytes.fromhex(content["descriptor"]), content["plugged"])

    def misbehave(self, how: str) -> None:
        """Make a fault, see `Unit.misbehave`."""
        self._ask(MISBEHAVE, how.encode())

    def history(self) -> list[tuple[float, list[float]]]:
        """Time of the monotonic clock [s], and the light of each LED from then on."""
        return [(moment, light) for moment, light in json.loads(self._ask(HISTORY))]

    def close(self) -> None:
        """End the connection."""
        self._closed = True
        self._connection.close()

    def _connected(self) -> socket.socket:
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        connection.settimeout(_PATIENCE)
        try:
            connection.connect(self._path)
        except OSError as error:
            connection.close()
            raise PortFailure(f"no emulator answers: {error.strerror or error}", where=self._where) from error
        return connection

    def _ask(self, kind: bytes, content: bytes = b"") -> bytes:
        with self._guard:
            try:
                if not (self._whole or self._closed):
                    # An interrupt may come anywhere: nobody knows what of that exchange is still to come.
                    self._connection.close()
                    self._connection = self._connected()
                self._whole = False
                send(self._connection, kind, content)
                answer = receive(self._connection)
                self._whole = True
            except OSError as error:
                raise PortFailure(f"the emulator was lost: {error}", where=self._where) from error
        if answer is None:
            raise PortFailure("the emulator was lost", where=self._where)
        if answer[0] in _TROUBLE:
            raise PortFailure(_TROUBLE[answer[0]], where=self._where)
        return answer[1]
