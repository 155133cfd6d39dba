"""Where candidates are rendered and measured: by workers, all of one stage alike, and none of them twice."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from radwrap.designing.candidates import Candidate, candidate_of, corners
from radwrap.designing.document import Problem
from radwrap.designing.light import LightAim, levels_of, time_of
from radwrap.designing.quantities import LEDS, TIME_OF_EXPOSURE
from radwrap.designing.trials import Trial, read_record, trial_of, write_record
from radwrap.designing.worker import CandidateJob, carry_out_candidate
from radwrap.errors import EnvironmentFailure, InputError
from radwrap.files import make_folder
from radwrap.manifest import sha256_of_value
from radwrap.progress import Progress
from radwrap.study.design import render_options
from radwrap.study.pilots import asked
from radwrap.study.pool import Pool
from radwrap.study.runner import Scheduler, Step
from radwrap.study.study import StudyOptions
from radwrap.study.worker import Measured, Outcome

RECORDS: Final = "records"
RENDERS: Final = "renders"
_NAME: Final = 20  # digits of a hash that name a folder
# Options that decide an image, besides those that `asked` has.
_DECIDING: Final = ("seed", "viewpoints", "layout", "pixel_samples", "pixel_sampling", "tracer", "basis")


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
        groups = [corners(self._problem, one) if is_kept else [] for is_kept, (one, _) in zip(kept, seen, strict=True)]
        others = iter(self._seen([one for group in groups for one in group], tolerance, seed, sought=False))
        for (one, record), group in zip(seen, groups, strict=True):
            around = [next(others) for _ in group]
            self.trials.append(trial_of(len(self.trials) + 1, stage, seed, one, record, corners=around))
        return self.trials[len(self.trials) - len(candidates) :]

    def _seen(
        self, candidates: Sequence[Candidate], tolerance: float | None, seed: int, *, sought: bool
    ) -> list[tuple[Candidate, dict[str, Any] | None]]:
        """Candidates with their levels, and what is on record of them; None where they were not rendered."""
        found = []
        jobs: list[CandidateJob | None] = []
        for number, candidate in enumerate(candidates):
            is_due = not candidate.fault and self._is_worth(candidate)
            jobs.append(self._job(candidate, number, tolerance, seed, sought=sought) if is_due else None)
        named = {job.runs[0].run: job for job in jobs if job is not None}
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
        return LightAim(levels, problem.objectives[0], problem.constraints, problem.study.responses, time)

    def _record(self, job: CandidateJob) -> Path:
        return self._out / RECORDS / f"{Path(job.image).name}.json"

    def _make(self, jobs: Sequence[CandidateJob]) -> None:
        """Render and measure what has no record yet; equal candidates once."""
        first = {job.image: job for job in jobs}
        due = {image: job for image, job in first.items() if read_record(self._record(job)) is None}
        self._progress.skip(sum(image not in due and image not in self._known for image in first))
        self._known |= first.keys()
        records = {job.runs[0].run: self._record(job) for job in due.values()}
        failures = Scheduler(
            [Step(job) for job in due.values()], _Records(records), self._pool, self._progress, carry_out_candidate
        ).run()
        for why in failures.values():
            if not isinstance(why, InputError):
                raise why
        missing = [path for path in records.values() if not path.exists()]
        if missing:
            raise EnvironmentFailure("a render came to nothing", where=str(missing[0]))


class _Records:
    """Keeps outcomes as records."""

    def __init__(self, paths: dict[int, Path]) -> None:
        self._paths = paths

    def save(self, outcomes: Sequence[Outcome]) -> None:
        """Write them; failures of a machine are none of the candidate's."""
        for outcome in outcomes:
            write_record(self._paths[outcome.run], outcome)
