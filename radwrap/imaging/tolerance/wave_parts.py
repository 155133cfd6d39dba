"""What waves add to an image that rays made, before Eq. 5: their footprint less that of rays, over the central image.

Light of different points adds as intensity, whatever made the image: so one
correction serves all methods. The central image is that of the image's own
rays where these suffice, see `own_rays`; else it is traced anew, as the kernel
traces it. It is wider by a guard band; what waves send farther comes from a
coarse image around it. Where rays go is decided once, in the light of all
sources; the very same rays then tell what waves add to the light of each.
"""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.methods.central import Cells, CentralImage, EdgeSampling, central_image, edge_sampling
from radwrap.imaging.methods.kernel import (
    GRID_SHARE,
    NO_CELLS,
    coarsened,
    decide_tile,
    is_smooth,
    layer_places,
)
from radwrap.imaging.methods.transforms import Room
from radwrap.imaging.optics.view import View
from radwrap.imaging.tolerance.own_rays import OwnRays, traced_beside
from radwrap.imaging.tolerance.wave_behind import Layout, places_seen
from radwrap.imaging.tolerance.wave_far import far_change, far_light
from radwrap.imaging.tolerance.wave_gather import gathered, kept_transforms
from radwrap.imaging.tolerance.wave_plan import WavePlan, bare, known_to
from radwrap.kept import Kept
from radwrap.random_streams import Rendering

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Rect = tuple[int, int, int, int]
Job = Callable[[], None]
Changed = tuple[Array, Array, Array]  # see `wave_tile`
Changes = Callable[[int], Iterator[tuple[int, Changed]]]  # of a tile: which replicate, and what its waves add

# How far light may be off that is laid out as if what lies behind went on: so much of what that changes, and of what
# waves do to light behind an edge that is not even, were it as far as it is and as near as the edge. By Fresnel's
# integral, scripts/wave_occlusion.py, where light is even behind the edge .01 to .03 of the first, and by renders; more
# only of what is less than .5 % of the light (.27 of .15 %). Of the second .1 to 1.5 of what `WavePlan.cut_by_edge` has
# of it, and 1.8 by renders.
OF_HIDING: Final = 0.06
OF_UNEVEN: Final = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class WaveParts:
    """What waves add to the light of one image, and in single precision how far that may be off.

    Attributes
    ----------
    change : ndarray, shape (replicates, rows, columns)
        Of mean radiance, by independent rays [W m^-2 sr^-1].
    cells : ndarray, shape (rows, columns)
        What the cells' size may change of that, where a near thing hides a far one how that is laid out, and of a lens
        whose glass differs over the field how places on a grid are mixed.
    lasting : ndarray, shape (replicates, rows, columns)
        The part of it that the cells' size does not change, by each set of rays.
    beyond : ndarray, shape (rows, columns)
        What light may change that comes from farther than was looked at.
    rays : int
        How many it took.
    sampling : EdgeSampling
        Rays in cells that differ much, which all tiles had in common.
    by_own_rays : bool
        Whether each set of rays is that of one replicate of the image.
    """

    change: Array
    cells: Single
    lasting: Single
    beyond: Single
    rays: int
    sampling: EdgeSampling
    by_own_rays: bool = False


def in_turn(jobs: list[Job]) -> None:
    """Call jobs one after the other."""
    for job in jobs:
        job()


