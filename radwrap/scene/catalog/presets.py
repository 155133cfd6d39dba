"""A scene's tables with the keys of the components that they name; what the scene says beside a name counts more."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from radwrap.errors import InputError
from radwrap.scene.catalog.component import UNSOURCED, Component
from radwrap.scene.catalog.places import find
from radwrap.units import LENGTH, parse_quantity

KEY: Final = "preset"
# A source tells its level by one of these, as a number and a unit.
LEVELS: Final = (
    *("radiance", "radiant_intensity", "radiant_flux"),
    *("luminance", "luminous_intensity", "luminous_flux"),
)
# Keys of a lens that a scene has in [camera] and not in [camera.lens].
_OF_CAMERA: Final = ("focal_length", "distortion")
_FALLOFF: Final = ("falloff", "relative_illumination")
_SAME_OPENING: Final = 0.02  # share by which F-numbers may differ: less than their steps on a lens
_EFFICIENCY: Final = ("quantum_efficiency", "quantum_efficiencies")
# Types of sources whose presets are no light with a housing.
_SOURCES: Final = {"lamp": "lamps", "led": "leds"}
# Types of materials that a preset may be of; of other types the key is unknown.
_MATERIALS: Final = {"specular": "materials", "glass": "materials", "retroreflective": "sheetings"}
# Where the scene lists these as assumed by their own words.
_TOLD_ELSEWHERE: Final = ("lamps", "sheetings")


@dataclass(frozen=True, slots=True)
class Taken:
    """A component that a scene names.

    Attributes
    ----------
    key : str
        Where the scene names it.
    component : Component
        What it names.
    used : tuple of str
        Keys that the scene takes from it.
    elsewhere : tuple of str
        Those of them that were measured at another wavelength than the scene's.
    """

    key: str
    component: Component
    used: tuple[str, ...]
    elsewhere: tuple[str, ...] = ()

    def place_of(self, key: str) -> str:
        """Path of the scene's table in which one of the component's keys stands."""
        return "camera" if self.component.kind == "lenses" and key in _OF_CAMERA else self.key.removesuffix(f".{KEY}")

    def assumed(self) -> Iterator[tuple[str, str]]:
        """Key path in the scene, and value, of all that is taken and that nobody published."""
        if self.component.kind in _TOLD_ELSEWHERE:
            return
        for key in self.used:
            table = self.place_of(key)
            entry = self.component.entries.get(key)
            if entry is not None and (entry.basis == "assumed" or key in self.elsewhere):
                value = f"measured at {entry.at}" if key in self.elsewhere else _shown(self.component.values[key])
                why = "scaled from there along another curve" if key in self.elsewhere else "which nobody measured"
                yield f"{table}.{key}", f"{value}: of the preset {self.component.name}, {why}"


def _shown(value: Any) -> Any:
    return "a table" if isinstance(value, list | Mapping) else value


def with_presets(
    document: Mapping[str, Any], origin: str, folder: Path | None
) -> tuple[Mapping[str, Any], tuple[Taken, ...]]:
    """The tables of a scene with the values of all components that they name, and these components.

    Parameters
    ----------
    document : Mapping
        A scene's tables, or a part of them.
    origin : str
        File, for messages.
    folder : Path, optional
        The scene's, where components are looked for first.

    Raises
    ------
    InputError
        If there is no such component, its file is damaged, or it is of another type.
    """
    whole: dict[str, Any] = dict(document)
    taken: list[Taken] = []

    def merged(table: Any, kind: str, key: str) -> Any:
        if not isinstance(table, dict) or KEY not in table:
            return table
        where = f"{origin}: {key}"
        component = find(kind, table[KEY], folder, f"{where}.{KEY}")
        values = _beside(component, table, where)
        used = tuple(name for name in values if name not in table)
        taken.append(Taken(f"{key}.{KEY}", component, used, _elsewhere(component, used, table)))
        return {**values, **table}

    camera = document.get("camera")
    if isinstance(camera, dict):
        changed = {**camera}
        if "sensor" in camera:
            changed["sensor"] = merged(camera["sensor"], "sensors", "camera.sensor")
        if "filter" in camera:
            changed["filter"] = merged(camera["filter"], "filters", "camera.filter")
        if isinstance(camera.get("lens"), dict) and KEY in camera["lens"]:
            component = find("lenses", camera["lens"][KEY], folder, f"{origin}: camera.lens.{KEY}")
            changed, used = _with_lens(changed, component, f"{origin}: camera")
            taken.append(Taken(f"camera.lens.{KEY}", component, used))
        whole["camera"] = changed
    sources = document.get("sources")
    if isinstance(sources, list):
        whole["sources"] = [merged(one, class_of_source(one), f"sources[{i}]") for i, one in enumerate(sources)]
    materials = document.get("materials")
    if isinstance(materials, dict):
        kinds = {name: _class_of_material(table) for name, table in materials.items()}
        whole["materials"] = {
            name: merged(table, kinds[name], f"materials.{name}") if kinds[name] else table
            for name, table in materials.items()
        }
    return whole, tuple(taken)


def naming_presets(document: Mapping[str, Any]) -> dict[str, Any]:
    """Of a scene's tables the names of presets, and what decides which class they are of."""

    def names(table: Any) -> dict[str, Any]:
        return {key: table[key] for key in (KEY, *UNSOURCED) if key in table} if isinstance(table, dict) else {}

    camera, sources, materials = (document.get(key) for key in ("camera", "sources", "materials"))
    parts = {part: names(camera.get(part)) for part in ("sensor", "lens", "filter")} if isinstance(camera, dict) else {}
    found = {
        "camera": {part: one for part, one in parts.items() if KEY in one},
        "sources": [one for one in map(names, sources) if KEY in one] if isinstance(sources, list) else [],
        "materials": {name: one for name, table in materials.items() if KEY in (one := names(table))}
        if isinstance(materials, dict)
        else {},
    }
    return {key: tables for key, tables in found.items() if tables}


