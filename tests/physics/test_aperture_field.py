"""The finite pinhole in a field of known radiance: H(p) = tau/f^2 times the integral of L cos^4 over the opening."""

import math
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import dblquad

import radwrap
from radwrap.frames import Pose
from radwrap.images import RadianceImage
from radwrap.imaging.methods.viewpoints import ViewpointPlan, merge, trace_viewpoints
from radwrap.imaging.optics.aperture import LAYOUTS, central_viewpoint, sub_viewpoints
from radwrap.imaging.optics.view import PixelPlan
from radwrap.imaging.response.exposure import radiant_exposure
from radwrap.process import Programs
from radwrap.progress import Progress
from radwrap.scene.camera import Aperture, Camera, Sensor
from radwrap.validate.closed_forms.aperture import at_zero_area, cos4, even_field_irradiance, pinhole_exposure

CONVERGED = 1e-6  # asked for by the validation plan
ROUNDING = 1e-14  # some tens of float64 operations
FLOAT32 = 1.2e-7  # sub-viewpoints are kept as float32: 2^-24 each, and as much again when the result is stored

F = 10.59e-3
TAU = 0.13
RADIANCE = 41.0
CORNER = 1.856e-3  # from the centre of the 192 x 165 sensor to its last pixel [m]


class Field:
    """A tracer whose radiance is a formula of origins and directions; cos is to the camera's axis, which is +z."""

    def __init__(self, formula: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> None:
        self.formula = formula

    def trace(self, rays: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
        for block in rays:
            cosine = block[:, 5] / np.linalg.norm(block[:, 3:], axis=1)
            yield self.formula(block[:, :3], cosine)


UNIFORM = Field(lambda origin, cosine: np.full(len(origin), RADIANCE))


def camera_of(aperture: Aperture) -> Camera:
    """At the origin, looking along +z; pixel (0, 0) lies on the axis, (1, 1) at the sensor's corner."""
    pitch = CORNER / math.sqrt(2)
    sensor = Sensor(2, 2, pitch, pitch, gain=1.0, gamma=1.0, dark_gray=0.0, saturation_gray=255.0)
    return Camera(Pose(), F, (0.0, 0.0), TAU, aperture, sensor)


def round_opening(radius: float, distance: float) -> float:
    """H of a round opening of `radius` in a uniform field, at a sensor point so far from the axis."""
    return TAU * RADIANCE * even_field_irradiance(radius, F, distance)


@pytest.fixture
def expose(tmp_path: Path) -> Callable[..., np.ndarray]:
    """H by the whole way of a run: files of sub-viewpoints, merge, exposure."""

    def run(tracer: Any, aperture: Aperture, count: int, layout: Any = "rings") -> np.ndarray:
        camera = camera_of(aperture)
        views = sub_viewpoints(aperture, count, layout)
        plan = ViewpointPlan(camera, views, PixelPlan(), "field")
        folder = tmp_path / f"{len(list(tmp_path.iterdir()))}"
        folder.mkdir()
        with Programs() as programs:
            progress = Progress("", plan.rays, shown=False)
            trace_viewpoints(plan, tracer, folder, programs=programs, workers=2, progress=progress)
        return radiant_exposure(RadianceImage(merge(plan, folder)), camera).values

    return run


@pytest.mark.parametrize(
    ("diameter", "numbers"),
    [
        (1e-4, (61,)),  # R^2/f^2 is 2e-5, and its 61st part is below the tolerance
        (1e-3, (37, 127)),
        pytest.param(
            1e-2, (37, 127, 469), marks=pytest.mark.long
        ),  # centred hexagonal numbers: rings of like cells, so that the error goes with 1/N
    ],
)
def test_uniform_field(diameter: float, numbers: tuple[int, ...], expose: Callable[..., np.ndarray]) -> None:
    converged = at_zero_area(numbers, [expose(UNIFORM, Aperture(diameter=diameter), number) for number in numbers])
    assert converged[0, 0] == pytest.approx(round_opening(diameter / 2, 0.0), rel=CONVERGED)
    assert converged[1, 1] == pytest.approx(round_opening(diameter / 2, CORNER), rel=CONVERGED)
    # On the axis the closed form is tau pi L R^2/(R^2 + f^2).
    on_axis = TAU * math.pi * RADIANCE * (diameter / 2) ** 2 / ((diameter / 2) ** 2 + F**2)
    assert converged[0, 0] == pytest.approx(on_axis, rel=CONVERGED)


def test_wide_opening_needs_the_integral(expose: Callable[..., np.ndarray]) -> None:
    """One viewpoint is tau A/f^2 L cos^4: exact for a pinhole, 22 % too much at 10 mm."""
    one = expose(UNIFORM, Aperture(diameter=1e-2), 1)
    level = pinhole_exposure(RADIANCE, 1e-2, F, TAU)
    assert one[0, 0] == pytest.approx(level, rel=FLOAT32)
    assert one[1, 1] == pytest.approx(level * cos4(CORNER, 0.0, F), rel=FLOAT32)
    assert one[0, 0] / round_opening(5e-3, 0.0) == pytest.approx(1.2229, abs=1e-4)


@pytest.mark.parametrize("place", [(0, 0), (1, 1)])
def test_uniform_field_through_other_openings(place: tuple[int, int], bench: Any) -> None:
    """Annular: disc less stop. Half disc: half of the disc, on the axis. Square: by quadrature."""
    numbers = (96, 384)
    distance = CORNER if place == (1, 1) else 0.0
    side = 1e-3

    def converged(aperture: Aperture) -> float:
        camera = camera_of(aperture)
        means = [bench.mean(camera, sub_viewpoints(aperture, n), UNIFORM) for n in numbers]
        mean = at_zero_area(numbers, means)
        return float(radiant_exposure(RadianceImage(mean), camera).values[place])

    x = y = distance / math.sqrt(2)
    integral, _ = dblquad(
        lambda u, v: (F / math.hypot(x + u, y + v, F)) ** 4, -side / 2, side / 2, -side / 2, side / 2, epsabs=1e-20
    )
    square = TAU * RADIANCE / F**2 * integral
    assert converged(Aperture(shape="square", diameter=side)) == pytest.approx(square, rel=CONVERGED)

    annular = round_opening(side / 2, distance) - round_opening(side / 5, distance)
    assert converged(Aperture(shape="annular", diameter=side, inner_diameter=0.4 * side)) == pytest.approx(
        annular, rel=CONVERGED
    )
    halves = [converged(Aperture(shape="half_disc", diameter=side, rotation=turn)) for turn in (0.0, math.pi)]
    assert sum(halves) == pytest.approx(round_opening(side / 2, distance), rel=CONVERGED)
    if distance == 0.0:
        assert halves[0] == pytest.approx(halves[1], rel=ROUNDING)
    else:  # the half towards the image point is seen under the larger angle
        assert halves[0] < halves[1]


@pytest.mark.parametrize(("diameter", "numbers"), [(1e-4, (61,)), pytest.param(1e-3, (19, 61), marks=pytest.mark.long)])
def test_uniform_field_of_the_real_tracer(bench: Any, diameter: float, numbers: tuple[int, ...]) -> None:
    """A wide shining disc fills the view; the whole of `render` answers."""
    pitch = CORNER / math.sqrt(2)
    camera = bench.camera(
        (0.0, 0.0, 0.0),
        (0.0, 0.0, 1.0),
        rows=2,
        columns=2,
        pitch=(pitch, pitch),
        focal_length=F,
        principal_point=["0 px", "0 px"],
        aperture={"diameter": f"{diameter!r} m"},
    ) | {"exposure_time": f"{TAU!r} s"}
    disc = {"type": "disc", "name": "sky", "diameter": "2 m", "radiance": f"{RADIANCE} W/m^2/sr"}
    disc |= {"position": bench.metres(0, 0, 1), "look_at": bench.metres(0, 0, 0)}
    behind = {"type": "sheet", "material": "black", "size": ["1 m", "1 m"], "position": bench.metres(0, 0, 2)}
    scene = bench.scene(camera, [disc], {"black": {"type": "lambertian", "reflectance": 0.05}}, [behind])
    values = [radwrap.render(scene, viewpoints=number).radiant_exposure.values for number in numbers]
    converged = at_zero_area(numbers, values)
    assert converged[0, 0] == pytest.approx(round_opening(diameter / 2, 0.0), rel=CONVERGED)
    assert converged[1, 1] == pytest.approx(round_opening(diameter / 2, CORNER), rel=CONVERGED)


@pytest.mark.parametrize(
    "counts", [(*range(1, 20), 37, 61, 100, 151), pytest.param((*range(1, 201), 4096), marks=pytest.mark.long)], ids=len
)
def test_uniform_scene_is_unchanged_by_any_number(bench: Any, counts: tuple[int, ...]) -> None:
    """L cos^4 the same for all rays: what is left is the sum of the weights, which is 1."""
    level = Field(lambda origin, cosine: RADIANCE / cosine**4)
    aperture = Aperture(diameter=1e-3)
    camera = camera_of(aperture)
    for count in counts:
        views = sub_viewpoints(aperture, count)
        assert len(views) == count
        assert bench.mean(camera, views, level) == pytest.approx(np.full((2, 2), RADIANCE), rel=ROUNDING)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_uniform_scene_is_unchanged_by_the_layout(layout: Any, expose: Callable[..., np.ndarray]) -> None:
    level = Field(lambda origin, cosine: RADIANCE / cosine**4)
    whole = pinhole_exposure(RADIANCE, 1e-3, F, TAU)
    for count in (1, 7, 61):
        values = expose(level, Aperture(diameter=1e-3), count, layout)
        assert values == pytest.approx(np.full((2, 2), whole), rel=FLOAT32)


def test_merging_is_linear(expose: Callable[..., np.ndarray]) -> None:
    aperture = Aperture(diameter=1e-3)
    slope = Field(lambda origin, cosine: 1 + origin[:, 0] / 1e-3)
    square = Field(lambda origin, cosine: (origin[:, 1] / 1e-3) ** 2)
    both = Field(lambda origin, cosine: 3 * slope.formula(origin, cosine) + 0.7 * square.formula(origin, cosine))
    scaled = Field(lambda origin, cosine: 1024 * slope.formula(origin, cosine))
    parts = [expose(tracer, aperture, 37, "uneven") for tracer in (slope, square)]
    together = expose(both, aperture, 37, "uneven")
    assert together == pytest.approx(3 * parts[0] + 0.7 * parts[1], rel=FLOAT32)
    # A power of two passes through float32 unchanged.
    assert (expose(scaled, aperture, 37, "uneven") == 1024 * parts[0]).all()


@pytest.mark.parametrize("layout", LAYOUTS)
def test_each_viewpoint_counts_by_its_area(layout: Any, expose: Callable[..., np.ndarray]) -> None:
    """Radiance that grows with the distance from the axis squared: its mean over a disc is R^2/2.

    The sum over N centroids misses the second moment inside the cells, about 1/N of it; equal weights for
    unequal areas would miss half.
    """
    radius, count = 0.5e-3, 127
    bowl = Field(lambda origin, cosine: (origin[:, 0] ** 2 + origin[:, 1] ** 2) / cosine**4)
    values = expose(bowl, Aperture(diameter=2 * radius), count, layout)
    whole = pinhole_exposure(radius**2 / 2, 2 * radius, F, TAU)
    assert values[0, 0] == pytest.approx(whole, rel=2 / count)


@pytest.mark.parametrize(("turn", "direction"), [(0.0, (1.0, 0.0)), (90.0, (0.0, 1.0)), (30.0, (0.8660254, 0.5))])
def test_half_disc_weighs_its_own_side(
    turn: float, direction: tuple[float, float], expose: Callable[..., np.ndarray]
) -> None:
    """The mean of a slope over a half disc is the slope at its centroid, 4 R/(3 pi) from the straight edge."""
    radius = 0.5e-3
    aperture = Aperture(shape="half_disc", diameter=2 * radius, rotation=math.radians(turn))
    for axis in (0, 1):
        slope = Field(lambda origin, cosine, axis=axis: (1 + origin[:, axis] / radius) / cosine**4)
        values = expose(slope, aperture, 12)
        mean = values[0, 0] / (pinhole_exposure(1.0, 2 * radius, F, TAU) / 2)
        assert mean == pytest.approx(1 + direction[axis] * 4 / (3 * math.pi), rel=2e-7)


def test_infinitesimal_pinhole_takes_its_level_from_the_stated_area(bench: Any) -> None:
    """All light goes through the centre, as much as a disc of the exposure diameter would let through."""
    aperture = Aperture(diameter=0.0, exposure_diameter=2e-4)
    camera = camera_of(aperture)
    views = central_viewpoint(aperture)
    values = radiant_exposure(RadianceImage(bench.mean(camera, views, UNIFORM)), camera).values
    level = pinhole_exposure(RADIANCE, 2e-4, F, TAU)
    assert values[0, 0] == pytest.approx(level, rel=ROUNDING)
    assert values[1, 1] == pytest.approx(level * cos4(CORNER, 0.0, F), rel=ROUNDING)
