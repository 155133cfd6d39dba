"""``radwrap catalog``: sensors, lenses, lights and materials by name, and where their numbers come from."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from radwrap.cli import catalog_effects, catalog_import
from radwrap.cli import options as shared
from radwrap.errors import InputError
from radwrap.files import make_folder, write_bytes
from radwrap.manifest import SCHEMA_VERSION, json_text, plain
from radwrap.scene.catalog.component import BASES, CLASSES, Component, checked_name, content_of, leaves, read_component
from radwrap.scene.catalog.places import find, listed, user_folder
from radwrap.scene.file.component_check import Checked, check_component

_CHECK_FAILED: Final = 1


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = verbs.add_parser("catalog", description=__doc__)
    kinds: argparse._SubParsersAction[Any] = parser.add_subparsers(title="what", required=True, metavar="WHAT")
    one = kinds.add_parser(
        "list",
        help="names of all components",
        description="Shows the components' names, where they are stored and what they are.",
    )
    one.add_argument("kind", metavar="CLASS", nargs="?", choices=tuple(CLASSES), help=", ".join(CLASSES))
    _finish(one, run_list)
    one = kinds.add_parser(
        "show", help="values and sources of a component", description="Shows all that a component states."
    )
    one.add_argument("name", metavar="NAME", help="NAME or NAME@DATE; CLASS/NAME where several classes have it")
    _finish(one, run_show)
    one = kinds.add_parser(
        "check",
        help="check that each number has a source, and that totals follow from the numbers",
        description="Checks all components, or the named ones: each key has its basis and source, a scene takes "
        "all keys, published totals follow from them within rounding and 1 dB. Exit code 1 where something is wrong.",
    )
    one.add_argument("names", metavar="NAME", nargs="*", help="names or files; default all")
    _finish(one, run_check)
    one = kinds.add_parser(
        "add", help="copy a file into your catalog", description="Copies FILE.toml, after `check`, to your catalog."
    )
    one.add_argument("file", metavar="FILE.toml", help="a component; its name is the file's")
    one.add_argument("--replace", action="store_true", help="replace one of the same revision")
    _finish(one, run_add)
    catalog_import.add_to(kinds)
    catalog_effects.add_to(kinds)


def _finish(parser: argparse.ArgumentParser, run: Any) -> None:
    shared.add_json(parser)
    if run is not run_add:
        parser.add_argument("--folder", metavar="DIR", help="a scene's folder, which is searched first")
    parser.set_defaults(run=run)


def run_list(arguments: argparse.Namespace) -> int:
    """Print what there is."""
    kinds = [arguments.kind] if arguments.kind else list(CLASSES)
    found, broken = _all_of(kinds, _folder(arguments))
    if arguments.json:
        print(_json([_short(one) for one in found], problems=broken), end="")
    else:
        for one in found:
            bases = ", ".join(f"{number} {basis}" for basis, number in _bases(one).items())
            print(f"{one.kind:<10} {one.name:<40} {one.place:<8} {one.revision}  {one.title} ({bases})")
    for problem in broken:
        print(problem, file=sys.stderr)
    return _CHECK_FAILED if broken else 0


def run_show(arguments: argparse.Namespace) -> int:
    """Print a component."""
    one = _named(arguments.name, _folder(arguments))
    if arguments.json:
        print(_json([_whole(one, check_component(one))]), end="")
    else:
        print("\n".join(_lines(one)))
    return 0


def run_check(arguments: argparse.Namespace) -> int:
    """Look at components."""
    folder = _folder(arguments)
    broken: list[str] = []
    if arguments.names:
        found = [_given(name, folder) for name in arguments.names]
    else:
        found, broken = _all_of(CLASSES, folder)
    checked = [(one, check_component(one)) for one in found]
    problems = broken + [problem for _, result in checked for problem in result.problems]
    if arguments.json:
        print(_json([_whole(one, result) for one, result in checked], problems=problems), end="")
    else:
        for problem in problems:
            print(problem)
        for kind, row in _summary(found).items():
            print(f"{kind}: {row['components']} components; keys: {', '.join(f'{row[b]} {b}' for b in BASES)}")
        totals = [total for _, result in checked for total in result.totals]
        largest = max((abs(total.difference_db) for total in totals), default=0.0)
        print(f"{len(totals)} published totals recomputed, at most {largest:.2f} dB off; {len(problems)} problems")
    return _CHECK_FAILED if problems else 0


def run_add(arguments: argparse.Namespace) -> int:
    """Put a file into the user's catalog; what is there of an older revision keeps its date as a name."""
    path = Path(arguments.file)
    one = _file(path)
    if path.suffix != ".toml":
        raise InputError("does not end in .toml", where=str(path), remedy="rename it")
    checked_name(one.name, str(path))
    problems = check_component(one).problems
    if problems:
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise InputError(problems[0] + more, remedy=f"see `radwrap catalog check {path}`")
    folder = user_folder() / one.kind
    make_folder(folder)
    target = folder / f"{one.name}.toml"
    content = content_of(path, path.parent, str(path))
    if target.exists():
        old = read_component(target, user_folder(), one.kind, "user", str(target))
        if old.sha256 != one.sha256:
            if old.revision == one.revision and not arguments.replace:
                raise InputError(
                    f"exists with the revision {old.revision} and other values",
                    where=str(target),
                    remedy="give yours a new revision, or --replace",
                )
            if old.revision > one.revision:
                target = folder / f"{one.name}@{one.revision}.toml"
            elif old.revision < one.revision:
                write_bytes(folder / f"{one.name}@{old.revision}.toml", content_of(target, user_folder(), str(target)))
    write_bytes(target, content)
    print(_json([_short(one) | {"file": str(target)}]) if arguments.json else f"{target}\n", end="")
    return 0


