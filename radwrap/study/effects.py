"""Effects of factors on a response, how sure they are, and the sentence that a designer wants."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import combinations
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.manifest import SCHEMA_VERSION, finite
from radwrap.study.lenth import FEWEST_CONTRASTS, Lenth, lenth
from radwrap.study.levels import Data

Array = NDArray[np.float64]

# Beyond so many factors only interactions of two are looked at.
_ALL_INTERACTIONS: Final = 9
_EQUAL: Final = 1e-9


@dataclass(frozen=True, slots=True)
class Effect:
    """What a factor or an interaction does.

    Attributes
    ----------
    name : str
        "A", "AB"; longer names of factors are joined by colons.
    factors : tuple of int
        Numbers of the factors.
    effect : float
        Mean at high minus mean at low; of a numeric factor with more levels, the change over its range by a
        straight line.
    image_error : float
        Standard uncertainty by the images' certified errors, taken as independent.
    t : float or None
        Effect over its standard error; None where nothing tells one.
    significant, significant_simulated : bool or None
        By the t limit; by the simulated one (Lenth's method alone).
    aliases : tuple of str
        What cannot be told from it.
    """

    name: str
    factors: tuple[int, ...]
    effect: float
    image_error: float
    t: float | None = None
    significant: bool | None = None
    significant_simulated: bool | None = None
    aliases: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class AnovaRow:
    """A line of an analysis of variance."""

    term: str
    sum_of_squares: float
    degrees_of_freedom: float
    f: float | None
    p: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Analysis:
    """All that is said of a response.

    Attributes
    ----------
    data : Data
    method : str
        "lenth", "replicates", "regression" or "none".
    alpha : float
    effects : tuple of Effect
        Main effects first, then interactions of two, three, ...
    lenth : Lenth or None
    standard_error : float or None
        Of an effect: the PSE, or from replicates or residuals.
    t_limit : float or None
    anova : tuple of AnovaRow
    notes : tuple of str
        What the user should know, such as that a design is not orthogonal.
    """

    data: Data
    method: str
    alpha: float
    effects: tuple[Effect, ...]
    lenth: Lenth | None
    standard_error: float | None
    t_limit: float | None
    anova: tuple[AnovaRow, ...]
    notes: tuple[str, ...]

    @property
    def margin(self) -> float | None:
        """What an effect must exceed to be significant, in the response's unit."""
        if self.standard_error is None or self.t_limit is None:
            return None
        return self.standard_error * self.t_limit


def analyse(data: Data, alpha: float = 0.05) -> Analysis:
    """Find the effects, and judge them by Lenth's method, by replicates, or by a regression's residuals.

    Raises
    ------
    InputError
        If alpha is no share, or the response is the same everywhere.
    """
    if not 0 < alpha < 1:
        raise InputError(f"{alpha:g} is no share between 0 and 1", where="--alpha")
    if np.ptp(data.values) == 0:
        raise InputError("is the same in all runs", where=data.response, remedy="choose another response")
    notes = list(_notes(data))
    balanced = data.is_two_level and _is_balanced(data)
    columns = _orthogonal_columns(data) if balanced else None
    if columns is None:
        if data.is_two_level:
            notes.append("the design is not orthogonal: effects are those of a least-squares fit, and not independent")
        return _regression(data, alpha, notes)
    effects = tuple(_contrast(data, column) for column in columns)
    if any(effect.aliases for effect in effects):
        notes.append("the design is a fraction of all combinations: aliased effects cannot be told apart")
    distinct = len(np.unique(data.codes, axis=0))
    if len(data.values) > distinct:
        return _replicated(data, alpha, effects, notes)
    return _unreplicated(data, alpha, effects, notes)


def _notes(data: Data) -> Iterator[str]:
    if data.dropped:
        yield f"{data.dropped} rows have no response and are left out"
    kinds = [len(factor.levels) for factor in data.factors]
    distinct = len(np.unique(data.codes, axis=0))
    if distinct < math.prod(kinds):
        yield f"the design is not complete: {distinct} of {math.prod(kinds)} combinations of levels occur"
    elif not _is_balanced(data):
        yield "the design is not balanced: some combinations occur more often than others"


def _is_balanced(data: Data) -> bool:
    _, counts = np.unique(data.codes, axis=0, return_counts=True)
    return bool((counts == counts[0]).all())


# --------------------------------------------------------------------------------------------------- two-level designs


@dataclass(frozen=True, slots=True, eq=False)
class _Column:
    """A contrast: signs of each row, and the interactions that have the same."""

    factors: tuple[int, ...]
    signs: Array
    aliases: tuple[str, ...] = ()


def _name(data: Data, factors: tuple[int, ...]) -> str:
    names = [data.factors[k].name for k in factors]
    return ("" if all(len(factor.name) == 1 for factor in data.factors) else ":").join(names)


def _subsets(data: Data) -> Iterator[tuple[int, ...]]:
    count = len(data.factors)
    for order in range(1, (count if count <= _ALL_INTERACTIONS else 2) + 1):
        yield from combinations(range(count), order)


def _orthogonal_columns(data: Data) -> list[_Column] | None:
    """All different contrasts of an orthogonal design; None where two are neither equal nor orthogonal."""
    signs = data.signs
    complete = len(np.unique(data.codes, axis=0)) == 2 ** len(data.factors)
    found: list[_Column] = []
    for factors in _subsets(data):
        column = signs[:, factors].prod(axis=1)
        if complete:
            found.append(_Column(factors, column))
            continue
        if abs(column.mean()) > 1 - _EQUAL:
            continue  # it is the mean: the interaction that defines the fraction
        overlaps = [float(column @ other.signs) / len(column) for other in found] + [float(column.mean())]
        equal = next((k for k, overlap in enumerate(overlaps) if abs(overlap) > 1 - _EQUAL), None)
        if equal is not None:
            minus = "-" if overlaps[equal] < 0 else ""
            alias = (*found[equal].aliases, minus + _name(data, factors))
            found[equal] = _Column(found[equal].factors, found[equal].signs, alias)
        elif max(map(abs, overlaps)) > _EQUAL:
            return None
        else:
            found.append(_Column(factors, column))
    return found


def _contrast(data: Data, column: _Column) -> Effect:
    high = column.signs > 0
    effect = float(data.values[high].mean() - data.values[~high].mean())
    error = 2 * math.sqrt(float((data.errors**2).sum())) / len(data.errors)
    return Effect(_name(data, column.factors), column.factors, effect, error, aliases=column.aliases)


def _unreplicated(data: Data, alpha: float, effects: tuple[Effect, ...], notes: list[str]) -> Analysis:
    if len(effects) < FEWEST_CONTRASTS:
        notes.append(f"{len(effects)} contrasts are too few for Lenth's method, which needs {FEWEST_CONTRASTS}")
        return Analysis(data, "none", alpha, effects, None, None, None, (), tuple(notes))
    try:
        found = lenth([effect.effect for effect in effects], alpha)
    except InputError as error:
        notes.append(error.what)
        return Analysis(data, "none", alpha, effects, None, None, None, (), tuple(notes))
    judged = tuple(
        _judged(effect, t, abs(t) > found.t_limit, simulated=abs(t) > found.simulated_limit)
        for effect, t in zip(effects, found.t, strict=True)
    )
    return Analysis(data, "lenth", alpha, judged, found, found.pse, found.t_limit, (), tuple(notes))


def _judged(effect: Effect, t: float, significant: bool, *, simulated: bool | None = None) -> Effect:
    return Effect(
        effect.name, effect.factors, effect.effect, effect.image_error, t, significant, simulated, effect.aliases
    )


def _replicated(data: Data, alpha: float, effects: tuple[Effect, ...], notes: list[str]) -> Analysis:
    from scipy.stats import t as student

    _, which = np.unique(data.codes, axis=0, return_inverse=True)
    which = which.ravel()
    means = np.bincount(which, data.values) / np.bincount(which)
    freedom = len(data.values) - len(means)
    variance = float(((data.values - means[which]) ** 2).sum()) / freedom
    error = 2 * math.sqrt(variance / len(data.values))
    limit = float(student.ppf(1 - alpha / 2, freedom))
    if error == 0:
        notes.append("the replicates are equal: nothing tells how sure an effect is")
        return Analysis(data, "none", alpha, effects, None, None, None, (), tuple(notes))
    judged = tuple(_judged(one, one.effect / error, abs(one.effect / error) > limit) for one in effects)
    return Analysis(data, "replicates", alpha, judged, None, error, limit, anova(data, notes), tuple(notes))


# ----------------------------------------------------------------------------------------------------- other designs


def anova(data: Data, notes: list[str]) -> tuple[AnovaRow, ...]:
    """Analysis of variance (type II) of main effects and, where the runs allow, interactions of two."""
    import pandas
    from statsmodels.formula.api import ols
    from statsmodels.stats.anova import anova_lm

    names = [f"x{k}" for k in range(len(data.factors))]
    frame = pandas.DataFrame({name: data.codes[:, k].astype(str) for k, name in enumerate(names)})
    frame["y"] = data.values
    levels = [len(factor.levels) for factor in data.factors]
    main = 1 + sum(count - 1 for count in levels)
    both = main + sum((a - 1) * (b - 1) for a, b in combinations(levels, 2))
    terms = names + ([f"{a}:{b}" for a, b in combinations(names, 2)] if both < len(data.values) else [])
    if main >= len(data.values):
        notes.append("there are too few runs for an analysis of variance")
        return ()
    table = anova_lm(ols(f"y ~ {' + '.join(terms)}", frame).fit(), typ=2)
    rows = []
    for term, line in table.iterrows():
        factors = () if term == "Residual" else tuple(int(part[1:]) for part in str(term).split(":"))
        f, p = float(line["F"]), float(line["PR(>F)"])
        name = _name(data, factors) if factors else "residual"
        rows.append(AnovaRow(name, float(line["sum_sq"]), float(line["df"]), finite(f), finite(p)))
    return tuple(rows)


def _regression(data: Data, alpha: float, notes: list[str]) -> Analysis:
    """Effects over the range of each factor by least squares; words of more than two levels are left to ANOVA."""
    from scipy.stats import t as student

    names: list[int] = []
    columns: list[Array] = [np.ones(len(data.values))]
    for number, factor in enumerate(data.factors):
        if factor.numbers is not None:
            values = np.array(factor.numbers)[data.codes[:, number]]
            columns.append((2 * values - values.min() - values.max()) / float(np.ptp(values)))
        elif len(factor.levels) == 2:
            columns.append(data.signs[:, number])
        else:
            notes.append(f"{factor.name} has words as levels: only the analysis of variance tells of it")
            continue
        names.append(number)
    design = np.column_stack(columns)
    table = () if not _repeats(data) else anova(data, notes)
    if np.linalg.matrix_rank(design) < design.shape[1]:
        notes.append("the runs cannot tell the factors apart")
        return Analysis(data, "none", alpha, (), None, None, None, table, tuple(notes))
    inverse = np.linalg.pinv(design)
    solution = inverse @ data.values
    freedom = len(data.values) - design.shape[1]
    residual = data.values - design @ solution
    variance = float(residual @ residual) / freedom if freedom else 0.0
    errors = np.sqrt(variance * (inverse**2).sum(axis=1))
    image = np.sqrt((inverse**2 * data.errors**2).sum(axis=1))
    limit = float(student.ppf(1 - alpha / 2, freedom)) if freedom else None
    effects = []
    for row, number in enumerate(names, 1):
        t = float(solution[row] / errors[row]) if freedom and errors[row] > 0 else None
        significant = None if t is None or limit is None else abs(t) > limit
        effects.append(
            Effect(_name(data, (number,)), (number,), 2 * float(solution[row]), 2 * float(image[row]), t, significant)
        )
    error = 2 * float(errors[1:].mean()) if freedom and len(errors) > 1 else None
    return Analysis(data, "regression", alpha, tuple(effects), None, error, limit, table, tuple(notes))


def _repeats(data: Data) -> bool:
    """Whether some factor has few enough levels for a table of means."""
    return len(np.unique(data.codes, axis=0)) < len(data.values) or any(
        factor.numbers is None for factor in data.factors
    )


# -------------------------------------------------------------------------------------------------------- what is told


def sentences(analysis: Analysis) -> tuple[str, ...]:
    """What a designer wants to know, the largest effect first."""
    data, unit = analysis.data, f" {analysis.data.unit}" if analysis.data.unit else ""
    told = []
    for effect in sorted(analysis.effects, key=lambda effect: -abs(effect.effect)):
        if not effect.significant or effect.t is None:
            continue
        margin = abs(effect.effect / effect.t) * (analysis.t_limit or 0.0)
        size = f"{_rounded(effect.effect, margin)} +- {_rounded(margin, margin)}{unit}"
        labels = [data.factors[k].label for k in effect.factors]
        if len(labels) == 1:
            factor = data.factors[effect.factors[0]]
            who = _titled(labels[0]) + (f" ({effect.name})" if labels[0] != effect.name else "")
            told.append(f"{who} moves {data.response} by {size}, from {factor.levels[0]} to {factor.levels[-1]}.")
        else:
            told.append(f"{_titled(' and '.join(labels))} act together ({effect.name}): {size} on {data.response}.")
    if told:
        return tuple(told)
    if analysis.margin is None:
        return (f"Nothing tells how sure the effects on {data.response} are.",)
    return (f"No effect on {data.response} exceeds {analysis.margin:.2g}{unit}, which chance alone would reach.",)


def _titled(text: str) -> str:
    return text[:1].upper() + text[1:]


def _rounded(value: float, margin: float) -> str:
    """A value to two digits of its margin."""
    digits = 0 if margin <= 0 else max(0, 1 - math.floor(math.log10(margin)))
    return f"{value:.{digits}f}"


def as_json(analysis: Analysis) -> dict[str, Any]:
    """All that was found."""
    data, found = analysis.data, analysis.lenth
    return {
        "schema_version": SCHEMA_VERSION,
        "response": data.response,
        "unit": data.unit,
        "runs": len(data.values),
        "method": analysis.method,
        "alpha": analysis.alpha,
        "pse": None if found is None else found.pse,
        "me": analysis.margin,
        "sme": None if found is None else found.simultaneous_margin_of_error,
        "t_limit": analysis.t_limit,
        "t_limit_simultaneous": None if found is None else found.t_limit_simultaneous,
        "simulated_limit": None if found is None else found.simulated_limit,
        "simulated_limit_simultaneous": None if found is None else found.simulated_limit_simultaneous,
        "standard_error": analysis.standard_error,
        "levels": {factor.name: list(factor.levels) for factor in data.factors},
        "effects": {
            effect.name: {
                "effect": effect.effect,
                "t": effect.t,
                "significant": effect.significant,
                "significant_simulated": effect.significant_simulated,
                "image_error": effect.image_error,
                "aliases": list(effect.aliases),
            }
            for effect in analysis.effects
        },
        "anova": [asdict(row) for row in analysis.anova],
        "notes": list(analysis.notes),
        "sentences": list(sentences(analysis)),
    }
