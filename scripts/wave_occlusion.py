"""Waves where a near edge hides what lies behind: Fresnel's integral in one dimension and two ways to lay out light.

    .venv/bin/python scripts/wave_occlusion.py

A slit looks at a half plane, black, before a plane that shines in a pattern. What each place on the sensor gathers is
its field, sent back through slit and edge to that plane. Printed for each case, in per cent of the light of an even
plane: what waves add to rays; how far that is off with light laid out where it is seen, and with what lies behind laid
out to go on behind the edge (`radwrap.imaging.tolerance.wave_behind`); how far both differ. A minute.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Pattern = Callable[[Array], Array]

WAVELENGTH: Final = 550e-9
SAMPLES: Final = 1 << 17
PLACES: Final = 37  # pixels over six times the largest blur
WITHIN: Final = 5  # places in a pixel
RAYS: Final = 4000


@dataclass(frozen=True)
class Case:
    """A slit, and where things are [m].

    Attributes
    ----------
    name : str
    side, distance : float
        Of the slit, and from it to the sensor.
    near, far : float
        Depths of edge and pattern.
    focal : float
        Of a lens in the slit; infinite without.
    span : float
        Of the samples in the planes.
    """

    name: str
    side: float
    distance: float
    near: float
    far: float
    focal: float
    span: float

    def magnification(self, depth: float) -> float:
        """Of the opening on the sensor by a point at a depth."""
        return self.distance * (1 / depth + 1 / self.distance - 1 / self.focal)


def cases() -> list[Case]:
    """A pinhole of Fresnel number 3 and a lens, and a cell's lens at f/8 before things at three distances."""
    pinhole = math.sqrt(3 * WAVELENGTH * 0.01)
    found = [Case("pinhole, F 3", pinhole, 0.01, 0.05, 1.0, math.inf, 0.3)]
    for name, focus in (("far in focus", 1.0), ("near in focus", 0.5), ("between", 0.7)):
        found.append(Case(f"f/5 10 mm, {name}", 2e-3, 1 / (1 / 0.01 - 1 / focus), 0.5, 1.0, 0.01, 0.1))
    for gap in (2.5e-3, 7.5e-3, 42.5e-3):
        name = f"f/8 35 mm, {1e3 * gap:g} mm behind"
        found.append(Case(name, 4.375e-3, 1 / (1 / 0.035 - 1 / 0.298), 0.2975, 0.2975 + gap, 0.035, 0.1))
    return found


def gathered(case: Case, places: Array, pattern: Pattern) -> Array:
    """What places on the sensor gather, by Fresnel's integral; 1 of an even plane that nothing hides."""
    k, pitch = 2 * np.pi / WAVELENGTH, case.span / SAMPLES
    x = (np.arange(SAMPLES) - SAMPLES / 2) * pitch
    step = WAVELENGTH * case.near / case.span
    q = (np.arange(SAMPLES) - SAMPLES / 2) * step
    slit = np.clip((case.side / 2 - np.abs(q)) / step + 0.5, 0, 1)
    slit = slit * np.exp(0.5j * k * q**2 * (1 / case.near + 1 / case.distance - 1 / case.focal))
    onwards = np.exp(-1j * np.pi * WAVELENGTH * (case.far - case.near) * np.fft.fftfreq(SAMPLES, pitch) ** 2)
    passes, light = np.clip(x / pitch + 0.5, 0, 1), pattern(x)
    found = []
    for place in places:
        field = np.fft.fftshift(np.fft.fft(np.fft.ifftshift(slit * np.exp(-1j * k * q * place / case.distance))))
        field = field * np.exp(0.5j * k * x**2 / case.near)
        behind = np.fft.ifft(np.fft.fft(field * passes) * onwards)
        found.append((np.abs(behind) ** 2 @ light) / (np.abs(field) ** 2).sum())
    return np.array(found)


