"""POV-Ray as a witness: what it is asked, what it cannot express, and that a broken one is noticed."""

import re
import shutil
import stat
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.errors import EnvironmentFailure, InputError, TracerError
from radwrap.images import write_exr
from radwrap.imaging.optics.view import PixelPlan, ray_blocks
from radwrap.process import Limits, Programs
from radwrap.tracers.povray import PovrayTracer, find_povray
from radwrap.tracers.povray_included import included_text, rims
from radwrap.tracers.povray_text import povray_camera, povray_scene
from radwrap.tracers.text_frame import TextFrame, users_frame

SCENES = Path(__file__).parents[2] / "rad_scenes" / "crosscheck"


FRAME = TextFrame()


def load(name: str = "lambertian", **changes: Any) -> radwrap.Scene:
    return radwrap.load_scene(SCENES / name / "scene.toml", changes)


def fake(folder: Path, body: str, version: str = "POV-Ray 3.7.0.10.fake") -> str:
    """A program that calls itself povray, and instead of tracing does what `body` says."""
    folder.mkdir(exist_ok=True)
    path = folder / "povray"
    path.write_text(f'#!/bin/sh\nif [ "$1" = --version ]; then echo "{version}" >&2; exit 0; fi\n{body}\n')
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


def ask(program: str, folder: Path, limits: Limits = Limits()) -> np.ndarray:  # noqa: B008  (frozen)
    scene = load()
    with Programs() as programs:
        tracer = PovrayTracer(
            find_povray(programs, program),
            programs,
            folder / "work",
            povray_scene(scene, {}, FRAME),
            frame=FRAME,
            camera=scene.camera,
            limits=limits,
        )
        blocks = (block.rays for block in ray_blocks(scene.camera, (0.0, 0.0), PixelPlan()))
        return np.concatenate(list(tracer.trace(blocks)))


def test_a_missing_witness_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(EnvironmentFailure, match=r"no such program.*apt install povray"):
        ask(str(tmp_path / "none"), tmp_path)
    monkeypatch.setenv("PATH", str(tmp_path))
    with Programs() as programs, pytest.raises(EnvironmentFailure, match="POV-Ray is not installed"):
        find_povray(programs)


@pytest.mark.parametrize("version", ["Persistence of Vision(tm) Ray Tracer Version 3.6.1", "POV-Ray 3.8.0-alpha", ""])
def test_another_version_is_noticed(version: str, tmp_path: Path) -> None:
    with pytest.raises(EnvironmentFailure, match=r"is not POV-Ray 3\.7"):
        ask(fake(tmp_path, "exit 0", version), tmp_path)


@pytest.mark.parametrize(
    ("body", "told"),
    [
        ("echo 'Fatal error in parser' >&2; exit 1", "exit code 1: Fatal error in parser"),
        ("kill -SEGV $$", "exit code -11"),
        ("exit 0", "wrote no picture"),
        ("echo junk > view.exr", "its picture is not an image"),
        ("echo 'Parse Warning: degenerate triangle' >&2; cp {right} view.exr", "degenerate triangle"),
        ("cp {small} view.exr", "has 4 x 3 pixels, not 60 x 50"),
        ("cp {wrong} view.exr", "NaN or negative"),
        ("head -c 3000 {right} > view.exr", "its picture is not complete"),
        ("sleep 30", "did not end within"),
    ],
)
def test_a_broken_witness_is_noticed(body: str, told: str, tmp_path: Path) -> None:
    shape = (50, 60)
    pictures = {"right": np.ones(shape), "small": np.ones((3, 4)), "wrong": np.full(shape, -1.0)}
    for name, pixels in pictures.items():
        noise = np.random.default_rng(0).random(pixels.shape)
        write_exr(tmp_path / f"{name}.exr", (pixels * (1 + noise)).astype(np.float32), channel="Y")
    body = body.format(**{name: tmp_path / f"{name}.exr" for name in pictures})
    with pytest.raises(TracerError, match=told):
        ask(fake(tmp_path, body), tmp_path, Limits(silence=1.0))


