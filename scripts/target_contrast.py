"""Contrast of the Siemens star and of USAF 1951 elements on renders, beside the closed form of lens and pixel.

    python scripts/target_contrast.py [--tolerance 0.5] [--json FILE]

Renders `rad_scenes/targets/siemens_star.toml` and `usaf1951.toml` straight on in three ways: sharp without
diffraction, out of focus without diffraction, and in focus through an opening so small that diffraction blurs. The
closed form knows no ray: the modulation transfer of the pixel (sinc), of the circle of confusion (2 J1(x)/x, but for
the cos^4 of slanted light) and of a round pupil in one wavelength (Goodman, Introduction to Fourier Optics, 3rd ed.,
eq. 6-31). Of the star it is the first harmonic along circles; of an element the contrast (gaps - bars)/(gaps + bars)
across its three bars, a profile of finite length whose Fourier transform is known. Both are taken at the very pixels of
the picture. Prints a table.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import j0

import radwrap
from radwrap.imaging.truth import geometry
from radwrap.scene.scene import Scene

TARGETS: Final = Path(__file__).parents[1] / "rad_scenes" / "targets"
WAVELENGTH: Final = 550e-9  # m
WAYS: Final[dict[str, dict[str, Any]]] = {
    "sharp": {"camera.diffraction": "off"},
    "out of focus": {"camera.diffraction": "off", "camera.lens.focus_distance": "400 mm", "camera.lens.f_number": 2.8},
    "diffraction": {
        **{"camera.diffraction": "on", "camera.lens.f_number": 32, "camera.wavelength": "550 nm"},
        **{"camera.exposure_time": "160 ms"},
    },
}
RADII: Final = (12.0, 16.0, 20.0, 26.0, 34.0, 44.0, 60.0, 80.0)  # px
NODES: Final = 40  # of a circle of confusion, from its middle to its rim
LONGEST: Final = 4096  # samples of the spectrum of a profile
Array = NDArray[np.float64]


def main() -> None:
    """Render, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tolerance", type=float, default=0.5, help="gray level rms of the renders")
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=list(WAYS))
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    found: dict[str, Any] = {}
    for way in given.ways:
        changes = WAYS[way]
        for name, measured in (("siemens_star", star), ("usaf1951", elements)):
            scene = radwrap.load_scene(TARGETS / f"{name}.toml", changes)
            result = radwrap.render(scene, tolerance=given.tolerance, workers=1)
            rows = measured(scene, result.radiant_exposure.values)
            found[f"{name}, {way}"] = rows
            print(f"{name}, {way}; certified {result.run.error.rms_gray_upper95:.3f} gray rms")
            for row in rows:
                told = "  ".join(f"{key} {value:.4g}" for key, value in row.items())
                print(f"  {told}  difference {row['measured'] - row['closed_form']:+.4f}")
    if given.json is not None:
        given.json.write_text(json.dumps(found, indent=1))


def transfer(scene: Scene, across: Array, down: Array) -> Array:
    """Modulation transfer of lens and pixel at frequencies along columns' and rows' directions [cycles/px]."""
    camera = scene.camera
    pitch = camera.sensor.pixel_width
    radial = np.hypot(across, down) / pitch  # m^-1 on the sensor
    found = np.sinc(across) * np.sinc(down)
    if camera.diffraction == "on":
        share = np.minimum(radial * WAVELENGTH * camera.image_distance / camera.aperture.diameter, 1.0)
        return found * 2 / math.pi * (np.arccos(share) - share * np.sqrt(1 - share**2))
    depth = camera.pose.position[2]
    confusion = camera.aperture.diameter * camera.image_distance * abs(1 / depth - 1 / camera.lens.focus_distance)
    # Light from the rim of the opening comes slanted, and counts by cos^4: a disc that is dimmer towards its rim.
    places, weights = np.polynomial.legendre.leggauss(NODES)
    share = (places + 1) / 2
    weights = weights * share / (1 + (share * camera.aperture.diameter / 2 / camera.image_distance) ** 2) ** 2
    return found * np.asarray(j0(math.pi * confusion * radial[..., np.newaxis] * share) @ weights / weights.sum())


def pixel_on_target(scene: Scene) -> float:
    """What a pixel sees of the target [m]."""
    camera = scene.camera
    return camera.sensor.pixel_width * camera.pose.position[2] / camera.image_distance