def hashes_of(taken: Iterable[Taken]) -> dict[str, str]:
    """Class and name of components -> SHA-256 of their files."""
    return {f"{one.component.kind}/{one.component.name}": one.component.sha256 for one in taken}


def in_file(error: InputError, taken: Iterable[Taken], origin: str) -> InputError:
    """An error of a scene's key with the component's file for its place, where the scene takes the key from there.

    Parameters
    ----------
    error : InputError
        About some key of the scene.
    taken : iterable of Taken
        What the scene takes from the catalog.
    origin : str
        Name of the scene.
    """
    told = f"{error.where}: {error.what}"
    for one in taken:
        for key in one.used:
            place = f"{origin}: {one.place_of(key)}"
            if re.match(rf"{re.escape(place)}(\.|: ){re.escape(key)}\b", told):
                where = (
                    f"{origin}: {one.key}: {one.component.path}: {error.where.removeprefix(place).lstrip('.') or key}"
                )
                return InputError(error.what.removeprefix(f"{key}: "), where=where, remedy=error.remedy)
    return error


def class_of_source(table: Any) -> str:
    """Class of the catalog that the presets of a source's table are of."""
    kind = table.get("type") if isinstance(table, dict) else None
    return _SOURCES.get(kind, "lights") if isinstance(kind, str) else "lights"


def _class_of_material(table: Any) -> str:
    kind = table.get("type") if isinstance(table, dict) else None
    return _MATERIALS.get(kind, "") if isinstance(kind, str) else ""


def _elsewhere(component: Component, used: Iterable[str], table: Mapping[str, Any]) -> tuple[str, ...]:
    """Keys that were measured at a wavelength that is not the table's."""
    told = table.get("wavelength")
    if not isinstance(told, str):
        return ()
    try:
        asked = parse_quantity(told, LENGTH)
    except InputError:
        return ()  # reported with the key, later
    entries = component.entries
    at = {key: entries[key].at for key in used if key in entries and entries[key].at}
    return tuple(key for key, one in at.items() if not math.isclose(parse_quantity(one, LENGTH), asked, rel_tol=1e-9))


def _with_lens(camera: Mapping[str, Any], component: Component, where: str) -> tuple[dict[str, Any], tuple[str, ...]]:
    """A camera with the keys of a lens, some of which are the camera's own, and those that it takes."""
    values = dict(component.values)
    if not any(key in camera["lens"] for key in _FALLOFF):
        _check_opening(camera, component, where)
    if "diameter" in camera.get("aperture", {}):
        values.pop("f_number", None)
    if "calibration" in camera:  # which tells these
        values = {key: value for key, value in values.items() if key not in _OF_CAMERA}
    if any(key in camera["lens"] for key in _FALLOFF):
        values = {key: value for key, value in values.items() if key not in _FALLOFF}
    own = {key: value for key, value in values.items() if key in _OF_CAMERA}
    other = {key: value for key, value in values.items() if key not in _OF_CAMERA}
    used = (*(key for key in own if key not in camera), *(key for key in other if key not in camera["lens"]))
    return {**own, **camera, "lens": {**other, **camera["lens"]}}, used


def _check_opening(camera: Mapping[str, Any], component: Component, where: str) -> None:
    """Refuse an opening that is not the lens's own where its rims say what light the corners get."""
    values, told = component.values, camera["lens"].get("f_number")
    if "relative_illumination" not in values or "f_number" not in values:
        return
    key, diameter = "lens.f_number", camera.get("aperture", {}).get("diameter")
    if told is None and isinstance(diameter, str):
        key = "aperture.diameter"
        try:
            told = parse_quantity(values["focal_length"], LENGTH) / parse_quantity(diameter, LENGTH)
        except (InputError, ZeroDivisionError):
            return  # reported with the key, later
    if isinstance(told, int | float) and abs(told / values["f_number"] - 1) > _SAME_OPENING:
        raise InputError(
            f'is f/{told:.3g}, and the preset "{component.name}" knows what light the corners get at '
            f"f/{values['f_number']:g}",
            where=f"{where}.{key}",
            remedy='take the preset of your F-number, or give camera.lens.relative_illumination, or falloff = "cos4"',
        )


def _beside(component: Component, table: Mapping[str, Any], where: str) -> dict[str, Any]:
    """The component's keys without those that the scene tells in another way."""
    values = dict(component.values)
    for key in UNSOURCED:
        told = table.get(key)
        own = values.get(key, "power_law" if component.kind == "sensors" and key == "model" else told)
        if told is not None and component.kind != "sheetings" and told != own:
            kind = component.kind.removesuffix("s")
            raise InputError(f'preset: "{component.name}" is a {kind} of {key} "{own}"', where=where)
    if any(key in table for key in LEVELS):
        values = {key: value for key, value in values.items() if key not in LEVELS}
    if component.kind == "sensors":
        if "data_sheet" in table:
            raise InputError("is given beside preset", where=f"{where}.data_sheet", remedy="leave one of them out")
        if any(key in table for key in (*_EFFICIENCY, "filters")):
            values = {key: value for key, value in values.items() if key not in _EFFICIENCY}
    return values
