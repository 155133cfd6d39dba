"""A straight edge through the finite pinhole against Eqs. 8 to 10, traced by the real Radiance.

A pixel at the erect image point x' sees the target through the whole opening, a disc of radius
R = (d_p/2)(1 + D'/f) about the point that the pinhole's centre projects it to (Eq. 8). It receives the share of
that disc which lies on the bright side (Eq. 9).
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.imaging.optics.aperture import Viewpoints, sub_viewpoints
from radwrap.imaging.optics.view import RayBlock
from radwrap.scene.camera import Aperture, Camera
from radwrap.validate.closed_forms.aperture import blurred_edge, cos4, pinhole_exposure, projection_radius, share_beyond

F = 10.59e-3
OPENING = 0.1e-3
PITCH = 13.75e-6
FAR, NEAR = 1.0, 3 * F  # distances D' [m]; at 3 f a shift of the wrong sign leaves half of R
DIRECTIONS = 12  # of the edge, over a full turn; the layout has its own six-fold ones

# rms over |S| <= 1 and all directions, of a pixel's area sampled 3 x 3. Measured .0043, .0017 and .0031: the limits
# are half as large again. They are stricter than what was asked for: .012, .005 and .015.
LIMITS = {(FAR, 37): 0.0065, (FAR, 127): 0.0025, (NEAR, 61): 0.0047}
# One ray at the pixel's centre; measured .050, .028, .017, .011, .0055.
POINT_LIMITS = {7: 0.062, 19: 0.034, 37: 0.021, 61: 0.014, 127: 0.0085}
UNMISTAKABLE = 0.05  # rms of a wrong shift; ten times the limit
FLOAT32 = 2e-7  # sub-viewpoints and result are each rounded to float32, and the tracer answers in it
SUBPIXEL = 0.03  # px, what 4 x 4 rays a pixel and some tens of sub-viewpoints leave of a centroid


def edge_scene(
    bench: Any, depth: float, angle: float, side: int, offset: tuple[float, float], **aperture: Any
) -> radwrap.Scene:
    """An edge on the camera's axis, black beside white, turned about the axis; the lamp lights it evenly."""
    middle = (side - 1) / 2
    camera = bench.camera(
        (0.0, 0.0, depth),
        rows=side,
        columns=side,
        pitch=(PITCH, PITCH),
        focal_length=F,
        principal_point=[f"{middle + offset[0]!r} px", f"{middle + offset[1]!r} px"],
        aperture={"diameter": f"{OPENING!r} m", **aperture},
    )
    # So far away that its irradiance differs by 1e-10 over what is seen; it gives a white radiance of 1.
    lamp = bench.lamp((0.0, 0.0, 1000.0), diameter=1.0, half_angle=5.0, radiant_intensity=1e6 * math.pi)
    edge = {
        "type": "edge",
        "material": "black",
        "edge_material": "white",
        "size": ["4 m", "4 m"],
        "rotation": bench.degrees(0, 0, angle),
    }
    materials = {
        "black": {"type": "lambertian", "reflectance": 0.0},
        "white": {"type": "lambertian", "reflectance": 1.0},
    }
    return bench.scene(camera, [lamp], materials, [edge])


