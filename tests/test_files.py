"""Files are whole or absent; folders have one owner."""

import json
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from radwrap.cli.main import main
from radwrap.errors import EnvironmentFailure, InputError
from radwrap.files import make_folder, sha256_of, sole_owner, write_bytes
from radwrap.images import ExposureImage, GrayImage, RadianceImage, digest, png_bytes, read_image, write_exr, write_png
from radwrap.manifest import json_text, plain, read_manifest, sha256_of_value, write_manifest


def test_bytes_are_written_whole_and_leave_nothing_else(tmp_path: Path) -> None:
    write_bytes(tmp_path / "a b.txt", b"content")
    assert (tmp_path / "a b.txt").read_bytes() == b"content"
    assert [path.name for path in tmp_path.iterdir()] == ["a b.txt"]


def test_a_failed_write_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.txt"
    write_bytes(path, b"old")

    def refuse(*_: object) -> bytes:
        return b"other"

    monkeypatch.setattr(Path, "read_bytes", refuse)
    with pytest.raises(EnvironmentFailure, match="returned"):
        write_bytes(path, b"new")
    monkeypatch.undo()
    assert path.read_bytes() == b"old"
    assert len(list(tmp_path.iterdir())) == 1


def test_a_folder_has_one_owner_across_processes(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from radwrap.files import sole_owner\n"
        "with sole_owner(Path(sys.argv[1])): pass"
    )
    with sole_owner(tmp_path):
        done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, check=False)
        assert done.returncode != 0
        assert "another run is writing here" in done.stderr
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=True)


def test_a_file_in_the_way_of_a_folder_is_bad_input(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="a file is where"):
        make_folder(tmp_path / "file" / "out")


@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (1, 1000)])
def test_exr_gives_back_every_bit_and_its_metadata(tmp_path: Path, shape: tuple[int, int]) -> None:
    pixels = np.random.default_rng(1).normal(size=shape).astype(np.float32) * np.float32(1e-30)
    path = tmp_path / "a.exr"
    write_exr(path, pixels, channel="radiance", metadata={"radwrap:weight": repr(1 / 37)})
    again, metadata = read_image(path)
    assert again.dtype == np.float32
    assert np.array_equal(again, pixels)
    assert float(metadata["radwrap:weight"]) == 1 / 37
    first = sha256_of(path)
    write_exr(path, pixels, channel="radiance", metadata={"radwrap:weight": repr(1 / 37)})
    assert sha256_of(path) == first


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_png_gives_back_every_level(tmp_path: Path, kind: type) -> None:
    top = np.iinfo(kind).max
    codes = np.linspace(0, top, 300).astype(kind).reshape(15, 20)
    write_png(tmp_path / "a.png", codes)
    again, _ = read_image(tmp_path / "a.png")
    assert again.dtype == kind
    assert np.array_equal(again, codes)
    assert png_bytes(codes).startswith(b"\x89PNG")


def test_png_carries_no_colour_correction(tmp_path: Path) -> None:
    """A gray level is a number, not a colour: a gamma chunk would make readers change it."""
    write_png(tmp_path / "a.png", np.zeros((2, 2), np.uint8))
    content = (tmp_path / "a.png").read_bytes()
    assert not any(chunk in content for chunk in (b"gAMA", b"sRGB", b"iCCP", b"cHRM", b"tIME"))


