"""A machine that fails: no Radiance, a tracer that dies, hangs or lies, a full disk. Exit code 4, one line."""

from __future__ import annotations

import resource
import shutil
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pytest

from tests.cli.conftest import (
    FINAL_NAMES,
    PATIENCE,
    Done,
    children,
    files_in,
    here,
    inhabitants,
    products,
    run,
    side_by_side,
    write_scene,
)

SIZE = 24 * 20 * 12  # byte of a whole answer


# ------------------------------------------------------------------------------------------------- Radiance is missing


def test_missing_radiance_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, out, empty = write_scene(tmp_path), tmp_path / "out", tmp_path / "empty"
    empty.mkdir()
    render = ["render", scene, "--out", out]
    assert str(empty) in here([*render, "--radiance", empty], capsys).refusal(4)
    assert str(empty) in here(["convert", scene, tmp_path / "out.rad", "--radiance", empty], capsys).refusal(4)
    assert str(empty) in here([*render, "--dry-run", "--radiance", empty], capsys).refusal(4)
    assert str(scene) in here([*render, "--radiance", scene], capsys).refusal(4)
    monkeypatch.setenv("RADWRAP_RADIANCE", "/nonexistent")
    assert "/nonexistent" in here(render, capsys).refusal(4)
    doctor = here(["doctor", "--json"], capsys)
    assert doctor.code == 4 and doctor.stderr.startswith("radwrap: Radiance: ") and doctor.stderr.count("\n") == 1
    entry = next(check for check in doctor.json["checks"] if check["name"] == "Radiance")
    assert not doctor.json["ok"] and not entry["found"] and entry["needed"] and "pip install" in entry["remedy"]
    # What needs no tracer goes on.
    here(["explain", scene, "--no-rays"], capsys).success()
    here(["explain", scene], capsys).refusal(4)
    here(["convert", scene, tmp_path / "out.vf"], capsys).success()
    assert not {Path(name).name for name in files_in(out)} & set(FINAL_NAMES)


# --------------------------------------------------------------------------------------------- Radiance does not behave

RTRACE = """#!/bin/sh
PATH=/usr/bin:/bin
case "$*" in *-version*) echo "FAKE 1.0"; exit 0;; esac
"""
# As many zeros as are due: 12 bytes for the 48 of each ray.
HONEST = "exec head -c $(($(wc -c) / 4)) /dev/zero"
ANSWER = f"cat > /dev/null; head -c {SIZE} /dev/zero"
OCONV = "#!/bin/sh\nPATH=/usr/bin:/bin\ncat > /dev/null\n"
XFORM = OCONV


@dataclass(frozen=True, eq=False)
class Fake:
    """A Radiance that fails in one way, and what the message must hold; `slow` where it takes its time.

    `long` where another is much like it.
    """

    name: str
    says: tuple[str, ...]
    rtrace: str = ANSWER
    oconv: str = "echo octree"
    xform: str = "echo"
    included: bool = False
    slow: bool = False
    long: bool = False


