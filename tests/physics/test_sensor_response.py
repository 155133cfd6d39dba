"""Eq. 5, G = K H^gamma + G0, with saturation, rounding and bit depth, and the way back."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio  # noqa: N813  (its own short name)
import pytest

import radwrap
from radwrap.images import ExposureImage
from radwrap.imaging.response.sensor import (
    GrayWhereAsked,
    gray_image,
    gray_levels,
    radiant_exposure_of,
    unclipped_gray,
    with_gamma,
)
from radwrap.scene.camera import Sensor
from radwrap.validate.closed_forms.sensor import power_law

OFF_SATURATION = 1e-12  # asked for by the validation plan

FIVS = Sensor(1, 1, 13.75e-6, 16e-6, gain=3.38e4, gamma=0.85, dark_gray=22.0, saturation_gray=181.0)


def linear(**changes: Any) -> Sensor:
    """G = 1000 H, 12 bits, not rounded."""
    plain = Sensor(1, 1, 1e-5, 1e-5, 1000.0, 1.0, 0.0, 4095.0, bit_depth=12, rounding=False)
    return replace(plain, **changes)


@pytest.mark.parametrize("gamma", [0.1, 0.45, 0.5, 0.85, 0.9, 1.0, 1.8, 2.2, 3.0])
@pytest.mark.parametrize("dark", [0.0, 22.0])
def test_eq5_and_its_inverse(gamma: float, dark: float) -> None:
    exposures = [1e-12, 1.83e-3, 0.017, 0.5, 1.0, 2.0]
    sensor = linear(gamma=gamma, gain=400.0, dark_gray=dark)
    gray = gray_levels(np.array(exposures), sensor)
    expected = [power_law(exposure, gain=400.0, gamma=gamma, dark_gray=dark) for exposure in exposures]
    assert gray == pytest.approx(np.array(expected), rel=OFF_SATURATION)
    # A level close above dark has lost digits of H to the sum: 2^-53 G/(G - G0)/gamma of it.
    kept = (gray - dark) * gamma / gray > 1e-3
    back = radiant_exposure_of(gray[kept], sensor)
    assert back == pytest.approx(np.array(exposures)[kept], rel=OFF_SATURATION)
    assert kept.any()


def test_another_gamma_keeps_one_gray_level() -> None:
    changed = with_gamma(FIVS, 0.9, 5e-4)
    assert changed == replace(FIVS, gamma=0.9, gain=changed.gain)
    # K' H^.9 = K H^.85 at H = 5e-4 and, by the ratio H^.05, twice the exposure gives 2^.05 more above dark.
    signal = gray_levels(np.array([5e-4, 1e-3]), FIVS) - 22
    assert gray_levels(np.array([5e-4, 1e-3]), changed) - 22 == pytest.approx(signal * [1, 2**0.05], rel=OFF_SATURATION)
    for wrong in ((0.0, 1.0), (0.9, 0.0), (math.nan, 1.0)):
        with pytest.raises(ValueError, match="above 0"):
            with_gamma(FIVS, *wrong)


@pytest.mark.parametrize(
    ("gamma", "exposure", "gray"),
    [(0.1, 1e-10, 100.0), (0.5, 0.04, 200.0), (1.0, 0.3, 300.0), (2.0, 0.5, 250.0), (3.0, 1.5, 3375.0)],
)
def test_powers_by_heart(gamma: float, exposure: float, gray: float) -> None:
    sensor = linear(gamma=gamma)
    assert gray_levels(np.array([exposure]), sensor)[0] == pytest.approx(gray, rel=OFF_SATURATION)
    assert radiant_exposure_of(np.array([gray]), sensor)[0] == pytest.approx(exposure, rel=OFF_SATURATION)


def test_sensor_of_the_paper_saturates_where_the_errata_say() -> None:
    """Reading notes, Eq. 6: H = 1.83e-3 J/m^2."""
    full = ((181 - 22) / 3.38e4) ** (1 / 0.85)
    assert full == pytest.approx(1.83e-3, abs=5e-6)
    below, above = gray_levels(np.array([0.999 * full, 1.001 * full]), FIVS)
    assert below == pytest.approx(181 - 0.001 * 0.85 * 159, abs=1e-3)
    assert above == 181.0


def test_no_light_is_dark() -> None:
    assert gray_levels(np.zeros(3), FIVS).tolist() == [22.0] * 3
    assert radiant_exposure_of(np.array([22.0]), FIVS).tolist() == [0.0]


@pytest.mark.parametrize("gamma", [0.45, 1.0, 2.2])
def test_estimates_below_no_light_have_their_noise(gamma: float) -> None:
    """They lie as far below dark as their opposites lie above it, and are numbers, whatever gamma is."""
    sensor, exposures = linear(gamma=gamma, dark_gray=22.0), np.array([-2.0, -1e-9, -0.0, 1e-9, 2.0])
    off = unclipped_gray(exposures, sensor) - 22.0
    assert np.isfinite(off).all() and off == pytest.approx(-off[::-1], abs=1e-12) and (np.diff(off) >= 0).all()
    assert exposures.tolist() == [-2.0, -1e-9, -0.0, 1e-9, 2.0]


@pytest.mark.parametrize("gamma", [0.1, 0.85, 3.0])
def test_what_overflows_is_saturated(gamma: float) -> None:
    """Without a warning, which would be an error here."""
    sensor = linear(gain=1e308, gamma=gamma)
    assert unclipped_gray(np.array([1e300]), sensor)[0] == math.inf
    assert gray_levels(np.array([0.0, 1e300]), sensor).tolist() == [0.0, 4095.0]


@pytest.mark.parametrize("level", [21.999, 181.0, 200.0])
def test_no_inverse_below_dark_or_at_saturation(level: float) -> None:
    with pytest.raises(ValueError, match="no radiant exposure"):
        radiant_exposure_of(np.array([100.0, level]), FIVS)


def test_rounding() -> None:
    exposure = ExposureImage(np.array([[0.0124, 0.0126, 0.5, 4.0949, 5.0]]))
    rounded = gray_image(exposure, linear(rounding=True))
    assert rounded.values.tolist() == [[12.0, 13.0, 500.0, 4095.0, 4095.0]]
    plain = gray_image(exposure, linear())
    assert plain.values == pytest.approx(np.array([[12.4, 12.6, 500.0, 4094.9, 4095.0]]), rel=OFF_SATURATION)
    assert plain.codes.tolist() == [[12, 13, 500, 4095, 4095]]


def test_levels_where_asked_are_those_of_the_whole_image_and_leave_it_alone() -> None:
    radiance = np.random.default_rng(1).uniform(0.0, 8.0, (6, 7))
    before = radiance.copy()
    asked = GrayWhereAsked(radiance, 0.0014, FIVS)
    rows, columns = np.array([0, 5, 3]), np.array([6, 0, 2])
    whole = gray_levels(radiance * 0.0014, FIVS)
    assert asked.shape == whole.shape
    assert np.array_equal(asked[rows, columns], whole[rows, columns])
    assert np.array_equal(asked[np.ix_(rows, columns)], whole[np.ix_(rows, columns)])
    assert np.array_equal(radiance, before)
    exposure = radiance * 0.0014
    gray_levels(exposure, FIVS)
    assert np.array_equal(exposure, radiance * 0.0014)


@pytest.mark.parametrize(
    ("bits", "kind"), [(1, np.uint8), (8, np.uint8), (9, np.uint16), (12, np.uint16), (16, np.uint16)]
)
def test_bit_depth(bits: int, kind: type) -> None:
    top = 2**bits - 1
    image = gray_image(
        ExposureImage(np.array([[0.0, 0.5, 1.0, 9.0]])), linear(gain=float(top), saturation_gray=top, bit_depth=bits)
    )
    assert image.codes.dtype == kind
    assert image.codes[0, 0] == 0
    assert image.codes[0, 2:].tolist() == [top, top]


def stored(path: Path) -> np.ndarray:
    source = oiio.ImageInput.open(str(path))
    pixels = source.read_image(source.spec().format)
    source.close()
    return np.asarray(pixels)[:, :, 0]


@pytest.mark.parametrize("rounding", [True, False])
@pytest.mark.parametrize(
    "response",
    [(8, 181.0, 3.38e4, 0.85), (8, 255.0, 6e2, 0.1), (12, 4000.0, 1e13, 3.0), (16, 65535.0, 1.2e8, 1.0)],
)
def test_gray_file_is_eq5_of_the_exposure_file(
    bench: Any, tmp_path: Path, rounding: bool, response: tuple[int, float, float, float]
) -> None:
    """Exactly, pixel by pixel; a part of the picture is saturated, a part is not."""
    bits, saturation, gain, gamma = response
    camera = bench.camera(rows=12, columns=20, pitch=(2e-5, 2e-5), focal_length=0.0125)
    camera["sensor"] |= {"gain": f"{gain!r} (J/m^2)^-{gamma!r}", "gamma": gamma, "dark_gray": 22}
    camera["sensor"] |= {"saturation_gray": saturation, "bit_depth": bits, "rounding": rounding}
    lamp = {
        "type": "led",
        "name": "led",
        "position": bench.metres(0.01, 0.0, 0.3),
        "look_at": bench.metres(0.01, 0.0, 0.0),
        "radiant_intensity": "15 W/sr",
        "beam": {"profile": "gaussian", "width": "3 deg", "width_definition": "fwhm"},
    }
    sheet = {"type": "sheet", "material": "white", "size": ["1 m", "1 m"]}
    scene = bench.scene(camera, [lamp], {"white": {"type": "lambertian", "reflectance": 0.8}}, [sheet])
    radwrap.render(scene, tmp_path, method="pinhole")
    exposure = stored(tmp_path / "radiant_exposure.exr").astype(np.float64)
    expected = np.minimum(gain * exposure**gamma + 22, saturation)
    codes = stored(tmp_path / "gray.png")
    assert codes.dtype == (np.uint8 if bits <= 8 else np.uint16)
    assert (codes == np.rint(expected)).all()
    assert (codes == saturation).any()
    assert (codes < saturation).any()
    if not rounding:
        assert stored(tmp_path / "gray.exr") == pytest.approx(expected, rel=6e-8)  # float32: 2^-24
