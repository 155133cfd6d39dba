"""Safety: no light without data of the LEDs, none beyond the limits, and none that outlives its driver."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

import psutil
import pytest

from radwrap.errors import EnvironmentFailure, InputError
from radwrap.led import claim, emulated_port, guardian, ports
from radwrap.led.backend import PortFailure
from radwrap.led.claim import Claim
from radwrap.led.connect import EmulatorProcess, choose, open_backend
from radwrap.led.drive import Drive
from radwrap.led.emulated_port import EmulatedPort
from radwrap.led.ports import Found, HidPort, found, open_port, udev_rules
from radwrap.led.ring import LedRing, open_ring
from radwrap.process import Child, start_child
from tests.cli.conftest import PATIENCE, here, run, start
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


@pytest.mark.parametrize("kind", ["mcp2221a_pca9685", "lamparray"])
def test_rounding_to_steps_exceeds_no_limit(kind: Any) -> None:
    bench = FakeBench(kind)
    with LedRing(bench.open(there(bench)), replace(DRIVE, max_level=0.006, max_sum=0.03)) as ring:
        assert max(ring.set_levels((0.006, *DARK[1:])).held) <= 0.006
        held = ring.set_levels((0.006,) * 4 + (0.0059,) + DARK[5:]).held
        assert held == light(bench) and sum(held) <= 0.03
        assert max(abs(one - 0.006) for one in held[:5]) <= 1 / ring.capabilities.steps
        with pytest.raises(InputError, match=r"LED 2: level 1e-05 .* would be dark"):
            ring.set_levels((0.0, 0.0, 1e-5, *DARK[3:]))


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


def test_an_interrupt_within_a_frame_does_not_dismiss_the_guardian() -> None:
    """It may shine by then; where `off` fails, nobody else is left."""
    bench = FakeBench("mcp2221a_pca9685")
    watcher = SimpleNamespace(watch=lambda _: None, rest=lambda: None, beat=lambda: None, close=pytest.fail)
    backend = bench.open(there(bench))
    show = backend.show

    def interrupted(steps: Any) -> Any:
        show(steps)
        bench.misbehave(FIRST, "freeze")
        raise KeyboardInterrupt

    backend.show = interrupted  # type: ignore[method-assign]
    with pytest.raises(KeyboardInterrupt), LedRing(backend, DRIVE, None, watcher) as ring:  # type: ignore[arg-type]
        ring.set_levels(HALF)
    assert any(light(bench))


def test_an_interrupted_request_leaves_no_answer_to_the_next(emulator: EmulatorProcess, monkeypatch: Any) -> None:
    port = EmulatedPort(emulator.socket)
    receive = emulated_port.receive

    def interrupted(_: Any) -> Any:
        monkeypatch.setattr(emulated_port, "receive", receive)
        raise KeyboardInterrupt

    monkeypatch.setattr(emulated_port, "receive", interrupted)
    with pytest.raises(KeyboardInterrupt):
        port.history()
    assert port.told().identity["serial"] == FIRST
    port.close()


class LostGuardian(SimpleNamespace):
    """It ended after the first word."""

    words = 0

    def _say(self, *_: object) -> None:
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


# A guardian's words, and where it stops talking.
DEAF: Final = """
import sys, time
print("ready", flush=True)
for line in sys.stdin:
    if {answers} and line.startswith("watch"):
        print("watch", flush=True)
