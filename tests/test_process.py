"""Programs are run without a shell, watched, and never left behind."""

import os
import resource
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from radwrap import process
from radwrap.errors import EnvironmentFailure, TracerError
from radwrap.process import Limits, Programs, start_child

PYTHON = sys.executable
PATIENCE = 60.0  # s, on a busy machine
ECHO = "import sys; sys.stdout.buffer.write(sys.stdin.buffer.read())"


def run(code: str, folder: Path, **more: object) -> tuple[bytes, str]:
    with Programs() as programs:
        return programs.run([PYTHON, "-c", code], folder=folder, environment={"A": "b c"}, **more)  # type: ignore[arg-type]


def test_bytes_go_in_and_out_without_deadlock(tmp_path: Path) -> None:
    """More than any pipe holds, while the program writes as it reads."""
    block = os.urandom(1 << 20)
    code = "import sys\nwhile b := sys.stdin.buffer.read(9999): sys.stdout.buffer.write(b)"
    output, said = run(code, tmp_path, stdin=(block for _ in range(16)))
    assert output == block * 16
    assert said == ""


def test_folder_and_environment_are_the_named_ones(tmp_path: Path) -> None:
    output, said = run("import os, sys; print(os.getcwd(), dict(os.environ).get('HOME'), os.environ['A'])", tmp_path)
    assert output.decode().split("\n")[0] == f"{tmp_path.resolve()} None b c"
    assert said == ""


def test_nothing_goes_through_a_shell(tmp_path: Path) -> None:
    with Programs() as programs:
        output, _ = programs.run(
            [PYTHON, "-c", "import sys; print(sys.argv[1:])", "$(touch x)", "a b; touch y"],
            folder=tmp_path,
            environment={},
        )
    assert output.decode().strip() == "['$(touch x)', 'a b; touch y']"
    assert list(tmp_path.iterdir()) == []


def test_failures_say_what_and_with_which_code(tmp_path: Path) -> None:
    with pytest.raises(TracerError, match="exit code 3: too bad"):
        run("import sys; print('too bad', file=sys.stderr); sys.exit(3)", tmp_path)
    with Programs() as programs, pytest.raises(EnvironmentFailure, match="cannot start"):
        programs.run([str(tmp_path / "none")], folder=tmp_path, environment={})


def test_a_silent_program_is_ended_with_all_its_children(tmp_path: Path) -> None:
    code = (
        "import subprocess, sys, time;"
        "p = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(100)']);"
        "open('pid', 'w').write(str(p.pid)); time.sleep(100)"
    )
    start = time.monotonic()
    with pytest.raises(TracerError, match="did not end within 3 s"):
        run(code, tmp_path, limits=Limits(silence=3.0))  # by then its child has begun, on a busy machine too
    assert time.monotonic() - start < PATIENCE / 2
    pid = int((tmp_path / "pid").read_text())
    assert gone(pid)


def gone(pid: int) -> bool:
    """Whether a process has ended; one that only waits to be collected counts."""
    for _ in range(500):
        try:
            if psutil.Process(pid).status() == psutil.STATUS_ZOMBIE:
                return True
        except psutil.NoSuchProcess:
            return True
        time.sleep(0.02)
    return False


def test_an_error_in_the_input_ends_the_program_and_comes_back(tmp_path: Path) -> None:
    def broken() -> Iterator[bytes]:
        yield b"first"
        raise ValueError("no more")

    with pytest.raises((ValueError, TracerError)) as caught:
        run(ECHO, tmp_path, stdin=broken())
    assert "no more" in str(caught.value)


def test_cancelling_from_another_thread_ends_the_program(tmp_path: Path) -> None:
    with Programs() as programs:
        threading.Timer(0.3, programs.cancel).start()
        start = time.monotonic()
        with pytest.raises(TracerError, match="cancelled"):
            programs.run([PYTHON, "-c", "import time; time.sleep(100)"], folder=tmp_path, environment={})
        assert time.monotonic() - start < PATIENCE / 2
        with pytest.raises(TracerError, match="cancelled"):
            programs.run([PYTHON, "-c", ""], folder=tmp_path, environment={})


