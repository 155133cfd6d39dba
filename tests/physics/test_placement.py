"""Where things lie must not matter: decals without ties, sources in one place, scenes far from the origin."""

import math
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.tracing import laid_out

FLOAT32 = 1e-6  # the tracer's answers
# Far from the origin a place is known to 1e-13 m (double precision at 1 km), and light falls off over 0.5 m.
MOVED = 2e-6
DARK, BRIGHT = 0.2, 0.8
TILT = (30.0, -20.0, 10.0)
FAR = [(0.0, 0.0, 0.0), (3.3, -7.1, 12.9), (1000.0, -700.0, 300.0)]


def painted(bench: Any, kind: str, offset: tuple[float, float, float], **more: Any) -> radwrap.Scene:
    """A turned board of dots, or an edge, between two lamps; everything moved by an offset."""

    def moved(*place: float) -> tuple[float, ...]:
        return tuple(a + b for a, b in zip(place, offset, strict=True))

    target = {"name": "t", "type": kind, "position": bench.metres(*offset), "rotation": bench.degrees(*TILT)}
    if kind == "board":
        target |= {"rows": 3, "columns": 4, "pitch": "10 mm", "dot_diameter": "6 mm", "margin": "5 mm"}
        target |= {"material": "dark", "dot_material": "bright"}
    else:
        target |= {"size": ["40 mm", "30 mm"], "edge_position": "3 mm", "material": "dark", "edge_material": "bright"}
    shares = {"dark": DARK, "bright": BRIGHT}
    paint = {name: {"type": "lambertian", "reflectance": share} for name, share in shares.items()}
    lamps = [
        bench.lamp(moved(0.1, 0.05, 0.5), offset, name="above"),
        bench.lamp(moved(-0.1, 0.02, -0.5), offset, name="below"),
    ]
    camera = bench.camera(moved(0, 0, 0.4), offset, rows=4, columns=4)
    return bench.scene(camera, lamps, paint, [target | more.get("target", {}), *more.get("others", [])])


