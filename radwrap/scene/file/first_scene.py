"""A first scene of a part, from components of the catalog: the part fills most of the field, and light falls on it.

The world's frame: z = 0 is the ground, the camera looks down from above, the
part's middle is on its axis. A thin lens magnifies by f/(s - f) at its plane
of focus, which is laid through the part's top.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from radwrap.errors import InputError
from radwrap.scene.catalog.component import Component
from radwrap.units import (
    LENGTH,
    LUMINANCE,
    LUMINOUS_FLUX,
    LUMINOUS_INTENSITY,
    RADIANCE,
    RADIANT_FLUX,
    RADIANT_INTENSITY,
    Dimension,
    parse_quantity,
)

FILLED: Final = 0.8  # of the field, by the part
GROUND_REFLECTANCE: Final = 0.1
PART_REFLECTANCE: Final = 0.5
_CLEAR: Final = 0.002  # of the part's size, between it and the ground
_AROUND: Final = 1.3  # ground beyond the field of view
_INSIDE_DOME: Final = 0.9  # of its radius, that ground may reach
_IRRADIANCE_ERROR: Final = 0.02
_BESIDE: Final = 1.1  # of what a light beside the camera's cone of light must keep away


@dataclass(frozen=True, slots=True)
class Part:
    """A part's file and its box.

    Attributes
    ----------
    file : str
        Name beside the scene.
    unit : str or None
        What a length of 1 in the file is, None where the file says it.
    low, high : tuple of float
        Corners of its box in the file's frame [m].
    """

    file: str
    unit: str | None
    low: tuple[float, float, float]
    high: tuple[float, float, float]

    @property
    def size(self) -> tuple[float, float, float]:
        """Lengths of the box [m]."""
        x, y, z = (high - low for low, high in zip(self.low, self.high, strict=True))
        return x, y, z


@dataclass(frozen=True, slots=True)
class ChosenLight:
    """A light, and its level as the user wrote it; None where the file's is taken."""

    component: Component
    level: str | None = None


@dataclass(frozen=True, slots=True)
class Field:
    """What the camera sees.

    Attributes
    ----------
    distance : float
        From the lens to the part's top [m].
    half_diagonal : float
        Of the field in that plane [m].
    opening : float
        Radius of the lens' opening [m].
    top : float
        Height of that plane [m].
    turned : bool
        Whether the image's columns run along the world's y.
    size : tuple of float
        Field along the world's x and y [m].
    """

    distance: float
    half_diagonal: float
    opening: float
    top: float
    turned: bool
    size: tuple[float, float]

    def radius(self, height: float) -> float:
        """Of the cone of light that the lens takes, at a height above the part's top [m]."""
        share = min(height / self.distance, 1.0)
        return self.half_diagonal * (1 - share) + self.opening * share


def first_scene(
    part: Part, sensor: Component, lens: Component, lights: Sequence[ChosenLight], exposure_time: float
) -> dict[str, Any]:
    """Tables of a scene.

    Parameters
    ----------
    part : Part
        What is looked at.
    sensor, lens : Component
        The camera's.
    lights : sequence of ChosenLight
        At least one.
    exposure_time : float
        [s].

    Raises
    ------
    InputError
        If a light cannot stand where the camera does not see it, or the part has no area.
    """
    field = _field(part, sensor, lens)
    clear = _CLEAR * max(part.size)
    behind = any(light.component.catalog.get("mount") == "behind" for light in lights)
    sources = [_source(light, number, field, part) for number, light in enumerate(lights, 1)]
    x, y = (-(low + high) / 2 for low, high in zip(part.low[:2], part.high[:2], strict=True))
    tables: dict[str, Any] = {
        "title": f"{part.file} under {', '.join(light.component.name for light in lights)}",
        "camera": {
            "position": _point(0, 0, field.top + field.distance),
            "look_at": _point(0, 0, 0),
            "up": [-1.0, 0.0, 0.0] if field.turned else [0.0, 1.0, 0.0],
            "exposure_time": f"{exposure_time * 1e3:.4g} ms",
            "lens": {"preset": lens.name, "focus_distance": _mm(field.distance)},
            "sensor": {"preset": sensor.name},
        },
        "sources": sources,
        "materials": {"part": {"type": "lambertian", "reflectance": PART_REFLECTANCE}},
        "targets": [
            {
                "name": "part",
                "part": part.file,
                **({} if part.unit is None else {"length_unit": part.unit}),
                "material": "part",
                "position": _point(x, y, clear - part.low[2]),
            }
        ],
    }
    if not behind:
        tables["materials"]["ground"] = {"type": "lambertian", "reflectance": GROUND_REFLECTANCE}
        widest = (field.distance + field.top) / field.distance
        size = [_AROUND * widest * length for length in field.size]
        tables["targets"].insert(
            0, {"type": "sheet", "name": "ground", "material": "ground", "size": [_mm(length) for length in size]}
        )
    return tables


