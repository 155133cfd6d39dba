"""The LED ring behind the page: one tab holds it, and it is dark whenever that tab, or the server, is not there."""

from __future__ import annotations

import io
import json
import os
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import psutil
import pytest

import radwrap
from radwrap.cli import face as command
from radwrap.errors import InputError
from radwrap.face.ring import MISSED, HeldRing
from radwrap.led.connect import EmulatorProcess
from radwrap.led.emulated_port import EmulatedPort
from tests.cli.conftest import here, write_scene
from tests.face.conftest import Served, gone, serving
from tests.face.test_turns import RING

COUNT: Final = 4
DARK_WITHIN: Final = 2.0  # s of a kill, or of the last heartbeat
DRIVE: Final = """
count = 4
wavelength = "850 nm"
rated_current = "100 mA"
drive_current = "50 mA"
max_level = 0.8
max_sum = 2.5
max_on_time = "{longest}"
"""
FULL: Final = 2.0  # radiant intensity at level 1, over that of the scene's LEDs
SCENE: Final[dict[str, Any]] = {"sources": [{**RING, "count": COUNT}]}


@pytest.fixture(scope="module")
def emulator() -> Iterator[EmulatorProcess]:
    with EmulatorProcess("mcp2221a_pca9685", COUNT) as running:
        yield running


@pytest.fixture
def light(emulator: EmulatorProcess) -> Iterator[Callable[[], list[float]]]:
    """What shines now."""
    port = EmulatedPort(emulator.socket)
    yield lambda: port.history()[-1][1]
    port.close()


def ring_options(folder: Path, emulator: EmulatorProcess, longest: str = "60 s") -> list[object]:
    (folder / "drive.toml").write_text(DRIVE.format(longest=longest))
    scene = radwrap.load_scene(write_scene(folder, SCENE))
    full = FULL * scene.emitters[0].radiant_intensity
    return ["--led", folder / "drive.toml", "--full-scale", f"{full!r} W/sr", "--emulator", emulator.socket]


@pytest.fixture
def lit(tmp_path: Path, emulator: EmulatorProcess) -> Iterator[Served]:
    with serving(tmp_path, SCENE, *ring_options(tmp_path, emulator)) as served:
        yield served
    assert not guardians(emulator), "a guardian is left"


def guardians(emulator: EmulatorProcess) -> list[psutil.Process]:
    found = []
    for process in psutil.process_iter(["cmdline"]):
        words = process.info["cmdline"] or []
        if "radwrap.led.guardian" in words and f"emulator:{emulator.socket}" in words:
            found.append(process)
    return found


def ask(served: Served, do: str, tab: str = "one", **told: Any) -> Any:
    return served.post("/api/ring", {"do": do, "tab": tab, **told})


def wait(until: Callable[[], bool], within: float) -> float:
    begin = time.monotonic()
    while not until():
        assert time.monotonic() - begin < within, "not within its time"
        time.sleep(0.02)
    return time.monotonic() - begin


def test_the_ring_shines_as_the_knobs_stand_and_only_for_who_holds_it(lit: Served, light: Any) -> None:
    described = lit.ready()
    basis, names = described["basis"], [one["name"] for one in described["sources"]]
    assert described["ring"]["count"] == COUNT and described["ring"]["emulated"]
    assert not any(light())
    factors = [1.0, 0.5, 0.0, 1.2]
    answer = ask(lit, "light", basis=basis, turn={"levels": factors})
    assert answer.status == 200, answer.body
    wanted = [factor / FULL for factor in factors]
    assert answer.json["verified"] and answer.json["held"] == pytest.approx(wanted, abs=0.5 / 4096)
    assert light() == pytest.approx(wanted, abs=0.5 / 4096) and len(names) == COUNT
    # Another tab does not get it, and cannot turn it off; what is beyond the drive's limits leaves the light as it is.
    other = ask(lit, "light", "two", basis=basis, turn={"levels": factors})
    assert other.status == 422 and "another tab holds" in other.json["error"]
    assert ask(lit, "beat", "two").json["held"] is False
    ask(lit, "dark", "two")
    for levels, says in (([1.7, 0, 0, 0], "max_level"), ([1.5] * 4, "sum"), ([9.0, 0, 0, 0], "")):
        refused = ask(lit, "light", basis=basis, turn={"levels": levels})
        assert refused.status == 422 and says in refused.json["text"], refused.body
    for forged in ({"do": "on"}, {"do": "light"}, {"do": "light", "basis": basis, "tab": 7}, {}):
        assert lit.post("/api/ring", forged).status == 422
    assert light() == pytest.approx(wanted, abs=0.5 / 4096)
    assert ask(lit, "beat").json == {"held": True, "why": ""}
    assert ask(lit, "dark").status == 200 and not any(light())
    # With an exposure that the PWM makes uneven it is refused.
    uneven = ask(lit, "light", basis=basis, turn={"levels": factors, "knobs": {"exposure_time": "1 ms"}})
    assert uneven.status == 422 and "PWM" in uneven.json["error"] and not any(light())
    # As long as its heart beats it shines, and no longer.
    assert ask(lit, "light", "two", basis=basis, turn={"levels": factors}).status == 200
    for _ in range(5):
        time.sleep(0.5)
        assert ask(lit, "beat", "two").json["held"] and any(light())
    assert wait(lambda: not any(light()), DARK_WITHIN) > MISSED - 0.6
    assert "was not heard" in ask(lit, "beat", "two").json["why"]
    killed_while_it_shines(lit, light, signal.SIGKILL)


