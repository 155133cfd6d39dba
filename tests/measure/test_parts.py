"""Parts of known area, place and direction; what their standard errors promise; and what is no part."""

import argparse
import importlib.util
import json
import math
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from radwrap.cli import measure_parts as command
from radwrap.errors import InputError
from radwrap.images import GrayImage, write_png
from radwrap.measure.background import background_surface
from radwrap.measure.parts import Part, find_parts, level

Array = NDArray[np.float64]


def _benchmark() -> ModuleType:
    """The script that the table comes from; its shapes, exact coverage and closed-form moments are used here too."""
    path = Path(__file__).parents[2] / "scripts" / "parts_benchmark.py"
    spec = importlib.util.spec_from_file_location("parts_benchmark", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


bench = _benchmark()
SHAPE = (64, 72)
# Even light, no noise, no rounding: what remains is the pixel grid, of the order of GRID_ERROR sqrt(perimeter)/area.
GRID = 0.004  # px, and rad


def ellipse(u: float, v: float, a: float, b: float, turn: float) -> Array:
    return bench.coverage(bench.placed([bench.circle(720, 1.0) * [a, b]], u, v, turn), *SHAPE)


def rectangle(u: float, v: float, length: float, width: float, turn: float) -> Array:
    corners = np.array([[-length, -width], [length, -width], [length, width], [-length, width]]) / 2
    return bench.coverage(bench.placed([corners], u, v, turn), *SHAPE)


def dark_on_bright(share: Array) -> GrayImage:
    return GrayImage(200 - 160 * share, bit_depth=16)


def only(image: GrayImage, **options: Any) -> Part:
    (part,) = find_parts(image, **options).parts
    return part


def test_coverage_is_exact_on_rectangles_known_by_hand() -> None:
    """1.5 x 2.25 px about (3, 3): whole pixels 1, sides 1/4 and 5/8, corners their product."""
    share = bench.coverage([np.array([[2.25, 1.875], [3.75, 1.875], [3.75, 4.125], [2.25, 4.125]])], 7, 7)
    side = np.array([0, 0, 0.25, 1, 0.25, 0, 0])
    assert share == pytest.approx(np.outer([0, 0, 0.625, 1, 0.625, 0, 0], side), abs=1e-12)


def test_moments_of_the_ellipse_and_the_rectangle_are_those_of_the_textbook() -> None:
    """Area pi a b; (a^2 - b^2)/(a^2 + b^2), for a rectangle with its half sides."""
    round_one = bench.moments(bench.placed([bench.circle(5000, 1.0) * [9, 4]], 5, 6, 0.7))
    assert round_one == pytest.approx((36 * math.pi, 5, 6, 0.7, (81 - 16) / (81 + 16)), rel=1e-5)
    square_one = bench.moments(bench.placed([np.array([[-6.0, -2], [6, -2], [6, 2], [-6, 2]])], -3, 2, -1.2))
    assert square_one == pytest.approx((48, -3, 2, -1.2, (36 - 4) / (36 + 4)), rel=1e-12)


@pytest.mark.parametrize("turn", [0.0, 0.4, math.pi / 2, -1.0])
def test_an_ellipse_gives_its_axes(turn: float) -> None:
    part = only(dark_on_bright(ellipse(34.3, 30.7, 16, 9, turn)))
    assert (part.u, part.v) == pytest.approx((34.3, 30.7), abs=GRID)
    assert bench.turned(part.orientation, turn, math.pi) == pytest.approx(0, abs=GRID)
    assert part.area == pytest.approx(144 * math.pi, rel=1e-4)
    assert (part.major_axis, part.minor_axis) == pytest.approx((32, 18), rel=1e-3)
    assert not part.orientation_ambiguous
    assert not part.touches_border


@pytest.mark.parametrize("turn", [0.0, 0.3, 1.2])
def test_a_rectangle_gives_its_sides(turn: float) -> None:
    """Second moments l^2/12 and w^2/12 are those of an ellipse with axes of 2 l/sqrt 3 and 2 w/sqrt 3."""
    part = only(dark_on_bright(rectangle(35.2, 31.9, 30, 14, turn)))
    assert (part.u, part.v) == pytest.approx((35.2, 31.9), abs=GRID)
    assert part.area == pytest.approx(420, rel=1e-4)
    # Sides along rows shift their part of m by the width times p (1 - p)/2 - 1/12, at most 1/24 px^2 m^(1/2).
    assert (part.major_axis, part.minor_axis) == pytest.approx((60 / 3**0.5, 28 / 3**0.5), rel=5e-3)
    assert bench.turned(part.orientation, turn, math.pi) == pytest.approx(0, abs=GRID)
    # The contour cuts corners, and runs straight between pixel centres.
    assert bench.turned(part.rectangle_orientation, turn, math.pi) == pytest.approx(0, abs=0.01)
    assert part.rectangle[2:] == pytest.approx((30, 14), abs=0.35)
    assert part.rectangle[:2] == pytest.approx((35.2, 31.9), abs=0.15)


def test_bright_parts_are_dark_ones_turned_over() -> None:
    share = ellipse(34.3, 30.7, 16, 9, 0.4)
    dark, bright = find_parts(dark_on_bright(share)), find_parts(GrayImage(40 + 160 * share, bit_depth=16))
    assert (dark.kind, bright.kind) == ("dark", "bright")
    assert bright.parts[0].u == pytest.approx(dark.parts[0].u, abs=1e-9)
    assert bright.parts[0].area == pytest.approx(dark.parts[0].area, abs=1e-6)


def test_blur_changes_neither_place_nor_area_nor_axes() -> None:
    share = bench.blurred(ellipse(34.3, 30.7, 16, 9, 0.4), 3.0)
    part = only(dark_on_bright(share))
    assert (part.u, part.v) == pytest.approx((34.3, 30.7), abs=1e-3)
    assert part.area == pytest.approx(144 * math.pi, rel=1e-3)
    assert (part.major_axis, part.minor_axis) == pytest.approx((32, 18), rel=5e-3)
    assert part.blur_radius == pytest.approx(3.0, rel=0.1)


def test_gamma_is_taken_out() -> None:
    """Blurred by 3 px and of gamma 0.6: as linear light its area is right, as gray level off by 6 %."""
    share = bench.blurred(ellipse(34.3, 30.7, 16, 9, 0.4), 3.0)
    image = GrayImage(20 + 180 * np.maximum(1 - 0.9 * share, 0) ** 0.6, bit_depth=16)
    right, wrong = only(image, dark=20.0, gamma=0.6), only(image)
    assert right.area == pytest.approx(144 * math.pi, rel=1e-3)
    assert abs(wrong.area / (144 * math.pi) - 1) > 0.02


@pytest.mark.parametrize("kind", ["dark", "bright"])
def test_a_blob_of_light_is_no_part_and_moves_none(kind: str) -> None:
    """Retroreflective background under an LED: a Gaussian of sigma 40 px, part off its middle."""
    v, u = np.indices(SHAPE)
    light = np.exp(-((u - 36) ** 2 + (v - 32) ** 2) / 2 / 40**2)
    share = bench.blurred(rectangle(41.2, 27.9, 20, 10, 0.5), 1.0)
    reflected = 1 - 0.95 * share if kind == "dark" else 0.1 + 0.8 * share
    found = find_parts(GrayImage(20 + 180 * light * reflected, bit_depth=16))
    assert found.kind == kind
    (part,) = found.parts
    assert (part.u, part.v) == pytest.approx((41.2, 27.9), abs=0.02)
    assert part.area == pytest.approx(200, rel=0.01)
    assert bench.turned(part.orientation, 0.5, math.pi) == pytest.approx(0, abs=2e-3)


@pytest.mark.parametrize("corners", [4, 6, 90])
def test_square_nut_and_disc_tell_that_they_have_no_axis(corners: int) -> None:
    image = dark_on_bright(bench.coverage(bench.placed([bench.circle(corners, 12.0)], 35.3, 31.2, 0.3), *SHAPE))
    assert only(image).orientation_ambiguous


def test_holes_do_not_count() -> None:
    outlines = bench.placed([bench.circle(6, 14.0), bench.circle(200, 6.0)[::-1]], 35.3, 31.2, 0.2)
    part = only(dark_on_bright(bench.coverage(outlines, *SHAPE)))
    assert part.area == pytest.approx(1.5 * 3**0.5 * 14**2 - 36 * math.pi, rel=5e-4)
    assert (part.u, part.v) == pytest.approx((35.3, 31.2), abs=GRID)


def test_several_parts_are_counted_from_top_to_bottom() -> None:
    share = ellipse(50, 12, 9, 6, 0.2) + ellipse(20, 30, 10, 6, 1.2) + rectangle(52, 48, 16, 8, 0.4)
    found = find_parts(dark_on_bright(share)).parts
    assert [(round(part.u), round(part.v)) for part in found] == [(50, 12), (20, 30), (52, 48)]
    assert len(find_parts(dark_on_bright(share), min_area=180).parts) == 1


def test_a_part_that_is_cut_says_so() -> None:
    assert only(dark_on_bright(ellipse(4, 30, 12, 8, 0.0))).touches_border


def test_the_threshold_is_a_gray_level() -> None:
    """A stain of a third of the contrast is a part below gray 170, none below gray 120."""
    share = ellipse(20, 32, 10, 7, 0.3) + 0.35 * ellipse(52, 32, 10, 7, 0.3)
    image = dark_on_bright(share)
    assert len(find_parts(image, threshold=170.0).parts) == 2
    assert len(find_parts(image, threshold=120.0).parts) == 1


PHOTOGRAPHED = [("L", 0.0), ("ellipse", 1.5), ("triangle", 0.0)]


def pulls_of(name: str, radius: float, count: int) -> dict[str, list[float]]:
    """Errors over their sigmas by what is measured, from so many placements."""
    generator = np.random.default_rng(8)
    pulls: dict[str, list[float]] = {}
    for _ in range(count):
        turn = generator.uniform(-math.pi, math.pi)
        outlines = bench.placed(bench.shapes()[name], *generator.uniform([35, 32], [52, 48]), turn)
        part = only(bench.photograph(outlines, generator, radius=radius, noise=1.5))
        for key, (error, sigma) in bench.errors(part, outlines, turn, name).items():
            if sigma is not None:
                pulls.setdefault(key, []).append(error / sigma)
    assert pulls.keys() == {"u", "v", "area", "orientation"}
    assert {len(values) for values in pulls.values()} == {count}
    return pulls


def sigmas_hold(pulls: dict[str, list[float]]) -> None:
    """Rms of error/sigma within 3.5 sigma of 1 above, and not less than half below."""
    for key, values in pulls.items():
        square = float(np.mean(np.square(values)))
        assert 0.25 < square < 1 + 3.5 * math.sqrt(2 / len(values)), (key, square)


@pytest.mark.long
def test_standard_errors_cover_what_a_few_placements_do() -> None:
    """Eight placements of each of three shapes, 24 pulls of each number.

    Its mean square must stay below 2.0: errors half as large again as stated, 2.25 +- .65, are found in 6 of 10
    samples, twice as large, 4 +- 1.2, in 98 of 100; sixty of each shape find the former too (long).
    """
    each = [pulls_of(name, radius, 8) for name, radius in PHOTOGRAPHED]
    sigmas_hold({key: [value for pulls in each for value in pulls[key]] for key in each[0]})


@pytest.mark.long
@pytest.mark.parametrize(("name", "radius"), PHOTOGRAPHED)
def test_standard_errors_cover_what_noise_light_and_grid_do(name: str, radius: float) -> None:
    """60 placements of one shape."""
    sigmas_hold(pulls_of(name, radius, 60))


def test_the_background_is_found_behind_a_large_part() -> None:
    """A third of the image covered; the surface is the light's own."""
    v, u = np.indices(SHAPE)
    light = 200 - 0.02 * (u - 20.0) ** 2 - 0.5 * v
    kind, surface = background_surface(light * (1 - 0.8 * rectangle(36, 32, 48, 32, 0.1)))
    assert kind == "dark"
    assert np.abs(surface - light).max() < 0.5


def test_light_that_varies_under_the_blur_moves_no_part() -> None:
    """Slope g of ln light moves a centroid by g (R^2/4 + 1/12), here 0.08 px."""
    u = np.indices(SHAPE)[1]
    unblurred = np.exp(0.03 * (u - 36.0)) * (1 - 0.95 * ellipse(34.3, 30.7, 16, 9, 0.4))
    part = only(GrayImage(100 * bench.blurred(np.pad(unblurred, 20, mode="edge"), 3.2)[20:-20, 20:-20], bit_depth=16))
    assert (part.u, part.v) == pytest.approx((34.3, 30.7), abs=0.01)


def test_blur_that_is_round_on_oblong_pixels_turns_no_axis() -> None:
    """Second moments of the blur differ along rows and columns: an axis at 45 degrees turns by 7 mrad."""
    radius, aspect = 3.2, 1.25
    finer = bench.coverage(bench.placed([bench.circle(720, 1.0) * [64, 36]], 145.5, 129.5, 0.7), 260, 290)
    blurred = bench.blurred(finer, radius * 4)
    cells = blurred.reshape(52, 5, 290)[:, :, :288].reshape(52, 5, 72, 4).mean(axis=(1, 3))
    image = GrayImage(200 - 160 * cells, bit_depth=16)
    # Four fine pixels make a column, five a row.
    true = (
        math.atan2(
            2 * 0.5 * math.sin(1.4) * (64**2 - 36**2) / 20,
            (64**2 * math.cos(0.7) ** 2 + 36**2 * math.sin(0.7) ** 2) / 16
            - (64**2 * math.sin(0.7) ** 2 + 36**2 * math.cos(0.7) ** 2) / 25,
        )
        / 2
    )
    assert only(image, pixel_aspect=aspect).orientation == pytest.approx(true, abs=1e-3)
    assert abs(only(image).orientation - true) > 3e-3
    assert only(image, pixel_aspect=aspect).blur_radius == pytest.approx(radius, rel=0.05)


@pytest.mark.parametrize("kinds", [{}, {"dark": 22.0, "gamma": 0.85}])
@pytest.mark.parametrize(("width", "centre"), [(26, (36, 32)), (30, (50, 45)), (34, (15, 50))])
def test_a_narrow_beam_makes_no_parts_of_the_corners(
    width: float, centre: tuple[int, int], kinds: dict[str, float]
) -> None:
    """The beam falls to nothing at the border; a part in it is found, and nothing without it."""
    v, u = np.indices(SHAPE)
    light = np.exp(-4 * math.log(2) * ((u - centre[0]) ** 2 + (v - centre[1]) ** 2) / width**2)
    noise = np.random.default_rng(3).normal(0, 1, SHAPE)

    def image(share: Array) -> GrayImage:
        return GrayImage(np.clip(np.rint(22 + 128 * (light * (1 - share)) ** 0.85 + noise), 0, 255))

    with pytest.raises(InputError, match="no part"):
        find_parts(image(np.zeros(SHAPE)), **kinds)
    part = only(image(0.99 * rectangle(centre[0] + 1, centre[1] - 2, 14, 8, 0.4)), **kinds)
    assert (part.u, part.v) == pytest.approx((centre[0] + 1, centre[1] - 2), abs=0.5)


@pytest.mark.parametrize("count", [14, pytest.param(40, marks=pytest.mark.long)])
def test_standard_errors_hold_where_light_varies_and_gray_levels_are_coarse(count: int) -> None:
    """Rounding is the same at neighbours; placements on a beam of 40 gray levels, without noise to dither it.

    A mean of squares of normal numbers is 1 within 3.5 sqrt(2/count): below 1.8 of 40, and below 2.3 of 14, which find
    errors twice as large as stated, 4 +- 1.5, in 87 of 100 samples for each of the four numbers.
    """
    generator = np.random.default_rng(4)
    v, u = np.indices(SHAPE)
    light = np.exp(-((u - 30) ** 2 + (v - 40) ** 2) / 2 / 40**2)
    pulls = []
    for _ in range(count):
        turn = generator.uniform(-math.pi, math.pi)
        outlines = bench.placed([bench.shapes()["triangle"][0]], *generator.uniform([32, 28], [40, 36]), turn)
        share = bench.blurred(bench.coverage(outlines, *SHAPE), 1.8)
        part = only(GrayImage(np.rint(22 + 40 * light * (1 - 0.97 * share))))
        found = bench.errors(part, outlines, turn, "triangle")
        pulls.append([found[key][0] / found[key][1] for key in ("u", "v", "orientation", "area")])
    squares = np.mean(np.square(pulls), axis=0)
    assert (squares < 1 + 3.5 * math.sqrt(2 / count)).all(), squares
    assert (squares > 0.1).all(), squares


NOISE = np.random.default_rng(1)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.full(SHAPE, 50.0), "is blank: gray 50"),
        (np.full(SHAPE, 255.0), "is saturated: 100%"),
        (np.full((1, 1), 50.0), "1 x 1 pixels, parts need 8 x 8"),
        (NOISE.normal(100, 5, SHAPE), "no part"),
        (NOISE.integers(0, 256, SHAPE).astype(float), "no part"),
        (2.0 * np.indices(SHAPE)[1], "no part"),
        (np.where(ellipse(30, 30, 2, 1.5, 0.0) > 0.5, 40.0, 200.0), "no part of 20 px"),
    ],
)
def test_what_shows_no_part_is_refused(values: Array, message: str) -> None:
    with pytest.raises(InputError, match=message):
        find_parts(GrayImage(values))


