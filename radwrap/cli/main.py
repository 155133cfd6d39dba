"""``radwrap``: one verb, one function, one exit code.

Exit codes: 0 done, 1 a check failed, 2 bad input, 3 tolerance not met,
4 environment or tracer, 130 interrupted.
"""

from __future__ import annotations

import argparse
import gc
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final, NoReturn

from radwrap.cli.address_space import check_address_space, is_lack_of_memory
from radwrap.cli.interrupts import Interrupts, tell_interrupted
from radwrap.cli.spelling import spell
from radwrap.errors import EnvironmentFailure, InputError, RadwrapError, one_line
from radwrap.extras import lack_of, require

if TYPE_CHECKING:
    from radwrap.process import Child

_EPILOG = (
    "Exit codes: 0 done, 1 a check failed, 2 bad input, 3 tolerance not met, 4 environment or tracer, 130 interrupted."
)

# Each verb, the module that adds it, and what it is for: to load every verb's libraries takes longer than a small run.
_VERBS: Final = {
    "init": ("start", "write a commented scene to start from"),
    "schema": ("start", "print the JSON schema of scene files"),
    "render": ("render", "predict the gray image of a scene"),
    "relight": ("relight", "make images for any levels of the sources"),
    "face": ("face", "turn light and exposure in the browser, and see gray levels with their error"),
    "fit": ("fit", "find values of a scene that explain captured images, and say whether they do"),
    "design": ("design", "find the values of a scene that make a measurement best within limits"),
    "explain": ("explain", "show what a scene amounts to"),
    "trade": ("trade", "measure what accuracy costs on a scene"),
    "study": ("study", "change a scene by a design, measure, and say what matters"),
    "dataset": ("dataset", "make images with truth to learn from: masks, boxes, depth, poses"),
    "convert": ("convert", "write a scene for Radiance, POV-Ray or as a preview; a mesh for Radiance"),
    "crosscheck": ("crosscheck", "compare Radiance with POV-Ray on a scene"),
    "measure": ("measure", "measure circles, widths, edges, dots, parts, gray levels or noise in images"),
    "calibrate": ("calibrate", "calibrate a camera or a sensor"),
    "compare": ("compare", "compare a captured image with the predicted one"),
    "led": ("led", "drive the real LED ring over USB HID"),
    "validate": ("validate", "run the score card of closed forms"),
    "catalog": ("catalog", "list, show and check sensors, lenses, lights and materials that scenes may name"),
    "doctor": ("doctor", "check programs and libraries"),
    "completion": ("completion", "print what a shell needs to complete this command"),
}
# The extra without which a verb cannot do its work; that of others shows where it is used.
_EXTRA: Final = {
    **dict.fromkeys(("measure", "calibrate", "compare"), "measure"),
    **dict.fromkeys(("study", "trade", "crosscheck", "validate"), "study"),
}
# What a verb has a process of its own for: that one loads its libraries while this one does.
_AHEAD: Final = {"face": "radwrap.face.renderer"}
_ALONE: Final = ("-h", "--help", "--export")  # needs none


def main(arguments: Sequence[str] | None = None, interrupts: Interrupts | None = None) -> int:
    """Run the command; returns its exit code.

    Parameters
    ----------
    arguments : sequence of str, optional
        Default those of the process.
    interrupts : Interrupts, optional
        What heeds the signals already.
    """
    own = interrupts is not None  # a process of its own, which ends with the command
    if interrupts is None:
        interrupts = Interrupts()
        interrupts.install()
    try:
        code = _carried_out(sys.argv[1:] if arguments is None else list(arguments), interrupts, own)
        sys.stdout.flush()
        return code
    except BaseException as error:  # noqa: BLE001  (each has its exit code)
        if interrupts.heard or isinstance(error, KeyboardInterrupt):
            return tell_interrupted()  # also where a library turned it into an error of its own
        return _failed(error)


def _carried_out(given: list[str], interrupts: Interrupts, own: bool) -> int:
    with _started_ahead(given) as ahead:
        try:
            parsed = _parsed(given)
        except SystemExit as end:  # --help and --version, which are told
            return int(end.code or 0)
        if own:
            gc.freeze()  # what is loaded stays: to look through it again and again takes 5 % of a small render
        interrupts.begin_work()
        if given[0] in _EXTRA:
            require(_EXTRA[given[0]], given[0])
        if ahead is not None:
            parsed.ahead = ahead
        try:
            code: int = parsed.run(parsed)
        except RadwrapError as error:
            spell(error, parsed.parser.options)
            raise
    return code


