"""One program drives a device at a time."""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
from pathlib import Path

from radwrap.errors import EnvironmentFailure


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
        user = os.getuid() if sys.platform != "win32" else 0
        name = f"radwrap-led-{user}-{hashlib.sha256(path.encode()).hexdigest()[:16]}.lock"
        self.descriptor = os.open(Path(tempfile.gettempdir()) / name, os.O_RDWR | os.O_CREAT, 0o600)
        if sys.platform != "win32":
            import fcntl

            try:
                fcntl.flock(self.descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                os.close(self.descriptor)
                raise EnvironmentFailure(
                    "another program drives this ring, or its guardian is turning it off",
                    where=path,
                    remedy="wait for it, or end it",
                ) from error

    def release(self) -> None:
        """Let the device go."""
        if self.descriptor >= 0:
            os.close(self.descriptor)
            self.descriptor = -1
