"""Centres of dots on pictures whose every dot is known: drawn by area, blurred, shaded, noisy."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import pytest
from scipy import signal

from radwrap.errors import InputError
from radwrap.images import GrayImage
from radwrap.measure.dots import METHODS, Dots, DotsNotFound, find_dots, find_dots_by, measured_dots, seek_dots
from radwrap.measure.dots.centres import Window
from radwrap.measure.dots.overlay import overlay_png
from radwrap.measure.dots.plane import disc_centre_shift, fit_homography, jacobian, project
from radwrap.measure.dots.unlike import likeness_of

# The paper's board and camera: f 12.5 mm on pixels of 13.75 um, 19.05 mm pitch at 0.79 m.
FOCAL_LENGTH = 12.5 / 13.75e-3  # px
PITCH, DIAMETER = 19.05e-3, 15.875e-3
RATIO = DIAMETER / PITCH


@dataclass(frozen=True)
class Picture:
    gray: GrayImage
    truth: np.ndarray  # (rows * columns, 2), px
    homography: np.ndarray


def looking(
    rows: int, columns: int, *, pitch: float, tilt: float, turn: float, centre: tuple[float, float]
) -> np.ndarray:
    """Homography of a board that is turned about its normal, then tilted about the picture's u axis [degrees]."""
    a, b = np.radians([tilt, turn])
    turned = np.array([[np.cos(b), -np.sin(b), 0], [np.sin(b), np.cos(b), 0], [0, 0, 1]])
    tilted = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    rotation = tilted @ turned
    centred = np.array([[1, 0, -(columns - 1) / 2], [0, 1, -(rows - 1) / 2], [0, 0, 1]])
    camera = np.array([[FOCAL_LENGTH, 0, centre[0]], [0, FOCAL_LENGTH, centre[1]], [0, 0, 1]])
    view = np.column_stack([rotation[:, 0], rotation[:, 1], [0, 0, FOCAL_LENGTH / pitch]])
    return camera @ view @ centred


def drawn(
    rows: int = 5,
    columns: int = 5,
    *,
    pitch: float = 22.37,
    ratio: float = RATIO,
    tilt: float = 0.0,
    turn: float = 0.0,
    size: tuple[int, int] = (165, 192),
    offset: tuple[float, float] = (0.31, -0.17),
    blur: float = 0.0,
    levels: tuple[float, float] = (20.0, 180.0),
    missing: tuple[int, ...] = (),
    light: Any = None,
    noise: float = 0.0,
    rounded: bool = False,
    bits: int = 8,
    seed: int = 1,
) -> Picture:
    """A board by its area in each pixel: 4 x 4 samples with rims softened over one of them."""
    samples = 4 if max(size) < 400 else 2
    matrix = looking(
        rows,
        columns,
        pitch=pitch,
        tilt=tilt,
        turn=turn,
        centre=((size[1] - 1) / 2 + offset[0], (size[0] - 1) / 2 + offset[1]),
    )
    board = np.array([(c, r) for r in range(rows) for c in range(columns)], dtype=float)
    v, u = ((np.arange(length * samples) + 0.5) / samples - 0.5 for length in size)
    plane = project(np.linalg.inv(matrix), np.stack(np.meshgrid(u, v), axis=-1))
    nearest = np.clip(np.rint(plane), 0, (columns - 1, rows - 1))
    distance = np.linalg.norm(plane - nearest, axis=-1)
    step = np.maximum(np.hypot(*np.gradient(distance)), 1e-9)
    cover = np.clip((ratio / 2 - distance) / step + 0.5, 0, 1)
    for dot in missing:
        cover[(nearest == board[dot]).all(axis=-1)] = 0
    if light is not None:
        cover = cover * light(*np.meshgrid(u, v))
    if blur:
        reach = int(np.ceil(blur * samples))
        y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
        disc = np.clip(blur * samples - np.hypot(x, y) + 0.5, 0, 1)
        cover = signal.fftconvolve(cover, disc / disc.sum(), mode="same")
    share = cover.reshape(size[0], samples, size[1], samples).mean(axis=(1, 3))
    gray = levels[0] + (levels[1] - levels[0]) * share
    gray = gray + np.random.default_rng(seed).normal(0, noise, gray.shape) if noise else gray
    gray = np.clip(np.rint(gray), 0, 2**bits - 1) if rounded else gray
    return Picture(GrayImage(gray, bits), project(matrix, board), matrix)


