"""Captures of the bench in several states, which share the values of the free keys."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.fitting.covariance import PredictionErrors, Shared, spread
from radwrap.fitting.free_keys import free_scene
from radwrap.fitting.places import Places
from radwrap.fitting.prediction import Prediction
from radwrap.fitting.series import read_series, states_of
from radwrap.fitting.solution import Solution, solve
from radwrap.fitting.weights import patterns
from radwrap.images import GrayImage, write_png
from radwrap.imaging.relight.relit import Basis
from radwrap.random_streams import generator
from radwrap.scene.file.load import scene_from_document
from radwrap.scene.scene import Scene
from tests.cli.conftest import here, scene_text
from tests.fitting.conftest import EXPOSURE, LEVELS, OPTIONS, changed, tables, taken
from twin_captures import FOLDER, POSE, TRUTH

EXACT: Final = 1e-9  # the solver's own precision, and rounding
TIMES: Final = ("40 ms", "80 ms", "120 ms")
OFFSET: Final = "camera.sensor.offset"
DRAWS: Final = 2000  # they know a variance to 3 %
WITHIN: Final = 0.15  # of a variance: five times that
SIGMAS: Final = 4.0  # of each of four keys: 1 of 4000 fits is missed


def _prediction(scene: Scene, basis: Basis, free: list[str], times: tuple[str, ...]) -> Prediction:
    """States that differ in their exposure time, all in one light."""
    begun = free_scene(scene, free)
    dark = GrayImage(np.zeros((20, 24)), 8)
    series = [radwrap.Captures([dark], {EXPOSURE: time}) for time in times]
    places = Places(begun, (), lambda _: basis)
    states = states_of(begun, series, None, None)
    assert all(places.serves(state.free.scene) for state in states)
    return Prediction([(state.free, places) for state in states])


def _solved(prediction: Prediction, scene: Scene, truth: list[float], free: list[str]) -> Solution:
    """Fitted to captures without noise."""
    keys = free_scene(scene, free).keys
    captures = [taken(part.unclipped, part.scene) for part in prediction.at(truth).parts]
    return solve(keys, prediction, captures, None, robust=False)


@pytest.mark.long
def test_what_each_state_knows_adds_up(bench: Scene, basis: Basis) -> None:
    bench = changed(bench, {"camera.sensor.rounding": False})  # these captures are not rounded
    free, truth = [LEVELS, OFFSET], [1.2, 0.8, 1.1, 6.0]
    together = _solved(_prediction(bench, basis, free, TIMES), bench, truth, free)
    assert together.converged and together.values == pytest.approx(truth, rel=EXACT)
    assert together.residual.shape == (60, 24)
    known = np.zeros((4, 4))
    for time in TIMES:
        alone = _solved(_prediction(bench, basis, free, (time,)), bench, truth, free).jacobian
        known += alone.T @ alone
    assert together.jacobian.T @ together.jacobian == pytest.approx(known, rel=1e-6)


@pytest.fixture(scope="module")
def patterned() -> Scene:
    """The same bench; pixels of its camera are anything but alike."""
    return scene_from_document(tables(dsnu="40 e", prnu=0.05))


def _with_pattern(solved: Solution) -> tuple[Shared, np.ndarray[Any, np.dtype[np.float64]]]:
    parts, sigma, used = solved.predicted.parts, solved.weighed.sigma, solved.weighed.used
    differ = np.concatenate([patterns(part.exposure, part.sensor) for part in parts], axis=1)
    pixel = np.tile(np.arange(480).reshape(20, 24), (len(parts), 1))
    return Shared(differ[:, used] / sigma[used], pixel[used]), differ


def test_pixels_that_differ_do_so_in_all_states(patterned: Scene, basis: Basis) -> None:
    """Noise as a camera has it, drawn: the values scatter as is told, and by more than if each state had its own."""
    free, truth = [LEVELS, OFFSET], [1.0, 1.0, 1.0, 6.0]
    solved = _solved(_prediction(patterned, basis, free, TIMES), patterned, truth, free)
    shared, differ = _with_pattern(solved)
    used, sigma = solved.weighed.used, solved.weighed.sigma
    inverse = np.linalg.pinv(solved.jacobian)
    own = np.sqrt(sigma**2 - (differ**2).sum(axis=0))
    random, values = generator(4, 1), []
    for _ in range(DRAWS):
        specimen = np.tile(random.standard_normal((2, 20, 24)), (1, len(TIMES), 1))
        noise = own * random.standard_normal(own.shape) + (differ * specimen).sum(axis=0)
        values.append(inverse @ (noise / sigma)[used])
    scatter = np.var(np.array(values), axis=0)
    quiet = PredictionErrors(np.zeros((2, int(used.sum()))))
    told = np.diag(spread(solved.jacobian, quiet, shared=shared).noise)
    assert scatter == pytest.approx(told, rel=WITHIN)
    alone = np.diag(spread(solved.jacobian, quiet).noise)
    assert np.abs(scatter / alone - 1).max() > 2 * WITHIN


def test_repeats_of_one_state_average_all_but_the_pattern(patterned: Scene, basis: Basis) -> None:
    """By hand, of one key: weights w, noise v of each pixel, of which d^2 is the same in all n states."""
    prediction = _prediction(patterned, basis, [OFFSET], ("100 ms",) * 3)
    solved = _solved(prediction, patterned, [6.0], [OFFSET])
    shared, differ = _with_pattern(solved)
    assert solved.weighed.used.all()
    v, d = solved.weighed.sigma[:20] ** 2, (differ[:, :20] ** 2).sum(axis=0)
    w = 1 / v
    expected = float((w**2 * ((v - d) / 3 + d)).sum() / w.sum() ** 2)
    quiet = PredictionErrors(np.zeros((2, 1440)))
    scale = free_scene(patterned, [OFFSET]).keys[0].scale
    assert spread(solved.jacobian, quiet, shared=shared).noise[0, 0] * scale**2 == pytest.approx(expected, rel=1e-6)


def test_light_is_shared_unless_a_ray_would_go_elsewhere(bench: Scene, basis: Basis) -> None:
    dark = changed(bench, {"sources[0].leds[2].radiance_factor": 0.0})
    places = Places(free_scene(bench, [OFFSET]), (), lambda _: basis)
    for changes in ({EXPOSURE: "1 ms"}, {"sources[0].radiance": "1 W/m^2/sr"}, {"camera.sensor.read_noise": "1 e"}):
        assert places.serves(changed(bench, changes))
    assert places.serves(dark)
    for changes in ({"camera.position": ["1 mm", "0 mm", "500 mm"]}, {"materials.white.reflectance": 0.3}):
        assert not places.serves(changed(bench, changes))
    assert not Places(free_scene(dark, [OFFSET]), (), lambda _: basis).serves(bench)


@pytest.fixture(scope="module")
def folder(bench: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Captures of an edge that lies elsewhere, in two lights and from two places."""
    folder = tmp_path_factory.mktemp("series")
    (folder / "scene.toml").write_text(scene_text(tables()))
    truth = {LEVELS.replace("*", "0"): 1.3, OFFSET: 7.0}
    near = {"camera.position": ["0 mm", "0 mm", "480 mm"]}
    for name, state in (("short", {EXPOSURE: "60 ms"}), ("near", near), ("long", {EXPOSURE: "110 ms"})):
        made = radwrap.render(changed(bench, {**truth, **state}), method="rays", tolerance=0.3, seed=5, workers=1)
        write_png(folder / f"{name}.png", made.frames(1)[0].codes)
    (folder / "captures.toml").write_text(
        '[[captures]]\nfiles = ["short.png"]\nset = { "camera.exposure_time" = "60 ms" }\n'
        '[[captures]]\nfiles = ["near.png"]\nset = { "camera.position" = ["0 mm", "0 mm", "480 mm"] }\n'
        '[[captures]]\nfiles = ["long.png"]\nset = { "camera.exposure_time" = "110 ms" }\n'
    )
    return folder