@pytest.mark.long
@pytest.mark.parametrize("how", [signal.SIGSTOP, signal.SIGTERM])
def test_without_its_server_the_ring_is_dark(lit: Served, light: Any, how: int) -> None:
    killed_while_it_shines(lit, light, how)


def killed_while_it_shines(lit: Served, light: Any, how: int) -> None:
    basis = lit.ready()["basis"]
    ask(lit, "light", basis=basis, turn={"levels": [1.0] * COUNT})
    assert any(light())
    family = lit.family()
    os.kill(lit.process.pid, how)
    wait(lambda: not any(light()), DARK_WITHIN)
    if how == signal.SIGSTOP:
        os.kill(lit.process.pid, signal.SIGCONT)
        time.sleep(0.3)
        assert not any(light())
    lit.process.kill()
    lit.process.wait()
    assert gone(family, 5.0)


@pytest.mark.long
def test_light_ends_by_itself_and_may_begin_again(tmp_path: Path, emulator: EmulatorProcess, light: Any) -> None:
    with serving(tmp_path, SCENE, *ring_options(tmp_path, emulator, "1 s")) as served:
        basis = served.ready()["basis"]
        for _ in range(2):
            assert ask(served, "light", basis=basis, turn={"levels": [1.0] * COUNT}).status == 200
            assert any(light())
            end = time.monotonic() + 3.0
            while ask(served, "beat").json["held"]:
                assert time.monotonic() < end
                time.sleep(0.2)
            assert not any(light()) and "max_on_time" in ask(served, "beat").json["why"]


def test_without_the_option_there_is_no_such_route(served: Served) -> None:
    assert ask(served, "beat").status == 404 and "ring" not in served.ready()


def refusal(tmp_path: Path, capsys: Any, *more: object) -> str:
    return here(["face", write_scene(tmp_path, SCENE), "--no-browser", *more], capsys).refusal(2)


def test_what_is_wrong_with_the_ring_is_told_before_anything_is_served(
    tmp_path: Path, emulator: EmulatorProcess, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ring_options(tmp_path, emulator)
    assert "needs to know how bright a level is" in refusal(tmp_path, capsys, *options[:2])
    assert "give --led DRIVE.toml too" in refusal(tmp_path, capsys, "--emulate")
    assert "needs the server" in refusal(tmp_path, capsys, *options, "--export", tmp_path / "page.html")
    (tmp_path / "drive.toml").write_text(DRIVE.format(longest="1 s").replace("count = 4", "count = 5"))
    assert "has 5 LEDs" in refusal(tmp_path, capsys, *options)


@pytest.mark.parametrize(("typed", "allowed"), [("yes\n", True), ("y\n", False)])
def test_a_real_ring_is_confirmed_in_the_terminal(
    tmp_path: Path,
    emulator: EmulatorProcess,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Any,
    typed: str,
    *,
    allowed: bool,
) -> None:
    """Here the emulator stands for it."""

    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    from radwrap.cli.main import whole_parser

    argv = ["face", str(write_scene(tmp_path, SCENE)), *map(str, ring_options(tmp_path, emulator))]
    arguments = whole_parser().parse_args(argv)
    scene = radwrap.load_scene(argv[1])
    real = command.ring_of
    given = {**vars(arguments)}
    monkeypatch.setattr(command, "ring_of", lambda _, scene: real(_arguments(given), scene))
    arguments.emulator = []
    monkeypatch.setattr("sys.stdin", Terminal(typed))
    if allowed:
        command._confirm(arguments, scene)
    else:
        with pytest.raises(InputError, match="was not confirmed"):
            command._confirm(arguments, scene)
    assert "4 LEDs of 850 nm" in capsys.readouterr().err
    monkeypatch.setattr("sys.stdin", io.StringIO("yes\n"))
    with pytest.raises(InputError, match="must be confirmed in a terminal"):
        command._confirm(arguments, scene)


def _arguments(given: Mapping[str, Any]) -> Any:
    import argparse

    return argparse.Namespace(**given)


def test_a_failed_ring_does_not_keep_its_holder(tmp_path: Path, emulator: EmulatorProcess, light: Any) -> None:
    """The device answers no more: it is said, and it is nobody's."""
    from radwrap.cli.led_device import ring_of

    options = ring_options(tmp_path, emulator)
    given = {"drive": str(options[1]), "full_scale": options[3], "emulator": [emulator.socket]}
    told = {**given, "calibration": None, "emulate": None, "which": None, "count": None}
    scene = radwrap.load_scene(tmp_path / "scene.toml")
    with HeldRing(lambda: ring_of(_arguments(told), scene)) as ring:
        factors = {led.source: 1.0 for led in scene.emitters}
        ring.light("one", scene, factors, 0.387)
        assert any(light())
        assert json.dumps(ring.described())
    assert not any(light())
    with pytest.raises(InputError, match="is closed"):
        ring.light("one", scene, factors, 0.387)
