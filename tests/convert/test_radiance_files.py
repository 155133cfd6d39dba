"""Converted scenes: what lies beside them, and that none touches another's files."""

import subprocess
import tomllib
from pathlib import Path

import numpy as np
import pytest

import radwrap
from radwrap.convert.radiance_files import side_stem, write_scene
from radwrap.errors import InputError
from radwrap.tracers.installation import find_radiance
from radwrap.tracers.radiance import RadianceOptions

ROOT = Path(__file__).parents[2]
BENCH = ROOT / "rad_scenes" / "bench_board" / "scene.toml"

# A dot of the board from the ring's middle, in the text's mm.
RAY = np.array([0.0, 0.0, 790.0, 0.0, 0.0, -1.0])
# Two converted scenes of one text but for their names: the tracer's float32.
FLOAT32 = 1e-6


def scene(folder: Path, coefficient: float, wall: str) -> radwrap.Scene:
    """A board of sheeting by a table, and an included file with a function of its own."""
    document = tomllib.loads(BENCH.read_text())
    document["materials"]["sheeting"] = {
        "type": "retroreflective",
        "model": "coefficient",
        "observation_angles": ["0.1 deg", "2 deg"],
        "entrance_angles": ["0 deg", "60 deg"],
        "coefficients": [[f"{coefficient} 1/sr"] * 2] * 2,
    }
    document["targets"].append({"rad": "room.rad"})
    folder.mkdir()
    (folder / "room.rad").write_text(
        "void brightfunc shade 2 level wall.cal 0 0\nshade plastic p 0 0 5 1 1 1 0 0\np sphere ball 0 0 4 0 0 -2 .001\n"
    )
    (folder / "wall.cal").write_text(f"level = {wall};\n")
    return radwrap.scene_from_document(document, folder=folder)


def write(one: radwrap.Scene, path: Path) -> dict[str, bytes]:
    written = write_scene(one, path, RadianceOptions(find_radiance()))
    return {str(file.relative_to(path.parent)): file.read_bytes() for file in written}


def radiance_of(path: Path) -> float:
    """What plain Radiance tools see of a converted scene, run in its folder."""
    found = find_radiance()

    def run(*argv: str, stdin: bytes = b"") -> bytes:
        words = [found.program(argv[0]), *argv[1:]]
        environment = {"PATH": str(found.programs), "RAYPATH": f".:{found.library}"}
        done = subprocess.run(words, cwd=path.parent, env=environment, input=stdin, capture_output=True, check=True)
        assert done.stderr == b"", done.stderr
        return done.stdout

    (path.parent / "test.oct").write_bytes(run("oconv", path.name))
    options = "-h -fdf -ab 0 -dt 0 -dc 1 -dj 0 -ds 0 -st 1".split()
    return float(np.frombuffer(run("rtrace", *options, "test.oct", stdin=RAY.tobytes()), np.float32)[0])


def test_two_scenes_live_in_one_folder(tmp_path: Path) -> None:
    first, second = scene(tmp_path / "a", 100, "1"), scene(tmp_path / "b", 300, "0.5")
    out = tmp_path / "out"
    files = write(first, out / "first.rad")
    before = radiance_of(out / "first.rad")
    others = write(second, out / "second.rad")
    assert len(files) == len(others) == 4 and not files.keys() & others.keys()
    assert all((out / name).read_bytes() == content for name, content in files.items())
    assert radiance_of(out / "first.rad") == before > 0
    assert radiance_of(out / "second.rad") == pytest.approx(3 * before, rel=FLOAT32)
    # Again, and changed: a scene writes over its own files.
    assert write(first, out / "first.rad") == files
    changed = radwrap.with_value(first, "materials.sheeting.coefficients", [["50 1/sr"] * 2] * 2)
    assert write(changed, out / "first.rad").keys() == files.keys()
    assert radiance_of(out / "first.rad") == pytest.approx(before / 2, rel=FLOAT32)


@pytest.mark.parametrize("name", ["a b.rad", "größe.rad", "-x.rad", "x" * 60 + ".rad", "a.b.rad", "a;b.rad", "..rad"])
def test_any_name_becomes_one_that_radiance_reads(name: str, tmp_path: Path) -> None:
    one = scene(tmp_path / "a", 100, "1")
    write(one, tmp_path / "out" / "plain.rad")
    write(one, tmp_path / "out" / name)
    (tmp_path / "out" / name).rename(tmp_path / "out" / "renamed.rad")
    assert radiance_of(tmp_path / "out" / "renamed.rad") == radiance_of(tmp_path / "out" / "plain.rad") > 0


def test_stems_differ_where_names_do() -> None:
    names = ["a", "a b", "a_b", "a;b", "a.b", "a\u0308", "\u00e4", "x" * 31, "x" * 32, "x" * 30]
    stems = {side_stem(Path(f"{name}.rad")) for name in names}
    assert len(stems) == len(names)
    assert all(len(stem) <= 30 for stem in stems)
    assert side_stem(Path("scene.rad")) == "scene"  # so the golden scene.rad files are what convert writes


def test_an_included_file_is_not_written_over(tmp_path: Path) -> None:
    one = scene(tmp_path / "a", 100, "1")
    before = (tmp_path / "a" / "room.rad").read_bytes()
    with pytest.raises(InputError, match=r"room\.rad: is a file that the scene includes"):
        write(one, tmp_path / "a" / ".." / "a" / "room.rad")
    assert (tmp_path / "a" / "room.rad").read_bytes() == before
