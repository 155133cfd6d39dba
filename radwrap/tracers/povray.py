"""POV-Ray 3.7 as a witness: one picture for each sub-viewpoint, read back as radiance along the rays asked for.

It cannot be asked for any ray. It traces whole pictures, so it answers rays
of one camera alone, those through the centres of its pixels' strata.
"""

from __future__ import annotations

import math
import re
import shutil
import threading
from collections.abc import Generator, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NoReturn

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import EnvironmentFailure, InputError, TracerError
from radwrap.files import disk_failure, make_folder, sha256_of
from radwrap.images import read_channel
from radwrap.process import Limits, Programs
from radwrap.scene.camera import Camera
from radwrap.tracers.povray_text import povray_camera
from radwrap.tracers.text_frame import TextFrame

Array = NDArray[np.float64]

_VERSION: Final = re.compile(r"POV-Ray (3\.7\.\S+)")
_REMEDY: Final = "apt install povray"
# Half floats hold 11 bits between 6e-5 and 65504. A picture whose peak lies between these limits holds everything
# down to a millionth of it; Scale is a power of two, so it changes no digit.
_PEAKS: Final = (1.0, 3e4)
_GOAL: Final = 256.0
_OVERFLOW: Final = 6.5e4
_TRIALS: Final = 6
_RAISED: Final = 2.0**20  # times brighter, where nothing at all was seen
# How far from the centre of its stratum a ray may lie [px]: rounding of its direction.
_CENTRED: Final = 1e-6
_LIMITS: Final = Limits()
# Lines of its long report that a user must know of.
_COMPLAINT: Final = re.compile(r"(?im)^.*\b(?:warning|error)\b.*$")
_HARMLESS: Final = re.compile(r"(?i)cannot open the user configuration file|0 warnings|warning_level|warning console")


@dataclass(frozen=True, slots=True)
class PovrayInstallation:
    """A POV-Ray that was asked for its version.

    Attributes
    ----------
    program : str
        Full path.
    version : str
        What it says.
    sha256 : str
        Of the program.
    """

    program: str
    version: str
    sha256: str


def find_povray(programs: Programs, named: str | None = None) -> PovrayInstallation:
    """Find POV-Ray 3.7: the named program, or the one on PATH.

    Raises
    ------
    EnvironmentFailure
        If there is none, or it is of another version.
    """
    place = shutil.which(named or "povray")
    if place is None:
        raise EnvironmentFailure(
            "no such program" if named else "POV-Ray is not installed",
            where=f"povray={named}" if named else "",
            remedy=f"{_REMEDY}, or name it with `povray`",
        )
    folder = Path(place).resolve().parent
    answer, said = programs.run(
        [str(Path(place).absolute()), "--version"], folder=folder, environment=_environment(folder)
    )
    match = _VERSION.search(answer.decode(errors="replace") + said)
    if match is None:
        told = next((line for line in (answer.decode(errors="replace") + said).splitlines() if "POV-Ray" in line), "")
        raise EnvironmentFailure(
            f"is not POV-Ray 3.7; it says {told.strip()[:80]!r}",
            where=place,
            remedy=f"{_REMEDY}, or name it with `povray`",
        )
    try:
        sha256 = sha256_of(Path(place))
    except OSError as error:
        raise EnvironmentFailure(f"cannot be read: {error.strerror}", where=place) from error
    return PovrayInstallation(str(Path(place).absolute()), match[1], sha256)


def _environment(folder: Path) -> dict[str, str]:
    return {"PATH": "/usr/bin:/bin", "HOME": str(folder), "LC_ALL": "C"}


@dataclass(slots=True)
class _Picture:
    """A picture on its way: made by the first who asks, kept until all its rays were answered."""

    guard: threading.Lock = field(default_factory=threading.Lock)
    values: Array | None = None
    due: int = 0


