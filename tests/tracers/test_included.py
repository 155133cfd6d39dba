"""Included Radiance scene files: what is refused, and that what is accepted renders as before."""

from __future__ import annotations

import importlib.util
import math
import os
import subprocess
import tempfile
from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from radwrap.errors import InputError
from radwrap.tracers.included import IncludedScene, check_no_cycle, light_in, read_included
from radwrap.tracers.rad_grammar import ALLOWED, Source, primitives


def _radiance() -> Path:
    spec = importlib.util.find_spec("pyradiance")
    assert spec is not None and spec.origin is not None
    return Path(spec.origin).parent


RADIANCE = _radiance()
LIBRARY = RADIANCE / "lib"
WHERE = "scene.toml: targets[0].rad"
GRAY = "void plastic gray 0 0 5 .5 .5 .5 0 0\n"
BALL = "gray sphere ball 0 0 4 0 0 0 1\n"
LAMP = "void light lamp 0 0 3 100 90 80\nlamp sphere bulb 0 0 4 3 3 6 .2\n"


def _run(*argv: str, folder: Path, stdin: bytes = b"") -> subprocess.CompletedProcess[bytes]:
    environment = {"PATH": str(RADIANCE / "bin"), "RAYPATH": f".:{LIBRARY}", "LC_ALL": "C"}
    program = str(RADIANCE / "bin" / argv[0])
    return subprocess.run(
        [program, *argv[1:]],
        input=stdin,
        cwd=folder,
        env=environment,
        capture_output=True,
        timeout=60,
        check=False,
    )


def _said(done: subprocess.CompletedProcess[bytes]) -> list[str]:
    lines = done.stderr.decode().splitlines()
    return [line for line in lines if not line.endswith("warning - no light sources found")]


def _lay(folder: Path, files: Mapping[str, str | bytes]) -> None:
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content.encode() if isinstance(content, str) else content)


def _read(folder: Path, text: str | bytes, files: Mapping[str, str | bytes] | None = None) -> IncludedScene:
    _lay(folder, {"room.rad": text, **(files or {})})
    return read_included(folder / "room.rad", folder=folder, library=LIBRARY, prefix="include1", where=WHERE)


def _refused(folder: Path, text: str | bytes, fragment: str, files: Mapping[str, str | bytes] | None = None) -> str:
    with pytest.raises(InputError) as caught:
        _read(folder, text, files)
    message = str(caught.value)
    assert fragment in message
    assert message.startswith(f"{WHERE}: {folder / 'room.rad'}")
    assert caught.value.remedy and caught.value.exit_code == 2
    assert "\n" not in message and message.isprintable()
    return message


def _rays() -> bytes:
    x, y = np.meshgrid(np.linspace(-1.6, 1.6, 33), np.linspace(-1.6, 1.6, 33))
    origin = np.stack([x, y, np.full_like(x, 5.0)], axis=-1).reshape(-1, 3)
    direction = np.broadcast_to([0.02, 0.01, -1.0], origin.shape)
    return np.hstack([origin, direction]).astype(np.float64).tobytes()


TRACE = "-h -fdf -ov -ab 0 -dt 0 -dc 1 -dj 0 -ds 0 -st 1 -lr 8 -lw 0".split()


def _rendered(folder: Path, text: bytes) -> bytes:
    octree = _run("oconv", "-f", "-", folder=folder, stdin=text)
    assert (octree.returncode, _said(octree)) == (0, [])
    (folder / "scene.oct").write_bytes(octree.stdout)
    values = _run("rtrace", *TRACE, "scene.oct", folder=folder, stdin=_rays())
    assert (values.returncode, _said(values)) == (0, [])
    assert len(values.stdout) == 33 * 33 * 3 * 4
    return values.stdout


# --- scenes that are accepted, and look the same ---------------------------------------------------------

DATA = "# two sizes\n2\n-1 1 3\n0 0 3 -1 0.1 1\n1 2 3\n4 5 6\n7 8 9\n"
BEAM = "1\n0 90 4\n1 .7 .2 .1\n"
PICTURE = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 3\n" + bytes([120, 90, 60, 129, 30, 20, 90, 128]) * 3
STRIPES = "{ a comment } stripe = if(sin(9*Px), .2, 1); bump(a, b) = a*b;"
SCENES: dict[str, tuple[str, dict[str, str | bytes]]] = {
    "plain": (
        f"# Maße in m\n{LAMP}{GRAY}{BALL}void metal shiny 0 0 5 .7 .7 .6 .5 .1\n"
        "shiny polygon floor 0 0 12 -2 -2 -1 2 -2 -1.0 2. 2 -1e0 -2 +2 -1\n"
        "gray cylinder post 0 0 7 .9 .9 -1 .9 .9 .6 .2\ngray ring lid 0 0 8 -1 1 .3 0 .1 1 0 .3\n",
        {},
    ),
    "function files": (
        f"{LAMP}void brightfunc striped 10 stripe sub/stripes.cal -rz 30 -t .1 .2 .3 -s 2 0 0\n"
        "striped colorfunc tinted 4 Px*Px+.1 abs(Py) noise3(Px,Py,Pz)*.5+.5 ./plain.cal 0 1 2\n"
        "tinted texfunc rough 4 bump(Px,.2) -Py*.1 0 plain.cal 0 0\n"
        "rough plastic wall 0 0 5 .5 .6 .7 0 0\nwall sphere ball 0 0 4 0 0 0 1.5\n",
        {"sub/stripes.cal": STRIPES, "plain.cal": STRIPES},
    ),
    "data files": (
        f"{LAMP}void brightdata grid 5 noop a/grid.dat . Px Py 0 0\ngrid plastic wall 0 0 5 .05 .06 .07 0 0\n"
        "void colorpict poster 7 noop noop noop poster.hdr . Px+.2 Py+.3 0 0\nposter glow paper 0 0 4 1 1 1 0\n"
        "wall sphere ball 0 0 4 0 0 0 1\npaper ring sheet 0 0 8 0 0 -1 0 0 1 0 3\n",
        {"a/grid.dat": DATA, "poster.hdr": PICTURE},
    ),
    "mixtures and aliases": (
        f"{LAMP}{GRAY}void plastic red 0 0 5 .8 .1 .1 0 0\nvoid mixfunc both 4 gray red sin(4*Px) . 0 0\n"
        "void alias other both\ninherit alias third red\nother sphere ball 0 0 4 0 0 0 1\n"
        "void plastic red 0 0 5 .1 .1 .8 0 0\nred ring back 0 0 8 0 0 -1 0 0 1 0 3\n"
        "third sphere small 0 0 4 1.2 1.2 0 .3\n",
        {},
    ),
    "lights": (
        "void spotlight spot 0 0 7 900 900 900 40 0 0 -1e-9\nspot ring eye 0 0 8 0 0 4 0 0 -1 0 .05\n"
        "void glow haze 0 0 4 .1 .2 .3 5\nhaze source sky 0 0 4 0 0 1 180\n"
        "void illum window 1 void 0 3 5 5 5\nwindow polygon pane 0 0 9 2 2 2 2 -1 2 4 .5 2\n" + GRAY + BALL,
        {},
    ),
    "library": (
        "void brightdata beam 4 corr beam.dat source.cal src_theta 0 1 2.5\nbeam light lamp 0 0 3 50 50 50\n"
        "lamp sphere bulb 0 0 4 0 0 4 .1\n" + GRAY + "gray ring floor 0 0 8 0 0 -1 0 0 1 0 3\n",
        {"beam.dat": BEAM},
    ),
    "Windows line ends, tabs and one line": (
        (LAMP + GRAY).replace("\n", "\r\n").replace(" ", "\t") + BALL.strip() + " # the end, without a newline",
        {},
    ),
}


