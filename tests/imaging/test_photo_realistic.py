"""The other way of Fig. 3: Lambert and Phong by hand, and the picture beside the predicted one."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.cli.main import main
from radwrap.images import read_gray
from radwrap.imaging.forecast.photo_realistic import Light, one_light, photo_realistic

SCENES = Path(__file__).parents[2] / "rad_scenes"
ROUNDING = 0.5  # gray level
SMALL = {
    "camera.sensor.rows": 21,
    "camera.sensor.columns": 31,
    "camera.sensor.pixel_width": "200 um",
    "camera.sensor.pixel_height": "200 um",
}


def sheet(material: dict[str, Any], tilt: float = 0.0) -> radwrap.Scene:
    changes = {
        "targets": [
            {"type": "sheet", "material": "m", "size": ["2 m", "2 m"], "rotation": [f"{tilt} deg"] + ["0 deg"] * 2}
        ],
        "materials": {"m": material},
        "sources": [
            {
                "type": "lamp",
                "name": "lamp",
                "position": ["0 mm", "0 mm", "790 mm"],
                "look_at": ["0 mm", "0 mm", "0 mm"],
                "diameter": "1 mm",
                "radiant_intensity": "3 W/sr",
                "beam": {"profile": "lambertian"},
            }
        ],
    }
    return radwrap.load_scene(SCENES / "bench_board" / "scene.toml", changes | SMALL)


@pytest.mark.parametrize("tilt", [0.0, 35.0, -60.0])
def test_parallel_light_on_a_diffuse_sheet_is_one_gray(tilt: float) -> None:
    scene = sheet({"type": "lambertian", "reflectance": 0.5}, tilt)
    light = Light("parallel", (0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
    assert np.abs(photo_realistic(scene, light) - 127.5 * math.cos(math.radians(tilt))).max() <= ROUNDING


def test_phongs_highlight_is_where_the_mirror_direction_meets_the_eye() -> None:
    """Light at the eye: on a flat sheet the highlight lies at the axis and falls with cos^n of twice the angle."""
    scene = sheet({"type": "specular", "specular_reflectance": 0.8, "roughness": 0.2})
    codes = photo_realistic(scene, Light("parallel", (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)))
    sensor = scene.camera.sensor
    away = np.hypot((np.arange(31) - 15)[np.newaxis], (np.arange(21) - 10)[:, np.newaxis]) * sensor.pixel_width
    angle = np.arctan(away / scene.camera.focal_length)  # parallel light comes back along the axis
    assert np.abs(codes - 255 * 0.8 * np.cos(angle) ** (1 / (2 * 0.2**2))).max() <= ROUNDING


def test_a_point_light_falls_with_distance() -> None:
    scene = sheet({"type": "lambertian", "reflectance": 1.0})
    codes = photo_realistic(scene, one_light(scene, "point"))
    assert codes[10, 15] == 255
    away = np.hypot((np.arange(31) - 15)[np.newaxis], (np.arange(21) - 10)[:, np.newaxis]) * 200e-6
    cosine = np.cos(np.arctan(away / scene.camera.focal_length))  # the lamp is at the pinhole
    assert np.abs(codes - 255 * cosine**3).max() <= ROUNDING


def test_the_command_puts_both_side_by_side(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [f"--set={key}={json.dumps(value)}" for key, value in SMALL.items()]
    scene = str(SCENES / "bench_board" / "scene.toml")
    out = tmp_path / "out"
    assert main(["render", scene, "--out", str(out), "--method", "pinhole", "--photo-realistic", *words]) == 0
    assert "comparison.png" in capsys.readouterr().out
    told = json.loads((out / "photo_realistic.json").read_text())
    gray, drawn = (read_gray(out / name).values for name in ("gray.png", "photo_realistic.png"))
    assert told["gray_difference"]["rms"] == pytest.approx(math.sqrt(((drawn - gray) ** 2).mean()))
    panels = read_gray(out / "comparison.png").values
    assert panels.shape == (21, 93)
    assert np.array_equal(panels[:, :31], drawn) and np.array_equal(panels[:, 31:62], gray)
    assert np.abs(panels[:, 62:] - (127.5 + (drawn - gray) / 2)).max() <= 2 * ROUNDING


def test_what_cannot_be_drawn_is_told_before_a_ray_is_traced(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [f"--set={key}={json.dumps(value)}" for key, value in SMALL.items()]
    mirror = '--set=materials.black={ type = "mirror", reflectance = 0.9 }'
    target = '--set=targets=[{ type = "sheet", material = "black", size = ["1 m", "1 m"] }]'
    scene = str(SCENES / "bench_board" / "scene.toml")
    out = tmp_path / "out"
    assert main(["render", scene, "--out", str(out), "--photo-realistic", "point", *words, mirror, target]) == 2
    assert "materials.black: mirrors and glass cannot be drawn" in capsys.readouterr().err
    assert not (out / "gray.png").exists()
