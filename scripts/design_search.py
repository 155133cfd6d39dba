"""Is a design's search worth its renders: three mixed problems against random candidates.

Each problem has continuous keys, steps and choices, limits, and a cost. Candidates drawn evenly over the same keys (the
logarithm where the key has one) are rendered at the same tolerance by the same seed; their best hundredth, counted over
all that were drawn, is what a search of fewer renders must reach.

    python scripts/design_search.py --random 2000 --budget 200 --out out/design_search
"""

from __future__ import annotations

import argparse
import math
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from radwrap.designing.bench import Bench
from radwrap.designing.candidates import candidate_of
from radwrap.designing.document import Problem, read_problem
from radwrap.designing.keys import Code, SearchKey
from radwrap.designing.run import run_design
from radwrap.designing.trials import Trial
from radwrap.files import make_folder
from radwrap.manifest import write_manifest
from radwrap.progress import Progress
from radwrap.study.study import StudyOptions, open_pool

_TOLERANCE: Final = 4.0  # gray levels
_BEST: Final = 100  # one in so many

_SCENE: Final = """
[camera]
position = ["0 mm", "0 mm", "250 mm"]
look_at = ["0 mm", "0 mm", "0 mm"]
focal_length = "12 mm"
exposure_time = "50 ms"
diffraction = "off"

[camera.aperture]
diameter = "0.3 mm"

[camera.sensor]
rows = 20
columns = 26
pixel_width = "60 um"
pixel_height = "60 um"
gain = "1e5 (J/m^2)^-1"
gamma = 1.0
dark_gray = 10
saturation_gray = 255
rounding = false

[[sources]]
type = "ring"
name = "ring"
position = ["0 mm", "0 mm", "150 mm"]
look_at = ["0 mm", "0 mm", "0 mm"]
count = 6
diameter = "80 mm"
led_diameter = "5 mm"
radiance = "300 kW/m^2/sr"
beam = { profile = "gaussian", width = "40 deg", width_definition = "fwhm" }

[materials.black]
type = "lambertian"
reflectance = 0.05

[materials.white]
type = "lambertian"
reflectance = 0.7

[[targets]]
type = "edge"
name = "edge"
material = "black"
edge_material = "white"
size = ["400 mm", "400 mm"]
rotation = ["0 deg", "0 deg", "9 deg"]
edge_position = "1 mm"
"""
_SHEET: Final = (
    _SCENE.partition("[[targets]]")[0]
    + """
[[targets]]
type = "sheet"
name = "sheet"
material = "white"
size = ["400 mm", "400 mm"]
"""
)

_TIME: Final = """
[keys.time]
key = "camera.exposure_time"
low = "2 ms"
high = "300 ms"
scale = "log"
"""
_OPENING: Final = """
[keys.opening]
key = "camera.aperture.diameter"
low = "0.1 mm"
high = "2 mm"
scale = "log"
"""
_RING: Final = """
[keys.width]
key = "sources[0].diameter"
low = "30 mm"
high = "150 mm"
step = "5 mm"
[keys.beam]
key = "sources[0].beam.width"
choices = ["15 deg", "25 deg", "40 deg", "60 deg"]
cost = [4, 3, 2, 1]
"""
_LEDS: Final = """
[keys.count]
key = "sources[0].count"
choices = [3, 4, 6, 8, 12]
cost = [3, 4, 6, 8, 12]
"""
_PLACE: Final = """
[keys.x]
key = "sources[0].position[0]"
low = "-40 mm"
high = "40 mm"
[keys.height]
key = "sources[0].position[2]"
low = "60 mm"
high = "230 mm"
"""
_PEAK: Final = """
[[constraints]]
of = "peak_gray"
at_least = 120
at_most = 240
"""

