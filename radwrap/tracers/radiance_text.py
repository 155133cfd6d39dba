"""A scene as Radiance text: deterministic, readable, commented.

Lengths are in mm and radiances in W m^-2 sr^-1 unless the header says another
unit. Not in m: Radiance takes a point for inside a polygon where the product
of a side's length and the point's distance from it is below 1e-6 square units,
which makes a turned sheet of 5 mm 0.2 mm wider on each side, if written in m.
It also loses radii below 1e-6 units, and light below 1e-6.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from radwrap.errors import InputError
from radwrap.frames import Vector
from radwrap.scene.materials import Material
from radwrap.scene.scene import Scene
from radwrap.scene.sources import Emitter, Luminaire, Patch, Source, TableBeam, WideSource, emitters
from radwrap.scene.targets import (
    DiscShape,
    MeshShape,
    PolygonShape,
    Sheet,
    SphereShape,
    Surface,
    Target,
    TubeShape,
    surfaces,
)
from radwrap.tracers.radiance_materials import (
    FUNCTIONS,
    MEASURED,
    Placement,
    data_files,
    described,
    functions_beside,
    number,
    primitive,
)

_MILLIMETRE: Final = 1e-3
# Polygon sides of at least 1 unit keep a polygon's border within 1e-6 units, and radii stay far from 1e-6 units.
_SHORTEST_SIDE: Final = 1.0
_SMALLEST_RADIUS: Final = 1e-3
# Radiances outside this range are scaled by a power of ten for the tracer.
_RADIANCE_RANGE: Final = (1.0, 1e6)
# In the text's unit: below, Radiance takes a source for dark (its limit is 1e-6), above, it overflows (1e39).
_DARKEST: Final = 1e-5
_BRIGHTEST: Final = 1e30


@dataclass(frozen=True, slots=True)
class Scales:
    """What the text's numbers are multiplied by to be SI.

    Attributes
    ----------
    length : float
        One unit of length in the text [m].
    radiance : float
        One unit of radiance in the text [W m^-2 sr^-1].
    """

    length: float = _MILLIMETRE
    radiance: float = 1.0


@dataclass(frozen=True, slots=True)
class RadianceScene:
    """Text for oconv and the files that belong beside it.

    Attributes
    ----------
    text : str
        The scene.
    files : Mapping[str, bytes]
        Relative name -> content of function and data files.
    scales : Scales
        Units of the text.
    """

    text: str
    files: Mapping[str, bytes]
    scales: Scales


def scales_of(scene: Scene) -> Scales:
    """Units in which Radiance can hold the scene.

    Raises
    ------
    InputError
        If the sources differ by more than Radiance can hold.
    """
    length = _MILLIMETRE
    for size, least in _sizes(scene):
        while size < least * length:
            length /= 1000
    return Scales(length, _radiance_scale(scene))


def _radiance_scale(scene: Scene) -> float:
    radiances = [emitter.radiance for emitter in scene.emitters if emitter.radiance > 0]
    if not radiances:
        return 1.0
    brightest, darkest = max(radiances), min(radiances)
    low, high = _RADIANCE_RANGE
    scale = 1.0
    if not scene.included and not low <= brightest <= high:
        scale = 10.0 ** (math.floor(math.log10(brightest)) - 3)
    if darkest / scale < _DARKEST or brightest / scale > _BRIGHTEST:
        raise InputError(
            f"sources from {darkest:g} to {brightest:g} W/m^2/sr cannot be traced together",
            where=f"{scene.origin}: sources",
            remedy="render them one by one",
        )
    return scale


def _sizes(scene: Scene) -> Iterator[tuple[float, float]]:
    """Sizes in the scene [m], and how many units of length each must have."""
    for emitter in scene.emitters:
        # A patch's border may be off by more than a target's: its area does not come from where rays end.
        yield emitter.radius, _SMALLEST_RADIUS
    for surface in scene.surfaces:
        match surface.shape:
            case PolygonShape(vertices):
                following = vertices[1:] + vertices[:1]
                yield min(math.dist(a, b) for a, b in zip(vertices, following, strict=True)), _SHORTEST_SIDE
            case TubeShape(start, end, radius):
                yield min(radius, math.dist(start, end)), _SMALLEST_RADIUS
            case MeshShape(corners, _):
                # A mesh knows no shortest side: its corners lie on a grid of 2^-32 of its size.
                yield float((corners.max(axis=0) - corners.min(axis=0)).max()), _SHORTEST_SIDE
            case DiscShape() | SphereShape():
                yield surface.shape.radius, _SMALLEST_RADIUS


def scene_text(
    scene: Scene,
    included: Mapping[str, str],
    files_beside: Mapping[str, bytes],
    stem: str = "scene",
    *,
    only: str | None = None,
) -> RadianceScene:
    """Write a scene for Radiance.

    Parameters
    ----------
    scene : Scene
        What is there.
    included : Mapping[str, str]
        Target name -> checked Radiance text of an included file, already
        moved to its pose, in this text's length unit.
    files_beside : Mapping[str, bytes]
        Files that the included texts need.
    stem : str
        What the names of function and data files begin with, so that texts of
        different stems can lie in one folder.
    only : str, optional
        Name of the one source or LED that shines; the others are black then. Default all.

    Returns
    -------
    RadianceScene
        Text and files; in the text later surfaces lie on top of earlier ones in the same plane.
    """
    scales = scales_of(scene)
    functions, own = function_file(stem)
    beside = {**files_beside, **own}
    parts = [_header(functions, scales)]
    for file in scene.included:
        parts.append(f"# {file.name}: included {file.file}\n\n{included[file.name]}")
    for emitter in scene.emitters:
        parts.append(_emitter(emitter, stem, scales, shines=only in {None, emitter.source}))
        beside.update(_beam_files(stem, emitter))
    parts += [_background(sky, scales) for sky in scene.sources if _is_sky(sky) and only in {None, sky.name}]
    for name, material in scene.materials.items():
        beside.update(data_files(f"{stem}.{name}", functions, material))
    for target in scene.targets:
        parts += _target(target, scene.materials, stem, scales)
    return RadianceScene("\n".join(parts), beside, scales)


def function_file(stem: str) -> tuple[str, dict[str, bytes]]:
    """Name and content of the file of radwrap's functions, for texts of that stem."""
    return f"{stem}.{FUNCTIONS}", functions_beside(stem, FUNCTIONS)


