"""Captures of one bench in several states: each with its own images, and with other values of some keys."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.files import sha256_of
from radwrap.fitting.captured import Captured, captured, read_captures
from radwrap.fitting.free_keys import FreeScene, holds
from radwrap.fitting.poses import aimed_keys
from radwrap.fitting.tables import SeriesModel
from radwrap.fitting.weights import check_noise
from radwrap.images import GrayImage, digest
from radwrap.imaging.mosaicked import brightest_colour, plane_of
from radwrap.reading import FileKind, read_toml
from radwrap.scene.colour_planes import shares_of_light
from radwrap.scene.file.beside import named_file
from radwrap.scene.file.faults import validated
from radwrap.scene.file.keys import expanded, with_all_leds
from radwrap.scene.file.load import scene_from_document
from radwrap.scene.mosaic import COLOURS

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
_FILE: Final = FileKind("file of captures", 16 << 20, "see docs/fit.md")


@dataclass(frozen=True, slots=True, eq=False)
class Captures:
    """Images of the bench in one state; several are repeats.

    Attributes
    ----------
    images : sequence of str, Path or GrayImage
        What the camera gave.
    changes : Mapping[str, Any]
        Keys of the scene that have other values there, as of `radwrap.load_scene`.
    """

    images: Sequence[str | Path | GrayImage]
    changes: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """One state of the bench, read and checked; of a colour camera one colour of it, whose pixels count.

    Attributes
    ----------
    free : FreeScene
        The scene there, with the keys that all states share.
    captured : Captured
        What the camera gave.
    told : tuple of dict
        Of each image, for the manifest; of a colour camera with its first colour.
    number : int
        Of the state of the bench.
    own : ndarray of bool, shape (rows, columns)
        Pixels that it stands for: all, or those of the colour.
    """

    free: FreeScene
    captured: Captured
    told: tuple[dict[str, Any], ...]
    number: int
    own: Flags


def read_series(path: str | Path) -> tuple[Captures, ...]:
    """Read a file of captures, whose images lie in its folder or below.

    Raises
    ------
    InputError
        With file and key.
    """
    source = Path(path)
    model = validated(SeriesModel, read_toml(source, _FILE), source.name, "see docs/fit.md")
    return tuple(
        Captures(
            [
                named_file(source.parent, name, f"{source.name}: captures[{number}].files[{one}]")
                for one, name in enumerate(entry.files)
            ],
            entry.set,
        )
        for number, entry in enumerate(model.captures)
    )


def states_of(
    free: FreeScene,
    captures: Sequence[str | Path | GrayImage] | Sequence[Captures],
    mask: Any,
    noise: float | None,
) -> tuple[State, ...]:
    """What was captured, each with its scene.

    Parameters
    ----------
    free : FreeScene
        Where the fit begins.
    captures : sequence
        Images, which are repeats, or `Captures`, each of its own state.
    mask : ndarray of bool or None
        Pixels that count, in all states.
    noise : float or None
        Standard deviation of one image [gray level].

    Raises
    ------
    InputError
        If an image is not one of the scene's sensor, a state changes a key that is free, or no noise is known.
    """
    series = [one for one in captures if isinstance(one, Captures)]
    if series and len(series) < len(captures):
        raise InputError("are images and states of the bench in one list", where="captures")
    repeats = [one for one in captures if not isinstance(one, Captures)]
    found: list[State] = []
    for number, one in enumerate(series or [Captures(repeats)]):
        where = f"captures[{number}]"
        scene = _changed(free, one.changes, where)
        images = read_captures(one.images)
        names = [_name(image, given) for image, given in zip(images, one.images, strict=True)]
        taken = captured(images, names, scene.scene.camera.sensor, mask)
        check_noise(scene.scene.camera.sensor, noise, taken.repeats)
        state = {"capture": number, "set": dict(one.changes)} if series else {}
        told = tuple({**_told(image, name), **state} for image, name in zip(images, names, strict=True))
        found += _by_colour(State(scene, taken, told, number, np.ones(taken.mask.shape, dtype=np.bool_)))
    _check_once([image for state in found for image in state.told if "file_sha256" in image])
    sensors = {(one.free.scene.camera.sensor.rows, one.free.scene.camera.sensor.columns) for one in found}
    if len(sensors) > 1:
        raise InputError("change the number of pixels", where="captures")
    return tuple(found)


def _by_colour(state: State) -> Iterator[State]:
    """The colours of a mosaic, that with most light first: each as if all pixels had its filter, but its own count.

    A colour that gets no light says nothing.
    """
    scene = state.free.scene
    mosaic = scene.camera.sensor.mosaic
    if mosaic is None:
        yield state
        return
    shares, brightest = shares_of_light(scene), brightest_colour(scene)
    told = state.told
    for colour in sorted(COLOURS, key=lambda colour: colour != brightest):
        own = np.zeros(state.own.shape, dtype=np.bool_)
        for place in mosaic.places(colour):
            own[place] = True
        counted = own & state.captured.mask
        if shares[colour] == 0 or not counted.any():
            continue
        free = replace(state.free, scene=plane_of(scene, colour))
        yield replace(state, free=free, captured=replace(state.captured, mask=counted), told=told, own=own)
        told = ()


def _check_once(images: Sequence[Mapping[str, Any]]) -> None:
    """Refuse a captured file that is there twice: noise makes any two differ, and what it says would count twice."""
    seen: dict[str, Mapping[str, Any]] = {}
    for image in images:
        other = seen.setdefault(image["pixels_sha256"], image)
        if other is not image:
            raise InputError(
                f"is {_in_state(other)} once more, pixel by pixel",
                where=_in_state(image),
                remedy="name each capture once, in the state that it is of",
            )


def _in_state(image: Mapping[str, Any]) -> str:
    number = f" of captures[{image['capture']}]" if "capture" in image else ""
    return f"{image['file']}{number}"


def _changed(free: FreeScene, changes: Mapping[str, Any], where: str) -> FreeScene:
    """The scene with other values of keys that are not free."""
    if not changes:
        return free
    document = with_all_leds(json.loads(free.scene.document), list(changes))
    told = {*free.written([key.value for key in free.keys]), *aimed_keys(free.poses)}
    for key in changes:
        for one in expanded(key, document):
            if any(holds(one, other) or holds(other, one) for other in told):
                raise InputError("is free: a capture cannot have a value of its own", where=f"{where}.set: {key}")
    try:
        scene = scene_from_document(
            json.loads(free.scene.document), dict(changes), origin=free.scene.origin, folder=free.scene.folder
        )
    except InputError as error:  # the scene was whole before
        raise InputError(f"the scene does not take it: {error}", where=f"{where}.set") from error
    return FreeScene(scene, free.keys, free.poses)


def _name(image: GrayImage, given: str | Path | GrayImage) -> str:
    return str(image.provenance.get("file", "captures")) if isinstance(given, GrayImage) else str(given)


def _told(image: GrayImage, name: str) -> dict[str, Any]:
    """What the manifest tells of an image."""
    path = Path(name)
    told = {"file_sha256": sha256_of(path)} if path.is_file() else {}
    return {"file": name, **told, "pixels_sha256": digest(image.values)}


def joined(images: Sequence[Array], states: Sequence[State]) -> list[Array]:
    """One image for each state of the bench: of the colours of a mosaic each pixel is that of its own.

    Parameters
    ----------
    images : sequence of ndarray, shape (rows, columns)
        Of each state, or of each colour of it.
    states : sequence of State
        Whose.
    """
    found: dict[int, Array] = {}
    for image, state in zip(images, states, strict=True):
        before = found.get(state.number)
        found[state.number] = image if before is None else np.where(state.own, image, before)
    return list(found.values())
