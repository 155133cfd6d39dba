"""Where things appear: u to the right, v down, an erect image, through the pinhole's centre.

A point at (X, Y, Z) in the camera's frame, x right, y down, z forward, appears at the column
u = u0 + f X/(Z pixel_width) and the row v = v0 + f Y/(Z pixel_height).
"""

import json
import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio  # noqa: N813  (its own short name)
import pytest

import radwrap

SUBPIXEL = 0.03  # px: 4 x 4 rays a pixel, spots of some tens of pixels
GEOMETRY = 1e-9  # px, float64
DEPTH = 1e-5  # asked for by the validation plan
FLOAT32_DEPTH = 2e-7  # the tracer's answer and the file are float32
RIM = 2e-5  # m: pixels so near to a border are not judged by the closed form

F = 0.0125
WIDE, HIGH = 14e-6, 20e-6  # pixels that are not square
ROWS, COLUMNS = 64, 96
MIDDLE = ((COLUMNS - 1) / 2, (ROWS - 1) / 2)
WHITE = {"white": {"type": "lambertian", "reflectance": 0.9}, "black": {"type": "lambertian", "reflectance": 0.0}}


def rotated(x: float, y: float, z: float, order: str = "xyz") -> np.ndarray:
    """Rotation about the world's fixed axes, one after the other; angles in degrees, counter-clockwise."""
    matrices = {}
    for axis, angle in zip("xyz", (x, y, z), strict=True):
        c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
        matrices[axis] = {
            "x": np.array([[1, 0, 0], [0, c, -s], [0, s, c]]),
            "y": np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]),
            "z": np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]),
        }[axis]
    result = np.eye(3)
    for axis in order:
        result = matrices[axis] @ result
    return result


FAR_ABOVE, FAR_BEHIND = (0.0, 0.0, 1000.0), (0.0, 0.0, -1000.0)  # lamps whose light is even over what is seen


def scene_of(
    bench: Any,
    targets: Sequence[dict[str, Any]],
    lamp: Sequence[float],
    look_at: Sequence[float] = (0.0, 0.0, 0.0),
    **camera: Any,
) -> radwrap.Scene:
    table = bench.camera(rows=ROWS, columns=COLUMNS, pitch=(WIDE, HIGH), focal_length=F, **camera)
    return bench.scene(table, [bench.lamp(lamp, look_at, diameter=1e-4)], WHITE, targets)


def spot(bench: Any, centre: Sequence[float], rotation: Sequence[float] = (0, 0, 0)) -> dict[str, Any]:
    return {
        "type": "disc",
        "material": "white",
        "diameter": "6 mm",
        "position": bench.metres(*centre),
        "rotation": bench.degrees(*rotation),
    }


def centroid(image: np.ndarray) -> tuple[float, float]:
    """(u, v) of the light."""
    rows, columns = np.indices(image.shape)
    return float((image * columns).sum() / image.sum()), float((image * rows).sum() / image.sum())


def pixel(x: float, y: float, z: float, principal: tuple[float, float] = MIDDLE) -> tuple[float, float]:
    """(u, v) of a point of the camera's frame."""
    return principal[0] + F * x / z / WIDE, principal[1] + F * y / z / HIGH


def image_of_disc(
    to_camera: Any, centre: np.ndarray, x_axis: np.ndarray, y_axis: np.ndarray, radius: float
) -> tuple[float, float]:
    """Centroid of a disc's image: an ellipse, whose centre is not the image of the disc's centre."""
    rim = []
    for turn in np.linspace(0, 2 * math.pi, 721):
        rim.append(pixel(*to_camera(centre + radius * (math.cos(turn) * x_axis + math.sin(turn) * y_axis))))
    area = u = v = 0.0
    u0, v0 = rim[0]
    for (u1, v1), (u2, v2) in pairwise(rim):
        piece = ((u1 - u0) * (v2 - v0) - (u2 - u0) * (v1 - v0)) / 2
        area += piece
        u += piece * (u0 + u1 + u2) / 3
        v += piece * (v0 + v1 + v2) / 3
    return u / area, v / area