def rims(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Points of the board's plane 1 um on either side of a rim, (x, y) [m], and whether each is painted."""
    if kind == "edge":
        y = np.linspace(-0.013, 0.013, 7)
        x = 0.003 + np.tile([-1e-6, 1e-6], len(y))
        return np.column_stack([x, np.repeat(y, 2)]), x > 0.003
    centres = [(0.01 * (column - 1.5), 0.01 * (1 - row)) for row in range(3) for column in range(4)]
    angles = np.arange(8) * 2 * math.pi / 8 + 0.1
    radii = 3e-3 - 1e-6, 3e-3 + 1e-6
    points = [(x + r * math.cos(a), y + r * math.sin(a)) for x, y in centres for a in angles for r in radii]
    return np.array(points), np.tile([True, False], len(points) // 2)


@pytest.mark.parametrize("offset", FAR)
@pytest.mark.parametrize("kind", ["board", "edge"])
def test_a_decal_is_exact(bench: Any, kind: str, offset: tuple[float, float, float]) -> None:
    """Seen face on, under grazing rays and from behind: the ratio to an even sheet is that of the reflectances."""
    scene = painted(bench, kind, offset)
    key = "dot_material" if kind == "board" else "edge_material"
    even = painted(bench, kind, offset, target={"material": "bright", key: "bright"})
    pose = scene.targets[0].pose
    flat, bright = rims(kind)
    points = np.column_stack([flat, np.zeros(len(flat))]) @ np.asarray(pose.rotation).T + pose.position
    expected = np.where(bright, 1.0, DARK / BRIGHT)
    for elevation in (90.0, 2.0, -2.0, -80.0):
        away = np.array([math.cos(math.radians(elevation)), 0.0, math.sin(math.radians(elevation))])
        eyes = points + 0.05 * np.asarray(pose.rotation) @ away
        ratio = bench.radiance(scene, eyes, points) / bench.radiance(even, eyes, points)
        assert ratio == pytest.approx(expected, rel=FLOAT32), elevation


@pytest.mark.parametrize("offset", FAR)
def test_a_decal_casts_its_board_s_shadow(bench: Any, offset: tuple[float, float, float]) -> None:
    """Behind the board there is no light of the lamp above, whether a dot or the board hides it."""
    wall = {"type": "sheet", "name": "wall", "material": "bright", "size": bench.metres(1, 1)}
    wall |= {"position": bench.metres(*(a + b for a, b in zip(offset, (0, 0, -0.1), strict=True)))}
    scene = painted(bench, "board", offset, others=[wall])
    flat, _ = rims("board")
    lamp = np.asarray(scene.emitters[0].position)
    pose = scene.targets[0].pose
    points = np.column_stack([flat, np.zeros(len(flat))]) @ np.asarray(pose.rotation).T + pose.position
    rays = points - lamp
    shaded = lamp + rays * ((offset[2] - 0.1 - lamp[2]) / rays[:, 2])[:, np.newaxis]
    radiance = bench.radiance(scene, np.add(shaded, (0.0, 0.0, 0.01)), shaded)
    assert radiance.max() == 0.0


@pytest.mark.parametrize("size", ["0.999 mm", "1.001 mm", "2 um"])
def test_a_small_part_beside_a_board_changes_nothing(bench: Any, size: str) -> None:
    """The text's unit hangs on its smallest part; places in it are rounded to 31 bits."""
    small = {"type": "sheet", "name": "small", "material": "dark", "size": [size, "20 mm"]}
    small |= {"position": bench.metres(0.07, 0, 0.06)}
    flat, _ = rims("board")
    scene, more = (painted(bench, "board", FAR[0], others=others) for others in ([], [small]))
    pose = scene.targets[0].pose
    points = np.column_stack([flat, np.zeros(len(flat))]) @ np.asarray(pose.rotation).T
    eye = (0.0, 0.0, 0.4)
    assert bench.radiance(more, eye, points) == pytest.approx(bench.radiance(scene, eye, points), rel=FLOAT32)


@pytest.mark.parametrize("offset", FAR[1:])
def test_a_moved_scene_is_the_same(bench: Any, offset: tuple[float, float, float]) -> None:
    here, there = (painted(bench, "board", place) for place in (FAR[0], offset))
    across = np.stack(np.meshgrid(np.linspace(-0.03, 0.03, 40), np.linspace(-0.02, 0.02, 30)), axis=-1).reshape(-1, 2)
    points = np.column_stack([across, np.zeros(len(across))])
    eye = np.array([0.0, 0.0, 0.4])
    near, far = bench.radiance(here, eye, points), bench.radiance(there, eye + offset, points + offset)
    assert np.unique(near.round(6)).size > 10
    assert far == pytest.approx(near, rel=MOVED)


def test_sources_in_one_place_add_up(bench: Any) -> None:
    """Two of half the radiance are one of the whole, and each has its own light when the other is off."""
    camera = bench.camera((0.1, 0, 1), rows=4, columns=4)
    sheet = {"type": "sheet", "name": "sheet", "material": "m", "size": bench.metres(0.1, 0.1)}
    paint = {"m": {"type": "lambertian", "reflectance": 0.5}}
    place = {"position": bench.metres(0.2, 0, 0.5), "look_at": bench.metres(0, 0, 0), "diameter": "4 mm"}
    beam = {"profile": "gaussian", "width": "30 deg", "width_definition": "fwhm"}

    def lit(*levels: float) -> radwrap.Scene:
        leds = [
            {"type": "led", "name": f"led{number}", "radiance": f"{level} W/m^2/sr", "beam": beam, **place}
            for number, level in enumerate(levels)
        ]
        return bench.scene(camera, leds, paint, [sheet])

    eye, points = (0.1, 0, 1), np.array([(0, 0, 0), (0.02, 0.03, 0), (-0.04, 0.01, 0)])
    whole, halves = (bench.radiance(lit(*levels), eye, points) for levels in ((8.0,), (5.0, 3.0)))
    assert whole.min() > 0
    assert halves == pytest.approx(whole, rel=FLOAT32)
    rays = np.hstack([np.broadcast_to(np.asarray(eye), points.shape), points - eye])
    with laid_out(lit(5.0, 3.0), RenderOptions()) as scene:
        for name, level in (("led0", 5.0), ("led1", 3.0)):
            (alone,) = scene.view_of(name).tracer.trace([rays])
            assert alone == pytest.approx(whole * level / 8, rel=FLOAT32)


@pytest.mark.parametrize("gap", [1e-9, 1e-7, 1e-5])
def test_a_plane_may_hold_the_camera_s_place(bench: Any, gap: float) -> None:
    """The text's origin: there Radiance holds rounded corners against a distance of next to nothing."""
    turn = bench.degrees(90, 33.3, 12.7)
    beside = {"name": "beside", "type": "sheet", "material": "m", "size": bench.metres(0.4, 0.3), "rotation": turn}
    sheet = {"name": "sheet", "type": "sheet", "material": "m", "size": bench.metres(0.1, 0.1)}
    paint = {"m": {"type": "lambertian", "reflectance": 0.5}}
    camera, lamp = bench.camera((0, 0, 0.5), rows=4, columns=4), bench.lamp((0.1, 0.05, 0.5))
    far = {"position": bench.metres(5, 5, 5)}
    axes = np.asarray(bench.scene(camera, [lamp], paint, [sheet, beside | far]).targets[1].pose.rotation)
    place = np.array([0.0, 0.0, 0.5]) + axes @ np.array([0.31, 0.27, gap])
    scene = bench.scene(camera, [lamp], paint, [sheet, beside | {"position": bench.metres(*place)}])
    points = np.array([(0.0, 0.0, 0.0), (0.01, 0.02, 0.0)])
    alone = bench.radiance(bench.scene(camera, [lamp], paint, [sheet]), (0, 0, 0.5), points)
    assert bench.radiance(scene, (0, 0, 0.5), points) == pytest.approx(alone, rel=FLOAT32)
    edge_on = place + axes @ np.array([0.05, 0.02, 0.0])
    towards = edge_on + 0.1 * axes[:, 2]
    assert bench.radiance(scene, towards, edge_on[np.newaxis])[0] >= 0.0
