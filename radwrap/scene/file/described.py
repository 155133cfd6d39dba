"""The JSON schema of a scene file, with what the models say of each key in the line below it."""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

from radwrap.scene.file.border import Model
from radwrap.scene.file.document import SceneModel

_Bodies = Mapping[str, Sequence[ast.stmt]]


def described_schema() -> dict[str, Any]:
    """The schema, each key with one line: what it is, and the units that it may have."""
    schema = SceneModel.model_json_schema()
    models = list(_models(Model))
    bodies = {name: _class_bodies(name) for name in {model.__module__ for model in models}}
    _describe(schema, SceneModel, bodies)
    for name, model in {model.__name__: model for model in models}.items():
        if name in schema["$defs"]:
            _describe(schema["$defs"][name], model, bodies)
    return schema


def _models(base: type[Model]) -> Iterator[type[Model]]:
    for model in base.__subclasses__():
        yield model
        yield from _models(model)


def _class_bodies(module: str) -> _Bodies:
    """Statements of each class of a module; a module is read once for all of its classes, which takes longest."""
    parsed = ast.parse(inspect.getsource(sys.modules[module]))
    return {statement.name: statement.body for statement in parsed.body if isinstance(statement, ast.ClassDef)}


def _describe(table: Mapping[str, Any], model: type[Model], bodies: Mapping[str, _Bodies]) -> None:
    lines = _lines_of(model, bodies)
    for key, rule in table["properties"].items():
        told = [lines.get(key, ""), *dict.fromkeys(_units(rule))]
        rule["description"] = " ".join(part for part in told if part)


def _lines_of(model: type[Model], bodies: Mapping[str, _Bodies]) -> dict[str, str]:
    """Field -> the string below it, those of the classes that a model is made of included."""
    found: dict[str, str] = {}
    for part in reversed(model.__mro__):
        if issubclass(part, Model) and part is not Model:
            found |= _own_lines(bodies[part.__module__][part.__name__])
    return found


def _own_lines(body: Sequence[ast.stmt]) -> dict[str, str]:
    found = {}
    for field, below in pairwise(body):
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
