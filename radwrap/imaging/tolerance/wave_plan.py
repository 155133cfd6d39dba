"""Which rays tell what waves add to an image, and how much each cell of the central image counts for that."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.demand import FINEST_CELL
from radwrap.imaging.methods.central import EdgeSampling
from radwrap.imaging.methods.kernel import KernelPlan, plan_kernel
from radwrap.imaging.methods.transforms import fast_length, spectrum_of
from radwrap.imaging.optics.footprint import Footprint, laid_out, reach_px
from radwrap.imaging.optics.guard_band import least_guard
from radwrap.imaging.optics.lens_field import (
    Glass,
    LensField,
    Place,
    Signs,
    glass_at,
    glass_reach,
    images_of,
    lens_field,
)
from radwrap.imaging.optics.smooth import SmoothField
from radwrap.imaging.optics.transfer import Transfer
from radwrap.imaging.optics.view import View, look_at_depths
from radwrap.imaging.optics.wave_footprint import is_laid_out, passed, passed_weights, ray_layout
from radwrap.imaging.optics.waves import Waves
from radwrap.imaging.tolerance.plans import POINTS_SHARE
from radwrap.imaging.tolerance.points_noise import points_noise
from radwrap.random_streams import Rendering, generator
from radwrap.tracers.noise import halvings_for

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
_Key = tuple[float, tuple[int, int], Place]  # cells, phase and place of weights

_LOOK: Final = 64  # rays along a side of a look at the depths
# A base cell is as wide as the wave's length, and as two pixels at least: with these an image was as exact as with
# single ones, by 30 % less rays.
_BASE_SHARE: Final = 1.0
_LEAST_BASE: Final = 2.0  # px
# There are so many of them at least, whatever waves spread: a line of two pixels is missed by base cells of sixteen.
_FEWEST_CELLS: Final = 16384
# Cells as wide as the wave's length change about a quarter of what waves add, rms, and half as wide ones a quarter of
# that. Where more than that may be left, cells may be of half a pixel though rays blur by less.
_OFF: Final = 0.25
_COARSEST: Final = 0.5  # px
_ABOUT: Final = 0.25  # of a halving: the size is a guess, and the next smaller one takes four times as long
# The guard band in wave's lengths, at least and at most; light that waves send farther is taken from a coarse image by
# a law that is off, see `wave_far`.
_NEAR: Final = 6.0
_WIDEST_NEAR: Final = 64.0
_RIM: Final = 0.5  # of the guard band, from outside
# The weights are made on a grid so many times as wide as they are taken from, of so many cells at most.
_AROUND: Final = 8
_AROUND_GLASS: Final = 4  # there are many weights then; what comes in is 5e-6 of the highest
_MOST_AROUND: Final = 1 << 23
_LEAST_GAIN: Final = 0.05  # of noise; rays are so few then that fewer would save nothing
FAR_STRATA: Final = 3
# Of a wavelength, what its light may deviate by without another footprint: where contrast falls with the eighth power
# of it, that changes .1 % of what waves add.
_ONE_LINE: Final = 0.005
_STEP: Final = 0.02  # of the diameter, to either side: a slope by both is off by its square


@dataclass(frozen=True, slots=True, eq=False)
class WaveWeights:
    """Differences of footprints within reach of a pixel, made once for all tiles.

    Attributes
    ----------
    kernel : KernelPlan
        Cells, layers and how far they reach.
    terms : tuple
        Factors, and of which waves; a wavelength of 0 is rays. The factors sum to 0.
    lens_field : LensField
        Places of the sensor at which they are made.
    made : dict
        What was made already, and how far the layers' shares of light that goes farther were from their mean, rms.
    guard : Lock
        Held while more is made: no two threads make the same.
    """

    kernel: KernelPlan
    terms: tuple[tuple[float, Waves], ...]
    lens_field: LensField
    made: dict[_Key, tuple[list[Array], float]] = field(default_factory=dict)
    guard: threading.Lock = field(default_factory=threading.Lock)

    def near(self, cell: float, phase: tuple[int, int], place: Place) -> list[Array]:
        """Of each layer, shape (2 rows + 1, 2 columns + 1); cells of a pixel in the middle."""
        return self._made_at(cell, phase, place)[0]

    def _made_at(self, cell: float, phase: tuple[int, int], place: Place) -> tuple[list[Array], float]:
        key = cell, phase, place
        with self.guard:
            if key not in self.made:
                self.made.update(self._at(place, {(cell, phase), *_gathered_by(self.kernel.grid.cell)}))
            return self.made[key]

    def _at(
        self, place: Place, sizes: Iterable[tuple[float, tuple[int, int]]]
    ) -> dict[_Key, tuple[list[Array], float]]:
        """Of a place and its mirror images: cells of all sizes share what passes, which takes longest."""
        camera, images = self.kernel.camera, images_of(self.kernel.camera, self.lens_field, place)
        keys = [(*size, image, signs) for size in sizes for image, signs in images]
        found: dict[_Key, list[Array]] = {key[:3]: [] for key in keys}
        glass = glass_at(camera, images[0][0])
        for layer in self.kernel.layers:
            once = [passed(replace(one, glass=glass), layer) if one.wavelength else None for _, one in self.terms]
            for cell, phase, image, signs in keys:
                passes = [None if one is None else partial(_signed, one, signs) for one in once]
                found[cell, phase, image].append(self.of_layer(layer, cell, phase, image, passes))
        return {key: (of_layers, _even_out(of_layers, self._rim(*key[:2]))) for key, of_layers in found.items()}

    def laid_out(  # noqa: PLR0917  (what is kept is known by all of it)
        self,
        cell: float,
        shape: tuple[int, int],
        phase: tuple[int, int],
        place: Place,
        layer: float,
        shift: tuple[int, int],
    ) -> Complex:
        """Conjugate of their transform in a field of a shape, of the layer of a number, or of a place between two.

        What they gather then lies before the pixel by a shift [cell].
        """
        each, number = self.near(cell, phase, place), math.floor(layer)
        near, share = each[number], layer - number
        if share:
            near = (1 - share) * near + share * each[number + 1]
        corner = (shift[0] - near.shape[0] // 2, shift[1] - near.shape[1] // 2)
        found = spectrum_of(laid_out(Footprint(corner, near), shape), shape)
        return np.conj(found, out=found)

    @property
    def share(self) -> float:
        """Share of the light that goes farther."""
        cell, places = self.kernel.grid.cell, self.lens_field.places
        return -float(np.mean([each.sum() for place in places for each in self.near(cell, (0, 0), place)]))

    @property
    def share_spread(self) -> float:
        """How far the share differs from layer to layer, rms."""
        cell, places = self.kernel.grid.cell, self.lens_field.places
        return math.sqrt(float(np.mean([self._made_at(cell, (0, 0), place)[1] ** 2 for place in places])))

    def of_layer(
        self,
        layer: float,
        cell: float,
        phase: tuple[int, int],
        place: Place,
        passes: Sequence[Transfer | None] | None = None,
    ) -> Array:
        """As `near`, of one layer by itself; with what passes of frequencies, where that is made already."""
        within = self._within(cell, phase)
        rows, columns = (size // 2 for size in within.shape)
        # What goes round comes in from far away: little, spread widely.
        glass = glass_at(self.kernel.camera, place)
        wide = max(
            1, min(_AROUND if glass is None else _AROUND_GLASS, math.isqrt(_MOST_AROUND // (4 * rows * columns)))
        )
        shape = fast_length(2 * wide * rows + 1), fast_length(2 * wide * columns + 1)
        summed = self._summed(layer, cell, shape, phase, glass=glass, passes=passes or [None] * len(self.terms))
        change = np.fft.fftshift(summed)
        r, c = (size // 2 for size in shape)
        # Cut at the same radius whatever the cells: a cell that it crosses counts in part.
        cut: Array = change[r - rows : r + rows + 1, c - columns : c + columns + 1] * np.clip(within, 0.0, 1.0)
        return cut

    def _within(self, cell: float, phase: tuple[int, int]) -> Array:
        """How far within reach each cell of the weights lies [cell]; half of one at what they are cut at."""
        reach = self.kernel.reach_px[::-1]
        # A pixel's middle beside that of the cell whose corner it shares [px].
        beside = [(1 - cell) / 2 + shift for shift in phase]
        sizes = [math.ceil((far + abs(off)) / cell + 0.5) for far, off in zip(reach, beside, strict=True)]
        down, across = (
            (np.arange(-size, size + 1) * cell - off) / far for size, off, far in zip(sizes, beside, reach, strict=True)
        )
        return np.asarray((1 - np.hypot(down[:, np.newaxis], across[np.newaxis])) * min(reach) / cell + 0.5)

    def _rim(self, cell: float, phase: tuple[int, int]) -> Array:
        """Shares of cells in the outermost part of the guard band."""
        within, guard = self._within(cell, phase), _RIM * (self.kernel.guard or min(self.kernel.reach_px))
        rim = np.clip(within, 0.0, 1.0) * (within <= max(guard / cell, 1.0))
        return np.asarray(rim / rim.sum())

    def _summed(
        self,
        layer: float,
        cell: float,
        shape: tuple[int, int],
        phase: tuple[int, int],
        *,
        glass: Glass | None,
        passes: Sequence[Transfer | None],
    ) -> Array:
        """The sum of all terms on a grid of a shape that goes round; rays of few cells need no transform."""
        camera = self.kernel.camera
        space, spectra = np.zeros(shape), list[Complex]()
        for (factor, light), transfer in zip(self.terms, passes, strict=True):
            if is_laid_out(light, camera, layer, cell):
                space += factor * ray_layout(camera, layer, cell, shape, phase)
                continue
            waves = replace(light, glass=glass) if light.wavelength else light
            spectra.append(factor * passed_weights(waves, camera, layer, cell, shape, phase=phase, transfer=transfer))
        if spectra:
            space += np.fft.irfft2(sum(spectra), shape)
        return space


def _even_out(of_layers: list[Array], rim: Array) -> float:
    """Let all layers send the same share of their light farther, as far light is not known by its depth.

    What one of them sends more than others, or less, stays at the rim: light of an even field adds up, and so does what
    lies behind and what hides it. Gives how far their shares were from the mean, rms.
    """
    shares = np.array([-one.sum() for one in of_layers])
    more = shares - shares.mean()
    for one, each in zip(of_layers, more, strict=True):
        np.add(one, each * rim, out=one)
    return float(np.sqrt(np.mean(more**2)))


def _gathered_by(cell: float) -> Iterator[tuple[float, tuple[int, int]]]:
    """Sizes of cells by which a tile is gathered, its own and twice that, and the places of a pixel in each."""
    for size in (cell, 2 * cell):
        for row, column in np.ndindex(max(1, round(size)), max(1, round(size))):
            yield size, (row, column)


def _signed(transfer: Transfer, signs: Signs, across: Array, down: Array) -> Complex:
    return transfer(signs[0] * across, signs[1] * down)


@dataclass(frozen=True, slots=True, eq=False)
class WavePlan:
    """Which rays tell what waves add.

    Attributes
    ----------
    kernel : KernelPlan
        Cells, layers, tiles and guard band of the central image.
    waves : Waves
        Of one wavelength.
    weights : WaveWeights
        Of its cells.
    seed : int
        Of all that is drawn.
    rays : int
        That the look at the depths took.
    smooth : SmoothField, optional
        Blocks whose cells are not to be cut: nothing changes there but smoothly.
    sampling : EdgeSampling, optional
        Rays in cells that differ much, the same for all tiles; default as all need together.
    far_strata : int
        Rays along a side of a block of far light, at most; see `wave_far.strata_for`.
    """

    kernel: KernelPlan
    waves: Waves
    weights: WaveWeights
    seed: int
    rays: int
    smooth: SmoothField | None = None
    sampling: EdgeSampling | None = None
    far_strata: int = FAR_STRATA

    def at(self, wavelength: float, deviation: float = 0.0) -> WavePlan:
        """The same rays, for light of another wavelength [m], or of such as deviate by so much of their mean.

        Of the latter the mean of two footprints counts, at the mean less its deviation and more: Gauss' rule, which is
        exact for what grows as the third power of the wavelength, of light that is as wide on either side.
        """
        if wavelength == self.waves.wavelength and deviation < _ONE_LINE:
            return self
        waves = replace(self.waves, wavelength=wavelength)
        lines = (0.0,) if deviation < _ONE_LINE else (-deviation, deviation)
        each = (replace(waves, wavelength=(1 + off) * wavelength) for off in lines)
        return replace(self, waves=waves, weights=WaveWeights(self.kernel, _less_rays(*each), self.weights.lens_field))

    @property
    def pitch(self) -> float:
        """The smaller pitch of the pixels [m]."""
        sensor = self.kernel.camera.sensor
        return min(sensor.pixel_width, sensor.pixel_height)

    @property
    def block(self) -> int:
        """Rows and columns over which errors hang together [px]."""
        blur = max(self.kernel.reach_px) - (self.kernel.guard or 0.0)
        bent = glass_reach(self.kernel.camera) / self.pitch
        return math.ceil(max(blur + bent, self.waves.blur / self.pitch)) + 1

    def cut_by_edge(self, apart: float) -> tuple[int, float]:
        """Within how many cells of an edge it cuts light that comes from behind, by waves or rays; and the rays' share.

        `apart` is by how much both magnifications differ. At the same depth, an edge is only where light ends.
        """
        by_rays, by_waves = 2 * max(reach_px(self.kernel.camera, apart)), self.waves.blur / self.pitch
        cut = by_rays + by_waves
        return math.ceil(cut / self.kernel.grid.cell), (by_rays / cut) ** 2


def plan_waves(
    view: View,
    wavelength: float,
    aim: float,
    seed: int,
    *,
    share: float | None = None,
    most_cell: float = math.inf,
    far: float = 1.0,
    even_cell: float | None = None,
) -> WavePlan:
    """Choose cells, layers, tiles and the guard band.

    Parameters
    ----------
    view : View
        In the light of all sources; its opening is finite.
    wavelength : float
        Of the light [m].
    aim : float
        Rms error of one replicate to aim at [gray level].
    seed : int
        Of all that is drawn.
    share : float, optional
        Of what waves add, what the cells' size may change; a guess that the image decides on. By default cells are no
        wider than where rays go needs them, and resolve what waves do.
    most_cell : float
        Size of the smallest cells, at most [px]; by measured errors, where the guess was wrong.
    far : float
        Of the light, what waves may send beyond the guard band; the band has limits of its own.
    even_cell : float, optional
        As of `plan_kernel`: no light decides where rays go.

    Raises
    ------
    TooDeep
        If the scene has more depths than a central image may have layers.
    """
    camera = view.camera
    waves = Waves(camera.aperture, camera.image_distance, wavelength)
    pitch = min(camera.sensor.pixel_width, camera.sensor.pixel_height)
    blur = waves.blur / pitch
    met, rays = look_at_depths(view, _LOOK, generator(seed, Rendering.WAVES))
    plan = plan_kernel(bare(view), met, aim, even_cell=even_cell)
    if even_cell is None:
        coarsest = plan.grid.cell if share is None else max(plan.grid.cell, _COARSEST)
        wanted = min(coarsest, most_cell, blur * math.sqrt((share or _OFF) / _OFF))
        finer = math.ceil(math.log2(plan.grid.cell / max(wanted, FINEST_CELL)) - _ABOUT)
        plan = plan_kernel(bare(view), met, aim, finer)
    near = waves.blur * min(_WIDEST_NEAR, max(_NEAR, waves.tail_radius(far) / waves.blur))
    guard = max(near / pitch, least_guard(camera.sensor)) + glass_reach(camera) / pitch
    if even_cell is None:
        # Where light is even rays go on in wide steps, as waves spread what they add.
        seen = (camera.sensor.rows + 2 * guard) * (camera.sensor.columns + 2 * guard)
        widest = max(min(_BASE_SHARE * blur, math.sqrt(seen / _FEWEST_CELLS)), _LEAST_BASE)
        wider = max(0, math.floor(math.log2(widest / plan.grid.base)))
        plan = replace(plan, grid=replace(plan.grid, base=plan.grid.base << wider, levels=plan.grid.levels + wider))
    plan = replace(plan, guard=guard)
    weights = WaveWeights(plan, _less_rays(waves), lens_field(camera, wavelength))
    if even_cell is None:
        aim /= _noise_gain(weights)
        square, looked = points_noise(view, seed)
        halvings = halvings_for(square, POINTS_SHARE * aim**2)
        plan, rays = replace(plan, grid=replace(plan.grid, aim=aim, halvings=halvings)), rays + looked
        weights = replace(weights, kernel=plan)
    return WavePlan(plan, waves, weights, seed, rays, None if even_cell is not None else view.smooth)


def _noise_gain(weights: WaveWeights) -> float:
    """Noise of what waves add over that of an image by the same rays: small where waves blur by less than pixels."""
    kernel, cell, (_, rays) = weights.kernel, weights.kernel.grid.cell, weights.terms[-1]
    place = weights.lens_field.places[len(weights.lens_field.places) // 2]
    added, alone = weights.near(cell, (0, 0), place), WaveWeights(kernel, ((1.0, rays),), weights.lens_field)
    gains = [
        float((added[number] ** 2).sum() / (alone.of_layer(kernel.layers[number], cell, (0, 0), place) ** 2).sum())
        for number in {0, len(kernel.layers) - 1}
    ]
    return min(1.0, max(math.sqrt(max(gains)), _LEAST_GAIN))


def by_diameter(plan: WavePlan) -> WavePlan:
    """The same rays, to tell how mean radiance changes with the logarithm of the opening's diameter."""
    aperture, share = plan.waves.aperture, 1 / math.log((1 + _STEP) / (1 - _STEP))
    terms = tuple(
        (
            sign * share * factor,
            replace(one, aperture=replace(aperture, diameter=(1 + sign * _STEP) * aperture.diameter)),
        )
        for sign in (1, -1)
        for factor, one in plan.weights.terms
        if one.wavelength
    )
    return replace(plan, weights=WaveWeights(plan.kernel, terms, plan.weights.lens_field))


def _less_rays(*waves: Waves) -> tuple[tuple[float, Waves], ...]:
    """Their mean less rays."""
    return (*((1 / len(waves), one) for one in waves), (-1.0, replace(waves[0], wavelength=0.0)))


def bare(view: View) -> View:
    """The view without blocks that are known to be smooth: beyond the image's edge none are."""
    return replace(view, smooth=None, prover=None)


def known_to(view: View, plan: WavePlan) -> SmoothField | None:
    """What a view knows of its smooth blocks; nothing where no light may decide where rays go."""
    return None if plan.kernel.grid.even else view.smooth
