"""Which tolerance on which factor keeps a response within bounds: by the study's model, confirmed by fresh renders.

Of a factor with numbers: how far it may lie off its nominal value. Of a factor with draws: by how much its scatter
may be widened or must be narrowed. All factors together: Monte Carlo on the model, then fresh random systems.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np

from radwrap.errors import InputError
from radwrap.files import sole_owner
from radwrap.progress import Progress
from radwrap.study.design import Design
from radwrap.study.factors import Draw, Factor, Level, number_and_unit
from radwrap.study.pool import Pool
from radwrap.study.responses import KINDS, Response
from radwrap.study.runner import Scheduler
from radwrap.study.runs import Run, run_with
from radwrap.study.study import Study, StudyOptions, open_pool, plan_steps, run_study
from radwrap.study.tolerance_model import Deviation, Model, deviation_of, fit
from radwrap.study.worker import Outcome
from radwrap.units import parse_quantity

TOLERANCES: Final = "tolerances.json"
_ROUNDS: Final = 6
# A change between these shares of the bound is near enough: the tolerance is then known to as much.
_ENOUGH: Final = (0.85, 1.0)
_AIM: Final = 0.95
_HIDDEN: Final = 1 / 3  # of the bound: where the scatter of fresh renders is larger, they confirm little
_SYSTEMS: Final = 8
_FRESH_ROW: Final = 1 << 20  # of draws: none that the study made


@dataclass(frozen=True, slots=True)
class Bound:
    """What a response may change by, in its unit."""

    response: Response
    relative: float | None
    absolute: float | None

    def at(self, nominal: float) -> float:
        """The largest change."""
        return self.absolute if self.absolute is not None else abs(nominal) * (self.relative or 0.0)


@dataclass(frozen=True, slots=True)
class Confirmed:
    """Change of the response at a deviation, by fresh renders: mean over seeds, and its standard error."""

    at: str
    change: float
    error: float


@dataclass(frozen=True, slots=True)
class Tolerance:
    """What one factor alone may be off by.

    Attributes
    ----------
    factor : Factor
    kind : str
        "deviation" from a nominal value, or "scatter" about it.
    tolerance : float
        In `unit`; of a scatter a factor on its width.
    unit, nominal, direction : str
        Unit; nominal value; "+-", "+" or "-".
    by_model : float
        What the study's model said before fresh renders.
    limited : bool
        Whether the study's range ends there and the bound was not reached.
    confirmed : tuple of Confirmed
    met : bool
        Whether fresh renders keep the bound.
    """

    factor: Factor
    kind: str
    tolerance: float
    unit: str
    nominal: str
    direction: str
    by_model: float
    limited: bool
    confirmed: tuple[Confirmed, ...]
    met: bool


@dataclass(frozen=True, slots=True)
class Together:
    """All deviations at a time.

    Attributes
    ----------
    scale : float
        Factor on every tolerance.
    share : float
        Of systems within the bound, by the model.
    inside, systems : int
        Of fresh random ones.
    """

    scale: float
    share: float
    inside: int
    systems: int


@dataclass(frozen=True, slots=True)
class Tolerances:
    """All that was found."""

    response: Response
    nominal: float
    bound: float
    share: float
    found: tuple[Tolerance, ...]
    together: Together | None
    left_out: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def met(self) -> bool:
        """Whether fresh renders confirm everything."""
        return all(one.met for one in self.found)


def read_bound(design: Design, response: str, within: str) -> Bound:
    """Read ``--within``: a share of the nominal response, or a change in its unit.

    Raises
    ------
    InputError
        If there is no such response, or it is no bound of it.
    """
    one = next((known for known in design.responses if known.name == response), None)
    if one is None:
        known_names = ", ".join(known.name for known in design.responses)
        raise InputError(f'no response "{response}"', where="--response", remedy=f"the design has {known_names}")
    text = within.strip()
    dimension = KINDS[one.kind].dimension
    try:
        if text.endswith("%"):
            relative = float(text[:-1]) / 100
            absolute = None
        else:
            relative = None
            absolute = float(text) if dimension is None else parse_quantity(text, dimension) / one.scale
    except ValueError as error:
        raise InputError(f'"{within}" is no bound', where="--within", remedy='say "0.1%"') from error
    except InputError as error:
        raise InputError(f"{error.what}", where="--within", remedy=f'{error.remedy}, or say "0.1%"') from error
    size = relative if absolute is None else absolute
    if size is None or not (math.isfinite(size) and size > 0):
        raise InputError("must be above zero", where="--within")
    return Bound(one, relative, absolute)


@dataclass
class _Collected:
    """Outcomes of fresh renders, by their number."""

    outcomes: dict[int, Outcome] = field(default_factory=dict)

    def save(self, outcomes: Sequence[Outcome]) -> None:
        """Keep them."""
        self.outcomes.update({outcome.run: outcome for outcome in outcomes})


class _Search:
    """Fresh renders of a study, and what they say of a response."""

    def __init__(
        self, study: Study, bound: Bound, options: StudyOptions, pool: Pool, *, repeats: int, share: float
    ) -> None:
        self.pool = pool
        self.design, self.out = study.design, study.folder
        self.bound, self.options, self.repeats, self.share = bound, options, repeats, share
        self.base = tuple(factor.levels[0] if factor.levels else factor.level_at(0.5) for factor in self.design.factors)
        deviations = [deviation_of(self.design, factor) for factor in self.design.factors]
        self.deviations = tuple(deviation for deviation in deviations if deviation is not None)
        for deviation in self.deviations:
            self.base = self.with_level(deviation.factor, deviation.level(deviation.nominal))
        self.notes: list[str] = []

    def with_level(self, factor: Factor, level: Level) -> tuple[Level, ...]:
        """The nominal system with one factor elsewhere."""
        names = [known.name for known in self.design.factors]
        place = names.index(factor.name)
        return (*self.base[:place], level, *self.base[place + 1 :])

    def measured(self, systems: Sequence[tuple[tuple[Level, ...], int]]) -> list[list[float]]:
        """The response of each system (its levels, and the row of its draws) for each fresh seed.

        Raises
        ------
        InputError
            If one cannot be measured.
        """
        runs: list[Run] = []
        for levels, row in systems:
            for repeat in range(self.repeats):
                replicate = self.design.replicates + repeat  # seeds that the study did not use
                runs.append(run_with(self.design, levels, index=len(runs) + 1, replicate=replicate, row=row))
        kept = {self.bound.response.name}
        runs = [replace(run, responses=tuple(r for r in run.responses if r.name in kept)) for run in runs]
        steps, _ = plan_steps(replace(self.design, basis=False), runs, self.out, self.options)
        collected = _Collected()
        progress = Progress("fresh renders", len(runs), shown=self.options.progress)
        try:
            Scheduler(steps, collected, self.pool, progress).run()
        finally:
            progress.close()
        values = [self._value(collected.outcomes[run.index]) for run in runs]
        return [values[first : first + self.repeats] for first in range(0, len(values), self.repeats)]

    def _value(self, outcome: Outcome) -> float:
        if outcome.error:
            raise InputError(outcome.error, where="a fresh render")
        return outcome.answers[self.bound.response.name].value / self.bound.response.scale

    def nominal(self) -> float:
        """The response of the nominal system."""
        self._nominal = self.measured([(self.base, _FRESH_ROW)])[0]
        return float(np.mean(self._nominal))

    def changes(self, factor: Factor, levels: Sequence[Level]) -> list[Confirmed]:
        """Change at each level of a factor, seed by seed: equal seeds draw equal rays, whose noise falls out."""
        values = self.measured([(self.with_level(factor, level), _FRESH_ROW) for level in levels])
        return [self._change(level.name, one) for level, one in zip(levels, values, strict=True)]

    def _change(self, at: str, values: Sequence[float]) -> Confirmed:
        differences = np.subtract(values, self._nominal)
        error = float(differences.std(ddof=1) / math.sqrt(len(values))) if len(values) > 1 else 0.0
        return Confirmed(at, float(differences.mean()), error)

    # ------------------------------------------------------------------------------------------------------ one factor

    def deviation(self, deviation: Deviation, by_model: float, bound: float) -> Tolerance:
        """Start where the model says; go nearer or farther until fresh renders fill the bound without leaving it."""
        good: tuple[float, list[Confirmed]] | None = None
        low, high = 0.0, math.inf
        size = min(by_model if by_model > 0 else deviation.reach, deviation.reach)
        for _ in range(_ROUNDS):
            levels = [deviation.level(deviation.nominal + side * size) for side in deviation.sides]
            seen = self.changes(deviation.factor, levels)
            largest = max(abs(one.change) for one in seen) / bound
            if largest <= _ENOUGH[1]:
                good, low = (size, seen), size
                if largest >= _ENOUGH[0] or size >= deviation.reach:
                    break
            else:
                high = size
                worst = seen
            wished = size * _AIM / largest if largest > 0 else deviation.reach
            # Never outside of what is known; where the response is no straight line, by halves.
            ceiling = deviation.reach if math.isinf(high) else low + 0.95 * (high - low)
            size = min(max(wished, low + 0.05 * ((high if math.isfinite(high) else wished) - low)), ceiling)
        met = good is not None
        size, seen = good if good is not None else (0.0, worst)
        self._note_noise(deviation.factor, seen, bound)
        limited = met and size >= deviation.reach and max(abs(one.change) for one in seen) < _ENOUGH[0] * bound
        direction = "+-" if len(deviation.sides) == 2 else "+" if deviation.sides == (1.0,) else "-"
        nominal = str(deviation.level(deviation.nominal).values[0])
        return Tolerance(
            deviation.factor, "deviation", size, deviation.unit, nominal, direction, by_model, limited, tuple(seen), met
        )

    def _note_noise(self, factor: Factor, seen: Sequence[Confirmed], bound: float) -> None:
        noise = max(one.error for one in seen)
        if noise > _HIDDEN * bound:
            self.notes.append(
                f"{factor.name}: fresh renders scatter by {noise:.2g}, which hides much of the bound {bound:.2g}; "
                "lower tolerance in [render]"
            )

    def scatter(self, factor: Factor, bound: float) -> Tolerance:
        """Widen or narrow what a factor draws until the wanted share of systems stays within the bound."""
        from scipy.stats import norm

        sure = float(norm.ppf((1 + self.share) / 2))
        first = self._scattered(factor, 1.0, 0)
        spread = math.sqrt(float(np.mean([one.change**2 for one in first])))
        by_model = bound / (sure * spread) if spread > 0 else math.inf
        size = min(by_model, 1.0)  # wider than the study looked is not asked
        seen = first if size == 1.0 else self._scattered(factor, size, 1)
        inside = sum(abs(one.change) <= bound for one in seen)
        self._note_noise(factor, seen, bound)
        self.notes.append(f"{factor.name}: {inside} of {len(seen)} fresh systems with this scatter stay within")
        # That many or fewer inside would be rarer than 5 % if the share were as wanted.
        from scipy.stats import binom

        met = bool(binom.cdf(inside, len(seen), self.share) > 0.05)
        return Tolerance(
            factor, "scatter", size, "", factor.levels[0].name, "+-", by_model, size == 1.0, tuple(seen), met
        )

    def _scattered(self, factor: Factor, size: float, batch: int) -> list[Confirmed]:
        level = scaled_scatter(factor, size)
        rows = range(_FRESH_ROW + 1 + batch * _SYSTEMS, _FRESH_ROW + 1 + (batch + 1) * _SYSTEMS)
        values = self.measured([(self.with_level(factor, level), row) for row in rows])
        return [self._change(level.name, one) for one in values]

    # ----------------------------------------------------------------------------------------------------- all of them

    def together(self, model: Model, found: Sequence[Tolerance], bound: float) -> Together | None:
        """One scale on all tolerances that keeps the wanted share of random systems within the bound."""
        tolerances = [one.tolerance for one in found]
        if len(tolerances) < 2 or not all(tolerances):
            return None
        # Fresh renders know better than the study how steep each factor is.
        corrected = _corrected(model, found)
        scales = np.linspace(1.0, 0.02, 99)
        scale = next((s for s in scales if self._inside(corrected, tolerances, s, bound) >= self.share), scales[-1])
        random = np.random.default_rng((self.design.seed, _FRESH_ROW))
        systems = []
        for _ in range(_SYSTEMS):
            levels = list(self.base)
            for deviation, tolerance in zip(model.deviations, tolerances, strict=True):
                low = -scale * tolerance if -1.0 in deviation.sides else 0.0
                high = scale * tolerance if 1.0 in deviation.sides else 0.0
                place = [factor.name for factor in self.design.factors].index(deviation.factor.name)
                levels[place] = deviation.level(deviation.nominal + float(random.uniform(low, high)))
            systems.append((tuple(levels), _FRESH_ROW))
        changes = [self._change("", values).change for values in self.measured(systems)]
        inside = sum(abs(change) <= bound for change in changes)
        return Together(float(scale), self._inside(corrected, tolerances, scale, bound), inside, len(systems))

    @staticmethod
    def _inside(model: Model, tolerances: Sequence[float], scale: float, bound: float) -> float:
        return model.share_inside([scale * tolerance for tolerance in tolerances], bound)


def _corrected(model: Model, found: Sequence[Tolerance]) -> Model:
    """The model with the straight and square terms of each factor as fresh renders show them."""
    powers, coefficients = list(model.powers), list(model.coefficients)
    for number, (deviation, one) in enumerate(zip(model.deviations, found, strict=True)):
        step = one.tolerance / deviation.half
        changes = dict(zip(deviation.sides, (seen.change for seen in one.confirmed), strict=True))
        up, down = changes.get(1.0), changes.get(-1.0)
        straight = (up - down) / 2 if up is not None and down is not None else (up or 0.0) - (down or 0.0)
        square = (up + down) / 2 if up is not None and down is not None else 0.0
        for exponent, value in ((1, straight / step), (2, square / step**2)):
            power = tuple(exponent if k == number else 0 for k in range(len(model.deviations)))
            if power in powers:
                coefficients[powers.index(power)] = value
            else:
                powers.append(power)
                coefficients.append(value)
    return replace(model, powers=tuple(powers), coefficients=np.array(coefficients))


def scaled_scatter(factor: Factor, size: float) -> Level:
    """The random level of a factor with its first key's draws nearer to the fixed level; other keys draw as before."""
    fixed = next(level for level in factor.levels if not level.is_random)
    drawn = next(level for level in factor.levels if level.is_random)
    draw, centre = drawn.values[0], number_and_unit(fixed.values[0])
    if not isinstance(draw, Draw) or centre is None:
        raise InputError("draws nothing by its first key", where=f"factors.{factor.name}")
    first = centre[0] + size * (draw.first - centre[0])
    second = size * draw.second if draw.distribution == "normal" else centre[0] + size * (draw.second - centre[0])
    return Level(f"{size:.3g} x {drawn.name}", (replace(draw, first=first, second=second), *drawn.values[1:]))


