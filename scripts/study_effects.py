"""Whether a study's effects and error bars can be trusted: null factors, planted effects, errors against finer renders.

    .venv/bin/python scripts/study_effects.py [coverage] [nulls] [planted] [exposure] [--seed N] [--out FILE.json]

Random edges in even light on 40 x 48 pixels, with and without rounding. `nulls`: exposure against gain, all levels
against exposure, exposure alone (for place and blur of the edge), the whole scene moved; two replicates, judged at the
5 % level. `planted`: an edge that lies elsewhere by four of the effect's stated errors. `coverage`: responses against
renders with cells of a quarter of the size and twenty replicates, whose noise is ten times smaller. `exposure`: blur of
an edge under exposure, opening and height of the ring, 12 bits, eight runs.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from threadpoolctl import threadpool_limits

from radwrap.files import write_bytes
from radwrap.imaging.demand import SamplingPlan
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.synthesis import render
from radwrap.imaging.tolerance.replicates import Work
from radwrap.imaging.tolerance.sampling import pilot, strictest
from radwrap.imaging.tracing import laid_out
from radwrap.manifest import json_text
from radwrap.process import Programs
from radwrap.progress import Progress
from radwrap.scene.file.load import scene_from_document
from radwrap.scene.scene import Scene
from radwrap.study.design import Design
from radwrap.study.effects import Analysis, analyse
from radwrap.study.factors import Factor, Level
from radwrap.study.image_error import blur_radii, error_fields, image_error
from radwrap.study.levels import read_data
from radwrap.study.responses import Response, answer
from radwrap.study.seen import Answer, Seen
from radwrap.study.study import StudyOptions, run_study
from radwrap.study.worker import seen_of

SENSOR: Final = {"dark": "sensor", "gamma": "sensor"}
RESPONSES: Final = (
    Response("u", "edge_position", "px", SENSOR),
    Response("b", "edge_blur", "px", SENSOR),
    Response("mean", "mean_gray"),
    Response("contrast", "contrast"),
)
SHIFTS: Final = 10.0  # m; by at most so much the whole scene is moved
STUDIES: Final = 12  # of each of three kinds of null factors: 204 in all
PLANTED: Final = 25
SCENES, SEEDS = 25, 8
PIXELS_A_MILLIMETRE: Final = 0.5  # by which the edge moves: 12.5 mm / 500 mm / 50 um
EDGE: Final[dict[str, Any]] = {
    "camera": {
        "position": ["0 mm", "0 mm", "500 mm"],
        "look_at": ["0 mm", "0 mm", "0 mm"],
        "focal_length": "12.5 mm",
        "exposure_time": "100 ms",
        "aperture": {"diameter": "0.2 mm"},
        "diffraction": "off",
        "sensor": {
            "rows": 40,
            "columns": 48,
            "pixel_width": "50 um",
            "pixel_height": "50 um",
            "gain": "1e5 (J/m^2)^-1",
            "gamma": 1.0,
            "dark_gray": 20,
            "saturation_gray": 255,
            "rounding": False,
        },
    },
    "sources": [
        {
            "type": "ring",
            "name": "ring",
            "position": ["0 mm", "0 mm", "500 mm"],
            "look_at": ["0 mm", "0 mm", "0 mm"],
            "count": 3,
            "diameter": "40 mm",
            "radiance": "2000 kW/m^2/sr",
            "beam": {"profile": "gaussian", "width": "30 deg", "width_definition": "fwhm"},
        }
    ],
    "materials": {
        "black": {"type": "lambertian", "reflectance": 0.05},
        "white": {"type": "lambertian", "reflectance": 0.6},
    },
    "targets": [
        {
            "type": "edge",
            "name": "edge",
            "material": "black",
            "edge_material": "white",
            "size": ["400 mm", "400 mm"],
            "position": ["0 mm", "0 mm", "0 mm"],
            "rotation": ["0 deg", "0 deg", "8 deg"],
            "edge_position": "1 mm",
        }
    ],
}
PLACES: Final = (
    "camera.position",
    "camera.look_at",
    "sources[0].position",
    "sources[0].look_at",
    "targets[0].position",
)


def random_edge(random: np.random.Generator) -> dict[str, Any]:
    """An edge of another angle, place, blur and light; the sensor rounds or does not."""
    tables = deepcopy(EDGE)
    camera, edge = tables["camera"], tables["targets"][0]
    diameter = random.choice([0.1, 0.2, 0.3])
    camera["aperture"]["diameter"] = f"{diameter} mm"
    camera["exposure_time"] = f"{100 * (0.2 / diameter) ** 2 * random.uniform(0.3, 1):.6g} ms"
    camera["sensor"]["rounding"] = bool(random.integers(2))
    edge["rotation"] = ["0 deg", "0 deg", f"{random.uniform(3, 40):.4f} deg"]
    edge["edge_position"] = f"{random.uniform(-2, 2):.4f} mm"
    return tables


# ------------------------------------------------------------------------------------------------------------- studies


def design_of(tables: Mapping[str, Any], factors: tuple[Factor, ...], responses: tuple[Response, ...]) -> Design:
    """Two replicates of all combinations, judged by their scatter."""
    return Design(
        title="effects",
        origin="study_effects.py",
        folder=Path(),
        scene_origin="scene",
        document=tables,
        seed=0,
        replicates=2,
        kind="full",
        plan={},
        render={},
        basis=None,
        factors=factors,
        responses=responses,
        analysis="anova",
    )


def two(name: str, keys: tuple[str, ...], low: tuple[Any, ...], high: tuple[Any, ...]) -> Factor:
    """A factor of two levels."""
    return Factor(name, name, keys, (Level("L", low), Level("H", high)))


def moved(random: np.random.Generator) -> Factor:
    """The whole scene elsewhere."""
    shift = random.uniform(-SHIFTS, SHIFTS, 3) * 1e3
    here = [[0.0, 0.0, 500.0], [0.0] * 3, [0.0, 0.0, 500.0], [0.0] * 3, [0.0] * 3]

    def told(by: np.ndarray[Any, Any]) -> tuple[Any, ...]:
        return tuple([f"{x!r} mm" for x in np.add(place, by).tolist()] for place in here)

    return two("moved", PLACES, told(np.zeros(3)), told(shift))


def exposure_against_gain(tables: Mapping[str, Any], times: float) -> Factor:
    """A shorter exposure, and as much more gain."""
    time = float(tables["camera"]["exposure_time"].split()[0])
    keys = ("camera.exposure_time", "camera.sensor.gain")
    low, high = (f"{time!r} ms", "1e5 (J/m^2)^-1"), (f"{time / times!r} ms", f"{1e5 * times!r} (J/m^2)^-1")
    return two("gain", keys, low, high)


def levels_against_exposure(tables: Mapping[str, Any], times: float) -> Factor:
    """A shorter exposure, and as much more light."""
    time = float(tables["camera"]["exposure_time"].split()[0])
    keys = ("camera.exposure_time", "sources[0].radiance")
    low, high = (f"{time!r} ms", "2000 kW/m^2/sr"), (f"{time / times!r} ms", f"{2000 * times!r} kW/m^2/sr")
    return two("levels", keys, low, high)


def exposure_alone(tables: Mapping[str, Any], times: float) -> Factor:
    """A shorter exposure: a darker image of the same edge."""
    time = float(tables["camera"]["exposure_time"].split()[0])
    return two("exposure", ("camera.exposure_time",), (f"{time!r} ms",), (f"{time / times!r} ms",))


def analysed(design: Design, folder: Path) -> dict[str, Analysis]:
    """The study of a design: what is said of each response."""
    run_study(design, folder, StudyOptions(workers=1))
    return {one.name: analyse(read_data(folder / "results.csv", one.name)) for one in design.responses}


def nulls(seed: int) -> dict[str, Any]:
    """How often a factor that changes no response is said to."""
    random = np.random.default_rng((seed, 1))
    said: list[dict[str, Any]] = []
    kinds: tuple[tuple[Callable[[Mapping[str, Any], float], Factor], tuple[str, ...]], ...] = (
        (exposure_against_gain, ("u", "b", "mean")),
        (levels_against_exposure, ("u", "b", "mean")),
        (exposure_alone, ("u", "b")),
    )
    for kind, free in kinds:
        for number in range(STUDIES):
            tables = random_edge(random)
            factors = (kind(tables, random.uniform(1.3, 4)), moved(random))
            if kind is exposure_alone:  # what is rounded changes with exposure by itself
                tables["camera"]["sensor"]["rounding"] = False
            with tempfile.TemporaryDirectory() as folder:
                found = analysed(design_of(tables, factors, RESPONSES[:3]), Path(folder) / "out")
            for response, analysis in found.items():
                for effect in analysis.effects[:2]:
                    if effect.name == "moved" or response in free:
                        row = {"factor": effect.name, "response": response, "effect": effect.effect}
                        said.append({**row, "image_error": effect.image_error, "significant": effect.significant})
            note(f"{kind.__name__} {number}: {sum(bool(one['significant']) for one in said)} of {len(said)}")
    wrong = [one for one in said if one["significant"]]
    ratio = [abs(one["effect"]) / one["image_error"] for one in said if one["image_error"]]
    return {"nulls": len(said), "significant": len(wrong), "largest_over_stated": max(ratio), "wrong": wrong}


def planted(seed: int) -> dict[str, Any]:
    """How often an effect of four of its stated errors is found."""
    random = np.random.default_rng((seed, 2))
    found = []
    for number in range(PLANTED):
        tables = random_edge(random)
        place = float(tables["targets"][0]["edge_position"].split()[0])
        dark, stated = exposure_against_gain(tables, 2.0), 0.0
        for _ in range(2):  # first nothing is planted, which tells the stated error
            size = 4 * stated / PIXELS_A_MILLIMETRE
            edge = two("edge", ("targets[0].edge_position",), (f"{place!r} mm",), (f"{place + size!r} mm",))
            with tempfile.TemporaryDirectory() as folder:
                analysis = analysed(design_of(tables, (dark, edge), RESPONSES[:1]), Path(folder) / "out")["u"]
            effect = next(one for one in analysis.effects if one.name == "edge")
            stated = max(analysis.standard_error or 0.0, effect.image_error)
        found.append(bool(effect.significant))
        note(f"planted {number}: {effect.effect:.4f} px, stated {stated:.4f}, {effect.significant}")
    return {"planted": len(found), "found": sum(found)}


def exposure(seed: int) -> dict[str, Any]:
    """Blur of an edge under exposure, opening and height of the ring; 12 bits, eight runs, once by each tolerance."""
    tables = deepcopy(EDGE)
    sensor = {"bit_depth": 12, "saturation_gray": 4095, "dark_gray": 200, "rounding": True, "gain": "1.6e6 (J/m^2)^-1"}
    tables["camera"]["sensor"] |= sensor
    heights = [[["0 mm", "0 mm", z]] for z in ("500 mm", "400 mm")]
    factors = (
        two("exposure", ("camera.exposure_time",), ("25 ms",), ("100 ms",)),
        two("opening", ("camera.aperture.diameter",), ("0.1 mm",), ("0.14 mm",)),
        two("height", ("sources[0].position",), tuple(heights[0]), tuple(heights[1])),
    )
    told = {}
    for tolerance in (4.0, 1.0):
        design = design_of(tables, factors, RESPONSES[1:2])
        design = replace(design, replicates=1, seed=seed, render={"tolerance": tolerance}, analysis="lenth")
        with tempfile.TemporaryDirectory() as folder:
            analysis = analysed(design, Path(folder) / "out")["b"]
        told[f"tolerance {tolerance:g}"] = {
            effect.name: {
                "effect": effect.effect,
                "image_error": effect.image_error,
                "t": effect.t,
                "significant": effect.significant,
            }
            for effect in analysis.effects[:3]
        }
    return told


# ------------------------------------------------------------------------------------------------------------ coverage


def plan_of(scene: Scene, tolerance: float) -> SamplingPlan:
    """What a study of this scene alone would take."""
    options = RenderOptions(tolerance=tolerance, workers=1)
    quiet = Progress("", 1, shown=False)
    with tempfile.TemporaryDirectory() as folder, laid_out(scene, options) as traced, Programs() as programs:
        work = Work(traced.view(), Path(folder), programs, quiet, traced.sha256(), 0)
        return strictest([pilot(work, options.demand)], options.demand)


def measured(scene: Scene, plan: SamplingPlan, seed: int) -> dict[str, Answer]:
    """Responses with their errors."""
    with tempfile.TemporaryDirectory() as name, threadpool_limits(1):
        folder = Path(name)
        result = render(scene, folder, sampling=plan, seed=seed, workers=1)
        fields = error_fields(result.gray.values.shape, blur_radii(scene))
        seen = seen_of(scene, result, folder, fields)
        return {one.name: answer(one, seen) for one in RESPONSES}


def finer(scene: Scene, plan: SamplingPlan) -> dict[str, float]:
    """Responses of a render whose noise is ten times smaller."""
    cell = None if plan.cell is None else max(plan.cell / 4, 1 / 16)
    rays = None if plan.rays is None else min(plan.rays * 16, 1 << 14)
    finest = SamplingPlan(plan.method, cell=cell, rays=rays, layered=plan.layered, replicates=20)
    with threadpool_limits(1):
        result = render(scene, sampling=finest, seed=1 << 20, workers=1)
        gray = gray_levels(result.radiant_exposure.values, scene.camera.sensor)
        radii = blur_radii(scene)
        seen = Seen(scene, result.gray, gray, image_error(gray, 0.0, radii), error_fields(gray.shape, radii, 0))
        return {one.name: answer(one, seen).value for one in RESPONSES}


def coverage(seed: int) -> dict[str, Any]:
    """How often 1.96 of a response's stated errors hold its true error."""
    random = np.random.default_rng((seed, 3))
    errors: dict[str, list[tuple[float, float]]] = {one.name: [] for one in RESPONSES}
    for number in range(SCENES):
        scene = scene_from_document(random_edge(random))
        plan = plan_of(scene, float(random.choice([0.4, 0.7, 1.0])))
        true = finer(scene, plan)
        for own in range(SEEDS):
            for name, found in measured(scene, plan, own).items():
                errors[name].append((found.error, found.value - true[name]))
        note(f"scene {number}: cell {plan.cell}, rays {plan.rays}; " + "; ".join(_told(errors)))
    return {name: _coverage(pairs) for name, pairs in errors.items()}


