"""Whether another machine may work at a study: the same programs to the byte, and the very same folder."""

from __future__ import annotations

import hashlib
import secrets
import socket
from collections.abc import Mapping
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
    mark : str
        A file in the study's folder.
    content : str
        What stands there; no other folder holds it.
    """

    programs: Mapping[str, str]
    radiance: str | None
    mark: str
    content: str


def seal_of(folder: Path, radiance: str | None) -> Seal:
    """Seal of a study, whose mark is laid into its folder."""
    mark = folder.absolute() / _MARK
    content = secrets.token_hex(16)
    write_bytes(mark, content.encode())
    return Seal(_programs(radiance), radiance, str(mark), content)


def break_seal(seal: Seal) -> None:
    """Take the mark away: what still runs elsewhere no longer belongs to the study."""
    with suppress(OSError):
        Path(seal.mark).unlink(missing_ok=True)


def why_unfit(seal: Seal) -> str:
    """Why this machine may not work at a study; empty where it may."""
    try:
        here = _programs(seal.radiance)
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


def _programs(radiance: str | None) -> dict[str, str]:
    packages = versions(*STUDY_PACKAGES, *COMPILER_PACKAGES)
    found = {name: version for name, version in packages.items() if name != "platform"}
    with Programs() as programs:
        found["radiance"] = radiance_version(find_radiance(radiance), programs)
    digest = hashlib.sha256()
    _add(digest, files("radwrap"))
    return {**found, "radwrap's files": digest.hexdigest()[:16]}


def _add(digest: hashlib._Hash, folder: Traversable) -> None:
    for entry in sorted(folder.iterdir(), key=lambda entry: entry.name):
        if entry.is_dir():
            if entry.name not in _NOT_RUN:
                _add(digest, entry)
        else:
            digest.update(entry.name.encode())
            digest.update(entry.read_bytes())
