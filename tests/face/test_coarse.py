"""A coarse picture stands in until the asked one is there, is marked as such, and changes no byte of it."""

from __future__ import annotations

import hashlib
import pickle
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.face import coarse as module
from radwrap.face.coarse import stages_of
from radwrap.face.recipe import Recipe
from radwrap.face.session import Session
from radwrap.face.traced import Traced
from radwrap.imaging.page.turn import Turn
from radwrap.scene.targets import MeshPart
from tests.cli.conftest import scene_with
from tests.face.conftest import PATIENCE, TWO
from tests.face.test_life import LONG, LONG_OPTIONS

SCENES: Final = Path(__file__).parents[2] / "rad_scenes"
OPTIONS: Final[dict[str, Any]] = {"tolerance": 0.5, "seed": 3, "tracer": "auto"}


def scene_of(rows: int, columns: int, **sensor: Any) -> radwrap.Scene:
    told = {"camera.sensor.rows": rows, "camera.sensor.columns": columns}
    return radwrap.scene_from_document(
        scene_with({**TWO, **told, **{f"camera.sensor.{k}": v for k, v in sensor.items()}})
    )


@pytest.mark.parametrize(
    ("rows", "columns", "blocks"),
    [
        (256, 256, (2,)),
        (495, 576, (3,)),
        (512, 512, (4,)),
        (1448, 1448, (8,)),
        (2048, 2448, (16, 4)),
        (2100, 2460, (15, 4)),
        (2053, 2459, (13, 4)),  # neither divides both sides
    ],
)
def test_they_have_few_pixels(rows: int, columns: int, blocks: tuple[int, ...]) -> None:
    found = stages_of(scene_of(rows, columns), OPTIONS)
    assert tuple(one.block for one in found) == blocks
    for one, block in zip(found, blocks, strict=True):
        sensor = one.scene.camera.sensor
        assert (sensor.rows, sensor.columns) == (rows // block, columns // block)
        assert one.options == {**OPTIONS, "tolerance": "2 %", "tracer": "compiled"}


def test_a_scale_that_the_scene_has_goes_on() -> None:
    (found,) = stages_of(scene_of(1024, 1024, scale="1/2"), OPTIONS)
    assert found.block == 4 and found.scene.camera.sensor.rows == 128


def test_there_is_none_where_it_is_not_worth_it() -> None:
    assert not stages_of(scene_of(20, 24), OPTIONS)
    assert stages_of(scene_of(256, 256), {**OPTIONS, "tolerance": "3 %"})  # fewer pixels all the same


def test_who_asks_for_a_tracer_gets_it() -> None:
    (found,) = stages_of(scene_of(256, 256), {**OPTIONS, "tracer": "radiance"})
    assert found.options["tracer"] == "radiance"


# --------------------------------------------------------------------------------------------------------- In a session


@pytest.fixture
def worth_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a picture as small as those of tests."""
    monkeypatch.setattr(module, "WORTH_IT", 1)
    monkeypatch.setattr(module, "MOST_PIXELS", 130)


@pytest.mark.parametrize("name", ["cells/ring.toml", "cells/backlight.toml", "bench_board/scene.toml"])
def test_the_renderer_gets_the_scene_as_it_is(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """With its meshes, and where it works itself: it reads no scene file."""
    monkeypatch.chdir(SCENES.parent)
    scene = radwrap.load_scene(Path(SCENES.name) / name)
    asked = pickle.loads(pickle.dumps(Session._request(scene, {"tolerance": 3.0})))  # noqa: S301  (our own)
    told = asked["scene"]
    assert told == scene and told.document == scene.document and asked["options"] == {"tolerance": 3.0}
    assert told.folder == (SCENES / name).parent
    for one, known in zip(told.targets, scene.targets, strict=True):
        assert not isinstance(known, MeshPart) or np.array_equal(one.mesh.corners, known.mesh.corners)


@pytest.fixture
def session(worth_it: None, tmp_path: Path) -> Iterator[Session]:
    del worth_it
    for name in ("work", "quick"):
        (tmp_path / name).mkdir()
    found = Session(
        scene_of(20, 24),
        {"tolerance": 2.0, "tracer": "radiance"},
        work=tmp_path / "work",
        out=None,
        recipe=Recipe(("x",), "s", {}, {}),
        quick=tmp_path / "quick",
    )
    yield found
    found.close()


def seen(session: Session) -> list[Traced]:
    """Every picture that was there, until nothing is traced any more."""
    found: list[Traced] = []
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        state, traced = session.status.state, session.present
        if traced is not None and traced not in found:
            found.append(traced)
        if state != "tracing":
            return found
        time.sleep(0.005)
    raise AssertionError("the trace did not end")


def hashes(folder: Path) -> dict[str, str]:
    """Of all files but the manifest, which holds times."""
    files = [path for path in folder.rglob("*") if path.is_file() and path.name != "manifest.json"]
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.mark.long
def test_it_stands_in_and_changes_no_byte(session: Session, tmp_path: Path) -> None:
    session.trace()
    first, last = seen(session)
    assert session.status.state == "ready"
    told = first.described()
    assert told["coarse"] == 2 and (told["rows"], told["columns"]) == (10, 12) and told["replaces"] == 0
    assert told["tolerance"] == pytest.approx(3.1)  # 2 % of 181 - 22, rounded down
    assert last.described()["coarse"] == 0 and last.described()["replaces"] == first.number
    assert first.sources == last.sources
    # The picture is told with its own error, and with no command: nobody wants it twice.
    image = first.image(Turn((1.0, 1.0)))
    assert 0 < first.told(Turn((1.0, 1.0)), image)["error"]["rms_gray_upper95"] < 3.1
    assert first.lines(Turn((1.0, 1.0)), image) == ("", "")
    assert last.lines(Turn((0.5, 1.0)), last.image(Turn((0.5, 1.0))))[0].startswith("x --out basis && radwrap relight")
    # Its light is that of the picture: both certificates hold.
    pictures = [one.image(Turn((2.0, 0.5))).relit for one in (first, last)]
    means = [one.gray.values.mean() for one in pictures]
    assert abs(means[0] - means[1]) < sum(one.certificate.rms_gray_upper95 for one in pictures)
    radwrap.render(scene_of(20, 24), tmp_path / "alone", basis=True, tolerance=2.0, tracer="radiance")
    assert hashes(last.folder) == hashes(tmp_path / "alone") and last.folder == tmp_path / "work" / "basis"
    assert first.folder.parent == tmp_path / "quick" and not first.folder.exists()  # it may lie in memory


@pytest.mark.long
def test_a_finer_one_follows_where_blocks_are_large(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each takes the place of the one before, and knows of which its knobs go on."""
    monkeypatch.setattr(module, "MOST_PIXELS", 30)
    monkeypatch.setattr(module, "LARGE_BLOCK", 4)
    session.trace()
    found = seen(session)
    assert [one.described()["coarse"] for one in found] == [4, 2, 0]
    assert [one.described()["replaces"] for one in found] == [0, found[0].number, found[1].number]
    assert not found[0].folder.exists() and found[-1].folder.exists()


@pytest.mark.long
def test_where_it_cannot_be_traced_the_picture_comes_all_the_same(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    render = session._renderer.render

    def fails(request: Any, told: Any) -> None:
        if request["options"]["tolerance"] == module.TOLERANCE:
            raise InputError("cannot be", where="coarse")
        render(request, told)

    monkeypatch.setattr(session._renderer, "render", fails)
    session.trace()
    (only,) = seen(session)
    assert only.coarse is None and only.replaces == 0 and session.status.state == "ready"


@pytest.mark.long
def test_it_stays_where_the_trace_is_stopped(worth_it: None, tmp_path: Path) -> None:
    """What it shows can be turned, not kept; a trace that is begun again needs no coarse picture."""
    del worth_it
    work = tmp_path / "work"
    work.mkdir()
    options = {"tolerance": LONG_OPTIONS[1], "tracer": "radiance"}
    session = Session(radwrap.scene_from_document(scene_with(LONG)), options, work=work, out=None, recipe=None)
    try:
        session.trace()
        end = time.monotonic() + PATIENCE
        while session.present is None:
            assert time.monotonic() < end, session.status
            time.sleep(0.005)
        session.stop()
        (first,) = seen(session)
        assert session.status.state == "stopped" and first.coarse is not None
        assert session.traced(first.number) is first
        with pytest.raises(InputError, match="coarse"):
            session.finished(first.number)
        with pytest.raises(InputError, match="coarse"):
            session.trace(Turn((0.5, 0.5)))
        before = set(work.glob("request_*.pickle"))
        session.trace()
        while not (more := set(work.glob("request_*.pickle")) - before):
            assert time.monotonic() < end + PATIENCE, session.status
            time.sleep(0.005)
        session.stop()
        assert seen(session) == [first]
        asked = [pickle.loads(path.read_bytes()) for path in more]  # noqa: S301  (our own)
        assert [request["options"]["tolerance"] for request in asked] == [options["tolerance"]]
    finally:
        session.close()


@pytest.mark.long
def test_a_stop_between_its_trace_and_the_next_is_not_lost(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    read = session._read

    def stopped(*given: Any, **more: Any) -> Traced:
        session.stop()
        return read(*given, **more)

    monkeypatch.setattr(session, "_read", stopped)
    session.trace()
    (first,) = seen(session)
    assert first.coarse is not None and session.status.state == "stopped"


@pytest.mark.long
def test_the_renderer_has_loaded_what_is_compiled_before_it_is_asked() -> None:
    """It took a fifth of the first picture's time."""
    warm = pytest.importorskip("radwrap.tracers.compiled.warm", exc_type=ImportError)
    code = (
        "from radwrap.face.warmth import load_tracer\n"
        "from radwrap.tracers.compiled.warm import is_warm\n"
        "before = is_warm()\n"
        "load_tracer()\n"
        "from radwrap.tracers.compiled.kernels import meet, trace\n"
        "print(before, all(one.overloads for one in (meet, trace)))\n"
    )
    warm.warm_up()
    assert (
        subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout == "True True\n"
    )
