"""How well a camera would be calibrated: planned views, and what a detector's noise leaves of the camera."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.calibrate.several_views import calibrate_views
from radwrap.calibrate.views import CalibrationView
from radwrap.errors import InputError
from radwrap.imaging.pattern_truth import true_points
from radwrap.imaging.response.sensor import gray_levels
from radwrap.measure.targets import chessboard_corners
from radwrap.scene.scene import Scene
from radwrap.scene.targets import PatternTarget
from radwrap.study.design import read_design
from radwrap.study.image_error import blur_radii, error_fields, image_error
from radwrap.study.planned_views import planned_views
from radwrap.study.responses import Response, answer, check_response
from radwrap.study.runs import check_design
from radwrap.study.seen import Seen

BOARD = Path(__file__).resolve().parents[2] / "rad_scenes" / "targets" / "chessboard.toml"
SMALL = {
    "camera.diffraction": "off",
    "camera.sensor.rows": 96,
    "camera.sensor.columns": 120,
    "camera.sensor.pixel_width": "36.8 um",
    "camera.sensor.pixel_height": "36.8 um",
}


@pytest.fixture(scope="module")
def scene() -> Scene:
    return radwrap.load_scene(BOARD, SMALL)


@pytest.fixture(scope="module")
def seen(scene: Scene) -> Seen:
    result = radwrap.render(scene, tolerance=4, tracer="compiled")
    gray = gray_levels(result.radiant_exposure.values, scene.camera.sensor)
    radii = blur_radii(scene)
    return Seen(scene, result.gray, gray, image_error(gray, 1.0, radii), error_fields(gray.shape, radii, 0))


def board_of(scene: Scene) -> PatternTarget:
    (target,) = scene.targets
    assert isinstance(target, PatternTarget)
    return target


def asked(scene: Scene, seen: Seen | None, kind: str, **options: Any) -> float:
    """The answer; without an image where the noise is given."""
    nothing = np.zeros((2, 2))
    found = seen or Seen(scene, None, nothing, image_error(nothing, 0.0, (1.0, 1.0)), None)  # type: ignore[arg-type]
    return answer(Response("r", kind, options=options), found).value


@pytest.mark.parametrize("tilt", [0.0, 0.5, 1.0])
def test_views_are_so_tilted_so_far_away_and_whole(scene: Scene, tilt: float) -> None:
    """The plane's normal by a homography of exact points (Zhang's way): it knows nothing of how views were planned."""
    camera = scene.camera
    views = planned_views(camera, board_of(scene), 7, tilt)
    f = camera.image_distance / camera.sensor.pixel_width
    seen_at = set()
    for view in views:
        assert (view.image > -0.5).all()
        assert (view.image < (119.5, 95.5)).all()
        x, y, _ = view.points.T
        u, v = ((view.image - camera.principal_point) / f).T
        nothing, one = np.zeros_like(x), np.ones_like(x)
        rows = np.concatenate(
            [
                np.column_stack([x, y, one, nothing, nothing, nothing, -u * x, -u * y, -u]),
                np.column_stack([nothing, nothing, nothing, x, y, one, -v * x, -v * y, -v]),
            ]
        )
        h = np.linalg.svd(rows)[2][-1].reshape(3, 3)
        h /= np.linalg.norm(h[:, 0]) * np.sign(h[2, 2])
        normal = np.cross(h[:, 0], h[:, 1])
        assert math.acos(min(abs(normal[2]), 1.0)) == pytest.approx(tilt, abs=1e-6)
        assert np.linalg.norm(h[:, 2]) == pytest.approx(0.3, rel=1e-9)
        seen_at.add(tuple(view.image[0].round(3).tolist()))
    assert len(seen_at) == len(views)


def test_a_target_that_does_not_fit_is_refused(scene: Scene) -> None:
    with pytest.raises(InputError, match="does not fit into the image"):
        planned_views(replace(scene.camera, focal_length=0.05), board_of(scene), 3, 0.2)


@pytest.mark.parametrize("kind", ["projection_sigma", "focal_length_sigma"])
def test_noise_counts_in_proportion_and_more_views_help_as_a_mean_does(scene: Scene, kind: str) -> None:
    few = asked(scene, None, kind, views=8, tilt="40 deg", noise="0.1 px")
    assert asked(scene, None, kind, views=8, tilt="40 deg", noise="0.3 px") == pytest.approx(3 * few)
    many = asked(scene, None, kind, views=72, tilt="40 deg", noise="0.1 px")
    assert few / 4.5 < many < few / 2.2  # a mean of nine times as many: a third; eight views are not all of a kind


def test_head_on_views_hardly_tell_the_focal_length(scene: Scene) -> None:
    """As mrcal finds: its distance makes up for it."""
    flat, tilted = (
        asked(scene, None, "focal_length_sigma", views=12, tilt=tilt, noise="0.1 px") for tilt in ("4 deg", "40 deg")
    )
    assert flat > 5 * tilted


def test_the_standard_error_is_that_of_many_calibrations(scene: Scene) -> None:
    told = asked(scene, None, "focal_length_sigma", views=6, tilt="35 deg", noise="0.02 px")
    random, found = np.random.default_rng(5), []
    views = planned_views(scene.camera, board_of(scene), 6, math.radians(35))
    for _ in range(40):
        noisy = [
            CalibrationView(view.points, view.image + 0.02 * random.standard_normal(view.image.shape), view.name)
            for view in views
        ]
        found.append(calibrate_views(noisy, (120, 96)).camera_matrix[0, 0] * scene.camera.sensor.pixel_width)
    assert np.std(found, ddof=1) == pytest.approx(told, rel=0.35)  # three standard errors of a spread of 40


def test_what_a_detector_misses_is_what_is_left(scene: Scene, seen: Seen) -> None:
    target, camera = board_of(scene), scene.camera
    corners = chessboard_corners(seen.image, 7, 10, "refined")
    truth = true_points(camera, target, [place for *_, place in target.layout.corners()])  # type: ignore[union-attr]
    rms = math.sqrt(float(((corners - truth.image) ** 2).sum(axis=1).mean()))
    assert 0 < rms < 0.2
    assert asked(scene, seen, "point_error") == pytest.approx(rms)
    plan = {"views": 6, "tilt": "30 deg"}
    by_noise = asked(scene, None, "projection_sigma", noise=f"{rms / math.sqrt(2)!r} px", **plan)
    assert asked(scene, seen, "projection_sigma", **plan) == pytest.approx(by_noise)
    assert asked(scene, seen, "projection_sigma", detector="corners", **plan) != pytest.approx(by_noise, rel=1e-3)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"views": 2}, "from 3 to 500"),
        ({"views": 3.5}, "whole number"),
        ({"tilt": "30"}, "has no unit"),
        ({"tilt": "85 deg"}, "from 0 to 80 deg"),
        ({"tilt": "0 deg"}, "do not separate"),
        ({"noise": "0 px"}, "above 0 px"),
        ({"noise": "1 px", "detector": "sb"}, "exclude each other"),
        ({"at": "-1 m"}, "above 0 m"),
        ({"target": "nobody"}, 'no "nobody"'),
        ({"detector": "charuco"}, "does not look for"),
    ],
)
def test_what_cannot_be_planned_is_refused(scene: Scene, options: dict[str, Any], told: str) -> None:
    with pytest.raises(InputError, match=told):
        check_response(Response("r", "projection_sigma", options=options), scene, "design.toml: responses.r")


def test_levels_of_options_are_held_against_the_scene(tmp_path: Path) -> None:
    """Before the first ray: a level that cannot be planned would else cost each of its runs."""
    design = tmp_path / "design.toml"
    design.write_text(
        f'title = "x"\nscene = "{BOARD}"\nanalysis = "none"\n[design]\nkind = "full"\n'
        '[factors.t]\nkey = "responses.p.tilt"\nlevels = ["20 deg", "85 deg"]\n'
        '[responses.p]\nmeasure = "projection_sigma"\nnoise = "0.1 px"\n'
    )
    with pytest.raises(InputError, match="tilt must be") as told:
        check_design(read_design(design), {})
    assert "factors.t, level 85 deg" in told.value.where
