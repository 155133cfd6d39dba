"""Predicts the gray values that a machine-vision camera will capture.

The data's way::

    scene file with units                                    load_scene, with_value
    -> what it amounts to, which effects matter              explain, effects
    -> Radiance text, rtrace: rays in, radiance out          tracers/
    -> mean radiance of each pixel, to a tolerance           render: kernel, rays or both, whichever takes fewest
    -> how far it is off, by rays of its own                 result.manifest["error"]
    -> radiant exposure on the pixel                         Eqs. 1 to 3
    -> gray level                                            Eq. 5: G = K H^gamma + G0

The paper's way to the mean radiance is ``render(scene, viewpoints=61)``: images
of sub-viewpoints in the pinhole, merged by area, w_i = a_i/A.

Examples
--------
>>> import radwrap
>>> scene = radwrap.load_scene("scene.toml")
>>> brighter = radwrap.with_value(scene, "camera.exposure_time", "64 ms")
>>> result = radwrap.render(brighter, tolerance=4)
>>> bool(result.error.rms_gray_upper95 < 4)
True
>>> bool(result.with_exposure("32 ms").gray.values.max() < result.gray.values.max())
True
"""

TYPE_CHECKING = False  # as type checkers know it: to import typing takes longer than the rest

if TYPE_CHECKING:
    from typing import Any

    from radwrap.calibrate.projection_uncertainty import projection_uncertainty as projection_uncertainty
    from radwrap.calibrate.response import fit_response as fit_response
    from radwrap.calibrate.several_views import calibrate_views as calibrate_views
    from radwrap.calibrate.tsai import calibrate_camera as calibrate_camera
    from radwrap.calibrate.views import CalibrationView as CalibrationView
    from radwrap.designing.run import design as design
    from radwrap.designing.told import Designed as Designed
    from radwrap.errors import Cancelled as Cancelled
    from radwrap.errors import CheckFailed as CheckFailed
    from radwrap.errors import EnvironmentFailure as EnvironmentFailure
    from radwrap.errors import InputError as InputError
    from radwrap.errors import RadwrapError as RadwrapError
    from radwrap.errors import ToleranceNotMet as ToleranceNotMet
    from radwrap.errors import TracerError as TracerError
    from radwrap.fitting.fit import fit as fit
    from radwrap.fitting.series import Captures as Captures
    from radwrap.fitting.told import Fit as Fit
    from radwrap.images import GrayImage as GrayImage
    from radwrap.imaging.forecast.effects import effects as effects
    from radwrap.imaging.forecast.explain import explain as explain
    from radwrap.imaging.relighting import relight as relight
    from radwrap.imaging.render_options import RenderOptions as RenderOptions
    from radwrap.imaging.rendered import Rendered as Rendered
    from radwrap.imaging.synthesis import render as render
    from radwrap.imaging.warm import WarmScene as WarmScene
    from radwrap.imaging.warm import warm as warm
    from radwrap.measure.compare import compare as compare
    from radwrap.measure.dots import find_dots as find_dots
    from radwrap.measure.edges import measure_edge as measure_edge
    from radwrap.measure.gauges import Box as Box
    from radwrap.measure.gauges import Caliper as Caliper
    from radwrap.measure.gauges import StraightCaliper as StraightCaliper
    from radwrap.measure.gauges import contrast_of as contrast_of
    from radwrap.measure.gauges import measure_circle as measure_circle
    from radwrap.measure.gauges import measure_line as measure_line
    from radwrap.measure.gauges import measure_region as measure_region
    from radwrap.measure.gauges import measure_uniformity as measure_uniformity
    from radwrap.measure.gauges import measure_width as measure_width
    from radwrap.measure.parts import find_parts as find_parts
    from radwrap.progress import Progressed as Progressed
    from radwrap.scene.file.load import load_scene as load_scene
    from radwrap.scene.file.load import scene_from_document as scene_from_document
    from radwrap.scene.file.load import with_value as with_value
    from radwrap.scene.scene import Scene as Scene

# Each public name and its home. They are fetched when they are first used: the command starts at once, and can be
# interrupted cleanly from its first moment on.
_HOMES = {
    "Box": "radwrap.measure.gauges",
    "Caliper": "radwrap.measure.gauges",
    "Cancelled": "radwrap.errors",
    "Captures": "radwrap.fitting.series",
    "CheckFailed": "radwrap.errors",
    "Designed": "radwrap.designing.told",
    "EnvironmentFailure": "radwrap.errors",
    "Fit": "radwrap.fitting.told",
    "GrayImage": "radwrap.images",
    "InputError": "radwrap.errors",
    "Progressed": "radwrap.progress",
    "RadwrapError": "radwrap.errors",
    "RenderOptions": "radwrap.imaging.render_options",
    "Rendered": "radwrap.imaging.rendered",
    "Scene": "radwrap.scene.scene",
    "StraightCaliper": "radwrap.measure.gauges",
    "ToleranceNotMet": "radwrap.errors",
    "TracerError": "radwrap.errors",
    "WarmScene": "radwrap.imaging.warm",
    "CalibrationView": "radwrap.calibrate.views",
    "calibrate_camera": "radwrap.calibrate.tsai",
    "calibrate_views": "radwrap.calibrate.several_views",
    "projection_uncertainty": "radwrap.calibrate.projection_uncertainty",
    "compare": "radwrap.measure.compare",
    "contrast_of": "radwrap.measure.gauges",
    "design": "radwrap.designing.run",
    "effects": "radwrap.imaging.forecast.effects",
    "explain": "radwrap.imaging.forecast.explain",
    "find_dots": "radwrap.measure.dots",
    "find_parts": "radwrap.measure.parts",
    "fit": "radwrap.fitting.fit",
    "fit_response": "radwrap.calibrate.response",
    "load_scene": "radwrap.scene.file.load",
    "measure_circle": "radwrap.measure.gauges",
    "measure_edge": "radwrap.measure.edges",
    "measure_line": "radwrap.measure.gauges",
    "measure_region": "radwrap.measure.gauges",
    "measure_uniformity": "radwrap.measure.gauges",
    "measure_width": "radwrap.measure.gauges",
    "relight": "radwrap.imaging.relighting",
    "render": "radwrap.imaging.synthesis",
    "scene_from_document": "radwrap.scene.file.load",
    "warm": "radwrap.imaging.warm",
    "with_value": "radwrap.scene.file.load",
}


def __getattr__(name: str) -> "Any":
    from importlib import import_module

    if name not in _HOMES:
        raise AttributeError(f"module 'radwrap' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(_HOMES)


# help() reports these, wherever they stand.
__all__ = sorted(_HOMES)  # noqa: PLE0605  (a list of strings)
