"""What an algorithm reads from a turn's image: numbers of a study, each with its certified error."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from radwrap.errors import InputError
from radwrap.imaging.relight.relit import Relit
from radwrap.scene.scene import Scene
from radwrap.scene.targets import DotBoard, EdgeTarget
from radwrap.study.image_error import blur_radii, error_fields
from radwrap.study.responses import KINDS, Response, answer
from radwrap.study.worker import seen_of_relit

_DOTS: Final = ("dot_error", "focal_length")
_EDGE: Final = ("edge_position", "edge_error", "edge_blur")
_PARTS: Final = ("part_orientation",)
_ALWAYS: Final = ("contrast",)


@dataclass(frozen=True, slots=True)
class Measured:
    """One number.

    Attributes
    ----------
    name, what, unit : str
        Its kind in a study, what it is, and in which unit it is told; a bare number has none.
    value, error : float or None
        The number, and its standard uncertainty by the image's error; None where the image does not show it.
    notes : tuple of str
        Why it does not, or what the measurement warns of.
    """

    name: str
    what: str
    unit: str
    value: float | None
    error: float | None
    notes: tuple[str, ...] = ()


def kinds_of(scene: Scene) -> tuple[str, ...]:
    """What there is to measure: dots and an edge where there are such targets, else the largest part."""
    boards = _DOTS if any(isinstance(target, DotBoard) for target in scene.targets) else ()
    edges = _EDGE if any(isinstance(target, EdgeTarget) for target in scene.targets) else ()
    return (*(boards + edges or _PARTS), *_ALWAYS)


def measured(scene: Scene, image: Relit) -> list[Measured]:
    """Measure an image as a study without options does.

    Parameters
    ----------
    scene : Scene
        With the camera of the image.
    image : Relit
        With its certificate.
    """
    return list(_each(scene, image))


def _each(scene: Scene, image: Relit) -> Iterator[Measured]:
    sensor = scene.camera.sensor
    seen = seen_of_relit(scene, image, error_fields((sensor.rows, sensor.columns), blur_radii(scene)))
    for kind in kinds_of(scene):
        response = Response(kind, kind, KINDS[kind].unit)
        try:
            found = answer(response, seen)
        except InputError as error:
            yield Measured(kind, response.what, response.unit, None, None, (error.what,))
            continue
        value, off = found.value / response.scale, found.error / response.scale
        yield Measured(kind, response.what, response.unit, value, off, found.warnings)