def _coverage(pairs: list[tuple[float, float]]) -> dict[str, float]:
    stated, true = np.array(pairs).T
    size = np.abs(true)
    # A response that takes steps may be right to the last digit, and say so.
    unsure = stated > 0
    return {
        "images": len(pairs),
        "within": float((size <= 1.96 * stated).mean()),
        "median_stated": float(np.median(stated)),
        "rms_true": math.sqrt(float((size**2).mean())),
        "median_stated_over_rms_true": float(np.median(stated) / max(math.sqrt((size**2).mean()), 1e-300)),
        "median_of_ratios": float(np.median(stated[unsure] / np.maximum(size[unsure], 1e-300)))
        if unsure.any()
        else 0.0,
    }


def _told(errors: Mapping[str, list[tuple[float, float]]]) -> Iterator[str]:
    for name, pairs in errors.items():
        found = _coverage(pairs)
        yield f"{name} {found['within']:.3f} {found['median_stated_over_rms_true']:.2f}"


def note(text: str) -> None:
    """Progress."""
    print(text, file=sys.stderr, flush=True)


PARTS: Final = {"coverage": coverage, "nulls": nulls, "planted": planted, "exposure": exposure}


def main() -> int:
    """Print what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    told = {part: PARTS[part](arguments.seed) for part in arguments.parts or PARTS}
    print(json.dumps(told, indent=2))
    if arguments.out:
        write_bytes(arguments.out, json_text(told).encode())
    return 0


if __name__ == "__main__":
    sys.exit(main())
