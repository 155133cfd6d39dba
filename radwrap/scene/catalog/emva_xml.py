"""Results of an EMVA 1288 measurement as the reference implementation writes them: XML of sections, names and values.

The layout is `results/SECTION/NAME/value`; names as the program has them, in
any case (`K`, `QE`, `sigma_d`, `u_e_sat`, ...). Source: EMVA1288/emva1288,
`process/results.py` and `process/routines.py`.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

from radwrap.errors import InputError
from radwrap.reading import FileKind, read_text

_FILE: Final = FileKind("EMVA 1288 result file", 1 << 20)
# A document type is where entities are declared, which may grow without bound or name other files.
_DECLARED: Final = re.compile(r"<!\s*(DOCTYPE|ENTITY)", re.IGNORECASE)
# Name in the file, in lower case -> whether a prediction cannot do without.
NAMES: Final = {
    "k": True,
    "qe": True,
    "sigma_d": True,
    "u_e_sat": True,
    "u_i_mean": False,
    "dsnu1288": False,
    "prnu1288": False,
    "dr_db": False,
    "snr_max_db": False,
    "u_e_min": False,
}


def read_emva_xml(path: Path) -> dict[str, float]:
    """Numbers of a result file, by their names in lower case: those of `NAMES` that it has.

    Parameters
    ----------
    path : Path
        The file. Units are the program's: QE and PRNU in per cent, noise in electrons, ranges in dB.

    Raises
    ------
    InputError
        If it is no XML, declares a document type or an entity, holds one name twice with two values, or lacks one that
        is needed.
    """
    text = read_text(path, _FILE)
    if _DECLARED.search(text):
        raise InputError("declares a DTD or an entity", where=str(path), remedy="leave the declaration out")
    try:
        root = ElementTree.fromstring(text)  # noqa: S314  (without declarations nothing can grow or be fetched)
    except (ElementTree.ParseError, ValueError) as error:
        raise InputError(f"is not XML: {error}", where=str(path)) from error
    found: dict[str, float] = {}
    empty: set[str] = set()
    for element in root.iter():
        name = element.tag.lower()
        values = [child.text for child in element if child.tag.lower() == "value"]
        if name in NAMES and values:
            number = _number(values[0], f"{path}: {element.tag}")
            if number is None:
                empty.add(name)
                continue
            if found.setdefault(name, number) != number:
                raise InputError("appears twice, with two values", where=f"{path}: {element.tag}")
    for name, needed in NAMES.items():
        if needed and name not in found:
            told = "has no value above zero" if name in empty else "is missing"
            raise InputError(told, where=f"{path}: {name}", remedy="export all results of the measurement")
        if needed and not found[name] > 0:
            raise InputError("must be above zero", where=f"{path}: {name}")
    return found


def _number(text: str | None, where: str) -> float | None:
    """A number, None where the program had none that means anything."""
    written = (text or "").strip().replace(",", ".")
    if written.lower() in ("", "none", "nan"):
        return None
    try:
        value = float(written)
    except ValueError:
        value = math.inf
    if not math.isfinite(value):
        raise InputError(f'"{written[:40]}" is not a finite number', where=where)
    return None if value < 0 else value  # a dark current below its own noise tells nothing
