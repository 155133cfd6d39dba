"""Sub-viewpoints inside the finite pinhole: where they lie and how much area each stands for (Sec. 3.1).

Every opening is described by two area-preserving coordinates: s, the share of
the area that lies further in, and t, the share of a full turn. A cell
[s0, s1] x [t0, t1] then has the area share (s1 - s0)(t1 - t0) whatever the
shape, and its sub-viewpoint is the cell's centroid, so that a layout
integrates constants and slopes exactly (slopes not so the sunflower in a half
disc, whose mean lies up to 1 % of the radius beside the centroid at N = 37).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal, assert_never

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.scene.camera import Aperture

Layout = Literal["rings", "hexagonal", "sunflower", "uneven"]
LAYOUTS: Final[tuple[Layout, ...]] = ("rings", "hexagonal", "sunflower", "uneven")

_GOLDEN_TURN: Final = (3 - math.sqrt(5)) / 2
_SQUARE_SAMPLES: Final = 48  # midpoints along each side of a cell, for centroids in a square
_AREA_SAMPLES: Final = (256, 1024)  # points in s and t that measure the cells of a lattice
_LATTICE_TRIALS: Final = 4000  # spacings that are tried for a lattice of N points

Cell = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Viewpoints:
    """Representative infinitesimal viewpoints of an opening.

    Attributes
    ----------
    positions : ndarray of float64, shape (n, 2)
        (u, v) in the pinhole plane, along the camera's x and y [m].
    weights : ndarray of float64, shape (n,)
        Area shares w_i = a_i/A; their sum is 1.
    area : float
        Area A that sets the exposure [m^2].
    """

    positions: NDArray[np.float64]
    weights: NDArray[np.float64]
    area: float

    def __len__(self) -> int:
        return len(self.weights)


def central_viewpoint(aperture: Aperture) -> Viewpoints:
    """The infinitesimal pinhole: all of the area's light through its centre."""
    return Viewpoints(np.zeros((1, 2)), np.ones(1), aperture.area)


def sub_viewpoints(aperture: Aperture, count: int, layout: Layout = "rings") -> Viewpoints:
    """Divide an opening into areas and give each its viewpoint.

    Parameters
    ----------
    aperture : Aperture
        A finite opening.
    count : int
        Number of sub-viewpoints, 1 or more.
    layout : str
        "rings": equal areas on concentric rings. "hexagonal": a lattice, each
        point with the area that is nearest to it. "sunflower": equal areas on
        two opposite spirals. "uneven": rings of equal width, hence of unequal
        areas, which shows that the weights work.

    Returns
    -------
    Viewpoints
        Positions and weights.

    Raises
    ------
    InputError
        If the opening is infinitesimal, or no such lattice has `count` points.
    """
    if aperture.is_infinitesimal:
        raise InputError("an infinitesimal pinhole has no sub-viewpoints", remedy='use `method="pinhole"`')
    if count < 1:
        raise InputError(f"cannot divide a pinhole into {count} parts", remedy="use `viewpoints=1` or more")
    match layout:
        case "sunflower":
            points, weights = _sunflower(aperture, count)
        case "hexagonal":
            points, weights = _lattice(aperture, count)
        case "rings" | "uneven":
            cells = _rings(aperture, count, even_areas=layout == "rings")
            points = np.array([_centroid(aperture, cell) for cell in cells])
            weights = np.array([(s1 - s0) * (t1 - t0) for s0, s1, t0, t1 in cells])
        case _:
            assert_never(layout)
    weights = weights / math.fsum(weights)
    return Viewpoints(points @ turn(aperture.rotation).T, weights, aperture.area)


def turn(angle: float) -> NDArray[np.float64]:
    """Matrix that turns (x, y) from x towards y."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s], [s, c]])


def place(aperture: Aperture, s: NDArray[np.float64], t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points of the opening, before its rotation, for area shares s and turn shares t; shape (..., 2) [m]."""
    if aperture.shape == "square":
        return _disc_to_square(np.sqrt(s), 2 * np.pi * t) * (aperture.diameter / 2)
    outer, inner = aperture.diameter / 2, aperture.inner_diameter / 2
    radius = np.sqrt(inner**2 + (outer**2 - inner**2) * s)
    angle = np.pi * (t - 0.5) if aperture.shape == "half_disc" else 2 * np.pi * t
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


