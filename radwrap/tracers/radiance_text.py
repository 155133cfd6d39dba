"""A scene as Radiance text: deterministic, readable, commented.

No two surfaces share a place: dots and the far side of an edge are painted on
their board by its material, and sources that fill the same place are written
as one. Where surfaces are as near as 1e-6 units, Radiance shows the one whose
material was defined last, but rounding decides whether they are.

A material is described once, before the targets that have it, and names of
modifiers begin with what they are: "material.black", "light.lamp". Radiance
looks names up by their last 15 characters, mixed in a way that gives names
which differ only in the middle the same place: 80 000 such names took 20 s at
each start of rtrace.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace

from radwrap.frames import Vector
from radwrap.scene.look.superposed import superposed
from radwrap.scene.materials import Material
from radwrap.scene.scene import Scene
from radwrap.scene.sources import Emitter, Luminaire, Patch, TableBeam, WideSource, emitters
from radwrap.scene.targets import (
    DiscShape,
    DotBoard,
    EdgeTarget,
    MeshShape,
    PatternTarget,
    PolygonShape,
    SphereShape,
    Surface,
    Target,
    TubeShape,
    surfaces,
)
from radwrap.tracers.radiance_decals import painted, pattern_file, pattern_functions
from radwrap.tracers.radiance_materials import (
    FUNCTIONS,
    MEASURED,
    data_files,
    described,
    functions_beside,
    has_direction,
    number,
    placement,
    primitive,
)
from radwrap.tracers.text_frame import TextFrame


@dataclass(frozen=True, slots=True)
class RadianceScene:
    """Text for oconv and the files that belong beside it.

    Attributes
    ----------
    text : str
        The scene.
    files : Mapping[str, bytes]
        Relative name -> content of function and data files.
    frame : TextFrame
        Origin and units of the text.
    """

    text: str
    files: Mapping[str, bytes]
    frame: TextFrame


def scene_text(
    scene: Scene,
    included: Mapping[str, str],
    files_beside: Mapping[str, bytes],
    frame: TextFrame,
    stem: str = "scene",
    *,
    only: Collection[str] | None = None,
) -> RadianceScene:
    """Write a scene for Radiance.

    Parameters
    ----------
    scene : Scene
        What is there.
    included : Mapping[str, str]
        Target name -> checked Radiance text of an included file, already
        moved to its pose in this text's frame.
    files_beside : Mapping[str, bytes]
        Files that the included texts need.
    frame : TextFrame
        Origin and units of the text.
    stem : str
        What the names of function and data files begin with, so that texts of
        different stems can lie in one folder.
    only : collection of str, optional
        Names of the sources and LEDs that shine; the others are black then. Default all.

    Returns
    -------
    RadianceScene
        Text and files.
    """
    functions, own = function_file(stem)
    beside = {**files_beside, **own}
    parts = [_header(functions, frame)]
    for file in scene.included:
        parts.append(f"# {file.name}: included {file.file}\n\n{included[file.name]}")
    parts += [f"# {emitter.name}: dark, left out\n" for emitter in scene.emitters if emitter.radiance == 0]
    for group in superposed(scene.emitters):
        level = math.fsum(emitter.radiance for emitter in group if only is None or emitter.source in only)
        parts.append(_emitter(replace(group[0], radiance=level), stem, frame))
        beside.update(_beam_files(stem, group[0]))
    parts += _background([sky for sky in scene.surrounds if only is None or sky.name in only], frame)
    for name, material in scene.materials.items():
        beside.update(data_files(f"{stem}.{name}", functions, material))
    parts += _materials(scene, stem)
    for target in scene.targets:
        if isinstance(target, PatternTarget):
            beside[pattern_file(functions, target)] = pattern_functions(target)
        parts += _target(target, scene.materials, stem, frame)
    return RadianceScene("\n".join(parts), beside, frame)


def function_file(stem: str) -> tuple[str, dict[str, bytes]]:
    """Name and content of the file of radwrap's functions, for texts of that stem."""
    return _functions(stem), functions_beside(stem, FUNCTIONS)


def _functions(stem: str) -> str:
    return f"{stem}.{FUNCTIONS}"


def mesh_file(stem: str, surface: str) -> str:
    """Name of the file that holds a surface's triangles, made by obj2mesh."""
    return f"{stem}.{surface}.rtm"


