"""Finished pieces of a light basis: a row or more for each source of a view."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import EnvironmentFailure
from radwrap.imaging.methods.pieces import Pieces
from radwrap.imaging.optics.view import LitView

# Values side by side in a file: OpenImageIO reads no image wider than 2^20.
_WIDEST: Final = 1 << 16


@dataclass(frozen=True, slots=True, eq=False)
class BasisPieces:
    """Where they are.

    Attributes
    ----------
    folder : Path
        Of the pieces.
    name : str
        Hash of all that decides them.
    views : tuple of LitView
        Each piece is of one of them.
    kept : Pieces
        Holds them.
    """

    folder: Path
    name: str
    views: tuple[LitView, ...]
    kept: Pieces

    def path(self, kind: str, view: int) -> Path:
        """File of a piece."""
        return self.folder / f"{kind}_{view:05d}.exr"

    def read(self, kind: str, view: int) -> NDArray[np.float32] | None:
        """What was made of a view, a row or more for each of its sources; None where that is missing."""
        found = self.kept.read(self.path(kind, view).name, f"{self.name}-{kind}-{view}")
        if found is None:
            return None
        length = int(found[1]["length"])
        return found[0].reshape(-1, _folded(length))[:, :length]

    def each(self, kind: str, view: int) -> list[NDArray[np.float32]]:
        """The rows of each source of a view.

        Raises
        ------
        EnvironmentFailure
            If the piece is not there.
        """
        rows = self.read(kind, view)
        if rows is None:
            where = str(self.path(kind, view))
            raise EnvironmentFailure("was changed by somebody else", where=where, remedy="run again")
        return np.split(rows, len(self.views[view].names))

    def write(self, kind: str, view: int, rows: Iterable[NDArray[np.float64]]) -> None:
        """Keep what was made of a view; rows are made small as they come, and let go, as all together may be large."""
        small = [row.astype(np.float32) for row in rows]
        length = len(small[0])
        folded = np.zeros((len(small), _folded(length)), dtype=np.float32)
        small.reverse()
        for place in folded:
            place[:length] = small.pop()
        pixels = folded.reshape(-1, min(length, _WIDEST))
        self.kept.write(self.path(kind, view).name, pixels, f"{self.name}-{kind}-{view}", {"length": length})

    def due(self, kind: str) -> list[int]:
        """Views of which such a piece is missing."""
        return [view for view in range(len(self.views)) if self.read(kind, view) is None]


def _folded(length: int) -> int:
    """Length of a row that is folded to the width that an image file may have."""
    return length if length <= _WIDEST else -(-length // _WIDEST) * _WIDEST
