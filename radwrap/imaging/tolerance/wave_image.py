"""What waves add to an image that was made by rays: their footprint less that of rays, over the central image.

Light of different points adds as intensity, whatever made the image: so one
correction serves all methods. The central image is traced anew, twice, as the
kernel traces it, but wider by a guard band; what waves send farther comes from a
coarse image around it. The two tell the noise; cells of twice the size tell
what the cells' size leaves open.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.methods.central import CentralImage, central_image
from radwrap.imaging.methods.kernel import (
    GRID_SHARE,
    KernelPlan,
    coarsened,
    decide_tile,
    fast_length,
    lattice,
    layer_shares,
    plan_kernel,
)
from radwrap.imaging.optics.footprint import Footprint, laid_out
from radwrap.imaging.optics.view import View, trace_rays
from radwrap.imaging.optics.wave_footprint import both_weights
from radwrap.imaging.optics.waves import Waves, rim
from radwrap.imaging.response.sensor import unclipped_gray
from radwrap.imaging.tolerance.bounds import NOTHING, Bounded, mean_square_of_differences
from radwrap.random_streams import Rendering, generator
from radwrap.scene.camera import Aperture

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Rect = tuple[int, int, int, int]

_LOOK: Final = 64  # rays along a side of a look at the depths
_BASE_SHARE: Final = 1.0  # of the wave's length, a base cell
# The guard band in wave's lengths. Light that waves send farther is taken from a coarse image, which is so many times
# as wide; what goes farther still is counted as an error.
_NEAR: Final = 6.0
_FAR: Final = 30.0
_BLOCKS: Final = 4  # of the coarse image, in a guard band's width
_FEWEST_BLOCK: Final = 2.0  # px
# The weights are made on a grid so many times as wide as they are taken from, of so many cells at most.
_AROUND: Final = 8
_MOST_AROUND: Final = 1 << 21
# Steps along a straight edge's tail, and across it: it is as wide as the edge.
_STEPS: Final = 4096
_BESIDE: Final = 8
_QUANTILE: Final = 0.995
_MOST_BLOCKS: Final = 1 << 18


@dataclass(frozen=True, slots=True, eq=False)
class WaveImage:
    """What waves add to an image, and how far that may be off.

    Attributes
    ----------
    change : ndarray, shape (rows, columns)
        Of mean radiance [W m^-2 sr^-1].
    noise : Bounded
        Mean square of what the number of rays adds [gray level^2].
    cells : float
        Mean square of what the cells' size adds [gray level^2].
    tails : float
        What light may change that comes from farther than was looked at, rms [gray level].
    quantile : float
        Error by all three that 99.5 % of the pixels stay below [gray level].
    rays : int
        How many it took.
    """

    change: Array
    noise: Bounded
    cells: float
    tails: float
    quantile: float
    rays: int


@dataclass(frozen=True, slots=True, eq=False)
class _Weights:
    """What waves change of the weights of cells within reach of a pixel, made once for all tiles."""

    plan: KernelPlan
    waves: Waves
    made: dict[tuple[float, tuple[int, int]], list[Array]]

    def near(self, cell: float, phase: tuple[int, int]) -> list[Array]:
        """Of each layer, shape (2 rows + 1, 2 columns + 1); cells of a pixel in the middle."""
        if (cell, phase) not in self.made:
            self.made[cell, phase] = [self._cut(layer, cell, phase) for layer in self.plan.layers]
        return self.made[cell, phase]

    def laid_out(self, cell: float, shape: tuple[int, int], phase: tuple[int, int]) -> Iterator[Complex]:
        """Their transforms in a field of a shape, of each layer."""
        for near in self.near(cell, phase):
            corner = (-(near.shape[0] // 2), -(near.shape[1] // 2))
            yield np.fft.rfft2(laid_out(Footprint(corner, near), shape))

    @property
    def share(self) -> float:
        """Share of the light that goes farther."""
        near = self.near(self.plan.grid.cell, (0, 0))
        return -float(np.mean([each.sum() for each in near]))

    def _cut(self, layer: float, cell: float, phase: tuple[int, int]) -> Array:
        columns, rows = (math.ceil(far / cell) for far in self.plan.reach_px)
        # What goes round comes in from far away: little, spread widely.
        wide = max(1, min(_AROUND, math.isqrt(_MOST_AROUND // (4 * rows * columns))))
        shape = fast_length(2 * wide * rows + 1), fast_length(2 * wide * columns + 1)
        rays, passed = both_weights(self.waves, self.plan.camera, layer, cell, shape, phase=phase)
        change = np.fft.fftshift(np.fft.irfft2(passed - rays, shape))
        r, c = (size // 2 for size in shape)
        change = change[r - rows : r + rows + 1, c - columns : c + columns + 1]
        down, across = (np.linspace(-1, 1, 2 * size + 1) ** 2 for size in (rows, columns))
        return np.where(down[:, np.newaxis] + across[np.newaxis] > 1, 0.0, change)


def wave_image(
    view: View,
    wavelength: float,
    radiance: Array,
    *,
    aim: float,
    seed: int,
    progress: Callable[[int], None],
    check: Callable[[], None],
) -> WaveImage:
    """Trace and gather what waves add to an image.

    Parameters
    ----------
    view : View
        Whose rays; its opening is finite.
    wavelength : float
        Of the light [m].
    radiance : ndarray, shape (rows, columns)
        The image by rays, through which Eq. 5 is taken [W m^-2 sr^-1].
    aim : float
        Rms error of one of both replicates to aim at [gray level].
    seed : int
        Of all that is drawn.
    progress, check : callable
        Is told how many rays were traced; raises where the run is to end.
    """
    view = replace(view, smooth=None, prover=None)
    camera, sensor = view.camera, view.camera.sensor
    waves = Waves(camera.aperture, camera.image_distance, wavelength)
    pitch = min(sensor.pixel_width, sensor.pixel_height)
    met, rays = _depths(view, seed)
    plan = plan_kernel(view, met, aim)
    # Where waves blur by many pixels rays go on in steps as wide, and only where light differs in finer ones.
    wider = max(0, math.floor(math.log2(_BASE_SHARE * waves.blur / pitch / plan.grid.base)))
    plan = replace(plan, grid=replace(plan.grid, base=plan.grid.base << wider, levels=plan.grid.levels + wider))
    reach = max(plan.reach_px)
    guard = max(_NEAR * waves.blur / pitch, 1.0)
    plan = replace(plan, guard=guard)
    weights = _Weights(plan, waves, {})
    change = np.zeros((2, sensor.rows, sensor.columns))
    cells = np.zeros((sensor.rows, sensor.columns))
    for tile, place in enumerate(plan.tiles):
        check()
        decided = decide_tile(view, plan, tile, (seed, Rendering.WAVE_CELLS, tile), progress)
        rays += decided.rays
        r0, r1, c0, c1 = place
        for replicate in range(2):
            key = (seed, Rendering.WAVE_RAYS, replicate, tile)
            central = central_image(view, plan.grid, decided, seed=key, progress=progress)
            rays += central.rays
            found = _gathered(plan, weights, central, plan.grid.cell, place)
            change[replicate, r0:r1, c0:c1] = found
            coarse = _gathered(plan, weights, coarsened(central), 2 * plan.grid.cell, place)
            cells[r0:r1, c0:c1] += GRID_SHARE * (coarse - found) / 2
    far, tails, more = _far(view, plan, waves, weights.share, seed)
    whole = change.mean(axis=0) + far
    to_exposure = view.exposure_of_radiance

    def gray(values: Array) -> Array:
        # Where the image is saturated nothing changes but by light that falls below it.
        levels: Array = np.minimum(
            unclipped_gray(np.maximum(values, 0.0) * to_exposure, sensor), sensor.saturation_gray
        )
        return levels

    made = radiance + whole
    apart = (gray(made + (change[1] - change[0]) / 2) - gray(made))[np.newaxis]
    block = math.ceil(max(reach, waves.blur / pitch)) + 1
    noise = mean_square_of_differences(apart, (block, block)) if apart.any() else NOTHING
    changed = gray(made + cells) - gray(made)
    beyond = gray(made + tails) - gray(made)
    scale = math.sqrt(noise.upper / noise.mean) if noise.mean > 0 else 1.0
    quantile = float(np.quantile(np.abs(apart[0]) * scale + np.abs(changed) + np.abs(beyond), _QUANTILE))
    square, rest = float((changed**2).mean()), math.sqrt(float((beyond**2).mean()))
    return WaveImage(whole, noise, square, rest, quantile, rays + more)


def _depths(view: View, seed: int) -> tuple[Array, int]:
    """Magnifications of what is in view, by some central rays."""
    camera, sensor = view.camera, view.camera.sensor
    rows, columns = (min(size, _LOOK) for size in (sensor.rows, sensor.columns))
    row, column = np.indices((rows, columns))
    inside = generator(seed, Rendering.WAVES).random((2, rows, columns))
    v, u = (row + inside[0]) * sensor.rows / rows - 0.5, (column + inside[1]) * sensor.columns / columns - 0.5
    _, met = trace_rays(view, None, u.ravel(), v.ravel(), with_depth=True)
    return met[met > camera.shear], rows * columns


def _gathered(plan: KernelPlan, weights: _Weights, central: CentralImage, cell: float, place: Rect) -> Array:
    """What waves add to each pixel of a tile."""
    rows, columns = (fast_length(size) for size in central.values.shape)
    shape = rows, columns
    shares = [1.0] if central.magnification is None else layer_shares(plan.layers, central.magnification)
    spectra = [np.fft.rfft2(central.values * share, shape) for share in shares]
    found = np.empty((place[1] - place[0], place[3] - place[2]))
    step = max(1, round(cell))
    for phase in np.ndindex(step, step):
        at_phase = weights.laid_out(cell, shape, (phase[0], phase[1]))
        field = np.fft.irfft2(
            sum(spectrum * np.conj(each) for spectrum, each in zip(spectra, at_phase, strict=True)), shape
        )
        pixels = lattice(cell, place, phase)
        row, column = (np.floor(at / cell).astype(int) - first for at, first in zip(pixels, central.first, strict=True))
        found[np.ix_(pixels[0] - place[0], pixels[1] - place[2])] = field[row[:, np.newaxis], column]
    return found


def _far(view: View, plan: KernelPlan, waves: Waves, share: float, seed: int) -> tuple[Array, Array, int]:
    """Light that comes from beyond the guard band, what may come from farther than is looked at, and rays."""
    from scipy.ndimage import map_coordinates
    from scipy.signal import fftconvolve

    sensor = plan.camera.sensor
    pitch = min(sensor.pixel_width, sensor.pixel_height)
    near = min(plan.reach_px)
    far = _FAR * near
    beyond = min(waves.tail(far * pitch), abs(share))
    block = max(near / _BLOCKS, _FEWEST_BLOCK)
    while (sensor.rows + 2 * far) * (sensor.columns + 2 * far) / block**2 > _MOST_BLOCKS:
        block *= 2
    margin = math.ceil(far / block) + 1
    rows, columns = (math.ceil(size / block) + 2 * margin for size in (sensor.rows, sensor.columns))
    inside = generator(seed, Rendering.WAVE_RAYS, 2).random((2, rows, columns))
    v, u = ((at - margin + inside[axis]) * block - 0.5 for axis, at in enumerate(np.indices((rows, columns))))
    values, _ = trace_rays(view, None, u.ravel(), v.ravel())
    # What a pixel gathers from the light around it: the kernel is turned, and alike from both sides.
    blur = near - (plan.guard or 0.0)
    rim_at = blur / math.sqrt(2) if waves.aperture.shape == "square" else blur
    kernel = _tail_kernel(waves.aperture, rim_at / block, near / block, far / block)
    gathered = fftconvolve(values.reshape(rows, columns), kernel, mode="valid")
    at = (np.arange(size) + 0.5 for size in (sensor.rows, sensor.columns))
    places = np.meshgrid(*(place / block - 0.5 for place in at), indexing="ij")
    mean = map_coordinates(gathered, places, order=1, mode="nearest")
    return share * mean, beyond * mean, rows * columns


def _tail_kernel(aperture: Aperture, rim_at: float, near: float, far: float) -> Array:
    """Where tails go, in blocks from a pixel; the sum is 1.

    Each element of the rim sends light along its normal, to both sides: 1/r^2 of a straight edge, and 1/r^3 of an arc,
    which turns.
    """
    margin = math.ceil(far) + 1
    size = 2 * margin + 1
    kernel = np.zeros((size, size))
    length = {"square": 4 * aperture.diameter, "half_disc": aperture.diameter}.get(aperture.shape, 0.0)
    straight = length / rim(aperture)
    if straight < 1:
        y, x = np.indices((size, size)) - margin
        radius = np.hypot(x, y)
        beyond = (radius > near) & (radius <= far)
        radius = np.where(beyond, radius, far)
        arc = np.where(beyond, _from_both_rims(radius, rim_at) / radius, 0.0)
        kernel += (1 - straight) * arc / arc.sum()
    if straight:
        normals = [aperture.rotation + turn * math.pi / 2 for turn in range(2 if aperture.shape == "square" else 1)]
        radius = np.geomspace(near, far, _STEPS)
        light = radius * _from_both_rims(radius, rim_at)
        light *= straight / (2 * len(normals) * light.sum() * _BESIDE)
        for normal, beside in itertools.product(normals, (np.arange(_BESIDE) + 0.5) / _BESIDE * 2 - 1):
            c, s = math.cos(normal), math.sin(normal)
            for far_off in (radius, -radius):
                row, column = s * far_off + c * beside * rim_at, c * far_off - s * beside * rim_at
                at = tuple(np.clip(np.rint(place).astype(np.intp) + margin, 0, size - 1) for place in (row, column))
                np.add.at(kernel, at, light)
    return kernel


def _from_both_rims(radius: Array, rim_at: float) -> Array:
    """Light that straight rims on either side of the middle send to a place beyond both."""
    found: Array = 1 / (radius - rim_at) ** 2 + 1 / (radius + rim_at) ** 2
    return found
