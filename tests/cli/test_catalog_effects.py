"""What a measurement hangs on: known changes over the ranges of assumed values."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap import GrayImage, StraightCaliper, measure_width
from radwrap.cli.main import main
from radwrap.images import read_gray
from radwrap.measure.gauges import Width
from tests.measure.pictures import noisy, stripe_picture

# 0.370 DN/e, offset 64 in 0 to 240, PRNU 0 to 1.4 %, DSNU 0 to 3.7 e.
SENSOR = {
    "preset": "sony_imx250.lucid_atlas",
    "rows": 24,
    "columns": 32,
    "pixel_width": "20 um",
    "pixel_height": "20 um",
}
SCENE: dict[str, Any] = {
    "camera": {
        "position": ["0 mm", "0 mm", "400 mm"],
        "look_at": ["0 mm", "0 mm", "0 mm"],
        "focal_length": "12.5 mm",
        "exposure_time": "20 ms",
        "diffraction": "off",
        "aperture": {"diameter": "0.1 mm"},
        "sensor": SENSOR,
    },
    "sources": [
        {
            "type": "ring",
            "name": "ring",
            "preset": "generic_ring_60mm_16led",
            "position": ["0 mm", "0 mm", "390 mm"],
            "look_at": ["0 mm", "0 mm", "0 mm"],
        }
    ],
    "materials": {
        "dark": {"type": "lambertian", "reflectance": 0.1},
        "light": {"type": "lambertian", "reflectance": 0.6},
    },
    "targets": [
        {
            "type": "edge",
            "name": "edge",
            "size": ["60 mm", "60 mm"],
            "material": "dark",
            "edge_material": "light",
            "rotation": ["0 deg", "0 deg", "7 deg"],
        }
    ],
}


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("effects") / "run"
    radwrap.render(radwrap.scene_from_document(SCENE), out, tolerance=8)
    return out


def effects(folder: Path, capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, dict[str, Any]]:
    assert main(["catalog", "effects", str(folder), "--json", *words]) == 0
    return {one["key"]: one for one in json.loads(capsys.readouterr().out)["assumed_effects"]}


def test_a_mean_over_a_region_moves_with_the_offset(rendered: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = effects(rendered, capsys, "--measure", "region --region 2 2 9 20")
    assert found["camera.sensor.offset"]["mean_gray"] == pytest.approx([-64, 176])
    moved = found["camera.sensor.offset"]["measured"]["region.mean"]
    assert moved["change"] == pytest.approx([-64, 176], abs=1e-9)
    assert found["camera.sensor.prnu"]["measured"] == {}, "noise is not in the mean image"
    level = found["sources[0].radiant_intensity"]["measured"]["region.mean"]
    assert level["change"][0] == pytest.approx(-0.9 * (level["value"] - 64), abs=0.5)  # of rounding


@pytest.mark.long
def test_an_edge_stays_where_it_is_and_is_lost_where_pixels_are_full(
    rendered: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its place does not hang on the level; a tenth of the light is rounded more coarsely."""
    found = effects(rendered, capsys, "--measure", "edge --gamma 1 --dark 64")
    place = found["sources[0].radiant_intensity"]["measured"]
    assert all(abs(one["change"][0]) < 0.05 for key, one in place.items() if key.startswith("offset"))
    assert main(["catalog", "effects", str(rendered), "--measure", "edge --gamma 1 --dark 64"]) == 0
    assert "camera.sensor.offset from 0 to 240: mean gray -64 to +176" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("", "--measure: names nothing to measure"),
        ("corner", "--measure: argument WHAT: invalid choice: 'corner'"),
        ("edge --nonsense 3", "--measure: unrecognized arguments: --nonsense 3"),
        ('edge "', "--measure: No closing quotation"),
    ],
)
def test_what_cannot_be_measured_is_refused(
    words: str, message: str, rendered: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["catalog", "effects", str(rendered), "--measure", words]) == 2
    assert message in capsys.readouterr().err


