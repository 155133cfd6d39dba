"""Each kind of wide source against quadrature: error asked, error got, patches, time.

A diffuse sheet of twice the source's radius lies at distance h from a source of radius R. Radiance traces it; SciPy
integrates the irradiance over the source's true shape at points that the cutting into patches did not look at.

    python scripts/wide_sources.py [--out DIR] [--quick]
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import dblquad

import radwrap
from radwrap.process import Programs
from radwrap.scene.look.wide_sources import divided
from radwrap.scene.sources import WideSource
from radwrap.tracers.installation import find_radiance
from radwrap.tracers.radiance import RadianceOptions, RadianceTracer, build, prepare

RADIUS = 0.05  # m
RATIOS = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
ERRORS = (0.01, 0.002)
# Places on the sheet in units of R, off the grid on which patches are chosen.
PLACES = ((0.0, 0.0), (0.137, 0.071), (0.43, -0.29), (-0.71, 0.33))


def source(kind: str, error: float) -> dict[str, Any]:
    """A source of radiance 1 at height h; the sheet lies below."""
    shapes: dict[str, dict[str, Any]] = {
        "rectangle": {"type": "rectangle", "size": [f"{2 * RADIUS} m", f"{RADIUS} m"]},
        "bar": {"type": "rectangle", "size": [f"{2 * RADIUS} m", f"{RADIUS / 10} m"]},
        "disc": {"type": "disc", "diameter": f"{2 * RADIUS} m"},
        "area_ring": {"type": "area_ring", "diameter": f"{2 * RADIUS} m", "inner_diameter": f"{1.2 * RADIUS} m"},
        "dome": {"type": "dome", "diameter": f"{2 * RADIUS} m", "opening_diameter": f"{RADIUS / 2} m"},
    }
    return {"name": kind, "radiance": "1 W/m^2/sr", "irradiance_error": error, **shapes[kind]}


def scene(kind: str, height: float, error: float) -> radwrap.Scene:
    """The sheet is in view all over; the dome stands `height` above it, open towards it."""
    place = {"position": ["0 m", "0 m", f"{height!r} m"], "look_at": ["0 m", "0 m", "0 m"]}
    camera = {
        "position": ["0 m", "0 m", "10 m"],
        "look_at": ["0 m", "0 m", "0 m"],
        "focal_length": "10 mm",
        "exposure_time": "1 s",
        "sensor": {"preset": "fivs"},
    }
    target = {"type": "sheet", "material": "white", "size": [f"{4 * RADIUS} m"] * 2}
    return divided(
        radwrap.scene_from_document(
            {
                "camera": camera,
                "sources": [{**source(kind, error), **place}],
                "materials": {"white": {"type": "lambertian", "reflectance": 1.0}},
                "targets": [target],
            }
        )
    )


def quadrature(kind: str, x: float, y: float, height: float) -> float:
    """Irradiance at a point of the sheet by SciPy [W m^-2]."""

    def flat(u: float, v: float) -> float:
        return height**2 / ((u - x) ** 2 + (v - y) ** 2 + height**2) ** 2

    def polar(turn: float, r: float) -> float:
        return flat(r * math.cos(turn), r * math.sin(turn)) * r

    def dome(turn: float, theta: float) -> float:
        out = np.array([math.sin(theta) * math.cos(turn), math.sin(theta) * math.sin(turn), math.cos(theta)])
        away = RADIUS * out + [-x, -y, height]
        square = float(away @ away)
        return max(0.0, float(out @ away)) * away[2] / square**2 * RADIUS**2 * math.sin(theta)

    inner = {"disc": 0.0, "area_ring": 0.6 * RADIUS}.get(kind, 0.0)
    half = {"rectangle": RADIUS / 2, "bar": RADIUS / 20}.get(kind, 0.0)
    regions: dict[str, tuple[Callable[[float, float], float], float, float, float, float]] = {
        "rectangle": (lambda v, u: flat(u, v), -RADIUS, RADIUS, -half, half),
        "bar": (lambda v, u: flat(u, v), -RADIUS, RADIUS, -half, half),
        "disc": (polar, inner, RADIUS, 0.0, 2 * math.pi),
        "area_ring": (polar, inner, RADIUS, 0.0, 2 * math.pi),
        "dome": (dome, math.asin(0.25), math.pi / 2, 0.0, 2 * math.pi),
    }
    function, a, b, c, d = regions[kind]
    return float(dblquad(function, a, b, c, d, epsabs=1e-11, epsrel=1e-8)[0])


def traced(of: radwrap.Scene, programs: Programs) -> np.ndarray:
    """Irradiance at the places by Radiance, E = pi L/rho [W m^-2]."""
    points = np.array([(x * RADIUS, y * RADIUS, 0.0) for x, y in PLACES])
    options = RadianceOptions(find_radiance())
    with tempfile.TemporaryDirectory() as folder:
        prepared = prepare(of, options, programs, Path(folder))
        build(prepared.scene.text, prepared.scene.files, Path(folder), options, programs)
        tracer = RadianceTracer(options, programs, Path(folder), prepared.scene)
        up = np.array([0.0, 0.0, 1e-4])
        rays = np.hstack([points + up, np.broadcast_to(-up, points.shape)])
        return np.concatenate(list(tracer.trace([rays]))) * math.pi


def case(kind: str, ratio: float, error: float, programs: Programs) -> dict[str, Any]:
    """One line of the table."""
    height = RADIUS / ratio
    start = time.perf_counter()
    head = {"source": kind, "R/h": ratio, "asked": error}
    try:
        made = scene(kind, height, error)
    except radwrap.InputError as refusal:
        return {**head, "refused": str(refusal)}
    seconds = time.perf_counter() - start
    got = traced(made, programs)
    due = np.array([quadrature(kind, x * RADIUS, y * RADIUS, height) for x, y in PLACES])
    wide = made.sources[0]
    if not isinstance(wide, WideSource):
        raise TypeError("is no wide source")
    worst = float(np.abs(got / due - 1).max())
    return {
        **head,
        "got": worst,
        "told": wide.reached,
        "patches": len(wide.patches),
        "seconds": round(seconds, 3),
        "pass": worst <= error,
    }


def main() -> int:
    """Print the table; exit 1 where an error is larger than was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/wide_sources"))
    parser.add_argument("--quick", action="store_true", help="three distances and one error")
    arguments = parser.parse_args()
    ratios, errors = (RATIOS[::3], ERRORS[:1]) if arguments.quick else (RATIOS, ERRORS)
    print(f"{'source':<10} {'R/h':>5} {'asked':>8} {'got':>9} {'told':>9} {'patches':>8} {'time':>7}")
    lines = []
    with Programs() as programs:
        for kind in ("rectangle", "bar", "disc", "area_ring", "dome"):
            for ratio in ratios:
                for error in errors:
                    line = case(kind, ratio, error, programs)
                    lines.append(line)
                    if "refused" in line:
                        print(f"{kind:<10} {ratio:>5g} {error:>8.2%} refused: {line['refused']}", flush=True)
                        continue
                    print(
                        f"{kind:<10} {ratio:>5g} {error:>8.2%} {line['got']:>9.4%} {line['told']:>9.4%} "
                        f"{line['patches']:>8} {line['seconds']:>5.2f} s{'' if line['pass'] else '  MISSED'}",
                        flush=True,
                    )
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "wide_sources.json").write_text(json.dumps(lines, indent=2) + "\n")
    missed, refused = sum(not line.get("pass", True) for line in lines), sum("refused" in line for line in lines)
    print(f"{len(lines)} cases, {missed} missed, {refused} refused; {arguments.out}/wide_sources.json")
    return 1 if missed else 0


if __name__ == "__main__":
    raise SystemExit(main())
