"""The largest rectangle of pixels that show one target and nothing else."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.scene.camera import Camera
from radwrap.scene.look.geometry import directions
from radwrap.scene.look.intersections import Bounded, first_hit, reached
from radwrap.scene.targets import Target

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_MOST_RAYS: Final = 200_000  # one for each pixel of a small sensor
_BESIDE: Final = 1.0  # px of margin besides blur: what a pixel averages


def seen_box(camera: Camera, targets: Iterable[Target], name: str) -> tuple[int, int, int, int]:
    """First column and row, last column and row of the largest rectangle that shows a target alone [px].

    It keeps as far from whatever else is seen as the target is blurred. Rays through the opening's centre decide, of
    large sensors one for several pixels; included Radiance files are not known.

    Raises
    ------
    InputError
        If no pixel shows the target alone.
    """
    sensor = camera.sensor
    step = max(1, math.ceil(math.sqrt(sensor.pixels / _MOST_RAYS)))
    u, v = (np.arange((count - 1) % step / 2, count, step) for count in (sensor.columns, sensor.rows))
    rays = directions(camera, np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
    distance, mine = _first(camera, targets, rays, name)
    shown = mine.reshape(len(v), len(u))
    margin = 0
    if shown.any():
        depth = (distance * (rays @ np.asarray(camera.pose.z_axis)))[mine]
        blur = (
            camera.aperture.diameter / 2 * max(abs(float(camera.magnification(d))) for d in (depth.min(), depth.max()))
        )
        margin = math.ceil((blur / min(sensor.pixel_width, sensor.pixel_height) + _BESIDE + step / 2) / step)
    found = _largest(_eroded(shown, margin))
    if found is None:
        raise InputError(f'no pixel shows "{name}" and nothing else', remedy="give the region by its pixels")
    left, top, right, bottom = found
    return math.ceil(u[left]), math.ceil(v[top]), math.floor(u[right]), math.floor(v[bottom])


def _first(camera: Camera, targets: Iterable[Target], rays: Array, name: str) -> tuple[Array, Flags]:
    """How far each ray goes, and whether it ends on the target."""
    eye = np.asarray(camera.pose.position)
    nearest = np.full(len(rays), math.inf)
    mine = np.zeros(len(rays), dtype=bool)
    for target, numbers in reached(Bounded.of(targets), camera.pose.position, rays):
        distance = first_hit(target, eye, rays[numbers])[0]
        closer = distance < nearest[numbers]
        nearest[numbers[closer]] = distance[closer]
        mine[numbers[closer]] = target.name == name
    return nearest, mine


def _eroded(shown: Flags, margin: int) -> Flags:
    """Without what lies within a margin of something else; the image's own border is none."""
    padded = np.pad(~shown, margin, mode="constant", constant_values=False).astype(np.int64)
    sums = np.pad(padded.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    width = 2 * margin + 1
    others = sums[width:, width:] - sums[:-width, width:] - sums[width:, :-width] + sums[:-width, :-width]
    kept: Flags = others == 0
    return kept


def _largest(some: Flags) -> tuple[int, int, int, int] | None:
    """The rectangle of most places that are all set: of each row the tallest bars that end there, by a stack."""
    best, area = None, 0
    height = np.zeros(some.shape[1], dtype=np.intp)
    for row in range(some.shape[0]):
        height = np.where(some[row], height + 1, 0)
        stack: list[tuple[int, int]] = []  # where bars begin, and how tall they are
        for column, tall in enumerate([*height.tolist(), 0]):
            start = column
            while stack and stack[-1][1] >= tall:
                start, high = stack.pop()
                if high * (column - start) > area:
                    best, area = (start, row - high + 1, column - 1, row), high * (column - start)
            stack.append((start, tall))
    return best
