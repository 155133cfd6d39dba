"""Standard deviation of each gray level: error of the rays, tolerances of what goes in, noise of the sensor.

::

    sigma^2 = rays^2 + sum over inputs (dG/dx sigma_x)^2 + noise^2

about the gray level before rounding that Eq. 5 gives for radiant_exposure.exr.
An interval of 1 sigma is to hold 68 %, one of 1.96 sigma 95 % of what cameras
within the tolerances would capture. Slopes are taken over a standard deviation
to each side, through saturation. Source: key gum2008.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.images import ExposureImage
from radwrap.imaging.optics.footprint import opening_points
from radwrap.imaging.optics.view import View, magnifications_at, trace_rays
from radwrap.imaging.response.noise import ROUNDING_VARIANCE, noise_variance
from radwrap.imaging.response.sensor import gray_levels, unclipped_gray
from radwrap.imaging.tolerance.certificate import places_of
from radwrap.scene.camera import Camera, Sensor
from radwrap.scene.tolerances import TO_STANDARD, Tolerances
from radwrap.written import NotNegative

Array = NDArray[np.float64]
# Of the mean square of the rays' error, what is laid on all pixels by their light alone. Nothing is known of the true
# share: edges have nearly all, half shadows of wide lights hardly any. With a half, sigma is at most sqrt(2) too small
# for either.
_EVEN_SHARE: Final = 0.5
_SURELY_CUT: Final = 3  # errors above saturation
_FEWEST_FOR_BLUR: Final = 3  # pixels each way
_RINGS: Final = 40  # of points that stand for the opening


@dataclass(frozen=True, slots=True)
class UncertaintySummary:
    """Root mean squares over the image, of all causes and of each; the manifest's ``uncertainty`` [gray level]."""

    sigma_rms_gray: NotNegative
    parts_rms_gray: Mapping[str, NotNegative]


@dataclass(frozen=True, slots=True, eq=False)
class Uncertainty:
    """How far a captured frame may be off the prediction.

    Attributes
    ----------
    sigma : ndarray, shape (rows, columns)
        Standard deviation [gray level].
    parts : Mapping[str, float]
        Root mean square over the image of what each cause adds [gray level].
    """

    sigma: Array
    parts: Mapping[str, float]

    def summary(self) -> UncertaintySummary:
        """What the manifest says."""
        return UncertaintySummary(float(np.sqrt(np.mean(self.sigma**2))), dict(self.parts))


def uncertainty(
    exposure: ExposureImage,
    camera: Camera,
    tolerances: Tolerances,
    ray_error: float,
    spread: Array | None = None,
    *,
    magnification: Array | None = None,
    blur_slope: Array | None = None,
) -> Uncertainty:
    """Combine all causes; arguments as of `uncertainty_squares`."""
    return combined(
        uncertainty_squares(
            exposure, camera, tolerances, ray_error, spread, magnification=magnification, blur_slope=blur_slope
        )
    )


def combined(squares: Mapping[str, Array]) -> Uncertainty:
    """All causes together, of what each adds at each pixel; see `uncertainty_squares`."""
    sigma = np.sqrt(np.sum(list(squares.values()), axis=0))
    return Uncertainty(sigma, {name: math.sqrt(float(square.mean())) for name, square in squares.items()})


