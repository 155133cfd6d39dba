"""Two tracers on one scene: they agree, or differ as closed forms say; and a wrong one is noticed."""

import json
import math
import shutil
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.errors import TracerError
from radwrap.imaging.render_options import RenderOptions
from radwrap.scene.camera import Camera
from radwrap.scene.look.geometry import directions
from radwrap.study.crosscheck import Crosscheck, CrosscheckOptions, crosscheck, gaussian_beams, without_gaussian_beams
from radwrap.study.crosscheck_report import EXPLAINED, agrees, as_json, explained, picture, write_crosscheck

SCENES = Path(__file__).parents[2] / "rad_scenes" / "crosscheck"
pytestmark = pytest.mark.skipif(
    shutil.which("povray") is None, reason="POV-Ray is not installed (apt install povray): no cross-check was made"
)

HALF = 5e-4  # a half float's rounding
DIFFUSE = 2e-3  # asked for; measured 1.1e-4
MIRROR = 5e-3  # asked for; measured 1e-4
# What 37 sub-viewpoints and 3 x 3 rays leave of Eq. 9, whoever traces; measured .0049 and .0052 at this one angle.
EQ9_37 = 0.0065


def load(name: str, **changes: Any) -> radwrap.Scene:
    return radwrap.load_scene(SCENES / name / "scene.toml", changes)


def run(
    scene: radwrap.Scene, folder: Path, samples: int = 1, area: int = 0, viewpoints: int | None = None
) -> Crosscheck:
    options = RenderOptions(pixel_samples=samples, viewpoints=viewpoints)
    return crosscheck(scene, folder, CrosscheckOptions(options, area_samples=area))


@pytest.mark.parametrize(
    "name",
    ["dots", *(pytest.param(name, marks=pytest.mark.long) for name in ("shadows", "lambertian", "cone_beam", "ring"))],
)
def test_direct_light(name: str, tmp_path: Path) -> None:
    result = run(load(name), tmp_path)
    found = as_json(result)
    assert found["agrees"]
    nothing = found["terms"].pop("background", {"maximum_of_peak": 0.0})
    assert nothing["maximum_of_peak"] == 0.0
    for term in found["terms"].values():
        assert term["relative_rms"] < DIFFUSE
        assert term["relative_maximum"] < 2 * HALF
    # Each against E rho/pi too, so that both cannot be wrong together.
    assert found["closed_form"]["radiance_relative_rms"] < DIFFUSE
    assert found["closed_form"]["povray_relative_rms"] < DIFFUSE
    assert found["gray"]["maximum"] < 0.1
    assert not list(tmp_path.glob(".work/*"))
    assert b"PNG" in picture(result)[:8]


def share_beyond(s: np.ndarray) -> np.ndarray:
    """Eq. 9: share of a disc on the bright side, its centre being s radii inside."""
    s = np.clip(s, -1.0, 1.0)
    return 1 - (np.arccos(s) - s * np.sqrt(1 - s**2)) / math.pi


