"""Wide lights that may shine as a whole have an outline of few patches, until Radiance is to trace them."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("numba")

import radwrap
from radwrap.errors import InputError
from radwrap.imaging import tracing
from radwrap.imaging.forecast.effects import Probe, bounces
from radwrap.imaging.forecast.explain import explain
from radwrap.imaging.optics.view import rays_through
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.tracer_choice import TracerUsed
from radwrap.imaging.tracing import laid_out
from radwrap.scene.look.wide_sources import divided
from radwrap.scene.sources import WideSource
from radwrap.tracers.compiled.layout import compiled_scene
from radwrap.tracers.text_frame import TextFrame
from tests.tracers.belt import at, scene_of

FEW = 64
BLACK = 1e-3  # reflectance
PATIENCE = 2.0  # s; to cut the patches of the glossy dome takes longer
COMPILED, RADIANCE = RenderOptions(tracer="compiled"), RenderOptions(tracer="radiance")
DOME = {
    "type": "dome",
    "name": "dome",
    "position": at(0, 0, 20),
    "look_at": at(0, 0, 0),
    "diameter": "200 mm",
    "opening_diameter": "60 mm",
    "radiance": "10 W/m^2/sr",
    "irradiance_error": 0.02,
}
BAR = {
    "type": "rectangle",
    "name": "bar",
    "position": at(40, 0, 100),
    "look_at": at(0, 0, 0),
    "size": ["60 mm", "20 mm"],
    "radiance": "100 W/m^2/sr",
    "irradiance_error": 0.02,
}
GAUSSIAN = {**BAR, "beam": {"profile": "gaussian", "width": "60 deg", "width_definition": "fwhm"}}


def wide(scene: radwrap.Scene) -> WideSource:
    source = scene.sources[0]
    assert isinstance(source, WideSource)
    return source


def radiances(scene: radwrap.Scene, options: RenderOptions) -> np.ndarray:
    with laid_out(scene, options) as traced:
        rays, _ = rays_through(scene.camera, (0.0, 0.0), *np.random.default_rng(1).random((2, 50)) * 60)
        found: np.ndarray = next(traced.view().tracer.trace([rays]))
        return found


def test_radiance_gets_patches_and_the_compiled_tracer_an_outline() -> None:
    scene = scene_of(sources=[DOME])
    assert wide(scene).is_outline and len(wide(scene).patches) <= FEW
    with laid_out(scene, COMPILED) as traced:
        assert traced.scene is scene and traced.tracer_used.whole == ("dome",)
        assert traced.tracer_used.in_patches is None
    with laid_out(scene, RADIANCE) as traced:
        assert not wide(traced.scene).is_outline and wide(traced.scene).reached <= wide(scene).irradiance_error
        assert wide(traced.scene).patches == wide(divided(scene)).patches
        assert traced.tracer_used.whole is None and traced.tracer_used.in_patches == ("dome",)


def test_where_radiance_traces_after_all_it_has_patches(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_of(sources=[DOME])
    expected = radiances(scene, RADIANCE)
    monkeypatch.setattr(tracing, "compared", lambda *_: TracerUsed("radiance", "they differ"))
    assert np.array_equal(radiances(scene, COMPILED), expected)


@pytest.mark.parametrize("light", [DOME, BAR, GAUSSIAN], ids=["dome", "bar", "gaussian"])
@pytest.mark.parametrize(
    "material",
    [
        {"type": "lambertian", "reflectance": 0.3},
        {"type": "specular", "diffuse_reflectance": 0.2, "specular_reflectance": 0.1, "roughness": 0.1},
        {"type": "retroreflective", "model": "perturbed_normal", "reflectance": 0.3, "roughness": 0.3},
    ],
    ids=lambda material: str(material["type"]),
)
def test_outlines_are_those_that_shine_as_a_whole(light: dict[str, Any], material: dict[str, Any]) -> None:
    """A light with an outline only would be off where the compiled tracer lets it shine from patches."""
    thing = {"type": "sheet", "name": "thing", "material": "thing", "size": ["9 mm", "9 mm"], "position": at(0, 0, 3)}
    materials = {"belt": {"type": "lambertian", "reflectance": 0.3}, "thing": material}
    light = {**light, "irradiance_error": 0.2}
    scene = scene_of(thing, sources=[light], materials=materials)
    outlined = {source.name for source in scene.sources if isinstance(source, WideSource) and source.is_outline}
    assert outlined == set(compiled_scene(scene, TextFrame(), whole=True).whole)


def test_a_dome_over_a_glossy_sheet_is_loaded_at_once() -> None:
    glossy = {"type": "specular", "diffuse_reflectance": 0.05, "specular_reflectance": 0.1, "roughness": 0.03}
    begin = time.process_time()
    scene_of(sources=[{**DOME, "irradiance_error": 0.001}], materials={"belt": glossy})
    assert time.process_time() - begin < PATIENCE


@pytest.mark.long
def test_too_many_patches_are_refused_only_where_radiance_traces() -> None:
    scene = scene_of(sources=[{**BAR, "position": at(0, 0, 2), "size": ["60 mm", "60 mm"], "irradiance_error": 1e-4}])
    with laid_out(scene, COMPILED) as traced:
        assert traced.tracer_used.whole == ("bar",)
    with pytest.raises(InputError, match="more than 4096 patches"), laid_out(scene, RADIANCE):
        pass
    assert any("more than 4096 patches" in line for line in explain(scene)["warnings"])


def test_what_an_outline_is_off_by_does_not_count_as_bounces() -> None:
    """A black box on a black belt bounces a thousandth of its light; the outline of a near bar is off by far more."""
    box = {"type": "box", "name": "box", "material": "belt", "size": ["5 mm"] * 3, "position": at(0, 0, 2.5)}
    black = {"belt": {"type": "lambertian", "reflectance": BLACK}}
    near = {**BAR, "position": at(-50, 0, 12), "look_at": at(-50, 0, 0), "size": ["60 mm", "60 mm"]}
    scene = scene_of(box, sources=[near], materials=black)
    with laid_out(scene, COMPILED) as traced:
        view, rough = traced.view(), traced.radiance_view()
        gray = 100 / (np.mean(radiances(scene, COMPILED)) * float(np.mean(view.exposure_of_radiance)))
        camera = replace(scene.camera, sensor=replace(scene.camera.sensor, gain=gray, rounding=False))
        view, rough = replace(view, camera=camera), replace(rough, camera=camera)
        probe = Probe.of(view, 0)
        assert math.sqrt(probe.mean_square(probe.traced(rough)).mean) > 1.0
        traced.scene = replace(scene, camera=camera)
        found = bounces(traced.scene, view, 0, 0.5, traced=traced)
    assert found.rms_gray < 2 * BLACK * 100
