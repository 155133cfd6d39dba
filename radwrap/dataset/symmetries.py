"""Turns of a mesh that change nothing that is seen of it: what BOP's errors of a pose need to know.

Poses that differ by such a turn look the same, and no algorithm can tell them apart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.scene.mesh import Mesh

_MOST_TURNS: Final = 60  # of the icosahedron, the largest group of turns that is not about one axis alone
_FEW: Final = 24  # turns about an axis of a continuous symmetry that are looked at
_SAMPLES: Final = 20_000
# Of two numbers whose multiples fill a square evenly (Roberts' R2 sequence).
_STEPS: Final = (0.7548776662466927, 0.5698402909980532)
_ALIKE: Final = 0.02  # of the diameter: how far a turned mesh may lie from itself; meshes of round parts have corners
_MM: Final = 1e3
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Symmetry:
    """A turn that maps a part onto itself.

    Attributes
    ----------
    target : str
        Name of the part.
    axis : tuple of float
        Its direction in the mesh's own frame, of length 1.
    through : tuple of float
        A point of the axis [m].
    fold : int or None
        How many times the part looks the same in a turn; None for any angle.
    where : str
        For messages.
    """

    target: str
    axis: tuple[float, float, float]
    through: tuple[float, float, float]
    fold: int | None
    where: str

    def turned(self, share: float) -> Array:
        """Matrix of a turn about the axis by a share of a whole one, shape (4, 4) [m]."""
        from scipy.spatial.transform import Rotation

        matrix = np.eye(4)
        matrix[:3, :3] = Rotation.from_rotvec(2 * math.pi * share * np.array(self.axis)).as_matrix()
        matrix[:3, 3] = np.array(self.through) - matrix[:3, :3] @ np.array(self.through)
        return matrix


def check_symmetry(one: Symmetry, mesh: Mesh) -> None:
    """See that a mesh looks the same after each turn.

    Raises
    ------
    InputError
        If its corners then lie away from its surface by more than 2 % of its diameter.
    """
    from scipy.spatial import cKDTree

    surface = _samples(mesh)
    corners = np.asarray(mesh.vertices)
    diameter = float(np.linalg.norm(np.ptp(corners, axis=0)))
    tree = cKDTree(surface)
    turns = one.fold or _FEW
    for number in range(1, turns):
        matrix = one.turned(number / turns)
        away = float(tree.query(corners @ matrix[:3, :3].T + matrix[:3, 3])[0].max())
        if away > _ALIKE * diameter:
            raise InputError(
                f'"{one.target}" is another after a turn by {360 * number / turns:g} degrees: a corner lies '
                f"{away * _MM:.3g} mm beside the mesh",
                where=one.where,
                remedy="correct axis, through or fold",
            )


def _samples(mesh: Mesh) -> Array:
    """Points all over a surface, the same each time."""
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.faces)]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    number = np.arange(_SAMPLES) + 0.5
    face = np.searchsorted(np.cumsum(areas) / areas.sum(), number / _SAMPLES).clip(max=len(areas) - 1)
    a, b = np.sort([number * step % 1 for step in _STEPS], axis=0)
    shares = np.stack([a, b - a, 1 - b], axis=1)
    return np.concatenate([(shares[:, :, np.newaxis] * corners[face]).sum(axis=1), corners.reshape(-1, 3)])


def told_symmetries(found: Sequence[Symmetry]) -> dict[str, Any]:
    """BOP's entries of a model: all turns of the group that the discrete ones make, and the axes of the others [mm].

    Raises
    ------
    InputError
        If axes make more turns than any part has.
    """
    turns = _group([one for one in found if one.fold is not None])
    axes = [one for one in found if one.fold is None]
    told: dict[str, Any] = {}
    if turns:
        told["symmetries_discrete"] = [_in_mm(matrix).ravel().tolist() for matrix in turns]
    if axes:
        told["symmetries_continuous"] = [
            {"axis": list(one.axis), "offset": [value * _MM for value in one.through]} for one in axes
        ]
    return told


def _group(found: Sequence[Symmetry]) -> list[Array]:
    """All products of turns but the one that turns nothing."""
    made = [np.eye(4)]
    makers = [one.turned(1 / one.fold) for one in found if one.fold is not None]
    due = list(made)
    most = max([_MOST_TURNS, *(one.fold or 0 for one in found)])
    while due:
        last = due.pop()
        for maker in makers:
            product = maker @ last
            if not any(np.allclose(product, known, atol=1e-9) for known in made):
                made.append(product)
                due.append(product)
            if len(made) > 2 * most:
                raise InputError(
                    f"make more than {2 * most} turns together, which no part has",
                    where=found[-1].where,
                    remedy="correct axes and folds",
                )
    return made[1:]


def _in_mm(matrix: Array) -> Array:
    told = matrix.copy()
    told[:3, 3] *= _MM
    return told
