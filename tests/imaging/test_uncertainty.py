"""Each cause of uncertainty by closed form, what a run writes of it, and how often the intervals hold."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.images import ExposureImage, read_image
from radwrap.imaging.response.noise import fixed_pattern, noisy_frame
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.tolerance.uncertainty import _EVEN_SHARE, _where_rays_err, spread_of, uncertainty
from radwrap.scene.camera import Camera, Lens
from radwrap.scene.tolerances import Tolerances
from radwrap.validate.closed_forms.aperture import share_beyond
from radwrap.validate.closed_forms.sensor import transfer_variance
from tests.physics.conftest import Bench
from tests.physics.test_linear_sensor import MU_P_OF_H, TABLE, scene_with, sensor_of

HALF = 1.959963984540054  # a tolerance in standard deviations


def camera_with(**changes: Any) -> Camera:
    return scene_with({**TABLE, "rows": 20, "columns": 30, **changes}).camera


def level(camera: Camera, photons: float) -> ExposureImage:
    return ExposureImage(np.full((camera.sensor.rows, camera.sensor.columns), photons / MU_P_OF_H))


CAUSES = {
    "source_radiance": (Tolerances(source_radiance=0.05 * HALF), 0.05 * 900),
    "aperture_diameter": (Tolerances(aperture_diameter=1e-6 * HALF), 2 * 0.01 * 900),  # of 0.1 mm; area goes as d^2
    "exposure_time": (Tolerances(exposure_time=4e-4 * HALF), 0.02 * 900),  # of 20 ms
    "sensor_gain": (Tolerances(sensor_gain=0.03 * HALF), 0.03 * 900),
    "dark_gray": (Tolerances(dark_gray=1.5 * HALF), 1.5),
    "rays": (Tolerances(), 0.4),
}


@pytest.mark.parametrize("name", CAUSES)
def test_each_cause_by_closed_form(name: str) -> None:
    camera = camera_with()
    tolerances, expected = CAUSES[name]
    found = uncertainty(level(camera, 6000), camera, tolerances, 0.4)  # 900 gray levels above dark
    assert found.parts[name] == pytest.approx(expected, rel=1e-9)
    noise = transfer_variance(900 / 0.25, gain=0.25, read_noise=8)
    rest = 0.0 if name == "rays" else 0.4**2
    assert found.sigma == pytest.approx(math.sqrt(expected**2 + rest + noise), rel=1e-9)


def test_more_blur_changes_an_edge_as_its_profile_says() -> None:
    """A pinhole 1 % larger: the blurred edge of a bright half-plane, rendered by its closed form at both sizes.

    Behind a disc of radius R the edge is 1 - (acos S - S sqrt(1 - S^2))/pi, S = x/R (Eq. 9).
    """

    def seen(radius: float) -> np.ndarray:
        # On the middle of a pixel; the profile's mean over a pixel by 400 points.
        x = (np.arange(30)[:, np.newaxis] - 14.7 + (np.arange(400) + 0.5) / 400 - 0.5) / radius
        return np.tile(0.1 + share_beyond(x).mean(axis=1), (20, 1)) * 900 / camera.sensor.gain

    camera = camera_with(rounding=False, pixel_width="25 um", pixel_height="25 um")  # d_p 0.1 mm: R = 2 px
    found = uncertainty(ExposureImage(seen(2.0)), camera, Tolerances(aperture_diameter=1e-6 * HALF), 0.0)
    small, large = (1.01 ** (2 * z) * seen(2.0 * 1.01**z) for z in (-1, 1))
    expected = np.abs(gray_levels(large, camera.sensor) - gray_levels(small, camera.sensor)) / 2
    noise = uncertainty(ExposureImage(seen(2.0)), camera, Tolerances(), 0.0).sigma
    alone = np.sqrt(np.maximum(found.sigma**2 - noise**2, 0.0))
    without = 2 * 0.01 * (gray_levels(seen(2.0), camera.sensor) - 100)

    def off(values: np.ndarray) -> float:
        return float(np.sqrt(np.mean((values - expected) ** 2)))

    # Second moments stand for the disc, whose rims have kinks: there 6 % of the largest change was seen.
    assert np.abs(alone - expected).max() < 0.1 * expected.max()
    assert off(alone) < 0.6 * off(without)


def test_a_lens_blurs_by_its_magnification() -> None:
    """None in the plane of focus; elsewhere the square of M times that of a pinhole."""
    camera = camera_with(rounding=False)
    through = replace(camera, lens=Lens(focus_distance=0.2))
    edge = ExposureImage(np.tile(np.where(np.arange(30) < 14, 3000.0, 6000.0), (20, 1)) / MU_P_OF_H)
    tolerances = Tolerances(aperture_diameter=1e-7 * HALF)

    def part(seen: Camera, magnification: float) -> np.ndarray:
        filled = np.full(edge.values.shape, magnification)
        sigma, least = (uncertainty(edge, seen, t, 0.0, magnification=filled).sigma for t in (tolerances, Tolerances()))
        return np.sqrt(sigma**2 - least**2)

    light = 2e-3 * (gray_levels(edge.values, camera.sensor) - 100)
    assert part(through, 0.0) == pytest.approx(light, rel=1e-6)
    pinhole, half = (part(*case) - light for case in ((camera, 1.0), (through, 0.05)))
    beside = 13  # the dark side, which blur brightens
    assert half[:, beside] == pytest.approx(0.05**2 * pinhole[:, beside], rel=1e-2)
    with pytest.raises(ValueError, match="magnifications"):
        uncertainty(edge, through, tolerances, 0.0)


def test_a_gain_before_a_power_law_counts_by_the_power() -> None:
    camera = camera_with(gamma=0.5)
    found = uncertainty(level(camera, 6000), camera, Tolerances(sensor_gain=0.001 * HALF), 0.0)
    above = gray_levels(level(camera, 6000).values, camera.sensor)[0, 0] - 100
    assert found.parts["sensor_gain"] == pytest.approx(0.5 * 0.001 * above, rel=1e-6)


def test_sources_of_their_own_add_as_squares() -> None:
    camera = camera_with()
    spread = np.full((20, 30), 1 / math.sqrt(12))  # twelve of equal share
    found = uncertainty(level(camera, 6000), camera, Tolerances(each_source_radiance=0.1 * HALF), 0.0, spread)
    assert found.parts["each_source_radiance"] == pytest.approx(0.1 * 900 / math.sqrt(12), rel=1e-9)


def test_nothing_is_uncertain_beyond_saturation_but_the_converter() -> None:
    camera = camera_with()
    found = uncertainty(level(camera, 1e6), camera, Tolerances(source_radiance=0.1, sensor_gain=0.1), 0.0)
    assert found.parts["source_radiance"] == found.parts["sensor_gain"] == 0.0


def test_intervals_hold_as_often_as_they_say() -> None:
    """400 cameras within their tolerances, 600 pixels each, at levels from dim to bright; errors of one camera hang
    together, so that a share over 400 has a standard error of at most 2.3 %: 6 % is 2.6 of them, seed fixed."""
    camera = camera_with(read_noise="20 e", prnu=0.01, dsnu="10 e")
    sensor, random = camera.sensor, np.random.default_rng(4)
    base = np.linspace(500, 12000, 600).reshape(20, 30) / MU_P_OF_H
    tolerances = Tolerances(source_radiance=0.02, aperture_diameter=1e-6, sensor_gain=0.02, dark_gray=8.0)
    found = uncertainty(ExposureImage(base), camera, tolerances, 0.0)
    predicted = gray_levels(base, sensor)
    held = np.zeros(2)
    for number in range(400):
        z = random.standard_normal(4) / HALF
        factor = (1 + 0.02 * z[0]) * (1 + 0.01 * z[1]) ** 2 * (1 + 0.02 * z[2])
        specimen = sensor_of(rows=20, columns=30, read_noise="20 e", prnu=0.01, dsnu="10 e", device_seed=number)
        frame = noisy_frame(ExposureImage(base * factor), specimen, fixed_pattern(specimen), 1, number).values
        off = np.abs(frame + 8.0 * z[3] - predicted) / found.sigma
        held += [(off <= 1).mean(), (off <= HALF).mean()]
    assert held / 400 == pytest.approx([0.6827, 0.95], abs=0.06)


def sheet(
    tolerances: dict[str, Any] | None, sensor: dict[str, Any] | None = None, *, lens: bool = False
) -> radwrap.Scene:
    view = Bench.camera(rows=6, columns=8, pitch=(2e-4, 2e-4))
    if sensor is not None:
        view = {**view, "sensor": sensor}
    if lens:
        view = {k: v for k, v in view.items() if k != "aperture"}
        view["lens"] = {"focus_distance": "1 m", "f_number": 8}
    document: dict[str, Any] = {
        "camera": view | {"exposure_time": "200 ms"},
        "sources": [Bench.lamp((x, 0, 0.5), name=name) for name, x in (("left", -0.3), ("right", 0.3))],
        "materials": {"white": {"type": "lambertian", "reflectance": 0.5}},
        "targets": [{"type": "sheet", "material": "white", "size": ["1 m", "1 m"]}],
    }
    if tolerances is not None:
        document["tolerances"] = tolerances
    return radwrap.scene_from_document(document)


def test_a_run_writes_it_where_the_scene_states_tolerances(tmp_path: Path) -> None:
    plain = radwrap.render(sheet(None), tmp_path, method="pinhole")
    assert "uncertainty" not in plain.manifest and not (tmp_path / "gray_sigma.exr").exists()
    result = radwrap.render(sheet({"each_source_radiance": 0.1 * HALF}), tmp_path, method="pinhole")
    sigma = read_image(tmp_path / "gray_sigma.exr")[0]
    above = result.gray.values
    # In the middle both lamps light alike, towards a side the nearer one more: between 1/sqrt(2) and 1.
    share = sigma / (0.1 * above)
    assert share[3, 4] == pytest.approx(1 / math.sqrt(2), rel=1e-2)
    assert "gray_sigma.exr" in result.manifest["files"]
    assert result.manifest["uncertainty"]["parts_rms_gray"].keys() == {"rays", "each_source_radiance"}
    radwrap.render(sheet(None), tmp_path, method="pinhole")
    assert not (tmp_path / "gray_sigma.exr").exists()


def test_frames_of_a_run_without_a_manifest_go(tmp_path: Path) -> None:
    (tmp_path / "frame_0007.png").write_bytes(b"of a run that was killed")
    radwrap.render(sheet(None), tmp_path, method="pinhole")
    assert not list(tmp_path.glob("frame_*"))


def test_a_run_with_a_lens_tells_what_its_opening_is_not_sure_of(tmp_path: Path) -> None:
    """The sheet in the plane of focus: more light of a wider opening, and no blur."""
    scene = sheet({"aperture_diameter": "10 um"}, lens=True)
    result = radwrap.render(scene, tmp_path, method="rays", tolerance=20.0)
    part = result.manifest["uncertainty"]["parts_rms_gray"]["aperture_diameter"]
    above = float(np.sqrt(np.mean((result.gray.values - scene.camera.sensor.dark_gray) ** 2)))
    diameter = scene.camera.aperture.diameter
    assert part == pytest.approx(2 * 10e-6 / HALF / diameter * above, rel=0.01)


def test_noise_alone_is_enough(tmp_path: Path) -> None:
    table = TABLE | {"rows": 6, "columns": 8}
    radwrap.render(sheet(None, table), tmp_path, method="pinhole")
    assert (
        read_image(tmp_path / "gray_sigma.exr")[0].min()
        >= math.sqrt(transfer_variance(0, gain=0.25, read_noise=8)) * 0.999
    )


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "percent": ({"source_radiance": "5 %"}, r"tolerances\.source_radiance: must be a number"),
    "above 1": ({"sensor_gain": 1.5}, r"tolerances\.sensor_gain: must be at most 1"),
    "no unit": ({"aperture_diameter": 0.001}, r"tolerances\.aperture_diameter: 0.001 has no unit"),
    "negative": ({"exposure_time": "-1 ms"}, r"tolerances\.exposure_time: must be at least 0"),
    "unknown": ({"radiance": 0.1}, r"tolerances\.radiance: unknown key"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_tolerances_are_one_clear_error(name: str) -> None:
    table, message = BAD[name]
    with pytest.raises(radwrap.InputError, match=message):
        sheet(table)


def test_where_nothing_is_seen_the_whole_image_tells_how_light_is_shared() -> None:
    """Two equal shares, none, and one share alone; 3 and 1 parts of the whole have sqrt(3^2 + 1^2)/4."""
    spread = spread_of([np.array([1.0, 0.0, 2.0]), np.array([1.0, 0.0, 0.0])])
    assert spread == pytest.approx([math.sqrt(0.5), math.sqrt(10) / 4, 1.0])
    assert spread_of([np.zeros(1), np.zeros(1)]) == 1.0


def test_rays_err_where_gray_levels_change_between_any_two_of_nine_neighbours() -> None:
    """Pixel by pixel, as the docstring says it; at the frame there are fewer neighbours."""
    signal = np.random.default_rng(3).random((5, 7))
    change = np.zeros_like(signal)
    for row, column in np.ndindex(signal.shape):
        around = signal[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
        change[row, column] = np.ptp(around) ** 2
    share = _EVEN_SHARE * signal**2 / np.mean(signal**2) + (1 - _EVEN_SHARE) * change / change.mean()
    assert np.allclose(_where_rays_err(signal), share, rtol=1e-12, atol=0)


def test_sigma_is_at_most_a_root_of_two_too_small_wherever_the_rays_err() -> None:
    """All at an edge, or all over by the light: nothing says which, so neither is left without its half."""
    signal = np.full((40, 40), 100.0)
    signal[:, 20:] = 150.0
    laid = _where_rays_err(signal)
    change = np.zeros_like(signal)
    change[:, 19:21] = 1.0
    for truth in (signal**2 / np.mean(signal**2), change / change.mean()):
        assert np.all(laid >= truth / 2 * (1 - 1e-12))


def test_pixels_that_are_cut_take_no_share_of_the_rays_error() -> None:
    """Three quarters of an image far above saturation: the rest has all of the mean square, half of it by its light."""
    camera = scene_with({**TABLE, "rows": 40, "columns": 40}).camera
    photons = np.full((40, 40), 1e6)
    photons[:20, :20] = 3000.0
    found = uncertainty(ExposureImage(photons / MU_P_OF_H), camera, Tolerances(), 0.4)
    still = uncertainty(ExposureImage(photons / MU_P_OF_H), camera, Tolerances(), 0.0)
    rays = found.sigma**2 - still.sigma**2
    assert rays[:19, :19] == pytest.approx(0.4**2 * 4 / 2)
    assert np.all(rays[22:] < 1e-9)
    assert rays.mean() == pytest.approx(0.4**2)


def _of_corner(x: float, y: float) -> float:
    """Irradiance over radiance by a rectangle of x times y distances, straight over the point, a corner above it."""
    a, b = math.hypot(1.0, x), math.hypot(1.0, y)
    return (x / a * math.atan(y / a) + y / b * math.atan(x / b)) / 2


def _of_rectangle(edges: Sequence[float], x: float, y: float) -> float:
    """The same of a rectangle 0.3 m above, by its edges."""
    left, right, low, high = ((edge - at) / 0.3 for edge, at in zip(edges, (x, x, y, y), strict=True))
    return _of_corner(right, high) - _of_corner(left, high) - _of_corner(right, low) + _of_corner(left, low)


@pytest.mark.long
def test_in_a_half_shadow_under_a_wide_light_the_interval_holds() -> None:
    """A strip hides a part of the light from each point, by closed forms; where that changes little, rays err no less.

    Of independent errors 95 % would hold; those of neighbours hang together, so that one image holds 85 % at least.
    """
    light, strip, ratio, far, size = (0.02, 0.12, -0.03, 0.05), (0.009, 0.019, -0.011, 0.019), 0.3 / 0.09, 0.4, 24

    def irradiance(x: float, y: float) -> float:
        shadow = [at + (edge - at) * ratio for at, edge in zip((x, x, y, y), strip, strict=True)]
        hidden = [
            max(shadow[0], light[0]),
            min(shadow[1], light[1]),
            max(shadow[2], light[2]),
            min(shadow[3], light[3]),
        ]
        return _of_rectangle(light, x, y) - _of_rectangle(hidden, x, y)

    pitch, focal, opening, gain = 40e-6, 0.02, 0.01e-3, 8e10
    seen = ((np.arange(4 * size) + 0.5) / 4 - size / 2) * pitch * far / focal  # four places in a pixel each way
    x, y = np.meshgrid(seen, -seen)
    cosine = far / np.sqrt(x**2 + y**2 + far**2)
    truth = np.vectorize(irradiance)(x, y) * 100 * 0.5 / math.pi
    truth *= cosine**4 * 0.01 * math.pi / 4 * opening**2 / focal**2 * gain
    truth = truth.reshape(size, 4, size, 4).mean(axis=(1, 3))
    scene = radwrap.scene_from_document(
        {
            "camera": {
                "position": ["0 mm", "0 mm", "400 mm"],
                "look_at": ["0 mm", "0 mm", "0 mm"],
                "up": [0, 1, 0],
                "focal_length": "20 mm",
                "exposure_time": "10 ms",
                "diffraction": "off",
                "aperture": {"diameter": "0.01 mm"},
                "sensor": {
                    "rows": size,
                    "columns": size,
                    "pixel_width": "40 um",
                    "pixel_height": "40 um",
                    "gain": f"{gain} (J/m^2)^-1",
                    "gamma": 1.0,
                    "dark_gray": 0.0,
                    "saturation_gray": 255.0,
                    "rounding": False,
                },
            },
            "sources": [
                {
                    "type": "rectangle",
                    "name": "panel",
                    "position": ["70 mm", "10 mm", "300 mm"],
                    "look_at": ["70 mm", "10 mm", "0 mm"],
                    "up": [0, 1, 0],
                    "size": ["100 mm", "80 mm"],
                    "radiance": "100 W/m^2/sr",
                }
            ],
            "materials": {
                "gray": {"type": "lambertian", "reflectance": 0.5},
                "black": {"type": "lambertian", "reflectance": 0.0},
            },
            "targets": [
                {"type": "sheet", "name": "field", "size": ["40 mm", "40 mm"], "material": "gray"},
                {
                    "type": "sheet",
                    "name": "strip",
                    "position": ["14 mm", "4 mm", "90 mm"],
                    "size": ["10 mm", "30 mm"],
                    "material": "black",
                },
            ],
        }
    )
    result = radwrap.render(scene, tolerance=1.0)
    assert truth.min() > 40 and truth.max() < 240  # nothing is cut
    held = np.abs(result.gray.values - truth) <= result.sigma / 0.5102134569
    assert held.mean() >= 0.85
