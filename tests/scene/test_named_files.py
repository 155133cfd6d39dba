"""Files that a scene depends on are found, those that Radiance files name too."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from radwrap.errors import InputError
from radwrap.scene.file.named_files import named_files


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


def test_files_outside_of_the_folder_are_for_trusted_scenes(tmp_path: Path) -> None:
    folder, outside = tmp_path / "scene", tmp_path / "outside.txt"
    folder.mkdir()
    outside.write_text("")
    (folder / "link.txt").symlink_to(outside)
    (folder / "cell.rad").write_text("!xform ../outside.txt\n")
    document = {"title": str(outside), "a": "../outside.txt", "b": "link.txt", "c": "cell.rad"}
    assert [path.name for path in named_files(document, folder)] == ["cell.rad"]
    assert [path.name for path in named_files(document, folder, trust=True)] == ["outside.txt", "cell.rad"]


def test_included_files_of_any_extension_are_looked_through(tmp_path: Path) -> None:
    (tmp_path / "top.inc").write_text("!xform -n 7 'low.xyz'\n")
    (tmp_path / "low.xyz").write_text("void brightdata x\n3 noop pattern.dat u\n0\n0\n")
    (tmp_path / "pattern.dat").write_text("7")
    (tmp_path / "7").write_text("a number, and no name")
    found = named_files({"file": "top.inc"}, tmp_path)
    assert [path.name for path in found] == ["low.xyz", "pattern.dat", "top.inc"]


@pytest.mark.skipif(sys.platform == "win32", reason="no such files there")
def test_special_files_are_passed_over_or_told(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    assert named_files({"a": "pipe", "b": "/proc/self/mem", "c": "/dev/zero"}, tmp_path) == ()
    with pytest.raises(InputError, match="cannot be read"):
        named_files({"b": "/proc/self/mem"}, tmp_path, trust=True)
