"""Scene text: golden files, units of the text, and what Radiance makes of extremes."""

import re
from pathlib import Path

import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.process import Programs
from radwrap.tracers.installation import find_radiance
from radwrap.tracers.radiance import RadianceOptions, build, prepare
from radwrap.tracers.text_frame import TextFrame, traced_frame, users_frame

ROOT = Path(__file__).parents[2]
SCENES = sorted((ROOT / "rad_scenes").rglob("scene.toml"))
BENCH = ROOT / "rad_scenes" / "bench_board" / "scene.toml"

# Another machine's sine may differ in its last digit; everything else is compared to the letter.
LAST_DIGITS = 1e-14


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.parent.name)
def test_the_text_is_the_golden_one(path: Path, tmp_path: Path) -> None:
    golden = path.with_name("scene.rad").read_text()
    scene = radwrap.load_scene(path)
    with Programs() as programs:
        options = RadianceOptions(find_radiance())
        prepared = prepare(scene, options, programs, tmp_path, frame=users_frame(scene))
    for ours, theirs in zip(prepared.scene.text.split("\n"), golden.split("\n"), strict=True):
        if ours == theirs:
            continue
        words = ours.split(), theirs.split()
        assert len(words[0]) == len(words[1])
        for mine, golden_word in zip(*words, strict=True):
            assert mine == golden_word or float(mine) == pytest.approx(float(golden_word), rel=LAST_DIGITS, abs=1e-15)


def test_the_text_is_readable() -> None:
    text = BENCH.with_name("scene.rad").read_text()
    assert text.startswith("# Radiance scene written by radwrap")
    assert "# board.dots: sheeting" in text
    assert len(re.findall(r" light ", text)) == 12
    # Dots are painted on the board: no surface of theirs lies in its plane.
    assert len(re.findall(r" polygon ", text)) == 1
    assert "both.board polygon board\n" in text


@pytest.mark.parametrize(
    ("changes", "frame"),
    [
        ({}, TextFrame()),
        ({"sources[0].led_diameter": "10 um"}, TextFrame(1e-3)),
        ({"sources[0].led_diameter": "1 um"}, TextFrame(1e-6)),
        (
            {"targets[0].margin": "0 mm", "targets[0].pitch": "0.5 mm", "targets[0].dot_diameter": "0.1 mm"},
            TextFrame(1e-3),
        ),
        ({"sources[0].radiance": "1e-12 W/m^2/sr"}, TextFrame(1e-3, 1e-15)),
        ({"sources[0].radiance": "1e12 W/m^2/sr"}, TextFrame(1e-3, 1e9)),
    ],
)
def test_units_suit_what_radiance_can_hold(changes: dict[str, str], frame: TextFrame) -> None:
    assert users_frame(radwrap.load_scene(BENCH, changes)) == frame


def test_sources_too_far_apart_are_refused() -> None:
    scene = radwrap.load_scene(BENCH, {"sources[0].leds": [{"index": 0, "radiance_factor": 1e-9}]})
    with pytest.raises(InputError, match="cannot be traced together"):
        traced_frame(scene)


def test_dark_leds_are_left_out_by_name(tmp_path: Path) -> None:
    scene = radwrap.load_scene(BENCH, {"sources[0].leds": [{"index": 0, "radiance_factor": 0.0}]})
    with Programs() as programs:
        text = prepare(scene, RadianceOptions(find_radiance()), programs, tmp_path).scene.text
    assert "# ring.led00: dark, left out" in text
    assert text.count(" light ") == 11


def test_oconv_takes_every_scene_without_a_word(tmp_path: Path) -> None:
    options = RadianceOptions(find_radiance())
    with Programs() as programs:
        for path in SCENES:
            prepared = prepare(radwrap.load_scene(path), options, programs, tmp_path)
            build(prepared.scene.text, prepared.scene.files, tmp_path, options, programs)


def test_light_that_a_file_s_unit_cannot_hold_is_refused() -> None:
    """Beside an included file nothing is scaled: its own light has the text's unit."""
    path = ROOT / "rad_scenes" / "crosscheck" / "corner_cubes" / "scene.toml"
    with pytest.raises(InputError, match="beside an included Radiance file"):
        traced_frame(radwrap.load_scene(path, {"sources[0].radiance": "1e-9 W/m^2/sr"}))


def test_a_material_is_described_once_for_all_that_have_it(tmp_path: Path) -> None:
    """Each start of rtrace reads all modifiers: four for each of 20 000 sheets took 20 s."""
    brushed = {
        "type": "specular",
        "diffuse_reflectance": 0.1,
        "specular_reflectance": 0.4,
        "roughness": [0.05, 0.25],
    }
    sheets = [
        {"type": "sheet", "name": f"s{at}", "material": material, "position": [f"{at} mm", "0 mm", "0 mm"]}
        | {"size": ["0.8 mm", "0.8 mm"], "rotation": ["0 deg", "0 deg", f"{10 * at} deg"]}
        for at, material in enumerate(["sheeting", "sheeting", "sheeting", "brushed", "brushed"])
    ]
    scene = radwrap.load_scene(BENCH, {"targets": sheets, "materials.brushed": brushed})
    with Programs() as programs:
        text = prepare(scene, RadianceOptions(find_radiance()), programs, tmp_path).scene.text
    assert len(re.findall(r"^void mixfunc material\.sheeting$", text, re.MULTILINE)) == 1
    assert re.findall(r"^(\S+) polygon (\S+)$", text, re.MULTILINE) == [
        *(("material.sheeting", f"s{at}") for at in range(3)),
        *((f"surface.s{at}", f"s{at}") for at in (3, 4)),  # their grain turns with them
    ]
    assert "material.black" not in text, "nothing has it"
