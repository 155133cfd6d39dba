"""How many rays a fit takes, and how many plain finite differences with fresh renders take for the same accuracy.

    .venv/bin/python scripts/fit_rays.py --twins 10 --seed 1 --out out/fit_rays.json
    .venv/bin/python scripts/fit_rays.py --twins 10 --renders --out out/fit_rays_renders.json

Both see the twins of fit_twins.py, one capture each. The plain way is that of a user who has a renderer and scipy:
`least_squares` with slopes by '2-point' differences, where each image is a render of a seed of its own, by the method
that costs least. It begins where the fit began (`afar`), or where the fit ended (`near`): then it need not find the
way. Its steps are chosen by hand, as those of scipy would show the grain of the rays only. It ends where chi-square
changes by less than a thousandth. Tolerances get finer by 2.

Each way is taken with several seeds of its rays. Two measures tell the same accuracy, in deviations by noise, over all
keys that the fit determines. `off` is the rms distance of the answers from the truth: the noise of the capture, which
no way can take away, is in all of them. `scatter` is that of the answers about their own mean: what the way itself
adds. The plain way is as accurate where its `off` is no more than a tenth larger, or where `scatter` is not either, and
gets finer until both are. Rays are counted at the tracer, of both ways alike, pilots and certificates too.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.optimize import least_squares

import radwrap
from fit_twins import Twin, keys_of, twin_of
from radwrap.errors import InputError
from radwrap.files import write_bytes
from radwrap.fitting.captured import captured
from radwrap.fitting.free_keys import FreeScene, free_scene
from radwrap.fitting.weights import weighed
from radwrap.imaging.response.sensor import unclipped_gray
from radwrap.manifest import json_text
from radwrap.random_streams import generator
from radwrap.tracers.compiled.tracer import CompiledTracer

Array = NDArray[np.float64]
_STREAM: Final = 9_002
# By so much a key is moved, in its unit: an edge goes by a third of a pixel, a level by a tenth.
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
# What is 0 where it begins has no relative step: all begin here, and are moved by a tenth of it.
MIDDLE: Final = 10.0
STEP: Final = 0.1
SETTLED: Final = 1e-3  # of chi-square, and of a step by its length
IMAGES: Final = 40  # at most, beside those of slopes
MORE: Final = 1.1
MEASURES: Final = ("off", "scatter")
NEVER: Final = 1e6  # gray levels off: a scene that does not take the values


class Rays:
    """How many are traced, by whomever."""

    def __init__(self) -> None:
        self.count = 0

    @contextmanager
    def counted(self) -> Iterator[None]:
        """Rays that are shaded in this block."""
        shaded = CompiledTracer._shaded

        def counting(tracer: CompiledTracer, block: Array, *rest: Any) -> Any:
            self.count += len(block)
            return shaded(tracer, block, *rest)

        CompiledTracer._shaded = counting  # type: ignore[method-assign]
        try:
            yield
        finally:
            CompiledTracer._shaded = shaded  # type: ignore[method-assign]


@dataclass
class Fresh:
    """Renders, each by a seed of its own."""

    free: FreeScene
    tolerance: float
    seed: int
    renders: int = 0

    def __call__(self, values: Array) -> Array:
        """Gray levels without saturation."""
        scene = self.free.at(values.tolist())
        self.renders += 1
        options = radwrap.RenderOptions(
            tolerance=self.tolerance, seed=self.seed + self.renders, workers=1, tracer="compiled"
        )
        made = radwrap.render(scene, options=options)
        return unclipped_gray(made.radiant_exposure.values, scene.camera.sensor)


def plainly(asked: Twin, begin: Array, fresh: Fresh) -> Array:
    """Values by scipy. What pixels count is told by the capture itself, a little blurred."""
    free = fresh.free
    sensor = free.scene.camera.sensor
    shot = captured([asked.capture], ["capture"], sensor, None)
    scale = steps_of(free)
    smooth = gaussian_filter(shot.mean, 1.0)
    light = np.linspace(0.0, 4.0 * np.ptp(smooth) / _gray_of_light(sensor), 10_001)
    exposure = np.interp(smooth, unclipped_gray(light, sensor), light)
    counted = weighed(exposure, smooth, shot, sensor, None)
    used, sigma = counted.used, counted.sigma[counted.used]
    bounds = np.array([[key.low, key.high] for key in free.keys]).T

    def off(x: Array) -> Array:
        try:
            gray = fresh(np.clip(begin + (x - MIDDLE) * scale, *bounds))
        except InputError:
            return np.full(sigma.size, NEVER)
        return np.asarray((gray - shot.mean)[used] / sigma)

    low, high = MIDDLE + (bounds - begin) / scale
    found = least_squares(
        off,
        np.clip(np.full(len(scale), MIDDLE), low + 1e-9, high - 1e-9),
        jac="2-point",
        diff_step=STEP,
        bounds=(low, high),
        x_scale="jac",
        ftol=SETTLED,
        xtol=SETTLED,
        gtol=None,
        max_nfev=IMAGES,
    )
    return np.asarray(begin + (found.x - MIDDLE) * scale)


def steps_of(free: FreeScene) -> Array:
    """By how much each key is moved."""
    return np.array([next(step for name, step in MOVED.items() if key.key.endswith(name)) for key in free.keys])


def _gray_of_light(sensor: Any) -> float:
    """Gray levels of 1 J/m^2."""
    return float(np.ptp(unclipped_gray(np.array([0.0, 1e-6]), sensor))) / 1e-6


def compared(number: int, given: argparse.Namespace) -> dict[str, Any]:
    """One twin, both ways."""
    asked = twin_of(number, given.seed, given.tolerance, renders=given.renders)
    free = free_scene(asked.begun, keys_of(asked.truth))
    truth = np.array([asked.truth[key.key] for key in free.keys])
    fits: list[radwrap.Fit] = []
    rays = Rays()
    with rays.counted():
        for seed in range(given.seeds):
            options = radwrap.RenderOptions(tolerance=given.tolerance, seed=1_000 * number + seed, workers=1)
            found = radwrap.fit(asked.begun, [asked.capture], keys_of(asked.truth), options=options)
            fits.append(found)
    first, own = fits[0], np.array([[key.value for key in one.keys] for one in fits])
    sigma = np.array([key.sigma_noise or np.nan for key in first.keys])
    told: dict[str, Any] = {
        "twin": number,
        "keys": [key.key for key in free.keys],
        "determined": int(np.isfinite(sigma).sum()),
        "rays": rays.count / given.seeds,
        **accuracy(own, truth, sigma),
    }
    if not told["determined"]:
        return told
    begun = np.array([key.value for key in free.keys])
    signs = generator(given.seed, number, _STREAM).choice([-0.5, 0.5], len(truth))
    near = np.clip(truth + signs * steps_of(free), *np.array([[key.low, key.high] for key in free.keys]).T)
    begins = {"afar": begun, "near": near}
    for name in given.begin:
        told[name] = []
        for halving in range(given.halvings):
            rays, plain, renders = Rays(), [], 0
            with rays.counted():
                for seed in range(given.seeds):
                    rays_of = 1_000_000 * (number + 1) + 10_000 * seed + 1_000 * halving
                    fresh = Fresh(free, given.tolerance / 2**halving, rays_of)
                    plain.append(plainly(asked, begins[name], fresh))
                    renders += fresh.renders
            told[name].append(
                {
                    "tolerance": given.tolerance / 2**halving,
                    "rays": rays.count / given.seeds,
                    "renders": renders / given.seeds,
                    **accuracy(np.array(plain), truth, sigma),
                }
            )
            if _reached(told, name, MEASURES[-1]) is not None:
                break
    return told


def accuracy(values: Array, truth: Array, sigma: Array) -> dict[str, float]:
    """Of the answers of several seeds, shape (seeds, keys), in deviations by noise."""
    known = np.isfinite(sigma)
    if not known.any():
        return {}
    off = ((values - truth) / sigma)[:, known]
    scatter = off - off.mean(axis=0)
    freedom = max(len(off) - 1, 1) * off.shape[1]
    return {"off": float(np.sqrt((off**2).mean())), "scatter": float(np.sqrt((scatter**2).sum() / freedom))}


def _reached(told: dict[str, Any], begin: str, measure: str) -> dict[str, Any] | None:
    """The plain way at the first tolerance with which it is as accurate, by a measure and those before it."""
    asked = MEASURES[: MEASURES.index(measure) + 1]
    return next((one for one in told[begin] if all(one[name] <= MORE * told[name] for name in asked)), None)


def summary(twins: list[dict[str, Any]]) -> dict[str, Any]:
    """Times the rays of the fit, at the first tolerance that is as accurate, or at the last one: at least so many."""
    judged = [one for one in twins if one["determined"]]
    told: dict[str, Any] = {"twins": len(twins), "nothing_determined": len(twins) - len(judged)}
    if not judged:
        return told
    told["rays_median"] = float(np.median([one["rays"] for one in judged]))
    for name in ("off", "scatter"):
        told[f"{name}_median"] = float(np.median([one[name] for one in judged]))
    for begin in ("afar", "near"):
        some = [one for one in judged if begin in one]
        if not some:
            continue
        told[begin] = {"twins": len(some)}
        for measure in MEASURES:
            reached = [_reached(one, begin, measure) for one in some]
            times = [(at or one[begin][-1])["rays"] / one["rays"] for at, one in zip(reached, some, strict=True)]
            told[begin][measure] = {
                "times_the_rays_median": float(np.median(times)),
                # Of those that are not as accurate at the last tolerance: more than that.
                "times_the_rays": sorted(times),
                "as_accurate": sum(at is not None for at in reached),
            }
    return told


def main() -> None:
    """Compare, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--twins", type=int, default=10)
    parser.add_argument("--renders", action="store_true", help="with places, poses and beams that need renders")
    parser.add_argument("--tolerance", type=float, default=0.5, help="of the fits [gray level] (default 0.5)")
    parser.add_argument("--halvings", type=int, default=3, help="tolerances of the plain way (default 3)")
    parser.add_argument("--seeds", type=int, default=6, help="of the rays of each way (default 6)")
    parser.add_argument("--begin", nargs="+", choices=("afar", "near"), default=["afar"])
    parser.add_argument("--seed", type=int, default=0, help="of the twins")
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    what = {name: value for name, value in vars(given).items() if name not in ("out", "twins")}
    twins: list[dict[str, Any]] = []
    if given.out and given.out.exists():
        kept = json.loads(given.out.read_text())
        if kept["asked"] != what:
            raise SystemExit(f"{given.out} is of another run: {kept['asked']}")
        twins = kept["twins"]
    for number in range(len(twins), given.twins):
        twins.append(compared(number, given))
        print(f"twin {number}: {len(twins[-1]['keys'])} keys", file=sys.stderr)
        if given.out:
            write_bytes(given.out, json_text({"asked": what, "summary": summary(twins), "twins": twins}).encode())
    print(json_text(summary(twins)), end="")


if __name__ == "__main__":
    main()
