"""``radwrap completion``: what a shell needs to complete verbs, options and files."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from typing import Any, Final

_DESCRIPTION = (
    "Prints a script by which a shell completes verbs, options, their choices, and names of files and folders. "
    'bash: add eval "$(radwrap completion bash)" to ~/.bashrc. zsh: write it to a file _radwrap in a folder of $fpath. '
    "fish: write it to ~/.config/fish/completions/radwrap.fish."
)
SHELLS: Final = ("bash", "zsh", "fish")
# What stands for files in our help: a name with an ending, or one of these words.
_FILE: Final = re.compile(r"\.[a-z]+$|^(FILE|IMAGE|IMAGES|PNG|PREDICTED|CAPTURED|PROGRAM|SOCKET)$")
_FOLDER: Final = "DIR"


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = verbs.add_parser("completion", description=_DESCRIPTION)
    parser.add_argument("shell", metavar="SHELL", choices=SHELLS, help=f"{', '.join(SHELLS[:-1])} or {SHELLS[-1]}")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the verb."""
    import shtab

    from radwrap.cli.main import whole_parser

    parser = whole_parser()
    for action in _actions(parser):  # `complete` is an attribute that shtab looks for, and argparse does not know
        names = action.metavar if isinstance(action.metavar, str) else action.dest.upper()
        if names == _FOLDER:
            action.complete = shtab.DIRECTORY  # type: ignore[attr-defined]
        elif action.nargs != 0 and _FILE.search(names):
            action.complete = shtab.FILE  # type: ignore[attr-defined]
    print(shtab.complete(parser, arguments.shell))
    return 0


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Options and arguments of a parser, and of all verbs below it."""
    for action in parser._actions:
        yield action
        if isinstance(action, argparse._SubParsersAction):
            for verb in action.choices.values():
                yield from _actions(verb)