def rms(dots: Dots, picture: Picture) -> float:
    return float(np.sqrt(np.mean(np.sum((dots.centres - picture.truth) ** 2, axis=1))))


def by(picture: Picture, method: Any = "gray", rows: int = 5, columns: int = 5, **options: Any) -> Dots:
    return find_dots(picture.gray, rows, columns, method=method, pitch=PITCH, dot_diameter=DIAMETER, **options)


# ---- centres -----------------------------------------------------------------------------------------------------

# Of dots 18 px wide without noise: drawing itself is good to 1e-3 px. A threshold cuts part of the light of the
# pixels on the rim, or takes them whole: sharp dots then show where they lie in the pixel grid.
EXACT = {"gray": 2e-3, "gray_threshold": 0.03, "binary": 0.05, "ellipse": 5e-3, "conic": 5e-3}


def test_a_board_seen_squarely_gives_its_centres_by_every_method() -> None:
    picture = drawn()
    for method, dots in find_dots_by(picture.gray, 5, 5, pitch=PITCH, dot_diameter=DIAMETER).items():
        assert rms(dots, picture) < EXACT[method], method
        area = np.pi / 4 * (22.37 * RATIO) ** 2
        assert [dot.area for dot in dots.dots] == pytest.approx([area] * 25, rel=0.03)
        assert dots.contrast == "bright"
        assert not any(dot.split or dot.saturated_fraction or dot.unlike for dot in dots.dots)


def test_the_centre_of_a_tilted_disc_is_not_the_centre_of_its_image() -> None:
    """46 degrees as in the paper: 0.035-0.044 px, which `conic` takes out."""
    picture = drawn(tilt=46, turn=6)
    found = find_dots_by(picture.gray, 5, 5, pitch=PITCH, dot_diameter=DIAMETER)
    for method in ("gray", "ellipse"):
        error = found[method].centres - picture.truth
        assert np.abs(error[:, 1]).mean() == pytest.approx(0.044, abs=0.008)
        expected = disc_centre_shift(picture.homography, found_board(5, 5), RATIO / 2)
        assert np.abs(error - expected).max() < 0.01
    assert rms(found["conic"], picture) < 5e-3


def window_of(dot: tuple[float, float], expected: tuple[float, float], level: float, noise: np.ndarray) -> Window:
    """A dot of 7 px with a soft rim, and where the grid has it."""
    v, u = np.indices((24, 24), dtype=float)
    light = level / (1 + np.exp(2 * (np.hypot(u - dot[0], v - dot[1]) - 7)))
    everywhere = np.ones(light.shape, dtype=bool)
    return Window(np.zeros(2), light + noise, everywhere, np.array(expected), np.eye(2) * 24, 7 / 24, 0.5, level)


def test_neither_a_place_that_is_off_nor_noise_makes_a_dot_unlike_others() -> None:
    """Dots lie .4 px off the grid in all directions, and the dimmest is seven times as noisy for its level."""
    dice = np.random.default_rng(3)
    turns, levels = 2 * np.pi * np.arange(8) / 8, np.array([160.0] * 7 + [22.0])
    windows = [
        window_of((11.5 + 0.4 * np.cos(t), 11.5 + 0.4 * np.sin(t)), (11.5, 11.5), level, dice.normal(0, 1.5, (24, 24)))
        for t, level in zip(turns, levels, strict=True)
    ]
    found = likeness_of(windows, np.zeros(8, dtype=bool), 1.5)
    assert not found.unlike.any() and found.hollow == 0
    windows[2].signal[9:12, 8:10] *= 0.5
    windows[5].signal[9:14, 9:14] *= 1.6
    assert np.flatnonzero(likeness_of(windows, np.zeros(8, dtype=bool), 1.5).unlike).tolist() == [2, 5]


