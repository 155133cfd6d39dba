"""From a design to its runs: which levels, which scene, which image, and which images are one and the same."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from copy import deepcopy
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Final

from radwrap.errors import InputError
from radwrap.imaging.demand import REPLICATES
from radwrap.imaging.forecast.cost import check_size
from radwrap.imaging.in_time.making import refuse_for_time
from radwrap.imaging.render_options import RenderOptions
from radwrap.manifest import sha256_of_value
from radwrap.random_streams import generator
from radwrap.scene.colour_planes import refuse_mosaic
from radwrap.scene.file.keys import expanded, set_key, steps_of
from radwrap.scene.file.load import scene_from_document
from radwrap.scene.instants import keys_of_time, refuse_time
from radwrap.scene.scene import Scene
from radwrap.study.design import Analysis, Design, check_render_option, render_options
from radwrap.study.design_tables import MOST_RUNS
from radwrap.study.factors import Draw, Factor, Level, settings
from radwrap.study.lenth import check_contrasts
from radwrap.study.responses import Response, check_options, check_response

_RENDER: Final = "render."
_RESPONSES: Final = "responses."


@dataclass(frozen=True, slots=True)
class Run:
    """One run of a study.

    Attributes
    ----------
    index : int
        From 1.
    replicate, row : int
        From 1; which repetition of which combination of levels.
    levels : tuple of Level
        Of each factor.
    seed : int
        Of the render.
    document : Mapping
        Tables of its scene.
    render : Mapping
        Options of its render.
    responses : tuple of Response
        With the options that the run's levels give them.
    """

    index: int
    replicate: int
    row: int
    levels: tuple[Level, ...]
    seed: int
    document: Mapping[str, Any]
    render: Mapping[str, Any]
    responses: tuple[Response, ...]

    @property
    def image(self) -> str:
        """Hash of all that decides its image."""
        return sha256_of_value({"scene": self.document, "render": self.render, "seed": self.seed})


def runs_of(design: Design) -> tuple[Run, ...]:
    """All runs of a design, in the order of their index.

    Raises
    ------
    InputError
        If the design asks for too many runs, or a list names a level that does not exist.
    """
    rows = combinations(design)
    if len(rows) * design.replicates > MOST_RUNS:
        raise InputError(f"more than {MOST_RUNS} runs", where=f"{design.origin}: design")
    return tuple(
        run_with(design, levels, index=replicate * len(rows) + row + 1, replicate=replicate, row=row)
        for replicate in range(design.replicates)
        for row, levels in enumerate(rows)
    )


def run_with(design: Design, levels: tuple[Level, ...], *, index: int, replicate: int, row: int) -> Run:
    """The run of a combination of levels; `replicate` and `row` from 0, they decide what is drawn."""
    document: dict[str, Any] = json.loads(json.dumps(design.document))
    render = dict(design.render)
    options = {response.told_in: dict(response.options) for response in design.responses}
    for factor, level in zip(design.factors, levels, strict=True):
        random = factor.random(design.seed, replicate, row)
        for key, value in settings(factor, level, design.document, random):
            if key.startswith(_RENDER):
                render[key.removeprefix(_RENDER)] = value
            elif key.startswith(_RESPONSES):
                name, _, option = key.removeprefix(_RESPONSES).partition(".")
                options[name][option] = value
            else:
                set_key(document, key, value, design.scene_origin)
    responses = tuple(replace(response, options=options[response.told_in]) for response in design.responses)
    return Run(index, replicate + 1, row + 1, levels, design.seed + replicate, document, render, responses)


# ------------------------------------------------------------------------------------------------------ combinations


def combinations(design: Design) -> list[tuple[Level, ...]]:
    """Levels of each row of the design; in a full factorial the last factor changes fastest."""
    match design.kind:
        case "full":
            return _full(design)
        case "fractional":
            return _fractional(design)
        case "latin_hypercube":
            return _latin_hypercube(design)
    return [_listed(design, row, number) for number, row in enumerate(_rows(design))]


def _full(design: Design) -> list[tuple[Level, ...]]:
    levels = [factor.levels for factor in design.factors]
    if math.prod(map(len, levels)) > MOST_RUNS:
        raise InputError(f"more than {MOST_RUNS} runs", where=f"{design.origin}: design")
    return list(product(*levels))


def _chosen(design: Design, numbers: Iterable[int]) -> tuple[Level, ...]:
    return tuple(factor.levels[number] for factor, number in zip(design.factors, numbers, strict=True))


def _fractional(design: Design) -> list[tuple[Level, ...]]:
    from pyDOE3 import fracfact

    where = f"{design.origin}: design.generators"
    for factor in design.factors:
        if len(factor.levels) != 2:
            raise InputError(
                f"a fractional design needs two levels, {factor.name} has {len(factor.levels)}", where=where
            )
    generators = design.plan["generators"]
    try:
        signs = fracfact(generators)
    except Exception as error:  # the library tells of bad generators by errors of many kinds
        raise InputError(
            f'"{generators}" are not generators: {error}', where=where, remedy='such as "a b c abc"'
        ) from error
    if signs.shape[1] != len(design.factors):
        raise InputError(f"{signs.shape[1]} generators for {len(design.factors)} factors", where=where)
    return [_chosen(design, row) for row in (signs > 0).astype(int)]


def _latin_hypercube(design: Design) -> list[tuple[Level, ...]]:
    from pyDOE3 import lhs

    shares = lhs(len(design.factors), samples=design.plan["runs"], seed=design.seed)
    return [
        tuple(factor.level_at(float(share)) for factor, share in zip(design.factors, row, strict=True))
        for row in shares
    ]


def _rows(design: Design) -> list[Any]:
    rows = design.plan["runs"]
    if not isinstance(rows, list) or not rows:
        raise InputError("must be an array of runs, or the name of a CSV file", where=f"{design.origin}: design.runs")
    return rows


def _listed(design: Design, row: Any, number: int) -> tuple[Level, ...]:
    where = f"{design.origin}: design.runs[{number}]"
    if not isinstance(row, list) or len(row) != len(design.factors):
        raise InputError(f"needs the level of each of the {len(design.factors)} factors", where=where)
    found = []
    for factor, name in zip(design.factors, row, strict=True):
        level = next((level for level in factor.levels if level.name == str(name)), None)
        if level is None:
            known = ", ".join(level.name for level in factor.levels)
            raise InputError(f'{factor.name} has no level "{name}"', where=where, remedy=f"it has {known}")
        found.append(level)
    return tuple(found)


# ------------------------------------------------------------------------------------------ checks before the first ray


def analysis_of(design: Design) -> Analysis:
    """How a design's effects are judged, where the user does not say."""
    if design.analysis is not None:
        return design.analysis
    if design.replicates > 1:
        return "anova"
    two_levels = all(len(factor.levels) == 2 for factor in design.factors)
    return "lenth" if two_levels and design.kind in ("full", "fractional") else "none"