def _field(part: Part, sensor: Component, lens: Component) -> Field:
    """Where the camera stands, so that the part fills the field: turned by 90 degrees where that shows more of it."""
    values = sensor.values
    width = values["columns"] * _length(values["pixel_width"])
    height = values["rows"] * _length(values["pixel_height"])
    x, y, thick = part.size
    if not (x > 0 and y > 0):
        raise InputError("has no area from above", where="part", remedy="turn the mesh: the camera looks along -z")
    straight, turned = min(width / x, height / y), min(width / y, height / x)
    magnification = FILLED * max(straight, turned)
    focal_length = _length(lens.values["focal_length"])
    opening = focal_length / float(lens.values["f_number"]) / 2
    is_turned = turned > straight
    size = (height, width) if is_turned else (width, height)
    return Field(
        distance=focal_length * (1 + 1 / magnification),
        half_diagonal=math.hypot(width, height) / magnification / 2,
        opening=opening,
        top=thick + _CLEAR * max(part.size),
        turned=is_turned,
        size=(size[0] / magnification, size[1] / magnification),
    )


def _source(light: ChosenLight, number: int, field: Field, part: Part) -> dict[str, Any]:
    """A light where it belongs: over the camera's cone of light, beside it, behind the part, or around it."""
    one = light.component
    kind = "lamp" if one.kind == "lamps" else str(one.values["type"])
    table: dict[str, Any] = {"type": kind, "name": f"light{number}", "preset": one.name}
    if light.level is not None:
        table[_level_key(light.level, one)] = light.level
    if kind in ("rectangle", "area_ring", "dome", "coaxial"):
        table["irradiance_error"] = _IRRADIANCE_ERROR
    distance = _length(one.catalog["distance"]) if "distance" in one.catalog else field.distance
    target = _point(0, 0, field.top)
    match one.catalog.get("mount", "side"):
        case "above":
            outside = _length(one.values.get("inner_diameter", one.values["diameter"]))
            led = _length(one.values["led_diameter"]) if "led_diameter" in one.values else 0.0
            clear = (outside - led) / 2
            height = distance if clear > _BESIDE * field.radius(distance) else field.distance
            if not clear > _BESIDE * field.radius(height):
                raise _in_the_way(one, number)
            return table | {"position": _point(0, 0, field.top + height), "look_at": target}
        case "behind":
            return table | {"position": _point(0, 0, -distance), "look_at": _point(0, 0, 0)}
        case "around":
            radius, hole = _length(one.values["diameter"]) / 2, _length(one.values["opening_diameter"]) / 2
            reach = max(math.hypot(*part.size[:2]) / 2, field.top)
            if not reach < _INSIDE_DOME * radius:
                raise InputError(
                    f"the part does not fit into {one.name}", where=f"light={one.name}", remedy="take a larger dome"
                )
            if not hole > _BESIDE * field.radius(max(radius + distance - field.top, 0.0)):
                raise _in_the_way(one, number)
            return table | {"position": _point(0, 0, distance), "look_at": _point(0, 0, 0)}
        case "axis":
            return table
        case _:
            away = max(distance / math.sqrt(2), _BESIDE * (field.half_diagonal + _largest(one)))
            place = {"position": _point(-away, 0, field.top + away), "look_at": target}
            return table | place | ({"up": [0.0, 0.0, 1.0]} if kind == "rectangle" else {})


def _in_the_way(one: Component, number: int) -> InputError:
    return InputError(
        f"light {number} would stand before the camera: the field does not pass its opening",
        where=f"light={one.name}",
        remedy="take a larger one, or a lens of longer focal length",
    )


def _largest(one: Component) -> float:
    told = one.values.get("size", [one.values.get("diameter", "0 mm")])
    return max(map(_length, told)) / 2


def _level_key(level: str, one: Component) -> str:
    """Which level of a source a unit means."""
    unit = level.partition(" ")[2]
    key = _UNITS.get(unit)
    if key is None:
        raise InputError(
            f'"{level}" is not a level of a light', where=f"light={one.name}", remedy=f"units: {', '.join(_UNITS)}"
        )
    return key


_DIMENSIONS: Final[Mapping[str, Dimension]] = {
    "radiance": RADIANCE,
    "radiant_intensity": RADIANT_INTENSITY,
    "radiant_flux": RADIANT_FLUX,
    "luminance": LUMINANCE,
    "luminous_intensity": LUMINOUS_INTENSITY,
    "luminous_flux": LUMINOUS_FLUX,
}
_UNITS: Final = {unit: key for key, dimension in _DIMENSIONS.items() for unit in dimension.units}


def _length(text: Any) -> float:
    return parse_quantity(str(text), LENGTH)


def _mm(length: float) -> str:
    return f"{round(length * 1e3, 4):.10g} mm"


def _point(x: float, y: float, z: float) -> list[str]:
    return [_mm(value + 0.0) for value in (x, y, z)]
