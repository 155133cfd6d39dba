"""What a run decides once, before it traces, and the hash that it is known by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from radwrap.imaging.mean_radiance import how
from radwrap.imaging.relight.basis import shining
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.response.noise import linear_of
from radwrap.imaging.tracing import LaidOutScene, scene_sha256
from radwrap.manifest import sha256_of_value, versions
from radwrap.scene.catalog.presets import hashes_of
from radwrap.scene.scene import Scene


@dataclass(frozen=True, slots=True)
class Identity:
    """What a run is known by.

    Attributes
    ----------
    run_sha256 : str
        Hash of all that decides any file of the run.
    traced_sha256 : str
        Of what the tracer gets, and of the tracer.
    scene_sha256 : str
        Of the scene, however it is traced.
    sources : tuple of str
        Of the light basis; empty where none is asked for.
    versions : Mapping[str, str]
        Of everything that the files depend on.
    """

    run_sha256: str
    traced_sha256: str
    scene_sha256: str
    sources: tuple[str, ...]
    versions: Mapping[str, str]


def identity_of(scene: Scene, options: RenderOptions, traced: LaidOutScene) -> Identity:
    """What a run of a scene is known by.

    Raises
    ------
    InputError
        If frames or a basis are asked for that the scene cannot have.
    """
    used = {**versions(), **traced.tracer_versions}
    traced_sha256 = traced.sha256()
    if options.frames:
        linear_of(scene.camera.sensor)
    sources = shining(scene, traced.prepared) if options.basis else ()
    run_sha256 = sha256_of_value(
        {
            "traced": traced_sha256,
            "camera": scene.camera,
            "how": how(scene, options),
            "truth": options.truth,
            "basis": sources,
            **({"frames": options.frames} if options.frames else {}),
            "document": scene.document,
            **({"components": hashes} if (hashes := hashes_of(scene.components)) else {}),
            "versions": used,
        }
    )
    return Identity(run_sha256, traced_sha256, scene_sha256(scene, traced.prepared), sources, used)
