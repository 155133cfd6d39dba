"""What waves send farther than the guard band, from a coarse image around the sensor."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.methods.transforms import correlated, fast_length, spectrum_of
from radwrap.imaging.optics.guard_band import BLOCKS, FEWEST_BLOCK
from radwrap.imaging.optics.view import View, known_or_traced
from radwrap.imaging.optics.waves import rim
from radwrap.imaging.response.strips import strips_of
from radwrap.imaging.tolerance.wave_plan import FAR_STRATA, WavePlan, bare, known_to
from radwrap.random_streams import Rendering, generator
from radwrap.scene.camera import Aperture, Sensor

Array = NDArray[np.float64]

# Each pixel sees rings: the first begins where the guard band ends, each next one where the last ended, and each ends
# so many times as far off as it begins. Blocks widen as rings do. What comes from beyond the last one is an error.
_WIDER: Final = 8.0
_RINGS: Final = 3
# Of far light, how far its law is off, rms: it leaves out the rings around a point. By scripts/waves_by_fft.py .12 with
# guard bands of 6 and of 12 wave's lengths.
OF_FAR: Final = 0.125
_MOST_BLOCKS: Final = 1 << 20
# A pixel gathers most of it from just beyond its guard band: up to so many guard bands beside the sensor a block has
# n x n rays, and one farther away. What is small and bright on the sensor stands in the image itself, beside which far
# light that is missed of it is little: fewer rays do there.
_DENSE: Final = 3.0
_LEAST_SHARE: Final = 0.01  # of the light, that goes so far: what is less needs no fewer points of wide lights
_ON_SENSOR: Final = 2
# Steps along a straight edge's tail, and across it: it is as wide as the edge.
_STEPS: Final = 4096
_BESIDE: Final = 8
_INSIDE: Final = 6  # places along a side of a block, of which the guard band's rim cuts some


def far_light(
    view: View,
    plan: WavePlan,
    replicate: int,
    progress: Callable[[int], None],
    *,
    on_sensor: Callable[[float], Array] | None = None,
) -> Array:
    """Mean light of each source that comes from beyond the guard band, at the middles of blocks of pixels.

    Parameters
    ----------
    view : View
        Whose.
    plan : WavePlan
        Which rays tell it.
    replicate : int
        Which of its sets.
    progress : callable
        Is told how many rays were traced.
    on_sensor : callable, optional
        Of blocks of a side [px] that lie on the sensor their mean light [W m^-2 sr^-1], shape (rows, columns), of the
        one source that there is; these need no rays then.

    Returns
    -------
    ndarray, shape (sources, rows of blocks, columns of blocks)
        [W m^-2 sr^-1]
    """
    random = generator(plan.seed, Rendering.WAVE_FAR, replicate)
    rings = _rings(plan)
    each = [_from_ring(view, plan, ring, random, progress, on_sensor=on_sensor) for ring in rings]
    beyond = each[-1]
    for found, ring, outer in reversed(list(zip(each, rings, rings[1:], strict=False))):
        for axis, size in enumerate(found.shape[1:], start=1):
            middles = (np.arange(size, dtype=np.float64) + 0.5) * ring.block
            beyond = _interpolated(beyond, middles / outer.block - 0.5, axis)
        share = outer.share(plan) / ring.share(plan)
        beyond = (1 - share) * found + share * beyond
    return beyond


def _from_ring(
    view: View,
    plan: WavePlan,
    coarse: _Coarse,
    random: np.random.Generator,
    progress: Callable[[int], None],
    *,
    on_sensor: Callable[[float], Array] | None,
) -> Array:
    """As `far_light`, of the light from a ring around each place."""
    block, margin, (rows, columns) = coarse.block, coarse.margin, coarse.shape
    places, owners = [], []
    known = np.empty((0, 0)) if on_sensor is None else on_sensor(block)
    inside_of = coarse.from_corner(known.shape)
    for some, strata in _strata(coarse, plan.far_strata):
        some[inside_of] = False
        row, column = np.nonzero(some)
        inside = (np.indices((strata, strata)).reshape(2, 1, -1) + random.random((2, len(row), strata**2))) / strata
        places.append(np.stack([row[:, np.newaxis] + inside[0], column[:, np.newaxis] + inside[1]]).reshape(2, -1))
        owners.append(np.repeat(row * columns + column, strata**2))
    v, u = (np.concatenate(places, axis=1) - margin) * block - 0.5
    owner = np.concatenate(owners)
    kernel = _kernel(plan, coarse)
    tracing = _with_noise(view, coarse.share(plan), kernel)
    light, _ = known_or_traced(tracing, known_to(view, plan), u, v, traced=progress)
    rays = np.bincount(owner, minlength=rows * columns)
    sums = np.stack([np.bincount(owner, one, rows * columns) for one in light.reshape(-1, len(u))])
    values = (sums / np.maximum(rays, 1)).reshape(-1, rows, columns)
    values[:, *inside_of] = known
    return np.stack([_correlated(one, kernel) for one in values])


def far_view(view: View, plan: WavePlan) -> View:
    """By whom `far_light` traces its rays: they ask as many points of wide lights as they count for."""
    coarse = _rings(plan)[0]
    return _with_noise(view, coarse.share(plan), _kernel(plan, coarse))


def _with_noise(view: View, share: float, kernel: Array) -> View:
    # So many rays have the noise of one whose light counts whole.
    together = 1 / (float((kernel**2).sum()) * max(share**2, _LEAST_SHARE**2))
    return bare(view).together(together)


def _kernel(plan: WavePlan, coarse: _Coarse) -> Array:
    """What a pixel gathers from the light around it: turned, and alike from both sides."""
    blur = min(plan.kernel.reach_px) - (plan.kernel.guard or 0.0)
    aperture = plan.waves.aperture
    rim_at = blur / math.sqrt(2) if aperture.shape == "square" else blur
    return _tail_kernel(aperture, *(length / coarse.block for length in (rim_at, coarse.near, coarse.far)))


def far_rays(plan: WavePlan, *, beside: bool = False) -> int:
    """About how many rays `far_light` takes, or so many of them go `beside` the sensor: none in smooth blocks."""
    sensor, rays = plan.kernel.camera.sensor, 0.0
    known = 0.0 if plan.smooth is None else plan.smooth.share_of((0, sensor.rows - 1), (0, sensor.columns - 1))
    for ring in _rings(plan):
        on_sensor = ring.from_corner(whole_blocks(sensor, ring.block))
        for some, strata in _strata(ring, plan.far_strata):
            if beside:
                some[on_sensor] = False
            rays += np.count_nonzero(some) * strata**2
        if not beside:
            rays -= known * sensor.pixels / ring.block**2 * min(_ON_SENSOR, plan.far_strata, round(ring.block)) ** 2
    return round(rays)


def whole_blocks(sensor: Sensor, block: float) -> tuple[int, int]:
    """How many rows and columns of blocks lie on a sensor, from its corner on."""
    return math.floor(sensor.rows / block), math.floor(sensor.columns / block)


def strata_for(plan: WavePlan, seen: float, allowed: float) -> int:
    """Fewest rays along a side of a block by which noise of far light is small where it is as bright as what is seen.

    What is small and brighter beside the image makes more noise; the certificate sees that, and asks for more rays.

    Parameters
    ----------
    plan : WavePlan
        For the blocks and their weights.
    seen : float
        Rms of the light that an image sees [gray level]: that of blocks is taken to be all noise.
    allowed : float
        Noise, rms [gray level].
    """
    coarse = _rings(plan)[0]
    noise = seen * abs(coarse.share(plan)) * math.sqrt(float((_kernel(plan, coarse) ** 2).sum()))
    return min(FAR_STRATA, max(1, math.ceil(noise / allowed)))


def _strata(coarse: _Coarse, most: int) -> tuple[tuple[NDArray[np.bool_], int], ...]:
    """Blocks, shape (rows, columns), and how many rays along a side each of them gets."""
    block, margin, (rows, columns) = coarse.block, coarse.margin, coarse.shape
    beside = min(margin, math.ceil(_DENSE * coarse.near / block))
    strata = np.ones((rows, columns), dtype=np.intp)
    for around, number in ((beside, FAR_STRATA), (0, _ON_SENSOR)):
        # No more rays than pixels are needed to tell light that is spread so far.
        strata[margin - around : rows - margin + around, margin - around : columns - margin + around] = min(
            number, most, round(block)
        )
    return tuple((strata == number, number) for number in range(FAR_STRATA, 0, -1))


def _correlated(values: Array, kernel: Array) -> Array:
    """Sums of values around each place under a kernel that is alike from both sides, where it lies in the field.

    By transforms of numpy: to load scipy's takes longer than all that they do here.
    """
    shape = [fast_length(size) for size in values.shape]  # what goes round is cut off
    found = correlated([spectrum_of(values, shape)], [spectrum_of(kernel, shape)], shape)
    return found[kernel.shape[0] - 1 : values.shape[0], kernel.shape[1] - 1 : values.shape[1]]


def far_change(plan: WavePlan, around: Array) -> tuple[Array, Array]:
    """Of `far_light` of one source, what it adds to each pixel, and what light from farther still may add.

    Parameters
    ----------
    plan : WavePlan
        As of `far_light`.
    around : ndarray, shape (rows of blocks, columns of blocks)
        [W m^-2 sr^-1]

    Returns
    -------
    change, beyond : ndarray, shape (rows, columns)
        [W m^-2 sr^-1]
    """
    sensor, share = plan.kernel.camera.sensor, plan.weights.share
    rings = _rings(plan)
    rows, columns = (
        (np.arange(size, dtype=np.float64) + 0.5) / rings[0].block - 0.5 for size in (sensor.rows, sensor.columns)
    )
    off = math.hypot(OF_FAR * share, plan.weights.share_spread)
    beyond = min(plan.waves.tail(rings[-1].far * plan.pitch), abs(share)) + off
    found = np.empty((2, sensor.rows, sensor.columns))
    for strip in strips_of(sensor.rows, sensor.columns):
        mean = _interpolated(_interpolated(around, rows[strip], 0), columns, 1)
        found[0, strip], found[1, strip] = share * mean, beyond * mean
    return found[0], found[1]


def _interpolated(values: Array, places: Array, axis: int) -> Array:
    """Values at places along an axis, by straight lines; beyond the ends those of the ends.

    By numpy: to load scipy's image functions takes a sixth of a small render.
    """
    places = np.clip(places, 0, values.shape[axis] - 1)
    low = np.minimum(np.floor(places).astype(np.intp), max(values.shape[axis] - 2, 0))
    high = np.minimum(low + 1, values.shape[axis] - 1)
    share = np.expand_dims(places - low, tuple(other for other in range(values.ndim) if other != axis))
    found: Array = values.take(low, axis) * (1 - share) + values.take(high, axis) * share
    return found


@dataclass(frozen=True, slots=True)
class _Coarse:
    """A coarse image around the sensor, of which each pixel sees a ring.

    Attributes
    ----------
    near, far : float
        How far from a pixel the ring begins and ends [px].
    block : float
        Side of a block [px].
    margin : int
        How many lie beside the sensor on each side.
    shape : tuple of int
        Rows and columns of blocks.
    """

    near: float
    far: float
    block: float
    margin: int
    shape: tuple[int, int]

    @classmethod
    def of(cls, sensor: Sensor, near: float, far: float, block: float) -> _Coarse:
        """As wide as the ring needs."""
        margin = math.ceil(far / block) + 1
        rows, columns = (math.ceil(size / block) + 2 * margin for size in (sensor.rows, sensor.columns))
        return cls(near, far, block, margin, (rows, columns))

    @property
    def blocks(self) -> int:
        return self.shape[0] * self.shape[1]

    def from_corner(self, shape: tuple[int, ...]) -> tuple[slice, ...]:
        """So many rows and columns of blocks, from the sensor's corner on."""
        return tuple(slice(self.margin, self.margin + size) for size in shape)

    def share(self, plan: WavePlan) -> float:
        """Share of the light that waves send farther than the ring's beginning."""
        share = plan.weights.share
        if self.near == min(plan.kernel.reach_px):
            return share
        return math.copysign(min(plan.waves.tail(self.near * plan.pitch), abs(share)), share)


