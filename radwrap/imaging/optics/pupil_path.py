"""What waves pass of each frequency through an opening behind which glass adds to the path of light.

As `waves`, with k path(q) beside the phase of the defocus:

    W(nu) = 1/A integral A(q - s/2) A(q + s/2) exp(i [phi(q - s/2) - phi(q + s/2)]) dq,  phi = k (m q^2/(2 v) + path)

The integral is a sum over squares of the opening, by transforms. Such a sum
knows the opening's rim badly, and that of the same opening without a phase
likewise: their ratio, smooth in nu, times the closed form in focus is W. So
W(0) = 1 whatever the path, W ends where it has to, and the tails are those of
the rim.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.imaging.optics.aperture import turn
from radwrap.imaging.optics.transfer import Transfer
from radwrap.scene.camera import Aperture
from radwrap.scene.zernike import Order, zernike_sum

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Squares along the opening, at least and at most, and for each cycle of the phase: the point spread is then right to
# 1e-4 of the peak in focus.
_FEWEST, _MOST = 256, 1024
_SQUARES_OF_CYCLE: Final = 16
_LEAST_OF_CYCLE: Final = 4  # beyond, sums over them fail
_ROUNDING: Final = 1e-12  # of coefficients, as angles of places are rounded
_RIM: Final = 720  # places on a circle at which a path is steepest, on so many circles
_CIRCLES: Final = 24
_MARGIN: Final = 8  # squares beyond the middle that cubics know
# Share of the opening that both shifted ones have at least in common where the ratio of sums is taken.
_LEAST_OVERLAP: Final = 1e-6


@dataclass(frozen=True, slots=True)
class PupilPath:
    """Extra path of light through the points of an opening, at one place of the field.

    Attributes
    ----------
    radius : float
        Of the disc that the polynomials belong to [m].
    orders : tuple
        See `zernike`.
    coefficients : tuple of float
        Of polynomials of rms 1 [m], in axes x right and y up.
    """

    radius: float
    orders: tuple[Order, ...]
    coefficients: tuple[float, ...]

    def path(self, x: Array, y: Array) -> Array:
        """Extra path [m] at points of the opening along the camera's x and y, which goes down [m]."""
        return zernike_sum(self.orders, self.coefficients, x / self.radius, -y / self.radius)

    def is_mirrored(self, other: object, across: int, down: int) -> bool:
        """Whether another path is this one with the signs of its axes changed, but for rounding."""
        if not isinstance(other, PupilPath) or (self.radius, self.orders) != (other.radius, other.orders):
            return False
        sines = np.array([m < 0 for _, m in self.orders])
        odd = np.array([m % 2 for _, m in self.orders], dtype=bool)
        # Turning x about takes theta to pi - theta, turning y about takes it to -theta.
        signs = np.where(odd != sines, across, 1) * np.where(sines, down, 1)
        ours, theirs = np.array(self.coefficients), np.array(other.coefficients)
        return bool(np.abs(signs * ours - theirs).max(initial=0.0) <= _ROUNDING * np.abs(ours).max(initial=0.0))

    def steepest(self, reach: float, curvature: float = 0.0) -> float:
        """Largest slope, without unit, of curvature q^2/2 + path within a radius; rays of it go v times as far."""
        radius = np.linspace(0.0, reach, _CIRCLES + 1)[:, np.newaxis]
        angle = np.arange(_RIM) * (2 * np.pi / _RIM)
        x, y = radius * np.cos(angle), radius * np.sin(angle)
        values = curvature * radius**2 / 2 + self.path(x, y)
        outward = np.abs(np.diff(values, axis=0)) / (reach / _CIRCLES)
        around = np.abs(np.diff(values, axis=1)) / np.maximum(radius * 2 * np.pi / _RIM, reach / _CIRCLES)
        return float(np.hypot(outward.max(initial=0.0), around.max(initial=0.0)))

    def transfer_up_to(
        self,
        aperture: Aperture,
        image_distance: float,
        wavelength: float,
        magnification: float,
        *,
        perfect: Callable[[float], Transfer],
    ) -> Transfer:
        """What waves pass of frequencies.

        Parameters
        ----------
        aperture, image_distance, wavelength
            As of `Waves`; a wavelength above 0.
        magnification : float
            m of the point.
        perfect : callable
            Gives the same of any magnification, without a path.

        Raises
        ------
        InputError
            If the phase has too many cycles over the opening.
        """
        curvature = magnification / image_distance
        cycles = self.steepest(aperture.reach, curvature) * 2 * aperture.reach / wavelength
        if _LEAST_OF_CYCLE * cycles > _MOST:
            raise InputError(
                f"blurs light over {cycles:.3g} lengths of waves, and {_MOST // _LEAST_OF_CYCLE} are the most that are "
                "computed",
                where="camera.lens.wavefront",
                remedy="bring targets nearer to focus, take a smaller opening, or leave the wavefront out",
            )
        number = min(max(_FEWEST, math.ceil(_SQUARES_OF_CYCLE * cycles / _FEWEST * 4) * _FEWEST // 4), _MOST)
        step = 2 * aperture.reach / (number - 2)  # a square to either side for the rim
        at = (np.arange(number) - (number - 1) / 2) * step
        x, y = np.meshgrid(at, at)
        share = _covered(aperture, x, y, step)
        phase = 2 * np.pi / wavelength * (curvature * (x**2 + y**2) / 2 + self.path(x, y))
        ratio = _ratio(share, phase)
        # Cubics by scipy, which is loaded where a lens has a wavefront only.
        from scipy.ndimage import spline_filter

        cubics = spline_filter(ratio, output=np.complex128)
        return partial(_between, cubics, wavelength * image_distance / step, perfect(0.0))


def _ratio(share: Array, phase: Array) -> Complex:
    """Sum of pupil(q) conj(pupil(q + s)) for shifts s, over that without a phase.

    Returns
    -------
    ndarray, shape (2 n, n + 1 + margin)
        Shifts down from -n on, and across from -margin on: those of the other half are the conjugates.
    """
    n = len(share)
    size = 2 * n
    power = np.abs(np.fft.fft2(share * np.exp(1j * phase), (size, size))) ** 2
    sums = np.fft.rfft2(power) / size**2
    overlap = np.fft.irfft2(np.abs(np.fft.rfft2(share, (size, size))) ** 2, (size, size))[:, : n + 1]
    least = _LEAST_OVERLAP * overlap[0, 0]
    half = np.where(overlap > least, sums / np.where(overlap > least, overlap, 1.0), 0.0)
    other = np.conj(half[-np.arange(size), _MARGIN:0:-1])
    return np.fft.fftshift(np.concatenate([other, half], axis=1), axes=0)


def _between(cubics: Complex, squares: float, perfect: Transfer, across: Array, down: Array) -> Complex:
    """The ratio at frequencies, times what passes in focus; so many squares shift the openings for 1/m."""
    from scipy.ndimage import map_coordinates

    across, down = np.broadcast_arrays(across, down)
    sign = np.where(across < 0, -squares, squares)
    places = [down * sign + len(cubics) // 2, across * sign + _MARGIN]
    ratio: Complex = map_coordinates(cubics, places, order=3, prefilter=False)
    return np.where(across < 0, np.conj(ratio), ratio) * perfect(across, down)


def _covered(aperture: Aperture, x: Array, y: Array, step: float) -> Array:
    """Share of squares that lies in the opening, by the distance of their middles from its rim."""
    along, across = np.moveaxis(np.stack([x, y], axis=-1) @ turn(aperture.rotation), -1, 0)
    radius, half = np.hypot(x, y), aperture.diameter / 2
    match aperture.shape:
        case "square":
            beyond = np.maximum(np.abs(along), np.abs(across)) - half
        case "annular":
            beyond = np.maximum(radius - half, aperture.inner_diameter / 2 - radius)
        case "half_disc":
            beyond = np.maximum(radius - half, -along)
        case _:
            beyond = radius - half
    found: Array = np.clip(0.5 - beyond / step, 0.0, 1.0)
    return found
