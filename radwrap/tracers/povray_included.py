"""Included Radiance files as POV-Ray text: plain paint, smooth metal mirrors, and the surfaces both programs have."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from radwrap.errors import InputError
from radwrap.tracers.rad_grammar import VOID, Primitive, Source, primitives

Corner = tuple[float, ...]

_PAINT: Final = (
    "texture {{ pigment {{ color rgb {colour} }} finish {{ diffuse {diffuse} reflection {{ {mirror} }} }} }}"
)
# Materials; all else that is no surface is refused.
_MATERIALS: Final = ("plastic", "metal")


def included_text(text: str, where: str) -> str:
    """Write an included file for POV-Ray.

    Parameters
    ----------
    text : str
        Radiance text, already in its place.
    where : str
        What named the file, for messages.

    Raises
    ------
    InputError
        Naming the first thing that POV-Ray cannot express.
    """
    textures: dict[str, str] = {}
    lines = []
    for primitive in primitives(text, Source(where, Path("included file"))):
        if primitive.kind in _MATERIALS:
            textures[primitive.name] = _texture(primitive, where)
            continue
        shape = _shape(primitive)
        if shape is None:
            raise _refused(where, f'{primitive.kind} "{primitive.name}"')
        if primitive.modifier not in textures:
            raise _refused(where, f'a surface of {primitive.modifier}, "{primitive.name}",')
        lines.append(f"{shape} {textures[primitive.modifier]} }}")
    return "\n".join([*lines, ""])


def mirrors_in(text: str) -> bool:
    """Whether an included text that `included_text` accepts holds a mirror."""
    found = primitives(text, Source("", Path("included file")))
    return any(primitive.kind == "metal" and primitive.reals[3] > 0 for primitive in found)


def _refused(where: str, what: str) -> InputError:
    return InputError(
        f"{what} cannot be written for POV-Ray",
        where=where,
        remedy="use plastic without highlight, or metal of roughness 0, on spheres, polygons, rings and cylinders",
    )


def _texture(primitive: Primitive, where: str) -> str:
    red, green, blue, specular, roughness = primitive.reals
    shown = f'{primitive.kind} "{primitive.name}"'
    if primitive.modifier != VOID:
        raise _refused(where, f'{shown} with the modifier "{primitive.modifier}"')
    if not red == green == blue:
        raise _refused(where, f"{shown} in colour")
    if specular and (roughness or primitive.kind == "plastic"):
        raise _refused(where, f"{shown} with a highlight")
    return _PAINT.format(colour=1, diffuse=repr(red * (1 - specular)), mirror=repr(red * specular))


def _shape(primitive: Primitive) -> str | None:
    numbers = primitive.reals
    match primitive.kind:
        case "polygon":
            corners = [numbers[i : i + 3] for i in range(0, len(numbers), 3)]
            places = [_vector(corner) for loop in rims(corners) for corner in (*loop, loop[0])]
            return f"polygon {{ {len(places)}, {', '.join(places)}"
        case "sphere":
            return f"sphere {{ {_vector(numbers[:3])}, {numbers[3]!r}"
        case "ring":
            inner, outer = sorted(numbers[6:])
            return f"disc {{ {_vector(numbers[:3])}, {_vector(numbers[3:6])}, {outer!r}, {inner!r}"
        case "cylinder":
            return f"cylinder {{ {_vector(numbers[:3])}, {_vector(numbers[3:6])}, {numbers[6]!r} open"
    return None


def rims(corners: Sequence[Corner]) -> list[list[Corner]]:
    """Closed rims of a polygon, holes included.

    A hole of Radiance's polygons hangs on a seam, a side that is gone both ways. POV-Ray ends a rim where its first
    corner comes again. Both count how many sides a ray to infinity crosses, so sides that come twice are left out, and
    what remains may be joined to rims in any way.
    """
    sides: dict[frozenset[Corner], tuple[Corner, Corner]] = {}
    for side in zip(corners, (*corners[1:], corners[0]), strict=True):
        name = frozenset(side)
        if name in sides:
            del sides[name]
        elif len(name) == 2:
            sides[name] = side
    at: dict[Corner, list[frozenset[Corner]]] = {}
    for name, side in sides.items():
        for corner in side:
            at.setdefault(corner, []).append(name)
    found = []
    for start, _ in list(sides.values()):
        loop, corner = [], start
        while ways := [name for name in at[corner] if name in sides]:
            loop.append(corner)
            del sides[ways[0]]
            (corner,) = ways[0] - {corner}
            if corner == start:
                break
        if loop:
            found.append(loop)
    return found


def _vector(numbers: tuple[float, ...]) -> str:
    return f"<{', '.join(map(repr, numbers))}>"