@pytest.mark.parametrize("name", SCENES)
def test_an_accepted_scene_renders_the_same_bits(tmp_path: Path, name: str) -> None:
    text, files = SCENES[name]
    checked = _read(tmp_path / "user", text, files)
    (tmp_path / "work").mkdir()
    _lay(tmp_path / "work", checked.files)
    assert all(key.startswith("include1/") for key in checked.files)
    assert checked.text.endswith("\n") and checked.has_light
    ours = _rendered(tmp_path / "work", checked.text.encode())
    theirs = _rendered(tmp_path / "user", text.encode())
    assert ours == theirs
    assert len(np.unique(np.frombuffer(ours, np.float32))) > 10  # there is something to see


FUNCTION_FILE = "f(x)=1;g(a,b,c,d)=.1;h(a,b,c,d,e)=a;u=1;"
EXAMPLES: dict[str, str] = {
    "sphere": "gray sphere x 0 0 4 0 0 0 1",
    "bubble": "gray bubble x 0 0 4 0 0 0 9",
    "polygon": "gray polygon x 0 0 9 -2 -2 0 2 -2 0 0 2 0",
    "cone": "gray cone x 0 0 8 0 0 1 0 0 0 0 1",
    "cup": "gray cup x 0 0 8 0 0 1 0 0 0 1 2",
    "cylinder": "gray cylinder x 0 0 7 -1 0 0 1 0 0 .5",
    "tube": "gray tube x 0 0 7 -1 0 0 1 0 0 .5",
    "ring": "gray ring x 0 0 8 0 0 0 0 0 1 .1 1",
    "source": "void glow sky 0 0 4 1 1 1 0 sky source x 0 0 4 0 0 -1 180",
    "light": "void light m 0 0 3 1 1 1",
    "illum": "void illum m 1 gray 0 3 1 1 1",
    "glow": "void glow m 0 0 4 1 1 1 0",
    "spotlight": "void spotlight m 0 0 7 1 1 1 60 0 0 1",
    "mirror": "void mirror m 1 gray 0 3 .9 .9 .9",
    "plastic": "void plastic m 0 0 5 .5 .5 .5 0 0",
    "metal": "void metal m 0 0 5 .5 .5 .5 .9 .1",
    "trans": "void trans m 0 0 7 .5 .5 .5 0 0 .5 .5",
    "plastic2": "void plastic2 m 4 1 0 0 . 0 6 .5 .5 .5 .1 .1 .2",
    "metal2": "void metal2 m 6 Px 1 0 f.cal -rz 5 0 6 .5 .5 .5 .1 .1 .2",
    "trans2": "void trans2 m 4 1 0 0 . 0 8 .5 .5 .5 .1 .1 .2 .5 .5",
    "ashik2": "void ashik2 m 4 1 0 0 . 0 8 .5 .5 .5 .1 .1 .1 100 200",
    "dielectric": "void dielectric m 0 0 5 .9 .9 .9 1.5 0",
    "interface": "void interface m 0 0 8 .9 .9 .9 1.5 .9 .9 .9 1.3",
    "glass": "void glass m 0 0 4 .9 .9 .9 1.5",
    "antimatter": "void plastic b 0 0 5 .1 .1 .1 0 0 void antimatter m 2 gray b 0 0",
    "mist": "void mist m 1 bulb 0 3 .01 .01 .01",
    "prism1": "void prism1 m 5 .9 Dx Dy Dz . 0 0",
    "prism2": "void prism2 m 9 .5 Dx Dy Dz .4 Dx Dy Dz-.1 f.cal 0 1 3",
    "BRTDfunc": "void BRTDfunc m 10 0 0 0 .1 .1 .1 g g g f.cal 0 9 .1 .1 .1 .1 .1 .1 0 0 0",
    "plasfunc": "void plasfunc m 2 g f.cal 0 4 .5 .5 .5 .1",
    "metfunc": "void metfunc m 4 g f.cal -rx 20 0 4 .5 .5 .5 .1",
    "transfunc": "void transfunc m 2 g f.cal 0 6 .5 .5 .5 .1 .5 .5",
    "plasdata": "void plasdata m 5 h grid.dat f.cal g g 0 4 .5 .5 .5 .1",
    "metdata": "void metdata m 5 h grid.dat f.cal g g 0 4 .5 .5 .5 .1",
    "transdata": "void transdata m 5 h grid.dat f.cal g g 0 6 .5 .5 .5 .1 .5 .5",
    "texfunc": "void texfunc p 6 Px*.1 0 0 . -s 2 0 0 p plastic m 0 0 5 .5 .5 .5 0 0",
    "texdata": "void texdata p 9 f f f grid.dat grid.dat grid.dat f.cal Px Py 0 0 p plastic m 0 0 5 .5 .5 .5 0 0",
    "colorfunc": "void colorfunc p 4 u u .5 f.cal 0 0 p plastic m 0 0 5 .5 .5 .5 0 0",
    "colordata": "void colordata p 9 f f f grid.dat grid.dat grid.dat f.cal Px Py 0 0 p plastic m 0 0 5 .5 .5 .5 0 0",
    "colorpict": "void colorpict p 9 noop noop noop p.hdr . Px Py -s .5 0 0 p plastic m 0 0 5 .5 .5 .5 0 0",
    "brightfunc": "void brightfunc p 2 abs(Px) . 0 0 p plastic m 0 0 5 .5 .5 .5 0 0",
    "brightdata": "void brightdata p 5 f grid.dat f.cal Px Py 0 0 p plastic m 0 0 5 .5 .5 .5 0 0",
    "spectrum": "void spectrum p 0 0 6 400 700 1 2 1 .5 p plastic m 0 0 5 .5 .5 .5 0 0",
    "mixfunc": "void plastic b 0 0 5 .1 .1 .1 0 0 void mixfunc m 4 gray b .3 . 0 0",
    "mixdata": "void plastic b 0 0 5 .1 .1 .1 0 0 void mixdata m 7 gray b f grid.dat f.cal Px Py 0 0",
    "mixpict": "void plastic b 0 0 5 .1 .1 .1 0 0 void mixpict m 7 gray b grey p.hdr picture.cal Px Py 0 0",
    "alias": "void alias m gray",
}
BESIDE: dict[str, str | bytes] = {
    "f.cal": FUNCTION_FILE,
    "grid.dat": DATA,
    "p.hdr": PICTURE,
    "picture.cal": "grey(r,g,b)=g;",
}


