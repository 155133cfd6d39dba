"""Packages that a plain installation does not have, and the extra that brings each."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec
from types import MappingProxyType
from typing import Final

from radwrap.errors import EnvironmentFailure

_MEASURE: Final = ("cv2", "contourpy", "matplotlib")
# Modules of each extra, by the names that they are imported by.
EXTRAS: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "measure": _MEASURE,
        "study": (*_MEASURE, "jinja2", "pyDOE3", "statsmodels"),
        "led": ("hid",),
        "fast": ("numba",),
        "face": ("starlette", "tomli_w", "uvicorn"),
        "dataset": ("fcl",),
        "design": ("clarabel", "optuna"),
        "cluster": ("distributed",),
        "step": ("cascadio",),
    }
)


def missing(extra: str) -> tuple[str, ...]:
    """Modules of an extra that are not installed."""
    return tuple(name for name in EXTRAS[extra] if find_spec(name) is None)


def require(extra: str, where: str) -> None:
    """Say so where a package of an extra is missing, before there is work that would be lost.

    Parameters
    ----------
    extra : str
        Key of `EXTRAS`.
    where : str
        What needs it.

    Raises
    ------
    EnvironmentFailure
        With the line that installs it.
    """
    if lacking := missing(extra):
        raise lack_of(lacking[0], where, extra)


def lack_of(module: str, where: str, extra: str | None = None) -> EnvironmentFailure:
    """The error for a module that is not installed; without an extra the first one that brings it."""
    extra = extra or next((name for name, modules in EXTRAS.items() if module in modules), None)
    remedy = "reinstall radwrap" if extra is None else installing(extra)
    return EnvironmentFailure(f"{module} is not installed", where=where, remedy=remedy)


def installing(extra: str) -> str:
    """The line that installs an extra."""
    return f'pip install "radwrap[{extra}]"'
