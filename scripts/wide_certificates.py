"""Honest certificates under wide lights: random scenes with things in front, each image held against other points.

The boards, spheres and boxes of scripts/certificates.py in the light of a rectangle, a bar with a beam, an area ring,
a disc or a dome. The truth knows nothing of closed forms, cells and lobes: each of its rays asks one point of each
light, even over the area of the true shape. Writes out/wide_certificates.json; exit code 1 if the bound holds in less
than 91 % of the scenes, or if it is idle (median of bound / truth above 1.5).

    python scripts/wide_certificates.py [--scenes 200] [--first 0] [--budget 5e6]
"""

from __future__ import annotations

import math
import sys
import tempfile
import time
from collections.abc import Generator, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import radwrap
from certificates import concluded, draw, judged_by, true_square
from radwrap.imaging.optics.view import trace_rays
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.tolerance.certificate import root
from radwrap.imaging.tracing import traced_scene
from radwrap.tracers.compiled.arrays import DISC, POLYGON, RECTANGLE, TRIANGLE, Floats
from radwrap.tracers.compiled.beams import radiance_along
from radwrap.tracers.compiled.compiler import compiled
from radwrap.tracers.compiled.covers import diffuse_at, painted
from radwrap.tracers.compiled.intersect import closest
from radwrap.tracers.compiled.kernels import normal_at, placed, shows_front
from radwrap.tracers.compiled.layout import CompiledScene
from radwrap.tracers.compiled.tracer import CompiledTracer
from radwrap.tracers.compiled.tree import DEPTH
from radwrap.tracers.compiled.wide_light import sent_by
from radwrap.tracers.compiled.wide_shadow import is_hidden

COMPILED = RenderOptions(tracer="compiled")
# What takes longer is lit by the far end of a lobe only, by 1e-8 of what its sheeting sends back: nobody looks at it.
LONGEST = 3600.0  # s
# Steps of a sequence that is even in the square: powers of the inverse of the number whose cube is itself and 1.
STEPS = (0.7548776662466927, 0.5698402909980532)


@compiled
def by_even_points(  # noqa: PLR0917  (compiled functions take their arrays one by one)
    scene: Any, tables: Floats, rays: Floats, place: Any, draws: Floats, values: Floats, stack: NDArray[np.int64]
) -> None:
    """Radiance along rays, of one point of each wide light for each; `scene` holds the arrays of a `CompiledScene`."""
    shapes, nodes, discs, disc_nodes, covers, decals, lights, wides = scene
    x0, y0, z0, units = place
    for r in range(len(rays)):
        _, ox, oy, oz, dx, dy, dz = placed(rays, r, x0, y0, z0, units)
        distance, number = closest(shapes, nodes, tables, ox, oy, oz, dx, dy, dz, math.inf, stack)
        distance, disc = closest(discs, disc_nodes, tables, ox, oy, oz, dx, dy, dz, distance, stack)
        values[r] = 0.0
        if disc >= 0:
            light = lights[discs[disc].owner]
            if shows_front(light, discs[disc], ox, oy, oz, dx, dy, dz, distance):
                values[r] = radiance_along(light, tables, -dx, -dy, -dz)
            continue
        if number < 0:
            continue
        shape = shapes[number]
        x, y, z = ox + distance * dx, oy + distance * dy, oz + distance * dz
        nx, ny, nz = normal_at(shape, x, y, z)
        cover = covers[painted(decals, tables, shape.owner, shape.decal, x, y, z)]
        if nx * dx + ny * dy + nz * dz > 0:
            if not cover.two_sided:
                continue
            nx, ny, nz = -nx, -ny, -nz
        diffuse = diffuse_at(cover, tables, x, y, z)
        itself = number if shape.kind in (RECTANGLE, POLYGON, DISC, TRIANGLE) else -1
        p = (x, y, z)
        for w in range(len(wides)):
            light = wides[w]
            value, d, away = sent_by(
                light, cover, tables, diffuse, True, p, (nx, ny, nz), (-dx, -dy, -dz), draws[r, 0], draws[r, 1]
            )
            if value > 0 and not is_hidden(light, shapes, nodes, discs, disc_nodes, tables, p, d, away, itself, stack):
                values[r] += value * light.radiance * light.area