def by_rays(case: Case, places: Array, pattern: Pattern) -> Array:
    """The same by rays through the slit."""
    q = ((np.arange(RAYS) + 0.5) / RAYS - 0.5) * case.side
    at_edge, at_far = (
        depth * (q * (1 / depth + 1 / case.distance - 1 / case.focal) - places[:, np.newaxis] / case.distance)
        for depth in (case.near, case.far)
    )
    return np.asarray(np.where(at_edge > 0, pattern(at_far), 0.0).mean(axis=1))


def by_layers(case: Case, places: Array, pattern: Pattern, *, goes_on: bool) -> Array:
    """What waves add by the layers' footprints over the central image."""
    blur = WAVELENGTH * case.distance / case.side
    reach = max(abs(case.magnification(depth)) for depth in (case.near, case.far)) * case.side
    span = max(400 * blur, 8 * reach, 6e-3)
    u = (np.arange(SAMPLES) - SAMPLES / 2) * span / SAMPLES
    light, seen = pattern(-case.far * u / case.distance), u < 0
    behind = np.where(seen, light, pattern(np.array([1e-9]))[0] if goes_on else 0.0)
    frequency = np.fft.fftfreq(SAMPLES, span / SAMPLES)
    width = np.maximum(case.side - WAVELENGTH * case.distance * np.abs(frequency), 0.0)

    def added(values: Array, depth: float) -> Array:
        m = case.magnification(depth)
        passed = width / case.side * np.sinc(m * frequency * width) - np.sinc(m * frequency * case.side)
        return np.asarray(np.fft.ifft(np.fft.fft(values) * passed).real)

    whole = added(behind, case.far) - added(np.where(seen, 0.0, behind), case.near)
    return np.interp(places, u, whole)


def row(case: Case, pattern: Pattern) -> dict[str, float]:
    """Rms over pixels about the edge [% of an even plane]."""
    blurs = [abs(case.magnification(depth)) * case.side for depth in (case.near, case.far)]
    reach = 3 * max(WAVELENGTH * case.distance / case.side, *blurs)
    # Beside the middle, where rays of a sharp edge jump.
    places = np.linspace(-reach, reach, PLACES * WITHIN + 1)[:-1] + 0.0024 * reach

    def pixels(values: Array) -> Array:
        return values.reshape(PLACES, WITHIN).mean(axis=1)

    waves = pixels(gathered(case, places, pattern) - by_rays(case, places, pattern))
    seen, on = (pixels(by_layers(case, places, pattern, goes_on=goes_on)) for goes_on in (False, True))
    parts = {"waves": waves, "seen off": seen - waves, "going on off": on - waves, "apart": on - seen}
    return {name: 100 * math.sqrt(float(np.mean(values**2))) for name, values in parts.items()}


def patterns(width: float) -> dict[str, Pattern]:
    """Light behind, its structure of some width [m]."""
    return {
        "even": np.ones_like,
        "stripes": lambda x: 0.5 + 0.5 * np.cos(2 * np.pi * x / (4 * width)),
        "step beside": lambda x: np.where(x > width, 1.0, 0.0),
    }


def main() -> int:
    """Print all cases."""
    print(f"{'case':28}{'light behind':22}{'waves':>8}{'seen off':>10}{'going on off':>14}{'apart':>8}")
    for case in cases():
        blur = max(WAVELENGTH * case.far / case.side, abs(case.magnification(case.far)) * case.side * case.far)
        for width in (blur, 4 * blur):
            for name, pattern in patterns(width).items():
                if name == "even" and width > blur:
                    continue
                found = row(case, pattern)
                what = name if name == "even" else f"{name}, {1e3 * width:.2f} mm"
                print(
                    f"{case.name:28}{what:22}{found['waves']:8.2f}{found['seen off']:10.2f}"
                    f"{found['going on off']:14.2f}{found['apart']:8.2f}",
                    flush=True,
                )
    return 0


if __name__ == "__main__":
    sys.exit(main())
