"""A dataset as a user writes it: DATASET.toml to frozen values, everything checked that can be without a ray.

Errors name the file and the key, such as ``dataset.toml: vary[1].uniform``.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from radwrap.dataset.bop import check_camera
from radwrap.dataset.draws import Distribution, RandomRotation, read_distribution, read_interval, read_rotation
from radwrap.dataset.symmetries import Symmetry, check_symmetry, told_symmetries
from radwrap.dataset.tables import (
    BOP,
    COCO,
    CONTINUOUS,
    DISTRIBUTIONS,
    MOST_COPIES,
    YOLO,
    DatasetModel,
    PartsModel,
    SegmentationName,
    VaryModel,
)
from radwrap.errors import InputError
from radwrap.imaging.in_time.making import refuse_for_time
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.response.noise import linear_of
from radwrap.reading import FileKind, read_toml
from radwrap.scene.file.faults import validated
from radwrap.scene.file.keys import expanded, set_key, with_all_leds
from radwrap.scene.file.load import load_scene, scene_from_document
from radwrap.scene.scene import Scene
from radwrap.scene.targets import MeshPart
from radwrap.study.factors import Draw

_DATASET_FILE: Final = FileKind("dataset file", 64 << 20)
_POSE_KEY: Final = re.compile(r"targets\[(\d+|\*)\]\.(position|rotation)")
# What makes a category: another mesh is another category.
_CATEGORY_KEY: Final = re.compile(r"targets\[(\d+)\]\.(name|part|length_unit|type)$")
_ROTATION: Final = ".rotation"


@dataclass(frozen=True, slots=True)
class Vary:
    """A key of the scene that is drawn anew for each image; with ``[*]`` for each entry of a list.

    Attributes
    ----------
    key : str
    distribution : Distribution
    where : str
        For messages.
    """

    key: str
    distribution: Distribution
    where: str


@dataclass(frozen=True, slots=True)
class Parts:
    """How often a part stands in an image, and where.

    Attributes
    ----------
    target : str
        Name of the scene's target, which is their category.
    fewest, most : int
        How many; every number from the first to the last is as likely.
    place : tuple
        Along x, y and z: a length, or two between which it is uniform.
    rotation : RandomRotation
    where : str
        For messages.
    """

    target: str
    fewest: int
    most: int
    place: tuple[Draw | str, Draw | str, Draw | str]
    rotation: RandomRotation
    where: str


@dataclass(frozen=True, slots=True)
class Dataset:
    """A dataset, checked.

    Attributes
    ----------
    title : str
        For people.
    origin : str
        File it was read from, for messages.
    folder : Path
        Of the scene, against which its files are resolved.
    scene_origin : str
        Name of the scene's file.
    document : Mapping
        Tables of the scene, with what ``[set]`` changes.
    images, seed, shard : int
        How many images, what decides all draws, and how many images a shard holds.
    formats : tuple of str
        Of "coco", "bop" and "yolo".
    segmentation : str
        How COCO's file holds masks: "rle" or "polygons".
    tolerance : float or str
        As in `RenderOptions`.
    noise : bool
        Whether an image is one frame with the noise of a linear camera, in place of the mean.
    vary : tuple of Vary
    parts : tuple of Parts
    categories : tuple of str
        Names of the scene's mesh parts in their order; the first has the number 1.
    symmetries : tuple of Symmetry
        Turns after which parts look the same; for BOP.
    """

    title: str
    origin: str
    folder: Path
    scene_origin: str
    document: Mapping[str, Any]
    images: int
    seed: int
    shard: int
    formats: tuple[str, ...]
    segmentation: SegmentationName
    tolerance: float | str
    noise: bool
    vary: tuple[Vary, ...]
    parts: tuple[Parts, ...]
    categories: tuple[str, ...]
    symmetries: tuple[Symmetry, ...] = ()

    @property
    def gray_folder(self) -> str:
        """Where a shard's images lie: BOP has "gray", YOLO finds labels by "images"."""
        return "gray" if BOP in self.formats or YOLO not in self.formats else "images"

    @property
    def most_objects(self) -> int:
        """How many objects an image may show."""
        fixed = len(self.categories) - len(self.parts)
        return fixed + sum(one.most for one in self.parts)


