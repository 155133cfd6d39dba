"""Plain Mitsuba 3 on a case: whole processes of several lengths, held against its own converged image."""

from __future__ import annotations

import json
import os
import re
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import radwrap
from cell_bench.cases import Case
from cell_bench.measured import Measured, measured
from cell_bench.solving import solved
from cell_bench.translation import NotTranslated, translated
from radwrap.imaging.optics.view import central_weights
from radwrap.imaging.response.exposure import exposure_of_radiance
from radwrap.imaging.response.sensor import gray_levels
from radwrap.process import available_cores
from radwrap.scene.scene import Scene

VARIANT: Final = "llvm_ad_mono"
_PROCESS: Final = Path(__file__).with_name("mitsuba_process.py")
_TRIAL_SECONDS: Final = 120.0
_LLVM: Final = "DRJIT_LIBLLVM_PATH"

# A sphere under a lamp: what an LLVM that cannot run Mitsuba fails on.
_TRIAL: Final[dict[str, Any]] = {
    "type": "scene",
    "integrator": {"type": "direct"},
    "sensor": {
        "type": "thinlens",
        "fov": 20,
        "aperture_radius": 0.1,
        "focus_distance": 10.0,
        "to_world": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -10], [0, 0, 0, 1]],
        "film": {"type": "hdrfilm", "width": 8, "height": 8, "pixel_format": "luminance"},
    },
    "light": {"type": "spot", "to_world": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -9], [0, 0, 0, 1]]},
    "ball": {
        "type": "sphere",
        "bsdf": {
            "type": "blendbsdf",
            "weight": 0.5,
            "below": {"type": "diffuse"},
            "lobe": {"type": "roughconductor", "material": "none"},
        },
    },
}


@dataclass(frozen=True, slots=True)
class Mitsuba:
    """A Mitsuba that works here.

    Attributes
    ----------
    version, variant : str
        Of the package, and which of its builds.
    llvm : str or None
        Its LLVM; None where Dr.Jit finds one by itself.
    """

    version: str
    variant: str
    llvm: str | None

    @property
    def environment(self) -> dict[str, str]:
        """For its processes."""
        return {**os.environ, _LLVM: self.llvm} if self.llvm else dict(os.environ)

    def render(self, scene: Path, image: Path, samples: int, seed: int, limit: float) -> Measured:
        """One image, by a process of its own."""
        report = image.with_suffix(".json")
        words = [scene, image, report, samples, seed, self.variant]
        return measured([sys.executable, *map(str, [_PROCESS, *words])], limit, self.environment)


def llvm_libraries(folders: Sequence[Path]) -> list[Path]:
    """LLVM's shared libraries in folders, newest version first, each file once."""
    found: dict[Path, tuple[int, ...]] = {}
    for folder in folders:
        for path in folder.glob("libLLVM*.so*"):
            numbers = re.findall(r"\d+", path.name) or re.findall(r"\d+", path.resolve().name)
            file = path.resolve()
            if file.is_file():
                found[file] = max(found.get(file, ()), tuple(map(int, numbers)))
    return sorted(found, key=lambda path: found[path], reverse=True)


def find_mitsuba(variant: str = VARIANT) -> Mitsuba | str:
    """A Mitsuba that renders a trial scene here, with the newest LLVM that can; else why there is none."""
    try:
        there = version("mitsuba")
    except PackageNotFoundError:
        return 'Mitsuba is not installed: pip install "radwrap[bench]"'
    if os.environ.get(_LLVM) or not variant.startswith("llvm"):
        candidates: list[str | None] = [None]
    else:
        folders = [*Path("/usr/lib").glob("*-linux-gnu"), *Path("/usr/lib").glob("llvm-*/lib"), Path("/usr/lib64")]
        candidates = [*map(str, llvm_libraries(folders)), None]
    failures = []
    for llvm in candidates:
        mitsuba = Mitsuba(there, variant, llvm)
        with tempfile.TemporaryDirectory() as folder:
            scene = Path(folder) / "scene.json"
            scene.write_text(json.dumps(_TRIAL))
            failure = mitsuba.render(scene, Path(folder) / "image.npy", 1, 0, _TRIAL_SECONDS).failure
        if failure is None:
            return mitsuba
        failures.append(f"{Path(llvm).name if llvm else 'the LLVM that Dr.Jit finds'}: {failure}")
    return f"Mitsuba {there} does not run here; its LLVM is libllvm19 of apt, say ({'; '.join(failures)})"


def mitsuba_row(case: Case, mitsuba: Mitsuba, samples: Sequence[int], limit: float, picture: Path) -> dict[str, Any]:
    """Time and error of plain Mitsuba on a case.

    Parameters
    ----------
    case : Case
        What is rendered.
    mitsuba : Mitsuba
        By whom.
    samples : sequence of int
        Of each pixel in each run, rising; the last run is the converged image.
    limit : float
        For each process [s].
    picture : Path
        Takes the converged image's gray levels, as .npy.
    """
    row: dict[str, Any] = {"by": "mitsuba", "case": case.name, "megapixels": case.megapixels, **asdict(mitsuba)}
    scene = case.scene()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        try:
            described = translated(scene, folder, bounces=case.bounces)
        except NotTranslated as error:
            return {**row, "failure": f"not translated: {error}"}
        file = folder / "scene.json"
        file.write_text(json.dumps(described))

        def render(image: Path, count: int, seed: int) -> Measured:
            return mitsuba.render(file, image, count, seed, limit)

        # Compiles, and is not counted; radwrap's tracer is compiled before, too.
        first = render(folder / "warm.npy", samples[0], 0)
        if first.failure:
            return {**row, "failure": first.failure}
        return {**row, **_rows(scene, render, samples, folder, picture)}


def _rows(
    scene: Scene, render: Callable[[Path, int, int], Measured], samples: Sequence[int], folder: Path, picture: Path
) -> dict[str, Any]:
    runs: list[Measured] = []
    images: list[NDArray[np.float64]] = []
    for number, count in enumerate(samples):
        image = folder / f"{number}.npy"
        runs.append(render(image, count, 1 + 100_000 * number))
        if runs[-1].failure:
            return {"failure": f"{count} samples: {runs[-1].failure}"}
        images.append(gray_of(np.load(image), scene))
    converged = images.pop()
    rms = [float(np.sqrt(((image - converged) ** 2).mean())) for image in images]
    picture.parent.mkdir(parents=True, exist_ok=True)
    np.save(picture, converged.astype(np.float32))
    result: dict[str, Any] = {
        "samples": list(samples),
        "wall_s": [run.wall_s for run in runs],
        "cpu_s": [run.cpu_s for run in runs],
        "peak_memory_bytes": max(run.peak_memory for run in runs),
        "rms_to_converged_gray": rms,
        "mean_gray": float(converged.mean()),
        "cores": available_cores(),
    }
    try:
        speed = solved(samples[:-1], result["wall_s"], rms, samples[-1])
    except ValueError as error:
        return {**result, "failure": str(error), "retry": True}
    return {**result, "speed": asdict(speed)}


def gray_of(radiance: NDArray[np.float32], scene: radwrap.Scene) -> NDArray[np.float64]:
    """Gray levels, before rounding, of an image of radiance that has no falloff towards the corners."""
    v, u = np.divmod(np.arange(radiance.size, dtype=np.float64), radiance.shape[1])
    weights = central_weights(scene.camera, u, v).reshape(radiance.shape)
    return gray_levels(radiance * weights * exposure_of_radiance(scene.camera), scene.camera.sensor)
