"""Masks as COCO's run lengths: down the columns, zeros first, as a string of six bits a character."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

_ZERO: Final = 48  # character of six bits that are 0
_MORE: Final = 0x20
_SIGN: Final = 0x10


def run_lengths(mask: NDArray[np.bool_]) -> list[int]:
    """Lengths of the runs of equal pixels down the columns, of pixels that are out first, which may be 0."""
    flat = mask.ravel(order="F")
    changes = np.flatnonzero(np.diff(flat)) + 1
    ends = np.concatenate([[0], changes, [len(flat)]])
    lengths: list[int] = np.diff(ends).tolist()
    return [0, *lengths] if len(flat) and flat[0] else lengths


def packed(lengths: list[int]) -> str:
    """Run lengths as a string: from the fourth on the difference to the length two before, five bits at a time."""
    text = []
    for number, length in enumerate(lengths):
        value = length - lengths[number - 2] if number > 2 else length
        while True:
            bits, value = value & 0x1F, value >> 5
            more = value != (-1 if bits & _SIGN else 0)
            text.append(chr((bits | _MORE if more else bits) + _ZERO))
            if not more:
                break
    return "".join(text)


def segmentation(mask: NDArray[np.bool_]) -> dict[str, object]:
    """A mask as COCO's ``segmentation``."""
    return {"size": list(mask.shape), "counts": packed(run_lengths(mask))}
