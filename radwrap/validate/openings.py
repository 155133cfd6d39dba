"""Section 4: the finite aperture in an even field and across an edge."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Generator, Iterable, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from radwrap.frames import Pose
from radwrap.imaging.methods.viewpoints import ViewpointPlan, merge, trace_viewpoints
from radwrap.imaging.optics.aperture import LAYOUTS, Layout, Viewpoints, sub_viewpoints
from radwrap.imaging.optics.view import PixelPlan
from radwrap.process import Programs
from radwrap.progress import Progress
from radwrap.scene.camera import Aperture, Camera, Sensor
from radwrap.validate import bench as on
from radwrap.validate.bench import Bench
from radwrap.validate.case import Case, Check, Finding
from radwrap.validate.closed_forms.aperture import at_zero_area, even_field_irradiance

Array = NDArray[np.float64]

_CONVERGED: Final = 1e-6
_FACTOR_DIGITS: Final = 1e-4  # of the printed 22 %, which is 1.2229
_UNIT_SUM: Final = 1e-15
_SYMMETRIC: Final = 1e-14  # of the radius: some hundred operations of float64
_FLOAT32: Final = 1.2e-7  # sub-viewpoints are kept as float32

_F: Final = 10.59e-3
_CORNER: Final = 1.856e-3  # from the centre of the 192 x 165 sensor to its last pixel [m]
# Numbers of sub-viewpoints in rings of like cells: the error goes with 1/N, and is taken to 1/N = 0.
_NUMBERS: Final = {1e-4: (61,), 1e-3: (37, 127), 1e-2: (37, 127, 469)}
_COUNTS: Final = (*range(1, 201), 4096)
_LATTICE_COUNTS: Final = (1, 7, 19, 37, 61)  # a lattice is searched for, which takes a second each
_FEW_COUNTS: Final = (1, 2, 3, 7, 19, 36, 61, 200)


def _field_names(diameter: float) -> tuple[str, str]:
    stem = f"4.uniform_field_{diameter * 1e3:g}_mm"
    return f"{stem}_axis", f"{stem}_corner"


def _uniform_field(bench: Bench) -> Iterator[Finding]:
    """A wide shining disc fills the view; pixel (0, 0) lies on the axis, (1, 1) at the sensor's corner."""
    sky: dict[str, Any] = {"type": "disc", "name": "sky", "diameter": "2 m", "radiance": "41 W/m^2/sr"}
    sky |= {"position": on.metres(0, 0, 1), "look_at": on.metres(0, 0, 0)}
    behind = on.sheet(1.0) | {"position": on.metres(0, 0, 2)}
    pitch = _CORNER / math.sqrt(2)
    for diameter, numbers in _NUMBERS.items():
        camera = on.camera(
            (0.0, 0.0, 0.0),
            (0.0, 0.0, 1.0),
            size=(2, 2),
            pitch=(pitch, pitch),
            principal_point=["0 px", "0 px"],
            focal_length=on.metres(_F)[0],
            aperture={"diameter": on.metres(diameter)[0]},
        )
        scene = on.scene(camera, [sky], {"it": on.lambertian(0.05)}, [behind])
        values = [bench.exposure(scene, viewpoints=number) for number in numbers]
        converged = at_zero_area(numbers, values)
        for name, place, distance in zip(_field_names(diameter), (0, 3), (0.0, _CORNER), strict=True):
            reference = 41.0 * even_field_irradiance(diameter / 2, _F, distance)
            yield Case(name, "H of a uniform field, closed form", reference, float(converged.flat[place]), _CONVERGED)
    one = float(bench.exposure(scene, viewpoints=1)[0, 0])
    found = one / (41.0 * even_field_irradiance(diameter / 2, _F))
    yield Case(
        "4.one_viewpoint_10_mm", "tau A/f^2 L is off by R^2/f^2", 1 + (diameter / 2 / _F) ** 2, found, _FACTOR_DIGITS
    )


def _layouts() -> Iterator[tuple[Layout, Viewpoints]]:
    aperture = Aperture(diameter=2.0)
    for layout in LAYOUTS:
        for count in _LATTICE_COUNTS if layout == "hexagonal" else _COUNTS:
            yield layout, sub_viewpoints(aperture, count, layout)


def _asymmetry(views: Viewpoints) -> float:
    """How far positions and weights are from those after half a turn."""
    distance, partner = cKDTree(views.positions).query(-views.positions)
    return max(float(distance.max()), float(np.abs(views.weights[partner] - views.weights).max()))


