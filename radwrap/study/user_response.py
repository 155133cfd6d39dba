"""Answers of a user's function as responses: its values, their errors by the image's, and their repeatability."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import chain
from typing import Any

import numpy as np

from radwrap.errors import InputError
from radwrap.imaging.truth import geometry
from radwrap.study.repeatability import frames_of, scatter
from radwrap.study.seen import Answer, Seen, spread
from radwrap.study.user_call import Called, call_user_function
from radwrap.study.user_function import UserFunction


def user_answer(seen: Seen, function: UserFunction, key: str, frames: int, *, repeatability: bool) -> Answer:
    """One of the function's answers, or how much it scatters from frame to frame.

    The value's error is the function's own standard uncertainty and what the image's error does to the value, as
    squares.

    Raises
    ------
    InputError
        If the function gave none.
    """
    changed = list(seen.changed())
    called = _called(seen, function, frames)
    value, sigma = called[0].of(key)
    if repeatability:
        return scatter(np.array([_value(one, key) for one in called[1 + len(changed) :]]))
    by_image = spread(
        value, [(copy.cause, _value(one, key)) for copy, one in zip(changed, called[1:], strict=False)]
    ).error
    return Answer(value, math.hypot(sigma, by_image))


def _value(called: Called, key: str) -> float:
    try:
        return called.of(key)[0]
    except InputError:
        return math.nan


def _called(seen: Seen, function: UserFunction, frames: int) -> Sequence[Called]:
    """The function on the image, on what it may be, and on frames: once for all of its keys."""
    place = (function, frames)
    if place not in seen.called:
        assert seen.home is not None  # noqa: S101  (of each image that a study looks at)
        copies = (copy.image for copy in seen.changed())
        seen.called[place] = call_user_function(
            function,
            seen.home,
            chain([seen.image], copies, frames_of(seen, frames) if frames else ()),
            rounded=seen.scene.camera.sensor.rounding,
            manifest=seen.told,
            truth=truth_of(seen),
        )
    return seen.called[place]


def truth_of(seen: Seen) -> dict[str, Any]:
    """What truth.json holds of targets."""
    told = geometry(seen.scene, ())
    del told["parts"]  # numbers of a mask that is not traced here
    return told
