"""The table of a study: a row for each run, on the disk as soon as it is finished, in the order of runs at the end."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from radwrap.errors import InputError
from radwrap.files import disk_failure, write_bytes
from radwrap.reading import read_bytes, whole_number
from radwrap.study.design import Design
from radwrap.study.runs import Run
from radwrap.study.table import TABLE, csv_text, read_table
from radwrap.study.worker import Outcome

RESULTS: Final = "results.csv"
TIMINGS: Final = "timings.csv"
_TIMING: Final = ("run", "wall_s")


def columns_of(design: Design) -> tuple[str, ...]:
    """Headings of the table of results."""
    factors = [factor.name for factor in design.factors]
    responses = [column for response in design.responses for column in (response.column, response.error_column)]
    return ("run", "replicate", "seed", *factors, *responses, "image_error", "met", "warnings", "error")


class Journal:
    """results.csv and timings.csv of a study, open for the rows to come.

    Parameters
    ----------
    folder : Path
        Of the study.
    design : Design
    runs : sequence of Run
    """

    def __init__(self, folder: Path, design: Design, runs: Sequence[Run]) -> None:
        self._folder = folder
        self._design = design
        self._columns = columns_of(design)
        self._runs = {run.index: run for run in runs}
        self._prepare()

    @property
    def path(self) -> Path:
        """The table of results."""
        return self._folder / RESULTS

    def finished(self) -> dict[int, Mapping[str, str]]:
        """Number -> row of every run that is finished, failed ones too.

        Raises
        ------
        InputError
            If a row is not one that this study wrote: somebody changed the table.
        """
        found: dict[int, Mapping[str, str]] = {}
        for number, row in enumerate(read_table(self.path).rows, 1):
            index = whole_number(row["run"]) or 0
            run = self._runs.get(index)
            fault = "its run is not one of the study's, or appears twice"
            if run is None or index in found or (fault := self._fault(run, row)):
                raise InputError(
                    f"row {number} is not as the study wrote it: {fault}",
                    where=str(self.path),
                    remedy="delete the row, and its run is done again, or choose another `out`",
                )
            found[index] = row
        return found

    def _fault(self, run: Run, row: Mapping[str, str]) -> str:
        """What of a row cannot come from its run; empty where nothing is wrong."""
        for column, known in self._identity(run).items():
            if row[column] != str(known):
                return f'{column} is "{row[column]}", not "{known}"'
        pairs = [(response.column, response.error_column) for response in self._design.responses]
        for column in (*(column for pair in pairs for column in pair), "image_error"):
            if row[column] and not _is_finite(row[column]):
                return f'{column} is "{row[column]}", no finite number'
        if any(bool(row[value]) != bool(row[error]) for value, error in pairs):
            return "a value without its error, or an error without its value"
        if not row["error"] and not all(row[value] for value, _ in pairs):
            return "a response is missing"
        return "" if row["met"] in ("", "0", "1") else f'met is "{row["met"]}"'

    def _identity(self, run: Run) -> dict[str, Any]:
        """The columns that say which run it is."""
        levels = {factor.name: level.name for factor, level in zip(self._design.factors, run.levels, strict=True)}
        return {"run": run.index, "replicate": run.replicate, "seed": run.seed, **levels}

    def _prepare(self) -> None:
        """Start the files, or cut off the line that a killed study did not end."""
        for path, columns in ((self.path, self._columns), (self._folder / TIMINGS, _TIMING)):
            if not path.exists():
                write_bytes(path, csv_text(columns, ()).encode())
                continue
            content = read_bytes(path, TABLE)
            whole = content[: content.rfind(b"\n") + 1]
            if not whole.startswith(csv_text(columns, ()).encode()):
                raise InputError("is not the table of this study", where=str(path), remedy="choose another `out`")
            if whole != content:
                write_bytes(path, whole)

    def forget(self, runs: Sequence[int]) -> None:
        """Take rows out, so that their runs are done again."""
        rows = [row for number, row in self.finished().items() if number not in runs]
        write_bytes(self.path, csv_text(self._columns, rows).encode())

    def save(self, outcomes: Sequence[Outcome]) -> None:
        """Add rows; they are on the disk when this returns."""
        _append(self.path, csv_text(self._columns, [self._row(outcome) for outcome in outcomes], header=False))
        timings = [{"run": outcome.run, "wall_s": outcome.wall_s} for outcome in outcomes]
        _append(self._folder / TIMINGS, csv_text(_TIMING, timings, header=False))

    def _row(self, outcome: Outcome) -> dict[str, Any]:
        run = self._runs[outcome.run]
        row = self._identity(run)
        for response in self._design.responses:
            answer = outcome.answers.get(response.name)
            if answer is not None:
                row[response.column] = answer.value / response.scale
                row[response.error_column] = answer.error / response.scale
        met = "" if outcome.image_error is None else int(outcome.met)
        told = {"warnings": outcome.warnings, "error": outcome.error}
        return {**row, "image_error": outcome.image_error, "met": met, **told}

    def close(self) -> list[Mapping[str, str]]:
        """Put the rows in order; returns them."""
        rows = [row for _, row in sorted(self.finished().items())]
        write_bytes(self.path, csv_text(self._columns, rows).encode())
        return rows


def _is_finite(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def _append(path: Path, text: str) -> None:
    left = memoryview(text.encode())
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_APPEND)
        try:
            while left:  # a disk that is nearly full takes a part, and refuses the rest
                left = left[os.write(descriptor, left) :]
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
    except OSError as error:
        raise disk_failure(path, error) from error
