"""One plan of sampling for all runs of a study: found before the first run, kept in study.json, given to every job."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from radwrap.errors import InputError
from radwrap.manifest import read_manifest, sha256_of_value
from radwrap.progress import Progress
from radwrap.study.pilots import Plans, asked, plans_from_json, plans_of, read_pilot, told_of
from radwrap.study.pool import Pool
from radwrap.study.runner import NO_SINK, Scheduler, Step
from radwrap.study.worker import Job

PILOTS: Final = "pilots"
_NAME: Final = 20  # digits of a hash that name a file


def with_pilots(steps: Sequence[Step], plans: Plans, out: Path, pool: Pool, *, shown: bool) -> Plans:
    """Plans for all that some steps render, those that are known first; others by pilots of every render.

    Raises
    ------
    EnvironmentFailure, TracerError
        If a pilot failed, and not by its scene: it may have been the strictest.
    """
    jobs: dict[str, Job] = {}
    for step in steps:
        job = step.job
        if step.after is None and _shares_a_plan(job) and asked(job.options) not in plans:
            # Replicates of a design are the same scene with other seeds.
            name = sha256_of_value({"scene": job.document, "asked": asked(job.options)})[:_NAME]
            how = replace(job.options, basis=False)
            image = f"{PILOTS}/{name}.json"
            jobs.setdefault(name, replace(job, name=f"pilot-{name}", image=image, runs=(), options=how, pilot=True))
    if not jobs:
        return plans
    due = [Step(job) for job in jobs.values() if read_pilot(out / job.image) is None]
    progress = Progress("pilots", len(jobs), shown=shown)
    try:
        failures = Scheduler(due, NO_SINK, pool, progress).run()
    finally:
        progress.close()
    for why in failures.values():
        if not isinstance(why, InputError):  # a scene that is wrong stays so, and its runs will say it
            raise why
    return {**plans, **plans_of([(job.options, read_pilot(out / job.image)) for job in jobs.values()])}


def sampled(steps: Sequence[Step], plans: Plans) -> list[Step]:
    """The steps, each with the plan by which it samples; without one where every scene of its kind is wrong."""
    found = []
    for step in steps:
        how = step.job.options
        plan = plans.get(asked(how)) if _shares_a_plan(step.job) else None
        found.append(replace(step, job=replace(step.job, options=replace(how, sampling=plan))))
    return found


def _shares_a_plan(job: Job) -> bool:
    """Whether its image is made to a tolerance, from rays that those of other runs may be like."""
    return job.options.fixed_method is None and not job.in_time


def read_plans(path: Path, known: str) -> Plans:
    """How a study that was begun is sampled; empty where that was not found out.

    Parameters
    ----------
    path : Path
        Its study.json.
    known : str
        Hash of the study.

    Raises
    ------
    InputError
        If study.json is not as it was written.
    """
    if not path.exists():
        return {}
    told = read_manifest(path)
    if told.get("study_sha256") != known:
        raise InputError("is of another study", where=f"{path}: study_sha256", remedy="delete the file, and run again")
    plans = plans_from_json(told.get("sampling", []), f"{path}: sampling")
    if told.get("sampling_sha256") != told_of(plans)["sampling_sha256"]:
        raise InputError(
            "is not as it was written: sampling_sha256 is of another plan",
            where=f"{path}: sampling",
            remedy="delete the file and results.csv, and run again",
        )
    return plans