@pytest.mark.long
def test_a_series_is_fitted_as_a_user_would(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    argv: list[object] = ["fit", folder / "scene.toml", "--captures", folder / "captures.toml", "--free", OFFSET]
    argv += [
        "--free",
        LEVELS.replace("*", "0"),
        "--out",
        folder / "out",
        "--tolerance",
        2,
        "--tracer",
        "compiled",
        "--json",
    ]
    told = here(argv, capsys).success().json
    assert told["explained"] and told["places"] == 2
    assert [one["set"] for one in told["captures"]] == [one.changes for one in read_series(folder / "captures.toml")]
    for key, true in zip(told["keys"], (7.0, 1.3), strict=True):
        assert abs(key["value"] - true) < SIGMAS * key["sigma"]
    # The scene is the user's, with the values that all states share.
    found = radwrap.load_scene(folder / "out" / "scene.toml")
    assert found.camera.exposure_time == radwrap.load_scene(folder / "scene.toml").camera.exposure_time
    # A state that is told wrong is found: what is left is told by capture.
    first, _, last = (folder / "captures.toml").read_text().strip().split("[[captures]]")[1:]
    (folder / "wrong.toml").write_text("".join(f"[[captures]]{one}" for one in (first, last.replace("110", "130"))))
    argv[3] = folder / "wrong.toml"
    argv.remove("--json")
    done = here(argv, capsys)
    assert done.code == 1 and re.search("capture [01], rows", done.stdout)


def test_one_led_at_a_time_is_a_state_each(bench: Scene) -> None:
    """An LED that is off in the first state is on in the second: each has the light of its own LEDs."""
    coarse = radwrap.RenderOptions(tolerance=8.0, tracer="compiled")
    series = []
    for on in (0, 1):
        state = {f"sources[0].leds[{k}].radiance_factor": 0.0 for k in range(3) if k != on}
        made = radwrap.render(changed(bench, {**state, OFFSET: 7.0}), options=coarse, seed=5)
        series.append(radwrap.Captures(made.frames(1), state))
    found = radwrap.fit(bench, series, [OFFSET], options=coarse)
    assert found.manifest["places"] == 2 and abs(found.keys[0].value - 7.0) < 0.5


def _files(text: str) -> Callable[[Path], list[object]]:
    def argv(folder: Path) -> list[object]:
        (folder / "bad.toml").write_text(text)
        return ["--captures", folder / "bad.toml", "--free", EXPOSURE]

    return argv


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (lambda folder: ["--free", EXPOSURE], "is missing"),
        (lambda folder: [folder / "short.png", "--captures", folder / "captures.toml", "--free", OFFSET], "both"),
        (lambda folder: ["--captures", folder / "captures.toml", "--free", EXPOSURE], "captures[0].set: camera.exp"),
        (lambda folder: ["--captures", folder / "captures.toml", "--free", "pose:camera"], "is free"),
        (_files('[[captures]]\nfiles = ["none.png"]'), "captures[0].files[0]"),
        (_files('[[captures]]\nfiles = ["../short.png"]'), "outside"),
        (_files('[[captures]]\nfile = ["short.png"]'), "captures[0].file"),
        (_files("[[captures]]\nfiles = []"), "captures[0].files"),
        (
            _files('[[captures]]\nfiles = ["short.png"]\n[[captures]]\nfiles = ["near.png", "short.png"]'),
            "short.png of captures[0] once more, pixel by pixel",
        ),
        (lambda folder: [folder / "short.png", folder / "short.png", "--free", OFFSET], "once more"),
        (_files('[[captures]]\nfiles = ["short.png"]\nset = { "camera.sensor.rows" = 21 }'), "24 x 20 pixels"),
        (_files('[[captures]]\nfiles = ["short.png"]\nset = { "camera.nothing" = 1 }'), "unknown key"),
        (_files('[[captures]]\nfiles = ["short.png"]\nset = { "camera.exposure_tim" = 1 }'), "captures[0].set"),
        (_files('[[captures]]\nfiles = ["short.png"]\nset = { "sources[0].radiance" = "0 W/m^2/sr" }'), "no light"),
    ],
)
def test_what_cannot_be_a_series_is_refused(
    folder: Path, capsys: pytest.CaptureFixture[str], argv: Callable[[Path], list[object]], words: str
) -> None:
    line = here(["fit", folder / "scene.toml", *argv(folder), "--out", folder / "refused"], capsys).refusal(2)
    assert words in line
    assert not (folder / "refused").exists()


