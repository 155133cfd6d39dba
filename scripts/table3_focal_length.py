"""Table 3 by the whole chain, over seeds, centre methods, both signs of the tilt, and one changed assumption at a time.

Studies lie in FOLDER/studies/VARIANT/seedNN, 16 images each; killed at any moment, the same command goes on.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any, Final

import numpy as np

from radwrap.measure.dots import METHODS
from replication.figure import OURS, PAPER, Made, Task, figure, main
from replication.images import Measured
from replication.published import claims, judge, published
from replication.studies import (
    NEGATIVE,
    NOMINAL,
    NOMINAL_METHOD,
    Draw,
    draws_of,
    folder_of,
    is_finished,
    mean_error_percent,
    run,
)
from table4_lenth import TRUE, printed_table

WORST: Final = ("HLLL", "HLHL", "HHLL", "HHHL")
FEWEST: Final = 20  # seeds on which a verdict rests (published.toml)
SHOWN: Final = ("A", "B", "C", "D", "AD")
# Conclusions of the paper that a share of seeds can hold: key of the claim -> what must be true of a seed's effects.
SIGNIFICANT: Final = {"A": True, "D": True, "AD": True, "B": False, "C": False}
SIGNS: Final = {"A": -1, "D": 1, "AD": 1}


def make(task: Task) -> Made:
    """Run what is missing, analyse each seed, draw."""
    variants = _variants(task)
    draws = [draw for variant, seeds in variants for seed in seeds for draw in _draws(variant, seed, task)]
    nominal = [draw for draw in draws if draw.variant == "nominal" and draw.method == NOMINAL_METHOD]
    percent = [abs(float(str(row["f [mm]"])) - TRUE) / TRUE * 100 for row in printed_table()]
    table = [
        _summary(variant, method, [one for one in draws if (one.variant, one.method) == (variant["name"], method)])
        for (variant, _), method in product(variants, METHODS)
        if method == NOMINAL_METHOD or variant in (NOMINAL, NEGATIVE)
    ]
    return Made(
        title="Effects on the focal length",
        picture=_picture(nominal, [row for row in table if row["method"] == NOMINAL_METHOD]),
        ours={"percent": percent, **shares(nominal), "worst": _worst(nominal)},
        assumed=tuple(published()["assumptions"]),
        more={
            "seeds": sorted(draw.seed for draw in nominal),
            "nominal": [_as_json(draw) for draw in nominal],
            "sensitivity": table,
            "not_run": [] if task.quick else not_run(variants),
            "failed": [
                {"variant": variant["name"], "seed": seed}
                for variant, seeds in variants
                for seed in seeds
                if not any(
                    (draw.variant, draw.seed, draw.method) == (variant["name"], seed, NOMINAL_METHOD) for draw in draws
                )
            ],
        },
        note=f"over {len(nominal)} seeds" + (f", the rule wants {FEWEST}" if len(nominal) < FEWEST else ""),
    )


def not_run(variants: Sequence[tuple[Mapping[str, Any], Sequence[int]]]) -> list[str]:
    """Names of the studies that the whole has and these lack."""
    seen = {variant["name"] for variant, _ in variants}
    return [one["name"] for one in (NOMINAL, NEGATIVE, *published()["variants"]) if one["name"] not in seen]


def _variants(task: Task) -> list[tuple[Mapping[str, Any], Sequence[int]]]:
    """What to run, and with which seeds; a quick run shows one seed."""
    if task.quick:
        return [(NOMINAL, [1])]
    seeds, fewer = range(1, task.seeds + 1), range(1, task.variant_seeds + 1)
    wanted = [(NOMINAL, seeds), (NEGATIVE, seeds), *((variant, fewer) for variant in published()["variants"])]
    if not task.finished_only:
        return wanted
    out = task.out / "studies"
    found = [(variant, [seed for seed in some if is_finished(variant, seed, out)]) for variant, some in wanted]
    return [(variant, seeds) for variant, seeds in found if seeds]


def _draws(variant: Mapping[str, Any], seed: int, task: Task) -> Iterator[Draw]:
    out = task.out / ("studies_quick" if task.quick else "studies")
    study = (
        folder_of(variant, seed, out) / "study" if task.finished_only else run(variant, seed, out, coarse=task.quick)
    )
    yield from draws_of(variant["name"], seed, study)


def shares(draws: Sequence[Draw]) -> dict[str, float | None]:
    """Key of a claim -> share of seeds for which it holds; None without a seed."""
    found: dict[str, float | None] = {}
    printed = claims("table3")
    for name, wanted in SIGNIFICANT.items():
        found[name] = _share(draw.effects[name]["significant"] == wanted for draw in draws)
    for name, sign in SIGNS.items():
        effects = [draw.effects[name]["effect"] for draw in draws]
        found[f"{name}_sign"] = _share(sign * effect > 0 for effect in effects)
        found[f"{name}_size"] = _share(effect < float(str(printed[f"{name}_size"].printed)) for effect in effects)
    return found


def _share(true: Any) -> float | None:
    listed = list(true)
    return float(np.mean(listed)) if listed else None


def _worst(draws: Sequence[Draw]) -> Measured | None:
    errors = [mean_error_percent(draw, WORST, TRUE) for draw in draws]
    if not errors:
        return None
    scatter = float(np.std(errors, ddof=1)) / math.sqrt(len(errors)) if len(errors) > 1 else math.nan
    return Measured(float(np.mean(errors)), scatter)


def _summary(variant: Mapping[str, Any], method: str, draws: Sequence[Draw]) -> dict[str, Any]:
    """A line of the sensitivity table."""
    found = shares(draws)
    rules = claims("table3")
    return {
        "variant": variant["name"],
        "opens": variant["opens"],
        "what": variant["what"],
        "method": method,
        "seeds": len(draws),
        "shares": found,
        "verdicts": {key: judge(rules[key], share)[0] for key, share in found.items()},
        "effects_mm": {name: _mean(draw.effects[name]["effect"] for draw in draws) for name in SHOWN},
        "effects_scatter_mm": {name: _scatter(draw.effects[name]["effect"] for draw in draws) for name in SHOWN},
        "pse_mm": _mean(draw.pse for draw in draws),
        "f_LLLL_mm": _mean(draw.focal_lengths["LLLL"] for draw in draws),
        "image_error_mm": _mean(draw.errors["LLLL"] for draw in draws),
        "worst_percent": _mean(mean_error_percent(draw, WORST, TRUE) for draw in draws),
    }


def _mean(values: Any) -> float | None:
    listed = list(values)
    return float(np.mean(listed)) if listed else None


def _scatter(values: Any) -> float | None:
    listed = list(values)
    return float(np.std(listed, ddof=1)) if len(listed) > 1 else None


def _as_json(draw: Draw) -> dict[str, Any]:
    effects = {
        name: {key: effect[key] for key in ("effect", "t", "significant")} for name, effect in draw.effects.items()
    }
    return {"seed": draw.seed, "pse_mm": draw.pse, "effects": effects, "f_mm": dict(draw.focal_lengths)}


# ------------------------------------------------------------------------------------------------------------- picture


def _picture(draws: Sequence[Draw], table: Sequence[Mapping[str, Any]]) -> Any:
    picture, panels = figure(
        7.6, 3.0 + 0.21 * len(table), 2, 2, height_ratios=(2.6, 0.6 + 0.21 * len(table)), width_ratios=(1, 1.35)
    )
    _effects_panel(panels[0, 0], draws)
    _lengths_panel(panels[0, 1], draws)
    grid = panels[1, 0].get_gridspec()
    for axes in panels[1]:
        axes.remove()
    _sensitivity_panel(picture.add_subplot(grid[1, :]), table)
    picture.suptitle(f"Table 3: {len(draws)} seeds, centre method {NOMINAL_METHOD}; red: printed, one draw")
    return picture


def _effects_panel(axes: Any, draws: Sequence[Draw]) -> None:
    printed = printed_effects()
    for place, name in enumerate(SHOWN):
        values = [draw.effects[name]["effect"] for draw in draws]
        spread = np.linspace(-0.2, 0.2, len(values)) if len(values) > 1 else np.zeros(len(values))
        axes.plot(place + spread, values, "o", color=OURS, ms=2.5, alpha=0.7)
        axes.plot(place, printed[name], "_", color=PAPER, ms=16, mew=1.8)
    axes.axhline(0, color="0.6", lw=0.6)
    axes.set(xticks=range(len(SHOWN)), xticklabels=SHOWN, ylabel="effect on f [mm]", title="effects, L to H")


def printed_effects() -> dict[str, float]:
    """Effects of the printed focal lengths: mean at H less mean at L, of a product where its levels agree [mm]."""
    rows = printed_table()
    found = {}
    for name in SHOWN:
        signs = [math.prod(1 if row[factor] == "H" else -1 for factor in name) for row in rows]
        found[name] = sum(sign * float(str(row["f [mm]"])) for sign, row in zip(signs, rows, strict=True)) / 8
    return found


def _lengths_panel(axes: Any, draws: Sequence[Draw]) -> None:
    rows = printed_table()
    names = ["".join(str(row[factor]) for factor in "ABCD") for row in rows]
    for draw in draws:
        axes.plot(range(16), [draw.focal_lengths[name] for name in names], "o", color=OURS, ms=2, alpha=0.5)
    axes.plot(range(16), [float(str(row["f [mm]"])) for row in rows], "_", color=PAPER, ms=9, mew=1.6)
    axes.axhline(TRUE, color="0.6", lw=0.6)
    axes.set(ylabel="f [mm]", title="calibrated focal length, rows ABCD")
    axes.set_xticks(range(16), names, rotation=90)


def _sensitivity_panel(axes: Any, table: Sequence[Mapping[str, Any]]) -> None:
    columns = {
        "A\nsign.": "A",
        "D\nsign.": "D",
        "AD\nsign.": "AD",
        "B\nnot": "B",
        "C\nnot": "C",
        "A\n< 0": "A_sign",
        "D\n> 0": "D_sign",
        "AD\n> 0": "AD_sign",
    }
    values = [
        [math.nan if row["shares"][key] is None else row["shares"][key] for key in columns.values()] for row in table
    ]
    if not values:
        axes.axis("off")
        axes.text(0.5, 0.5, "no study is finished", ha="center", transform=axes.transAxes)
        return
    axes.imshow(np.array(values), vmin=0, vmax=1, cmap="RdYlGn", aspect="auto", alpha=0.55)
    for line, row in enumerate(table):
        for place, value in enumerate(values[line]):
            axes.text(place, line, "-" if math.isnan(value) else f"{value:.2g}", ha="center", va="center", fontsize=7)
        effects = [row["effects_mm"][name] for name in ("A", "D", "AD")]
        told = "  ".join("   -  " if effect is None else f"{effect:+.3f}" for effect in effects)
        axes.text(7.7, line, f"{told}   {row['seeds']} seeds", va="center", fontsize=7, family="monospace")
    axes.text(7.7, -0.95, "mean A, D, AD [mm]", fontsize=7)
    axes.set_xlim(-0.5, 12.5)
    axes.set_xticks(range(len(columns)), list(columns), fontsize=7)
    axes.set_yticks(range(len(table)), [row["variant"] for row in table], fontsize=7)
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    for side in axes.spines.values():
        side.set_visible(False)


if __name__ == "__main__":
    sys.exit(main("table3", make, __doc__))
