"""What can go wrong, and the exit code that says so.

::

    RadwrapError
    ├── CheckFailed        exit 1   a check that was asked for failed
    ├── InputError         exit 2   a scene file, an option or an argument is wrong
    ├── ToleranceNotMet    exit 3   the image stands, but not to the asked tolerance
    ├── Cancelled          exit 130 a render was told to end by its caller
    └── EnvironmentFailure exit 4   a program, a folder or the disk is not as needed
        ├── FolderTaken    exit 4   another run is writing there
        └── TracerError    exit 4   the ray tracer failed, warned or answered too little

An interrupted command ends with 130 (:data:`INTERRUPTED`).
"""

from __future__ import annotations

INTERRUPTED = 130


class RadwrapError(Exception):
    """An error told in one line: where, what, and what to do.

    Parameters
    ----------
    what : str
        What is wrong; parameters stand in backquotes, such as `trust=True`.
    where : str
        File and key path, parameter or program; empty where there is no such place.
    remedy : str
        What the user can do, with parameters as in ``what``; empty where ``what`` already says it.
    """

    exit_code = 1

    def __init__(self, what: str, *, where: str = "", remedy: str = "") -> None:
        self.what = what
        self.where = where
        self.remedy = remedy
        super().__init__(what)

    def __str__(self) -> str:
        line = f"{self.where}: {self.what}" if self.where else self.what
        if self.remedy:
            line += f"; {self.remedy}"
        return one_line(_shortened(line))


# Without a module more: this one is loaded before the signals are ours.
_LONGEST_QUOTE = 60  # characters; of a value that a message quotes
_LONGEST_WORD = 4096  # without a blank, as long as a path may be


def _shortened(line: str) -> str:
    """A message in which long values, quoted or not, are cut to what shows which they are."""
    parts = line.split('"')
    if len(parts) % 2:  # quotes are in pairs: between the first and the second, the third and the fourth
        parts[1::2] = [_cut(part, _LONGEST_QUOTE) for part in parts[1::2]]
    return " ".join(_cut(word, _LONGEST_WORD) for word in '"'.join(parts).split(" "))


def _cut(text: str, longest: int) -> str:
    return text if len(text) <= longest else f"{text[:_LONGEST_QUOTE]}..."


def one_line(text: str) -> str:
    """Text in one line that a terminal shows as it is: what is not printable is escaped."""
    folded = " ".join(text.split())
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in folded)


class CheckFailed(RadwrapError):
    """A check that was asked for failed."""

    exit_code = 1


class InputError(RadwrapError):
    """A scene file, an option or an argument is wrong."""

    exit_code = 2


class ToleranceNotMet(RadwrapError):
    """The image is written, but misses the asked tolerance. Commands end so; `render` returns it: look at its `met`."""

    exit_code = 3


class Cancelled(RadwrapError):
    """A render ended because the program that started it asked for that.

    No process is left. In a folder that was named finished pieces stay, and the same call goes on from them.
    """

    exit_code = INTERRUPTED


class EnvironmentFailure(RadwrapError):
    """A program, a folder or the disk is not as needed."""

    exit_code = 4


class FolderTaken(EnvironmentFailure):
    """Another run is writing in the folder."""


class TracerError(EnvironmentFailure):
    """The ray tracer failed, warned or answered too little."""