def _is_scatter(factor: Factor) -> bool:
    random = [level for level in factor.levels if level.is_random]
    fixed = [level for level in factor.levels if not level.is_random]
    return bool(
        len(random) == 1 and fixed and isinstance(random[0].values[0], Draw) and number_and_unit(fixed[0].values[0])
    )


def tolerate(
    design: Design, out: Path, bound: Bound, options: StudyOptions, *, repeats: int = 3, share: float = 0.95
) -> Tolerances:
    """Find the tolerances; runs the study first, as far as it has not been run.

    Parameters
    ----------
    design : Design
        The study.
    out : Path
        Its folder.
    bound : Bound
        See `read_bound`.
    options : StudyOptions
        How it is carried out.
    repeats : int
        Fresh seeds for each system.
    share : float
        Of random systems that are to stay within the bound.

    Raises
    ------
    InputError
        If no factor has a tolerance, or the nominal system cannot be measured.
    """
    if not 1 <= repeats <= 1000:
        raise InputError("must lie between 1 and 1000", where="--repeats")
    if not 0.5 <= share < 1:
        raise InputError("must lie between 0.5 and 1", where="--share")
    study = run_study(design, out, options)
    with sole_owner(out), closing(open_pool(options)) as pool:
        search = _Search(study, bound, options, pool, repeats=repeats, share=share)
        scatters = [factor for factor in design.factors if _is_scatter(factor)]
        if not search.deviations and not scatters:
            raise InputError("no factor has numbers or draws as levels", where=f"{design.origin}: factors")
        nominal = search.nominal()
        largest = bound.at(nominal)
        found: list[Tolerance] = []
        together = None
        if search.deviations:
            model = fit(design, search.deviations, study.rows, bound.response.column)
            for number, deviation in enumerate(search.deviations):
                found.append(search.deviation(deviation, model.reach(number, largest), largest))
            together = search.together(model, found, largest)
        found += [search.scatter(factor, largest) for factor in scatters]
    done = {one.factor.name for one in found}
    left_out = tuple(factor.name for factor in design.factors if factor.name not in done)
    return Tolerances(bound.response, nominal, largest, share, tuple(found), together, left_out, tuple(search.notes))
