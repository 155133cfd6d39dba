"""A scene as files that plain Radiance tools read."""

from __future__ import annotations

import hashlib
import math
import re
import tempfile
from pathlib import Path
from typing import Final

from radwrap.errors import InputError
from radwrap.files import make_folder, write_bytes
from radwrap.process import Programs
from radwrap.scene.camera import Camera
from radwrap.scene.scene import Scene
from radwrap.tracers.radiance import RadianceOptions, prepare
from radwrap.tracers.text_frame import users_frame

# Radiance's text holds no other words, and cuts the names of functions at 127 characters, of which the file's is part.
_PLAIN_STEM: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.+-]{0,29}")
_NOT_PLAIN: Final = re.compile(r"[^A-Za-z0-9_+-]")


def side_stem(path: Path) -> str:
    """What the names of the files beside a converted scene begin with: its own, as far as Radiance can hold that.

    Different scenes of one folder have different stems, so that none writes
    over another's files.
    """
    if _PLAIN_STEM.fullmatch(path.stem):
        return path.stem
    mark = hashlib.sha256(path.stem.encode(errors="surrogateescape")).hexdigest()[:8]
    return f"{_NOT_PLAIN.sub('_', path.stem[:20])}-{mark}"


def write_scene(scene: Scene, path: Path, options: RadianceOptions) -> tuple[Path, ...]:
    """Write a scene as Radiance text, its function and data files beside it.

    ``oconv`` reads the text when it is run in that folder. The files beside it
    are named after it, see `side_stem`.

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

    Raises
    ------
    InputError
        If the .rad file is one that the scene includes, or an included file breaks the trust rule.
    """
    for target in scene.included:
        if (scene.folder / target.file).resolve() == path.resolve():
            raise InputError("is a file that the scene includes", where=str(path), remedy="choose another name")
    with Programs() as programs, tempfile.TemporaryDirectory(prefix="radwrap-") as work:
        prepared = prepare(scene, options, programs, Path(work), side_stem(path), frame=users_frame(scene))
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
        "-vh": [math.degrees(2 * math.atan(sensor.width / 2 / camera.image_distance))],
        "-vv": [math.degrees(2 * math.atan(sensor.height / 2 / camera.image_distance))],
        "-vs": [right],
        "-vl": [-down],
    }
    words = " ".join(f"{key} {' '.join(repr(value + 0.0) for value in values)}" for key, values in numbers.items())
    return f"rvu -vtv {words} -vo 0 -va 0\n"


def write_view(scene: Scene, path: Path) -> tuple[Path, ...]:
    """Write the central view; returns the file.

    Raises
    ------
    InputError
        If the camera has a lens, or one that distorts, which a view file cannot hold.
    """
    camera, where = scene.camera, f"{scene.origin}: camera"
    if camera.distortion is not None:
        raise InputError("Radiance's views have no distortion", where=f"{where}.distortion", remedy="leave it out")
    if camera.lens is not None:
        raise InputError(
            "a view file holds no lens",
            where=f"{where}.lens",
            remedy="leave it out for the central view of a pinhole; rpict has -pd for a lens",
        )
    make_folder(path.parent)
    write_bytes(path, view_text(scene.camera, users_frame(scene).length).encode())
    return (path,)
