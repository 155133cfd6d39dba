"""Files that a scene depends on are found, those that Radiance files name too."""

from __future__ import annotations

from pathlib import Path

from radwrap.scene.named_files import named_files


def test_files_and_what_they_name_are_found_once(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "bracket.stl").write_bytes(b"\xff\x00")
    (tmp_path / "parts" / "pattern.dat").write_text("0 0 0")
    (tmp_path / "parts" / "deep.rad").write_text("void brightdata x\n3 noop pattern.dat u\n0\n0\n")
    (tmp_path / "cell.rad").write_text("!xform parts/deep.rad\n!xform cell.rad\n")
    (tmp_path / "unused.rad").write_text("")
    document = {
        "targets": [{"part": "parts/bracket.stl"}, {"file": "cell.rad", "name": "no such file"}],
        "n": [1, None],
    }
    found = named_files(document, tmp_path)
    assert [path.relative_to(tmp_path.resolve()).as_posix() for path in found] == [
        "cell.rad",
        "parts/bracket.stl",
        "parts/deep.rad",
        "parts/pattern.dat",
    ]


def test_strings_that_can_name_no_file_are_passed_over(tmp_path: Path) -> None:
    assert named_files({"a": "", "b": "x" * 5000, "c": "nul\0", "d": ".", "e": "\ud800"}, tmp_path) == ()
