"""Parts in a white tent, lit off its walls alone: error asked, certified and got, rays and time.

What was got is measured from two images of different seeds: their difference has twice the error's mean square.
"""

from __future__ import annotations

import resource
import sys
import time
from pathlib import Path

import numpy as np

import radwrap

ROOT = Path(__file__).parents[1]
TENT = ROOT / "rad_scenes" / "white_tent" / "scene.toml"
SMALLER = {"camera.sensor.rows": 25, "camera.sensor.columns": 30} | {
    f"camera.sensor.pixel_{side}": "120 um" for side in ("width", "height")
}
TOLERANCES = (16.0, 8.0)


def main() -> int:
    """Print a row for each tolerance; 1 where an error is beyond its certificate."""
    scene = radwrap.load_scene(TENT, SMALLER | {"camera.sensor.rounding": False})
    code = 0
    print(f"{'asked':>6} {'certified':>9} {'got':>6} {'mean gray':>9} {'rays':>9} {'wall':>7} {'cpu':>7}")
    for tolerance in TOLERANCES:
        start, before = time.monotonic(), _cpu()
        images = [radwrap.render(scene, bounces="all", tolerance=tolerance, seed=seed) for seed in (0, 1)]
        wall, cpu = (time.monotonic() - start) / 2, (_cpu() - before) / 2
        first, second = (image.gray.values for image in images)
        got = float(np.sqrt(((first - second) ** 2).mean() / 2))
        certified = max(image.run.error.rms_gray_upper95 for image in images)
        rays = images[0].run.rays
        print(
            f"{tolerance:6g} {certified:9.3g} {got:6.3g} {first.mean():9.1f} {rays:9.3g} {wall:6.1f}s {cpu:6.1f}s",
            flush=True,
        )
        code = code or int(got > certified)
    return code


def _cpu() -> float:
    """Processor time of this process and its children [s]."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


if __name__ == "__main__":
    sys.exit(main())
