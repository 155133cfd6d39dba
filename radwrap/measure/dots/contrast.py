"""Bright dots or dark ones: gaps between dots form a lattice of the other contrast."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.measure.dots.order import Lattice
from radwrap.measure.dots.survey import patch_means

Field = NDArray[np.float64]

# Just outside the outermost dots lies board: beyond the rims of touching dots (0.5), within the margin [pitch].
JUST_OUTSIDE: Final = 0.75
PATCH: Final = 0.06
# Gray levels on the scale 0 (gap) to 1 (dot).
LIKE_A_DOT: Final = 0.5
CLEARLY_LESS: Final = 0.15

_STEPS: Final = ((1, 0), (-1, 0), (0, 1), (0, -1))


def likelier_contrast(values: Field, lattices: Mapping[int, Lattice]) -> int:
    """Tell which of two lattices consists of dots.

    Around dots the board goes on as it is between them; around the gaps
    between dots it does not. Half way between two round dots it is as between
    four of them, or nearly; gaps run into one another there. Where neither
    tells, there are more dots than gaps wholly among them.

    Parameters
    ----------
    values : ndarray, shape (rows, columns)
        Gray levels.
    lattices : Mapping
        Sign of the contrast -> lattice; at least one.

    Returns
    -------
    int
        +1 for bright dots, -1 for dark ones.
    """
    if len(lattices) == 1:
        return next(iter(lattices))
    (one, (outside_one, between_one)), (other, (outside_other, between_other)) = (
        (sign, _shares(sign * values, lattice)) for sign, lattice in lattices.items()
    )
    if (outside_one > LIKE_A_DOT) != (outside_other > LIKE_A_DOT):
        return one if outside_one < outside_other else other
    if abs(between_one - between_other) > CLEARLY_LESS:
        return one if between_one < between_other else other
    sizes = {sign: lattice.found + len(lattice.beyond) for sign, lattice in lattices.items()}
    return max(sizes, key=lambda sign: sizes[sign])


def _shares(values: Field, lattice: Lattice) -> tuple[float, float]:
    """Median gray level just outside the lattice, and half way between neighbours, from 0 (gap) to 1 (dot)."""
    nodes = {(int(c), int(r)) for c, r in (*lattice.board.tolist(), *lattice.beyond.tolist())}

    def gray(points: list[tuple[float, float]]) -> Field:
        return patch_means(values, lattice.homography, np.array(points, dtype=np.float64).reshape(-1, 2), PATCH)

    listed = sorted(nodes)
    dots = dict(zip(listed, gray([(c, r) for c, r in listed]), strict=True))
    # Gaps that lie among four dots, at their lower right.
    whole = [(c, r) for c, r in listed if {(c + 1, r), (c, r + 1), (c + 1, r + 1)} <= nodes]
    gaps = dict(zip(whole, gray([(c + 0.5, r + 0.5) for c, r in whole]), strict=True))
    usual = float(np.median(list(gaps.values()))) if gaps else float(values.min())
    outside: list[tuple[tuple[int, int], tuple[float, float]]] = []
    between: list[tuple[tuple[int, int], tuple[float, float]]] = []
    for c, r in listed:
        for across, down in _STEPS:
            if (c + across, r + down) in nodes:
                between.append(((c, r), (c + across / 2, r + down / 2)))
            else:
                outside.append(((c, r), (c + JUST_OUTSIDE * across, r + JUST_OUTSIDE * down)))
    shares = []
    for pairs in (outside, between):
        dot = np.array([dots[node] for node, _ in pairs])
        gap = np.array([_nearest_gap(gaps, node, usual) for node, _ in pairs])
        with np.errstate(divide="ignore", invalid="ignore"):
            share = (gray([place for _, place in pairs]) - gap) / (dot - gap)
        share = share[np.isfinite(share)]
        shares.append(float(np.median(share)) if len(share) else 0.0)
    return shares[0], shares[1]


def _nearest_gap(gaps: Mapping[tuple[int, int], float], node: tuple[int, int], usual: float) -> float:
    """Mean level of the gaps that a dot touches."""
    near = [gaps[node[0] + c, node[1] + r] for c in (-1, 0) for r in (-1, 0) if (node[0] + c, node[1] + r) in gaps]
    return sum(near) / len(near) if near else usual