FAKES = [
    Fake("rtrace dies", ("rtrace", "exit code 1"), "exit 1"),
    Fake("rtrace dies with words", ("rtrace", "out of cheese"), "cat > /dev/null; echo out of cheese >&2; exit 1"),
    Fake("rtrace is killed", ("rtrace", "-9"), "kill -9 $$"),
    Fake("rtrace dies after half of it", ("rtrace", "exit code 3"), "cat > /dev/null; head -c 100 /dev/zero; exit 3"),
    Fake("rtrace hangs at once", ("rtrace", "silent for 0.8 s", "--tracer-timeout"), "exec sleep 600", slow=True),
    Fake(
        "rtrace hangs with children",
        ("rtrace", "silent for 0.8 s"),
        "sleep 600 & sleep 601 & cat > /dev/null; wait",
        slow=True,
        long=True,
    ),
    Fake("rtrace hangs after its answer", ("rtrace",), f"{ANSWER}; exec sleep 600", slow=True, long=True),
    Fake(
        "rtrace hangs without output",
        ("rtrace", "within 0.8 s"),
        f"{ANSWER}; exec >&- 2>&-; exec sleep 600",
        slow=True,
        long=True,
    ),
    Fake("rtrace leaves a child behind", ("rtrace",), f"{ANSWER}; sleep 600 & exit 0", slow=True, long=True),
    Fake("rtrace goes into the background", ("rtrace",), "setsid sleep 600 & exit 0", slow=True, long=True),
    Fake(
        "rtrace answers from the background",
        ("rtrace",),
        "setsid sh -c 'sleep 600; cat' & exit 0",
        slow=True,
        long=True,
    ),
    Fake("rtrace leaves the room", ("rtrace",), f"{ANSWER}; setsid setsid sleep 600 >/dev/null & exit 3", slow=True),
    Fake("rtrace talks for ever", ("rtrace",), "while :; do echo 'no light here' >&2; done", slow=True),
    Fake("rtrace prints too little", ("rtrace", "12 bytes"), f"cat > /dev/null; head -c {SIZE - 12} /dev/zero"),
    Fake("rtrace prints a byte too little", ("rtrace", "1 byte"), f"cat > /dev/null; head -c {SIZE - 1} /dev/zero"),
    Fake("rtrace prints too much", ("rtrace", "too much"), f"{ANSWER}; head -c 12 /dev/zero"),
    Fake("rtrace prints without end", ("rtrace", "too much"), "exec cat /dev/zero", slow=True, long=True),
    Fake("rtrace prints nothing", ("rtrace", "bytes"), "cat > /dev/null"),
    Fake("rtrace reads nothing", ("rtrace", "bytes"), "exit 0"),
    Fake("rtrace prints NaN", ("rtrace", "NaN"), f"{ANSWER} | tr '\\0' '\\377'"),
    Fake("rtrace prints negative", ("rtrace", "negative"), f"{ANSWER} | tr '\\0' '\\201'"),
    Fake("rtrace warns", ("rtrace", "warning - hot"), f"{ANSWER}; echo 'rtrace: warning - hot' >&2"),
    Fake("oconv warns", ("oconv", "warning - cold"), oconv="echo octree; echo 'oconv: warning - cold' >&2"),
    Fake("oconv dies", ("oconv", "exit code 2"), oconv="exit 2"),
    Fake("oconv hangs", ("oconv", "0.8 s"), oconv="exec sleep 600", slow=True),
    Fake(
        "oconv prints now and then",
        ("oconv", "0.8 s"),
        oconv="while :; do echo .; sleep .1; done",
        slow=True,
        long=True,
    ),
    Fake("xform warns", ("xform", "wrong"), xform="echo wrong >&2", included=True),
    Fake("xform dies", ("xform", "exit code 1"), xform="exit 1", included=True),
    Fake("xform cannot start", ("xform",), xform="", included=True),
]


def _install(fake: Fake, folder: Path) -> Path:
    for program, text in {
        "rtrace": RTRACE + fake.rtrace,
        "oconv": OCONV + fake.oconv,
        "xform": XFORM + fake.xform if fake.xform else "#!/nonexistent",
    }.items():
        path = folder / "bin" / program
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text + "\n", "ascii")
        path.chmod(0o755)
    (folder / "lib").mkdir()
    (folder / "lib" / "rayinit.cal").touch()
    return folder


def _small_memory() -> None:
    """A test that goes wrong must not take the machine along."""
    resource.setrlimit(resource.RLIMIT_AS, (2 << 30, resource.getrlimit(resource.RLIMIT_AS)[1]))


def _lay(fake: Fake, folder: Path) -> list[object]:
    changes: dict[str, Any] = {"targets.1": {"type": "rad", "rad": "room.rad"}} if fake.included else {}
    scene = write_scene(folder, changes)
    (folder / "room.rad").write_text("void plastic paint 0 0 5 1 1 1 0 0\npaint sphere ball 0 0 4 0 0 0 .02\n", "ascii")
    radiance = _install(fake, folder / "fake")
    options = ["--viewpoints", 7, "--radiance", radiance, "--tracer-timeout", "0.8 s"]
    return ["render", scene, "--out", folder / "out", *options]


def _fails_cleanly(fake: Fake, done: Done, folder: Path) -> None:
    line = done.refusal(4)
    assert [word for word in fake.says if word not in line] == [], line
    assert len(line) < 1000
    assert inhabitants(folder) == []
    assert {Path(name).name for name in files_in(folder / "out")} <= {".radwrap.lock", "tracer_calls.log"}
    assert done.wall < PATIENCE / 2  # what hangs sleeps for 600 s


