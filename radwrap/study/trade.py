"""What each method and setting costs on one scene, and how far its gray levels are off.

Every setting is timed alone, with the scene laid out and its octree built;
images stay in memory. The time of kernel, hybrid and rays holds their certificate;
pinhole and viewpoints, which know no certificate of their own, go without.
Errors are taken against rays that no method used.
"""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.files import make_folder, sole_owner, write_bytes
from radwrap.imaging.demand import Budget, Demand, ToleranceMethod
from radwrap.imaging.forecast.cost import check_size
from radwrap.imaging.optics.aperture import LAYOUTS, Layout, Viewpoints, central_viewpoint, sub_viewpoints
from radwrap.imaging.optics.view import PixelPlan, PixelSampling, View, trace_rays
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.tolerance.lit_noise import with_gray_tolerance
from radwrap.imaging.tolerance.planner import render_to_tolerance
from radwrap.imaging.tolerance.plans import Plans
from radwrap.imaging.tolerance.replicates import Work
from radwrap.imaging.tolerance.survey import predicted_rays, survey, with_smooth_blocks
from radwrap.imaging.tracing import LaidOutScene
from radwrap.manifest import json_text, sha256_of_value, versions
from radwrap.process import Programs, available_cores, children_cpu_time
from radwrap.progress import Progress
from radwrap.random_streams import generator
from radwrap.reading import read_json
from radwrap.scene.instants import refuse_time
from radwrap.scene.scene import Scene
from radwrap.study.paper_method import summed_viewpoints
from radwrap.study.reference import (
    Distance,
    Reference,
    check_reference,
    distance,
    reference_as_json,
    reference_from_json,
    take_reference,
)

Family = Literal["pinhole", "viewpoints", "kernel", "hybrid", "rays"]

ROWS: Final = "settings"
_WORK: Final = ".work"
_REFERENCE: Final = "reference"
_NUMBERS: Final = (7, 19, 37, 61, 127, 217)
_TRIAL_NUMBER: Final = 37  # on which layouts and samplings are compared
_SMALL_NUMBERS: Final = (7, 19)  # where more rays a pixel may pay
_CERTIFIED: Final[tuple[ToleranceMethod, ...]] = ("kernel", "hybrid", "rays")
_SHARES: Final = (
    4.0,
    2.0,
    1.0,
    0.4,
    0.2,
)  # of the tolerance that is wanted, which kernel, hybrid and rays are asked for
# A method that misses its tolerance tries again; after so many times the rays that were expected, or the longest time,
# it has shown enough.
_PATIENCE: Final = 8
_TIMED_RAYS: Final = 1 << 15
_LONGEST_LIMITS: Final = (1e-3, 1e9)


@dataclass(frozen=True, slots=True)
class Setting:
    """A method with its options.

    Attributes
    ----------
    method : str
        "pinhole", "viewpoints", "kernel", "hybrid" or "rays".
    viewpoints : int, optional
        Number of sub-viewpoints.
    layout : str, optional
        How they lie.
    pixel_samples : int
        k; k x k rays a pixel and sub-viewpoint.
    pixel_sampling : str
        "centre" or "jitter".
    tolerance : float, optional
        Asked of kernel, hybrid or rays [gray level rms].
    """

    method: Family
    viewpoints: int | None = None
    layout: Layout | None = None
    pixel_samples: int = 1
    pixel_sampling: PixelSampling = "centre"
    tolerance: float | None = None

    @property
    def options(self) -> str:
        """The same as options of ``radwrap render``."""
        words = [f"--method {self.method}"]
        if self.tolerance is not None:
            return f"{words[0]} --tolerance {self.tolerance:g}"
        if self.viewpoints is not None:
            words.append(f"--viewpoints {self.viewpoints} --layout {self.layout}")
        if self.pixel_samples != 1:
            words.append(f"--pixel-samples {self.pixel_samples}")
        if self.pixel_sampling != "centre":
            words.append(f"--pixel-sampling {self.pixel_sampling}")
        return " ".join(words)

    @property
    def name(self) -> str:
        """The options as a file name."""
        words = self.options.removeprefix("--method ").replace("viewpoints --viewpoints", "viewpoints")
        return words.replace(" --", "_").replace(" ", "-")


