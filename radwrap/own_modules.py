"""Our own modules as programs beside this one."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from radwrap.process import Child, start_child


def start_module(name: str, *arguments: str, keep_open: Sequence[int] = ()) -> Child:
    """Start one of our modules as a helper program; arguments and errors as `start_child`."""
    # -P: no module of the folder it happens to work in.
    argv = [sys.executable, "-P", "-m", name, *arguments]
    return start_child(argv, folder=Path(tempfile.gettempdir()), environment=os.environ, keep_open=keep_open)
