"""What a measurement hangs on: known changes over the ranges of assumed values."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import radwrap
from radwrap.cli.main import main

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