@dataclass(frozen=True, slots=True)
class Row:
    """What a setting cost, and how good it was.

    Attributes
    ----------
    setting : Setting
        What was done.
    rays : int
        Rays in all.
    met : bool or None
        Whether kernel, hybrid or rays certified their tolerance.
    certified_rms_gray_upper95 : float or None
        What they certified [gray level].
    error : Distance
        From the reference [gray level].
    wall_s, cpu_s : float
        Wall time, and CPU time of this process and its tracers [s].
    """

    setting: Setting
    rays: int
    met: bool | None
    certified_rms_gray_upper95: float | None
    error: Distance
    wall_s: float
    cpu_s: float


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A setting that was not run, and why."""

    setting: Setting
    why: str


@dataclass(frozen=True, slots=True)
class TradeOptions:
    """How methods are compared.

    Attributes
    ----------
    longest : float
        A setting that is expected to take longer is left out [s].
    reference_pixels, reference_rays : int
        Pixels of the reference, and rays of each of its two values.
    render : RenderOptions
        Seed, workers, tracer, and the tolerance that is wanted; its method is not used.
    """

    longest: float = 60.0
    reference_pixels: int = 2000
    reference_rays: int = 1024
    render: RenderOptions = field(default_factory=RenderOptions)

    def __post_init__(self) -> None:
        low, high = _LONGEST_LIMITS
        if not low <= self.longest <= high:
            raise InputError(f"must lie between {low:g} and {high:g} s, not {self.longest:g}", where="longest")
        check_reference(self.reference_pixels, self.reference_rays)

    @property
    def workers(self) -> int:
        """Tracer processes at a time."""
        return self.render.workers or available_cores()


@dataclass(frozen=True, slots=True, eq=False)
class Trade:
    """All that was measured on a scene.

    Attributes
    ----------
    title : str
        Where the scene comes from.
    run_sha256 : str
        Of all that decides the numbers.
    options : TradeOptions
        How.
    tolerance : float
        What is wanted [gray level rms].
    reference : Reference
        What errors are taken against.
    rows : tuple of Row
        In the order of the sweep.
    left_out : tuple of LeftOut
        What was not run.
    """

    title: str
    run_sha256: str
    options: TradeOptions
    tolerance: float
    reference: Reference
    rows: tuple[Row, ...]
    left_out: tuple[LeftOut, ...]


def measure_trade(scene: Scene, out: Path, options: TradeOptions) -> Trade:
    """Sweep methods and settings on a scene; rows of an earlier, equal run that lie in the folder are used again.

    Parameters
    ----------
    scene : Scene
        What is there.
    out : Path
        Folder; each finished setting leaves a file in its folder `ROWS`.
    options : TradeOptions
        How.

    Raises
    ------
    InputError
        If scene or options are wrong.
    EnvironmentFailure
        If Radiance or the disk fails, or another run owns the folder.
    """
    refuse_time(scene, "a trade")
    check_size(scene, options.render.max_pixels, _TRIAL_NUMBER, options.workers)
    make_folder(out / ROWS)
    with sole_owner(out), Programs() as programs:
        work = out / _WORK
        shutil.rmtree(work, ignore_errors=True)
        make_folder(work)
        try:
            return _Sweep(scene, out / ROWS, work, options, programs).run()
        finally:
            shutil.rmtree(work, ignore_errors=True)


class _Sweep:
    """One sweep in its folder."""

    def __init__(self, scene: Scene, rows: Path, work: Path, options: TradeOptions, programs: Programs) -> None:
        self.scene, self.folder, self.work, self.options, self.programs = scene, rows, work, options, programs
        traced = LaidOutScene(scene, options.render, programs, work, exact_bands=True)
        self.view = traced.view()
        self.tolerance = with_gray_tolerance(options.render, self.view)[0].gray_tolerance
        self.traced_sha256 = traced.sha256()
        self.sha256 = sha256_of_value(
            {
                "traced": self.traced_sha256,
                "camera": scene.camera,
                "reference": [options.reference_pixels, options.reference_rays],
                "seed": options.render.seed,
                "versions": {**versions(), "radiance": traced.version},
            }
        )
        self.rows: list[Row] = []
        self.left_out: list[LeftOut] = []

    def run(self) -> Trade:
        self.reference = self._reference()
        self.seconds_per_ray = _seconds_per_ray(self.view)
        self.survey = survey(self.view, self.options.render.seed)
        self.progress = Progress(
            "settings", len(_NUMBERS) + len(_CERTIFIED) * len(_SHARES), shown=self.options.render.progress
        )
        try:
            self._pinhole()
            if not self.scene.camera.aperture.is_infinitesimal:
                self._viewpoints()
            for method in _CERTIFIED:
                if method == "hybrid" and self.scene.camera.aperture.is_infinitesimal:
                    continue  # nothing is left to correct
                self._all(Setting(method, tolerance=float(f"{share * self.tolerance:.3g}")) for share in _SHARES)
        finally:
            self.progress.close()
        title = "/".join(Path(self.scene.origin).parts[-2:])
        rows, left_out = tuple(self.rows), tuple(self.left_out)
        return Trade(title, self.sha256, self.options, self.tolerance, self.reference, rows, left_out)

    def _reference(self) -> Reference:
        options, known = self.options, self._read(_REFERENCE)
        if known is not None:
            return reference_from_json(known)
        progress = Progress(
            "reference", 2 * options.reference_rays * options.reference_pixels, shown=options.render.progress
        )
        try:
            reference = take_reference(
                self.view,
                pixels=options.reference_pixels,
                rays=options.reference_rays,
                seed=options.render.seed,
                progress=progress.add,
            )
        finally:
            progress.close()
        self._write(_REFERENCE, reference_as_json(reference))
        return reference

    def _pinhole(self) -> None:
        # Of an infinitesimal pinhole nothing but the pixel is left to sample.
        samples = (1, 2, 4, 8) if self.scene.camera.aperture.is_infinitesimal else (1,)
        self._all(Setting("pinhole", pixel_samples=k) for k in samples)

    def _viewpoints(self) -> None:
        """Find the best layout and sampling with one number of sub-viewpoints, take these for the others."""

        def setting(number: int, layout: Layout, sampling: PixelSampling, samples: int = 1) -> Setting:
            return Setting("viewpoints", number, layout, samples, sampling)

        trial = max((n for n in _NUMBERS if n <= _TRIAL_NUMBER and self._is_affordable(n)), default=_NUMBERS[0])
        found = self._all(setting(trial, layout, "centre") for layout in LAYOUTS)
        layout = _best(found).layout if found else LAYOUTS[0]
        assert layout is not None  # noqa: S101  (a setting of viewpoints has one)
        found = [row for row in found if row.setting.layout == layout]
        found += self._all([setting(trial, layout, "jitter")])
        sampling = _best(found).pixel_sampling if found else "centre"
        numbers = {number: self._layout_with(number, layout) for number in _NUMBERS}
        self._all(setting(number, fit, sampling) for number, fit in numbers.items() if number != trial)
        for way in ("centre", "jitter"):
            self._all(setting(number, numbers[number], way, 2) for number in _SMALL_NUMBERS)

    def _layout_with(self, number: int, layout: Layout) -> Layout:
        """The layout, or where it has no such number of points the one that has them all."""
        try:
            sub_viewpoints(self.scene.camera.aperture, number, layout)
        except InputError:
            return LAYOUTS[0]
        return layout

    def _is_affordable(self, rays_per_pixel: int) -> bool:
        rays = rays_per_pixel * self.scene.camera.sensor.pixels
        return rays * self.seconds_per_ray <= self.options.longest

    def _all(self, settings: Iterable[Setting]) -> list[Row]:
        """Rows of settings, as far as they are not left out."""
        rows = [row for setting in settings if (row := self._one(setting)) is not None]
        self.rows += rows
        return rows

    def _one(self, setting: Setting) -> Row | None:
        known = self._read(setting.name)
        row = None if known is None else _row_from_json(known)
        try:
            row = row or self._measured(setting)
        except InputError as error:  # such as a layout that has no such number of points
            self.left_out.append(LeftOut(setting, str(error)))
            return None
        if row is not None and known is None:
            self._write(setting.name, asdict(row))
        self.progress.add(1)
        return row

    def _measured(self, setting: Setting) -> Row | None:
        expected = self._expected_rays(setting)
        if not math.isfinite(expected):
            raise InputError("the scene is too deep for one central image")
        if expected * self.seconds_per_ray > self.options.longest:
            why = f"expected to take longer than {self.options.longest:g} s, by {expected:.3g} rays"
            self.left_out.append(LeftOut(setting, why))
            return None
        viewpoints = self._points(setting)
        start, cpu = time.monotonic(), time.process_time() + children_cpu_time()
        if setting.tolerance is None:
            plan = PixelPlan(setting.pixel_samples, setting.pixel_sampling, self.options.render.seed)
            radiance = summed_viewpoints(self.view, viewpoints, plan, self.programs)
            rays, met, certified = round(expected), None, None
        else:
            radiance, rays, met, certified = self._to_tolerance(setting, expected)
        wall, cpu = time.monotonic() - start, time.process_time() + children_cpu_time() - cpu
        seen = radiance.ravel()[self.reference.sample.pixels] * self.view.exposure_of_radiance
        error = distance(self.reference, gray_levels(seen, self.scene.camera.sensor))
        return Row(setting, rays, met, certified, error, wall, cpu)

    def _expected_rays(self, setting: Setting) -> float:
        if setting.tolerance is not None:
            view = with_smooth_blocks(self.view, self.survey, setting.tolerance, self.options.render.seed)
            if setting.method == "hybrid":
                return Plans(view, self.survey, Demand(setting.tolerance), self.options.render.seed).hybrid_rays()
            rays, kernel = predicted_rays(view, self.survey, setting.tolerance)
            return kernel if setting.method == "kernel" else rays
        return (setting.viewpoints or 1) * setting.pixel_samples**2 * self.scene.camera.sensor.pixels

    def _points(self, setting: Setting) -> Viewpoints:
        aperture = self.scene.camera.aperture
        if setting.viewpoints is None or setting.layout is None:
            return central_viewpoint(aperture)
        return sub_viewpoints(aperture, setting.viewpoints, setting.layout)

    def _to_tolerance(self, setting: Setting, expected: float) -> tuple[NDArray[np.float64], int, bool, float]:
        assert setting.tolerance is not None  # noqa: S101
        method = next(method for method in _CERTIFIED if method == setting.method)
        folder = self.work / setting.name
        make_folder(folder)
        quiet = Progress("", 1, shown=False)
        outcome = render_to_tolerance(
            Work(self.view, folder, self.programs, quiet, self.traced_sha256, self.options.render.seed),
            Demand(setting.tolerance, method=method, budget=Budget(rays=self._patience(expected))),
        )
        shutil.rmtree(folder, ignore_errors=True)
        return outcome.radiance, outcome.record.rays, outcome.met, outcome.certificate.rms_gray_upper95

    def _patience(self, expected: float) -> float:
        return min(_PATIENCE * expected, self.options.longest / self.seconds_per_ray)

    def _read(self, name: str) -> dict[str, Any] | None:
        """What an equal run left under a name; None where there is nothing of it."""
        try:
            found = read_json(self.folder / f"{name}.json")
            content: dict[str, Any] | None = found["content"] if found["run_sha256"] == self.sha256 else None
        except (InputError, KeyError, TypeError):
            return None
        return content

    def _write(self, name: str, content: dict[str, Any]) -> None:
        write_bytes(self.folder / f"{name}.json", json_text({"run_sha256": self.sha256, "content": content}).encode())


def _seconds_per_ray(view: View) -> float:
    """Wall time of a ray with all workers busy [s]."""
    sensor = view.camera.sensor
    u, v = generator(0).random((2, _TIMED_RAYS)) * [[sensor.columns], [sensor.rows]] - 0.5
    start = time.monotonic()
    trace_rays(view, None, u, v)
    return (time.monotonic() - start) / _TIMED_RAYS


def _best(rows: list[Row]) -> Setting:
    return min(rows, key=lambda row: row.error.rms_gray).setting


def _row_from_json(found: dict[str, Any]) -> Row:
    return Row(**{**found, "setting": Setting(**found["setting"]), "error": Distance(**found["error"])})