def obj_text(shape: MeshShape, frame: TextFrame) -> bytes:
    """Triangles for obj2mesh, in the text's frame."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in frame.points(shape.vertices).tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (shape.faces + 1).tolist()]
    return ("\n".join(lines) + "\n").encode()


def identity_text(
    scene: Scene, included: Mapping[str, str], frame: TextFrame, stem: str = "scene"
) -> tuple[str, tuple[str, ...]]:
    """The same geometry, each part of each target glowing with its own number.

    Returns
    -------
    text : str
        Radiance text without light.
    parts : tuple of str
        Names such as "board.dots"; the first has the number 1.
    """
    shown = {group[0].name for group in superposed(scene.emitters)}
    parts: list[str] = []
    texts = []
    for file in scene.included:
        parts.append(file.name)
        texts.append(f"{_glow(file.name, len(parts))}\n{included[file.name]}")
    for source in scene.sources:
        parts.append(source.name)
        glow = _part(len(parts))
        texts.append(_glow(glow, len(parts)))
        texts += [_shining_surface(glow, emitter, frame) for emitter in emitters(source) if emitter.name in shown]
    for target in scene.targets:
        pieces = surfaces(target)
        modifiers = {}
        for part in dict.fromkeys(surface.part for surface in pieces):
            parts.append(f"{target.name}.{part}")
            modifiers[part] = _part(len(parts))
            texts.append(_glow(modifiers[part], len(parts)))
        texts += _geometry(target, pieces, modifiers, frame, stem)
    return "\n".join(texts), tuple(parts)


def _part(number: int) -> str:
    """What glows with a number; names that end in binary have no place in common where Radiance looks them up."""
    return f"part.{number:b}"


def _glow(name: str, number: int) -> str:
    return primitive("void", "glow", name, (number, number, number, 0))


def _header(functions: str, frame: TextFrame) -> str:
    length = "mm" if frame.in_millimetres else f"{frame.length:g} m"
    lines = [f"Radiance scene written by radwrap; see {functions} for its functions.", f"Lengths in {length},"]
    if frame.radiance == 1.0:
        lines[-1] += " radiances in W/m^2/sr."
    else:
        lines[-1] += f" radiances in {frame.radiance:g} W/m^2/sr: multiply what is rendered by it."
    if any(frame.origin):
        lines.append(f"The origin lies at {' '.join(map(number, frame.origin))} m in the world.")
    return "".join(f"# {line}\n" for line in lines)


def _placed(frame: TextFrame, *points: Vector) -> tuple[float, ...]:
    return tuple(value for point in points for value in frame.point(point))


def _ring(centre: Vector, normal: Vector, radius: float, frame: TextFrame) -> tuple[float, ...]:
    return (*_placed(frame, centre), *normal, 0.0, radius * frame.units)


def _emitter(emitter: Emitter, stem: str, frame: TextFrame) -> str:
    intensity = f"{emitter.radiant_intensity:g} W/sr on its axis"
    if emitter.radiance == 0:
        # Not a light of radiance 0, which Radiance leaves out with a warning; the disc still hides what is behind it.
        black = primitive("void", "plastic", f"dark.{emitter.name}", (0, 0, 0, 0, 0))
        return f"# {emitter.name}: off\n{black}" + _shining_surface(f"dark.{emitter.name}", emitter, frame)
    modifier, pattern = _pattern(emitter, stem)
    text = f"# {emitter.name}: {intensity}, {emitter.beam.profile}\n{pattern}"
    radiance = emitter.radiance / frame.radiance
    text += primitive(modifier, "light", f"light.{emitter.name}", (radiance, radiance, radiance))
    return text + _shining_surface(f"light.{emitter.name}", emitter, frame)


def _pattern(emitter: Emitter, stem: str) -> tuple[str, str]:
    """Name and text of what modifies an emitter's light by its direction; "void" where it is Lambertian."""
    name = f"beam.{emitter.name}"
    if isinstance(emitter, Luminaire):
        words = ("as_told", _beam_data(stem, emitter), f"{stem}.{MEASURED}", "lamp_azimuth_deg", "lamp_polar_deg")
        return name, primitive("void", "brightdata", name, (*emitter.x_axis, *emitter.y_axis, *emitter.axis), words)
    beam = emitter.beam
    match beam.profile:
        case "lambertian":
            return "void", ""
        case "table":
            table = ("table_beam", _beam_data(stem, emitter), f"{stem}.{MEASURED}", "table_deg")
            return name, primitive("void", "brightdata", name, (beam.spread,), table)
        case "gaussian" | "cosine_power" | "cone":
            function = (f"{beam.profile}_beam", f"{stem}.{FUNCTIONS}")
            return name, primitive("void", "brightfunc", name, (beam.spread,), function)


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