@pytest.mark.parametrize("fake", [pytest.param(fake, id=fake.name) for fake in FAKES if not fake.slow])
def test_a_radiance_that_fails_is_told_in_one_line(
    fake: Fake, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _fails_cleanly(fake, here(_lay(fake, tmp_path), capsys), tmp_path)
    assert children() == []


SLOW: Final = "test_a_radiance_that_hangs_or_floods_is_ended"


@pytest.fixture(scope="module")
def slow_ones(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Done, Path]]:
    """Those of this session that hang or flood, a few side by side: most of their time is waiting for 0.8 s."""
    asked = {item.name for item in request.session.items if item.path == request.path}
    slow = [fake for fake in FAKES if fake.slow and f"{SLOW}[{fake.name}]" in asked]
    folders = [tmp_path_factory.mktemp("fake") for _ in slow]
    argv = [_lay(fake, folder) for fake, folder in zip(slow, folders, strict=True)]
    found = side_by_side(lambda words: run(*words, preexec_fn=_small_memory), argv, at_once=4)
    return {fake.name: pair for fake, pair in zip(slow, zip(found, folders, strict=True), strict=True)}


@pytest.mark.parametrize(
    "fake",
    [pytest.param(fake, id=fake.name, marks=[pytest.mark.long] if fake.long else []) for fake in FAKES if fake.slow],
)
def test_a_radiance_that_hangs_or_floods_is_ended(fake: Fake, slow_ones: dict[str, tuple[Done, Path]]) -> None:
    _fails_cleanly(fake, *slow_ones[fake.name])


def test_distances_of_zero_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing is seen at the place of the camera: not a number to reckon with."""
    widths = 'n=12; case "$*" in *-ovLN*) n=28;; *-ovL*) n=16;; *-oL*) n=4;; esac'
    fake = Fake("zeros", (), f"{widths}; exec head -c $(($(wc -c) / 48 * n)) /dev/zero")
    words = [word for word in _lay(fake, tmp_path) if word not in ("--viewpoints", 7)]
    assert "distance that is not positive" in here(words, capsys).refusal(4)


def test_the_fake_itself_is_good(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each of them fails for its own reason alone."""
    here(_lay(Fake("all is well", (), HONEST), tmp_path), capsys).success()
    assert set(FINAL_NAMES) <= set(files_in(tmp_path / "out"))


def test_a_user_with_a_limit_of_memory_can_work(tmp_path: Path) -> None:
    """As `ulimit -v` sets it, on clusters and in containers: the programs get no more than the user has."""
    scene = write_scene(tmp_path)

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))

    run("render", scene, "--out", tmp_path / "out", "--viewpoints", 1, preexec_fn=limit).success()


@pytest.mark.parametrize("size", [150, 300, 450])  # MB
def test_too_little_address_space_is_told(size: int, tmp_path: Path) -> None:
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (size * 10**6, size * 10**6))

    words = ["render", write_scene(tmp_path), "--out", tmp_path / "out", "--method", "pinhole"]
    assert "address space is limited" in run(*words, preexec_fn=limit).refusal(4)
    assert run("--version", preexec_fn=limit).code == 0