def check_design(design: Design, options: Mapping[str, Any]) -> None:
    """Refuse what cannot work, before the first ray: each level of each factor alone, responses, and the analysis.

    Raises
    ------
    InputError
        Naming factor and level.
    """
    if analysis_of(design) == "lenth":
        try:
            check_contrasts(len(combinations(design)) - 1)
        except InputError as error:
            raise InputError(error.what, where=f"{design.origin}: design", remedy=error.remedy) from error
    if design.analysis == "anova":
        _check_anova(design)
    _check_trusted(design, trust=bool(options.get("trust")))
    for factor in design.factors:
        for level in factor.levels or (factor.level_at(0.0), factor.level_at(1.0)):
            _check_level(design, factor, level, options)
    _check_keys(design)
    scene = scene_from_document(design.document, origin=design.scene_origin, folder=design.folder)
    for response in design.responses:
        check_response(response, scene, f"{design.origin}: responses.{response.told_in}")
    if design.basis:
        render_options(design.render, f"{design.origin}: render", basis=True)


def _check_trusted(design: Design, *, trust: bool) -> None:
    """Refuse to run the user's code, unless the user says so."""
    for response in design.responses:
        if response.user is not None and not trust:
            raise InputError(
                f"{response.user.file} is code that would be run",
                where=f"{design.origin}: responses.{response.table}.measure",
                remedy="read it, then set `trust`",
            )


def _check_anova(design: Design) -> None:
    """Refuse an analysis of variance that has nothing left for the noise."""
    where = f"{design.origin}: analysis"
    if any(factor.span is not None for factor in design.factors):
        raise InputError("an analysis of variance needs levels, and a Latin hypercube has ranges", where=where)
    runs = len(combinations(design)) * design.replicates
    needed = 1 + sum(len(factor.levels) - 1 for factor in design.factors)
    if runs <= needed:
        raise InputError(
            f"{runs} runs are too few for an analysis of variance of {needed - 1} effects",
            where=where,
            remedy="repeat them (replicates = 2)",
        )


