"""Honest certificates of real glass: boards that hide nothing, through lenses that are not perfect.

The scenes of scripts/wave_certificates.py with lenses of f/2 to f/16 and light of one wavelength. A lens has one of a
wavefront (two to five Zernike terms up to order 4, by one of three conventions, .02 to .25 waves rms), the contrast of
a data sheet, or a picture of a point. Wavefronts and contrasts are the same everywhere, or change with the height in
the image. The truth is independent of how images are made: the pupil's field is sampled, its Zernike terms by formulas
of their own, and its transform gives the point spread at each depth, of each pixel where the glass changes; a data
sheet's contrast and a picture enter by their own transforms. Places around a pixel are drawn from a density, central
rays are traced there, and each counts by the point spread at the depth that it meets.
What is seen otherwise from the opening than from its centre is added by geometry.
Writes out/glass_certificates.json; exit code 1 if the bound holds in less than 91 % of the scenes, or is idle (median
of bound / truth above 1.5).
"""

from __future__ import annotations

import math
import resource
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import map_coordinates, spline_filter
from scipy.special import j0

import radwrap
from certificates import concluded, draw, exposed, judged_by, true_square
from radwrap.images import write_exr
from radwrap.imaging.methods.sobol import scrambled_points
from radwrap.imaging.optics.view import View, look_at_depths, trace_rays
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.tracing import traced_scene
from wave_certificates import held, seen_otherwise
from wave_certificates import in_words as waves_in_words

Array = np.ndarray[Any, Any]
Pupil = Callable[[Array, Array], Array]  # at places of the unit disc, x right and y up
Place = tuple[float, float]  # of the sensor, x right and y up [m]

ROWS, COLUMNS = 20, 24
OVER_THE_FIELD = 8, 10  # rows and columns where each pixel has a point spread of its own
FASTEST, SLOWEST = 2.0, 16.0  # f-numbers
NEAREST, FARTHEST = 0.95, 1.05  # focus, in distances of the board
NEAR_FOCUS = 0.1  # of that range, where each pixel has a point spread of its own
TILTED = 4.0  # deg, of boards before a lens that changes over the field
LINES = (450, 550, 650)  # nm
LEAST_RMS, MOST_RMS = 0.02, 0.25  # waves
HIGHEST = 4  # order
SQUARES = 128, 256, 512  # along the pupil
PARTS = 4  # of lambda N, that a point spread is sampled by
FRINGES = 20.0  # lambda N beyond three radii of the blur, within which a point spread is sampled; then it is 1/r^3
MOST_LAYERS, LAYER_STEP = 33, 0.1  # the latter: radii of blur that are told apart, in lambda N
FARTHEST_SHARE = 2e-4  # of the light, beyond the last radius
MOST_LOST = 2e-3  # of the light, by samples and the law of the tail, which is made up for
WIDE = 0.15  # share of the places that are drawn from a density without zeros
FINEST = 3  # samples of a picture of a point in its smallest deviation