@contextmanager
def _started_ahead(given: Sequence[str]) -> Iterator[Child | None]:
    """The process that a verb will need, if it needs one; it does not outlive the verb."""
    alone = any(word == one or word.startswith(f"{one}=") for word in given for one in _ALONE)
    if not given or given[0] not in _AHEAD or alone:
        yield None
        return
    from radwrap.own_modules import start_module

    child = start_module(_AHEAD[given[0]])
    try:
        yield child
    finally:
        if not child.ended:
            child.kill()


def _failed(error: BaseException) -> int:
    """Say what went wrong, in one line if it is not our own fault; returns the exit code."""
    match error:
        case RadwrapError():
            _tell(str(error))
            return error.exit_code
        case BrokenPipeError():
            # Whoever read our output has gone; Python must not try to flush it again.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        case ModuleNotFoundError(name=str(module)) if not module.startswith("radwrap"):
            _tell(str(lack_of(module, "")))
        case _ if is_lack_of_memory(error):
            _tell("not enough memory; see `radwrap render --dry-run`")
        case OSError():
            what = error.strerror or str(error)
            _tell(one_line(f"{error.filename}: {what}" if error.filename else what))
        case _:
            import traceback

            traceback.print_exception(error)
            _tell("this is an error in radwrap itself; please report it")
    return EnvironmentFailure.exit_code


def _tell(what: str) -> None:
    with suppress(OSError):  # nobody can be told, but the exit code is right
        print(f"radwrap: {what}", file=sys.stderr)


class _Parser(argparse.ArgumentParser):
    """Takes options by their whole names, and says what is wrong in one line, like every other error."""

    def __init__(self, **more: Any) -> None:
        super().__init__(allow_abbrev=False, **more)
        self.set_defaults(parser=self)  # the innermost is left: that of the verb

    @property
    def options(self) -> dict[str, str]:
        """Spelling of each option by the name that its value goes by; `out` of `init` and `convert` is none."""
        named = (action for action in self._actions if action.option_strings or action.dest == "out")
        return {action.dest: (action.option_strings or [str(action.metavar)])[-1] for action in named}

    def format_help(self) -> str:
        """Help without the mark-up of the docstrings that it is made of."""
        return super().format_help().replace("``", "")

    def error(self, message: str) -> NoReturn:
        raise InputError(message, remedy=f"see `{self.prog} --help`")

    def _print_message(self, message: str, file: Any = None) -> None:
        (file or sys.stdout).write(message)  # argparse itself passes over what cannot be written


class _Verbs(argparse._SubParsersAction):  # type: ignore[type-arg]  # generic for type checkers only
    """Verbs with what they are for."""

    def add_parser(self, name: str, **more: Any) -> Any:
        return super().add_parser(name, help=_VERBS[name][1], **more)


class _Version(argparse.Action):
    """The version, looked up where it is asked for."""

    def __call__(self, *_: object) -> NoReturn:
        from importlib.metadata import version

        print(f"radwrap {version('radwrap')}")
        raise SystemExit


def _parsed(arguments: Sequence[str]) -> argparse.Namespace:
    looks = gc.isenabled()
    gc.disable()  # among what is loaded here there is no garbage: to look for it is time lost
    try:
        return _parser(arguments).parse_args(arguments)
    finally:
        if looks:
            gc.enable()


def whole_parser() -> argparse.ArgumentParser:
    """Parser of all verbs, with all that each of them takes."""
    parser, verbs = _without_verbs()
    for module in dict.fromkeys(module for module, _ in _VERBS.values()):
        import_module(f"radwrap.cli.{module}").add_to(verbs)
    return parser


def _without_verbs() -> tuple[argparse.ArgumentParser, argparse._SubParsersAction[Any]]:
    parser = _Parser(
        prog="radwrap", description="Predicts the gray values a machine-vision camera will capture.", epilog=_EPILOG
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    return parser, parser.add_subparsers(title="verbs", required=True, metavar="VERB", action=_Verbs)


def _parser(arguments: Sequence[str]) -> argparse.ArgumentParser:
    """Parser of the verb that is asked for; of all their names where none is."""
    parser, verbs = _without_verbs()
    asked = _VERBS.get(arguments[0]) if arguments else None
    if asked is not None:
        check_address_space()
        # Here and not above: until the libraries are loaded, an interrupt must find `main` at work.
        import_module(f"radwrap.cli.{asked[0]}").add_to(verbs)
        return parser
    for name in _VERBS:
        verbs.add_parser(name)
    return parser


if __name__ == "__main__":
    sys.exit(main())
