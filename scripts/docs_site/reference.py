"""Pages of the reference that follow from the code: the command line and the keys of scene files."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator, Mapping
from typing import Any, Final

_WIDE: Final = re.compile(r"\s+")
# How the schema says what a text with a unit looks like; the page has one table of all units.
_QUANTITY: Final = re.compile(r"(?:^|(?<=\s))([A-Z][\w ]*): one number, one blank, one unit of ([^.]+)\.$")
_INDEX: Final = """# Keys of a scene file

A scene is a TOML file. These are its parts, each with all of its keys. `radwrap schema` prints the same as a JSON
schema, from which editors complete and check scene files.

A key that is not in these tables is an error that names it, and so is a number where a quantity with a unit is due.
Keys are `required`, have the default that the table gives, or may be left out. Of some only one is given, as the text
says.

| key | what it is |
|---|---|
{parts}

## Quantities and their units

A quantity is text: one number, one blank, one unit, such as `"12.5 mm"`.

| quantity | units |
|---|---|
{units}

```{{toctree}}
:hidden:

{toc}
```
"""


def verb_pages(parser: argparse.ArgumentParser) -> Iterator[tuple[str, str]]:
    """Name and MyST text of a page for each verb, with the verbs below it."""
    for name, verb in _verbs(parser).items():
        yield name, "\n".join(_sections(f"radwrap {name}", verb, 1)) + "\n"


def _verbs(parser: argparse.ArgumentParser) -> Mapping[str, argparse.ArgumentParser]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return dict(action.choices)
    return {}


def _sections(name: str, parser: argparse.ArgumentParser, level: int) -> Iterator[str]:
    """Lines of a verb under a heading of a level, and of all verbs below it."""
    yield from (
        f"{'#' * level} {name}",
        "",
        "```text",
        parser.format_usage().removeprefix("usage: ").rstrip(),
        "```",
        "",
    )
    if parser.description:
        yield from (_plain(parser.description.replace("``", "`")), "")
    rows = [action for action in parser._actions if not isinstance(action, argparse._SubParsersAction)]
    if rows:
        yield from ("| argument | what it does |", "|---|---|")
        for action in rows:
            yield f"| {_names(parser, action)} | {_help(parser, action)} |"
    for below, verb in _verbs(parser).items():
        yield ""
        yield from _sections(f"{name} {below}", verb, level + 1)


def _names(parser: argparse.ArgumentParser, action: argparse.Action) -> str:
    names = action.option_strings
    value = parser._get_formatter()._format_args(action, action.dest.upper()) if action.nargs != 0 else ""
    told = [f"{name} {value}".strip() for name in names] if names else [value]
    return ", ".join(f"`{name}`" for name in told).replace("|", "\\|")


def _help(parser: argparse.ArgumentParser, action: argparse.Action) -> str:
    return _plain(parser._get_formatter()._expand_help(action)) if action.help else ""


def _plain(text: str) -> str:
    """Text as MyST shows it as it stands: a name between asterisks or underscores is not emphasised."""
    return re.sub(r"(?<!\\)([*_|<>\[\]$])", r"\\\1", _WIDE.sub(" ", text)).replace("``", "`")


def scene_pages(schema: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Name and MyST text of a page for each part of a scene file, first that of all parts."""
    tables, homes = schema["$defs"], _homes(schema)
    parts = "\n".join(
        f"| {f'[`{key}`]({key}.md)' if key in homes else f'`{key}`'} | {_plain(value['description'])} |"
        for key, value in schema["properties"].items()
    )
    units = "\n".join(f"| {name} | {_plain(told)} |" for name, told in sorted(_units(tables).items()))
    yield "index", _INDEX.format(parts=parts, units=units, toc="\n".join(homes))
    for page, names in homes.items():
        lines = [f"# Keys of a scene: {page}", ""]
        for name in names:
            lines += [f"({_label(name)})=", f"## {_title(name, tables[name])}", ""]
            lines += [_described(tables[name]), "", *_table(tables[name]), ""]
        yield page, "\n".join(lines)


