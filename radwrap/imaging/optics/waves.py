"""What waves pass of each spatial frequency through an opening of any shape, in focus and out of it.

Scalar, paraxial, incoherent light. A point at depth z that is seen through the
opening A(q) gives the field U(x) = integral A(q) exp(ik [D q^2/2 - q x/v]) dq,
D = 1/z + 1/v - 1/f_lens, at a place x [m] of the central image that lies by x
from the sensor's place. Its intensity |U|^2, divided by its integral, is what a
place on the sensor gathers from the central image. The Fourier transform of
that is the autocorrelation of the pupil's field: with s = lambda v nu and the
magnification m = v D of `Camera.magnification`

    W(nu) = 1/A integral A(q - s/2) A(q + s/2) exp(-2 pi i m nu q) dq.

The overlap of two shifted openings is cut in chords across s, so that one
integral is left, whose ends and kinks are known: Gauss' rule gives it to 1e-8
and better. W(0) = 1 whatever the defocus, and no light is lost. As lambda -> 0
it becomes the transform of the opening, m q, that rays see; the same code gives
both. Above the frequency d/(lambda v) nothing passes. Sources: keys
born_wolf and goodman.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray

from radwrap.imaging.optics.contrast_share import ContrastShare
from radwrap.imaging.optics.measured_spread import MeasuredSpread
from radwrap.imaging.optics.pupil_path import PupilPath
from radwrap.imaging.optics.transfer import Transfer
from radwrap.scene.camera import Aperture

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
_Curve = tuple[float, float, Array]  # from one frequency to another [m^-1], and what lies between, see `_finer`

# Nodes of Gauss' rule; a piece of a chord's integral is cut into as many parts as its phase has cycles for. Of a whole
# piece pi pi/2 nodes a cycle are the least that resolve it, as nodes lie apart where the sine is steep.
_NODES: Final = 32
_NODES_OF_CYCLE: Final = 6
# Places along the frequency at which a round opening's transform is computed. As a function of the angle of which they
# are the cosines it is smooth and periodic, so its Fourier series gives it between them, and straight lines between
# those: their error is 1/8 (2 pi/(16 24))^2 = 3e-5 of the local amplitude, which for many cycles is small itself.
_PLACES: Final = 384
_PLACES_OF_CYCLE: Final = 24
_FINER: Final = 16
_AT_ONCE: Final = 1 << 20  # values of an integrand that are held: 16 MiB
# Of a transform's envelope over x = pi |m| d nu: 2 |J1(x)|/x <= sqrt(8/pi) x^-1.5 of a disc, less than twice of a ring
# whose stop is not nearly as wide, |sin(x)/x| <= 1/x of a square and of the straight edge of half a disc.
_ROUND_ENVELOPE: Final = math.sqrt(8 / math.pi)


@dataclass(frozen=True, slots=True)
class Waves:
    """Light of one wavelength behind an opening.

    Attributes
    ----------
    aperture : Aperture
        A finite opening.
    image_distance : float
        v, from the opening to the sensor [m].
    wavelength : float
        lambda [m]; 0 is the limit of rays.
    glass : PupilPath, ContrastShare or MeasuredSpread, optional
        What the lens does to waves, which rays do not know.
    """

    aperture: Aperture
    image_distance: float
    wavelength: float
    glass: PupilPath | ContrastShare | MeasuredSpread | None = None

    @property
    def shift(self) -> float:
        """How far a frequency of 1/m shifts the openings against each other: lambda v [m^2]."""
        return self.wavelength * self.image_distance

    @property
    def blur(self) -> float:
        """The length that diffraction knows, lambda N_w = lambda v/d; the Airy disc has 1.22 of it as radius [m]."""
        return self.shift / self.aperture.diameter

    @property
    def highest_frequency(self) -> float:
        """Above it nothing passes [m^-1]; infinite for rays."""
        if not self.shift:
            return math.inf
        if isinstance(self.glass, MeasuredSpread):
            return math.sqrt(2) * self.glass.highest_frequency
        return (2 * self.aperture.reach if self.aperture.shape == "square" else self.aperture.diameter) / self.shift

    def last_frequency(self, magnification: float, least: float) -> float:
        """Above it less than a share `least` passes of each frequency, of a point out of focus [m^-1].

        What is blurred by many times `blur` has passed none of its fine structure long before `highest_frequency`.
        """
        blur = math.pi * abs(magnification) * self.aperture.diameter
        if not blur or (self.glass is not None and self.wavelength):  # which may bring to focus what lies out of it
            return self.highest_frequency
        straight = self.aperture.shape in ("square", "half_disc")
        x = 1 / least if straight else (2 * _ROUND_ENVELOPE / least) ** (2 / 3)
        return min(self.highest_frequency, x / blur)

    def tail(self, radius: float) -> float:
        """Share of the light that waves send farther than a radius [m] which is large beside blur and `blur`.

        lambda v P/(2 pi^2 A r), P the length of the opening's rim: 2 lambda N/(pi^2 r) for a round one.
        """
        return self.shift * rim(self.aperture) / (2 * math.pi**2 * self.aperture.area * radius)

    def tail_radius(self, share: float) -> float:
        """Radius beyond which that share of the light lies [m]."""
        return self.tail(1.0) / share

    def transfer(self, magnification: float, across: Array, down: Array) -> Complex:
        """W at frequencies.

        Parameters
        ----------
        magnification : float
            m of the point, see `Camera.magnification`; 0 in focus.
        across, down : ndarray
            Frequencies along the camera's x and y [m^-1], of shapes that broadcast.

        Returns
        -------
        ndarray
            1 at the frequency 0; real for an opening that looks alike from both sides.
        """
        highest = float(np.hypot(np.abs(across).max(initial=0.0), np.abs(down).max(initial=0.0)))
        return self.transfer_up_to(highest or 1 / self.aperture.diameter, magnification)(across, down)

    def transfer_up_to(self, highest: float, magnification: float) -> Transfer:
        """As `transfer`, of frequencies that come in parts, none above the highest: what they share is made once."""
        if self.glass is not None and self.wavelength:
            measured = isinstance(self.glass, MeasuredSpread)  # it stands in place of waves
            light = replace(self, glass=None, wavelength=0.0 if measured else self.wavelength)
            perfect = partial(light.transfer_up_to, highest)
            return self.glass.transfer_up_to(
                self.aperture, self.image_distance, self.wavelength, magnification, perfect=perfect
            )
        match self.aperture.shape:
            case "square":
                return partial(self._square, magnification)
            case "half_disc":
                return partial(self._half_disc, magnification)
        curves = self._curves(magnification, min(highest, self.highest_frequency))
        return partial(_round, curves)

    def _square(self, magnification: float, across: Array, down: Array) -> Complex:
        across, down = np.broadcast_arrays(across, down)
        c, s = math.cos(self.aperture.rotation), math.sin(self.aperture.rotation)
        found = np.ones(across.shape)
        for frequency in (c * across + s * down, c * down - s * across):
            width = np.maximum(self.aperture.diameter - self.shift * np.abs(frequency), 0.0)
            found *= width / self.aperture.diameter * np.sinc(magnification * frequency * width)
        return found.astype(np.complex128)

    def _curves(self, magnification: float, highest: float) -> list[_Curve]:
        """Of a disc, or a ring: overlaps of its discs with each other, real as those of both orders are taken."""
        outer, inner = self.aperture.diameter / 2, self.aperture.inner_diameter / 2
        pairs = [(outer, outer, 1.0)]
        if self.aperture.shape == "annular":
            pairs += [(outer, inner, -2.0), (inner, inner, 1.0)]
        curves = []
        for large, small, sign in pairs:
            # Where the smaller disc begins to leave the larger one, and where both part, the overlap has kinks.
            ends = [(large - small) / self.shift, (large + small) / self.shift] if self.shift else [highest]
            for low, high in itertools.pairwise([0.0, *ends]):
                top = min(high, highest)
                if not top > low:
                    continue
                places = _PLACES + math.ceil(_PLACES_OF_CYCLE * 2 * large * abs(magnification) * (top - low))
                knots = low + (top - low) * (1 - np.cos(np.pi * np.arange(places + 1) / places)) / 2
                values = sign / self.aperture.area * self._discs(magnification, large, small, knots)
                curves.append((low, top, _finer(values)))
        return curves

    def _discs(self, magnification: float, large: float, small: float, frequency: Array) -> Array:
        """Real part of the transform of what two discs have in common, by frequency; shape (n,) [m^2]."""
        half = self.shift * frequency / 2
        low, high = np.maximum(-half - large, half - small), np.minimum(large - half, half + small)
        high = np.maximum(high, low)
        with np.errstate(divide="ignore", invalid="ignore"):
            kink = np.where(half > 0, (large**2 - small**2) / (4 * half), 0.0)
        inside = (kink > low) & (kink < high)
        kink = np.where(inside, kink, (low + high) / 2)

        def chord(x: Array, some: NDArray[np.intp]) -> Array:
            h = half[some, np.newaxis, np.newaxis]
            return 2 * np.sqrt(np.maximum(np.minimum(large**2 - (x + h) ** 2, small**2 - (x - h) ** 2), 0.0))

        if large == small:  # alike on both sides of the middle
            breaks = np.stack([np.zeros_like(high), high], axis=-1)
            return 2 * _transformed(chord, breaks, magnification * frequency, real=True).real
        breaks = np.stack([low, kink, high], axis=-1)
        return _transformed(chord, breaks, magnification * frequency, real=True).real

    def _half_disc(self, magnification: float, across: Array, down: Array) -> Complex:
        across, down = np.broadcast_arrays(across, down)
        radius, rotation = self.aperture.diameter / 2, self.aperture.rotation
        frequency = np.hypot(across, down)
        found = np.zeros(frequency.shape, dtype=np.complex128)
        some = self.shift * frequency < 2 * radius
        f = frequency[some]
        # The straight edge's normal, which points into the opening, along the shift and across it.
        angle = np.arctan2(down[some], across[some])
        along, beside = np.cos(rotation - angle), np.maximum(np.abs(np.sin(rotation - angle)), 1e-12)
        half = self.shift * f / 2
        edge = np.abs(along) * half  # both openings' edges: the farther one counts
        most = radius - half
        breaks = [-most, np.zeros_like(most), most]
        for centre in (-half, half):
            off = edge - along * centre
            foot, reach = centre + along * off, beside * np.sqrt(np.maximum(radius**2 - off**2, 0.0))
            breaks += [foot - reach, foot + reach]
        cut = np.sort(np.clip(np.stack(breaks, axis=-1), -most[:, np.newaxis], most[:, np.newaxis]), axis=-1)

        def chord(x: Array, of: NDArray[np.intp]) -> Array:
            h, a, b, e = (values[of, np.newaxis, np.newaxis] for values in (half, along, beside, edge))
            rim_ = np.sqrt(np.maximum(radius**2 - (np.abs(x) + h) ** 2, 0.0))
            return np.clip(rim_ - (e - a * x) / b, 0.0, 2 * rim_)

        found[some] = _transformed(chord, cut, magnification * f) / self.aperture.area
        return found


def _round(curves: list[_Curve], across: Array, down: Array) -> Complex:
    frequency = np.hypot(across, down)
    found = np.zeros(frequency.shape)
    for low, high, curve in curves:
        some = (frequency <= high) & ((frequency > low) | (low == 0.0))
        place = np.arccos(np.clip(1 - 2 * (frequency[some] - low) / (high - low), -1.0, 1.0)) / np.pi
        found[some] += np.interp(place * (len(curve) - 1), np.arange(len(curve)), curve)
    return found.astype(np.complex128)


def _finer(values: Array) -> Array:
    """Values at equal steps of an angle from 0 to pi, about both of which they are even: the same at finer steps."""
    around = np.concatenate([values, values[-2:0:-1]])
    return _FINER * np.fft.irfft(np.fft.rfft(around), _FINER * len(around))[: _FINER * (len(values) - 1) + 1]


def rim(aperture: Aperture) -> float:
    """Length of an opening's rim [m], that of the stop in its middle included."""
    match aperture.shape:
        case "square":
            return 4 * aperture.diameter
        case "half_disc":
            return (math.pi / 2 + 1) * aperture.diameter
        case "annular":
            return math.pi * (aperture.diameter + aperture.inner_diameter)
    return math.pi * aperture.diameter


