"""A luminaire file becomes a source of the intensity that it says."""

import math
from pathlib import Path

import numpy as np
import pytest

import radwrap
from radwrap.cli.main import main

SCENE = Path(__file__).parents[2] / "rad_scenes" / "crosscheck" / "lambertian" / "scene.toml"
# 100 cd on the axis, falling off with the cosine in steps of 15 degrees; a point.
LAMP = """IESNA:LM-63-2002
[TEST] {note}
TILT={tilt}
1 -1 100 7 1 1 2 0 0 0
1 1 50
0 15 30 45 60 75 90
0
1 0.9659258 0.8660254 0.7071068 0.5 0.2588190 0
"""
NEAR_AXIS = 1e-3  # the sheet is looked at within 0.3 degrees of the axis


def test_irradiance_is_what_the_candelas_say(tmp_path: Path) -> None:
    (tmp_path / "lamp.ies").write_text(LAMP.format(note="none", tilt="NONE"))
    assert main(["convert", str(tmp_path / "lamp.ies"), str(tmp_path / "lamp.rad")]) == 0
    (tmp_path / "scene.toml").write_text(SCENE.read_text())
    # A luminaire shines downwards, along -z of its file.
    targets = [
        {"type": "sheet", "material": "white", "size": ["400 mm", "400 mm"]},
        {"rad": "lamp.rad", "position": ["0 m", "0 m", "2 m"]},
    ]
    changes = {"targets": targets, "sources": [], "camera.focal_length": "300 mm"}
    scene = radwrap.load_scene(tmp_path / "scene.toml", changes)
    exposure = radwrap.render(scene, method="pinhole").radiant_exposure.values
    level = scene.camera.exposure_time * scene.camera.aperture.area / scene.camera.focal_length**2
    radiance = 0.8 / math.pi * 100 / 179 / 2.0**2
    assert float(np.median(exposure)) / level == pytest.approx(radiance, rel=NEAR_AXIS)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (LAMP.format(note="x", tilt="../../etc/passwd"), "names another file for its tilt"),
        (LAMP.format(note="x", tilt="tilt.dat"), "names another file for its tilt"),
        ("", "no TILT"),
        ("TILT=NONE\n\0", "no text"),
        ("TILT=NONE\n1 2 3\n", ""),
        (LAMP.format(note="x", tilt="NONE").replace("1 -1 100 7 1", "1 -1 100 1000000000 1000000000"), ""),
    ],
)
def test_hostile_files_are_refused(text: str, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "lamp.ies").write_text(text)
    assert main(["convert", str(tmp_path / "lamp.ies"), str(tmp_path / "lamp.rad")]) in (2, 4)
    said = capsys.readouterr().err
    assert told in said and "Traceback" not in said
    assert not (tmp_path / "lamp.rad").exists()


def test_nothing_of_the_header_reaches_the_scene(tmp_path: Path) -> None:
    """A comment of 2100 bytes would end as scene text, and "!" there runs a command."""
    mark = tmp_path / "ran"
    (tmp_path / "lamp.ies").write_text(LAMP.format(note="x" * 2100 + f" !touch {mark}", tilt="NONE"))
    main(["convert", str(tmp_path / "lamp.ies"), str(tmp_path / "lamp.rad")])
    out = tmp_path / "lamp.rad"
    assert not out.exists() or "!" not in out.read_text()
    assert not mark.exists()