def _background(skies: list[WideSource], frame: TextFrame) -> list[str]:
    """What is seen between the flat patches of surrounds; a glow of no radius lights nothing."""
    level = math.fsum(sky.patches[0].radiance for sky in skies) / frame.radiance
    if level == 0:
        return []
    name = f"background.{skies[0].name}"
    glow = primitive("void", "glow", name, (level, level, level, 0.0))
    return [f"# {name}\n{glow}" + primitive(name, "source", name, (0.0, 0.0, 1.0, 360.0))]


def _shining_surface(modifier: str, emitter: Emitter, frame: TextFrame) -> str:
    if isinstance(emitter, Luminaire):
        place = _placed(frame, emitter.position)
        return primitive(modifier, "sphere", emitter.name, (*place, emitter.radius * frame.units))
    if isinstance(emitter, Patch):
        return primitive(modifier, "polygon", emitter.name, _placed(frame, *emitter.corners))
    disc = _ring(emitter.position, emitter.axis, emitter.radius, frame)
    return primitive(modifier, "ring", emitter.name, disc)


def _materials(scene: Scene, stem: str) -> Iterator[str]:
    """Each material that looks the same on whatever has it, and that something has."""
    used = {surface.material for surface in scene.surfaces}
    for name, material in scene.materials.items():
        if name in used and not has_direction(material):
            yield f"# {name}\n" + described(_shared(name), f"{stem}.{name}", _functions(stem), material)


def _shared(material: str) -> str:
    return f"material.{material}"


def _target(target: Target, materials: Mapping[str, Material], stem: str, frame: TextFrame) -> Iterator[str]:
    functions, pieces = _functions(stem), surfaces(target)
    head, modifiers = "", {}
    for part, name in {surface.part: surface.material for surface in pieces}.items():
        head += f"# {target.name}.{part}: {name}\n"
        modifiers[part] = _shared(name)
        if has_direction(materials[name]):
            modifiers[part] = f"{part}.{target.name}"
            head += described(modifiers[part], f"{stem}.{name}", functions, materials[name], placement(target, frame))
    for text in _geometry(target, pieces, modifiers, frame, stem):
        yield head + text
        head = ""


def _geometry(
    target: Target, pieces: tuple[Surface, ...], modifiers: Mapping[str, str], frame: TextFrame, stem: str
) -> Iterator[str]:
    """A target's surfaces; `modifiers` are those of its parts, which must stand before them."""
    if isinstance(target, DotBoard | EdgeTarget | PatternTarget):
        decal = next(surface.part for surface in pieces if surface.is_decal)
        both = f"both.{target.name}"
        yield painted(both, (modifiers[decal], modifiers["surface"]), _functions(stem), target, frame)
        modifiers = {"surface": both}
    for surface in pieces:
        if not surface.is_decal:
            yield _surface(surface, modifiers["surface"], frame, stem)


def _surface(surface: Surface, modifier: str, frame: TextFrame, stem: str) -> str:
    match surface.shape:
        case MeshShape():
            return primitive(modifier, "mesh", surface.name, (), (mesh_file(stem, surface.name),))
        case PolygonShape(vertices):
            return primitive(modifier, "polygon", surface.name, _placed(frame, *vertices))
        case DiscShape(centre, normal, radius):
            return primitive(modifier, "ring", surface.name, _ring(centre, normal, radius, frame))
        case SphereShape(centre, radius):
            return primitive(modifier, "sphere", surface.name, (*_placed(frame, centre), radius * frame.units))
        case TubeShape(start, end, radius):
            return primitive(modifier, "cylinder", surface.name, (*_placed(frame, start, end), radius * frame.units))
