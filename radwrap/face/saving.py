"""What a turn leaves in the folder that --out named: names are the server's own."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any, Final

import numpy as np

from radwrap.errors import InputError
from radwrap.face.profile import Ends, profile_table
from radwrap.face.traced import Image, Traced
from radwrap.files import TEMPORARY_SUFFIX, disk_failure, make_folder, sole_owner, temporary_name, write_bytes
from radwrap.images import PREVIEW_BITS, preview_codes, write_exr, write_png
from radwrap.imaging.page.turn import Turn
from radwrap.manifest import write_manifest
from radwrap.scene.file.load import scene_from_document
from radwrap.scene.file.turned import with_levels
from radwrap.scene.scene import Scene

_MOST: Final = 10_000


def turned_scene(traced: Traced, turn: Turn, image: Image) -> Scene:
    """The scene with its knobs turned; raises as `with_levels`."""
    return with_levels(traced.scene, dict(zip(traced.sources, turn.factors, strict=True)), image.changes)


def scene_text(scene: Scene) -> str:
    """A scene file."""
    import tomli_w

    return f"# Written by radwrap face from {scene.origin}.\n\n{tomli_w.dumps(json.loads(scene.document))}"


def save(out: Path, traced: Traced, turn: Turn, image: Image, line: tuple[Ends, int] | None) -> tuple[Path, str]:
    """Write gray.png, its deviations, the turned scene and the profile into a new folder of `out`, all or nothing.

    Returns
    -------
    Path, str
        The folder, and a note where the scene file could not be written, or not for that place.

    Raises
    ------
    EnvironmentFailure
        If the disk refuses.
    """
    make_folder(out)
    with sole_owner(out):
        for leftover in out.glob(f".turn_*{TEMPORARY_SUFFIX}"):  # of a server that was killed
            shutil.rmtree(leftover, ignore_errors=True)
        folder = next(path for k in range(1, _MOST) if not (path := out / f"turn_{k:04d}").exists())
        begun = temporary_name(folder)
        try:
            make_folder(begun)
            note = _write_all(begun, traced, turn, image, line)
            begun.rename(folder)
        except OSError as error:
            raise disk_failure(folder, error) from error
        finally:
            shutil.rmtree(begun, ignore_errors=True)
    return folder, note


def _write_all(folder: Path, traced: Traced, turn: Turn, image: Image, line: tuple[Ends, int] | None) -> str:
    write_png(folder / "gray.png", image.relit.gray.codes)
    if image.relit.gray.bit_depth > PREVIEW_BITS:
        write_png(folder / "preview.png", preview_codes(image.relit.gray))
    write_exr(folder / "gray_sigma.exr", image.sigma.astype(np.float32), channel="gray_sigma")
    exposure = image.relit.radiant_exposure.values.astype(np.float32)
    unit = {"radwrap:unit": "J m^-2"}
    write_exr(folder / "radiant_exposure.exr", exposure, channel="radiant_exposure", metadata=unit)
    if line is not None:
        write_bytes(folder / "profile.csv", profile_table(image, *line).encode())
    note = _write_scene(folder, traced, turn, image)
    told: dict[str, Any] = {
        **traced.told(turn, image),
        "levels": dict(zip(traced.sources, turn.factors, strict=True)),
        "changed": dict(image.changes),
    }
    write_manifest(folder / "turn.json", told)
    return note


def _write_scene(folder: Path, traced: Traced, turn: Turn, image: Image) -> str:
    try:
        scene = turned_scene(traced, turn, image)
    except InputError as error:
        return f"no scene.toml: {error}"
    write_bytes(folder / "scene.toml", scene_text(scene).encode())
    try:
        scene_from_document(json.loads(scene.document), origin=scene.origin, folder=folder)
    except InputError:
        return f"scene.toml names files that lie beside {scene.origin}: move it there"
    return ""