def expected(
    depth: float, angle: float, side: int, offset: tuple[float, float], points: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Eq. 9 averaged over each pixel by so many midpoints a side; S and cos^4 at the pixel's centre."""
    along = np.arange(side) - (side - 1) / 2
    columns, rows = ((along - start) * PITCH for start in offset)
    turn = -math.radians(angle)  # rows run down, the world's y up
    radius = projection_radius(OPENING, depth, F) * F / depth
    mean = blurred_edge(columns, rows, (PITCH, PITCH), angle=turn, radius=radius, points=points)
    x, y = np.meshgrid(columns, rows)
    return mean, (x * math.cos(turn) + y * math.sin(turn)) / radius, cos4(x, y, F)


def rms_against_eq9(bench: Any, depth: float, views: Viewpoints, samples: int = 3, bend: Any = None) -> float:
    """Root mean square of what is traced less Eq. 9 over |S| <= 1 and all directions of the edge."""
    radius = projection_radius(OPENING, depth, F)
    side = 2 * math.ceil(radius * F / depth / PITCH) + 3
    # Eq. 2: the mean over the pixel's area, far finer than the rays; one ray has no area.
    points = 16 if samples > 1 else 1
    squares, number = 0.0, 0
    for turn in range(DIRECTIONS):
        angle = 360 * (turn + 0.37) / DIRECTIONS
        offset = (0.5 * math.cos(5 * turn), 0.5 * math.sin(7 * turn))  # pixels fall differently each time
        traced = bench.image(edge_scene(bench, depth, angle, side, offset), views, samples, bend)
        mean, s, falloff = expected(depth, angle, side, offset, points)
        counted = np.abs(s) <= 1
        squares += float(((traced / falloff - mean)[counted] ** 2).sum())
        number += int(counted.sum())
    return math.sqrt(squares / number)


def opening_views(count: int, layout: Any = "rings") -> Viewpoints:
    return sub_viewpoints(Aperture(diameter=OPENING), count, layout)


def sheared(factor: float) -> Any:
    """Rays whose window is shifted by `factor` times what it should be: -1 turns the sign, 0 leaves it out."""

    def bend(block: RayBlock, camera: Camera, q: tuple[float, float]) -> RayBlock:
        excess = np.asarray(camera.pose.rotation) @ np.array([*q, 0.0]) * (1 - factor)
        rays = block.rays - np.concatenate([np.zeros(3), excess])
        square = (rays[:, 3:] ** 2).sum(axis=1)
        return replace(block, rays=rays, cos4=(camera.focal_length**2 / square) ** 2)

    return bend


@pytest.mark.parametrize(
    ("depth", "count"),
    [(FAR, 37), *(pytest.param(*pair, marks=pytest.mark.long) for pair in LIMITS if pair != (FAR, 37))],
)
def test_eq9(bench: Any, depth: float, count: int) -> None:
    assert rms_against_eq9(bench, depth, opening_views(count)) <= LIMITS[depth, count]


@pytest.mark.parametrize(
    "count", [7, 37, *(pytest.param(count, marks=pytest.mark.long) for count in POINT_LIMITS if count not in (7, 37))]
)
def test_eq9_at_points(bench: Any, count: int) -> None:
    assert rms_against_eq9(bench, FAR, opening_views(count), samples=1) <= POINT_LIMITS[count]


@pytest.mark.parametrize(
    "layout", ["uneven", *(pytest.param(name, marks=pytest.mark.long) for name in ("hexagonal", "sunflower"))]
)
def test_eq9_with_the_other_layouts(bench: Any, layout: str) -> None:
    """Spirals and unequal areas cost accuracy: measured .0049, .0081 and .0085 beside .0043 with rings."""
    assert rms_against_eq9(bench, FAR, opening_views(37, layout)) <= 0.012


@pytest.mark.long
def test_measuring_sees_a_shift_of_the_wrong_sign(bench: Any) -> None:
    """The same measurement fails at 3 f, .13, with the shear's sign turned; at 1 m it would see nothing."""
    views = opening_views(61)
    assert rms_against_eq9(bench, NEAR, views, samples=1, bend=sheared(1.0)) <= POINT_LIMITS[61]
    assert rms_against_eq9(bench, NEAR, views, samples=1, bend=sheared(-1.0)) == pytest.approx(0.128, abs=0.01)
    assert rms_against_eq9(bench, FAR, views, samples=1, bend=sheared(-1.0)) <= POINT_LIMITS[37]


@pytest.mark.parametrize(("depth", "rms"), [(FAR, 0.266), (NEAR, 0.198)])
def test_measuring_sees_a_missing_shift(bench: Any, depth: float, rms: float) -> None:
    """Moving the viewpoint alone is a lens focused at infinity."""
    found = rms_against_eq9(bench, depth, opening_views(61), samples=1, bend=sheared(0.0))
    assert found > UNMISTAKABLE
    assert found == pytest.approx(rms, abs=0.01)


def test_unequal_areas_need_their_weights(bench: Any) -> None:
    """At N = 61 the inner ones stand for an eighth of the area of the outer ones; measured .016 and .060."""
    views = opening_views(61, "uneven")
    limit = 0.02
    assert rms_against_eq9(bench, FAR, views, samples=1) <= limit
    alike = Viewpoints(views.positions, np.full(len(views), 1 / len(views)), views.area)
    assert rms_against_eq9(bench, FAR, alike, samples=1) > 2 * limit


def test_render_is_the_weighted_sum(bench: Any) -> None:
    """`render` gives tau A/f^2 times what is measured above, and halves it where the edge is."""
    scene = edge_scene(bench, FAR, 30.0, 9, (0.2, -0.1))
    views = opening_views(61, "uneven")
    values = radwrap.render(scene, viewpoints=61, layout="uneven", pixel_samples=2).radiant_exposure.values
    factor = pinhole_exposure(1.0, OPENING, F)
    assert values == pytest.approx(factor * bench.image(scene, views, 2), rel=FLOAT32, abs=FLOAT32 * factor)
    # The opposite sides of the edge add up to the whole, apart from 9 x 9 pixels' falling off with cos^4.
    at_points, _, _ = expected(FAR, 30.0, 9, (0.2, -0.1), points=1)
    assert values / factor == pytest.approx(at_points, abs=0.03)


def test_edge_of_the_paper(bench: Any) -> None:
    """Sec. 4.3: an edge at beta_0 = 0.0015 rad lies at 95.5 px + f tan(beta_0)/13.75 um = 96.655 px (printed 96.7)."""
    camera = bench.camera(focal_length=F, principal_point=["95.5 px", "0 px"])
    camera |= {"sensor": {"preset": "fivs", "rows": 1, "columns": 110}}
    lamp = bench.lamp((0.0, 0.0, 1000.0), diameter=1.0, half_angle=5.0, radiant_intensity=1e6 * math.pi)
    edge = {"type": "edge", "material": "black", "edge_material": "white", "size": ["4 m", "4 m"]}
    edge["edge_position"] = f"{math.tan(0.0015)!r} m"
    materials = {
        "black": {"type": "lambertian", "reflectance": 0.0},
        "white": {"type": "lambertian", "reflectance": 1.0},
    }
    scene = bench.scene(camera, [lamp], materials, [edge])
    exposure = radwrap.render(scene, viewpoints=61, pixel_samples=6).radiant_exposure.values[0]
    columns = np.arange(110)
    share = exposure / pinhole_exposure(cos4((columns - 95.5) * 13.75e-6, 0.0, F), OPENING, F)
    # A blur that is the same to both sides leaves the sum as it is: so many bright pixels lie beside the edge.
    position = 109.5 - share.sum()
    assert position == pytest.approx(95.5 + F * math.tan(0.0015) / 13.75e-6, abs=SUBPIXEL)
    blur = projection_radius(OPENING, FAR, F) * F / FAR / 13.75e-6  # 3.67 px on the sensor
    assert (share[columns < position - blur - 0.5] == 0).all()
    # cos^4 of the shifted rays differs from that of the central one by R^2/f^2.
    assert share[columns > position + blur + 0.5] == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize(
    ("turn", "direction"),
    [
        (210.0, (-0.8660254, -0.5)),
        *(pytest.param(*pair, marks=pytest.mark.long) for pair in ((0.0, (1.0, 0.0)), (90.0, (0.0, 1.0)))),
    ],
)
def test_half_disc_moves_the_image_of_a_spot_away_from_it(
    bench: Any, turn: float, direction: tuple[float, float]
) -> None:
    """Light of a point goes on through the opening's point q to x = q(1 + f/D') on the sensor: -x in the erect image.

    So a spot's centroid moves by 4 (d_p/2)/(3 pi) (1 + f/D') against the side on which the half disc lies.
    """
    side, diameter = 21, 6e-3
    camera = bench.camera(
        (0.0, 0.0, FAR),
        rows=side,
        columns=side,
        pitch=(PITCH, PITCH),
        focal_length=F,
        aperture={"diameter": f"{OPENING!r} m", "shape": "half_disc", "rotation": f"{turn} deg"},
    )
    lamp = bench.lamp((0.0, 0.0, 1000.0), diameter=1.0, half_angle=5.0, radiant_intensity=1e6 * math.pi)
    spot = {"type": "disc", "material": "white", "diameter": f"{diameter} m"}
    scene = bench.scene(camera, [lamp], {"white": {"type": "lambertian", "reflectance": 1.0}}, [spot])
    values = radwrap.render(scene, viewpoints=36, pixel_samples=4).radiant_exposure.values
    rows, columns = np.indices(values.shape) - (side - 1) / 2
    shift = 4 * (OPENING / 2) / (3 * math.pi) * (1 + F / FAR) / PITCH
    assert (values * columns).sum() / values.sum() == pytest.approx(-shift * direction[0], abs=SUBPIXEL)
    assert (values * rows).sum() / values.sum() == pytest.approx(-shift * direction[1], abs=SUBPIXEL)
    # Nothing is lost: all light of the spot that the half opening takes.
    spot_pixels = math.pi * (diameter * F / FAR / PITCH) ** 2 / 4
    level = pinhole_exposure(1.0, OPENING, F) / 2
    assert values.sum() / level == pytest.approx(spot_pixels, rel=1e-2)  # by 4 x 4 rays a pixel


def test_half_disc_across_an_edge(bench: Any) -> None:
    """The part q > t of the half disc of unit radius is 2/pi (acos t - t sqrt(1 - t^2)); t = -x'/R, correlation.

    A convolution would have the transition on the other side of the edge, and be wrong by 1 there.
    """
    side = 13
    scene = edge_scene(bench, FAR, 0.0, side, (0.3, 0.0), shape="half_disc")
    views = sub_viewpoints(scene.camera.aperture, 60)
    profile = bench.image(scene, views, 3)[side // 2]
    x = (np.arange(side) - (side - 1) / 2 - 0.3) * PITCH
    fine = (np.arange(64) + 0.5) / 64 - 0.5
    t = np.clip(-(x[:, np.newaxis] + fine * PITCH) / (projection_radius(OPENING, FAR, F) * F / FAR), 0.0, 1.0)
    due = (2 * share_beyond(-t)).mean(axis=1)
    assert profile == pytest.approx(due, abs=0.03)  # 60 sub-viewpoints; the columns of some coincide
    assert math.sqrt(((profile - due) ** 2).mean()) < 0.01
    assert math.sqrt(((profile - (1 - due[::-1])) ** 2).mean()) > 10 * 0.01
