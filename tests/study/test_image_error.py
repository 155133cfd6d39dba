"""Error bars of responses: known cases, and the scatter of real renders."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

import radwrap
from radwrap.images import GrayImage
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.tolerance.kept_replicates import KeptReplicates
from radwrap.scene.scene import Scene
from radwrap.study.image_error import blur_radii, copies_of, error_fields, image_error
from radwrap.study.responses import KINDS, Response, answer, contrast
from radwrap.study.seen import Seen
from tests.study.conftest import EDGE


@pytest.fixture(scope="module")
def scene() -> Scene:
    return radwrap.scene_from_document(EDGE)


def test_error_fields_have_variance_one_and_hang_together_over_the_disc() -> None:
    """The autocorrelation of white noise over a disc is the share that two discs overlap: 0 beyond the diameter."""
    fields = error_fields((120, 100), (4.0, 4.0), copies=40).fields
    assert fields.var() == pytest.approx(1, abs=0.05)
    for shift in (2, 4, 9):
        overlap = shift / 8
        expected = 0.0 if overlap >= 1 else (2 / math.pi) * (math.acos(overlap) - overlap * math.sqrt(1 - overlap**2))
        found = float((fields[:, :, shift:] * fields[:, :, :-shift]).mean())
        assert found == pytest.approx(expected, abs=0.05)  # a disc of pixels is not quite round


def test_the_error_lies_where_gray_changes_and_has_the_certified_rms() -> None:
    gray = np.tile(np.concatenate([np.full(20, 30.0), np.linspace(30, 100, 8), np.full(20, 100.0)]), (30, 1))
    error = image_error(gray, 0.7, (2.0, 2.0))
    assert math.sqrt(error.variance.mean()) == pytest.approx(0.7, rel=1e-12)
    assert error.variance[:, :18].max() == 0
    flat = image_error(np.full((10, 10), 50.0), 0.7, (2.0, 2.0))
    assert (flat.variance == 0.7**2).all()


def test_the_mean_gray_is_off_by_no_more_than_the_rms(scene: Scene) -> None:
    """|mean e| <= sqrt(mean e^2) for any error e; equal where it is the same everywhere."""
    gray = np.full((50, 60), 80.0)
    seen = Seen(scene, GrayImage(gray), gray, image_error(gray, 0.4, (1.0, 1.0)), error_fields((50, 60), (1.0, 1.0)))
    found = answer(Response("m", "mean_gray"), seen)
    assert (found.value, found.error) == (80.0, 0.4)


def test_a_linear_response_of_white_errors_has_its_closed_form(scene: Scene) -> None:
    """Position of an edge from errors of one pixel each: each row by e/slope, the mean of n rows by 1/sqrt(n)."""
    columns, slope = np.arange(60), 10.0
    gray = np.tile(np.clip(20 + slope * (columns - 20), 20, 220.0), (50, 1))
    error = image_error(gray, 0.5, (0.5, 0.5))
    fields = error_fields((50, 60), (0.5, 0.5), copies=400)

    def place(image: GrayImage) -> float:
        return 40 - float((image.values - 20).sum()) / slope / 20 / 50  # any linear function of the gray levels

    copies = copies_of(gray, error, fields, scene.camera.sensor)
    changes = [place(copy.image) - place(GrayImage(gray)) for copy in copies]
    expected = 0.5 * math.sqrt(50 * 60) / slope / 20 / 50
    # 400 draws: 3.5 %; a little is clipped where errors push below dark.
    assert np.std(changes) == pytest.approx(expected, rel=0.12)


def test_the_bar_of_a_percentile_sees_what_the_cells_took_from_it(scene: Scene) -> None:
    """The brightest twentieth was made darker than the rest: made darker still, it changes no percentile."""
    true = np.full(3000, 4e-4)  # [J m^-2]
    true[:300], true[-150:] = 1e-4, 6e-4
    found = np.where(true > 5e-4, 3e-4, true)
    exposure, change = found.reshape(50, 60), (found - true).reshape(50, 60)
    kept = KeptReplicates(np.stack([exposure] * 3), change)
    sensor, flat = scene.camera.sensor, error_fields((50, 60), (1.0, 1.0), copies=0)
    gray, right = gray_levels(exposure, sensor), gray_levels(true.reshape(50, 60), sensor)
    seen = Seen(scene, GrayImage(gray), gray, image_error(gray, 0.0, (1.0, 1.0)), flat, kept, exposure)
    off = abs(contrast(GrayImage(right)) - contrast(GrayImage(gray)))
    assert off > 0.05 and answer(Response("c", "contrast"), seen).error == pytest.approx(off, rel=1e-9)


@pytest.mark.long
def test_stated_errors_are_as_large_as_the_scatter_of_renders(scene: Scene) -> None:
    """Renders with seeds of their own: the scatter of the edge's place against what each image says of itself.

    The scatter of six is known to 32 %. The bound is above the error, so that more may be stated than is seen.
    """
    values, stated = [], []
    for seed in range(6):
        made = radwrap.render(scene, seed=seed, workers=1)
        gray = gray_levels(made.radiant_exposure.values, scene.camera.sensor)
        radii = blur_radii(scene)
        error = image_error(gray, made.manifest["error"]["rms_gray_upper95"], radii)
        seen = Seen(scene, made.gray, gray, error, error_fields(gray.shape, radii))
        with threadpool_limits(1):
            found = answer(Response("u", "edge_position", "px", {"dark": "sensor", "gamma": "sensor"}), seen)
        values.append(found.value)
        stated.append(found.error)
    assert 0.5 * _scatter(values) < _rms(stated) < 4 * _scatter(values)


def _scatter(values: Sequence[float]) -> float:
    return float(np.std(values, ddof=1))


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def test_every_response_is_documented() -> None:
    assert all(kind.what for kind in KINDS.values())
