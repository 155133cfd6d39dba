"""Gray images from files: levels as stored, and what is no whole gray image."""

import subprocess
import sys
from pathlib import Path
from typing import Any

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
        with pytest.raises(InputError, match=r"cut\.png: is not whole: it ends after \d+ bytes"):
            read(path)
    assert capfd.readouterr() == ("", "")


def test_a_png_with_a_wrong_byte_is_one_clear_error(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "wrong.png"
    write_png(path, np.arange(4096, dtype=np.uint16).reshape(64, 64))
    content = bytearray(path.read_bytes())
    content[-30] ^= 1
    path.write_bytes(content)
    with pytest.raises(InputError, match="is not whole: a checksum is wrong"):
        read_gray(path)
    assert capfd.readouterr() == ("", "")


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
