"""Small designs: an edge in even light on 60 x 50 pixels, or a sheet in the light of three LEDs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any, Final
from unittest.mock import patch

import numpy as np
import pytest
from numpy.typing import NDArray

from radwrap.imaging.relight.relit import Basis
from radwrap.scene.scene import Scene
from tests.cli.conftest import scene_text
from tests.study.conftest import EDGE, OneThread

Write = Callable[[str], Path]

COMMENT: Final = "# The bench, as it stands in the laboratory.\n"


def sheet() -> dict[str, Any]:
    """A white sheet in the light of three LEDs, so that it is not even."""
    bench = deepcopy(EDGE)
    bench["camera"]["sensor"] |= {"rows": 20, "columns": 24, "pixel_width": "100 um", "pixel_height": "100 um"}
    bench["sources"][0] |= {
        "position": ["10 mm", "5 mm", "120 mm"],
        "look_at": ["10 mm", "5 mm", "0 mm"],
        "diameter": "60 mm",
        "radiance": "300 kW/m^2/sr",
    }
    bench["targets"] = [{"type": "sheet", "name": "sheet", "material": "white", "size": ["400 mm", "400 mm"]}]
    return bench


def write_problem(folder: Path, text: str, scene: dict[str, Any] = EDGE) -> Path:
    """Write a scene and a design beside it."""
    (folder / "scene.toml").write_text(COMMENT + scene_text(scene))
    path = folder / "design.toml"
    path.write_text(f'scene = "scene.toml"\n{text}')
    return path


def basis_of(light: NDArray[np.float64], scene: Scene) -> Basis:
    """A light basis that no ray has made: of each LED of a ring its light [gray level above dark], for a gamma of 1."""
    none = np.zeros((len(light), 2, 0), dtype=np.float32)
    return Basis(
        sources=tuple(f"ring.led{k:02d}" for k in range(len(light))),
        dark=(),
        images=np.repeat(light[:, np.newaxis].astype(np.float32), 2, axis=1),
        grid_pixels=np.zeros(0, dtype=np.intp),
        grid=none,
        sample=None,
        lacks=none,
        model_rays=0,
        block=(1, 1),
        exposure_of_radiance=1e-5,
        camera=scene.camera,
        tolerance=1.0,
        max_error=None,
        scene_sha256="",
        tolerances=None,
        magnification=None,
    )


@pytest.fixture
def design_file(tmp_path: Path) -> Write:
    """A function that writes a design beside the edge."""
    return lambda text: write_problem(tmp_path, text)


@pytest.fixture
def one_thread() -> Iterator[None]:
    """Designs are carried out in this process."""
    with patch("radwrap.study.study.LocalPool", OneThread):
        yield
