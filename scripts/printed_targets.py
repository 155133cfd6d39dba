"""What a printer would put on paper: PDFs of targets as poppler draws them at 1200 dpi, against their geometry.

python scripts/printed_targets.py [FILE.toml ...]        (poppler-utils of the system, for development only)

Prints for each target how far the farthest pixel of the wrong colour lies from the nearest edge of the true geometry.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from radwrap.convert.print_files import write_pdf
from radwrap.convert.print_pages import pages
from radwrap.scene.file.target_file import load_target
from radwrap.scene.patterns.partition import partition

DPI: Final = 1200
MOST: Final = 0.05  # mm
TARGETS: Final = Path(__file__).parents[1] / "rad_scenes" / "targets"


def drawn(pdf: Path, folder: Path) -> list[np.ndarray]:
    """Each page as poppler draws it."""
    words = ["pdftoppm", "-r", str(DPI), "-gray", "-aa", "no", "-aaVector", "no", str(pdf), str(folder / "page")]
    subprocess.run(words, check=True, timeout=300)
    return [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in sorted(folder.glob("page*.pgm"))]


def worst(path: Path) -> float:
    """Distance of the farthest wrong pixel from an edge [mm]."""
    name, layout = load_target(path)
    parted = partition(layout.marks(), layout.size)
    pitch = 0.0254 / DPI
    found = 0.0
    with tempfile.TemporaryDirectory() as folder:
        pdf = Path(folder) / "target.pdf"
        write_pdf(name, layout, pdf, "a4")
        sheets = pages(name, layout, "a4")
        if len(sheets) > 1:
            raise SystemExit(f"{path}: is on {len(sheets)} sheets, one is looked at here")
        ((page, image),) = zip(sheets, drawn(pdf, Path(folder)), strict=True)
    window = page.window
    columns = np.arange(int(window.left / pitch), int(window.right / pitch))
    rows = np.arange(int((page.size[1] - window.top) / pitch), int((page.size[1] - window.bottom) / pitch))
    x = (columns + 0.5) * pitch - (window.left + window.right) / 2
    y = page.size[1] - (rows + 0.5) * pitch - (window.bottom + window.top) / 2
    dark = np.stack([parted.covered(np.column_stack([x, np.full(len(x), one)])) for one in y])
    wrong = (image[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] < 128) != dark
    wrong[[0, 1, -2, -1]] = wrong[:, [0, 1, -2, -1]] = False  # where the lines along which the plate is cut begin
    for side in (dark, ~dark):
        away = cv2.distanceTransform(side.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        found = max(found, float(away[wrong & side].max(initial=0.0)))
    return found * pitch * 1e3


if __name__ == "__main__":
    files = [Path(name) for name in sys.argv[1:]] or sorted(TARGETS.glob("*.toml"))
    results = {path: worst(path) for path in files}
    for path, distance in results.items():
        print(f"{path.stem}: {distance:.4f} mm at most")
    raise SystemExit(0 if max(results.values()) <= MOST else 1)
