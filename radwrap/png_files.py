"""What is wrong with a PNG file, told before libpng reads it: that prints a line of its own on stderr."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"

_KNOWN: Final = {b"IHDR", b"PLTE", b"IDAT", b"IEND"}
_ANCILLARY: Final = 0x20  # bit of a chunk's first letter: who does not know it may pass it by
_CHANNELS: Final = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # of each colour type
_DEPTHS: Final = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
_PALETTE: Final = 3
_LONGEST_SIDE: Final = 1_000_000  # px, that libpng reads
_LAST_FILTER: Final = 4
_LARGEST_PALETTE: Final = 256
# First column and row, and steps, of the passes of an interlaced picture.
_PASSES: Final = (
    *((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4)),
    *((0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2)),
)
_BLOCK: Final = 1 << 20  # bytes that are unpacked at a time


@dataclass(frozen=True, slots=True)
class _Header:
    width: int
    height: int
    depth: int
    colour: int
    methods: bytes  # of packing, filters, interlacing

    @property
    def is_sound(self) -> bool:
        """Whether a picture may have such a header."""
        return (
            self.depth in _DEPTHS.get(self.colour, ())
            and 0 < min(self.width, self.height) <= max(self.width, self.height) <= _LONGEST_SIDE
            and self.methods in (b"\0\0\0", b"\0\0\1")
        )

    def rows(self) -> NDArray[np.int64]:
        """Places of the rows' filters among the unpacked bytes, and the number of these bytes."""
        passes = _PASSES if self.methods[2] else ((0, 0, 1, 1),)
        place, found = 0, []
        for x, y, right, down in passes:
            columns, rows = -((x - self.width) // right), -((y - self.height) // down)
            if columns > 0 and rows > 0:
                length = 1 + (columns * _CHANNELS[self.colour] * self.depth + 7) // 8
                found.append(place + length * np.arange(rows))
                place += length * rows
        return np.append(np.concatenate(found), place)


def broken_png(content: bytes, most_pixels: int) -> str:
    """What is wrong with a PNG file, empty where it is whole or no PNG; of larger pictures the header alone is judged.

    Parameters
    ----------
    content : bytes
        The file.
    most_pixels : int
        Larger pictures are refused by who asks: they are not unpacked.
    """
    if not content.startswith(SIGNATURE):
        return ""
    header, packed, colours = None, [], 0
    for place, kind, data in _chunks(content):
        if data is None:
            return f"a checksum is wrong {place} bytes from its start"
        is_named = kind.isalpha() and kind[2:3].isupper() and (kind in _KNOWN or kind[0] & _ANCILLARY)
        if not is_named or (header is None) != (kind == b"IHDR"):
            return f"a part does not follow the PNG format {place} bytes from its start"
        if kind == b"IHDR":
            header = _header(data)
            if header is None or not header.is_sound:
                return "its header is not valid"
        elif kind == b"PLTE":
            colours = len(data)
        elif kind == b"IDAT":
            packed.append(data)
        elif kind == b"IEND" and header is not None:
            if header.colour == _PALETTE and not 0 < colours <= 3 * _LARGEST_PALETTE:
                return "its palette is missing"
            return "" if header.width * header.height > most_pixels else _broken_rows(header.rows(), packed)
    return f"it ends after {len(content)} bytes, within the picture"


def _chunks(content: bytes) -> Iterator[tuple[int, bytes, memoryview | None]]:
    """Place, kind and content of each whole chunk; None for the content where the checksum is wrong."""
    place, view = len(SIGNATURE), memoryview(content)
    while place + 12 <= len(content):
        end = place + 12 + int.from_bytes(content[place : place + 4], "big")
        if end > len(content):
            return
        is_right = zlib.crc32(view[place + 4 : end - 4]) == int.from_bytes(content[end - 4 : end], "big")
        yield place, content[place + 4 : place + 8], view[place + 8 : end - 4] if is_right else None
        place = end


def _header(data: memoryview) -> _Header | None:
    if len(data) != 13:
        return None
    width, height = (int.from_bytes(data[start : start + 4], "big") for start in (0, 4))
    return _Header(width, height, data[8], data[9], bytes(data[10:]))


def _broken_rows(rows: NDArray[np.int64], packed: list[memoryview]) -> str:
    """What is wrong with the picture itself: each row must be there, and begin with a filter that there is."""
    unpacker, start = zlib.decompressobj(), 0
    try:
        for data in packed:
            rest: bytes | memoryview = data
            while len(rest) and start < rows[-1] and not unpacker.eof:
                block = np.frombuffer(unpacker.decompress(rest, _BLOCK), dtype=np.uint8)
                rest = unpacker.unconsumed_tail
                here = rows[:-1][slice(*np.searchsorted(rows[:-1], [start, start + len(block)]))]
                if (block[here - start] > _LAST_FILTER).any():
                    return "its picture cannot be unpacked"
                start += len(block)
    except zlib.error:
        return "its picture cannot be unpacked"
    return "" if start >= rows[-1] else "its picture ends too early"