@pytest.mark.parametrize(
    ("options", "where"),
    [
        ({"threshold": 10.0}, "threshold"),
        ({"min_area": 0.0}, "min_area"),
        ({"min_area": math.nan}, "min_area"),
        ({"gamma": 0.0}, "gamma"),
        ({"gamma": 0.85}, "dark"),
        ({"pixel_aspect": 0.0}, "pixel_aspect"),
        ({"pixel_aspect": math.nan}, "pixel_aspect"),
        ({"min_area": 1e6}, "the image"),
    ],
)
def test_wrong_options_are_named(options: dict[str, Any], where: str) -> None:
    with pytest.raises(InputError) as caught:
        find_parts(dark_on_bright(ellipse(34.3, 30.7, 16, 9, 0.0)), **options)
    assert caught.value.where == where


def run(*arguments: str) -> int:
    parser = argparse.ArgumentParser()
    command.add_to(parser.add_subparsers())
    parsed = parser.parse_args(["parts", *arguments])
    return int(parsed.run(parsed))


def test_the_command_tells_what_the_function_finds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, overlay = tmp_path / "parts.png", tmp_path / "seen.png"
    share = ellipse(24, 30, 12, 7, 0.3) + ellipse(54, 40, 8, 8, 0.0)
    write_png(path, np.rint(dark_on_bright(share).values).astype(np.uint8))
    assert run(str(path), "--json", "--overlay", str(overlay)) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["schema_version"], told["count"], told["contrast"]) == (1, 2, "dark")
    assert told["parts"][0]["orientation"] == pytest.approx(0.3, abs=0.01)
    assert [part["orientation_ambiguous"] for part in told["parts"]] == [False, True]
    assert overlay.read_bytes().startswith(b"\x89PNG")
    assert run(str(path)) == 0
    text = capsys.readouterr().out
    assert text.startswith("2 dark parts\n")
    assert "no axis by moments" in text


