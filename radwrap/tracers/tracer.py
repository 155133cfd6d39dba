"""The narrow waist: rays in, radiance out."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class Tracer(Protocol):
    """Whatever can tell the radiance along rays."""

    def trace(self, rays: Iterable[NDArray[np.float64]]) -> Generator[NDArray[np.float64]]:
        """Radiance along rays.

        Parameters
        ----------
        rays : iterable of ndarray, shape (n, 6)
            Blocks of origins [m] and directions (of any length) in the world.

        Yields
        ------
        ndarray, shape (n,)
            Radiance [W m^-2 sr^-1] for each block of rays, in the same order.

        Raises
        ------
        TracerError
            If the tracer fails, warns, or answers other than one finite
            number a ray.
        """
        ...

    def trace_with_distances(
        self, rays: Iterable[NDArray[np.float64]]
    ) -> Generator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """Radiance along rays, and the distance to the first surface [m]; blocks and errors as in `trace`.

        The distance is infinite where a ray meets nothing.
        """
        ...

    def distances(self, rays: Iterable[NDArray[np.float64]]) -> Generator[NDArray[np.float64]]:
        """Distance to the first surface alone [m], infinite where a ray meets nothing; cheaper than `trace`."""
        ...
