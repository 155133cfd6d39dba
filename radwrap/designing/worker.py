"""What a worker does for a candidate: its image as a study makes it, or levels on its light basis first."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Final

from radwrap.designing.light import LightAim, best_levels
from radwrap.errors import InputError
from radwrap.imaging.asked_tolerance import FINEST
from radwrap.imaging.relight.relit import read_basis
from radwrap.scene.file.load import scene_from_document
from radwrap.study.pilots import asked, plans_of, read_pilot
from radwrap.study.worker import Job, Measured, Outcome, carry_out, failed

_PILOTS: Final = "pilots"
_SHARES: Final = (
    1.0,
    0.5,
    0.25,
)  # of the tolerance, for which an image is planned: one after the other, until it is met


@dataclass(frozen=True, slots=True)
class CandidateJob(Job):
    """A candidate to be rendered and measured; with an aim, levels of sources are sought first."""

    aim: LightAim | None = None


@dataclass(frozen=True, slots=True)
class LitOutcome(Outcome):
    """What a candidate with sought levels came to.

    Attributes
    ----------
    levels : Mapping
        Key path -> level, as the scene's file would hold it.
    light : Mapping
        How they were found, and what the objective is in radiant exposure.
    """

    levels: Mapping[str, Any] = field(default_factory=dict)
    light: Mapping[str, Any] = field(default_factory=dict)


def carry_out_candidate(job: CandidateJob) -> list[Outcome]:
    """Do a job; what goes wrong with a candidate is its outcome.

    Where the image misses its tolerance by the plan that its pilot found, it is made again by finer ones.

    Raises
    ------
    EnvironmentFailure
        If nothing could be done here.
    """
    outcomes: list[Outcome] = []
    for number, share in enumerate(_SHARES):
        outcomes = _looked_at(job, share, f"{job.image}-{number}" if number else job.image)
        if job.options.fixed_method is not None or all(one.met or one.image_error is None for one in outcomes):
            break
    return outcomes


def _looked_at(job: CandidateJob, share: float, image: str) -> list[Outcome]:
    """A candidate whose image is planned for a share of its tolerance, and lies in a folder of that name."""
    (run,) = job.runs
    try:
        job = _sampled(replace(job, image=image), share)
        if job.aim is None:
            return carry_out(job)
        carry_out(replace(job, runs=()))
        basis = read_basis(Path(job.study) / job.image)
        scene = scene_from_document(job.document, origin=job.origin, folder=Path(job.folder))
        found = best_levels(job.aim, basis, scene)
    except InputError as error:
        return [failed(run.run, str(error))]
    lit = Measured(run.run, run.responses, found.factors)
    # As a study's images from a basis: levels are factors on those that the basis was made with.
    outcomes = carry_out(replace(job, runs=(lit,), reference=dict.fromkeys(found.factors, 1.0)))
    light = {"way": found.way, "objective": found.value, "at_low": found.at_low, "at_high": found.at_high}
    return [
        LitOutcome(
            **{one.name: getattr(outcome, one.name) for one in fields(Outcome)}, levels=found.levels, light=light
        )
        for outcome in outcomes
    ]


def _sampled(job: CandidateJob, share: float) -> CandidateJob:
    """The job with an even plan of sampling by a pilot of its own: its image then has replicates, which show its error.

    A study's images share the strictest plan, so that its sampling is no effect; here the widest opening and the
    brightest light would make all others cost as much as they do.
    """
    if job.options.fixed_method is not None:
        return job
    name = f"{_PILOTS}/{Path(job.image).name}.json"
    path = Path(job.study) / name
    how = replace(job.options, basis=False, tolerance=max(FINEST, share * job.options.demand.tolerance))
    if read_pilot(path) is None:
        carry_out(replace(job, runs=(), pilot=True, image=name, options=how))
    plan = plans_of([(how, read_pilot(path))]).get(asked(how))
    return replace(job, options=replace(job.options, sampling=plan))
