"""The trade: errors against a noisy truth, the paper's method in memory, the front, and one sentence."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Final

import numpy as np
import pytest

from radwrap.errors import InputError
from radwrap.imaging.optics.aperture import sub_viewpoints
from radwrap.imaging.optics.view import PixelPlan
from radwrap.imaging.synthesis import render
from radwrap.imaging.tolerance.certificate import PixelSample
from radwrap.imaging.tracing import traced_scene
from radwrap.process import Programs
from radwrap.scene.file.load import load_scene
from radwrap.study.paper_method import summed_viewpoints
from radwrap.study.reference import (
    Distance,
    Reference,
    distance,
    reference_as_json,
    reference_from_json,
    take_reference,
)
from radwrap.study.trade_report import pareto_front, recommendation
from radwrap.study.trade_rows import Family, Row, Setting, TradeOptions
from tests.cli.conftest import write_scene

FLOAT32: Final = 2e-6  # the tracer answers in float32, files hold it, and sums are of a few dozen of them


def _noisy_reference(noise: float, pixels: int = 4000) -> Reference:
    """A truth of gray 100, two noisy values of it, in two strata that stand for 10 % and 90 % of the image."""
    random = np.random.default_rng(3)
    stratum = np.repeat([0, 1], pixels // 2)
    first, second = 100 + noise * random.standard_normal((2, pixels))
    return Reference(PixelSample(np.arange(pixels), stratum, np.array([0.1, 0.9])), first, second, 0, seed=0)


def test_the_noise_of_the_reference_is_no_error_of_the_image() -> None:
    """With noise one and a half times the error: without its removal the rms would be 0.36."""
    reference = _noisy_reference(0.3)
    off = np.full(4000, 100.2)
    found = distance(reference, off)
    # The product's standard deviation is 0.124, its mean over strata of 2000 pixels good to 0.0025: five of these.
    assert found.rms_gray**2 == pytest.approx(0.04, abs=0.0125)
    assert found.rms_gray < found.rms_gray_upper < 0.25
    # Of the mean of both: sigma/sqrt(2); with these weights good to 1.4 %.
    assert reference.rms_gray == pytest.approx(0.3 / np.sqrt(2), rel=0.06)


def test_strata_count_by_their_share_of_the_image() -> None:
    """A tenth of the image is off by 3 gray, the rest by 1; half of the sample lies in that tenth."""
    reference = _noisy_reference(0.0)
    gray = np.where(reference.sample.stratum == 0, 103.0, 99.0)
    found = distance(reference, gray)
    assert found.rms_gray == pytest.approx(np.sqrt(0.1 * 9 + 0.9 * 1), rel=1e-12)
    assert found.p99_gray == found.max_gray == pytest.approx(3.0, rel=1e-12)
    few = np.where(np.arange(4000) < 100, 103.0, 99.0)  # half a per cent of the image
    assert distance(reference, few).p99_gray == pytest.approx(1.0, rel=1e-12)
    assert distance(reference, few).max_gray == pytest.approx(3.0, rel=1e-12)


def test_a_reference_comes_back_from_json_to_the_last_bit() -> None:
    reference = _noisy_reference(0.7, pixels=200)
    again = reference_from_json(json.loads(json.dumps(reference_as_json(reference))))
    gray = np.linspace(98, 102, 200)
    assert distance(again, gray) == distance(reference, gray)
    assert (again.rms_gray, again.rays, again.seed) == (reference.rms_gray, 0, 0)


@pytest.mark.parametrize(("pixels", "rays", "option"), [(2, 64, "pixels"), (100, 2, "rays")])
def test_a_reference_of_nearly_nothing_is_refused(pixels: int, rays: int, option: str) -> None:
    with pytest.raises(InputError, match=f"reference_{option}: must lie between"):
        TradeOptions(reference_pixels=pixels, reference_rays=rays)


@pytest.mark.long
def test_the_reference_finds_what_viewpoints_lack(tmp_path: Path) -> None:
    """Sub-viewpoints come nearer to it as they grow in number, and two references with other rays agree."""
    scene = load_scene(write_scene(tmp_path))
    with traced_scene(scene) as view, Programs() as programs:
        references = [take_reference(view, pixels=480, rays=256, seed=seed) for seed in (1, 2)]
        assert references[0].rays == 2 * 256 * 480
        found = []
        for number in (1, 7, 61):
            points = sub_viewpoints(scene.camera.aperture, number)
            radiance = summed_viewpoints(view, points, PixelPlan(), programs)
            sensor = scene.camera.sensor
            exposure = radiance[references[0].sample.pixels] * view.exposure_of_radiance
            gray = np.minimum(sensor.gain * exposure**sensor.gamma + sensor.dark_gray, sensor.saturation_gray)
            found.append([distance(reference, gray).rms_gray for reference in references])
    one, seven, many = found
    assert min(one) > 2 * max(seven) > 4 * max(many) > 0
    # All pixels are in both: they differ by noise alone, which the product leaves to second order.
    assert one[0] == pytest.approx(one[1], rel=0.03)
    assert seven[0] == pytest.approx(seven[1], rel=0.1)


def test_viewpoints_in_memory_are_those_of_the_files(tmp_path: Path) -> None:
    """The same image as `render` makes through its files; any number of workers and any pixels give the same bits."""
    scene = load_scene(write_scene(tmp_path))
    points = sub_viewpoints(scene.camera.aperture, 7, "sunflower")
    plan = PixelPlan(samples=2)
    filed = render(scene, viewpoints=7, layout="sunflower", pixel_samples=2).radiant_exposure.values
    with traced_scene(scene) as view, Programs() as programs:
        counted: list[int] = []
        radiance = summed_viewpoints(view, points, plan, programs, progress=counted.append)
        some = np.array([3, 77, 400])
        part = summed_viewpoints(view, points, plan, programs, pixels=some)
    assert sum(counted) == 7 * 4 * scene.camera.sensor.pixels
    ours = (radiance * view.exposure_of_radiance).reshape(filed.shape)
    np.testing.assert_allclose(ours, filed, rtol=FLOAT32, atol=FLOAT32 * filed.max())
    np.testing.assert_array_equal(part, radiance[some])


def _row(
    method: Family,
    rms: float,
    wall: float,
    number: int | None = None,
    *,
    tolerance: float | None = None,
    upper: float | None = None,
    met: bool | None = None,
) -> Row:
    layout = "rings" if number else None
    setting = Setting(method, number, layout, tolerance=tolerance)
    return Row(setting, 1000, met, None, Distance(rms, rms if upper is None else upper, rms, rms), wall, wall)


def test_the_front_holds_what_nothing_beats() -> None:
    pinhole, slow, good = _row("pinhole", 17.0, 0.1), _row("viewpoints", 1.0, 3.0, 37), _row("kernel", 0.3, 1.0)
    finest, slower_twin = _row("kernel", 0.1, 4.0), _row("rays", 0.1, 5.0)
    assert pareto_front([slow, slower_twin, finest, good, pinhole]) == (pinhole, good, finest)
    assert pareto_front([]) == ()


def test_the_sentence_names_the_fastest_that_is_good_enough() -> None:
    pinhole, kernel = _row("pinhole", 17.0, 0.1), _row("kernel", 0.4, 1.0, tolerance=0.5)
    finer, paper = _row("kernel", 0.1, 2.0, tolerance=0.1), _row("viewpoints", 0.45, 8.0, 127)
    text = recommendation([pinhole, finer, kernel, paper], 0.5)
    assert "use `--method kernel --tolerance 0.5`: 0.4 gray (below 0.4 by 97.5 %) in 1 s" in text
    assert "`--method viewpoints --viewpoints 127 --layout rings`, took 8 times as long" in text
    assert "did not reach it" in recommendation([pinhole, kernel, _row("viewpoints", 1.2, 3.0, 37)], 0.5)
    assert recommendation([pinhole, kernel], 0.5).endswith("in 1 s.")  # nobody tried them
    assert "use `--method viewpoints" in recommendation([pinhole, paper], 0.5)
    lucky, unmet = _row("kernel", 0.0, 0.3, tolerance=2.0, upper=1.4), _row("rays", 0.4, 0.2, tolerance=0.5, met=False)
    assert recommendation([pinhole, lucky, unmet, kernel], 0.5) == recommendation([pinhole, kernel], 0.5)
    assert pareto_front([lucky, kernel]) == (lucky, kernel)
    none = recommendation([pinhole, _row("viewpoints", 1.2, 3.0, 37)], 0.5)
    assert none.startswith("No setting") and "--viewpoints 37" in none
    for sentence in (text, none, recommendation([], 0.5)):
        assert sentence.endswith(".") and sentence.count(". ") == 0


def test_options_are_those_of_render_and_names_are_files() -> None:
    setting = Setting("viewpoints", 19, "rings", 2, "jitter")
    assert (
        setting.options
        == "--method viewpoints --viewpoints 19 --layout rings --pixel-samples 2 --pixel-sampling jitter"
    )
    assert setting.name == "viewpoints-19_layout-rings_pixel-samples-2_pixel-sampling-jitter"
    assert Setting("kernel", tolerance=0.5).name == "kernel_tolerance-0.5"
    assert Setting("pinhole").name == "pinhole"