@pytest.mark.parametrize(("touching", "unlike"), [(False, [3, 10]), (True, [3])])
@pytest.mark.parametrize("noise", [0.3, 0.5])
def test_faint_spots_move_the_centroid_or_are_seen_where_noise_is_low(
    noise: float, touching: bool, unlike: list[int]
) -> None:
    """12 px of a tenth of the level on one side of a dot of 7 px: 1.5 % rms, and it moves by .03 px.

    On both sides nearly the same moves nothing, and is seen where dots do not run together. Of half of that nothing is.
    """
    dice = np.random.default_rng(4)
    middles = 11.5 + dice.uniform(-0.4, 0.4, (12, 2))
    windows = [window_of((u, v), (11.5, 11.5), 160.0, noise * dice.standard_normal((24, 24))) for u, v in middles]
    for dot, columns, share in ((3, (16,), 0.1), (8, (4, 16), 0.04), (10, (4, 16), 0.08)):
        for column in columns:
            windows[dot].signal[10:14, column : column + 3] += share * 160
    found = likeness_of(windows, np.full(12, touching), noise).unlike
    assert np.flatnonzero(found).tolist() == unlike
    assert all(0.01 < found[dot] < 0.02 for dot in unlike)


def hole_in(picture: Picture, dot: int, aside: float, size: float, left: float) -> Any:
    """Light that is less within a circle about a place to the right of a dot's middle [px]."""
    u0, v0 = picture.truth[dot]
    return lambda u, v: np.where(np.hypot(u - u0 - aside, v - v0) < size, left, 1.0)


def test_a_hole_in_a_dot_moves_its_centroid_and_is_warned_of() -> None:
    """In closed form, by the areas and middles of both discs; the other dots look as they should."""
    options: dict[str, Any] = {
        "rows": 4,
        "columns": 4,
        "size": (104, 108),
        "ratio": 0.6,
        "pitch": 24.0,
        "blur": 0.8,
        "noise": 1.0,
        "rounded": True,
    }
    sound = drawn(**options)
    assert by(sound, rows=4, columns=4).warnings == ()
    found = by(drawn(**options, light=hole_in(sound, 6, 3.0, 2.0, 0.0)), rows=4, columns=4)
    radius = 0.3 * 24
    aside = found.dots[6].u - sound.truth[6][0]
    assert aside == pytest.approx(-3.0 * 2.0**2 / (radius**2 - 2.0**2), abs=5 * found.dots[6].covariance[0, 0] ** 0.5)
    assert np.flatnonzero([dot.unlike for dot in found.dots]).tolist() == [6]
    assert len(found.warnings) == 1 and "1 of 16 dots do not look like the others" in found.warnings[0]
    assert "row 1 column 2;" in found.warnings[0]


@pytest.mark.parametrize(
    "name", ["scratch", *(pytest.param(name, marks=pytest.mark.long) for name in ("shadow", "highlight"))]
)
def test_dots_that_are_cut_or_lit_in_part_are_warned_of(name: str) -> None:
    """By light outside: one dot cut in two, half in shadow, or with a bright speck of a twentieth of its area."""
    options: dict[str, Any] = {
        "rows": 4,
        "columns": 4,
        "size": (104, 108),
        "ratio": 0.6,
        "pitch": 24.0,
        "blur": 0.8,
        "levels": (20.0, 120.0),
        "noise": 1.0,
        "rounded": True,
    }
    u0, v0 = drawn(**options).truth[15]
    lights = {
        "scratch": lambda u, v: np.where((np.abs(u - u0 + v - v0) < 1.5) & (np.hypot(u - u0, v - v0) < 12), 0.1, 1.0),
        "shadow": lambda u, v: np.where((np.hypot(u - u0, v - v0) < 12) & (v > v0 + 2), 0.4, 1.0),
        "highlight": lambda u, v: np.where(np.hypot(u - u0 - 3, v - v0) < 1.6, 1.6, 1.0),
    }
    picture = drawn(**options, light=lights[name])
    for method, found in find_dots_by(picture.gray, 4, 4, methods=("gray", "binary", "ellipse")).items():
        assert np.flatnonzero([dot.unlike for dot in found.dots]).tolist() == [15], method
        assert any("row 3 column 3;" in text for text in found.warnings)


