"""What a worker does for a candidate: its image as a study makes it, or levels on its light basis first."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Final

from radwrap.designing.best_levels import best_levels
from radwrap.designing.light import LightAim
from radwrap.errors import InputError
from radwrap.imaging.asked_tolerance import FINEST
from radwrap.imaging.relight.relit import Basis, read_basis
from radwrap.scene.file.load import scene_from_document
from radwrap.scene.scene import Scene
from radwrap.study.pilots import asked, plans_of, read_pilot
from radwrap.study.worker import Job, Measured, Outcome, carry_out, failed

_PILOTS: Final = "pilots"
# Of the tolerance, for which an image is planned: one after the other, until it is met.
_SHARES: Final = (1.0, 0.5, 0.25)


@dataclass(frozen=True, slots=True)
class CandidateJob(Job):
    """A candidate to be rendered and measured; with an aim, levels of sources are sought first.

    Attributes
    ----------
    aim : LightAim, optional
        What levels are sought for.
    around : tuple of CandidateJob
        The corners of its tolerances, where levels are sought for the worst case.
    share : int
        Which plan its image has, from 0 on: the next one is finer, and has a folder of its own.
    """

    aim: LightAim | None = None
    around: tuple[CandidateJob, ...] = ()
    share: int = 0

    @property
    def folder_of_image(self) -> str:
        """Below the design's folder."""
        return f"{self.image}-{self.share}" if self.share else self.image


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
    while True:
        (outcome,) = _looked_at(job)
        before, job = job, finer(job, outcome)
        if job == before:
            return [outcome]


def finer(job: CandidateJob, outcome: Outcome) -> CandidateJob:
    """The same with a finer image, where it misses its tolerance and there is a finer plan."""
    is_missed = not outcome.met and outcome.image_error is not None
    if not is_missed or job.options.fixed_method is not None or job.share + 1 == len(_SHARES):
        return job
    return replace(job, share=job.share + 1)


def _looked_at(job: CandidateJob) -> list[Outcome]:
    """A candidate by one image."""
    try:
        if job.aim is None:
            return carry_out(_sampled(job))
        make_basis(job)
    except InputError as error:
        return [failed(job.runs[0].run, str(error))]
    return carry_out_levels(job)


def make_basis(job: CandidateJob) -> list[Outcome]:
    """Make a light basis; nothing is measured.

    Raises
    ------
    InputError, TracerError, EnvironmentFailure
        As a render of the scene.
    """
    carry_out(replace(_sampled(job), runs=()))
    return []


def carry_out_levels(job: CandidateJob) -> list[Outcome]:
    """Find levels on the bases of a candidate and its corners, which are there, and measure all of them without a ray.

    Raises
    ------
    EnvironmentFailure
        If nothing could be done here.
    """
    jobs = [job, *job.around]
    assert job.aim is not None  # noqa: S101  (asked before)
    try:
        (basis, scene), *around = map(_lit, jobs)
        found = best_levels(job.aim, basis, scene, around)
    except InputError as error:
        return [failed(one.runs[0].run, str(error)) for one in jobs]
    own, *others = map(_relit, jobs, (found.factors, *found.around))
    light = {"way": found.way, "objective": found.value, "at_low": found.at_low, "at_high": found.at_high}
    told = {one.name: getattr(own, one.name) for one in fields(Outcome)}
    return [LitOutcome(**told, levels=found.levels, light=light), *others]


def _lit(job: CandidateJob) -> tuple[Basis, Scene]:
    scene = scene_from_document(job.document, origin=job.origin, folder=Path(job.folder))
    return read_basis(Path(job.study) / job.folder_of_image), scene


def _relit(job: CandidateJob, factors: Mapping[str, float]) -> Outcome:
    """What is measured in some levels: as a study's images from a basis, factors on those that it was made with."""
    lit = Measured(job.runs[0].run, job.runs[0].responses, factors)
    (outcome,) = carry_out(replace(_sampled(job), runs=(lit,), reference=dict.fromkeys(factors, 1.0)))
    return outcome


def _sampled(job: CandidateJob) -> Job:
    """The job with an even plan of sampling by a pilot of its own: its image then has replicates, which show its error.

    A study's images share the strictest plan, so that its sampling is no effect; here the widest opening and the
    brightest light would make all others cost as much as they do.
    """
    share, job = job.share, replace(job, image=job.folder_of_image, share=0)
    if job.options.fixed_method is not None:
        return job
    name = f"{_PILOTS}/{Path(job.image).name}.json"
    path = Path(job.study) / name
    how = replace(job.options, basis=False, tolerance=max(FINEST, _SHARES[share] * job.options.demand.tolerance))
    if read_pilot(path) is None:
        carry_out(replace(job, runs=(), pilot=True, image=name, options=how))
    plan = plans_of([(how, read_pilot(path))]).get(asked(how))
    return replace(job, options=replace(job.options, sampling=plan))
