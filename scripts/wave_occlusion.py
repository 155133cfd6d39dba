"""Waves where a near edge hides what lies behind: Fresnel's integral in one dimension and two ways to lay out light.

    .venv/bin/python scripts/wave_occlusion.py

A slit looks at a half plane, black, before a plane that shines in a pattern. What each place on the sensor gathers is
its field, sent back through slit and edge to that plane. Printed for each case, in per cent of the light of an even
plane: what waves add to rays; how far that is off with light laid out where it is seen, and with what lies behind laid
out to go on behind the edge (`radwrap.imaging.tolerance.wave_behind`); how far both differ; and what a certificate
holds of it. A minute and a half.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from radwrap.imaging.tolerance.wave_parts import OF_HIDING, OF_UNEVEN

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

    @property
    def blur(self) -> float:
        """By waves, on the sensor [m]."""
        return WAVELENGTH * self.distance / self.side

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


@dataclass(frozen=True)
class Layers:
    """A line on the sensor, what is seen along it of the pattern, and what waves add to light of a depth."""

    case: Case
    u: Array
    frequency: Array

    @classmethod
    def of(cls, case: Case) -> Layers:
        """Wide enough for what waves send far."""
        reach = max(abs(case.magnification(depth)) for depth in (case.near, case.far)) * case.side
        span = max(400 * case.blur, 8 * reach, 6e-3)
        step = span / SAMPLES
        return cls(case, (np.arange(SAMPLES) - SAMPLES / 2) * step, np.fft.fftfreq(SAMPLES, step))

    def added(self, values: Array, depth: float) -> Array:
        """What waves add to light of a depth."""
        side, m = self.case.side, self.case.magnification(depth)
        width = np.maximum(side - WAVELENGTH * self.case.distance * np.abs(self.frequency), 0.0)
        passed = width / side * np.sinc(m * self.frequency * width) - np.sinc(m * self.frequency * side)
        return np.asarray(np.fft.ifft(np.fft.fft(values) * passed).real)

    @property
    def seen(self) -> Array:
        """What share of each sample is seen beside the edge, which crosses one of them."""
        return np.asarray(np.clip(0.5 - self.u / (self.u[1] - self.u[0]), 0.0, 1.0))

    def light(self, pattern: Pattern) -> Array:
        """Of the pattern, as if nothing hid it."""
        return pattern(-self.case.far * self.u / self.case.distance)

    def laid_out(self, pattern: Pattern, *, goes_on: bool) -> Array:
        """What waves add by the layers' footprints over the central image."""
        seen = self.seen
        behind = seen * self.light(pattern) + (1 - seen) * (pattern(np.array([1e-9]))[0] if goes_on else 0.0)
        return self.added(behind, self.case.far) - self.added((1 - seen) * behind, self.case.near)

    def uneven(self, pattern: Pattern) -> list[Array]:
        """What they add to light beside the edge less its mean, as far as it is and as near; see `Layout.uneven`."""
        case = self.case
        by_rays = abs(case.magnification(case.near) - case.magnification(case.far)) * case.side
        size = 2 * math.ceil((by_rays + case.blur) / (self.u[1] - self.u[0])) + 1
        seen = self.seen
        cut = (seen > 0) & (uniform_filter1d(1 - seen, size) > 1 / (2 * size))
        mean = uniform_filter1d(seen * self.light(pattern), size)[cut] / uniform_filter1d(seen, size)[cut]
        differs = np.zeros_like(self.u)
        differs[cut] = (by_rays / (by_rays + case.blur)) ** 2 * (self.light(pattern)[cut] - mean)
        return [self.added(differs, depth) for depth in (case.far, case.near)]


def row(case: Case, pattern: Pattern) -> dict[str, float]:
    """Rms over pixels about the edge [% of an even plane]."""
    blurs = [abs(case.magnification(depth)) * case.side for depth in (case.near, case.far)]
    reach = 3 * max(case.blur, *blurs)
    # Beside the middle, where rays of a sharp edge jump.
    places = np.linspace(-reach, reach, PLACES * WITHIN + 1)[:-1] + 0.0024 * reach

    def pixels(values: Array) -> Array:
        return values.reshape(PLACES, WITHIN).mean(axis=1)

    waves, layers = pixels(gathered(case, places, pattern) - by_rays(case, places, pattern)), Layers.of(case)

    def added(values: Array) -> Array:
        return pixels(np.interp(places, layers.u, values))

    seen, on = (added(layers.laid_out(pattern, goes_on=goes_on)) for goes_on in (False, True))
    parts = {"waves": waves, "seen off": seen - waves, "going on off": on - waves, "apart": on - seen}
    parts["held"] = OF_HIDING * parts["apart"] + OF_UNEVEN * np.hypot(*map(added, layers.uneven(pattern)))
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
    print(f"{'case':28}{'light behind':22}{'waves':>8}{'seen off':>10}{'going on off':>14}{'apart':>8}{'held':>8}")
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
                    f"{found['going on off']:14.2f}{found['apart']:8.2f}{found['held']:8.2f}",
                    flush=True,
                )
    return 0


if __name__ == "__main__":
    sys.exit(main())