def test_there_is_an_example_of_each_permitted_type() -> None:
    assert set(EXAMPLES) == set(ALLOWED)
    assert all(f" {kind} " in text for kind, text in EXAMPLES.items())


@pytest.mark.parametrize("kind", ALLOWED)
def test_oconv_xform_and_rtrace_take_each_permitted_type(tmp_path: Path, kind: str) -> None:
    text = LAMP + GRAY + EXAMPLES[kind] + "\n"
    text += "gray ring floor 0 0 8 0 0 -2 0 0 1 0 3\n"
    text += "" if " x " in text else "m ring pane 0 0 8 0 0 0 .1 0 1 0 1\n"
    checked = _read(tmp_path / "user", text, BESIDE)
    _lay(tmp_path, checked.files)
    moved = _run("xform", "-rz", "90", "-t", "1e-3", "0", "0", folder=tmp_path, stdin=checked.text.encode())
    assert (moved.returncode, _said(moved)) == (0, [])
    for stage in (checked.text.encode(), moved.stdout):
        assert any(_rendered(tmp_path, stage))


# --- files that are refused --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("!touch x\n", 1),
        (f"{GRAY}  \t!touch x\n", 2),
        (f"{GRAY}{BALL.strip()} !touch x\n", 2),
        (f"# a comment! so far\n{GRAY}", 1),
        (f"{GRAY}#!touch x\n{BALL}", 2),
        ("void brightfunc b 2\n!touch .\n0 0\n", 2),
        ("void brightfunc b 2 a!=b . 0 0\n", 1),
        ("\ufeff\n\n\n!", 4),
    ],
)
def test_a_command_is_refused_wherever_it_stands(tmp_path: Path, text: str, line: int) -> None:
    message = _refused(tmp_path, text, f'line {line}: holds a "!"')
    assert "`trust=True`" in message


@pytest.mark.parametrize(
    ("kind", "reason"),
    [
        ("instance", "octree"),
        ("mesh", "octree"),
        ("BSDF", "not checked"),
        ("aBSDF", "not checked"),
        ("WGMDfunc", "not checked"),
        ("colortext", "font"),
        ("brighttext", "font"),
        ("mixtext", "font"),
        ("specfile", "not checked"),
        ("specfunc", "not checked"),
        ("specdata", "not checked"),
        ("specpict", "not checked"),
        ("Sphere", "not a type"),
        ("teapot", "not a type"),
    ],
)
def test_a_type_that_opens_more_is_refused(tmp_path: Path, kind: str, reason: str) -> None:
    message = _refused(tmp_path, f"\nvoid {kind} i 1 room.oct 0 0\n", reason)
    assert "line 2" in message and f'"{kind}"' in message and "`trust=True`" in message


BAD_NAMES = [
    "/etc/hostname", "../f.cal", "sub/../f.cal", "..", "~/f.cal", "~root/f.cal", "sub\\f.cal", "f.oct", "F.OCT",
    "f.rtm", "sub//f.cal", "f.cal/", "/", "./.", "C:f.cal", "f%.cal", "a" * 81,
]  # fmt: skip


@pytest.mark.parametrize("name", BAD_NAMES)
@pytest.mark.parametrize("primitive", ["brightfunc b 2 a {}", "brightdata b 4 a {} . Px"])
def test_a_file_name_that_leads_elsewhere_is_refused(tmp_path: Path, name: str, primitive: str) -> None:
    present = {"f.cal": "a=1;", "sub/f.cal": "a=1;", "f.oct": "", "F.OCT": "", "f.rtm": "", "a" * 81: "a=1;"}
    _refused(tmp_path, f"void {primitive.format(name)} 0 0\n", "line 1", present)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    assert '"wood.cal"' in _refused(tmp_path, "void brightfunc b 2 a wood.cal 0 0\n", "neither in")
    _refused(tmp_path, "void brightfunc b 2 a x/source.cal 0 0\n", "neither in")  # in the library by bare name only
    _refused(tmp_path, "void brightdata b 4 a . . Px 0 0\n", "may not be a file name")
    (tmp_path / "folder.cal").mkdir()
    _refused(tmp_path, "void brightfunc b 2 a folder.cal 0 0\n", "not a regular file")