def test_leaving_an_unfinished_stream_ends_the_program(tmp_path: Path) -> None:
    code = "import os, sys, time; print(os.getpid(), flush=True); time.sleep(100)"
    with Programs() as programs:
        stream = programs.stream([PYTHON, "-c", code], folder=tmp_path, environment={}, stdin=(), said=[])
        pid = int(next(stream))
        stream.close()
        assert gone(pid)


def test_a_program_that_does_not_read_its_input_does_not_block(tmp_path: Path) -> None:
    output, _ = run("print('done')", tmp_path, stdin=(bytes(1 << 20) for _ in range(20)))
    assert output.strip() == b"done"


def test_a_child_that_is_killed_does_not_hear_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What it would do then, it must not: whoever kills it goes on."""
    child = start_child([PYTHON, "-c", "import sys; sys.stdin.read()"], folder=tmp_path, environment={})
    kill, heard = process._kill, []

    def kills(program: subprocess.Popen[bytes]) -> None:
        assert program.stdin is not None
        heard.append(program.stdin.closed)
        kill(program)

    monkeypatch.setattr(process, "_kill", kills)
    child.kill()
    child.kill()  # whose number may be another's by now
    assert heard == [False] and child.ended


def test_a_child_talks_in_lines_and_ends_with_its_stdin(tmp_path: Path) -> None:
    code = "import sys\nfor line in sys.stdin: print(line.strip()[::-1], flush=True)"
    child = start_child([PYTHON, "-c", code], folder=tmp_path, environment={})
    assert child.tell("abc") and child.tell("x y")
    assert [child.hear(PATIENCE), child.hear(PATIENCE)] == ["cba", "y x"]
    assert child.hear(0.01) is None
    assert not child.ended
    child.close(PATIENCE)
    assert child.ended and not child.tell("more")


def test_a_line_that_comes_in_parts_is_one(tmp_path: Path) -> None:
    """As of a Python without buffers, which writes a line and its end apart and may be interrupted between."""
    code = "import os\nos.write(1, b'half')\nif input() == 'go on': os.write(1, b' and half\\nmore')"
    child = start_child([PYTHON, "-c", code], folder=tmp_path, environment={})
    end = time.monotonic() + PATIENCE
    while not child._begun:  # it has begun, and no look is long enough for the rest
        assert child.hear(0.01) is None and time.monotonic() < end
    assert child.hear(0.05) is None and child.tell("go on")
    assert [child.hear(PATIENCE), child.hear(PATIENCE)] == ["half and half", "more"]
    child.close(PATIENCE)


def test_a_child_that_does_not_listen_is_killed(tmp_path: Path) -> None:
    child = start_child([PYTHON, "-c", "import time; time.sleep(1000)"], folder=tmp_path, environment={})
    begin = time.monotonic()
    child.close(0.1)
    assert child.ended and time.monotonic() - begin < PATIENCE
    with pytest.raises(EnvironmentFailure, match="cannot start"):
        start_child([str(tmp_path / "none")], folder=tmp_path, environment={})


def test_a_child_that_does_not_listen_blocks_nobody(tmp_path: Path) -> None:
    child = start_child([PYTHON, "-c", "import time; time.sleep(60)"], folder=tmp_path, environment={})
    begin = time.monotonic()
    assert not all(child.tell("a heartbeat") for _ in range(100_000)), "no pipe takes a megabyte"
    assert time.monotonic() - begin < PATIENCE / 2
    child.close(0.0)


def attend(code: str, folder: Path, look: Callable[[], None] = lambda: None, longest: float = PATIENCE) -> None:
    with Programs() as programs:
        programs.attend([PYTHON, "-c", code], folder=folder, environment={"A": "b c"}, look=look, longest=longest)


def test_a_program_that_is_attended_ends_when_it_ends_itself(tmp_path: Path) -> None:
    """Not when the last process ends that inherited its output; what stayed in its group is ended."""
    heir = f"import subprocess, sys; subprocess.Popen([sys.executable, '-c', 'import time; time.sleep({PATIENCE})'])"
    begin = time.monotonic()
    attend(f"{heir}; open('done', 'x'); print('x' * 1000000)", tmp_path)
    assert (tmp_path / "done").exists()
    assert time.monotonic() - begin < PATIENCE / 2
    with pytest.raises(TracerError, match="exit code 3: no film"):
        attend("import sys; sys.stderr.write('no film'); sys.exit(3)", tmp_path)
    with pytest.raises(TracerError, match=r"did not end within 0\.2 s"):
        attend(f"import time; time.sleep({PATIENCE})", tmp_path, longest=0.2)


def test_what_is_seen_meanwhile_ends_an_attended_program(tmp_path: Path) -> None:
    def look() -> None:
        if (tmp_path / "begun").exists():
            raise EnvironmentFailure("the light is gone")

    begin = time.monotonic()
    with pytest.raises(EnvironmentFailure, match="the light is gone"):
        attend(f"import time; open('begun', 'x'); time.sleep({PATIENCE})", tmp_path, look)
    assert time.monotonic() - begin < PATIENCE / 2


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells what a pipe holds")
def test_a_program_that_reads_slowly_wakes_us_seldom(tmp_path: Path) -> None:
    """16 MiB in 4 KiB at a time: a feeder that waits at a full pipe would be woken for each, 4096 times."""
    code = "import sys\nn = 0\nwhile b := sys.stdin.buffer.raw.read(4096): n += sum(b) & 1"
    block = os.urandom(1 << 20)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_nvcsw
    run(code, tmp_path, stdin=(block for _ in range(16)))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_nvcsw - before < 1000


# A daemon: a session of its own, its parent gone; which of its streams it keeps is asked for.
DAEMON = """
import os, sys, time
if os.fork() == 0:
    os.setsid()
    if os.fork() == 0:
        open("pid", "w").write(str(os.getpid()))
        for stream in {closed}: os.close(stream)
        time.sleep(100)
    os._exit(0)
