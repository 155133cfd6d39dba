"""A photo's bytes made into gray levels, in a process of its own: what they hold may be meant to do harm.

Reads the bytes on stdin, and answers on stdout with a line of JSON and, where nothing is wrong, gray levels as float32.
The bytes lie in memory that has no name; once they are there this process can write no file any more.
Run as ``python -m radwrap.face.decoder COLUMNS ROWS FOLDER``; FOLDER is for a link to that memory.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, Final

from radwrap.errors import InputError, RadwrapError

SECONDS: Final = 10  # of processor time
MEMORY: Final = 2 << 30  # byte of address space
LARGEST: Final = 256 << 20  # byte of a photo
_BLOCK: Final = 1 << 20
_WATCH: Final = 0.2  # s between looks at whether the server lives
# How each kind of file begins, and how its name ends.
KINDS: Final[tuple[tuple[bytes, str], ...]] = (
    (b"\x89PNG\r\n\x1a\n", ".png"),
    (b"II*\0", ".tif"),
    (b"MM\0*", ".tif"),
    (b"II+\0", ".tif"),
    (b"MM\0+", ".tif"),
    *((f"P{number}".encode(), ".pgm") for number in (2, 3, 5, 6)),
    (b"\xff\xd8\xff", ".jpg"),
    (b"\x76\x2f\x31\x01", ".exr"),
)
NONE_OF_THEM: Final = "is none of PNG, TIFF, PGM, JPEG and EXR"


def kind_of(begin: bytes) -> str | None:
    """How a photo's name ends, by how its bytes begin; None where no such photo is read."""
    return next((suffix for magic, suffix in KINDS if begin.startswith(magic)), None)


def main(arguments: Sequence[str] | None = None) -> int:
    """Decode one photo."""
    columns, rows, folder = sys.argv[1:] if arguments is None else arguments
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    _limit()
    told: Mapping[str, Any]
    try:
        told, grays = _decoded(_held(sys.stdin.buffer), int(columns), int(rows), Path(folder))
    except RadwrapError as error:
        told, grays = {"error": error.what, "remedy": error.remedy}, memoryview(b"")
    except MemoryError:
        told, grays = {"error": f"needs more than {MEMORY >> 30} GiB of memory", "remedy": ""}, memoryview(b"")
    sys.stdout.buffer.write(json.dumps(told).encode() + b"\n")
    sys.stdout.buffer.write(grays)
    sys.stdout.buffer.flush()
    return 0


def _end_with(server: int) -> None:
    """Nobody wants the photo of a server that was killed."""
    while os.getppid() == server:
        time.sleep(_WATCH)
    os._exit(1)


def _limit() -> None:
    """Time and memory of this process; no core file, which would hold the photo."""
    import resource

    for what, most in (
        (resource.RLIMIT_CPU, SECONDS),
        (resource.RLIMIT_AS, MEMORY),
        (resource.RLIMIT_CORE, 0),
    ):
        _, hard = resource.getrlimit(what)
        least = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(what, (least, least))


def _held(stream: BinaryIO) -> int:
    """Descriptor of memory that holds the bytes; from then on no file can be written."""
    import resource

    held = os.memfd_create("photo")
    size = 0
    while block := stream.read(_BLOCK):
        size += len(block)
        if size > LARGEST:
            raise InputError(f"has more than {LARGEST >> 20} MiB")
        _write(held, block)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
    return held


def _write(held: int, block: bytes) -> None:
    while block:
        block = block[os.write(held, block) :]


def _decoded(held: int, columns: int, rows: int, folder: Path) -> tuple[Mapping[str, Any], memoryview]:
    """What is said of a photo, and its gray levels as float32."""
    import numpy as np

    from radwrap.images import read_gray

    suffix = kind_of(os.pread(held, 16, 0))
    if suffix is None:
        raise InputError(NONE_OF_THEM, remedy="save it as one of them")
    # The reader wants a name that says what it is; what has the name is a link.
    link = folder / f"photo_{os.getpid()}{suffix}"
    link.symlink_to(f"/proc/{os.getpid()}/fd/{held}")
    try:
        image = read_gray(link)
    finally:
        with suppress(OSError):
            link.unlink()
    if image.values.shape != (rows, columns):
        has = f"{image.values.shape[1]} x {image.values.shape[0]}"
        raise InputError(f"has {has} pixels, the picture {columns} x {rows}", remedy="cut it to the same pixels")
    told = {"bit_depth": image.bit_depth, "whole": image.provenance["whole_numbers"], "kind": suffix[1:]}
    return told, memoryview(np.ascontiguousarray(image.values, dtype="<f4").tobytes())


if __name__ == "__main__":
    sys.exit(main())
