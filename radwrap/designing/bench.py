"""Where candidates are rendered and measured: by workers, all of one stage alike, and none of them twice."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Final

from radwrap.designing.candidates import Candidate, candidate_of, corners
from radwrap.designing.document import Problem
from radwrap.designing.keys import STEPS_OF_BALANCE
from radwrap.designing.light import LightAim, levels_of, time_of
from radwrap.designing.quantities import LEDS, TIME_OF_EXPOSURE
from radwrap.designing.trials import Trial, read_record, trial_of, write_record
from radwrap.designing.worker import (
    CandidateJob,
    carry_out_candidate,
    carry_out_levels,
    finer,
    make_basis,
)
from radwrap.errors import EnvironmentFailure, InputError
from radwrap.files import make_folder
from radwrap.imaging.output.folder import is_whole
from radwrap.manifest import sha256_of_value
from radwrap.progress import Progress
from radwrap.study.design import render_options
from radwrap.study.pilots import asked
from radwrap.study.pool import Pool
from radwrap.study.runner import NO_SINK, Scheduler, Sink, Step
from radwrap.study.study import StudyOptions
from radwrap.study.worker import Measured, Outcome, failed

RECORDS: Final = "records"
RENDERS: Final = "renders"
_NAME: Final = 20  # digits of a hash that name a folder
# Options that decide an image, besides those that `asked` has.
_DECIDING: Final = ("seed", "viewpoints", "layout", "pixel_samples", "pixel_sampling", "tracer", "basis")

# A candidate, and what is on record of it; None where it was not rendered.
_Seen = tuple[Candidate, Mapping[str, Any] | None]


class Bench:
    """Makes trials of candidates.

    Parameters
    ----------
    problem : Problem
        Whose tolerance is in gray levels.
    out : Path
        Folder of the design.
    options : StudyOptions
        Whose tracer is decided.
    pool : Pool
    progress : Progress
        Counts renders.
    """

    def __init__(self, problem: Problem, out: Path, options: StudyOptions, pool: Pool, progress: Progress) -> None:
        self._problem, self._out, self._options = problem, out, options
        self._pool, self._progress = pool, progress
        self._known: set[str] = set()
        self.trials: list[Trial] = []
        make_folder(out / RECORDS)

    @property
    def renders(self) -> int:
        """Different images that were made or read so far."""
        return len(self._known)

    def look_at(
        self, candidates: Sequence[Candidate], stage: str, tolerance: float | None, seed: int, *, sought: bool = True
    ) -> list[Trial]:
        """Trials of some candidates, in their order.

        Parameters
        ----------
        candidates : sequence of Candidate
            What is looked at.
        stage : str
            "search", "decide" or "check".
        tolerance : float or None
            Of their images [gray level]; None where the method keeps none.
        seed : int
            Of their renders.
        sought : bool
            Whether levels are solved for, where the problem has any.
        """
        seen = self._seen(candidates, tolerance, seed, sought=sought)
        first = [trial_of(0, stage, seed, one, record) for one, record in seen]
        # What breaks a limit as it stands, is no better off it.
        kept = [
            bool(self._problem.allowed) and record is not None and trial.may_be_feasible(self._problem)
            for trial, (_, record) in zip(first, seen, strict=True)
        ]
        if self._problem.levels and sought:
            due = [one if is_kept else None for is_kept, one in zip(kept, candidates, strict=True)]
            worst = self._worst(due, tolerance, seed)
            found = [(one, []) if made is None else made for made, one in zip(worst, seen, strict=True)]
        else:
            due = [one if is_kept else None for is_kept, (one, _) in zip(kept, seen, strict=True)]
            found = list(zip(seen, self._around(due, tolerance, seed), strict=True))
        for (one, record), around in found:
            self.trials.append(trial_of(len(self.trials) + 1, stage, seed, one, record, corners=around))
        return self.trials[len(self.trials) - len(candidates) :]

    def _around(self, candidates: Sequence[Candidate | None], tolerance: float | None, seed: int) -> list[list[_Seen]]:
        """The corners of candidates, in the candidates' own levels; none of those that are not looked at there."""
        groups = [[] if one is None else corners(self._problem, one) for one in candidates]
        others = iter(self._seen([one for group in groups for one in group], tolerance, seed, sought=False))
        return [[next(others) for _ in group] for group in groups]

    def _worst(
        self, candidates: Sequence[Candidate | None], tolerance: float | None, seed: int
    ) -> list[tuple[_Seen, list[_Seen]] | None]:
        """Candidates in the levels that are best in the worst case, and their corners; None where none is given.

        First the light bases of corners are made, each of them once, whosever corner it is; then levels are found on
        them without a ray. Where the image in these levels misses its tolerance, finer bases follow.
        """
        problem = self._problem
        groups = [[] if one is None else corners(problem, one) for one in candidates]
        jobs: dict[int, CandidateJob] = {}
        runs = 0
        for place, (candidate, group) in enumerate(zip(candidates, groups, strict=True)):
            # A corner that is no scene, or breaks a limit of its own, needs no ray.
            if candidate is None or any(one.fault or not self._is_worth(one) for one in group):
                continue
            own, *around = (
                self._job(one, runs + number, tolerance, seed, sought=True)
                for number, one in enumerate((candidate, *group))
            )
            runs += 1 + len(group)
            every = tuple(one.runs[0] for one in (own, *around))
            jobs[place] = replace(own, runs=every, around=tuple(around))
        self._find_levels(list(jobs.values()))
        found: list[tuple[_Seen, list[_Seen]] | None] = []
        for place, (candidate, group) in enumerate(zip(candidates, groups, strict=True)):
            if candidate is None:
                found.append(None)
            elif place not in jobs:
                found.append(((candidate, None), [(one, None) for one in group]))
            else:
                record, *others = (read_record(path) for path in self._records(jobs[place]))
                levels = (record or {}).get("levels")
                lit = candidate_of(problem, candidate.codes, levels) if levels else candidate
                found.append(((lit, record), list(zip(corners(problem, lit), others, strict=True))))
        return found

    def _find_levels(self, jobs: Sequence[CandidateJob]) -> None:
        """Make the bases of candidates and their corners, find levels on them, and keep what is measured there."""
        images = {one.image: one for job in jobs for one in (job, *job.around)}
        due = {
            self._records(job)[0]: job for job in jobs if any(read_record(path) is None for path in self._records(job))
        }
        left = {one.image for job in due.values() for one in (job, *job.around)} - self._known
        self._progress.skip(len(images.keys() - left - self._known))
        self._known |= images.keys()
        jobs = list(due.values())
        while jobs:
            lost = self._make_bases([one for job in jobs for one in (replace(job, around=()), *job.around)])
            self._progress.add(len(left))
            left = set()
            outcomes = _Outcomes()
            able = []
            for job in jobs:
                why = [lost[one.folder_of_image] for one in (job, *job.around) if one.folder_of_image in lost]
                if why:
                    outcomes.save([failed(run.run, str(why[0])) for run in job.runs])
                else:
                    able.append(job)
            self._done(able, outcomes, carry_out_levels)
            again = []
            for job in jobs:
                found = [outcomes.by_run[run.run] for run in job.runs]
                own, *around = (finer(one, told) for one, told in zip((job, *job.around), found, strict=True))
                if (own, *around) != (job, *job.around):
                    again.append(replace(own, around=tuple(around)))
                    continue
                for path, outcome in zip(self._records(job), found, strict=True):
                    write_record(path, outcome)
            jobs = again

    def _make_bases(self, jobs: Sequence[CandidateJob]) -> Mapping[str, InputError]:
        """Make light bases that are not there, each once; those that came to nothing, by their folders, and why."""
        due = {one.folder_of_image: replace(one, runs=()) for one in jobs}
        due = {folder: one for folder, one in due.items() if not is_whole(self._out / folder)}
        lost = self._done(list(due.values()), NO_SINK, make_basis)
        return {folder: lost[one.name] for folder, one in due.items() if one.name in lost}

    def _records(self, job: CandidateJob) -> list[Path]:
        """Of a candidate in the levels of the worst case, and of its corners; of one without them its own."""
        if not job.around:
            return [self._record(job)]
        name = self._out / RECORDS / _name(job)
        return [Path(f"{name}-worst.json"), *(Path(f"{name}-worst-{k}.json") for k in range(len(job.around)))]

    def _seen(
        self, candidates: Sequence[Candidate], tolerance: float | None, seed: int, *, sought: bool
    ) -> list[_Seen]:
        """Candidates with their levels, and what is on record of them; None where they were not rendered."""
        found: list[_Seen] = []
        jobs: list[CandidateJob | None] = []
        for number, candidate in enumerate(candidates):
            is_due = not candidate.fault and self._is_worth(candidate)
            jobs.append(self._job(candidate, number, tolerance, seed, sought=sought) if is_due else None)
        named = {job.runs[0].run: job for job in jobs if job is not None}
        if self._problem.is_balanced and sought:
            self._find_levels(list(named.values()))  # on one light for all balances
        else:
            self._make(list(named.values()))
        for number, candidate in enumerate(candidates):
            job = named.get(number)
            record = None if job is None else read_record(self._record(job))
            made = candidate
            if record is not None and record.get("levels"):  # LEDs that are off do not count
                made = candidate_of(self._problem, candidate.codes, record["levels"])
            found.append((made, record))
        return found

    def _is_worth(self, candidate: Candidate) -> bool:
        """Whether a candidate keeps all limits that are known without a ray."""
        problem = self._problem
        # Levels and the time are not known yet; where they are, they are no levels of the problem's own scene.
        sought = {LEDS} if problem.levels else set()
        if problem.time is not None and not candidate.levels:
            sought.add(TIME_OF_EXPOSURE)
        return not any(
            one.excess(candidate.own[one.quantity.name].value)
            for one in self._problem.constraints
            if one.quantity.name in candidate.own and one.quantity.name not in sought
        )

    def _job(
        self, candidate: Candidate, number: int, tolerance: float | None, seed: int, *, sought: bool
    ) -> CandidateJob:
        problem, study = self._problem, self._problem.study
        aim = self._aim(candidate) if problem.levels and sought else None
        options: dict[str, Any] = dict(study.render)
        if tolerance is not None:
            options["tolerance"] = tolerance
        how = render_options(
            options,
            f"{study.origin}: render",
            seed=seed,
            workers=1,
            basis=aim is not None,
            **self._options.of_render,
        )
        told = {
            "scene": candidate.document,
            "render": asdict(asked(how)),
            "options": {name: getattr(how, name) for name in _DECIDING},
        }
        return CandidateJob(
            name=f"trial{len(self.trials) + number + 1}",
            study=str(self._out.absolute()),
            image=f"{RENDERS}/{sha256_of_value(told)[:_NAME]}",
            document=candidate.document,
            origin=study.scene_origin,
            folder=str(study.folder.absolute()),
            options=how,
            runs=(Measured(number, study.responses),),
            home=str(study.home.absolute()),
            aim=aim,
        )

    def _aim(self, candidate: Candidate) -> LightAim:
        problem = self._problem
        scene = problem.scene(candidate.document)
        levels = levels_of(problem.levels, candidate.document, scene, problem.origin)
        time = None if problem.time is None else time_of(problem.time, scene)
        first, *others = problem.objectives
        aim = LightAim(levels, first, problem.constraints, problem.study.responses, time)
        if not others:
            return aim
        return replace(aim, second=others[0], share=float(candidate.codes[-1]) / (STEPS_OF_BALANCE - 1))

    def _record(self, job: CandidateJob) -> Path:
        return self._out / RECORDS / f"{_name(job)}.json"

    def _make(self, jobs: Sequence[CandidateJob]) -> None:
        """Render and measure what has no record yet; equal candidates once."""
        first = {job.image: job for job in jobs}
        due = {image: job for image, job in first.items() if read_record(self._record(job)) is None}
        self._progress.skip(sum(image not in due and image not in self._known for image in first))
        self._known |= first.keys()
        records = {job.runs[0].run: self._record(job) for job in due.values()}
        self._done(list(due.values()), _Records(records), carry_out_candidate, self._progress)
        missing = [path for path in records.values() if not path.exists()]
        if missing:
            raise EnvironmentFailure("a render came to nothing", where=str(missing[0]))

    def _done(
        self,
        jobs: Sequence[CandidateJob],
        sink: Sink,
        work: Callable[[CandidateJob], list[Outcome]],
        progress: Progress | None = None,
    ) -> Mapping[str, InputError]:
        """Have the pool do jobs; those that failed for what they are, and why."""
        progress = progress or Progress("", 1, shown=False)
        failures = Scheduler([Step(job) for job in jobs], sink, self._pool, progress, work).run()
        wrong = {}
        for name, why in failures.items():
            if not isinstance(why, InputError):
                raise why
            wrong[name] = why
        return wrong


def _name(job: CandidateJob) -> str:
    """Of a record: that of its image, and of the balance of two objectives on it."""
    name = Path(job.image).name
    if job.aim is None or job.aim.second is None:
        return name
    return f"{name}-{job.aim.share:g}"


class _Outcomes:
    """Holds outcomes by their runs."""

    def __init__(self) -> None:
        self.by_run: dict[int, Outcome] = {}

    def save(self, outcomes: Sequence[Outcome]) -> None:
        """Take them."""
        self.by_run |= {outcome.run: outcome for outcome in outcomes}


class _Records:
    """Keeps outcomes as records."""

    def __init__(self, paths: dict[int, Path]) -> None:
        self._paths = paths

    def save(self, outcomes: Sequence[Outcome]) -> None:
        """Write them; failures of a machine are none of the candidate's."""
        for outcome in outcomes:
            write_record(self._paths[outcome.run], outcome)
