"""What a study gains by two workers, beside what two bare tracers gain; writes out/study_benchmark.json.

Sixteen runs (rad_scenes/study_table2) with one worker, with two, and on a Dask LocalCluster of two processes; between
them the same rays by one tracer and by two. Every limit is a ratio of times of this run; exit code 1 if one is missed.
Last 4096 levels of twelve LEDs from one light basis.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

import radwrap
from radwrap.imaging.optics.view import trace_rays
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.tracing import traced_scene

ROOT = Path(__file__).resolve().parent.parent
DESIGN = ROOT / "rad_scenes" / "study_table2" / "design.toml"
LEDS = ROOT / "rad_scenes" / "study_leds" / "design.toml"
COMMAND = str(Path(sys.executable).parent / "radwrap")

GAIN = 1.7  # of two workers over one,
OF_BARE = 0.9  # or so much of what two bare tracers gain
RAYS = 400_000
ROUNDS = int(sys.argv[1]) if len(sys.argv) > 1 else 2
LONGEST = 60.0  # s, for 4096 levels
MOST_RENDERS = 5


def timed(work: Callable[[], object]) -> float:
    """Wall time [s]."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def cpu() -> float:
    """CPU time of the ended children [s]."""
    times = os.times()
    return times.children_user + times.children_system


def study(design: Path, *words: object) -> tuple[float, float, bytes, dict[str, object]]:
    """Wall and CPU time of a study, its table, and what it told."""
    with tempfile.TemporaryDirectory() as folder:
        argv = [COMMAND, "study", "run", design, "--out", folder, "--no-report", "--json", *words]
        wall, used = time.perf_counter(), cpu()
        done = subprocess.run([str(word) for word in argv], check=True, capture_output=True)
        wall = time.perf_counter() - wall
        return wall, cpu() - used, (Path(folder) / "results.csv").read_bytes(), json.loads(done.stdout)


def bare_tracers() -> tuple[float, float]:
    """Times of the same rays by one tracer and by two [s]."""
    scene = radwrap.load_scene(ROOT / "rad_scenes" / "fig13_oriented_board" / "scene.toml")
    random = np.random.default_rng(0)
    with traced_scene(scene, RenderOptions(workers=2)) as view:
        sensor = view.camera.sensor
        u, v = random.random((2, RAYS)) * [[sensor.columns], [sensor.rows]] - 0.5
        one, two = (
            timed(lambda workers=workers: trace_rays(replace(view, workers=workers), None, u, v)) for workers in (1, 2)
        )
    return one, two


def main() -> int:
    """Measure, print, write; the exit code says whether the limits were kept."""
    from distributed import LocalCluster

    def note(what: str, seconds: float) -> None:
        print(f"{what}: {seconds:.1f} s", file=sys.stderr, flush=True)

    ones, twos, dasks, bare_ones, bare_twos, tables, used = [], [], [], [], [], set(), []
    with LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0") as cluster:
        for _ in range(ROUNDS):
            for times, words in (
                (ones, ("--workers", 1)),
                (twos, ("--workers", 2)),
                (dasks, ("--dask", cluster.scheduler_address)),
            ):
                wall, cpu_s, table, _ = study(DESIGN, *words)
                times.append(wall)
                tables.add(table)
                used.append((words[0] + " " + str(words[1]), cpu_s))
                note(" ".join(map(str, words)), wall)
                one, two = bare_tracers()
                bare_ones.append(one)
                bare_twos.append(two)
                note("one bare tracer", one)
                note("two bare tracers", two)
    bare = sum(bare_ones) / sum(bare_twos)
    gains = {"two workers": sum(ones) / sum(twos), "dask": sum(ones) / sum(dasks)}
    wall, cpu_s, _, told = study(LEDS)
    result = {
        "one_worker_s": ones,
        "two_workers_s": twos,
        "dask_s": dasks,
        "gain": gains,
        "gain_of_bare_tracers": bare,
        "tables_equal": len(tables) == 1,
        "cpu_s": used,
        "leds": {"wall_s": wall, "cpu_s": cpu_s, "runs": told["runs"], "renders": told["renders"]},
        "load": os.getloadavg(),
    }
    print(json.dumps(result, indent=2))
    (ROOT / "out").mkdir(exist_ok=True)
    (ROOT / "out" / "study_benchmark.json").write_text(json.dumps(result, indent=2) + "\n")
    kept = all(gain >= min(GAIN, OF_BARE * bare) for gain in gains.values()) and len(tables) == 1
    return 0 if kept and wall <= LONGEST and int(str(told["renders"])) <= MOST_RENDERS else 1


if __name__ == "__main__":
    sys.exit(main())