def uncertainty_squares(
    exposure: ExposureImage,
    camera: Camera,
    tolerances: Tolerances,
    ray_error: float,
    spread: Array | None = None,
    *,
    magnification: Array | None = None,
    blur_slope: Array | None = None,
) -> dict[str, Array]:
    """Square of what each cause adds at each pixel, shape (rows, columns) [gray level^2].

    Parameters
    ----------
    exposure : ExposureImage
        The prediction [J m^-2].
    camera : Camera
        Its sensor, opening and exposure time.
    tolerances : Tolerances
        Of what goes in.
    ray_error : float
        Estimated rms error of the rays over the image [gray level]; it is laid where gray levels change.
    spread : ndarray, shape (rows, columns), optional
        Root of the sum of squares of the sources' shares in each pixel, 1 where one source alone lights it; needed with
        `each_source_radiance`.
    magnification : ndarray, shape (rows, columns), optional
        M of what each pixel sees (`Camera.magnification`); needed with `aperture_diameter` behind a lens, whose blur
        it scales.
    blur_slope : ndarray, shape (rows, columns), optional
        Relative change of the radiant exposure with the logarithm of the opening's diameter, its area held, where it is
        known of the image: of waves, which have no second moments. Else it is that of the opening's, by rays.
    """
    values, sensor = exposure.values, camera.sensor
    straight = unclipped_gray(values, sensor)
    sees = straight < sensor.saturation_gray + _SURELY_CUT * ray_error
    signal = np.minimum(straight, sensor.saturation_gray) - sensor.dark_gray
    squares: dict[str, Array] = {"rays": ray_error**2 * _where_rays_err(signal, sees)}

    def by_exposure(name: str, factor: Callable[[float], float | Array]) -> None:
        """A cause that multiplies the radiant exposure by factor(z) at z standard deviations."""
        up, down = (gray_levels(values * np.maximum(factor(z), 0.0), sensor) for z in (1.0, -1.0))
        squares[name] = ((up - down) / 2) ** 2

    if tolerances.source_radiance:
        by_exposure("source_radiance", lambda z: 1 + z * tolerances.source_radiance * TO_STANDARD)
    if tolerances.each_source_radiance:
        if spread is None:
            raise ValueError("the sources' shares are needed")
        by_exposure("each_source_radiance", lambda z: 1 + z * tolerances.each_source_radiance * TO_STANDARD * spread)
    if tolerances.aperture_diameter:
        blur = _blur_slope(values, camera) if blur_slope is None else blur_slope
        if camera.lens is not None and blur_slope is None:
            if magnification is None:
                raise ValueError("the magnifications are needed")
            # The opening's second moments on the sensor go with M^2: none in the plane of focus.
            blur = blur * magnification**2
        by_exposure(
            "aperture_diameter",
            lambda z: _aperture_factor(camera, z * tolerances.aperture_diameter * TO_STANDARD, blur),
        )
    if tolerances.exposure_time and camera.exposure_time > 0:
        by_exposure("exposure_time", lambda z: 1 + z * tolerances.exposure_time * TO_STANDARD / camera.exposure_time)
    for name, key, size in (
        ("sensor_gain", "gain", sensor.gain * tolerances.sensor_gain),
        ("dark_gray", "dark_gray", tolerances.dark_gray),
    ):
        if name == "sensor_gain" and size and sensor.linear is not None and sensor.gamma != 1.0:
            # The power law stands behind the converter: it bends what the gain has scaled.
            by_exposure(name, lambda z: 1 + z * tolerances.sensor_gain * TO_STANDARD)
        elif size:
            squares[name] = _by_sensor(values, sensor, key, size * TO_STANDARD)
    if sensor.linear is not None:
        squares["noise"] = noise_variance(values, sensor)
    elif sensor.rounding:
        squares["rounding"] = np.full(values.shape, ROUNDING_VARIANCE)
    return squares


def _where_rays_err(signal: Array, sees: NDArray[np.bool_] | None = None) -> Array:
    """Square of the rays' error at each pixel, over its mean: it goes with how much gray levels change around.

    The certificate knows the mean alone. Half of it is laid on edges, half on each pixel by its light, as in half
    shadows rays err all over; where there is no light they cannot err, nor where all of it is cut: but for `sees`.
    """
    framed = np.pad(signal, 1, mode="edge")
    change = (_of_nine(framed, np.maximum) - _of_nine(framed, np.minimum)) ** 2
    even = signal**2 if sees is None else np.where(sees, signal, 0.0) ** 2
    light, edges = float(even.mean()), float(change.mean())
    if light == 0.0:
        return np.ones_like(signal) if edges == 0.0 else change / edges
    even /= light
    return even if edges == 0.0 else _EVEN_SHARE * even + (1 - _EVEN_SHARE) * change / edges


