"""Two images beside each other: known differences come back, and what cannot be compared says so."""

import argparse
import json
import math
import re
from collections.abc import Callable
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from radwrap.cli import compare as verb
from radwrap.cli.main import main
from radwrap.errors import CheckFailed, InputError
from radwrap.images import GrayImage, read_image, write_png
from radwrap.measure import compare as comparing
from radwrap.measure.compare import compare, registration, warped
from radwrap.measure.compare_statistics import rectangle, regions_of_mask
from radwrap.progress import Progress

SHAPE = (120, 160)
DARK = 22.0

SHIFT = 0.02  # px, noise of 1 gray on a board of dots (measured: 0.004)
CORNER = 0.1  # px, of a homography at the image's corners
RESAMPLED = 0.5  # gray rms, cubic splines on edges of 2 px


def board(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Smooth dots on a dark ground, at any point."""
    total = np.full(u.shape, DARK)
    for row in range(4):
        for column in range(5):
            radius = np.hypot((u - 30 - 24 * column - 3 * row) / 1.1, v - 22 - 24 * row - 1.5 * column)
            total = total + 140 / (1 + np.exp((radius - 9) / 1.2)) * (1 - 0.05 * row)
    return total


def grid(shape: tuple[int, int] = SHAPE) -> tuple[np.ndarray, np.ndarray]:
    v, u = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    return u, v


U, V = grid()
PREDICTED = GrayImage(board(U, V))


def photograph(
    u: float = 0.0, v: float = 0.0, *, factor: float = 1.0, offset: float = 0.0, noise: float = 1.0
) -> GrayImage:
    random = np.random.default_rng(5)
    values = factor * (board(U - u, V - v) - DARK) + DARK + offset + noise * random.standard_normal(SHAPE)
    return GrayImage(np.clip(np.rint(values), 0, 255))


def test_statistics_by_closed_form() -> None:
    """Predicted 100; captured 100, but 110 on 4 of 100 pixels and 80 on 1."""
    predicted = np.full((10, 10), 100.0)
    captured = predicted.copy()
    captured[0, :4] = 110
    captured[7, 3] = 80
    found = compare(GrayImage(captured), GrayImage(predicted), tolerance=10)
    overall = found.overall
    assert overall.mean == pytest.approx(0.2)
    assert overall.rms == pytest.approx(math.sqrt(8))
    assert (overall.median, overall.maximum, overall.pixels) == (0, 20, 100)
    assert overall.beyond == pytest.approx(0.01)
    assert found.worst == (3, 7)
    assert found.levels.gain is None
    edges, in_captured, in_predicted = found.histograms()
    assert in_predicted[100] == 100
    assert (in_captured[80], in_captured[100], in_captured[110]) == (1, 95, 4)
    assert edges[100] < 100 < edges[101]


def test_equal_images_do_not_differ() -> None:
    found = compare(PREDICTED, PREDICTED)
    assert found.overall.maximum == 0
    assert (found.levels.gain, found.levels.offset) == pytest.approx((1.0, 0.0), abs=1e-12)
    assert found.causes.mainly is None


def test_gain_and_offset_come_back_exactly() -> None:
    found = compare(GrayImage(1.25 * PREDICTED.values - 7), PREDICTED)
    assert (found.levels.gain, found.levels.offset) == pytest.approx((1.25, -7.0), rel=1e-9)
    assert found.levels.correlation == pytest.approx(1.0)


def test_gain_and_offset_lie_within_their_standard_errors() -> None:
    """Noise that is independent from pixel to pixel, 3 sigma of each."""
    random = np.random.default_rng(3)
    captured = 1.1 * PREDICTED.values + 4 + 2 * random.standard_normal(SHAPE)
    levels = compare(GrayImage(captured), PREDICTED).levels
    assert levels.gain is not None and levels.offset is not None
    assert levels.gain_sigma is not None and levels.offset_sigma is not None
    assert abs(levels.gain - 1.1) < 3 * levels.gain_sigma < 0.003
    assert abs(levels.offset - 4) < 3 * levels.offset_sigma


@pytest.mark.parametrize(
    ("captured", "mainly"),
    [
        (photograph(), None),
        (photograph(offset=6), "dark level"),
        (photograph(factor=0.8), "exposure"),
        (photograph(1.5, -2.0), "geometry"),
        (photograph(0.3, 0.2, factor=0.7), "exposure"),
    ],
)
def test_the_main_cause_is_named(captured: GrayImage, mainly: str | None) -> None:
    assert compare(captured, PREDICTED, dark=DARK).causes.mainly == mainly


@pytest.mark.parametrize("striped", [False, True])
def test_noise_is_no_matter_of_place(striped: bool) -> None:
    """A place along straight lines is found by the noise only, and splines halfway between pixels would smooth that."""
    random = np.random.default_rng(5)
    u = np.indices((96, 128))[1]
    predicted = 100.0 + (60.0 * ((u // 4) % 2) if striped else 5.0 * (u > 64))
    for _ in range(4):
        causes = compare(GrayImage(predicted + random.normal(0, 8, u.shape)), GrayImage(predicted)).causes
        assert causes.mainly is None
        assert causes.shift is not None, "nothing was registered, so that nothing was tried"
        assert causes.geometry == pytest.approx(causes.as_is, rel=0.02)


def test_the_factor_of_the_exposure_comes_back() -> None:
    causes = compare(photograph(factor=0.8), PREDICTED, dark=DARK).causes
    assert causes.exposure_factor == pytest.approx(0.8, abs=1e-3)
    assert causes.dark_gray == DARK
    assert compare(photograph(factor=0.8), PREDICTED).causes.dark_gray == PREDICTED.values.min()
    assert causes.exposure == pytest.approx(1.0, abs=0.1)  # the noise of 1 gray, and rounding


@pytest.mark.parametrize("shift", [(0.25, 0.5), (3.3, -2.7), (-11.4, 9.2)])
@pytest.mark.parametrize("factor", [1.0, 0.6])
def test_a_shift_is_found_and_taken_back(shift: tuple[float, float], factor: float) -> None:
    """Dots 24 px apart: a shift of half that is still the nearest."""
    found = compare(photograph(*shift, factor=factor), PREDICTED, register="translation", dark=DARK)
    assert found.warp[:2, 2] == pytest.approx(shift, abs=SHIFT)
    assert found.causes.exposure_factor == pytest.approx(factor, abs=5e-3)
    assert found.causes.exposure < 1.2
    assert np.isnan(found.captured).sum() >= int(abs(shift[0])) * SHAPE[0]


def test_a_homography_is_found_between_images_of_different_size() -> None:
    true = np.array([[1.3, 0.03, 4], [-0.02, 1.25, -3], [1e-4, -5e-5, 1]])
    u, v = grid((155, 215))
    back = np.linalg.inv(true) @ np.stack([u.ravel(), v.ravel(), np.ones(u.size)])
    captured = GrayImage(np.rint(board(back[0] / back[2], back[1] / back[2])).reshape(u.shape))
    found = compare(captured, PREDICTED, register="homography")
    corners = np.array([[0, SHAPE[1] - 1, 0, SHAPE[1] - 1], [0, 0, SHAPE[0] - 1, SHAPE[0] - 1], [1, 1, 1, 1.0]])
    one, other = true @ corners, found.warp @ corners
    assert one[:2] / one[2] == pytest.approx(other[:2] / other[2], abs=CORNER)
    assert found.overall.rms < RESAMPLED


def test_looking_up_between_pixels_keeps_a_smooth_image() -> None:
    moved = warped(board(U, V), np.array([[1, 0, 0.5], [0, 1, -0.25], [0, 0, 1.0]]), SHAPE)
    inside = np.isfinite(moved)
    assert np.abs(moved - board(U + 0.5, V - 0.25))[inside].max() < RESAMPLED
    unmoved = warped(PREDICTED.values, np.eye(3), SHAPE)
    assert np.array_equal(unmoved, PREDICTED.values)


def test_saturated_pixels_say_nothing_of_the_gain() -> None:
    clipped = GrayImage(np.minimum(1.3 * (PREDICTED.values - DARK) + DARK, 181.0))
    found = compare(clipped, PREDICTED, saturation=181.0, dark=DARK)
    assert found.levels.gain == pytest.approx(1.3)
    assert found.causes.exposure_factor == pytest.approx(1.3)


def test_regions_have_their_own_statistics() -> None:
    captured = PREDICTED.values.copy()
    captured[10:20, 30:50] += 5
    mask = np.zeros(SHAPE, dtype=np.uint16)
    mask[10:20, 30:50] = 2
    regions = [rectangle("box", (30, 10, 50, 20), SHAPE), *regions_of_mask(mask, {2: "board.dots"})]
    found = compare(GrayImage(captured), PREDICTED, regions=regions).regions
    assert list(found) == ["box", "nothing", "board.dots"]
    assert (found["box"].mean, found["box"].pixels) == (pytest.approx(5), 200)
    assert found["board.dots"].rms == pytest.approx(5)
    assert found["nothing"].maximum == 0


@pytest.mark.parametrize("kind", ["translation", "homography"])
def test_images_of_different_things_are_not_registered(kind: Any) -> None:
    random = np.random.default_rng(2)
    with pytest.raises(InputError, match="cannot be registered"):
        registration(255 * random.random(SHAPE), PREDICTED.values, kind)


def test_an_even_image_is_not_registered() -> None:
    with pytest.raises(InputError, match="an even image"):
        compare(GrayImage(np.full(SHAPE, 9.0)), PREDICTED, register="translation")
    assert compare(GrayImage(np.full(SHAPE, 9.0)), PREDICTED).causes.geometry is None


@pytest.mark.parametrize("kind", ["none", "translation"])
def test_different_sizes_need_a_homography(kind: Any) -> None:
    with pytest.raises(InputError, match="160 x 119 pixels, the predicted one 160 x 120"):
        compare(GrayImage(PREDICTED.values[1:]), PREDICTED, register=kind)


def test_a_region_of_another_size_or_beyond_the_photograph() -> None:
    with pytest.raises(InputError, match="is made for 3 x 2 pixels"):
        compare(PREDICTED, PREDICTED, regions=[rectangle("r", (0, 0, 1, 1), (2, 3))])
    edge = rectangle("edge", (0, 0, 3, 120), SHAPE)
    with pytest.raises(InputError, match='region "edge": has no pixel to compare'):
        compare(photograph(-8.0, 0.0), PREDICTED, register="translation", regions=[edge])


@pytest.mark.parametrize("corners", [(0, 0, 0, 5), (5, 0, 4, 5), (-1, 0, 4, 5), (0, 0, 161, 5), (0, 0, 5, 121)])
def test_rectangles_lie_within_the_image(corners: tuple[int, int, int, int]) -> None:
    with pytest.raises(InputError, match="is not a part of"):
        rectangle("r", corners, SHAPE)


def command(*words: object) -> int:
    parser = argparse.ArgumentParser()
    verb.add_to(parser.add_subparsers())
    arguments = parser.parse_args(["compare", *map(str, words)])
    code: int = arguments.run(arguments)
    return code


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    paths = tmp_path / "captured.png", tmp_path / "predicted.png"
    for path, image in zip(paths, (photograph(2.0, 1.0), PREDICTED), strict=True):
        write_png(path, image.codes)
    return paths


def test_the_command_writes_its_three_files(
    files: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert command(*files, "--out", out, "--json", "--region", "box:0,0,40,40", "--register", "translation") == 0
    printed = capsys.readouterr().out
    assert (out / "compare.json").read_text() == printed
    found = json.loads(printed)
    assert found["registration"]["shift_px"] == pytest.approx([2, 1], abs=SHIFT)
    assert found["regions"]["box"]["pixels"] == 40 * 40
    assert len(found["profiles"]["row"]["predicted"]) == SHAPE[1]
    assert None in found["profiles"]["row"]["captured"]
    assert (out / "report.png").read_bytes().startswith(b"\x89PNG")
    codes, _ = read_image(out / "diff.png")
    assert codes.shape == SHAPE
    assert (codes == 0).sum() == round((1 - found["registration"]["covered"]) * codes.size)
    first = {path.name: path.read_bytes() for path in out.iterdir()}
    command(*files, "--out", out, "--region", "box:0,0,40,40", "--register", "translation")
    assert first == {path.name: path.read_bytes() for path in out.iterdir()}


def test_the_tolerance_decides_the_exit_code(files: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert command(*files, "--tolerance", "200") == 0
    with pytest.raises(CheckFailed) as error:
        command(*files, "--tolerance", "10")
    assert error.value.exit_code == 1
    assert "differ by more than 10 gray" in str(error.value)
    assert command(*files, "--tolerance", "10", "--allow-beyond", "0.5") == 0
    assert "mainly: geometry" in capsys.readouterr().out


def test_a_mask_has_its_names_from_truth(
    files: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mask = np.zeros(SHAPE, dtype=np.uint16)
    mask[PREDICTED.values > 90] = 1
    write_png(tmp_path / "mask.png", mask)
    command(*files, "--mask", tmp_path / "mask.png", "--json")
    assert set(json.loads(capsys.readouterr().out)["regions"]) == {"nothing", "part 1"}
    (tmp_path / "truth.json").write_text('{"parts": {"board.dots": 1}}')
    command(*files, "--mask", tmp_path / "mask.png", "--json")
    assert set(json.loads(capsys.readouterr().out)["regions"]) == {"nothing", "board.dots"}
    (tmp_path / "truth.json").write_text("[]")
    with pytest.raises(InputError, match="input should be an object"):
        command(*files, "--mask", tmp_path / "mask.png")


def test_bits_that_differ_are_told(
    files: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_png(tmp_path / "wide.png", (photograph().codes * np.uint16(257)).astype(np.uint16))
    command(tmp_path / "wide.png", files[1])
    assert "warning: the captured file holds 16 bits" in capsys.readouterr().out


def _colour(path: Path) -> None:
    # A 1 x 1 PPM: red.
    path.write_bytes(b"P6\n1 1\n255\n\xff\x00\x00")


def _truncated(path: Path) -> None:
    write_png(path.with_suffix(".png"), PREDICTED.codes)
    content = path.with_suffix(".png").read_bytes()
    path.write_bytes(content[: len(content) // 2])


def _nan(path: Path) -> None:
    # A portable float map of one pixel.
    path.write_bytes(b"Pf\n1 1\n-1.0\n" + np.array([np.nan], np.float32).tobytes())


def _nothing(path: Path) -> None:
    assert not path.exists()


def _text(path: Path) -> None:
    path.write_text("no image")


@pytest.mark.parametrize(
    ("write", "name", "message"),
    [
        (_colour, "c.ppm", "is in colour"),
        (_truncated, "t.bin", "is not complete|is not an image"),
        (_nan, "n.pfm", "holds NaN"),
        (_nothing, "missing.png", "no such image"),
        (_text, "text.png", "is not an image"),
    ],
)
def test_images_that_cannot_be_compared(
    files: tuple[Path, Path], tmp_path: Path, write: Callable[[Path], None], name: str, message: str
) -> None:
    write(tmp_path / name)
    with pytest.raises(InputError, match=message):
        command(tmp_path / name, files[1])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--region", "box"), "is not NAME:U0,V0,U1,V1"),
        (("--region", "1,2,3,4"), "has no name"),
        (("--region", "a:0,0,1,1", "--region", "a:0,0,2,2"), "two regions have the name"),
        (("--tolerance", "-1"), "--tolerance: must be a number"),
        (("--allow-beyond", "2"), "--allow-beyond: must be a number"),
        (("--truth", "truth.json"), "goes with --mask"),
    ],
)
def test_options_that_cannot_be_used(files: tuple[Path, Path], words: tuple[str, ...], message: str) -> None:
    with pytest.raises(InputError) as error:
        command(*files, *words)
    assert message in str(error.value)


def test_an_image_is_moved_in_bands_as_it_would_be_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(comparing, "_BAND", 7)
    warp = np.array([[1.01, 0.02, 0.5], [-0.01, 0.99, -0.25], [1e-5, 2e-5, 1.0]])
    image = np.random.default_rng(0).uniform(0, 255, (40, 50))
    v, u = np.mgrid[:40, :50].astype(float)
    x, y, w = np.einsum("ij,jrc->irc", warp, np.stack([u, v, np.ones_like(u)]))
    whole = map_coordinates(image, [y / w, x / w], order=3, mode="nearest").clip(image.min(), image.max())
    moved = warped(image, warp, (40, 50))
    seen = np.isfinite(moved)
    assert 0.8 < seen.mean() < 1
    assert moved[seen] == pytest.approx(whole[seen], abs=1e-9)


def test_large_images_are_registered_on_smaller_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each twice as small: the shift is as good as on the whole ones, and all of them is counted."""
    monkeypatch.setattr(comparing, "MOST_REGISTERED", PREDICTED.values.size // 2)
    monkeypatch.setattr("radwrap.progress._LOG_PERIOD", 0.0)
    told = StringIO()
    shifted = GrayImage(board(U + 0.4, V - 1.3))
    found = compare(shifted, PREDICTED, register="translation", progress=Progress("comparing", 1, stream=told))
    assert found.warp[:2, 2] == pytest.approx([-0.4, 1.3], abs=0.02)
    shares = [int(share) for share in re.findall(r"comparing +(\d+) %", told.getvalue())]
    assert 0 < shares[0] < 50 and shares[-1] == 100


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--dark", "200", "--saturation", "100"], "--dark: 200 is not below --saturation 100"),
        (["--allow-beyond", "7", "--tolerance", "1"], "--allow-beyond: must be a number from 0 to 1"),
        (["--allow-beyond", "0.5"], "--allow-beyond: is of pixels beyond a tolerance; give --tolerance"),
    ],
)
def test_options_that_mean_nothing_are_refused(
    options: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["compare", "captured.png", "predicted.png", *options]) == 2
    assert capsys.readouterr().err == f"radwrap: {told}\n"