@pytest.mark.long
def test_dots_that_are_all_weak_in_the_middle_are_warned_of_and_right() -> None:
    options: dict[str, Any] = {
        "rows": 4,
        "columns": 4,
        "size": (104, 108),
        "ratio": 0.6,
        "pitch": 24.0,
        "blur": 0.8,
        "noise": 0.5,
    }
    truth = drawn(**options).truth

    def light(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        away = np.min([np.hypot(u - a, v - b) for a, b in truth], axis=0)
        return np.where(away < 3.0, 0.5, 1.0)

    picture = drawn(**options, light=light)
    found = by(picture, rows=4, columns=4)
    assert rms(found, picture) < 0.02
    assert not any(dot.unlike for dot in found.dots)
    assert len(found.warnings) == 1 and "the dots are weaker in their middle, by" in found.warnings[0]


def found_board(rows: int, columns: int) -> np.ndarray:
    return np.array([(c, r) for r in range(rows) for c in range(columns)], dtype=float)


def test_the_shift_is_that_of_the_ellipse_through_the_projected_circle() -> None:
    """Against a conic through points of the circle, which knows nothing of poles and duals."""
    matrix = looking(5, 5, pitch=22, tilt=55, turn=20, centre=(96, 82))
    for centre in ((0.0, 0.0), (4.0, 1.0), (2.0, 3.0)):
        angles = np.linspace(0, 2 * np.pi, 50, endpoint=False)
        circle = np.array(centre) + 0.45 * np.column_stack([np.cos(angles), np.sin(angles)])
        origin = project(matrix, np.array([centre]))[0]
        x, y = (project(matrix, circle) - origin).T
        a, b, c, d, e = np.linalg.lstsq(np.column_stack([x * x, x * y, y * y, x, y]), np.ones(50), rcond=None)[0]
        middle = np.linalg.solve([[2 * a, b], [b, 2 * c]], [-d, -e])
        assert disc_centre_shift(matrix, np.array([centre]), 0.45)[0] == pytest.approx(middle, abs=1e-9)


def test_a_homography_goes_through_its_points_and_its_jacobian_is_its_derivative() -> None:
    matrix = looking(4, 6, pitch=30, tilt=50, turn=-25, centre=(200, 150))
    board = found_board(4, 6)
    fitted = fit_homography(board, project(matrix, board))
    assert project(fitted, board) == pytest.approx(project(matrix, board), abs=1e-9)
    for axis in (0, 1):
        ahead, behind = board.copy(), board.copy()
        ahead[:, axis] += 1e-5
        behind[:, axis] -= 1e-5
        slope = (project(matrix, ahead) - project(matrix, behind)) / 2e-5
        assert jacobian(matrix, board)[:, :, axis] == pytest.approx(slope, rel=1e-6, abs=1e-6)


def test_light_that_falls_off_shifts_weighted_centres_and_not_contours() -> None:
    """Over a dot of radius r a relative gradient g shifts the mean by g r^2/4."""

    def beam(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.exp(-((u - 96) ** 2 + (v - 82) ** 2) / (2 * 60.0**2))

    picture = drawn(light=beam)
    found = find_dots_by(picture.gray, 5, 5, pitch=PITCH, dot_diameter=DIAMETER)
    expected = -(picture.truth - (96, 82)) / 60.0**2 * (22.37 * RATIO / 2) ** 2 / 4
    shift = found["gray"].centres - picture.truth
    assert shift == pytest.approx(expected, abs=0.12 * np.abs(expected).max())
    assert rms(found["gray"], picture) > 0.2
    assert rms(found["ellipse"], picture) < 0.01


@pytest.mark.parametrize(("number", "within"), [(4, 0.3), pytest.param(10, 0.2, marks=pytest.mark.long)])
def test_the_covariance_is_that_of_repeated_pictures(number: int, within: float) -> None:
    """4 pictures of 25 dots, both coordinates: 200 squares of mean 1, with a standard error of 0.1; of 10, 0.06."""
    squares: dict[str, list[float]] = {"gray": [], "ellipse": []}
    for seed in range(number):
        picture = drawn(noise=3.0, seed=seed, rounded=True)
        for method, dots in find_dots_by(picture.gray, 5, 5, methods=("gray", "ellipse")).items():
            for dot, truth in zip(dots.dots, picture.truth, strict=True):
                error = np.array([dot.u, dot.v]) - truth
                squares[method].append(error @ np.linalg.solve(dot.covariance, error) / 2)
    assert 1 - within < np.mean(squares["gray"]) < 1 + within
    # A contour's points are not as independent as the formula takes them to be: it may be off by a factor of 2.
    assert 0.5 < np.mean(squares["ellipse"]) < 2.0


# ---- what a board may look like ----------------------------------------------------------------------------------


@pytest.mark.parametrize("turn", [44, *(pytest.param(turn, marks=pytest.mark.long) for turn in (-44, -20, 0, 31))])
def test_rows_and_columns_are_the_boards_up_to_45_degrees(turn: float) -> None:
    picture = drawn(turn=turn, pitch=18)
    assert rms(by(picture, "ellipse"), picture) < 0.01


def test_beyond_45_degrees_a_square_grid_is_read_from_its_new_top() -> None:
    picture = drawn(turn=60, pitch=18)
    truth = np.rot90(picture.truth.reshape(5, 5, 2), 1).reshape(-1, 2)
    dots = by(picture, "ellipse")
    other = np.rot90(picture.truth.reshape(5, 5, 2), -1).reshape(-1, 2)
    assert min(np.abs(dots.centres - truth).max(), np.abs(dots.centres - other).max()) < 0.03
    # Read as turned by -30 degrees: the first row climbs to the right.
    assert dots.centres[4, 1] < dots.centres[0, 1]
    assert dots.centres[4, 0] > dots.centres[0, 0]


@pytest.mark.parametrize("turn", [-80, 80])
def test_an_oblong_grid_keeps_its_rows_to_90_degrees(turn: float) -> None:
    picture = drawn(4, 6, turn=turn, pitch=18)
    assert rms(by(picture, "ellipse", 4, 6), picture) < 0.01


@pytest.mark.parametrize(
    ("tilt", "turn"), [(-60, 25), *(pytest.param(*pair, marks=pytest.mark.long) for pair in ((60, 0), (45, 40)))]
)
def test_tilt_to_60_degrees(tilt: float, turn: float) -> None:
    picture = drawn(tilt=tilt, turn=turn, pitch=26, noise=0.5, rounded=True)
    assert rms(by(picture, "conic"), picture) < 0.03


def test_dark_dots_on_a_bright_board_and_16_bits() -> None:
    dark = drawn(levels=(200, 30), rounded=True, noise=0.5)
    dots = by(dark)
    assert dots.contrast == "dark"
    assert rms(dots, dark) < 0.02
    deep = drawn(levels=(3000, 52000), bits=16, rounded=True, noise=50)
    assert rms(by(deep), deep) < 0.01


@pytest.mark.parametrize(
    ("diameter", "size"), [(6.0, (70, 80)), pytest.param(200.0, (800, 840), marks=pytest.mark.long)]
)
def test_dots_of_6_to_200_pixels(diameter: float, size: tuple[int, int]) -> None:
    rows = 5 if diameter < 100 else 3
    picture = drawn(rows, rows, pitch=1.2 * diameter, size=size, noise=0.5, rounded=True)
    for method in ("gray", "conic"):
        assert rms(by(picture, method, rows, rows), picture) < 0.05


def test_sparse_dots() -> None:
    picture = drawn(ratio=0.3, noise=1.0, rounded=True)
    assert rms(find_dots(picture.gray, 5, 5), picture) < 0.05


@pytest.mark.long
def test_dots_that_run_together_are_parted_and_say_so() -> None:
    """The paper's blur: radius 3.67 px on gaps of 3.7 x 2.1 px at 46 degrees."""
    picture = drawn(tilt=46, turn=6, blur=3.67, noise=0.5, rounded=True)
    found = find_dots_by(picture.gray, 5, 5, pitch=PITCH, dot_diameter=DIAMETER)
    assert all(dot.split for dot in found["gray"].dots)
    assert any("ran together" in warning for warning in found["gray"].warnings)
    # Beside noise of 0.01 px there is the distance of ellipse and dot, 0.04 px.
    assert rms(found["gray"], picture) < 0.08
    assert rms(found["conic"], picture) < 0.03
    apart = by(drawn(pitch=30, tilt=30, blur=1.0))
    assert not any(dot.split for dot in apart.dots)


@pytest.mark.long
def test_without_the_model_neighbours_would_draw_outer_dots_outwards() -> None:
    """Outer dots lose light to the cells of inner ones: parted by windows alone their shift is tenths of a pixel."""
    picture = drawn(blur=6.0)
    error = (by(picture).centres - picture.truth).reshape(5, 5, 2)
    assert np.abs(error[:, 0, 0]).max() < 0.05
    assert np.abs(error[0, :, 1]).max() < 0.05


@pytest.mark.long
def test_vignetted_and_partly_dim_boards() -> None:
    def vignetted(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.clip(1 - ((u - 60) ** 2 + (v - 60) ** 2) / 130.0**2, 0.02, 1)

    def half_dim(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.where(u < 85, 1.0, 0.12)

    for light in (vignetted, half_dim):
        # The dimmest dots are 2 to 20 gray levels high: at 0.6 levels of noise that is some 0.1 px.
        picture = drawn(light=light, noise=0.5, rounded=True)
        found = by(picture, "ellipse")
        assert rms(found, picture) < 0.1
    assert any("no smooth law" in warning for warning in found.warnings)


@pytest.mark.long
def test_saturated_dots_are_counted() -> None:
    picture = drawn(levels=(20, 400), rounded=True)
    dots = by(picture)
    assert min(dot.saturated_fraction for dot in dots.dots) > 0.7
    assert "25 of 25 dots are saturated: their centres shift" in dots.warnings
    lower = drawn(rounded=True)
    assert all(dot.saturated_fraction > 0.7 for dot in by(lower, saturation=180).dots)
    assert not any(dot.saturated_fraction for dot in by(lower).dots)


def test_a_dark_level_takes_the_place_of_the_background() -> None:
    """Gray levels above the true zero: background within the window pulls the mean to the window's middle."""
    picture = drawn()
    assert rms(by(picture, dark=20.0), picture) < 5e-3
    assert any("dark level is not used" in one for one in by(picture, "ellipse", dark=20.0).warnings)


# ---- all dots, or an error ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("picture", [drawn(missing=(7,)), drawn(missing=(7,), blur=4.5, noise=0.5, rounded=True)])
def test_a_missing_dot_is_an_error_that_names_it(picture: Picture) -> None:
    with pytest.raises(DotsNotFound, match="found 24 of 25 dots; missing: row 1 column 2") as caught:
        by(picture)
    assert caught.value.found.shape == (24, 2)
    assert caught.value.missing == pytest.approx(picture.truth[7:8], abs=0.5)
    assert overlay_png(picture.gray, caught.value.found, caught.value.missing).startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("grid", "message"),
    [
        ((4, 5), "found 4 x 5 dots, but dots continue"),
        pytest.param((5, 4), "found 5 x 4 dots, but dots continue", marks=pytest.mark.long),
        ((4, 4), "found .* dots"),
        ((6, 6), "found 25 of 36 dots"),
        pytest.param((5, 6), "found 25 of 30 dots", marks=pytest.mark.long),
        ((40, 40), "found .* of 1600 dots"),
    ],
)
# Where dots run together they are found another way; what is made of a wrong grid then is the same, and so long.
@pytest.mark.parametrize("blur", [0.0, pytest.param(4.0, marks=pytest.mark.long)])
def test_a_wrong_grid_is_an_error(grid: tuple[int, int], message: str, blur: float) -> None:
    picture = drawn(tilt=30, turn=10, blur=blur, noise=0.5, rounded=True)
    with pytest.raises(DotsNotFound, match=message):
        by(picture, rows=grid[0], columns=grid[1])


def test_a_wrong_grid_of_dots_that_run_together_is_an_error() -> None:
    """One of six, which are long above."""
    picture = drawn(tilt=30, turn=10, blur=4.0, noise=0.5, rounded=True)
    with pytest.raises(DotsNotFound, match="found 4 x 5 dots, but dots continue"):
        by(picture, rows=4, columns=5)


def test_a_board_that_the_border_cuts_is_an_error() -> None:
    with pytest.raises(DotsNotFound, match=r"found (20|2.) of 25 dots"):
        by(drawn(offset=(45.0, 0.0)))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.full((100, 100), 22.0), "gray level 22 everywhere"),
        (np.full((100, 100), 255.0), "gray level 255 everywhere"),
        (np.full((1, 1), 22.0), "gray level 22 everywhere"),
        (np.array([[1.0, 2.0]]), "found 0 of 25 dots"),
        (np.random.default_rng(1).normal(100, 5, (120, 120)), "found .* of 25 dots"),
        (np.tile(np.linspace(0, 255, 120), (90, 1)), "found .* of 25 dots"),
    ],
)
def test_pictures_without_dots_are_errors(values: np.ndarray, message: str) -> None:
    with pytest.raises(InputError, match=message):
        find_dots(GrayImage(values), 5, 5)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rows": 1}, "2 rows and 2 columns at least"),
        ({"rows": 200, "columns": 200}, "10000 dots at most"),
        ({"method": "hough"}, "gray, gray_threshold, binary, ellipse, conic"),
        ({"method": "conic"}, "needs the pitch and the dots' diameter"),
        ({"pitch": -1.0}, "pitch must be positive"),
        ({"dot_diameter": float("nan")}, "dot diameter must be positive"),
        ({"pitch": 1e-3, "dot_diameter": 2e-3}, "overlap"),
    ],
)
def test_wrong_parameters_are_errors(options: dict[str, Any], message: str) -> None:
    arguments: dict[str, Any] = {"rows": 5, "columns": 5} | options
    with pytest.raises(InputError, match=message):
        find_dots(drawn().gray, **arguments)