def eq9(camera: Camera, depth: float, angle: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean of Eq. 9 over each pixel, and where |S| <= 1 at its centre."""
    fine = (np.arange(16) + 0.5) / 16 - 0.5
    row, column = np.indices((camera.sensor.rows, camera.sensor.columns))
    pitch = camera.sensor.pixel_width
    u = (column[..., np.newaxis, np.newaxis] + fine - camera.principal_point[0]) * pitch
    v = (row[..., np.newaxis, np.newaxis] + fine[:, np.newaxis] - camera.principal_point[1]) * pitch
    x, y = u * depth / camera.focal_length, -v * depth / camera.focal_length
    radius = camera.aperture.diameter / 2 * (1 + depth / camera.focal_length)
    s = (x * math.cos(angle) + y * math.sin(angle)) / radius
    return share_beyond(s).mean(axis=(2, 3)), np.abs(s.mean(axis=(2, 3))) <= 1


@pytest.mark.long
@pytest.mark.parametrize(("name", "depth"), [("edge_far", 1.0), ("edge_near", 3 * 10.59e-3)])
def test_finite_pinhole(name: str, depth: float, tmp_path: Path) -> None:
    """At 3 f a shift of the wrong sign leaves .13: neither tracer, nor the merge, has it."""
    scene = load(name)
    result = run(scene, tmp_path, samples=3, viewpoints=37)
    expected, blurred = eq9(scene.camera, depth, math.radians(12))
    white = 6.83e5 / 100**2 / math.pi
    rays = directions(scene.camera, np.column_stack([i.ravel() for i in np.indices((12, 30))][::-1]).astype(float))
    cos4 = ((rays @ np.asarray(scene.camera.pose.z_axis)) ** 4).reshape(12, 30)
    for image in (result.radiance, result.povray):
        left = (image / cos4 / white - expected)[blurred]
        assert math.sqrt((left**2).mean()) < EQ9_37
    assert np.abs(result.povray - result.radiance).max() < HALF * white
    found = as_json(result)
    assert found["viewpoints"] == 37 and found["agrees"]
    assert found["terms"]["aperture"]["rms_of_peak"] < HALF


def test_highlights_differ_as_closed_forms_say(tmp_path: Path) -> None:
    result = run(load("specular"), tmp_path)
    found = as_json(result)
    assert found["terms"]["specular"]["relative_rms"] > 0.01
    numbers = found["explained"]["highlight"]
    assert numbers["expected_rms"] == pytest.approx(numbers["measured_rms"], rel=0.05)
    assert numbers["left_rms"] < 0.05 * numbers["measured_rms"]  # EXPLAINED asks for 0.2
    assert found["terms"]["specular"]["verdict"] == "explained" and found["agrees"]
    assert EXPLAINED == 0.2


def test_extended_source(tmp_path: Path) -> None:
    """Radiance samples the disc's centre: off by (radius/distance)^2; POV-Ray, which integrates it, is right."""
    scene = load("extended_source")
    assert agrees(run(scene, tmp_path / "centre"))
    result = run(scene, tmp_path / "disc", area=9)
    numbers = explained(result)["extended source"]
    assert numbers["expected_rms"] == pytest.approx(numbers["measured_rms"], rel=0.1)
    assert numbers["left_rms"] < EXPLAINED * numbers["measured_rms"]
    # Right below the source the closed form of the disc, pi L R^2/(R^2 + z^2), is lower by (R/z)^2.
    below = np.array([[20.0, 30.0, 0.0]]) * 1e-3
    z, r = math.dist((0.02, 0.03, 0.112), tuple(below[0])), 0.01
    assert r**2 / (r**2 + z**2) - r**2 / z**2 == pytest.approx(-((r / z) ** 4), rel=0.02)
    seen = result.seen.terms["diffuse"]
    lowest = ((result.povray - result.radiance)[seen] / result.radiance[seen]).min()
    assert -1.2 < lowest / (r / z) ** 2 < -0.8  # the sheet is seen below a source that leans by 18 degrees


def returned(scene: radwrap.Scene, samples: int) -> np.ndarray:
    """Which rays come back from corner cubes, by the cubes' geometry alone: no mirror is followed.

    A ray that meets the opening in p returns if the point opposite to p about the apex, seen along the ray, lies in the
    opening too: three reflections turn the ray round and mirror its place about the apex.
    """
    rows, columns = scene.camera.sensor.rows, scene.camera.sensor.columns
    v, u = ((np.arange(n * samples) + 0.5) / samples - 0.5 for n in (rows, columns))
    uv = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    rays = directions(scene.camera, uv)
    p = (np.asarray(scene.camera.pose.position) / 1e-3)[:2] + rays[:, :2] / -rays[:, 2:] * 500
    slope = rays[:, :2] / rays[:, 2:]
    hit = np.zeros(len(rays), dtype=bool)
    a = 16.0
    for cube in range(9):
        centre = np.array([(cube % 3 - 1) * 34.0, (cube // 3 - 1) * 30.0 - 2.0])
        turn = math.radians(90 + 180 * (cube % 2))
        angle = turn + 2 * np.pi * np.arange(3) / 3
        inner = a * math.sqrt(2 / 3) / 2  # from the centre to each side of the opening
        outward = -np.column_stack([np.cos(angle), np.sin(angle)])
        apex = centre + slope * (a / math.sqrt(3))  # the apex, 9.24 mm behind, drawn along the ray onto the opening
        inside = [((q - centre) @ outward.T <= inner).all(axis=1) for q in (p, 2 * apex - p)]
        hit |= inside[0] & inside[1]
    return hit.reshape(rows, samples, columns, samples).mean(axis=(1, 3))


def test_corner_cubes_send_light_back(tmp_path: Path) -> None:
    """Retroreflection by real geometry in both: 2/3 of a triangular opening at normal incidence."""
    scene = load("corner_cubes")
    samples = 4
    result = run(scene, tmp_path, samples=samples)
    share = returned(scene, samples)
    for image in (result.radiance, result.povray):
        back = image / 29.3
        assert back.sum() == pytest.approx(share.sum(), rel=MIRROR + 0.02)  # cos^4 falls by 2 % to the outer cubes
        assert np.abs(back[20:31, 22:37].sum() / share[20:31, 22:37].sum() - 1) < MIRROR
    # The middle cube in closed form. Of an opening of area sqrt(3)/2 a^2 that is seen from afar 2/3 return; from the
    # distance D the opposite of p lies m = 1 + 2 (a/sqrt(3))/D times as far out, and 1 - (2 - 1/m)^2/3 return.
    m = 1 + 2 * (16.0 / math.sqrt(3)) / 500.0
    expected = (1 - (2 - 1 / m) ** 2 / 3) * math.sqrt(3) / 2 * 16.0**2
    for image in (result.radiance, result.povray):
        assert image[18:33, 22:37].sum() / 29.3 * 4.0 == pytest.approx(expected, rel=MIRROR)  # 4 mm^2 a pixel
    assert "sheeting is not checked" in as_json(result)["note"]


def test_smooth_metal_is_brighter_at_a_slant_in_radiance(tmp_path: Path) -> None:
    """Radiance adds (1 - r)(exp(-5.85 cos) - .00203) to a smooth metal's r, an estimate of Fresnel's law; POV-Ray not.

    Who is right: for a mirror of constant reflectance POV-Ray. Mirrors of reflectance 1 have no such difference.
    """
    reflectance = 0.5
    shutil.copytree(SCENES / "mirror", tmp_path / "scene")
    silver = (tmp_path / "scene" / "mirror.rad").read_text()
    (tmp_path / "scene" / "mirror.rad").write_text(silver.replace("5 1 1 1 1 0", f"5 {' '.join(['0.5'] * 3)} 1 0"))
    scene = radwrap.load_scene(tmp_path / "scene" / "scene.toml")
    result = run(scene, tmp_path / "out")
    rays = directions(scene.camera, np.column_stack([i.ravel() for i in np.indices((50, 60))][::-1]).astype(float))
    cosine = -(rays @ np.array([0.6428, 0.0, 0.766])).reshape(50, 60)
    added = (1 - reflectance) * (np.exp(-5.85 * cosine) - 0.00202943064)
    seen = result.radiance > 1e-3 * result.radiance.max()
    measured = result.radiance[seen] / result.povray[seen] - 1
    assert measured == pytest.approx((added / reflectance)[seen], abs=HALF)
    assert measured.mean() > 0.008  # there is something to explain


def test_gaussian_beams_are_replaced_and_it_is_said() -> None:
    scene = load("ring")
    (beam,) = gaussian_beams(scene)
    assert beam["closed_form"] == pytest.approx(beam["largest_difference_of_peak"], rel=0.02)
    spread = math.radians(7) / math.sqrt(8 * math.log(2))
    assert beam["largest_difference_of_peak"] == pytest.approx(4 * math.exp(-2) / 3 * spread**2, rel=0.02)
    assert {emitter.beam.profile for emitter in without_gaussian_beams(scene).emitters} == {"cosine_power"}


def test_a_wrong_witness_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that takes reflectances for 1 % more, or the fade law for 2 %, does not pass."""
    from radwrap.study import crosscheck as module

    write = module.povray_scene
    monkeypatch.setattr(module, "povray_scene", lambda *a, **k: write(*a, **k).replace("diffuse 0.8", "diffuse 0.808"))
    result = run(load("lambertian"), tmp_path)
    assert not agrees(result)
    assert as_json(result)["terms"]["diffuse"]["relative_median"] == pytest.approx(0.01, abs=HALF)
    assert as_json(result)["closed_form"]["radiance_relative_rms"] < DIFFUSE  # so it is not Radiance


def test_files(tmp_path: Path) -> None:
    result = run(load("lambertian"), tmp_path)
    names = {path.name for path in write_crosscheck(result, tmp_path)}
    assert names == {"crosscheck.png", "crosscheck.json"}
    found = json.loads((tmp_path / "crosscheck.json").read_text())
    assert found["versions"]["povray"].startswith("3.7")
    again = as_json(run(load("lambertian"), tmp_path))
    assert {**again, "timing": None} == {**found, "timing": None}


def test_every_scene_has_one_term_and_says_which() -> None:
    scenes = sorted(SCENES.glob("*/scene.toml"))
    assert len(scenes) >= 12
    for path in scenes:
        assert path.read_text().startswith("# ")
        assert tomllib.loads(path.read_text())["title"].startswith("Cross-check: ")


def test_a_run_goes_on_with_what_is_finished(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """POV-Ray breaks down; the next run takes Radiance's image from the disk, and says the same in the end."""
    broken = tmp_path / "povray"
    broken.write_text('#!/bin/sh\nif [ "$1" = --version ]; then echo "POV-Ray 3.7.0.fake" >&2; exit 0; fi\nexit 1\n')
    broken.chmod(0o755)
    scene, out = load("lambertian"), tmp_path / "out"
    with pytest.raises(TracerError, match="exit code 1"):
        crosscheck(scene, out, CrosscheckOptions(RenderOptions(), povray=str(broken)))
    piece = out / ".work" / "radiance" / "viewpoint_00000.exr"
    written = piece.stat().st_mtime_ns
    monkeypatch.setattr("radwrap.study.crosscheck.shutil.rmtree", lambda *_, **__: None)
    assert agrees(run(scene, out))
    assert piece.stat().st_mtime_ns == written
