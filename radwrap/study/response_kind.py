"""What all responses of a study have in common: a measurement, its unit and its options."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from radwrap.scene.scene import Scene
from radwrap.study.seen import Answer, Seen
from radwrap.units import Dimension

Options = Mapping[str, Any]
BOX: Final = (
    "box"  # as what an option may be: four whole numbers, the first and the last column and row; or a target's name
)


@dataclass(frozen=True, slots=True)
class Kind:
    """A measurement.

    Attributes
    ----------
    what : str
        For people.
    dimension : Dimension or None
        Of its value.
    unit : str
        In which it is told where nothing else is said.
    options : Mapping
        Name -> what it may be: choices, a type, "box", or "gray" for a number or "sensor".
    answer : callable
        Image and options -> value with error.
    copies : bool
        Whether its error is found on copies of the image.
    needed : tuple of str
        Options that must be given.
    period : float, optional
        Of an answer that comes round to itself, in SI.
    check : callable, optional
        Refuses a scene, with the options, that does not hold what is measured.
    """

    what: str
    dimension: Dimension | None
    unit: str
    options: Mapping[str, Any]
    answer: Callable[[Seen, Options], Answer]
    copies: bool = True
    needed: tuple[str, ...] = ()
    period: float | None = None
    check: Callable[[Scene, Options], object] | None = None
