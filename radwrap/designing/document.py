"""A design as a user writes it: DESIGN.toml to frozen values, everything checked that can be without a ray.

Errors name the file and the key, such as ``design.toml: keys.pinhole.low``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from radwrap.designing.keys import BALANCE, SearchKey, read_key
from radwrap.designing.light import levels_of
from radwrap.designing.quantities import (
    COST,
    PEAK,
    SCENES_OWN,
    TIME_OF_EXPOSURE,
    Constraint,
    Objective,
    Quantity,
    limits_of,
    quantity_of,
)
from radwrap.designing.tables import FEWEST_RENDERS, ConstraintModel, ObjectiveModel, ProblemModel
from radwrap.designing.worst import MOST, PERCENT, Allowed, read_allowed
from radwrap.errors import InputError
from radwrap.imaging.forecast.cost import check_size
from radwrap.reading import FileKind, read_text, read_toml
from radwrap.scene.file.faults import validated
from radwrap.scene.file.keys import expanded, set_key, steps_of, with_all_leds
from radwrap.scene.file.load import load_scene, scene_from_document
from radwrap.scene.scene import Scene
from radwrap.study.design import Design, render_options
from radwrap.study.design_responses import read_responses
from radwrap.study.responses import Response, check_response

_DESIGN_FILE: Final = FileKind("design file", 64 << 20)
_SCENE_FILE: Final = FileKind("scene file", 16 << 20, "")
_WORST: Final = "worst"
_TIME: Final = "camera.exposure_time"
_GRAY: Final = {"peak_gray", "mean_gray"}  # responses that go from black to white
_ROUNDING: Final = 1e-9  # of a limit
_TAKEN: Final = {"trial", "stage", "seed", "image_error", "met", "feasible", "warnings", "error"}


@dataclass(frozen=True, slots=True)
class Problem:
    """A design problem, checked.

    Attributes
    ----------
    study : Design
        Scene, render options and responses, as a study without factors has them.
    text : str
        The scene's file, which the best scene keeps but for its values.
    changes : Mapping
        Keys that ``[set]`` changes.
    keys : tuple of SearchKey
        What a search varies; the last one is `BALANCE` where levels have two objectives.
    levels : tuple of SearchKey
        Levels of sources, which are solved for on a light basis.
    time : SearchKey or None
        The exposure time, where it is solved for with them.
    objectives : tuple of Objective
        One or two.
    constraints : tuple of Constraint
    budget : int
        How many images may be rendered.
    batch : int
        How many candidates are asked for at a time.
    coarse : float
        How much coarser than the tolerance images are while it is searched.
    allowed : tuple of Allowed
        What the bench may be off by, where the worst case counts.
    """

    study: Design
    text: str
    changes: Mapping[str, Any]
    keys: tuple[SearchKey, ...]
    levels: tuple[SearchKey, ...]
    objectives: tuple[Objective, ...]
    constraints: tuple[Constraint, ...]
    budget: int
    batch: int
    coarse: float
    time: SearchKey | None = None
    allowed: tuple[Allowed, ...] = ()

    @property
    def free(self) -> tuple[SearchKey, ...]:
        """Keys that are searched and change the scene: all but the balance of two objectives that levels have."""
        return tuple(key for key in self.keys if key != BALANCE)

    @property
    def is_balanced(self) -> bool:
        """Whether levels are solved for between two objectives."""
        return BALANCE in self.keys

    @property
    def images_each(self) -> int:
        """Images of a candidate: it, and each corner of its tolerances."""
        return 1 + 2 ** len(self.allowed) if self.allowed else 1

    @property
    def origin(self) -> str:
        """Its file, for messages."""
        return self.study.origin

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """All that a trial tells: responses, and what is known of a scene without a ray."""
        measured = tuple(quantity_of(one.name, self.study.responses) for one in self.study.responses)
        return (*measured, *(quantity_of(name, ()) for name in SCENES_OWN))

    @property
    def solved(self) -> tuple[SearchKey, ...]:
        """Keys that are solved for on a light basis: levels, and the time."""
        return (*self.levels, *((self.time,) if self.time is not None else ()))

    def with_leds(self, document: Mapping[str, Any]) -> dict[str, Any]:
        """Tables in which rings list every LED, where levels of LEDs are sought."""
        return with_all_leds(document, [path for key in self.levels for path in key.keys])

    def scene(self, document: Mapping[str, Any]) -> Scene:
        """The scene of some tables."""
        return scene_from_document(document, origin=self.study.scene_origin, folder=self.study.folder)

    def documents(self) -> list[dict[str, Any]]:
        """Tables of the scene with each end or choice of each key, the others as the scene has them."""
        keys = (*self.free, *self.solved)
        return [with_values(self.study, key, key.values(code)) for key in keys for code in key.ends()]


def with_values(study: Design, key: SearchKey, values: Sequence[Any]) -> dict[str, Any]:
    """Tables of the base scene in which one key has a value."""
    return set_values(study.document, key, values, study.scene_origin)[0]


def set_values(
    document: Mapping[str, Any], key: SearchKey, values: Sequence[Any], origin: str
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Tables in which a key is set, rings with all their LEDs where it names some; and path -> value."""
    document = with_all_leds(document, key.keys)
    told: dict[str, Any] = {}
    for path, value in zip(key.keys, values, strict=True):
        for one in expanded(path, document):
            set_key(document, one, value, origin)
            told[one] = value
    return document, told


