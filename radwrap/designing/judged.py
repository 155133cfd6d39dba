"""Which trial is best, which are as good within their errors, what is not beaten in both objectives, what limits it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from radwrap.designing.document import Problem
from radwrap.designing.quantities import TIE, is_tie
from radwrap.designing.trials import Trial
from radwrap.study.seen import Answer

# Of a limit, or of the way from bound to bound: so near a value counts as held by it.
_AT_LIMIT: Final = 0.02
_AT_BOUND: Final = 0.01


def ranked(problem: Problem, trials: Sequence[Trial]) -> list[Trial]:
    """Feasible trials, the best one first; of two objectives the front first, from its middle outwards."""
    good = [trial for trial in trials if trial.is_feasible(problem)]
    if len(problem.objectives) == 1:
        return sorted(good, key=lambda trial: (_sizes(problem, trial)[0], trial.number))
    front = pareto_front(problem, good)
    return sorted(front, key=lambda trial: (_distance(problem, front, trial), trial.number))


def pareto_front(problem: Problem, trials: Sequence[Trial]) -> list[Trial]:
    """Feasible trials that no other one beats: by no objective worse, and better by one."""
    good = [trial for trial in trials if trial.is_feasible(problem)]
    sizes = {trial.number: _sizes(problem, trial) for trial in good}

    def beats(one: Trial, other: Trial) -> bool:
        pairs = list(zip(sizes[one.number], sizes[other.number], strict=True))
        return all(a <= b for a, b in pairs) and any(a < b for a, b in pairs)

    return [trial for trial in good if not any(beats(other, trial) for other in good)]


def ties_of(problem: Problem, best: Trial, trials: Sequence[Trial]) -> list[Trial]:
    """Other feasible trials whose objectives all differ from the best one's by no more than errors may explain."""
    first = best.objectives(problem) or []
    return [
        trial
        for trial in trials
        if trial.number != best.number and trial.is_feasible(problem) and _are_ties(first, trial.objectives(problem))
    ]


def _are_ties(first: Sequence[Answer], second: Sequence[Answer] | None) -> bool:
    return second is not None and all(is_tie(a, b) for a, b in zip(first, second, strict=True))


def shortlist(problem: Problem, trials: Sequence[Trial], most: int) -> list[Trial]:
    """The trials that may be best, as far as errors allow, in the order in which they look so."""
    maybe = [trial for trial in trials if trial.may_be_feasible(problem)]
    if not maybe:
        return []
    # A limit that is broken within its error does not make a candidate look better than it is to be: it comes later.
    order = sorted(maybe, key=lambda one: (not one.is_feasible(problem), _merit(problem, maybe, one), one.number))
    if len(problem.objectives) == 2:
        return order[:most]
    best = order[0].objectives(problem) or []
    sign = problem.objectives[0].sign
    found = []
    for trial in order:
        objectives = trial.objectives(problem) or []
        is_better = sign * objectives[0].value < sign * best[0].value
        if is_better or _are_ties(best, objectives):
            found.append(trial)
    return found[:most]


def _merit(problem: Problem, trials: Sequence[Trial], trial: Trial) -> float:
    """What a shortlist is ordered by: the objective, or how many beat the trial in both."""
    own = _sizes(problem, trial)
    if len(own) == 1:
        return own[0]
    return sum(all(a <= b for a, b in zip(_sizes(problem, other), own, strict=True)) for other in trials)


def _sizes(problem: Problem, trial: Trial) -> tuple[float, ...]:
    """Objectives as what is to become small."""
    answers = trial.objectives(problem) or []
    return tuple(one.sign * answer.value for one, answer in zip(problem.objectives, answers, strict=True))


def _distance(problem: Problem, front: Sequence[Trial], trial: Trial) -> float:
    """From the best values of the front, each objective as a share of what the front spans."""
    columns = list(zip(*(_sizes(problem, one) for one in front), strict=True))
    shares = []
    for own, column in zip(_sizes(problem, trial), columns, strict=True):
        span = max(column) - min(column)
        shares.append((own - min(column)) / span if span else 0.0)
    return math.hypot(*shares)


def limited_by(problem: Problem, best: Trial) -> list[str]:
    """What holds the best scene where it is: limits that it nearly breaks, and bounds that it lies at."""
    told = []
    for one in problem.constraints:
        ends = best.ends(one)
        if ends is None:
            continue
        for limit, answer in zip((one.low, one.high), ends, strict=True):
            room = abs(limit - answer.value)
            if math.isfinite(limit) and room <= max(_AT_LIMIT * abs(limit), TIE * answer.error):
                told.append(f"{one.told()}: it is {one.quantity.told(answer.value)}")
    for key, code in zip(problem.keys, best.codes, strict=True):
        if key.span is not None:
            low, high = key.span.low, key.span.high
            value = float(code)
            if key.span.is_log:
                low, high, value = math.log(low), math.log(high), math.log(value)
            share = (value - low) / (high - low)
            at = "low" if share <= _AT_BOUND else "high" if share >= 1 - _AT_BOUND else ""
        elif not key.keys:  # what is between objectives is no limit
            continue
        else:
            at = "first" if code == 0 else "last" if code == len(key.choices) - 1 else ""
            at = at if key.is_ordered else ""
        if at:
            told.append(f"{key.name} is at its {at} {'bound' if key.span else 'step'}, {key.label(code)}")
    for name in ("low", "high"):
        paths = best.light.get(f"at_{name}", ())
        if paths:
            more = f" and {len(paths) - 1} more" if len(paths) > 1 else ""
            told.append(f"{paths[0]}{more} at the {name} bound")
    return told
