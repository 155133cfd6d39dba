"""How far a colour camera's raw image may be off, by what its colours are off."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.tolerance.certificate import Certificate
from radwrap.imaging.tolerance.uncertainty import Uncertainty
from radwrap.scene.mosaic import Colour, Pattern, composed, pixels_of

Array = NDArray[np.float64]


def error_of_all(
    pixels: Mapping[Colour, int], errors: Mapping[Colour, Certificate], own: Iterable[Certificate]
) -> Certificate:
    """Mean squares over the colours' pixels, and their largest quantile.

    Parameters
    ----------
    pixels : Mapping
        How many pixels a colour has.
    errors : Mapping
        How far they may be off.
    own : iterable of Certificate
        Those for which rays were traced, each once.
    """
    total = sum(pixels.values())
    weights = [pixels[colour] / total for colour in errors]
    bounds = list(errors.values())

    def rms(values: Sequence[float]) -> float:
        return math.sqrt(math.fsum(weight * value**2 for weight, value in zip(weights, values, strict=True)))

    def where_any(name: str) -> list[float] | None:
        values = [getattr(error, name) for error in bounds]
        return None if all(value is None for value in values) else [value or 0.0 for value in values]

    known = [error.p99_gray_upper95 for error in bounds if error.p99_gray_upper95 is not None]
    bands, waves, motion = (where_any(name) for name in ("bands_gray", "diffraction_gray", "motion_gray"))
    traced = list(own)
    return Certificate(
        rms_gray=rms([error.rms_gray for error in bounds]),
        rms_gray_upper95=rms([error.rms_gray_upper95 for error in bounds]),
        p99_gray_upper95=max(known) if len(known) == len(bounds) else None,
        model_rms_gray=rms([error.model_rms_gray for error in bounds]),
        discretisation_rms_gray=rms([error.discretisation_rms_gray for error in bounds]),
        certificate_pixels=sum(error.certificate_pixels for error in traced),
        certificate_rays=sum(error.certificate_rays for error in traced),
        method=", ".join(sorted({error.method for error in traced})),
        bands_gray=None if bands is None else max(bands),
        diffraction_gray=None if waves is None else rms(waves),
        motion_gray=None if motion is None else rms(motion),
    )


def without_error(like: Certificate) -> Certificate:
    """Of pixels that get no light; who says so is as of another colour."""
    return Certificate(
        rms_gray=0.0,
        rms_gray_upper95=0.0,
        p99_gray_upper95=0.0,
        model_rms_gray=0.0,
        discretisation_rms_gray=0.0,
        certificate_pixels=like.certificate_pixels,
        certificate_rays=like.certificate_rays,
        method=like.method,
    )


def uncertainty_of_all(pattern: Pattern, colours: Mapping[Colour, Uncertainty]) -> Uncertainty:
    """Standard deviation of each pixel, by its own colour, and rms values of the causes over all pixels."""
    sigma = composed(pattern, {colour: one.sigma for colour, one in colours.items()})
    pixels = {colour: pixels_of(pattern, colour, sigma.shape) for colour in colours}
    causes = dict.fromkeys(cause for one in colours.values() for cause in one.parts)

    def rms(cause: str) -> float:
        squares = (pixels[colour] * one.parts.get(cause, 0.0) ** 2 for colour, one in colours.items())
        return math.sqrt(math.fsum(squares) / sigma.size)

    return Uncertainty(sigma, {cause: rms(cause) for cause in causes})
