"""Analysis of variance, and the scatter of runs that are alike."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from radwrap.manifest import finite
from radwrap.study.levels import Data

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class AnovaRow:
    """A line of an analysis of variance."""

    term: str
    sum_of_squares: float
    degrees_of_freedom: float
    f: float | None
    p: float | None
    factors: tuple[int, ...] = ()


def name_of(data: Data, factors: tuple[int, ...]) -> str:
    """Name of an effect: "AB"; longer names of factors are joined by colons."""
    names = [data.factors[k].name for k in factors]
    return ("" if all(len(factor.name) == 1 for factor in data.factors) else ":").join(names)


def pure_error(data: Data) -> tuple[float, int]:
    """Sum of squares of runs about the mean of their combination of levels, and its degrees of freedom."""
    _, which = np.unique(data.codes, axis=0, return_inverse=True)
    which = which.ravel()
    means = np.bincount(which, data.values) / np.bincount(which)
    return float(((data.values - means[which]) ** 2).sum()), len(data.values) - len(means)


def indicators(data: Data, number: int) -> Array:
    """A column for each level of a factor but the first: 1 where a run has it."""
    levels = range(1, len(data.factors[number].levels))
    return np.column_stack([data.codes[:, number] == level for level in levels]).astype(np.float64)


def anova(data: Data, notes: list[str]) -> tuple[AnovaRow, ...]:
    """Analysis of variance (type II) of main effects and of those interactions of two that the runs can tell."""
    import pandas
    from statsmodels.formula.api import ols
    from statsmodels.stats.anova import anova_lm

    count, runs = len(data.factors), len(data.values)
    # Counted before they are made: a factor that differs from run to run has a column for each.
    if 1 + sum(len(factor.levels) - 1 for factor in data.factors) >= runs:
        notes.append("there are too few runs for an analysis of variance")
        return ()
    columns = np.column_stack([np.ones(runs), *(indicators(data, k) for k in range(count))])
    if np.linalg.matrix_rank(columns) < columns.shape[1]:
        notes.append("the runs cannot separate the factors: there is no analysis of variance")
        return ()
    pairs = _told_apart(data, columns)
    left_out = [name_of(data, pair) for pair in combinations(range(count), 2) if pair not in pairs]
    if left_out:
        notes.append(f"the analysis of variance is without {', '.join(left_out)}, which the runs cannot separate")
    frame = pandas.DataFrame({f"x{k}": data.codes[:, k].astype(str) for k in range(count)})
    frame["y"] = data.values
    terms = [f"x{k}" for k in range(count)] + [f"x{a}:x{b}" for a, b in pairs]
    with np.errstate(divide="ignore", invalid="ignore"):  # where nothing scatters F is infinite
        table = anova_lm(ols(f"y ~ {' + '.join(terms)}", frame).fit(), typ=2)
    rows = []
    for term, line in table.iterrows():
        factors = () if term == "Residual" else tuple(int(part[1:]) for part in str(term).split(":"))
        f, p = finite(float(line["F"])), finite(float(line["PR(>F)"]))
        name = name_of(data, factors) if factors else "residual"
        rows.append(AnovaRow(name, float(line["sum_sq"]), float(line["df"]), f, p, factors))
    return tuple(rows)


def _told_apart(data: Data, columns: Array) -> list[tuple[int, int]]:
    """Interactions of two that can be told from all before them and leave something for the residual."""
    found = []
    for a, b in combinations(range(len(data.factors)), 2):
        both = [first * second for first in indicators(data, a).T for second in indicators(data, b).T]
        wider = np.column_stack([columns, *both])
        if wider.shape[1] < len(data.values) and np.linalg.matrix_rank(wider) == wider.shape[1]:
            found.append((a, b))
            columns = wider
    return found
