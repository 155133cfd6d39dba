"""One program drives a device at a time, whoever started it; and it can be ended where light has to go off."""

from __future__ import annotations

import hashlib
import os
import signal
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from typing import Final

from radwrap.errors import EnvironmentFailure

# The same for every user and every TMPDIR: the device is one, too.
_FOLDER: Final = Path(tempfile.gettempdir() if sys.platform == "win32" else "/tmp")  # noqa: S108
_CLOSING: Final = 2.0  # s for a program to turn off and end; a camera's program is killed with it
_GUARDING: Final = 5.0  # s for its guardian, once it was killed
_AGAIN: Final = 0.05  # s between two attempts


class Claim:
    """A device held for one program; it falls when that program and its guardian are gone, even killed.

    Parameters
    ----------
    path : str
        The device's path.

    Raises
    ------
    EnvironmentFailure
        If another program, or its guardian, holds the device.
    """

    def __init__(self, path: str) -> None:
        self.descriptor = _opened(_file(path))
        if not _lock(self.descriptor):
            os.close(self.descriptor)
            raise EnvironmentFailure(
                "another program drives this ring, or its guardian is turning it off",
                where=path,
                remedy="wait for it, or end it: radwrap led off",
            )

    def release(self) -> None:
        """Let the device go."""
        if self.descriptor >= 0:
            os.close(self.descriptor)
            self.descriptor = -1


def drivers(path: str) -> list[int]:
    """Processes that drive a device, as far as this user may know of them, and without guardians; only Linux tells."""
    lock = _file(path)
    return [
        int(process.name)
        for process in Path("/proc").glob("[0-9]*")
        if process.name != str(os.getpid()) and _holds(process, lock) and not _is_guardian(process)
    ]


def end_drivers(path: str) -> list[int]:
    """End whoever drives a device, by SIGTERM, which turns it off, or by SIGKILL, after which the guardian does.

    Returns
    -------
    list of int
        Processes that were ended.

    Raises
    ------
    EnvironmentFailure
        If the device is still held: by another user, or by a guardian that cannot reach it.
    """
    if _falls(path, 0.0):
        return []
    held_by = drivers(path)
    for number, patience in ((signal.SIGTERM, _CLOSING), (signal.SIGKILL, _GUARDING)) if held_by else ():
        for process in held_by:
            with suppress(ProcessLookupError, PermissionError):
                os.kill(process, number)
        if _falls(path, patience):
            return held_by
    raise EnvironmentFailure("another user's program drives this ring, or a guardian cannot reach it", where=path)


def _falls(path: str, patience: float) -> bool:
    """Whether nobody holds a claim, at the latest after some time."""
    end = time.monotonic() + patience
    while True:
        try:
            Claim(path).release()
        except EnvironmentFailure:
            if time.monotonic() > end:
                return False
            time.sleep(_AGAIN)
        else:
            return True


def _file(path: str) -> Path:
    own = path.partition(":")[2]
    # However it is written: a relative path, or a link that udev made.
    key = str(Path(own).resolve()) if own and Path(own).exists() else path
    return _FOLDER / f"radwrap-led-{hashlib.sha256(key.encode()).hexdigest()[:16]}.lock"


def _opened(file: Path) -> int:
    """Open the file of a claim, to be locked: any user may, since that needs no right to write."""
    if sys.platform == "win32":
        return os.open(file, os.O_RDWR | os.O_CREAT)
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK
    try:
        with suppress(FileNotFoundError):
            return os.open(file, flags)
        with suppress(FileExistsError):
            descriptor = os.open(file, flags | os.O_CREAT | os.O_EXCL, 0o644)
            os.fchmod(descriptor, 0o644)  # whatever the umask
            return descriptor
        return os.open(file, flags)  # another made it just now
    except OSError as error:
        raise EnvironmentFailure(
            f"cannot be locked: {error.strerror or error}", where=str(file), remedy="remove it"
        ) from error


def _lock(descriptor: int) -> bool:
    if sys.platform == "win32":
        return True
    import fcntl

    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _holds(process: Path, lock: Path) -> bool:
    """Whether a process has the lock itself, and not only the file open."""
    try:
        wanted = lock.stat()
        for own in (process / "fd").iterdir():
            with suppress(OSError):
                if os.path.samestat(own.stat(), wanted) and "FLOCK" in (process / "fdinfo" / own.name).read_text():
                    return True
    except OSError:
        pass  # it has ended, or is another user's
    return False


def _is_guardian(process: Path) -> bool:
    try:
        return b"\0radwrap.led.guardian\0" in (process / "cmdline").read_bytes()
    except OSError:
        return True  # it has ended
