"""When two images agree: every pixel has a term, and no term hides a difference behind brighter ones."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.imaging.render_options import RenderOptions
from radwrap.process import Programs
from radwrap.study import crosscheck as module
from radwrap.study.crosscheck import Crosscheck, CrosscheckOptions, crosscheck
from radwrap.study.crosscheck_report import agrees, as_json, measured, verdict
from radwrap.study.crosscheck_terms import Seen, sees
from radwrap.tracers.povray import find_povray

SCENE = Path(__file__).parents[2] / "rad_scenes" / "crosscheck" / "lambertian" / "scene.toml"
SHAPE = (50, 60)


def compared(radiance: np.ndarray, povray: np.ndarray, **terms: np.ndarray) -> Crosscheck:
    """A cross-check whose pixels are known."""
    seen = Seen(terms, radiance, {})
    options = CrosscheckOptions(RenderOptions())
    return Crosscheck(
        radwrap.load_scene(SCENE), options, radiance, povray, (radiance, povray), seen, (), 1, {}, {"radiance": 1.0}
    )


def halves() -> tuple[np.ndarray, np.ndarray]:
    left = np.zeros(SHAPE, dtype=bool)
    left[:, :30] = True
    return left, ~left


def test_what_shines_before_the_background_is_a_difference() -> None:
    """Radiance sees nothing there: no relative difference knows of it, and of all pixels' peak it is 0.6 %."""
    left, right = halves()
    radiance = np.where(left, 30.0, 0.0)
    povray = radiance.copy()
    povray[20:23, 50:53] = 4.0
    result = compared(radiance, povray, diffuse=left, background=right)
    assert verdict(result, "diffuse") == "agrees"
    assert verdict(result, "background") == "differs" and not agrees(result)
    assert as_json(result)["terms"]["background"]["relative_rms"] is None
    assert agrees(compared(radiance, radiance, diffuse=left, background=right))


def test_a_scene_with_waves_is_compared_without_and_says_so() -> None:
    left, _ = halves()
    result = compared(np.ones(SHAPE), np.ones(SHAPE), diffuse=left)
    assert "diffraction" not in as_json(result)
    camera = result.scene.camera
    for diffraction, diameter, told in (("auto", 1e-3, True), ("on", 1e-3, True), ("auto", 0.0, False)):
        other = replace(camera, diffraction=diffraction, aperture=replace(camera.aperture, diameter=diameter))
        found = as_json(replace(result, scene=replace(result.scene, camera=other)))
        assert ("the geometric part is compared" in found.get("diffraction", "")) == told


def test_every_pixel_has_a_term() -> None:
    parts = np.zeros(SHAPE, dtype=np.uint16)
    parts[:, :30] = 1
    prepared: Any = SimpleNamespace(parts=("target0.surface",), included={})
    scene = radwrap.load_scene(SCENE)
    maps = ((parts * 0.5).astype(np.float32), parts)
    seen = sees(scene, 0, np.where(parts, 30.0, 0.0), maps, prepared)
    assert (np.sum(list(seen.terms.values()), axis=0) == 1).all()
    assert seen.terms["background"][:, 40:].all() and not seen.terms["background"][:, :30].any()


def test_dark_pixels_count_too() -> None:
    """A cone of light lights a corner of the sheet; POV-Ray shines where Radiance has none: .7 % of the peak."""
    lit = np.zeros(SHAPE, dtype=bool)
    lit[:10, :10] = True
    radiance = np.where(lit, 10.0, 0.0)
    povray = radiance.copy()
    povray[40:43, 40:43] = 1.3
    result = compared(radiance, povray, diffuse=np.ones(SHAPE, dtype=bool))
    assert as_json(result)["terms"]["diffuse"]["relative_rms"] == 0.0
    assert measured(result, "diffuse") == ("rms_of_peak", pytest.approx(1.3 / 10 * (9 / 3000) ** 0.5))
    assert not agrees(result)