def _units(tables: Mapping[str, Any]) -> dict[str, str]:
    """Units of each quantity that any key takes."""
    told = (one.get("description", "") for table in tables.values() for one in table.get("properties", {}).values())
    return {found[1].lower(): found[2] for text in told if (found := _QUANTITY.search(text))}


def _homes(schema: Mapping[str, Any]) -> dict[str, list[str]]:
    """Tables of each part: a table stands where it is reached first."""
    homes: dict[str, list[str]] = {}
    seen: set[str] = set()
    for key, value in schema["properties"].items():
        ahead = _named(value)
        while ahead:
            name = ahead.pop(0)
            if name not in seen:
                seen.add(name)
                homes.setdefault(key, []).append(name)
                ahead += _named(schema["$defs"][name])
    return homes


def _named(value: Any) -> list[str]:
    """Tables that a part of the schema names, in order."""
    match value:
        case {"$ref": str(path)}:
            return [path.rsplit("/", 1)[-1]]
        case dict():
            return list(dict.fromkeys(name for one in value.values() for name in _named(one)))
        case list():
            return list(dict.fromkeys(name for one in value for name in _named(one)))
    return []


def _title(name: str, table: Mapping[str, Any]) -> str:
    told = str(table.get("description", "")).split(". ")[0].rstrip(".")
    return _plain(told) if told.startswith("[") else f"{_words(name)}: {_plain(told)}" if told else _words(name)


def _words(name: str) -> str:
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name.removesuffix("Model")).lower()


def _described(table: Mapping[str, Any]) -> str:
    return _plain(". ".join(str(table.get("description", "")).split(". ")[1:]))


def _label(name: str) -> str:
    return f"keys-{name.lower()}"


def _table(table: Mapping[str, Any]) -> Iterator[str]:
    yield from ("| key | value | default | what it is |", "|---|---|---|---|")
    for key, value in table.get("properties", {}).items():
        text = value.get("description", "")
        quantity, kind = _QUANTITY.search(text), _value(value)
        if quantity:
            text, kind = _QUANTITY.sub("", text).strip(), kind.replace("quantity", quantity[1].lower())
            kind = f"list, each one {quantity[1].lower()}" if kind == "list" else kind
        default = "required" if key in table.get("required", []) else _default(value) or "optional"
        yield f"| `{key}` | {kind} | {default} | {_plain(text)} |"


def _default(value: Mapping[str, Any]) -> str:
    default = value.get("default")
    return "" if default is None else f"`{_toml(default)}`".replace("|", "\\|")


def _toml(value: Any) -> str:
    match value:
        case bool():
            return str(value).lower()
        case str():
            return f'"{value}"'
        case list():
            return f"[{', '.join(map(_toml, value))}]"
        case dict():
            return "{" + ", ".join(f"{key} = {_toml(one)}" for key, one in value.items()) + "}"
    return str(value)


def _value(value: Mapping[str, Any]) -> str:
    """What a key takes, in a word or two; tables are linked."""
    match value:
        case {"$ref": str(path)}:
            name = path.rsplit("/", 1)[-1]
            return f"[{_words(name)}](#{_label(name)})"
        case {"anyOf": list(ways)} | {"oneOf": list(ways)}:
            told = dict.fromkeys(_value(way) for way in ways if way.get("type") != "null")
            return " or ".join(told)
        case {"const": one}:
            return f"`{_toml(one)}`"
        case {"enum": list(names)}:
            return ", ".join(f"`{_toml(name)}`" for name in names)
        case {"type": "array", "items": dict(item)}:
            return f"list of {_value(item)}"
        case {"type": "array"}:
            return "list"
        case {"type": "object", "additionalProperties": dict(item)}:
            return f"table of {_value(item)}"
        case {"type": "string", "pattern": str(pattern)}:
            return "quantity" if "[0-9]" in pattern else "text"
        case {"type": str(name)}:
            return {"string": "text", "integer": "whole number", "boolean": "true or false", "object": "table"}.get(
                name, name
            )
    return "any"
