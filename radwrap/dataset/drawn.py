"""What an image of a dataset shows: the scene's tables with the values that were drawn for it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from radwrap.dataset.document import Dataset, Parts
from radwrap.dataset.draws import RandomRotation
from radwrap.errors import InputError
from radwrap.random_streams import Drawing, spawned
from radwrap.scene.file.keys import expanded, set_key
from radwrap.study.factors import Draw

_ORDER: Final = "xyz"  # of the angles that a rotation is written as
_SEEDS: Final = 2**32
MOST_TRIES: Final = 1000  # to place a part where it stands in no other

Table = dict[str, Any]
# Whether a target's table, of a category, stands free of those that were placed; it is then placed too.
Places = Callable[[Mapping[str, Any], str], bool]


@dataclass(frozen=True, slots=True)
class DrawnImage:
    """An image before it is rendered.

    Attributes
    ----------
    number : int
        From 0.
    seed : int
        Of its render.
    document : Mapping
        Tables of its scene.
    categories : Mapping of str to str
        Name of each object, a target of the scene -> its category.
    values : Mapping
        Key path -> what was drawn; of parts position and rotation, by NAME.position.
    """

    number: int
    seed: int
    document: Mapping[str, Any]
    categories: Mapping[str, str]
    values: Mapping[str, Any]


def drawn_image(dataset: Dataset, number: int, places: Places = lambda *_: True) -> DrawnImage:
    """What image `number` shows; the same whoever asks, and in whatever order.

    Parameters
    ----------
    dataset : Dataset
        What is drawn from.
    number : int
        From 0.
    places : callable, optional
        Whether a part may stand where it was drawn; all parts that are not drawn are asked first.

    Raises
    ------
    InputError
        If a part found no place after 1000 tries, or parts that are not drawn stand in each other.
    """
    document: Table = deepcopy(dict(dataset.document))
    values: dict[str, Any] = {}
    for table, one in enumerate(dataset.vary):
        random = _random(dataset, Drawing.VARIED, number, table)
        for key in expanded(one.key, dataset.document):
            values[key] = one.distribution.value(random)
            set_key(document, key, values[key], dataset.scene_origin)
            if isinstance(one.distribution, RandomRotation):
                _write_order(document, f"{key}_order", dataset.scene_origin)
    copied = {one.target: one for one in dataset.parts}
    targets: list[Table] = []
    categories: dict[str, str] = {}
    for target in document["targets"]:
        if target["name"] in copied:
            continue
        targets.append(target)
        if target["name"] in dataset.categories:
            categories[target["name"]] = target["name"]
            if not places(target, target["name"]):
                raise InputError(
                    f'image {number}: "{target["name"]}" overlaps another part', where=f"{dataset.origin}: scene"
                )
    taken = {target["name"] for target in document["targets"]}
    for table, parts in enumerate(dataset.parts):
        prototype = next(target for target in document["targets"] if target["name"] == parts.target)
        random = _random(dataset, Drawing.PARTS, number, table)
        for _ in range(int(random.integers(parts.fewest, parts.most, endpoint=True))):
            copy = {**deepcopy(prototype), "name": _name_of_copy(parts.target, taken)}
            targets.append(_placed(copy, parts, random, places, number))
            categories[copy["name"]] = parts.target
            values |= {f"{copy['name']}.{key}": copy[key] for key in ("position", "rotation")}
    document["targets"] = targets
    seed = int(spawned(dataset.seed, Drawing.RENDER, number).integers(_SEEDS))
    return DrawnImage(number, seed, document, categories, values)


def _random(dataset: Dataset, stream: Drawing, image: int, table: int) -> np.random.Generator:
    return spawned(dataset.seed, stream, image, table)


def _write_order(document: Table, key: str, origin: str) -> None:
    """Angles are those of one order, whatever the scene's file says."""
    set_key(document, key, _ORDER, origin)


def _name_of_copy(target: str, taken: set[str]) -> str:
    number = 1
    while (name := f"{target}_{number}") in taken:
        number += 1
    taken.add(name)
    return name


def _placed(copy: Table, parts: Parts, random: np.random.Generator, places: Places, number: int) -> Table:
    for _ in range(MOST_TRIES):
        copy["position"] = [place.value(random) if isinstance(place, Draw) else place for place in parts.place]
        copy["rotation"], copy["rotation_order"] = parts.rotation.value(random), _ORDER
        if places(copy, parts.target):
            return copy
    raise InputError(
        f'image {number}: "{copy["name"]}" found no place in {MOST_TRIES} tries where it overlaps no other part',
        where=parts.where,
        remedy="give it more room, or fewer parts",
    )