def wave_parts(
    view: View,
    plans: Sequence[tuple[View, WavePlan]],
    replicates: int,
    *,
    progress: Callable[[int], None],
    run: Callable[[list[Job]], None] = in_turn,
    own: OwnRays | None = None,
) -> WaveParts:
    """What waves add to the light of a view that does not tell its sources apart.

    Parameters
    ----------
    view : View
        In the light of all sources.
    plans : sequence of (View, WavePlan)
        The light of each wavelength, and its plan, all of the same rays: see `WavePlan.at`.
    replicates : int
        How many sets of them, 2 at least.
    progress : callable
        Is told how many rays were traced.
    run : callable
        Calls jobs, some of them at a time perhaps, as `run_jobs` does; raises where the run is to end.
    own : OwnRays, optional
        Of as many replicates of the image that waves are added to, if they suffice for the one plan that there is.
    """
    plan = plans[0][1]
    sensor = plan.kernel.camera.sensor
    change = np.zeros((replicates, sensor.rows, sensor.columns))
    cells, lasting = np.zeros(change.shape[1:], dtype=np.float32), np.zeros(change.shape, dtype=np.float32)
    counted, guard = plan.rays, threading.Lock()

    def count(rays: int) -> None:
        nonlocal counted
        with guard:
            counted += rays
        progress(rays)

    def add_near() -> EdgeSampling:
        """Transforms, which take much memory, go at the end."""
        if own is None:
            sampling, each = _anew(view, plans, replicates, count, run)
        else:
            sampling, each = _by_own_rays(view, plan, own, count, run)

        def trace(tile: int) -> None:
            r0, r1, c0, c1 = plan.kernel.tiles[tile]
            for replicate, (found, of_cells, of_hiding) in each(tile):
                change[replicate, r0:r1, c0:c1] += found
                cells[r0:r1, c0:c1] += of_cells / replicates
                lasting[replicate, r0:r1, c0:c1] += of_hiding

        run([partial(trace, tile) for tile in range(len(plan.kernel.tiles))])
        return sampling

    sampling = add_near()
    beyond = np.zeros(change.shape, dtype=np.float32)

    def add_far(replicate: int) -> None:
        on_sensor = None if own is None else partial(own.means, replicate=replicate)
        for lit, of_light in plans:
            (around,) = far_light(replace(lit, workers=1), plan, replicate, count, on_sensor=on_sensor)
            far, farther = far_change(of_light, around)
            change[replicate] += far
            beyond[replicate] += farther / replicates

    run([partial(add_far, replicate) for replicate in range(replicates)])
    return WaveParts(change, cells, lasting, beyond.sum(axis=0), counted, sampling, own is not None)


def _anew(
    view: View,
    plans: Sequence[tuple[View, WavePlan]],
    replicates: int,
    count: Callable[[int], None],
    run: Callable[[list[Job]], None],
) -> tuple[EdgeSampling, Changes]:
    """Decide where rays go; gives what traces them, and gathers, tile by tile."""
    plan = plans[0][1]
    tiles, decided = range(len(plan.kernel.tiles)), dict[int, Cells]()

    def decide(tile: int) -> None:
        decided[tile] = wave_cells(replace(view, workers=1), plan, tile, count)

    run([partial(decide, tile) for tile in tiles])
    sampling = sampling_of_all(plan, decided)
    finest, transforms = plan.kernel.grid.levels, kept_transforms()
    alike = replace(view, workers=1) if len(plans) > 1 else None

    def each(tile: int) -> Iterator[tuple[int, Changed]]:
        cells = decided[tile].with_rays(finest, sampling)
        for replicate, (lit, of_light) in itertools.product(range(replicates), plans):
            one, which = replace(lit, workers=1), (tile, replicate)
            for changed in wave_tile(one, [of_light], which, cells, count, transforms=transforms, of_all=alike):
                yield replicate, changed

    return sampling, each


def _by_own_rays(
    view: View, plan: WavePlan, own: OwnRays, count: Callable[[int], None], run: Callable[[list[Job]], None]
) -> tuple[EdgeSampling, Changes]:
    """As `_anew`, but rays are traced beside the sensor only."""
    one, transforms = replace(view, workers=1), kept_transforms()
    beside = traced_beside(one, plan, own.replicates, count, run)

    def each(tile: int) -> Iterator[tuple[int, Changed]]:
        if _is_smooth(plan, tile):
            for changed in _smooth_tile(one, [plan], plan.kernel.tiles[tile]):
                yield from ((replicate, changed) for replicate in range(own.replicates))
            return
        images = [own.central(plan, tile, seen, replicate) for replicate, seen in enumerate(beside.seen)]
        depths = [image.magnification for image in images if image.magnification is not None]
        layout = _laid_out([plan], np.mean(depths, axis=0)) if depths else None
        for replicate, central in enumerate(images):
            rough = coarsened(central)
            for changed in waves_of([plan], tile, central, rough, transforms=transforms, layout=layout):
                yield replicate, changed

    return beside.sampling, each


