"""Plots of effects: half-normal, Pareto, main effects, interactions."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from radwrap.figure_png import figure_png
from radwrap.files import make_folder, write_bytes
from radwrap.manifest import json_text
from radwrap.study.effects import Analysis, as_json

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ANALYSIS: Final = "analysis.json"
_MOST_BARS: Final = 40
_MOST_FACTORS: Final = 6  # of interaction plots
_SIGNIFICANT, _OTHER = "C3", "C0"


def figures(analysis: Analysis) -> Mapping[str, bytes]:
    """Name -> PNG of every plot that the analysis allows."""
    import matplotlib

    # What users call their factors and levels is text, also with a dollar in it, and no formula.
    with matplotlib.rc_context({"text.parse_math": False}):
        found = {"main_effects": main_effects(analysis)}
        if analysis.effects:
            found["pareto"] = pareto(analysis)
        if len(analysis.effects) > 2:
            found["half_normal"] = half_normal(analysis)
        if len(analysis.data.factors) > 1:
            found["interactions"] = interactions(analysis)
    return found


def write_figures(analysis: Analysis, folder: Path) -> None:
    """Write all plots and the numbers."""
    make_folder(folder)
    for name, content in figures(analysis).items():
        write_bytes(folder / f"{name}.png", content)
    write_bytes(folder / ANALYSIS, json_text(as_json(analysis)).encode())


def _figure(width: float, height: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def _axis(analysis: Analysis, what: str) -> str:
    unit = analysis.data.unit
    return f"{what} {analysis.data.response}" + (f" [{unit}]" if unit else "")


def half_normal(analysis: Analysis) -> bytes:
    """Sizes of effects against half-normal quantiles: noise lies on a line through the origin."""
    from scipy.stats import norm

    effects = sorted(analysis.effects, key=lambda effect: abs(effect.effect))
    shares = (np.arange(len(effects)) + 0.5) / len(effects)
    quantiles = norm.ppf(0.5 + shares / 2)
    figure = _figure(6, 4.5)
    axes = figure.subplots()
    for quantile, effect in zip(quantiles, effects, strict=True):
        axes.plot(quantile, abs(effect.effect), "o", color=_SIGNIFICANT if effect.significant else _OTHER)
        if effect.significant or abs(effect.effect) > 0.25 * abs(effects[-1].effect):
            axes.annotate(
                effect.name, (quantile, abs(effect.effect)), xytext=(-5, 4), textcoords="offset points", ha="right"
            )
    if analysis.standard_error is not None:
        ends = np.array([0.0, quantiles[-1] * 1.05])
        axes.plot(ends, ends * analysis.standard_error, "-", color="0.6", label="noise only")
        axes.legend(fontsize="small")
    axes.set_xlabel("half-normal quantile")
    axes.set_ylabel(_axis(analysis, "size of effect on"))
    axes.set_title("Half-normal plot")
    axes.grid(visible=True, alpha=0.3)
    return figure_png(figure)


def pareto(analysis: Analysis) -> bytes:
    """Sizes of effects, the largest first, with the limits."""
    effects = sorted(analysis.effects, key=lambda effect: -abs(effect.effect))[:_MOST_BARS]
    figure = _figure(6, max(2.5, 0.28 * len(effects) + 1.2))
    axes = figure.subplots()
    colours = [_SIGNIFICANT if effect.significant else _OTHER for effect in effects]
    sizes = [abs(effect.effect) for effect in effects]
    axes.barh(
        [effect.name for effect in effects], sizes, xerr=[e.image_error for e in effects], color=colours, ecolor="0.3"
    )
    axes.invert_yaxis()
    axes.set_xlim(left=0)
    if analysis.margin is not None:
        axes.axvline(analysis.margin, color="0.2", linestyle="dashed", label=f"ME {analysis.margin:.3g}")
    if analysis.lenth is not None:
        sme = analysis.lenth.simultaneous_margin_of_error
        axes.axvline(sme, color="0.2", linestyle=":", label=f"SME {sme:.3g}")
    if analysis.margin is not None:
        axes.legend(fontsize="small", loc="lower right")
    axes.set_xlabel(
        _axis(analysis, "size of effect on") + ("; bars: images' error" if analysis.data.errors.any() else "")
    )
    axes.set_title("Pareto plot")
    return figure_png(figure)


def main_effects(analysis: Analysis) -> bytes:
    """Mean response at each level of each factor."""
    data = analysis.data
    count = len(data.factors)
    columns = min(count, 6)
    figure = _figure(max(3.0, 1.9 * columns), 2.8 * -(-count // columns))
    grid = figure.subplots(-(-count // columns), columns, sharey=True, squeeze=False)
    for number, factor in enumerate(data.factors):
        axes: Axes = grid[number // columns][number % columns]
        _means(axes, data.codes[:, number], data.values, factor.levels, factor.numbers)
        axes.set_title(factor.label if len(factor.label) < 26 else factor.name, fontsize="small")
        axes.axhline(float(data.values.mean()), color="0.7", linewidth=0.8)
    for number in range(count, grid.size):
        grid[number // columns][number % columns].set_axis_off()
    for row in grid:
        row[0].set_ylabel(_axis(analysis, "mean"))
    return figure_png(figure)


def _means(axes: Axes, codes: Any, values: Any, levels: tuple[str, ...], numbers: Any, **style: Any) -> None:
    """Mean at each level, over its number where it has one and there are many."""
    present = sorted(set(codes.tolist()))
    means = [float(values[codes == code].mean()) for code in present]
    if numbers is not None and len(levels) > 6:
        axes.plot([numbers[code] for code in present], means, ".", **style)
        return
    axes.plot(present, means, "o-", **style)
    axes.set_xticks(present, [levels[code] for code in present], fontsize="small")
    axes.margins(x=0.25)


def interactions(analysis: Analysis) -> bytes:
    """Mean response over one factor for each level of another: parallel where they do not act together."""
    data = analysis.data
    chosen = [k for k, factor in enumerate(data.factors) if len(factor.levels) <= 6][:_MOST_FACTORS]
    pairs = list(combinations(chosen, 2))
    columns = min(max(len(pairs), 1), 3)
    figure = _figure(3.2 * columns, 2.7 * max(1, -(-len(pairs) // columns)))
    grid = figure.subplots(max(1, -(-len(pairs) // columns)), columns, sharey=True, squeeze=False)
    for axes in grid.ravel():
        axes.set_axis_off()
    for number, (a, b) in enumerate(pairs):
        axes = grid[number // columns][number % columns]
        axes.set_axis_on()
        for code, level in enumerate(data.factors[b].levels):
            here = data.codes[:, b] == code
            if here.any():
                _means(
                    axes,
                    data.codes[here, a],
                    data.values[here],
                    data.factors[a].levels,
                    None,
                    label=f"{data.factors[b].name} {level}",
                    color=f"C{code}",
                )
        axes.set_title(f"{data.factors[a].name} x {data.factors[b].name}", fontsize="small")
        axes.legend(fontsize="x-small")
    for row in grid:
        row[0].set_ylabel(_axis(analysis, "mean"), fontsize="small")
    return figure_png(figure)
