"""Curves over wavelength in files beside a scene."""

from __future__ import annotations

import math
from pathlib import Path

from radwrap.errors import InputError
from radwrap.scene.file.beside import named_file
from radwrap.scene.spectrum import Curve, read_curve


def curve_beside(name: str, folder: Path, where: str, largest: float = math.inf) -> Curve:
    """Read the table that a key of a scene names.

    Raises
    ------
    InputError
        If there is no such file, or it is no table, with the key.
    """
    path = named_file(folder, name, where)
    try:
        return read_curve(path, largest=largest)
    except InputError as error:
        raise InputError(str(error), where=where) from error
