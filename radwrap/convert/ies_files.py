"""Luminaire files (IES LM-63) as Radiance sources, by Radiance's own ies2rad.

A luminaire file may name another file for its tilt, and its header lines end
up in comments, which Radiance cuts at 2047 bytes and reads on as scene. So
only TILT=NONE and TILT=INCLUDE pass, and what ies2rad writes is parsed and
written again without comments.
"""

from __future__ import annotations

import re
import tempfile
from pathlib import Path
from typing import Final

from radwrap.convert.ies_numbers import fault_of_numbers
from radwrap.convert.radiance_files import side_stem
from radwrap.errors import InputError, TracerError
from radwrap.files import make_folder, write_bytes
from radwrap.process import Programs
from radwrap.reading import FileKind, read_bytes
from radwrap.tracers.installation import judge
from radwrap.tracers.rad_grammar import Source, primitives
from radwrap.tracers.radiance import RadianceOptions

# Radiance's luminous efficacy of white light [lm/W], by which ies2rad makes watts of lumens.
LUMENS_PER_WATT: Final = 179.0
_LUMINAIRE: Final = FileKind("luminaire file", 1 << 20)
_TILT: Final = re.compile(rb"(?im)^[ \t]*TILT[ \t]*=[ \t]*([^\r\n]*)")
_TILT_MARK: Final = ".tilt"
_HARMLESS: Final = (r"\S+: warning - no lamp type",)


def write_luminaire(path: Path, out: Path, options: RadianceOptions) -> tuple[Path, ...]:
    """Write a luminaire as a Radiance scene in m, its distribution beside it.

    Parameters
    ----------
    path : Path
        The .ies file.
    out : Path
        The .rad file; a scene includes it with ``rad = "lamp.rad"``.
    options : RadianceOptions
        Which Radiance.

    Raises
    ------
    InputError
        If it is no luminaire file, or names another file.
    TracerError
        If ies2rad fails or warns.
    """
    content = _content(path)
    stem = side_stem(out)
    with Programs() as programs, tempfile.TemporaryDirectory(prefix="radwrap-") as folder:
        work = Path(folder)
        (work / "lamp.ies").write_bytes(content)
        try:
            _, said = programs.run(
                [options.installation.program("ies2rad"), "-p", ".", "-o", stem, "lamp.ies"],
                folder=work,
                environment=options.installation.environment(),
                limits=options.limits,
            )
        except TracerError as error:
            if not error.what.startswith("ended with exit code"):
                raise
            raise _no_luminaire(path, error.what) from error
        judge(said, "ies2rad", _HARMLESS)
        made = {file.name: file.read_bytes() for file in work.iterdir() if file.name != "lamp.ies"}
    text = _plain(made.pop(f"{stem}.rad", b""), path)
    # A tilt's table, whose name no scene may include.
    made = {name.replace("%", _TILT_MARK): data for name, data in made.items()}
    make_folder(out.parent)
    for name, data in sorted(made.items()):
        write_bytes(out.parent / name, data)
    head = f"# Luminaire written by radwrap. Lengths in m, radiances in W/m^2/sr at {LUMENS_PER_WATT:g} lm/W.\n"
    write_bytes(out, (head + text).encode())
    return (*(out.parent / name for name in sorted(made)), out)


def _content(path: Path) -> bytes:
    content = read_bytes(path, _LUMINAIRE)
    if b"\0" in content:
        raise InputError("is not a luminaire file: it holds a NUL byte", where=str(path))
    tilt = _TILT.search(content)
    if tilt is None:
        raise InputError("is not a luminaire file: it has no TILT", where=str(path), remedy="name an IES LM-63 file")
    if tilt[1].strip().upper() not in (b"NONE", b"INCLUDE"):
        raise InputError("names another file for its tilt", where=str(path), remedy="write TILT=NONE or TILT=INCLUDE")
    fault = fault_of_numbers(content[tilt.end() :].decode("latin-1"), tilted=tilt[1].strip().upper() == b"INCLUDE")
    if fault:
        raise _no_luminaire(path, fault)
    return content


def _no_luminaire(path: Path, why: str) -> InputError:
    return InputError(f"is not a luminaire file: {why}", where=str(path), remedy="correct it")


def _plain(text: bytes, path: Path) -> str:
    """The scene again from its checked words; ies2rad quotes names, which our grammar does not allow."""
    lines = [line for line in text.decode("ascii", "replace").splitlines() if not line.startswith("#")]
    words = re.sub(r"'([^']*)'", r"\1", "\n".join(lines) + "\n")
    found = primitives(words, Source(str(path), path))
    pieces = [p.text([word.removeprefix("./").replace("%", _TILT_MARK) for word in p.words]) for p in found]
    if not pieces:
        raise InputError("is not a luminaire file: no source came of it", where=str(path))
    return "\n".join(pieces)
