"""How far a response may be off because the predicted image is: the image's error, carried through the measurement.

An image by an even plan of sampling (`imaging/tolerance/sampling.py`) has independent replicates. What is measured on
images as the true one may be, without what the size of the kernel's cells adds and with the noise of one replicate,
tells what both do to the response. They lie as in this image, from pixel to pixel.

The cells' error is known with its sign, and is taken out, not added once more: a response that takes steps, such as a
percentile, does not see the same on both sides. Beside an edge the cells make the brightest pixels darker; these then
are no longer among the brightest, and to make them darker still changes no percentile.

Of the error of the kernel's model, and of images by the paper's method, a certificate gives the rms error of the gray
levels before rounding. How that error lies in the image is taken to be

- where gray changes: its standard deviation is proportional to the local slope (across the edge of Fig. 11 it is 0.69
gray levels on the flank and 0.03 beside it; on the bench board the steepest tenth of the pixels holds half of the
variance, and the flat half none); - smooth as the blur: white noise averaged over the disc of the opening's projection,
as an image gathered with that disc has it.

Copies of the image with such errors are measured again. The response's error is the rms change by each cause, added as
squares.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from radwrap.images import GrayImage
from radwrap.imaging.forecast.explain import blur_radius
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.tolerance.kept_replicates import KeptReplicates
from radwrap.random_streams import Studying, generator
from radwrap.scene.camera import Camera, Sensor
from radwrap.scene.look.geometry import project
from radwrap.scene.scene import Scene

Array = NDArray[np.float64]

COPIES: Final = 8  # the rms of so many is known to 25 %
_LARGEST_BLUR: Final = 200.0  # px
# Of the rms error by noise; what is smaller adds half a percent to an error bar, and eight measurements.
_NEGLIGIBLE: Final = 0.1

Cause = Literal["sampling", "model"]


@dataclass(frozen=True, slots=True, eq=False)
class ImageError:
    """What is known of an image's error.

    Attributes
    ----------
    rms : float
        Bound of the rms error of the gray levels before rounding, which holds in 95 of 100 images [gray level].
    variance : ndarray, shape (rows, columns)
        Of each pixel [gray level^2]; its mean is rms^2.
    radii : tuple of float
        Of the disc over which errors hang together, along u and v [px].
    """

    rms: float
    variance: Array
    radii: tuple[float, float]

    @property
    def block(self) -> float:
        """Number of pixels whose errors are as one: the area of the disc [px]."""
        return max(1.0, math.pi * self.radii[0] * self.radii[1])

    def near(self, u: float, v: float, radius: float) -> float:
        """Mean variance within a distance of a place [gray level^2]."""
        rows, columns = self.variance.shape
        r0, r1 = max(0, round(v - radius)), min(rows, round(v + radius) + 1)
        c0, c1 = max(0, round(u - radius)), min(columns, round(u + radius) + 1)
        part = self.variance[r0:r1, c0:c1]
        return float(part.mean()) if part.size else 0.0


def image_error(gray: Array, rms: float, radii: tuple[float, float]) -> ImageError:
    """Spread a certified rms error over an image.

    Parameters
    ----------
    gray : ndarray, shape (rows, columns)
        Gray levels before rounding.
    rms : float
        Certified [gray level].
    radii : tuple of float
        See `blur_radii`.
    """
    square = np.zeros(gray.shape)
    for axis in (0, 1):
        if gray.shape[axis] > 1:
            square += np.gradient(gray, axis=axis) ** 2
    mean = float(square.mean())
    variance = rms**2 * square / mean if mean > 0 else np.full(gray.shape, rms**2)
    return ImageError(rms, variance, radii)


def blur_radii(scene: Scene) -> tuple[float, float]:
    """Semi-axes of the opening's projection on the sensor [px], for the nearest target before the camera."""
    camera = scene.camera
    places = np.array([target.pose.position for target in scene.targets]).reshape(-1, 3)
    depths = [float(depth) for depth in project(camera, places)[1] if depth > 0] if len(places) else []
    if not depths or camera.aperture.is_infinitesimal:
        return 0.5, 0.5
    radius = blur_radius(camera, min(depths))
    return _pixels(radius, camera)


def _pixels(radius: float, camera: Camera) -> tuple[float, float]:
    widths = (camera.sensor.pixel_width, camera.sensor.pixel_height)
    u, v = (min(max(radius / width, 0.5), _LARGEST_BLUR) for width in widths)
    return u, v


@dataclass(frozen=True, slots=True, eq=False)
class ErrorFields:
    """Random fields of variance 1, smooth over a disc; the same for every image of a size, so that runs compare.

    Attributes
    ----------
    fields : ndarray, shape (copies, rows, columns)
    """

    fields: Array


def error_fields(shape: tuple[int, int], radii: tuple[float, float], copies: int = COPIES) -> ErrorFields:
    """Draw the fields of all copies."""
    # Round about the borders, so that the variance is 1 everywhere.
    v, u = (np.minimum(np.arange(size), size - np.arange(size)) for size in shape)
    disc = ((u / radii[0]) ** 2 + (v[:, np.newaxis] / radii[1]) ** 2 <= 1).astype(np.float64)
    disc /= math.sqrt(float((disc**2).sum()))
    white = generator(Studying.IMAGE_ERROR, *shape).standard_normal((copies, *shape))
    return ErrorFields(np.fft.irfft2(np.fft.rfft2(white) * np.fft.rfft2(disc), s=shape))


@dataclass(frozen=True, slots=True, eq=False)
class Changed:
    """An image with an error as it may be.

    Attributes
    ----------
    cause : str
        What makes such errors: "sampling" by a finite number of rays and cells, or the kernel's "model".
    gray : ndarray, shape (rows, columns)
        Gray levels before rounding.
    image : GrayImage
        Rounded where the sensor rounds.
    """

    cause: Cause
    gray: Array
    image: GrayImage


def changed_image(cause: Cause, gray: Array, sensor: Sensor) -> Changed:
    """Clip and round gray levels as the sensor does."""
    clipped = np.clip(gray, 0.0, sensor.saturation_gray)
    return Changed(cause, gray, GrayImage(np.rint(clipped) if sensor.rounding else clipped, sensor.bit_depth))


def copies_of(gray: Array, error: ImageError, fields: ErrorFields, sensor: Sensor) -> Iterator[Changed]:
    """The image with errors that lie as a certificate does not say."""
    amplitude = np.sqrt(error.variance)
    for field in fields.fields:
        yield changed_image("model", gray + amplitude * field, sensor)


def changed_by_replicates(exposure: Array, kept: KeptReplicates, sensor: Sensor) -> Iterator[Changed]:
    """An image of some radiant exposure [J m^-2] as the true one may be, by its own replicates."""
    for change in kept.changes():
        yield changed_image("sampling", gray_levels(np.maximum(exposure - kept.change + change, 0.0), sensor), sensor)


def model_error(gray: Array, model_rms: float, noise_rms: float, radii: tuple[float, float]) -> ImageError | None:
    """The error of the kernel's model, spread over the image; None where it is negligible beside noise."""
    return None if model_rms <= _NEGLIGIBLE * noise_rms else image_error(gray, model_rms, radii)
