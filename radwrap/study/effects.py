"""Effects of factors on a response, how sure they are, and the sentence that a designer wants."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.manifest import SCHEMA_VERSION
from radwrap.study.lenth import FEWEST_CONTRASTS, Lenth, lenth
from radwrap.study.levels import Data
from radwrap.study.variance import AnovaRow, anova, indicators, name_of, pure_error

Array = NDArray[np.float64]

# Beyond so many factors only interactions of two are looked at.
_ALL_INTERACTIONS: Final = 9
_EQUAL: Final = 1e-9
_SURE: Final = 1.959963985  # normal quantile of 0.975


@dataclass(frozen=True, slots=True)
class Effect:
    """What a factor or an interaction does.

    Attributes
    ----------
    name : str
        "A", "AB"; longer names of factors are joined by colons. Words of more than two levels have an effect for each
        level but the first, "A=level".
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
        By the t limit; by the simulated one (Lenth's method alone). Never where the images' errors alone may make it:
        runs that share their rays have errors in common, and scatter less than they are off.
    aliases : tuple of str
        What cannot be told from it.
    start, end : str or None
        Levels between which an effect of one factor is told: response at `end` minus response at `start`.
    """

    name: str
    factors: tuple[int, ...]
    effect: float
    image_error: float
    t: float | None = None
    significant: bool | None = None
    significant_simulated: bool | None = None
    aliases: tuple[str, ...] = ()
    start: str | None = None
    end: str | None = None


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
        raise InputError(f"{alpha:g} is not a share between 0 and 1", where="alpha")
    if np.ptp(data.values) == 0:
        raise InputError("is the same in all runs", where=data.response, remedy="choose another response")
    notes = list(_notes(data))
    repeated = len(np.unique(data.codes, axis=0)) < len(data.values)
    columns = _contrasts(data, notes)
    if columns is None and data.analysis == "lenth":
        notes.append("Lenth's method, which the design asks for, needs an orthogonal design of two levels")
    if columns is None or (data.analysis == "anova" and not repeated):
        return _regression(data, alpha, notes)
    effects = tuple(_contrast(data, column) for column in columns)
    if any(effect.aliases for effect in effects):
        notes.append("the design is a fraction of all combinations: aliased effects cannot be separated")
    if repeated and data.analysis != "lenth":
        return _replicated(data, alpha, effects, notes)
    return _unreplicated(data, alpha, effects, notes)


def _contrasts(data: Data, notes: list[str]) -> list[_Column] | None:
    """All contrasts that are judged as such; None where a fit must tell the effects."""
    if not data.is_two_level:
        return None
    columns = _orthogonal_columns(data) if _is_balanced(data) else None
    if columns is not None:
        return columns
    signs = data.signs
    overlaps = np.abs(signs.T @ signs - len(signs) * np.eye(signs.shape[1]))
    if overlaps.max() > _EQUAL or np.abs(signs.sum(axis=0)).max() > _EQUAL:
        notes.append("the design is not orthogonal: effects are those of a least-squares fit, and not independent")
        return None
    notes.append("interactions are spread over several main effects, as in Plackett-Burman designs: none is looked at")
    mains = [_Column((number,), signs[:, number]) for number in range(signs.shape[1])]
    # Where Lenth's method has too few contrasts, the residuals of a fit tell more.
    return mains if len(mains) >= FEWEST_CONTRASTS else None


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
            alias = (*found[equal].aliases, minus + name_of(data, factors))
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
    found = Effect(name_of(data, column.factors), column.factors, effect, error, aliases=column.aliases)
    if len(column.factors) > 1:
        return found
    levels = data.factors[column.factors[0]].levels
    return replace(found, start=levels[0], end=levels[-1])


def _unreplicated(data: Data, alpha: float, effects: tuple[Effect, ...], notes: list[str]) -> Analysis:
    if len(effects) < FEWEST_CONTRASTS:
        notes.append(f"{len(effects)} contrasts are too few for Lenth's method, which needs {FEWEST_CONTRASTS}")
        return Analysis(data, "none", alpha, effects, None, None, None, (), tuple(notes))
    try:
        found = lenth([effect.effect for effect in effects], alpha)
    except InputError as error:
        notes.append(error.what)
        return Analysis(data, "none", alpha, effects, None, None, None, (), tuple(notes))
    if (data.errors > 0).any():
        notes.append(
            "the responses are predictions without a camera's noise: what Lenth's method takes for noise is small "
            "effects and the rendering's error, so significant means larger than these; frames = N gives a "
            "frame's noise"
        )
    judged = tuple(
        _judged(effect, t, abs(t) > found.t_limit, simulated=abs(t) > found.simulated_limit)
        for effect, t in zip(effects, found.t, strict=True)
    )
    return Analysis(data, "lenth", alpha, judged, found, found.pse, found.t_limit, (), tuple(notes))


def _judged(effect: Effect, t: float, significant: bool, *, simulated: bool | None = None) -> Effect:
    """With what the statistics say, unless the images' errors alone may make such an effect."""
    shown = abs(effect.effect) > _SURE * effect.image_error
    simulated = None if simulated is None else simulated and shown
    return replace(effect, t=t, significant=significant and shown, significant_simulated=simulated)


def _replicated(data: Data, alpha: float, effects: tuple[Effect, ...], notes: list[str]) -> Analysis:
    from scipy.stats import t as student

    squares, freedom = pure_error(data)
    variance = squares / freedom
    error = 2 * math.sqrt(variance / len(data.values))
    limit = float(student.ppf(1 - alpha / 2, freedom))
    if error == 0:
        notes.append("the replicates are equal: nothing shows how certain an effect is")
        return Analysis(data, "none", alpha, effects, None, None, None, (), tuple(notes))
    judged = tuple(_judged(one, one.effect / error, abs(one.effect / error) > limit) for one in effects)
    return Analysis(data, "replicates", alpha, judged, None, error, limit, anova(data, notes), tuple(notes))


# ----------------------------------------------------------------------------------------------------- other designs


def _regression(data: Data, alpha: float, notes: list[str]) -> Analysis:
    """Effects by least squares: a straight line over each factor of numbers, and each level of words for itself."""
    from scipy.stats import t as student

    effects, columns = _fitted_columns(data)
    design = np.column_stack([np.ones(len(data.values)), *columns])
    wanted = data.analysis == "anova" or _has_few_levels(data)
    table = anova(data, notes) if wanted else ()
    if np.linalg.matrix_rank(design) < design.shape[1]:
        notes.append("the runs cannot separate the factors")
        return Analysis(data, "none", alpha, (), None, None, None, table, tuple(notes))
    inverse = np.linalg.pinv(design)
    residual = data.values - design @ (inverse @ data.values)
    freedom = len(data.values) - design.shape[1]
    variance, freedom = _noise(data, float(residual @ residual), freedom, alpha, notes)
    sizes = (inverse @ data.values)[1:]
    errors = np.sqrt(variance * (inverse[1:] ** 2).sum(axis=1))
    image = np.sqrt((inverse[1:] ** 2 * data.errors**2).sum(axis=1))
    limit = float(student.ppf(1 - alpha / 2, freedom)) if freedom else None
    judged = []
    for effect, size, error, by_image in zip(effects, sizes, errors, image, strict=True):
        told = replace(effect, effect=float(size), image_error=float(by_image))
        if limit is not None and error > 0:
            told = _judged(told, float(size / error), bool(abs(size) > limit * error))
        judged.append(told)
    # The largest error, so that what no effect exceeds is true of each.
    error = float(errors.max()) if freedom else None
    return Analysis(data, "regression", alpha, tuple(judged), None, error, limit, table, tuple(notes))


def _fitted_columns(data: Data) -> tuple[list[Effect], list[Array]]:
    """Effects to be found, and for each its column: an effect is its column's coefficient."""
    effects: list[Effect] = []
    columns: list[Array] = []
    for number, factor in enumerate(data.factors):
        name = name_of(data, (number,))
        if factor.numbers is not None or len(factor.levels) == 2:
            numbers = np.array(factor.numbers if factor.numbers is not None else (0.0, 1.0))
            values = numbers[data.codes[:, number]]
            columns.append((values - (numbers[0] + numbers[-1]) / 2) / (numbers[-1] - numbers[0]))
            effects.append(Effect(name, (number,), 0.0, 0.0, start=factor.levels[0], end=factor.levels[-1]))
            continue
        for level, column in zip(factor.levels[1:], indicators(data, number).T, strict=True):
            columns.append(column)
            effects.append(Effect(f"{name}={level}", (number,), 0.0, 0.0, start=factor.levels[0], end=level))
    return effects, columns


def _noise(data: Data, squares: float, freedom: int, alpha: float, notes: list[str]) -> tuple[float, int]:
    """Variance of a run and its degrees of freedom: by all residuals, unless equal runs scatter significantly less."""
    from scipy.stats import f

    equal, of_equal = pure_error(data)
    others = freedom - of_equal
    if of_equal and others > 0 and equal > 0:
        p = float(f.sf((squares - equal) / others / (equal / of_equal), others, of_equal))
        if p < alpha:
            notes.append(
                f"straight lines and levels that add up do not describe the response (lack of fit, p = {p:.1g}): it is "
                "curved, or factors act together"
            )
            return equal / of_equal, of_equal
    return (squares / freedom, freedom) if freedom else (0.0, 0)


def _has_few_levels(data: Data) -> bool:
    """Whether there are equal runs, or words: then a table of means says something."""
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
        who = _who(data, effect.factors, effect.name)
        if len(effect.factors) == 1:
            told.append(f"{who} moves {data.response} by {size}, from {effect.start} to {effect.end}.")
        else:
            told.append(f"{who}: {size} on {data.response}.")
    told += _by_variance(analysis)
    if told:
        return tuple(told)
    if analysis.margin is None:
        return (f"Nothing shows how certain the effects on {data.response} are.",)
    return (
        f"No effect on {data.response} exceeds {analysis.margin:.2g}{unit}, a size that chance by itself would reach.",
    )


def _by_variance(analysis: Analysis) -> Iterator[str]:
    """What only the analysis of variance shows beside a fit: curves, and factors that act together."""
    if analysis.method != "regression":
        return
    data = analysis.data
    known = {effect.factors for effect in analysis.effects if effect.significant}
    for row in analysis.anova:
        if not row.factors or row.factors in known or row.p is None or row.p >= analysis.alpha:
            continue
        who, sure = _who(data, row.factors, row.term), f"(analysis of variance, p = {row.p:.1g})"
        if len(row.factors) == 1:
            yield f"{who} moves {data.response}, but not along a straight line {sure}."
        else:
            yield f"{who} on {data.response} {sure}."


def _who(data: Data, factors: tuple[int, ...], name: str) -> str:
    labels = [data.factors[k].label for k in factors]
    if len(labels) > 1:
        return f"{_titled(' and '.join(labels))} act together ({name})"
    factor = data.factors[factors[0]]
    return _titled(factor.label) + (f" ({factor.name})" if factor.label != factor.name else "")


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
                "from": effect.start,
                "to": effect.end,
            }
            for effect in analysis.effects
        },
        "anova": [
            {
                "term": row.term,
                "sum_of_squares": row.sum_of_squares,
                "degrees_of_freedom": row.degrees_of_freedom,
                "f": row.f,
                "p": row.p,
            }
            for row in analysis.anova
        ],
        "notes": list(analysis.notes),
        "sentences": list(sentences(analysis)),
    }