@pytest.mark.parametrize("point", [(0.0, 0.0), (0.02, 0.0), (0.0, 0.015), (-0.02, -0.02)])
def test_pinhole_formula(bench: Any, point: tuple[float, float]) -> None:
    """A camera without rotation looks along the world's z; x is right and y is down."""
    disc = spot(bench, (*point, 0.6), (180, 0, 0))
    scene = scene_of(bench, [disc], FAR_BEHIND, position=(0.0, 0.0, 0.0), rotation=bench.degrees(0, 0, 0))
    assert centroid(bench.image(scene, samples=4)) == pytest.approx(pixel(*point, 0.6), abs=SUBPIXEL)


@pytest.mark.parametrize("principal", [(30.0, 20.0), (60.5, 44.25)])
def test_principal_point(bench: Any, principal: tuple[float, float]) -> None:
    """The axis meets the sensor there, and the picture moves along with it."""
    scene = scene_of(
        bench,
        [spot(bench, (0.01, 0.006, 0.6), (180, 0, 0))],
        FAR_BEHIND,
        position=(0.0, 0.0, 0.0),
        rotation=bench.degrees(0, 0, 0),
        principal_point=[f"{value} px" for value in principal],
    )
    assert centroid(bench.image(scene, samples=4)) == pytest.approx(pixel(0.01, 0.006, 0.6, principal), abs=SUBPIXEL)


def test_principal_point_of_silence_is_the_middle(bench: Any) -> None:
    """The centre of the first pixel is (0, 0): the middle of 96 x 64 pixels is (47.5, 31.5)."""
    scene = scene_of(bench, [spot(bench, (0, 0, 0))], FAR_ABOVE, position=(0.0, 0.0, 0.5))
    assert scene.camera.principal_point == (47.5, 31.5)
    assert centroid(bench.image(scene, samples=4)) == pytest.approx((47.5, 31.5), abs=SUBPIXEL)


@pytest.mark.parametrize(
    ("eye", "up", "right", "upwards"),
    [
        ((0, 0, 1), None, (1, 0, 0), (0, 1, 0)),
        ((0, 0, -1), None, (-1, 0, 0), (0, 1, 0)),
        ((1, 0, 0), None, (0, 0, -1), (0, 1, 0)),
        ((0, 1, 0), None, (-1, 0, 0), (0, 0, 1)),
        ((0, 0, 1), [1, 0, 0], (0, -1, 0), (1, 0, 0)),
        ((0, 0, 1), [0, -2, 0.5], (-1, 0, 0), (0, -1, 0)),
    ],
)
def test_erect_image_by_look_at(bench: Any, eye: Any, up: Any, right: Any, upwards: Any) -> None:
    """A sphere to the viewer's right appears at a larger u, one above at a smaller v."""
    more = {} if up is None else {"up": up}
    for direction, expected in ((right, pixel(0.015, 0.0, 0.5)), (upwards, pixel(0.0, -0.015, 0.5))):
        ball = {"type": "sphere", "material": "white", "diameter": "6 mm"}
        ball["position"] = bench.metres(*(0.015 * np.asarray(direction)))
        # A lamp behind the pinhole: a sphere then fades evenly to all sides, its image is off by (r/Z)^2 alone.
        scene = scene_of(bench, [ball], 0.501 * np.asarray(eye), position=0.5 * np.asarray(eye), **more)
        image = bench.image(scene, samples=4)
        assert centroid(image) == pytest.approx(expected, abs=SUBPIXEL)


@pytest.mark.parametrize("order", ["xyz", "zyx", "yxz"])
def test_camera_by_rotation_and_translation(bench: Any, order: str) -> None:
    """world_from_camera = rotation about fixed axes, then the translation to the pinhole's place."""
    angles, place = (160.0, 12.0, -25.0), np.array([0.1, -0.2, 0.6])
    rotation = rotated(*angles, order)
    in_camera = np.array([0.02, 0.012, 0.55])
    centre = place + rotation @ in_camera
    ball = {"type": "sphere", "material": "white", "diameter": "6 mm", "position": bench.metres(*centre)}
    scene = scene_of(
        bench,
        [ball],
        place - rotation @ np.array([0, 0, 1e-3]),
        centre,
        translation=bench.metres(*place),
        rotation=bench.degrees(*angles),
        rotation_order=order,
    )
    assert centroid(bench.image(scene, samples=4)) == pytest.approx(pixel(*in_camera), abs=SUBPIXEL)


