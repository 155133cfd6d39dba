"""From the keys that say what happens in the course of an exposure to their values in SI."""

from __future__ import annotations

from collections.abc import Sequence

from radwrap.scene.file.border import TargetBase
from radwrap.scene.file.sensor_tables import PixelsModel
from radwrap.scene.file.source_tables import Spectral
from radwrap.scene.motion import STILL, Motion
from radwrap.scene.scene import Scene
from radwrap.scene.shutter import Shutter, Strobe


def shutter_of(table: PixelsModel) -> Shutter | None:
    """The shutter of a sensor; None where all rows are exposed at once."""
    if table.shutter is None or table.shutter == "global" or table.line_time is None:
        return None
    return Shutter(table.shutter, table.line_time, table.readout or "down")


def motions_of(targets: Sequence[TargetBase], names: Sequence[str]) -> dict[str, Motion]:
    """Of each target that moves, how."""
    found = {
        name: Motion(table.velocity or STILL, table.angular_velocity or STILL)
        for table, name in zip(targets, names, strict=True)
    }
    return {name: motion for name, motion in found.items() if not motion.is_still}


def strobes_of(sources: Sequence[Spectral]) -> dict[str, Strobe]:
    """Of each source that is pulsed, when it shines."""
    return {
        table.name: Strobe(table.strobe.delay, table.strobe.width, table.strobe.period)
        for table in sources
        if table.strobe is not None
    }


def check_dark_current(scene: Scene, assumed: dict[str, str]) -> None:
    """Name the dark current that rows have besides where a global reset exposes them longer: it is left out."""
    sensor = scene.camera.sensor
    shutter, linear, time = sensor.shutter, sensor.linear, scene.camera.exposure_time
    if shutter is None or shutter.kind != "global_reset" or linear is None or not (linear.dark_signal and time):
        return
    more = linear.dark_signal * (sensor.rows - 1) * shutter.line_time / time
    assumed["camera.sensor.dark_current"] = f"as in the first row; the last one has {more:.2g} e more"
