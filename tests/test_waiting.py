"""Futures are waited for so that an interrupt, wherever it comes, leaves nobody waiting."""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import Future, ThreadPoolExecutor

import pytest

from radwrap.waiting import Finished

# Interrupts, as Ctrl-C sends them, at random moments of a wait for many jobs: concurrent.futures.wait in its place hung
# after one of 240.
# One that Python cannot raise where it comes, as in a finaliser, is sent again, as the command does. Where something
# hangs all the same, all threads say where they stand.
_INTERRUPTED = """
import faulthandler, os, random, signal, sys, threading, time
from concurrent.futures import ThreadPoolExecutor
from radwrap.waiting import Finished
faulthandler.dump_traceback_later({patience}, exit=True)
def again(lost):
    threading.Timer(0.01, os.kill, (os.getpid(), signal.SIGINT)).start()
sys.unraisablehook = again
signal.signal(signal.SIGINT, signal.default_int_handler)
random.seed(int({seed}))
for _ in range(40):
    with ThreadPoolExecutor(2) as pool:
        finished, jobs = Finished(), []
        timer = threading.Timer(random.uniform(0.001, 0.02), os.kill, (os.getpid(), signal.SIGINT))
        try:
            jobs = [finished.watch(pool.submit(time.sleep, 0.001)) for _ in range(2000)]
            timer.start()
            while True:
                finished.within(0.0001)
        except KeyboardInterrupt:
            for job in jobs:
                job.cancel()
        timer.join()
"""
_PATIENCE = 120.0  # s


def test_those_that_ended_come_once_each_and_failures_too() -> None:
    finished: Finished[int] = Finished()
    assert finished.within(0) == []
    with ThreadPoolExecutor(2) as pool:
        jobs = [finished.watch(pool.submit(divmod_of, k)) for k in (1, 0, 2)]
        found: list[Future[int]] = []
        while len(found) < len(jobs):
            found += finished.within(10)
    assert set(found) == set(jobs) and len(found) == 3
    assert sorted(job.result() for job in found if job.exception() is None) == [0, 1]
    assert sum(isinstance(job.exception(), ZeroDivisionError) for job in found) == 1


def divmod_of(k: int) -> int:
    return 1 // k


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.long)])
def test_an_interrupt_leaves_no_lock_behind(seed: int) -> None:
    done = subprocess.run(
        [sys.executable, "-c", _INTERRUPTED.format(seed=seed, patience=_PATIENCE)], capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr.decode()
