"""Images as types, and their files; the one door to OpenImageIO.

Radiance, radiant exposure and gray level are three types, so that a type
checker refuses one where another is due.
"""

from __future__ import annotations

import hashlib
import tempfile
import zlib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import OpenImageIO as oiio  # noqa: N813  (its own short name)
from numpy.typing import DTypeLike, NDArray

from radwrap.errors import EnvironmentFailure, InputError
from radwrap.files import disk_failure, publish, temporary_name

Provenance = Mapping[str, Any]
_NOTHING: Final[Provenance] = MappingProxyType({})

# Bits of what a file may hold as gray levels.
_BITS: Final = {"uint8": 8, "uint16": 16, "half": 16, "float": 16}
_WHOLE: Final = {"uint8", "uint16"}

_PNG: Final = b"\x89PNG\r\n\x1a\n"
_END_OF_JPEG: Final = b"\xff\xd9"
_JPEG_PADDING: Final = 4096  # bytes that cameras append
_PNM_HEADER: Final = 4096  # bytes, with comments

# Rows that are compared at a time; EXR packs 16 into a block.
_BAND: Final = 64

# OpenEXR files carry a date; a fixed one keeps equal images equal byte by byte.
_FIXED_DATE: Final = "2000:01:01 00:00:00"


def _checked(values: NDArray[Any], what: str) -> None:
    if values.ndim != 2 or values.size == 0:
        raise ValueError(f"{what} needs the shape (rows, columns), not {values.shape}")
    if not np.isfinite(values).all():
        raise ValueError(f"{what} holds NaN or infinity")


class _Pixels:
    """What NumPy takes for its array."""

    __slots__ = ()
    values: NDArray[Any]

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.values, dtype=dtype, copy=copy)


@dataclass(frozen=True, slots=True, eq=False)
class RadianceImage(_Pixels):
    """What one sub-viewpoint sees.

    Attributes
    ----------
    values : ndarray of float32, shape (rows, columns)
        Mean over the pixel's rays of radiance times cos^4(theta)
        [W m^-2 sr^-1]; theta is each ray's own angle to the axis.
    provenance : Mapping
        Where it comes from.
    """

    values: NDArray[np.float32]
    provenance: Provenance = field(default_factory=dict)

    def __post_init__(self) -> None:
        _checked(self.values, "a radiance image")


@dataclass(frozen=True, slots=True, eq=False)
class ExposureImage(_Pixels):
    """What the sensor receives.

    Attributes
    ----------
    values : ndarray of float64, shape (rows, columns)
        Radiant exposure H, mean over each pixel [J m^-2] (Eqs. 2 and 3).
    provenance : Mapping
        Where it comes from.
    """

    values: NDArray[np.float64]
    provenance: Provenance = field(default_factory=dict)

    def __post_init__(self) -> None:
        _checked(self.values, "an exposure image")
        if (self.values < 0).any():
            raise ValueError("an exposure image holds negative values")


@dataclass(frozen=True, slots=True, eq=False)
class GrayImage(_Pixels):
    """What an algorithm gets.

    Attributes
    ----------
    values : ndarray of float64, shape (rows, columns)
        Gray levels, clipped at saturation; whole numbers where the sensor rounds.
    bit_depth : int
        Bits of the camera's digital output, 1 to 16.
    provenance : Mapping
        Where it comes from.
    """

    values: NDArray[np.float64]
    bit_depth: int = 8
    provenance: Provenance = field(default_factory=dict)

    def __post_init__(self) -> None:
        _checked(self.values, "a gray image")

    @property
    def codes(self) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """Gray levels as the camera sends them: uint8 up to 8 bits, else uint16."""
        codes = np.empty(self.values.shape, dtype=np.uint8 if self.bit_depth <= 8 else np.uint16)
        return np.rint(self.values, out=codes, casting="unsafe")


def digest(pixels: NDArray[Any]) -> str:
    """SHA-256 of the pixels, in hexadecimal."""
    return hashlib.sha256(np.ascontiguousarray(pixels).data).hexdigest()


def write_exr(
    path: Path,
    pixels: NDArray[np.float32],
    *,
    channel: str,
    metadata: Mapping[str, str] = _NOTHING,
    packed: bool = True,
) -> None:
    """Write one channel of float32 as OpenEXR, whole or not at all.

    Parameters
    ----------
    path : Path
        Final name.
    pixels : ndarray of float32, shape (rows, columns)
        Values.
    channel : str
        Name of the channel.
    metadata : Mapping[str, str]
        Attributes to store.
    packed : bool
        Whether to make the file small; what lives only as long as a run is written sooner if not.

    Raises
    ------
    EnvironmentFailure
        If the disk refuses, or does not give back what was written.
    """
    _write(path, np.ascontiguousarray(pixels, dtype=np.float32), channel, metadata, "zip:1" if packed else "none")