def wave_cells(view: View, plan: WavePlan, tile: int, progress: Callable[[int], None]) -> Cells:
    """Find out, in the light of all sources, which cells of the central image a tile needs."""
    if _is_smooth(plan, tile):
        return NO_CELLS
    seed = (plan.seed, Rendering.WAVE_CELLS, tile)
    found = decide_tile(bare(view), plan.kernel, tile, seed, progress, smooth=plan.smooth)
    return found if plan.sampling is None else found.with_rays(plan.kernel.grid.levels, plan.sampling)


def _is_smooth(plan: WavePlan, tile: int) -> bool:
    """Whether a tile gathers from smooth blocks only, of a lens whose glass moves light to no side."""
    # Where it does, the sum of the weights does not tell that.
    symmetric = plan.kernel.camera.lens is None or plan.kernel.camera.lens.glass is None
    return symmetric and is_smooth(plan.smooth, plan.kernel, plan.kernel.tiles[tile])


def sampling_of_all(plan: WavePlan, decided: Mapping[int, Cells]) -> EdgeSampling:
    """Rays in cells that differ much, the same for all tiles, by what is known of some, by number."""
    if plan.sampling is not None:
        return plan.sampling
    places = [
        (cells, plan.kernel.tiles[tile]) for tile, cells in sorted(decided.items())
    ]  # the same sum, whatever the workers
    return edge_sampling(plan.kernel.grid, [(cells, (r1 - r0) * (c1 - c0)) for cells, (r0, r1, c0, c1) in places])


def wave_tile(
    view: View,
    plans: Sequence[WavePlan],
    which: tuple[int, int],
    cells: Cells,
    progress: Callable[[int], None],
    *,
    transforms: Kept,
    of_all: View | None = None,
) -> Iterator[Changed]:
    """Trace a tile, and gather what waves add to each source that the view tells apart.

    Parameters
    ----------
    view : View
        In the light of all sources or of some.
    plans : sequence of WavePlan
        Of each source that the view tells apart, all of the same rays.
    which : tuple of int
        Numbers of the tile and of the replicate.
    cells : Cells
        Of the tile, see `wave_cells`.
    progress : callable
        Is told how many rays were traced.
    transforms : Kept
        Of the image's plan, or of the tile; see `kept_transforms`.
    of_all : View, optional
        In the light of all, where the view has that of one: its depths are those that count.

    Yields
    ------
    change, cells, lasting : ndarray, shape (rows, columns)
        See `WaveParts`; without the light from far away.
    """
    plan, (tile, _) = plans[0], which
    if not cells.samples:
        yield from _smooth_tile(view, plans, plan.kernel.tiles[tile])
        return
    images = wave_images(view, plan, which, cells, progress, of_all=of_all)
    yield from waves_of(plans, tile, *images, transforms=transforms)


def wave_images(
    view: View,
    plan: WavePlan,
    which: tuple[int, int],
    cells: Cells,
    progress: Callable[[int], None],
    *,
    of_all: View | None = None,
) -> tuple[CentralImage, CentralImage]:
    """Trace what a tile gathers from: in its cells, and in such of twice the size; parameters as of `wave_tile`."""
    (tile, replicate), grid = which, plan.kernel.grid
    key = (plan.seed, Rendering.WAVE_RAYS, replicate, tile)

    def seen_by(view: View, like: CentralImage | None = None) -> CentralImage:
        smooth = known_to(view, plan)
        return central_image(bare(view), grid, cells, seed=key, progress=progress, like=like, smooth=smooth)

    like = seen_by(of_all) if of_all is not None and grid.with_depth else None
    central = seen_by(view, like)
    summed = central if central.values.ndim == 2 else replace(central, values=central.values.sum(axis=0))
    return central, coarsened(central, coarsened(like or summed))


