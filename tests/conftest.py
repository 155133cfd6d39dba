"""What tests of several folders share."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest


@pytest.fixture
def memory_path(tmp_path: Path) -> Iterator[Path]:
    """A folder in memory, where there is such a disk: thousands of files that are flushed take long on a real one."""
    memory = Path("/dev/shm")  # noqa: S108  (made by mkdtemp)
    if not os.access(memory, os.W_OK):
        yield tmp_path
        return
    with tempfile.TemporaryDirectory(prefix="radwrap-test-", dir=memory) as folder:
        yield Path(folder)
