"""An image as a study looks at it: all that a measurement may use, and what its error does to what is measured."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radwrap.calibrate.several_views import ViewsCalibration
from radwrap.calibrate.views import DistortionModel
from radwrap.errors import InputError
from radwrap.images import GrayImage
from radwrap.imaging.tolerance.kept_replicates import KeptReplicates
from radwrap.measure.dots import SoughtDots
from radwrap.measure.edges import Edge
from radwrap.measure.mosaic import RawChannel, colour_image, colour_levels
from radwrap.scene.scene import Scene
from radwrap.study.image_error import Cause, Changed, ErrorFields, ImageError, changed_by_replicates, copies_of
from radwrap.study.target_points import Detector
from radwrap.study.user_call import Called
from radwrap.study.user_function import UserFunction

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """An image, and all that a measurement may use.

    Attributes
    ----------
    scene : Scene
        Its truth, and its sensor.
    image : GrayImage
        What the camera gives.
    gray : ndarray
        The same before rounding.
    error : ImageError
        How far it may be off.
    fields : ErrorFields
        How that may lie.
    replicates : KeptReplicates, optional
        Of the image, where it has them: radiant exposure [J m^-2].
    exposure : ndarray, optional
        Its own [J m^-2].
    model : ImageError, optional
        Of an image with replicates: what the kernel's model may add to what they show.
    channel : RawChannel, optional
        Where what is measured is that colour of the raw image of a colour camera: `image` and `gray` have its filter on
        all pixels, and pixels of other colours are passed over for means of neighbours before anything is measured.
    sought : dict
        Dots that were found on it and its copies, by copy, board and dark level: several responses measure the same.
    edges : dict
        The edge on each copy, likewise, by dark level and gamma.
    points : dict
        Rms distance of a target's points on each copy from the truth [px], likewise, by target and detector.
    planned : dict
        Calibrations by planned views of a target, by its name, their number, tilt and model.
    seed : int
        Of its run: decides the noise of frames.
    home : Path, optional
        Folder of the design, where the user's own functions lie.
    told : Mapping
        What a user's function is told of the image.
    called : dict
        What users' functions gave for it, its copies and its frames.
    """

    scene: Scene
    image: GrayImage
    gray: Array
    error: ImageError
    fields: ErrorFields
    replicates: KeptReplicates | None = None
    exposure: Array | None = None
    model: ImageError | None = None
    channel: RawChannel | None = None
    sought: dict[tuple[int, str | None, float | None], SoughtDots] = field(default_factory=dict)
    edges: dict[tuple[int, float | None, float | None], Edge] = field(default_factory=dict)
    points: dict[tuple[int, str, Detector], float] = field(default_factory=dict)
    planned: dict[tuple[str, int, float, DistortionModel], ViewsCalibration] = field(default_factory=dict)
    seed: int = 0
    home: Path | None = None
    told: Mapping[str, Any] = field(default_factory=dict)
    called: dict[tuple[UserFunction, int], Sequence[Called]] = field(default_factory=dict)

    def changed(self) -> Iterator[Changed]:
        """The image with errors as they may be."""
        for copy in self._changed():
            if self.channel is None:
                yield copy
            else:
                yield replace(copy, gray=colour_levels(copy.gray, self.channel), image=self.raw_seen(copy.image))

    def raw_seen(self, image: GrayImage) -> GrayImage:
        """An image as a colour camera's raw image shows it, where that is measured; else the image."""
        return image if self.channel is None else colour_image(image, self.channel.pattern, self.channel.colour)

    def as_raw(self, channel: RawChannel | None) -> Seen:
        """Itself as the raw image of a colour camera shows it in one colour; all pixels have that colour's filter."""
        if channel is None:
            return self
        raw = replace(self, channel=channel, gray=colour_levels(self.gray, channel))
        return replace(raw, image=raw.raw_seen(self.image))

    def _changed(self) -> Iterator[Changed]:
        """The image with errors as they may be, of all pixels."""
        sensor = self.scene.camera.sensor
        if self.replicates is None or self.exposure is None:
            yield from copies_of(self.gray, self.error, self.fields, sensor)
            return
        yield from changed_by_replicates(self.exposure, self.replicates, sensor)
        if self.model is not None:
            yield from copies_of(self.gray, self.model, self.fields, sensor)


@dataclass(frozen=True, slots=True)
class Answer:
    """A value and its standard uncertainty by the image's certified error, in SI, and what the gauge warns of."""

    value: float
    error: float
    warnings: tuple[str, ...] = ()


def tried(measure: Callable[[Any], float], what: Any) -> float:
    """The measurement, NaN where it finds nothing."""
    try:
        return measure(what)
    except InputError:
        return math.nan


def spread(value: float, again: list[tuple[Cause, float]]) -> Answer:
    """The value with the rms change by each cause of errors; half of the copies at least must still show it."""
    changes = {cause: np.array([other - value for own, other in again if own == cause]) for cause, _ in again}
    if 2 * sum(int(np.isfinite(some).sum()) for some in changes.values()) < len(again):
        raise InputError("is lost in most images that differ by no more than their error")
    good = [some[np.isfinite(some)] for some in changes.values()]
    if not all(some.size for some in good):
        raise InputError("is lost in every image that differs by no more than one cause of its error")
    return Answer(value, math.sqrt(sum(float(np.mean(some**2)) for some in good)))


def again(seen: Seen, measure: Callable[[GrayImage], float]) -> Answer:
    """Measure the image, and copies of it with its error."""
    return again_by_number(seen, lambda _, image: measure(image))


def again_with_warnings(seen: Seen, measure: Callable[[GrayImage], Any], value: Callable[[Any], float]) -> Answer:
    """The same for a gauge: one of its numbers, and what it warns of on the image itself."""
    found = measure(seen.image)
    copies = [(copy.cause, tried(lambda image: value(measure(image)), copy.image)) for copy in seen.changed()]
    return replace(spread(value(found), copies), warnings=tuple(found.warnings))


def again_by_number(seen: Seen, measure: Callable[[int, GrayImage], float]) -> Answer:
    """The same where a measurement knows the copy by its number from 1, the image itself by 0."""
    copies = enumerate(seen.changed(), 1)
    again = [(copy.cause, tried(partial(measure, number), copy.image)) for number, copy in copies]
    return spread(measure(0, seen.image), again)
