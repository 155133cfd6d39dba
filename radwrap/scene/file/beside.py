"""Files that a scene names: inside its own folder, by real path, and of a sensible size."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from radwrap.errors import InputError
from radwrap.reading import FileKind, check_regular

_BESIDE: Final = FileKind("file beside a scene", 64 << 20)


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
        If it is not there, lies outside the folder, links followed, or is no regular file of at most 64 MiB.
    """
    try:
        real = (folder / name).resolve()
        if not real.is_relative_to(folder.resolve()):
            raise InputError(f'"{name}" lies outside the scene\'s folder', where=where, remedy="copy it there")
        if not real.exists():
            raise InputError(f'no file "{name}" beside the scene', where=where)
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(f'"{name}" cannot be read', where=where) from error
    check_regular(real, _BESIDE, f'{where}: "{name}"')
    return real