def _disc_to_square(radius: NDArray[np.float64], angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Area-preserving concentric map of the unit disc onto the square [-1, 1]^2 (Shirley and Chiu 1997)."""
    quarter = np.floor((angle + np.pi / 4) / (np.pi / 2))
    across = radius * (angle - quarter * np.pi / 2) / (np.pi / 4)
    c, s = np.round(np.cos(quarter * np.pi / 2)), np.round(np.sin(quarter * np.pi / 2))
    return np.stack([c * radius - s * across, s * radius + c * across], axis=-1)


def _centroid(aperture: Aperture, cell: Cell) -> tuple[float, float]:
    s0, s1, t0, t1 = cell
    if aperture.shape == "square":
        n = _SQUARE_SAMPLES
        s = s0 + (s1 - s0) * (np.arange(n) + 0.5) / n
        t = t0 + (t1 - t0) * (np.arange(4 * n) + 0.5) / (4 * n)
        mean = place(aperture, *np.meshgrid(s, t)).reshape(-1, 2).mean(axis=0)
        return float(mean[0]), float(mean[1])
    outer, inner = aperture.diameter / 2, aperture.inner_diameter / 2
    r0, r1 = (math.sqrt(inner**2 + (outer**2 - inner**2) * s) for s in (s0, s1))
    turn, start = (math.pi, -math.pi / 2) if aperture.shape == "half_disc" else (2 * math.pi, 0.0)
    half_width = turn * (t1 - t0) / 2
    radius = 2 / 3 * (r1**3 - r0**3) / (r1**2 - r0**2) * math.sin(half_width) / half_width
    angle = start + turn * (t0 + t1) / 2
    return radius * math.cos(angle), radius * math.sin(angle)


def _rings(aperture: Aperture, count: int, *, even_areas: bool) -> list[Cell]:
    """Cells on concentric rings; equal areas, or equal ring widths with as many cells on each ring."""
    whole = aperture.shape in ("round", "square")
    centre = even_areas and whole and count % 2 == 1
    numbers = _cells_on_rings(aperture, count - centre, even_areas=even_areas, whole=whole)
    if centre:
        numbers = [1, *numbers]
    if even_areas:
        bounds = np.concatenate([[0], np.cumsum(numbers)]) / count
    else:
        outer, inner = 1.0, aperture.inner_diameter / aperture.diameter
        radii = np.linspace(inner, outer, len(numbers) + 1)
        bounds = (radii**2 - inner**2) / (outer**2 - inner**2)
    bounds[-1] = 1.0
    return [
        (float(bounds[ring]), float(bounds[ring + 1]), cell / number, (cell + 1) / number)
        for ring, number in enumerate(numbers)
        for cell in range(number)
    ]


def _cells_on_rings(aperture: Aperture, count: int, *, even_areas: bool, whole: bool) -> list[int]:
    """Numbers of cells from the innermost ring outwards: cells about as wide as deep.

    Whole openings get even numbers (point symmetry) where `count` is even;
    6, 12, 18, ... around a centre for the centred hexagonal numbers.
    """
    if count == 0:
        return []
    inner = aperture.inner_diameter / aperture.diameter
    share = 0.5 if aperture.shape == "half_disc" else 1.0
    depth = math.sqrt(math.pi * share * (1 - inner**2) / (count + 1))
    rings = max(1, round((1 - inner) / depth - (0.5 if whole and even_areas else 0.0)))
    step = 2 if aperture.shape != "half_disc" and count % 2 == 0 else 1
    rings = min(rings, count // step)
    if even_areas:
        # Circumference of each ring, in the same unit for all; a centre cell takes half a ring's depth.
        offset = 0.0 if whole and count % 6 == 0 and _is_triangular(count // 6) else 0.5
        shares = [inner / (1 - inner) * rings + ring + 1 - offset for ring in range(rings)]
    else:
        shares = [1.0] * rings
    return _apportion(count, shares, step)


def _is_triangular(number: int) -> bool:
    root = math.isqrt(8 * number + 1)
    return root * root == 8 * number + 1


def _apportion(count: int, shares: list[float], step: int) -> list[int]:
    """Whole multiples of `step`, each at least one, that add up to `count` (largest remainder)."""
    units = count // step
    ideal = [units * share / sum(shares) for share in shares]
    numbers = [max(1, math.floor(number)) for number in ideal]
    while sum(numbers) < units:
        numbers[max(range(len(numbers)), key=lambda i: ideal[i] - numbers[i])] += 1
    while sum(numbers) > units:
        numbers[max(range(len(numbers)), key=lambda i: (numbers[i] > 1, numbers[i] - ideal[i]))] -= 1
    return [number * step for number in numbers]


def _sunflower(aperture: Aperture, count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Equal areas on a spiral and its opposite; an odd one lies in the middle of the area order."""
    pairs, odd = divmod(count, 2)
    order = np.arange(pairs)
    s = (2 * order + 1 + odd) / count
    t = np.concatenate([np.mod(order * _GOLDEN_TURN, 1.0) / 2, np.mod(order * _GOLDEN_TURN, 1.0) / 2 + 0.5])
    points = place(aperture, np.concatenate([s, s]), t)
    if odd:
        points = np.vstack([np.array([_centroid(aperture, (0.0, 1 / count, 0.0, 1.0))]), points])
    return points, np.full(count, 1.0)


def _lattice(aperture: Aperture, count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points of a hexagonal lattice, moved to the centroids of the areas that are nearest to them."""
    seeds = _lattice_points(aperture, count)
    rows, columns = _AREA_SAMPLES
    s, t = np.meshgrid((np.arange(rows) + 0.5) / rows, (np.arange(columns) + 0.5) / columns)
    samples = place(aperture, s.ravel(), t.ravel())
    nearest = np.empty(len(samples), dtype=np.intp)
    block = max(1, 4_000_000 // count)
    for start in range(0, len(samples), block):
        part = samples[start : start + block]
        # |a - b|^2 without its constant part |a|^2
        nearest[start : start + block] = np.argmin((seeds**2).sum(axis=1) - 2 * part @ seeds.T, axis=1)
    sizes = np.bincount(nearest, minlength=count).astype(np.float64)
    if (sizes == 0).any():
        raise InputError(f"{count} sub-viewpoints are too many for the hexagonal layout", remedy='use `layout="rings"`')
    points = np.column_stack([np.bincount(nearest, samples[:, axis], count) / sizes for axis in (0, 1)])
    return points, sizes


def _lattice_points(aperture: Aperture, count: int) -> NDArray[np.float64]:
    reach = aperture.reach
    span = np.arange(-2 * math.isqrt(count) - 3, 2 * math.isqrt(count) + 4)
    i, j = (grid.ravel() for grid in np.meshgrid(span, span))
    unit = np.column_stack([i + j / 2, j * math.sqrt(3) / 2])
    # Areas of the lattice's hexagons are sqrt(3)/2 spacing^2; the best spacing makes them A/N.
    ideal = math.sqrt(aperture.area / count / (math.sqrt(3) / 2))
    spacings = ideal * np.exp(np.linspace(-0.5, 0.5, _LATTICE_TRIALS))
    numbers = np.array([int(_inside(aperture, unit * spacing).sum()) for spacing in spacings])
    right = np.flatnonzero(numbers == count)
    if right.size == 0:
        near = sorted(set(numbers[numbers > 0].tolist()), key=lambda number: (abs(number - count), number))[:4]
        raise InputError(
            f"no hexagonal layout has {count} sub-viewpoints",
            remedy=f'use `viewpoints` {", ".join(map(str, sorted(near)))}, or `layout="rings"`',
        )
    spacing = spacings[right[np.argmin(np.abs(np.log(spacings[right] / ideal)))]]
    points = unit * spacing
    inside = points[_inside(aperture, points)]
    order = np.lexsort((inside[:, 0], inside[:, 1], np.round(np.hypot(*inside.T) / reach, 9)))
    ordered: NDArray[np.float64] = inside[order]
    return ordered


def _inside(aperture: Aperture, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which points, before the opening's rotation, lie in it."""
    x, y = points.T
    half = aperture.diameter / 2
    radius = np.maximum(np.abs(x), np.abs(y)) if aperture.shape == "square" else np.hypot(x, y)
    ahead = x > 0 if aperture.shape == "half_disc" else np.full(len(x), True)
    inside: NDArray[np.bool_] = (radius < half) & (radius >= aperture.inner_diameter / 2) & ahead
    return inside
