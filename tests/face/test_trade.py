"""What accuracy costs, as a job of the page: in the light of its knobs, told on the way, ended with who asked."""

from __future__ import annotations

import http.client
import json
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import pytest

import radwrap
from radwrap.errors import Cancelled, InputError
from radwrap.face.renderer import Renderer
from radwrap.face.saving import scene_text
from radwrap.face.session import Session
from radwrap.face.trading import longest_of
from radwrap.imaging.render_options import RenderOptions
from radwrap.scene.file.turned import with_levels
from radwrap.study.trade import measure_trade
from radwrap.study.trade_rows import TradeOptions
from tests.cli.conftest import SLOWER, here, scene_with
from tests.face.conftest import PATIENCE, TWO, Served, serving
from tests.face.test_matters import _traced, _turn

OPTIONS: Final[dict[str, Any]] = {"tolerance": 2.0, "tracer": "radiance"}
SHORT: Final = TradeOptions(longest=0.001, reference_pixels=50, reference_rays=16, render=RenderOptions(**OPTIONS))


def lines(served: Served, told: Mapping[str, Any]) -> Iterator[Any]:
    """What the server says of a trade, line by line; who stops listening hangs up."""
    connection = http.client.HTTPConnection("127.0.0.1", served.port, timeout=PATIENCE)
    try:
        head = {"Authorization": f"Bearer {served.token}", "Content-Type": "application/json"}
        connection.request("POST", "/api/trade", json.dumps(told), head)
        answer = connection.getresponse()
        assert answer.status == 200, answer.read()
        while line := answer.readline():
            yield json.loads(line)
    finally:
        connection.close()


def test_it_tells_how_far_it_is_and_ends_when_asked(tmp_path: Path) -> None:
    """A setting is refused where it would take longer, so that all of it takes little here."""
    scene, seen = radwrap.scene_from_document(scene_with(TWO)), list[tuple[str, int, int]]()
    told = measure_trade(scene, tmp_path, SHORT, told=lambda what, state: seen.append((what, state.done, state.of)))
    assert len(told.rows) <= 1 and told.left_out  # one ray a pixel takes about so long
    assert all(done <= of for _, done, of in seen) and {what for what, _, _ in seen} <= {"reference", "settings"}
    reference = [done for what, done, _ in seen if what == "reference"]
    assert reference == sorted(reference)
    with pytest.raises(Cancelled):
        measure_trade(scene, tmp_path / "ended", SHORT, cancelled=lambda: True)
    assert not list((tmp_path / "ended" / "settings").iterdir())


@pytest.mark.parametrize("told", [None, 10, "10", "10 mm", "-1 s", "nan s", "1e308 s", "1e999 s", "0 s", "", "9" * 99])
def test_what_is_no_time_is_one_clear_error(told: object) -> None:
    with pytest.raises(InputError) as caught:
        longest_of(told)
    assert caught.value.where == "longest" and len(str(caught.value)) < 200


def test_times_are_taken_with_their_units() -> None:
    assert longest_of("10 s") == 10.0 and longest_of(" 250 ms ") == 0.25


def test_who_asked_ends_it_and_nobody_else_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    session = Session(radwrap.scene_from_document(scene_with(TWO)), OPTIONS, work=tmp_path, out=None, recipe=None)
    measuring, ended, asked = threading.Event(), list[Cancelled](), dict[str, Any]()

    def trades(self: Renderer, request: Mapping[str, Any], told: Callable[[Any], object]) -> Any:
        asked.update(request)
        told({"what": "settings", "done": 1, "of": 2})
        measuring.set()
        assert self._stop.wait(PATIENCE)
        raise Cancelled("was stopped", where="renderer")

    monkeypatch.setattr(Renderer, "trade", trades)
    steps: list[Any] = []
    traced = _traced(session, wait=False)

    def trade() -> None:
        try:
            session.trade(traced, _turn(), 5.0, heard)
        except Cancelled as error:
            ended.append(error)

    heard = steps.append
    thread = threading.Thread(target=trade)
    thread.start()
    try:
        assert measuring.wait(PATIENCE)
        with pytest.raises(InputError, match="under way"):
            session.effects(traced, _turn())
        session.end_trade(lambda _: None)  # another's
        thread.join(0.1)
        assert thread.is_alive() and not ended
    finally:
        session.end_trade(heard)
        thread.join(PATIENCE)
        measuring.clear()
        with pytest.raises(Cancelled):  # who asked was gone before it began
            session.trade(traced, _turn(), 5.0, heard, lambda: True)
        session.close()
    assert ended and steps == [{"what": "settings", "done": 1, "of": 2}] and not measuring.is_set()
    assert asked["longest"] == 5.0 and asked["keeps"] is False and Path(asked["out"]) == tmp_path / "trade"


