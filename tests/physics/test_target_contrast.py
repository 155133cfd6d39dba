"""A star's contrast in focus is the transfer of a pixel; USAF bars are their shares of pixels, in closed form."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.scene.look.geometry import directions
from radwrap.scene.patterns.layouts import Usaf1951
from radwrap.scene.targets import PatternTarget

TARGETS = Path(__file__).parents[2] / "rad_scenes" / "targets"
TOLERANCE = 1.0  # gray level rms of renders, of 170 from ink to paper
STAR = 0.01  # of the contrast: that tolerance over the first harmonic of the step, 2/pi of 161 gray levels
PAPER, INK, DARK = 0.8, 0.04, 4.0

pytestmark = pytest.mark.long  # two renders of 8 s each


def rendered(name: str, **overrides: Any) -> tuple[radwrap.Scene, np.ndarray]:
    """A scene, and its gray levels above the dark one over what paper on the axis would have."""
    changes = {"camera.diffraction": "off", "camera.sensor.rounding": False, **overrides}
    scene = radwrap.load_scene(TARGETS / f"{name}.toml", changes)
    image = radwrap.render(scene, tolerance=TOLERANCE, workers=1)
    camera = scene.camera
    v, u = np.indices(image.gray.values.shape).astype(float)
    rays = directions(camera, np.column_stack([u.ravel(), v.ravel()]))
    fall = (rays @ np.asarray(camera.pose.rotation)[:, 2]).reshape(u.shape) ** 4
    # Even light from all sides: the plate's radiance is its reflectance times that of the tent, 40 W/m^2/sr.
    area = np.pi / 4 * camera.aperture.diameter**2
    exposure = camera.exposure_time * area / camera.image_distance**2 * 40 * PAPER
    return scene, (image.gray.values - DARK) / (4e4 * exposure * fall)


def test_contrast_of_a_star_is_the_transfer_of_the_pixel() -> None:
    scene, share = rendered("siemens_star")
    camera, spokes = scene.camera, 36
    v, u = np.indices(share.shape).astype(float)
    right, up = u - camera.principal_point[0], camera.principal_point[1] - v
    radius, turn = np.hypot(right, up), np.arctan2(up, right)
    # The first harmonic of dark and light spokes, from which sharp ones have 2/pi of the step.
    step = 2 / np.pi * (1 - INK / PAPER)
    for wanted in (14.0, 20.0, 30.0, 45.0, 70.0):
        ring = np.abs(radius - wanted) < 1
        angle = spokes * turn[ring]
        terms = [np.ones_like(angle), -np.sin(angle), np.cos(angle), np.sin(3 * angle), np.cos(3 * angle)]
        (_, along, across, *_), *_ = np.linalg.lstsq(np.column_stack(terms), share[ring], rcond=None)
        waves = spokes / (2 * np.pi * radius[ring])  # a pixel, along the circle
        pixel = np.sinc(waves * np.sin(turn[ring])) * np.sinc(waves * np.cos(turn[ring]))
        assert along / step == pytest.approx(float(pixel.mean()), abs=STAR)
        assert abs(across / step) < STAR


def test_bars_of_usaf_elements_are_their_shares_of_pixels() -> None:
    """In focus: row by row through the middle of upright bars, column by column through level ones."""
    scene, share = rendered("usaf1951")
    (target,) = scene.targets
    assert isinstance(target, PatternTarget)
    camera = scene.camera
    scale = camera.image_distance / 0.3 / camera.sensor.pixel_width  # px a metre
    off = []
    assert isinstance(target.layout, Usaf1951)
    for element in target.layout.elements():
        bar = element.bar_width * scale
        for (x, y), is_upright in ((element.upright, True), (element.level, False)):
            u, v = camera.principal_point[0] + x * scale, camera.principal_point[1] - y * scale
            if 5 * bar < 4:  # shorter than the pixels through its middle
                continue
            along, across = (u, v) if is_upright else (v, u)
            pixels = np.arange(int(along - 2.5 * bar), int(along + 2.5 * bar) + 2)
            line = share[round(across), pixels] if is_upright else share[pixels, round(across)]
            edges = along + bar * np.array([-2.5, -0.5, 1.5])
            dark = sum(
                np.clip(np.minimum(pixels + 0.5, edge + bar) - np.maximum(pixels - 0.5, edge), 0, 1) for edge in edges
            )
            off.append(line - (1 - (1 - INK / PAPER) * dark))
    away = np.concatenate(off)
    assert len(off) == 36 and len(away) > 300
    # Gray levels: the tolerance is of all pixels, most of which have no outline.
    assert np.sqrt((away**2).mean()) * 170 < 2.5
    assert abs(away.mean()) * 170 < TOLERANCE
