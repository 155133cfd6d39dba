"""A photo that the page's user has uploaded: decoded beside the server, kept in its memory, compared with pictures.

It is written nowhere, and given to nobody but the page that sent it.
"""

from __future__ import annotations

import json
import math
import os
import tempfile
import threading
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import EnvironmentFailure, InputError, TracerError
from radwrap.face.decoder import LARGEST, MEMORY, NONE_OF_THEM, SECONDS, kind_of
from radwrap.face.traced import Image
from radwrap.images import GrayImage
from radwrap.imaging.response.sensor import gray_levels
from radwrap.own_modules import run_module
from radwrap.process import Limits, Programs
from radwrap.scene.camera import Sensor

_CLOCK: Final = 3.0 * SECONDS  # s: what takes the processor as long as it may takes longer on a busy machine
LIMITS: Final = Limits(silence=_CLOCK, total=_CLOCK, memory=MEMORY)
WHERE: Final = "photo"
# Rms over what is expected, up to which no cause is looked for: mere scatter may have one too.
TELLING: Final = 1.2
BEYOND: Final = 1.96  # standard deviations, that one in twenty pixels exceeds by chance
_KEPT: Final = 2  # photos
_EIGHT: Final = 8


@dataclass(frozen=True, slots=True, eq=False)
class Photo:
    """A photo as the camera gave it.

    Attributes
    ----------
    number : int
        By which the page names it.
    values : ndarray of float32, shape (rows, columns)
        Gray levels.
    bit_depth : int
        Of the camera.
    notes : tuple of str
        What its user should know.
    """

    number: int
    values: NDArray[np.float32]
    bit_depth: int
    notes: tuple[str, ...]


class Photos:
    """The photos that were uploaded last.

    Parameters
    ----------
    work : Path
        A folder of the server's own, for names of memory.
    """

    def __init__(self, work: Path) -> None:
        self._work = work
        self._kept: OrderedDict[int, Photo] = OrderedDict()
        self._number = 0
        self._guard = threading.Lock()

    def take(self, content: bytes | memoryview, sensor: Sensor) -> Photo:
        """Decode a photo, and keep it in place of the oldest.

        Parameters
        ----------
        content : bytes
            Of its file.
        sensor : Sensor
            That it is to be compared with.

        Raises
        ------
        InputError
            If it is no photo of such a sensor.
        """
        told, values = decoded(content, sensor.rows, sensor.columns, self._work)
        notes = as_the_camera_has_it(values, int(told["bit_depth"]), sensor.bit_depth, whole=bool(told["whole"]))
        if told["kind"] == "jpg":
            notes = ("JPEG does not keep gray levels as they were: some of the difference is its own", *notes)
        with self._guard:
            self._number += 1
            photo = Photo(self._number, values, sensor.bit_depth, notes)
            self._kept[photo.number] = photo
            while len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        return photo

    def kept(self, number: Any) -> Photo:
        """A photo by its number.

        Raises
        ------
        InputError
            If it is not kept any more.
        """
        with self._guard:
            found = self._kept.get(number) if type(number) is int else None
            if found is None:
                raise InputError("is not kept any more", where=WHERE, remedy="open it again")
            self._kept.move_to_end(found.number)
            return found