def test_a_file_beside_goes_before_the_library(tmp_path: Path) -> None:
    checked = _read(tmp_path, "void brightfunc b 2 a source.cal 0 0\n", {"source.cal": "a=1;"})
    assert dict(checked.files) == {"include1/source.cal": b"a=1;"}
    checked = _read(tmp_path, "void brightfunc b 2 a gauss.cal 0 0\n")
    assert not checked.files and " gauss.cal\n" in checked.text


def test_links_that_lead_outside_are_refused(tmp_path: Path) -> None:
    inside = tmp_path / "scene"
    _lay(
        tmp_path,
        {"secret.cal": "a=1;", "other/wood.cal": "a=1;", "scene/real/wood.cal": "a=1;", "lamp.rad": GRAY},
    )
    (inside / "link.cal").symlink_to("../secret.cal")
    (inside / "there").symlink_to("../other")
    (inside / "loop.cal").symlink_to("loop.cal")
    (inside / "fine.cal").symlink_to("real/wood.cal")
    _refused(inside, "void brightfunc b 2 a link.cal 0 0\n", "lies outside")
    _refused(inside, "void brightfunc b 2 a there/wood.cal 0 0\n", "lies outside")
    _refused(inside, "void brightfunc b 2 a loop.cal 0 0\n", "neither in")
    assert "include1/fine.cal" in _read(inside, "void brightfunc b 2 a fine.cal 0 0\n").files
    (inside / "room.rad").unlink()
    (inside / "room.rad").symlink_to("../lamp.rad")
    with pytest.raises(InputError, match="outside the scene's folder"):
        read_included(inside / "room.rad", folder=inside, library=LIBRARY, prefix="p", where=WHERE)
    with pytest.raises(InputError, match="outside the scene's folder"):
        read_included(inside / "../lamp.rad", folder=inside, library=LIBRARY, prefix="p", where=WHERE)


def test_a_linked_scene_keeps_its_own_folder(tmp_path: Path) -> None:
    _lay(tmp_path, {"parts/wood.cal": "a=1;", "parts/a.rad": "void brightfunc b 2 a wood.cal 0 0\n"})
    (tmp_path / "a.rad").symlink_to("parts/a.rad")
    (tmp_path / "scenes").symlink_to(".")
    checked = read_included(
        tmp_path / "scenes/a.rad", folder=tmp_path / "scenes", library=LIBRARY, prefix="p", where=WHERE
    )
    assert list(checked.files) == ["p/wood.cal"]


def test_pipes_devices_folders_and_nothing_are_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "dir").mkdir()
    for name, reason in (("pipe", "regular"), ("dir", "regular"), ("absent", "no such"), ("a\0b", "no such")):
        with pytest.raises(InputError, match=reason):
            read_included(tmp_path / name, folder=tmp_path, library=LIBRARY, prefix="p", where=WHERE)
    with pytest.raises(InputError, match="regular"):
        read_included(Path("/dev/zero"), folder=Path("/dev"), library=LIBRARY, prefix="p", where=WHERE)
    _refused(tmp_path, "void brightfunc b 2 a pipe 0 0\n", "not a regular file")


def test_a_huge_file_is_refused_without_reading_it_all(tmp_path: Path) -> None:
    with (tmp_path / "huge.cal").open("wb") as stream:
        stream.truncate(1 << 40)  # a sparse file: it takes no disk
    _refused(tmp_path, "void brightfunc b 2 a huge.cal 0 0\n", "larger than 64 MiB")
    (tmp_path / "huge.cal").rename(tmp_path / "room.rad")
    with pytest.raises(InputError, match="larger than 64 MiB"):
        read_included(tmp_path / "room.rad", folder=tmp_path, library=LIBRARY, prefix="p", where=WHERE)
    for index in range(5):
        with (tmp_path / f"{index}.cal").open("wb") as stream:
            stream.truncate(60 << 20)
    text = "".join(f"void brightfunc b 2 a {index}.cal 0 0\n" for index in range(5))
    _refused(tmp_path, text, "256 MiB in all")


