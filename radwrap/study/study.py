"""A study from its design to its table: plan the jobs so that nothing is traced twice, do them, say what came of it."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

from radwrap.errors import InputError
from radwrap.files import make_folder, sole_owner
from radwrap.imaging.asked_tolerance import USUAL
from radwrap.imaging.render_options import TracerName
from radwrap.imaging.tolerance.lit_noise import ToleranceAsked
from radwrap.manifest import SCHEMA_VERSION, STUDY_PACKAGES, read_manifest, sha256_of_value, versions, write_manifest
from radwrap.process import Programs, available_cores
from radwrap.progress import Progress
from radwrap.scene.file.input_hashes import input_hashes
from radwrap.study.design import Design, render_options
from radwrap.study.in_time import changes_in_time
from radwrap.study.journal import RESULTS, Journal
from radwrap.study.light import reference_levels, split_light, with_levels
from radwrap.study.one_tolerance import with_one_tolerance
from radwrap.study.one_tracer import one_tracer
from radwrap.study.pilots import Plans, told_of
from radwrap.study.pool import WORKER_TIMEOUT, DaskPool, LocalPool, Pool, check_workers
from radwrap.study.responses import Response
from radwrap.study.runner import Scheduler, Step, chunks
from radwrap.study.runs import Run, analysis_of, check_design, runs_of
from radwrap.study.sampled import PILOTS, read_plans, sampled, with_pilots
from radwrap.study.worker import Job, Measured
from radwrap.tracers.engine import ENGINES, EngineName
from radwrap.tracers.installation import find_radiance
from radwrap.tracers.installation import version as radiance_version

PLAN: Final = "plan.json"
STUDY: Final = "study.json"
_RENDERS: Final = "renders"
_BASES: Final = "bases"
_NAME: Final = 20  # digits of a hash that name a folder
# A basis costs a render for each source and one for all together, and its levels are free afterwards.
_BASIS_OVERHEAD: Final = 2
# Images that one job makes from a basis: to read that takes as long as 15 images do, so that a study of many has fewer
# and longer jobs, but enough for many workers, and each ends soon.
_FEWEST_RELIT, _MOST_RELIT = 32, 256
_RELIT_JOBS: Final = 32


@dataclass(frozen=True, slots=True)
class StudyOptions:
    """How a study is carried out; nothing of it changes a number.

    Attributes
    ----------
    workers : int, optional
        Processes; default one a core.
    dask : str, optional
        Address of a Dask scheduler, in place of own processes.
    worker_timeout : float, optional
        How long the cluster may have no worker before the study ends [s]; default 60.
    retry_failed : bool
        Whether runs that failed before are done again.
    trust, radiance, tracer_timeout, tracer
        As in `RenderOptions`; "auto" is decided once for all runs.
    progress : bool
        Show progress on stderr.
    """

    workers: int | None = None
    dask: str | None = None
    worker_timeout: float | None = None
    retry_failed: bool = False
    trust: bool = False
    radiance: str | None = None
    tracer_timeout: float = 600.0
    tracer: TracerName = "auto"
    progress: bool = False

    def __post_init__(self) -> None:
        check_workers(self.workers, self.dask, self.worker_timeout)

    @property
    def of_render(self) -> dict[str, Any]:
        """What renders need to know."""
        return {
            "trust": self.trust,
            "radiance": self.radiance,
            "tracer_timeout": self.tracer_timeout,
            "tracer": self.tracer,
        }


@dataclass(frozen=True, slots=True)
class Study:
    """A study that was carried out.

    Attributes
    ----------
    design : Design
    folder : Path
    rows : tuple of dict
        The table, in the order of the runs.
    summary : Mapping
        What study.json holds.
    """

    design: Design
    folder: Path
    rows: tuple[Mapping[str, str], ...]
    summary: Mapping[str, Any]


def run_study(design: Design, out: Path, options: StudyOptions) -> Study:
    """Carry out a study; rows and images that an equal study left in the folder are used again.

    Raises
    ------
    InputError
        If the design cannot work, or the folder holds another study; before the first ray.
    EnvironmentFailure
        If Radiance, Dask or the disk fails.
    """
    start = time.monotonic()
    check_design(design, options.of_render)
    runs = runs_of(design)
    make_folder(out)
    with sole_owner(out):
        known_one = known_tracer(out) if options.tracer == "auto" else None
        options = replace(options, tracer=known_one or one_tracer(design, runs, options.of_render))
        design, asked = with_one_tolerance(design, runs, options.of_render)
        runs = runs if asked is None else runs_of(design)
        take_possession(out, design, runs, options, asked)
        journal = Journal(out, design, runs)
        known = journal.finished()
        if options.retry_failed:
            journal.forget([number for number, row in known.items() if row["error"]])
            known = journal.finished()
        steps, made = plan_steps(design, runs, out, options)
        plans = known_plans(out)
        due = sum(run.index not in known for run in runs)
        if due:
            plans = _carry_out(steps, plans, journal, options, due)
        rows = journal.close()
        summary = _summary(design, rows, made, out) | told_of(plans)
        timing = {"wall_s": time.monotonic() - start, "reused_runs": len(known)}
        write_manifest(out / STUDY, {**summary, "timing": timing})
    return Study(design, out, tuple(rows), {**summary, "timing": timing})


def _carry_out(steps: Sequence[Step], plans: Plans, journal: Journal, options: StudyOptions, due: int) -> Plans:
    """Find how all runs are sampled, where that is not known, and do those that are due."""
    known, out = journal.finished(), journal.path.parent
    with closing(open_pool(options, out)) as pool:
        wider = with_pilots(steps, plans, out, pool, shown=options.progress)
        if wider != plans:
            write_manifest(out / STUDY, {"schema_version": SCHEMA_VERSION, **_identity_of(out), **told_of(wider)})
        progress = Progress("runs", due + len(known), shown=options.progress)
        progress.skip(len(known))
        try:
            Scheduler(still_due(sampled(steps, wider), known), journal, pool, progress).run()
        finally:
            progress.close()
    shutil.rmtree(out / PILOTS, ignore_errors=True)
    return wider


def known_plans(out: Path) -> Plans:
    """How the study in a folder is sampled; empty where that was not found out."""
    return read_plans(out / STUDY, _identity_of(out)["study_sha256"])


def known_tracer(out: Path) -> EngineName | None:
    """Who traces the study in a folder; None where none lies there that says so."""
    told = read_manifest(out / PLAN).get("tracer") if (out / PLAN).exists() else None
    return next((name for name in ENGINES if name == told), None)


def _identity_of(out: Path) -> dict[str, Any]:
    return {"study_sha256": read_manifest(out / PLAN)["study_sha256"]}


def open_pool(options: StudyOptions, folder: Path) -> Pool:
    """Workers for the study in a folder, to be closed by the caller."""
    if options.dask is not None:
        return DaskPool(options.dask, folder, options.radiance, options.worker_timeout or WORKER_TIMEOUT)
    return LocalPool(options.workers or available_cores())


def take_possession(
    out: Path, design: Design, runs: Sequence[Run], options: StudyOptions, asked: ToleranceAsked | None = None
) -> None:
    """Write what the study is, or make sure that it is the one that lies there."""
    told = {
        "schema_version": SCHEMA_VERSION,
        "title": design.title,
        "design": _told_of(design),
        "analysis": analysis_of(design),
        "runs": len(runs),
        "versions": versions(*STUDY_PACKAGES) | {"radiance": _radiance_version(options)},
        "trust": options.trust,
        "tracer": options.tracer,
        **({} if asked is None else {"tolerance_asked": asdict(asked)}),
        "files": input_hashes(
            [design.document, *(run.document for run in runs)],
            design.scene_origin,
            design.folder,
            trust=options.trust,
        ),
    }
    told["study_sha256"] = _identity(told, runs)
    if (out / PLAN).exists():
        if read_manifest(out / PLAN).get("study_sha256") != told["study_sha256"]:
            raise InputError(
                "holds another study, or one made with other files or programs",
                where=str(out),
                remedy="choose another `out`",
            )
        return
    if (out / RESULTS).exists():
        raise InputError(f"holds a {RESULTS} of something else", where=str(out), remedy="choose another `out`")
    write_manifest(out / PLAN, told)


def _told_of(design: Design) -> dict[str, Any]:
    """A design as JSON, without the places where it lies."""
    told = asdict(replace(design, folder=Path(), home=Path()))
    del told["home"]
    if design.channel is None:
        del told["channel"]  # studies of one colour keep their hash
    return told | {"folder": design.folder.name}


def _identity(told: Mapping[str, Any], runs: Sequence[Run]) -> str:
    """Hash of what decides the table: neither the name of the scene's folder does, nor the machine's kernel."""
    design = {key: value for key, value in told["design"].items() if key != "folder"}
    programs = {key: value for key, value in told["versions"].items() if key != "platform"}
    images = [run.image for run in runs]
    return sha256_of_value({**told, "design": design, "versions": programs, "images": images})


def _radiance_version(options: StudyOptions) -> str:
    with Programs() as programs:
        return radiance_version(find_radiance(options.radiance), programs)


# ---------------------------------------------------------------------------------------------------------------- plan


@dataclass(frozen=True, slots=True)
class Made:
    """What a study traces.

    Attributes
    ----------
    renders, bases : int
        Images that are traced for themselves, and light bases.
    relit : int
        Images that are made from a basis.
    """

    renders: int
    bases: int
    relit: int


def plan_steps(design: Design, runs: Sequence[Run], out: Path, options: StudyOptions) -> tuple[list[Step], Made]:
    """The jobs for some runs: equal images once, and from a light basis where only levels of sources differ."""
    images: dict[str, list[Run]] = {}
    for run in runs:
        images.setdefault(run.image, []).append(run)
    in_time = {image for image, sharing in images.items() if changes_in_time(sharing[0].document, design.folder)}
    still = {image: sharing for image, sharing in images.items() if image not in in_time}
    groups = _light_groups(design, still, options)  # a basis knows one instant
    steps: list[Step] = []
    for number, group in enumerate(groups, 1):
        steps += _basis_steps(design, group, f"basis{number}", out, options)
    relit = {image for group in groups for image in group.images}
    for image, sharing in images.items():
        if image not in relit:
            steps += _render_steps(design, image, sharing, out, options, in_time=image in in_time)
    return steps, Made(len(images) - len(relit), len(groups), len(relit))


def still_due(steps: Sequence[Step], finished: Mapping[int, Any]) -> list[Step]:
    """The plan without the runs that are finished; it stays the plan of all runs, so that no number depends on them."""
    left: list[Step] = []
    first: dict[str, str] = {}
    needed = {step.after for step in steps if any(run.run not in finished for run in step.job.runs)}
    for step in steps:
        job = replace(step.job, runs=tuple(run for run in step.job.runs if run.run not in finished))
        if not job.runs and not (job.name in needed and not step.job.runs):
            continue
        # Where the run that was to render is finished or failed, the next one sees to the image, and the others wait.
        leader = first.setdefault(job.image, job.name)
        left.append(Step(job, None if leader == job.name else leader))
    return left


def _render_steps(
    design: Design, image: str, runs: Sequence[Run], out: Path, options: StudyOptions, *, in_time: bool
) -> Iterator[Step]:
    """The first run renders, the others look at its image."""
    first = f"run{runs[0].index}"
    for run in runs:
        job = _job(design, run, out, options, name=f"run{run.index}", image=f"{_RENDERS}/{image[:_NAME]}")
        job = replace(job, runs=(Measured(run.index, run.responses),), in_time=in_time)
        yield Step(job, None if run is runs[0] else first)


def _job(design: Design, run: Run, out: Path, options: StudyOptions, *, name: str, image: str, **how: Any) -> Job:
    render = render_options(
        run.render, f"{design.origin}: render", seed=run.seed, workers=1, **options.of_render, **how
    )
    if render.tolerance is None:  # others are in gray levels already, see `with_one_tolerance`
        render = replace(render, tolerance=USUAL)
    return Job(
        name=name,
        study=str(out.absolute()),
        image=image,
        document=run.document,
        origin=design.scene_origin,
        folder=str(design.folder.absolute()),
        options=render,
        runs=(),
        home=str(design.home.absolute()),
        channel=design.channel,
    )


@dataclass(frozen=True, slots=True)
class _LightGroup:
    """Runs whose images differ only in the levels of sources."""

    bare: Mapping[str, Any]
    runs: tuple[Run, ...]
    levels: tuple[Mapping[str, float], ...]

    @property
    def images(self) -> set[str]:
        return {run.image for run in self.runs}


def _light_groups(design: Design, images: Mapping[str, Sequence[Run]], options: StudyOptions) -> list[_LightGroup]:
    """Groups for which a basis pays, or that are to have one."""
    if design.basis is False:
        return []
    groups: dict[str, list[tuple[Run, Mapping[str, float], Mapping[str, Any]]]] = {}
    for sharing in images.values():
        run = sharing[0]
        if render_options(run.render, "render", **options.of_render).fixed_method is not None:
            continue  # a basis is made to a tolerance
        try:
            bare, levels = split_light(run.document)
        except (InputError, KeyError, TypeError):
            continue  # the run itself will say what is wrong with it
        key = sha256_of_value({"scene": bare, "render": run.render, "seed": run.seed})
        groups.setdefault(key, []).append((run, levels, bare))
    found = []
    for members in groups.values():
        sources = sum(level > 0 for level in reference_levels(levels for _, levels, _ in members).values())
        least = 2 if design.basis else sources + _BASIS_OVERHEAD + 1
        if sources and len(members) >= least:
            every = [(run, levels) for first, levels, _ in members for run in images[first.image]]
            every.sort(key=lambda pair: pair[0].index)
            found.append(_LightGroup(members[0][2], tuple(r for r, _ in every), tuple(v for _, v in every)))
    return found


def _basis_steps(design: Design, group: _LightGroup, name: str, out: Path, options: StudyOptions) -> Iterator[Step]:
    reference = reference_levels(group.levels)
    lit = replace(group.runs[0], document=with_levels(group.bare, reference))
    folder = f"{_BASES}/{sha256_of_value({'image': lit.image})[:_NAME]}"
    maker = _job(design, lit, out, options, name=name, image=folder, basis=True)
    yield Step(maker)
    pairs = list(zip(group.runs, group.levels, strict=True))
    size = min(max(_FEWEST_RELIT, len(pairs) // _RELIT_JOBS), _MOST_RELIT)
    for number, part in enumerate(chunks(pairs, size), 1):
        runs = tuple(Measured(run.index, run.responses, levels) for run, levels in part)
        yield Step(replace(maker, name=f"{name}.{number}", runs=runs, reference=reference), name)


# ------------------------------------------------------------------------------------------------------------- summary


def _summary(design: Design, rows: Sequence[Mapping[str, str]], made: Made, out: Path) -> dict[str, Any]:
    failed = [row for row in rows if row["error"]]
    return {
        "schema_version": SCHEMA_VERSION,
        "title": design.title,
        **_identity_of(out),
        "results": RESULTS,
        "runs": len(rows),
        "failed": len(failed),
        "not_met": sum(row["met"] == "0" for row in rows),
        "warned": sum(bool(row["warnings"]) for row in rows),
        "missed": {row["run"]: float(row["image_error"]) for row in rows if row["met"] == "0"},
        "renders": made.renders + made.bases,
        "light_bases": made.bases,
        "relit": made.relit,
        "factors": {factor.name: factor.label for factor in design.factors},
        "responses": {
            response.name: {"measure": response.kind, "unit": response.unit, **response.options, **_frames(response)}
            for response in design.responses
        },
        "analysis": analysis_of(design),
        **({} if design.channel is None else {"channel": asdict(design.channel)}),
        "versions": versions(*STUDY_PACKAGES),
    }


def _frames(response: Response) -> dict[str, int]:
    return {"frames": response.frames} if response.repeatability else {}
