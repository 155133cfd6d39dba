"""Mutation samples: whether the tests of a folder notice small faults planted in it.

    .venv/bin/python scripts/mutants.py measure imaging --also OLD --out out/mutants_now.json
    .venv/bin/python scripts/mutants.py measure imaging --commit OLD --also HEAD --out out/mutants_old.json
    .venv/bin/python scripts/mutants.py --against out/mutants_old.json out/mutants_now.json

cosmic-ray lists all mutants of radwrap/FOLDER, of which a seeded sample is planted, one at a time, in a clone of the
committed state with an environment of its own. tests/FOLDER runs on each until a test fails or its time is over, first
the files that name the mutated module. Only a test that fails kills a mutant; one whose tests end without a failure,
or run out of time, has survived. Time is the processor's: other work on the machine changes no verdict.

A mutant is known by its module, its operator and the line that it changes, not by the line's number, and the sample is
drawn by a hash of that: another commit has the same mutants wherever these lines are the same. With --also, only
those are drawn that the other commit has too. Each result is saved at once; a run that was cut short goes on.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from queue import SimpleQueue
from threading import Lock
from typing import Any, Final

import psutil

ROOT: Final = Path(__file__).resolve().parent.parent
COSMIC_RAY: Final = "cosmic-ray==8.7.0"  # not in the lock file: it is needed here only
FOLDERS: Final = ("imaging", "measure")
# Annotations are not evaluated, and nearly all `|` stand there: such mutants change nothing.
ANNOTATING: Final = "_BitOr_"
_LOOK: Final = 0.5  # s between two looks at the clock
_PATIENCE: Final = 10.0  # so many times its limit a test may take by the wall: it may hang
SETTINGS: Final = """[cosmic-ray]
module-path = ["radwrap/{folder}"]
timeout = 60.0
excluded-modules = []
test-command = "true"
[cosmic-ray.distributor]
name = "local"
"""


@dataclass(frozen=True, slots=True)
class Mutant:
    """A fault to plant.

    Attributes
    ----------
    module : str
        File that it changes.
    operator : str
        What it does, as cosmic-ray names it.
    occurrence : int
        At which of the places in that file, as cosmic-ray counts.
    line : str
        The line that it changes, without blanks around it.
    repeat : int
        Which of the mutants of the same module, operator and line.
    """

    module: str
    operator: str
    occurrence: int
    line: str
    repeat: int

    @property
    def name(self) -> str:
        """The same in each commit that has the line."""
        return f"{self.module}|{self.operator}|{self.line}|{self.repeat}"

    def place(self, seed: int) -> str:
        """By which the sample is drawn."""
        return hashlib.sha256(f"{seed}|{self.name}".encode()).hexdigest()


class Clone:
    """A clone of the committed state; all clones share the environment of the first."""

    def __init__(self, folder: Path, commit: str, environment: Path | None = None) -> None:
        self.folder = folder
        self.commit = commit
        _call("git", "clone", "--quiet", "--no-hardlinks", str(ROOT), str(folder))
        _call("git", "checkout", "--quiet", "--detach", commit, cwd=folder)
        if environment is None:
            _call("make", "--silent", ".venv/.warm", cwd=folder)
            environment = folder / ".venv"
            _call(str(environment / "bin" / "pip"), "install", "--quiet", COSMIC_RAY, cwd=folder)
        self.environment = environment

    def program(self, name: str) -> str:
        """A program of the environment."""
        return str(self.environment / "bin" / name)

    def mutants(self, folder: str) -> Iterator[Mutant]:
        """All mutants of radwrap/FOLDER."""
        with tempfile.TemporaryDirectory() as place:
            settings, session = Path(place) / "settings.toml", Path(place) / "session.sqlite"
            settings.write_text(SETTINGS.format(folder=folder))
            _call(self.program("cosmic-ray"), "init", str(settings), str(session), cwd=self.folder)
            dumped = _call(self.program("cosmic-ray"), "dump", str(session), cwd=self.folder)
        told = [json.loads(line)[0]["mutations"][0] for line in dumped.splitlines()]
        seen: Counter[tuple[str, str, str]] = Counter()
        for one in sorted(told, key=lambda one: (one["module_path"], one["operator_name"], one["occurrence"])):
            if ANNOTATING in one["operator_name"]:
                continue
            line = (self.folder / one["module_path"]).read_text().splitlines()[one["start_pos"][0] - 1].strip()
            key = (one["module_path"], one["operator_name"], line)
            yield Mutant(key[0], key[1], one["occurrence"], line, seen[key])
            seen[key] += 1

    def tests(self, folder: str, mutant: Mutant | None) -> list[str]:
        """Test files of a folder; first those that name the module or the folder that it stands in."""
        files = sorted((self.folder / "tests" / folder).rglob("test_*.py"))
        module = Path("" if mutant is None else mutant.module)
        near = [name for name in (module.stem, module.parent.name) if name not in ("", folder)]
        files.sort(key=lambda file: -(2 * any(name in file.stem for name in near) + (module.stem in file.read_text())))
        return [str(file.relative_to(self.folder)) for file in files]

    def passes(self, folder: str, mutant: Mutant | None, limit: float | None) -> tuple[bool | None, str]:
        """Whether the folder's tests pass, None if they were not done in time; the test that failed."""
        command = [self.program("python"), "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider"]
        command += self.tests(folder, mutant)
        # Byte code of the mutant would outlive it.
        settings = {
            **os.environ,
            "PYTHONPATH": str(self.folder),
            "PYTHONDONTWRITEBYTECODE": "1",
            "OPENBLAS_NUM_THREADS": "1",
        }
        with subprocess.Popen(
            command,
            cwd=self.folder,
            env=settings,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        ) as tests:
            output = _within(tests, limit)
            if output is None:
                os.killpg(tests.pid, 9)
                tests.communicate()
                return None, ""
        failed = [line for line in output.splitlines() if line.startswith(("FAILED", "ERROR"))]
        return tests.returncode == 0, (failed or output.splitlines()[-1:] or [""])[0]

    def plant(self, folder: str, mutant: Mutant, limit: float) -> dict[str, Any]:
        """What became of a mutant."""
        start = time.monotonic()
        arguments = (mutant.module, mutant.operator, str(mutant.occurrence))
        _call(self.program("cosmic-ray"), "apply", *arguments, cwd=self.folder)
        diff = _call("git", "diff", "--unified=0", cwd=self.folder)
        try:
            passed, test = self.passes(folder, mutant, limit)
        finally:
            _call("git", "checkout", "--quiet", ".", cwd=self.folder)
        fate = {True: "survived", False: "killed", None: "survived its time"}[passed]
        change = [line for line in diff.splitlines() if line[:1] in "+-" and line[:3] not in ("+++", "---")]
        seconds = round(time.monotonic() - start, 1)
        row = {"folder": folder, "name": mutant.name, **asdict(mutant), "change": change}
        row |= {"fate": fate, "test": test, "seconds": seconds}
        print(f"{fate:17} {seconds:5.1f} s  {mutant.module}: {change[-1:]}", file=sys.stderr, flush=True)
        return row


