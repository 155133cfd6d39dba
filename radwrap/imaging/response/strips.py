"""Rows of large images, few at a time: what is computed of them stays in the processor's cache."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

# Pixels of a strip: 1 MiB of numbers. Of a whole image of megapixels each step would wait for new memory.
_PIXELS: Final = 1 << 17


def strips_of(rows: int, columns: int) -> Iterator[slice]:
    """Slices of an image's rows, from the first to the last."""
    step = max(1, _PIXELS // max(1, columns))
    for start in range(0, rows, step):
        yield slice(start, min(start + step, rows))