class PovrayTracer:
    """Satisfies `Tracer` for the rays of one camera.

    Parameters
    ----------
    installation : PovrayInstallation
        Which POV-Ray.
    programs : Programs
        Owner of the processes.
    folder : Path
        Working folder.
    text : str
        The scene, see `povray_scene`.
    frame : TextFrame
        Origin and unit of the text.
    camera : Camera
        Whose rays.
    samples : int
        k; each pixel has k x k rays, at the centres of its strata.
    expected_peak : float
        About what the brightest pixel holds [W m^-2 sr^-1]; a wrong one costs time, no digit.
    limits : Limits
        Time and memory of each picture.
    """

    def __init__(
        self,
        installation: PovrayInstallation,
        programs: Programs,
        folder: Path,
        text: str,
        *,
        frame: TextFrame,
        camera: Camera,
        samples: int = 1,
        expected_peak: float = 1.0,
        limits: Limits = _LIMITS,
    ) -> None:
        self._installation = installation
        self._programs = programs
        self._folder = folder
        self._text = text
        self._frame = frame
        self._camera = camera
        self._samples = samples
        self._scale = 2.0 ** round(math.log2(_GOAL / expected_peak))
        self._limits = limits
        self._guard = threading.Lock()
        self._pictures: dict[tuple[float, float], _Picture] = {}
        self._number = 0
        make_folder(folder)

    def trace(self, rays: Iterable[Array]) -> Generator[Array]:
        """Radiance along rays of the camera; see `Tracer.trace`.

        Raises
        ------
        ValueError
            If a ray does not go through the centre of a pixel's stratum.
        TracerError
            If POV-Ray fails, or its picture is not whole.
        """
        for block in rays:
            opening, places = self._places(block)
            yield self._answer(opening, places)

    def trace_with_distances(self, rays: Iterable[Array]) -> NoReturn:
        """POV-Ray does not give distances."""
        raise InputError("POV-Ray does not give distances", remedy="use sub-viewpoints")

    def distances(self, rays: Iterable[Array]) -> NoReturn:
        """POV-Ray does not give distances."""
        raise InputError("POV-Ray does not give distances", remedy="use sub-viewpoints")

    def _places(self, block: Array) -> tuple[tuple[float, float], NDArray[np.intp]]:
        """The opening's point that rays come from, and the place of each in the picture."""
        camera, k = self._camera, self._samples
        rotation = np.asarray(camera.pose.rotation)
        start = (block[:, :3] - np.asarray(camera.pose.position)) @ rotation
        if np.ptp(start, axis=0).max() > 1e-12:
            raise ValueError("rays of one block must come from one point of the opening")
        # Rounded: the same point for every block of a sub-viewpoint.
        opening = (round(float(start[0, 0]), 15), round(float(start[0, 1]), 15))
        local = block[:, 3:] @ rotation
        on_sensor = local[:, :2] * (camera.image_distance / local[:, 2:]) - camera.shear * np.asarray(opening)
        pitch = np.array([camera.sensor.pixel_width, camera.sensor.pixel_height])
        exact = (on_sensor / pitch + camera.principal_point + 0.5) * k - 0.5
        places = np.rint(exact)
        size = np.array([camera.sensor.columns, camera.sensor.rows]) * k
        if np.abs(exact - places).max() > _CENTRED * k or (places < 0).any() or (places >= size).any():
            raise ValueError("POV-Ray answers only rays through the centres of pixels' strata")
        return opening, (places[:, 1] * size[0] + places[:, 0]).astype(np.intp)

    def _answer(self, opening: tuple[float, float], places: NDArray[np.intp]) -> Array:
        with self._guard:
            picture = self._pictures.setdefault(opening, _Picture())
        with picture.guard:
            if picture.values is None:
                picture.values = self._render(opening).ravel()
                picture.due = len(picture.values)
            answer = picture.values[places]
            picture.due -= len(places)
            if picture.due <= 0:
                with self._guard:
                    self._pictures.pop(opening, None)
        return answer

    def _render(self, opening: tuple[float, float]) -> Array:
        """Radiance in each stratum, shape (rows k, columns k) [W m^-2 sr^-1]."""
        scale = self._scale
        for _ in range(_TRIALS):
            values = self._picture(opening, scale)
            peak = float(values.max())
            if peak == 0.0:
                if scale >= self._scale * _RAISED:
                    return values
                scale *= _RAISED
            elif _PEAKS[0] <= peak <= _PEAKS[1]:
                return values / scale
            elif peak >= _OVERFLOW:
                scale /= 2.0**16
            else:
                scale *= 2.0 ** round(math.log2(_GOAL / peak))
        raise TracerError("its values lie outside what a half float holds", where="povray")

    def _picture(self, opening: tuple[float, float], scale: float) -> Array:
        with self._guard:
            self._number += 1
            folder = self._folder / f"picture{self._number}"
        make_folder(folder)
        scene, out = folder / "view.pov", folder / "view.exr"
        camera = povray_camera(self._camera, opening, self._frame)
        try:
            scene.write_text(f"#version 3.7;\n#declare Scale = {scale!r};\n{self._text}\n{camera}", encoding="ascii")
        except OSError as error:
            raise disk_failure(scene, error) from error
        sensor, k = self._camera.sensor, self._samples
        size = [f"+W{sensor.columns * k}", f"+H{sensor.rows * k}"]
        quiet = ["-D", "-P", "-V", "-GA", "-GD", "-GR", "-GS", "+WT1", "-A", "-J"]
        _, said = self._programs.run(
            [self._installation.program, f"+I{scene.name}", f"+O{out.name}", "+FE", *size, *quiet],
            folder=folder,
            environment=_environment(folder),
            limits=self._limits,
        )
        complaints = [line.strip() for line in _COMPLAINT.findall(said) if not _HARMLESS.search(line)]
        if complaints:
            raise TracerError(complaints[0], where="povray")
        values = self._read(out)
        shutil.rmtree(folder, ignore_errors=True)
        return values

    def _read(self, path: Path) -> Array:
        if not path.is_file():
            raise TracerError("wrote no picture", where="povray")
        try:
            values = read_channel(path)
        except InputError as error:
            raise TracerError(f"its picture {error.what}", where="povray") from error
        sensor, k = self._camera.sensor, self._samples
        due = (sensor.rows * k, sensor.columns * k)
        if values.shape != due:
            raise TracerError(
                f"its picture has {values.shape[1]} x {values.shape[0]} pixels, not {due[1]} x {due[0]}", where="povray"
            )
        # Too much for a half float becomes its largest number or infinity, which asks for another scale.
        values = np.minimum(values, _OVERFLOW)
        if not np.isfinite(values).all() or values.min() < 0:
            raise TracerError("its picture holds NaN or negative values", where="povray")
        return values
