"""``radwrap``: one verb, one function, one exit code.

Exit codes: 0 done, 1 a check failed, 2 bad input, 3 tolerance not met,
4 environment or tracer, 130 interrupted.
"""

from __future__ import annotations

import argparse
import atexit
import gc
import os
import signal
import sys
import threading
import traceback
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from importlib.metadata import version
from typing import Any, Final, NoReturn

from radwrap.errors import INTERRUPTED, EnvironmentFailure, InputError, RadwrapError, one_line

_EPILOG = (
    "Exit codes: 0 done, 1 a check failed, 2 bad input, 3 tolerance not met, 4 environment or tracer, 130 interrupted."
)

_MODULES: Final = {
    "init": "start",
    "schema": "start",
    "render": "render",
    "relight": "relight",
    "explain": "explain",
    "trade": "trade",
    "study": "study",
    "convert": "convert",
    "crosscheck": "crosscheck",
    "measure": "measure",
    "calibrate": "calibrate",
    "compare": "compare",
    "led": "led",
    "validate": "validate",
    "doctor": "doctor",
}


def program() -> NoReturn:
    """Run the command as a process of its own, and end that with its exit code.

    To free piece by piece what the process leaves behind would take some per
    cent of a small run's time.
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by who started us
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w"))
    code = main()
    if threading.active_count() > 1:
        sys.exit(code)
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError):  # `main` told it
            stream.flush()
    os._exit(code)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit code."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupt)
    try:
        given = sys.argv[1:] if arguments is None else list(arguments)
        parsed = _parsed(given)
        code: int = parsed.run(parsed)
        sys.stdout.flush()
        return code
    except KeyboardInterrupt:
        return _interrupted()
    except RadwrapError as error:
        _tell(str(error))
        return error.exit_code
    except BrokenPipeError:
        # Whoever read our output has gone; Python must not try to flush it again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EnvironmentFailure.exit_code
    except (OSError, MemoryError) as error:
        _tell(_one_line(error))
        return EnvironmentFailure.exit_code
    except Exception:  # noqa: BLE001  (an error of ours: all of it is shown)
        if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
            return _interrupted()  # the interrupt came where a library turned it into an error of its own
        with suppress(OSError):
            traceback.print_exc()
        _tell("this is an error in radwrap itself; please report it")
        return EnvironmentFailure.exit_code


def _interrupted() -> int:
    _tell("interrupted; the same command goes on where it was")
    return INTERRUPTED


def _tell(what: str) -> None:
    with suppress(OSError):  # nobody can be told, but the exit code is right
        print(f"radwrap: {what}", file=sys.stderr)


def _interrupt(*_: object) -> None:
    """SIGTERM ends a run as Ctrl-C does: programs first. Further signals would only disturb that."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt


def _one_line(error: OSError | MemoryError) -> str:
    if isinstance(error, MemoryError):
        return "not enough memory; see `radwrap render --dry-run`"
    what = error.strerror or str(error)
    return one_line(f"{error.filename}: {what}" if error.filename else what)


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, like every other error."""

    def error(self, message: str) -> NoReturn:
        raise InputError(message, remedy=f"see `{self.prog} --help`")


def _parsed(arguments: Sequence[str]) -> argparse.Namespace:
    looks = gc.isenabled()
    gc.disable()  # among what is loaded here there is no garbage: to look for it is time lost
    try:
        return _parser(arguments).parse_args(arguments)
    finally:
        if looks:
            gc.enable()


def _parser(arguments: Sequence[str]) -> argparse.ArgumentParser:
    """Parser of the verb that is asked for, or of all: to load every verb's libraries takes longer than a small run."""
    asked = _MODULES.get(arguments[0]) if arguments else None
    parser = _Parser(
        prog="radwrap", description="Predicts the gray values a machine-vision camera will capture.", epilog=_EPILOG
    )
    parser.add_argument("--version", action="version", version=f"radwrap {version('radwrap')}")
    verbs: argparse._SubParsersAction[Any] = parser.add_subparsers(title="verbs", required=True, metavar="VERB")
    for name in dict.fromkeys(_MODULES.values()) if asked is None else (asked,):
        # Here and not above: until the libraries are loaded, an interrupt must find `main` at work.
        import_module(f"radwrap.cli.{name}").add_to(verbs)
    return parser


if __name__ == "__main__":
    sys.exit(main())
