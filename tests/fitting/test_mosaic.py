"""A raw mosaic as a capture: each colour is a plane of the scene, of which its own pixels count."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.fitting.free_keys import free_scene
from radwrap.fitting.places import Places
from radwrap.fitting.prediction import Prediction
from radwrap.fitting.series import joined, states_of
from radwrap.fitting.solution import solve
from radwrap.images import GrayImage, write_png
from radwrap.imaging.relight.relit import Basis
from radwrap.scene.file.load import scene_from_document
from radwrap.scene.mosaic import COLOURS, places_of
from radwrap.scene.scene import Scene
from tests.fitting.conftest import EXPOSURE, LEVELS, OPTIONS, changed, tables, taken

EFFICIENCIES: Final = {"red": 0.3, "green": 0.5, "blue": 0.1}
SIGMAS: Final = 4.0  # of each of four keys: 1 of 4000 fits is missed
FREE: Final = [LEVELS, "camera.sensor.offset"]
TRUTH: Final = {
    "sources[0].leds[0].radiance_factor": 1.2,
    "sources[0].leds[1].radiance_factor": 0.8,
    "sources[0].leds[2].radiance_factor": 1.1,
    "camera.sensor.offset": 6.0,
}


def colour_bench(**sensor: Any) -> Scene:
    filters = {colour: {"quantum_efficiency": value} for colour, value in EFFICIENCIES.items()}
    document = tables(mosaic="GBRG", filters=filters, **sensor)
    del document["camera"]["sensor"]["quantum_efficiency"]
    return scene_from_document(document)


def frame_of(scene: Scene, seed: int) -> GrayImage:
    """What the camera gives, with noise."""
    made = radwrap.render(scene, options=OPTIONS, method="rays", tolerance=0.3, seed=seed)
    return made.frames(1, seed=seed + 1)[0]


def test_each_colour_is_a_state_of_its_own_pixels() -> None:
    scene = colour_bench()
    rows, columns = scene.camera.sensor.rows, scene.camera.sensor.columns
    mask = np.ones((rows, columns), dtype=np.bool_)
    mask[:4] = False
    image = GrayImage(np.zeros((rows, columns)), 8)
    states = states_of(free_scene(scene, [EXPOSURE]), [image], mask, None)
    assert [state.free.scene.camera.sensor.linear.quantum_efficiency for state in states if state] == [0.5, 0.3, 0.1]
    assert [len(state.told) for state in states] == [1, 0, 0] and {state.number for state in states} == {0}
    assert (sum(state.captured.mask.astype(int) for state in states) == mask).all()
    for state, colour in zip(states, ("green", "red", "blue"), strict=True):
        own = np.zeros_like(mask)
        for place in places_of("GBRG", colour):
            own[place] = True
        assert (state.own == own).all() and (state.captured.mask == (own & mask)).all()
    whole = [np.full((rows, columns), float(number)) for number in range(3)]
    (raw,) = joined(whole, states)
    for number, state in enumerate(states):
        assert (raw[state.own] == number).all()
    assert len(COLOURS) == len(states)


@pytest.mark.long
def test_levels_and_offset_come_out_of_a_raw_image_without_noise(basis: Basis) -> None:
    """All colours are seen in one light, and each pixel says what its own filter lets through."""
    begun = free_scene(colour_bench(rounding=False), FREE)  # nor is it rounded
    states = states_of(begun, [GrayImage(np.zeros((20, 24)), 8)], None, None)
    places = Places(states[0].free, (), lambda _: basis)
    assert all(places.serves(state.free.scene) for state in states)
    prediction = Prediction([(state.free, places) for state in states])
    truth = [TRUTH[key.key] for key in begun.keys]
    (raw,) = joined([part.unclipped for part in prediction.at(truth).parts], states)
    shot = taken(raw, begun.scene)
    captures = [replace(shot, mask=state.captured.mask) for state in states]
    solved = solve(begun.keys, prediction, captures, None, robust=False)
    assert solved.converged and solved.values == pytest.approx(truth, rel=1e-9)


@pytest.mark.long
def test_a_fit_to_a_raw_image_finds_levels_and_offset() -> None:
    scene = colour_bench()
    found = radwrap.fit(scene, [frame_of(changed(scene, TRUTH), 5)], FREE, options=OPTIONS)
    for key in found.keys:
        assert key.sigma is not None and abs(key.value - TRUTH[key.key]) < SIGMAS * key.sigma, key
    assert found.explained and found.converged
    assert found.scene.camera.sensor.mosaic is not None
    rows, columns = scene.camera.sensor.rows, scene.camera.sensor.columns
    assert found.residual.shape == found.gray.values.shape == (rows, columns)
    assert float(np.nanmean(found.residual**2)) == pytest.approx(1, abs=5 * np.sqrt(2 / (rows * columns)))
    assert len(found.manifest["captures"]) == 1 and all(block.capture is None for block in found.verdict.worst)


@pytest.mark.long
def test_a_wrong_filter_is_seen() -> None:
    """A camera whose red pixels see half as much light again does not fit by levels and offset."""
    scene = colour_bench()
    filters = {c: {"quantum_efficiency": v * (1.5 if c == "red" else 1)} for c, v in EFFICIENCIES.items()}
    other = changed(scene, {"camera.sensor.filters": filters})
    found = radwrap.fit(scene, [frame_of(other, 5)], FREE, options=OPTIONS)
    assert not found.explained


def test_an_image_twice_is_still_refused(tmp_path: Path) -> None:
    path = tmp_path / "raw.png"
    write_png(path, np.full((20, 24), 7, dtype=np.uint8))
    states = [radwrap.Captures([path]), radwrap.Captures([path], {EXPOSURE: "80 ms"})]
    with pytest.raises(InputError, match="once more, pixel by pixel"):
        radwrap.fit(colour_bench(), states, FREE, options=OPTIONS)
