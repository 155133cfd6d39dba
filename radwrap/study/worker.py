"""What a worker of a study does: make an image with one tracer at a time, and measure it.

Jobs and what comes back are plain values, so that a worker may be a process
here or on another machine that sees the study's folder under the same name.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import (
    INTERRUPTED,
    EnvironmentFailure,
    FolderTaken,
    InputError,
    RadwrapError,
    TracerError,
    one_line,
)
from radwrap.files import make_folder
from radwrap.images import GrayImage, write_png
from radwrap.imaging.output.folder import is_whole
from radwrap.imaging.relight.relit import Relit, read_basis, relit
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.rendered import Rendered, load_result
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.synthesis import render
from radwrap.imaging.tolerance.kept_replicates import REPLICATES, read_replicates
from radwrap.lost_interrupts import interrupt_again
from radwrap.manifest import SCHEMA_VERSION, plain
from radwrap.measure.mosaic import RawChannel
from radwrap.scene.colour_planes import refuse_mosaic
from radwrap.scene.file.load import scene_from_document
from radwrap.scene.scene import Scene
from radwrap.study.image_error import COPIES, ErrorFields, blur_radii, error_fields, image_error, model_error
from radwrap.study.light import factors
from radwrap.study.pilots import write_pilot
from radwrap.study.responses import Response, answer
from radwrap.study.seen import Answer, Seen

STARTED: Final = "started.log"
THUMBNAILS: Final = "thumbnails"
_THUMBNAIL: Final = 96  # px wide
_PATIENCE: Final = 1.0  # s between looks at what another one renders


@dataclass(frozen=True, slots=True)
class Measured:
    """What is read from an image for one run: its number, and its responses."""

    run: int
    responses: tuple[Response, ...]
    levels: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Job:
    """A piece of a study.

    Attributes
    ----------
    name : str
        Unique in the study.
    study : str
        The study's folder.
    image : str
        Folder below it for the image or the light basis.
    document, origin, folder
        The scene: its tables, its file's name, and where it lies.
    options : RenderOptions
        How; with one worker.
    runs : tuple of Measured
        What to measure; none where a basis is made.
    pilot : bool
        Whether it only finds out what sampling the image needs, into a file in place of the folder.
    home : str
        Folder of the design, below which the user's functions lie.
    reference : Mapping
        Where the images come from a light basis: emitter -> level that the basis was rendered with.
    channel : RawChannel, optional
        Colour of a colour camera's raw image that is measured; the document has its filter on all pixels.
    in_time : bool
        Whether the scene changes in the course of its exposure: its image then has instants and a sampling of its own.
    """

    name: str
    study: str
    image: str
    document: Mapping[str, Any]
    origin: str
    folder: str
    options: RenderOptions
    runs: tuple[Measured, ...]
    reference: Mapping[str, float] | None = None
    pilot: bool = False
    home: str = ""
    channel: RawChannel | None = None
    in_time: bool = False


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a run came to.

    Attributes
    ----------
    run : int
    answers : Mapping of str to Answer
        Response -> value and error, as far as it was found.
    image_error : float or None
        Certified bound of the image's rms error [gray level].
    met : bool
        Whether the image keeps the tolerance asked for.
    error : str
        Why something is missing; empty where nothing is.
    wall_s : float
        How long it took [s].
    warnings : str
        What gauges warn of; empty where of nothing.
    """

    run: int
    answers: Mapping[str, Answer]
    image_error: float | None
    met: bool
    error: str
    wall_s: float
    warnings: str = ""


def carry_out(job: Job) -> list[Outcome]:
    """Do a job; what goes wrong with a run is its outcome.

    Raises
    ------
    EnvironmentFailure
        If no run could be done here: no Radiance, no disk.
    """
    from threadpoolctl import threadpool_limits

    # Workers share the cores already; threads of linear algebra on top of them only wait for each other.
    with ended_by_signal(), threadpool_limits(1):
        start = time.monotonic()
        try:
            _log(job)
            return list(_outcomes(job, start))
        except (InputError, TracerError) as error:
            return [failed(run.run, str(error), time.monotonic() - start) for run in job.runs] or _raise(error)
        except OSError as error:
            raise EnvironmentFailure(error.strerror or str(error), where=str(error.filename or job.study)) from error
        except MemoryError as error:
            raise EnvironmentFailure("not enough memory", where=job.name, remedy="use fewer `workers`") from error


