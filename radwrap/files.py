"""Files that are either whole or absent, and folders with one owner."""

from __future__ import annotations

import hashlib
import os
import shutil
import stat
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from radwrap.errors import EnvironmentFailure, FolderTaken, InputError

TEMPORARY_SUFFIX = ".part"
LOCK_NAME = ".radwrap.lock"
_MEMORY = Path("/dev/shm")  # noqa: S108  (folders in it are made by tempfile)
_ROOM = 1 << 30  # byte; where it is smaller it stays for others


def temporary_name(path: Path) -> Path:
    """Name under which a file is written before it is whole; keeps the extension."""
    return path.with_name(f".{path.stem}{TEMPORARY_SUFFIX}{path.suffix}")


def disk_failure(path: Path, error: OSError) -> EnvironmentFailure:
    """Turn an operating-system error about a file into ours."""
    return EnvironmentFailure(
        f"cannot write: {error.strerror or error}",
        where=str(path),
        remedy="free disk space or choose another folder",
    )


def disk_in_memory() -> Path | None:
    """A disk in memory, where what is written need not be waited for; None where there is none with room."""
    return _MEMORY if os.access(_MEMORY, os.W_OK) and shutil.disk_usage(_MEMORY).free >= _ROOM else None


def flush_to_disk(path: Path) -> None:
    """Wait until the disk holds the file or folder."""
    if path.is_dir() and sys.platform == "win32":
        return  # Windows does not open folders
    descriptor = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def check_result(path: Path) -> None:
    """Refuse a name for a result that is taken by anything but a regular file: it would be replaced.

    Raises
    ------
    InputError
        If a device, a pipe, a link or a folder has that name, or the name cannot be a file's.
    EnvironmentFailure
        If the disk has no room for such a name.
    """
    try:
        taken = path.lstat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return
    except OSError as error:
        raise disk_failure(path, error) from error
    except ValueError as error:
        raise InputError(f"cannot be written: {error}", where=str(path), remedy="choose another name") from error
    if not stat.S_ISREG(taken):
        raise InputError("is not a regular file", where=str(path), remedy="give a new name, or that of a regular file")


def check_results(folder: Path, names: Iterable[str]) -> None:
    """Refuse before a work what would fail after it: a folder for results, and files that will be written there.

    Raises
    ------
    InputError
        If a file stands in the folder's way, or as `check_result`.
    EnvironmentFailure
        If nothing can be written there.
    """
    there = folder
    while not os.path.lexists(there) and there != there.parent:
        there = there.parent
    if not there.is_dir():
        raise _no_folder(there)
    if not os.access(there, os.W_OK | os.X_OK):
        raise EnvironmentFailure("cannot be written to", where=str(there), remedy="choose another `out`")
    for name in names:
        check_result(folder / name)


def check_not_others(folder: Path, names: Iterable[str], mark: str, by: str) -> None:
    """Refuse a folder with files of the user's own, which results of these names would replace.

    Parameters
    ----------
    folder : Path
        For the results.
    names : iterable of str
        Of the results.
    mark : str
        File by which a folder with such results is known.
    by : str
        What writes them, for the message.

    Raises
    ------
    InputError
        If one of the files is there, and the mark is not.
    """
    other = next((name for name in names if (folder / name).exists()), None)
    if other is not None and not (folder / mark).exists():
        raise InputError(
            f"holds {other}, which was not written by any {by}", where=str(folder), remedy="choose another `out`"
        )


def publish(temporary: Path, final: Path) -> None:
    """Rename a whole, read-back file to its final name, durably.

    Raises
    ------
    EnvironmentFailure
        If the disk refuses.
    InputError
        As `check_result`.
    """
    check_result(final)
    try:
        flush_to_disk(temporary)
        temporary.replace(final)
        flush_to_disk(final.parent)
    except OSError as error:
        raise disk_failure(final, error) from error


def move_files(made: Path, folder: Path, names: Iterable[str]) -> None:
    """Rename whole files into another folder of the same disk, durably; names may hold folders."""
    folders = {folder}
    for name in names:
        final = folder / name
        make_folder(final.parent)
        (made / name).replace(final)
        folders.add(final.parent)
    for place in sorted(folders):
        flush_to_disk(place)


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file whole or not at all: temporary name, flush, read back, rename.

    Raises
    ------
    EnvironmentFailure
        If the disk refuses, or does not give back what was written.
    InputError
        As `check_result`.
    """
    check_result(path)
    temporary = temporary_name(path)
    try:
        temporary.unlink(missing_ok=True)
        temporary.write_bytes(content)
        flush_to_disk(temporary)
        if temporary.read_bytes() != content:
            raise EnvironmentFailure("the disk returned bytes other than those written", where=str(path))
        publish(temporary, path)
    except OSError as error:
        raise disk_failure(path, error) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def sha256_of(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def make_folder(path: Path) -> None:
    """Make a folder and its parents.

    Raises
    ------
    InputError
        If a regular file stands in the way, or the name is not text.
    EnvironmentFailure
        If the disk refuses.
    """
    try:
        str(path).encode()
    except UnicodeEncodeError as error:
        raise InputError("its name is not UTF-8", where=repr(str(path)), remedy="choose another `out`") from error
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        raise _no_folder(path) from error
    except OSError as error:
        raise disk_failure(path, error) from error


def write_new(folder: Path, contents: Mapping[str, bytes]) -> None:
    """Write files into a folder, none of them where one of them is there already.

    Parameters
    ----------
    folder : Path
        Is made where it is not there.
    contents : mapping of str to bytes
        By the files' paths in it, in the order of writing.

    Raises
    ------
    InputError
        If a file is there already; also as `make_folder`.
    EnvironmentFailure
        If the disk refuses.
    """
    make_folder(folder)
    for name in contents:
        if (folder / name).exists():
            raise InputError("is there already", where=str(folder / name), remedy="choose another folder")
    for name, content in contents.items():
        make_folder((folder / name).parent)
        write_bytes(folder / name, content)


def _no_folder(path: Path) -> InputError:
    return InputError("a file is where a folder is needed", where=str(path), remedy="choose another `out`")


@contextmanager
def sole_owner(folder: Path) -> Iterator[None]:
    """Hold a folder for one run; the lock falls with the process, even a killed one.

    Raises
    ------
    FolderTaken
        If another run holds the folder.
    EnvironmentFailure
        If the disk refuses.
    """
    try:
        stream = (folder / LOCK_NAME).open("a+b")
    except OSError as error:
        raise disk_failure(folder, error) from error
    with stream:
        try:
            _lock(stream.fileno())
        except OSError as error:
            raise FolderTaken(
                "another run is writing here", where=str(folder), remedy="wait for it or choose another `out`"
            ) from error
        yield


if sys.platform == "win32":
    import msvcrt

    def _lock(descriptor: int) -> None:
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)

else:
    import fcntl

    def _lock(descriptor: int) -> None:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
