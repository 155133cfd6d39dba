"""What a scene says of the ring that is to be driven."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from typing import Final

from radwrap.errors import InputError
from radwrap.scene.scene import Scene
from radwrap.scene.sources import Emitter, Ring, emitters

# Lamps are placed by pick-and-place machines and told in whole micrometres; a wrong order is off by millimetres.
PLACED: Final = 0.5e-3  # m


def the_ring(scene: Scene) -> Ring:
    """The scene's one ring; nothing else may shine, since nothing else is driven.

    Raises
    ------
    InputError
        If that is not so.
    """
    rings = [source for source in scene.sources if isinstance(source, Ring)]
    if len(rings) != 1:
        raise InputError(f"has {len(rings)} rings, one can be driven", where=f"{scene.origin}: sources")
    others = [each.name for each in scene.sources if each is not rings[0] and any(e.radiance for e in emitters(each))]
    if others:
        raise InputError(
            f'"{others[0]}" shines too, and is not driven', where=f"{scene.origin}: sources", remedy="make it dark"
        )
    return rings[0]


def leds_of(scene: Scene) -> tuple[Emitter, ...]:
    """The LEDs of the scene's one ring, in their order."""
    return emitters(the_ring(scene))


def check_positions(positions: Sequence[tuple[float, float, float]], ring: Ring) -> None:
    """Compare where a device's lamps are with where the scene's LEDs are.

    All distances between two of them must agree: that holds however the device's own frame lies, and tells wrong
    diameters, orders and numbers, but not a mirrored order.

    Raises
    ------
    InputError
        Naming the two LEDs that differ most.
    """
    leds = [emitter.position for emitter in emitters(ring)]
    if len(positions) != len(leds):
        raise InputError(f"the device has {len(positions)} lamps, the scene's ring {len(leds)}", where=ring.name)
    worst = max(
        ((abs(math.dist(positions[a], positions[b]) - math.dist(leds[a], leds[b])), a, b)
         for a, b in combinations(range(len(leds)), 2)),
        default=(0.0, 0, 0),
    )  # fmt: skip
    if worst[0] > PLACED:
        _, a, b = worst
        there, here = (math.dist(places[a], places[b]) for places in (positions, leds))
        raise InputError(
            f"LEDs {a} and {b} are {1e3 * there:.2f} mm apart by the device and {1e3 * here:.2f} mm in the scene",
            where=ring.name,
            remedy="correct count, diameter and first_angle, or the wiring's order",
        )
