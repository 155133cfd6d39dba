"""An image through a lens with aberrations over the field, held against the pupil's own integral at single pixels."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
import pytest

import radwrap
from radwrap.imaging.optics.view import trace_rays
from radwrap.imaging.response.sensor import unclipped_gray
from radwrap.imaging.tracing import traced_scene
from radwrap.scene.camera import Camera
from tests.imaging.planes import Array

FOLDER = Path(__file__).parents[2] / "rad_scenes" / "real_lens"
WAVELENGTH = 630e-9
CELLS, HALF, PIXELS = 6, 22, 12  # cells along a pixel; pixels to either side; places that are looked at
RADII, ANGLES = 48, 240  # nodes over the pupil: they tell the 14 cycles that its phase has at the last cell
TOLERANCE = 0.7
STEEP = 0.9


def wavefront() -> dict[int, tuple[Array, Array]]:
    """Heights [m] and coefficients [m] of each term, as the file has them."""
    with (FOLDER / "wavefront.csv").open() as stream:
        rows = [
            (int(row["index"]), float(row["field_height_mm"]), row["coefficient"]) for row in csv.DictReader(stream)
        ]
    found = {}
    for index in {index for index, _, _ in rows}:
        heights, values = zip(
            *((height * 1e-3, float(value)) for one, height, value in rows if one == index), strict=True
        )
        found[index] = np.array(heights), np.array(values)
    return found


def spread(camera: Camera, column: int, row: int, offsets: Array, *, headlong: bool = False) -> Array:
    """Weights of cells around a pixel, by Noll's terms 4, 6, 7 and 11 in their own formulas; rows go down.

    Headlong the coma points the other way.
    """
    sensor, v, radius = camera.sensor, camera.image_distance, camera.aperture.diameter / 2
    nodes, weights = np.polynomial.legendre.leggauss(RADII)
    rho, theta = np.meshgrid(np.sqrt((nodes + 1) / 2), np.arange(ANGLES) * 2 * np.pi / ANGLES, indexing="ij")
    share = np.broadcast_to(weights[:, np.newaxis] / 2 / ANGLES, rho.shape)
    x = (column - camera.principal_point[0]) * sensor.pixel_width
    y = (camera.principal_point[1] - row) * sensor.pixel_height
    c = {index: np.interp(math.hypot(x, y), *table) for index, table in wavefront().items()}
    turned = theta - (math.atan2(y, x) - math.pi / 2)
    path = c[4] * math.sqrt(3) * (2 * rho**2 - 1) + c[6] * math.sqrt(6) * rho**2 * np.cos(2 * turned)
    path = path + (-1 if headlong else 1) * c[7] * math.sqrt(8) * (3 * rho**3 - 2 * rho) * np.sin(turned)
    path = path + c[11] * math.sqrt(5) * (6 * rho**4 - 6 * rho**2 + 1)
    k = 2 * np.pi / WAVELENGTH
    field = (share * np.exp(1j * k * path)).ravel()
    right, up = (radius * (rho * turn(theta)).ravel() for turn in (np.cos, np.sin))
    across = np.exp(-1j * k / v * np.outer(offsets * sensor.pixel_width, right))
    down = np.exp(-1j * k / v * np.outer(-offsets * sensor.pixel_height, up))
    area = sensor.pixel_width * sensor.pixel_height / CELLS**2
    intensity = np.abs((down * field) @ across.T) ** 2 * math.pi * radius**2 / (WAVELENGTH * v) ** 2 * area
    box = np.array([0.5, *[1.0] * (CELLS - 1), 0.5]) / CELLS
    for axis in (0, 1):
        intensity = np.apply_along_axis(np.convolve, axis, intensity, box, "same")
    return intensity


@pytest.mark.long
def test_each_pixel_gathers_by_its_own_wavefront_within_the_certificate() -> None:
    scene = radwrap.load_scene(FOLDER / "scene.toml")
    made = radwrap.render(scene, tolerance=TOLERANCE, seed=5)
    camera, random = scene.camera, np.random.default_rng(5)
    offsets = (np.arange((2 * HALF + 1) * CELLS) + 0.5) / CELLS - 0.5 - HALF
    steep = np.abs(np.gradient(made.radiant_exposure.values)[1])  # where aberrations show
    rows, columns = np.nonzero(steep > np.quantile(steep, STEEP))
    off, turned = [], []
    with traced_scene(scene, radwrap.RenderOptions()) as view:
        for place in random.choice(len(rows), PIXELS, replace=False):
            row, column = int(rows[place]), int(columns[place])
            u, v = np.meshgrid(column + offsets, row + offsets)
            light = trace_rays(view, None, u.ravel(), v.ravel())[0].reshape(u.shape)
            levels = []
            for headlong in (False, True):
                weights = spread(camera, column, row, offsets, headlong=headlong)
                radiance = (light * weights).sum() + (1 - weights.sum()) * light.mean()  # the tail, 1 % of the light
                exposure = np.array([radiance * view.exposure_of_radiance])
                levels.append(float(unclipped_gray(exposure, camera.sensor)[0]))
            found = unclipped_gray(made.radiant_exposure.values[row : row + 1, column], camera.sensor)[0]
            off.append(found - levels[0])
            turned.append(levels[1] - levels[0])
    # The steepest tenth of the pixels has more than its share of the error, but no more than all of it. Measured 2.6
    # times the bound, and .35 of what coma does that points the other way.
    rms, by_coma = (math.sqrt(float(np.mean(np.square(values)))) for values in (off, turned))
    assert math.sqrt(1 - STEEP) * rms < made.error.rms_gray_upper95
    assert rms < 0.4 * by_coma
