"""Trials: what was rendered and measured, kept on the disk so that nothing is rendered twice."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from radwrap.designing.candidates import Candidate
from radwrap.designing.document import Problem
from radwrap.designing.keys import Code
from radwrap.designing.quantities import TIE, Constraint
from radwrap.designing.worker import LitOutcome
from radwrap.errors import InputError
from radwrap.files import write_bytes
from radwrap.manifest import SCHEMA_VERSION, read_manifest, sha256_of_value, write_manifest
from radwrap.study.seen import Answer
from radwrap.study.table import csv_text
from radwrap.study.worker import Outcome

TRIALS: Final = "trials.csv"
_SEAL: Final = "sha256"


@dataclass(frozen=True, slots=True)
class Trial:
    """A candidate and what it came to.

    Attributes
    ----------
    number : int
        From 1, in the order in which they were asked for.
    stage : str
        "search", "decide" or "check".
    seed : int
        Of its render.
    codes : tuple
        Of each searched key.
    values : Mapping
        Key path -> value of all that is set, levels that were found among them.
    answers : Mapping of str to Answer
        Quantity -> value and standard error, in SI, as far as it is known.
    image_error : float or None
        Certified bound of the image's rms error [gray level].
    met : bool
        Whether the image keeps its tolerance.
    is_rendered : bool
        Whether there is an image of it.
    error, warnings : str
        Why something is missing, and what gauges warn of.
    light : Mapping
        How levels were found; empty where none were sought.
    levels : Mapping
        Those that were found.
    corners : tuple of Mapping of str to Answer
        The same as `answers`, in each corner of the tolerances; empty where these do not count.
    """

    number: int
    stage: str
    seed: int
    codes: tuple[Code, ...]
    values: Mapping[str, Any]
    answers: Mapping[str, Answer]
    image_error: float | None
    met: bool
    is_rendered: bool
    error: str
    warnings: str
    light: Mapping[str, Any]
    levels: Mapping[str, Any]
    corners: tuple[Mapping[str, Answer], ...] = ()

    def extreme(self, name: str, sign: float) -> Answer | None:
        """The answer that is largest, or with a negative sign smallest, of the trial and its corners.

        None where one of them is not known.
        """
        found = [one.get(name) for one in (self.answers, *self.corners)]
        known = [one for one in found if one is not None]
        return max(known, key=lambda one: sign * one.value) if len(known) == len(found) else None

    def objectives(self, problem: Problem) -> list[Answer] | None:
        """Of each objective, the worst of all corners; None where one is missing."""
        found = [self.extreme(one.quantity.name, one.sign) for one in problem.objectives]
        known = [one for one in found if one is not None]
        return known if len(known) == len(found) else None

    def ends(self, one: Constraint) -> tuple[Answer, Answer] | None:
        """The smallest and the largest answer of what has limits; None where it is not known."""
        low, high = (self.extreme(one.quantity.name, sign) for sign in (-1.0, 1.0))
        return None if low is None or high is None else (low, high)

    def violations(self, problem: Problem) -> list[float]:
        """How far each limit is broken, as a share of it; 1 where it is not known.

        Levels that were solved for stand exactly on a limit that holds them, and another image of them lies on either
        side of it within its error: that breaks no limit.
        """
        found = []
        for one in problem.constraints:
            ends = self.ends(one)
            found.append(1.0 if ends is None else max(self._violation(one, end) for end in ends))
        return found

    def _violation(self, one: Constraint, end: Answer) -> float:
        is_held = bool(self.light) and _may_be_kept(one, end)
        return 0.0 if is_held else one.violation(end.value)

    def is_feasible(self, problem: Problem) -> bool:
        """Whether it has all objectives and keeps all limits."""
        return self.objectives(problem) is not None and not any(self.violations(problem))

    def may_be_feasible(self, problem: Problem) -> bool:
        """The same, but for limits that it breaks by no more than its errors."""
        if self.objectives(problem) is None:
            return False
        ends = ((one, self.ends(one)) for one in problem.constraints)
        return all(found is not None and all(_may_be_kept(one, end) for end in found) for one, found in ends)


def _may_be_kept(one: Constraint, end: Answer) -> bool:
    """Whether an answer breaks a limit by no more than its own error."""
    return one.excess(end.value) <= TIE * end.error


def trial_of(
    number: int,
    stage: str,
    seed: int,
    candidate: Candidate,
    record: Mapping[str, Any] | None,
    *,
    corners: Sequence[tuple[Candidate, Mapping[str, Any] | None]] = (),
) -> Trial:
    """A trial from its candidate and its record, and those of its corners; without one it was not rendered."""
    trial = _trial_of(number, stage, seed, candidate, record)
    if not corners:
        return trial
    others = [_trial_of(number, stage, seed, one, told) for one, told in corners]
    errors = [one.image_error for one in (trial, *others) if one.image_error is not None]
    return replace(
        trial,
        corners=tuple(one.answers for one in others),
        image_error=max(errors, default=None),
        met=all(one.met for one in (trial, *others)),
        error=next((one.error for one in (trial, *others) if one.error), ""),
        warnings=next((one.warnings for one in (trial, *others) if one.warnings), ""),
    )


def _trial_of(number: int, stage: str, seed: int, candidate: Candidate, record: Mapping[str, Any] | None) -> Trial:
    told = record or {"answers": {}, "image_error": None, "met": False, "error": candidate.fault, "warnings": ""}
    measured = {name: Answer(*pair) for name, pair in told["answers"].items()}
    return Trial(
        number=number,
        stage=stage,
        seed=seed,
        codes=candidate.codes,
        values=candidate.values,
        answers={**measured, **candidate.own},
        image_error=told["image_error"],
        met=told["met"],
        is_rendered=record is not None,
        error=told["error"],
        warnings=told["warnings"],
        light=told.get("light", {}),
        levels=candidate.levels,
    )


# ------------------------------------------------------------------------------------------------------------- records


def write_record(path: Path, outcome: Outcome) -> None:
    """Keep what a render came to; whole, or not at all."""
    told: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "answers": {name: [one.value, one.error] for name, one in outcome.answers.items()},
        "image_error": outcome.image_error,
        "met": bool(outcome.met),
        "error": outcome.error,
        "warnings": outcome.warnings,
    }
    if isinstance(outcome, LitOutcome):
        told |= {"levels": dict(outcome.levels), "light": dict(outcome.light)}
    write_manifest(path, {**told, _SEAL: sha256_of_value(told)})


def read_record(path: Path) -> dict[str, Any] | None:
    """What `write_record` kept; None where there is nothing.

    Raises
    ------
    InputError
        If it is not as it was written.
    """
    if not path.exists():
        return None
    told = read_manifest(path)
    if told.pop(_SEAL, None) != sha256_of_value(told):
        raise InputError("is not as it was written", where=str(path), remedy="delete it, and it is made again")
    return told


# --------------------------------------------------------------------------------------------------------------- table


def write_table(path: Path, problem: Problem, trials: Sequence[Trial]) -> None:
    """Write trials.csv: values of keys, quantities with their errors, and whether limits are kept."""
    names = [key.name for key in problem.keys]
    quantities = problem.quantities
    paths = list(dict.fromkeys(path for trial in trials for path in trial.levels))
    columns = ["trial", "stage", "seed", *names, *paths]
    for one in quantities:
        unit = f" [{one.unit}]" if one.unit else ""
        columns += [f"{one.name}{unit}", f"{one.name}_error{unit}"]
        if problem.allowed:
            columns += [f"{one.name}_least{unit}", f"{one.name}_most{unit}"]
    columns += ["image_error", "met", "feasible", "warnings", "error"]
    rows = []
    for trial in trials:
        row: dict[str, Any] = {"trial": trial.number, "stage": trial.stage, "seed": trial.seed}
        row |= {key.name: key.label(code) for key, code in zip(problem.keys, trial.codes, strict=True)}
        row |= {path: trial.levels.get(path) for path in paths}
        for one in quantities:
            answer = trial.answers.get(one.name)
            unit = f" [{one.unit}]" if one.unit else ""
            if answer is not None and math.isfinite(answer.value):
                row |= {
                    f"{one.name}{unit}": answer.value / one.scale,
                    f"{one.name}_error{unit}": answer.error / one.scale,
                }
            if trial.corners:
                for column, sign in (("least", -1.0), ("most", 1.0)):
                    end = trial.extreme(one.name, sign)
                    row[f"{one.name}_{column}{unit}"] = None if end is None else end.value / one.scale
        row |= {"image_error": trial.image_error, "feasible": int(trial.is_feasible(problem))}
        row |= {"met": int(trial.met) if trial.is_rendered else "", "warnings": trial.warnings, "error": trial.error}
        rows.append(row)
    write_bytes(path, csv_text(columns, rows).encode())
