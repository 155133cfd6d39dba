"""What is painted on flat targets as Radiance text: a mixture of two materials, and a pattern's file of functions."""

from __future__ import annotations

from typing import Final

from radwrap.scene.patterns.partition import MARK, Partition
from radwrap.scene.targets import DotBoard, EdgeTarget, PatternTarget
from radwrap.tracers.radiance_materials import FUNCTIONS, placement, primitive
from radwrap.tracers.text_frame import TextFrame

_ON_MARK: Final = "on_mark"
_WIDEST: Final = 100  # characters of a line; Radiance reads 255 at once

_HEAD: Final = """{
	Which material a plate shows: 1 on its marks, 0 beside them. arg(1..3): the
	plate's origin, arg(4..6), arg(7..9): its x and y over a metre. A condition
	asks on which side of a line, or of a circle, a place lies.
}
across = (Px-arg(1))*arg(4) + (Py-arg(2))*arg(5) + (Pz-arg(3))*arg(6);
up = (Px-arg(1))*arg(7) + (Py-arg(2))*arg(8) + (Pz-arg(3))*arg(9);
"""


def painted(
    name: str,
    materials: tuple[str, str],
    functions: str,
    target: DotBoard | EdgeTarget | PatternTarget,
    frame: TextFrame,
) -> str:
    """A modifier of that name that shows the first material on a target's decals and the second one beside them.

    The board is one surface, so nothing hangs on which of two surfaces in one plane is met: rims are exact under
    grazing rays, on both sides and for shadow rays.
    """
    place = placement(target, frame)
    x, y = place.x_axis, place.y_axis
    match target:
        case DotBoard():
            pitch, radius = target.pitch * frame.units, target.dot_diameter / 2 / target.pitch
            steps = (*(value / pitch for value in x), *(value / pitch for value in y))
            numbers = (*place.middle, *steps, float(target.columns), float(target.rows), radius**2)
            function = "on_dot"
        case EdgeTarget():
            numbers, function = (*place.middle, *x, target.edge_position * frame.units), "beyond_edge"
        case PatternTarget():
            in_metres = (value / frame.units for value in (*x, *y))
            numbers, function, functions = (*place.middle, *in_metres), _ON_MARK, pattern_file(functions, target)
    return primitive("void", "mixfunc", name, numbers, (*materials, function, functions))


def pattern_file(functions: str, target: PatternTarget) -> str:
    """Name of a target's file, beside the file of all other functions."""
    return f"{functions.removesuffix(FUNCTIONS)}{target.name}.pattern.cal"


def pattern_functions(target: PatternTarget) -> bytes:
    """The file's content."""
    lines = [""]
    for word in _words(target.partition):
        if len(lines[-1]) + len(word) > _WIDEST:
            lines.append("")
        lines[-1] += word
    return (_HEAD + f"{_ON_MARK} =\n" + "\n".join(lines) + ";\n").encode()


def _words(partition: Partition) -> list[str]:
    """The tree as one condition within another."""
    words, rows = [], partition.nodes.tolist()
    left: list[int | str] = [0]
    while left:
        item = left.pop()
        if isinstance(item, str):
            words.append(item)
        elif item < 0:
            words.append("1" if item == MARK else "0")
        else:
            *numbers, is_circle, inside, outside = rows[item]
            words.append(f"if({_side(*numbers, is_circle=bool(is_circle))},")
            left += [")", int(outside), ",", int(inside)]
    return words


def _side(a: float, b: float, c: float, *, is_circle: bool) -> str:
    if is_circle:
        return f"{c!r}-sq(across-({a!r}))-sq(up-({b!r}))"
    return f"across*({a!r})+up*({b!r})-({c!r})"