def star(scene: Scene, exposure: Array) -> list[dict[str, float]]:
    """First harmonic of the spokes along circles, over that of ideal spokes."""
    told = geometry(scene, ())["targets"]["target"]["star"]
    layout = scene.targets[0].layout
    rows, columns = np.mgrid[: exposure.shape[0], : exposure.shape[1]]
    x, y = columns - told["u"], told["v"] - rows
    distance, angle = np.hypot(x, y), np.arctan2(y, x)
    light, dark = (scene.materials[name].reflectance for name in ("paper", "ink"))
    ideal = 2 / math.pi * (light - dark) / (light + dark) * 2  # of the first harmonic of a square wave, over the mean
    found = []
    for radius in RADII:
        ring = np.abs(distance - radius) < 0.75
        phase, r = layout.spokes * angle[ring], distance[ring]
        expected = np.zeros_like(phase)
        for harmonic in range(1, 40, 2):
            frequency = harmonic * layout.spokes / (2 * math.pi * r)  # across the spokes, along the circle
            passed = transfer(scene, frequency * np.sin(angle[ring]), frequency * np.cos(angle[ring]))
            expected -= passed * np.sin(harmonic * phase) / harmonic  # the first spoke, from the right on, is dark
        shape = np.column_stack([np.ones_like(phase), np.cos(phase), np.sin(phase)])
        mean, *waves = np.linalg.lstsq(shape, exposure[ring], rcond=None)[0]
        _, *computed = np.linalg.lstsq(shape, expected, rcond=None)[0]
        found.append(
            {
                "cycles_per_px": layout.spokes / (2 * math.pi * radius),
                "measured": math.hypot(*waves) / mean / ideal,
                "closed_form": math.hypot(*computed),
            }
        )
    return found


def elements(scene: Scene, exposure: Array) -> list[dict[str, float]]:
    """Contrast of each element of at least two pixels a pair of lines, mean of its two directions."""
    target = scene.targets[0]
    pixel = pixel_on_target(scene)
    middle_u, middle_v = scene.camera.principal_point
    light, dark = (scene.materials[name].reflectance for name in ("paper", "ink"))
    found = []
    for element in target.layout.elements():
        bar = element.bar_width / pixel
        if bar < 1:
            continue
        both = []
        for (x, y), upright in ((element.upright, True), (element.level, False)):
            u, v = middle_u + x / pixel, middle_v - y / pixel
            picture, along, across = (exposure, v, u) if upright else (exposure.T, u, v)
            half = max(bar - 1, 0.5)  # the middle of the bars, away from their ends
            lines = slice(round(along - half), round(along + half) + 1)
            places = np.arange(math.floor(across - 2.5 * bar) - 1, math.ceil(across + 2.5 * bar) + 2)
            seen = picture[lines, places].mean(axis=0)
            computed = profile(scene, bar, places - across, upright=upright)
            both.append(
                (
                    contrast(seen, places - across, bar),
                    contrast(light - (light - dark) * computed, places - across, bar),
                )
            )
        measured, closed = np.mean(both, axis=0)
        found.append(
            {
                "group": element.group,
                "element": element.element,
                "cycles_per_px": 1 / (2 * bar),
                "measured": float(measured),
                "closed_form": float(closed),
            }
        )
    return found


def profile(scene: Scene, bar: float, places: Array, *, upright: bool) -> Array:
    """Share of ink over three bars of width `bar` [px] as pixels at some places from their middle see it."""
    length = 32 * bar + 64  # px, after which the profile repeats
    frequency = np.arange(-LONGEST, LONGEST + 1) / length
    zero = np.zeros_like(frequency)
    passed = transfer(scene, frequency, zero) if upright else transfer(scene, zero, frequency)
    spectrum = bar * np.sinc(frequency * bar) * (1 + 2 * np.cos(4 * math.pi * frequency * bar)) * passed / length
    return np.asarray((spectrum * np.cos(2 * math.pi * np.outer(places, frequency))).sum(axis=1))


def contrast(levels: Array, places: Array, bar: float) -> float:
    """(gaps - bars)/(gaps + bars): the lightest pixel of each gap, the darkest of each bar."""

    def of(middle: float) -> Array:
        return levels[np.abs(places - middle) <= max(bar / 2, 0.5)]

    gaps = np.mean([of(side * bar).max() for side in (-1, 1)])
    bars = np.mean([of(side * bar).min() for side in (-2, 0, 2)])
    return float((gaps - bars) / (gaps + bars))


if __name__ == "__main__":
    main()
