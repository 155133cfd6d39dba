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


# Factors for a luminaire that is tilted by so many degrees; here it hangs upright.
TILTED = "INCLUDE\n1\n3\n0 45 90\n1 0.9 0.8"


@pytest.mark.parametrize("tilt", ["NONE", TILTED], ids=["plain", "tilt"])
def test_irradiance_is_what_the_candelas_say(tilt: str, tmp_path: Path) -> None:
    (tmp_path / "lamp.ies").write_text(LAMP.format(note="none", tilt=tilt))
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


def changed(word: str, other: str) -> str:
    """The lamp with something else in one place."""
    text = LAMP.format(note="x", tilt="NONE")
    assert text.count(word) == 1
    return text.replace(word, other)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (LAMP.format(note="x", tilt="../../etc/passwd"), "names another file for its tilt"),
        (LAMP.format(note="x", tilt="tilt.dat"), "names another file for its tilt"),
        ("", "no TILT"),
        ("TILT=NONE\n\0", "holds a NUL byte"),
        ("TILT=NONE\n1 2 3\n", "ends too early"),
        (changed("100 7 1 1", "100 1000000000 1000000000 1"), "number of vertical angles must lie between"),
        (changed("0.9659258", "-0.9659258"), "candela values must lie between 0 and"),
        (changed("0.9659258", "1e30"), "candela values must lie between 0 and"),
        (changed("0.9659258", "nan"), '"nan" is not a number'),
        (changed("1 -1 100 7", "1 -1 -100 7"), "a multiplier is not above 0"),
        (changed("1 1 50", "0 1 50"), "a multiplier is not above 0"),
        (changed("15 30", "30 15"), "vertical angles must increase"),
        (changed("75 90", "75 190"), "vertical angles must increase"),
        (changed("0.2588190 0", "0.2588190 0 0"), "1 numbers follow its last"),
        (changed("0.2588190 0", "0.2588190"), "ends too early"),
        (changed("1 1 2 0", "1 1 3 0"), "unit of length is 3"),
        (changed("1 1 2 0", "1 2 2 0"), "of type B; only type C is read"),
        (changed("1 1 2 0", "1 3 2 0"), "of type A; only type C is read"),
        (LAMP.format(note="x", tilt=TILTED.replace("0.9", "-0.9")), "a tilt's factor is negative"),
    ],
)
def test_hostile_files_are_refused(text: str, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "lamp.ies").write_text(text)
    assert main(["convert", str(tmp_path / "lamp.ies"), str(tmp_path / "lamp.rad")]) == 2
    said = capsys.readouterr().err
    assert told in said and f"{tmp_path / 'lamp.ies'}: " in said and "Traceback" not in said
    assert not (tmp_path / "lamp.rad").exists()


def test_what_ies2rad_refuses_is_the_file_s_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("radwrap.convert.ies_files.fault_of_numbers", lambda *_, **__: None)
    (tmp_path / "lamp.ies").write_text("TILT=NONE\n1 2 3\n")
    assert main(["convert", str(tmp_path / "lamp.ies"), str(tmp_path / "lamp.rad")]) == 2
    assert f"{tmp_path / 'lamp.ies'}: is not a luminaire file: ended with exit code 1" in capsys.readouterr().err


def test_nothing_of_the_header_reaches_the_scene(tmp_path: Path) -> None:
    """A comment of 2100 bytes would end as scene text, and "!" there runs a command."""
    mark = tmp_path / "ran"
    (tmp_path / "lamp.ies").write_text(LAMP.format(note="x" * 2100 + f" !touch {mark}", tilt="NONE"))
    main(["convert", str(tmp_path / "lamp.ies"), str(tmp_path / "lamp.rad")])
    out = tmp_path / "lamp.rad"
    assert not out.exists() or "!" not in out.read_text()
    assert not mark.exists()
