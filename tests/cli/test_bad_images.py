"""Broken images and tables, each verb of measuring and calibrating: one line that says what, exit code 2."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from radwrap.cli.main import main
from radwrap.images import read_gray, write_exr, write_png

EDGE = np.repeat([[20, 20, 60, 140, 180, 180]], 60, axis=0).repeat(10, axis=1).astype(np.uint8)


def _noise() -> NDArray[np.uint8]:
    return np.random.default_rng(0).normal(100, 5, (60, 60)).astype(np.uint8)


def _colour(path: Path) -> None:
    codes = np.stack([EDGE, EDGE // 2, EDGE], axis=2)
    path.write_bytes(b"P6\n60 60\n255\n" + codes.tobytes())


def _not_a_number(path: Path) -> None:
    import OpenImageIO as oiio  # noqa: N813

    values = EDGE.astype(np.float32)
    values[3, 3] = np.nan
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), oiio.ImageSpec(60, 60, 1, "float"))
    assert output.write_image(values[:, :, np.newaxis])
    output.close()


def _cut(ending: str) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        whole = path.with_name(f"whole{ending}")
        if ending == ".pgm":
            whole.write_bytes(b"P5\n60 60\n255\n" + EDGE.tobytes())
        elif ending == ".exr":
            write_exr(whole, _noise().astype(np.float32), channel="Y")
        else:
            write_png(whole, _noise())
        path.write_bytes(whole.read_bytes()[: whole.stat().st_size * 2 // 3])

    return write


IMAGES: dict[str, Callable[[Path], object]] = {
    "blank.png": lambda path: write_png(path, np.full((60, 60), 30, np.uint8)),
    "saturated.png": lambda path: write_png(path, np.full((60, 60), 255, np.uint8)),
    "one.png": lambda path: write_png(path, np.full((1, 1), 30, np.uint8)),
    "colour.ppm": _colour,
    "nan.exr": _not_a_number,
    "cut.png": _cut(".png"),
    "cut.pgm": _cut(".pgm"),
    "cut.exr": _cut(".exr"),
    "empty.png": lambda path: path.write_bytes(b""),
    "text.png": lambda path: path.write_text("gray\n" * 40),
    "folder.png": lambda path: path.mkdir(),
    "missing.png": lambda path: None,
}
SAYS = {
    "saturated.png": "255|saturated",
    "one.png": "1 x 1|gray level 30 everywhere",
    "colour.ppm": "is in colour",
    "nan.exr": "holds NaN or infinity",
    "cut.png": "is not complete",
    "cut.pgm": "is not complete",
    "cut.exr": "is not complete",
    "empty.png": "is not an image",
    "text.png": "is not an image",
    "folder.png": "is not a regular file",
    "missing.png": "no such image",
}
VERBS: dict[str, Callable[[str], list[str]]] = {
    "dots": lambda image: ["measure", "dots", image, "--grid", "5x5"],
    "edge": lambda image: ["measure", "edge", image],
    "parts": lambda image: ["measure", "parts", image],
    "compare to": lambda image: ["compare", "edge.png", image],
    "compare": lambda image: ["compare", image, "edge.png"],
}
# A blank image differs from another by a number: that is told, with a warning.
TOLD = {("compare", "blank.png"), ("compare to", "blank.png")}


@pytest.mark.parametrize("image", IMAGES)
@pytest.mark.parametrize("verb", VERBS)
def test_a_broken_image_is_one_clear_error(
    verb: str, image: str, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_png(tmp_path / "edge.png", EDGE)
    IMAGES[image](tmp_path / image)
    code = main(VERBS[verb](image))
    out, err = capfd.readouterr()
    if (verb, image) in TOLD:
        assert code == 0
        assert "is blank: gray 30 all over" in out
        return
    assert code == 2
    assert out == ""
    assert re.search(f"^radwrap: .*({SAYS.get(image, 'gray')})", err)
    assert err.count("\n") == 1
    assert not [path for path in tmp_path.iterdir() if path.suffix == ".json"]


CAMERA = ["calibrate", "camera", "points.csv", "--pixel-width", "13.75 um", "--pixel-height", "16 um"]
CAMERA += ["--centre", "95.5", "82"]
HEADER = "x,y,z,u,v\n"
# A board of 3 x 3 dots as a camera tilted by 40 degrees sees it, far from exact.
SIDE = (-0.05, 0, 0.05)
BOARD = [f"{x},{y},0,{95 + 900 * x / (1 - 0.6 * y)},{82 + 600 * y / (1 - 0.6 * y)}\n" for x in SIDE for y in SIDE]
TABLES: dict[str, tuple[str | bytes | None, str]] = {
    "missing": (None, "no such file"),
    "empty": ("", "is empty"),
    "header alone": (HEADER, "points"),
    "no text": (b"\xff\xfe\x00\x01", "is not UTF-8 text"),
    "another column": ("x,y,z,u,v,w\n1,2,3,4,5,6\n", "the header is"),
    "a column twice": ("x,y,z,u,u\n1,2,3,4,5\n", "the header is"),
    "a short line": (HEADER + "1,2,3,4\n", "points.csv:2: holds 4 values"),
    "no number": (HEADER + "1,2,3,4,five\n", 'v "five" is not a number'),
    "NaN": (HEADER + "1,2,3,4,nan\n", "v nan is not a finite number"),
    "a blank line inside": (HEADER + BOARD[0] + "\n" + "".join(BOARD[1:]), "points.csv:3: holds 0 values"),
    "a point twice": (HEADER + "".join([*BOARD, BOARD[0]]), "point"),
    "collinear": (HEADER + "".join(f"{i / 100},{i / 50},0,{90 + i},{80 + 2 * i}\n" for i in range(9)), "line"),
    "four points": (HEADER + "".join(BOARD[:4]), "points"),
}


@pytest.mark.parametrize("name", TABLES)
def test_points_that_cannot_calibrate_are_one_clear_error(
    name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    content, says = TABLES[name]
    if content is not None:
        (tmp_path / "points.csv").write_bytes(content.encode() if isinstance(content, str) else content)
    assert main(CAMERA) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith("radwrap: points.csv")
    assert says in err


@pytest.mark.parametrize("grid", ["", "5", "5x", "0x5", "-1x5", "5x5x5", "axb", "1e9x1e9", "100000x100000", "1x1"])
def test_a_wrong_grid_is_one_clear_error(
    grid: str, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_png(tmp_path / "edge.png", EDGE)
    assert main(["measure", "dots", "edge.png", f"--grid={grid}"]) == 2
    out, err = capfd.readouterr()
    assert (out, err.count("\n")) == ("", 1)


WRITTEN = [
    ["measure", "dots", "edge.png", "--grid=5x5", "--overlay"],
    ["measure", "dots", "edge.png", "--grid=5x5", "--csv"],
    ["measure", "parts", "edge.png", "--overlay"],
    ["calibrate", "sensor", "frames.csv", "--plot"],
]


@pytest.mark.parametrize("argv", WRITTEN, ids=" ".join)
def test_a_file_that_cannot_be_written_is_told_first(
    argv: list[str], tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, told in (("nowhere/x.png", "there is no folder"), (".", "is not the name of a")):
        assert main([*argv, name]) == 2
        line = capfd.readouterr().err
        assert line.startswith(f"radwrap: {argv[-1]}: ") and told in line


def test_a_cut_jpeg_is_no_image(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    import OpenImageIO as oiio  # noqa: N813

    for name in ("whole.jpg", "cut.jpg"):
        output = oiio.ImageOutput.create(str(tmp_path / name))
        assert output.open(str(tmp_path / name), oiio.ImageSpec(60, 60, 1, "uint8"))
        assert output.write_image(EDGE[:, :, np.newaxis])
        output.close()
    whole = (tmp_path / "whole.jpg").read_bytes()
    (tmp_path / "cut.jpg").write_bytes(whole[: len(whole) * 2 // 3])
    read_gray(tmp_path / "whole.jpg")
    assert main(["measure", "edge", str(tmp_path / "cut.jpg")]) == 2
    assert "cut.jpg: is not complete: its end is missing" in capfd.readouterr().err


OPTIONS = {
    "--dark=500": ["measure", "parts", "edge.png"],
    "--dark=501": ["measure", "edge", "edge.png"],
    "--dark=nan": ["measure", "dots", "edge.png", "--grid=5x5"],
    "--saturation=-3": ["measure", "dots", "edge.png", "--grid=5x5"],
    "--saturation=nan": ["measure", "edge", "edge.png"],
}


@pytest.mark.parametrize("option", OPTIONS)
def test_a_gray_level_that_cannot_be_is_one_clear_error(
    option: str, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_png(tmp_path / "edge.png", EDGE)
    assert main([*OPTIONS[option], option]) == 2
    out, err = capfd.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert option.split("=", maxsplit=1)[0] in err


def test_a_file_that_the_reader_cannot_quote_is_one_clear_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The reader's message holds the file's own bytes, which need not be text; nor need the file's name."""
    write_exr(tmp_path / "edge.exr", EDGE.astype(np.float32), channel="Y")
    content = (tmp_path / "edge.exr").read_bytes()
    spoilt = content.replace(b"capDate\0", b"capDate\xff", 1)
    for name, written in (("a.exr", spoilt), (os.fsdecode(b"\xff.exr"), content)):
        (tmp_path / name).write_bytes(written)
        assert main(["measure", "edge", str(tmp_path / name)]) == 2
        told = capsys.readouterr().err
        assert told.count("\n") == 1 and ("is not an image" in told or "not UTF-8" in told)