@dataclass(frozen=True, slots=True)
class EvenPoints:
    """A tracer for the truth; satisfies `Tracer`."""

    scene: CompiledScene
    random: np.random.Generator

    def trace(self, rays: Iterable[Floats]) -> Generator[Floats]:
        """Radiance along rays."""
        a = self.scene
        arrays = (*a.targets, *a.emitters, a.covers, a.decals, a.lights, a.wides)
        place = (*map(float, a.frame.origin), float(a.frame.units))
        for block in rays:
            k = np.arange(len(block))[:, np.newaxis]
            draws = np.mod(self.random.random(2) + k * np.array(STEPS), 1.0)
            values = np.empty(len(block))
            by_even_points(arrays, a.tables, block, place, draws, values, np.empty(DEPTH, dtype=np.int64))
            yield values

    def trace_with_distances(self, rays: Iterable[Floats]) -> Generator[tuple[Floats, Floats]]:
        """Not needed for a truth."""
        raise NotImplementedError

    def distances(self, rays: Iterable[Floats]) -> Generator[Floats]:
        """Not needed for a truth."""
        raise NotImplementedError


def wide_source(random: np.random.Generator, distance: float) -> dict[str, Any]:
    """A wide light beside or around the camera's view."""
    kind = str(random.choice(["rectangle", "bar", "area_ring", "disc", "dome"]))
    turn, height, aside = random.uniform(0, 2 * math.pi), random.uniform(0.15, 0.6), random.uniform(0.3, 0.6)
    if kind == "area_ring":
        aside = 0.0
    place = [aside * distance * math.cos(turn), aside * distance * math.sin(turn), height * distance]
    made: dict[str, Any] = {
        "name": "wide",
        "position": [f"{value:.5f} mm" for value in place],
        "look_at": ["0 mm", "0 mm", "0 mm"],
        "radiance": "100 W/m^2/sr",
    }
    size = distance * random.uniform(0.1, 0.3)
    if kind in ("rectangle", "bar"):
        thin = 0.15 if kind == "bar" else random.uniform(0.5, 1.0)
        made |= {"type": "rectangle", "size": [f"{size:.5f} mm", f"{thin * size:.5f} mm"]}
        if random.random() < 0.5:
            profile = str(random.choice(["gaussian", "cosine_power"]))
            made["beam"] = {"profile": profile, "width": f"{random.uniform(30, 70):.3f} deg"}
    elif kind == "area_ring":
        made |= {"type": "area_ring", "diameter": f"{2 * size:.5f} mm", "inner_diameter": f"{1.3 * size:.5f} mm"}
    elif kind == "disc":
        made |= {"type": "disc", "diameter": f"{size:.5f} mm", "irradiance_error": 0.02}
    else:
        made |= {
            "type": "dome",
            "position": ["0 mm", "0 mm", "0 mm"],
            "look_at": ["0 mm", "0 mm", f"{-distance:.5f} mm"],
            "diameter": f"{1.8 * distance:.5f} mm",
            "opening_diameter": f"{random.uniform(0.1, 0.6) * distance:.5f} mm",
        }
    return made


def drawn(random: np.random.Generator) -> dict[str, Any]:
    """A scene's document."""
    document = draw(random)
    distance = float(document["camera"]["position"][2].split()[0])
    document["sources"] = [wide_source(random, distance)]
    if random.random() < 0.4:
        roughness = float(random.uniform(0.1, 0.3))
        document["materials"]["gray"] = {
            "type": "specular",
            "diffuse_reflectance": 0.2,
            "specular_reflectance": 0.1,
            "roughness": roughness,
        }
    return document