def test_a_picture_of_the_right_size_passes(tmp_path: Path) -> None:
    """So it is the faults above that are noticed."""
    write_exr(tmp_path / "right.exr", np.full((50, 60), 300.0, dtype=np.float32), channel="Y")
    scale = 256.0  # asked for by an expected peak of 1
    answer = ask(fake(tmp_path, f"cp {tmp_path}/right.exr view.exr"), tmp_path)
    assert (answer == 300.0 / scale).all()


@pytest.mark.parametrize(
    ("name", "changes", "told"),
    [
        ("ring", {}, "no Gaussian beam"),
        (
            "lambertian",
            {
                "materials.white": {
                    "type": "retroreflective",
                    "model": "perturbed_normal",
                    "reflectance": 0.1,
                    "roughness": 0.01,
                }
            },
            "materials.white: POV-Ray has no retroreflection",
        ),
        (
            "cone_beam",
            {"sources[0].position": ["0 mm", "0 mm", "90 mm"], "sources[0].look_at": ["0 mm", "0 mm", "500 mm"]},
            "its disc is in view",
        ),
        ("lambertian", {"sources[0].position": ["0 m", "0 m", "2000 m"]}, "where POV-Ray loses it"),
    ],
)
def test_what_povray_cannot_express_is_refused_by_name(name: str, changes: dict[str, Any], told: str) -> None:
    with pytest.raises(InputError, match=told):
        scene = load(name, **changes)
        povray_scene(scene, {}, users_frame(scene))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("void glass g 0 0 3 1 1 1\ng sphere s 0 0 4 0 0 0 1\n", 'glass "g" cannot be written'),
        ("void plastic p 0 0 5 .5 .5 .5 .1 .1\np sphere s 0 0 4 0 0 0 1\n", 'plastic "p" with a highlight'),
        ("void plastic p 0 0 5 .5 .4 .5 0 0\np sphere s 0 0 4 0 0 0 1\n", 'plastic "p" in colour'),
        ("void light l 0 0 3 1 1 1\nl sphere s 0 0 4 0 0 0 1\n", 'light "l" cannot be written'),
        ("void plastic p 0 0 5 1 1 1 0 0\np cone c 0 0 8 0 0 0 0 0 1 1 0\n", 'cone "c" cannot be written'),
        ("void sphere s 0 0 4 0 0 0 1\n", "a surface of void"),
    ],
)
def test_what_an_included_file_holds_is_refused_by_name(text: str, told: str) -> None:
    with pytest.raises(InputError, match=told):
        included_text(text, "scene.toml: targets[0]")


def test_a_polygon_s_hole_is_a_rim_of_its_own() -> None:
    """Radiance hangs it on a seam; POV-Ray would end the polygon where a corner comes again."""
    outer = [(-4.0, -4.0), (4.0, -4.0), (4.0, 4.0), (-4.0, 4.0)]
    hole, other = (
        [(x + shift, y) for x, y in ((0.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, 0.0))] for shift in (0.0, 2.0)
    )
    seamed = [*outer, outer[0], *hole, hole[0], *other, other[0], hole[0], outer[0]]
    assert rims(seamed) == [outer, hole, other]
    assert rims(outer) == [outer]
    touching = [(0.0, 0.0), (1.0, 0.0), (2.0, 1.0), (3.0, 0.0), (3.0, 2.0), (2.0, 1.0), (0.0, 2.0)]
    assert sum(map(len, rims(touching))) == 7  # two rims that share a corner, whichever way round
    numbers = " ".join(f"{x} {y} 0" for x, y in seamed)
    text = f"void plastic p 0 0 5 .5 .5 .5 0 0\np polygon s 0 0 {3 * len(seamed)} {numbers}\n"
    assert "polygon { 15, <-4.0, -4.0, 0.0>, " in included_text(text, "x")


