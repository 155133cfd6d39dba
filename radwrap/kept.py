"""What a caller lets us keep from one piece of work to the next, up to so much memory."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, TypeVar, cast

_T = TypeVar("_T")


class Kept:
    """Values by keys that say all they hang on; what was not used for longest goes first. Threads may share it.

    Parameters
    ----------
    limit : int
        What all values together may take [byte].
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._values: OrderedDict[Hashable, tuple[Any, int]] = OrderedDict()
        self._guard = threading.Lock()
        self._held = 0

    @property
    def held(self) -> int:
        """What all values together take [byte]."""
        return self._held

    def get(self, key: Hashable) -> Any | None:
        """A value, or None where it is not kept."""
        with self._guard:
            if key not in self._values:
                return None
            self._values.move_to_end(key)
            return self._values[key][0]

    def put(self, key: Hashable, value: Any, size: int) -> None:
        """Keep a value that takes so many bytes, unless that is too much by itself."""
        with self._guard:
            if key in self._values:
                self._held -= self._values.pop(key)[1]
            if size > self._limit:
                return
            self._values[key] = value, size
            self._held += size
            while self._held > self._limit:
                self._held -= self._values.popitem(last=False)[1][1]

    def clear(self) -> None:
        """Keep nothing any more."""
        with self._guard:
            self._values.clear()
            self._held = 0


def of_kept(kept: Kept | None, key: Callable[[], Hashable], make: Callable[[], _T], size: Callable[[_T], int]) -> _T:
    """A value as it is kept, or else as it is made, and kept from then on where anything is.

    Parameters
    ----------
    kept : Kept, optional
        None where nothing is kept.
    key : callable
        Tells all that the value hangs on; asked only where something is kept.
    make : callable
        Makes it; two threads may make the same at a time.
    size : callable
        What a value takes [byte].
    """
    if kept is None:
        return make()
    known = kept.get(name := key())
    if known is not None:
        return cast("_T", known)
    made = make()
    kept.put(name, made, size(made))
    return made
