"""Knobs that need rays: traced anew, coarse first, the newest last, and made again by the command that is told."""

from __future__ import annotations

import json
import shlex
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pytest

import radwrap
from radwrap.cli.options import changes_of
from radwrap.errors import InputError
from radwrap.face import coarse
from radwrap.face.ray_knobs import ray_changes, ray_knobs
from radwrap.face.recipe import Recipe
from radwrap.face.session import Session
from radwrap.imaging.page.turn import Turn
from tests.cli.conftest import scene_with
from tests.face.conftest import TWO, Served
from tests.face.test_coarse import hashes, seen

OPTIONS: Final[dict[str, Any]] = {"tolerance": 2.0, "tracer": "radiance"}
ROTATION: Final = "targets[0].rotation"
OPENING: Final = "camera.aperture.diameter"


def scene(**changes: Any) -> radwrap.Scene:
    return radwrap.scene_from_document(scene_with(TWO), changes)


def test_knobs_are_what_the_scene_says() -> None:
    assert ray_knobs(scene()) == {
        "camera.position": "0 mm, 0 mm, 500 mm",
        "camera.look_at": "0 mm, 0 mm, 0 mm",
        "camera.focal_length": "12.5 mm",
        OPENING: "0.4 mm",
        ROTATION: "20 deg, 6 deg, -2 deg",
    }


def test_an_f_number_is_a_number() -> None:
    lens = {"camera.lens": {"focus_distance": "500 mm", "f_number": 4}}
    document = scene_with(TWO)
    del document["camera"]["aperture"]
    turned = radwrap.scene_from_document(document, lens)
    assert ray_knobs(turned)["camera.lens.f_number"] == "4"
    assert ray_changes({"camera.lens.f_number": " 5.6"}, turned) == {"camera.lens.f_number": 5.6}
    assert ray_changes({"camera.lens.f_number": "4.0"}, turned) == {}
    with pytest.raises(InputError, match="must be a number without a unit"):
        ray_changes({"camera.lens.f_number": "f/4"}, turned)


def test_only_what_is_turned_changes() -> None:
    told = {OPENING: " 0.4 mm", ROTATION: "20 deg,6 deg , 5 deg"}
    assert ray_changes(told, scene()) == {ROTATION: ["20 deg", "6 deg", "5 deg"]}


@pytest.mark.parametrize(
    ("told", "where"),
    [
        ([], "rays"),
        ({"camera.calibration": "/etc/passwd"}, "rays"),
        ({"targets[0].file": "x.stl"}, "rays"),
        ({"sources[0].ies": "x.ies"}, "rays"),
        ({OPENING: 0.4}, OPENING),
        ({OPENING: "1" * 201}, OPENING),
        ({ROTATION: "20 deg"}, ROTATION),
    ],
)
def test_nothing_else_is_taken(told: Any, where: str) -> None:
    with pytest.raises(InputError) as raised:
        ray_changes(told, scene())
    assert raised.value.where == where


@pytest.fixture
def session(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Session]:
    """With a coarse picture of a picture as small as those of tests."""
    monkeypatch.setattr(coarse, "WORTH_IT", 1)
    monkeypatch.setattr(coarse, "MOST_PIXELS", 130)
    (tmp_path / "work").mkdir()
    recipe = Recipe(("radwrap", "render", "x.toml", "--basis"), "x.toml", {"camera.gain": 2}, {"tolerance": 2.0})
    found = Session(scene(), OPTIONS, work=tmp_path / "work", out=None, recipe=recipe)
    found.trace()
    seen(found)
    yield found
    found.close()


def test_a_turn_is_the_render_of_the_changed_scene(session: Session, tmp_path: Path) -> None:
    first = session.traced()
    session.trace_with({**ray_knobs(scene()), OPENING: "0.2 mm", ROTATION: "10 deg, 6 deg, -2 deg"})
    before, *pictures = seen(session)
    assert before is first and session.status.state == "ready"
    rough, last = pictures
    assert rough.coarse is not None and rough.replaces == first.number  # its knobs go on, and so on
    assert last.coarse is None and last.replaces == rough.number and last.ray_knobs[OPENING] == "0.2 mm"
    changes = {OPENING: "0.2 mm", ROTATION: ["10 deg", "6 deg", "-2 deg"]}
    other = scene(**changes)
    radwrap.render(other, tmp_path / "alone", basis=True, **OPTIONS)
    assert hashes(last.folder) == hashes(tmp_path / "alone")
    assert not first.folder.exists() and not rough.folder.exists()  # nothing piles up
    command, python = last.lines(Turn((1.0, 1.0)), last.image(Turn((1.0, 1.0))))
    words = shlex.split(command.partition(" && ")[0])
    assert words[:4] == ["radwrap", "render", "x.toml", "--basis"] and words[-2:] == ["--out", last.folder.name]
    assert changes_of([words[k + 1] for k, word in enumerate(words) if word == "--set"]) == changes
    assert f"radwrap.load_scene('x.toml', { ({'camera.gain': 2} | changes)!r})" in python
    assert json.loads(last.scene.document)["camera"]["aperture"]["diameter"] == "0.2 mm"


@pytest.mark.long
def test_a_wrong_value_leaves_the_picture(session: Session) -> None:
    first = session.traced()
    for told in ({OPENING: "0.2 deg"}, {OPENING: "-1 mm"}, {ROTATION: "nan deg, 0 deg, 0 deg"}):
        with pytest.raises(InputError):
            session.trace_with(told)
    session.trace_with(ray_knobs(scene()))  # as it is: nothing to trace
    assert session.status.state == "ready" and session.traced() is first


@pytest.mark.long
def test_of_many_turns_the_last_one_counts(session: Session) -> None:
    renderer = session.renderer_pid
    start = time.monotonic()
    for k in range(1, 6):
        session.trace_with({OPENING: f"0.{k} mm"})
    assert time.monotonic() - start < 5 * 2.0  # each is asked to stop, and does
    last = seen(session)[-1]
    assert session.status.state == "ready" and last.ray_knobs[OPENING] == "0.5 mm"
    assert last.described()["ray_knobs_of_file"] == ray_knobs(scene())
    assert session.renderer_pid == renderer  # it stayed warm


@pytest.mark.long
def test_a_trace_that_was_stopped_goes_on_with_its_values(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    show = session._show

    def stops(found: Any) -> None:
        show(found)
        session.stop()

    monkeypatch.setattr(session, "_show", stops)
    session.trace_with({OPENING: "0.2 mm"})
    assert seen(session)[-1].coarse is not None and session.status.state == "stopped"
    monkeypatch.undo()
    session.trace()
    last = seen(session)[-1]
    assert last.coarse is None and last.ray_knobs[OPENING] == "0.2 mm"


def test_the_server_takes_values_and_says_what_is_wrong(served: Served) -> None:
    described = served.ready()
    basis, rays = described["basis"], described["ray_knobs"]
    assert rays[OPENING] == "0.4 mm"
    wrong = served.post("/api/trace", {"basis": basis, "rays": {OPENING: "0.2 deg"}})
    assert wrong.status == 422 and OPENING in wrong.json["where"]
    assert served.post("/api/trace", {"basis": basis, "rays": {"camera.calibration": "x"}}).json["where"] == "rays"
    assert served.post("/api/trace", {"basis": basis + 1, "rays": rays}).json["where"] == "basis"
    assert served.post("/api/trace", {"basis": basis, "rays": rays}).status == 200  # as they are
    assert served.ready()["basis"] == basis