def decoded(
    content: bytes | memoryview, rows: int, columns: int, work: Path
) -> tuple[Mapping[str, Any], NDArray[np.float32]]:
    """Gray levels of a photo, decoded by a process of its own with limits.

    Returns
    -------
    Mapping
        ``bit_depth`` of the file, ``whole``: whether it holds whole numbers, ``kind``.
    ndarray, shape (rows, columns)
        Gray levels.

    Raises
    ------
    InputError
        If it is none of the kinds that are read, has other pixels, is in colour or not whole, or exceeds a limit.
    EnvironmentFailure
        If this is not Linux.
    """
    if not hasattr(os, "memfd_create"):
        raise EnvironmentFailure("photos are read on Linux only, where a process can be limited", where=WHERE)
    if len(content) > LARGEST:
        raise InputError(f"has more than {LARGEST >> 20} MiB", where=WHERE)
    if kind_of(bytes(content[:16])) is None:
        raise InputError(NONE_OF_THEM, where=WHERE, remedy="save it as one of them")
    # Each arena and each thread of a library takes address space, of which there is a limit.
    environment = {**os.environ, "MALLOC_ARENA_MAX": "2", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    try:
        # One that is killed leaves the link.
        with tempfile.TemporaryDirectory(dir=work) as folder, Programs() as programs:
            answer = run_module(
                programs,
                "radwrap.face.decoder",
                str(columns),
                str(rows),
                folder,
                stdin=content,
                limits=LIMITS,
                environment=environment,
                most=(1 << 16) + 4 * rows * columns,
            )
    except (TracerError, EnvironmentFailure) as error:
        what = f"cannot be decoded within {SECONDS} s and {MEMORY >> 30} GiB of memory"
        raise InputError(what, where=WHERE, remedy="save it anew, as PNG") from error
    head, _, octets = answer.partition(b"\n")
    told = json.loads(head)
    if "error" in told:
        raise InputError(told["error"], where=WHERE, remedy=told["remedy"])
    return told, np.frombuffer(octets, dtype="<f4").reshape(rows, columns)


def as_the_camera_has_it(
    values: NDArray[np.float32], file_bits: int, camera_bits: int, *, whole: bool
) -> tuple[str, ...]:
    """Make sure that the gray levels of a file are on the camera's own scale.

    Parameters
    ----------
    values : ndarray
        Gray levels as the file has them.
    file_bits, camera_bits : int
        Of the file and of the camera; a file of more than 8 bits may hold those of a camera that has fewer.
    whole : bool
        Whether the file holds whole numbers; floats are gray levels as they are, such as means over frames.

    Returns
    -------
    tuple of str
        What is to be known.

    Raises
    ------
    InputError
        If they are not.
    """
    full, highest = 2**camera_bits - 1, float(values.max())
    if float(values.min()) < 0:
        raise InputError("holds negative gray levels", where=WHERE)
    wide = file_bits > _EIGHT and camera_bits < file_bits  # no file has 10 or 12 bits of its own in most formats
    if whole and file_bits != camera_bits and not wide:
        what = f"holds {file_bits} bits, the camera gives {camera_bits}"
        raise InputError(what, where=WHERE, remedy="turn the knob for bits, or give what the camera gave")
    if highest > full:
        what = f"reaches the gray level {highest:g}, the camera's {camera_bits} bits end at {full}"
        raise InputError(what, where=WHERE, remedy="turn the knob for bits, or give gray levels as the camera has them")
    step = 2 ** (file_bits - camera_bits)
    if whole and wide and highest > 0 and not (values % step).any():
        what = f"has multiples of {step} only, as if its {camera_bits} bits stood at the upper end of {file_bits}"
        raise InputError(what, where=WHERE, remedy=f"divide its gray levels by {step}")
    if whole:
        return ()
    return ("it holds no whole numbers: what is expected is the scatter of single frames",)


def compared(photo: Photo, image: Image) -> dict[str, Any]:
    """How a photo differs from a picture, against what that one's deviation lets expect, and what would explain it.

    Returns
    -------
    dict
        ``mean``, ``rms`` of photo - picture before rounding, over all pixels [gray level]; ``expected_rms``: of the
        picture's deviation; ``beyond``: share of the pixels that differ by more than 1.96 of their own standard
        deviations; ``worst``: column, row, and both gray levels; ``causes``: see `Causes`, None where the rms is hardly
        more than is expected; ``notes``.

    Raises
    ------
    InputError
        If the picture has another size or other bits.
    """
    sensor = image.relighter.basis.sensor
    if photo.values.shape != image.sigma.shape or photo.bit_depth != sensor.bit_depth:
        has = f"{photo.values.shape[1]} x {photo.values.shape[0]} pixels of {photo.bit_depth} bits"
        want = f"{sensor.columns} x {sensor.rows} of {sensor.bit_depth}"
        raise InputError(f"has {has}, the picture {want}", where=WHERE, remedy="open it again")
    captured = photo.values.astype(np.float64)
    predicted = gray_levels(image.relit.radiant_exposure.values, sensor)
    off = captured - predicted
    rms, expected = (math.sqrt(float(np.mean(values**2))) for values in (off, image.sigma))
    causes = None
    if rms > TELLING * expected:
        from radwrap.measure.compare import compare  # with OpenCV, which the first picture need not wait for

        pair = (GrayImage(values, sensor.bit_depth) for values in (captured, predicted))
        causes = asdict(compare(*pair, dark=sensor.dark_gray, saturation=sensor.saturation_gray).causes)
    row, column = divmod(int(np.argmax(np.abs(off))), off.shape[1])
    return {
        "mean": float(off.mean()),
        "rms": rms,
        "expected_rms": expected,
        "beyond": float(np.mean(np.abs(off) > BEYOND * image.sigma)),
        "worst": {
            "column": column,
            "row": row,
            "photo": float(captured[row, column]),
            "picture": float(predicted[row, column]),
        },
        "causes": causes,
        "notes": photo.notes,
    }