@pytest.mark.long
def test_many_workers_are_no_more_than_the_work(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["render", write_scene(tmp_path), "--out", tmp_path / "out", "--workers"]
    here([*words, 1024], capsys).success()
    assert "between 1 and 1024" in here([*words, 4096], capsys).refusal(2)


# --------------------------------------------------------------------------------------------- The disk is full


def _whole_or_absent(out: Path, good: dict[str, Any]) -> None:
    """What stands under a final name is what an undisturbed run writes."""
    found = {name: content for name, content in products(out).items() if name != "manifest.json"}
    assert {name: content for name, content in found.items() if content != good[name]} == {}
    assert not [name for name in files_in(out) if ".part" in name or name.startswith(".work/")]


@pytest.fixture
def good(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    """What the command below writes where there is room."""
    write_scene(tmp_path / "home")
    here(_render(tmp_path / "home", tmp_path / "good"), capsys).success()
    return products(tmp_path / "good")


def _render(home: Path, out: Path) -> list[object]:
    return ["render", home / "scene.toml", "--out", out, "--viewpoints", 2, "--truth", "--workers", 1]


@pytest.mark.long
@pytest.mark.parametrize("sizes", [[0, 4000, 20_000], [0, 1000, 2500, 4000, 20_000]], ids=len)
def test_a_limit_of_file_size_is_told(tmp_path: Path, good: dict[str, Any], sizes: list[int]) -> None:
    def limited(size: int) -> Done:
        def limit() -> None:
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

        return run(*_render(tmp_path / "home", tmp_path / str(size)), preexec_fn=limit)

    failed = []
    for size, done in zip(sizes, side_by_side(limited, sizes), strict=True):
        out = tmp_path / str(size)
        if done.code == 0:
            assert products(out) == good
            continue
        failed.append(done.refusal(4))
        assert not (out / "manifest.json").exists()
        _whole_or_absent(out, good)
    assert len(failed) > len(sizes) // 2
    assert [line for line in failed if str(tmp_path) not in line] == []
    assert inhabitants(tmp_path) == []


def _mounted(place: Path) -> bool:
    """Whether a small disk could be mounted; only root may, and not everywhere."""
    place.mkdir()
    words = ["mount", "-t", "tmpfs", "-o", "size=4k,nr_inodes=200", "tmpfs", str(place)]
    mount = shutil.which("mount")
    return mount is not None and subprocess.run([mount, *words[1:]], capture_output=True, check=False).returncode == 0


@contextmanager
def _small_disk(place: Path) -> Iterator[bool]:
    there = _mounted(place)
    try:
        yield there
    finally:
        if there:
            subprocess.run([str(shutil.which("umount")), "-l", str(place)], check=True)


_TRIES: Final = 12  # at most, of which exposure is told in one of two or more


@pytest.mark.long
def test_a_full_disk_is_told_whatever_it_is_that_no_longer_fits(
    tmp_path: Path, good: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    disk, out = tmp_path / "disk", tmp_path / "disk" / "out"
    failed: list[str] = []

    def fits() -> bool:
        shutil.rmtree(out, ignore_errors=True)
        done = here(_render(tmp_path / "home", out), capsys)
        if done.code == 0:
            assert products(out) == good
            return True
        failed.append(done.refusal(4))
        assert not (out / "manifest.json").exists()
        _whole_or_absent(out, good)
        return False

    with _small_disk(disk) as there:
        # Where no disk can be mounted the limits above must do.
        for pages in range(1, 40) if there else []:
            subprocess.run([str(shutil.which("mount")), "-o", f"remount,size={4 * pages}k", str(disk)], check=True)
            if fits():
                break
            # Gray levels and exposure are written side by side: which of them no longer fits is chance.
            for _ in range(_TRIES if "gray.png" in failed[-1] else 0):
                if any("radiant_exposure" in line for line in failed):
                    break
                fits()
        else:
            assert not there, "there never was enough room"
    names = ("viewpoint_00000", "viewpoint_00001", "radiant_exposure", "gray", "depth", "mask", "truth", "manifest")
    assert [name for name in names if there and not any(name in line for line in failed)] == []
    assert [line for line in failed if str(disk) not in line] == []
    assert inhabitants(tmp_path) == []


def test_a_disk_that_fills_leaves_the_older_basis_whole(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Whatever a new run cannot write, what an older one left stays until all of it is there."""
    disk, out = tmp_path / "disk", tmp_path / "disk" / "out"
    words = ["render", write_scene(tmp_path / "home"), "--out", out, "--basis", "--workers", 1, "--tolerance"]
    with _small_disk(disk) as there:
        if not there:
            pytest.skip("no small disk can be mounted here")
        _resize(disk, 1000)
        here([*words, 8], capsys).success()
        old = files_in(out)
        used = sum(-(-path.stat().st_size // 4096) for path in disk.rglob("*") if path.is_file())
        messages = set()
        for pages in range(used + 2, 1000, 3):
            _resize(disk, pages)
            done = here([*words, 7], capsys)
            if done.code == 0:
                break
            messages.add(done.refusal(4))
            kept = files_in(out)
            assert {name: kept.get(name) for name in old} == old
        assert any("/basis/" in line for line in messages)
        assert files_in(out)["basis.json"] != old["basis.json"]


def _resize(disk: Path, pages: int) -> None:
    subprocess.run([str(shutil.which("mount")), "-o", f"remount,size={4 * pages}k", str(disk)], check=True)
