"""How far an image may be off by what waves add to it: noise of its rays, size of its cells, light from far away."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.optics.view import View, trace_rays
from radwrap.imaging.response.sensor import unclipped_gray
from radwrap.imaging.response.strips import strips_of
from radwrap.imaging.tolerance.bounds import NOTHING, Bounded, mean_square_of_differences
from radwrap.imaging.tolerance.replicates import contrasts
from radwrap.imaging.tolerance.wave_parts import Single, WaveParts
from radwrap.scene.camera import Sensor

Array = NDArray[np.float64]
Gray = Callable[[Array], Array]

_QUANTILE: Final = 0.995
_LITTLE: Final = 0.01  # of the light
_LOOKED: Final = 32  # pixels along a side that tell how much light is seen


@dataclass(frozen=True, slots=True)
class WaveError:
    """How far gray levels may be off by what waves add.

    Attributes
    ----------
    noise : Bounded
        Mean square of what the number of rays adds [gray level^2].
    cells : float
        Mean square of what `WaveParts.cells` adds to what the size of the image's own cells does [gray level^2].
    lasting : float
        The part of it that neither finer cells nor more rays make smaller.
    tails : float
        What light may change that comes from farther than was looked at, rms [gray level].
    quantile : float
        Error by all three that 99.5 % of the pixels stay below [gray level].
    """

    noise: Bounded
    cells: float
    lasting: float
    tails: float
    quantile: float


def wave_error(
    parts: WaveParts,
    made: Array,
    gray: Gray,
    block: int,
    own: tuple[Array, Array] | None = None,
    *,
    images: NDArray[np.float32] | None = None,
) -> WaveError:
    """How far an image may be off by what waves added to it.

    Parameters
    ----------
    parts : WaveParts
        What they added.
    made : ndarray, shape (rows, columns)
        The image, with that [W m^-2 sr^-1].
    gray : callable
        See `visible_gray`.
    block : int
        Rows and columns over which errors hang together [px].
    own : tuple of ndarray, shape (rows, columns), optional
        What the size of the image's own cells adds to it, as its own certificate has it and as it counts beside waves
        [W m^-2 sr^-1], where that is known.
    images : ndarray, shape (replicates, rows, columns), optional
        Those without waves, where each has the rays of one of the sets [W m^-2 sr^-1]: noise is then what the sum has
        more than they have, or less.

    Notes
    -----
    What waves add is their footprint less that of rays, which the image has. Of cells of the same size both footprints
    of rays are off alike, and the sum by what the waves' own is, which knows no edges as sharp: so what both sizes
    change adds pixel by pixel. How light is laid out where things hide, and glass is mixed, has nothing of that.
    """
    noise, size = NOTHING, np.zeros(made.shape)
    if (parts.change != parts.change[0]).any():
        # Each replicate about the image as it is: where it is saturated none of them shows.
        noise, size = _noise_of((parts.change,), made, gray, block)
        size *= math.sqrt(noise.upper / noise.mean) if noise.mean > 0 else 1.0
        if images is not None:
            without, whole = (_noise_of(each, made, gray, block)[0] for each in ((images,), (images, parts.change)))
            noise = Bounded(whole.mean - without.mean, whole.upper - without.upper)
    lasting = lasting_wave_error(parts.cells, parts.beyond, made, gray, noise=size)
    if own is not None and not parts.lasting.any():
        lasting = replace(lasting, cells=_beside_own(own, parts.cells, made, gray))
    common = _common_square(parts.lasting, made, gray)
    return replace(lasting, noise=noise, lasting=min(lasting.cells, common))


def _noise_of(
    terms: Sequence[Array | NDArray[np.float32]], made: Array, gray: Gray, block: int
) -> tuple[Bounded, Array]:
    """Mean square of the noise in the mean of replicates that are sums of terms, and its rms at each pixel."""
    samples, size = np.empty((len(terms[0]) - 1, *made.shape)), np.empty(made.shape)
    for strip in strips_of(*made.shape):
        moved = sum(each[:, strip] - each[:, strip].mean(axis=0, dtype=np.float64) for each in terms)
        samples[:, strip] = contrasts(gray(made[strip] + moved))
        size[strip] = np.sqrt((samples[:, strip] ** 2).mean(axis=0))
    return mean_square_of_differences(samples, (block, block)), size


def _beside_own(own: tuple[Array, Array], cells: Array | Single, made: Array, gray: Gray) -> float:
    """What cells of waves add to the mean square that the image's own change by themselves.

    Nothing where the sum is less: what estimates of both seem to cancel makes no bound smaller.
    """
    square = 0.0
    for strip in strips_of(*made.shape):
        exact = gray(made[strip])
        alone, both = (gray(made[strip] + each) - exact for each in (own[0][strip], own[1][strip] + cells[strip]))
        square += float((both**2).sum()) - float((alone**2).sum())
    return max(square, 0.0) / made.size


def _common_square(lasting: Array | Single, made: Array, gray: Gray) -> float:
    """Mean square of what independent replicates have in common, 0 at least: their products hold no noise."""
    number, products = len(lasting), 0.0
    for strip in strips_of(*made.shape):
        each = gray(made[strip] + lasting[:, strip]) - gray(made[strip])
        products += float((each.sum(axis=0) ** 2).sum()) - float((each**2).sum())
    return max(products, 0.0) / (number * (number - 1) * made.size)


def lasting_wave_error(
    cells: Array | Single, beyond: Array | Single, made: Array, gray: Gray, *, noise: Array | float = 0.0
) -> WaveError:
    """As `wave_error`, of what more rays do not make smaller; the quantile holds a noise of each pixel [gray level]."""
    whole, square, tails = np.broadcast_to(noise, made.shape).copy(), 0.0, 0.0
    for strip in strips_of(*made.shape):
        exact = gray(made[strip])
        changed, far = gray(made[strip] + cells[strip]) - exact, gray(made[strip] + beyond[strip]) - exact
        whole[strip] += np.abs(changed) + np.abs(far)
        square, tails = square + float((changed**2).sum()), tails + float((far**2).sum())
    square, tails = square / made.size, math.sqrt(tails / made.size)
    quantile = float(np.quantile(whole, _QUANTILE, overwrite_input=True))
    return WaveError(NOTHING, square, square, tails, quantile)


def visible_gray(exposure_of_radiance: float, sensor: Sensor) -> Gray:
    """Gray level of mean radiance [W m^-2 sr^-1] by Eq. 5, as far as it shows.

    Where an image is saturated nothing changes but by light that falls below it.
    """

    def gray(values: Array) -> Array:
        levels: Array = np.minimum(
            unclipped_gray(np.maximum(values, 0.0) * exposure_of_radiance, sensor), sensor.saturation_gray
        )
        return levels

    return gray


def look(view: View, *, whole: bool = False) -> Array:
    """About what an image shows, a ray a pixel, of some pixels or of all [W m^-2 sr^-1]."""
    rows, columns = (
        np.arange(size, dtype=np.float64)[:: 1 if whole else math.ceil(size / _LOOKED)]
        for size in (view.camera.sensor.rows, view.camera.sensor.columns)
    )
    v, u = np.meshgrid(rows, columns, indexing="ij")
    return trace_rays(view, None, u.ravel(), v.ravel())[0].reshape(v.shape)


def seen_rms(radiance: Array, view: View) -> float:
    """Rms of gray levels that the mean light of an image would add to each pixel, by what a hundredth of it does.

    Light from far away is about as bright as that, whatever a pixel sees itself; it shows more where that is dark.
    """
    gray = visible_gray(view.exposure_of_radiance, view.camera.sensor)
    more = gray(radiance + _LITTLE * radiance.mean()) - gray(radiance)
    return math.sqrt(float((more**2).mean())) / _LITTLE