def exposed(document: dict[str, Any], gray: float) -> radwrap.Scene | None:
    """As that of scripts/certificates.py, by the compiled tracer."""
    scene = radwrap.scene_from_document(document)
    with traced_scene(scene, COMPILED) as view:
        sensor = scene.camera.sensor
        v, u = np.divmod(np.arange(sensor.pixels, dtype=np.float64), sensor.columns)
        values, _ = trace_rays(view, None, u, v)
        bright = float(np.quantile(values, 0.9)) * view.exposure_of_radiance
    if bright <= 0 or values.std() < 0.1 * values.mean():
        return None
    wanted = ((gray - sensor.dark_gray) / sensor.gain) ** (1 / sensor.gamma)
    time_needed = scene.camera.exposure_time * wanted / bright
    if time_needed > LONGEST:
        return None
    return radwrap.with_value(scene, "camera.exposure_time", f"{time_needed * 1e3!r} ms")


def judged(number: int, budget: float) -> dict[str, Any] | None:
    """One scene, rendered and held against the truth; None where there is nothing to see."""
    random = np.random.default_rng([2027, number])
    document = drawn(random)
    try:
        scene = exposed(document, float(random.uniform(60, 200)))
    except radwrap.InputError as error:  # drawn badly: a part around the camera or a light
        return {"number": number, "refused": str(error)}
    except radwrap.RadwrapError as error:  # the tracers do not agree there
        return {"number": number, "refused": str(error)}
    if scene is None:
        return None
    tolerance, start = float(random.choice([0.5, 1.0, 2.0])), time.process_time()
    with tempfile.TemporaryDirectory() as out:
        result = radwrap.render(scene, out, tolerance=tolerance, budget_rays=budget, seed=number, tracer="compiled")
    cpu, error, plan = time.process_time() - start, result.run.error, result.run.plan
    assert plan is not None  # noqa: S101  (there is a tolerance)
    with traced_scene(scene, COMPILED) as view:
        assert isinstance(view.tracer, CompiledTracer)  # noqa: S101  (asked for)
        truth_view = replace(view, tracer=EvenPoints(view.tracer.scene, np.random.default_rng([3, number])), workers=1)
        gray = gray_levels(result.radiant_exposure.values, scene.camera.sensor)
        square, noise = true_square(truth_view, gray, error.rms_gray_upper95, 1000 + number)
    truth = root(square)
    return {
        "number": number,
        "source": document["sources"][0]["type"] + ("+beam" if "beam" in document["sources"][0] else ""),
        "tolerance": tolerance,
        "method": result.run.method,
        "met": plan.met,
        "rays": result.run.rays,
        "true_rms_gray": truth,
        "truth_standard_error_gray": noise / (2 * max(truth, 1e-3)),
        "rms_gray_upper95": error.rms_gray_upper95,
        "holds": truth <= error.rms_gray_upper95,
        "ratio": error.rms_gray_upper95 / max(truth, 1e-9),
        "cpu_s": cpu,
    }


def _judged(number: int, budget: float) -> dict[str, Any] | None:
    """The same, and a line of what is not judged."""
    row = judged(number, budget)
    if row is None or "refused" in row:
        print(f"{number:4d} {'nothing to see' if row is None else row['refused'][:100]}", flush=True)
    return row


def _told(row: dict[str, Any]) -> str:
    return (
        f"{row['number']:4d} {row['source']:14} tol {row['tolerance']:.1f} {row['method']:6} "
        f"{'met ' if row['met'] else 'MISS'} true {row['true_rms_gray']:.4f}"
        f"+-{row['truth_standard_error_gray']:.4f} upper {row['rms_gray_upper95']:.4f} "
        f"{'' if row['holds'] else 'BROKEN BOUND '}rays {row['rays']:.3g} {row['cpu_s']:.1f} s of processor"
    )


def main() -> int:
    """Draw, judge, print."""
    return concluded(judged_by(_judged, _told, __doc__ or "", 5e6), "wide_certificates")


if __name__ == "__main__":
    sys.exit(main())