LIGHTS = [
    SCENE["sources"][0] | {"name": "left", "count": 2, "position": ["-60 mm", "0 mm", "390 mm"]},
    SCENE["sources"][0]
    | {"name": "right", "count": 2, "position": ["80 mm", "0 mm", "390 mm"], "radiant_intensity": "20 mW/sr"},
]


def stripe(bright: float) -> Width:
    """A stripe of 7.4 px: of little light it looks like one of 5.5 px with more blur, and its width is not known."""
    light = stripe_picture((60, 80), 0.3, 42.0, 7.4, blur=3.3, levels=(30.0, bright))
    image = GrayImage(noisy(light, np.random.default_rng(7)))
    return measure_width(image, StraightCaliper((39.0, 17.5), 0.3, 24, 14))


@pytest.mark.parametrize("known", [True, False])
def test_a_width_that_is_not_known_is_named(
    known: bool, rendered: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is null there, and would not be seen among what changes: with a tenth of the light, or everywhere."""
    clear, faint = stripe(220.0), stripe(80.0)
    half = (read_gray(rendered / "gray.png").codes.max() + 64) / 2  # beside the offset

    def by_light(image: GrayImage, *_: Any, **__: Any) -> Width:
        return clear if known and image.codes.max() > half else faint

    monkeypatch.setattr("radwrap.cli.measure_straight.measure_width", by_light)
    words = ("--measure", "width --at 9 9 --length 9 --band 9")
    found = effects(rendered, capsys, *words)["sources[0].radiant_intensity"]["measured"]["width"]
    low = "at the low end"
    assert main(["catalog", "effects", str(rendered), *words]) == 0
    told = capsys.readouterr().out
    if known:
        assert found == {"value": clear.width, "change": [None, 0.0], "not_known": [low]}
        assert f"  width {clear.width:.6g}: ? to +0; not known {low}" in told
    else:
        assert found == {"value": None, "change": [None, None], "not_known": ["as rendered", low, "at the high end"]}
        assert f"  width ?: ? to ?; not known as rendered, {low}, at the high end" in told


@pytest.mark.parametrize("basis", [True, False])
def test_a_level_of_several_is_measured_where_a_basis_keeps_its_light(
    basis: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A mean without black level grows with the light: a tenth of left's part is left of it."""
    out = tmp_path / "run"
    scene = radwrap.scene_from_document(SCENE | {"sources": LIGHTS})
    run = radwrap.render(scene, out, tolerance=40, basis=basis)
    words = ("--measure", "region --region 0 0 31 23")
    found = effects(out, capsys, *words)["sources[0].radiant_intensity"]
    assert "sources[1].radiant_intensity" not in effects(out, capsys)
    (told,) = (one for one in run.manifest["assumed_effects"] if one["key"] == "sources[0].radiant_intensity")
    assert found["mean_gray"] == pytest.approx(told["mean_gray"], rel=0.03)
    if basis:
        alone = radwrap.relight(out, {"right": 0}).radiant_exposure.values.mean()
        share = alone / run.radiant_exposure.values.mean()
        assert 0.6 < share < 0.9
        moved = found["measured"]["region.mean"]
        assert moved["change"][0] == pytest.approx(-0.9 * share * (moved["value"] - 64), rel=0.01)
    else:
        assert "measured" not in found
        assert main(["catalog", "effects", str(out), *words]) == 0
        assert "cannot be measured: only a render with --basis keeps" in capsys.readouterr().out


def test_no_message_names_the_picture_that_is_only_for_a_while(
    rendered: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["catalog", "effects", str(rendered), "--measure", "dots --grid 5x5"]) == 2
    told = capsys.readouterr().err
    assert "gray" not in told.replace(str(rendered), "") and f"image of {rendered}: " in told and "; see" not in told
    assert not list(tmp_path.iterdir()), "nor is a picture of what was found left where the command runs"


@pytest.mark.parametrize("words", [("catalog", "effects", "DIR"), ("relight", "DIR", "--out", "out")])
def test_a_scene_folder_that_is_none_is_refused(
    words: tuple[str, ...], rendered: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = [str(rendered) if word == "DIR" else word for word in words]
    assert main([*given, "--scene-folder", "nix"]) == 2
    assert '--scene-folder: no such folder "nix"' in capsys.readouterr().err