def test_the_overlay_shows_every_dot() -> None:
    picture = drawn()
    found = cv2.imdecode(np.frombuffer(overlay_png(picture.gray, by(picture)), np.uint8), cv2.IMREAD_COLOR)
    green = (found == (0, 200, 0)).all(axis=2)
    scale = found.shape[1] / 192
    for u, v in picture.truth:
        assert green[int((v + 0.5) * scale), int((u + 0.5) * scale)]


def test_all_methods_share_one_search() -> None:
    picture = drawn()
    assert set(find_dots_by(picture.gray, 5, 5, pitch=PITCH, dot_diameter=DIAMETER)) == set(METHODS)


# ---- saturated boards --------------------------------------------------------------------------------------------


def saturated_board(times: float) -> Picture:
    """The paper's board and blur, exposed so many times too long; the sensor clips at 181."""
    picture = drawn(tilt=46, turn=6, blur=3.67, levels=(22.0, 22 + 160 * times))
    return Picture(GrayImage(np.rint(np.minimum(picture.gray.values, 181)), 8), picture.truth, picture.homography)


@pytest.mark.long
@pytest.mark.parametrize("times", [2.6, 4.0, 6.0])
def test_a_heavily_saturated_board_is_right_or_an_error(times: float) -> None:
    """Never the lattice of the gaps, half a pitch off, nor one that a model of clipped light has moved.

    1 px is a tenth of the smaller pitch: centres of saturated dots shift, but stay the dots' own.
    """
    picture = saturated_board(times)
    for options in ({}, {"pitch": PITCH, "dot_diameter": DIAMETER}):
        try:
            dots = find_dots(picture.gray, 5, 5, method="ellipse", **options)
        except DotsNotFound:
            assert times > 5, "the gaps still tell where the dots are"
            continue
        assert dots.contrast == "bright"
        assert np.abs(dots.centres - picture.truth).max() < 1.0


