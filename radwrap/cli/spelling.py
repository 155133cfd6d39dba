"""Parameters that the library's errors name, spelled as options: here only, for every verb."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final

from radwrap.errors import InputError, RadwrapError

# `tolerance`, `basis=True` or `method="rays"`.
_NAMED: Final = re.compile(r"`(\w+)(?:=([^`]*))?`")
_QUOTE: Final = '"'
_VALUED: Final = re.compile(r"(\w+)=(.*)", re.DOTALL)
# Parameters that share an option, which tells them apart by its value.
_TOGETHER: Final = {"budget_rays": "budget", "budget_seconds": "budget"}


def spell(error: RadwrapError, options: Mapping[str, str]) -> None:
    """Put options in place of the parameters that an error names; what is no option of the verb stays.

    Parameters
    ----------
    error : RadwrapError
        Is changed. Its words name parameters in backquotes; its place may be one, and begin with one and its value.
    options : mapping
        Spelling of the verb's options by the names of parameters.
    """

    def option(name: str, value: str | None) -> str | None:
        known = options.get(_TOGETHER.get(name, name))
        if known is None or value is None or value == "True":
            return known
        return f"{known} {value.strip(_QUOTE)}"

    def spelled(text: str) -> str:
        return _NAMED.sub(lambda found: option(found[1], found[2]) or found[0], text)

    error.what, error.remedy = spelled(error.what), spelled(error.remedy)
    if valued := _VALUED.fullmatch(error.where):
        error.where = option(valued[1], valued[2]) or error.where
    elif isinstance(error, InputError):  # the place of others may be a program of the same name
        error.where = option(error.where, None) or error.where
