"""Gray images for eyes: eight bits, and no smaller than a page shows them well."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

# What is narrower is shown larger, each pixel as a square.
SHOWN: Final = 480  # px


def for_eyes(gray: NDArray[np.float64], white: float) -> NDArray[np.uint8]:
    """Gray levels from 0 to that of white as 0 to 255, enlarged by whole pixels."""
    bits = np.clip(np.rint(gray * (255 / white)), 0, 255).astype(np.uint8)
    times = -(-SHOWN // bits.shape[1]) if bits.shape[1] < SHOWN else 1
    return bits.repeat(times, axis=0).repeat(times, axis=1)


def shown(file: Path, target: Path) -> None:
    """Write a PNG of any depth for eyes; of 16 bits white is that of the fewest bits that hold its levels."""
    gray = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    if gray.ndim == 3:
        cv2.imwrite(str(target), gray)
        return
    bits = max(8, int(gray.max()).bit_length())
    cv2.imwrite(str(target), for_eyes(gray.astype(np.float64), 2.0**bits - 1))
