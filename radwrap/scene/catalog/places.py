"""Where components lie: the scene's folder, RADWRAP_CATALOG, the user's folder, radwrap's own; the first one counts."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Final

from radwrap.errors import InputError
from radwrap.nearest import did_you_mean
from radwrap.scene.catalog.component import CLASSES, Component, checked_name, read_component

VARIABLE: Final = "RADWRAP_CATALOG"
SCENE: Final = "scene"
USER: Final = "user"
PACKAGE: Final = "package"
_ENDING: Final = ".toml"


@dataclass(frozen=True, slots=True)
class Place:
    """A folder with a folder of components for each class.

    Attributes
    ----------
    name : str
        As the manifest has it.
    folder : Path
    flat : bool
        Whether a component may also lie in it without the folder of its class.
    """

    name: str
    folder: Path
    flat: bool = False


def user_folder() -> Path:
    """Where `radwrap catalog add` puts components: the user's folder for data, radwrap/catalog in it."""
    if sys.platform == "win32":
        base = os.environ.get("APPDATA") or str(Path.home() / "AppData" / "Roaming")
    elif sys.platform == "darwin":
        base = str(Path.home() / "Library" / "Application Support")
    else:
        base = os.environ.get("XDG_DATA_HOME") or str(Path.home() / ".local" / "share")
    return Path(base) / "radwrap" / "catalog"


def places(scene_folder: Path | None = None) -> tuple[Place, ...]:
    """All places, that of the highest rank first.

    Parameters
    ----------
    scene_folder : Path, optional
        Folder of the scene that names components.

    Raises
    ------
    InputError
        If the variable names no folder.
    """
    found = [Place(SCENE, scene_folder, flat=True)] if scene_folder is not None else []
    if named := os.environ.get(VARIABLE):
        if not Path(named).is_dir():
            raise InputError(f'"{named}" is not a folder', where=VARIABLE, remedy="correct the variable, or unset it")
        found.append(Place(VARIABLE, Path(named)))
    return (*found, Place(USER, user_folder()), Place(PACKAGE, Path(str(files("radwrap") / "data"))))


def find(kind: str, name: object, scene_folder: Path | None, where: str) -> Component:
    """The component of a class that a name means.

    Parameters
    ----------
    kind : str
        Class, as its folder is called.
    name : object
        As the user wrote it: NAME is the newest, NAME@YYYY-MM-DD that revision.
    scene_folder : Path, optional
        Folder of the scene.
    where : str
        File and key, for messages.

    Raises
    ------
    InputError
        If there is none, or its file is damaged.
    """
    text = checked_name(name, where)
    bare, _, date = text.partition("@")
    for place in places(scene_folder):
        for path in _paths(place, kind, text):
            return read_component(path, place.folder, kind, place.name, f'{where}: "{text}"')
        if date:  # the newest may be the one that is asked for
            for path in _paths(place, kind, bare):
                found = read_component(path, place.folder, kind, place.name, f'{where}: "{bare}"')
                if found.revision == date:
                    return found
    known = sorted({name for name, _, _ in listed(kind, scene_folder)})
    raise InputError(
        f'no {CLASSES[kind]} "{text}"',
        where=where,
        remedy=did_you_mean(text, known) or f"known: {', '.join(known)}",
    )


def listed(kind: str, scene_folder: Path | None = None) -> Iterator[tuple[str, Place, Path]]:
    """Name, place and file of all components of a class in folders of classes, older revisions included."""
    for place in places(scene_folder):
        try:
            names = sorted(path.name for path in (place.folder / kind).iterdir())
        except OSError:
            continue
        for name in names:
            if name.endswith(_ENDING) and not name.startswith("."):
                yield name.removesuffix(_ENDING), place, place.folder / kind / name


def _paths(place: Place, kind: str, name: str) -> Iterator[Path]:
    """Files of that name; links that lead nowhere count, so that they are told."""
    tried = [place.folder / kind / f"{name}{_ENDING}"]
    if place.flat:
        tried.append(place.folder / f"{name}{_ENDING}")
    for path in tried:
        try:
            there = os.path.lexists(path)
        except (OSError, ValueError):
            continue
        if there:
            yield path
