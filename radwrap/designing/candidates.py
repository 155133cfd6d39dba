"""From codes to a scene: what a candidate is, before anything of it is rendered."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

from radwrap.designing.document import Problem, set_values
from radwrap.designing.keys import Code
from radwrap.designing.quantities import scenes_own
from radwrap.errors import InputError
from radwrap.scene.file.keys import set_key
from radwrap.study.seen import Answer


@dataclass(frozen=True, slots=True)
class Candidate:
    """A scene that a design may come to.

    Attributes
    ----------
    codes : tuple
        Of each key that is searched.
    document : Mapping
        Tables of its scene.
    values : Mapping
        Key path -> value of all that is set.
    own : Mapping of str to Answer
        What is known of it without a ray.
    levels : Mapping
        Those among them that were found on a light basis.
    fault : str
        Why it is no scene; empty where it is one.
    """

    codes: tuple[Code, ...]
    document: Mapping[str, Any]
    values: Mapping[str, Any]
    own: Mapping[str, Answer]
    levels: Mapping[str, Any]
    fault: str = ""


def candidate_of(problem: Problem, codes: Sequence[Code], levels: Mapping[str, Any] | None = None) -> Candidate:
    """The candidate of a code for each searched key.

    Parameters
    ----------
    problem : Problem
        Whose scene is changed.
    codes : sequence
        In the order of its keys.
    levels : Mapping, optional
        Key path -> level of a source that was found.
    """
    document: dict[str, Any] = dict(problem.study.document)
    values: dict[str, Any] = {}
    # Single LEDs last: how many there are may be a choice.
    for key, code in sorted(zip(problem.keys, codes, strict=True), key=lambda pair: pair[0].names_leds):
        document, told = set_values(document, key, key.values(code), problem.study.scene_origin)
        values |= told
    document = problem.with_leds(document)
    cost = sum(key.cost(code) for key, code in zip(problem.keys, codes, strict=True))
    found = dict(levels or {})
    for path, value in found.items():
        set_key(document, path, value, problem.study.scene_origin)
        values[path] = value
    try:
        scene = problem.scene(document)
    except InputError as error:
        return Candidate(tuple(codes), document, values, {}, found, str(error))
    return Candidate(tuple(codes), document, values, scenes_own(scene, cost), found)


def corners(problem: Problem, candidate: Candidate) -> list[Candidate]:
    """A candidate with each combination of its tolerances at their ends; levels that were found stay.

    Raises
    ------
    InputError
        If a tolerance does not fit the scene.
    """
    made = []
    for signs in product((-1.0, 1.0), repeat=len(problem.allowed)):
        document: Mapping[str, Any] = candidate.document
        for one, sign in zip(problem.allowed, signs, strict=True):
            document = one.moved(document, sign, f"{problem.origin}: tolerances.{one.name}")
        try:
            scene = problem.scene(document)
        except InputError as error:
            made.append(replace(candidate, document=document, own={}, fault=str(error)))
            continue
        own = scenes_own(scene, candidate.own["cost"].value)
        made.append(replace(candidate, document=document, own=own))
    return made
