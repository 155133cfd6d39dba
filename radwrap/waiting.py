"""Waiting for what threads and processes do, so that an interrupt leaves nothing locked."""

from __future__ import annotations

from concurrent.futures import Future
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Generic, TypeVar

_T = TypeVar("_T")


class Finished(Generic[_T]):
    """Futures as they come to their ends.

    `concurrent.futures.wait` takes the locks of all its futures one by one. An
    interrupt between two of them leaves the first ones locked for ever, and the
    threads that were to work on these wait as long.
    """

    def __init__(self) -> None:
        self._queue: SimpleQueue[Future[_T]] = SimpleQueue()

    def watch(self, future: Future[_T]) -> Future[_T]:
        """Have a future told of when it ends; gives it back."""
        future.add_done_callback(self._queue.put)
        return future

    def within(self, seconds: float) -> list[Future[_T]]:
        """Those that have ended since the last look; waits so long for the first one [s]."""
        found: list[Future[_T]] = []
        with suppress(Empty):
            found.append(self._queue.get(timeout=seconds))
            while True:
                found.append(self._queue.get_nowait())
        return found
