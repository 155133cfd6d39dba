"""The JSON schema of a scene file, with what the models say of each key in the line below it."""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

from radwrap.scene.file.border import Model
from radwrap.scene.file.document import SceneModel


def described_schema() -> dict[str, Any]:
    """The schema, each key with one line: what it is, and the units that it may have."""
    schema = SceneModel.model_json_schema()
    _describe(schema, SceneModel)
    for name, model in {model.__name__: model for model in _models(Model)}.items():
        if name in schema["$defs"]:
            _describe(schema["$defs"][name], model)
    return schema


def _models(base: type[Model]) -> Iterator[type[Model]]:
    for model in base.__subclasses__():
        yield model
        yield from _models(model)


def _describe(table: Mapping[str, Any], model: type[Model]) -> None:
    lines = _lines_of(model)
    for key, rule in table["properties"].items():
        told = [lines.get(key, ""), *dict.fromkeys(_units(rule))]
        rule["description"] = " ".join(part for part in told if part)


def _lines_of(model: type[Model]) -> dict[str, str]:
    """Field -> the string below it, those of the classes that a model is made of included."""
    found: dict[str, str] = {}
    for part in reversed(model.__mro__):
        if issubclass(part, Model):
            found |= _own_lines(part)
    return found


def _own_lines(model: type[Model]) -> dict[str, str]:
    body = ast.parse(textwrap.dedent(inspect.getsource(model))).body[0]
    found = {}
    statements = body.body if isinstance(body, ast.ClassDef) else []
    for field, below in pairwise(statements):
        if not (isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)):
            continue
        if isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant) and isinstance(below.value.value, str):
            found[field.target.id] = below.value.value
    return found


def _units(rule: Any) -> Iterator[str]:
    """What the types of a key's values say of their units."""
    if isinstance(rule, list):
        for part in rule:
            yield from _units(part)
    elif isinstance(rule, dict):
        if isinstance(rule.get("description"), str):
            text = rule["description"]
            yield text[:1].upper() + text[1:] + ("" if text.endswith(".") else ".")
            return
        for key in ("anyOf", "prefixItems", "items"):
            yield from _units(rule.get(key))