def read_problem(path: Path, *, trust: bool = False) -> Problem:
    """Read a design file and its scene.

    Parameters
    ----------
    path : Path
        The file.
    trust : bool
        Whether the user's own functions may be run as responses.

    Raises
    ------
    InputError
        What is wrong, with file and key; also where a bound or a choice gives no scene.
    """
    origin = path.name
    told = validated(ProblemModel, read_toml(path, _DESIGN_FILE), origin, "docs/design.md shows a design file")
    scene_path = path.parent / told.scene
    scene = load_scene(scene_path, told.set)
    keys = tuple(read_key(name, table, f"{origin}: keys.{name}") for name, table in told.keys.items())
    responses = read_responses(told.responses, path.parent, f"{origin}: responses") if told.responses else ()
    asked = [one.of for one in told.objectives] + [one.of for one in told.constraints]
    responses = _with_peak(responses, asked)
    is_balanced = len(told.objectives) > 1 and any(key.is_level for key in keys)
    balance = (BALANCE,) if is_balanced else ()
    _check_names((*keys, *balance), responses, origin)
    render_options(told.render.given(), f"{origin}: render")
    study = Design(
        title=told.title or path.stem,
        origin=origin,
        folder=scene.folder,
        scene_origin=scene.origin,
        document=json.loads(scene.document),
        seed=told.seed,
        replicates=1,
        kind="list",
        plan={},
        render=told.render.given(),
        basis=None,
        factors=(),
        responses=responses,
        analysis="none",
        home=path.parent,
    )
    is_fixed = render_options(study.render, origin).fixed_method is not None
    time = _time(keys, study, scene)
    problem = Problem(
        study=study,
        text=read_text(scene_path, _SCENE_FILE),
        changes=told.set,
        keys=(*(key for key in keys if not key.is_level and key is not time), *balance),
        levels=tuple(key for key in keys if key.is_level),
        objectives=_objectives(told.objectives, responses, origin),
        constraints=_constraints(told.constraints, responses, origin),
        budget=told.budget,
        batch=told.batch,
        coarse=1.0 if is_fixed else float(told.coarse),
        time=time,
        allowed=_allowed(told, origin),
    )
    _check(problem, keys, trust=trust, is_fixed=is_fixed)
    return problem


def _allowed(told: ProblemModel, origin: str) -> tuple[Allowed, ...]:
    """Tolerances of the worst case."""
    where = f"{origin}: tolerances"
    if (told.case == _WORST) != bool(told.tolerances):
        raise InputError(
            f'go with case = "{_WORST}", and that needs them',
            where=where,
            remedy="give both or none, see docs/design.md",
        )
    if len(told.tolerances) > MOST:
        raise InputError(
            f"are {len(told.tolerances)}, whose corners would be {2 ** len(told.tolerances)} images for each candidate",
            where=where,
            remedy=f"give the {MOST} that matter most; several keys may be off together",
        )
    return tuple(read_allowed(name, table, f"{where}.{name}") for name, table in told.tolerances.items())


def _time(keys: Sequence[SearchKey], study: Design, scene: Scene) -> SearchKey | None:
    """The key of the exposure time where levels are sought, and nothing but light hangs on it."""
    found = next((key for key in keys if key.span is not None and key.keys == (_TIME,)), None)
    if found is None or not any(key.is_level for key in keys):
        return None
    for code in found.ends():
        try:
            other = scene_from_document(
                with_values(study, found, found.values(code)), origin=study.scene_origin, folder=study.folder
            )
        except InputError:
            return None  # told where bounds are held against the scene
        if other.camera.sensor != scene.camera.sensor:  # dark current
            return None
    return found