# Problem -> scene, and keys, objective and limits.
PROBLEMS: Final = {
    "sharp edge, 4 keys": (
        _SCENE,
        _TIME
        + _OPENING
        + _RING
        + _PEAK
        + '[responses.goal]\nmeasure = "edge_blur"\ndark = "sensor"\ngamma = "sensor"\n'
        '[[objectives]]\nof = "goal"\naim = "minimise"\n[[constraints]]\nof = "exposure_time"\nat_most = "40 ms"\n'
        '[[constraints]]\nof = "cost"\nat_most = 3\n',
    ),
    "even field, 6 keys": (
        _SHEET,
        _TIME + _RING + _LEDS + _PLACE + _PEAK + '[responses.goal]\nmeasure = "unevenness"\n'
        '[[objectives]]\nof = "goal"\naim = "minimise"\n[[constraints]]\nof = "cost"\nat_most = 9\n',
    ),
    "sharp edge, 8 keys": (
        _SCENE,
        _TIME + _OPENING + _RING + _LEDS + _PLACE + '[keys.lens]\nkey = "camera.focal_length"\n'
        'choices = ["8 mm", "12 mm", "16 mm"]\ncost = [1, 2, 3]\n' + _PEAK + '[responses.goal]\nmeasure = "edge_blur"\n'
        'dark = "sensor"\ngamma = "sensor"\n[responses.mean]\nmeasure = "mean_gray"\n[[objectives]]\nof = "goal"\n'
        'aim = "minimise"\n[[constraints]]\nof = "exposure_time"\nat_most = "20 ms"\n'
        '[[constraints]]\nof = "cost"\nat_most = 12\n',
    ),
}


def drawn(key: SearchKey, random: np.random.Generator) -> Code:
    """A code, evenly over all that the key may be."""
    if key.span is None:
        return int(random.integers(len(key.choices)))
    low, high = key.span.low, key.span.high
    if key.span.is_log:
        return math.exp(random.uniform(math.log(low), math.log(high)))
    return float(random.uniform(low, high))


def randomly(problem: Problem, out: Path, options: StudyOptions, count: int, seed: int) -> list[Trial]:
    """Trials of candidates that are drawn."""
    random = np.random.default_rng(seed)
    codes = [tuple(drawn(key, random) for key in problem.keys) for _ in range(count)]
    make_folder(out)
    progress = Progress("random", count)
    with closing(open_pool(options, out)) as pool, closing(progress):
        bench = Bench(problem, out, options, pool, progress)
        return bench.look_at([candidate_of(problem, one) for one in codes], "search", _TOLERANCE, problem.study.seed)


def compared(name: str, given: argparse.Namespace) -> bool:
    """Whether the search of a problem is as good as the best hundredth of random candidates."""
    scene, text = PROBLEMS[name]
    folder, count = given.out / name.replace(" ", "_").replace(",", ""), given.random
    make_folder(folder)
    (folder / "scene.toml").write_text(scene)
    path = folder / "design.toml"
    head = f'scene = "scene.toml"\nbudget = {given.budget}\nseed = {given.seed}\ncoarse = 1\n'
    path.write_text(f"{head}[render]\ntolerance = {_TOLERANCE}\n{text}")
    problem = read_problem(path)
    options = StudyOptions(workers=given.workers, tracer="compiled", progress=True)
    found = run_design(problem, folder / "design", options)
    trials = randomly(replace(problem, study=found.problem.study), folder / "random", options, count, given.seed + 1)
    sign = problem.objectives[0].sign
    good = sorted(sign * trial.answers["goal"].value for trial in trials if trial.is_feasible(problem))
    most = max(1, count // _BEST)
    limit = good[most - 1] if len(good) >= most else math.inf
    best = math.inf if found.best is None else sign * found.best.answers["goal"].value
    rank = sum(one < best for one in good)
    told = {
        "schema_version": 1,
        "best": best if math.isfinite(best) else None,
        "best_hundredth": limit if math.isfinite(limit) else None,
        "best_of_random": good[0] if good else None,
        "random_better": rank,
        "random": count,
        "random_feasible": len(good),
        "renders": found.renders,
    }
    write_manifest(folder / "compared.json", told)
    print(
        f"{name}: design {best:.5g} by {found.renders} renders; best hundredth of {count} random ones {limit:.5g} "
        f"(best {good[0] if good else math.inf:.5g}, {len(good)} keep the limits); {rank} of them are better",
        flush=True,
    )
    return best <= limit


def main() -> int:
    """Compare all problems; exit code 1 where one is worse."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--random", type=int, default=2000, help="random candidates of each problem")
    parser.add_argument("--budget", type=int, default=200, help="renders of each search")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("out/design_search"))
    given = parser.parse_args()
    good = [compared(name, given) for name in PROBLEMS]
    return 0 if all(good) else 1


if __name__ == "__main__":
    sys.exit(main())
