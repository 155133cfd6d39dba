"""How a lens differs from a perfect one: what its glass adds to the path of light, leaves of contrast, or spreads.

Pupil axes are the camera's x, right, and y UP as the camera looks: the table of
a lens is written so, though rows of an image go down. A positive path is a
longer one. Light of the phase exp(+i k path), beside the defocus (q^2/2)(1/z +
1/v - 1/f), appears where its rays do: what passes a point of the pupil at which
the path grows upwards comes from higher up in the scene.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from radwrap.scene.zernike import Order


@dataclass(frozen=True, slots=True)
class Wavefront:
    """A lens's wavefront by Zernike polynomials of rms 1.

    Attributes
    ----------
    pupil_diameter : float
        Diameter of the disc that they belong to, about the opening's middle [m].
    orders : tuple
        n and m of each, see `zernike`; (n, m) and (n, -m) both, where there is one of them.
    coefficients : tuple of tuple of float
        Extra path of each [m], a row for each height.
    heights : tuple of float, optional
        Of points straight above the axis in the erect image, from 0 on and increasing [m]: the coefficients between
        them are straight, and turned with the azimuth of a place. Without heights all of the image has the one row.
    """

    pupil_diameter: float
    orders: tuple[Order, ...]
    coefficients: tuple[tuple[float, ...], ...]
    heights: tuple[float, ...] | None = None

    def at(self, x: float, y: float) -> tuple[float, ...]:
        """Coefficients [m] at a place of the erect image, x right and y up from the axis [m]."""
        if self.heights is None:
            return self.coefficients[0]
        height = math.hypot(x, y)
        values = [float(np.interp(height, self.heights, column)) for column in zip(*self.coefficients, strict=True)]
        if not height:
            return tuple(values)
        turn = math.atan2(y, x) - math.pi / 2
        by_order = dict(zip(self.orders, values, strict=True))
        return tuple(_turned(by_order, order, turn) for order in self.orders)


def _turned(coefficients: dict[Order, float], order: Order, turn: float) -> float:
    """Coefficient of a pattern that is turned from x towards y [rad]."""
    n, m = order
    if not m:
        return coefficients[order]
    c, s = math.cos(abs(m) * turn), math.sin(abs(m) * turn)
    other = coefficients[n, -m]
    return coefficients[order] * c + (other * s if m < 0 else -other * s)


@dataclass(frozen=True, slots=True)
class ContrastTable:
    """A lens's contrast as a share of the diffraction limit's.

    Attributes
    ----------
    frequencies : tuple of float
        From 0 on, increasing [m^-1].
    tangential, sagittal : tuple of tuple of float
        Shares of gratings whose frequency lies along the radius of the field, and across it, a row for each height; 1
        at the frequency 0, and held beyond the last.
    heights : tuple of float, optional
        On the sensor, from 0 on and increasing [m]; straight between them. Without heights all of the image has the
        one row, and both directions are alike.
    """

    frequencies: tuple[float, ...]
    tangential: tuple[tuple[float, ...], ...]
    sagittal: tuple[tuple[float, ...], ...]
    heights: tuple[float, ...] | None = None

    def at(self, x: float, y: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Tangential and sagittal shares at a place of the erect image, x right and y up from the axis [m]."""
        if self.heights is None:
            return self.tangential[0], self.sagittal[0]
        height, heights = math.hypot(x, y), self.heights
        tangential, sagittal = (
            tuple(float(np.interp(height, heights, column)) for column in zip(*rows, strict=True))
            for rows in (self.tangential, self.sagittal)
        )
        return tangential, sagittal


@dataclass(frozen=True, slots=True)
class PointSpread:
    """Light of a point in focus as it falls on the sensor, measured without a pixel's box.

    Attributes
    ----------
    sha256 : str
        Of the light.
    pitch : float
        Between samples, on the sensor [m].
    middle : tuple of float
        Row and column of its middle, where a perfect lens puts the point.
    reach : float
        Radius about that which holds nearly all of the light [m].
    rows : tuple of tuple of float
        Samples of the erect picture, not negative, the top row first.
    """

    sha256: str
    pitch: float
    middle: tuple[float, float]
    reach: float
    rows: tuple[tuple[float, ...], ...] = field(compare=False, repr=False)


LensGlass = Wavefront | ContrastTable | PointSpread