@pytest.mark.parametrize("term", ["mirror", "shadow", "edges", "aperture"])
def test_a_dark_term_is_not_measured_by_what_is_bright_elsewhere(term: str) -> None:
    """A reflection 1.6 % too dark, beside a sheet eight times as bright: .2 % of the image's peak."""
    left, right = halves()
    radiance = np.where(left, 40.0, 5.0)
    result = compared(radiance, np.where(right, 0.984 * radiance, radiance), diffuse=left, **{term: right})
    assert measured(result, term)[1] == pytest.approx(0.016)
    assert not agrees(result)


def test_a_reflection_that_is_mostly_dark_is_not_diluted() -> None:
    """1.6 % too dark where the mirror shows a lamp, one pixel of 60: .2 % of the mirror's own peak."""
    mirror = np.ones(SHAPE, dtype=bool)
    radiance = np.zeros(SHAPE)
    radiance[7] = 5.0
    result = compared(radiance, 0.984 * radiance, mirror=mirror)
    assert as_json(result)["terms"]["mirror"]["rms_of_peak"] < 0.005
    assert measured(result, "mirror") == ("relative_median", pytest.approx(0.016))
    # What mixes bright and dark by chance has the right median.
    noisy = radiance * (1 + np.where(np.arange(60) % 2, 0.02, -0.02))
    assert agrees(compared(radiance, noisy, mirror=mirror))


@pytest.fixture
def no_tracing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> dict[str, Any]:
    """Radiance and POV-Ray say what the test says."""
    program = tmp_path / "povray"
    program.write_text('#!/bin/sh\necho "POV-Ray 3.7.0.fake"\n')
    program.chmod(0o755)
    said: dict[str, Any] = {"program": str(program), "radiance": 0.0, "povray": 0.0, "part": 0, "asked": {}}

    def image(self: Any, name: str, plan: Any, *_: Any) -> np.ndarray:
        said["asked"][name] = plan.traced_sha256
        return np.full(SHAPE, said[name])

    monkeypatch.setattr(module._Runs, "image", image)
    monkeypatch.setattr(
        module, "central_maps", lambda *_: (np.full(SHAPE, 0.5, np.float32), np.full(SHAPE, said["part"], np.uint16))
    )
    return said


def ask(said: dict[str, Any], folder: Path) -> Crosscheck:
    return crosscheck(radwrap.load_scene(SCENE), folder, CrosscheckOptions(RenderOptions(), povray=said["program"]))


def test_an_empty_view_is_no_agreement(no_tracing: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nothing is in view"):
        ask(no_tracing, tmp_path / "out")
    assert list(no_tracing["asked"]) == ["radiance"]  # no time is spent on POV-Ray


def test_two_black_images_are_no_agreement(no_tracing: dict[str, Any], tmp_path: Path) -> None:
    no_tracing["part"] = 1
    with pytest.raises(InputError, match="both images are black"):
        ask(no_tracing, tmp_path / "out")
    no_tracing["povray"] = 1.0
    assert not agrees(ask(no_tracing, tmp_path / "out"))


def test_pieces_of_one_witness_are_not_taken_for_another_s(no_tracing: dict[str, Any], tmp_path: Path) -> None:
    """Two programs that say the same version: what the first left unfinished is not gone on with by the second."""
    no_tracing |= {"part": 1, "radiance": 1.0}
    ask(no_tracing, tmp_path / "out")
    first = no_tracing["asked"]["povray"]
    ask(no_tracing, tmp_path / "out")
    assert no_tracing["asked"]["povray"] == first
    program = Path(no_tracing["program"])
    program.write_text(program.read_text() + "# another\n")
    ask(no_tracing, tmp_path / "out")
    assert no_tracing["asked"]["povray"] != first
    with Programs() as programs:
        assert len(find_povray(programs, str(program)).sha256) == 64
