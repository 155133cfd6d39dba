"""From a scene file to a Scene: read, override, validate, convert to SI.

Errors name the file and the key path, such as ``scene.toml: targets[0].pitch``.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel, ValidationError
from pydantic_core import PydanticUndefined

from radwrap.errors import InputError
from radwrap.reading import FileKind, check_tree, read_toml
from radwrap.scene.camera import Camera
from radwrap.scene.catalog.presets import Taken, in_file, with_presets
from radwrap.scene.file.border import Model
from radwrap.scene.file.calibrated import with_calibration
from radwrap.scene.file.convert import camera_from_table, scene_from_model
from radwrap.scene.file.data_sheet import in_sheet, with_data_sheet
from radwrap.scene.file.document import CameraModel, SceneModel
from radwrap.scene.file.faults import fault
from radwrap.scene.file.keys import set_all
from radwrap.scene.file.material_convert import material_from_table
from radwrap.scene.file.material_tables import MaterialModel
from radwrap.scene.look.checks import check_scene, check_shapes
from radwrap.scene.look.wide_checks import check_beside, check_coaxial
from radwrap.scene.look.wide_sources import outlined
from radwrap.scene.materials import Glass, Material, Mirror, PrintedImage
from radwrap.scene.scene import Scene

# Keys of a camera that change nothing of what spectra are weighed by: the time, and what comes after the electrons.
BEHIND_THE_LIGHT: Final = (
    "camera.exposure_time",
    *(f"camera.sensor.{key}" for key in ("system_gain", "offset", "full_well", "read_noise", "dsnu", "prnu")),
    *(f"camera.sensor.{key}" for key in ("dark_current", "temperature")),
)
_SCENE_FILE: Final = FileKind("scene file", 16 << 20, "`radwrap init DIR` writes one to start from")  # written by hand


def load_scene(path: str | Path, overrides: Mapping[str, Any] | None = None) -> Scene:
    """Read a scene file.

    Parameters
    ----------
    path : str or Path
        The TOML file.
    overrides : Mapping[str, Any], optional
        Key path -> value as the file would hold it, such as
        ``{"camera.exposure_time": "64 ms", "targets[0].rotation": ["46 deg", "6 deg", "-2 deg"]}``. ``[*]`` stands
        for every entry of a list; ``leds[i]`` is LED i of a ring, listed in the file or not.

    Returns
    -------
    Scene
        Validated, in SI units.

    Raises
    ------
    InputError
        What is wrong, with file and key path.

    Examples
    --------
    >>> import radwrap
    >>> radwrap.load_scene("scene.toml", {"camera.exposure_time": "64 ms"}).camera.sensor.columns
    192
    """
    path = Path(path)
    document = read_toml(path, _SCENE_FILE)
    return scene_from_document(document, overrides, origin=path.name, folder=path.parent)


class _MaterialsModel(Model):
    """A file of materials: names as a mesh has them -> tables as a scene has them."""

    materials: dict[str, MaterialModel]


def load_materials(path: str | Path) -> dict[str, Material]:
    """Read a file with ``[materials."NAME"]`` tables as a scene has them; errors as `load_scene`."""
    path = Path(path)
    document, _ = with_presets(read_toml(path, _SCENE_FILE), path.name, path.parent)
    _checked_json(document, path.name)
    try:
        model = _MaterialsModel.model_validate(document)
    except ValidationError as error:
        raise fault(error, path.name, document, _MaterialsModel) from error
    found = {
        name: material_from_table(table, f"{path}: materials.{name}", f"materials.{name}", {}, path.parent)
        for name, table in model.materials.items()
    }
    for name, material in found.items():
        if getattr(model.materials[name], "spectrum", None) is not None:
            raise InputError(
                "goes with the spectra of a scene's sources",
                where=f"{path}: materials.{name}.spectrum",
                remedy="leave it out here",
            )
        if isinstance(material, PrintedImage | Mirror | Glass):
            raise InputError(
                "prints, mirrors and glass are for flat targets of a scene", where=f"{path}: materials.{name}"
            )
    return found


def scene_from_document(
    document: Mapping[str, Any],
    overrides: Mapping[str, Any] | None = None,
    *,
    origin: str = "scene",
    folder: Path = Path(),
) -> Scene:
    """Make a Scene from the tables of a scene file; arguments, result and errors as `load_scene`.

    Examples
    --------
    >>> import json, radwrap
    >>> tables = json.loads(radwrap.load_scene("scene.toml").document)
    >>> tables["sources"][0]["count"] = 6
    >>> len(radwrap.scene_from_document(tables).emitters)
    6
    """
    tables: dict[str, Any] = json.loads(_checked_json(document, origin))
    for key, value in (overrides or {}).items():
        tables = set_all(tables, key, value, origin)
    text = _checked_json(tables, origin)
    filled, taken = with_presets(tables, origin, folder)
    whole = with_calibration(with_data_sheet(filled, origin, folder), origin, folder)
    try:
        model = SceneModel.model_validate(whole)
    except ValidationError as error:
        raise in_file(
            in_sheet(fault(error, origin, whole, SceneModel), tables, whole, origin), taken, origin
        ) from error
    told = dict(_assumed(model)) | _unpublished(taken)
    scene = scene_from_model(model, assumed=told, origin=origin, folder=folder, document=text)
    scene = replace(scene, components=taken)
    check_shapes(scene)
    check_beside(scene)
    scene = outlined(scene)
    check_coaxial(scene)
    check_scene(scene)
    return scene


class _CameraModel(Model):
    """The camera of a scene for itself."""

    camera: CameraModel


def with_camera(scene: Scene, overrides: Mapping[str, Any]) -> Scene:
    """A scene that differs in keys of its camera; what does not hang on the camera is not looked at again.

    Raises
    ------
    InputError
        As `load_scene`; and if a key is none of the camera, or another sensor may weigh the scene's spectra otherwise.
    """
    other = camera_with(
        scene.document, overrides, origin=scene.origin, folder=scene.folder, spectral=scene.spectral is not None
    )
    return replace(
        scene,
        camera=other.camera,
        assumed={key: value for key, value in scene.assumed.items() if not _of_camera(key)} | other.assumed,
        document=other.document,
        components=(*other.components, *(taken for taken in scene.components if not _of_camera(taken.key))),
    )


def _of_camera(key: str) -> bool:
    return key.startswith("camera.")


@dataclass(frozen=True, slots=True)
class OtherCamera:
    """The camera of a document in which some keys were changed.

    Attributes
    ----------
    camera : Camera
        The camera.
    assumed : dict
        What it takes because the document is silent, as `Scene.assumed`.
    document : str
        The document with the changes.
    components : tuple of Taken
        What the camera takes from the catalog.
    """

    camera: Camera
    assumed: dict[str, str]
    document: str
    components: tuple[Taken, ...]


def camera_with(
    document: str, overrides: Mapping[str, Any], *, origin: str, folder: Path, spectral: bool
) -> OtherCamera:
    """The camera of a scene's document with some keys changed; errors as `with_camera`.

    Parameters
    ----------
    document : str
        The scene file's content as JSON, as `Scene.document` has it.
    overrides : Mapping[str, Any]
        Key of the camera -> value as the file would hold it.
    origin, folder : str, Path
        As of `Scene`.
    spectral : bool
        Whether the scene tells spectra, which another sensor may weigh otherwise.
    """
    tables: dict[str, Any] = json.loads(document)
    for key, value in overrides.items():
        if not key.startswith("camera."):
            raise InputError("is not a key of the camera", where=f"{origin}: {key}")
        if spectral and key not in BEHIND_THE_LIGHT:
            raise InputError("may weigh the scene's spectra differently", where=key, remedy="render that camera")
        tables = set_all(tables, key, value, origin)
    text = _checked_json(tables, origin)
    filled, taken = with_presets({"camera": tables["camera"]}, origin, folder)
    whole = with_calibration(with_data_sheet(filled, origin, folder), origin, folder)
    try:
        model = _CameraModel.model_validate({"camera": whole["camera"]})
    except ValidationError as error:
        found = in_sheet(fault(error, origin, whole, _CameraModel), tables, whole, origin)
        raise in_file(found, taken, origin) from error
    told = dict(_assumed(model)) | _unpublished(taken)
    return OtherCamera(
        camera_from_table(model.camera, f"{origin}: camera", told, folder, spectral=spectral), told, text, taken
    )


def with_value(scene: Scene, key: str, value: Any) -> Scene:
    """A scene that differs in one key, written as the scene file would hold it.

    Raises
    ------
    InputError
        As `load_scene`.

    Examples
    --------
    >>> import radwrap
    >>> scene = radwrap.load_scene("scene.toml")
    >>> radwrap.with_value(scene, "camera.exposure_time", "64 ms").camera.exposure_time
    0.064
    """
    return with_changes(scene, {key: value})


def with_changes(scene: Scene, changes: Mapping[str, Any]) -> Scene:
    """A scene that differs in some keys; see `with_value`."""
    return scene_from_document(json.loads(scene.document), changes, origin=scene.origin, folder=scene.folder)


def _checked_json(document: Mapping[str, Any], origin: str) -> str:
    """JSON of a document; dates and non-finite numbers are no values of a scene."""
    check_tree(document, origin, finite=True)
    for key, value in _leaves(document, ""):
        if not isinstance(value, str | int | float | bool | dict | list):
            raise InputError(f"a {type(value).__name__} is not a value of a scene", where=f"{origin}: {key}")
    return json.dumps(document, ensure_ascii=False)


def _leaves(value: Any, key: str) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping):
        for name, item in value.items():
            yield from _leaves(item, f"{key}.{name}" if key else str(name))
    elif isinstance(value, list | tuple):
        for index, item in enumerate(value):
            yield from _leaves(item, f"{key}[{index}]")
    else:
        yield key, value


def _assumed(model: BaseModel, prefix: str = "") -> Iterator[tuple[str, str]]:
    """Key path and value of everything that was taken because the file is silent."""
    for name, field in type(model).model_fields.items():
        key = f"{prefix}{name}"
        value = getattr(model, name)
        if name not in model.model_fields_set and field.default not in (PydanticUndefined, None, (), {}):
            yield key, _shown(field.default)
        if isinstance(value, BaseModel):
            yield from _assumed(value, f"{key}.")
        elif isinstance(value, tuple):
            for index, item in enumerate(value):
                if isinstance(item, BaseModel):
                    yield from _assumed(item, f"{key}[{index}].")
        elif isinstance(value, dict):
            for entry, item in value.items():
                if isinstance(item, BaseModel):
                    yield from _assumed(item, f"{key}.{entry}.")


def _unpublished(taken: tuple[Taken, ...]) -> dict[str, str]:
    """Key path and value of everything that comes from a component and that nobody published."""
    return {key: value for one in taken for key, value in one.assumed()}


def _shown(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_shown, value))}]"
    return str(value)