def write_png(path: Path, codes: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    """Write gray levels as PNG of 8 or 16 bits, whole or not at all; raises as `write_exr`."""
    _write(path, np.ascontiguousarray(codes), "Y", _NOTHING)


def _write(
    path: Path, pixels: NDArray[Any], channel: str, metadata: Mapping[str, str], compression: str = "zip"
) -> None:
    rows, columns = pixels.shape
    spec = oiio.ImageSpec(columns, rows, 1, str(pixels.dtype) if pixels.dtype != np.float32 else "float")
    spec.channelnames = [channel]
    if path.suffix == ".exr":
        spec.attribute("DateTime", _FIXED_DATE)
        spec.attribute("compression", compression)
    else:
        # A gray level is a number, not a colour: without this the PNG gets sRGB and gamma chunks.
        spec.attribute("oiio:ColorSpace", "data")
    for key, value in metadata.items():
        spec.attribute(key, value)
    temporary = temporary_name(path)
    try:
        output = _without_threads().ImageOutput.create(str(temporary))
        if output is None:
            raise EnvironmentFailure(f"cannot write: {oiio.geterror()}", where=str(path))
        # The third axis is needed: a two-dimensional float32 array crashes the writer (OpenImageIO 3.2.2).
        written = output.open(str(temporary), spec) and output.write_image(pixels[:, :, np.newaxis])
        message = output.geterror()
        if not (output.close() and written):
            raise EnvironmentFailure(
                f"cannot write: {message or output.geterror() or 'no reason given'}",
                where=str(path),
                remedy="free disk space or choose another folder",
            )
        # Success is not to be believed: PNG on a full disk reports it.
        if not _holds(temporary, pixels):
            raise EnvironmentFailure(
                "the disk gave back another image than was written",
                where=str(path),
                remedy="free disk space or choose another folder",
            )
        publish(temporary, path)
    except OSError as error:
        raise disk_failure(path, error) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def _without_threads() -> Any:
    """OpenImageIO, without threads of OpenEXR's: a process that is forked later would wait for them for ever."""
    oiio.attribute("exr_threads", -1)
    return oiio


def _holds(path: Path, pixels: NDArray[Any]) -> bool:
    """Whether a file holds these pixels; read in bands, so that many writers at a time stay small."""
    source = _without_threads().ImageInput.open(str(path))
    if source is None:
        return False
    try:
        spec = source.spec()
        if (spec.height, spec.width, spec.nchannels) != (*pixels.shape, 1):
            return False
        for first in range(0, spec.height, _BAND):
            last = min(first + _BAND, spec.height)
            band = source.read_scanlines(0, 0, first, last, 0, 0, 1, spec.format)
            if band is None or not np.array_equal(np.reshape(band, (last - first, -1)), pixels[first:last]):
                return False
    finally:
        source.close()
    return True


def _broken_png(path: Path) -> str:
    """What is wrong with the chunks of a PNG file, empty where all are whole; libpng would print it on stderr."""
    content = path.read_bytes()
    place = len(_PNG)
    if content[:place] != _PNG:
        return ""
    while place + 12 <= len(content):
        end = place + 12 + int.from_bytes(content[place : place + 4], "big")
        if end > len(content):
            break
        kind, found = content[place + 4 : place + 8], int.from_bytes(content[end - 4 : end], "big")
        if zlib.crc32(content[place + 4 : end - 4]) != found:
            return f"a checksum is wrong {place} bytes from its start"
        if kind == b"IEND":
            return ""
        place = end
    return f"it ends after {len(content)} bytes, within the picture"


def _full_scale(source: Any, path: Path) -> int:
    """Largest whole number that the file could hold; OpenImageIO scales it up to 8 or 16 bits."""
    spec = source.spec()
    if source.format_name() != "pnm":
        return int(2 ** spec.get_int_attribute("oiio:BitsPerSample", _BITS[str(spec.format)])) - 1
    with path.open("rb") as file:
        header = b" ".join(line.split(b"#")[0] for line in file.read(_PNM_HEADER).splitlines(keepends=True)[:64])
    # Magic number, columns, rows, largest value; bit maps have none.
    try:
        return int(header.split(maxsplit=4)[3]) if header[:2] in {b"P2", b"P5", b"P3", b"P6"} else 1
    except (IndexError, ValueError) as error:
        raise InputError("has a header that names no largest gray level", where=str(path)) from error


def _read(path: Path) -> tuple[NDArray[Any], dict[str, str]]:
    if path.is_file() and (broken := _broken_png(path)):
        raise EnvironmentFailure(f"is not whole: {broken}", where=str(path))
    source = _without_threads().ImageInput.open(str(path))
    if source is None:
        raise EnvironmentFailure(f"is not a whole image: {oiio.geterror()}", where=str(path))
    try:
        spec = source.spec()
        pixels = source.read_image(spec.format)
        if pixels is None or spec.nchannels != 1:
            raise EnvironmentFailure(f"is not a whole one-channel image: {source.geterror()}", where=str(path))
        metadata = {attribute.name: str(attribute.value) for attribute in spec.extra_attribs}
    finally:
        source.close()
    return pixels.reshape(spec.height, spec.width), metadata


def read_image(path: Path) -> tuple[NDArray[Any], dict[str, str]]:
    """Read a one-channel image as it is stored, with its attributes.

    Returns
    -------
    pixels : ndarray, shape (rows, columns)
        uint8, uint16 or float32, as stored.
    metadata : dict
        Attributes as strings.

    Raises
    ------
    InputError
        If it cannot be read whole, or holds NaN or infinity.
    """
    try:
        pixels, metadata = _read(path)
    except EnvironmentFailure as error:
        raise InputError(error.what, where=str(path)) from error
    if not np.isfinite(pixels).all():
        raise InputError("holds NaN or infinity", where=str(path))
    return pixels, metadata


def read_gray(path: Path) -> GrayImage:
    """Read a gray image, predicted or captured: PNG, TIFF, PGM of 8 or 16 bits, or EXR with gray levels.

    A picture with several channels is taken where all colour channels agree.

    Returns
    -------
    GrayImage
        Gray levels as stored, in as many bits as the file says: 10 or 12 too; 16 bits where it holds floats.

    Raises
    ------
    InputError
        If it cannot be read whole, is in colour, or holds NaN or infinity.
    """
    pixels, bit_depth = _read_floats(path)
    colours = pixels[:, :, :3] if pixels.shape[2] > 2 else pixels[:, :, :1]
    if not np.isfinite(colours).all():
        raise InputError("holds NaN or infinity", where=str(path))
    if (colours != colours[:, :, :1]).any():
        raise InputError("is in colour", where=str(path), remedy="give the one channel that the camera saw")
    return GrayImage(np.ascontiguousarray(colours[:, :, 0]), bit_depth, {"file": str(path)})


def read_channel(path: Path) -> NDArray[np.float64]:
    """First channel of a picture, shape (rows, columns), as it is stored; NaN and infinity too.

    Raises
    ------
    InputError
        If it cannot be read whole.
    """
    return np.ascontiguousarray(_read_floats(path)[0][:, :, 0])


def _read_floats(path: Path) -> tuple[NDArray[np.float64], int]:
    """All channels, shape (rows, columns, channels), and the bit depth."""
    if not path.is_file():
        raise InputError("no such image", where=str(path))
    try:
        broken = _broken_png(path)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", where=str(path)) from error
    if broken:
        raise InputError(f"is not whole: {broken}", where=str(path))
    source = _without_threads().ImageInput.open(str(path))
    if source is None:
        raise InputError(f"is no image: {oiio.geterror()}", where=str(path))
    try:
        spec = source.spec()
        kind = str(spec.format)
        if kind not in _BITS:
            raise InputError(f"holds pixels of the type {kind}", where=str(path), remedy="use 8 or 16 bits, or floats")
        pixels = source.read_image("float" if kind == "half" else spec.format)
        if pixels is None:
            raise InputError(f"is not whole: {source.geterror()}", where=str(path))
        # The reader fills up what is missing of a JPEG, and says nothing.
        if source.format_name() == "jpeg" and _END_OF_JPEG not in path.read_bytes()[-_JPEG_PADDING:]:
            raise InputError("is not whole: its end is missing", where=str(path))
        full = _full_scale(source, path) if kind in _WHOLE else 0
    finally:
        source.close()
    pixels = pixels.reshape(spec.height, spec.width, spec.nchannels).astype(np.float64)
    if full:
        pixels = np.rint(pixels * (full / (2 ** _BITS[kind] - 1)))
    return pixels, full.bit_length() if full else _BITS[kind]


def png_bytes(codes: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    """Gray levels as a PNG file in memory, for notebooks."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "gray.png"
        write_png(path, codes)
        return path.read_bytes()
