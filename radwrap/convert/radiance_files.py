"""A scene as files that plain Radiance tools read."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

from radwrap.files import make_folder, write_bytes
from radwrap.process import Programs
from radwrap.scene.camera import Camera
from radwrap.scene.scene import Scene
from radwrap.tracers.radiance import RadianceOptions, prepare
from radwrap.tracers.radiance_text import scales_of


def write_scene(scene: Scene, path: Path, options: RadianceOptions) -> tuple[Path, ...]:
    """Write a scene as Radiance text, its function and data files beside it.

    ``oconv`` reads the text when it is run in that folder.

    Parameters
    ----------
    scene : Scene
        What to write.
    path : Path
        The .rad file.
    options : RadianceOptions
        For included files: which Radiance, and whether they are trusted.

    Returns
    -------
    tuple of Path
        All files that were written, the scene last.
    """
    with Programs() as programs, tempfile.TemporaryDirectory(prefix="radwrap-") as work:
        prepared = prepare(scene, options, programs, Path(work))
    written = []
    for name, content in sorted(prepared.scene.files.items()):
        make_folder((path.parent / name).parent)
        write_bytes(path.parent / name, content)
        written.append(path.parent / name)
    make_folder(path.parent)
    write_bytes(path, prepared.scene.text.encode())
    return (*written, path)


def view_text(camera: Camera, unit: float) -> str:
    """Central view as a Radiance view file, with all digits.

    The window is shifted where the principal point lies off the sensor's centre.

    Parameters
    ----------
    camera : Camera
        Whose view.
    unit : float
        Unit of length of the scene text that the view belongs to [m].
    """
    sensor = camera.sensor
    right = ((sensor.columns - 1) / 2 - camera.principal_point[0]) / sensor.columns
    down = ((sensor.rows - 1) / 2 - camera.principal_point[1]) / sensor.rows
    up = [-value for value in camera.pose.y_axis]
    numbers = {
        "-vp": [value / unit for value in camera.pose.position],
        "-vd": camera.pose.z_axis,
        "-vu": up,
        "-vh": [math.degrees(2 * math.atan(sensor.width / 2 / camera.focal_length))],
        "-vv": [math.degrees(2 * math.atan(sensor.height / 2 / camera.focal_length))],
        "-vs": [right],
        "-vl": [-down],
    }
    words = " ".join(f"{key} {' '.join(repr(value + 0.0) for value in values)}" for key, values in numbers.items())
    return f"rvu -vtv {words} -vo 0 -va 0\n"


def write_view(scene: Scene, path: Path) -> tuple[Path, ...]:
    """Write the central view; returns the file."""
    make_folder(path.parent)
    write_bytes(path, view_text(scene.camera, scales_of(scene).length).encode())
    return (path,)
