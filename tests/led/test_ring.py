"""Safety: no light without data of the LEDs, none beyond the limits, and none that outlives its driver."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

import psutil
import pytest

from radwrap.errors import EnvironmentFailure, InputError
from radwrap.led import ports
from radwrap.led.claim import Claim
from radwrap.led.connect import EmulatorProcess, choose
from radwrap.led.drive import Drive
from radwrap.led.emulated_port import EmulatedPort
from radwrap.led.ports import HidPort, PortFailure, found, open_port, udev_rules
from radwrap.led.ring import LedRing, open_ring
from tests.cli.conftest import PATIENCE, run, start
from tests.led.benches import FakeBench
from tests.led.conformance import COUNT, DARK, FIRST, light, there
from tests.led.fake_hid import FakeHid

DRIVE: Final = Drive(COUNT, 850e-9, 0.1, 0.05, 0.8, 6.0, 60.0)
# The guardian promises 2 s, which scripts/led_benchmark.py measures; a machine busy with tests may be slower.
OFF_WITHIN: Final = 20.0
HALF: Final = (0.5,) * COUNT
DRIVE_FILE: Final = """
count = 12
wavelength = "850 nm"
rated_current = "100 mA"
drive_current = "50 mA"
max_level = 0.8
max_sum = 6.0
max_on_time = "60 s"
"""


def ring_on(bench: FakeBench, drive: Drive | None = DRIVE, guardian: Any = None) -> LedRing:
    return LedRing(bench.open(there(bench)), drive, None, guardian)


def wait(condition: Callable[[], bool], patience: float) -> float:
    begin = time.monotonic()
    while not condition():
        assert time.monotonic() - begin < patience, "too slow"
        time.sleep(0.005)
    return time.monotonic() - begin


def test_without_a_drive_there_is_no_light() -> None:
    bench = FakeBench("mcp2221a_pca9685")
    with ring_on(bench, None) as ring:
        ring.set_levels(DARK)
        for levels in ((0.01, *DARK[1:]), (0.0,) * 3):
            with pytest.raises(InputError, match="rated current is not known"):
                ring.set_levels(levels)
    assert bench.history(FIRST) == bench.history(FIRST)[:1]


@pytest.mark.parametrize("kind", ["mcp2221a_pca9685", "lamparray"])
def test_an_exception_leaves_the_ring_dark(kind: Any) -> None:
    bench = FakeBench(kind)
    with pytest.raises(KeyboardInterrupt), ring_on(bench) as ring:
        ring.set_levels(HALF)
        assert any(light(bench))
        raise KeyboardInterrupt
    assert light(bench) == DARK
    with pytest.raises(EnvironmentFailure, match="closed"):
        ring.set_levels(DARK)


def test_refused_levels_leave_the_light_as_it_is() -> None:
    bench = FakeBench("mcp2221a_pca9685")
    with ring_on(bench) as ring:
        ring.set_levels(HALF)
        with pytest.raises(InputError, match="max_level"):
            ring.set_levels((0.9, *DARK[1:]))
        with pytest.raises(InputError, match="max_sum"):
            ring.set_levels((0.8,) * COUNT)
        assert light(bench) == HALF


def test_light_that_lasts_too_long_is_ended() -> None:
    bench = FakeBench("mcp2221a_pca9685")
    brief = Drive(COUNT, 850e-9, 0.1, 0.05, 0.8, 6.0, 0.3)
    with ring_on(bench, brief) as ring:
        ring.set_levels(HALF)
        assert wait(lambda: light(bench) == DARK, 5.0) > 0.2
        for use in (ring.check, lambda: ring.set_levels(HALF)):
            with pytest.raises(EnvironmentFailure, match="max_on_time"):
                use()


def test_a_failure_of_the_device_turns_off_what_it_can() -> None:
    bench = FakeBench("mcp2221a_pca9685")
    with ring_on(bench) as ring:
        ring.set_levels(HALF)
        bench.misbehave(FIRST, "nack")
        with pytest.raises(EnvironmentFailure, match="0x40"):
            ring.set_levels(HALF)
        assert light(bench) == DARK
        bench.misbehave(FIRST, "ack")


class LostGuardian(SimpleNamespace):
    """It ended after the first word."""

    words = 0

    def _say(self) -> None:
        self.words += 1
        if self.words > 1:
            raise EnvironmentFailure("has ended, so there must be no light", where="guardian")

    watch = rest = beat = _say

    def close(self) -> None:
        pass


def test_without_its_guardian_the_ring_goes_dark() -> None:
    bench = FakeBench("mcp2221a_pca9685")
    ring = ring_on(bench, guardian=LostGuardian())
    ring.set_levels(HALF)
    wait(lambda: light(bench) == DARK, 5.0)
    with pytest.raises(EnvironmentFailure, match="guardian"):
        ring.check()


@pytest.fixture(scope="module")
def emulator() -> Iterator[EmulatorProcess]:
    with EmulatorProcess("mcp2221a_pca9685", COUNT, FIRST) as running:
        yield running


@pytest.fixture
def shines(emulator: EmulatorProcess) -> Iterator[Callable[[], bool]]:
    port = EmulatedPort(emulator.socket)
    yield lambda: any(port.history()[-1][1])
    port.close()


@pytest.fixture
def driver(emulator: EmulatorProcess, tmp_path: Path) -> Iterator[Callable[[], subprocess.Popen[str]]]:
    """Starts the command that lights the ring; in the end none of its processes is left."""
    (tmp_path / "drive.toml").write_text(DRIVE_FILE)
    started: list[subprocess.Popen[str]] = []

    def light_it() -> subprocess.Popen[str]:
        argv = ["led", "set", 0.5, "--emulator", emulator.socket, "--drive", tmp_path / "drive.toml", "--for", "50 s"]
        started.append(start(argv))
        return started[-1]

    yield light_it
    for process in started:
        process.kill()
        process.communicate()
    wait(lambda: not guardians(emulator.socket), PATIENCE)


def guardians(socket: str) -> list[psutil.Process]:
    found = []
    for process in psutil.process_iter(["cmdline"]):
        words = process.info["cmdline"] or []
        if "radwrap.led.guardian" in words and f"emulator:{socket}" in words:
            found.append(process)
    return found


@pytest.mark.parametrize("number", range(3))
def test_sigkill_leaves_no_light(driver: Any, shines: Callable[[], bool], number: int) -> None:
    process = driver()
    wait(shines, PATIENCE)
    process.kill()
    wait(lambda: not shines(), OFF_WITHIN)


def test_a_driver_that_hangs_is_darkened_and_may_not_go_on(driver: Any, shines: Callable[[], bool]) -> None:
    process = driver()
    assert "verified" in process.stdout.readline()  # the frame is shown and read back
    process.send_signal(signal.SIGSTOP)
    wait(lambda: not shines(), OFF_WITHIN)
    process.send_signal(signal.SIGCONT)
    _, said = process.communicate(timeout=PATIENCE)
    assert process.returncode == 4 and "hung" in said
    assert not shines()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupts_leave_no_light(driver: Any, shines: Callable[[], bool], number: signal.Signals) -> None:
    process = driver()
    wait(shines, PATIENCE)
    process.send_signal(number)
    _, said = process.communicate(timeout=PATIENCE)
    assert (process.returncode, "interrupted" in said) == (130, True)
    assert not shines()


def test_a_killed_guardian_is_noticed(driver: Any, shines: Callable[[], bool], emulator: EmulatorProcess) -> None:
    process = driver()
    wait(shines, PATIENCE)
    (guardian,) = guardians(emulator.socket)
    guardian.kill()
    _, said = process.communicate(timeout=PATIENCE)
    assert process.returncode == 4 and "guardian" in said
    assert not shines()


def test_one_program_drives_a_ring_at_a_time(
    driver: Any, shines: Callable[[], bool], emulator: EmulatorProcess
) -> None:
    driver()
    wait(shines, PATIENCE)
    refused = run("led", "off", "--emulator", emulator.socket).refusal(4)
    assert "another program drives this ring" in refused
    assert shines()


def test_a_killed_command_leaves_no_process_and_no_file(tmp_path: Path) -> None:
    """Guardian and emulator of --emulate end on their own."""
    (tmp_path / "drive.toml").write_text(DRIVE_FILE)
    with start(["led", "set", 0.5, "--emulate", "--drive", tmp_path / "drive.toml", "--for", "50 s"]) as process:
        assert process.stdout is not None and process.stdout.readline()  # it shines
        family = psutil.Process(process.pid).children()
        assert len(family) == 2
        (socket,) = (Path(child.cmdline()[4]) for child in family if "radwrap.led.emulator" in child.cmdline())
        assert socket.exists()
        process.kill()
    psutil.wait_procs(family, timeout=PATIENCE)
    assert not any(child.is_running() for child in family)
    assert not socket.parent.exists()


def test_a_claim_falls_with_its_holder() -> None:
    first = Claim("nowhere")
    with pytest.raises(EnvironmentFailure):
        Claim("nowhere")
    first.release()
    Claim("nowhere").release()


def test_a_ring_that_fails_to_open_is_let_go(emulator: EmulatorProcess) -> None:
    device, kind = choose(found([emulator.socket], only_emulators=True))
    with pytest.raises(EnvironmentFailure):
        open_ring(device, kind, count=17)
    with open_ring(device, kind, count=COUNT) as ring:
        assert ring.readback() == DARK


def test_what_happens_in_hidapi_becomes_one_kind_of_error() -> None:
    bench = FakeBench("mcp2221a_pca9685")
    port = HidPort(bench.module, "bus/0")
    with pytest.raises(PortFailure, match=r"did not answer within 0\.001 s"):
        port.read(64, 1e-3)
    bench.misbehave(FIRST, "stall 1")
    with pytest.raises(PortFailure, match="writing failed: Broken pipe"):
        port.write(bytes(65))
    bench.misbehave(FIRST, "unplug")
    with pytest.raises(PortFailure, match="writing failed: No such device"):
        port.write(bytes(65))
    with pytest.raises(PortFailure, match="reading failed"):
        port.read(64, 1e-3)
    port.close()
    with pytest.raises(PortFailure, match="not open"):
        port.write(bytes(65))


def test_missing_permission_tells_the_udev_rule(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ports, "modules", lambda: iter([FakeHid()]))
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(PortFailure) as caught:
        open_port("fake:/dev/null")
    told = str(caught.value)
    assert "no permission" in told and 'KERNEL=="hidraw*"' in told and 'TAG+="uaccess"' in told
    with pytest.raises(PortFailure, match="cannot be opened"):
        open_port("fake:/dev/there is none")


def test_the_udev_rules_cover_both_ways_and_small_hexadecimal() -> None:
    rules = [line for line in udev_rules().splitlines() if line and not line.startswith("#")]
    assert [rule.split(",")[0] for rule in rules] == ['KERNEL=="hidraw*"', 'SUBSYSTEMS=="usb"']
    for rule in rules:
        assert 'ATTRS{idVendor}=="04d8", ATTRS{idProduct}=="00dd"' in rule and "uaccess" in rule
