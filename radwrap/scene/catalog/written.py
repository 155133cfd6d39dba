"""A component as the text of its file."""

from __future__ import annotations

import datetime
import json
from collections.abc import Mapping, Sequence
from typing import Any

from radwrap.scene.catalog.component import FORMAT


def component_text(
    kind: str,
    title: str,
    values: Mapping[str, Any],
    entries: Mapping[str, Mapping[str, Any]],
    *,
    revision: datetime.date,
    sources: Mapping[str, Mapping[str, Any]],
    published: Mapping[str, str] | None = None,
) -> str:
    """Text of a component's file.

    Parameters
    ----------
    kind, title : str
        Class, as its folder is called, and what it is in words.
    values : Mapping
        Keys as a scene has them.
    entries : Mapping
        Key -> basis, source, note and what else `[catalog.from]` may have.
    revision : date
        Of the file.
    sources : Mapping
        Name of a source -> citation and what else `[catalog.sources.NAME]` may have.
    published : Mapping, optional
        Totals that a sheet prints.
    """
    told: dict[str, Any] = {"format": FORMAT, "kind": kind, "name": title, "revision": revision}
    if published:
        told["published"] = published
    tables = {"catalog": told, "catalog.from": entries}
    tables |= {f"catalog.sources.{name}": source for name, source in sources.items()}
    lines = [f"{key} = {toml_value(value)}" for key, value in values.items()]
    for name, table in tables.items():
        lines += ["", f"[{name}]", *(f"{key} = {toml_value(value)}" for key, value in table.items())]
    return "\n".join(lines) + "\n"


def toml_value(value: Any) -> str:
    """A value as TOML writes it in one line."""
    if isinstance(value, datetime.date):
        return value.isoformat()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        # What JSON escapes TOML knows too; the one character besides that TOML refuses is DEL.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{key} = {toml_value(item)}' for key, item in value.items())} }}"
    if isinstance(value, Sequence):
        return f"[{', '.join(map(toml_value, value))}]"
    return repr(value)
