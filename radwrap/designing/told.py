"""What a design found, as values, in words and as JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from radwrap.designing.document import Problem
from radwrap.designing.judged import limited_by
from radwrap.designing.quantities import TIE, Quantity, combined, is_tie
from radwrap.designing.trials import Trial
from radwrap.manifest import SCHEMA_VERSION, plain
from radwrap.study.seen import Answer

DESIGN: Final = "design.json"
BEST: Final = "best.toml"
_MOST_NAMED: Final = 8  # trials in one line


@dataclass(frozen=True, slots=True, eq=False)
class Designed:
    """A design that was carried out.

    Attributes
    ----------
    problem : Problem
        What was asked for.
    best : Trial or None
        The best trial at the tolerance asked for; None where none keeps all limits.
    check : Trial or None
        The best scene once more, by other rays.
    ties : tuple of Trial
        Others whose objectives differ from the best one's by no more than errors may explain.
    front : tuple of Trial
        With two objectives: trials that none beats in both.
    undecided : tuple of Trial
        Trials of the search that may be as good within its errors, and were not rendered finely, for lack of budget.
    trials : tuple of Trial
        All, in their order.
    renders : int
        Different images that it took.
    how : str
        How candidates were chosen.
    tolerance : float or None
        Of the images that decide [gray level].
    """

    problem: Problem
    best: Trial | None
    check: Trial | None
    ties: tuple[Trial, ...]
    front: tuple[Trial, ...]
    undecided: tuple[Trial, ...]
    trials: tuple[Trial, ...]
    renders: int
    how: str
    tolerance: float | None

    @property
    def met(self) -> bool:
        """Whether the images that the answer rests on keep their tolerance."""
        return all(trial is None or trial.met for trial in (self.best, self.check))

    @property
    def limits(self) -> tuple[str, ...]:
        """What holds the best scene where it is, in words."""
        return () if self.best is None else tuple(limited_by(self.problem, self.best))

    @property
    def doubts(self) -> tuple[str, ...]:
        """What the check by other rays makes doubtful, in words."""
        if self.best is None or self.check is None:
            return ()
        told = []
        for one in self.problem.constraints:
            ends = [trial.ends(one) for trial in (self.best, self.check)]
            if ends[0] is None or ends[1] is None:
                told.append(f"by other rays {one.quantity.name} is lost")
                continue
            for first, second in zip(*ends, strict=True):
                if one.excess(second.value) > TIE * combined(first, second):
                    told.append(f"by other rays {one.told()} is broken: {one.quantity.told(second.value)}")
                    break
        for aim in self.problem.objectives:
            first, second = (trial.extreme(aim.quantity.name, aim.sign) for trial in (self.best, self.check))
            if first is None or second is None:
                told.append(f"by other rays {aim.quantity.name} is lost")
            elif not is_tie(first, second):
                told.append(
                    f"by other rays {aim.quantity.name} is {aim.quantity.told(second.value)}, off by more than "
                    f"{TIE:g} combined errors"
                )
        return tuple(told)

    @property
    def manifest(self) -> dict[str, Any]:
        """What design.json holds."""
        return manifest_of(self)

    def lines(self) -> list[str]:
        """The answer in words, a line each."""
        if self.best is None:
            return [*self._nothing(), self._work()]
        told = [f"{path} = {value}" for path, value in self.best.values.items()]
        told += [f"{name}: {text}" for name, text in self._quantities(self.best)]
        if self.best.light:
            told.append(f"levels: {self.best.light['way']} on the light basis")
        told += [f"limited by {text}" for text in self.limits] or ["no limit and no bound holds it"]
        if self.ties:
            told.append(f"a tie within errors: trial {_numbers(self.ties)}")
        if self.undecided:
            told.append(f"not decided, as the budget is spent: trial {_numbers(self.undecided)} may be as good")
        if self.front:
            told.append(f"Pareto front: trial {_numbers(self.front)}")
        return [*told, *self.doubts, self._work()]

    def _work(self) -> str:
        return f"{len(self.trials)} trials by {self.renders} renders; candidates by {self.how}"

    def _nothing(self) -> list[str]:
        told = [f"no trial keeps all limits{self._unseen()}"]
        known = [trial for trial in self.trials if trial.objectives(self.problem) is not None]
        if known:
            nearest = min(known, key=lambda trial: (sum(trial.violations(self.problem)), trial.number))
            told.append(f"nearest is trial {nearest.number}: {', '.join(self._broken(nearest))}")
        elif failed := [trial for trial in self.trials if trial.error]:
            told.append(f"trial {failed[0].number}: {failed[0].error}")
        return told

    def _unseen(self) -> str:
        """Whether another candidate may keep them, where there is no end of choices but by the budget."""
        keys = self.problem.keys
        if any(key.span is not None for key in keys):
            return ""
        left = math.prod(len(key.choices) for key in keys) - len({trial.codes for trial in self.trials})
        return f"; {left} combinations were not looked at: raise the budget" if left else ""

    def _broken(self, trial: Trial) -> list[str]:
        found = []
        for one in self.problem.constraints:
            ends = trial.ends(one)
            if ends is None:
                found.append(f"{one.quantity.name} is not known")
                continue
            worst = max(ends, key=lambda end: one.violation(end.value))
            if one.excess(worst.value):
                own = trial.answers[one.quantity.name].value
                where = "" if one.excess(own) or not trial.corners else "within tolerances "
                found.append(f"{one.told()}, {where}it is {one.quantity.told(worst.value)}")
        return found or ["only a finer image breaks a limit"]

    def _quantities(self, trial: Trial) -> list[tuple[str, str]]:
        names = {one.quantity.name for one in self.problem.objectives}
        names |= {one.quantity.name for one in self.problem.constraints}
        found = []
        for one in self.problem.quantities:
            answer = trial.answers.get(one.name)
            if one.name in names and answer is not None:
                error = f" +- {answer.error / one.scale:.2g}" if answer.error else ""
                text = f"{answer.value / one.scale:.6g}{error} {one.unit}".strip()
                found.append((one.name, f"{text}{_within(trial, one)}"))
        return found


def _within(trial: Trial, one: Quantity) -> str:
    """What a quantity goes to in the corners of the tolerances."""
    low, high = (trial.extreme(one.name, sign) for sign in (-1.0, 1.0))
    if not trial.corners:
        return ""
    if low is None or high is None:
        return " (not known within tolerances)"
    return f" (within tolerances {one.told(low.value)} to {one.told(high.value)})"


def _numbers(trials: Sequence[Trial]) -> str:
    """Trials by their numbers, some of them where they are many."""
    named = ", ".join(str(trial.number) for trial in trials[:_MOST_NAMED])
    return f"{named} and {len(trials) - _MOST_NAMED} more" if len(trials) > _MOST_NAMED else named


def manifest_of(found: Designed) -> dict[str, Any]:
    """A design as JSON; nothing of it hangs on clocks, workers or the folder."""
    problem = found.problem
    return {
        "schema_version": SCHEMA_VERSION,
        "title": problem.study.title,
        "scene": problem.study.scene_origin,
        "seed": problem.study.seed,
        "budget": problem.budget,
        "objectives": [
            {"of": one.quantity.name, "aim": "maximise" if one.is_maximised else "minimise"}
            for one in problem.objectives
        ],
        "constraints": [one.told() for one in problem.constraints],
        "case": "worst" if problem.allowed else "nominal",
        "tolerance": found.tolerance,
        "coarse": problem.coarse,
        "candidates_by": found.how,
        "feasible": found.best is not None,
        "met": found.met,
        "best": None if found.best is None else _told(found, found.best),
        "check": None if found.check is None else _told(found, found.check),
        "limited_by": list(found.limits),
        "doubts": list(found.doubts),
        "ties": [_told(found, trial) for trial in found.ties],
        "tie_errors": TIE,
        "undecided": [trial.number for trial in found.undecided],
        "front": [_told(found, trial) for trial in found.front],
        "trials": len(found.trials),
        "renders": found.renders,
    }


def _told(found: Designed, trial: Trial) -> dict[str, Any]:
    quantities: dict[str, Any] = {}
    for one in found.problem.quantities:
        answer = trial.answers.get(one.name)
        if answer is not None:
            quantities[one.name] = {
                "value": answer.value / one.scale,
                "error": answer.error / one.scale,
                "unit": one.unit,
            }
            ends = [trial.extreme(one.name, sign) for sign in (-1.0, 1.0)] if trial.corners else []
            for name, end in zip(("least", "most"), ends, strict=False):
                quantities[one.name][name] = None if end is None else end.value / one.scale
    told = {
        "trial": trial.number,
        "stage": trial.stage,
        "values": plain(trial.values),
        "quantities": quantities,
        "image_error": trial.image_error,
        "met": trial.met,
    }
    if trial.light:
        told["levels_by"] = _light(trial.light)
    if found.best is not None and trial.number != found.best.number:
        told["combined_errors_from_best"] = _apart(found, trial)
    return told


def _light(light: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "way": light["way"],
        "objective_in_radiant_exposure": light["objective"],
        "at_low": list(light["at_low"]),
        "at_high": list(light["at_high"]),
    }


def _apart(found: Designed, trial: Trial) -> dict[str, float | None]:
    """By how many combined errors its objectives differ from the best one's; None where there is no error."""
    told: dict[str, float | None] = {}
    for one in found.problem.objectives:
        name = one.quantity.name
        first, second = (
            found.best.extreme(name, one.sign) if found.best is not None else None,
            trial.extreme(name, one.sign),
        )
        told[name] = _share(first, second)
    return told


def _share(first: Answer | None, second: Answer | None) -> float | None:
    if first is None or second is None:
        return None
    size, apart = combined(first, second), abs(first.value - second.value)
    return apart / size if size else (0.0 if math.isclose(apart, 0.0) else None)
