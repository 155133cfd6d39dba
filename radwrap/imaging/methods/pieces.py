"""Pieces of a run on the disk: its memory, so that a killed run goes on where it was.

Each piece is a float32 OpenEXR file that says of what plan it is, and the
digest of its pixels; one that is not whole, or of another plan, is made again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.files import TEMPORARY_SUFFIX
from radwrap.images import digest, read_image, write_exr
from radwrap.process import Programs
from radwrap.tracers.timed import OutOfTime
from radwrap.waiting import Finished

CALL_LOG: Final = "tracer_calls.log"
_CHANNEL: Final = "radiance_cos4"
_PREFIX: Final = "radwrap:"
_TICK: Final = 0.2  # s
# Levels of four cells make one number below 2^16, far from where float32 rounds.
_BASE: Final = 16
_DIGITS: Final = 4


def write_piece(
    path: Path, pixels: NDArray[np.float32], plan: str, metadata: Mapping[str, object], *, packed: bool = False
) -> None:
    """Write a piece, whole or not at all; packed where users may keep it."""
    own = {"plan": plan, "pixels": digest(pixels), "unit": "W m^-2 sr^-1", **metadata}
    attributes = {f"{_PREFIX}{key}": str(value) for key, value in own.items()}
    write_exr(path, pixels, channel=_CHANNEL, metadata=attributes, compression="zip:1" if packed else "none")


def read_piece(path: Path, plan: str) -> tuple[NDArray[np.float32], dict[str, str]] | None:
    """Pixels and metadata of a piece; None where it is not there, not whole or of another plan."""
    if not path.is_file():
        return None
    try:
        pixels, found = read_image(path)
    except InputError:
        return None
    metadata = {key.removeprefix(_PREFIX): value for key, value in found.items() if key.startswith(_PREFIX)}
    if (metadata.get("plan"), metadata.get("pixels")) != (plan, digest(pixels)):
        return None
    return pixels, metadata


class Pieces:
    """Where a run's pieces are: in its folder, or in memory, where nobody goes on with a run that was killed.

    Parameters
    ----------
    folder : Path
        For the log, and for the pieces unless they are in memory.
    in_memory : bool
        Where they are.
    """

    def __init__(self, folder: Path, *, in_memory: bool) -> None:
        self._folder = folder
        self._memory: dict[tuple[str, str], tuple[NDArray[np.float32], dict[str, str]]] | None
        self._memory = {} if in_memory else None

    @property
    def in_memory(self) -> bool:
        """Where they are."""
        return self._memory is not None

    def write(self, name: str, pixels: NDArray[np.float32], plan: str, metadata: Mapping[str, object]) -> None:
        """As `write_piece`."""
        if self._memory is None:
            write_piece(self._folder / name, pixels, plan, metadata)
        else:
            self._memory[name, plan] = pixels, {key: str(value) for key, value in metadata.items()}

    def read(self, name: str, plan: str) -> tuple[NDArray[np.float32], dict[str, str]] | None:
        """As `read_piece`."""
        if self._memory is None:
            return read_piece(self._folder / name, plan)
        return self._memory.get((name, plan))


def packed_levels(levels: NDArray[np.int8]) -> NDArray[np.float32]:
    """Small numbers of neighbours in a row as one number each: there are more cells than pixels.

    Parameters
    ----------
    levels : ndarray of int8, shape (rows, columns)
        From 0 to less than 16.

    Returns
    -------
    ndarray, shape (rows, ceil(columns / 4))
        Whole numbers, which a file of float32 holds exactly.

    Raises
    ------
    ValueError
        If one of them is not small.
    """
    if levels.min(initial=0) < 0 or levels.max(initial=0) >= _BASE:
        raise ValueError(f"levels of cells must lie from 0 to {_BASE - 1}")
    rows, columns = levels.shape
    digits = np.zeros((rows, -(-columns // _DIGITS) * _DIGITS), dtype=np.int32)
    digits[:, :columns] = levels
    each = digits.reshape(rows, -1, _DIGITS)
    packed = each[:, :, 0].copy()
    for place in range(1, _DIGITS):
        packed += each[:, :, place] * _BASE**place
    return packed.astype(np.float32)


def unpacked_levels(packed: NDArray[np.float32], columns: int) -> NDArray[np.int8]:
    """What `packed_levels` took, of so many columns."""
    left = packed.astype(np.int32)
    levels = np.empty((*packed.shape, _DIGITS), dtype=np.int8)
    for place in range(_DIGITS):
        levels[:, :, place] = left % _BASE
        left //= _BASE
    return levels.reshape(len(packed), -1)[:, :columns]


def log_call(folder: Path, name: object) -> None:
    """Note that a piece is begun: while a run is unfinished, the proof that nothing finished is traced again."""
    with (folder / CALL_LOG).open("a", encoding="ascii") as log:
        log.write(f"{name}\n")


def remove_strangers(folder: Path, ours: set[str]) -> None:
    """Remove half-written pieces, and those of another plan."""
    remove_halves(folder)
    for path in folder.glob("*.exr"):
        if path.name not in ours:
            path.unlink(missing_ok=True)


def remove_halves(folder: Path) -> None:
    """Remove half-written pieces."""
    for path in folder.iterdir():
        if path.suffix == ".exr" and TEMPORARY_SUFFIX in path.suffixes:
            path.unlink(missing_ok=True)


def remove_log(folder: Path) -> None:
    """Remove the log: what was killed and begun again is no part of a result."""
    (folder / CALL_LOG).unlink(missing_ok=True)


def remove_pieces(folder: Path) -> None:
    """Remove all pieces and logs, and the folders where nothing of somebody else is in them."""
    for path in (*sorted(folder.rglob("*"), reverse=True), folder):
        if path.is_dir() and not path.is_symlink():
            with suppress(OSError):  # not empty
                path.rmdir()
        elif path.suffix == ".exr" or path.name == CALL_LOG:
            path.unlink(missing_ok=True)


def run_jobs(jobs: Iterable[Callable[[], None]], programs: Programs, workers: int) -> None:
    """Run jobs in threads; the first failure, or an interrupt, ends all programs."""
    with ThreadPoolExecutor(max_workers=workers) as pool:
        running = [pool.submit(job) for job in jobs]
        try:
            finished, left = Finished[None](), len(running)
            for job in running:
                finished.watch(job)
            while left:
                # Awake now and then: a signal that another thread got is heard by the main one only when it runs.
                programs.check()
                for job in finished.within(_TICK):
                    job.result()
                    left -= 1
        except BaseException as failure:
            for job in running:
                job.cancel()
            # Ctrl-C comes here too: the programs end at once, and so do the threads that wait for them. Out of time,
            # each job gives up by itself: the programs are needed for what comes next.
            if not isinstance(failure, OutOfTime):
                programs.cancel()
            raise
