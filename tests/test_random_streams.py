"""Purposes do not share random numbers."""

from enum import IntEnum
from itertools import combinations

from radwrap import random_streams
from radwrap.random_streams import (
    Camera,
    Drawing,
    Measuring,
    Relighting,
    Rendering,
    Studying,
    Trading,
    generator,
    spawned,
)

STREAMS = (Rendering, Relighting, Camera, Trading, Studying, Measuring, Drawing)
# Numbers of two classes, and what else tells their keys apart. They decide bytes, so that they stay.
APART = {
    ("Rendering.EFFECT_RESAMPLES", "Relighting.MODEL_RAYS"): "the second goes on with the number of pairs",
    ("Camera.PATTERN", "Trading.PILOT"): "the seed of a specimen, and that of a reference",
    ("Camera.FRAME", "Trading.RAYS"): "the first stands third",
}


def test_every_class_of_streams_is_known() -> None:
    classes = {one for one in vars(random_streams).values() if isinstance(one, type) and issubclass(one, IntEnum)}
    assert classes - {IntEnum} == set(STREAMS)


def test_numbers_differ() -> None:
    every = [stream for one in STREAMS for stream in one]
    twice = {(_name(one), _name(other)) for one, other in combinations(every, 2) if int(one) == int(other)}
    assert twice == APART.keys()


def _name(stream: IntEnum) -> str:
    return f"{type(stream).__name__}.{stream.name}"


def test_streams_of_one_seed_are_told_apart() -> None:
    drawn = [generator(3, stream, 1).integers(2**62) for stream in Rendering]
    assert len(set(drawn)) == len(Rendering)
    assert generator(3, Rendering.TILE, 1).integers(2**62) == generator(3, 2, 1).integers(2**62)


def test_children_of_a_seed_are_told_apart() -> None:
    keys = [(Drawing.PARTS, 1), (Drawing.PARTS, 2), (Drawing.VARIED, 1), (Drawing.PARTS, 1, 0)]
    assert len({spawned(3, *key).integers(2**62) for key in keys}) == len(keys)
    assert spawned(3, *keys[0]).integers(2**62) == spawned(3, *keys[0]).integers(2**62)
    assert spawned(3, *keys[0]).integers(2**62) != spawned(4, *keys[0]).integers(2**62)
