"""A scene's central view as a POV-Ray file."""

from __future__ import annotations

import tempfile
from pathlib import Path

from radwrap.errors import InputError
from radwrap.files import make_folder, write_bytes
from radwrap.process import Programs
from radwrap.scene.scene import Scene
from radwrap.tracers.povray_text import povray_camera, povray_scene
from radwrap.tracers.radiance import RadianceOptions, prepare
from radwrap.tracers.text_frame import users_frame


def write_povray(scene: Scene, path: Path, options: RadianceOptions) -> tuple[Path, ...]:
    """Write a scene for POV-Ray 3.7, seen through the pinhole's centre.

    Its values are radiances; ``Scale`` brings them into the range of the picture's format.

    Raises
    ------
    InputError
        Naming what POV-Ray cannot express, or if the camera has a lens.
    """
    if scene.camera.lens is not None:
        raise InputError(
            "a file of the central view holds no lens",
            where=f"{scene.origin}: camera.lens",
            remedy="leave it out; radwrap crosscheck traces a lens by POV-Ray",
        )
    frame = users_frame(scene)
    with Programs() as programs, tempfile.TemporaryDirectory(prefix="radwrap-") as work:
        included = prepare(scene, options, programs, Path(work), frame=frame).included if scene.included else {}
    camera = povray_camera(scene.camera, (0.0, 0.0), frame)
    sensor = scene.camera.sensor
    head = (
        f"// povray +I{path.name} +W{sensor.columns} +H{sensor.rows} +FE writes radiances as OpenEXR.\n"
        "#version 3.7;\n#declare Scale = 1.0;\n"
    )
    make_folder(path.parent)
    write_bytes(path, f"{head}{povray_scene(scene, included, frame)}\n{camera}".encode())
    return (path,)
