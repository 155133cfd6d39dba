"""Files that a scene names: inside its own folder, by real path, and of a sensible size."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from radwrap.errors import InputError

_LARGEST_FILE: Final = 16 << 20  # byte


def named_file(folder: Path, name: str, where: str) -> Path:
    """The file that a scene names.

    Parameters
    ----------
    folder : Path
        The scene's.
    name : str
        As the scene has it.
    where : str
        Key, for messages.

    Raises
    ------
    InputError
        If it is not there, lies outside the folder, links followed, or is no regular file of at most 16 MiB.
    """
    try:
        real = (folder / name).resolve()
        if not real.is_relative_to(folder.resolve()):
            raise InputError(f'"{name}" lies outside the scene\'s folder', where=where, remedy="copy it there")
        if not real.is_file():
            raise InputError(f'no file "{name}" beside the scene', where=where)
        if real.stat().st_size > _LARGEST_FILE:
            raise InputError(f'"{name}" is larger than {_LARGEST_FILE >> 20} MiB', where=where)
    except (OSError, ValueError) as error:
        raise InputError(f'"{name}" cannot be read', where=where) from error
    return real