def test_the_gaps_between_saturated_dots_are_no_grid() -> None:
    """Given 25 gaps and notches as a lattice, the board outside is missing."""
    from radwrap.measure.dots.settle import _outside
    from radwrap.measure.dots.survey import Grid, survey

    picture = saturated_board(4.0)
    half = picture.homography @ np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    for sign, matrix, wrong in ((-1, half, True), (1, picture.homography, False)):
        places = project(matrix, found_board(5, 5))
        grid = Grid(picture.gray.values * sign, sign, (5, 5), matrix / matrix[2, 2], places, None, None, 181.0)
        assert (_outside(grid, survey(grid, 0.3)) is not None) == wrong


def test_sparse_saturated_dots_under_noise_are_bright() -> None:
    """Here the dark between the dots used to be taken for the dots, and nothing was found."""
    rng = np.random.default_rng(3)
    picture = drawn(tilt=40, turn=6.4, pitch=23.7, ratio=0.5, levels=(22, 372))
    gray = np.rint(np.clip(picture.gray.values + rng.normal(0, 1.5, picture.gray.values.shape), 0, 181))
    dots = find_dots(GrayImage(gray, 8), 5, 5)
    assert dots.contrast == "bright"
    assert np.abs(dots.centres - picture.truth).max() < 0.5