def _folder(arguments: argparse.Namespace) -> Path | None:
    folder = Path(arguments.folder) if arguments.folder else None
    if folder is not None and not folder.is_dir():
        raise InputError("is not a folder", where=f"--folder {folder}")
    return folder


def _all_of(kinds: Iterable[str], folder: Path | None) -> tuple[list[Component], list[str]]:
    """All components of some classes, and what is wrong with files that are none."""
    found, broken = [], []
    for kind in kinds:
        seen: set[str] = set()
        for name, place, path in listed(kind, folder):
            if name in seen:  # what is hidden by an earlier place cannot be named
                continue
            seen.add(name)
            try:
                found.append(read_component(path, place.folder, kind, place.name, str(path)))
            except InputError as error:
                broken.append(str(error))
    return found, broken


def _named(text: str, folder: Path | None) -> Component:
    """The component that NAME or CLASS/NAME means."""
    kind, slash, name = text.rpartition("/")
    if slash:
        if kind not in CLASSES:
            raise InputError(f'no class "{kind}"', where="NAME", remedy=f"known: {', '.join(CLASSES)}")
        return find(kind, name, folder, "NAME")
    bare = text.partition("@")[0]
    kinds = [kind for kind in CLASSES if any(name == bare for name, _, _ in listed(kind, folder))]
    if len(kinds) > 1:
        raise InputError(f'"{text}" is in {" and in ".join(kinds)}', where="NAME", remedy=f"say {kinds[0]}/{text}")
    return find(kinds[0] if kinds else "sensors", text, folder, "NAME")


def _given(text: str, folder: Path | None) -> Component:
    return _file(Path(text)) if text.endswith(".toml") else _named(text, folder)


def _file(path: Path) -> Component:
    kind = path.parent.name if path.parent.name in CLASSES else ""
    return read_component(path, path.parent, kind, "file", str(path))


def _bases(one: Component) -> dict[str, int]:
    told = [entry.basis for entry in one.entries.values()]
    return {basis: told.count(basis) for basis in BASES if basis in told}


def _summary(found: Sequence[Component]) -> dict[str, dict[str, int]]:
    """Class -> how many components, and keys of each basis."""
    rows: dict[str, dict[str, int]] = {}
    for one in found:
        row = rows.setdefault(one.kind, {"components": 0, **dict.fromkeys(BASES, 0)})
        row["components"] += 1
        for basis, number in _bases(one).items():
            row[basis] += number
    return rows


def _short(one: Component) -> dict[str, Any]:
    return {
        "class": one.kind,
        "name": one.name,
        "title": one.title,
        "place": one.place,
        "revision": one.revision,
        "sha256": one.sha256,
        "file": str(one.path),
        "bases": _bases(one),
    }


def _whole(one: Component, checked: Checked) -> dict[str, Any]:
    catalog = {key: value for key, value in one.catalog.items() if key in ("sources", "note")}
    return _short(one) | {
        "values": dict(one.values),
        "from": {key: plain(entry) for key, entry in one.entries.items()},
        **{key: _dated(value) for key, value in catalog.items()},
        "totals": [plain(total) | {"agrees": total.agrees} for total in checked.totals],
        "problems": list(checked.problems),
    }


def _dated(value: Any) -> Any:
    """A table of TOML as JSON has it: dates are text."""
    if isinstance(value, dict):
        return {key: _dated(item) for key, item in value.items()}
    return value if isinstance(value, str | int | float | bool | list) else value.isoformat()


def _json(components: list[dict[str, Any]], **more: Any) -> str:
    return json_text({"schema_version": SCHEMA_VERSION, "components": components, **more})


def _lines(one: Component) -> Iterator[str]:
    yield f"{one.kind}/{one.name}: {one.title}"
    yield f"revision {one.revision}, {one.path} ({one.place})"
    if note := one.catalog.get("note"):
        yield f"note: {note}"
    for key, value in one.values.items():
        entry = one.entries.get(key)
        told = "" if entry is None else " ".join(filter(None, (entry.basis, entry.source, entry.where)))
        note = f"; {entry.note}" if entry is not None and entry.note else ""
        yield f"  {key} = {_value(value)}  [{told}{note}]"
    for name, source in one.catalog.get("sources", {}).items():
        yield f"source {name}: " + "; ".join(f"{key} {item}" for key, item in leaves(source))


def _value(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{key} = {_value(item)}' for key, item in value.items())} }}"
    return f'"{value}"' if isinstance(value, str) else str(value)
