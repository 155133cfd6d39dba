"""What matters to a picture: effects in its own light, parts of its deviation, results of a study."""

from __future__ import annotations

import csv
import json
import threading
import time
from pathlib import Path
from typing import Any, Final

import pytest

import radwrap
from radwrap.errors import Cancelled, InputError
from radwrap.face.effects import measured_effects
from radwrap.face.matters import parts_of, study_told
from radwrap.face.renderer import Renderer
from radwrap.face.session import Session
from tests.cli.conftest import here, scene_with, write_scene
from tests.face.conftest import PATIENCE, TWO, Served, serving

OPTIONS: Final[dict[str, Any]] = {"tolerance": 2.0, "tracer": "radiance"}


def request(**changes: Any) -> dict[str, Any]:
    scene = radwrap.scene_from_document(scene_with(TWO), changes)
    return {"scene": scene, "options": OPTIONS}


@pytest.mark.long
def test_effects_are_those_of_explain_in_the_same_light(served: Served) -> None:
    """The server's are measured for the turn; where light differs, so do they."""
    basis = served.ready()["basis"]

    def matters(**turn: Any) -> Any:
        answer = served.post("/api/matters", {"basis": basis, "turn": turn})
        assert answer.status == 200, answer.body
        return answer.json

    own = matters(levels=[1.0, 1.0])
    alone = radwrap.effects(radwrap.scene_from_document(scene_with(TWO)), radwrap.RenderOptions(**OPTIONS))
    assert own["effects"] == alone["effects"] and own["tolerance"] == 2.0
    assert own["advice"] == radwrap.explain(radwrap.scene_from_document(scene_with(TWO)))["advice"]
    assert own["method"] == alone["planner"]["method"] and own["effects_exposure_time"] == own["exposure_time"]
    halved = matters(levels=[1.0, 1.0], knobs={"gain": "0.5"})
    for one, other in zip(own["effects"], halved["effects"], strict=True):
        assert other["rms_gray"] == pytest.approx(0.5 * one["rms_gray"], rel=1e-6), one["name"]
    dark = matters(levels=[1.0, 0.0])
    assert dark["effects"] != own["effects"]
    parts = own["parts"]
    assert list(parts) == sorted(parts, key=lambda name: -parts[name]) and parts["rounding"] == pytest.approx(12**-0.5)
    assert served.post("/api/matters", {"basis": basis + 1}).status == 422
    assert served.settled()["state"] == "ready"


def test_where_the_picture_saturates_that_is_said() -> None:
    """All of it at an exposure that does not: effects on a saturated picture are none."""
    bright = measured_effects(request(**{"camera.exposure_time": "100 s"}))
    assert bright["exposure_time"] == 100.0 and bright["effects_exposure_time"] < 10.0
    assert "saturated" in bright["advice"]


@pytest.mark.long
def test_a_trace_ends_the_measurement(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And the other way round it is refused; in no case do both wait for each other."""
    session = Session(radwrap.scene_from_document(scene_with(TWO)), OPTIONS, work=tmp_path, out=None, recipe=None)
    measuring = threading.Event()

    def measures(self: Renderer, _: Any) -> Any:
        measuring.set()
        assert self._stop.wait(PATIENCE)
        raise Cancelled("was stopped", where="renderer")

    monkeypatch.setattr(Renderer, "effects", measures)
    try:
        session.trace()
        with pytest.raises(InputError, match="under way"):
            session.effects(_traced(session, wait=False), _turn())
        traced, ended = _traced(session), []

        def measure() -> None:
            try:
                session.effects(traced, _turn())
            except Cancelled as error:
                ended.append(error)

        thread = threading.Thread(target=measure)
        thread.start()
        assert measuring.wait(PATIENCE)
        with pytest.raises(InputError, match="under way"):
            session.effects(traced, _turn())
        session.trace()
        thread.join(PATIENCE)
        assert ended and _traced(session).number == traced.number + 1
    finally:
        session.close()


def _turn() -> Any:
    from radwrap.imaging.page.turn import Turn

    return Turn((1.0, 1.0))


def _traced(session: Session, *, wait: bool = True) -> Any:
    end = time.monotonic() + PATIENCE
    while wait and session.status.state == "tracing":
        assert time.monotonic() < end
        time.sleep(0.02)
    assert not wait or session.status.state == "ready", session.status
    if wait:
        return session.finished()
    from types import SimpleNamespace

    scene = radwrap.scene_from_document(scene_with(TWO))
    return SimpleNamespace(scene=scene, sources=("lamp", "second"))


def study_in(folder: Path, title: str = "Rings </script>") -> Path:
    """A table as a study leaves it: A moves f by 4, B by 1, and both are known to 0.01."""
    folder.mkdir()
    with (folder / "results.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(
            ["run", "replicate", "seed", "A", "B", "f [mm]", "f_error [mm]", "image_error", "met", "warnings", "error"]
        )
        for number in range(8):
            a, b, scatter = number % 2, number // 2 % 2, (number // 4 - 0.5) * 0.02
            value = 12 + 4 * a + b + scatter
            table.writerow([number, 1, 1, "LH"[a], "LH"[b], value, 0.01, 0.1, "yes", "", ""])
    return folder


def test_a_study_is_told_with_its_largest_effect_first(tmp_path: Path) -> None:
    told = study_told(study_in(tmp_path / "study"))
    (found,) = told["responses"]
    assert found["response"] == "f [mm]" and found["runs"] == 8
    first, second = found["effects"][:2]
    assert (first["name"], first["effect"], first["significant"]) == ("A", pytest.approx(4.0), True)
    assert (second["name"], second["effect"]) == ("B", pytest.approx(1.0))
    assert (first["from"], first["to"]) == ("L", "H") and "A moves f by" in found["sentences"][0]


def test_what_is_no_study_is_one_clear_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = write_scene(tmp_path, TWO)
    line = here(["face", scene, "--no-browser", "--study", tmp_path], capsys).refusal(2)
    assert "holds no results.csv" in line and str(tmp_path) in line
    study = study_in(tmp_path / "study")
    (study / "results.csv").write_text("run,A,f,f_error\n1,L,nothing,0\n2,H,2,0\n")
    (found,) = study_told(study)["responses"]
    assert found["effects"] == [] and "Nothing can be said" in found["sentences"][0]


@pytest.mark.long
def test_the_page_is_told_of_the_study(tmp_path: Path) -> None:
    with serving(tmp_path, None, "--study", study_in(tmp_path / "study")) as served:
        assert served.ready()["study"] == json.loads(json.dumps(study_told(tmp_path / "study")))


def test_parts_are_rms_over_the_picture() -> None:
    import numpy as np

    from radwrap.face.traced import Image

    squares = {"rays": np.array([[1.0, 3.0]]), "noise": np.array([[16.0, 16.0]])}
    image = Image(None, squares, np.zeros((1, 2)), None, {}, None)  # type: ignore[arg-type]
    assert list(parts_of(image).items()) == [("noise", 4.0), ("rays", pytest.approx(2**0.5))]
