"""Lengths in a calibrated plane, and what the calibration's own errors leave of them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import expit

from radwrap.calibrate.calibrated_plane import plane_from_calibration
from radwrap.calibrate.tsai import as_json, calibrate_camera
from radwrap.errors import InputError
from radwrap.frames import rotation_about_fixed_axes
from radwrap.images import write_png
from tests.cli.conftest import here

Array = NDArray[np.float64]
PIXEL = 10e-6
CENTRE = (319.5, 239.5)
F = 0.0125
AT = (300.0, 260.0)


def board() -> Array:
    """7 x 7 points, 10 mm apart, the world's origin beside them."""
    x, y = np.meshgrid(np.arange(7) * 0.01, np.arange(7) * 0.01)
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(49)])


def seen(points: Array) -> Array:
    """Their images by a camera tilted by 25 and 10 degrees, 0.4 m away."""
    rotation = np.array(rotation_about_fixed_axes((np.radians(205), np.radians(10), 0.02)))
    inside = points @ rotation.T + [-0.03, 0.03, 0.4]
    return np.asarray(F / PIXEL * inside[:, :2] / inside[:, 2:] + CENTRE)


def calibrated(image: Array) -> dict[str, Any]:
    found = calibrate_camera(board(), image, pixel_width=PIXEL, pixel_height=PIXEL, centre=CENTRE)
    told: dict[str, Any] = json.loads(json.dumps(as_json(found)))
    return {**told, "pixel_width": PIXEL, "pixel_height": PIXEL}


def test_places_are_those_of_the_world_and_back() -> None:
    plane = plane_from_calibration(calibrated(seen(board())), "c.json", AT)
    assert plane.to_plane(seen(board())) == pytest.approx(board()[:, :2], abs=1e-9)
    assert plane.to_image(board()[:, :2]) == pytest.approx(seen(board()), abs=1e-5)
    above = plane_from_calibration(calibrated(seen(board())), "c.json", AT, 0.003)
    raised = board() + np.array([0, 0, 0.003])
    assert above.to_plane(seen(raised)) == pytest.approx(raised[:, :2], abs=1e-9)


@pytest.mark.long
def test_the_scales_error_is_that_of_repeated_calibrations() -> None:
    dice = np.random.default_rng(3)
    exact = seen(board())
    ends = np.array([[AT[0] - 5, AT[1]], [AT[0] + 5, AT[1]], [AT[0], AT[1] - 5], [AT[0], AT[1] + 5]])

    def length(plane: Any) -> float:
        left, right, up, down = plane.to_plane(ends)
        return float(np.sqrt(abs(np.linalg.det(np.stack([right - left, down - up])))))

    true = length(plane_from_calibration(calibrated(exact), "c.json", AT))
    z = []
    for _ in range(150):
        plane = plane_from_calibration(calibrated(exact + 0.05 * dice.standard_normal(exact.shape)), "c.json", AT)
        z.append((length(plane) / true - 1) / plane.relative_sigma)
    # Known to sqrt(1/300), 6 %.
    assert np.std(z) == pytest.approx(1, abs=0.2) and abs(np.mean(z)) < 0.3
    told = calibrated(exact + 0.05 * dice.standard_normal(exact.shape))
    plane = plane_from_calibration(told, "c.json", AT)
    # Distance and focal length by themselves are known ten times worse: their errors hang together.
    assert plane.relative_sigma < 0.2 * told["sigma"]["focal_length"] / F


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"covariance": None}, "covariance"),
        ({"covariance": [[0.0] * 11] * 10}, "covariance: is not a square of 11 rows"),
        ({"focal_length": -1.0}, "focal_length"),
        ({"translation": [0.0, 0.0, -0.4]}, "is not a covariance of a plane before the camera"),
    ],
)
def test_what_is_no_calibration_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as refused:
        plane_from_calibration({**calibrated(seen(board())), **change}, "c.json", AT)
    assert message in str(refused.value) and "c.json" in str(refused.value)


def test_a_disc_on_the_board_is_measured_with_the_scales_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = calibrated(seen(board()) + 0.05 * np.random.default_rng(4).standard_normal((49, 2)))
    (tmp_path / "c.json").write_text(json.dumps(told))
    plane = plane_from_calibration(calibrated(seen(board())), "c.json", AT)
    v, u = np.indices((480, 640))
    fine = np.stack([u.ravel(), v.ravel()], axis=1).astype(float)
    away = np.hypot(*(plane.to_plane(fine) - [0.03, 0.03]).T).reshape(480, 640)
    image = tmp_path / "disc.png"
    write_png(image, np.rint(30 + 170 * expit((0.012 - away) / 0.00006)).astype(np.uint8))
    middle = plane.to_image(np.array([[0.03, 0.03]]))[0]
    radius = f"{np.abs(plane.to_image(np.array([[0.042, 0.03]]))[0] - middle).max():.1f}"
    words = ["measure", "circle", image, "--at", *(f"{x:.1f}" for x in middle), "--radius", radius]
    words += ["--calibration", tmp_path / "c.json"]
    found = json.loads(here([*words, "--json"], capsys).success().stdout)
    assert found["outer"]["diameter"] == pytest.approx(24, abs=5 * found["outer"]["diameter_sigma_scale"])
    assert 0.001 < found["outer"]["diameter_sigma_scale"] < 0.05
    assert found["scale_source"] == "the calibration, its errors by their covariance"
    refused = here([*words, "--mm-per-px", "0.3"], capsys)
    assert refused.code == 2 and "--calibration: is given beside another scale" in refused.stderr
    alone = here(["measure", "circle", image, "--at", "5", "5", "--radius", "5", "--height", "1 mm"], capsys)
    assert alone.code == 2 and "give --calibration" in alone.stderr