# ---- a very similar image ----------------------------------------------------------------------------------------


# With the second, dots run together: the search before differs, and what follows is the same.
@pytest.mark.parametrize("blur", [0.0, pytest.param(2.0, marks=pytest.mark.long)])
def test_dots_near_known_ones_are_those_that_a_search_finds(blur: float) -> None:
    """Each settles from where it starts to the same grid: what is left is a thousandth of what the noise moves."""
    first, noisy = (drawn(tilt=20, turn=6, blur=blur, noise=noise, seed=4) for noise in (0.0, 0.5))
    known = seek_dots(first.gray, 5, 5, pitch=PITCH, dot_diameter=DIAMETER)
    sought = seek_dots(noisy.gray, 5, 5, pitch=PITCH, dot_diameter=DIAMETER)
    near = seek_dots(noisy.gray, 5, 5, pitch=PITCH, dot_diameter=DIAMETER, near=known)
    for method in METHODS:
        there, here = measured_dots(sought, method).centres, measured_dots(near, method).centres
        moved = np.abs(there - measured_dots(known, method).centres).max()
        assert np.abs(there - here).max() < 1e-3 * moved


@pytest.mark.long
def test_dots_that_are_not_near_are_sought() -> None:
    first, other = drawn(), drawn(offset=(0.31 + 22.37 / 2, -0.17), size=(165, 202))
    known = seek_dots(first.gray, 5, 5, pitch=PITCH, dot_diameter=DIAMETER)
    near = seek_dots(other.gray, 5, 5, pitch=PITCH, dot_diameter=DIAMETER, near=known)
    assert rms(measured_dots(near, "gray"), other) < EXACT["gray"]
    with pytest.raises(DotsNotFound):
        measured_dots(seek_dots(drawn(missing=(7,)).gray, 5, 5, near=known), "gray")
