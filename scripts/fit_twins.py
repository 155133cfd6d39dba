"""Twins of `radwrap fit`: random scenes, captures by other rays with noise, and whether fits find what made them.

    .venv/bin/python scripts/fit_twins.py --twins 20 --seed 1 --out out/fit_twins.json

Prints for each kind of key how often its 95 % interval holds the truth, the bias in deviations, how many right scenes
were refused and how many wrong ones (an LED off in the model) were found, and processor time and rays.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any, Final

import numpy as np

import radwrap
from default_tolerance import cpu
from radwrap.manifest import json_text
from radwrap.random_streams import generator

# Stands apart from the streams of the package's own draws.
_STREAM: Final = 9_001
KINDS: Final = {
    "level": ("sources[0].leds[0].radiance_factor", "sources[0].leds[1].radiance_factor"),
    "exposure": ("camera.exposure_time",),
    "offset": ("camera.sensor.offset",),
    "place": ("targets[0].edge_position",),
}


def bench(random: np.random.Generator) -> dict[str, Any]:
    """An edge in the light of three LEDs, seen by a linear camera of 20 to 40 pixels a side."""
    rows, columns = (int(number) for number in random.integers(20, 41, 2))
    return {
        "camera": {
            "position": ["0 mm", "0 mm", f"{random.uniform(350, 600):.1f} mm"],
            "look_at": ["0 mm", "0 mm", "0 mm"],
            "focal_length": "12.5 mm",
            "exposure_time": "100 ms",
            "aperture": {"diameter": "0.2 mm"},
            "diffraction": "off",
            "sensor": {
                "model": "linear",
                "rows": rows,
                "columns": columns,
                "pixel_width": "50 um",
                "pixel_height": "50 um",
                "wavelength": "550 nm",
                "quantum_efficiency": 0.5,
                "system_gain": "0.02 DN/e",
                "offset": 5.0,
                "full_well": "20 ke",
                "read_noise": f"{random.uniform(10, 40):.1f} e",
            },
        },
        "sources": [
            {
                "type": "ring",
                "name": "ring",
                "position": ["0 mm", "0 mm", "300 mm"],
                "look_at": ["0 mm", "0 mm", "0 mm"],
                "count": 3,
                "diameter": f"{random.uniform(30, 90):.1f} mm",
                "radiance": f"{random.uniform(700, 1000):.1f} W/m^2/sr",
                "beam": {"profile": "gaussian", "width": "30 deg", "width_definition": "fwhm"},
            }
        ],
        "materials": {
            "black": {"type": "lambertian", "reflectance": 0.1},
            "white": {"type": "lambertian", "reflectance": 0.6},
        },
        "targets": [
            {
                "type": "edge",
                "name": "edge",
                "material": "black",
                "edge_material": "white",
                "size": ["400 mm", "400 mm"],
                "rotation": ["0 deg", "0 deg", f"{random.uniform(3, 40):.1f} deg"],
                "edge_position": "1 mm",
            }
        ],
    }


def truth_of(random: np.random.Generator, *, renders: bool) -> dict[str, Any]:
    """Three to five keys and the values that a capture is made with."""
    found: dict[str, Any] = {key: float(random.uniform(0.75, 1.25)) for key in KINDS["level"]}
    found["camera.sensor.offset"] = float(random.uniform(3.0, 8.0))
    if random.random() < 0.5:
        found["camera.exposure_time"] = f"{random.uniform(85, 115):.6f} ms"
    if renders:
        found["targets[0].edge_position"] = f"{random.uniform(0.6, 1.4):.6f} mm"
    return found


def number_of(value: Any) -> float:
    """Of a value with or without a unit."""
    return float(str(value).split()[0])


def twin(number: int, seed: int, tolerance: float, *, renders: bool, wrong: bool) -> dict[str, Any]:
    """One scene, one capture, one fit."""
    random = generator(seed, number, _STREAM)
    scene = radwrap.scene_from_document(bench(random))
    truth = truth_of(random, renders=renders)
    captured = radwrap.scene_from_document(json.loads(scene.document), truth)
    # No ray in common with the fit.
    rays = radwrap.RenderOptions(method="rays", tolerance=tolerance / 5, seed=10_000 + number, workers=1)
    made = radwrap.render(captured, options=rays, tracer="compiled")
    begun = radwrap.with_value(scene, "sources[0].leds[2].radiance_factor", 0.0) if wrong else scene
    before = cpu()
    options = radwrap.RenderOptions(tolerance=tolerance, seed=number, workers=1)
    found = radwrap.fit(begun, made.frames(1), list(truth), options=options)
    keys = [
        {
            "key": key.key,
            "pull": (key.value - number_of(truth[key.key])) / key.sigma if key.sigma else None,
            "held": key.interval is not None and key.interval[0] <= number_of(truth[key.key]) <= key.interval[1],
        }
        for key in found.keys
    ]
    return {
        "twin": number,
        "wrong": wrong,
        "explained": found.explained,
        "converged": found.converged,
        "keys": keys,
        "processor_s": cpu() - before,
        "rays": found.manifest["rays"],
        "places": found.manifest["places"],
    }


def summary(twins: list[dict[str, Any]]) -> dict[str, Any]:
    """What all of them say."""
    right = [one for one in twins if not one["wrong"]]
    told: dict[str, Any] = {}
    for kind, names in {**KINDS, "all": tuple(key for some in KINDS.values() for key in some)}.items():
        keys = [key for one in right for key in one["keys"] if key["key"] in names and key["pull"] is not None]
        if keys:
            pulls = np.array([key["pull"] for key in keys])
            told[kind] = {
                "keys": len(keys),
                "held": float(np.mean([key["held"] for key in keys])),
                "bias_in_deviations": float(pulls.mean()),
                "rms_in_deviations": float(np.sqrt((pulls**2).mean())),
            }
    wrong = [one for one in twins if one["wrong"]]
    return {
        "kinds": told,
        "right": len(right),
        "right_refused": sum(not one["explained"] for one in right),
        "not_converged": sum(not one["converged"] for one in twins),
        "wrong": len(wrong),
        "wrong_found": sum(not one["explained"] for one in wrong),
        "processor_s_each": float(np.mean([one["processor_s"] for one in twins])),
        "rays_each": float(np.mean([one["rays"] for one in twins])),
        "places_each": float(np.mean([one["places"] for one in twins])),
    }


def main() -> None:
    """Run twins and print what they say."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("--twins", type=int, default=20, help="right scenes (default 20)")
    parser.add_argument("--wrong", type=int, default=5, help="scenes that lack an LED (default 5)")
    parser.add_argument("--renders", action="store_true", help="with a place that needs renders")
    parser.add_argument("--tolerance", type=float, default=0.5, help="of the fits [gray level] (default 0.5)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", help="file for the numbers")
    asked = parser.parse_args()
    twins = []
    for number in range(asked.twins + asked.wrong):
        wrong = number >= asked.twins
        twins.append(twin(number, asked.seed, asked.tolerance, renders=asked.renders, wrong=wrong))
        print(f"twin {number}: {'explained' if twins[-1]['explained'] else 'not explained'}", file=sys.stderr)
    told = summary(twins)
    print(json_text(told), end="")
    if asked.out:
        Path(asked.out).write_text(json_text({"summary": told, "twins": twins}))


if __name__ == "__main__":
    main()