def _raise(error: RadwrapError) -> list[Outcome]:
    raise error


def failed(run: int, why: str, wall_s: float = 0.0) -> Outcome:
    """The outcome of a run that has none."""
    return Outcome(run, {}, None, False, one_line(why), wall_s)


@contextmanager
def ended_by_signal() -> Iterator[None]:
    """SIGTERM ends the tracers first, then this process; a thread of somebody else's process cannot know of it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    hook, sys.unraisablehook = sys.unraisablehook, _lost
    before = signal.signal(signal.SIGTERM, _interrupt)
    try:
        yield
    except KeyboardInterrupt:
        os._exit(INTERRUPTED)
    finally:
        signal.signal(signal.SIGTERM, before)
        sys.unraisablehook = hook


def _interrupt(*_: object) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise KeyboardInterrupt


def _lost(lost: sys.UnraisableHookArgs) -> None:
    """An error where Python cannot raise one; an interrupt must not be lost there."""
    if lost.exc_type is not KeyboardInterrupt:
        sys.__unraisablehook__(lost)
        return
    signal.signal(signal.SIGTERM, _interrupt)
    interrupt_again(signal.SIGTERM)


def _log(job: Job) -> None:
    """One line for each run that begins, in one write, so that lines of many workers do not mix."""
    words = [f"{job.name} {run.run} {os.getpid()}" for run in job.runs] or [f"{job.name} 0 {os.getpid()}"]
    descriptor = os.open(Path(job.study) / STARTED, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
    try:
        os.write(descriptor, ("\n".join(words) + "\n").encode())
    finally:
        os.close(descriptor)


def _outcomes(job: Job, start: float) -> Iterator[Outcome]:
    scene = scene_from_document(job.document, origin=job.origin, folder=Path(job.folder))
    refuse_mosaic(scene, "a study")
    out = Path(job.study) / job.image
    if job.pilot:
        write_pilot(out, scene, job.options)
        return
    if job.reference is not None:
        yield from _relit(job, scene, out, start)
        return
    result = _made(job, scene, out)
    if not job.runs:
        return
    seen = seen_of(scene, result, out, _fields(job, scene, blur_radii(scene)))
    seen = replace(seen, told={**_lasting(result.manifest)}, **_known(job)).as_raw(job.channel)
    for run in job.runs:
        yield _outcome(job, run, seen, met=result.run.met, wall_s=time.monotonic() - start)


def _made(job: Job, scene: Scene, out: Path) -> Rendered:
    """Render, or read, if that is not due; an interrupted study may still be at it elsewhere, and is waited for.

    Its errors are those of this job; the folder is left as far as it came, and goes on there another time.
    """
    while not is_whole(out):  # of whatever run: the folder's name says of what
        try:
            return render(scene, out, job.options)
        except FolderTaken:
            time.sleep(_PATIENCE)
    return load_result(scene, out)


def seen_of(scene: Scene, result: Rendered, out: Path, fields: ErrorFields) -> Seen:
    """What is measured of an image that lies in a folder."""
    gray = gray_levels(result.radiant_exposure.values, scene.camera.sensor)
    error, radii = result.run.error, blur_radii(scene)
    seen = Seen(scene, result.gray, gray, image_error(gray, error.rms_gray_upper95, radii), fields)
    seen = replace(seen, exposure=result.radiant_exposure.values)
    if REPLICATES not in result.run.files:
        return seen
    kept = read_replicates(out, scene.camera.sensor.rows)
    model = model_error(gray, error.model_rms_gray, error.discretisation_rms_gray, radii)
    return replace(seen, replicates=kept, model=model)


def seen_of_relit(scene: Scene, image: Relit, fields: ErrorFields) -> Seen:
    """What is measured of an image that a light basis gives for some levels, in the scene's camera."""
    gray = gray_levels(image.radiant_exposure.values, scene.camera.sensor)
    certificate, radii = image.certificate, blur_radii(scene)
    seen = Seen(scene, image.gray, gray, image_error(gray, certificate.rms_gray_upper95, radii), fields)
    seen = replace(seen, exposure=image.radiant_exposure.values)
    if image.replicates is None:
        return seen
    model = model_error(gray, certificate.model_rms_gray, certificate.discretisation_rms_gray, radii)
    return replace(seen, replicates=image.replicates, model=model)


