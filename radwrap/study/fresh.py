"""Fresh renders: systems that a study did not look at, rendered with seeds that it did not use."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from radwrap.errors import InputError
from radwrap.progress import Progress
from radwrap.random_streams import Studying
from radwrap.study.design import Design
from radwrap.study.factors import Draw, Factor, Level
from radwrap.study.pilots import Plans
from radwrap.study.pool import Pool
from radwrap.study.responses import Response
from radwrap.study.runner import Scheduler
from radwrap.study.runs import Run, run_with
from radwrap.study.sampled import sampled, with_pilots
from radwrap.study.study import StudyOptions, plan_steps
from radwrap.study.worker import Outcome

FRESH_ROW: Final = int(Studying.FRESH_ROW)

# Levels of all factors, and the row that decides what random ones draw.
System = tuple[tuple[Level, ...], int]


@dataclass
class _Collected:
    """Outcomes by the number of their run."""

    outcomes: dict[int, Outcome] = field(default_factory=dict)

    def save(self, outcomes: Sequence[Outcome]) -> None:
        """Keep them."""
        self.outcomes.update({outcome.run: outcome for outcome in outcomes})


class FreshRenders:
    """Renders of systems by some fresh seeds each, and what is measured on them.

    Parameters
    ----------
    design : Design
        The study.
    out : Path
        Its folder; images are kept there.
    response : Response
        What is measured.
    options : StudyOptions
    pool : Pool
    repeats : int
        Seeds for each system.
    plans : Mapping, optional
        How the study's runs are sampled: fresh renders are too.

    Attributes
    ----------
    not_met : int
        Images so far that miss the tolerance of their render.
    """

    def __init__(
        self,
        design: Design,
        out: Path,
        response: Response,
        options: StudyOptions,
        pool: Pool,
        *,
        repeats: int,
        plans: Plans | None = None,
    ) -> None:
        # A system draws for itself, also where the runs of a study share what is drawn.
        factors = tuple(replace(factor, draw_once=False) for factor in design.factors)
        self._design = replace(design, factors=factors, basis=False)
        self._out, self._options, self._pool = out, options, pool
        self._response, self._repeats = response, repeats
        self._plans = plans or {}
        self.not_met = 0

    def runs(self, systems: Sequence[System]) -> list[Run]:
        """The runs of some systems, `repeats` in a row for each: equal scenes, and rays of other seeds."""
        runs: list[Run] = []
        for levels, row in systems:
            system = run_with(self._design, levels, index=0, replicate=self._design.replicates, row=row)
            wanted = tuple(response for response in system.responses if response.name == self._response.name)
            for repeat in range(self._repeats):
                runs.append(replace(system, index=len(runs) + 1, seed=system.seed + repeat, responses=wanted))
        return runs

    def measured(self, systems: Sequence[System]) -> list[list[float]]:
        """The response of each system for each fresh seed, in its unit.

        Raises
        ------
        InputError
            If one cannot be measured.
        """
        runs = self.runs(systems)
        steps, _ = plan_steps(self._design, runs, self._out, self._options)
        shown = self._options.progress
        # The study's plans; only a factor that is an option of the render, between its levels, needs one of its own.
        self._plans = with_pilots(steps, self._plans, self._out, self._pool, shown=shown)
        steps = sampled(steps, self._plans)
        collected = _Collected()
        progress = Progress("fresh renders", len(runs), shown=self._options.progress)
        try:
            Scheduler(steps, collected, self._pool, progress).run()
        finally:
            progress.close()
        values = [self._value(collected.outcomes[run.index]) for run in runs]
        return [values[first : first + self._repeats] for first in range(0, len(values), self._repeats)]

    def _value(self, outcome: Outcome) -> float:
        if outcome.error:
            raise InputError(outcome.error, where="a fresh render")
        self.not_met += not outcome.met
        return outcome.answers[self._response.name].value / self._response.scale


def nominal_level(factor: Factor) -> Level:
    """Where a factor stands while others are looked at: its first level that draws nothing, or the middle of a range.

    A factor whose levels all draw stands at the means of the first.
    """
    if not factor.levels:
        return factor.level_at(0.5)
    fixed = next((level for level in factor.levels if not level.is_random), None)
    if fixed is not None:
        return fixed
    first = factor.levels[0]
    values = tuple(value.mean if isinstance(value, Draw) else value for value in first.values)
    return Level(f"mean of {first.name}", values)
