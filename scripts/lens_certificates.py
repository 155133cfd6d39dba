"""Honest certificates of lenses: the random scenes of scripts/certificates.py, seen by a lens in place of a pinhole.

Of f/1.4 to f/16, focused anywhere from the nearest thing to behind the board.
Writes out/lens_certificates.json; exit code 1 as that script, but for the
share of scenes that break the kernel's model, which is only printed.
"""

from __future__ import annotations

import math
import sys
from typing import Any

import numpy as np

from certificates import concluded, draw, judged, judged_by, told

FASTEST, SLOWEST = 1.4, 16.0  # f-numbers
NEAREST, FARTHEST = 0.4, 1.2  # focus, in distances of the board


def through_a_lens(random: np.random.Generator) -> dict[str, Any]:
    """A scene's document."""
    document = draw(random)
    camera = document["camera"]
    del camera["aperture"]
    distance = float(camera["position"][2].split()[0]) * random.uniform(NEAREST, FARTHEST)
    number = math.exp(random.uniform(math.log(FASTEST), math.log(SLOWEST)))
    camera["lens"] = {"focus_distance": f"{distance:.5f} mm", "f_number": round(number, 3)}
    return document


def main() -> int:
    """Draw, judge, print."""
    rows = judged_by(lambda number, budget: judged(number, budget, through_a_lens), told, __doc__ or "", 2e7)
    return concluded(rows, "lens_certificates")


if __name__ == "__main__":
    sys.exit(main())
