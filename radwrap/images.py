"""Images as types, and their files; the one door to OpenImageIO.

Radiance, radiant exposure and gray level are three types, so that a type
checker refuses one where another is due.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import DTypeLike, NDArray

from radwrap.errors import EnvironmentFailure, InputError
from radwrap.files import check_result, disk_failure, publish, temporary_name
from radwrap.png_files import broken_png
from radwrap.reading import FileKind, read_bytes

Provenance = Mapping[str, Any]
Compression = Literal["zip:1", "rle", "none"]
_NOTHING: Final[Provenance] = MappingProxyType({})

# Bits of what a file may hold as gray levels.
_BITS: Final = {"uint8": 8, "uint16": 16, "half": 16, "float": 16}
_UPRIGHT: Final = 1  # of the tag Orientation of TIFF and Exif; from 2 to 8 a picture is turned or mirrored
_TURNED: Final = range(2, 9)
_MOST_BITS: Final = 16
_HALF: Final = 0.5  # gray: so far beside the codes a level is rounded to one
_WHOLE: Final = {"uint8", "uint16"}

_JPEG: Final = b"\xff\xd8"
_END_OF_JPEG: Final = b"\xff\xd9"
_JPEG_PADDING: Final = 4096  # bytes that cameras append
_PNM_HEADER: Final = 4096  # bytes, with comments

# Judged by the header: 8192 x 8192 pixels for what is measured, more for what is only read back.
MOST_PIXELS: Final = 1 << 26
PREVIEW_BITS: Final = 8  # what viewers show as it is; of deeper pictures they show nearly nothing
_MOST_STORED: Final = 1 << 28
_MOST_CHANNELS: Final = 4
_PICTURE: Final = FileKind("image", 1 << 30)
_STORED: Final = {"uint8": np.uint8, "uint16": np.uint16, "float": np.float32}

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
    """What the opening lets through to each pixel, before Eq. 3 makes an exposure of it.

    Attributes
    ----------
    values : ndarray of float64, shape (rows, columns)
        Mean over the opening and the pixel of radiance times cos^4(theta)
        [W m^-2 sr^-1]; theta is each ray's own angle to the axis.
    provenance : Mapping
        Where it comes from.
    """

    values: NDArray[np.float64]
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

    def save(self, path: str | Path) -> None:
        """Write the codes as PNG of 8 or 16 bits, with the bytes of a run's gray.png; whole or not at all.

        Raises
        ------
        InputError
            If the name does not end with ".png", or a gray level is none of the camera's.
        EnvironmentFailure
            If the disk refuses.
        """
        if Path(path).suffix != ".png":
            raise InputError("must end with .png", where=str(path), remedy="choose another name")
        if not 1 <= self.bit_depth <= _MOST_BITS:
            raise InputError(f"must be 1 to {_MOST_BITS}", where="bit_depth")
        low, high, top = self.values.min(initial=0.0), self.values.max(initial=0.0), 2**self.bit_depth - 1
        if not (low >= -_HALF and high < top + _HALF):
            raise InputError(
                f"holds gray levels from {low:g} to {high:g}, its {self.bit_depth} bits reach from 0 to {top}",
                where="values",
                remedy="clip them, or give more bits",
            )
        write_png(Path(path), self.codes)


def digest(pixels: NDArray[Any]) -> str:
    """SHA-256 of the pixels, in hexadecimal."""
    return hashlib.sha256(np.ascontiguousarray(pixels).data).hexdigest()


def write_exr(
    path: Path,
    pixels: NDArray[np.float32],
    *,
    channel: str,
    metadata: Mapping[str, str] = _NOTHING,
    compression: Compression = "zip:1",
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
    compression : str
        "zip:1" makes the file smallest; "rle" takes half of the time, and hardly makes noise smaller; "none" a quarter.

    Raises
    ------
    EnvironmentFailure
        If the disk refuses, or does not give back what was written.
    """
    _write(path, np.ascontiguousarray(pixels, dtype=np.float32), channel, metadata, compression)


