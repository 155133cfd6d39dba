"""``camera.lens`` as users write it: what is refused, what is told, and that every verb takes it or says no."""

from __future__ import annotations

import json
import shutil
import tomllib
from pathlib import Path
from typing import Any

import pytest

import radwrap
from radwrap.cli.main import main
from radwrap.errors import InputError
from radwrap.images import read_image

SCENES = Path(__file__).parents[2] / "rad_scenes"
EDGE = SCENES / "fig11_edge" / "scene.toml"
LENS = {"focus_distance": "500 mm", "f_number": 4}
SMALL = {"camera.sensor.rows": 30, "camera.sensor.columns": 40, "camera.exposure_time": "0.3 ms"}


def with_lens(scene: Path = EDGE, **more: Any) -> radwrap.Scene:
    """A scene of a pinhole, seen by a lens."""
    document = tomllib.loads(scene.read_text())
    document["camera"]["aperture"] = more.pop("aperture", {})
    document["camera"]["lens"] = {key: value for key, value in {**LENS, **more}.items() if value is not None}
    return radwrap.scene_from_document(document, SMALL, folder=scene.parent)


def arguments(verb: str, scene: Path = EDGE) -> list[str]:
    """Command line of a verb on a scene of a pinhole."""
    words = [verb, str(scene)]
    for key, value in {**SMALL, "camera.lens": LENS, "camera.aperture": {"shape": "round"}}.items():
        told = json.dumps(value).replace('": ', '" = ') if isinstance(value, dict) else json.dumps(value)
        words += ["--set", f"{key}={told}"]
    return words


def test_a_lens_has_its_opening_from_the_f_number() -> None:
    scene = with_lens()
    f = scene.camera.focal_length
    assert scene.camera.aperture.diameter == pytest.approx(f / 4)
    assert scene.camera.image_distance == pytest.approx(1 / (1 / f - 1 / 0.5))
    assert scene.assumed["camera.lens.falloff"] == "cos4" and scene.assumed["camera.lens.transmission"] == "1.0"
    assert "camera.aperture.diameter" not in scene.assumed
    same = with_lens(f_number=None, aperture={"diameter": f"{f / 4 * 1e3!r} mm"})
    assert same.camera.aperture.diameter == pytest.approx(scene.camera.aperture.diameter)
    assert radwrap.with_value(scene, "camera.lens.focus_distance", "1 m").camera.lens.focus_distance == 1.0  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("lens", "told"),
    [
        ({"focus_distance": "5 mm"}, "lens.focus_distance must be larger than focal_length"),
        ({"focus_distance": 500}, "has no unit"),
        ({"f_number": None}, "needs either of lens.f_number and aperture.diameter"),
        ({"f_number": 0}, "camera.lens.f_number: must be at least 0.1"),
        ({"aperture": {"diameter": "1 mm"}}, "needs one of lens.f_number and aperture.diameter"),
        ({"aperture": {"shape": "annular", "inner_diameter": "9 mm"}}, "inner_diameter must be smaller"),
        ({"transmission": 1.5}, "must be at most 1"),
        ({"focus": "1 m"}, "camera.lens.focus: unknown key"),
        ({"relative_illumination": [["0 mm", 0.5]]}, "must begin with"),
        ({"relative_illumination": [["0 mm", 1.0], ["0 mm", 0.5]]}, "heights must increase"),
        ({"relative_illumination": [["0 mm", 1.0], ["0.01 mm", 0.5]]}, "the sensor at"),
        ({"relative_illumination": [["0 mm", 1.0]], "falloff": "none"}, "takes the place of falloff"),
    ],
)
def test_what_cannot_be_is_refused_with_its_key(lens: dict[str, Any], told: str) -> None:
    with pytest.raises(InputError, match="camera") as caught:
        with_lens(**lens)
    assert told in str(caught.value)


def test_sheeting_is_checked_through_the_whole_lens() -> None:
    """The ring of 25 mm is seen at .716 deg from the centre at 1 m, from the rim of 10.59 mm at f/1.4 up to .93 deg."""
    table = {
        "type": "retroreflective",
        "model": "coefficient",
        "observation_angles": ["0.2 deg", "0.85 deg"],
        "entrance_angles": ["0 deg", "30 deg"],
        "coefficients": [["250 cd/lx/m^2", "150 cd/lx/m^2"], ["70 cd/lx/m^2", "50 cd/lx/m^2"]],
    }
    document = tomllib.loads(EDGE.read_text())
    document["materials"]["sheeting"] = table
    document["camera"]["aperture"] = {}
    for f_number, refused in ((8, False), (1.4, True)):
        document["camera"]["lens"] = {"focus_distance": "1 m", "f_number": f_number}
        if refused:
            with pytest.raises(InputError, match=r"materials\.sheeting: .*observation angles"):
                radwrap.scene_from_document(document, SMALL)
        else:
            radwrap.scene_from_document(document, SMALL)