def read_dataset(path: Path) -> Dataset:
    """Read a dataset's file and its scene.

    Raises
    ------
    InputError
        What is wrong, with file and key; also where an end of a distribution gives no scene.
    """
    origin = path.name
    told = validated(DatasetModel, read_toml(path, _DATASET_FILE), origin, "docs/dataset.md shows a dataset's file")
    scene = load_scene(path.parent / told.scene, told.set)
    refuse_for_time(scene, RenderOptions())
    categories = tuple(target.name for target in scene.targets if isinstance(target, MeshPart))
    if not categories:
        raise InputError("the scene has no mesh part", where=f"{origin}: scene", remedy='give a target with "part"')
    if len(set(told.formats)) < len(told.formats):
        raise InputError("names a format twice", where=f"{origin}: formats")
    if told.segmentation != "rle" and COCO not in told.formats:
        raise InputError(f'is of the format "{COCO}"', where=f"{origin}: segmentation", remedy="name it in formats")
    _check_tolerance(told.tolerance, f"{origin}: tolerance")
    vary = tuple(_vary(table, f"{origin}: vary[{number}]") for number, table in enumerate(told.vary))
    parts = tuple(_parts(table, f"{origin}: parts[{number}]") for number, table in enumerate(told.parts))
    dataset = Dataset(
        title=told.title or path.stem,
        origin=origin,
        folder=scene.folder,
        scene_origin=scene.origin,
        document=_named(with_all_leds(json.loads(scene.document), [one.key for one in vary]), scene.targets),
        images=told.images,
        seed=told.seed,
        shard=told.shard,
        formats=tuple(told.formats),
        segmentation=told.segmentation,
        tolerance=told.tolerance,
        noise=told.noise,
        vary=vary,
        parts=parts,
        categories=categories,
        symmetries=_symmetries(told, scene, origin),
    )
    if BOP in dataset.formats:
        check_camera(scene.camera, f"{origin}: formats")
    if dataset.noise:
        _check_noise(scene, f"{origin}: noise")
    _check_parts(dataset)
    _check_vary(dataset)
    return dataset


def _symmetries(told: DatasetModel, scene: Scene, origin: str) -> tuple[Symmetry, ...]:
    meshes = {target.name: target.mesh for target in scene.targets if isinstance(target, MeshPart)}
    found = []
    for number, table in enumerate(told.symmetries):
        where = f"{origin}: symmetries[{number}]"
        if BOP not in told.formats:
            raise InputError(f'is of the format "{BOP}"', where=where, remedy="name it in formats")
        if table.target not in meshes:
            raise InputError(
                f'the scene has no mesh part "{table.target}"',
                where=f"{where}.target",
                remedy=f"it has {', '.join(meshes)}",
            )
        length = math.hypot(*table.axis)
        if not 0 < length < math.inf:
            raise InputError("needs a length above zero", where=f"{where}.axis")
        x, y, z = (part / length for part in table.axis)
        fold = None if table.fold == CONTINUOUS else table.fold
        one = Symmetry(table.target, (x, y, z), table.through, fold, where)
        check_symmetry(one, meshes[table.target])
        found.append(one)
    for name in meshes:
        told_symmetries([one for one in found if one.target == name])
    return tuple(found)


def _named(document: dict[str, Any], targets: tuple[Any, ...]) -> dict[str, Any]:
    """Tables in which each target has its name: those that have it by their number keep it among copies."""
    for table, target in zip(document.get("targets", []), targets, strict=True):
        table["name"] = target.name
    return document


def _check_tolerance(tolerance: Any, where: str) -> None:
    if tolerance is None or isinstance(tolerance, bool) or not isinstance(tolerance, int | float | str):
        raise InputError("must be a number of gray levels, or a text with a unit", where=where)
    try:
        RenderOptions(tolerance=tolerance)
    except InputError as error:
        raise InputError(error.what, where=where, remedy=error.remedy) from error