def test_truncated_and_foreign_images_are_noticed(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    write_exr(path, np.ones((64, 64), np.float32), channel="Y")
    content = path.read_bytes()
    for broken in (content[: len(content) // 2], content[:10], b"", b"not an image"):
        path.write_bytes(broken)
        with pytest.raises(InputError):
            read_image(path)


def test_nan_and_infinity_never_pass(tmp_path: Path) -> None:
    for bad in (np.nan, np.inf):
        values = np.array([[bad]])
        for kind in (RadianceImage, ExposureImage, GrayImage):
            with pytest.raises(ValueError, match="NaN or infinity"):
                kind(values)
    with pytest.raises(ValueError, match="negative"):
        ExposureImage(np.array([[-1.0]]))
    with pytest.raises(ValueError):
        json_text({"a": float("nan")})
    write_exr(tmp_path / "a.exr", np.zeros((2, 2), np.float32), channel="Y")


def test_manifests_come_back_and_others_are_refused(tmp_path: Path) -> None:
    write_manifest(tmp_path / "m.json", {"schema_version": 1, "a": 0.1})
    assert read_manifest(tmp_path / "m.json")["a"] == 0.1
    for text in ("{}", "[]", "{", json.dumps({"schema_version": 99})):
        (tmp_path / "m.json").write_text(text)
        with pytest.raises(InputError):
            read_manifest(tmp_path / "m.json")


def test_hashes_depend_on_every_value() -> None:
    image = GrayImage(np.zeros((2, 2)))
    assert plain({"a": (1, 2)}) == {"a": [1, 2]}
    assert sha256_of_value({"a": 0.1}) == sha256_of_value({"a": 0.1})
    assert sha256_of_value({"a": 0.1}) != sha256_of_value({"a": np.nextafter(0.1, 1).item()})
    assert digest(image.values) != digest(image.values + 1e-300)


@pytest.mark.parametrize(
    "argv",
    [
        ["compare", "a.png", "a.png", "--out", "out", "compare.json", "diff.png", "report.png"],
        ["trade", "scene.toml", "--out", "out", "trade.csv", "trade.json", "trade.png"],
        ["validate", "--out", "out", "validate.json", "index.html"],
        ["study", "run", "design.toml", "--out", "out", "plan.json", "results.csv", "study.json", "index.html"],
    ],
    ids=lambda argv: argv[0],
)
def test_results_that_cannot_be_written_are_refused_before_the_work(
    argv: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A link of the name of each result, a file for the folder, a folder of nobody: nothing is worked, nothing made."""

    def at_work(*_: object, **__: object) -> object:
        raise AssertionError("the work began")

    monkeypatch.chdir(tmp_path)
    for work in (
        "radwrap.cli.compare.compare",
        "radwrap.cli.trade.measure_trade",
        "radwrap.cli.validate.validate",
        "radwrap.study.study.run_study",
    ):
        monkeypatch.setattr(work, at_work)
    monkeypatch.setattr("radwrap.study.design.read_design", lambda *_: None)
    (tmp_path / "scene.toml").write_bytes((files("radwrap") / "data" / "init" / "scene.toml").read_bytes())
    write_png(tmp_path / "a.png", np.arange(64, dtype=np.uint8).reshape(8, 8))
    command, names = argv[: argv.index("out") + 1], argv[argv.index("out") + 1 :]
    out = tmp_path / "out"
    out.mkdir()
    for name in names:
        (out / name).symlink_to("/dev/null")
        assert main(command) == 2
        assert f"{name}: is not a regular file" in capsys.readouterr().err
        (out / name).unlink()
    with monkeypatch.context() as nobody:
        nobody.setattr("os.access", lambda *_: False)
        assert main(command) == 4
    assert "out: cannot be written to" in capsys.readouterr().err
    out.rmdir()
    out.write_text("a file")
    assert main([*command[:-1], "out/inner"]) == 2
    assert "out: a file is where a folder is needed" in capsys.readouterr().err


def test_long_values_are_shortened_in_messages() -> None:
    long = "x" * 100_000
    for error in (
        InputError(f'"{long}" is not a length', where="camera.distance"),
        InputError("unknown key", where=f"scene.toml: {long}"),
        InputError(f"argument --only: invalid choice: '{long}'"),
    ):
        assert 60 < len(str(error)) < 200 and "x" * 50 in str(error) and "x..." in str(error)
    path = "/".join(["folder" * 9] * 20)
    assert path in str(InputError("no such file", where=path)), "which somebody must find"
