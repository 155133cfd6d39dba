"""What tests of several folders share."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

# These take longest. They are begun first, so that no process is left with one of them while the others have nothing
# to do; those that mostly wait stand beside those that mostly compute.
FIRST = (
    *("study/test_study_run", "study/test_tolerate", "measure/test_dots", "cli/test_resume", "study/test_sampled"),
    *("imaging/test_certificate", "cli/test_signals", "imaging/test_synthesis", "cli/test_bad_machine"),
    *("test_invariance", "study/test_cluster", "led/test_led_cli", "imaging/test_basis", "led/test_ring"),
    *("replication/test_replication", "physics/test_extremes", "physics/test_edge_model", "physics/test_preview"),
    *("cli/test_cli", "cli/test_determinism", "tracers/test_bouncing", "physics/test_aperture_field"),
    *("calibrate/test_response", "measure/test_edges", "study/test_shared_dots", "cli/test_hostile_files"),
)


# Renders flush what they write, and a real disk makes them wait: tests write to the one in memory where that has room.
MEMORY = Path("/dev/shm")  # noqa: S108  (pytest makes a folder of the user's own in it)
LEAST_ROOM = 2 << 30  # byte; all tests together leave an eighth of it, less as what passed is removed


def pytest_configure() -> None:
    """Have pytest make its temporary folders in memory."""
    if os.access(MEMORY, os.W_OK) and shutil.disk_usage(MEMORY).free > LEAST_ROOM:
        os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", str(MEMORY))  # noqa: TID251  (pytest has no other way)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the longest files first; the order within a file stays."""
    here = Path(__file__).parent
    place = {(here / f"{name}.py"): number for number, name in enumerate(FIRST)}
    items.sort(key=lambda item: place.get(item.path, len(FIRST)))