"""


@pytest.fixture
def deaf(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[bool], guardian.Guardian]]:
    """Guardians that live and listen, and do not answer heartbeats."""
    made: list[Child] = []

    def make(answers: bool) -> guardian.Guardian:
        def child(*_: object, **__: object) -> Child:
            code = DEAF.format(answers=answers)
            made.append(start_child([sys.executable, "-c", code], folder=Path("/"), environment=os.environ))
            return made[-1]

        monkeypatch.setattr(guardian, "start_module", child)
        return guardian.Guardian(Found("fake:bus/0", 0, 0, FIRST, "", 0, 0), "mcp2221a_pca9685", COUNT, 0)

    yield make
    for child in made:
        child.close(0.0)


def test_a_guardian_that_no_longer_answers_is_noticed(deaf: Any) -> None:
    bench = FakeBench("mcp2221a_pca9685")
    with ring_on(bench, guardian=deaf(True)) as ring:
        ring.set_levels(HALF)
        assert wait(lambda: light(bench) == DARK, OFF_WITHIN) >= guardian.MISSED
        with pytest.raises(EnvironmentFailure, match="guardian: does not answer"):
            ring.check()


def test_a_heartbeat_after_the_farewell_is_none(deaf: Any) -> None:
    """The thread that sends them may be about to when the ring is closed."""
    watcher = deaf(True)
    watcher.close()
    watcher.beat()


def test_there_is_no_light_before_the_guardian_says_that_it_watches(deaf: Any, monkeypatch: Any) -> None:
    monkeypatch.setattr(guardian, "_ATTENTION", 0.3)
    bench = FakeBench("mcp2221a_pca9685")
    with ring_on(bench, guardian=deaf(False)) as ring, pytest.raises(EnvironmentFailure, match="does not answer"):
        ring.set_levels(HALF)
    assert bench.history(FIRST) == bench.history(FIRST)[:1]


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


@pytest.mark.parametrize("number", [0, *(pytest.param(number, marks=pytest.mark.long) for number in (1, 2))])
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


def test_a_stopped_guardian_wakes_up_when_its_driver_is_killed(
    driver: Any, shines: Callable[[], bool], emulator: EmulatorProcess
) -> None:
    process = driver()
    wait(shines, PATIENCE)
    (watcher,) = guardians(emulator.socket)
    process.send_signal(signal.SIGSTOP)  # so that no heartbeat wakes it up before
    watcher.suspend()
    process.kill()
    wait(lambda: not shines(), OFF_WITHIN)


def test_a_guardian_knows_how_long_light_may_last(emulator: EmulatorProcess, shines: Callable[[], bool]) -> None:
    """Where the driver sends heartbeats, and does not keep the limit itself."""
    device, kind = choose(found([emulator.socket], only_emulators=True))
    ours = Claim(device.path)
    watcher = guardian.Guardian(device, kind, COUNT, ours.descriptor)
    watcher.watch(0.2)
    backend = open_backend(device, kind, COUNT)
    backend.show((2048,) * COUNT)

    def dark() -> bool:
        watcher.beat()
        return not shines()

    assert wait(dark, OFF_WITHIN) > guardian.MISSED / 2
    backend.close()
    watcher.close()
    ours.release()


def test_one_program_drives_a_ring_at_a_time_and_off_ends_it(
    driver: Any, shines: Callable[[], bool], emulator: EmulatorProcess, tmp_path: Path
) -> None:
    process = driver()
    wait(shines, PATIENCE)
    relative = os.path.relpath(emulator.socket, tmp_path)
    refused = run("led", "show", "--emulator", relative, cwd=tmp_path, environment={"TMPDIR": str(tmp_path)})
    assert "another program drives this ring" in refused.refusal(4)
    assert shines()
    done = run("led", "off", "--emulator", emulator.socket).success()
    assert f"process {process.pid} drove the ring" in done.stderr and "off" in done.stdout
    assert not shines() and process.wait(PATIENCE) == 130


def test_off_ends_even_a_program_that_was_stopped(driver: Any, emulator: EmulatorProcess, monkeypatch: Any) -> None:
    monkeypatch.setattr(claim, "_CLOSING", 0.1)
    process = driver()
    assert "verified" in process.stdout.readline()
    process.send_signal(signal.SIGSTOP)
    assert claim.end_drivers(f"emulator:{emulator.socket}") == [process.pid]
    assert process.wait(PATIENCE) == -signal.SIGKILL


def test_what_cannot_be_ended_is_turned_off_and_told(
    driver: Any, shines: Callable[[], bool], emulator: EmulatorProcess, monkeypatch: Any, capsys: Any
) -> None:
    monkeypatch.setattr(claim, "drivers", lambda _: [])  # another user's
    driver()
    wait(shines, PATIENCE)
    done = here(["led", "off", "--emulator", emulator.socket], capsys)
    assert done.code == 4 and "was turned off, but another user's program drives it" in done.stderr
    assert not shines()


@pytest.mark.long
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


def test_a_claim_falls_with_its_holder(tmp_path: Path) -> None:
    nowhere = str(tmp_path)  # claims are of the whole machine, where another suite may run
    first = Claim(nowhere)
    with pytest.raises(EnvironmentFailure):
        Claim(nowhere)
    first.release()
    Claim(nowhere).release()


@pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
def test_a_claim_is_one_for_all_users(tmp_path: Path) -> None:
    nowhere = str(tmp_path)
    first = Claim(nowhere)
    code = "import fcntl, os, sys; from radwrap.led.claim import Claim; os.setuid(65534); Claim(sys.argv[1])"
    done = subprocess.run([sys.executable, "-c", code, nowhere], capture_output=True, text=True, check=False)
    assert f"EnvironmentFailure: {nowhere}: another program drives this ring" in done.stderr
    first.release()


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