PATCH = 37 * 31  # px^2, of a chart of twelve, 6 px apart and from the border
CHART = (118, 178)


def chart(ground: float) -> Array:
    """Patches of twelve levels from gray 20 to 235 on an even ground."""
    values = np.full(CHART, ground)
    for number, gray in enumerate(np.linspace(20, 235, 12)):
        row, column = divmod(number, 4)
        values[6 + 37 * row :][:31, 6 + 43 * column :][:, :37] = gray
    return values


@pytest.mark.parametrize("ground", [30.0, 60.0, 150.0, 210.0])
def test_the_ground_of_a_chart_is_what_lies_at_its_border(ground: float) -> None:
    """Patches cover 66 % of the image, so that by area alone a surface through some of them served better.

    Of a ground 6 px wide between other levels the area of a patch is right to some percent only.
    """
    found = find_parts(GrayImage(np.rint(chart(ground) + np.random.default_rng(3).normal(0, 1, CHART))))
    assert found.kind == ("bright" if ground < 128 else "dark")
    assert len(found.parts) >= 6
    for part in found.parts:
        assert part.area == pytest.approx(PATCH, rel=0.06)
        assert not part.touches_border
    assert found.ground.gray == pytest.approx(ground, abs=1)
    assert found.ground.border_share == 1