@dataclass(frozen=True)
class Spread:
    """Point spreads on a grid, for magnifications, and the density by which places are drawn.

    Attributes
    ----------
    layers : ndarray, shape (layers,)
        Magnifications, increasing.
    step : float
        Of the grid, whose middle is the pixel's own place [m].
    cubics : ndarray, shape (layers, n, n)
        Splines of intensity [m^-2] at places x across, y up.
    radius : float
        Of the disc in which they hold [m].
    tail : float
        lambda N, beyond; 0 where there is none [m].
    total : ndarray, shape (n^2,)
        Summed shares of the places in each cell.
    wide : float
        Scale of the density without zeros [m].
    """

    layers: Array
    step: float
    cubics: Array
    radius: float
    tail: float
    total: Array
    wide: float

    @classmethod
    def of(cls, layers: Array, step: float, intensity: Array, tail: float, wide: float) -> Spread:
        """From shares of the light on an even grid, shape (layers, n, n)."""
        size = intensity.shape[-1]
        at = (np.arange(size) - size // 2) * step
        off = np.hypot(at, at[:, np.newaxis])
        radius = (size // 2 - 4) * step
        beyond = 2 * tail / (np.pi**2 * radius)
        inside = np.where(off <= radius, intensity, 0.0)
        held = inside.sum(axis=(1, 2), keepdims=True)
        lost = float(np.abs(held - 1 + beyond).max())
        if lost > MOST_LOST:
            raise TooWideError(f"{lost:.2%} of the light is lost")
        inside *= (1 - beyond) / held
        density = np.abs(inside).mean(axis=0).ravel()
        cubics = np.stack([spline_filter(one / step**2, output=np.float32) for one in inside])
        return cls(layers, step, cubics, radius, tail, np.cumsum(density / density.sum()), wide)

    def drawn(self, share: Array, random: np.random.Generator) -> tuple[Array, Array, Array]:
        """Places x, y [m] by shares from 0 to 1, and their density there [m^-2]."""
        size = self.cubics.shape[-1]
        within = share >= WIDE
        cell = np.searchsorted(self.total, np.clip((share - WIDE) / (1 - WIDE), 0, 1), side="right")
        cell = np.minimum(cell, size**2 - 1)
        beside = random.random((2, *share.shape)) - 0.5
        x, y = (
            (one - size // 2 + off) * self.step for one, off in zip((cell % size, cell // size), beside, strict=True)
        )
        # r^2/(c + r)^2 is the share within a radius.
        part = np.sqrt(np.clip(share / WIDE, 0, 1 - 1e-9))
        radius, angle = self.wide * part / (1 - part), 2 * np.pi * random.random(share.shape)
        x, y = np.where(within, x, radius * np.cos(angle)), np.where(within, y, radius * np.sin(angle))
        column, row = (np.rint(one / self.step).astype(int) + size // 2 for one in (x, y))
        on = (column >= 0) & (column < size) & (row >= 0) & (row < size)
        of_cell = np.diff(self.total, prepend=0.0)[np.where(on, row * size + column, 0)]
        near = np.where(on, (1 - WIDE) * of_cell / self.step**2, 0.0)
        return x, y, near + WIDE * self.wide / (np.pi * (self.wide + np.hypot(x, y)) ** 3)

    def intensity(self, x: Array, y: Array, magnification: Array) -> Array:
        """At places [m^-2], straight between two layers."""
        off = np.hypot(x, y)
        far = 2 * self.tail / (np.pi**2 * FARTHEST_SHARE)
        tail = np.where(off < far, self.tail / np.pi**3 / np.maximum(off, self.radius) ** 3, 0.0)
        place = np.interp(magnification, self.layers, np.arange(len(self.layers)))
        inside = off <= self.radius
        found = np.where(inside, 0.0, tail)
        for number in range(len(self.layers)):
            hat = np.maximum(1 - np.abs(place - number), 0.0)
            some = inside & (hat > 0)
            at = [one[some] / self.step + self.cubics.shape[-1] // 2 for one in (y, x)]
            values = map_coordinates(self.cubics[number], at, order=3, prefilter=False, output=np.float64)
            found[some] += hat[some] * values
        return found


class TooWideError(Exception):
    """The truth does not hold so much light."""


def radial(n: int, m: int, rho: Array) -> Array:
    """R_n^m, by its sum of factorials."""
    f, found = math.factorial, np.zeros_like(rho)
    for k in range((n - m) // 2 + 1):
        found += (-1) ** k * f(n - k) / (f(k) * f((n + m) // 2 - k) * f((n - m) // 2 - k)) * rho ** (n - 2 * k)
    return found


def term(convention: str, n: int, m: int) -> tuple[int, Pupil, float]:
    """Number of a term, m < 0 for sines; itself; and its rms."""
    size = abs(m)
    norm = math.sqrt((1 if m == 0 else 2) * (n + 1))
    scale = 1.0 if convention == "fringe" else norm
    if convention == "osa":
        number = (n * (n + 2) + m) // 2
    elif convention == "fringe":
        number = (1 + (n + size) // 2) ** 2 - 2 * size + (m < 0)
    else:  # noll: by n, by |m|, and of a pair the even number is the cosine
        before = n * (n + 1) // 2
        places = sorted(abs(k) for k in range(-n, n + 1, 2))
        pair = [before + 1 + at for at, one in enumerate(places) if one == size]
        number = next(one for one in pair if m == 0 or (one % 2 == 0) == (m > 0))

    def value(x: Array, y: Array) -> Array:
        theta = np.arctan2(y, x)
        around: Array = np.sin(size * theta) if m < 0 else np.cos(size * theta)
        return scale * radial(n, size, np.hypot(x, y)) * around

    return number, value, scale / norm


@dataclass(frozen=True)
class Glass:
    """A lens of which the truth knows what it does.

    Attributes
    ----------
    kind : str
        Of it.
    varies : bool
        Whether it changes over the field.
    path : callable, optional
        Extra path [m] of a place of the sensor at places of the unit disc.
    share : callable, optional
        Share of contrast of a place, at frequencies across and up [m^-1].
    spots : ndarray, shape (spots, 4), optional
        Of a picture of a point: weight, x, y up of the middle about that of all, deviation [1, m].
    """

    kind: str
    varies: bool
    path: Callable[[Place, Array, Array], Array] | None = None
    share: Callable[[Place, Array, Array], Array] | None = None
    spots: Array | None = None


def with_wavefront(random: np.random.Generator, lens: dict[str, Any], light: float, corner: float) -> Glass:
    """Two to five terms; over the field they grow from what is alike from all sides."""
    convention, varies = str(random.choice(["osa", "noll", "fringe"])), bool(random.random() < 0.4)
    orders = [(n, m) for n in range(1, HIGHEST + 1) for m in range(-n, n + 1, 2)]
    chosen = [orders[k] for k in random.choice(len(orders), int(random.integers(2, 6)), replace=False)]
    size = random.normal(size=len(chosen))
    whole = math.exp(random.uniform(math.log(LEAST_RMS), math.log(MOST_RMS))) * light
    paths = whole * size / math.sqrt(float((size**2).sum()))
    terms = [(*term(convention, n, m), path) for (n, m), path in zip(chosen, paths.tolist(), strict=True)]
    table = {str(number): f"{path / rms * 1e9:.9f} nm" for number, _, rms, path in terms}
    wavefront: dict[str, Any] = {"convention": convention}
    lens["wavefront"] = wavefront
    if not varies:
        wavefront["coefficients"] = table

        def same(_: Place, across: Array, up: Array) -> Array:
            return np.sum([path / rms * value(across, up) for _, value, rms, path in terms], axis=0)

        return Glass("wavefront", varies, path=same)
    heights = np.array([0.0, 0.4, 0.7, 1.05]) * corner
    alike = np.array([m == 0 for _, m in chosen])
    growth = np.where(alike, 1.0, (heights[:, np.newaxis] / heights[-1]) ** random.uniform(0.8, 2.5))
    wavefront["fields"] = [
        {
            "height": f"{height * 1e3:.9f} mm",
            "coefficients": {
                str(number): f"{path / rms * part * 1e9:.9f} nm"
                for (number, _, rms, path), part in zip(terms, row, strict=True)
            },
        }
        for height, row in zip(heights.tolist(), growth.tolist(), strict=True)
    ]

    def over(place: Place, across: Array, up: Array) -> Array:
        # What points straight up at the height points along the radius of the field.
        height, turn = math.hypot(*place), math.atan2(place[1], place[0]) - math.pi / 2
        c, s = math.cos(turn), math.sin(turn)
        straight = c * across + s * up, c * up - s * across
        found = np.zeros_like(across)
        for number, (_, value, rms, path) in enumerate(terms):
            found += path / rms * float(np.interp(height, heights, growth[:, number])) * value(*straight)
        return found

    return Glass("wavefront", varies, path=over)


def with_contrast(
    random: np.random.Generator, lens: dict[str, Any], light: float, corner: float, folder: Path
) -> Glass:
    """A data sheet's table, as a share of a perfect lens in the sheet's own light, that falls with the frequency."""
    number, varies = lens["f_number"], bool(random.random() < 0.4)
    sheet = light * random.uniform(0.9, 1.1)
    per_mm = np.linspace(0, 0.94 / (sheet * number) * 1e-3, 12)
    least, scale = random.uniform(0.3, 0.95), random.uniform(0.15, 0.6) / (light * number)
    share = least + (1 - least) * np.exp(-((per_mm * 1e3 / scale) ** 2))
    s = per_mm * 1e3 * sheet * number
    limit = 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s**2))
    heights = np.array([0.0, 0.5, 1.05]) * corner if varies else np.zeros(1)
    worse = random.uniform(0.6, 1.0, 2)
    each = np.stack(
        [share**power for power in (1 + 2 * (1 - worse[:, np.newaxis]) * heights / (corner if varies else 1.0)).ravel()]
    ).reshape(2, len(heights), -1)
    lines = ["frequency_per_mm,tangential,sagittal" + (",field_height_mm" if varies else "")]
    for at, height in enumerate(heights.tolist()):
        for k, frequency in enumerate(per_mm.tolist()):
            row = [frequency, *(each[:, at, k] * limit[k]).tolist(), *([height * 1e3] if varies else [])]
            lines.append(",".join(f"{value:.12g}" for value in row))
    (folder / "contrast.csv").write_text("\n".join(lines) + "\n")
    lens["mtf"] = {"file": "contrast.csv", "f_number": number, "wavelength": f"{sheet * 1e9:.9f} nm"}
    nodes = per_mm * 1e3
    both = np.concatenate([-nodes[:0:-1], nodes])

    def passed(place: Place, across: Array, up: Array) -> Array:
        height, azimuth = math.hypot(*place), math.atan2(place[1], place[0])
        frequency = np.minimum(np.hypot(across, up), nodes[-1])
        curves = []
        for rows in each:
            row = np.array([np.interp(height, heights, column) for column in rows.T])
            curves.append(PchipInterpolator(both, np.concatenate([row[:0:-1], row]))(frequency))
        along = np.cos(np.arctan2(up, across) - azimuth) ** 2
        found: Array = along * curves[0] + (1 - along) * curves[1]
        return found

    return Glass("mtf", varies, share=passed)


def with_picture(random: np.random.Generator, lens: dict[str, Any], pixel: float, folder: Path) -> Glass:
    """A picture of a point: two to four spots, from which all of its light is known."""
    count = int(random.integers(2, 5))
    size = pixel * math.exp(random.uniform(math.log(0.3), math.log(1.5)))
    spots = np.stack(
        [
            random.uniform(0.2, 1, count),
            *(random.normal(size=(2, count)) * size),
            random.uniform(0.5, 1.2, count) * size,
        ],
        axis=1,
    )
    spots[:, 0] /= spots[:, 0].sum()
    spots[:, 1:3] -= spots[:, :1].T @ spots[:, 1:3]
    pitch = spots[:, 3].min() / 1.5
    half = math.ceil(float((np.abs(spots[:, 1:3]).max(axis=1) + 5 * spots[:, 3]).max()) / pitch)
    at = np.arange(-half, half + 1) * pitch
    up, across = np.meshgrid(-at, at, indexing="ij")
    light = sum(
        weight / s**2 * np.exp(-((across - x) ** 2 + (up - y) ** 2) / (2 * s**2)) for weight, x, y, s in spots.tolist()
    )
    write_exr(folder / "point.exr", light.astype(np.float32), channel="Y")
    lens["psf"] = {"file": "point.exr", "pitch": f"{pitch * 1e6:.9f} um"}
    return Glass("psf", varies=False, spots=spots)


def point_spread(view: View, glass: Glass, light: float, layers: Array, place: Place) -> Spread:
    """Of all depths, at a place of the sensor."""
    camera = view.camera
    v, a = camera.image_distance, camera.aperture.diameter / 2
    length, blur = light * v / (2 * a), float(np.abs(layers).max()) * a
    if glass.spots is not None:
        return of_picture(glass.spots, v, a, layers, blur)
    # Point spreads are told out to a quarter of what squares of the pupil tell.
    number = next((one for one in SQUARES if one >= 4 * (3 * blur / length + FRINGES)), None)
    if number is None:
        raise TooWideError("more than the pupil's squares tell")
    size = number * PARTS
    # Squares at the rim count by the share that lies inside.
    fine = 8
    at = (np.arange(number) - number // 2) * 2 / (number - 2)
    parts = (np.arange(fine) + 0.5) / fine - 0.5
    x, y = np.meshgrid(at, at)
    covered = np.zeros_like(x)
    for right in parts:
        for up in parts:
            covered += np.hypot(x + right * 2 / (number - 2), y + up * 2 / (number - 2)) <= 1
    rho = a * np.hypot(x, y)
    covered, slanted = covered / fine**2, v**2 / (v**2 + rho**2)
    # All light that passes: squares at the rim pass their share of it, not the square of that.
    whole = float((covered * slanted**2).sum()) * size**2
    extra = np.zeros_like(x) if glass.path is None else glass.path(place, x, y)
    step = light * v / (size * a * 2 / (number - 2))
    cut = slice(size // 4, 3 * size // 4)
    # Squares in place of points smooth the pupil's rim.
    smoothed = np.sinc((np.arange(size)[cut] - size // 2) / size) ** 2
    intensity = []
    frequency = np.fft.fftfreq(size, step)
    passed = None if glass.share is None else glass.share(place, frequency, frequency[:, np.newaxis])
    for layer in layers.tolist():
        phase = 2 * np.pi / light * (layer / v * rho**2 / 2 + extra)
        field = np.zeros((size, size), dtype=np.complex128)
        field[:number, :number] = covered * slanted * np.exp(1j * phase)
        one = np.abs(np.fft.fft2(field)) ** 2 / whole
        if passed is not None:
            one = np.fft.ifft2(np.fft.fft2(one) * passed).real
        intensity.append(np.fft.fftshift(one)[cut, cut] / np.outer(smoothed, smoothed))
    return Spread.of(layers, step, np.stack(intensity), length, blur + 3 * length)


def of_picture(spots: Array, v: float, a: float, layers: Array, blur: float) -> Spread:
    """Spots, folded with what rays through the opening do; a pixel gathers from where a point's light does not go."""
    step = float(spots[:, 3].min()) / FINEST
    reach = blur + float((np.hypot(spots[:, 1], spots[:, 2]) + 6 * spots[:, 3]).max())
    size = 2 * math.ceil(reach / step) + 16
    frequency = np.fft.fftfreq(size, step)
    across, up = frequency, frequency[:, np.newaxis]
    gathered = sum(
        weight * np.exp(2j * np.pi * (across * x + up * y) - 2 * np.pi**2 * s**2 * (across**2 + up**2))
        for weight, x, y, s in spots.tolist()
    )
    nodes, weights = np.polynomial.legendre.leggauss(64 + math.ceil(4 * blur / step))
    q = a * (nodes + 1) / 2
    share = weights * q * (v**2 / (v**2 + q**2)) ** 2
    at = np.linspace(0, math.sqrt(0.5) / step * 1.01, 4096)
    intensity = []
    for layer in layers.tolist():
        disc = j0(2 * np.pi * abs(layer) * np.outer(at, q)) @ (share / share.sum())
        passed = gathered * np.interp(np.hypot(across, up), at, disc)
        intensity.append(np.fft.fftshift(np.fft.ifft2(passed).real))
    return Spread.of(layers, step, np.stack(intensity), 0.0, blur + float(spots[:, 3].mean()))


def layers_of(view: View, light: float) -> Array:
    """Magnifications that tell all depths in view."""
    camera = view.camera
    met, _ = look_at_depths(view, 64, np.random.default_rng(1))
    low, high = float(met.min()), float(met.max())
    # Beyond the sensor the board goes on.
    low, high = low - (high - low), high + (high - low)
    a = camera.aperture.diameter / 2
    length = light * camera.image_distance / (2 * a)
    return np.linspace(low, high, min(MOST_LAYERS, math.ceil((high - low) * a / (LAYER_STEP * length)) + 2))


def drawn_from(view: View, glass: Glass, light: float) -> Any:
    """As `sampled_radiance`, with rays drawn from point spreads: one for all pixels, or one for each."""
    layers, sensor, (cu, cv) = layers_of(view, light), view.camera.sensor, view.camera.principal_point
    known = dict[Place, Spread]()

    def spread_at(u: float, v: float) -> Spread:
        place = ((u - cu) * sensor.pixel_width, (cv - v) * sensor.pixel_height) if glass.varies else (0.0, 0.0)
        if place not in known:
            known[place] = point_spread(view, glass, light, layers, place)
        return known[place]

    def sampled(view: View, u: Array, v: Array, number: int, random: np.random.Generator) -> Array:
        found = np.empty((len(u), number))
        together = 1 if glass.varies else 64
        for start in range(0, len(u), together):
            some = slice(start, start + together)
            points = scrambled_points(random.integers(0, 2**32, (len(u[some]), 4), dtype=np.uint32), number)
            spread = spread_at(float(u[start]), float(v[start]))
            x, y, density = spread.drawn(points[..., 2], random)
            across = u[some, np.newaxis] + points[..., 0] - 0.5 + x / sensor.pixel_width
            down = v[some, np.newaxis] + points[..., 1] - 0.5 - y / sensor.pixel_height
            light, magnification = trace_rays(view, None, across.ravel(), down.ravel(), with_depth=True)
            weight = spread.intensity(x, y, magnification.reshape(x.shape)) / density
            found[some] = light.reshape(x.shape) * weight
            found[some] += seen_otherwise(view, u[some], v[some], number, random)
        return found

    return sampled


def with_glass(random: np.random.Generator, folder: Path) -> tuple[dict[str, Any], float, Glass]:
    """A scene's document, its wavelength [m], and what its lens does."""
    document = draw(random)
    camera = document["camera"]
    document["targets"] = [one for one in document["targets"] if one["type"] == "board"]
    camera["diffraction"] = "on"
    del camera["aperture"]
    distance, off = float(camera["position"][2].split()[0]), random.uniform(NEAREST, FARTHEST) - 1
    number = round(math.exp(random.uniform(math.log(FASTEST), math.log(SLOWEST))), 3)
    lens: dict[str, Any] = {"f_number": number}
    camera["lens"] = lens
    light = int(random.choice(LINES)) * 1e-9
    camera["wavelength"] = f"{light * 1e9:.0f} nm"
    sensor = camera["sensor"]
    width, height = (float(sensor[key].split()[0]) * 1e-6 for key in ("pixel_width", "pixel_height"))
    rows, columns = OVER_THE_FIELD
    corner = math.hypot(columns * width, rows * height) / 2
    match int(random.integers(3)):
        case 0:
            glass = with_wavefront(random, lens, light, corner)
        case 1:
            glass = with_contrast(random, lens, light, corner, folder)
        case _:
            glass = with_picture(random, lens, min(width, height), folder)
    lens["focus_distance"] = f"{distance * (1 + off * (NEAR_FOCUS if glass.varies else 1)):.5f} mm"
    sensor["rows"], sensor["columns"] = OVER_THE_FIELD if glass.varies else (ROWS, COLUMNS)
    if glass.varies:
        document["targets"][0]["rotation"] = [
            *(f"{random.uniform(-TILTED, TILTED):.3f} deg" for _ in range(2)),
            f"{random.uniform(-40, 40):.3f} deg",
        ]
    return document, light, glass


def judged(number: int, budget: float) -> dict[str, Any] | None:
    """One scene, rendered and held against the truth; None where there is nothing to see."""
    random = np.random.default_rng([2028, number])
    with tempfile.TemporaryDirectory() as name:
        document, light, glass = with_glass(random, Path(name))
        try:
            scene = exposed(document, float(random.uniform(60, 260)), Path(name))
            if scene is None:
                return None
            tolerance = float(random.choice([0.2, 0.5, 1.0, 2.0]))
            start = resource.getrusage(resource.RUSAGE_SELF)
            result = radwrap.render(scene, tolerance=tolerance, budget_rays=budget, seed=number, workers=1)
            end = resource.getrusage(resource.RUSAGE_SELF)
        except radwrap.InputError as refused:
            return {"number": number, "refused": str(refused)}
    error = result.run.error
    with traced_scene(scene) as view:
        gray = gray_levels(result.radiant_exposure.values, scene.camera.sensor)
        try:
            sampled = drawn_from(view, glass, light)
            square, noise = true_square(view, gray, error.rms_gray_upper95, 1000 + number, sampled)
        except TooWideError as wide:
            return {"number": number, "refused": str(wide)}
    kind, seconds = {"glass": glass.kind, "varies": glass.varies}, end.ru_utime - start.ru_utime
    return {"number": number, "tolerance": tolerance} | kind | held(result, (square, noise), light, seconds)


def in_words(row: dict[str, Any]) -> str:
    """A line of a scene."""
    return waves_in_words(row, f"{row['glass']:9} {'over the field' if row['varies'] else 'everywhere'}")


def main() -> int:
    """Draw, judge, print."""
    rows = judged_by(judged, in_words, __doc__ or "", 2e7)
    return concluded(rows, "glass_certificates")


if __name__ == "__main__":
    sys.exit(main())