@pytest.mark.parametrize(
    ("text", "fragment"),
    [
        (b"void plastic gray 0 0 5 .5 .5 .5 0 0\0\n", "line 1: holds a NUL"),
        (b"# \xff\xfe\nvoid", "line 1: is not UTF-8"),
        ("", "no Radiance primitive"),
        ("# only\n\n  # comments", "no Radiance primitive"),
        ("void", "ends where a type"),
        ("void plastic", "ends where an identifier"),
        ("void plastic x", "ends where the number of strings"),
        ("void plastic x 0 0 5 1 1 1 0\n", "ends where real 5 of 5"),
        ("void brightfunc x 3 a .\n", "ends where string 3 of 3"),
        ("\nvoid plastic x 0 0 4 1 1 1 0\nx sphere s 0 0 4 0 0 0 1\n", "line 2: plastic"),
        ("void plastic x 0 0 6 1 1 1 0 0\nx sphere s 0 0 4 0 0 0 1\n", 'line 2: "x" is found where real 6'),
        ("void plastic x 0 0 5 1 1 1 0 0 0\n", '"0" is found where a modifier'),
        ("void plastic x 0 1 7 5 1 1 1 0 0\n", "number of integers"),
        ("void plastic x -1 0 5 1 1 1 0 0\n", "number of strings"),
        ("void plastic x 0x0 0 5 1 1 1 0 0\n", "number of strings"),
        ("void plastic x 1e0 0 5 1 1 1 0 0\n", "number of strings"),
        ("void plastic x 1.0 0 5 1 1 1 0 0\n", "number of strings"),
        ("void plastic x \u0660 0 5 1 1 1 0 0\n", "is not allowed"),
        ("void plastic x 0 0 5 1 1 1 0 nan\n", '"nan"'),
        ("void plastic x 0 0 5 1 1 1 0 -inf\n", '"-inf"'),
        ("void plastic x 0 0 5 1 1 1 0 1e999\n", "largest number"),
        ("void plastic x 0 0 5 1 1 1 0 0x1p3\n", '"0x1p3"'),
        ("void plastic x 0 0 5 1 1 1 0 1_0\n", '"1_0"'),
        ("void plastic x 0 0 5 1 1 1 0 1,5\n", '"1,5"'),
        ("void plastic x 0 0 5 1 1 1 0 1e\n", '"1e"'),
        ("void plastic x 0 0 5 1 1 1 0 .\n", '"."'),
        ("void plastic x 0 0 5 1 1 1 0 \u0661\n", "is not allowed"),
        ("void plastic x 0 0 5 1 1 1 0 1\u00a02\n", "is not allowed"),
        ("void plastic x 0 0 5 1 1 1 0 1\x1c\n", "is not allowed"),
        ("void plastic x 0 0 5 1 1 1 0 ." + "9" * 600 + "\n", "longer than 500"),
        ("void plastic x 0 0 5 1 1 1 0 " + "9" * 400 + "\n", "largest number"),
        ("white sphere s 0 0 4 0 0 0 1\n", 'modifier "white" is not defined'),
        (f"{GRAY}{BALL}ball sphere b 0 0 4 0 0 0 1\n", 'modifier "ball" is not defined'),
        ("inherit plastic x 0 0 5 1 1 1 0 0\n", '"inherit" is not defined'),
        ("void alias a a\n", '"a" is not defined'),
        ("void alias a\n", "ends where the reference"),
        ("void mirror m 1 gold 0 3 1 1 1\n", '"gold" is not defined'),
        ("void mixfunc m 4 void gold a . 0 0\n", '"gold" is not defined'),
        ("void antimatter m 0 0 0\n", "cannot have 0 strings"),
        ("void mist m 1 a>b>/c 0 0\n", "names no light source"),
        ("void plastic x 1 a 0 5 1 1 1 0 0\n", "cannot have 1 strings"),
        ("void brightfunc x 1 a 0 0\n", "cannot have 1 strings"),
        ("void mirror m 2 void void 0 3 1 1 1\n", "cannot have 2 strings"),
        ("void plastic void 0 0 5 1 1 1 0 0\n", "may not be an identifier"),
        ("void plastic inherit 0 0 5 1 1 1 0 0\n", "may not be an identifier"),
        ("void plastic 1x 0 0 5 1 1 1 0 0\n", "may not be an identifier"),
        ("void plastic a/b 0 0 5 1 1 1 0 0\n", "may not be an identifier"),
        (f"void plastic {'x' * 129} 0 0 5 1 1 1 0 0\n", "may not be an identifier"),
        ("void plastic 'x' 0 0 5 1 1 1 0 0\n", "is not allowed"),
        ('void plastic x 0 0 5 1 1 1 0 "0"\n', "is not allowed"),
        ("void brightfunc x 2 'a b' . 0 0\n", "is not allowed"),
        ("void brightfunc x 2 a`b . 0 0\n", "is not allowed"),
        ("void brightfunc x 2 $1 . 0 0\n", "is not allowed"),
        ("void brightfunc x 2 a@b . 0 0\n", "is not allowed"),
        ("void brightfunc x 2 @file . 0 0\n", "is not allowed"),
        ("void brightfunc x 2 é . 0 0\n", "is not allowed"),
        ("void brightfunc x 2 a\x07 . 0 0\n", "is not allowed"),
        ("void brightfunc x 2 a\x7f . 0 0\n", "is not allowed"),
        (f"void brightfunc x 2 {'a' * 501} . 0 0\n", "longer than 500"),
        ("void brightfunc x 2 #a . 0 0\n", "a comment is found where string 1"),
        ("void plastic x 0 # none\n0 5 1 1 1 0 0\n", "a comment is found where"),
        ("void plastic x 0 0 5 1 1 # red\n1 0 0\n", "a comment is found where real 3"),
        ("void # what\nplastic x 0 0 5 1 1 1 0 0\n", "a comment is found where a type"),
        (f"#{'x' * 2001}\n{GRAY}", "line 1: a comment is longer"),
        (GRAY.replace("\n", "\r") + "# all in a comment\r", ""),
    ],
)  # fmt: skip
def test_what_is_not_of_the_grammar_is_refused(tmp_path: Path, text: str | bytes, fragment: str) -> None:
    if fragment:
        _refused(tmp_path, text, fragment)
    else:  # a lone carriage return is a blank, to Radiance and to us
        assert _read(tmp_path, text).text.count("plastic") == 1


@pytest.mark.parametrize(
    ("primitive", "fragment"),
    [
        ("sphere s 0 0 4 0 0 0 0", "radius"),
        ("sphere s 0 0 4 0 0 0 -1", "radius"),
        ("sphere s 0 0 4 0 0 0 1e-7", "radius"),
        ("sphere s 0 0 5 0 0 0 1 1", "4 reals"),
        ("cone c 0 0 8 0 0 0 0 0 1 0 0", "radii"),
        ("cone c 0 0 8 0 0 0 0 0 1 -1 1", "radii"),
        ("cup c 0 0 8 0 0 1 0 0 1 0 1", "ends coincide"),
        ("cone c 0 0 7 0 0 0 0 0 1 1", "8 reals"),
        ("cylinder c 0 0 7 0 0 0 0 0 0 1", "ends coincide"),
        ("tube c 0 0 7 0 0 0 0 0 1 0", "radius"),
        ("ring r 0 0 8 0 0 0 0 0 0 0 1", "direction"),
        ("ring r 0 0 8 0 0 0 0 0 1 1 1", "radii"),
        ("ring r 0 0 8 0 0 0 0 0 1 -1 1", "radii"),
        ("polygon p 0 0 6 0 0 0 1 0 0", "9 to"),
        ("polygon p 0 0 10 0 0 0 1 0 0 0 1 0 1", "steps of 3"),
        ("polygon p 0 0 9 0 0 0 1 1 1 2 2 2", "no area"),
        ("source s 0 0 4 0 0 0 5", "direction"),
        ("source s 0 0 4 0 0 1 0", "angle"),
        ("source s 0 0 4 0 0 1 361", "angle"),
        ("light l 0 0 3 1 1 -1", "radiance"),
        ("light l 0 0 3 1 1 1e39", "largest number"),
        ("light l 0 0 4 1 1 1 1", "3 reals"),
        ("glow g 0 0 3 1 1 1", "4 reals"),
        ("glow g 0 0 4 -1 1 1 0", "radiance"),
        ("illum i 0 0 3 1 1 -1", "radiance"),
        ("spotlight s 0 0 7 1 1 1 10 0 0 0", "direction"),
        ("spotlight s 0 0 7 1 1 1 0 0 0 1", "angle"),
        ("spotlight s 0 0 7 1 1 -1 10 0 0 1", "radiance"),
        ("plastic p 0 0 4 1 1 1 0", "5 reals"),
        ("metal p 0 0 6 1 1 1 0 0 0", "5 reals"),
        ("trans p 0 0 5 1 1 1 0 0", "7 reals"),
        ("glass p 0 0 2 1 1", "3 or 4 reals"),
        ("dielectric p 0 0 4 1 1 1 1.5", "5 reals"),
        ("mirror p 0 0 4 1 1 1 1", "3 reals"),
        ("mist p 0 0 4 1 1 1 1", "0 or 3 or 6 or 7 reals"),
        ("spectrum p 0 0 4 400 700 1 1", "5 to"),
        ("spectrum p 0 0 5 380 780 1 1 1", "100 nm apart"),  # answers memory that was never set
        ("spectrum p 0 0 5 500 500 1 1 1", "100 nm apart"),
        ("spectrum p 0 0 6 1e19 700 1 1 1 1", "between 100 and 10000 nm"),  # ends in a segmentation fault
    ],
)
def test_what_radiance_only_warns_about_is_refused(tmp_path: Path, primitive: str, fragment: str) -> None:
    _refused(tmp_path, f"{GRAY}gray {primitive}\n", fragment)


