"""The three machined parts of rad_scenes/part_presentation as STL files in mm: bracket, washer, stepped shaft."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from radwrap.convert.preview_files import ears
from radwrap.files import write_bytes

FOLDER = Path(__file__).parents[1] / "rad_scenes" / "part_presentation"
ROUND = 48  # sides of what is round


def bracket() -> trimesh.Trimesh:
    """An L of 50 x 40 mm, arms of 12 mm, 6 mm thick, lying flat, its frame's origin in the corner."""
    outline = np.array([[0, 0], [50, 0], [50, 12], [12, 12], [12, 40], [0, 40]], dtype=float)
    triangles = ears(np.column_stack([outline, np.zeros(len(outline))]))
    return trimesh.creation.extrude_triangulation(outline, triangles, height=6.0)


def washer() -> trimesh.Trimesh:
    """Radii 9 and 20 mm, 4 mm thick, lying flat."""
    body = trimesh.creation.annulus(r_min=9.0, r_max=20.0, height=4.0, sections=ROUND)
    body.apply_translation((0.0, 0.0, 2.0))
    return body


def shaft() -> trimesh.Trimesh:
    """60 mm long, steps of radius 6, 10 and 8 mm, lying along x."""
    profile = np.array([[0, -30], [6, -30], [6, -8], [10, -8], [10, 10], [8, 10], [8, 30], [0, 30]], dtype=float)
    body = trimesh.creation.revolve(profile, sections=ROUND)
    body.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (0, 1, 0)))
    body.apply_translation((0.0, 0.0, 10.0))
    return body


def main() -> None:
    """Write each part beside both scenes."""
    for make in (bracket, washer, shaft):
        content = make().export(file_type="stl")
        for light in ("ring", "ambient"):
            write_bytes(FOLDER / light / f"{make.__name__}.stl", content)


if __name__ == "__main__":
    main()
