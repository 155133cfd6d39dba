"""What matters to a picture: causes of its deviation, and results of a study."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

import numpy as np

from radwrap.errors import InputError
from radwrap.face.traced import Image
from radwrap.manifest import read_manifest

_MOST_EFFECTS: Final = 50  # of a response; the others are in the study's own report


def parts_of(image: Image) -> dict[str, float]:
    """What each cause adds to the deviation of an image, rms over its pixels, the largest first [gray level]."""
    parts = {name: math.sqrt(float(np.mean(square))) for name, square in image.squares.items()}
    return dict(sorted(parts.items(), key=lambda part: -part[1]))


def study_told(folder: Path) -> dict[str, Any]:
    """What a study found: for each response the effects of its factors, the largest first, and sentences.

    Parameters
    ----------
    folder : Path
        That a study left.

    Raises
    ------
    InputError
        If it holds none, or its table cannot be read.
    """
    from radwrap.study.journal import RESULTS
    from radwrap.study.study import PLAN
    from radwrap.study.table import bare, read_table

    if not (folder / RESULTS).is_file():
        raise InputError(f"holds no {RESULTS}", where=str(folder), remedy="name the folder of a study that was run")
    columns = read_table(folder / RESULTS).columns
    names = {bare(column) for column in columns}
    responses = [column for column in columns if f"{bare(column)}_error" in names]
    plan = read_manifest(folder / PLAN) if (folder / PLAN).is_file() else {}
    title = plan.get("title")
    return {
        "title": title if isinstance(title, str) and title else folder.name,
        "responses": [_response(folder / RESULTS, column) for column in responses],
    }


def _response(path: Path, column: str) -> dict[str, Any]:
    from radwrap.study.effects import analyse, sentences
    from radwrap.study.levels import read_data

    told: dict[str, Any] = {"response": column, "runs": 0, "effects": [], "margin": None, "sentences": []}
    try:
        data = read_data(path, column)
        analysis = analyse(data)
    except InputError as error:
        return {**told, "sentences": [f"Nothing can be said of it: {error.what}"]}
    labels = {factor.name: factor.label for factor in data.factors}
    found = sorted(analysis.effects, key=lambda effect: -abs(effect.effect))[:_MOST_EFFECTS]
    return {
        **told,
        "runs": len(data.values),
        "margin": analysis.margin,
        "effects": [
            {
                "name": effect.name,
                "label": labels.get(effect.name, effect.name),
                "effect": effect.effect,
                "image_error": effect.image_error,
                "significant": effect.significant,
                "from": effect.start,
                "to": effect.end,
            }
            for effect in found
        ],
        "sentences": [*sentences(analysis), *analysis.notes],
    }
