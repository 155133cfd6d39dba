"""Tolerances in sentences and as JSON."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from radwrap.manifest import SCHEMA_VERSION
from radwrap.study.tolerances import Confirmed, Tolerances


def sentences(result: Tolerances) -> Iterator[str]:
    """What was found, a line each."""
    unit = f" {result.response.unit}" if result.response.unit else ""
    name = result.response.name
    yield f"{name} is {result.nominal:.6g}{unit} nominally and may change by {result.bound:.3g}{unit}."
    for one in result.found:
        who = f"{one.factor.label} ({one.factor.name})"
        change = max(one.confirmed, key=lambda seen: abs(seen.change))
        sure = "" if change.error is None else f" +- {change.error:.1g}"
        seen = f"fresh renders: {change.change:+.3g}{sure}{unit}"
        if one.kind == "scatter" and not one.met:
            yield f"{who}: no scatter was confirmed, too few systems stay within; {seen} at most."
        elif one.kind == "scatter":
            yield f"{who}: {one.tolerance:.3g} times the scatter of the study; {seen} at most."
        elif not one.met:
            yield f"{who}: no tolerance was found; {seen} at {change.at}."
        else:
            least = "at least " if one.limited else ""
            own = f" {one.unit}" if one.unit else ""
            yield f"{who}: {least}{one.direction} {one.tolerance:.3g}{own} about {one.nominal}; {seen}."
    if result.together is not None:
        both = result.together
        # What is drawn about a fixed level is not drawn there: with it, fewer systems stay within.
        scatters = ", ".join(one.factor.name for one in result.found if one.kind == "scatter")
        which = f"All deviations together, without the scatter of {scatters}," if scatters else "All together"
        yield (
            f"{which} at {both.scale:.2g} times these: {both.share:.1%} of random systems stay within by the "
            f"model, {both.inside} of {both.systems} fresh ones do"
            + ("." if both.met else ": too few, the scale is not confirmed.")
        )
    if result.left_out:
        yield f"Without a tolerance, as their levels are only words or draws: {', '.join(result.left_out)}."
    if result.images_not_met:
        yield f"{result.images_not_met} images do not keep the tolerance of [render]: they are less exact than asked."
    yield from (f"Note: {note}." for note in result.notes)


def as_json(result: Tolerances) -> dict[str, Any]:
    """All that was found."""
    return {
        "schema_version": SCHEMA_VERSION,
        "response": result.response.name,
        "unit": result.response.unit,
        "nominal": result.nominal,
        "bound": result.bound,
        "share": result.share,
        "met": result.met,
        "factors": {
            one.factor.name: {
                "kind": one.kind,
                "label": one.factor.label,
                "tolerance": one.tolerance,
                "unit": one.unit,
                "nominal": one.nominal,
                "direction": one.direction,
                "by_model": one.by_model if math.isfinite(one.by_model) else None,
                "limited_by_range": one.limited,
                "met": one.met,
                "confirmed": [_seen(seen) for seen in one.confirmed],
                "halfway": [_seen(seen) for seen in one.halfway],
            }
            for one in result.found
        },
        "together": None
        if result.together is None
        else {
            "scale": result.together.scale,
            "share_by_model": result.together.share,
            "inside": result.together.inside,
            "systems": result.together.systems,
            "met": result.together.met,
        },
        "images_not_met": result.images_not_met,
        "left_out": list(result.left_out),
        "notes": list(result.notes),
        "sentences": list(sentences(result)),
    }


def _seen(seen: Confirmed) -> dict[str, Any]:
    return {"at": seen.at, "change": seen.change, "error": seen.error}