def _with_peak(responses: tuple[Response, ...], asked: Sequence[str]) -> tuple[Response, ...]:
    """The peak gray level needs no table of its own."""
    if PEAK not in asked or any(one.name == PEAK for one in responses):
        return responses
    return (*responses, Response(PEAK, PEAK))


def _check_names(keys: Sequence[SearchKey], responses: Sequence[Response], origin: str) -> None:
    names = [*(key.name for key in keys), *(response.name for response in responses)]
    errors = {f"{response.name}_error" for response in responses}
    for name in names:
        if not name.isidentifier() or name in _TAKEN | errors | set(SCENES_OWN) or names.count(name) > 1:
            raise InputError(
                "cannot name a column, or names another one already",
                where=f"{origin}: {name}",
                remedy="use letters, digits and _, each name once",
            )


def _objectives(tables: Sequence[ObjectiveModel], responses: Sequence[Response], origin: str) -> tuple[Objective, ...]:
    found = []
    for number, table in enumerate(tables):
        quantity = quantity_of(table.of, responses, f"{origin}: objectives[{number}].of")
        found.append(Objective(quantity, table.aim == "maximise"))
    if len({one.quantity.name for one in found}) < len(found):
        raise InputError("are the same twice", where=f"{origin}: objectives")
    return tuple(found)


def _constraints(
    tables: Sequence[ConstraintModel], responses: Sequence[Response], origin: str
) -> tuple[Constraint, ...]:
    found = []
    for number, table in enumerate(tables):
        where = f"{origin}: constraints[{number}]"
        quantity = quantity_of(table.of, responses, f"{where}.of")
        low, high = limits_of(quantity, table.at_least, table.at_most, where)
        found.append(Constraint(quantity, low, high))
    return tuple(found)


# ------------------------------------------------------------------------------------------ checks before the first ray


def _check(problem: Problem, keys: Sequence[SearchKey], *, trust: bool, is_fixed: bool) -> None:
    study = problem.study
    for response in study.responses:
        if response.user is not None and not trust:
            raise InputError(
                f"{response.user.file} is code that would be run",
                where=f"{study.origin}: responses.{response.table}.measure",
                remedy="read it, then set `trust`",
            )
    if problem.levels and is_fixed:
        raise InputError(
            "levels of sources are solved for on a light basis, which is made to a tolerance",
            where=f"{study.origin}: render.method",
            remedy="leave the method out, or give the levels a step",
        )
    base = problem.scene(study.document)
    for response in study.responses:
        check_response(response, base, f"{study.origin}: responses.{response.told_in}")
    _check_apart(study, keys, problem.changes)
    _check_costs(problem)
    _check_corners(problem)
    ends = [_ends(problem, key) for key in keys]
    levels_of(problem.levels, study.document, base, study.origin)
    _check_reach(problem, base, ends)


def _check_corners(problem: Problem) -> None:
    """Refuse tolerances that do not fit the scene, and a budget that is too small for their corners."""
    document = problem.with_leds(problem.study.document)
    for one in problem.allowed:
        where = f"{problem.origin}: tolerances.{one.name}"
        one.refuse_nothing(document, where)
        _check_solved(problem, one, document, where)
        for sign in (-1.0, 1.0):
            moved = one.moved(document, sign, where)
            try:
                problem.scene(moved)
            except InputError as error:
                raise InputError(f"the scene does not take it: {error}", where=where, remedy=error.remedy) from error
    least = FEWEST_RENDERS * problem.images_each
    if problem.budget < least:
        raise InputError(
            f"is {problem.budget}, and each candidate takes {problem.images_each} images with the corners of its "
            "tolerances",
            where=f"{problem.origin}: budget",
            remedy=f"give {least} or more",
        )


def _check_solved(problem: Problem, one: Allowed, document: Mapping[str, Any], where: str) -> None:
    """Refuse an amount by which something is off that is solved for: light of the corners then is not in proportion."""
    solved = {path for key in problem.solved for asked in key.keys for path in expanded(asked, document)}
    if one.unit != PERCENT and not solved.isdisjoint(one.paths(document)):
        raise InputError(
            "is of a value that is solved for",
            where=f"{where}.by",
            remedy='give a share of the value, such as "3 %", or its key a step',
        )


