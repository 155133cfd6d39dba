"""What is wrong with the tables of a file, in the user's words: the file, the key, what it must hold there instead."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from types import UnionType
from typing import Annotated, Any, Final, Literal, TypeVar, Union, get_args, get_origin

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from radwrap.errors import InputError
from radwrap.nearest import did_you_mean
from radwrap.scene.file.border import TERM_NUMBER, Model
from radwrap.units import dimension_of

AnyModel = TypeVar("AnyModel", bound=Model)

# What pydantic calls a wrong kind of value, and what the file must hold there instead.
_WRONG_KINDS: Final = {
    "model_type": "a table",
    "model_attributes_type": "a table",
    "dict_type": "a table",
    "tuple_type": "an array",
    "string_type": "a string",
    "int_type": "an integer",
    "int_from_float": "an integer",
    "float_type": "a number",
    "bool_type": "true or false",
}
_NAMES: Final[Mapping[type, str]] = {dict: "a table", list: "an array"}
_UNKNOWN: Final = "unknown key"


def validated(shape: type[AnyModel], table: Mapping[str, Any], origin: str, remedy: str = "") -> AnyModel:
    """Tables as a model, which need not be a scene's.

    Parameters
    ----------
    shape : type
        The model.
    table : Mapping
        As `read_toml` gave it.
    origin : str
        File, for messages.
    remedy : str
        Where to see what belongs there.

    Raises
    ------
    InputError
        What is wrong first, with file and key.
    """
    try:
        return shape.model_validate(table)
    except ValidationError as error:
        found = fault(error, origin, table, shape)
        raise InputError(found.what, where=found.where, remedy=found.remedy or remedy) from error


def _known(shape: Any, steps: Sequence[int | str]) -> tuple[str, ...]:
    """Keys of the table in which the last step is unknown; steps are pydantic's, with the tags of alternatives."""
    shapes = _alternatives(shape)
    for step in steps[:-1]:
        inside = [one for shape in shapes for one in _inside(shape, step)]
        shapes = inside or [shape for shape in shapes if _is_tagged(shape, step)] or shapes
    return tuple(dict.fromkeys(key for shape in shapes if _is_table(shape) for key in shape.model_fields))


def _is_table(shape: Any) -> bool:
    return isinstance(shape, type) and issubclass(shape, Model)


def _alternatives(shape: Any) -> list[Any]:
    """Tables, arrays and the like that an annotation allows."""
    if _is_table(shape):
        return [shape]
    origin = get_origin(shape)
    if origin is Annotated:
        return _alternatives(get_args(shape)[0])
    if origin in (Union, UnionType):
        return [one for part in get_args(shape) for one in _alternatives(part)]
    return [shape] if origin in (tuple, list, dict) else []


def _inside(shape: Any, step: int | str) -> list[Any]:
    """What may stand at a key of a table, or an entry of an array."""
    if _is_table(shape):
        return _alternatives(shape.model_fields[step].annotation) if step in shape.model_fields else []
    parts = get_args(shape)
    return _alternatives(parts[-1] if get_origin(shape) is dict else parts[0])


def _is_tagged(shape: Any, tag: int | str) -> bool:
    """Whether it is the alternative of a tag: a table one of whose keys can hold nothing else."""
    return _is_table(shape) and any(
        tag in get_args(one)
        for field in shape.model_fields.values()
        for one in (field.annotation, *get_args(field.annotation))
        if get_origin(one) is Literal
    )


def _steps(detail: ErrorDetails, document: Any) -> list[int | str]:
    """Where in the file a detail is; the names of alternatives, which pydantic adds, are left out."""
    steps: list[int | str] = []
    way = list(detail["loc"])
    missing = [way.pop()] if detail["type"] == "missing" else []
    for step in way:
        if not isinstance(document, dict) or step in document:
            steps.append(step)
            document = _written(document, [step])
    steps += missing
    if detail["type"] in ("union_tag_invalid", "union_tag_not_found"):
        key = detail["ctx"]["discriminator"].strip("'")
        steps.append(key if key.isidentifier() else "model")  # a sensor's is told by a function
    return steps


