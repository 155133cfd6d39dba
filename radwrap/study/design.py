"""A study as a user writes it: DESIGN.toml to frozen values, everything checked that can be checked without a ray.

Errors name the file and the key, such as ``design.toml: factors.A.levels[1]``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final, Literal

from radwrap.errors import InputError
from radwrap.imaging.render_options import RenderOptions
from radwrap.reading import FileKind, read_toml
from radwrap.scene.file.load import load_scene
from radwrap.study.factors import Factor, Level, quantity, read_draw, with_all_leds
from radwrap.study.responses import KINDS, Response, check_options, unit_of

Kind = Literal["full", "fractional", "latin_hypercube", "list"]
Analysis = Literal["lenth", "anova", "none"]

_TOP: Final = ("title", "scene", "set", "seed", "replicates", "design", "render", "factors", "responses", "analysis")
_OF_KIND: Final[Mapping[str, tuple[str, ...]]] = {
    "full": (),
    "fractional": ("generators",),
    "latin_hypercube": ("runs",),
    "list": ("runs",),
}
# Options of a render that a study may name, and the types they have.
_RENDER: Final[Mapping[str, type | tuple[type, ...]]] = {
    "method": str,
    "tolerance": (int, float),
    "max_error": (int, float),
    "budget_rays": (int, float),
    "viewpoints": int,
    "layout": str,
    "pixel_samples": int,
    "pixel_sampling": str,
    "max_pixels": int,
}
_CHOICES: Final[Mapping[str, tuple[str, ...]]] = {
    "method": ("pinhole", "viewpoints", "kernel", "rays"),
    "layout": ("rings", "hexagonal", "sunflower", "uneven"),
    "pixel_sampling": ("centre", "jitter"),
}
_DESIGN_FILE: Final = FileKind("design file", 64 << 20)
_LARGEST_SEED: Final = 2**32 - 1
MOST_RUNS: Final = 1_000_000


@dataclass(frozen=True, slots=True)
class Design:
    """A study, checked.

    Attributes
    ----------
    title : str
        For people.
    origin : str
        File it was read from, for messages.
    folder : Path
        Of the base scene, against which its files are resolved.
    scene_origin : str
        Name of the base scene's file.
    document : Mapping
        Tables of the base scene, with what ``[set]`` changes, and every LED listed where a factor names LEDs.
    seed : int
        Of all that is drawn; replicate r renders with seed + r.
    replicates : int
        How often the whole design is run.
    kind : str
        "full", "fractional", "latin_hypercube" or "list".
    plan : Mapping
        Options of the kind.
    render : Mapping
        Options of `RenderOptions`.
    basis : bool or None
        Whether runs that differ only in the levels of sources are made from a light basis; None: where it pays.
    factors : tuple of Factor
    responses : tuple of Response
    analysis : str
        "lenth", "anova" or "none".
    """

    title: str
    origin: str
    folder: Path
    scene_origin: str
    document: Mapping[str, Any]
    seed: int
    replicates: int
    kind: Kind
    plan: Mapping[str, Any]
    render: Mapping[str, Any]
    basis: bool | None
    factors: tuple[Factor, ...]
    responses: tuple[Response, ...]
    analysis: Analysis | None


def read_design(path: Path) -> Design:
    """Read a design file and its base scene.

    Raises
    ------
    InputError
        What is wrong, with file and key.
    """
    table = read_toml(path, _DESIGN_FILE)
    origin = path.name
    _only(table, _TOP, origin)
    for key in ("scene", "design", "factors", "responses"):
        if key not in table:
            raise InputError("is missing", where=f"{origin}: {key}")
    scene_path = path.parent / _text(table["scene"], f"{origin}: scene")
    scene = load_scene(scene_path, _table(table.get("set", {}), f"{origin}: set"))
    kind, plan = _plan(_table(table["design"], f"{origin}: design"), f"{origin}: design")
    responses = _responses(_table(table["responses"], f"{origin}: responses"), f"{origin}: responses")
    factors = _factors(_table(table["factors"], f"{origin}: factors"), kind, f"{origin}: factors")
    _check_names(factors, responses, origin)
    render, basis = _render(_table(table.get("render", {}), f"{origin}: render"), f"{origin}: render")
    analysis = table.get("analysis")
    if analysis not in (None, "lenth", "anova", "none"):
        raise InputError('must be "lenth", "anova" or "none"', where=f"{origin}: analysis")
    return Design(
        title=_text(table.get("title", path.stem), f"{origin}: title"),
        origin=origin,
        folder=scene.folder,
        scene_origin=scene.origin,
        document=with_all_leds(json.loads(scene.document), [key for factor in factors for key in factor.keys]),
        seed=_count(table.get("seed", 0), f"{origin}: seed", 0, _LARGEST_SEED),
        replicates=_count(table.get("replicates", 1), f"{origin}: replicates", 1, MOST_RUNS),
        kind=kind,
        plan=_with_file(plan, path.parent, factors, f"{origin}: design.runs"),
        render=render,
        basis=basis,
        factors=factors,
        responses=responses,
        analysis=analysis,
    )


# ---------------------------------------------------------------------------------------------------------- the design


def _plan(table: Mapping[str, Any], where: str) -> tuple[Kind, Mapping[str, Any]]:
    kind: Any = table.get("kind")
    if not isinstance(table.get("kind"), str) or kind not in _OF_KIND:
        raise InputError(f"must be one of {', '.join(_OF_KIND)}", where=f"{where}.kind")
    _only(table, ("kind", *_OF_KIND[kind]), where)
    for key in _OF_KIND[kind]:
        if key not in table:
            raise InputError(f"is missing, {kind} needs it", where=f"{where}.{key}")
    if kind == "latin_hypercube":
        _count(table["runs"], f"{where}.runs", 2, MOST_RUNS)
    if kind == "fractional":
        _text(table["generators"], f"{where}.generators")
    return kind, {key: table[key] for key in _OF_KIND[kind]}


def _with_file(plan: Mapping[str, Any], folder: Path, factors: tuple[Factor, ...], where: str) -> Mapping[str, Any]:
    """The runs of a list, also where they stand in a CSV file."""
    runs = plan.get("runs")
    if not isinstance(runs, str):
        return plan
    from radwrap.study.table import read_table

    table = read_table(folder / runs)
    names = [factor.name for factor in factors]
    if sorted(table.columns) != sorted(names):
        raise InputError(f"its columns must be {', '.join(names)}", where=where)
    return {"runs": [[row[name] for name in names] for row in table.rows]}


# --------------------------------------------------------------------------------------------------------- the factors


def _factors(tables: Mapping[str, Any], kind: Kind, where: str) -> tuple[Factor, ...]:
    if not tables:
        raise InputError("there is none", where=where)
    return tuple(
        _factor(name, _table(table, f"{where}.{name}"), kind, f"{where}.{name}") for name, table in tables.items()
    )


def _factor(name: str, table: Mapping[str, Any], kind: Kind, where: str) -> Factor:
    _only(table, ("label", "key", "keys", "levels", "range", "draws"), where)
    if ("key" in table) == ("keys" in table):
        raise InputError("needs exactly one of key and keys", where=where)
    keys = table["keys"] if "keys" in table else [table["key"]]
    if not isinstance(keys, list) or not keys or not all(isinstance(key, str) and key for key in keys):
        raise InputError("must be an array of key paths", where=f"{where}.keys")
    if ("levels" in table) == ("range" in table):
        raise InputError("needs exactly one of levels and range", where=where)
    draws = table.get("draws", "each run")
    if draws not in ("each run", "once"):
        raise InputError('must be "each run" or "once"', where=f"{where}.draws")
    label = _text(table.get("label", name), f"{where}.label")
    if "range" in table:
        if kind != "latin_hypercube":
            raise InputError(f"{kind} needs levels", where=f"{where}.range", remedy='or kind = "latin_hypercube"')
        span, unit = _range(table["range"], f"{where}.range")
        return Factor(name, label, tuple(keys), (), span, unit)
    if kind == "latin_hypercube":
        raise InputError('latin_hypercube needs range = ["LOW", "HIGH"]', where=where)
    levels = _levels(table["levels"], len(keys), f"{where}.levels", is_list="keys" in table)
    return Factor(name, label, tuple(keys), levels, draw_once=draws == "once")


def _range(pair: Any, where: str) -> tuple[tuple[float, float], str]:
    ends = [quantity(value, where) for value in pair] if isinstance(pair, list) and len(pair) == 2 else [None]
    if ends[0] is None or ends[-1] is None or ends[0][1] != ends[-1][1] or not ends[0][0] < ends[-1][0]:
        raise InputError("must be two numbers or quantities of the same unit, the lower first", where=where)
    return (ends[0][0], ends[-1][0]), ends[0][1]


def _levels(given: Any, keys: int, where: str, *, is_list: bool) -> tuple[Level, ...]:
    named: list[tuple[str, Any, str]]
    if isinstance(given, dict):
        named = [(name, value, f"{where}.{name}") for name, value in given.items()]
    elif isinstance(given, list):
        names = _names_of(given)
        named = [(name, value, f"{where}[{i}]") for i, (name, value) in enumerate(zip(names, given, strict=True))]
    else:
        raise InputError("must be an array, or a table of named levels", where=where)
    if len(named) < 2 or len({name for name, _, _ in named}) < len(named):
        raise InputError("needs two or more different levels", where=where)
    for name, _, place in named:
        # A table of results gives names back without blanks around them, and a row is one line.
        if not name or name != name.strip() or not name.isprintable():
            raise InputError(f"{name!r} cannot name a level", where=place, remedy="name it by printable text")
    return tuple(Level(name, _values(value, keys, place, is_list=is_list)) for name, value, place in named)


def _names_of(values: list[Any]) -> list[str]:
    """Levels as tables name them: by their value, where that is short, else L and H, or their number."""
    if all(isinstance(value, str | int | float) for value in values):
        return [str(value) for value in values]
    return ["L", "H"] if len(values) == 2 else [str(number) for number in range(1, len(values) + 1)]


def _values(value: Any, keys: int, where: str, *, is_list: bool) -> tuple[Any, ...]:
    given = value if is_list else [value]
    if not isinstance(given, list) or len(given) != keys:
        raise InputError(f"needs a value for each of the {keys} keys", where=where)
    return tuple(read_draw(item, where) if isinstance(item, dict) else item for item in given)


# -------------------------------------------------------------------------------------------- the rest of what is asked


def _responses(tables: Mapping[str, Any], where: str) -> tuple[Response, ...]:
    if not tables:
        raise InputError("there is none", where=where)
    found = []
    for name, given in tables.items():
        place = f"{where}.{name}"
        table = dict(_table(given, place))
        kind = table.pop("measure", None)
        if not isinstance(kind, str) or kind not in KINDS:
            raise InputError(f"must be one of {', '.join(KINDS)}", where=f"{place}.measure")
        unit = table.pop("unit", None)
        check_options(kind, table, place)
        found.append(Response(name, kind, unit_of(kind, unit, f"{place}.unit"), table))
    return tuple(found)


def _check_names(factors: tuple[Factor, ...], responses: tuple[Response, ...], origin: str) -> None:
    """Names become columns of a table, and letters of interactions."""
    names = [factor.name for factor in factors] + [response.name for response in responses]
    taken = {"run", "replicate", "seed", "error", "met", "image_error"}
    errors = {f"{response.name}_error": response.name for response in responses}
    for name in names:
        if not name.isidentifier() or name in taken or names.count(name) > 1:
            raise InputError(
                "cannot name a column", where=f"{origin}: {name}", remedy="use letters, digits and _, each name once"
            )
        if name in errors:
            raise InputError(
                f"is the name of a column already: the error of {errors[name]}",
                where=f"{origin}: {name}",
                remedy="choose another",
            )


def _render(table: Mapping[str, Any], where: str) -> tuple[Mapping[str, Any], bool | None]:
    _only(table, (*_RENDER, "basis"), where)
    basis = table.get("basis")
    if basis is not None and not isinstance(basis, bool):
        raise InputError("must be true or false", where=f"{where}.basis")
    options = {key: value for key, value in table.items() if key != "basis"}
    for key, value in options.items():
        check_render_option(key, value, f"{where}.{key}")
    render_options(options, where)
    return options, basis


def check_render_option(key: str, value: Any, where: str) -> None:
    """Refuse what is no option of a render, or of the wrong type."""
    if key not in _RENDER:
        raise InputError("unknown option", where=where, remedy=f"known are {', '.join(_RENDER)}")
    if not isinstance(value, _RENDER[key]) or isinstance(value, bool):
        raise InputError(f"{value!r} is of the wrong type", where=where)
    if key in _CHOICES and value not in _CHOICES[key]:
        raise InputError(f"{value!r} is not one of {', '.join(_CHOICES[key])}", where=where)
    if isinstance(value, float) and not math.isfinite(value):
        raise InputError("is not a finite number", where=where)


def render_options(options: Mapping[str, Any], where: str, **more: Any) -> RenderOptions:
    """Options of a render; raises InputError with the place in the design file."""
    known = {entry.name for entry in fields(RenderOptions)}
    assert known >= set(options)  # noqa: S101  (checked one by one)
    try:
        return RenderOptions(**options, **more)
    except InputError as error:
        raise InputError(error.what, where=f"{where}.{error.where}") from error


def _only(table: Mapping[str, Any], known: tuple[str, ...], where: str) -> None:
    for key in table:
        if key not in known:
            raise InputError(
                "unknown key",
                where=f"{where}: {key}" if ":" not in where else f"{where}.{key}",
                remedy=(f"known are {', '.join(known)}"),
            )


def _table(value: Any, where: str) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise InputError("must be a table", where=where)
    return value


def _text(value: Any, where: str) -> str:
    if not isinstance(value, str) or not value:
        raise InputError("must be a string", where=where)
    return value


def _count(value: Any, where: str, low: int, high: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise InputError(f"must be a whole number from {low} to {high}, not {value!r}", where=where)
    return value
