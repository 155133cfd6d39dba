"""Manifests: what was made, of what, with what, so that it can be made again."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import os
import platform
import re
import sys
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from radwrap.errors import InputError
from radwrap.files import write_bytes
from radwrap.reading import FileKind, read_json

SCHEMA_VERSION: Final = 1
# Metadata of a dataclass's field that is told only where it is not None: what a scene does not use leaves its manifest
# and hashes as they are.
ONLY_WHERE_USED: Final[Mapping[str, bool]] = MappingProxyType({"only_where_used": True})
_MANIFEST: Final = FileKind("manifest", 256 << 20)
_PACKAGES: Final = ("numpy", "scipy", "OpenImageIO", "pydantic", "pyradiance")
# What designs, responses and their analysis hang on, besides.
STUDY_PACKAGES: Final = ("opencv-contrib-python-headless", "pyDOE3", "statsmodels")
# What compiles our own tracer.
COMPILER_PACKAGES: Final = ("numba", "llvmlite")
_VERSION: Final = re.compile(r"^Version: *(\S+)", re.MULTILINE)  # of a package, among what is told of it
# What JSON holds as it is: of a basis thousands of pixels' numbers, for which nothing else is asked.
_AS_IT_IS: Final = frozenset({bool, float, int, str, type(None)})


def versions(*more: str) -> dict[str, str]:
    """Versions of everything in this process that a result depends on: of each, and of some more packages."""
    found = {
        "radwrap": _installed("radwrap"),
        "python": platform.python_version(),
        "platform": _platform(),
    }
    for package in (*_PACKAGES, *more):
        try:
            found[package] = _installed(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


@cache
def _installed(package: str) -> str:
    """A package's version when it was first asked for: what is installed later, this process does not run.

    To read it takes a while, and a study writes a manifest of six packages for each of its images. Of all that is told
    of a package only this line is looked for: to read the rest took 2 ms of each.
    """
    told = distribution(package)
    line = _VERSION.search(told.read_text("METADATA") or "")
    return line[1] if line else told.version


def _platform() -> str:
    """System, machine and C library; `platform.platform` would read Python's whole program for the last."""
    system = platform.uname()
    known = [system.system, system.release, system.machine]
    if sys.platform == "linux":
        with suppress(OSError, ValueError):  # another C library than GNU's
            known += (os.confstr("CS_GNU_LIBC_VERSION") or "").split()
    return "-".join(known)


def plain(value: Any, *, named: bool = True) -> Any:
    """Turn frozen dataclasses into what JSON can hold; the type's name goes along, unless it is not to be `named`.

    Left out are fields that are not compared, and those with the metadata
    ``only_where_used`` that are None: a new field changes no hash of what has none.
    """
    if type(value) in _AS_IT_IS:
        return value
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        told = [field for field in dataclasses.fields(value) if _is_told(field, value)]
        values = {field.name: plain(getattr(value, field.name), named=named) for field in told}
        return {"is": type(value).__name__, **values} if named else values
    if isinstance(value, Mapping):
        return {str(key): plain(item, named=named) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [item if type(item) in _AS_IT_IS else plain(item, named=named) for item in value]
    if isinstance(value, Path):
        return str(value)
    return value


def _is_told(field: dataclasses.Field[Any], value: Any) -> bool:
    unused = field.metadata.get("only_where_used", False) and getattr(value, field.name) is None
    return field.compare and not unused


def json_text(value: Any) -> str:
    """JSON with a fixed layout; NaN and infinity never pass.

    Raises
    ------
    ValueError
        If a number is NaN or infinite.
    """
    return json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def sha256_of_value(value: Any) -> str:
    """SHA-256 of a value's JSON form, in hexadecimal."""
    text = json.dumps(plain(value), sort_keys=True, ensure_ascii=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def write_manifest(path: Path, manifest: Mapping[str, Any]) -> None:
    """Write a manifest, whole or not at all."""
    write_bytes(path, json_text(manifest).encode())


def read_manifest(path: Path) -> dict[str, Any]:
    """Read a manifest.

    Raises
    ------
    InputError
        If it is not there, or not one of ours.
    """
    manifest = read_json(path, _MANIFEST)
    if not isinstance(manifest, dict) or manifest.get("schema_version") != SCHEMA_VERSION:
        raise InputError(f"is not a manifest of schema version {SCHEMA_VERSION}", where=str(path))
    return manifest


def finite(value: float) -> float | None:
    """The number, or None where it is NaN or infinite, which JSON cannot hold."""
    return value if math.isfinite(value) else None
