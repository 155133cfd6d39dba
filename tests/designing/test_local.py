"""Levels that are searched: against linear programs, and from light that is far too bright."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import NonlinearConstraint, linprog

from radwrap.designing.best_levels import FoundLevels, best_levels
from radwrap.designing.document import read_problem
from radwrap.designing.light import LOCAL, LightAim, levels_of, time_of
from radwrap.designing.local import _excess
from radwrap.study.factors import in_si
from tests.designing.conftest import basis_of, sheet, write_problem

Array = NDArray[np.float64]

TEXT = """
budget = 3
[render]
tolerance = 1
[keys.level]
key = "sources[0].leds[*].radiance_factor"
low = 0.0
high = 3.0
[responses.part]
measure = "region_mean"
region = [2, 2, 9, 9]
[responses.contrast]
measure = "region_contrast"
region = [2, 2, 9, 9]
against = [12, 10, 20, 17]
[[objectives]]
of = "{of}"
aim = "maximise"
[[constraints]]
of = "peak_gray"
at_most = 150
"""
DARK, MOST = 20.0, 3.0


def spots(count: int, peak: float, seed: int) -> Array:
    """Light of LEDs, together so bright [gray level above dark], shape (count, 20, 24)."""
    v, u = np.mgrid[-1:1:20j, -1:1:24j]
    random = np.random.default_rng((seed, count))
    middles, widths = random.uniform(-1.2, 1.2, (count, 2)), random.uniform(0.3, 3, count)
    found = np.stack(
        [np.exp(-((u - a) ** 2 + (v - b) ** 2) / width) for (a, b), width in zip(middles, widths, strict=True)]
    )
    return np.asarray(found * peak / found.sum(axis=0).max())


def found_for(folder: Path, light: Array, text: str) -> FoundLevels:
    scene_tables: dict[str, Any] = sheet()
    scene_tables["sources"][0]["count"] = len(light)
    problem = read_problem(write_problem(folder, text, scene_tables))
    scene = problem.scene(problem.study.document)
    levels = levels_of(problem.levels, problem.study.document, scene, "design.toml")
    time = None if problem.time is None else time_of(problem.time, scene)
    aim = LightAim(levels, problem.objectives[0], problem.constraints, problem.study.responses, time)
    return best_levels(aim, basis_of(light, scene), scene)


def image(light: Array, found: FoundLevels) -> Array:
    return np.asarray(np.tensordot(list(found.factors.values()), light, axes=1))


@pytest.mark.parametrize(
    ("count", "peak"),
    [
        (3, 800.0),
        pytest.param(3, 120.0, marks=pytest.mark.long),
        *(pytest.param(12, one, marks=pytest.mark.long) for one in (20.0, 120.0, 300.0, 800.0)),
    ],
)
def test_a_mean_below_a_peak_is_that_of_a_linear_program(tmp_path: Path, count: int, peak: float) -> None:
    """From the dark, from near the limit, and from where every pixel is full and nothing shows."""
    light = spots(count, peak, 1)
    found = found_for(tmp_path, light, TEXT.format(of="part"))
    flat = light.reshape(count, -1)
    best = linprog(
        -light[:, 2:10, 2:10].mean(axis=(1, 2)), flat.T, np.full(flat.shape[1], 130.0), bounds=[(0, MOST)] * count
    )
    assert found.way == LOCAL
    assert found.value - DARK == pytest.approx(-best.fun, rel=2e-3)
    assert image(light, found).max() <= 130 * (1 + 1e-4)


def test_a_contrast_is_that_of_the_led_that_has_most(tmp_path: Path) -> None:
    """(a - b)/(a + b) of sums of light is largest where only the LED shines whose own is; full pixels do not count."""
    for peak in (60.0, 800.0):
        light = spots(3, peak, 2)
        first, second = light[:, 2:10, 2:10].mean(axis=(1, 2)), light[:, 10:18, 12:21].mean(axis=(1, 2))
        found = found_for(tmp_path, light, TEXT.format(of="contrast"))
        assert found.value == pytest.approx(np.abs((first - second) / (first + second)).max(), abs=2e-3)
        assert math.isfinite(found.value) and image(light, found).max() <= 130 * (1 + 1e-4)
        # A scene leaves a source without light out, with its body.
        assert found.at_low and all(found.levels[path] == pytest.approx(1e-6 * MOST) for path in found.at_low)
    # Without a limit nothing but saturation is in the way, in which the scene stands.
    bare = TEXT.format(of="contrast").partition("[[constraints]]")[0]
    found = found_for(tmp_path, spots(3, 4000.0, 2), bare)
    assert found.value == pytest.approx(np.abs((first - second) / (first + second)).max(), abs=2e-3)


@pytest.mark.long
def test_a_time_that_is_searched_keeps_the_limit_too(tmp_path: Path) -> None:
    """Light is level times time, and the peak no longer linear in both; what is best is the same."""
    light = spots(3, 800.0, 1)
    time = '[keys.time]\nkey = "camera.exposure_time"\nlow = "10 ms"\nhigh = "300 ms"\n'
    found = found_for(tmp_path, light, TEXT.format(of="part").replace("[responses.part]", time + "[responses.part]"))
    flat = light.reshape(3, -1)
    best = linprog(
        -light[:, 2:10, 2:10].mean(axis=(1, 2)), flat.T, np.full(flat.shape[1], 130.0), bounds=[(0, 3 * MOST)] * 3
    )
    asked = in_si(found.levels["camera.exposure_time"])
    assert asked is not None and 0.01 <= asked <= 0.3
    assert found.value - DARK == pytest.approx(-best.fun, rel=1e-2)
    assert image(light, found).max() <= 130 * (1 + 1e-4)


@pytest.mark.parametrize("limits", [(-np.inf, 1.0), (1.0, np.inf), (-np.inf, np.inf)])
@pytest.mark.parametrize("unknown", [math.nan, math.inf, -math.inf])
def test_what_cannot_be_measured_breaks_every_limit(limits: tuple[float, float], unknown: float) -> None:
    of_light = NonlinearConstraint(lambda x: unknown if x[0] == 0 else float(x[0]), *limits)
    assert _excess([of_light], np.zeros(1)) == math.inf
    assert _excess([of_light], np.ones(1)) == 0.0