def _weights(bench: Bench) -> Iterator[Finding]:
    worst_sum = worst_centre = worst_turn = 0.0
    for layout, views in _layouts():
        worst_sum = max(worst_sum, abs(math.fsum(views.weights) - 1))
        centroid = [math.fsum(views.weights * views.positions[:, axis]) for axis in (0, 1)]
        worst_centre = max(worst_centre, math.hypot(*centroid))
        # Rings of unequal areas and odd numbers elsewhere than in the middle keep the centroid alone.
        if layout != "uneven":
            worst_turn = max(worst_turn, _asymmetry(views))
    bench.tick()
    yield Case("4.weights_sum", "sum of w_i", 0.0, worst_sum, _UNIT_SUM, "absolute")
    yield Case(
        "4.layout_centroid", "of radii, all layouts, N = 1 to 200, 4096", 0.0, worst_centre, _SYMMETRIC, "absolute"
    )
    yield Case("4.layout_symmetry", "half a turn changes nothing", 0.0, worst_turn, _SYMMETRIC, "absolute")


class _Field:
    """A tracer whose radiance is a formula of origins and of cosines to the axis, which is +z."""

    def __init__(self, formula: Callable[[Array, Array], Array]) -> None:
        self._formula = formula

    def trace(self, rays: Iterable[Array]) -> Generator[Array]:
        """As `Tracer.trace`."""
        for block in rays:
            yield self._formula(block[:, :3], block[:, 5] / np.linalg.norm(block[:, 3:], axis=1))

    def trace_with_distances(self, rays: Iterable[Array]) -> Generator[tuple[Array, Array]]:
        """As `Tracer.trace_with_distances`."""
        raise NotImplementedError

    def distances(self, rays: Iterable[Array]) -> Generator[Array]:
        """As `Tracer.distances`."""
        raise NotImplementedError


def _merged(field: _Field, count: int) -> Array:
    """Through files of sub-viewpoints and their merging, as a run does it."""
    aperture = Aperture(diameter=1e-3)
    pitch = _CORNER / math.sqrt(2)
    sensor = Sensor(2, 2, pitch, pitch, gain=1.0, gamma=1.0, dark_gray=0.0, saturation_gray=255.0)
    camera = Camera(Pose(), _F, (0.0, 0.0), 1.0, aperture, sensor)
    plan = ViewpointPlan(camera, sub_viewpoints(aperture, count), PixelPlan(), "field")
    with tempfile.TemporaryDirectory(prefix="radwrap-") as folder, Programs() as programs:
        quiet = Progress("", plan.rays, shown=False)
        trace_viewpoints(plan, field, Path(folder), programs=programs, workers=1, progress=quiet)
        return merge(plan, Path(folder))


def _merging(bench: Bench) -> Iterator[Finding]:
    level = _Field(lambda origin, cosine: 41.0 / cosine**4)
    worst = max((_merged(level, count) for count in _FEW_COUNTS), key=lambda image: float(np.abs(image - 41.0).max()))
    ours = float(worst.flat[np.abs(worst - 41.0).argmax()])
    yield Case("4.uniform_scene", f"unchanged by N = {_FEW_COUNTS}", 41.0, ours, _FLOAT32)
    slope = _Field(lambda origin, cosine: 1 + origin[:, 0] / 1e-3)
    bowl = _Field(lambda origin, cosine: (origin[:, 1] / 1e-3) ** 2)
    both = _Field(lambda origin, cosine: 3 * (1 + origin[:, 0] / 1e-3) + 0.7 * (origin[:, 1] / 1e-3) ** 2)
    parts = 3 * _merged(slope, 37) + 0.7 * _merged(bowl, 37)
    error = np.abs(_merged(both, 37) / parts - 1).max()
    bench.tick()
    yield Case(
        "4.merge_linear", "merge(3 a + .7 b) = 3 merge(a) + .7 merge(b)", 0.0, float(error), 2 * _FLOAT32, "absolute"
    )


CHECKS: Final = (
    Check(
        "4.uniform_field",
        (*(name for diameter in _NUMBERS for name in _field_names(diameter)), "4.one_viewpoint_10_mm"),
        _uniform_field,
    ),
    Check("4.layouts", ("4.weights_sum", "4.layout_centroid", "4.layout_symmetry"), _weights),
    Check("4.merging", ("4.uniform_scene", "4.merge_linear"), _merging),
)
