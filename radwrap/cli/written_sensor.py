"""A measured sensor as a file of the catalog: what the measurement does not tell is asked for."""

from __future__ import annotations

import argparse
import datetime
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from radwrap.cli import options as shared
from radwrap.errors import InputError
from radwrap.files import write_bytes
from radwrap.scene.catalog.component import checked_name, component_of, content_of
from radwrap.scene.catalog.written import component_text
from radwrap.scene.file.component_check import check_component
from radwrap.units import LENGTH, parse_quantity

_LENGTHS: Final = ("pixel_width", "pixel_height", "wavelength")


def add_options(parser: argparse.ArgumentParser) -> None:
    """--write and what goes with it."""
    parser.add_argument("--write", metavar="NAME.toml", help="write the sensor as a component of the catalog")
    parser.add_argument(
        "--bit-depth", metavar="N", type=shared.whole(1, 16), help="with --write: bits of the converter"
    )
    parser.add_argument("--title", metavar="TEXT", help="with --write: the camera and its settings")
    parser.add_argument("--revision", metavar="DATE", help="with --write: date of the file (default today)")
    parser.add_argument("--replace", action="store_true", help="with --write: replace a file that says something else")


def file_of(arguments: argparse.Namespace) -> Path | None:
    """File that --write names, whose name is one of the catalog.

    Raises
    ------
    InputError
        If it is no such name, or something that goes with it is missing.
    """
    path = shared.file_to_write(arguments.write, "--write", ".toml")
    if path is None:
        for option in ("bit_depth", "title", "revision"):
            if getattr(arguments, option) is not None:
                raise InputError("goes with --write", where=f"--{option.replace('_', '-')}")
        if arguments.replace:
            raise InputError("goes with --write", where="--replace")
        return None
    checked_name(path.name.removesuffix(".toml"), "--write")
    for option in (*_LENGTHS, "bit_depth"):
        if getattr(arguments, option) is None:
            raise InputError("is missing", where=f"--{option.replace('_', '-')}", remedy="--write needs it")
    return path


def write_sensor(
    path: Path,
    arguments: argparse.Namespace,
    measured: Mapping[str, Any],
    *,
    assumed: Mapping[str, tuple[Any, str]],
    published: Mapping[str, str],
    citation: str,
) -> None:
    """Write a sensor's file, after the same check as that of `radwrap catalog check`.

    Parameters
    ----------
    path : Path
        File, as `file_of` gave it.
    arguments : Namespace
        With what the measurement does not tell.
    measured : Mapping
        Keys of ``[camera.sensor]`` -> values, as a scene has them.
    assumed : Mapping
        Key -> value and reason, of what nothing tells.
    published : Mapping
        Totals.
    citation : str
        What was measured, and how.

    Raises
    ------
    InputError
        If an option is wrong, the numbers do not go together, or a file is there that says something else.
    """
    told = {"model": "linear", "bit_depth": arguments.bit_depth} | {key: getattr(arguments, key) for key in _LENGTHS}
    for key in _LENGTHS:
        try:
            parse_quantity(told[key], LENGTH)
        except InputError as error:
            raise InputError(error.what, where=f"--{key.replace('_', '-')}", remedy=error.remedy) from error
    source = {"basis": "measured", "source": "own"}
    entries: dict[str, Mapping[str, Any]] = {key: source for key in (*told, *measured) if key != "model"}
    entries |= {key: {"basis": "assumed", "note": why} for key, (_, why) in assumed.items()}
    text = component_text(
        "sensors",
        arguments.title or path.name.removesuffix(".toml"),
        {**told, **measured, **{key: value for key, (value, _) in assumed.items()}},
        entries,
        revision=_revision(arguments.revision),
        sources={"own": {"citation": citation, "seen": "measurement"}},
        published=published,
    )
    problems = check_component(component_of(text.encode(), path, "sensors", "file", str(path))).problems
    if problems:
        raise InputError(problems[0], where="--write", remedy="see docs/catalog.md")
    content = text.encode()
    if path.exists() and not arguments.replace and content_of(path, path.parent, str(path)) != content:
        raise InputError("exists and has other content", where=str(path), remedy="name another file, or --replace")
    write_bytes(path, content)


def _revision(text: str | None) -> datetime.date:
    if text is None:
        return datetime.datetime.now(datetime.UTC).date()
    try:
        return datetime.date.fromisoformat(text)
    except ValueError as error:
        raise InputError(f'"{text}" is not a date, such as 2026-11-25', where="--revision") from error
