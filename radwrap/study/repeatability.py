"""Repeatability of a measurement: how much it scatters from frame to frame of the same scene."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.images import ExposureImage, GrayImage
from radwrap.imaging.response.noise import fixed_pattern, noisy_frame
from radwrap.study.image_error import ErrorFields
from radwrap.study.response_kind import Kind, Options
from radwrap.study.seen import Answer, Seen, tried

Array = NDArray[np.float64]

FEWEST_FRAMES: Final = 2
MOST_FRAMES: Final = 10_000


def frames_of(seen: Seen, number: int) -> Iterator[GrayImage]:
    """Frames as one specimen of the scene's linear camera would send them, by the seed of the image's run."""
    assert seen.exposure is not None  # noqa: S101  (of each image that a study looks at)
    sensor = seen.scene.camera.sensor
    pattern, exposure = fixed_pattern(sensor), ExposureImage(seen.exposure)
    for frame in range(number):
        yield seen.raw_seen(noisy_frame(exposure, sensor, pattern, seen.seed, frame))


def repeatability(seen: Seen, kind: Kind, options: Options, frames: int) -> Answer:
    """Standard deviation of a measurement over frames that differ by noise.

    Parameters
    ----------
    seen : Seen
        The image.
    kind : Kind
        What is measured.
    options : Mapping
        Of the measurement.
    frames : int
        How many.

    Returns
    -------
    Answer
        The standard deviation, in SI, and its own standard uncertainty by the number of frames.

    Raises
    ------
    InputError
        If half of the frames do not show it.
    """
    # Dots draw errors of their centres where an image has no replicates: none for a frame.
    alone = {**options, "draws": 0} if "draws" in kind.options else options

    def value(frame: GrayImage) -> float:
        return kind.answer(_only(seen, frame), alone).value

    return scatter(np.array([tried(value, frame) for frame in frames_of(seen, frames)]), kind.period)


def scatter(values: Array, period: float | None = None) -> Answer:
    """Standard deviation of values, NaN where there is none, with its standard uncertainty.

    That of a normal scatter, s / sqrt(2 (n - 1)).
    """
    found = values[np.isfinite(values)]
    if 2 * len(found) <= len(values) or len(found) < FEWEST_FRAMES:
        raise InputError(f"is lost in {len(values) - len(found)} of {len(values)} frames")
    if period is not None:
        found = found[0] + (found - found[0] + period / 2) % period - period / 2
    deviation = float(found.std(ddof=1))
    return Answer(deviation, deviation / math.sqrt(2 * (len(found) - 1)))


def _only(seen: Seen, frame: GrayImage) -> Seen:
    """A frame for itself, as if it were free of error."""
    shape = frame.values.shape
    return replace(
        seen,
        image=frame,
        gray=frame.values,
        error=replace(seen.error, rms=0.0, variance=np.zeros(shape)),
        fields=ErrorFields(np.zeros((0, *shape))),
        replicates=None,
        model=None,
        sought={},
        edges={},
    )