@pytest.mark.parametrize("names", [("a-b", "a_M_b"), ("m" * 50 + "1", "m" * 50 + "2")])
def test_every_material_has_a_word_of_its_own(names: tuple[str, str]) -> None:
    """POV-Ray's identifiers hold no "-", and 40 characters."""
    materials = {name: {"type": "lambertian", "reflectance": 0.25 + i / 2} for i, name in enumerate(names)}
    sheet = {"type": "sheet", "size": ["9 mm", "9 mm"]}
    targets = [{**sheet, "material": name, "position": ["0 mm", "0 mm", f"{i} mm"]} for i, name in enumerate(names)]
    text = povray_scene(load(**{"materials": materials, "targets": targets}), {}, FRAME)
    words = dict(re.findall(r"#declare (\w+) = .*? diffuse ([\d.]+)", text))
    used = re.findall(r"texture \{ (\w+) \} \}", text)
    assert [words[word] for word in used] == ["0.25", "0.75"]
    assert max(map(len, used)) <= 40


def test_a_file_s_name_is_no_part_of_the_text(tmp_path: Path) -> None:
    """It may hold any letter, and a line break would end the comment; POV-Ray has #include and #fopen."""
    shutil.copytree(SCENES / "mirror", tmp_path / "s")
    path = (tmp_path / "s" / "scene.toml").rename(tmp_path / "s" / "sz\u00e9ne\n#error.toml")
    scene = radwrap.load_scene(path)
    (name,) = (target.name for target in scene.included)
    text = povray_scene(scene, {name: "void plastic p 0 0 5 1 1 1 0 0\np sphere s 0 0 4 0 0 0 1\n"}, FRAME)
    assert text.isascii() and "#error" not in text and f"// {name}\nsphere" in text


def test_the_camera_is_sheared() -> None:
    """From the opening's point through the pixel's erect image point: the window moves against the place."""
    scene = load("edge_near")
    still, moved = (povray_camera(scene.camera, (u, 0.0), FRAME) for u in (0.0, 5e-5))

    def vector(text: str, key: str) -> np.ndarray:
        return np.array(text.split(f"{key} <")[1].split(">", maxsplit=1)[0].split(","), dtype=float)

    f = scene.camera.focal_length
    x = np.asarray(scene.camera.pose.x_axis)
    assert vector(moved, "location") - vector(still, "location") == pytest.approx(5e-2 * x)
    assert vector(moved, "direction") - vector(still, "direction") == pytest.approx(5e-5 / f * x)
    assert (vector(moved, "right") == vector(still, "right")).all()


@pytest.mark.skipif(shutil.which("povray") is None, reason="POV-Ray is not installed (apt install povray)")
def test_it_answers_rays_of_its_camera_alone(tmp_path: Path) -> None:
    assert ask(shutil.which("povray") or "", tmp_path).min() > 0
    scene = load()
    with Programs() as programs:
        installation = find_povray(programs)
        assert installation.version.startswith("3.7")
        text = povray_scene(scene, {}, FRAME)
        tracer = PovrayTracer(installation, programs, tmp_path, text, frame=FRAME, camera=scene.camera)
        for block in ray_blocks(scene.camera, (0.0, 0.0), PixelPlan(2)):
            with pytest.raises(ValueError, match="centres of pixels' strata"):
                list(tracer.trace([block.rays]))
        with pytest.raises(InputError, match="does not give distances"):
            tracer.distances([])


@pytest.mark.skipif(shutil.which("povray") is None, reason="POV-Ray is not installed (apt install povray)")
def test_a_scene_of_any_level_comes_back(tmp_path: Path) -> None:
    """Half floats hold eleven decades; the scale is looked for, whatever was expected, and changes no digit."""
    values = []
    for power in (0, 9):
        scene = load(**{"sources[0].radiant_intensity": f"34e{power} W/sr"})
        with Programs() as programs:
            text = povray_scene(scene, {}, FRAME)
            tracer = PovrayTracer(
                find_povray(programs), programs, tmp_path / str(power), text, frame=FRAME, camera=scene.camera
            )
            blocks = [block.rays for block in ray_blocks(scene.camera, (0.0, 0.0), PixelPlan())]
            values.append(np.concatenate(list(tracer.trace(blocks))) / 10.0**power)
    assert values[0] == pytest.approx(values[1], rel=1e-3)
    assert not list((tmp_path / "0").iterdir())  # pictures do not pile up
