"""Twins of `radwrap fit`: random scenes, captures by other rays with noise, and whether fits find what made them.

    .venv/bin/python scripts/fit_twins.py --twins 20 --seed 1 --out out/fit_twins.json

Prints for each kind of key how often its 95 % interval holds the truth, the bias in deviations, how many right scenes
were refused, how many wrong ones were found (an LED off in the model, another beam, a target moved, gamma held at a
wrong value), and processor time and rays. With --povray captures are traced by POV-Ray, of sources whose beam is a
power of the cosine, which it can show.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

import radwrap
from default_tolerance import cpu
from radwrap.files import write_bytes
from radwrap.fitting.free_keys import free_scene
from radwrap.images import RadianceImage
from radwrap.imaging.response.exposure import radiant_exposure
from radwrap.imaging.response.noise import fixed_pattern, noisy_frame
from radwrap.manifest import json_text
from radwrap.random_streams import generator
from radwrap.study.crosscheck import CrosscheckOptions, crosscheck

# Stands apart from the streams of the package's own draws.
_STREAM: Final = 9_001
POSE: Final = "pose:target"
KINDS: Final = {
    "level": ("sources[0].leds[0].radiance_factor", "sources[0].leds[1].radiance_factor"),
    "exposure": ("camera.exposure_time",),
    "offset": ("camera.sensor.offset",),
    "place": ("targets[0].edge_position",),
    "shift": tuple(f"{POSE}.{name}" for name in ("tx", "ty", "tz")),
    "turn": tuple(f"{POSE}.{name}" for name in ("rx", "ry", "rz")),
    "focal length": ("camera.focal_length",),
    "reflectance": ("materials.white.reflectance",),
    "beam width": ("sources[0].beam.width",),
}
# How far off the fit begins: shifts [mm] and turns [deg] of the target.
SHIFT: Final = (4.0, 4.0, 8.0)
TURN: Final = (3.0, 3.0, 3.0)
# Of the opening, for POV-Ray, each with 4 x 4 rays a pixel. With 91 of them edges are off by a gray level.
PLACES: Final = 271
WRONG: Final = ("LED off", "wide beam", "target moved", "gamma held")


def bench(random: np.random.Generator, target: dict[str, Any]) -> dict[str, Any]:
    """A target in the light of three LEDs, seen by a linear camera of 20 to 40 pixels a side."""
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
        "targets": [target],
    }


def edge(random: np.random.Generator) -> dict[str, Any]:
    """A straight edge."""
    return {
        "type": "edge",
        "edge_material": "white",
        "size": ["400 mm", "400 mm"],
        "rotation": ["0 deg", "0 deg", f"{random.uniform(3, 40):.1f} deg"],
        "edge_position": "1 mm",
    }


def board(random: np.random.Generator) -> dict[str, Any]:
    """Dots, tilted, so that all six numbers of a pose show."""
    return {
        "type": "board",
        "dot_material": "white",
        "rows": int(random.integers(2, 4)),
        "columns": int(random.integers(2, 4)),
        "pitch": "14 mm",
        "dot_diameter": f"{random.uniform(7, 10):.1f} mm",
        "margin": "10 mm",
        "rotation": [f"{random.uniform(8, 20):.1f} deg", f"{random.uniform(-12, 12):.1f} deg", "10 deg"],
    }


def truth_of(random: np.random.Generator, *, renders: bool, is_board: bool) -> dict[str, float]:
    """Three to twelve keys and the values that a capture is made with, in the units of the scene."""
    found = {key: float(random.uniform(0.75, 1.25)) for key in KINDS["level"]}
    found["camera.sensor.offset"] = float(random.uniform(3.0, 8.0))
    if random.random() < 0.5:
        found["camera.exposure_time"] = float(random.uniform(85, 115))
    if not renders:
        return found
    if is_board:
        for names, sizes in ((KINDS["shift"], SHIFT), (KINDS["turn"], TURN)):
            found |= {name: float(random.uniform(-size, size)) for name, size in zip(names, sizes, strict=True)}
    else:
        found["targets[0].edge_position"] = float(random.uniform(-4, 6))
        if random.random() < 0.5:
            found["camera.focal_length"] = float(random.uniform(12, 13))
    if random.random() < 0.5:
        found["materials.white.reflectance"] = float(random.uniform(0.5, 0.7))
    if random.random() < 0.5:
        found["sources[0].beam.width"] = float(random.uniform(26, 34))
    return found


def keys_of(truth: dict[str, float]) -> list[str]:
    """What is freed: a pose as a whole."""
    return list(dict.fromkeys(POSE if key.startswith(POSE) else key for key in truth))


def wronged(scene: radwrap.Scene, kind: str) -> radwrap.Scene:
    """What the user believes: not what was captured."""
    if kind == "LED off":
        return radwrap.with_value(scene, "sources[0].leds[2].radiance_factor", 0.0)
    if kind == "wide beam":
        return radwrap.with_value(scene, "sources[0].beam.width", "60 deg")
    if kind == "target moved":
        return radwrap.with_value(scene, "targets[0].position", ["3 mm", "0 mm", "0 mm"])
    return radwrap.with_value(scene, "camera.sensor.gamma", 0.8)


@dataclass(frozen=True)
class Twin:
    """What a fit is asked: the scene where it begins, a capture, and the values that made it."""

    begun: radwrap.Scene
    capture: radwrap.GrayImage
    truth: dict[str, float]


def by_povray(scene: radwrap.Scene, seed: int, places: int) -> radwrap.GrayImage:
    """A frame of a scene as POV-Ray sees it from some places of the opening."""
    pictures = radwrap.RenderOptions(viewpoints=places, pixel_samples=4, pixel_sampling="centre", workers=1)
    with tempfile.TemporaryDirectory(prefix="radwrap-") as folder:
        seen = crosscheck(scene, Path(folder), CrosscheckOptions(pictures)).povray
    sensor = scene.camera.sensor
    exposure = radiant_exposure(RadianceImage(seen), scene.camera)
    return noisy_frame(exposure, sensor, fixed_pattern(sensor), seed, 0)


def twin_of(number: int, seed: int, tolerance: float, *, renders: bool, wrong: str = "", povray: int = 0) -> Twin:
    """A scene that is drawn, and its capture: by rays, or by POV-Ray from so many places of the opening."""
    random = generator(seed, number, _STREAM)
    is_board = renders and bool(random.integers(2))
    target = (board if is_board else edge)(random)
    tables = bench(random, {**target, "name": "target", "material": "black"})
    if povray:
        tables["sources"][0]["beam"]["profile"] = "cosine_power"
    scene = radwrap.scene_from_document(tables)
    # A wrong model keeps its places: what it is wrong in must not be what the fit may move.
    truth = truth_of(random, renders=renders and not wrong, is_board=is_board)
    free = free_scene(scene, keys_of(truth))
    captured = free.at([truth[key.key] for key in free.keys])
    # No ray in common with the fit, and no noise with the captures of other seeds.
    own = 10_000 * (seed + 1) + number
    if povray:
        return Twin(scene, by_povray(captured, own, povray), truth)
    rays = radwrap.RenderOptions(method="rays", tolerance=tolerance / 5, seed=own, workers=1)
    made = radwrap.render(captured, options=rays, tracer="compiled")
    return Twin(wronged(scene, wrong) if wrong else scene, made.frames(1, seed=own)[0], truth)


def twin(number: int, seed: int, tolerance: float, *, renders: bool, wrong: str, povray: int = 0) -> dict[str, Any]:
    """One scene, one capture, one fit."""
    asked = twin_of(number, seed, tolerance, renders=renders, wrong=wrong, povray=povray)
    truth = asked.truth
    before = cpu()
    options = radwrap.RenderOptions(tolerance=tolerance, seed=number, workers=1)
    found = radwrap.fit(asked.begun, [asked.capture], keys_of(truth), options=options)
    keys = [
        {
            "key": key.key,
            "truth": truth[key.key],
            "value": key.value,
            "interval": key.interval,
            "sigma_noise": key.sigma_noise,
            "sigma_prediction": key.sigma_prediction,
            "pull": (key.value - truth[key.key]) / key.sigma if key.sigma else None,
            "held": key.interval is not None and key.interval[0] <= truth[key.key] <= key.interval[1],
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
        "wrong_missed": [one["wrong"] for one in wrong if one["explained"]],
        "processor_s_each": float(np.mean([one["processor_s"] for one in twins])),
        "rays_each": float(np.mean([one["rays"] for one in twins])),
        "places_each": float(np.mean([one["places"] for one in twins])),
    }


def main() -> None:
    """Run twins and print what they say."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("--twins", type=int, default=20, help="right scenes (default 20)")
    parser.add_argument("--wrong", type=int, default=5, help="scenes whose model is wrong (default 5)")
    parser.add_argument("--renders", action="store_true", help="with places, poses and beams that need renders")
    parser.add_argument("--povray", action="store_true", help="captures by POV-Ray, of right scenes only")
    parser.add_argument(
        "--viewpoints", type=int, default=PLACES, help=f"of POV-Ray: places of the opening (default {PLACES})"
    )
    parser.add_argument("--tolerance", type=float, default=0.5, help="of the fits [gray level] (default 0.5)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", help="file for the numbers")
    asked = parser.parse_args()
    what = {"seed": asked.seed, "tolerance": asked.tolerance, "renders": asked.renders, "right": asked.twins}
    if asked.povray:
        what["povray"], asked.wrong = asked.viewpoints, 0
    twins = done(asked.out, what)
    for number in range(len(twins), asked.twins + asked.wrong):
        wrong = WRONG[number % len(WRONG)] if number >= asked.twins else ""
        places = what.get("povray", 0)
        made = twin(number, asked.seed, asked.tolerance, renders=asked.renders, wrong=wrong, povray=places)
        twins.append(made)
        told = "explained" if twins[-1]["explained"] else "not explained"
        print(f"twin {number} {wrong}: {told}, {twins[-1]['processor_s']:.0f} s", file=sys.stderr)
        if asked.out:
            write_bytes(Path(asked.out), json_text({"asked": what, "summary": summary(twins), "twins": twins}).encode())
    print(json_text(summary(twins)), end="")


def done(path: str | None, what: dict[str, Any]) -> list[dict[str, Any]]:
    """Twins of the same run that a file has already: one that was killed goes on."""
    if path is None or not Path(path).exists():
        return []
    kept = json.loads(Path(path).read_text())
    if kept["asked"] != what:
        raise SystemExit(f"{path} is of another run: {kept['asked']}")
    return list(kept["twins"])


if __name__ == "__main__":
    main()
