"""What somebody may have meant who wrote a name that there is not."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

_LIKE: Final = 0.6  # of letters in common; `exposure` is .76 like `exposure_time`
_LONGEST: Final = 100  # letters; comparing longer names takes long, and nobody meant one


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """A remedy that names the nearest of the known names; empty where none is near."""
    if not isinstance(name, str) or len(name) > _LONGEST:
        return ""
    from difflib import get_close_matches  # 5 ms, and only after an error

    near = get_close_matches(name, sorted(set(known)), n=1, cutoff=_LIKE)
    return f'did you mean "{near[0]}"?' if near else ""
