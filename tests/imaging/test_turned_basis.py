"""A light basis in another camera: exposure and electronics without a ray, the error measured anew."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.imaging.other_camera import SceneText, basis_in_other_camera
from radwrap.imaging.relight.relit import Basis, Relighter, read_basis, relit
from radwrap.imaging.relight.relit_uncertainty import relit_squares, relit_uncertainty
from tests.cli.conftest import SMALL, scene_with

# Files hold float32: sums of a few have some 1e-7 of the peak, of which Eq. 5 makes less.
FLOAT32: Final = 1e-6
SECOND: Final = {**SMALL["sources"][0], "name": "second", "position": ["-60 mm", "-90 mm", "450 mm"]}
DIM: Final = [0.3, 0.2]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[radwrap.Scene, radwrap.Rendered, Basis]:
    out = tmp_path_factory.mktemp("turned")
    scene = radwrap.scene_from_document(scene_with({"sources.1": SECOND}))
    return scene, radwrap.render(scene, out, basis=True, tolerance=2), read_basis(out)


Made = tuple[radwrap.Scene, radwrap.Rendered, Basis]


def turned(made: Made, **changes: Any) -> Basis:
    """The basis with keys of the camera changed; two underscores stand for a dot."""
    keys = {f"camera.{name.replace('__', '.')}": value for name, value in changes.items()}
    return basis_in_other_camera(made[2], SceneText.of(made[0]), keys)


def test_no_change_is_the_basis_itself(made: Made) -> None:
    assert turned(made) is made[2]
    same = turned(made, exposure_time="387 ms")
    assert same.exposure_of_radiance == made[2].exposure_of_radiance and same.camera == made[2].camera


def test_exposure_time_and_all_levels_are_one_knob(made: Made) -> None:
    """H is proportional to both, whatever the certificate is measured by: closed form."""
    (by_levels,) = relit(made[2], [[2 * factor for factor in DIM]])
    (by_time,) = relit(turned(made, exposure_time="774 ms"), [DIM])
    peak = by_levels.radiant_exposure.values.max()
    assert np.abs(by_levels.radiant_exposure.values - by_time.radiant_exposure.values).max() < FLOAT32 * peak
    for name in ("rms_gray", "rms_gray_upper95", "model_rms_gray", "discretisation_rms_gray"):
        assert getattr(by_time.certificate, name) == pytest.approx(getattr(by_levels.certificate, name), rel=1e-9)
    assert by_time.certificate.rms_gray_upper95 > 0


def test_errors_go_with_the_gain_where_nothing_saturates(made: Made) -> None:
    """G = K H^gamma + G0: twice K is twice the error, and another G0 none."""
    (before,) = relit(made[2], [DIM])
    (after,) = relit(turned(made, sensor__gain="1.69e4 (J/m^2)^-0.85", sensor__dark_gray=5), [DIM])
    assert before.saturated_fraction == after.saturated_fraction == 0
    assert after.certificate.rms_gray == pytest.approx(before.certificate.rms_gray / 2, rel=1e-9)
    assert after.gray.values.min() == 5 and np.array_equal(
        after.radiant_exposure.values, before.radiant_exposure.values
    )


def test_what_saturated_before_has_an_error_again(made: Made) -> None:
    """A picture that clips tells nothing above; a basis does, as it keeps radiances."""
    bright = radwrap.scene_from_document(scene_with({"sources.1": SECOND, "camera.exposure_time": "4 s"}))
    clipped = basis_in_other_camera(made[2], SceneText.of(made[0]), {"camera.exposure_time": "4 s"})
    (over,) = relit(clipped, [[1.0, 1.0]])
    assert over.saturated_fraction > 0.1
    changes = {"camera.sensor.saturation_gray": 4095, "camera.sensor.bit_depth": 12}
    (deep,) = relit(basis_in_other_camera(clipped, SceneText.of(bright), changes), [[1.0, 1.0]])
    assert deep.saturated_fraction == 0 and deep.gray.bit_depth == 12
    assert over.certificate.rms_gray_upper95 < deep.certificate.rms_gray_upper95 < np.inf


def test_a_picture_in_another_camera_is_the_same_picture(made: Made) -> None:
    """`with_exposure` scales what a file holds, a basis what that was made of: a code may differ by rounding."""
    (image,) = relit(turned(made, exposure_time="64 ms"), [[1.0, 1.0]])
    picture = made[1].with_exposure("64 ms")
    assert np.abs(image.gray.values - picture.gray.values).max() <= 1
    assert (image.gray.values != picture.gray.values).mean() < 1e-2


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("camera.focal_length", "13 mm", "changes which light a pixel gets"),
        ("camera.sensor.rows", 10, "changes which light a pixel gets"),
        ("camera.aperture.diameter", "1 mm", "changes which light a pixel gets"),
        ("sources[0].radiance", "1 W/m^2/sr", "is not a key of the camera"),
        ("camera.exposure_time", "nan s", "camera.exposure_time"),
        ("camera.sensor.gamma", 2.0, "gain"),
    ],
)
def test_what_needs_rays_is_refused(made: Made, key: str, value: Any, says: str) -> None:
    with pytest.raises(InputError, match=says):
        basis_in_other_camera(made[2], SceneText.of(made[0]), {key: value})


def test_spectra_are_weighed_by_the_sensor(made: Made) -> None:
    text = SceneText(made[0].document, Path(), spectral=True)
    with pytest.raises(InputError, match="may weigh"):
        basis_in_other_camera(made[2], text, {"camera.sensor.dark_gray": 5})


def test_a_relighter_that_stays_gives_the_same_bytes(made: Made) -> None:
    together = list(relit(made[2], [[1.0, 1.0], DIM, [0.0, 3.0]]))
    stays = Relighter(made[2])
    long = turned(made, exposure_time="774 ms")
    elsewhere = stays.in_camera(long)
    (long_anew,) = relit(long, [DIM])
    for _ in range(2):
        for factors, one in (([0.0, 3.0], together[2]), (DIM, together[1])):
            alone = stays.image(factors)
            assert np.array_equal(alone.radiant_exposure.values, one.radiant_exposure.values)
            assert alone.certificate == one.certificate
        assert elsewhere.image(DIM).certificate == long_anew.certificate
    with pytest.raises(ValueError, match="another basis"):
        stays.in_camera(_other_sample(made[2]))


def _other_sample(basis: Basis) -> Basis:
    from dataclasses import replace

    assert basis.sample is not None
    return replace(basis, sample=replace(basis.sample))


def test_every_image_has_a_deviation_at_each_pixel_and_its_parts(made: Made) -> None:
    """Also where the scene states no tolerances: of rays and of rounding, 1/12."""
    (image,) = relit(made[2], [DIM])
    factors = np.array(DIM)
    squares = relit_squares(made[2], factors, image)
    assert set(squares) == {"rays", "rounding"}
    assert squares["rounding"] == pytest.approx(1 / 12)
    sigma = relit_uncertainty(made[2], factors, image).sigma
    assert sigma**2 == pytest.approx(squares["rays"] + squares["rounding"])
    assert np.sqrt(squares["rays"].mean()) == pytest.approx(image.certificate.rms_gray)