def _transformed(
    chord: Callable[[Array, NDArray[np.intp]], Array], breaks: Array, cycles: Array, *, real: bool = False
) -> Complex:
    """Integral of chord(x) exp(-2 pi i cycles x) dx, the chord smooth but for its square roots at the breaks.

    Parameters
    ----------
    chord : callable
        Lengths [m] at places x, shape (n, pieces, nodes), of some of the rows.
    breaks : ndarray, shape (rows, pieces + 1)
        Increasing [m].
    cycles : ndarray, shape (rows,)
        [m^-1].
    real : bool
        Whether the real part is enough.
    """
    longest = np.diff(breaks, axis=-1).max(axis=-1, initial=0.0)
    parts = np.maximum(np.ceil(_NODES_OF_CYCLE * longest * np.abs(cycles) / _NODES), 1).astype(np.intp)
    found = np.empty(len(breaks), dtype=np.complex128)
    nodes, weights = leggauss(_NODES)
    for number in np.unique(parts).tolist():
        # x = sin turns a square root at either end of a piece into a smooth function.
        middles = (np.arange(number)[:, np.newaxis] + 0.5) * np.pi / number - np.pi / 2
        angle = (middles + nodes * np.pi / 2 / number).ravel()
        place, weight = np.sin(angle), np.tile(weights, number) * np.pi / 2 / number * np.cos(angle)
        rows = np.flatnonzero(parts == number)
        together = max(1, _AT_ONCE // (len(place) * (breaks.shape[1] - 1)))
        for start in range(0, len(rows), together):
            some = rows[start : start + together]
            middle = (breaks[some, 1:] + breaks[some, :-1]) / 2
            half = (breaks[some, 1:] - breaks[some, :-1]) / 2
            x = middle[..., np.newaxis] + half[..., np.newaxis] * place
            phase = -2 * np.pi * cycles[some, np.newaxis, np.newaxis] * x
            values = chord(x, some) * weight
            found[some] = np.einsum("ijk,ijk,ij->i", values, np.cos(phase) if real else np.exp(1j * phase), half)
    return found
