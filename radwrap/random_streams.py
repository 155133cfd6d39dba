"""Where random numbers come from: each purpose has a stream of its own, told by a number beside the seed.

The numbers decide bytes, so that none is ever changed or used again. Those of
one class stand at the same place beside the same seed; where two classes have
a number in common, the note says what else tells them apart.
"""

from __future__ import annotations

from enum import IntEnum, unique

import numpy as np


@unique
class Rendering(IntEnum):
    """Of an image: (seed, number, ...)."""

    CELLS = 1  # then the tile
    TILE = 2  # then replicate and tile
    CERTIFIED_PIXELS = 3
    CERTIFIED_RAYS = 4
    CERTIFIED_RESAMPLES = 5
    SURVEYED_PIXELS = 6
    SURVEYED_RAYS = 7
    SURVEYED_MODEL = 8  # then the number of pairs
    SURVEYED_RESAMPLES = 9
    MODEL_PIXELS = 10  # then the effort
    MODEL_RAYS = 11  # then the effort and the number of pairs
    MODEL_RESAMPLES = 12  # then the effort
    EFFECT_PATHS = 14
    EFFECT_RESAMPLES = 15
    TRACER_PROBE = 18
    REHEARSED_TILES = 19
    CORRECTED_PIXELS = 24  # then the tile
    CORRECTIONS = 25  # then replicate and tile
    FORESEEN_PIXELS = 26
    LIT_PIXELS = 27
    LIT_RAYS = 28
    SAMPLED_BLOCKS = 29
    WAVES = 30
    WAVE_RESAMPLES = 31
    WAVE_CELLS = 32  # then the tile
    WAVE_RAYS = 33  # then replicate and tile
    WAVE_FAR = 34  # then the replicate
    INSTANTS = 35  # then the level
    POINTS_NOISE = 36
    LEVEL_SHARES = 37
    RAYS_OF_PIXELS = 38  # then the tile


@unique
class Relighting(IntEnum):
    """Of a light basis."""

    MODEL_RAYS = 15  # (seed, number, number of pairs): longer than that of effects
    KEPT_PIXELS = 16  # (tile, number): no seed, as all replicates keep the same
    RESAMPLES = 17  # (number)


@unique
class Camera(IntEnum):
    """Of a linear camera's noise."""

    PATTERN = 21  # (seed of the specimen, number)
    FRAME = 22  # (seed, frame, number)


@unique
class Trading(IntEnum):
    """Of a trade's reference: (seed, number)."""

    PIXELS = 20
    PILOT = 21
    RAYS = 22
    RESAMPLES = 23


@unique
class Studying(IntEnum):
    """Of a study's evaluation, each first in its key; `FRESH_ROW` stands behind the seed."""

    IMAGE_ERROR = 41
    DOT_CENTRES = 43
    TOLERANCE_MODEL = 47
    LENTH = 1989
    FRESH_ROW = 1 << 20  # of draws: none that a study made


@unique
class Drawing(IntEnum):
    """Of a dataset: (stream, image, number of the table) beside the seed, see `spawned`."""

    VARIED = 71
    PARTS = 72
    RENDER = 73


@unique
class Measuring(IntEnum):
    """Of a measurement, each first in its key; images give no seed."""

    RIMS = 61  # then the number of points


def generator(*key: int) -> np.random.Generator:
    """Random numbers that a key decides: seed, stream, and what else tells them apart."""
    return np.random.default_rng(tuple(map(int, key)))


def spawned(seed: int, *key: int) -> np.random.Generator:
    """Random numbers of a child of a seed's sequence: another key is independent of it, and nothing else decides it."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(map(int, key))))
