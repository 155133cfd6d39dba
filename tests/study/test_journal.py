"""A table of results that somebody changed is not gone on with; rows are written whole."""

from __future__ import annotations

import os
from collections.abc import Callable

import pytest

from radwrap.errors import InputError
from radwrap.study.design import read_design
from radwrap.study.journal import RESULTS, Journal
from radwrap.study.runs import runs_of
from radwrap.study.seen import Answer
from radwrap.study.worker import Outcome, failed
from tests.study.conftest import SMALL, DesignWriter

Opened = Callable[[], Journal]


@pytest.fixture
def opened(design: DesignWriter) -> Opened:
    """The journal of a study of four runs, one of which failed and one is due."""
    path = design(SMALL)
    study = read_design(path)

    def again() -> Journal:
        return Journal(path.parent, study, runs_of(study))

    answers = {"u": Answer(26.5, 0.03), "mean": Answer(88.25, 0.5)}
    again().save([Outcome(1, answers, 0.5, True, "", 1.0), Outcome(2, answers, 0.6, False, "", 1.0)])
    again().save([failed(3, "no edge, and a comma")])
    return again


def test_what_was_written_is_read_back(opened: Opened) -> None:
    rows = opened().finished()
    assert list(rows) == [1, 2, 3] and rows[2]["mean"] == "88.25" and rows[3]["error"] == "no edge, and a comma"


CHANGES = [
    ("\n1,1,5,", "\n99,1,5,", "not one of the study's"),
    ("\n1,1,5,", "\n2,1,5,", "s is"),
    ("\n1,1,5,", "\nabc,1,5,", "not one of the study's"),
    ("\n1,1,5,", "\n01,1,5,", "run is"),
    ("\n1,1,5,", "\n1,2,5,", "replicate is"),
    ("\n1,1,5,", "\n1,1,6,", "seed is"),
    ("\n1,1,5,1 mm,L", "\n1,1,5,2 mm,L", "x is"),
    ("\n1,1,5,1 mm,L", "\n1,1,5,1 mm,H", "s is"),
    ("26.5,", "nan,", "no finite number"),
    ("26.5,", "inf,", "no finite number"),
    ("26.5,", "words,", "no finite number"),
    ("26.5,0.03,", ",,", "a response is missing"),
    ("26.5,", ",", "without its value"),
    (",0.6,0,", ",0.6,maybe,", "met is"),
    ("\n2,1,5,1 mm,H", "\n1,1,5,1 mm,L", "appears twice"),
    ("run,replicate", "\ufeffrun,replicate", "not the table of this study"),
]


@pytest.mark.parametrize(("old", "new", "complaint"), CHANGES)
def test_a_changed_row_is_told(opened: Opened, old: str, new: str, complaint: str) -> None:
    path = opened().path
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=complaint) as refused:
        opened().finished()
    assert refused.value.where.endswith(RESULTS)


def test_a_row_that_is_deleted_is_due_again(opened: Opened) -> None:
    path = opened().path
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join([lines[0], *lines[2:]]))
    assert list(opened().finished()) == [2, 3]


def test_a_row_is_whole_where_the_disk_takes_a_part_at_a_time(opened: Opened, monkeypatch: pytest.MonkeyPatch) -> None:
    write = os.write
    monkeypatch.setattr(os, "write", lambda descriptor, content: write(descriptor, bytes(content[:7])))
    opened().save([failed(4, "why it failed")])
    monkeypatch.undo()
    assert opened().finished()[4]["error"] == "why it failed"