def mesh_file(stem: str, surface: str) -> str:
    """Name of the file that holds a surface's triangles, made by obj2mesh."""
    return f"{stem}.{surface}.rtm"


def obj_text(shape: MeshShape, scales: Scales) -> bytes:
    """Triangles for obj2mesh, in the text's unit."""
    unit = round(1 / scales.length)
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in (shape.vertices * unit).tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (shape.faces + 1).tolist()]
    return ("\n".join(lines) + "\n").encode()


def identity_text(scene: Scene, included: Mapping[str, str], stem: str = "scene") -> tuple[str, tuple[str, ...]]:
    """The same geometry, each part of each target glowing with its own number.

    Returns
    -------
    text : str
        Radiance text without light.
    parts : tuple of str
        Names such as "board.dots"; the first has the number 1.
    """
    scales = scales_of(scene)
    parts: list[str] = []
    texts = []
    for file in scene.included:
        parts.append(file.name)
        texts.append(f"{_glow(file.name, len(parts))}\n{included[file.name]}")
    for source in scene.sources:
        parts.append(source.name)
        texts.append(_glow(source.name, len(parts)))
        texts += [_shining_surface(source.name, emitter, scales) for emitter in emitters(source)]
    for target in scene.targets:
        for surface in surfaces(target):
            part = f"{target.name}.{surface.part}"
            if part not in parts:
                parts.append(part)
                texts.append(_glow(part, len(parts)))
            texts.append(_geometry(surface, part, scales, stem))
    return "\n".join(texts), tuple(parts)


def _glow(name: str, number: int) -> str:
    return primitive("void", "glow", name, (number, number, number, 0))


def _header(functions: str, scales: Scales) -> str:
    length = "mm" if scales.length == _MILLIMETRE else f"{scales.length:g} m"
    lines = [f"Radiance scene written by radwrap; see {functions} for its functions.", f"Lengths in {length},"]
    if scales.radiance == 1.0:
        lines[-1] += " radiances in W/m^2/sr."
    else:
        lines[-1] += f" radiances in {scales.radiance:g} W/m^2/sr: multiply what is rendered by it."
    return "".join(f"# {line}\n" for line in lines)


def _scaled(scales: Scales, *points: Vector) -> tuple[float, ...]:
    return tuple(_units(value, scales) for point in points for value in point)


def _units(length: float, scales: Scales) -> float:
    """A length in the text's unit; multiplied by the inverse, which is a whole number, so that 12.5 mm stays 12.5."""
    return length * round(1 / scales.length)


def _ring(centre: Vector, normal: Vector, radius: float, scales: Scales) -> tuple[float, ...]:
    return (*_scaled(scales, centre), *normal, 0.0, _units(radius, scales))


