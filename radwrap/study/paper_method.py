"""The paper's method at its fastest: all sub-viewpoints summed in memory, one tracer process a worker, no files.

What other methods are held against; `imaging.viewpoints` gives the same
pixels, but keeps each sub-viewpoint on the disk until the image is whole.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.methods.pieces import run_jobs
from radwrap.imaging.optics.aperture import Viewpoints
from radwrap.imaging.optics.view import PixelPlan, RayBlock, View, pixel_means, ray_blocks, traced
from radwrap.process import Programs


def summed_viewpoints(
    view: View,
    viewpoints: Viewpoints,
    plan: PixelPlan,
    programs: Programs,
    *,
    pixels: NDArray[np.intp] | None = None,
    progress: Callable[[int], None] | None = None,
) -> NDArray[np.float64]:
    """Area-weighted mean of L cos^4(theta) over the sub-viewpoints.

    Parameters
    ----------
    view : View
        The camera, who traces, and how many at a time.
    viewpoints : Viewpoints
        Where the sub-viewpoints lie, and their weights.
    plan : PixelPlan
        Rays of each pixel.
    programs : Programs
        Ended at the first failure.
    pixels : ndarray of int, shape (n,), optional
        Numbers of the pixels, row by row; default all.
    progress : callable, optional
        Is told how many rays were traced.

    Returns
    -------
    ndarray, shape (n,)
        [W m^-2 sr^-1]
    """
    mean = np.zeros(view.camera.sensor.pixels if pixels is None else len(pixels))

    def trace(part: int) -> None:
        # The same pixels of every sub-viewpoint: no other worker writes there, and their order is fixed.
        weights: deque[float] = deque()

        def blocks() -> Iterator[RayBlock]:
            for index, (point, weight) in enumerate(zip(viewpoints.positions, viewpoints.weights, strict=True)):
                place = (float(point[0]), float(point[1]))
                for block in ray_blocks(view.camera, place, plan, index, pixels, part=part, parts=view.workers):
                    weights.append(float(weight))
                    yield block

        for block, radiance in traced(view.tracer.trace, blocks()):
            mean[block.first : block.first + block.pixels] += weights.popleft() * pixel_means(block, radiance)
            if progress is not None:
                progress(len(radiance))

    run_jobs([partial(trace, part) for part in range(view.workers)], programs, view.workers)
    return mean
