"""Work that its caller may end, and hears of meanwhile: it runs in a thread of its own, the caller's stays awake."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Final, TypeVar

from radwrap.errors import Cancelled, RadwrapError
from radwrap.process import Programs
from radwrap.progress import Progress, Progressed
from radwrap.waiting import Finished

_T = TypeVar("_T")
# s between questions to the caller: a tenth of the time in which a render that is cancelled has to end.
_TICK: Final = 0.05


def watched(
    make: Callable[[], _T],
    programs: Programs,
    progress: Progress,
    cancelled: Callable[[], bool] | None,
    told: Callable[[Progressed], object] | None,
) -> _T:
    """Carry out work, and ask and tell its caller in the caller's thread.

    Parameters
    ----------
    make : callable
        The work; it ends by an error soon after `programs` are cancelled.
    programs : Programs
        That the work runs.
    progress : Progress
        In which it counts.
    cancelled : callable, optional
        Whether it is to end; asked before it begins, and some twenty times a second.
    told : callable, optional
        Is told how far it is, whenever that has changed; what it raises ends the work, and is raised here.

    Raises
    ------
    Cancelled
        If it was to end, and did before it was whole.
    """
    if cancelled is not None and cancelled():
        raise _ended()
    with ThreadPoolExecutor(1) as pool:
        job = pool.submit(make)
        try:
            asked_to_end = _attended(job, progress, cancelled, told)
        finally:
            if not job.done():  # the pool waits for it
                programs.cancel()
        try:
            return job.result()
        except RadwrapError as error:
            if asked_to_end:
                raise _ended() from error
            raise


def _attended(
    job: Future[_T],
    progress: Progress,
    cancelled: Callable[[], bool] | None,
    told: Callable[[Progressed], object] | None,
) -> bool:
    """Wait for work, and say whether it is to end before it has."""
    known, finished = progress.state, Finished[_T]()
    finished.watch(job)
    while not finished.within(_TICK):
        if cancelled is not None and cancelled():
            return True
        state = progress.state
        if told is not None and (state.done, state.of) != (known.done, known.of):
            known = state
            told(state)
    return False


def _ended() -> Cancelled:
    return Cancelled("was ended before the image was complete", where="render", remedy="call it again")
