"""Tolerances where the answer is known in closed form, and what the model alone says of planted polynomials."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from radwrap.errors import InputError, RadwrapError
from radwrap.study.design import Design, read_design
from radwrap.study.fresh import FreshRenders, System
from radwrap.study.pool import LocalPool
from radwrap.study.runner import Sink, Step
from radwrap.study.seen import Answer
from radwrap.study.study import StudyOptions
from radwrap.study.tolerance_model import Model, deviation_of, fit
from radwrap.study.tolerance_report import as_json, sentences
from radwrap.study.tolerances import Confirmed, Tolerance, Tolerances
from radwrap.study.tolerate import Search, largest_change, read_bound, scaled_scatter
from radwrap.study.worker import Outcome
from tests.cli.conftest import Done, here
from tests.study.conftest import SMALL, TINY, TINY_SMALL, DesignWriter

Tolerate = Callable[[Path, str, str], Done]
pytestmark = pytest.mark.usefixtures("one_process")

# The search stops where the change fills 85 to 100 % of the bound.
LEAST_FILLED = 0.85
# Of a change of 1 gray level: the mean of these small images is known to about 0.01, as equal seeds draw equal rays.
NOISE = 0.03

MEAN = '[responses.mean]\nmeasure = "mean_gray"\n'
TIME = f"""
analysis = "none"
{TINY}
[design]
kind = "full"
[factors.t]
label = "exposure time"
key = "camera.exposure_time"
levels = ["80 ms", "100 ms", "120 ms"]
"""


@pytest.fixture
def tolerate(capsys: pytest.CaptureFixture[str]) -> Tolerate:
    """`radwrap study tolerate` in this process."""

    def run(path: Path, response: str, within: str) -> Done:
        words = ("--out", path.parent / "out", "--response", response, "--within", within, "--repeats", 1)
        return here(["study", "tolerate", path, *words, "--json", "--workers", 1], capsys)

    return run


@pytest.mark.long
def test_gray_is_linear_in_exposure_time(design: DesignWriter, tolerate: Tolerate) -> None:
    """With gamma 1 the mean is G0 + c t: it may change by 1 % as long as |dt| stays below 0.01 mean/c.

    Asked again for a bound that the range never reaches, the same study says so.
    """
    path = design(TIME, MEAN)
    told = tolerate(path, "mean", "1%").success().json
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
    wide = tolerate(path, "mean", "90%").success().json["factors"]["t"]
    assert wide["limited_by_range"] and wide["tolerance"] == 20.0 and not found["limited_by_range"]


@pytest.mark.long
def test_an_edge_moves_by_the_projection_of_its_place(design: DesignWriter, tolerate: Tolerate) -> None:
    """u = f x/(D' p): 0.2 px are 0.2 x 50 um x 500 mm/12.5 mm = 0.4 mm.

    Long: the search is that of the exposure time above, the projection has its tests in tests/physics, and how a bound
    in pixels is read is tested below.
    """
    text = TIME.replace("camera.exposure_time", "targets[0].edge_position").replace(
        '["80 ms", "100 ms", "120 ms"]', '["0 mm", "1 mm", "2 mm"]'
    )
    text = text.replace("tolerance = 1.0", "tolerance = 0.7")  # the edge meets other rays where it moves
    path = design(text, '[responses.u]\nmeasure = "edge_position"\ndark = "sensor"\ngamma = 1.0\n')
    told = tolerate(path, "u", "0.2 px").success().json
    found = told["factors"]["t"]
    assert found["by_model"] == pytest.approx(0.4, rel=0.05)  # 0.005 px of 0.2: what the measured places are off by
    assert LEAST_FILLED * 0.4 * 0.95 <= found["tolerance"] <= 0.4 * 1.05


@pytest.mark.long
def test_two_factors_together_are_held_to_the_share(design: DesignWriter, tolerate: Tolerate) -> None:
    """Two factors that act alike, each alone within the bound: together they must be narrower.

    Long: the share of systems within a bound and how many must be seen within it are tested below by planted responses.
    """
    text = TIME.replace('"80 ms", "100 ms", "120 ms"', '"80 ms", "120 ms"') + (
        '[factors.r]\nlabel = "radiance"\nkey = "sources[0].radiance"\nlevels = ["1600 kW/m^2/sr", "2400 kW/m^2/sr"]\n'
    )
    told = tolerate(design(text, MEAN), "mean", "2%").success().json
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


@pytest.mark.long
def test_scatter_that_is_allowed_follows_from_what_fresh_systems_do(design: DesignWriter, tolerate: Tolerate) -> None:
    """Three LEDs, each even in 1 +- 0.3: the mean scatters by c/3 x 0.3 x sqrt(3)/sqrt(3), c the light of all.

    Long: planted responses keep their share below, and fresh systems are rendered for the exposure time above.
    """
    text = TINY_SMALL.replace("beam_width_factor", "radiance_factor").replace("[0.9, 1.1]", "[0.7, 1.3]")
    text = text.partition("[factors.x]")[0] + text[text.index("[factors.s]") :]
    told = tolerate(design(text, MEAN), "mean", "3%").json
    sigma = (told["nominal"] - 20) * 0.1
    # The scatter of eight systems is known to 25 %: four of that.
    assert told["factors"]["s"]["by_model"] == pytest.approx(told["bound"] / (1.96 * sigma), rel=1.0)
    assert told["factors"]["s"]["kind"] == "scatter" and len(told["factors"]["s"]["confirmed"]) == 8


class Planted(FreshRenders):
    """Renders whose response is known: a function of the scene, and noise that the seed decides."""

    def __init__(
        self, study: Design, response: Callable[[Mapping[str, Any]], float], repeats: int = 1, noise: float = 0.0
    ) -> None:
        # Neither a folder nor a pool: nothing is rendered.
        super().__init__(
            study, Path(), study.responses[0], StudyOptions(), LocalPool.__new__(LocalPool), repeats=repeats
        )
        self.planted, self.noise, self.each = response, noise, repeats

    def measured(self, systems: Sequence[System]) -> list[list[float]]:
        values = [
            self.planted(run.document) + self.noise * float(np.random.default_rng(run.seed).normal())
            for run in self.runs(systems)
        ]
        return [values[first : first + self.each] for first in range(0, len(values), self.each)]


def exposure(document: Mapping[str, Any]) -> float:
    """The exposure time [ms]."""
    return float(document["camera"]["exposure_time"].removesuffix(" ms"))


SCATTERED = """
analysis = "none"
seed = 5
[design]
kind = "full"
[factors.t]
key = "camera.exposure_time"
levels = { L = "100 ms", H = { normal = ["100 ms", "10 ms"] } }
"""


def shares_within(study: Design, repeats: int, bound: float, seeds: int = 60) -> list[float]:
    """Of each study: the true share of systems within the bound at the scatter that it allows."""
    shares = []
    for seed in range(seeds):
        search = Search(replace(study, seed=seed * 100), share=0.95)
        search.begin(Planted(search.design, exposure, repeats))
        size = search.scatter(search.scatters[0], bound).tolerance
        shares.append(float(2 * norm.cdf(bound / (10 * size)) - 1))
    return shares


@pytest.mark.parametrize("repeats", [1, 3])
def test_a_scatter_that_is_allowed_keeps_its_share(design: DesignWriter, repeats: int) -> None:
    """Repeats render one system again, they draw no other: the mean of others would scatter less than each of them."""
    shares = shares_within(study_design(design, SCATTERED), repeats, bound=5.0)
    # Student's t keeps 95 % in the mean over studies; of 60, each good to 0.055, the mean is known to 0.007.
    assert np.mean(shares) == pytest.approx(0.95, abs=4 * 0.007)


def test_systems_draw_for_themselves_where_a_study_draws_once(design: DesignWriter) -> None:
    study = study_design(design, SCATTERED + 'draws = "once"\n')
    search = Search(study, share=0.95)
    fresh = Planted(study, exposure, repeats=2)
    rows = fresh.measured([((study.factors[0].levels[1],), row) for row in range(8)])
    assert len({values[0] for values in rows}) == 8 and all(a == b for a, b in rows)
    seeds = [run.seed for run in fresh.runs([(search.base, 0)])]
    assert seeds == [6, 7]  # the study itself renders with 5


def test_the_nominal_system_draws_nothing(design: DesignWriter) -> None:
    text = SCATTERED.replace(
        '{ L = "100 ms", H = { normal = ["100 ms", "10 ms"] } }',
        '{ H = { uniform = ["70 ms", "110 ms"] }, L = "100 ms" }',
    )
    study = study_design(design, text)
    search = Search(study, share=0.95)
    assert search.begin(Planted(study, exposure)) == 100.0
    assert search.scatter(search.scatters[0], 1.0).nominal == "L"
    both = text.replace('L = "100 ms"', 'G = { normal = ["95 ms", "1 ms"] }')
    assert Search(study_design(design, both), share=0.95).base[0].values == ("90.0 ms",)


RANGES = """
analysis = "none"
[design]
kind = "latin_hypercube"
runs = 5
[factors.t]
key = "sources[0].misalignment.about_y"
range = ["-1 deg", "5 deg"]
[factors.e]
key = "camera.exposure_time"
range = ["90 ms", "160 ms"]
"""


def test_the_nominal_value_is_the_base_scenes(design: DesignWriter) -> None:
    """Also where the scene leaves it to the format's default: no misalignment."""
    assert [level.name for level in Search(study_design(design, RANGES), share=0.95).base] == ["0.0 deg", "100.0 ms"]
    outside = study_design(design, RANGES.replace("90 ms", "120 ms"))
    with pytest.raises(InputError, match=r"100.0 ms lies outside of what the study looks at, 120.0 ms to 160.0 ms"):
        Search(outside, share=0.95)


def test_a_response_that_leaves_its_bound_and_comes_back_is_seen(design: DesignWriter) -> None:
    """sin(pi dt/20 ms) is 0 again at 20 ms, the end of the range; it stays within 0.5 only up to 20/6 ms."""
    study = study_design(design, TIME)
    search = Search(study, share=0.95)
    search.begin(Planted(study, lambda document: float(np.sin(np.pi * (exposure(document) - 100) / 20))))
    found = search.deviation(search.deviations[0], 20.0, 0.5)
    assert found.met and LEAST_FILLED * 0.5 <= abs(found.confirmed[0].change) <= 0.5
    assert found.tolerance <= 20 / 6
    assert all(abs(seen.change) <= 0.5 for seen in found.halfway)


TWO = (
    TIME
    + """
[factors.f]
key = "camera.focal_length"
levels = ["12 mm", "12.5 mm", "13 mm"]
"""
)


@pytest.mark.parametrize(("inside", "met"), [(8, True), (7, True), (6, False), (0, False)])
def test_too_few_systems_within_confirm_nothing(design: DesignWriter, inside: int, met: bool) -> None:
    study = study_design(design, TWO)
    search = Search(study, share=0.95)
    values = iter([0.0, *[0.0] * inside, *[9.0] * (8 - inside)])
    search.begin(Planted(study, lambda document: next(values)))
    seen = (Confirmed("", -1.0, None), Confirmed("", 1.0, None))
    found = [
        Tolerance(one.factor, "deviation", 1.0, one.unit, "", "+-", 1.0, False, seen, True) for one in search.deviations
    ]
    model = Model(search.deviations, ((0, 0), (1, 0), (0, 1)), np.array([0.0, 1.0, 1.0]))
    both = search.together(model, found, 1.0)
    assert both is not None and both.inside == inside and both.met is met
    told = Tolerances(study.responses[0], 0.0, 1.0, 0.95, tuple(found), both, (), ())
    assert told.met is met and as_json(told)["together"]["met"] is met
    # A scatter that is looked at beside them is not among what is drawn: the sentence does not claim it.
    assert any(line.startswith("All together at ") for line in sentences(told))
    scatter = replace(found[0], kind="scatter", factor=replace(found[0].factor, name="leds"))
    lines = list(sentences(replace(told, found=(*found, scatter))))
    assert any(line.startswith("All deviations together, without the scatter of leds, at ") for line in lines)


def test_bounds_are_shares_or_changes_in_the_unit_of_the_response(design: DesignWriter) -> None:
    study = study_design(design, SMALL)
    assert largest_change(read_bound(study, "u", "0.2 px"), 10.0) == pytest.approx(0.2, rel=1e-12)
    assert largest_change(read_bound(study, "mean", "1%"), 110.0) == pytest.approx(1.1, rel=1e-12)
    assert largest_change(read_bound(study, "mean", "5"), 110.0) == 5.0


def test_a_share_of_nothing_is_no_bound(design: DesignWriter) -> None:
    with pytest.raises(InputError, match="give the change itself"):
        largest_change(read_bound(study_design(design, TIME), "mean", "1%"), 0.0)


def test_one_seed_tells_no_error(design: DesignWriter) -> None:
    study = study_design(design, TIME)
    for repeats, known in ((1, False), (3, True)):
        search = Search(study, share=0.95)
        search.begin(Planted(study, exposure, repeats, noise=0.1))
        found = search.deviation(search.deviations[0], 5.0, 5.0)
        assert all((seen.error is not None) is known for seen in found.confirmed)
        assert any("one seed" in note for note in search.notes) is not known
        told = Tolerances(study.responses[0], 100.0, 5.0, 0.95, (found,), None, (), ())
        assert any("+-" in line.partition("fresh renders")[2] for line in sentences(told)) is known


class AtOnce:
    """In place of a scheduler: every run has an answer, and the even ones an image that misses its tolerance."""

    def __init__(self, steps: Sequence[Step], sink: Sink, *_: object) -> None:
        self.runs, self.sink = [run.run for step in steps for run in step.job.runs], sink

    def run(self) -> dict[str, RadwrapError]:
        answers = {"mean": Answer(1.0, 0.0)}
        self.sink.save([Outcome(run, answers, 0.1, run % 2 == 1, "", 0.0) for run in self.runs])
        return {}


def test_images_that_miss_their_tolerance_are_counted(
    design: DesignWriter, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = design(TIME, MEAN)
    study = read_design(path)
    fresh = Planted(study, exposure, repeats=4)
    for user in ("fresh", "sampled"):  # and pilots, which find nothing here
        monkeypatch.setattr(f"radwrap.study.{user}.Scheduler", AtOnce)
    FreshRenders.measured(fresh, [(Search(study, share=0.95).base, 0)])
    assert fresh.not_met == 2
    (path.parent / "out").mkdir()
    for missed, code in ((2, 3), (0, 0)):
        told = Tolerances(study.responses[0], 100.0, 5.0, 0.95, (), None, (), (), missed)
        monkeypatch.setattr("radwrap.study.tolerate.tolerate", lambda *_, told=told, **__: told)
        words = ("study", "tolerate", path, "--out", path.parent / "out", "--response", "mean", "--within", "5")
        done = here([*words, "--json"], capsys)
        assert done.code == code and done.json["images_not_met"] == missed
