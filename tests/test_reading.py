"""Files that a user names: whatever lies there, one error with its place, at once and in little memory."""

from __future__ import annotations

import os
import sys
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import pytest

from radwrap.errors import InputError
from radwrap.reading import FileKind, csv_rows, parse_json, parse_toml, read_bytes, read_text

KIND = FileKind("scene file", 1 << 20, "write one")
DEEP = 100_000

if sys.platform == "win32":
    pytest.skip("no FIFOs and devices there", allow_module_level=True)


def _fifo(path: Path) -> Path:
    os.mkfifo(path)
    return path


def _folder(path: Path) -> Path:
    path.mkdir()
    return path


def _loop(path: Path) -> Path:
    path.symlink_to(path)
    return path


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (_fifo, "is not a regular file"),
        (_folder, "is not a regular file"),
        (lambda path: Path("/dev/zero"), "is not a regular file"),
        (lambda path: Path("/dev/stdin"), "is not a regular file|cannot be read|no such"),
        (_loop, "cannot be read"),
        (lambda path: path, "no such scene file; write one"),
        (lambda path: path.with_name("a\0b"), "cannot be read"),
        (lambda path: path.with_name("n" * 300), "cannot be read"),
    ],
)
def test_only_regular_files_are_read(make: Callable[[Path], Path], says: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=says):
        read_bytes(make(tmp_path / "x"), KIND)


def test_a_file_is_at_most_as_large_as_its_kind(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(b"a" * KIND.largest)
    assert len(read_bytes(path, KIND)) == KIND.largest
    with path.open("ab") as stream:
        stream.truncate(1 << 40)  # a hole: no disk is needed, and no memory must be
    with pytest.raises(InputError, match="larger than 1 MiB, the limit for a scene file"):
        read_bytes(path, KIND)


def test_text_is_utf8_without_nul_or_mark(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(b"\xef\xbb\xbfname\n")
    assert read_text(path, KIND) == "name\n"
    path.write_bytes(b"one\ntwo\xff")
    with pytest.raises(InputError, match=r"is not UTF-8 text \(line 2\)"):
        read_text(path, KIND)
    path.write_bytes(b"one\0")
    with pytest.raises(InputError, match="NUL"):
        read_text(path, KIND)


@pytest.mark.parametrize(
    "text",
    [
        "x = " + "[" * DEEP,
        "x = " + "[" * 200 + "]" * 200,
        "x = " + "{a = " * 200 + "1" + "}" * 200,
        f"[{'.'.join('a' * 1000)}]",
        f"[[{' . '.join('a' * 1000)}]]",
        ".".join("a" * DEEP) + " = 1",
        ".".join(['"a"'] * DEEP) + " = 1",
        ".".join(["'a'"] * DEEP) + " = 1",
        f"x = {{ {'.'.join('a' * DEEP)} = 1 }}",
        "[a.b]\n" + "".join(f"[a.b{'.c' * k}]\n" for k in range(100)),
    ],
)
def test_toml_nested_too_deep_is_refused_at_once(text: str) -> None:
    tracemalloc.start()
    start = time.process_time()
    with pytest.raises(InputError, match=r"scene\.toml: is nested more than 64 levels deep"):
        parse_toml(text, "scene.toml")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert time.process_time() - start < 5.0
    assert peak < 100 << 20


def test_toml_that_only_looks_deep_is_read() -> None:
    dots = ".".join("a" * 1000)
    text = f'''# {dots}
a = "{dots}" # '
b = \'{dots}\'
c = """
{dots} " "" \\"
"""
d = \'\'\'
{dots}
\'\'\'
[{".".join("t" * 60)}]
x = 1.5
'''
    tree = parse_toml(text, "x")
    assert tree["a"] == tree["b"] == dots
    assert tree["d"] == dots + "\n"


@pytest.mark.parametrize(
    "text",
    ["[" * DEEP, '{"a":' * DEEP, "[" * DEEP + "]" * DEEP, "[" * 100 + "]" * 100, '{"a":' * 100 + "1" + "}" * 100],
)
def test_json_nested_too_deep_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"plan\.json: is nested more than 64 levels deep"):
        parse_json(text, "plan.json")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('{"a": [1, NaN]}', r"plan\.json: a\[1\]: is not a finite number"),
        ('{"a": {"b": -Infinity}}', r"plan\.json: a\.b: is not a finite number"),
        ('{"a": 1e999}', r"plan\.json: a: is not a finite number"),
        (f'{{"a": 1{"0" * 400}}}', r"plan\.json: a: is an integer of more than 64 bits"),
        (f'{{"a": {"9" * 5000}}}', r"plan\.json: holds an integer of more than 64 bits"),
        ("{", r"plan\.json: is not JSON"),
    ],
)
def test_numbers_in_json_are_finite(text: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        parse_json(text, "plan.json")


def test_integers_in_toml_have_64_bits() -> None:
    assert parse_toml(f"a = {2**63 - 1}\nb = {-(2**63)}", "x") == {"a": 2**63 - 1, "b": -(2**63)}
    with pytest.raises(InputError, match=r"x: t\.a\[1\]: is an integer of more than 64 bits"):
        parse_toml(f"[t]\na = [1, {2**63}]", "x")
    with pytest.raises(InputError, match="x: holds an integer of more than 64 bits"):
        parse_toml(f"a = {'9' * 5000}", "x")


def test_rows_of_a_table_have_their_lines() -> None:
    text = 'a,b\r\n\r\n"x\ny",2\n3,4'
    assert list(csv_rows(text, "t.csv")) == [(1, ["a", "b"]), (4, ["x\ny", "2"]), (5, ["3", "4"])]


@pytest.mark.parametrize("cell", ["1" * 140_000, '"open', '"a"b'])
def test_what_is_not_csv_is_refused_with_its_line(cell: str) -> None:
    with pytest.raises(InputError, match=r"t\.csv: line 2: is not CSV"):
        list(csv_rows(f"a,b\n1,{cell}", "t.csv"))


def test_a_small_file_takes_little_memory_whatever_its_kind_may_hold(tmp_path: Path) -> None:
    path = tmp_path / "small"
    path.write_bytes(b"12345")
    tracemalloc.start()
    assert read_bytes(path, FileKind("file", 1 << 30)) == b"12345"
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1 << 20


def test_a_file_that_does_not_know_its_size_is_read_whole() -> None:
    path = Path("/proc/self/status")
    if not path.exists():
        pytest.skip("no /proc on this system")
    assert path.stat().st_size == 0
    assert b"VmRSS" in read_bytes(path, FileKind("file", 1 << 20))
