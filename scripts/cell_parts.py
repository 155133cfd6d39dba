"""The parts that lie on the belt of rad_scenes/cells: a plate with three holes, a nut and a washer, as OBJ files.

Each is a flat outline with round holes, drawn up to its height: sharp edges, holes that are looked into, and sides that
throw shadows.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
FOLDER: Final = Path(__file__).parent.parent / "rad_scenes" / "cells"
_SIDES: Final = 96  # of a hole


def tile(
    outline: Array, hole_diameter: float, height: float, joined: tuple[float, ...] = ()
) -> tuple[Array, list[tuple[int, int, int]]]:
    """A convex outline about a round hole, drawn up.

    Parameters
    ----------
    outline : ndarray, shape (n, 2)
        Counter-clockwise about the hole's centre, with as many corners as the hole has sides [mm].
    hole_diameter, height : float
        [mm].
    joined : tuple of float
        Where another tile goes on, x [mm]: it has no side there.

    Returns
    -------
    corners : ndarray, shape (4 n, 3)
        Below outside, below inside, above outside, above inside.
    faces : list of tuple
        Triangles, counter-clockwise from outside.
    """
    count = len(outline)
    turn = np.arctan2(outline[:, 1], outline[:, 0])
    hole = hole_diameter / 2 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    low, high = np.zeros((count, 1)), np.full((count, 1), height)
    corners = np.vstack([np.hstack([part, z]) for z in (low, high) for part in (outline, hole)])
    faces = []
    for here in range(count):
        after = (here + 1) % count
        below_out, below_in, above_out, above_in = ((k * count + here, k * count + after) for k in range(4))
        strips = [(below_in, below_out), (above_out, above_in), (above_in, below_in)]
        if not any(outline[here, 0] == outline[after, 0] == x for x in joined):
            strips.append((below_out, above_out))
        for (a, b), (c, d) in strips:
            faces += [(a, b, d), (a, d, c)]
    return corners, faces


def round_outline(diameter: float) -> Array:
    """A circle [mm]."""
    return regular(diameter, math.inf)


def regular(across: float, sides: float) -> Array:
    """A regular polygon by its width across flats, or a circle, with a corner for each side of a hole [mm]."""
    turn = 2 * np.pi * np.arange(_SIDES) / _SIDES
    if math.isinf(sides):
        radius = np.full(_SIDES, across / 2)
    else:
        step = 2 * np.pi / sides
        radius = across / 2 / np.cos((turn + step / 2) % step - step / 2)
    # Rounded, so that tiles side by side have the same corners.
    outline: Array = np.round(radius[:, np.newaxis] * np.stack([np.cos(turn), np.sin(turn)], axis=1), 9) + 0.0
    return outline


def parts() -> dict[str, str]:
    """Name of each file and its text."""
    joined = {6.0: (12.0,), 10.0: (-12.0, 12.0), 14.0: (-12.0,)}
    plate = [tile(regular(24.0, 4), diameter, 4.0, ends) for diameter, ends in joined.items()]
    for number, (corners, _) in enumerate(plate):
        corners[:, 0] += 24.0 * (number - 1)
    return {
        "plate.obj": obj_text(plate, "a plate of 72 x 24 x 4 mm with holes of 6, 10 and 14 mm"),
        "nut.obj": obj_text([tile(regular(17.0, 6), 10.0, 8.0)], "a nut, 17 mm across flats, 8 mm high"),
        "washer.obj": obj_text([tile(round_outline(24.0), 13.0, 2.5)], "a washer of 24 mm, 2.5 mm high"),
    }


def obj_text(tiles: list[tuple[Array, list[tuple[int, int, int]]]], what: str) -> str:
    """Several tiles as one OBJ file."""
    lines, first = [f"# {what}; written by scripts/cell_parts.py, in mm"], 1
    for corners, faces in tiles:
        lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in corners.tolist()]
        lines += [f"f {first + a} {first + b} {first + c}" for a, b, c in faces]
        first += len(corners)
    return "\n".join(lines) + "\n"


def main() -> int:
    """Write the files."""
    argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "").parse_args()
    for name, text in parts().items():
        (FOLDER / name).write_text(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
