"""``radwrap init`` and ``radwrap schema``: a scene to start from, and what a scene may hold."""

from __future__ import annotations

import argparse
from importlib.resources import files
from pathlib import Path
from typing import Any

from radwrap.errors import InputError
from radwrap.files import make_folder, write_bytes
from radwrap.manifest import json_text
from radwrap.scene.file.document import SceneModel


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verbs."""
    init = verbs.add_parser("init", description="Writes DIR/scene.toml.")
    init.add_argument("folder", metavar="DIR", help="folder for the scene")
    init.set_defaults(run=run_init)
    schema = verbs.add_parser("schema", description="Editors complete scene files from it.")
    schema.add_argument("--json", action="store_true", help="accepted for uniformity: the schema always is JSON")
    schema.set_defaults(run=run_schema)


def run_init(arguments: argparse.Namespace) -> int:
    """Write the starting scene, never over an existing one."""
    if not arguments.folder:
        raise InputError("has no name", where="DIR", remedy='name a folder; "." is this one')
    folder = Path(arguments.folder)
    make_folder(folder)
    path = folder / "scene.toml"
    if path.exists():
        raise InputError("is there already", where=str(path), remedy="choose another folder")
    write_bytes(path, (files("radwrap") / "data" / "init" / "scene.toml").read_bytes())
    print(f"{path}\nrender it: radwrap render {path} --out {folder / 'out'}")
    return 0


def run_schema(_: argparse.Namespace) -> int:
    """Print the schema."""
    print(json_text(SceneModel.model_json_schema()), end="")
    return 0