def test_images_and_states_do_not_mix(bench: Scene) -> None:
    image = GrayImage(np.zeros((20, 24)), 8)
    with pytest.raises(InputError, match="one list"):
        radwrap.fit(bench, [image, radwrap.Captures([image])], [EXPOSURE], options=OPTIONS)  # type: ignore[list-item]


@pytest.mark.long
def test_the_twin_is_found_in_its_four_captures() -> None:
    """Levels and gamma of rad_scenes/twin, the pose of its board held at what is true: with it a fit takes minutes."""
    scene = radwrap.load_scene(FOLDER / "scene.toml")
    held = free_scene(scene, [POSE]).written(TRUTH[6:12])
    there = radwrap.load_scene(FOLDER / "scene.toml", held)
    series = read_series(FOLDER / "captures.toml")
    found = radwrap.fit(there, series, [LEVELS, "camera.sensor.gamma=0.5:1.5"], options=OPTIONS)
    assert found.converged and found.explained and len(found.keys) == 7
    inside = 0
    for key, true in zip(found.keys, (*TRUTH[:6], TRUTH[12]), strict=True):
        assert key.interval is not None
        inside += key.interval[0] < true < key.interval[1]
        assert key.sigma is not None and abs(key.value - true) < 5 * key.sigma < 0.05
    # The captures' own rays are off by half of their noise: a right value is outside with a chance of 8 %, and three of
    # seven with one of 1 %.
    assert inside >= len(found.keys) - 2