def _known(job: Job) -> dict[str, Any]:
    """What decides frames and users' functions, besides the image."""
    return {"seed": job.options.seed, "home": Path(job.home or job.folder)}


def _lasting(manifest: Mapping[str, Any]) -> Mapping[str, Any]:
    """A manifest without what differs between equal runs."""
    return {key: value for key, value in manifest.items() if key != "timing"}


def _relit(job: Job, scene: Scene, out: Path, start: float) -> Iterator[Outcome]:
    assert job.reference is not None  # noqa: S101  (asked before)
    basis = read_basis(out)
    levels = [factors(run.levels, job.reference, basis.sources) for run in job.runs]
    fields = _fields(job, scene, blur_radii(scene))
    for run, shares, image in zip(job.runs, levels, relit(basis, levels), strict=True):
        told = {
            "schema_version": SCHEMA_VERSION,
            "scene_sha256": basis.scene_sha256,
            "levels": dict(zip(basis.sources, map(float, shares), strict=True)),
            "error": plain(image.certificate, named=False),
        }
        seen = replace(seen_of_relit(scene, image, fields), told=told, **_known(job)).as_raw(job.channel)
        yield _outcome(job, run, seen, met=image.keeps(basis), wall_s=time.monotonic() - start)
        start = time.monotonic()


def _fields(job: Job, scene: Scene, radii: tuple[float, float]) -> ErrorFields:
    """Error fields for the scene's images; none where no response needs them."""
    needed = job.options.sampling is not None or any(response.copies for run in job.runs for response in run.responses)
    sensor = scene.camera.sensor
    return error_fields((sensor.rows, sensor.columns), radii, COPIES if needed else 0)


def _outcome(job: Job, run: Measured, seen: Seen, *, met: bool, wall_s: float) -> Outcome:
    start = time.monotonic()
    answers: dict[str, Answer] = {}
    errors = []
    for response in run.responses:
        try:
            answers[response.name] = answer(response, seen)
        except InputError as error:
            errors.append(f"{response.name}: {error}")
        except (ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
            errors.append(f"{response.name}: {type(error).__name__}: {error}")
    write_thumbnail(Path(job.study), run.run, seen.image)
    told = one_line("; ".join(errors))
    warned = [f"{name}: {text}" for name, found in answers.items() for text in found.warnings]
    wall_s += time.monotonic() - start
    return Outcome(run.run, answers, seen.error.rms, met, told, wall_s, one_line("; ".join(warned)))


def thumbnail_path(study: Path, run: int) -> Path:
    """Where the small picture of a run lies."""
    return study / THUMBNAILS / f"{run:06d}.png"


def write_thumbnail(study: Path, run: int, image: GrayImage) -> None:
    """Write a small picture of an image: means of blocks of pixels, 8 bits."""
    path = thumbnail_path(study, run)
    make_folder(path.parent)
    values = image.values * (255.0 / (2**image.bit_depth - 1))
    write_png(path, np.rint(_reduced(values, max(1, -(-values.shape[1] // _THUMBNAIL)))).astype(np.uint8))


def _reduced(values: NDArray[np.float64], step: int) -> NDArray[np.float64]:
    rows, columns = (max(step, size // step * step) for size in values.shape)
    if min(values.shape) < step:
        return values
    cut = values[:rows, :columns].reshape(rows // step, step, columns // step, step)
    small: NDArray[np.float64] = cut.mean(axis=(1, 3))
    return small
