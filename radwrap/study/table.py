"""Tables as CSV: read with the line of every error, written whole."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from radwrap.errors import InputError
from radwrap.reading import FileKind, csv_rows, read_text, shortened

TABLE: Final = FileKind("table of results", 256 << 20, "give a CSV file in UTF-8")


@dataclass(frozen=True, slots=True)
class Table:
    """A CSV file with a header.

    Attributes
    ----------
    columns : tuple of str
        The header.
    rows : tuple of dict
        Column -> cell.
    """

    columns: tuple[str, ...]
    rows: tuple[dict[str, str], ...]

    def column(self, name: str) -> str:
        """The full heading of a column that is named with or without its unit.

        Raises
        ------
        InputError
            If there is none, or more than one.
        """
        found = [column for column in self.columns if name in (column, bare(column))]
        if len(found) != 1:
            what = f'no column "{name}"' if not found else f'more than one column "{name}"'
            raise InputError(what, where="the table", remedy=f"columns are {shortened(', '.join(self.columns), 500)}")
        return found[0]


def bare(column: str) -> str:
    """A heading without its unit: "f [mm]" is f."""
    return column.partition(" [")[0]


def unit(column: str) -> str:
    """The unit in a heading; empty where there is none."""
    return column.partition(" [")[2].removesuffix("]")


def read_table(path: Path) -> Table:
    """Read a CSV file.

    Raises
    ------
    InputError
        If it cannot be read, or a line does not have as many cells as the header.
    """
    lines = csv_rows(read_text(path, TABLE), str(path))
    header = [cell.strip() for cell in next(lines, (1, []))[1]]
    if not header or len(set(header)) < len(header) or not all(header):
        raise InputError("needs a header of different names", where=f"{path}: line 1")
    rows = []
    for line, cells in lines:
        if len(cells) != len(header):
            raise InputError(f"has {len(cells)} cells, the header has {len(header)}", where=f"{path}: line {line}")
        rows.append(dict(zip(header, (cell.strip() for cell in cells), strict=True)))
    return Table(tuple(header), tuple(rows))


def csv_text(columns: Sequence[str], rows: Iterable[Mapping[str, Any]], *, header: bool = True) -> str:
    """Rows as CSV; floats with all their digits, None as an empty cell."""
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    if header:
        writer.writeheader()
    for row in rows:
        writer.writerow({name: _cell(row.get(name)) for name in columns})
    return text.getvalue()


def _cell(value: Any) -> str:
    if value is None:
        return ""
    return repr(float(value)) if isinstance(value, float) else str(value)