def test_explain_tells_focus_and_airy_disc(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*arguments("explain"), "--no-rays", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    f = found["scene"]["camera"]["focal_length"]
    v = f * 0.5 / (0.5 - f)
    assert found["f_number"] == pytest.approx(4)
    assert found["focus"]["image_distance"] == pytest.approx(v)
    # At the ends of the sharp range the circle of confusion is as wide as a pixel.
    pitch = found["scene"]["camera"]["sensor"]["pixel_width"]
    for depth in (found["focus"]["nearest_sharp"], found["focus"]["farthest_sharp"]):
        assert f / 4 * v * abs(1 / depth - 2) == pytest.approx(pitch)
    airy = found["diffraction"]
    assert airy["airy_radius"] == pytest.approx(1.22 * 550e-9 * v / (f / 4), rel=1e-3)
    assert not airy["matters"] and not any("diffraction" in line for line in found["warnings"])
    assert main([*arguments("explain"), "--no-rays"]) == 0
    told = capsys.readouterr().out
    assert "lens: focused at 0.5 m" in told and "Airy radius" in told
    narrow = [*arguments("explain"), "--no-rays", "--set", "camera.lens.f_number=22"]
    assert main([*narrow, "--set", "camera.diffraction=auto"]) == 0
    told = capsys.readouterr().out
    assert "nm (assumed); images have it where it matters at their tolerance" in told and "warning: diff" not in told
    assert main([*narrow, "--set", "camera.diffraction=off"]) == 0
    assert 'warning: diffraction at the opening is left out, as camera.diffraction is "off"' in capsys.readouterr().out


@pytest.mark.long
def test_every_method_and_a_basis_agree(tmp_path: Path) -> None:
    """Within their certificates; sources far apart from the axis are seen by all."""
    scene = with_lens(f_number=8)
    images = {
        method: radwrap.render(scene, method=method, tolerance=1.0, viewpoints=37 if method == "viewpoints" else None)
        for method in ("kernel", "rays", "viewpoints")
    }
    for first in images.values():
        for other in images.values():
            off = first.gray.values - other.gray.values
            bound = first.manifest["error"]["rms_gray_upper95"] + other.manifest["error"]["rms_gray_upper95"] + 0.6
            assert (off**2).mean() ** 0.5 < bound  # .6: both are rounded
    assert images["kernel"].manifest["camera"]["lens"]["focus_distance"] == 0.5
    assert images["kernel"].manifest["run_sha256"] != images["rays"].manifest["run_sha256"]


def test_a_view_file_refuses_a_lens_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for ending in ("vf", "pov"):
        assert main([*arguments("convert"), str(tmp_path / f"a.{ending}")]) == 2
        assert "camera.lens" in capsys.readouterr().err
        assert not list(tmp_path.iterdir())


@pytest.mark.skipif(shutil.which("povray") is None, reason="POV-Ray is not installed: no cross-check was made")
@pytest.mark.long
def test_crosscheck_traces_a_lens_twice(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """POV-Ray sees the same sheared frustum of each sub-viewpoint: out of focus too."""
    scene = SCENES / "crosscheck" / "edge_near" / "scene.toml"
    words = [
        *arguments("crosscheck", scene),
        "--set",
        'camera.lens.focus_distance="50 mm"',
        "--viewpoints",
        "7",
        "--pixel-samples",
        "1",
    ]
    assert main([*words, "--out", str(tmp_path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["agrees"] and found["terms"]["aperture"]["pixels"] > 400  # the edge is blurred over much of the image


def test_a_basis_holds_the_lens(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, levels = tmp_path / "run", tmp_path / "levels.csv"
    assert (
        main([*arguments("render"), "--set", "sources[0].count=2", "--tolerance", "1", "--basis", "--out", str(out)])
        == 0
    )
    names = json.loads((out / "basis.json").read_text())["sources"]
    levels.write_text(f"name,{','.join(names)}\nsame,{','.join('1' for _ in names)}\n")
    assert main(["relight", str(out), "--levels", str(levels), "--out", str(tmp_path / "relit")]) in (0, 3)
    whole, relit = (read_image(path)[0].astype(float) for path in (out / "gray.png", tmp_path / "relit" / "same.png"))
    assert abs(whole - relit).max() <= 2
