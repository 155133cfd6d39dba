"""The same scene in other words: scaled, in other units, in another order, of other parts, or otherwise lit.

Each function takes what was written and returns it rewritten, or None where
the scene holds nothing of the kind.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from invariance_relations.documents import (
    LEVELS,
    Table,
    Written,
    angle,
    changed,
    in_unit,
    length,
    lengths,
    metres,
    placed,
    radians,
    read_pose,
    scaled,
    write_pose,
)
from invariance_relations.drawing import obj_text
from radwrap.frames import Pose, to_world
from radwrap.units import LENGTH, RADIANCE, RADIANT_FLUX, RADIANT_INTENSITY, TIME

_LARGEST_SCALE: Final = 100.0
_MARGIN: Final = "10 mm"  # of boards that tell none: the one length that drawn scenes leave to its default
# Units of which one is a power of ten of the other, so that both are the same number.
_DECIMAL: Final = (
    (LENGTH, ("m", "cm", "mm", "um", "nm", "km")),
    (TIME, ("s", "ms", "us", "ns")),
    (RADIANCE, tuple(RADIANCE.units)),
    (RADIANT_INTENSITY, tuple(RADIANT_INTENSITY.units)),
    (RADIANT_FLUX, tuple(RADIANT_FLUX.units)),
)


def resized(written: Written, random: np.random.Generator) -> Written:
    """All lengths times one factor; intensities and fluxes times its square."""
    linear = written.camera["sensor"].get("model") == "linear"
    # A linear camera's pixels gather more light with their area: its quantum efficiency makes up for that, below 1.
    low = 0.0 if linear else -math.log(_LARGEST_SCALE)
    factor = math.exp(random.uniform(low, math.log(_LARGEST_SCALE)))

    def change(key: str, text: str) -> str:
        unit = text.split(" ")[1]
        if unit in LENGTH.units and key != "wavelength":
            return scaled(text, factor)
        if key in ("radiant_intensity", "radiant_flux"):
            return scaled(text, factor**2)
        return scaled(text, factor**-2) if key in ("kappa1", "luminous_efficacy") else text

    told = written.copied()
    for target in told.targets:
        if target["type"] == "board":
            target.setdefault("margin", _MARGIN)
    new = Written(changed(told.document, change), told.files)
    if linear:
        new.camera["sensor"]["quantum_efficiency"] /= factor**2
    return new


def in_other_units(written: Written, random: np.random.Generator) -> Written:
    """Each quantity in another unit that is a power of ten of its own."""

    def change(_: str, text: str) -> str:
        unit = text.split(" ")[1]
        for dimension, units in _DECIMAL:
            if unit in units:
                return in_unit(text, dimension, str(random.choice(units)))
        return text

    return Written(changed(written.document, change), dict(written.files))


def otherwise_posed(written: Written, random: np.random.Generator) -> Written:
    """Poses by rotation for look_at, in another order of turns, and other units of angles."""
    new = written.copied()
    for table in placed(new):
        order = str(random.choice(["xyz", "xzy", "yxz", "yzx", "zxy", "zyx"]))
        pose = read_pose(table)
        write_pose(table, pose)
        table["rotation"] = [angle(value) for value in angles_in_order(np.array(pose.rotation), order)]
        table["rotation_order"] = order

    def change(_: str, text: str) -> str:
        number, unit = text.split(" ")
        return f"{math.degrees(float(number)) * 60!r} arcmin" if unit == "rad" else text

    return Written(changed(new.document, change), new.files)


def angles_in_order(rotation: np.ndarray[Any, Any], order: str) -> tuple[float, float, float]:
    """Angles about the fixed axes x, y, z [rad], carried out in an order, that make a rotation."""
    first, second, third = ("xyz".index(axis) for axis in order)
    sign = 1.0 if (second - first) % 3 == 1 else -1.0
    about = [0.0, 0.0, 0.0]
    # The rotation is R_third R_second R_first, whose entry in the third row and first column is -+ sin(second).
    about[second] = math.asin(max(-1.0, min(1.0, -sign * rotation[third, first])))
    about[first] = math.atan2(sign * rotation[third, second], rotation[third, third])
    about[third] = math.atan2(sign * rotation[second, first], rotation[first, first])
    return about[0], about[1], about[2]


def materials_in_another_order(written: Written, _: np.random.Generator) -> Written | None:
    """Tables of the materials from the last to the first."""
    return _reversed(written, "materials")


def sources_in_another_order(written: Written, _: np.random.Generator) -> Written | None:
    """Tables of the sources from the last to the first."""
    return _reversed(written, "sources")


def targets_in_another_order(written: Written, _: np.random.Generator) -> Written | None:
    """Tables of the targets from the last to the first."""
    return _reversed(written, "targets")


def _reversed(written: Written, kind: str) -> Written | None:
    if len(written.document[kind]) < 2:
        return None
    new = written.copied()
    tables = new.document[kind]
    new.document[kind] = dict(reversed(tables.items())) if isinstance(tables, dict) else tables[::-1]
    return new


def split(written: Written, random: np.random.Generator) -> Written:
    """Any source as two of half the light in the same place; a rectangle as two halves side by side, now and then."""
    new = written.copied()
    source = new.sources[int(random.integers(0, len(new.sources)))]
    halves = [source, dict(source, name=f"{source['name']}b")]
    apart = random.random() < 0.5
    if source["type"] == "rectangle" and apart:
        _halve_rectangle(halves)
    elif source["type"] == "ring" and apart:
        _halve_ring(halves)
    else:
        _dim(halves, 0.5)
    new.sources.append(halves[1])
    return new


def _dim(sources: list[Table], factor: float) -> None:
    for source in sources:
        for key in LEVELS:
            if key in source:
                source[key] = scaled(source[key], factor)
        if "luminous_efficacy" in source:
            source["luminous_efficacy"] = scaled(source["luminous_efficacy"], 1 / factor)


def _halve_rectangle(halves: list[Table]) -> None:
    """Two rectangles of the same radiance, side by side."""
    pose = read_pose(halves[0])
    width, height = (metres(text) for text in halves[0]["size"])
    for half, side in zip(halves, (-width / 4, width / 4), strict=True):
        write_pose(half, Pose(to_world(pose, (side, 0.0, 0.0)), pose.rotation))
        half["size"] = lengths((width / 2, height))
        for key in ("radiant_intensity", "radiant_flux"):
            if key in half:
                half[key] = scaled(half[key], 0.5)


def _halve_ring(halves: list[Table]) -> None:
    """Every other LED in a ring of its own; a ring's level is that of each LED."""
    count, changes = halves[0]["count"], halves[0]["leds"]
    first = radians(halves[0]["first_angle"])
    for odd, half in enumerate(halves):
        half["count"] = count // 2
        half["first_angle"] = angle(first + 2 * math.pi * odd / count)
        half["leds"] = [dict(led, index=led["index"] // 2) for led in changes if led["index"] % 2 == odd]


def cut(written: Written, random: np.random.Generator) -> Written | None:
    """A sheet as two that meet at a line."""
    new = written.copied()
    prints = {name for name, table in new.materials.items() if table["type"] == "print"}
    sheet = next((t for t in new.targets if t["type"] == "sheet" and t["material"] not in prints), None)
    if sheet is None:
        return None
    pose = read_pose(sheet)
    sizes = [metres(text) for text in sheet["size"]]
    axis, share = int(random.integers(0, 2)), float(random.uniform(0.2, 0.8))
    whole = sizes[axis]
    pieces = [sheet, dict(sheet, name=f"{sheet['name']}b")]
    for piece, part, middle in zip(pieces, (share, 1 - share), ((share - 1) / 2, share / 2), strict=True):
        write_pose(piece, Pose(to_world(pose, _on_axis(axis, middle * whole)), pose.rotation))
        piece["size"] = lengths(part * whole if k == axis else size for k, size in enumerate(sizes))
    new.targets.append(pieces[1])
    return new


def _on_axis(axis: int, value: float) -> tuple[float, float, float]:
    return (value, 0.0, 0.0) if axis == 0 else (0.0, value, 0.0)


_CORNERS: Final = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
# Counter-clockwise seen from outside, corners numbered as above.
_FACES: Final = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


def box_as_mesh(written: Written, _: np.random.Generator) -> Written | None:
    """A box as twelve triangles of a file."""
    new = written.copied()
    box = next((target for target in new.targets if target["type"] == "box"), None)
    if box is None:
        return None
    half = [metres(text) / 2 * 1e3 for text in box.pop("size")]
    vertices = [[c * h for c, h in zip(corner, half, strict=True)] for corner in _CORNERS]
    faces = [list(f) for a, b, c, d in _FACES for f in ((a, b, c), (a, c, d))]
    new.files["box.obj"] = obj_text(vertices, faces)
    box |= {"type": "part", "part": "box.obj", "length_unit": "1 mm"}
    return new


def with_a_part_outside(written: Written, random: np.random.Generator) -> Written:
    """One more part, behind the camera and all lights, of any size from a micrometre to the scene's."""
    new = written.copied()
    pose = read_pose(new.camera)
    distance = math.dist(pose.position, [metres(text) for text in new.camera["look_at"]])
    away = distance * math.exp(random.uniform(math.log(1.5), math.log(20)))
    size = math.exp(random.uniform(math.log(1e-6), math.log(distance)))
    sides = [length(size), length(size * random.uniform(0.05, 1))]
    part: Table = {"name": "outside", "material": "outside_paint"}
    part["position"] = lengths(to_world(pose, (0.3 * distance, 0.1 * distance, -away)))
    part["rotation"] = [f"{value:.3f} deg" for value in random.uniform(-90, 90, 3)]
    kind = str(random.choice(["sheet", "box", "sphere"]))
    shape = {"diameter": sides[0]} if kind == "sphere" else {"size": sides if kind == "sheet" else [*sides, sides[0]]}
    new.targets.append(part | shape | {"type": kind})
    new.materials["outside_paint"] = {"type": "lambertian", "reflectance": 0.5}
    return new


def longer_and_dimmer(written: Written, _: np.random.Generator) -> Written:
    """Twice the exposure time, half of each source's light."""
    new = written.copied()
    new.camera["exposure_time"] = scaled(new.camera["exposure_time"], 2.0)
    _dim(new.sources, 0.5)
    return new


def unchanged(written: Written, _: np.random.Generator) -> Written:
    """The same scene."""
    return written.copied()