# --- attacks on Radiance's own readers -----------------------------------------------------------------------


def test_counts_above_16_bits_are_refused(tmp_path: Path) -> None:
    """A frozen octree keeps counts in 16 bits.

    With 65536 numbers Radiance 6.0a writes the count 0 and then the numbers,
    whose bytes rtrace reads as further primitives: a scene of numbers alone
    made it open an octree and run that octree's command.
    """
    numbers = "1 " * 65536
    _refused(tmp_path, f"void brightfunc s 2 a . 0 65536 {numbers}", "more than 32767")
    _refused(tmp_path, f"void brightfunc s 2 a . 0 32768 {numbers}", "more than 32767")
    _refused(tmp_path, f"void brightfunc s 65536 {'a ' * 65536} 0 0\n", "more than 1000")
    _refused(tmp_path, "void plastic x 999999999 0 5 1 1 1 0 0\n", "more than 1000")
    _refused(tmp_path, "void plastic x 99999999999999 0 5 1 1 1 0 0\n", "number of strings")
    assert _read(tmp_path, f"void brightfunc s 2 a . 0 32767 {numbers[: 2 * 32767]}").text.count("1.0") == 32767


def test_ten_million_numbers_are_the_most(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("radwrap.tracers.rad_grammar._MOST_REALS_IN_ALL", 12)
    assert _read(tmp_path, GRAY + GRAY)
    _refused(tmp_path, GRAY * 3, "more than 12 numbers")


@pytest.mark.parametrize(
    ("content", "fragment"),
    [
        ("2\n0 1 65536\n0 1 65536\n", "announces 4294967296 values"),  # wraps to 0 in Radiance
        ("2\n0 1 65536\n0 1 4294967298\n", "expected a size"),  # 2 to Radiance
        ("1\n0 1 9\n1 2 3\n", "announces 9 values"),
        ("0\n", "expected a size"),
        ("7\n" + "0 1 2\n" * 7, "expected a size"),
        ("1\n0 1 1\n5\n", "expected a size"),
        ("1\n0 1 -5\n5\n", "expected a size"),
        ("1\n0 x 2\n5 5\n", "expected a number"),
        ("1\n0 nan 2\n5 5\n", "expected a number"),
        ("2\n1 1.00000001 3 2 3 65536\n0 1 2\n1 1 1 1 1 1\n", "cannot distinguish"),  # equal in float32
        ("1\n0 1e-50 2\n5 5\n", "cannot distinguish"),
        ("2\n1e999 1e999 5\n0 1 2\n5 5 5 5 5\n", "cannot distinguish"),
        ("# nothing", "expected a size"),
    ],
)
def test_a_data_file_that_radiance_would_misread_is_refused(tmp_path: Path, content: str, fragment: str) -> None:
    text = "void brightdata b 5 noop x.dat . Px Py 0 0\n"
    assert "line 1" in _refused(tmp_path, text, fragment, {"x.dat": content})


def test_missing_coordinates_are_refused(tmp_path: Path) -> None:
    for primitive in ("plasdata p 4 f g.dat . f 0 4 .5 .5 .5 .1", "brightdata p 4 f g.dat . Px 0 0"):
        _refused(tmp_path, f"void {primitive}\n", "2 dimensions, but 1 coordinates", {"g.dat": DATA})
    # mie_ca.dat of the library has two dimensions
    _refused(tmp_path, "void brightdata p 4 f mie_ca.dat . Px 0 0\n", "2 dimensions")


@pytest.mark.parametrize(
    ("content", "fragment"),
    [
        (b"#?RADIANCE\n\n+Y 65536 +X 16384\n", "pixels"),  # 2^32 bytes, 0 to Radiance
        (b"#?RADIANCE\n\n-Y 99999 +X 99999\n", "pixels"),
        (b"#?RADIANCE\n\n-Y 0 +X 5\n", "pixels"),
        (b"#?RADIANCE\n\n-Y 1 -Y 5\n", "size is missing"),
        (b"#?RADIANCE\n\n-Y 1 +X 5 X99999999\n", "size is missing"),
        (b"#?RADIANCE\n\n-Y                             1 +X 5\n", "size is missing"),
        (b"#?RADIANCE\n\n-Y 4294967297 +X 1\n", "size is missing"),
        (b"#?RADIANCE\n" + b"a" * 2500 + b"\n\n-Y 1 +X 1\n", "not a Radiance picture"),
        (b"#?RADIANCE\n\0\n\n-Y 1 +X 1\n", "not a Radiance picture"),
        (b"#?RADIANCE\n\r\n-Y 65536 +X 16384\n\n-Y 1 +X 1\n", "not a Radiance picture"),
        (b"#?RADIANCE\n", "not a Radiance picture"),
        (b"BM", "not a Radiance picture"),
        (b"", "not a Radiance picture"),
    ],
)
def test_a_picture_that_radiance_would_misread_is_refused(tmp_path: Path, content: bytes, fragment: str) -> None:
    _refused(tmp_path, "void colorpict b 7 a a a p.hdr . Px Py 0 0\n", fragment, {"p.hdr": content})


def test_one_file_may_not_be_data_and_picture(tmp_path: Path) -> None:
    both = b"#?RADIANCE\n1 0 1 2 5 5\n\n-Y 1 +X 1\n" + bytes(4)
    text = "void brightdata a 4 f ./both . Px 0 0\nvoid colorpict b 7 a a a both . Px Py 0 0\n"
    _refused(tmp_path, text, "two kinds of file", {"both": both})


def test_a_side_file_that_is_an_octree_or_holds_commands_runs_nothing(tmp_path: Path) -> None:
    user, work = tmp_path / "user", tmp_path / "work"
    payload = f"!: > {tmp_path}/ran\n{GRAY}{BALL}"
    _lay(user, {"payload.rad": payload})
    work.mkdir()
    octree = _run("oconv", "payload.rad", folder=user).stdout
    (tmp_path / "ran").unlink()
    for content in (octree, payload.encode()):
        for primitive in ("brightfunc b 2 a wood", "mixfunc b 4 void void a wood"):
            checked = _read(user, f"void {primitive} 0 0\nb sphere s 0 0 4 0 0 0 1\n", {"wood": content})
            assert checked.files == {"include1/wood": content}
            _lay(work, checked.files)
            frozen = _run("oconv", "-f", "-", folder=work, stdin=checked.text.encode())
            (work / "scene.oct").write_bytes(frozen.stdout)
            _run("rtrace", *TRACE, "scene.oct", folder=work, stdin=_rays())
            assert not (tmp_path / "ran").exists()


WORDS = st.sampled_from(
    "void gray light plastic sphere polygon brightfunc mixfunc alias inherit instance antimatter mist illum "
    "glow 0 1 2 3 4 5 9 .5 -1 1e-3 nan . source.cal gauss.cal ../x.cal /etc/passwd Px*Px sin(Py) -rx !ls # \n "
    "'q' \"q\" $HOME `id` @f \\ é "
    "\x00 \x1c a_b A.B-C+D 65536 lamp m".split(" ")
)
PRIMITIVES = st.sampled_from(
    [
        "void plastic gray 0 0 5 .5 .5 .5 0 0",
        "gray sphere s 0 0 4 0 0 0 1",
        "void light lamp 0 0 3 1 2 3",
        "void brightfunc lamp 4 Px*Px . -rx 30 0 1 1e-300",
        "void brightfunc gray 2 gauss source.cal 0 0",
        "void alias gray lamp",
        "inherit alias m gray",
        "void illum m 1 gray 0 3 1 1 1",
        "gray mixfunc m 4 gray void .5 . 0 0",
        "# a comment\n",
    ]
)


@settings(max_examples=400, deadline=None)
@given(
    st.lists(st.one_of(WORDS, PRIMITIVES, PRIMITIVES, PRIMITIVES), max_size=12),
    st.sampled_from([" ", "\n", "\r\n"]),
)
def test_any_words_are_refused_or_made_harmless(parts: list[str], between: str) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        try:
            checked = _read(folder, between.join(parts))
        except InputError:
            return
        assert checked.text.isascii() and not set("!'\"`$@\0\r\t") & set(checked.text)
        assert "instance" not in checked.text and not checked.files
        again = _read(folder, checked.text)
        assert (again.text, again.has_light) == (checked.text, checked.has_light)
        assert light_in(checked.text) == checked.has_light


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=200) | st.text(max_size=200).map(str.encode))
def test_any_bytes_end_in_an_input_error_or_a_scene(content: bytes) -> None:
    with tempfile.TemporaryDirectory() as name:
        try:
            assert _read(Path(name), content).text
        except InputError as error:
            assert "\n" not in str(error)
    light_in(content.decode(errors="replace"))


