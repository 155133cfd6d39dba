"""Predicts the gray values that a machine-vision camera will capture.

The data's way::

    scene file with units                     load_scene
    -> Radiance text, rtrace                  once for each sub-viewpoint in the pinhole
    -> float32 images, merged by area         w_i = a_i/A
    -> radiant exposure on the pixel          Eqs. 1 to 3
    -> gray level                             Eq. 5: G = K H^gamma + G0

Examples
--------
>>> import radwrap
>>> scene = radwrap.load_scene("scene.toml")  # doctest: +SKIP
>>> brighter = radwrap.with_value(scene, "camera.exposure_time", "64 ms")  # doctest: +SKIP
>>> result = radwrap.render(brighter, viewpoints=61)  # doctest: +SKIP
>>> result.gray.values.max(), result.radiant_exposure.values.max()  # doctest: +SKIP
"""

from radwrap.errors import CheckFailed, EnvironmentFailure, InputError, RadwrapError, ToleranceNotMet, TracerError
from radwrap.imaging.explain import explain
from radwrap.imaging.synthesis import Rendered, RenderOptions, render
from radwrap.scene.load import load_scene, scene_from_document, with_value
from radwrap.scene.scene import Scene

__all__ = [
    "CheckFailed",
    "EnvironmentFailure",
    "InputError",
    "RadwrapError",
    "RenderOptions",
    "Rendered",
    "Scene",
    "ToleranceNotMet",
    "TracerError",
    "explain",
    "load_scene",
    "render",
    "scene_from_document",
    "with_value",
]