def board(bench: Any, rotation: Sequence[float], **more: Any) -> dict[str, Any]:
    """Two by two dots, 15 mm from the axes."""
    return {
        "type": "board",
        "name": "board",
        "material": "black",
        "dot_material": "white",
        "rows": 2,
        "columns": 2,
        "pitch": "30 mm",
        "dot_diameter": "10 mm",
        "rotation": bench.degrees(*rotation),
        **more,
    }


HEIGHT = 0.55


def seen_from_above(point: np.ndarray) -> tuple[float, float, float]:
    """Camera's frame at (0, 0, HEIGHT), looking down at the board, the world's y upwards."""
    return float(point[0]), -float(point[1]), HEIGHT - float(point[2])


def quadrants(image: np.ndarray) -> dict[tuple[int, int], tuple[float, float]]:
    """Centroid of the dot in each quarter of the picture; (row, column)."""
    found = {}
    for row in (0, 1):
        for column in (0, 1):
            top, left = row * ROWS // 2, column * COLUMNS // 2
            u, v = centroid(image[top : top + ROWS // 2, left : left + COLUMNS // 2])
            found[row, column] = (u + left, v + top)
    return found


@pytest.mark.parametrize(
    ("rotation", "order"),
    [
        ((0, 0, 0), "xyz"),
        ((10, 0, 0), "xyz"),
        ((0, 10, 0), "xyz"),
        ((0, 0, 10), "xyz"),
        ((46, 6, -2), "xyz"),
        ((46, 6, -20), "zyx"),
    ],
)
def test_dots_of_a_rotated_board(bench: Any, rotation: tuple[float, float, float], order: str) -> None:
    """Rendered dots against the ellipses' centroids: row 0 is at the top (+y), column 0 on the left (-x)."""
    scene = scene_of(bench, [board(bench, rotation, rotation_order=order)], FAR_ABOVE, position=(0.0, 0.0, HEIGHT))
    matrix = rotated(*rotation, order)
    found = quadrants(bench.image(scene, samples=4))
    for (row, column), place in found.items():
        centre = matrix @ np.array([(column - 0.5) * 0.03, (0.5 - row) * 0.03, 0.0])
        expected = image_of_disc(seen_from_above, centre, matrix[:, 0], matrix[:, 1], 0.005)
        assert place == pytest.approx(expected, abs=SUBPIXEL)


def test_positive_angles_turn_the_right_way(bench: Any) -> None:
    """About x the upper dots come nearer, about y the right ones go farther, about z all turn to the left, up there."""
    places = {}
    for rotation in ((0, 0, 0), (10, 0, 0), (0, 10, 0), (0, 0, 10)):
        scene = scene_of(bench, [board(bench, rotation)], FAR_ABOVE, position=(0.0, 0.0, HEIGHT))
        places[rotation] = quadrants(bench.image(scene, samples=4))
    flat, about_x, about_y, about_z = places.values()

    def width(dots: Any, row: int) -> float:
        return float(dots[row, 1][0] - dots[row, 0][0])

    def height(dots: Any, column: int) -> float:
        return float(dots[1, column][1] - dots[0, column][1])

    assert width(about_x, 0) > width(flat, 0) + 0.1 > width(flat, 1) > width(about_x, 1)
    assert height(about_y, 0) > height(flat, 0) + 0.1 > height(flat, 1) > height(about_y, 1)
    assert about_z[0, 0][0] < flat[0, 0][0] - 1  # upper left: to the left, and down
    assert about_z[0, 0][1] > flat[0, 0][1] + 1
    assert about_z[1, 1][0] > flat[1, 1][0] + 1


def stored(path: Path) -> np.ndarray:
    source = oiio.ImageInput.open(str(path))
    pixels = source.read_image(source.spec().format)
    source.close()
    return np.asarray(pixels)[:, :, 0]


def rays() -> np.ndarray:
    """Direction of each pixel's centre in the camera's frame, z = 1; shape (rows, columns, 3)."""
    rows, columns = np.indices((ROWS, COLUMNS))
    return np.stack(
        [(columns - MIDDLE[0]) * WIDE / F, (rows - MIDDLE[1]) * HIGH / F, np.ones((ROWS, COLUMNS))], axis=-1
    )


def test_truth_of_a_board(bench: Any, tmp_path: Path) -> None:
    rotation = (46, 6, -2)
    place = np.array([0.004, -0.002, 0.01])
    table = board(bench, rotation, position=bench.metres(*place), rows=3, columns=4, pitch="12 mm")
    table["dot_diameter"] = "8 mm"
    scene = scene_of(bench, [table], FAR_ABOVE, position=(0.0, 0.0, HEIGHT))
    radwrap.render(scene, tmp_path, method="pinhole", truth=True)
    truth = json.loads((tmp_path / "truth.json").read_text())
    matrix = rotated(*rotation)
    told = truth["targets"]["board"]

    flip = np.diag([1.0, -1.0, -1.0])  # x right, y down, z forward, seen from above
    pose = np.array(told["camera_from_target"])
    assert pose[:3, :3] == pytest.approx(flip @ matrix, abs=1e-12)
    assert pose[:3, 3] == pytest.approx(flip @ (place - [0, 0, HEIGHT]), abs=1e-12)

    centres = []
    for dot in told["dots"]:
        local = np.array([(dot["column"] - 1.5) * 0.012, (1 - dot["row"]) * 0.012, 0.0])
        centres.append(local)
        assert (dot["u"], dot["v"]) == pytest.approx(pixel(*seen_from_above(place + matrix @ local)), abs=GEOMETRY)
        assert dot["in_view"]
    assert len(centres) == 12

    # What each pixel's centre sees, by intersecting its ray with the board's plane.
    directions = rays() @ flip
    normal = matrix[:, 2]
    depth = (place - [0, 0, HEIGHT]) @ normal / (directions @ normal)
    local = (directions * depth[..., np.newaxis] + [0, 0, HEIGHT] - place) @ matrix
    to_rim = np.min([np.hypot(local[..., 0] - x, local[..., 1] - y) for x, y, _ in centres], axis=0) - 0.004
    half = np.array([3 * 0.012 + 0.008 + 0.02, 2 * 0.012 + 0.008 + 0.02]) / 2
    to_border = (np.abs(local[..., :2]) - half).max(axis=-1)
    parts = {name: number for name, number in truth["parts"].items() if name.startswith("board")}
    expected = np.where(to_rim < 0, parts["board.dots"], np.where(to_border < 0, parts["board.surface"], 0))
    judged = (np.abs(to_rim) > RIM) & (np.abs(to_border) > RIM)
    mask = stored(tmp_path / "mask.png")
    assert (mask[judged] == expected[judged]).all()
    assert judged.mean() > 0.98
    assert {0, *parts.values()} == set(np.unique(mask).tolist())

    written = stored(tmp_path / "depth.exr")
    on_board = judged & (to_border < 0)
    assert written[on_board] == pytest.approx(depth[on_board], rel=FLOAT32_DEPTH)
    assert (written[judged & (to_border > 0)] == 0).all()


def test_truth_dots_are_the_rendered_ones(bench: Any, tmp_path: Path) -> None:
    """Up to the shift between an ellipse's centre and the image of the disc's centre, 0.04 px at this tilt."""
    scene = scene_of(bench, [board(bench, (46, 6, -2))], FAR_ABOVE, position=(0.0, 0.0, HEIGHT))
    radwrap.render(scene, tmp_path, method="pinhole", pixel_samples=4, truth=True)
    found = quadrants(stored(tmp_path / "radiant_exposure.exr").astype(np.float64))
    matrix = rotated(46, 6, -2)
    for dot in json.loads((tmp_path / "truth.json").read_text())["targets"]["board"]["dots"]:
        u, v = found[dot["row"], dot["column"]]
        centre = matrix @ np.array([(dot["column"] - 0.5) * 0.03, (0.5 - dot["row"]) * 0.03, 0.0])
        ellipse = image_of_disc(seen_from_above, centre, matrix[:, 0], matrix[:, 1], 0.005)
        conic = (ellipse[0] - dot["u"], ellipse[1] - dot["v"])
        assert math.hypot(*conic) < 0.1
        assert (u - conic[0], v - conic[1]) == pytest.approx((dot["u"], dot["v"]), abs=SUBPIXEL)


def test_depth_of_a_tilted_sheet(bench: Any, tmp_path: Path) -> None:
    """Along the axis, not along the ray: f (n . P0)/(n . d)."""
    rotation, place = (50, -20, 15), np.array([0.02, 0.01, -0.05])
    sheet = {"type": "sheet", "name": "sheet", "material": "white", "size": ["3 m", "3 m"]}
    sheet |= {"position": bench.metres(*place), "rotation": bench.degrees(*rotation)}
    scene = scene_of(bench, [sheet], FAR_ABOVE, position=(0.0, 0.0, HEIGHT))
    radwrap.render(scene, tmp_path, method="pinhole", truth=True)
    normal = rotated(*rotation)[:, 2]
    directions = rays() * [1, -1, -1]
    depth = (place - [0, 0, HEIGHT]) @ normal / (directions @ normal)
    assert np.ptp(depth) > 0.05
    assert stored(tmp_path / "depth.exr") == pytest.approx(depth, rel=DEPTH)


def test_outline_and_depth_of_a_sphere(bench: Any, tmp_path: Path) -> None:
    """A ray meets the sphere where it is nearer to its centre than the radius."""
    centre, radius = np.array([0.01, -0.006, 0.4]), 0.012
    ball = {"type": "sphere", "name": "ball", "material": "white", "diameter": "24 mm"}
    ball["position"] = bench.metres(*centre)
    scene = scene_of(bench, [ball], FAR_BEHIND, position=(0.0, 0.0, 0.0), rotation=bench.degrees(0, 0, 0))
    radwrap.render(scene, tmp_path, method="pinhole", truth=True)
    unit = rays() / np.linalg.norm(rays(), axis=-1, keepdims=True)
    nearest = unit @ centre
    beside = np.sqrt(centre @ centre - nearest**2)
    mask, depth = stored(tmp_path / "mask.png"), stored(tmp_path / "depth.exr")
    number = json.loads((tmp_path / "truth.json").read_text())["parts"]["ball.surface"]
    judged = np.abs(beside - radius) > RIM
    assert (mask[judged] == np.where(beside < radius, number, 0)[judged]).all()
    inside = beside < radius - RIM
    distance = nearest - np.sqrt(np.where(inside, radius**2 - beside**2, 0))
    assert depth[inside] == pytest.approx((distance * unit[..., 2])[inside], rel=DEPTH)


def border_is_sharp(bench: Any, scene: radwrap.Scene, size: float, turn: float) -> bool:
    """Whether each side of a square sheet lies within 1e-4 of its size of where it should."""
    matrix = rotated(0, 0, turn)
    for outwards in ((1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0)):
        for along in (-0.3, 0.1):
            middle = matrix @ np.array(outwards) * size / 2
            middle = middle + matrix @ np.array([outwards[1], outwards[0], 0]) * along * size
            points = [middle + matrix @ np.array(outwards) * size * step for step in (-1e-4, 1e-4)]
            inside, outside = bench.radiance(scene, (0.0, 0.0, 0.5), points)
            if not inside > 0 == outside:
                return False
    return True


@pytest.mark.parametrize("size", [0.2, 0.005, 0.0003])
@pytest.mark.parametrize("turn", [0.0, 30.0])
def test_small_polygons_keep_their_size(bench: Any, size: float, turn: float) -> None:
    """Radiance takes a point for inside where a side's length times the distance from it is below 1e-6 square units.

    Written in metres, a turned sheet of 5 mm would grow by 0.2 mm on each side.
    """
    sheet = {"type": "sheet", "material": "white", "size": bench.metres(size, size)}
    lamp = bench.lamp((0.0, 0.0, 5.0), diameter=0.01)
    scene = bench.scene(bench.camera(), [lamp], WHITE, [sheet | {"rotation": bench.degrees(0, 0, turn)}])
    assert border_is_sharp(bench, scene, size, turn)


def test_small_polygons_of_a_file_keep_their_size(bench: Any, tmp_path: Path) -> None:
    (tmp_path / "part.rad").write_text(
        "void plastic gray\n0\n0\n5 .5 .5 .5 0 0\n"
        "gray polygon part\n0\n0\n12 -.001 -.001 0 .001 -.001 0 .001 .001 0 -.001 .001 0\n"
    )
    document = {
        "camera": bench.camera(),
        "sources": [bench.lamp((0.0, 0.0, 5.0), diameter=0.01)],
        "targets": [{"type": "rad", "rad": "part.rad", "rotation": bench.degrees(0, 0, 30)}],
    }
    scene = radwrap.scene_from_document(document, folder=tmp_path)
    assert border_is_sharp(bench, scene, 0.002, 30)
