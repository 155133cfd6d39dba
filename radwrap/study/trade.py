"""What each method and setting costs on one scene, and how far its gray levels are off.

Of a scene of one instant and one colour every setting is timed alone, with the scene laid out and its octree built;
images stay in memory. The time of kernel, hybrid and rays holds their certificate;
pinhole and viewpoints, which know no certificate of their own, go without.
Of a scene that changes in the course of its exposure, and of a colour camera, each setting is a render.
Errors are taken against rays that no method used.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Final, Protocol

from radwrap.errors import InputError
from radwrap.files import make_folder, sole_owner
from radwrap.imaging.forecast.cost import check_size
from radwrap.imaging.in_time.making import refuse_for_time
from radwrap.imaging.optics.aperture import LAYOUTS, Layout, sub_viewpoints
from radwrap.imaging.optics.view import PixelSampling
from radwrap.imaging.render_options import RenderOptions
from radwrap.process import Programs
from radwrap.progress import Progress, Progressed
from radwrap.scene.instants import keys_of_time
from radwrap.scene.scene import Scene
from radwrap.study.laid_out_bench import LaidOutBench
from radwrap.study.reference import Reference, reference_as_json, reference_from_json
from radwrap.study.rendered_bench import RenderedBench
from radwrap.study.trade_rows import (
    CERTIFIED,
    LeftOut,
    Row,
    RowFiles,
    Setting,
    TooLong,
    Trade,
    TradeOptions,
    row_from_json,
)
from radwrap.watched import watched

ROWS: Final = "settings"
_WORK: Final = ".work"
_REFERENCE: Final = "reference"
_NUMBERS: Final = (7, 19, 37, 61, 127, 217)
_TRIAL_NUMBER: Final = 37  # on which layouts and samplings are compared
_SMALL_NUMBERS: Final = (7, 19)  # where more rays a pixel may pay
_SHARES: Final = (
    4.0,
    2.0,
    1.0,
    0.4,
    0.2,
)  # of the tolerance that is wanted, which kernel, hybrid and rays are asked for


class Bench(Protocol):
    """On what settings are measured.

    Attributes
    ----------
    tolerance : float
        What is wanted [gray level rms].
    sha256 : str
        Of all that decides the numbers.
    takes_fixed : bool
        Whether methods with a fixed number of rays render the scene.
    """

    tolerance: float
    sha256: str
    takes_fixed: bool

    def take_reference(self, progress: Callable[[int], None]) -> Reference:
        """What errors are taken against."""

    def get_ready(self) -> None:
        """Look at the scene as much as forecasts need."""

    def is_affordable(self, rays_per_pixel: int) -> bool:
        """Whether so many rays take no longer than a setting may."""

    def measured(self, setting: Setting, reference: Reference) -> Row:
        """What a setting costs, and how good it is; `InputError` and `TooLong` where it is to be left out."""


def measure_trade(
    scene: Scene,
    out: Path,
    options: TradeOptions,
    *,
    cancelled: Callable[[], bool] | None = None,
    told: Callable[[str, Progressed], object] | None = None,
) -> Trade:
    """Sweep methods and settings on a scene; rows of an earlier, equal run that lie in the folder are used again.

    Parameters
    ----------
    scene : Scene
        What is there.
    out : Path
        Folder; each finished setting leaves a file in its folder `ROWS`.
    options : TradeOptions
        How.
    cancelled : callable, optional
        Whether it is to end, asked some twenty times a second; what is finished stays in the folder.
    told : callable, optional
        Is told "reference" or "settings", and how much of it is done.

    Raises
    ------
    InputError
        If scene or options are wrong.
    EnvironmentFailure
        If Radiance or the disk fails, or another run owns the folder.
    Cancelled
        If it was to end.
    """
    refuse_for_time(replace(scene, tolerances=None), RenderOptions())
    check_size(scene, options.render.max_pixels, _TRIAL_NUMBER, options.workers)
    make_folder(out / ROWS)
    with sole_owner(out), Programs() as programs:
        work = out / _WORK
        shutil.rmtree(work, ignore_errors=True)
        make_folder(work)
        try:
            composed = bool(keys_of_time(scene)) or scene.camera.sensor.mosaic is not None
            kind = RenderedBench if composed else LaidOutBench
            progress = Progress(_REFERENCE, 1, shown=options.render.progress)

            def sweep() -> Trade:
                return _Sweep(scene, out / ROWS, options, kind(scene, work, options, programs), progress).run()

            if cancelled is None and told is None:
                return sweep()
            tell = None if told is None else lambda state: told(progress.what, state)
            return watched(sweep, programs, progress, cancelled, tell)
        finally:
            shutil.rmtree(work, ignore_errors=True)


class _Sweep:
    """One sweep in its folder."""

    def __init__(self, scene: Scene, rows: Path, options: TradeOptions, bench: Bench, progress: Progress) -> None:
        self.scene, self.options, self.bench, self.progress = scene, options, bench, progress
        self.files = RowFiles(rows, bench.sha256)
        self.rows: list[Row] = []
        self.left_out: list[LeftOut] = []

    def run(self) -> Trade:
        self.reference = self._reference()
        self.bench.get_ready()
        self.progress.restart(ROWS)
        self.progress.expect(len(_NUMBERS) + len(CERTIFIED) * len(_SHARES))
        infinitesimal = self.scene.camera.aperture.is_infinitesimal
        try:
            if self.bench.takes_fixed:
                self._pinhole()
                if not infinitesimal:
                    self._viewpoints()
            for method in CERTIFIED:
                if method == "hybrid" and infinitesimal:
                    continue  # nothing is left to correct
                tolerances = [float(f"{share * self.bench.tolerance:.3g}") for share in _SHARES]
                self._all(Setting(method, tolerance=tolerance) for tolerance in tolerances)
        finally:
            self.progress.close()
        title = "/".join(Path(self.scene.origin).parts[-2:])
        rows, left_out = tuple(self.rows), tuple(self.left_out)
        return Trade(title, self.bench.sha256, self.options, self.bench.tolerance, self.reference, rows, left_out)

    def _reference(self) -> Reference:
        options, known = self.options, self.files.read(_REFERENCE)
        if known is not None:
            return reference_from_json(known)
        self.progress.expect(2 * options.reference_rays * options.reference_pixels)
        try:
            reference = self.bench.take_reference(self.progress.add)
        finally:
            self.progress.close()
        self.files.write(_REFERENCE, reference_as_json(reference))
        return reference

    def _pinhole(self) -> None:
        # Of an infinitesimal pinhole nothing but the pixel is left to sample.
        samples = (1, 2, 4, 8) if self.scene.camera.aperture.is_infinitesimal else (1,)
        self._all(Setting("pinhole", pixel_samples=k) for k in samples)

    def _viewpoints(self) -> None:
        """Find the best layout and sampling with one number of sub-viewpoints, take these for the others."""

        def setting(number: int, layout: Layout, sampling: PixelSampling, samples: int = 1) -> Setting:
            return Setting("viewpoints", number, layout, samples, sampling)

        trial = max((n for n in _NUMBERS if n <= _TRIAL_NUMBER and self.bench.is_affordable(n)), default=_NUMBERS[0])
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

    def _all(self, settings: Iterable[Setting]) -> list[Row]:
        """Rows of settings, as far as they are not left out."""
        rows = [row for setting in settings if (row := self._one(setting)) is not None]
        self.rows += rows
        return rows

    def _one(self, setting: Setting) -> Row | None:
        known = self.files.read(setting.name)
        try:
            row = self.bench.measured(setting, self.reference) if known is None else row_from_json(known)
        except (InputError, TooLong) as error:  # such as a layout that has no such number of points
            self.left_out.append(LeftOut(setting, str(error)))
            return None
        if known is None:
            self.files.write(setting.name, asdict(row))
        self.progress.add(1)
        return row


def _best(rows: list[Row]) -> Setting:
    return min(rows, key=lambda row: row.error.rms_gray).setting
