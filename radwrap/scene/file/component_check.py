"""What is wrong with a component: keys, sources, bases, and totals that do not follow from its numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from radwrap.errors import InputError
from radwrap.scene.catalog.component import UNSOURCED, Component, Entry
from radwrap.scene.catalog.totals import Total, totals_of
from radwrap.scene.file import material_tables as materials
from radwrap.scene.file import source_tables as sources
from radwrap.scene.file.border import Model
from radwrap.scene.file.document import DistortionModel
from radwrap.scene.file.faults import validated
from radwrap.scene.file.optics_tables import LensModel, TransmissionModel
from radwrap.scene.file.sensor_tables import LinearSensorModel, SensorModel
from radwrap.units import LENGTH, dimension_of, parse_quantity

_MATERIALS: Final[Mapping[str, type[Model]]] = {
    "specular": materials.SpecularModel,
    "glass": materials.GlassModel,
}
_LIGHTS: Final[Mapping[str, type[Model]]] = {
    "led": sources.LedModel,
    "lamp": sources.LampModel,
    "disc": sources.DiscSourceModel,
    "ring": sources.RingModel,
    "rectangle": sources.RectangleSourceModel,
    "area_ring": sources.AreaRingModel,
    "dome": sources.DomeModel,
    "coaxial": sources.CoaxialModel,
    "surround": sources.SurroundModel,
}
# What a scene says of any source, and a component does not.
_PLACED: Final = {"name": "one", "position": ["0 mm", "0 mm", "0 mm"], "look_at": ["0 mm", "0 mm", "1 mm"]}


@dataclass(frozen=True, slots=True)
class Checked:
    """What was found of a component.

    Attributes
    ----------
    problems : tuple of str
        What is wrong, with file and key; empty where nothing is.
    totals : tuple of Total
        Published totals, computed anew.
    bases : Mapping[str, int]
        Basis -> how many keys have it.
    """

    problems: tuple[str, ...]
    totals: tuple[Total, ...]
    bases: Mapping[str, int]


def check_component(component: Component) -> Checked:
    """Look at all that a component says.

    Parameters
    ----------
    component : Component
        As `read_component` gave it.
    """
    where = f"{component.kind}/{component.path.name}"
    problems = [*_of_keys(component, where), *_of_entries(component, where), *_of_sources(component, where)]
    if not problems:
        problems += _of_ranges(component, where)
    totals: tuple[Total, ...] = ()
    try:
        totals = totals_of(component, where)
    except InputError as error:
        problems.append(str(error))
    problems += [
        f"{where}: catalog.published.{total.key}: {total.published} is {total.difference_db:+.1f} dB off "
        f"{total.computed:.4g}, which follows from the keys; {total.allowed_db:.2f} dB are allowed"
        for total in totals
        if not total.agrees
    ]
    bases = [entry.basis for entry in component.entries.values()]
    return Checked(tuple(problems), totals, {basis: bases.count(basis) for basis in dict.fromkeys(bases)})


def _of_keys(component: Component, where: str) -> Iterator[str]:
    """What a scene that names it would say of its keys."""
    values = dict(component.values)
    try:
        match component.kind:
            case "sensors":
                validated(LinearSensorModel if values.get("model") == "linear" else SensorModel, values, where)
            case "lenses":
                if "focal_length" in values and not parse_quantity(values.pop("focal_length"), LENGTH) > 0:
                    raise InputError("must be above zero", where=f"{where}: focal_length")
                if "distortion" in values:
                    validated(DistortionModel, values.pop("distortion"), f"{where}: distortion")
                validated(LensModel, values | {"focus_distance": "1 km"}, where)
            case "sheetings":
                validated(materials.RetroreflectiveModel, {"type": "retroreflective"} | values, where)
            case "materials":
                validated(_shape(_MATERIALS, values, where), values, where)
            case "filters":
                validated(TransmissionModel, values, where)
            case _:
                shape = sources.LampModel if component.kind == "lamps" else _shape(_LIGHTS, values, where)
                placed = {key: value for key, value in _PLACED.items() if key in shape.model_fields}
                kind = {"type": "lamp"} if component.kind == "lamps" else {}
                validated(shape, {**placed, **kind, **values}, where)
    except InputError as error:
        yield str(error)


def _shape(known: Mapping[str, type[Model]], values: Mapping[str, Any], where: str) -> type[Model]:
    found = known.get(str(values.get("type")))
    if found is None:
        raise InputError(f"must be one of {', '.join(known)}", where=f"{where}: type")
    return found


def _of_entries(component: Component, where: str) -> Iterator[str]:
    told = {key for key in component.values if key not in UNSOURCED}
    for key in sorted(told - component.entries.keys()):
        yield f"{where}: {key}: nothing in catalog.from says where it comes from"
    for key in sorted(component.entries.keys() - told):
        yield f"{where}: catalog.from.{key}: the file has no such key"
    known = component.catalog.get("sources", {})
    for key, entry in component.entries.items():
        place = f"{where}: catalog.from.{key}"
        if entry.source and entry.source not in known:
            yield f'{place}: catalog.sources has no "{entry.source}"'
        yield from (f"{place}: {what}" for what in _missing(entry))


def _of_ranges(component: Component, where: str) -> Iterator[str]:
    """Both ends of a range are values that a scene takes, in their order, and the value lies between them."""
    for key, entry in component.entries.items():
        if entry.range is None or key not in component.values:
            continue
        place = f"{where}: catalog.from.{key}.range"
        wrong = [
            problem
            for end in entry.range
            for problem in _of_keys(replace(component, values={**component.values, key: end}), place)
        ]
        yield from wrong[:1]
        low, value, high = (_number(one) for one in (entry.range[0], component.values[key], entry.range[1]))
        if not wrong and low is not None and value is not None and high is not None and not low <= value <= high:
            yield f"{place}: {component.values[key]} does not lie between its ends"


def _number(value: Any) -> float | None:
    """Of a value that a scene takes, with its unit or without; None of what is no number."""
    if not isinstance(value, str):
        return float(value) if isinstance(value, int | float) else None
    dimension = dimension_of(value)
    return None if dimension is None else parse_quantity(value, dimension)


def _missing(entry: Entry) -> Iterator[str]:
    if entry.basis == "measured" and not entry.source:
        yield "what was measured needs its source"
    if entry.basis != "measured" and not (entry.source or entry.note or entry.where):
        yield f"what is {entry.basis} needs a note or a source"


def _of_sources(component: Component, where: str) -> Iterator[str]:
    known = component.catalog.get("sources", {})
    if not isinstance(known, dict):
        yield f"{where}: catalog.sources: must be a table"
        return
    for name, source in known.items():
        if not isinstance(source, dict) or not (source.get("url") or source.get("citation")):
            yield f"{where}: catalog.sources.{name}: needs url or citation"