def _ends(problem: Problem, key: SearchKey) -> list[Scene]:
    """Scenes at a key's bounds, or with each of its choices, of a size that may be rendered."""
    study, found = problem.study, []
    how = render_options(study.render, f"{study.origin}: render")
    for code in key.ends():
        where = f"{study.origin}: keys.{key.name}, {key.label(code)}"
        try:
            found.append(problem.scene(with_values(study, key, key.values(code))))
            check_size(found[-1], how.max_pixels, 1, 1)
        except InputError as error:
            if key.span is not None and key.span.is_whole and _takes(problem, key, int(code)):
                raise InputError(
                    "takes whole numbers only", where=f"{study.origin}: keys.{key.name}", remedy="add step = 1"
                ) from error
            told = f"{error.where}: {error.what}" if error.where else error.what
            raise InputError(told, where=where, remedy=error.remedy) from error
    return found


def _takes(problem: Problem, key: SearchKey, value: int) -> bool:
    """Whether there is a scene with a whole number at a key's places."""
    try:
        problem.scene(with_values(problem.study, key, [value] * len(key.keys)))
    except InputError:
        return False
    return True


def _check_reach(problem: Problem, base: Scene, ends: Sequence[Sequence[Scene]]) -> None:
    """Refuse limits that no values of the keys keep, where that is known without a ray."""
    time = base.camera.exposure_time
    times = [[scene.camera.exposure_time for scene in scenes] for scenes in ends]
    # One key at most sets it.
    exposures = next((one for one in times if any(value != time for value in one)), [time])
    costs = [key.costs for key in problem.keys if key.costs]
    whitest = max(scene.camera.sensor.saturation_gray for scene in (base, *(one for scenes in ends for one in scenes)))
    grays = {one.name for one in problem.study.responses if one.kind in _GRAY}
    reach = {
        TIME_OF_EXPOSURE: (min(exposures), max(exposures)),
        COST: (sum(map(min, costs)), sum(map(max, costs))),
        **dict.fromkeys(grays, (0.0, whitest)),
    }
    for number, one in enumerate(problem.constraints):
        least, most = reach.get(one.quantity.name, (-math.inf, math.inf))
        if one.low > most * (1 + _ROUNDING) or one.high < least * (1 - _ROUNDING):
            ends_at = " gray levels, the sensor's saturation_gray" if one.quantity.name in grays else ""
            raise InputError(
                f"nothing can keep {one.told()}: it goes from {one.quantity.told(least)} to {one.quantity.told(most)}"
                f"{ends_at}",
                where=f"{problem.origin}: constraints[{number}]",
            )


def _check_apart(study: Design, keys: Sequence[SearchKey], changes: Mapping[str, Any]) -> None:
    """Refuse two keys that set the same value, or one of which holds the other; and a change of what a key sets."""
    document = with_all_leds(study.document, [path for key in keys for path in key.keys])
    set_by: dict[tuple[str | int, ...], str] = {}
    changed = {steps_of(one): path for path in changes for one in expanded(path, document)}
    for key in keys:
        for path in key.keys:
            try:
                places = [steps_of(one) for one in expanded(path, document)]
            except InputError as error:
                raise InputError(
                    error.what, where=f"{study.origin}: keys.{key.name}: {error.where}", remedy=error.remedy
                ) from error
            for steps in places:
                for other, name in set_by.items():
                    shorter = min(len(other), len(steps))
                    if other[:shorter] == steps[:shorter]:
                        raise InputError(
                            f"sets {path}, which keys.{name} sets already", where=f"{study.origin}: keys.{key.name}"
                        )
                set_by[steps] = key.name
                within = next((path for other, path in changed.items() if other[: len(steps)] == steps), None)
                if within is not None:
                    raise InputError(
                        f"keys.{key.name} searches it, and its value here would not count",
                        where=f"{study.origin}: set: {within}",
                        remedy="leave one of both out",
                    )


def _check_costs(problem: Problem) -> None:
    asked = [one.quantity.name for one in problem.objectives]
    asked += [one.quantity.name for one in problem.constraints]
    if COST in asked and not any(key.costs for key in problem.keys):
        raise InputError("no choice has a cost", where=f"{problem.origin}: {COST}", remedy="give choices cost = [...]")
