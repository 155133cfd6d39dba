"""How far a captured frame may be off each gray level, as a file."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from radwrap.images import write_exr
from radwrap.imaging.output.image_files import read_exposure
from radwrap.imaging.output.traced_run import TracedRun
from radwrap.imaging.tolerance.uncertainty import UncertaintySummary, uncertainty
from radwrap.scene.tolerances import Tolerances

SIGMA: Final = "gray_sigma.exr"


def write_sigma(folder: Path | None, run: TracedRun) -> tuple[UncertaintySummary | None, list[str]]:
    """Write it where there is a folder, and the scene states tolerances or noise; what it holds, and its name."""
    camera, tolerances = run.scene.camera, run.scene.tolerances
    if folder is None or (tolerances is None and camera.sensor.linear is None):
        return None, []
    found = uncertainty(
        read_exposure(folder),
        camera,
        tolerances or Tolerances(),
        run.made.certificate.rms_gray,
        run.spread,
        magnification=run.magnification,
        blur_slope=run.blur_slope,
    )
    write_exr(folder / SIGMA, found.sigma.astype(np.float32), channel="gray_sigma")
    return found.summary(), [SIGMA]
