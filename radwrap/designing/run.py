"""A design from its file to its best scene: search coarsely, decide finely, check by other rays."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Final

from radwrap.designing.bench import RECORDS, Bench
from radwrap.designing.candidates import candidate_of
from radwrap.designing.document import Problem, read_problem
from radwrap.designing.judged import pareto_front, ranked, shortlist, ties_of
from radwrap.designing.keys import STEPS_OF_BALANCE
from radwrap.designing.page import PAGE, write_page
from radwrap.designing.sampler import AllOf, Asker, Codes, Tpe
from radwrap.designing.told import BEST, DESIGN, Designed
from radwrap.designing.trials import TRIALS, Trial, read_record, write_table
from radwrap.errors import EnvironmentFailure, InputError
from radwrap.files import check_not_others, check_results, make_folder, sole_owner, write_bytes
from radwrap.fitting.scene_text import with_values
from radwrap.imaging.asked_tolerance import USUAL
from radwrap.imaging.tracing import laid_out
from radwrap.manifest import (
    COMPILER_PACKAGES,
    SCHEMA_VERSION,
    STUDY_PACKAGES,
    plain,
    read_manifest,
    sha256_of_value,
    versions,
    write_manifest,
)
from radwrap.progress import Progress
from radwrap.scene.colour_planes import refuse_mosaic
from radwrap.scene.file.input_hashes import input_hashes
from radwrap.scene.instants import refuse_time
from radwrap.study.design import render_options
from radwrap.study.one_tolerance import with_one_tolerance
from radwrap.study.one_tracer import one_tracer
from radwrap.study.runs import Run
from radwrap.study.study import StudyOptions, known_tracer, open_pool
from radwrap.tracers.engine import EngineName
from radwrap.tracers.expressible import compiler_lacks, inexpressible

PLAN: Final = "plan.json"
FILES: Final = (PLAN, TRIALS, BEST, PAGE, DESIGN)
PACKAGES: Final = ("optuna", "clarabel", "tomlkit")
# Of the budget, at most: for images at the tolerance asked for, of those that may be best.
_DECIDE_SHARE: Final = 0.25
_MOST_DECIDED: Final = 8
_ASKED: Final = 10  # times the budget: candidates that need no image cost nothing, but do not go on for ever


def design(file: str | Path, out: str | Path, options: StudyOptions | None = None) -> Designed:
    """Find the values of a scene's keys that make a measurement best.

    Parameters
    ----------
    file : str or Path
        DESIGN.toml: scene, keys, objectives, constraints and budget, see docs/design.md.
    out : str or Path
        Folder for design.json, trials.csv, best.toml and index.html. An equal design that was begun there goes on.
    options : StudyOptions, optional
        How it is carried out; nothing of it changes a number but the tracer.

    Returns
    -------
    Designed
        The best scene, what limits it, ties, and every trial.

    Raises
    ------
    InputError
        If the file is wrong, or the folder holds another design.
    EnvironmentFailure
        If a library, a tracer or the disk fails.

    Examples
    --------
    >>> import radwrap
    >>> from pathlib import Path
    >>> text = '''
    ... scene = "scene.toml"
    ... budget = 3
    ... coarse = 1
    ... set = { "camera.sensor.scale" = "1/8" }
    ... render = { tolerance = 8 }
    ... objectives = [{ of = "mean", aim = "maximise" }]
    ... constraints = [{ of = "exposure_time", at_most = "300 ms" }]
    ... keys.time = { key = "camera.exposure_time", choices = ["200 ms", "400 ms"] }
    ... responses.mean = { measure = "mean_gray" }
    ... '''
    >>> _ = Path("design.toml").write_text(text)
    >>> found = radwrap.design("design.toml", "out")
    >>> found.best.values
    {'camera.exposure_time': '200 ms'}
    """
    options = options or StudyOptions()
    return run_design(read_problem(Path(file), trust=options.trust), Path(out), options)


def run_design(problem: Problem, out: Path, options: StudyOptions) -> Designed:
    """Carry out a design that was read; arguments and errors as of `design`."""
    check_results(out, FILES)
    check_not_others(out, FILES, PLAN, "design")
    make_folder(out)
    with sole_owner(out):
        known = known_tracer(out) if options.tracer == "auto" else None
        refuse_mosaic(problem.scene(problem.study.document), "a design")
        refuse_time(problem.scene(problem.study.document), "a design")
        runs = _runs(problem)
        options = replace(options, tracer=known or _tracer(problem, runs, options))
        study, _ = with_one_tolerance(problem.study, runs, options.of_render)
        problem = replace(problem, study=study)
        _take_possession(problem, out, options)
        if options.retry_failed:
            _forget_failures(out)
        progress = Progress("renders", problem.budget, shown=options.progress)
        with closing(open_pool(options, out)) as pool, closing(progress):
            found = _found(problem, Bench(problem, out, options, pool, progress))
        _write(found, out)
    return found


def _write(found: Designed, out: Path) -> None:
    """Files of a design, design.json last."""
    (out / DESIGN).unlink(missing_ok=True)
    write_table(out / TRIALS, found.problem, found.trials)
    if found.best is None:
        (out / BEST).unlink(missing_ok=True)
    else:
        text = with_values(found.problem.text, {**found.problem.changes, **found.best.values})
        write_bytes(out / BEST, text.encode())
    write_page(out / PAGE, found)
    write_manifest(out / DESIGN, found.manifest)


# --------------------------------------------------------------------------------------------------------------- stages


def _found(problem: Problem, bench: Bench) -> Designed:
    tolerance, seed = _tolerance(problem), problem.study.seed
    is_one = not problem.free  # nothing is searched: the first look decides
    coarse = None if tolerance is None else tolerance * (1.0 if is_one else problem.coarse)
    is_coarse = coarse != tolerance
    each = problem.images_each
    decided = max(1, min(_MOST_DECIDED, math.floor(_DECIDE_SHARE * problem.budget / each))) if is_coarse else 0
    most = problem.budget - each * (1 + is_coarse)  # one is checked, one decided
    trials, how = _searched(problem, bench, coarse, (problem.budget - each * (decided + 1), most))
    undecided: list[Trial] = []
    if is_coarse:
        searched, trials = trials, _decided(problem, bench, trials, decided)
        tried = {trial.codes for trial in trials}
        undecided = [one for one in _each_once(shortlist(problem, searched, len(searched))) if one.codes not in tried]
    order = ranked(problem, trials)
    best = order[0] if order else None
    check = None
    if best is not None:
        again = candidate_of(problem, best.codes, best.levels)
        (check,) = bench.look_at([again], "check", tolerance, seed + 1, sought=False)
    unique = _each_scene_once(trials)
    return Designed(
        problem=problem,
        best=best,
        check=check,
        ties=tuple(ties_of(problem, best, unique)) if best is not None else (),
        front=tuple(pareto_front(problem, unique)) if len(problem.objectives) == 2 else (),
        undecided=tuple(undecided),
        trials=tuple(bench.trials),
        renders=bench.renders,
        how=how,
        tolerance=tolerance,
    )


def _decided(problem: Problem, bench: Bench, trials: Sequence[Trial], most: int) -> list[Trial]:
    """Those that may be best, at the tolerance asked for; where none of them keeps all limits, those that follow."""
    found: list[Trial] = []
    tried: set[Codes] = set()
    while len(tried) < most and not any(trial.is_feasible(problem) for trial in found):
        left = [trial for trial in trials if trial.codes not in tried]
        chosen = _each_once(shortlist(problem, left, most - len(tried)))
        if not chosen:
            break
        if problem.is_balanced:  # other levels on the same light take no image
            light = {trial.codes[:-1] for trial in chosen}
            chosen = [one for one in _each_once(left) if one.codes[:-1] in light]
        tried |= {trial.codes for trial in chosen}
        candidates = [candidate_of(problem, one.codes) for one in chosen]
        found += bench.look_at(candidates, "decide", _tolerance(problem), problem.study.seed)
    return found


def _each_once(trials: Sequence[Trial]) -> list[Trial]:
    """Of equal trials the first."""
    return list({trial.codes: trial for trial in reversed(trials)}.values())[::-1]


def _each_scene_once(trials: Sequence[Trial]) -> list[Trial]:
    """Of trials of one scene the first: all balances lead to the same levels where these change one objective only."""
    return list({sha256_of_value(trial.values): trial for trial in reversed(trials)}.values())[::-1]


def _tolerance(problem: Problem) -> float | None:
    how = render_options(problem.study.render, problem.origin)
    if how.fixed_method is not None:
        return None
    return USUAL if how.tolerance is None else float(how.tolerance)


def _searched(
    problem: Problem, bench: Bench, tolerance: float | None, budgets: tuple[int, int]
) -> tuple[list[Trial], str]:
    """Trials of the search, and how candidates were chosen.

    Of two budgets of renders the second, larger one holds as long as no trial keeps all limits: then there is nothing
    to decide.
    """
    each = problem.images_each
    asker, how = _asker(problem, budgets[0] // each)
    found: list[Trial] = []
    budget = budgets[1]
    while bench.renders + each <= budget and len(found) < _ASKED * problem.budget:
        codes = asker.ask(min(problem.batch, (budget - bench.renders) // each))
        if not codes:
            break
        if problem.is_balanced and isinstance(asker, AllOf):  # all levels on one light
            codes = [(*one, step) for one in codes for step in range(STEPS_OF_BALANCE)]
        candidates = [candidate_of(problem, one) for one in codes]
        trials = bench.look_at(candidates, "search", tolerance, problem.study.seed)
        for trial in trials:
            answers = trial.objectives(problem)
            values = None if answers is None else [one.value for one in answers]
            asker.tell(values, trial.violations(problem))
        found += trials
        if any(trial.is_feasible(problem) for trial in found):
            budget = budgets[0]
    return found, how


def _asker(problem: Problem, budget: int) -> tuple[Asker, str]:
    keys, free = problem.keys, problem.free
    if all(key.span is None for key in free) and math.prod(len(key.choices) for key in free) <= budget:
        return AllOf(free), "every combination"
    maximised = [one.is_maximised for one in problem.objectives]
    return Tpe(keys, maximised, problem.study.seed, problem.batch), "optuna's TPE"


# ------------------------------------------------------------------------------------------------ what the folder holds


def _tracer(problem: Problem, runs: Sequence[Run], options: StudyOptions) -> EngineName:
    """Who traces all candidates: as in a study, but our own wherever it can; of many small images that costs less."""
    usual = one_tracer(problem.study, runs, options.of_render)
    if usual != "radiance" or options.tracer != "auto" or compiler_lacks():
        return usual
    scenes = [problem.scene(document) for document in (problem.study.document, *problem.documents())]
    if any(inexpressible(scene) for scene in scenes):
        return usual
    how = {**options.of_render, "tracer": "compiled"}
    try:
        with laid_out(scenes[0], render_options(problem.study.render, problem.origin, **how)) as traced:
            return traced.tracer_used.name
    except EnvironmentFailure:  # they do not agree
        return usual


def _runs(problem: Problem) -> list[Run]:
    """Scenes at the ends of all keys, as runs of a study: tracer and tolerance are those of all."""
    study = problem.study
    return [
        Run(number, 1, number, (), study.seed, document, study.render, study.responses)
        for number, document in enumerate(problem.documents(), 1)
    ]


def _take_possession(problem: Problem, out: Path, options: StudyOptions) -> None:
    """Write what the design is, or make sure that it is the one that lies there; its budget may change."""
    told: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "title": problem.study.title,
        "problem": _told_of(problem),
        "files": input_hashes(
            [problem.study.document, *problem.documents()],
            problem.study.scene_origin,
            problem.study.folder,
            trust=options.trust,
        ),
        "tracer": options.tracer,
        "trust": options.trust,
        "versions": versions(*STUDY_PACKAGES, *COMPILER_PACKAGES, *PACKAGES),
    }
    programs = {name: value for name, value in told["versions"].items() if name != "platform"}
    told["design_sha256"] = sha256_of_value({**told, "versions": programs})
    if (out / PLAN).exists():
        if read_manifest(out / PLAN).get("design_sha256") != told["design_sha256"]:
            raise InputError(
                "holds another design, or one made with other files or programs",
                where=str(out),
                remedy="choose another `out`",
            )
        return
    write_manifest(out / PLAN, told)


def _told_of(problem: Problem) -> dict[str, Any]:
    """A problem as JSON, without the places where it lies, and without its budget."""
    study = asdict(replace(problem.study, folder=Path(), home=Path()))
    told: dict[str, Any] = plain({**asdict(replace(problem, budget=0)), "study": study})
    decided: dict[str, Any] = _finite({key: value for key, value in told.items() if key not in ("budget", "text")})
    return decided


def _finite(value: Any) -> Any:
    """Numbers that JSON cannot hold as text: a limit that is not there is infinite."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def _forget_failures(out: Path) -> None:
    """Take away records of renders that failed, so that they are made again."""
    for path in sorted((out / RECORDS).glob("*.json")):
        record = read_record(path)
        if record is not None and record["image_error"] is None:
            path.unlink()
