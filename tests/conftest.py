"""What tests of several folders share."""

from __future__ import annotations

import gc
import os
import shutil
from collections.abc import Generator
from pathlib import Path

import pytest

# These take longest. They are begun first, so that no process is left with one of them while the others have nothing
# to do; those that mostly wait stand beside those that mostly compute.
FIRST = (
    *("study/test_study_run", "measure/test_gauges", "measure/test_dots", "face/test_life", "cli/test_cli"),
    *("imaging/test_warm", "cli/test_resume", "measure/test_edges", "imaging/test_in_time", "cli/test_signals"),
    *("imaging/test_hybrid", "imaging/test_certificate", "cli/test_bad_machine", "designing/test_design"),
    *("test_public", "face/test_ray_knobs", "test_architecture", "imaging/test_basis", "led/test_led_cli"),
    *("physics/test_extremes", "test_invariance", "led/test_ring", "measure/test_emva", "imaging/test_forecast"),
    *("face/test_coarse", "measure/test_parts", "imaging/test_wave_image", "face/test_measuring"),
    *("study/test_user_function", "imaging/test_synthesis", "face/test_ring", "study/test_sampled"),
    *("imaging/test_in_sight", "cli/test_relight", "cli/test_hostile_input", "fitting/test_from_afar"),
    *("physics/test_wide_sources", "cli/test_trade_cli", "cli/test_hostile_files", "fitting/test_series"),
    *("cli/test_determinism", "imaging/test_many_waves", "physics/test_aperture_field", "docs_site/test_lessons"),
    *("study/test_shared_dots", "study/test_crosscheck", "imaging/test_kernel", "face/test_photo"),
)


# Renders flush what they write, and a real disk makes them wait: tests write to the one in memory where that has room.
MEMORY = Path("/dev/shm")  # noqa: S108  (pytest makes a folder of the user's own in it)
LEAST_ROOM = 2 << 30  # byte; all tests together leave an eighth of it, less as what passed is removed


def pytest_configure() -> None:
    """Have pytest make its temporary folders in memory."""
    if os.access(MEMORY, os.W_OK) and shutil.disk_usage(MEMORY).free > LEAST_ROOM:
        os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", str(MEMORY))  # noqa: TID251  (pytest has no other way)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Look for no garbage while tests are collected, nor among them later: all of them stay until the end."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_unconfigure() -> None:
    """Leave nothing that libraries would take for a leak at the end."""
    gc.unfreeze()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the longest files first; the order within a file stays."""
    here = Path(__file__).parent
    place = {(here / f"{name}.py"): number for number, name in enumerate(FIRST)}
    items.sort(key=lambda item: place.get(item.path, len(FIRST)))