def test_the_next_one_waits_for_the_end_of_one_that_was_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A page that stops a trade and begins another at once is not refused for the first one's last moments."""
    session = Session(radwrap.scene_from_document(scene_with(TWO)), OPTIONS, work=tmp_path, out=None, recipe=None)
    begun, may_end, found = threading.Event(), threading.Event(), list[Any]()

    def trades(_: Renderer, request: Mapping[str, Any], told: Callable[[Any], object]) -> Any:
        del told
        if request["longest"] == 5.0:
            begun.set()
            assert may_end.wait(PATIENCE)
            raise Cancelled("was stopped", where="renderer")
        return {"longest": request["longest"]}

    def first() -> None:
        with pytest.raises(Cancelled):
            session.trade(traced, _turn(), 5.0, lambda _: None)

    monkeypatch.setattr(Renderer, "trade", trades)
    traced = _traced(session, wait=False)
    threads = [
        threading.Thread(target=first),
        threading.Thread(target=lambda: found.append(session.trade(traced, _turn(), 7.0, lambda _: None))),
    ]
    threads[0].start()
    try:
        assert begun.wait(PATIENCE)
        threads[1].start()
        threads[1].join(0.1)
        assert threads[1].is_alive() and not found
    finally:
        may_end.set()
        for thread in threads:
            thread.join(PATIENCE)
        session.close()
    assert found == [{"longest": 7.0}]


@pytest.mark.long
def test_what_a_lost_renderer_ends_is_told_and_goes_on(tmp_path: Path) -> None:
    with serving(tmp_path, {**TWO, **SLOWER}, "--tolerance", 8) as served:
        basis = served.ready()["basis"]
        trade = lines(served, {"basis": basis, "longest": "60 s"})
        assert next(line for line in trade if line["progress"])["progress"]["what"] == "reference"
        # A tracer that it has just forked is called so too, until it becomes a program of its own.
        renderer = next(one for one in served.family() if "radwrap.face.renderer" in one.cmdline())
        renderer.kill()
        refused = next(line["refused"] for line in trade if "refused" in line)
        assert refused["text"] == "renderer: ended by itself, or was killed; measure again"
        assert served.post("/api/turn", {"basis": basis}).status == 200
        trade = lines(served, {"basis": basis, "longest": "60 s"})
        assert next(line for line in trade if line["progress"])["progress"]["what"] == "reference"
        assert served.post("/api/trace", {}).status == 200  # it needs the renderer
        refused = next(line["refused"] for line in trade if "refused" in line)
        assert refused["text"] == "renderer: was stopped; measure again"


@pytest.mark.long
def test_it_is_that_of_the_command_in_the_same_light(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Errors and rays to the last digit; times are of another run."""
    with serving(tmp_path / "served") as served:
        basis = served.ready()["basis"]
        turn = {"levels": [0.5, 2.0], "knobs": {}}
        *steps, last = lines(served, {"basis": basis, "turn": turn, "longest": "20 s"})
        assert steps[0] == {"progress": None}
        told = [one["progress"] for one in steps[1:]]
        assert {one["what"] for one in told} == {"reference", "settings"} and all(o["done"] <= o["of"] for o in told)
        found = last["found"]
        assert (served.out / "trade" / "trade.csv").is_file()
    scene = with_levels(radwrap.scene_from_document(scene_with(TWO)), {"lamp": 0.5, "second": 2.0}, {})
    path = tmp_path / "turned.toml"
    path.write_text(scene_text(scene))
    argv = ["trade", path, "--tolerance", 2, "--tracer", "radiance", "--longest", "20 s", "--out", tmp_path / "out"]
    alone = here([*argv, "--json"], capsys).success().json
    keys = ("rays", "rms_gray", "rms_gray_upper")
    ours, theirs = ({row["options"]: [row[key] for key in keys] for row in one["settings"]} for one in (found, alone))
    both = ours.keys() & theirs.keys()  # which settings take too long hangs on the clock
    assert len(both) >= 10 and {name: ours[name] for name in both} == {name: theirs[name] for name in both}
    assert found["tolerance"] == 2.0 and any(row["front"] for row in found["settings"])
    assert found["reference"] == alone["reference"]["rms_gray"] and "use `--method" in found["recommendation"]


def first_word(served: Served, basis: int) -> Any:
    """What a trade says first, once it has begun or was refused; then it is hung up."""
    return next(line for line in lines(served, {"basis": basis, "longest": "60 s"}) if line.get("progress", True))


def test_who_hangs_up_ends_it(tmp_path: Path) -> None:
    """The renderer is free again, and takes the next request."""
    with serving(tmp_path, {**TWO, **SLOWER}, "--tolerance", 8) as served:
        basis = served.ready()["basis"]
        wrong = served.post("/api/trade", {"basis": basis, "longest": "ten"})
        assert wrong.status == 422 and wrong.json["where"] == "longest"
        assert served.post("/api/trade", {"basis": basis + 1, "longest": "9 s"}).status == 422
        assert first_word(served, basis)["progress"]["what"] == "reference"
        end = time.monotonic() + PATIENCE
        while "refused" in (again := first_word(served, basis)):
            assert "under way" in again["refused"]["text"] and time.monotonic() < end, again
        assert again["progress"]["what"] == "reference"
        assert served.post("/api/pixel", {"basis": basis, "column": 1, "row": 1}).status == 200
