"""Gray images from files: levels as stored, and what is no whole gray image."""

import subprocess
import sys
import zlib
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

from radwrap.errors import InputError
from radwrap.images import ExposureImage, GrayImage, RadianceImage, read_gray, read_image, write_png

LEVELS = np.array([[0, 100, 700], [1, 2, 3]])


def pgm(path: Path, magic: str, largest: int) -> Path:
    """P2 in text or P5 in bytes, of two per level above 255, with a comment in its header."""
    header = f"{magic}\n# columns rows 7\n3 2 # P2 9\n{largest}\n".encode()
    codes = LEVELS.astype(">u2" if largest > 255 else np.uint8)
    text = " ".join(map(str, codes.ravel())).encode()
    path.write_bytes(header + (text if magic == "P2" else codes.tobytes()))
    return path


@pytest.mark.parametrize("magic", ["P2", "P5"])
@pytest.mark.parametrize(("largest", "bits"), [(1000, 10), (1023, 10), (4095, 12), (65535, 16)])
def test_pgm_keeps_the_camera_s_levels(tmp_path: Path, magic: str, largest: int, bits: int) -> None:
    image = read_gray(pgm(tmp_path / "x.pgm", magic, largest))
    assert image.values.tolist() == LEVELS.tolist()
    assert image.bit_depth == bits


def test_tiff_of_12_bits_keeps_its_levels(tmp_path: Path) -> None:
    import OpenImageIO as oiio  # noqa: N813

    spec = oiio.ImageSpec(3, 2, 1, "uint16")
    spec.attribute("oiio:BitsPerSample", 12)
    path = tmp_path / "x.tif"
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec)
    # Twelve bits in sixteen: the writer takes full scale for full scale.
    output.write_image(np.rint(LEVELS * (65535 / 4095)).astype(np.uint16)[:, :, np.newaxis])
    output.close()
    image = read_gray(path)
    assert image.values.tolist() == LEVELS.tolist()
    assert image.bit_depth == 12


@pytest.mark.parametrize("kept", [20, 60, -20, -12])
def test_a_cut_png_is_one_clear_error(tmp_path: Path, kept: int, capfd: pytest.CaptureFixture[str]) -> None:
    """Nothing from libpng beside it."""
    path = tmp_path / "cut.png"
    write_png(path, np.arange(4096, dtype=np.uint16).reshape(64, 64))
    path.write_bytes(path.read_bytes()[:kept])
    for read in (read_gray, read_image):
        with pytest.raises(InputError, match=r"cut\.png: is not complete: it ends after \d+ bytes"):
            read(path)
    assert capfd.readouterr() == ("", "")


def test_a_png_with_a_wrong_byte_is_one_clear_error(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "wrong.png"
    write_png(path, np.arange(4096, dtype=np.uint16).reshape(64, 64))
    content = bytearray(path.read_bytes())
    content[-30] ^= 1
    path.write_bytes(content)
    with pytest.raises(InputError, match="is not complete: a checksum is wrong"):
        read_gray(path)
    assert capfd.readouterr() == ("", "")


def _png(*chunks: tuple[bytes, bytes]) -> bytes:
    """Chunks with their checksums."""
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        len(data).to_bytes(4, "big") + kind + data + zlib.crc32(kind + data).to_bytes(4, "big") for kind, data in chunks
    )


HEADER: Final = (b"IHDR", bytes([0, 0, 0, 9, 0, 0, 0, 5, 8, 0, 0, 0, 0]))  # 9 x 5 pixels of 8 bits
PICTURE: Final = bytes([0, *range(9)]) * 5
END: Final = (b"IEND", b"")
BROKEN: Final = {
    "a filter that there is not": (
        [HEADER, (b"IDAT", zlib.compress(PICTURE[:10] + b"\7" + PICTURE[11:])), END],
        "unpacked",
    ),
    "bytes that are not packed": ([HEADER, (b"IDAT", PICTURE), END], "unpacked"),
    "half a picture": ([HEADER, (b"IDAT", zlib.compress(PICTURE[:25])), END], "ends too early"),
    "7 bits": ([(b"IHDR", HEADER[1][:8] + bytes([7, 0, 0, 0, 0])), (b"IDAT", zlib.compress(PICTURE)), END], "header"),
    "no pixels": ([(b"IHDR", bytes(4) + HEADER[1][4:]), (b"IDAT", zlib.compress(PICTURE)), END], "header"),
    "no header": ([(b"IDAT", zlib.compress(PICTURE)), END], "a part does not follow"),
    "no palette": ([(b"IHDR", HEADER[1][:9] + bytes([3, 0, 0, 0])), (b"IDAT", zlib.compress(PICTURE)), END], "palette"),
    "an unknown part": ([HEADER, (b"IDAX", zlib.compress(PICTURE)), END], "a part does not follow"),
}