def _of_nine(framed: Array, of_two: np.ufunc) -> Array:
    """What `of_two` leaves of each pixel and its eight neighbours; the frame is lost."""
    columns = of_two(of_two(framed[:-2], framed[1:-1]), framed[2:])
    found: Array = of_two(of_two(columns[:, :-2], columns[:, 1:-1]), columns[:, 2:])
    return found


def _aperture_factor(camera: Camera, change: float, blur: Array) -> Array:
    """By how much a change of the diameter [m] changes the radiant exposure: more light, and more blur."""
    opening = camera.aperture
    key = "exposure_diameter" if opening.is_infinitesimal else "diameter"
    before = getattr(opening, key)
    # A diameter of nothing would be taken for the infinitesimal pinhole.
    after = max(before + change, opening.inner_diameter, math.ulp(1.0))
    area = replace(opening, **{key: after}).area / opening.area
    factor: Array = area * (1 + math.log(after / before) * blur)
    return factor


def _blur_slope(values: Array, camera: Camera) -> Array:
    """Relative change of the radiant exposure with the logarithm of the opening's size, its area held.

    Blur by a small opening is exp(C:DD/2), with C the second moments of its shape on the sensor; its slope by the
    logarithm of the size is C:DD, taken on the blurred image itself. That of a pinhole grows at near things:
    this is left out. Behind a lens it is the slope of M = 1.
    """
    if camera.aperture.is_infinitesimal or min(values.shape) < _FEWEST_FOR_BLUR:
        return np.zeros_like(values)
    points, weights = opening_points(camera.aperture, camera.aperture.reach / _RINGS)
    places = points / (camera.sensor.pixel_width, camera.sensor.pixel_height)
    (across, mixed), (_, down) = (places * weights[:, np.newaxis]).T @ places
    p = np.pad(values, 1, mode="edge")
    here = p[1:-1, 1:-1]
    change = across * (p[1:-1, 2:] + p[1:-1, :-2] - 2 * here) + down * (p[2:, 1:-1] + p[:-2, 1:-1] - 2 * here)
    change += 2 * mixed * (p[2:, 2:] + p[:-2, :-2] - p[2:, :-2] - p[:-2, 2:]) / 4
    slope: Array = np.where(values > 0, change / np.where(values > 0, values, 1.0), 0.0)
    return slope


def _by_sensor(values: Array, sensor: Sensor, key: str, size: float) -> Array:
    up, down = (gray_levels(values, replace(sensor, **{key: getattr(sensor, key) + z * size})) for z in (1.0, -1.0))
    square: Array = ((up - down) / 2) ** 2
    return square


def share_spread(views: Sequence[View]) -> Array:
    """Root of the sum of squares of the sources' shares in each pixel, by its central ray.

    Parameters
    ----------
    views : sequence of View
        The same camera in the light of each source alone.

    Returns
    -------
    ndarray, shape (rows, columns)
        Between 1/sqrt(sources) and 1; that of the whole image where the central ray sees nothing.
    """
    sensor = views[0].camera.sensor
    u, v = places_of(np.arange(sensor.pixels), sensor.columns)
    spread = spread_of(trace_rays(view, np.zeros((1, 2)), u, v)[0] for view in views)
    return spread.reshape(sensor.rows, sensor.columns)


def spread_of(parts: Iterable[Array]) -> Array:
    """Root of the sum of squares of the shares that each part of an image has in its sum; see `share_spread`."""
    total = square = np.zeros(())
    sums = []
    for values in parts:
        total = total + values
        square = square + values**2
        sums.append(float(values.sum()))
    whole = math.sqrt(sum(value**2 for value in sums)) / sum(sums) if sum(sums) > 0 else 1.0
    spread: Array = np.where(total > 0, np.sqrt(square) / np.where(total > 0, total, 1.0), whole)
    return spread


def seen_magnifications(view: View) -> Array:
    """M of what each pixel's central ray meets, shape (rows, columns)."""
    sensor = view.camera.sensor
    u, v = places_of(np.arange(sensor.pixels), sensor.columns)
    return magnifications_at(view, u, v).reshape(sensor.rows, sensor.columns)
