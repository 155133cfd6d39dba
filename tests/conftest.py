"""What tests of several folders share."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
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


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the longest files first; the order within a file stays."""
    here = Path(__file__).parent
    place = {(here / f"{name}.py"): number for number, name in enumerate(FIRST)}
    items.sort(key=lambda item: place.get(item.path, len(FIRST)))


@pytest.fixture
def memory_path(tmp_path: Path) -> Iterator[Path]:
    """A folder in memory, where there is such a disk: thousands of files that are flushed take long on a real one."""
    memory = Path("/dev/shm")  # noqa: S108  (made by mkdtemp)
    if not os.access(memory, os.W_OK):
        yield tmp_path
        return
    with tempfile.TemporaryDirectory(prefix="radwrap-test-", dir=memory) as folder:
        yield Path(folder)
