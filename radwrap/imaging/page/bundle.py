"""The page's modules as one script, for a page that has no server to load them from.

They are written for this: an import stands in one line and names what it takes, an export stands before what it names.
Each module becomes a function of its own, so that their names do not meet.
"""

from __future__ import annotations

import re
from importlib.resources import files
from typing import Final

_IMPORT: Final = re.compile(r'^import \{([^}]*)\} from "\./([\w.]+)";\n', re.MULTILINE)
_EXPORT: Final = re.compile(r"^export (?=(?:async )?(?:function\*?|class|const) (\w+))", re.MULTILINE)
_NOTHING: Final = "export {};\n"


def shipped(name: str) -> str:
    """Text of a file of the page."""
    return (files("radwrap") / "data" / "face" / name).read_text("utf-8")


def script_of(name: str) -> str:
    """A module, and before it all that it needs, as one script."""
    found: dict[str, str] = {}
    _collect(name, found)
    modules = "\n".join(f"modules[{known!r}] = (() => {{\n{text}}})();" for known, text in found.items())
    return f'"use strict";\n(() => {{\nconst modules = {{}};\n{modules}\n}})();\n'


def _collect(name: str, found: dict[str, str]) -> None:
    text = shipped(name).replace(_NOTHING, "")
    for match in _IMPORT.finditer(text):
        if match[2] not in found:
            _collect(match[2], found)
    names = _EXPORT.findall(text)
    text = _EXPORT.sub("", _IMPORT.sub(_taken, text))
    found[name] = f"{text}return {{ {', '.join(names)} }};\n"


def _taken(match: re.Match[str]) -> str:
    return f"const {{{match[1].replace(' as ', ': ')}}} = modules[{match[2]!r}];\n"
