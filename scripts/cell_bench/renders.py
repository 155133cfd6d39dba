"""`radwrap render` on a case: the whole command as a process, its forecast, and its error by other rays."""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from cell_bench.cases import Case
from cell_bench.measured import Measured, measured
from radwrap.images import read_image
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.tracing import laid_out
from radwrap.study.reference import Reference, distance, take_reference

COMMAND: Final = str(Path(sys.executable).parent / "radwrap")
_FORECAST_LIMIT: Final = 120.0  # s
_NOT_MET: Final = 3  # exit code: the image is there, beyond its tolerance
_SEED: Final = 20_260  # of the rays of the truth; renders take 0


@dataclass(slots=True)
class Truth:
    """Rays that no render used, taken when the first image asks for them.

    Attributes
    ----------
    case : Case
        Of what.
    pixels, rays : int
        Sampled pixels, and the rays of each of their two values.
    """

    case: Case
    pixels: int
    rays: int
    _reference: Reference | None = field(default=None, init=False)

    def of(self, exposure: np.ndarray[Any, Any]) -> dict[str, float]:
        """Error of an image by its radiant exposure."""
        if self._reference is None:
            self._reference = self._taken()
        scene = self.case.scene()
        gray = gray_levels(exposure.astype(np.float64).ravel()[self._reference.sample.pixels], scene.camera.sensor)
        found = distance(self._reference, gray)
        return {
            "true_rms_gray": found.rms_gray,
            "true_rms_gray_upper": found.rms_gray_upper,
            "truth_noise_rms_gray": self._reference.rms_gray,
        }

    def _taken(self) -> Reference:
        options = RenderOptions(bounces="all" if self.case.bounces else 0)
        with laid_out(self.case.scene(), options) as traced:
            view = traced.bouncing_view(None) if self.case.bounces else traced.view()
            return take_reference(view, pixels=self.pixels, rays=self.rays, seed=_SEED)


@dataclass(frozen=True, slots=True)
class Asked:
    """How a case is rendered.

    Attributes
    ----------
    case : Case
        What.
    tolerance : float
        rms error that is asked for [gray level].
    tracer : str
        Word of the command line.
    limit : float
        After which the command is ended [s].
    budget : float or None
        Time that the command may take by its own option [s].
    """

    case: Case
    tolerance: float
    tracer: str
    limit: float
    budget: float | None = None

    def command(self) -> list[str]:
        """The command line, without a folder."""
        settings = [
            text for key, value in self.case.overrides.items() for text in ("--set", f"{key}={json.dumps(value)}")
        ]
        more = ["--tracer", self.tracer, *(["--bounces", "all"] if self.case.bounces else [])]
        if self.budget is not None:
            more += ["--budget", f"{self.budget:g} s"]
        options = ["--tolerance", repr(self.tolerance), "--json", *more]
        return [COMMAND, "render", str(self.case.file), *settings, *options]


def render_row(
    asked: Asked, truth: Callable[[np.ndarray[Any, Any]], dict[str, float]], picture: Path
) -> dict[str, Any]:
    """A render: forecast, time, memory, certified and true error; the picture's file takes its gray levels."""
    row: dict[str, Any] = {
        "by": "radwrap",
        "case": asked.case.name,
        "megapixels": asked.case.megapixels,
        "tolerance": asked.tolerance,
        "tracer": asked.tracer,
        "limit_s": asked.limit,
        "budget_s": asked.budget,
        **_forecast(asked),
    }
    with tempfile.TemporaryDirectory() as out:
        done = measured([*asked.command(), "--out", out], asked.limit)
        row |= {"wall_s": done.wall_s, "cpu_s": done.cpu_s, "peak_memory_bytes": done.peak_memory}
        # A tolerance that was not met is a result here.
        if done.failure and done.code != _NOT_MET:
            return {**row, "failure": done.failure}
        row |= _made(done, Path(out), picture)
        row |= truth(read_image(Path(out) / "radiant_exposure.exr")[0])
    if row.get("forecast_wall_s"):
        row["forecast_over_actual"] = row["forecast_wall_s"] / row["manifest_wall_s"]
    return row


def _made(done: Measured, out: Path, picture: Path) -> dict[str, Any]:
    """What the manifest says; the picture is copied."""
    manifest = json.loads((out / "manifest.json").read_text())
    picture.parent.mkdir(parents=True, exist_ok=True)
    picture.write_bytes((out / "gray.png").read_bytes())
    return {
        "manifest_wall_s": manifest["timing"]["wall_s"],
        "certified_rms_gray": manifest["error"]["rms_gray_upper95"],
        "met": manifest["plan"]["met"],
        "rays": manifest["rays"],
        "method": manifest["method"],
        "traced_by": manifest["tracer"]["name"],
        "mean_gray": manifest["gray"]["mean"],
    }


def _forecast(asked: Asked) -> dict[str, Any]:
    """What `--dry-run` says of rays and time."""
    if asked.budget is not None:
        return {}
    with tempfile.TemporaryDirectory() as out:
        done = measured([*asked.command(), "--dry-run", "--out", out], _FORECAST_LIMIT)
    if done.failure:
        return {"forecast_failure": done.failure}
    said = json.loads(done.output)
    return {"forecast_rays": said["rays"], "forecast_wall_s": said["timing"]["wall_s"], "forecast_took_s": done.wall_s}
