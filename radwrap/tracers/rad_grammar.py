"""Radiance scene text read with suspicion: words, primitives, and which types may stand.

The grammar is that of Radiance 6.0 (readobj.c, readfargs.c, fgetword.c): words
between blanks; a comment only where a primitive may begin; ``modifier type
identifier``, then counted strings, no integers, counted reals. What Radiance
reads otherwise than it looks (quotes, long words, long comments, counts above
16 bits) is refused, so that our reading and Radiance's cannot differ.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Final

from radwrap.errors import InputError

VOID: Final = "void"
# As modifier of an alias: the alias takes the modifier of its reference.
_INHERIT: Final = "inherit"
_ALIAS: Final = "alias"

# The blanks of C's isspace(), neither more nor less.
_BLANK: Final = r"[ \t\n\v\f\r]"
_WORD: Final = re.compile(rf"{_BLANK}*([^ \t\n\v\f\r]+)")
_REAL: Final = re.compile(rf"{_BLANK}*([+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)(?={_BLANK}|\Z)")
_COUNT: Final = re.compile(r"[0-9]{1,9}")
_NAME: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_.+-]{0,127}")
_RELAYED: Final = re.compile(rf"{_NAME.pattern}(?:>{_NAME.pattern})*")
# Printable ASCII without quotes and without what shells, rtrace's arguments or cal contexts give a meaning.
_PLAIN: Final = re.compile(r"[#%&()*+,\-./0-9:;<=>?A-Z\[\\\]^_a-z{|}~]+")

# Radiance cuts words at 511 bytes and reads the rest as the next word.
_LONGEST_WORD: Final = 500
# Radiance reads the rest of a comment beyond 2047 bytes as scene.
_LONGEST_COMMENT: Final = 2000
# A frozen octree keeps counts in 16 bits. With 65536 numbers it keeps the count 0, and rtrace reads the bytes
# of the numbers as further primitives: numbers alone then open an octree and run its commands.
_MOST_REALS: Final = 32767
_MOST_WORDS: Final = 1000
_MOST_REALS_IN_ALL: Final = 10_000_000
# FTINY: Radiance takes lengths up to this for zero.
_TINY: Final = 1e-6
# Above it a frozen octree holds another number, and float32 colours are infinite.
_LARGEST: Final = 1e38

ILLUMINATING: Final = frozenset({"light", "spotlight", "glow", "illum"})


@dataclass(frozen=True, slots=True)
class Source:
    """The file that is read, for messages.

    Attributes
    ----------
    where : str
        What named the file, such as "scene.toml: targets[0].rad".
    path : Path
        The file.
    """

    where: str
    path: Path

    def fault(self, what: str, *, line: int | None = None, remedy: str = "correct the file") -> InputError:
        """Error about a line of the file, or about the whole of it."""
        place = f"{self.where}: {self.path}"
        return InputError(what, where=place if line is None else f"{place}, line {line}", remedy=remedy)


@dataclass(frozen=True, slots=True)
class Primitive:
    """One checked primitive of a scene.

    Attributes
    ----------
    modifier, kind, name : str
        The three words it begins with.
    words : tuple of str
        String arguments; of an alias, its reference.
    reals : tuple of float
        Real arguments.
    roles : str
        For each string argument one letter: m a modifier, e an expression or
        transform argument, f a function file, d a data file, p a picture,
        s a light source's name.
    line : int
        Where it begins.
    """

    modifier: str
    kind: str
    name: str
    words: tuple[str, ...]
    reals: tuple[float, ...]
    roles: str
    line: int

    @property
    def shines(self) -> bool:
        """Whether it is the material of a light that is not black."""
        return self.kind in ILLUMINATING and max(self.reals[:3]) > 0

    def text(self, words: Sequence[str]) -> str:
        """Radiance text of it, with other string arguments."""
        if self.kind == _ALIAS:
            return f"{self.modifier} {_ALIAS} {self.name} {words[0]}\n\n"
        strings = " ".join([str(len(words)), *words])
        reals = " ".join([str(len(self.reals)), *map(repr, self.reals)])
        return f"{self.modifier} {self.kind} {self.name}\n{strings}\n0\n{reals}\n\n"


Check = Callable[[Sequence[float]], str]
_ANY: Final = range(_MOST_REALS + 1)


@dataclass(frozen=True, slots=True)
class _Form:
    """What a type takes.

    Attributes
    ----------
    words : str
        Roles of its string arguments; after the last may stand ``*`` for any number of it, ``+`` for one or
        more, ``?`` for none or one.
    reals : sequence of int
        Permitted numbers of reals.
    check : callable
        Tells what is wrong with the reals, or "".
    """

    words: str = ""
    reals: Sequence[int] = _ANY
    check: Check = lambda _: ""

    def roles(self, count: int) -> str | None:
        """Role of each of `count` strings; None where there are too few or too many."""
        fixed, repeated, least, most = self.words, "", 0, 0
        if self.words[-1:] in ("*", "+", "?"):
            fixed, repeated = self.words[:-2], self.words[-2]
            least, most = {"*": (0, _MOST_WORDS), "+": (1, _MOST_WORDS), "?": (0, 1)}[self.words[-1]]
        more = count - len(fixed)
        return fixed + repeated * more if least <= more <= most else None

    def due(self) -> str:
        """The permitted numbers of reals, in words."""
        if isinstance(self.reals, range):
            steps = f" in steps of {self.reals.step}" if self.reals.step > 1 else ""
            return f"{self.reals.start} to {_MOST_REALS} reals{steps}"
        return f"{' or '.join(map(str, self.reals))} reals"


def _or_more(count: int, step: int = 1) -> range:
    return range(count, _MOST_REALS + 1, step)


def _is_zero(vector: Sequence[float]) -> bool:
    return not any(vector)


def _sphere(reals: Sequence[float]) -> str:
    return "" if reals[3] > _TINY else f"its radius must be greater than {_TINY:g}"


def _cylinder(reals: Sequence[float]) -> str:
    if reals[6] <= _TINY:
        return f"its radius must be greater than {_TINY:g}"
    return "its ends coincide" if tuple(reals[:3]) == tuple(reals[3:6]) else ""


def _cone(reals: Sequence[float]) -> str:
    if min(reals[6:]) < 0 or max(reals[6:]) <= _TINY:
        return f"its radii must not be negative, and one must be greater than {_TINY:g}"
    return "its ends coincide" if tuple(reals[:3]) == tuple(reals[3:6]) else ""


def _ring(reals: Sequence[float]) -> str:
    if min(reals[6:]) < 0 or abs(reals[6] - reals[7]) <= _TINY:
        return f"its radii must not be negative and must differ by more than {_TINY:g}"
    return "its direction is zero" if _is_zero(reals[3:6]) else ""


def _polygon(reals: Sequence[float]) -> str:
    corners = [reals[i : i + 3] for i in range(0, len(reals), 3)]
    ax, ay, az = corners[0]
    edges = [(x - ax, y - ay, z - az) for x, y, z in corners[1:]]
    area = [0.0, 0.0, 0.0]
    for (ux, uy, uz), (vx, vy, vz) in pairwise(edges):
        area[0] += uy * vz - uz * vy
        area[1] += uz * vx - ux * vz
        area[2] += ux * vy - uy * vx
    return "it has no area" if _is_zero(area) else ""


_BAD_ANGLE: Final = "its angle must lie above 0 and at most at 360 degrees"


def _source(reals: Sequence[float]) -> str:
    if _is_zero(reals[:3]):
        return "its direction is zero"
    return "" if _TINY < math.radians(reals[3] / 2) <= math.pi else _BAD_ANGLE


def _emission(reals: Sequence[float]) -> str:
    return "" if min(reals[:3]) >= 0 else "its radiance is negative"


def _spotlight(reals: Sequence[float]) -> str:
    if wrong := _emission(reals):
        return wrong
    if _is_zero(reals[4:]):
        return "its direction is zero"
    return "" if _TINY < reals[3] <= 360 else _BAD_ANGLE


def _spectrum(reals: Sequence[float]) -> str:
    # Radiance answers with memory that it never set where samples lie more than about 150 nm apart, and
    # reads beyond them where the wavelengths are huge.
    first, last = reals[:2]
    if min(first, last) < 100 or max(first, last) > 1e4:
        return "its wavelengths must lie between 100 and 10000 nm"
    step = abs(last - first) / (len(reals) - 3)
    return "" if 1e-3 <= step <= 100 else "its samples must lie 0.001 to 100 nm apart"


_ANISOTROPIC: Final = "eeefe*"
_MATERIAL_FUNCTION: Final = "efe*"
_MATERIAL_DATA: Final = "edfe*"
_SURFACES: Final = MappingProxyType(
    {
        "sphere": _Form("", (4,), _sphere),
        "bubble": _Form("", (4,), _sphere),
        "polygon": _Form("", _or_more(9, 3), _polygon),
        "cone": _Form("", (8,), _cone),
        "cup": _Form("", (8,), _cone),
        "cylinder": _Form("", (7,), _cylinder),
        "tube": _Form("", (7,), _cylinder),
        "ring": _Form("", (8,), _ring),
        "source": _Form("", (4,), _source),
    }
)
_MODIFIERS: Final = MappingProxyType(
    {
        "light": _Form("", (3,), _emission),
        "illum": _Form("m?", (3,), _emission),
        "glow": _Form("", (4,), _emission),
        "spotlight": _Form("", (7,), _spotlight),
        "mirror": _Form("m?", (3,)),
        "plastic": _Form("", (5,)),
        "metal": _Form("", (5,)),
        "trans": _Form("", (7,)),
        "plastic2": _Form(_ANISOTROPIC, (6,)),
        "metal2": _Form(_ANISOTROPIC, (6,)),
        "trans2": _Form(_ANISOTROPIC, (8,)),
        "ashik2": _Form(_ANISOTROPIC, (8,)),
        "dielectric": _Form("", (5,)),
        "interface": _Form("", (8,)),
        "glass": _Form("", (3, 4)),
        "antimatter": _Form("m+", (0,)),
        "mist": _Form("s*", (0, 3, 6, 7)),
        "prism1": _Form("eeeefe*"),
        "prism2": _Form("eeeeeeeefe*"),
        "BRTDfunc": _Form("eeeeeeeeefe*", _or_more(9)),
        "plasfunc": _Form(_MATERIAL_FUNCTION, _or_more(4)),
        "metfunc": _Form(_MATERIAL_FUNCTION, _or_more(4)),
        "transfunc": _Form(_MATERIAL_FUNCTION, _or_more(6)),
        "plasdata": _Form(_MATERIAL_DATA, _or_more(4)),
        "metdata": _Form(_MATERIAL_DATA, _or_more(4)),
        "transdata": _Form(_MATERIAL_DATA, _or_more(6)),
        "texfunc": _Form("eeefe*"),
        "texdata": _Form("eeedddfe*"),
        "colorfunc": _Form("eeefe*"),
        "colordata": _Form("eeedddfe*"),
        "colorpict": _Form("eeepfeee*"),
        "brightfunc": _Form("efe*"),
        "brightdata": _Form("edfe*"),
        "spectrum": _Form("", _or_more(5), _spectrum),
        "mixfunc": _Form("mmefe*"),
        "mixdata": _Form("mmedfe*"),
        "mixpict": _Form("mmepfeee*"),
        _ALIAS: _Form("m"),
    }
)
ALLOWED: Final = MappingProxyType({**_SURFACES, **_MODIFIERS})

_OCTREE: Final = "opens a prebuilt octree or mesh, which may run commands"
_UNCHECKED: Final = "opens a file format that is not checked here"
_TEXT: Final = "opens font and text files that are not checked here"
_REFUSED: Final = MappingProxyType(
    {"instance": _OCTREE, "mesh": _OCTREE}
    | dict.fromkeys(("BSDF", "aBSDF", "WGMDfunc"), _UNCHECKED)
    | dict.fromkeys(("specfile", "specfunc", "specdata", "specpict"), _UNCHECKED)
    | dict.fromkeys(("colortext", "brighttext", "mixtext"), _TEXT)
)


def shown(word: str) -> str:
    """A word of the file for a message: short, printable, quoted."""
    cut = word if len(word) <= 40 else f"{word[:40]}..."
    return f'"{cut.encode("unicode_escape").decode()}"'


class _Reader:
    """Walks through the words of a text and knows the line."""

    def __init__(self, text: str, source: Source) -> None:
        self._text = text
        self._source = source
        self._at = 0
        self._line = 1
        self._counted = 0

    def line(self) -> int:
        """Number of the line at which the reader stands."""
        self._line += self._text.count("\n", self._counted, self._at)
        self._counted = self._at
        return self._line

    def fault(self, what: str, remedy: str = "correct the file") -> InputError:
        """Error at this line."""
        return self._source.fault(what, line=self.line(), remedy=remedy)

    def more(self) -> bool:
        """Skip blanks and comments; tell whether a primitive follows."""
        while match := _WORD.match(self._text, self._at):
            self._at = match.start(1)
            if self._text[self._at] != "#":
                return True
            end = self._text.find("\n", self._at)
            end = len(self._text) if end < 0 else end
            if len(self._text[self._at : end].encode()) > _LONGEST_COMMENT:
                what = f"a comment is longer than {_LONGEST_COMMENT} bytes"
                raise self.fault(f"{what}, and Radiance reads its end as scene", "break it into lines")
            self._at = end
        return False

    def word(self, due: str) -> str:
        """Next word; `due` names it for messages."""
        match = _WORD.match(self._text, self._at)
        if match is None:
            self._at = len(self._text)
            raise self.fault(f"the file ends where {due} is expected")
        self._at = match.end()
        word = match[1]
        if len(word) > _LONGEST_WORD:
            raise self.fault(f"the word {shown(word)} is longer than {_LONGEST_WORD} characters")
        if word.startswith("#"):
            raise self.fault(
                f"a comment is found where {due} is expected",
                "put comments between primitives: Radiance reads them only there",
            )
        if not _PLAIN.fullmatch(word):
            raise self.fault(
                f"{shown(word)} holds a character that is not allowed in a scene",
                "use printable ASCII without quotes, $, ` and @",
            )
        return word

    def count(self, due: str, most: int) -> int:
        """Next word, the number of arguments that follow."""
        word = self.word(due)
        if not _COUNT.fullmatch(word):
            raise self.fault(f"{shown(word)} is found where {due} is expected", "write an integer, 0 or more")
        if int(word) > most:
            raise self.fault(f"{due} is {int(word)}, more than {most}", "split the primitive")
        return int(word)

    def reals(self, count: int) -> tuple[float, ...]:
        """Next `count` numbers."""
        values = []
        for index in range(count):
            match = _REAL.match(self._text, self._at)
            if match is None or len(match[1]) > _LONGEST_WORD:
                word = self.word(f"real {index + 1} of {count}")
                raise self.fault(
                    f"{shown(word)} is found where real {index + 1} of {count} is expected", "write a decimal number"
                )
            self._at = match.end()
            value = float(match[1])
            if abs(value) > _LARGEST:
                raise self.fault(f"{shown(match[1])} is beyond the largest number, {_LARGEST:g}")
            values.append(value)
        return tuple(values)


def primitives(text: str, source: Source) -> Iterator[Primitive]:
    """Read a scene text, primitive by primitive.

    Parameters
    ----------
    text : str
        The whole file.
    source : Source
        For messages.

    Yields
    ------
    Primitive
        Checked but for the files that its string arguments name.

    Raises
    ------
    InputError
        At the first word that is not of the grammar, or not permitted.
    """
    reader = _Reader(text, source)
    defined = {VOID}
    total = 0
    while reader.more():
        primitive = _primitive(reader, defined)
        total += len(primitive.reals)
        if total > _MOST_REALS_IN_ALL:
            raise reader.fault(f"the file holds more than {_MOST_REALS_IN_ALL} numbers", "split it")
        if primitive.kind in _MODIFIERS:
            defined.add(primitive.name)
        yield primitive


def _primitive(reader: _Reader, defined: set[str]) -> Primitive:
    modifier = reader.word("a modifier")
    line = reader.line()
    if not _NAME.fullmatch(modifier):
        raise reader.fault(
            f"{shown(modifier)} is found where a modifier is expected", "check whether the counts before it are right"
        )
    kind = reader.word("a type")
    form = ALLOWED.get(kind)
    if form is None:
        reason = _REFUSED.get(kind, "is not a type of primitive that is allowed here")
        raise reader.fault(f"{shown(kind)} {reason}", "remove it, or pass `trust=True` if you trust the file")
    if modifier not in defined and (modifier, kind) != (_INHERIT, _ALIAS):
        raise reader.fault(
            f'modifier "{modifier}" is not defined before', "define it earlier in this file, or write void"
        )
    name = reader.word("an identifier")
    if not _NAME.fullmatch(name) or name in (VOID, _INHERIT):
        raise reader.fault(
            f"{shown(name)} may not be an identifier",
            "begin it with a letter or _ and continue with letters, digits and _.+-, 128 characters at most",
        )
    words, reals = _arguments(reader, kind, name)
    roles = form.roles(len(words))
    if roles is None:
        raise reader.fault(f'{kind} "{name}" cannot have {len(words)} strings', "see its type in the Radiance manual")
    if kind != _ALIAS and len(reals) not in form.reals:
        raise reader.fault(f'{kind} "{name}" takes {form.due()}, not {len(reals)}')
    if wrong := form.check(reals):
        raise reader.fault(f'{kind} "{name}": {wrong}')
    for word, role in zip(words, roles, strict=True):
        _check_word(reader, word, role, defined)
    return Primitive(modifier, kind, name, words, reals, roles, line)


def _arguments(reader: _Reader, kind: str, name: str) -> tuple[tuple[str, ...], tuple[float, ...]]:
    if kind == _ALIAS:
        return (reader.word(f'the reference of alias "{name}"'),), ()
    of = f'of {kind} "{name}"'
    strings = reader.count(f"the number of strings {of}", _MOST_WORDS)
    words = tuple(reader.word(f"string {index + 1} of {strings} {of}") for index in range(strings))
    reader.count(f"the number of integers {of}", 0)
    return words, reader.reals(reader.count(f"the number of reals {of}", _MOST_REALS))


def _check_word(reader: _Reader, word: str, role: str, defined: set[str]) -> None:
    if role == "m" and word not in defined:
        raise reader.fault(f"material {shown(word)} is not defined before", "define it earlier in this file")
    if role == "s" and not _RELAYED.fullmatch(word):
        raise reader.fault(f"{shown(word)} names no light source", "name a surface of the file")