def _within(tests: subprocess.Popen[str], limit: float | None) -> str | None:
    """What tests say, None where they take longer: by the processor's time, as the machine may have other work."""
    process, longest = psutil.Process(tests.pid), math.inf if limit is None else time.monotonic() + _PATIENCE * limit
    while True:
        try:
            return tests.communicate(timeout=_LOOK)[0]
        except subprocess.TimeoutExpired:
            if limit is not None and (sum(process.cpu_times()[:4]) > limit or time.monotonic() > longest):
                return None


def _call(*command: str, cwd: Path = ROOT) -> str:
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SystemExit(f"error: {' '.join(command)}: {(done.stderr or done.stdout).strip()[-2000:]}")
    return done.stdout


class Results:
    """What is known of a commit's mutants, kept in a file from one mutant to the next."""

    def __init__(self, file: Path, commit: str) -> None:
        self.file = file
        self.commit = commit
        self.lock = Lock()
        rows = json.loads(file.read_text()) if file.is_file() else []
        self.rows: dict[str, dict[str, Any]] = {row["name"]: row for row in rows if row["commit"] == commit}

    def add(self, row: dict[str, Any]) -> None:
        """One more; a kill between two of them loses nothing."""
        with self.lock:
            self.rows[row["name"]] = {**row, "commit": self.commit}
            self.file.parent.mkdir(parents=True, exist_ok=True)
            unfinished = self.file.with_suffix(".part")
            unfinished.write_text(json.dumps(list(self.rows.values()), indent=1))
            unfinished.replace(self.file)