def fault(error: ValidationError, origin: str, document: Mapping[str, Any], shape: type[Model]) -> InputError:
    """One line for the first thing that is wrong, in the user's words.

    Parameters
    ----------
    error : ValidationError
        What pydantic says.
    origin : str
        File.
    document : Mapping
        Its tables.
    shape : type
        The model of the whole.
    """
    details = error.errors(include_url=False)
    # An entry that is wrong is not counted, so that its array may seem too short.
    wrong = [detail["loc"] for detail in details]
    details = [
        detail
        for detail in details
        if detail["type"] != "too_short"
        or not any(len(loc) > len(detail["loc"]) and loc[: len(detail["loc"])] == detail["loc"] for loc in wrong)
    ]
    # An unknown key often explains the missing one beside it, so it is told first.
    details.sort(key=lambda detail: detail["type"] != "extra_forbidden")
    first = details[0]
    more = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
    steps = _steps(first, document)
    what = _message(first, _written(document, steps)) + more
    return InputError(what, where=f"{origin}: {_key_path(steps)}", remedy=_remedy(first, shape, document))


def _remedy(detail: ErrorDetails, shape: type[Model], document: Mapping[str, Any]) -> str:
    """For a name that there is not: the one that may have been meant, else those that there are."""
    context: Mapping[str, Any] = detail.get("ctx", {})
    match detail["type"]:
        case "extra_forbidden":
            known = _known(shape, detail["loc"])
            return did_you_mean(detail["loc"][-1], known) or (f"known are {', '.join(known)}" if known else "")
        case "literal_error" | "union_tag_invalid":
            allowed = str(context.get("expected", context.get("expected_tags", "")))
            return did_you_mean(context.get("tag", detail["input"]), re.findall(r"'([^']+)'", allowed))
        case "union_tag_not_found":
            # A key path makes the tables on its way, and so one of a misspelt material.
            *way, name = detail["loc"]
            beside = _written(document, way)
            meant = did_you_mean(name, beside.keys() - {name}) if isinstance(beside, Mapping) else ""
            return f'give "{name}" one; {meant}' if meant else ""
    return ""


def _key_path(steps: Iterable[int | str]) -> str:
    """Key path as messages write it."""
    path = ""
    for step in steps:
        path += f"[{step}]" if isinstance(step, int) else f".{step}" if path else step
    return path or "the file"


def _written(document: Any, steps: Iterable[int | str]) -> Any:
    """What stands at a place of the file, None where nothing does: pydantic tells of what it became."""
    for step in steps:
        try:
            document = document[step]
        except (KeyError, IndexError, TypeError):
            return None
    return document


def _limit(limit: float, given: Any) -> str:
    """A limit of a quantity, which is in SI, in the unit that its value was written with."""
    dimension = dimension_of(given)
    if dimension is None:
        return f"{limit:g}" + (" (in SI units)" if isinstance(given, str) else "")
    unit = given.partition(" ")[2]
    return f"{limit / dimension.units[unit]:g} {unit}"


def _message(detail: ErrorDetails, written: Any) -> str:
    context: Mapping[str, Any] = detail.get("ctx", {})
    kind = detail["type"]
    given = detail["input"] if written is None else written
    shown = f"{given!r}" if isinstance(given, str | bool | int | float) else _NAMES.get(type(given), "that")
    if kind in _WRONG_KINDS:
        return f"must be {_WRONG_KINDS[kind]}, not {shown}"
    match kind:
        case "extra_forbidden":
            return _UNKNOWN
        case "missing":
            return "is missing"
        case "value_error":
            return str(context["error"])
        case "greater_than":
            return f"must be above {_limit(context['gt'], given)}, not {shown}"
        case "greater_than_equal":
            return f"must be at least {_limit(context['ge'], given)}, not {shown}"
        case "less_than_equal":
            return f"must be at most {_limit(context['le'], given)}, not {shown}"
        case "too_short":
            return f"must have at least {context['min_length']} entries, not {context['actual_length']}"
        case "too_long":
            return f"must have at most {context['max_length']} entries, not {context['actual_length']}"
        case "literal_error" | "union_tag_invalid":
            return (
                f"{context.get('tag', given)!r} is not one of {context.get('expected', context.get('expected_tags'))}"
            )
        case "union_tag_not_found":
            return "is missing"
        case "string_pattern_mismatch" if context.get("pattern") == TERM_NUMBER:
            return f"{given!r} is not the number of a polynomial"
        case "string_pattern_mismatch":
            return f"{given!r} is not a name: a letter, then letters, digits, _ or -, at most 64"
        case "finite_number":
            return "is not a finite number"
    return f"{detail['msg'][0].lower()}{detail['msg'][1:]}"