def test_objects_of_the_other_kind_are_warned_of(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """On a ground of gray 150 four patches, 22 % of the image, are brighter by more than its tolerance, 8 % of 215."""
    path = tmp_path / "chart.png"
    write_png(path, np.rint(chart(150.0)).astype(np.uint8))
    assert run(str(path)) == 0
    lines = capsys.readouterr().out.splitlines()
    # 137 and 157 lie within the tolerance.
    assert lines[1] == "ground: gray 150, 45% of the image and 100% of its border"
    assert lines[2].startswith("warning: 22% of the image is brighter than the ground of gray 150: only dark parts")
    assert run(str(path), "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["ground"]["other_share"] == pytest.approx(4 * PATCH / (118 * 178), abs=1e-3)
    write_png(path, np.rint(np.minimum(chart(150.0), 150)).astype(np.uint8))
    assert run(str(path), "--json") == 0
    assert json.loads(capsys.readouterr().out)["warnings"] == []


def test_a_command_that_fails_leaves_no_overlay(tmp_path: Path) -> None:
    path, overlay = tmp_path / "blank.png", tmp_path / "seen.png"
    write_png(path, np.full((20, 20), 7, np.uint8))
    with pytest.raises(InputError, match="blank"):
        run(str(path), "--overlay", str(overlay))
    with pytest.raises(InputError, match="not the name of a PNG"):
        run(str(path), "--overlay", str(tmp_path / "seen.jpg"))
    cut = tmp_path / "cut.png"
    cut.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(InputError, match=r"cut\.png"):
        run(str(cut), "--overlay", str(overlay))
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["blank.png", "cut.png"]


@pytest.mark.parametrize("where", ["ring", "row", "none"])
def test_coefficients_are_those_of_least_squares(where: str) -> None:
    """Also where pixels in a row leave terms open: then the shortest coefficients."""
    shape = (31, 27)
    v, u = np.indices(shape)
    chosen = {"ring": np.abs(np.hypot(u - 13, v - 15) - 10) < 2, "row": v == 4, "none": v < 0}[where]
    for degree, terms in level.monomials(shape).items():
        there = terms[:, chosen]
        assert len(there) == (degree + 1) * (degree + 2) // 2
        expected = np.linalg.pinv(there.T) if there.size else there
        np.testing.assert_allclose(level._inverse(there), expected, rtol=0, atol=1e-10)
