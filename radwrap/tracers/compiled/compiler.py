"""The one door to the compiler: numba, and where it keeps what it has compiled."""

from __future__ import annotations

import hashlib
import os
import pickle
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, TypeVar

import llvmlite
import numba
from numba.core.caching import FunctionCache
from numba.core.runtime import rtsys

# Numba's settings as they are, for a moment at a time: it has no other way to say where compiled functions are kept.
_CONFIG: Any = numba.config

# What reading half a file ends with.
_BROKEN: Final = (OSError, EOFError, ValueError, LookupError, TypeError, AttributeError, pickle.UnpicklingError)

F = TypeVar("F", bound=Callable[..., object])

VERSIONS: Final = {"numba": numba.__version__, "llvmlite": llvmlite.__version__}


def _sources() -> str:
    folder = Path(__file__).parent
    return hashlib.sha256(b"".join(path.read_bytes() for path in sorted(folder.glob("*.py")))).hexdigest()[:16]


# Hash of all that is compiled here, which stands for the tracer's version.
SOURCES: Final = _sources()


def cache_folder() -> Path:
    """Folder of what is compiled from these very sources by this numba, which need not exist.

    Numba itself looks at the file of a function only, not at those of the functions that it calls: without the hash of
    all of them, a changed formula would be left out as long as the file of its caller is the same.
    """
    # The environment's own folder serves users without a home of their own that can be written.
    places = [folder / "radwrap" / f"compiled-{numba.__version__}-{SOURCES}" for folder in (_caches(), _environment())]
    return next(filter(_usable, places), places[0])


def _usable(folder: Path) -> bool:
    """Whether a folder can be written, or made."""
    there = next(place for place in (folder, *folder.parents) if place.exists())
    return there.is_dir() and os.access(there, os.W_OK | os.X_OK)


def _environment() -> Path:
    return Path(sys.prefix) / "cache"


def _caches() -> Path:
    """The user's folder for what can be made again; one that cannot be written where the user has no home."""
    named = os.environ.get("LOCALAPPDATA" if sys.platform == "win32" else "XDG_CACHE_HOME", "")
    if Path(named).is_absolute():
        return Path(named)
    try:
        home = Path.home()
    except RuntimeError:
        return Path(os.devnull)
    return home / ("AppData/Local" if sys.platform == "win32" else ".cache")


def compiled(function: F) -> F:
    """Compile a function when it is first called, or take what an earlier process has compiled.

    It runs without Python's lock, and divides as IEEE 754 says. No rule of arithmetic is loosened: products and sums
    are rounded each, so that all processors give the same bytes. It may not make arrays: numba then leaves out the
    counts of who uses an array, which take longer than the arithmetic.
    """
    return _compiled(function, counts=False)


def compiled_with_memory(function: F) -> F:
    """As `compiled`, of a function that makes arrays."""
    return _compiled(function, counts=True)


def _compiled(function: F, *, counts: bool) -> F:
    # _nrt, counts of who uses an array, is not in its annotations.
    settings: Any = {"nogil": True, "error_model": "numpy", "fastmath": False, "_nrt": counts}
    decorate: Any = numba.njit(**settings)
    made: Any = decorate(function)
    if _may_write():
        before = _CONFIG.CACHE_DIR
        _CONFIG.CACHE_DIR = str(cache_folder())
        try:
            made._cache = _Kept(function)
        finally:
            _CONFIG.CACHE_DIR = before
    compiled_function: F = made
    return compiled_function


class _Kept(FunctionCache):  # type: ignore[misc]  # numba has no types
    """What is kept of a function. A broken file or a full disk costs time, and nothing else."""

    def load_overload(self, *arguments: Any) -> Any:
        """What an earlier process has compiled; None where there is nothing, or nothing whole.

        Numba would first load all that its compiler knows of functions and types, which takes a tenth of a second at
        each start. What is already compiled needs its memory only; a function that is not gets the rest from the
        compiler, which asks for it again.
        """
        _signature, target = arguments
        rtsys.initialize(target)
        try:
            return self._load_overload(*arguments)
        except _BROKEN:
            try:
                self.flush()
            except OSError:
                self.disable()
            return None

    def save_overload(self, *arguments: Any) -> None:
        """Keep what was compiled, if there is room."""
        try:
            super().save_overload(*arguments)
        except OSError:
            self.disable()


def _may_write() -> bool:
    """Whether the folder of compiled functions can be used; else each process compiles for itself."""
    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return _usable(folder)