def _rings(plan: WavePlan) -> tuple[_Coarse, ...]:
    """From the guard band outwards, by blocks that widen as the rings do."""
    sensor, near = plan.kernel.camera.sensor, min(plan.kernel.reach_px)
    block = max(near / BLOCKS, FEWEST_BLOCK)
    while (found := _Coarse.of(sensor, near, _WIDER * near, block)).blocks > _MOST_BLOCKS:
        block *= 2
    rings = [found]
    while len(rings) < _RINGS:
        near = rings[-1].far
        rings.append(_Coarse.of(sensor, near, _WIDER * near, near / BLOCKS))
    return tuple(rings)


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
        # It is alike in all quarters: one of them, with the middle's own blocks.
        half = margin + 1
        along = (np.arange(half * _INSIDE) + 0.5) / _INSIDE - 0.5
        radius = np.hypot(along[:, np.newaxis], along)
        beyond = (radius > near) & (radius <= far)
        each = np.zeros_like(radius)
        seen = radius[beyond]
        each[beyond] = _from_both_rims(seen, rim_at) / seen
        quarter = each.reshape(half, _INSIDE, half, _INSIDE).sum(axis=(1, 3))
        lower = np.concatenate([quarter[:, :0:-1], quarter], axis=1)
        arc = np.concatenate([lower[:0:-1], lower])
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
