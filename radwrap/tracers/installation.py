"""Where Radiance is, and how its programs are run and judged."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from radwrap.errors import EnvironmentFailure, TracerError
from radwrap.process import Limits, Programs

VARIABLE: Final = "RADWRAP_RADIANCE"
_PROGRAMS: Final = ("oconv", "rtrace", "xform")
# The function file without which every run fails: it tells a Radiance library from another folder.
_LIBRARY_MARK: Final = "rayinit.cal"
_LIMITS: Final = Limits(silence=30.0, remedy="see whether it starts at all")  # it says its version at once
# What commands of a trusted file find after Radiance's programs; the user's own PATH would make images depend on it.
_SYSTEM_PROGRAMS: Final = ("/usr/bin", "/bin")


@dataclass(frozen=True, slots=True)
class Installation:
    """A Radiance: its programs and its library.

    Attributes
    ----------
    programs : Path
        Folder of oconv, rtrace and xform.
    library : Path
        Folder of rayinit.cal and other function files.
    origin : str
        How it was found, for people.
    """

    programs: Path
    library: Path
    origin: str

    def program(self, name: str) -> str:
        """Full path of a program."""
        return str(self.programs / (f"{name}.exe" if sys.platform == "win32" else name))

    def environment(self, extra: Iterable[Path] = (), *, commands: bool = False) -> dict[str, str]:
        """Environment for its programs: its own, nothing of the user's.

        Parameters
        ----------
        extra : iterable of Path
            Folders in which files may be looked for besides the working folder and the library.
        commands : bool
            Whether a trusted file may run the system's programs, such as
            ``!awk``, after Radiance's own.
        """
        programs = [str(self.programs), *(_SYSTEM_PROGRAMS if commands and sys.platform != "win32" else ())]
        places = [".", *map(str, extra), str(self.library)]
        environment = {"PATH": os.pathsep.join(programs), "RAYPATH": os.pathsep.join(places), "LC_ALL": "C"}
        if sys.platform == "win32":
            environment["SYSTEMROOT"] = os.environ.get("SYSTEMROOT", r"C:\Windows")
        return environment


def find_radiance(folder: str | Path | None = None) -> Installation:
    """Find Radiance: the named folder, RADWRAP_RADIANCE, the pyradiance wheel, then PATH.

    Parameters
    ----------
    folder : str or Path, optional
        Folder that holds bin and lib.

    Raises
    ------
    EnvironmentFailure
        If there is none, or the named one is not whole.
    """
    if folder is not None:
        return _checked(Path(folder), f"radiance={folder}")
    if named := os.environ.get(VARIABLE):
        return _checked(Path(named), f"{VARIABLE}={named}")
    # Found without importing it: the import changes PATH and RAYPATH of this process.
    wheel = importlib.util.find_spec("pyradiance")
    if wheel is not None and wheel.origin is not None:
        return _checked(Path(wheel.origin).parent, "the pyradiance wheel")
    if found := shutil.which("rtrace"):
        programs = Path(found).resolve().parent
        for library in (programs.parent / "lib", programs.parent / "lib" / "ray", Path("/usr/share/radiance/lib")):
            if (library / _LIBRARY_MARK).is_file():
                return Installation(programs, library, "PATH")
    raise EnvironmentFailure(
        "Radiance is not installed",
        remedy=f"pip install pyradiance, or name a Radiance folder with `radiance` or {VARIABLE}",
    )


def _checked(folder: Path, origin: str) -> Installation:
    found = Installation((folder / "bin").absolute(), (folder / "lib").absolute(), origin)
    missing = [name for name in _PROGRAMS if not Path(found.program(name)).is_file()]
    if not (found.library / _LIBRARY_MARK).is_file():
        missing.append(_LIBRARY_MARK)
    if missing:
        raise EnvironmentFailure(
            f"does not hold a complete Radiance: bin and lib lack {', '.join(missing)}",
            where=str(folder),
            remedy="name the folder that holds Radiance's bin and lib",
        )
    if os.pathsep in str(found.library):
        raise EnvironmentFailure(f'Radiance cannot live in a folder with "{os.pathsep}"', where=str(folder))
    return found


def judge(stderr: str, program: str, harmless: Iterable[str] = ()) -> None:
    """Take every word of a program for an error, unless it is known to be harmless.

    Exit codes lie: oconv succeeds on a polygon without area and on a negative
    radius, with a warning only.

    Parameters
    ----------
    stderr : str
        What it said.
    program : str
        Its name, for the message.
    harmless : iterable of str
        Regular expressions of whole lines that may be passed over.

    Raises
    ------
    TracerError
        If it said anything else.
    """
    for line in stderr.splitlines():
        text = line.strip()
        if text and not any(re.fullmatch(pattern, text) for pattern in harmless):
            raise TracerError(text.removeprefix(f"{program}: "), where=program)


def version(installation: Installation, programs: Programs) -> str:
    """Version that rtrace names.

    Raises
    ------
    EnvironmentFailure
        If it cannot be run.
    """
    answer, _ = programs.run(
        [installation.program("rtrace"), "-version"],
        folder=installation.programs,
        environment=installation.environment(),
        limits=_LIMITS,
    )
    return answer.decode(errors="replace").strip()
