"""Whether another machine may work at a study: the same programs to the byte, and the very same folder."""

from __future__ import annotations

import hashlib
import secrets
import socket
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Final

from radwrap.errors import EnvironmentFailure, RadwrapError
from radwrap.files import write_bytes
from radwrap.manifest import COMPILER_PACKAGES, STUDY_PACKAGES, versions
from radwrap.process import Programs
from radwrap.tracers.installation import find_radiance
from radwrap.tracers.installation import version as radiance_version

_MARK: Final = ".radwrap.cluster"
# Byte code, and scenes to copy, of which a clone has more files than a wheel: neither changes a result.
_NOT_RUN: Final = ("__pycache__", "examples")


class Unfit(EnvironmentFailure):
    """A machine would do the study's work otherwise."""


@dataclass(frozen=True, slots=True)
class Seal:
    """What a worker must have.

    Attributes
    ----------
    programs : Mapping[str, str]
        Program or package -> version, or digest.
    radiance : str or None
        Folder of the Radiance that is asked for.
    packages : tuple of str
        Which packages decide a result besides radwrap's own needs.
    mark : str
        A file in the study's folder.
    content : str
        What stands there; no other folder holds it.
    """

    programs: Mapping[str, str]
    radiance: str | None
    packages: tuple[str, ...]
    mark: str
    content: str


def seal_of(folder: Path, radiance: str | None, packages: Sequence[str] = STUDY_PACKAGES) -> Seal:
    """Seal of a study, or of other work on a folder, into which its mark is laid."""
    mark = folder.absolute() / _MARK
    content = secrets.token_hex(16)
    write_bytes(mark, content.encode())
    return Seal(_programs(radiance, packages), radiance, tuple(packages), str(mark), content)


def break_seal(seal: Seal) -> None:
    """Take the mark away: what still runs elsewhere no longer belongs to the study."""
    with suppress(OSError):
        Path(seal.mark).unlink(missing_ok=True)


def why_unfit(seal: Seal) -> str:
    """Why this machine may not work at a study; empty where it may."""
    try:
        here = _programs(seal.radiance, seal.packages)
    except RadwrapError as error:
        return str(error)
    other = [name for name in seal.programs if here.get(name) != seal.programs[name]]
    if other:
        return f"another {other[0]}, {here.get(other[0])} for {seal.programs[other[0]]}"
    try:
        same = Path(seal.mark).read_text("utf-8", errors="replace") == seal.content
    except OSError:
        same = False
    return "" if same else f"does not see {Path(seal.mark).parent}"


def check_fit(seal: Seal) -> None:
    """Refuse to work where the results would be others.

    Raises
    ------
    Unfit
        With the machine and the reason.
    """
    why = why_unfit(seal)
    if why:
        raise Unfit(why, where=socket.gethostname())


def _programs(radiance: str | None, packages: Sequence[str]) -> dict[str, str]:
    told = versions(*packages, *COMPILER_PACKAGES)
    found = {name: version for name, version in told.items() if name != "platform"}
    found["radiance"] = _radiance(radiance)
    digest = hashlib.sha256()
    _add(digest, files("radwrap"))
    return {**found, "radwrap's files": digest.hexdigest()[:16]}


def _radiance(asked: str | None) -> str:
    """Version of Radiance; "none" where it is missing and nobody asked for one: what is traced may not need it."""
    try:
        with Programs() as programs:
            return radiance_version(find_radiance(asked), programs)
    except EnvironmentFailure:
        if asked is not None:
            raise
        return "none"


def _add(digest: hashlib._Hash, folder: Traversable) -> None:
    for entry in sorted(folder.iterdir(), key=lambda entry: entry.name):
        if entry.is_dir():
            if entry.name not in _NOT_RUN:
                _add(digest, entry)
        else:
            digest.update(entry.name.encode())
            digest.update(entry.read_bytes())
