"""Pictures of round and straight things whose light on each pixel is known in closed form, or by fine quadrature."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_INNER = 8  # places a side inside each pixel


def disc_share(distance: Array, radius: float, blur: float) -> Array:
    """Share of a disc of blur that lies in a disc, by the area that two circles have in common."""
    a, b = blur, radius
    d = np.maximum(distance, 1e-12)
    first = np.clip((d**2 + a**2 - b**2) / (2 * d * a), -1, 1)
    second = np.clip((d**2 + b**2 - a**2) / (2 * d * b), -1, 1)
    triangle = np.sqrt(np.maximum((-d + a + b) * (d + a - b) * (d - a + b) * (d + a + b), 0)) / 2
    both = a**2 * np.arccos(first) + b**2 * np.arccos(second) - triangle
    inside = d <= abs(b - a)
    return np.where(inside, min(1.0, (b / a) ** 2), np.where(d >= a + b, 0.0, both / (math.pi * a**2)))


def _places(shape: tuple[int, int]) -> tuple[Array, Array]:
    """Places inside all pixels, shape (rows, columns, places)."""
    inner = (np.arange(_INNER) + 0.5) / _INNER - 0.5
    v, u = np.indices(shape, dtype=np.float64)
    du, dv = (part.ravel() for part in np.meshgrid(inner, inner))
    return u[..., None] + du, v[..., None] + dv


def ring_picture(
    shape: tuple[int, int],
    centre: tuple[float, float],
    radii: tuple[float, ...],
    blur: float,
    levels: tuple[float, ...],
) -> Array:
    """Light of discs one in the other: `levels` from the outside inwards, one more than radii, the largest first."""
    v, u = np.indices(shape, dtype=np.float64)
    away = np.hypot(u - centre[0], v - centre[1])
    offset_u, offset_v = _places((1, 1))
    light = np.full(shape, levels[0])
    for radius, outer, inner in zip(radii, levels[:-1], levels[1:], strict=True):
        share = disc_share(away, radius, blur)  # 0 or 1 but for pixels that the blurred rim crosses
        rim = np.abs(away - radius) < blur + 1
        places = np.hypot(u[rim][:, None] + offset_u[0] - centre[0], v[rim][:, None] + offset_v[0] - centre[1])
        share[rim] = disc_share(places, radius, blur).mean(axis=-1)
        light = light + (inner - outer) * share
    return light


def straight_share(distance: Array, blur: float) -> Array:
    """Share of a disc of blur beyond a straight edge (Eq. 9)."""
    s = np.clip(distance / blur, -1, 1)
    return 1 - (np.arccos(s) - s * np.sqrt(1 - s * s)) / math.pi


def edge_picture(
    shape: tuple[int, int], angle: float, offset: float, blur: float, levels: tuple[float, float]
) -> Array:
    """Light of a straight edge u cos + v sin = offset: levels below and above."""
    u, v = _places(shape)
    share = straight_share(u * math.cos(angle) + v * math.sin(angle) - offset, blur).mean(axis=-1)
    return levels[0] + (levels[1] - levels[0]) * share


def stripe_picture(
    shape: tuple[int, int], angle: float, offset: float, width: float, *, blur: float, levels: tuple[float, float]
) -> Array:
    """Light of a stripe about u cos + v sin = offset."""
    below = edge_picture(shape, angle, offset - width / 2, blur, (0.0, 1.0))
    above = edge_picture(shape, angle, offset + width / 2, blur, (0.0, 1.0))
    return levels[0] + (levels[1] - levels[0]) * (below - above)


def noisy(light: Array, dice: np.random.Generator, gain: float = 0.04, read: float = 0.6) -> Array:
    """Whole gray levels of shot noise and read noise."""
    sigma = np.sqrt(np.maximum(light, 0) * gain + read**2)
    return np.clip(np.rint(light + sigma * dice.standard_normal(light.shape)), 0, 255)


def any_picture(shape: tuple[int, int], inside: Callable[[Array, Array], Array], blur: float, levels: Array) -> Array:
    """Light where `inside` gives the number of a level at each place, blurred by a disc, by fine quadrature."""
    from scipy.signal import fftconvolve

    fine, margin = 10, math.ceil(blur) + 1
    v, u = np.indices(((shape[0] + 2 * margin) * fine, (shape[1] + 2 * margin) * fine), dtype=np.float64)
    light = levels[inside((u + 0.5) / fine - 0.5 - margin, (v + 0.5) / fine - 0.5 - margin).astype(np.intp)]
    half = math.ceil(blur * fine) + 1
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    # A rim of the disc that is soft by one place stands for the share of the place that lies in it.
    disc = np.clip(blur * fine + 0.5 - np.hypot(x, y), 0, 1)
    blurred = fftconvolve(light, disc / disc.sum(), mode="same")
    rows, columns = shape
    cut = blurred[margin * fine : -margin * fine, margin * fine : -margin * fine]
    return np.asarray(cut.reshape(rows, fine, columns, fine).mean(axis=(1, 3)))