def _check_noise(scene: Scene, where: str) -> None:
    try:
        linear_of(scene.camera.sensor)
    except InputError as error:
        raise InputError(error.what, where=where, remedy=error.remedy) from error


def _vary(table: VaryModel, where: str) -> Vary:
    kind = next(kind for kind in DISTRIBUTIONS if getattr(table, kind) is not None)
    distribution = read_distribution(kind, getattr(table, kind), table.weights, f"{where}.{kind}")
    if kind == "rotation" and not table.key.endswith(_ROTATION):
        raise InputError("a rotation is for a key that ends in .rotation", where=f"{where}.key")
    return Vary(table.key, distribution, where)


def _parts(table: PartsModel, where: str) -> Parts:
    count = table.count if isinstance(table.count, list) else [table.count, table.count]
    if len(count) != 2 or not all(isinstance(one, int) and not isinstance(one, bool) for one in count):
        raise InputError("must be a whole number, or two", where=f"{where}.count", remedy="such as 3 or [1, 5]")
    fewest, most = count
    if not 0 <= fewest <= most <= MOST_COPIES:
        raise InputError(f"must rise, from 0 to {MOST_COPIES} at most", where=f"{where}.count")
    x, y, z = (read_interval(getattr(table, axis), f"{where}.{axis}") for axis in "xyz")
    return Parts(table.target, fewest, most, (x, y, z), read_rotation(table.rotation, f"{where}.rotation"), where)


def _check_parts(dataset: Dataset) -> None:
    seen: set[str] = set()
    for one in dataset.parts:
        if one.target not in dataset.categories:
            known = ", ".join(dataset.categories)
            raise InputError(
                f'the scene has no mesh part "{one.target}"', where=f"{one.where}.target", remedy=f"it has {known}"
            )
        if one.target in seen:
            raise InputError(f'"{one.target}" has two tables', where=f"{one.where}.target")
        seen.add(one.target)
        for axis, place in zip("xyz", one.place, strict=True):
            for end in place.ends if isinstance(place, Draw) else (place,):
                _try(dataset, {f"targets[{_number(dataset, one.target)}].position": _at(axis, end)}, one.where)


def _at(axis: str, value: Any) -> list[Any]:
    return [value if axis == one else "0 mm" for one in "xyz"]


def _number(dataset: Dataset, name: str) -> int:
    return next(number for number, table in enumerate(dataset.document["targets"]) if table["name"] == name)


def _check_vary(dataset: Dataset) -> None:
    copied = {_number(dataset, one.target) for one in dataset.parts}
    keys: dict[str, str] = {}
    for one in dataset.vary:
        try:
            places = expanded(one.key, dataset.document)
        except InputError as error:
            raise InputError(error.what, where=f"{one.where}.key", remedy=error.remedy) from error
        for key in places:
            if key in keys:
                raise InputError(f"{key} is drawn by {keys[key]} too", where=f"{one.where}.key")
            keys[key] = one.where
            if _CATEGORY_KEY.match(key):
                raise InputError(
                    f"{key} makes a category, and is not drawn",
                    where=f"{one.where}.key",
                    remedy="give the scene a target for each mesh, and draw their numbers in [[parts]]",
                )
            pose = _POSE_KEY.match(key)
            if pose is not None and int(pose[1]) in copied:
                raise InputError(
                    f"{key} is drawn by [[parts]] too", where=f"{one.where}.key", remedy="leave it to [[parts]]"
                )
        for end in one.distribution.ends:
            _try(dataset, dict.fromkeys(places, end), one.where)


def _try(dataset: Dataset, changes: Mapping[str, Any], where: str) -> None:
    """See that some values give a scene; meshes are read again, which is little beside a render."""
    document = deepcopy(dict(dataset.document))
    try:
        for key, value in changes.items():
            set_key(document, key, value, dataset.scene_origin)
        scene_from_document(document, origin=dataset.scene_origin, folder=dataset.folder)
    except InputError as error:
        raise InputError(f"{error.where}: {error.what}", where=where, remedy=error.remedy) from error