def write_png(path: Path, codes: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    """Write gray levels as PNG of 8 or 16 bits, whole or not at all; raises as `write_exr`."""
    _write(path, np.ascontiguousarray(codes), "Y", _NOTHING)


def _write(
    path: Path, pixels: NDArray[Any], channel: str, metadata: Mapping[str, str], compression: str = "zip"
) -> None:
    check_result(path)
    oiio = _reader_and_writer()
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
        output = oiio.ImageOutput.create(str(temporary))
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
                "the disk returned an image other than the one written",
                where=str(path),
                remedy="free disk space or choose another folder",
            )
        publish(temporary, path)
    except OSError as error:
        raise disk_failure(path, error) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def get_ready() -> None:
    """Load what reads and writes, for who has time now and none later."""
    _reader_and_writer()


def _reader_and_writer() -> Any:
    """OpenImageIO, without threads of OpenEXR's: a process that is forked later would wait for them for ever.

    It is loaded here: that takes 0.06 s, and half of the commands neither read nor write an image.
    """
    import OpenImageIO as oiio  # noqa: N813  (its own short name)

    oiio.attribute("exr_threads", -1)
    return oiio


def _holds(path: Path, pixels: NDArray[Any]) -> bool:
    """Whether a file holds these pixels; read in bands, so that many writers at a time stay small."""
    oiio = _reader_and_writer()
    source = oiio.ImageInput.open(str(path))
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


def _opened(path: Path, most_pixels: int) -> Any:
    """Reader of a picture whose header is sound and whose file is whole; to be closed by the caller.

    Raises
    ------
    InputError
        If it is no regular file, no image, not whole, or too large.
    """
    content = read_bytes(path, _PICTURE)
    if broken := broken_png(content, most_pixels):
        raise InputError(f"is not complete: {broken}", where=str(path))
    # The reader fills up what is missing of a JPEG, and says nothing.
    if content[:2] == _JPEG and _END_OF_JPEG not in content[-_JPEG_PADDING:]:
        raise InputError("is not complete: its end is missing", where=str(path))
    del content
    try:
        str(path).encode()
    except UnicodeEncodeError as error:  # the reader takes names of UTF-8 only
        raise InputError("has a name that is not UTF-8", where=str(path), remedy="rename it") from error
    oiio = _reader_and_writer()
    source = oiio.ImageInput.open(str(path))
    if source is None:
        raise InputError(f"is not an image: {_reason(oiio)}", where=str(path))
    spec = source.spec()
    if not 0 < spec.width * spec.height <= most_pixels or spec.depth > 1:
        source.close()
        raise InputError(
            f"is {spec.width} x {spec.height} pixels, the limit is {most_pixels / 1e6:.3g} million",
            where=str(path),
            remedy="make it smaller",
        )
    if spec.nchannels > _MOST_CHANNELS:
        source.close()
        raise InputError(f"has {spec.nchannels} channels", where=str(path), remedy="give one channel")
    return source


def _reason(reader: Any) -> str:
    """What the reader says is wrong; it may quote the file's own bytes."""
    try:
        return str(reader.geterror())
    except UnicodeDecodeError:
        return "its parts cannot be separated"


def _bands(source: Any, path: Path, channels: int, kind: str) -> Iterator[tuple[slice, NDArray[Any]]]:
    """Rows, and their pixels, shape (rows, columns, channels); in bands, so that large pictures need no copy."""
    spec = source.spec()
    step = spec.height if spec.tile_width else _BAND
    for first in range(0, spec.height, step):
        last = min(first + step, spec.height)
        if spec.tile_width:
            band = source.read_image(0, 0, 0, channels, kind)
        else:
            band = source.read_scanlines(0, 0, spec.y + first, spec.y + last, 0, 0, channels, kind)
        if band is None:
            raise InputError(f"is not complete: {_reason(source)}", where=str(path))
        yield slice(first, last), np.reshape(band, (last - first, spec.width, channels))


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
    source = _opened(path, _MOST_STORED)
    try:
        spec = source.spec()
        if spec.nchannels != 1 or str(spec.format) not in _STORED:
            raise InputError("is not an image of one channel", where=str(path))
        pixels = np.empty((spec.height, spec.width), dtype=_STORED[str(spec.format)])
        for rows, band in _bands(source, path, 1, str(spec.format)):
            pixels[rows] = band[:, :, 0]
        metadata = {attribute.name: str(attribute.value) for attribute in spec.extra_attribs}
    finally:
        source.close()
    if not np.isfinite(pixels).all():
        raise InputError("holds NaN or infinity", where=str(path))
    return pixels, metadata