def waves_of(
    plans: Sequence[WavePlan],
    tile: int,
    central: CentralImage,
    coarser: CentralImage,
    *,
    transforms: Kept,
    layout: Layout | None = None,
) -> Iterator[Changed]:
    """Gather what waves add to each source of a central image, given that in cells of twice the size too.

    A layout that several images share says what hides, else it is found in this one. Yields as `wave_tile`.
    """
    plan, room = plans[0], Room()
    place, cell = plan.kernel.tiles[tile], plan.kernel.grid.cell
    layers = plan.kernel.layers
    fine_places, rough_places = (places_seen(image.magnification, layers) for image in (central, coarser))
    if layout is None and central.magnification is not None:
        layout = _laid_out(plans, central.magnification)
    each = (array.reshape(-1, *array.shape[-2:]) for array in (central.values, coarser.values))
    for of_source, fine, rough in zip(plans, *each, strict=True):
        # Cells that do not resolve what waves do say little of what smaller ones would change.
        share = GRID_SHARE if cell * plan.pitch <= of_source.waves.blur else 1.0
        seen, rough_seen = ((fine, fine_places),), ((rough, rough_places),)
        behind = None if layout is None else layout.going_on(fine)
        found, of_field = gathered(of_source, central, seen, cell, place, transforms=transforms, room=room)
        seen_only = found
        if behind is not None:
            found, of_field = gathered(of_source, central, behind, cell, place, transforms=transforms, room=room)
        of_cells = share * (
            gathered(of_source, coarser, rough_seen, 2 * cell, place, transforms=transforms, room=room)[0] - seen_only
        )
        of_hiding = OF_HIDING * (found - seen_only)
        if layout is not None and layout.edges:
            reach, by_rays = of_source.cut_by_edge(layout.apart)
            far, near = (
                gathered(of_source, central, light, cell, place, transforms=transforms, room=room)[0]
                for light in layout.uneven(fine, reach)
            )
            of_hiding += OF_UNEVEN * by_rays * np.copysign(np.hypot(far, near), far)
        off = of_cells + of_hiding
        yield found, off + np.copysign(of_field, off), of_hiding + np.copysign(of_field, of_hiding)


def _laid_out(plans: Sequence[WavePlan], magnification: Array) -> Layout:
    """What hides in a central image, and how far around its edges each source's light is cut."""
    layout = Layout.of(magnification, plans[0].kernel.layers)
    return layout.cut_within(of_source.cut_by_edge(layout.apart)[0] for of_source in plans) if layout.edges else layout


def _smooth_tile(view: View, plans: Sequence[WavePlan], place: Rect) -> Iterator[Changed]:
    """A tile of smooth blocks only: the sum of the weights is what counts where light changes evenly."""
    known = known_to(view, plans[0])
    if known is None:
        raise TypeError("no block of this view is known to be smooth")
    values, m = known.in_pixels(place)
    layers, cell = plans[0].kernel.layers, plans[0].kernel.grid.cell
    at_layers = np.zeros(m.shape) if len(layers) == 1 else layer_places(layers, m)
    for of_source, light in zip(plans, values.reshape(-1, *m.shape), strict=True):
        (of_field,) = of_source.weights.lens_field.places
        sums = [float(each.sum()) for each in of_source.weights.near(cell, (0, 0), of_field)]
        yield np.interp(at_layers, np.arange(len(sums)), sums) * light, np.zeros(m.shape), np.zeros(m.shape)
