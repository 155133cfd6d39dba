"""How far work is: shares, time left, and that nobody says it is done before it is."""

from __future__ import annotations

import io

import pytest

from radwrap import progress as module
from radwrap.progress import Progress


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time that progress sees."""
    now = [100.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    return now


def test_time_left_is_by_the_speed_so_far(clock: list[float]) -> None:
    told = io.StringIO()
    work = Progress("tracing", 200, stream=told)
    clock[0] += 20
    work.add(50)
    assert told.getvalue() == "tracing  25 %, 1 min 00 s left\n"
    assert work.state.seconds_left == pytest.approx(60)
    work.left(50)  # half of it is done after all
    assert work.state.seconds_left == pytest.approx(20) and work.state.of == 100


def test_work_beyond_its_forecast_is_not_said_to_be_done(clock: list[float]) -> None:
    told = io.StringIO()
    work = Progress("tracing", 100, stream=told)
    clock[0] += 20
    work.add(101)
    clock[0] += 20
    work.add(29)
    assert told.getvalue() == "tracing 100 %, 0 s left\ntracing takes longer than was forecast, 1.30 times so far\n"
    assert work.state.seconds_left is None and work.state.of == 130


def test_parts_that_are_left_count_as_much_as_the_others(clock: list[float]) -> None:
    """Of four parts two are done, of 100 and of 200 units, and half of the third, which is to have 150."""
    told = io.StringIO()
    work = Progress("tracing", 100, stream=told)
    for left, total, done in ((3, 100, 100), (2, 200, 200), (1, 150, 75)):
        work.begin_part(left)
        work.expect(total)
        clock[0] += done / 5
        work.add(done)
    # 450 units of three parts, 600 of four; 375 done in 75 s.
    assert (work.state.done, work.state.of) == (375, 600)
    assert work.state.seconds_left == pytest.approx(45)
    assert told.getvalue().splitlines()[-1] == "tracing  62 %, 45 s left"
    work.restart()
    assert (work.state.done, work.state.of) == (0, 1)
