"""``radwrap init`` and ``radwrap schema``: a scene to start from, and what a scene may hold."""

from __future__ import annotations

import argparse
import re
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from radwrap.cli import init_examples, init_from_catalog
from radwrap.errors import InputError
from radwrap.files import write_new
from radwrap.manifest import json_text
from radwrap.scene.file.described import described_schema

_SCENE: Final = "scene.toml"
_PAPER: Final = "retro"
TEMPLATES: Final = ("ring", "dome", "backlight", "darkfield", "coaxial", "calibration", _PAPER)


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verbs."""
    init = verbs.add_parser("init", description="Writes DIR/scene.toml.")
    init.add_argument("out", metavar="DIR", nargs="?", help="folder for the scene")
    init.add_argument(
        "--template",
        choices=TEMPLATES,
        help="what to start from: a part under a ring of LEDs, under a dome, before a backlight, in a dark field, in "
        "coaxial light, a calibration board (all with a lens and a linear sensor), or the paper's retroreflective "
        "board behind a pinhole (default)",
    )
    init.add_argument("--example", metavar="NAME", help="an example of the documentation, see --list")
    init.add_argument("--list", action="store_true", help="name all templates and examples, and write nothing")
    init_from_catalog.add_options(init)
    init.set_defaults(run=run_init)
    schema = verbs.add_parser("schema", description="Editors complete scene files from it.")
    schema.add_argument("--json", action="store_true", help="accepted for uniformity: the schema always is JSON")
    schema.set_defaults(run=run_schema)


def run_init(arguments: argparse.Namespace) -> int:
    """Write the starting scene, never over an existing one."""
    if arguments.list:
        return _list(arguments)
    if not arguments.out:
        raise InputError("has no name", where="DIR", remedy='name a folder; "." is this one')
    folder = Path(arguments.out)
    if init_from_catalog.is_asked(arguments):
        path, assumed = init_from_catalog.write_scene(arguments, folder)
        for line in assumed:
            print(f"assumed: {line}")
        _tell_next(path, folder, look=True, plane=init_from_catalog.has_mosaic(arguments))
        return 0
    if arguments.example is not None:
        return _write_example(arguments, folder)
    write_new(folder, _files_of(arguments.template or _PAPER))
    _tell_next(folder / _SCENE, folder, look=arguments.template not in (None, _PAPER))
    return 0


def _list(arguments: argparse.Namespace) -> int:
    """Names for --template and --example."""
    if arguments.out:
        raise InputError("goes without DIR", where="--list", remedy="leave one of them out")
    print("templates:")
    for name in TEMPLATES:
        print(f"  {name}")
    print("examples:")
    known = init_examples.names()
    width = max(map(len, known))
    for name, title in known.items():
        print(f"  {name:{width}}  {title}")
    return 0


def _write_example(arguments: argparse.Namespace, folder: Path) -> int:
    if arguments.template is not None:
        raise InputError("goes without --template", where="--example", remedy="leave one of them out")
    written, verb = init_examples.write_example(arguments.example, folder)
    for path in written:
        print(path)
    print(f"begin with: radwrap {verb} {written[0]} --out {folder / 'out'}")
    return 0


def _tell_next(path: Path, folder: Path, *, look: bool, plane: bool = False) -> None:
    print(f"{path}\nrender it: radwrap render {path} --out {folder / 'out'}")
    if look:
        one = " --set camera.sensor.mosaic=green" if plane else ""  # pixels of several colours are not added up
        print(f"a first look: radwrap render {path}{one} --scale 1/4 --out {folder / 'look'}")


def _files_of(template: str) -> dict[str, bytes]:
    """Name and content of all files of a template; the scene last, as it names the others."""
    if template == _PAPER:
        return {_SCENE: (files("radwrap") / "data" / "init" / _SCENE).read_bytes()}
    scene = (files("radwrap") / "data" / "templates" / f"{template}.toml").read_bytes()
    parts = re.findall(r'^part = "([^"]+)"', scene.decode(), re.MULTILINE)
    found = {name: (files("radwrap") / "data" / "templates" / name).read_bytes() for name in parts}
    return found | {_SCENE: scene}


def run_schema(_: argparse.Namespace) -> int:
    """Print the schema."""
    print(json_text(described_schema()), end="")
    return 0
