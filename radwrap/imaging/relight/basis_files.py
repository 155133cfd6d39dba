"""Files of a light basis: a picture for each part of each source, or one of all, where they are read once and go."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.files import sha256_of, write_bytes
from radwrap.images import read_image, write_exr
from radwrap.imaging.run_files import BasisFile
from radwrap.reading import FileKind, read_bytes

FOLDER: Final = "basis"
MAGNIFICATION: Final = f"{FOLDER}/magnification.exr"  # no part of a source: their files have two dots
IN_ONE: Final = f"{FOLDER}/parts.f32"
_TYPE: Final = np.dtype("<f4")
_ALL: Final = FileKind("light basis", 1 << 30)


def file_name(source: str, part: str) -> str:
    """Name of a file of the basis; the part is the number of a replicate, "grid" or "model"."""
    return f"{FOLDER}/{source}.{part}.exr"


class PartsToWrite:
    """Takes the parts of a basis as they come.

    Parameters
    ----------
    out : Path
        Folder of the run.
    in_one : bool
        Whether all of them make one file: the sixty of a coarse picture took a sixth of its time.
    """

    def __init__(self, out: Path, *, in_one: bool) -> None:
        self._out = out
        self._parts: dict[str, NDArray[np.float32]] | None = {} if in_one else None
        self._names: dict[str, list[str]] = {}  # by source

    def write(self, source: str, part: str, values: NDArray[np.float32]) -> None:
        """Write a part of a source, shape (rows, columns) or (n,)."""
        name = file_name(source, part)
        self._write(name, values, "radiance_cos4", {"radwrap:unit": "W m^-2 sr^-1"})
        self._names.setdefault(source, []).append(name)

    def write_magnification(self, values: NDArray[np.float32]) -> None:
        """Write it, shape (rows, columns), after all parts of sources."""
        self._write(MAGNIFICATION, values, "magnification", {})
        self._names[""] = [MAGNIFICATION]

    def _write(self, name: str, values: NDArray[np.float32], channel: str, metadata: Mapping[str, str]) -> None:
        if self._parts is None:
            write_exr(self._out / name, values, channel=channel, metadata=metadata, compression="rle")
        else:
            self._parts[name] = values.astype(_TYPE)

    def finish(self) -> tuple[list[str], dict[str, Any]]:
        """Names of the files, source by source, and what `basis.json` is to tell of them."""
        names = [name for of_source in self._names.values() for name in of_source]
        told: dict[str, Any] = {}
        if self._parts is not None:
            told = {"parts": [(name, *self._parts[name].shape) for name in names]}
            write_bytes(self._out / IN_ONE, b"".join(self._parts[name].tobytes() for name in names))
            names = [IN_ONE]
        return names, {**told, "files": {name: sha256_of(self._out / name) for name in names}}


class PartsToRead:
    """Gives the parts of a basis as they were written.

    Parameters
    ----------
    folder : Path
        Of the run.
    told : BasisFile
        What `basis.json` holds.

    Raises
    ------
    InputError
        If a file is not the one that was written.
    """

    def __init__(self, folder: Path, told: BasisFile) -> None:
        self._folder, self._files = folder, told.files
        for name, known in told.files.items():
            _check_file(folder / name, known)
        self._parts: dict[str, NDArray[np.float32]] = {}
        if told.parts is not None:
            values, place = np.frombuffer(read_bytes(folder / IN_ONE, _ALL), _TYPE).astype(np.float32), 0
            for name, rows, columns in told.parts:
                self._parts[name] = values[place : place + rows * columns].reshape(rows, columns)
                place += rows * columns

    def of(self, source: str, part: str) -> NDArray[np.float32]:
        """A part of a source, shape (rows, columns).

        Raises
        ------
        KeyError
            If there is none.
        """
        return self._read(file_name(source, part))

    @property
    def magnification(self) -> NDArray[np.float32] | None:
        """What was written of it."""
        return self._read(MAGNIFICATION) if MAGNIFICATION in {*self._files, *self._parts} else None

    def _read(self, name: str) -> NDArray[np.float32]:
        if name in self._parts:
            return self._parts[name]
        if name not in self._files:
            raise KeyError(name)
        pixels: NDArray[np.float32] = read_image(self._folder / name)[0]
        return pixels


def _check_file(path: Path, known: str) -> None:
    try:
        same = sha256_of(path) == known
    except OSError as error:
        raise InputError("cannot be read", where=str(path), remedy="make the basis again") from error
    if not same:
        raise InputError("is not the file that the basis was made with", where=str(path), remedy="make it again")
