"""How many rays a fit takes, and how many plain finite differences with fresh renders take for the same accuracy.

    .venv/bin/python scripts/fit_rays.py --twins 6 --seed 1 --out out/fit_rays.json
    .venv/bin/python scripts/fit_rays.py --twins 6 --renders --out out/fit_rays_renders.json

Both see the twins of fit_twins.py. The plain way is that of a user who has a renderer and Gauss and Newton: each image
is a render of its own seed, each slope a difference of two of them, until a step moves the prediction by less than half
a deviation, and four steps at most. It begins where the fit ended, with steps of keys that are chosen by hand: it need
not find the way from afar, nor how far keys may be moved. It is tried at tolerances that get finer by 2; that one
counts at which its keys are no farther from the truth (rms over all keys that the fit determines, in the fit's own
deviations) than a tenth more than the fit's, or the last one.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import radwrap
from fit_twins import Twin, keys_of, twin_of
from radwrap.files import write_bytes
from radwrap.fitting.captured import captured
from radwrap.fitting.covariance import GRAIN, inverse_of
from radwrap.fitting.free_keys import FreeScene, free_scene
from radwrap.fitting.weights import weighed
from radwrap.imaging.response.sensor import unclipped_gray
from radwrap.manifest import json_text

Array = NDArray[np.float64]
# By so much a key is moved both ways, in its unit: an edge goes by a third of a pixel, a level by a tenth.
MOVED: Final = {
    "radiance_factor": 0.1,
    "exposure_time": 10.0,
    "offset": 1.0,
    "edge_position": 0.6,
    ".tx": 0.6,
    ".ty": 0.6,
    ".tz": 8.0,
    ".rx": 4.0,
    ".ry": 4.0,
    ".rz": 1.5,
    "focal_length": 0.3,
    "reflectance": 0.05,
    "beam.width": 3.0,
}
STEPS: Final = 4
ARRIVED: Final = 0.5
MORE: Final = 1.1
TOLERANCES: Final = 2


@dataclass
class Fresh:
    """Renders, each by a seed of its own; counts rays."""

    free: FreeScene
    tolerance: float
    seed: int
    method: str | None
    rays: int = 0
    renders: int = 0

    def __call__(self, values: Array) -> tuple[Array, Array]:
        """Radiant exposure and gray levels without saturation."""
        scene = self.free.at(values.tolist())
        self.renders += 1
        options = radwrap.RenderOptions(
            tolerance=self.tolerance, seed=self.seed + self.renders, workers=1, tracer="compiled"
        )
        made = radwrap.render(scene, options=replace(options, method=self.method))
        self.rays += made.run.rays
        return made.radiant_exposure.values, unclipped_gray(made.radiant_exposure.values, scene.camera.sensor)


def plainly(asked: Twin, begin: Array, fresh: Fresh) -> Array:
    """Values by Gauss and Newton."""
    free, values = fresh.free, begin
    sensor = free.scene.camera.sensor
    shot = captured([asked.capture], ["capture"], sensor, None)
    for _ in range(STEPS):
        exposure, gray = fresh(values)
        scene = free.at(values.tolist())
        counted = weighed(exposure, gray, shot, scene.camera.sensor, None)
        used, sigma = counted.used, counted.sigma[counted.used]
        columns = []
        for number, key in enumerate(free.keys):
            step = next(step for name, step in MOVED.items() if key.key.endswith(name))
            ends = []
            for sign in (1, -1):
                moved = values.copy()
                moved[number] = min(max(moved[number] + sign * step, key.low), key.high)
                ends.append((moved[number], fresh(moved)[1]))
            slope = (ends[0][1] - ends[1][1]) / (ends[0][0] - ends[1][0]) * key.scale
            columns.append(slope[used] / sigma)
        jacobian = np.stack(columns, axis=1)
        way = inverse_of(jacobian, GRAIN).matrix @ ((shot.mean - gray)[used] / sigma)
        low, high = np.array([[key.low, key.high] for key in free.keys]).T
        values = np.clip(values + way * np.array([key.scale for key in free.keys]), low, high)
        if np.linalg.norm(jacobian @ way) < ARRIVED:
            break
    return values


def compared(number: int, given: argparse.Namespace) -> dict[str, Any]:
    """One twin, both ways."""
    asked = twin_of(number, given.seed, given.tolerance, renders=given.renders)
    options = radwrap.RenderOptions(tolerance=given.tolerance, seed=number, workers=1)
    found = radwrap.fit(asked.begun, [asked.capture], keys_of(asked.truth), options=options)
    free = free_scene(asked.begun, keys_of(asked.truth))
    truth = np.array([asked.truth[key.key] for key in free.keys])
    begin = np.array([key.value for key in found.keys])
    sigma = np.array([key.sigma or np.nan for key in found.keys])
    told: list[dict[str, Any]] = []
    for halving in range(TOLERANCES):
        fresh = Fresh(free, given.tolerance / 2**halving, 1_000 * (number + 1), found.manifest["held"]["method"])
        values = plainly(asked, begin, fresh)
        told.append({"tolerance": fresh.tolerance, "rays": fresh.rays, "renders": fresh.renders})
        told[-1]["pulls"] = [float(one) for one in ((values - truth) / sigma)[np.isfinite(sigma)]]
    return {
        "twin": number,
        "keys": len(free.keys),
        "rays": found.manifest["rays"],
        "pulls": [float(one) for one in ((begin - truth) / sigma)[np.isfinite(sigma)]],
        "plain": told,
    }


def summary(twins: list[dict[str, Any]]) -> dict[str, Any]:
    """Rays of both, and accuracy at each tolerance."""

    def rms(pulls: list[list[float]]) -> float:
        return float(np.sqrt(np.mean(np.concatenate([np.array(one) for one in pulls]) ** 2)))

    own, rays = rms([one["pulls"] for one in twins]), float(np.mean([one["rays"] for one in twins]))
    plain = [
        {
            "tolerance": twins[0]["plain"][k]["tolerance"],
            "rms_in_deviations": rms([one["plain"][k]["pulls"] for one in twins]),
            "times_the_rays": float(np.mean([one["plain"][k]["rays"] for one in twins])) / rays,
        }
        for k in range(TOLERANCES)
    ]
    enough = [one for one in plain if one["rms_in_deviations"] <= MORE * own]
    return {
        "rays": rays,
        "rms_in_deviations": own,
        "plain": plain,
        "is_reached": bool(enough),
        "times_the_rays": (enough or plain[-1:])[0]["times_the_rays"],
    }


def main() -> None:
    """Compare, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--twins", type=int, default=6)
    parser.add_argument("--renders", action="store_true", help="with places, poses and beams that need renders")
    parser.add_argument("--tolerance", type=float, default=0.5, help="of the fits [gray level] (default 0.5)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    twins = []
    for number in range(given.twins):
        twins.append(compared(number, given))
        print(f"twin {number}: {twins[-1]['keys']} keys", file=sys.stderr)
        if given.out:
            write_bytes(given.out, json_text({"summary": summary(twins), "twins": twins}).encode())
    print(json_text(summary(twins)), end="")


if __name__ == "__main__":
    main()