@settings(max_examples=200, deadline=None)
@given(st.floats(-1e38, 1e38))
def test_a_number_keeps_all_its_digits(value: float) -> None:
    with tempfile.TemporaryDirectory() as name:
        checked = _read(Path(name), f"void brightfunc b 2 a . 0 1 {value!r}\n")
        assert float(checked.text.split()[-1]) == value


class _Octree:
    """Reads the primitives out of a frozen octree, as rtrace does."""

    def __init__(self, octree: bytes) -> None:
        self._bytes = octree
        self._at = octree.rindex(b"polygon\0cone\0sphere\0")
        self._types = []
        while kind := self._string():
            self._types.append(kind)

    def _string(self) -> str:
        end = self._bytes.index(b"\0", self._at)
        text, self._at = self._bytes[self._at : end].decode("latin-1"), end + 1
        return text

    def _integer(self, size: int) -> int:
        self._at += size
        return int.from_bytes(self._bytes[self._at - size : self._at], "big", signed=True)

    def _float(self) -> float:
        mantissa, exponent = self._integer(4), self._integer(1)
        return math.ldexp((mantissa + 0.5) / 0x7FFFFFFF, exponent) if mantissa else 0.0

    def primitives(self) -> Iterator[tuple[str, str, list[str], list[float]]]:
        while (kind := self._integer(1)) != -1:
            self._integer(4)
            name = self._string()
            strings = [self._string() for _ in range(self._integer(2))]
            yield self._types[kind], name, strings, [self._float() for _ in range(self._integer(2))]
        assert self._at == len(self._bytes)


NAMES = st.from_regex(r"[A-Za-z_][A-Za-z0-9_.+-]{0,127}", fullmatch=True).filter(lambda name: name != "inherit")
PLAIN = "".join(chr(code) for code in range(33, 127) if chr(code) not in "'\"!$`@")
STRINGS = st.text(PLAIN, min_size=1, max_size=500).filter(lambda word: word[0] != "#")
SIZES = st.floats(1e-30, 1e30) | st.floats(-1e30, -1e-30)  # an octree keeps 31 bits of numbers of this range
FUNCTIONS = st.tuples(NAMES, st.lists(STRINGS, min_size=1, max_size=9), st.lists(SIZES, max_size=9))


