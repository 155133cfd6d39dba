"""How long a render on a warm scene takes, once the light, a pose or the exposure has changed, and where the time goes.

bench_board at 192 x 165 pixels, a tolerance of 0.5 gray levels, by the compiled tracer. Each change is another one, so
that nothing of it is known. A render is timed whole; what files take is measured too, and taken off in a column of its
own. The comparison with Radiance goes on beside the render, in a thread. Rays are told, as a search may try again.

    python scripts/warm_benchmark.py
    python scripts/warm_benchmark.py --renders 20 --json warm.json
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import Any

import radwrap
from radwrap.imaging import synthesis, tracing

SCENE = Path(__file__).resolve().parents[1] / "rad_scenes" / "bench_board" / "scene.toml"
CHANGES: dict[str, Callable[[int], dict[str, Any]]] = {
    "nothing": lambda _: {},
    "one LED": lambda n: {"sources[0].leds": [{"index": 3, "radiance_factor": 0.9 - 0.005 * n}]},
    "all LEDs": lambda n: {"sources[0].radiance": f"{2300 - n} W/m^2/sr"},
    "beam": lambda n: {"sources[0].beam.width": f"{7.7 + 0.01 * n} deg"},
    "reflectance": lambda n: {"materials.black.reflectance": 0.051 + 0.0001 * n},
    "exposure": lambda n: {"camera.exposure_time": f"{380 - n} ms"},
    "pose of the board": lambda n: {"targets[0].rotation": [f"{45.9 - 0.1 * n} deg", "6 deg", "-2 deg"]},
    "pose of the camera": lambda n: {"camera.position": [f"{0.1 * (n + 1)} mm", "0 mm", "790 mm"]},
}
FILES = ("write_images", "write_run_manifest", "publish", "load_result", "sha256_of")


def main() -> None:
    """Measure, and tell."""
    parser = argparse.ArgumentParser(description="times of renders on a warm scene")
    parser.add_argument("--renders", type=int, default=8, help="of each kind of change")
    parser.add_argument("--json", type=Path, help="a file for the numbers")
    arguments = parser.parse_args()
    scene = radwrap.load_scene(SCENE)
    options = radwrap.RenderOptions(tracer="compiled", tolerance=0.5)
    rows = []
    print("change               warm ms (least)   without files   CPU ms   cold ms    comparison ms   rays")
    with radwrap.warm(scene, options) as live, spent() as parts:
        live.render()
        for name, change in CHANGES.items():
            scenes = [with_values(scene, change(number)) for number in range(arguments.renders)]
            rows.append({"change": name, **measured(scenes, live.render, parts)})
            cold = measured(scenes[:3], lambda one: radwrap.render(one, options=options), parts)
            rows[-1]["cold_ms"] = cold["ms"]
            print(line(rows[-1]))
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=2))


def line(row: dict[str, Any]) -> str:
    """A row of the table."""
    return (
        f"{row['change']:20s} {row['ms']:7.0f} ({row['least_ms']:4.0f}) {row['without_files_ms']:12.0f} "
        f"{row['cpu_ms']:11.0f} {row['cold_ms']:9.0f} {row['comparison_ms']:13.0f} {row['rays']:12.0f}"
    )


def with_values(scene: radwrap.Scene, changes: dict[str, Any]) -> radwrap.Scene:
    """A scene with other values."""
    return radwrap.scene_from_document(json.loads(scene.document), changes, folder=scene.folder)


def measured(
    scenes: list[radwrap.Scene], render: Callable[[radwrap.Scene], radwrap.Rendered], parts: dict[str, float]
) -> dict[str, float]:
    """Medians over renders of some scenes [ms]."""
    walls, without, cpus, rays, comparisons = [], [], [], [], []
    for scene in scenes:
        parts.clear()
        cpu, begin = time.process_time(), time.perf_counter()
        made = render(scene)
        walls.append(1e3 * (time.perf_counter() - begin))
        cpus.append(1e3 * (time.process_time() - cpu))
        without.append(walls[-1] - 1e3 * sum(parts.get(name, 0.0) for name in FILES))
        comparisons.append(1e3 * parts.get("probed", 0.0))
        rays.append(made.run.rays)
    return {
        "ms": statistics.median(walls),
        "least_ms": min(walls),
        "without_files_ms": statistics.median(without),
        "cpu_ms": statistics.median(cpus),
        "comparison_ms": statistics.median(comparisons),
        "rays": statistics.median(rays),
    }


@contextmanager
def spent() -> Iterator[dict[str, float]]:
    """Seconds that some functions take, by their names."""
    parts: dict[str, float] = {}
    originals = [(synthesis, name) for name in FILES] + [(tracing, "probed")]
    known = [(module, name, getattr(module, name)) for module, name in originals]
    for module, name, function in known:
        setattr(module, name, _timed(name, function, parts))
    try:
        yield parts
    finally:
        for module, name, function in known:
            setattr(module, name, function)


def _timed(name: str, function: Callable[..., Any], parts: dict[str, float]) -> Callable[..., Any]:
    @wraps(function)
    def timed(*arguments: Any, **named: Any) -> Any:
        begin = time.perf_counter()
        try:
            return function(*arguments, **named)
        finally:
            parts[name] = parts.get(name, 0.0) + time.perf_counter() - begin

    return timed


if __name__ == "__main__":
    main()
