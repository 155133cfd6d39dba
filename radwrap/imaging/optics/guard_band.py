"""How far around a pixel diffraction is looked at closely; what it sends farther is told by blocks of pixels."""

from __future__ import annotations

from typing import Final

from radwrap.scene.camera import Sensor

# Blocks of a coarse image in a guard band's width: half of what goes beyond it comes from within twice that width, so
# that wider ones would move the light of an edge to where it is not. Their side in pixels, at least, and how many may
# lie on the sensor.
BLOCKS: Final = 4
FEWEST_BLOCK: Final = 1.0
_MOST_ON_SENSOR: Final = 1 << 19


def least_guard(sensor: Sensor) -> float:
    """Width of a guard band beyond which blocks tell what comes from where, few enough of which cover a sensor [px]."""
    block = FEWEST_BLOCK
    while sensor.pixels > _MOST_ON_SENSOR * block**2:
        block *= 2
    return BLOCKS * block
