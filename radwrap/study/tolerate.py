"""Which tolerance on which factor keeps a response within bounds: by the study's model, confirmed by fresh renders.

Of a factor with numbers: how far it may lie off its nominal value. Of a factor with draws: by how much its scatter
may be widened or must be narrowed. All factors together: Monte Carlo on the model, then fresh random systems.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from radwrap.errors import InputError
from radwrap.files import sole_owner
from radwrap.random_streams import generator
from radwrap.study.design import Design
from radwrap.study.factors import Draw, Factor, Level, number_and_unit
from radwrap.study.fresh import FRESH_ROW, FreshRenders, nominal_level
from radwrap.study.runs import check_design
from radwrap.study.study import StudyOptions, known_plans, known_tracer, open_pool, run_study
from radwrap.study.tolerance_model import Deviation, Model, deviation_of, fit
from radwrap.study.tolerances import Bound, Confirmed, Together, Tolerance, Tolerances
from radwrap.units import parse_quantity

TOLERANCES: Final = "tolerances.json"
_ROUNDS: Final = 6
# A change between these shares of the bound is near enough: the tolerance is then known to as much.
_ENOUGH: Final = (0.85, 1.0)
_AIM: Final = 0.95
_HIDDEN: Final = 1 / 3  # of the bound: where the scatter of fresh renders is larger, they confirm little
_FOLDS: Final = 3  # how often a response may leave its bounds on the way and come back, before it is given up
SYSTEMS: Final = 8
# So few systems within, or fewer, would come by chance less often than this, if the share were as wanted: 6 of 8 where
# 95 % are, in 5.7 % of such checks.
_REFUTED: Final = 0.1


def read_bound(design: Design, response: str, within: str) -> Bound:
    """Read what a response may change by: a share of the nominal response, or a change in its unit.

    Raises
    ------
    InputError
        If there is no such response, or it is no bound of it.
    """
    one = next((known for known in design.responses if known.name == response), None)
    if one is None:
        known_names = ", ".join(known.name for known in design.responses)
        raise InputError(f'no response "{response}"', where="response", remedy=f"the design has {known_names}")
    text = within.strip()
    dimension = one.dimension
    try:
        if text.endswith("%"):
            relative = float(text[:-1]) / 100
            absolute = None
        else:
            relative = None
            absolute = float(text) if dimension is None else parse_quantity(text, dimension) / one.scale
    except ValueError as error:
        raise InputError(f'"{within}" is not a bound', where="within", remedy='write "0.1%"') from error
    except InputError as error:
        raise InputError(f"{error.what}", where="within", remedy=f'{error.remedy}, or write "0.1%"') from error
    size = relative if absolute is None else absolute
    if size is None or not (math.isfinite(size) and size > 0):
        raise InputError("must be above zero", where="within")
    return Bound(one, relative, absolute)


class Search:
    """What fresh renders of a study say of a response.

    Parameters
    ----------
    design : Design
        The study.
    share : float
        Of random systems that are to stay within the bound.
    systems : int
        Number of random systems that are looked at.

    Raises
    ------
    InputError
        If a nominal value lies outside of what the study looks at.
    """

    def __init__(self, design: Design, *, share: float, systems: int = SYSTEMS) -> None:
        self.design, self.share, self.systems = design, share, systems
        self.base = tuple(map(nominal_level, design.factors))
        self.notes: list[str] = []
        deviations = [deviation_of(design, factor) for factor in design.factors]
        self.deviations = tuple(deviation for deviation in deviations if deviation is not None)
        for deviation in self.deviations:
            self.base = self.with_level(deviation.factor, deviation.level(deviation.nominal))
            if not deviation.from_scene:
                taken = deviation.level(deviation.nominal).name
                self.notes.append(
                    f"{deviation.factor.name}: the base scene has no {deviation.factor.keys[0]}; {taken} is taken for "
                    "its nominal value"
                )
        self.scatters = tuple(factor for factor in design.factors if _is_scatter(factor))

    def with_level(self, factor: Factor, level: Level) -> tuple[Level, ...]:
        """The nominal system with one factor elsewhere."""
        names = [known.name for known in self.design.factors]
        place = names.index(factor.name)
        return (*self.base[:place], level, *self.base[place + 1 :])

    def begin(self, fresh: FreshRenders) -> float:
        """Take fresh renders from somewhere; returns the response of the nominal system."""
        self.fresh = fresh
        self._nominal = fresh.measured([(self.base, FRESH_ROW)])[0]
        if len(self._nominal) == 1:
            self.notes.append("one seed for each system does not show how far fresh renders scatter; use --repeats 3")
        return float(np.mean(self._nominal))

    def changes(self, factor: Factor, levels: Sequence[Level]) -> list[Confirmed]:
        """Change at each level of a factor, seed by seed: equal seeds draw equal rays, whose noise falls out."""
        values = self.fresh.measured([(self.with_level(factor, level), FRESH_ROW) for level in levels])
        return [self._change(level.name, one) for level, one in zip(levels, values, strict=True)]

    def _change(self, at: str, values: Sequence[float]) -> Confirmed:
        differences = np.subtract(values, self._nominal)
        error = float(differences.std(ddof=1) / math.sqrt(len(values))) if len(values) > 1 else None
        return Confirmed(at, float(differences.mean()), error)

    # ------------------------------------------------------------------------------------------------------ one factor

    def deviation(self, deviation: Deviation, by_model: float, bound: float) -> Tolerance:
        """The tolerance of one factor, and whether the response stays within the bound on the way there too."""
        size = min(by_model if by_model > 0 else deviation.reach, deviation.reach)
        ceiling = deviation.reach
        halfway: list[Confirmed] = []
        for _ in range(_FOLDS):
            met, size, seen = self._filled(deviation, size, ceiling, bound)
            if not met:
                break
            halfway = self._at(deviation, size / 2)
            met = all(abs(one.change) <= bound for one in halfway)
            if met:
                break
            # The response comes back into the bound only farther out: that is no tolerance.
            size = ceiling = size / 2
            seen = halfway
        if not met:
            size, halfway = 0.0, []
        self._note_noise(deviation.factor, seen, bound)
        limited = met and size >= deviation.reach and max(abs(one.change) for one in seen) < _ENOUGH[0] * bound
        return Tolerance(
            deviation.factor,
            "deviation",
            size,
            deviation.unit,
            nominal=str(deviation.level(deviation.nominal).values[0]),
            direction="+-" if len(deviation.sides) == 2 else "+" if deviation.sides == (1.0,) else "-",
            by_model=by_model,
            limited=limited,
            confirmed=tuple(seen),
            met=met,
            halfway=tuple(halfway),
        )

    def _at(self, deviation: Deviation, size: float) -> list[Confirmed]:
        levels = [deviation.level(deviation.nominal + side * size) for side in deviation.sides]
        return self.changes(deviation.factor, levels)

    def _filled(
        self, deviation: Deviation, size: float, reach: float, bound: float
    ) -> tuple[bool, float, list[Confirmed]]:
        """Go nearer or farther until fresh renders fill the bound without leaving it.

        Returns whether that succeeded, the size, and what was seen there.
        """
        good: tuple[float, list[Confirmed]] | None = None
        low, high = 0.0, math.inf
        for _ in range(_ROUNDS):
            seen = self._at(deviation, size)
            largest = max(abs(one.change) for one in seen) / bound
            if largest <= _ENOUGH[1]:
                good, low = (size, seen), size
                if largest >= _ENOUGH[0] or size >= reach:
                    break
            else:
                high = size
            wished = size * _AIM / largest if largest > 0 else reach
            # Never outside of what is known; where the response is no straight line, by halves.
            ceiling = reach if math.isinf(high) else low + 0.95 * (high - low)
            size = min(max(wished, low + 0.05 * ((high if math.isfinite(high) else wished) - low)), ceiling)
        return (False, size, seen) if good is None else (True, *good)

    def _note_noise(self, factor: Factor, seen: Sequence[Confirmed], bound: float) -> None:
        noise = max(one.error or 0.0 for one in seen)
        if noise > _HIDDEN * bound:
            self.notes.append(
                f"{factor.name}: fresh renders scatter by {noise:.2g}, which hides much of the bound {bound:.2g}; "
                "lower tolerance in [render]"
            )

    def scatter(self, factor: Factor, bound: float) -> Tolerance:
        """Widen or narrow what a factor draws until the wanted share of systems stays within the bound."""
        from scipy.stats import t

        # The scatter is known from so few systems only: by Student's t the share is kept in the mean of such studies.
        sure = float(t.ppf((1 + self.share) / 2, self.systems))
        first = self._scattered(factor, 1.0, 0)
        spread = math.sqrt(float(np.mean([one.change**2 for one in first])))
        by_model = bound / (sure * spread) if spread > 0 else math.inf
        size = min(by_model, 1.0)  # wider than the study looked is not asked
        seen = first if size == 1.0 else self._scattered(factor, size, 1)
        inside = sum(abs(one.change) <= bound for one in seen)
        self._note_noise(factor, seen, bound)
        self.notes.append(f"{factor.name}: {inside} of {len(seen)} fresh systems with this scatter stay within")
        return Tolerance(
            factor,
            "scatter",
            size,
            "",
            nominal=nominal_level(factor).name,
            direction="+-",
            by_model=by_model,
            limited=size == 1.0,
            confirmed=tuple(seen),
            met=self._goes_with_share(inside, len(seen)),
        )

    def _scattered(self, factor: Factor, size: float, batch: int) -> list[Confirmed]:
        level = scaled_scatter(factor, size)
        rows = range(FRESH_ROW + 1 + batch * self.systems, FRESH_ROW + 1 + (batch + 1) * self.systems)
        values = self.fresh.measured([(self.with_level(factor, level), row) for row in rows])
        return [self._change(level.name, one) for one in values]

    def _goes_with_share(self, inside: int, systems: int) -> bool:
        """Whether so many systems within the bound do not refute the wanted share."""
        from scipy.stats import binom

        return bool(binom.cdf(inside, systems, self.share) > _REFUTED)

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
        random = generator(self.design.seed, FRESH_ROW)
        systems = []
        for _ in range(self.systems):
            levels = list(self.base)
            for deviation, tolerance in zip(model.deviations, tolerances, strict=True):
                low = -scale * tolerance if -1.0 in deviation.sides else 0.0
                high = scale * tolerance if 1.0 in deviation.sides else 0.0
                place = [factor.name for factor in self.design.factors].index(deviation.factor.name)
                levels[place] = deviation.level(deviation.nominal + float(random.uniform(low, high)))
            systems.append((tuple(levels), FRESH_ROW))
        changes = [self._change("", values).change for values in self.fresh.measured(systems)]
        inside = sum(abs(change) <= bound for change in changes)
        share = self._inside(corrected, tolerances, scale, bound)
        return Together(float(scale), share, inside, len(systems), self._goes_with_share(inside, len(systems)))

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
    design: Design,
    out: Path,
    bound: Bound,
    options: StudyOptions,
    *,
    repeats: int = 3,
    share: float = 0.95,
    systems: int = SYSTEMS,
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
    systems : int
        Number of random systems that are looked at.

    Raises
    ------
    InputError
        If no factor has a tolerance, a nominal value lies outside of its factor, or the nominal system cannot be
        measured.
    """
    if not 1 <= repeats <= 1000:
        raise InputError("must lie between 1 and 1000", where="repeats")
    if not 0.5 <= share < 1:
        raise InputError("must lie between 0.5 and 1", where="share")
    if not 4 <= systems <= 10_000:
        raise InputError("must lie between 4 and 10000", where="systems")
    check_design(design, options.of_render)
    search = Search(design, share=share, systems=systems)
    if not search.deviations and not search.scatters:
        raise InputError("no factor has numbers or draws as levels", where=f"{design.origin}: factors")
    study = run_study(design, out, options)
    # With the one tolerance and the one tracer that all its runs have.
    design, options = study.design, replace(options, tracer=known_tracer(out) or options.tracer)
    search = Search(design, share=share, systems=systems)
    with sole_owner(out), closing(open_pool(options, out)) as pool:
        plans = known_plans(out)
        fresh = FreshRenders(design, out, bound.response, options, pool, repeats=repeats, plans=plans)
        nominal = search.begin(fresh)
        largest = largest_change(bound, nominal)
        found: list[Tolerance] = []
        together = None
        if search.deviations:
            model = fit(design, search.deviations, study.rows, bound.response.column)
            for number, deviation in enumerate(search.deviations):
                found.append(search.deviation(deviation, model.reach(number, largest), largest))
            together = search.together(model, found, largest)
        found += [search.scatter(factor, largest) for factor in search.scatters]
    done = {one.factor.name for one in found}
    left_out = tuple(factor.name for factor in design.factors if factor.name not in done)
    not_met = int(study.summary["not_met"]) + fresh.not_met
    notes = tuple(search.notes)
    return Tolerances(bound.response, nominal, largest, share, tuple(found), together, left_out, notes, not_met)


def largest_change(bound: Bound, nominal: float) -> float:
    """What the response may change by; a share of nothing is no bound."""
    largest = bound.at(nominal)
    if not largest > 0:
        unit = f" {bound.response.unit}" if bound.response.unit else ""
        raise InputError(
            f"{bound.response.name} is {nominal:g} nominally, so a share of it cannot be a bound",
            where="within",
            remedy=f'give the change itself, such as "0.05{unit}"',
        )
    return largest