def _check_keys(design: Design) -> None:
    """Refuse two keys that set the same value, or one of which holds the other: the later one would hide the first."""
    set_by: dict[tuple[str | int, ...], str] = {}
    set_within: dict[tuple[str | int, ...], str] = {}
    for factor in design.factors:
        for full in (full for key in factor.keys for full in expanded(key, design.document)):
            steps = steps_of(full)
            holders = [steps[:length] for length in range(1, len(steps) + 1)]
            other = next((set_by[holder] for holder in holders if holder in set_by), set_within.get(steps))
            if other is not None:
                raise InputError(
                    f"sets {full}, which factors.{other} sets already",
                    where=f"{design.origin}: factors.{factor.name}",
                    remedy="vary it by one key",
                )
            set_by[steps] = factor.name
            set_within.update(dict.fromkeys(holders, factor.name))


def _check_level(design: Design, factor: Factor, level: Level, options: Mapping[str, Any]) -> None:
    where = f"{design.origin}: factors.{factor.name}, level {level.name}"
    for values in _ends(level):
        document: dict[str, Any] = deepcopy(dict(design.document))
        render = dict(design.render)
        changed: dict[str, dict[str, Any]] = {}
        for key, value in settings(factor, Level(level.name, values), design.document, generator(0)):
            if key.startswith(_RENDER):
                check_render_option(key.removeprefix(_RENDER), value, where)
                render[key.removeprefix(_RENDER)] = value
            elif key.startswith(_RESPONSES):
                response, option = _response_of(design, key, where)
                check_options(response.kind, {option: value}, where)
                changed.setdefault(response.told_in, {})[option] = value
            else:
                _set(document, key, value, where)
        how = render_options(render, where, **options)
        try:
            scene = scene_from_document(document, origin=design.scene_origin, folder=design.folder)
            replicates = REPLICATES if how.fixed_method is None else 0
            check_size(scene, how.max_pixels, max(replicates, 1), 1, replicates=replicates)
            _check_decided(scene, how, design.basis)
        except InputError as error:
            raise InputError(f"{error.where}: {error.what}", where=where, remedy=error.remedy) from error
        for response in design.responses:
            if there := changed.get(response.told_in):
                asked = replace(response, options={**response.options, **there})
                check_response(asked, scene, f"{where}: responses.{response.told_in}")


def _check_decided(scene: Scene, how: RenderOptions, basis: bool | None) -> None:
    """See that it is decided once for all runs whether they have diffraction: pilots do that, and the scene."""
    refuse_mosaic(scene, "a study")
    refuse_for_time(scene, how)
    if basis:
        refuse_time(scene, "a light basis of a study")
    camera = scene.camera
    alone = "sub-viewpoints" if how.fixed_method == "viewpoints" else "scenes that change in the course of an exposure"
    shared = how.fixed_method != "viewpoints" and not keys_of_time(scene)
    if not shared and camera.diffraction == "auto" and not camera.aperture.is_infinitesimal:
        raise InputError(
            f"would be decided by each run for itself, as {alone} have no pilots",
            where="camera.diffraction",
            remedy='set it "on" or "off"',
        )


def _set(document: dict[str, Any], key: str, value: Any, where: str) -> None:
    try:
        set_key(document, key, value, "scene")
    except InputError as error:
        raise InputError(error.what, where=f"{where}: {key}", remedy=error.remedy) from error


def _ends(level: Level) -> list[tuple[Any, ...]]:
    """The values of a level; of draws both ends."""
    if not level.is_random:
        return [level.values]
    pairs = [value.ends if isinstance(value, Draw) else (value, value) for value in level.values]
    return [tuple(pair[end] for pair in pairs) for end in (0, 1)]


def _response_of(design: Design, key: str, where: str) -> tuple[Response, str]:
    """The response that a key names, and its option."""
    name, _, option = key.removeprefix(_RESPONSES).partition(".")
    response = next((response for response in design.responses if response.told_in == name), None)
    if response is None:
        raise InputError(f'no response "{name}"', where=where, remedy="define it in [responses]")
    if response.user is not None:
        raise InputError("a Python function has no options that vary", where=where, remedy="define two responses")
    return response, option