def read_gray(path: Path, *, most_pixels: int = MOST_PIXELS) -> GrayImage:
    """Read a gray image, predicted or captured: PNG, TIFF, PGM of 8 or 16 bits, or EXR with gray levels.

    A picture with several channels is taken where all colour channels agree, and nothing is transparent.

    Parameters
    ----------
    path : Path
        The file.
    most_pixels : int
        A larger picture is refused by its header, before room is made for it.

    Returns
    -------
    GrayImage
        Gray levels as stored, in as many bits as the file says: 10 or 12 too; 16 bits where it holds floats.

    Raises
    ------
    InputError
        If it cannot be read whole, is too large, in colour, transparent, to be turned, or holds NaN or infinity.
    """
    values, bit_depth, whole = _read_floats(path, most_pixels, gray=True)
    return GrayImage(values, bit_depth, {"file": str(path), "whole_numbers": whole})


def read_channel(path: Path) -> NDArray[np.float64]:
    """First channel of a picture, shape (rows, columns), as it is stored; NaN and infinity too.

    Raises
    ------
    InputError
        If it cannot be read whole.
    """
    return _read_floats(path, _MOST_STORED, gray=False)[0]


def _read_floats(path: Path, most_pixels: int, *, gray: bool) -> tuple[NDArray[np.float64], int, bool]:
    """First channel, shape (rows, columns), bit depth, and whether it holds whole numbers; gray where colours agree."""
    source = _opened(path, most_pixels)
    try:
        spec = source.spec()
        kind = str(spec.format)
        if kind not in _BITS:
            raise InputError(f"holds pixels of the type {kind}", where=str(path), remedy="use 8 or 16 bits, or floats")
        values = np.empty((spec.height, spec.width), dtype=np.float64)
        if gray:
            _check_upright(spec, path)
        opacity = spec.alpha_channel if gray else -1
        channels = max(3 if gray and spec.nchannels > 2 else 1, opacity + 1)
        for rows, found in _bands(source, path, channels, "float" if kind == "half" else kind):
            band = found if opacity < 0 else np.delete(found, opacity, axis=2)
            values[rows] = band[:, :, 0]
            if gray and not np.isfinite(band).all():
                raise InputError("holds NaN or infinity", where=str(path))
            if opacity >= 0:
                _check_opaque(found[:, :, opacity], path)
            if (band != band[:, :, :1]).any() and gray:
                raise InputError("is in colour", where=str(path), remedy="give the one channel that the camera saw")
        full = _full_scale(source, path) if kind in _WHOLE else 0
    finally:
        source.close()
    if full and full != 2 ** _BITS[kind] - 1:
        values *= full / (2 ** _BITS[kind] - 1)
        np.rint(values, out=values)
    return values, full.bit_length() if full else _BITS[kind], kind in _WHOLE


def _check_upright(spec: Any, path: Path) -> None:
    """Viewers turn a picture as its tag says, and the reader does not."""
    if spec.get_int_attribute("Orientation", _UPRIGHT) in _TURNED:
        raise InputError(
            "is to be turned or mirrored, as its tag Orientation says", where=str(path), remedy="save it upright"
        )


def _check_opaque(opacity: NDArray[Any], path: Path) -> None:
    """The reader multiplies what is seen through by its opacity, and what is behind is not known."""
    if (opacity < (np.iinfo(opacity.dtype).max if opacity.dtype.kind == "u" else 1)).any():
        raise InputError("has transparent pixels", where=str(path), remedy="put it on a ground, without transparency")


def preview_codes(image: GrayImage) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Gray levels for people's eyes: linear, full scale as 255; those of up to 8 bits as they are."""
    if image.bit_depth <= PREVIEW_BITS:
        return image.codes
    shares = image.values / (2.0**image.bit_depth - 1)
    codes: NDArray[np.uint8] = np.rint(255 * shares).astype(np.uint8)
    return codes


def png_bytes(codes: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    """Gray levels as a PNG file in memory, for notebooks."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "gray.png"
        write_png(path, codes)
        return path.read_bytes()
