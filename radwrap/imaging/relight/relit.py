"""Images for any levels of the sources, from a light basis and without a ray, each with its certificate.

The levels enter linearly: into the replicates, into what the kernel's model
lacks and into what the size of its cells changes. Eq. 5 comes after the sum,
so that the certificate holds for these very gray levels.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.images import ExposureImage, GrayImage
from radwrap.imaging.methods.kernel import grid_squares
from radwrap.imaging.relight.basis import BASIS, WAVES, read_sealed
from radwrap.imaging.relight.basis_files import PartsToRead
from radwrap.imaging.response.sensor import gray_levels, image_of_levels
from radwrap.imaging.run_files import BasisFile, SampleFile
from radwrap.imaging.tolerance.bounds import ALONE, NOTHING, Bounded, mean_squares, resampling
from radwrap.imaging.tolerance.certificate import Certificate, PixelErrors, PixelSample, certificate_of, lacks_in_gray
from radwrap.imaging.tolerance.kept_replicates import KeptReplicates
from radwrap.imaging.tolerance.planner import model_quantile, noise_quantile
from radwrap.imaging.tolerance.replicates import looks, noise_of
from radwrap.imaging.tolerance.wave_image import lasting_wave_error, visible_gray
from radwrap.random_streams import Relighting
from radwrap.scene.camera import Camera, Sensor
from radwrap.scene.tolerances import Tolerances
from radwrap.written import read_back

# Images that are made together. Always as many, the last ones perhaps in vain: then a product's last bits do not depend
# on how many images are asked for.
_TOGETHER: Final = 16
_VALUES_HELD: Final = 1 << 24  # 128 MiB
_SURE: Final = 1.959963985  # normal quantile of 0.975
_LARGEST_FLOAT32: Final = float(np.finfo(np.float32).max)


@dataclass(frozen=True, slots=True, eq=False)
class Basis:
    """Images of each source alone, and what the certificate needs of each.

    Attributes
    ----------
    sources : tuple of str
        Names, in the order of the arrays' first axis.
    dark : tuple of str
        Names of the scene's sources that are dark in it.
    images : ndarray of float32, shape (sources, replicates, rows, columns)
        Mean of L cos^4(theta) over pixel and opening [W m^-2 sr^-1].
    grid_pixels : ndarray of int, shape (n,)
        Pixels at which it is known what the size of the kernel's cells changes.
    grid : ndarray of float32, shape (sources, replicates, n)
        That change [W m^-2 sr^-1].
    sample : PixelSample or None
        Pixels at which the kernel's model was held against rays.
    lacks : ndarray of float32, shape (sources, 2, m)
        Two values of what it lacks there [W m^-2 sr^-1].
    model_rays : int
        Rays that told so, in the light of each source.
    block : tuple of int
        Rows and columns over which errors hang together [px].
    exposure_of_radiance : float
        tau A/f^2.
    camera : Camera
        As the scene has it, but for its distortion, which the images hold.
    tolerance : float
        What the image in the light of all sources was to keep [gray level].
    max_error : float or None
        Likewise for 99 % of the pixels.
    scene_sha256 : str
        Hash of the scene.
    tolerances : Tolerances or None
        Those that the scene states.
    magnification : ndarray of float32, shape (rows, columns), optional
        M of what each pixel sees, where a lens has an opening that is not sure.
    even : bool
        Whether no light decided where its rays went, see `sampling`.
    smooth_share : float
        As of `Replicates`.
    every_pixel : bool
        Whether some pixels have rays of their own, as those of a hybrid: their noise is looked for at all.
    waves : ndarray of float32, shape (sources, 2, rows, columns), optional
        Where the images have diffraction: what its cells may change, and what light may that comes from farther than
        was looked at [W m^-2 sr^-1].
    """

    sources: tuple[str, ...]
    dark: tuple[str, ...]
    images: NDArray[np.float32]
    grid_pixels: NDArray[np.intp]
    grid: NDArray[np.float32]
    sample: PixelSample | None
    lacks: NDArray[np.float32]
    model_rays: int
    block: tuple[int, int]
    exposure_of_radiance: float
    camera: Camera
    tolerance: float
    max_error: float | None
    scene_sha256: str
    tolerances: Tolerances | None
    magnification: NDArray[np.float32] | None
    even: bool = False
    smooth_share: float = 1.0
    every_pixel: bool = False
    waves: NDArray[np.float32] | None = None

    @property
    def sensor(self) -> Sensor:
        """Response."""
        return self.camera.sensor


@dataclass(frozen=True, slots=True, eq=False)
class Relit:
    """An image in its own light.

    Attributes
    ----------
    radiant_exposure : ExposureImage
        H as a file holds it: rounded to float32 [J m^-2].
    gray : GrayImage
        What the camera gives.
    certificate : Certificate
        How far the gray levels may be off.
    saturated_fraction : float
        Share of the pixels at saturation.
    replicates : KeptReplicates or None
        Of an even basis: the independent images whose mean it is.
    """

    radiant_exposure: ExposureImage
    gray: GrayImage
    certificate: Certificate
    saturated_fraction: float
    replicates: KeptReplicates | None = None

    def keeps(self, basis: Basis) -> bool:
        """Whether it keeps the tolerance that the basis was made for."""
        quantile, largest = self.certificate.p99_gray_upper95, basis.max_error
        return self.certificate.rms_gray_upper95 <= basis.tolerance and (
            largest is None or (quantile is not None and quantile <= largest)
        )


def read_basis(folder: Path) -> Basis:
    """Read what ``radwrap render --basis`` wrote.

    Raises
    ------
    InputError
        If there is no basis, or one of its files, `basis.json` too, is not the one that was written.
    """
    if not (folder / BASIS).exists():
        raise InputError(f"holds no light basis, {BASIS}", where=str(folder), remedy="render the scene with a basis")
    told_by = read_back(read_sealed(folder / BASIS), BasisFile, str(folder / BASIS))
    try:
        return _basis(folder, told_by)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError("is not a light basis", where=str(folder / BASIS), remedy="make it again") from error


def _basis(folder: Path, told: BasisFile) -> Basis:
    parts = PartsToRead(folder, told)
    sensor, model = told.camera.sensor, told.model
    images = np.empty((len(told.sources), told.replicates, sensor.rows, sensor.columns), dtype=np.float32)
    grid = np.zeros((len(told.sources), told.replicates, len(told.grid_pixels)), dtype=np.float32)
    lacks = np.zeros((len(told.sources), 2, len(model.pixels) if model else 0), dtype=np.float32)
    waves = None
    if told.waves is not None:
        waves = np.zeros((len(told.sources), 2, sensor.rows, sensor.columns), dtype=np.float32)
    for k, source in enumerate(told.sources):
        for replicate in range(told.replicates):
            images[k, replicate] = parts.of(source, str(replicate))
        if grid.size:
            grid[k] = parts.of(source, "grid")
        if model:
            lacks[k] = parts.of(source, "model")
        if waves is not None:
            waves[k] = parts.of(source, WAVES).reshape(2, sensor.rows, sensor.columns)
    return Basis(
        sources=told.sources,
        dark=told.dark,
        images=images,
        grid_pixels=np.array(told.grid_pixels, dtype=np.intp),
        grid=grid,
        sample=_sample(model) if model else None,
        lacks=lacks,
        model_rays=model.rays if model else 0,
        block=told.block,
        exposure_of_radiance=told.exposure_of_radiance,
        camera=replace(told.camera, distortion=None),
        tolerance=told.tolerance,
        max_error=told.max_error,
        scene_sha256=told.scene_sha256,
        tolerances=told.tolerances,
        magnification=parts.magnification,
        even=told.even,
        smooth_share=told.smooth_share,
        every_pixel=told.every_pixel,
        waves=waves,
    )


def _sample(model: SampleFile) -> PixelSample:
    pixels, stratum, pairs = (
        np.array(numbers, dtype=np.intp) for numbers in (model.pixels, model.stratum, model.pairs)
    )
    return PixelSample(pixels, stratum, np.array(model.shares, dtype=np.float64), pairs)


def relit(basis: Basis, factors: Sequence[Sequence[float]] | NDArray[np.float64]) -> Iterator[Relit]:
    """Images for any levels of the sources.

    Parameters
    ----------
    basis : Basis
        See `read_basis`.
    factors : array, shape (images, sources)
        On the radiance of each source as it is in the basis' scene; finite, not negative.

    Yields
    ------
    Relit
        Each image, in the order of the factors.

    Raises
    ------
    InputError
        If the factors are not so, or a radiant exposure overflows.
    """
    return Relighter(basis).images(factors)


def _check_overflow(basis: Basis, levels: NDArray[np.float64]) -> None:
    """Refuse levels before the first image, if one of them may give what float32 cannot hold."""
    brightest = basis.images.reshape(len(basis.sources), -1).max(axis=1).astype(np.float64)
    with np.errstate(over="ignore"):
        largest = levels @ (brightest * basis.exposure_of_radiance)
    if (over := np.flatnonzero(~(largest <= _LARGEST_FLOAT32))).size:
        raise InputError(f"the radiant exposure of image {over[0] + 1} overflows", remedy="lower its factors")


class Relighter:
    """What is made once for all images of a basis, for whoever asks for one image after the other.

    Parameters
    ----------
    basis : Basis
        See `read_basis`.
    """

    def __init__(self, basis: Basis) -> None:
        self._basis = basis
        sample, key = basis.sample, (Relighting.RESAMPLES,)
        self._again = None if sample is None else resampling(sample.stratum, sample.shares, key)

    @property
    def basis(self) -> Basis:
        """Of which images are made."""
        return self._basis

    def in_camera(self, basis: Basis) -> Relighter:
        """The same for the basis in another camera; nothing is drawn anew, as that hangs on the light alone."""
        if basis.sample is not self._basis.sample:
            raise ValueError("is another basis")
        other = object.__new__(Relighter)
        other._basis, other._again = basis, self._again
        return other

    def image(self, factors: Sequence[float] | NDArray[np.float64]) -> Relit:
        """The image for a factor on each source: the very same as `relit` gives among others; raises as that."""
        return next(self.images([factors]))

    def images(self, factors: Sequence[Sequence[float] | NDArray[np.float64]] | NDArray[np.float64]) -> Iterator[Relit]:
        """Images for any levels of the sources, as `relit`."""
        basis, levels = self._basis, np.array(factors, dtype=np.float64)
        if levels.ndim != 2 or levels.shape[1] != len(basis.sources):
            raise InputError(
                f"have the shape {levels.shape}", where="factors", remedy="give one for each image and source"
            )
        if not (np.isfinite(levels).all() and (levels >= 0).all()):
            raise InputError("must be finite and not negative", where="factors")
        _check_overflow(basis, levels)
        return self._in_batches(levels)

    def _in_batches(self, levels: NDArray[np.float64]) -> Iterator[Relit]:
        together = min(_TOGETHER, max(1, _VALUES_HELD // self._basis.images[0].size))
        for first in range(0, len(levels), together):
            part = levels[first : first + together]
            full = np.zeros((together, levels.shape[1]))
            full[: len(part)] = part
            yield from self._batch(full, len(part))

    def _batch(self, levels: NDArray[np.float64], count: int) -> Iterator[Relit]:
        """The first `count` images for some levels."""
        basis = self._basis
        replicates = _combined(levels, basis.images)
        grid = _combined(levels, basis.grid)
        waves = None if basis.waves is None else _combined(levels, basis.waves)
        mean = np.maximum(replicates.mean(axis=1), 0.0)
        errors = self._model_errors(mean, levels)
        models = [NOTHING] * len(levels)
        if self._again is not None:
            first, second = (np.stack(values) for values in zip(*((e.first, e.second) for e in errors), strict=True))
            models = mean_squares(first, second, self._again)
        for k in range(count):
            noise, samples = self._noise(replicates[k], grid[k])
            quantile = None
            if basis.max_error is not None:
                quantile = noise_quantile(samples, noise)
                if basis.sample is not None:
                    quantile += model_quantile(errors[k], basis.sample)
            pixels = 0 if basis.sample is None else len(basis.sample.pixels)
            certificate = certificate_of(models[k], noise, quantile, pixels=pixels, rays=basis.model_rays)
            if waves is not None:
                certificate = self._with_waves(certificate, mean[k], waves[k])
            image = self._image(mean[k], certificate)
            if basis.even:
                cells = None if waves is None else waves[k][0]
                image = replace(image, replicates=self._kept(replicates[k], grid[k], cells))
            yield image

    def _model_errors(self, mean: NDArray[np.float64], levels: NDArray[np.float64]) -> list[PixelErrors]:
        basis = self._basis
        if basis.sample is None:
            return []
        lacks = _combined(levels, basis.lacks)
        image = mean.reshape(len(mean), -1)[:, basis.sample.pixels]
        scale, sensor = basis.exposure_of_radiance, basis.sensor
        return [lacks_in_gray(*pair, basis.model_rays, scale, sensor) for pair in zip(image, lacks, strict=True)]

    def _noise(self, replicates: NDArray[np.float64], grid: NDArray[np.float64]) -> tuple[Bounded, NDArray[np.float64]]:
        basis = self._basis
        rows, columns = steps = (1, 1) if basis.every_pixel else looks(basis.block)
        seen = np.maximum(replicates[:, ::rows, ::columns], 0.0)
        gray = gray_levels(seen * basis.exposure_of_radiance, basis.sensor)
        noise, samples = noise_of(gray, basis.block, steps)
        if not grid.size:
            return noise, samples
        at = replicates.reshape(len(replicates), -1)[:, basis.grid_pixels]
        if basis.even:  # what replicates have in common, without the noise of each
            at, grid = at.mean(axis=0, keepdims=True), grid.mean(axis=0, keepdims=True)
        # Replicates see the same edges: only pixels are independent looks.
        squares = grid_squares(at, grid, basis.exposure_of_radiance, basis.sensor).mean(axis=0)
        mean = float(squares.mean())
        return noise + Bounded(mean, mean + _SURE * float(squares.std()) / math.sqrt(len(squares))), samples

    def _with_waves(
        self, certificate: Certificate, mean: NDArray[np.float64], waves: NDArray[np.float64]
    ) -> Certificate:
        """With what diffraction may be off by; noise of its rays is that of the replicates, which have it."""
        gray = visible_gray(self._basis.exposure_of_radiance, self._basis.sensor)
        error = lasting_wave_error(waves[0], waves[1], mean, gray)
        # What wavelengths change is in what comes from farther: they add as one.
        return certificate.with_waves(NOTHING, error.cells, 0.0, error.quantile, bands=error.tails)

    def _kept(
        self, replicates: NDArray[np.float64], grid: NDArray[np.float64], cells: NDArray[np.float64] | None
    ) -> KeptReplicates:
        change = np.zeros(replicates.shape[1:])
        change.ravel()[self._basis.grid_pixels] = grid.mean(axis=0)
        scale = self._basis.exposure_of_radiance
        change *= self._basis.smooth_share
        return KeptReplicates(replicates * scale, (change if cells is None else change + cells) * scale)

    def _image(self, mean: NDArray[np.float64], certificate: Certificate) -> Relit:
        sensor = self._basis.sensor
        # Below no light by chance, as in `radiant_exposure`.
        values = np.maximum(mean, 0.0) * self._basis.exposure_of_radiance
        exposure = ExposureImage(values.astype(np.float32).astype(np.float64), {"scene": self._basis.scene_sha256})
        levels = gray_levels(exposure.values, sensor)
        gray = image_of_levels(levels, sensor, exposure.provenance)
        # Not of the rounded gray levels: rounding may reach a saturation that the pixel does not.
        saturated = float(np.mean(levels >= sensor.saturation_gray))
        return Relit(exposure, gray, certificate, saturated)


def _combined(levels: NDArray[np.float64], parts: NDArray[np.float32]) -> NDArray[np.float64]:
    """Sums over sources in float64, shape (images, ...), of parts of the shape (sources, ...)."""
    flat = parts.reshape(len(parts), -1)
    result = np.empty((len(levels), flat.shape[1]))
    step = max(1, ALONE // levels.size)
    for start in range(0, flat.shape[1], step):
        part = slice(start, start + step)
        np.matmul(levels, flat[:, part].astype(np.float64), out=result[:, part])
    return result.reshape(len(levels), *parts.shape[1:])
