"""Depth, parts and true positions, as files."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from radwrap.images import read_image, write_exr, write_png
from radwrap.imaging.truth import central_maps, geometry
from radwrap.manifest import SCHEMA_VERSION, read_manifest, write_manifest
from radwrap.scene.scene import Scene
from radwrap.tracers.tracer import Tracer

DEPTH: Final = "depth.exr"
PARTS: Final = "mask.png"
TRUTH: Final = "truth.json"


def write_truth(folder: Path, scene: Scene, part_names: tuple[str, ...], numbered: Tracer) -> list[str]:
    """Trace what each pixel's centre sees, by a tracer that tells parts from each other, and write it; the names."""
    depth, parts = central_maps(scene.camera, numbered)
    write_exr(folder / DEPTH, depth, channel="depth", metadata={"radwrap:unit": "m"})
    write_png(folder / PARTS, parts)
    write_manifest(folder / TRUTH, {"schema_version": SCHEMA_VERSION, **geometry(scene, part_names)})
    return [DEPTH, PARTS, TRUTH]


def read_truth(folder: Path) -> dict[str, Any]:
    """What truth.json holds, with ``depth`` and ``mask``."""
    return {
        **read_manifest(folder / TRUTH),
        "depth": read_image(folder / DEPTH)[0],
        "mask": read_image(folder / PARTS)[0],
    }
