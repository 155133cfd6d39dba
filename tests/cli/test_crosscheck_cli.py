"""``radwrap crosscheck`` as users run it."""

import json
import shutil
from pathlib import Path

import pytest

from radwrap.cli.main import main

SCENE = Path(__file__).parents[2] / "rad_scenes" / "crosscheck" / "lambertian" / "scene.toml"
needs_povray = pytest.mark.skipif(
    shutil.which("povray") is None, reason="POV-Ray is not installed (apt install povray): no cross-check was made"
)


@needs_povray
def test_agreement(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "with blanks"
    assert main(["crosscheck", str(SCENE), "--out", str(out), "--pixel-samples", "1", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["agrees"] and found["terms"]["diffuse"]["pixels"] == 3000
    written = json.loads((out / "crosscheck.json").read_text())
    assert written == found
    assert (out / "crosscheck.png").read_bytes()[:4] == b"\x89PNG"


@needs_povray
def test_disagreement_is_exit_code_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Half floats are good to 5e-4 and 1.4e-4 rms: a tolerance below that is missed, and said so."""
    argv = ["crosscheck", str(SCENE), "--out", str(tmp_path), "--pixel-samples", "1", "--tolerance", "1e-4"]
    assert main(argv) == 1
    told = capsys.readouterr().out
    assert "differs" in told and "they DIFFER" in told


FILTERS = "{red = {quantum_efficiency = 0.1}, green = {quantum_efficiency = 0.5}, blue = {quantum_efficiency = 0.05}}"


def colour_scene(folder: Path) -> Path:
    """The scene with a small linear sensor behind a mosaic, in light of one wavelength."""
    text = SCENE.read_text()
    head, sensor = text.split("[camera.sensor]\n", 1)
    own, rest = sensor.split("\n[", 1)
    kept = [line for line in own.splitlines() if line.split(" ")[0] in ("pixel_width", "pixel_height")]
    linear = [
        "rows = 14",
        "columns = 16",
        'model = "linear"',
        'wavelength = "550 nm"',
        'system_gain = "0.1 DN/e"',
        "offset = 4",
    ]
    linear += ['full_well = "12 ke"', 'read_noise = "8 e"', 'mosaic = "RGGB"', f"filters = {FILTERS}"]
    path = folder / "colour.toml"
    path.write_text(head + "\n".join(["[camera.sensor]", *kept, *linear]) + "\n\n[" + rest)
    return path


@pytest.mark.long
@needs_povray
def test_a_colour_camera_is_compared_colour_by_colour(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of one wavelength all colours differ alike: that with most light is compared, as a camera with its filter is."""
    scene, out = colour_scene(tmp_path), tmp_path / "out"
    assert main(["crosscheck", str(scene), "--out", str(out), "--pixel-samples", "1", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["agrees"] and found["mosaic"] == "RGGB" and list(found["colours"]) == ["green"]
    assert json.loads((out / "crosscheck.json").read_text()) == found
    assert (out / "planes" / "green" / "crosscheck.png").is_file()
    plane = ["--set", "camera.sensor.mosaic=green", "--pixel-samples", "1", "--json"]
    assert main(["crosscheck", str(scene), "--out", str(tmp_path / "green"), *plane]) == 0
    alone = json.loads(capsys.readouterr().out)
    assert found["colours"]["green"]["radiance"] == alone["radiance"]


@pytest.mark.long
@needs_povray
def test_a_colour_that_differs_is_exit_code_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    argv = ["crosscheck", str(colour_scene(tmp_path)), "--out", str(tmp_path / "out"), "--pixel-samples", "1"]
    assert main([*argv, "--tolerance", "1e-4"]) == 1
    told = capsys.readouterr().out
    assert "green pixels of the raw mosaic RGGB" in told and "they DIFFER" in told


@pytest.mark.parametrize(
    ("options", "code", "told"),
    [
        (["--povray", "no-such-povray"], 4, "no such program"),
        (["--povray", "true"], 4, "is not POV-Ray 3.7"),
        (["--area-samples", "1"], 2, "--area-samples: must be 0"),
        (["--tolerance", "nan"], 2, "--tolerance: must be a number"),
        (["--pixel-samples", "0"], 2, "--pixel-samples: must lie between"),
    ],
)
def test_bad_options(
    options: list[str], code: int, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["crosscheck", str(SCENE), "--out", str(tmp_path / "out"), *options]) == code
    assert told in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_out_is_needed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["crosscheck", str(SCENE)]) == 2
    assert "--out: is missing" in capsys.readouterr().err
