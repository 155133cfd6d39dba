"""Too little memory for the libraries themselves, as under ``ulimit -v``, told as such."""

from __future__ import annotations

import sys
from typing import Final

from radwrap.errors import EnvironmentFailure
from radwrap.process import available_cores

# With less, libraries end the process in ways of their own: OpenBLAS by a signal as if the user had interrupted, or
# by exit code 1, others by a segmentation fault. On two cores that was seen up to 430 MiB.
_LIBRARIES: Final = 512 << 20  # byte of address space
_THREAD: Final = 32 << 20  # byte for each core: stacks and buffers
# What libraries say where memory ends while they are loaded or start threads.
_SIGNS: Final = ("can't start new thread", "annot allocate memory", "failed to map segment", "not enough memory")


def check_address_space() -> None:
    """Refuse to load libraries that do not fit.

    Raises
    ------
    EnvironmentFailure
        With what there is and what is needed.
    """
    limit = _limit()
    needed = _LIBRARIES + _THREAD * available_cores()
    if limit is not None and limit < needed:
        raise EnvironmentFailure(
            f"the address space is limited to {limit >> 20} MiB, and {needed >> 20} MiB are needed to start",
            remedy="raise ulimit -v",
        )


def is_lack_of_memory(error: BaseException) -> bool:
    """Whether an error came about because memory ended: libraries give it many names."""
    if isinstance(error, MemoryError):
        return True
    told = isinstance(error, ImportError | RuntimeError | OSError) and any(sign in str(error) for sign in _SIGNS)
    # A library that is half loaded fails in ways of its own.
    return told or (isinstance(error, ImportError | SystemError) and _limit() is not None)


def _limit() -> int | None:
    if sys.platform == "win32":
        return None
    import resource

    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if soft == resource.RLIM_INFINITY else soft