@settings(max_examples=100, deadline=None)
@given(st.lists(FUNCTIONS, min_size=1, max_size=6), st.integers(1, 3))
def test_radiance_finds_in_our_text_exactly_what_was_checked(
    functions: list[tuple[str, list[str], list[float]]], between: int
) -> None:
    text = ""
    for name, (first, *rest), reals in functions:
        strings = [first, ".", *rest]
        words = [
            "void",
            "brightfunc",
            name,
            str(len(strings)),
            *strings,
            "0",
            str(len(reals)),
            *map(repr, reals),
        ]
        text += (" \t\r\n"[:between]).join(words) + "\n"
    with tempfile.TemporaryDirectory() as folder:
        checked = _read(Path(folder), text + GRAY + BALL)
        octree = _run("oconv", "-f", "-", folder=Path(folder), stdin=checked.text.encode())
        passed = _run("xform", folder=Path(folder), stdin=checked.text.encode())
        again = _run("oconv", "-f", "-", folder=Path(folder), stdin=passed.stdout)
    for done in (octree, passed, again):
        assert (done.returncode, _said(done)) == (0, [])
    ours = list(primitives(checked.text, Source(WHERE, Path("room.rad"))))
    for found in (list(_Octree(octree.stdout).primitives()), list(_Octree(again.stdout).primitives())):
        assert [(p.kind, p.name, list(p.words)) for p in ours] == [primitive[:3] for primitive in found]
        for primitive, (*_, reals) in zip(ours, found, strict=True):
            assert reals == pytest.approx(list(primitive.reals), rel=1e-8, abs=0)


# --- light, and circles ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (GRAY + BALL, False),
        (LAMP, True),
        ("void light l 0 0 3 0 0 0\n", False),
        ("void light l 0 0 3 0 0 1e-9\n", True),
        ("void glow l 0 0 4 0 1 0 0\n", True),
        ("void illum l 0 0 3 1 0 0\n", True),
        ("void spotlight l 0 0 7 1 1 1 9 0 0 1\n", True),
        ("void glow l 0 0 4 0 0 0 9\n", False),
    ],
)
def test_light_is_seen(tmp_path: Path, text: str, expected: bool) -> None:
    assert _read(tmp_path, text).has_light is expected
    assert light_in(text) is expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", False),
        ("# light l 0 0 3 1 1 1 'unclosed\n", False),
        ("void plastic 'a b' 0 0 5 \"1\" 1 1 0 0\n# end", False),
        ("void colortext 'a b' 2 x.fnt 'light glow' 0 0\n", False),
        ("void specfile s 1 s.dat 0 0 s light l 0 0 3 1 1 1", True),
        ("void alias a b\nvoid light l 0 0 3 0 0 0", False),
        ("void instance i 1 room.oct 0 0\n", True),
        ("void light l 0 0 3 0 0", True),
        ("void light l 0 0 x", True),
        ("void light l 0 0 0", True),
        ("void plastic 'p 0 0 5", True),
        ("!genbox gray box 1 1 1\n", True),
        ("void", True),
    ],
)
def test_light_in_a_trusted_text_is_seen_or_supposed(text: str, expected: bool) -> None:
    assert light_in(text) is expected


def _circle(folder: Path, files: Mapping[str, str | bytes]) -> None:
    _lay(folder, files)
    check_no_cycle(folder / "a.rad", where=WHERE)


@pytest.mark.parametrize(
    "files",
    [
        {"a.rad": "!xform a.rad\n"},
        {"a.rad": f"{GRAY}{BALL.strip()} !xform -t 0 0 1 ./a.rad\n"},
        {"a.rad": "!xform -t 0 0 1 b.rad\n", "b.rad": "# b\n!genbox x y 1 1 1 | xform; cat 'a.rad'\n"},
        {"a.rad": "!cat b.rad", "b.rad": "!cat c.rad", "c.rad": "!cat b.rad"},
        {"a.rad": "!cat \\\n sub/b.rad\n", "sub/b.rad": "!cat c.rad\n", "sub/c.rad": "!cat (sub/b.rad)\n"},
    ],
)
def test_a_circle_of_inclusions_is_refused(tmp_path: Path, files: dict[str, str | bytes]) -> None:
    with pytest.raises(InputError, match="includes itself") as caught:
        _circle(tmp_path, files)
    assert caught.value.exit_code == 2 and str(caught.value).startswith(WHERE)


def test_what_only_looks_like_a_circle_passes(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    _circle(
        tmp_path,
        {
            "a.rad": "# use as !xform a.rad\n!xform b.rad\n!cat b.rad pipe nothing.rad x.bin sub\n!./gen.py\n",
            "b.rad": GRAY + "!cat c.rad",
            "c.rad": BALL + "x != a.rad\n",
            "gen.py": '#!/usr/bin/python\nif name != "a.rad":\n    pass\n',
            "x.bin": b"\0!cat a.rad\n",
            "sub/a.rad": "",
        },
    )


def test_inclusions_nest_32_deep_and_no_deeper(tmp_path: Path) -> None:
    names = ["a.rad", *(f"f{index}.rad" for index in range(1, 34))]
    chain: dict[str, str | bytes] = {above: f"!cat {below}\n" for above, below in pairwise(names[:33])}
    _circle(tmp_path, {**chain, names[32]: GRAY})
    with pytest.raises(InputError, match="nest deeper than 32"):
        _circle(tmp_path, {names[32]: f"!cat {names[33]}\n", names[33]: GRAY})
    # a shared part is looked at once: without that, this takes 2^30 visits
    wide: dict[str, str | bytes] = {above: f"!cat {below}\n!xform {below}\n" for above, below in pairwise(names[:31])}
    _circle(tmp_path, {**wide, names[30]: GRAY})


def test_a_trusted_file_that_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        check_no_cycle(tmp_path / "a.rad", where=WHERE)