def _emitter(emitter: Emitter, stem: str, scales: Scales, *, shines: bool = True) -> str:
    functions = f"{stem}.{FUNCTIONS}"
    intensity = f"{emitter.radiant_intensity:g} W/sr on its axis"
    if emitter.radiance == 0:
        return f"# {emitter.name}: dark, left out\n"
    if not shines:
        # Not a light of radiance 0, which Radiance leaves out with a warning; the disc still hides what is behind it.
        black = primitive("void", "plastic", f"{emitter.name}.dark", (0, 0, 0, 0, 0))
        return f"# {emitter.name}: off\n{black}" + _shining_surface(f"{emitter.name}.dark", emitter, scales)
    text = f"# {emitter.name}: {intensity}, {emitter.beam.profile}\n"
    words: tuple[str, ...] = ()
    modifier = "void"
    if isinstance(emitter, Luminaire):
        modifier = f"{emitter.name}.beam"
        words = ("as_told", _beam_data(stem, emitter), f"{stem}.{MEASURED}", "lamp_azimuth_deg", "lamp_polar_deg")
        axes = (*emitter.x_axis, *emitter.y_axis, *emitter.axis)
        text += primitive("void", "brightdata", modifier, axes, words)
    elif isinstance(emitter.beam, TableBeam):
        modifier = f"{emitter.name}.beam"
        words = ("table_beam", _beam_data(stem, emitter), f"{stem}.{MEASURED}", "table_deg")
        text += primitive("void", "brightdata", modifier, (emitter.beam.spread,), words)
    elif emitter.beam.profile != "lambertian":
        modifier = f"{emitter.name}.beam"
        words = (f"{emitter.beam.profile}_beam", functions)
        text += primitive("void", "brightfunc", modifier, (emitter.beam.spread,), words)
    radiance = emitter.radiance / scales.radiance
    text += primitive(modifier, "light", f"{emitter.name}.light", (radiance, radiance, radiance))
    return text + _shining_surface(f"{emitter.name}.light", emitter, scales)


def _beam_data(stem: str, emitter: Emitter) -> str:
    return f"{stem}.{emitter.source}.beam.dat"


def _beam_files(stem: str, emitter: Emitter) -> dict[str, bytes]:
    """The data file of a measured beam: even steps, for which Radiance needs no list of angles."""
    if isinstance(emitter, Luminaire):
        rows = emitter.table.rows
        if len(rows) == 1:
            rows = (rows[0], rows[0])
        head = f"2\n0 360 {len(rows)}\n0 180 {len(rows[0])}\n"
    elif isinstance(emitter.beam, TableBeam):
        rows = (emitter.beam.values,)
        head = f"1\n0 90 {len(rows[0])}\n"
    else:
        return {}
    lines = "".join(" ".join(map(number, row)) + "\n" for row in rows)
    return {_beam_data(stem, emitter): (head + lines).encode(), **functions_beside(stem, MEASURED)}


def _is_sky(source: Source) -> bool:
    return isinstance(source, WideSource) and source.kind == "surround" and source.radiance > 0


def _background(sky: Source, scales: Scales) -> str:
    """What is seen between a surround's flat patches; a glow of no radius lights nothing."""
    level = sky.patches[0].radiance / scales.radiance if isinstance(sky, WideSource) else 0.0
    name = f"{sky.name}.background"
    glow = primitive("void", "glow", f"{name}.glow", (level, level, level, 0.0))
    return f"# {name}\n{glow}" + primitive(f"{name}.glow", "source", name, (0.0, 0.0, 1.0, 360.0))


def _shining_surface(modifier: str, emitter: Emitter, scales: Scales) -> str:
    if isinstance(emitter, Luminaire):
        place = _scaled(scales, emitter.position)
        return primitive(modifier, "sphere", emitter.name, (*place, _units(emitter.radius, scales)))
    if isinstance(emitter, Patch):
        return primitive(modifier, "polygon", emitter.name, _scaled(scales, *emitter.corners))
    disc = _ring(emitter.position, emitter.axis, emitter.radius, scales)
    return primitive(modifier, "ring", emitter.name, disc)


def _target(target: Target, materials: Mapping[str, Material], stem: str, scales: Scales) -> Iterator[str]:
    written: set[str] = set()
    size = (target.width, target.height) if isinstance(target, Sheet) else (0.0, 0.0)
    place = Placement(target.pose, size, scales.length)
    for surface in surfaces(target):
        # Each part has its own copy of its material, defined just before its first surface: where two surfaces
        # share a plane, Radiance shows the one whose material was defined last.
        modifier = f"{surface.name.split('.')[0]}.{surface.part}"
        if modifier not in written:
            written.add(modifier)
            yield f"# {modifier}: {surface.material}\n" + described(
                modifier, f"{stem}.{surface.material}", f"{stem}.{FUNCTIONS}", materials[surface.material], place
            )
        yield _geometry(surface, modifier, scales, stem)


def _geometry(surface: Surface, modifier: str, scales: Scales, stem: str) -> str:
    match surface.shape:
        case MeshShape():
            return primitive(modifier, "mesh", surface.name, (), (mesh_file(stem, surface.name),))
        case PolygonShape(vertices):
            return primitive(modifier, "polygon", surface.name, _scaled(scales, *vertices))
        case DiscShape(centre, normal, radius):
            return primitive(modifier, "ring", surface.name, _ring(centre, normal, radius, scales))
        case SphereShape(centre, radius):
            return primitive(modifier, "sphere", surface.name, (*_scaled(scales, centre), _units(radius, scales)))
        case TubeShape(start, end, radius):
            return primitive(modifier, "cylinder", surface.name, (*_scaled(scales, start, end), _units(radius, scales)))