@pytest.mark.parametrize("fault", list(BROKEN))
def test_a_png_that_libpng_cannot_read_is_one_clear_error(
    tmp_path: Path, fault: str, capfd: pytest.CaptureFixture[str]
) -> None:
    """Checksums are right: libpng would say what is wrong on a line of its own."""
    chunks, expected = BROKEN[fault]
    path = tmp_path / "wrong.png"
    path.write_bytes(_png(*chunks))
    with pytest.raises(InputError, match=f"wrong\\.png: is not complete: .*{expected}"):
        read_gray(path)
    assert capfd.readouterr() == ("", "")


def test_a_png_in_parts_and_an_interlaced_one_are_read(tmp_path: Path) -> None:
    packed = zlib.compress(PICTURE)
    (tmp_path / "parts.png").write_bytes(_png(HEADER, (b"IDAT", packed[:7]), (b"IDAT", packed[7:]), END))
    assert read_gray(tmp_path / "parts.png").values.tolist() == [list(range(9))] * 5
    # Of 9 x 5 pixels the passes have 2 x 1, 1 x 1, 3 x 1, 2 x 2, 5 x 1, 4 x 3 and 9 x 2.
    sizes = [(2, 1), (1, 1), (3, 1), (2, 2), (5, 1), (4, 3), (9, 2)]
    rows = b"".join(bytes([0] + [6] * columns) * count for columns, count in sizes)
    laced = (b"IHDR", HEADER[1][:12] + b"\1")
    (tmp_path / "laced.png").write_bytes(_png(laced, (b"IDAT", zlib.compress(rows)), END))
    assert read_gray(tmp_path / "laced.png").values.tolist() == [[6] * 9] * 5


@pytest.mark.parametrize("kind", [RadianceImage, ExposureImage, GrayImage])
def test_numpy_takes_an_image_for_its_values(kind: Any) -> None:
    values = np.arange(6.0).reshape(2, 3)
    image = kind(values)
    assert np.asarray(image) is values
    assert np.array(image, dtype=np.float32).tolist() == values.tolist()
    assert not np.shares_memory(np.array(image), values)


_FORKED = """
import multiprocessing, sys
from pathlib import Path
import numpy as np
from radwrap.images import read_image, write_exr
def copy(name):
    write_exr(Path(name), np.ones((300, 300), dtype=np.float32), channel="Y")
    return read_image(Path(name))[0].shape
copy(sys.argv[1])
with multiprocessing.get_context("fork").Pool(1) as pool: print(pool.apply(copy, [sys.argv[1]]))
"""


def test_images_are_written_after_a_fork(tmp_path: Path) -> None:
    """Threads do not survive one."""
    words = [sys.executable, "-c", _FORKED, str(tmp_path / "image.exr")]
    done = subprocess.run(words, capture_output=True, text=True, check=True, timeout=20)
    assert done.stdout == "(300, 300)\n"


@pytest.mark.parametrize(("level", "bits"), [(300.0, 8), (-5.0, 8), (10.0, 0), (10.0, 17)])
def test_codes_that_no_camera_sends_are_not_saved(level: float, bits: int, tmp_path: Path) -> None:
    with pytest.raises(InputError):
        GrayImage(np.full((4, 4), level), bits).save(tmp_path / "wrong.png")
    assert not list(tmp_path.iterdir())


def test_a_picture_that_lets_its_background_through_is_refused(tmp_path: Path) -> None:
    """The reader multiplies gray levels by opacity: half of 200 came back as 100, and nothing said so."""
    from PIL import Image

    gray = np.full((4, 5), 200, dtype=np.uint8)
    for name, opacity in (("through", 128), ("opaque", 255)):
        alpha = np.full_like(gray, opacity)
        Image.fromarray(np.dstack([gray, alpha])).save(tmp_path / f"{name}_gray.png")
        Image.fromarray(np.dstack([gray, gray, gray, alpha])).save(tmp_path / f"{name}_colour.png")
        Image.fromarray(np.dstack([gray, gray, gray, alpha])).save(tmp_path / f"{name}_colour.tif")
    for kind in ("gray.png", "colour.png", "colour.tif"):
        assert (read_gray(tmp_path / f"opaque_{kind}").values == 200).all()
        with pytest.raises(InputError, match="transparent"):
            read_gray(tmp_path / f"through_{kind}")


def test_a_picture_that_is_to_be_turned_is_refused(tmp_path: Path) -> None:
    """As it is stored it is not what viewers show: a print lay upside down on its sheet."""
    from PIL import Image

    picture = Image.fromarray(np.arange(20, dtype=np.uint8).reshape(4, 5))
    for orientation in (1, 3, 6):
        picture.save(tmp_path / f"{orientation}.tif", tiffinfo={274: orientation})
        exif = Image.Exif()
        exif[274] = orientation
        picture.save(tmp_path / f"{orientation}.jpg", exif=exif)
        picture.save(tmp_path / f"{orientation}.png", exif=exif)
    for kind in ("tif", "jpg", "png"):
        assert read_gray(tmp_path / f"1.{kind}").values.shape == (4, 5)
        for orientation in (3, 6):
            with pytest.raises(InputError, match="turned"):
                read_gray(tmp_path / f"{orientation}.{kind}")
