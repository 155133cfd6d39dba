"""Tolerances where the answer is known in closed form, and what the model alone says of planted polynomials."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from radwrap.errors import InputError
from radwrap.study.design import Design, read_design
from radwrap.study.tolerance_model import Model, deviation_of, fit
from radwrap.study.tolerate import read_bound, scaled_scatter
from tests.cli.conftest import Done
from tests.study.conftest import SMALL, DesignWriter, command

# The search stops where the change fills 85 to 100 % of the bound.
LEAST_FILLED = 0.85
# Of a change of 1 gray level: the mean of these small images is known to about 0.01 at tolerance 0.2.
NOISE = 0.03

MEAN = '[responses.mean]\nmeasure = "mean_gray"\n'
TIME = """
analysis = "none"
[render]
tolerance = 0.2
[design]
kind = "full"
[factors.t]
label = "exposure time"
key = "camera.exposure_time"
levels = ["80 ms", "100 ms", "120 ms"]
"""


def tolerate(path: Path, response: str, within: str, *options: object) -> Done:
    words = ("--out", path.parent / "out", "--response", response, "--within", within, *options)
    return command("study", "tolerate", path, *words, "--json", "--workers", 1)


def test_gray_is_linear_in_exposure_time(design: DesignWriter) -> None:
    """With gamma 1 the mean is G0 + c t: it may change by 1 % as long as |dt| stays below 0.01 mean/c."""
    path = design(TIME, MEAN)
    told = tolerate(path, "mean", "1%", "--repeats", 1).success().json
    found = told["factors"]["t"]
    slope = (told["nominal"] - 20) / 100  # gray per ms
    exact = told["bound"] / slope
    assert told["bound"] == pytest.approx(0.01 * told["nominal"], rel=1e-12)
    assert found["by_model"] == pytest.approx(exact, rel=NOISE)
    assert LEAST_FILLED * exact <= found["tolerance"] <= exact * (1 + NOISE)
    assert found["nominal"] == "100.0 ms" and found["direction"] == "+-" and found["met"]
    for seen in found["confirmed"]:
        assert abs(seen["change"]) == pytest.approx(slope * found["tolerance"], rel=NOISE)
    assert json.loads((path.parent / "out" / "tolerances.json").read_text())["factors"]["t"] == found


def test_an_edge_moves_by_the_projection_of_its_place(design: DesignWriter) -> None:
    """u = f x/(D' p): 0.2 px are 0.2 x 50 um x 500 mm/12.5 mm = 0.4 mm."""
    text = TIME.replace("camera.exposure_time", "targets[0].edge_position").replace(
        '["80 ms", "100 ms", "120 ms"]', '["0 mm", "1 mm", "2 mm"]'
    )
    path = design(text, '[responses.u]\nmeasure = "edge_position"\ndark = "sensor"\ngamma = 1.0\n')
    told = tolerate(path, "u", "0.2 px", "--repeats", 1).success().json
    found = told["factors"]["t"]
    assert found["by_model"] == pytest.approx(0.4, rel=0.05)  # 0.005 px of 0.2: what the measured places are off by
    assert LEAST_FILLED * 0.4 * 0.95 <= found["tolerance"] <= 0.4 * 1.05


def test_a_bound_that_the_range_never_reaches_is_said(design: DesignWriter) -> None:
    told = tolerate(design(TIME, MEAN), "mean", "90%", "--repeats", 1).success().json
    assert told["factors"]["t"]["limited_by_range"] and told["factors"]["t"]["tolerance"] == 20.0


def test_two_factors_together_are_held_to_the_share(design: DesignWriter) -> None:
    """Two factors that act alike, each alone within the bound: together they must be narrower."""
    text = TIME.replace('"80 ms", "100 ms", "120 ms"', '"80 ms", "120 ms"') + (
        '[factors.r]\nlabel = "radiance"\nkey = "sources[0].radiance"\nlevels = ["1600 kW/m^2/sr", "2400 kW/m^2/sr"]\n'
    )
    told = tolerate(design(text, MEAN), "mean", "2%", "--repeats", 1).success().json
    both = told["together"]
    # a, b even in -s ... s: |a + b| exceeds 1 in (2 - 1/s)^2/4 of all systems, which is 5 %.
    expected = 1 / (2 - np.sqrt(0.2))
    filled = np.mean([one["tolerance"] / (told["bound"] / slope) for one, slope in _slopes(told)])
    assert both["scale"] * filled == pytest.approx(expected, rel=0.04)
    assert both["share_by_model"] >= 0.95 and both["inside"] >= both["systems"] - 2


def _slopes(told: dict[str, object]) -> list[tuple[dict[str, float], float]]:
    factors, light = told["factors"], float(str(told["nominal"])) - 20
    assert isinstance(factors, dict)
    return [(factors["t"], light / 100), (factors["r"], light / 2000)]


def study_design(design: DesignWriter, text: str) -> Design:
    return read_design(design(text))


def test_the_model_gives_planted_polynomials_back(design: DesignWriter) -> None:
    study = study_design(design, TIME)
    deviation = deviation_of(study, study.factors[0])
    assert deviation is not None and (deviation.nominal, deviation.low, deviation.high) == (100, 80, 120)
    rows = [
        {"t": level.name, "y": str(3 + 0.5 * x + 0.25 * x**2)}
        for level, x in zip(study.factors[0].levels, (-1, 0, 1), strict=True)
    ]
    model = fit(study, (deviation,), rows, "y")
    x = np.array([[-1.0], [0.5], [1.0]])
    assert model.change(x) == pytest.approx([-0.25, 0.3125, 0.75], abs=1e-12)
    # 0.5 x + 0.25 x^2 = 0.3125 at x = 0.5, on the steeper side: 10 ms.
    assert model.reach(0, 0.3125) == pytest.approx(10, rel=1e-3)


def test_the_share_of_random_systems_has_its_closed_form(design: DesignWriter) -> None:
    """x even in -1 ... 1, y = x: |y| <= 0.6 holds for 60 %."""
    study = study_design(design, TIME)
    deviation = deviation_of(study, study.factors[0])
    assert deviation is not None
    model = Model((deviation,), ((0,), (1,)), np.array([0.0, 1.0]))
    assert model.share_inside([20.0], 0.6) == pytest.approx(0.6, abs=0.015)  # 20 000 draws: 4 standard errors


def test_scatter_is_narrowed_about_the_fixed_level(design: DesignWriter) -> None:
    study = study_design(design, SMALL)
    level = scaled_scatter(study.factors[1], 0.5)
    assert (level.values[0].first, level.values[0].second) == pytest.approx((0.95, 1.05))
    assert deviation_of(study, study.factors[1]) is None


@pytest.mark.parametrize(
    ("response", "within"), [("mean", "0%"), ("mean", "x"), ("mean", "-1"), ("u", "1 mm"), ("v", "1%")]
)
def test_bad_bounds_are_refused(design: DesignWriter, response: str, within: str) -> None:
    with pytest.raises(InputError):
        read_bound(study_design(design, SMALL), response, within)


def test_scatter_that_is_allowed_follows_from_what_fresh_systems_do(design: DesignWriter) -> None:
    """Three LEDs, each even in 1 +- 0.3: the mean scatters by c/3 x 0.3 x sqrt(3)/sqrt(3), c the light of all."""
    text = SMALL.replace("beam_width_factor", "radiance_factor").replace("[0.9, 1.1]", "[0.7, 1.3]")
    text = text.partition("[factors.x]")[0] + text[text.index("[factors.s]") :]
    told = tolerate(design(text, MEAN), "mean", "3%", "--repeats", 1).json
    sigma = (told["nominal"] - 20) * 0.1
    # The scatter of eight systems is known to 25 %: four of that.
    assert told["factors"]["s"]["by_model"] == pytest.approx(told["bound"] / (1.96 * sigma), rel=1.0)
    assert told["factors"]["s"]["kind"] == "scatter" and len(told["factors"]["s"]["confirmed"]) == 8
