"""Small studies: an edge in even light on 60 x 50 pixels, so that a run takes a fraction of a second."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, Final
from unittest.mock import patch

import pytest

from tests.cli.conftest import Done, scene_text, start

# An edge that does not run along the pixels; gamma 1 and no rounding, so that responses have closed forms.
EDGE: Final[dict[str, Any]] = {
    "camera": {
        "position": ["0 mm", "0 mm", "500 mm"],
        "look_at": ["0 mm", "0 mm", "0 mm"],
        "focal_length": "12.5 mm",
        "exposure_time": "100 ms",
        "aperture": {"diameter": "0.2 mm"},
        "diffraction": "off",  # it has its own tests
        "sensor": {
            "rows": 50,
            "columns": 60,
            "pixel_width": "50 um",
            "pixel_height": "50 um",
            "gain": "1e5 (J/m^2)^-1",
            "gamma": 1.0,
            "dark_gray": 20,
            "saturation_gray": 255,
            "rounding": False,
        },
    },
    "sources": [
        {
            "type": "ring",
            "name": "ring",
            "position": ["0 mm", "0 mm", "500 mm"],
            "look_at": ["0 mm", "0 mm", "0 mm"],
            "count": 3,
            "diameter": "40 mm",
            "radiance": "2000 kW/m^2/sr",
            "beam": {"profile": "gaussian", "width": "30 deg", "width_definition": "fwhm"},
        }
    ],
    "materials": {
        "black": {"type": "lambertian", "reflectance": 0.05},
        "white": {"type": "lambertian", "reflectance": 0.6},
    },
    "targets": [
        {
            "type": "edge",
            "name": "edge",
            "material": "black",
            "edge_material": "white",
            "size": ["400 mm", "400 mm"],
            "rotation": ["0 deg", "0 deg", "8 deg"],
            "edge_position": "1 mm",
        }
    ],
}

RESPONSES: Final = """
[responses.u]
measure = "edge_position"
dark = "sensor"
gamma = "sensor"

[responses.mean]
measure = "mean_gray"
"""

# A study starts processes that load everything anew: on a busy machine that alone takes a while [s].
PATIENCE: Final = 300.0


def command(*argv: object) -> Done:
    """The command, to its end."""
    begin = time.monotonic()
    with start(argv) as process:
        try:
            stdout, stderr = process.communicate(timeout=PATIENCE)
        except BaseException:
            process.kill()
            raise
    return Done(process.returncode, stdout or "", stderr or "", time.monotonic() - begin)


class OneThread:
    """A pool of one thread of this process: jobs are done as a worker does them, without its start.

    Two seconds of a study of a few small images are the start of its processes. What hangs on these is tested with
    them, in test_study_run and test_cluster.
    """

    workers = 1

    def __init__(self, workers: int) -> None:
        self._executor = ThreadPoolExecutor(self.workers)

    def submit(self, work: Callable[[Any], Any], job: Any) -> Future[Any]:
        return self._executor.submit(work, job)

    def is_broken(self, error: BaseException) -> bool:
        return False

    def rebuild(self) -> None:
        raise AssertionError("a thread does not break")

    def look(self) -> None:
        pass

    def close(self) -> None:
        self._executor.shutdown(cancel_futures=True)


@pytest.fixture(scope="module")
def one_process() -> Iterator[None]:
    """Studies of a module are done in this process."""
    with patch("radwrap.study.study.LocalPool", OneThread):
        yield


DesignWriter = Callable[[str], Path]


def write_design(folder: Path, text: str, responses: str = RESPONSES) -> Path:
    """Write the scene and a design; returns the design's path."""
    (folder / "scene.toml").write_text(scene_text(EDGE))
    path = folder / "design.toml"
    path.write_text(f'scene = "scene.toml"\n{text}\n{responses}')
    return path


@pytest.fixture
def design(tmp_path: Path) -> DesignWriter:
    """Write the scene and a design into a folder of the test's own; returns the design's path."""
    return partial(write_design, tmp_path)


# Two factors that move the edge and the light, one of them by draws; 4 runs.
SMALL: Final = """
analysis = "none"
seed = 5
[design]
kind = "full"
[factors.x]
label = "place of the edge"
key = "targets[0].edge_position"
levels = ["1 mm", "2 mm"]
[factors.s]
label = "scatter of the LEDs"
key = "sources[0].leds[*].beam_width_factor"
levels = { L = 1.0, H = { uniform = [0.9, 1.1] } }
"""

# Six times fewer pixels, and coarse cells: for what hangs on neither.
TINY: Final = """
set = { "camera.sensor.rows" = 20, "camera.sensor.columns" = 24 }
render.tolerance = 1.0
"""
TINY_SMALL: Final = TINY + SMALL