while not os.path.exists("pid") or not open("pid").read(): time.sleep(0.01)
{last}
"""
PIPES = {"none": (0, 1, 2), "stdin": (1, 2), "stdout": (0, 2), "stderr": (0, 1), "all": ()}


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells of each process's environment")
@pytest.mark.parametrize("kept", PIPES)
def test_what_goes_into_the_background_ends_with_its_program(kept: str, tmp_path: Path) -> None:
    """Nobody waits for it; where it could still write, the answer is not known to be whole."""
    code = DAEMON.format(closed=PIPES[kept], last="sys.stdout.write('done'); sys.stdout.flush()")
    begin = time.monotonic()
    if kept in {"stdout", "all"}:
        with pytest.raises(TracerError, match="continued in the background with its output open"):
            run(code, tmp_path, stdin=(bytes(1 << 20) for _ in range(4)))
    else:
        assert run(code, tmp_path, stdin=(bytes(1 << 20) for _ in range(4))) == (b"done", "")
    assert time.monotonic() - begin < PATIENCE / 6
    assert gone(int((tmp_path / "pid").read_text()))


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells of each process's environment")
@pytest.mark.parametrize("last", ["time.sleep(100)", "while True: print('x', flush=True); time.sleep(.1)"])
def test_a_stalled_program_is_ended_with_what_it_sent_into_the_background(last: str, tmp_path: Path) -> None:
    """Silent, or talking for ever: whoever asks for a whole answer waits no longer than that."""
    begin = time.monotonic()
    with pytest.raises(TracerError, match="did not end within 2 s"):
        run(DAEMON.format(closed=(), last=last), tmp_path, limits=Limits(silence=2.0))  # by then its child has begun
    assert time.monotonic() - begin < PATIENCE / 6
    assert gone(int((tmp_path / "pid").read_text()))


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells of each process's environment")
def test_what_an_attended_program_sent_into_the_background_ends_with_it(tmp_path: Path) -> None:
    attend(DAEMON.format(closed=(), last=""), tmp_path)
    assert gone(int((tmp_path / "pid").read_text()))


def test_a_background_process_that_hides_is_waited_for_no_longer_than_the_others(tmp_path: Path) -> None:
    """One that wiped its environment cannot be known, but it cannot hold us either."""
    wiped = DAEMON.format(closed=(), last="").replace(
        "time.sleep(100)", "os.execve(sys.executable, [sys.executable, '-c', 'import time; time.sleep(30)'], {})"
    )
    begin = time.monotonic()
    with pytest.raises(TracerError, match="continued in the background"):
        run(wiped, tmp_path, stdin=(bytes(1 << 20) for _ in range(4)))
    assert time.monotonic() - begin < PATIENCE / 6
    psutil.Process(int((tmp_path / "pid").read_text())).kill()