def drawn(clone: Clone, folder: str, arguments: argparse.Namespace) -> list[Mutant]:
    """The sample of a folder."""
    mutants = list(clone.mutants(folder))
    if arguments.also:
        _call("git", "checkout", "--quiet", "--detach", arguments.also, cwd=clone.folder)
        there = {mutant.name for mutant in clone.mutants(folder)}
        _call("git", "checkout", "--quiet", "--detach", clone.commit, cwd=clone.folder)
        mutants = [mutant for mutant in mutants if mutant.name in there]
    return sorted(mutants, key=lambda mutant: mutant.place(arguments.seed))[: arguments.count]


def sample(arguments: argparse.Namespace, commit: str, results: Results) -> None:
    """Plant a sample in each folder, but for what is known already."""
    with tempfile.TemporaryDirectory(prefix="mutants-") as place:
        first = Clone(Path(place) / "0", commit)
        further = range(1, arguments.workers)
        clones = [first, *(Clone(Path(place) / str(number), commit, first.environment) for number in further)]
        jobs = []
        for folder in arguments.folders or FOLDERS:
            jobs += [(folder, one) for one in drawn(first, folder, arguments) if one.name not in results.rows]
        for folder in sorted({folder for folder, _ in jobs}):
            passed, test = first.passes(folder, None, None)
            if not passed:
                raise SystemExit(f"error: tests/{folder} fails without a mutant: {test}")
        free: SimpleQueue[Clone] = SimpleQueue()
        for clone in clones:
            free.put(clone)

        def run(job: tuple[str, Mutant]) -> None:
            clone = free.get()
            try:
                results.add(clone.plant(*job, arguments.seconds))
            finally:
                free.put(clone)

        with ThreadPoolExecutor(arguments.workers) as pool:
            list(pool.map(run, jobs))


def compared(before: Path, after: Path) -> int:
    """Report mutants that were killed before and are not now; 1 if there are any."""
    old, new = ({row["name"]: row for row in json.loads(file.read_text())} for file in (before, after))
    both = old.keys() & new.keys()
    lost = sorted(name for name in both if old[name]["fate"] == "killed" != new[name]["fate"])
    print(f"{len(both)} mutants in both, {len(old) - len(both)} only before")
    print(f"killed before: {_killed(old)} of {len(old)}; after: {_killed(new)} of {len(new)}; lost: {len(lost)}")
    for name in lost:
        print(f"  {name}")
    return 1 if lost else 0


def _killed(rows: dict[str, dict[str, Any]]) -> int:
    return sum(row["fate"] == "killed" for row in rows.values())


def main() -> int:
    """Plant, or compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="*", choices=[*FOLDERS, []], help="default: both")
    parser.add_argument("--commit", default="HEAD", help="state to mutate and to test")
    parser.add_argument("--also", metavar="COMMIT", help="draw only mutants that this state has too")
    parser.add_argument("--count", type=int, default=50, help="mutants of each folder (default 50)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=60.0, help="of the processor for each mutant (default 60)")
    parser.add_argument("--workers", type=int, default=1, help="mutants tested side by side")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "mutants.json")
    parser.add_argument("--against", nargs=2, type=Path, metavar=("BEFORE", "AFTER"), help="compare two results")
    arguments = parser.parse_args()
    if arguments.against:
        return compared(*arguments.against)
    if shutil.which("git") is None:
        raise SystemExit("error: git is needed, for the clone")
    commit = _call("git", "rev-parse", arguments.commit).strip()
    if arguments.also:
        arguments.also = _call("git", "rev-parse", arguments.also).strip()
    results = Results(arguments.out, commit)
    sample(arguments, commit, results)
    print(f"{_killed(results.rows)} of {len(results.rows)} killed")
    return 0


if __name__ == "__main__":
    sys.exit(main())