def test_a_wild_pixel_is_compared_as_any_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wild = EDGE.astype(np.float32)
    wild[5, 5] = 3e38
    write_exr(tmp_path / "a.exr", EDGE.astype(np.float32), channel="Y")
    write_exr(tmp_path / "b.exr", wild, channel="Y")
    assert main(["compare", str(tmp_path / "a.exr"), str(tmp_path / "b.exr"), "--out", str(tmp_path / "out")]) in (0, 1)
    assert "Traceback" not in capsys.readouterr().err


NUMBERS = {
    "calibrate sensor": ("exposure_time,gray\n0.1,20\n0.2,1e300\n", []),
    "calibrate camera": (
        "x,y,z,u,v\n1e150,0,0,1,1\n",
        ["--pixel-width", "13 um", "--pixel-height", "16 um", "--centre", "9", "8"],
    ),
    "study analyse": ("A,y\nL,1\nH,-1e154\n", ["--response", "y"]),
}


@pytest.mark.parametrize("verb", NUMBERS)
def test_numbers_whose_squares_are_none_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], verb: str
) -> None:
    text, options = NUMBERS[verb]
    (tmp_path / "table.csv").write_text(text)
    assert main([*verb.split(), str(tmp_path / "table.csv"), *options]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1 and "is beyond 1e+30" in told


OVER = [
    ["measure", "parts", "edge.png", "--overlay", "edge.png"],
    ["measure", "dots", "edge.png", "--grid", "5x5", "--csv", "folder/../edge.png"],
    ["measure", "dots", "edge.png", "--grid", "5x5", "--overlay", "x.png", "--csv", "x.png"],
    ["led", "calibrate", "--table", "table.csv", "--drive", "drive.toml", "--out", "drive.toml"],
]


@pytest.mark.parametrize("words", OVER)
def test_no_result_takes_the_place_of_what_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    write_png(tmp_path / "edge.png", EDGE)
    (tmp_path / "table.csv").write_text("a\n")
    (tmp_path / "drive.toml").write_text("")
    before = {path.name: path.read_bytes() for path in tmp_path.glob("*.*")}
    assert main(words) == 2
    assert "choose another name" in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in tmp_path.glob("*.*")} == before
