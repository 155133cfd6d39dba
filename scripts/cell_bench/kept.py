"""Rows that are finished, kept by a hash of all that they depend on."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cell_bench.cases import digest
from radwrap.files import write_bytes


def kept(folder: Path, key: dict[str, Any], measure: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """The row for a key: read where it was finished before, else measured, and written if it needs no retry."""
    path = folder / f"{digest(key)[:32]}.json"
    if path.is_file():
        found: dict[str, Any] = json.loads(path.read_text())
        return found
    row = measure()
    if row.get("retry"):
        return row
    folder.mkdir(parents=True, exist_ok=True)
    write_bytes(path, json.dumps(row, indent=1).encode())
    return row
