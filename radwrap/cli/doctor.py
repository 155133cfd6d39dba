"""``radwrap doctor``: what is installed, what is missing, and how to get it."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as distribution_version
from typing import Any, Final

from radwrap.errors import EnvironmentFailure, RadwrapError
from radwrap.extras import EXTRAS, installing, require
from radwrap.imaging.forecast.speed import tracer_speed
from radwrap.led.ports import modules as hidapi_modules
from radwrap.manifest import STUDY_PACKAGES, json_text, versions
from radwrap.process import Programs, available_cores
from radwrap.tracers.expressible import compiler_lacks
from radwrap.tracers.installation import find_radiance, version

_LISTED: Final = tuple(name for name in EXTRAS if name not in ("fast", "led"))  # these have entries that say more


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = verbs.add_parser(
        "doctor",
        description="Shows what is installed, what is missing and how to get it, and how fast rays are traced here.",
    )
    parser.add_argument("--radiance", metavar="DIR", help="folder with another Radiance's bin and lib")
    parser.add_argument("--warm", action="store_true", help="compile our own tracer now, if it is not compiled yet")
    parser.add_argument("--json", action="store_true", help="machine-readable result on stdout")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Check everything; exit code 4 where something needed is missing."""
    folder = arguments.radiance
    checks = [
        _with_speed(
            _check("Radiance", True, "pip install pyradiance, or --radiance DIR", lambda: _radiance(folder)),
            lambda: tracer_speed("radiance", folder),
        ),
        _with_speed(
            _check("compiled tracer", False, installing("fast"), lambda: _compiled(warm=arguments.warm)),
            lambda: _compiled_speed(folder),
        ),
        _check("POV-Ray", False, "apt install povray (only for cross-checks)", _povray),
        _check("hidapi", False, f"{installing('led')} (only for a real LED ring)", _hidapi),
        *(_check(f"extra {name}", False, installing(name), partial(_extra, name)) for name in _LISTED),
    ]
    whole = all(check["found"] or not check["needed"] for check in checks)
    found = {"ok": whole, "checks": checks, "versions": versions(*STUDY_PACKAGES), "cores": available_cores()}
    if arguments.json:
        print(json_text(found), end="")
    else:
        for check in checks:
            state = check["version"] if check["found"] else f"missing: {check['problem']}; get it by: {check['remedy']}"
            speed = f", {check['mrays_per_s']:.2g} Mrays/s on one core" if check.get("mrays_per_s") else ""
            print(f"{check['name']}: {state}{speed}" + (f" ({check['place']})" if check["place"] else ""))
        for name, version in versions(*STUDY_PACKAGES).items():
            print(f"{name}: {version}")
        print(f"cores: {available_cores()}")
    for check in checks:
        if check["needed"] and not check["found"]:
            raise EnvironmentFailure(check["problem"], where=check["name"], remedy=check["remedy"])
    return 0


def _check(name: str, needed: bool, remedy: str, look: Callable[[], tuple[str, str]]) -> dict[str, Any]:
    entry: dict[str, Any] = {"name": name, "needed": needed, "remedy": remedy}
    try:
        version, place = look()
    except RadwrapError as error:
        return {**entry, "found": False, "version": None, "place": None, "problem": error.what}
    return {**entry, "found": True, "version": version, "place": place, "problem": None}


def _with_speed(check: dict[str, Any], measure: Callable[[], float | None]) -> dict[str, Any]:
    """A tracer's entry with its speed [Mrays/s]; None where that cannot be measured, which is no reason to fail."""
    speed = None
    if check["found"]:
        with suppress(RadwrapError):
            speed = measure()
    return {**check, "mrays_per_s": None if speed is None else speed / 1e6}


def _radiance(folder: str | None) -> tuple[str, str]:
    installation = find_radiance(folder)
    with Programs() as programs:
        return version(installation, programs), f"{installation.programs}, from {installation.origin}"


def _compiled(*, warm: bool) -> tuple[str, str]:
    """Version of the compiler, and whether and where the tracer is compiled."""
    if lacks := compiler_lacks():
        raise EnvironmentFailure(lacks)
    from radwrap.imaging.methods import direct_gather
    from radwrap.imaging.tolerance import sorted_light
    from radwrap.tracers.compiled.compiler import VERSIONS, cache_folder
    from radwrap.tracers.compiled.warm import is_warm, warm_up

    if warm:
        warm_up()
        direct_gather.compile_ahead()
        sorted_light.compile_ahead()
    state = "compiled" if is_warm() else "not compiled yet; radwrap doctor --warm compiles it"
    return f"numba {VERSIONS['numba']}, {state}", str(cache_folder())


def _compiled_speed(radiance: str | None) -> float | None:
    """Its speed, once it is compiled: to compile it takes long, and is only done where that is asked for."""
    from radwrap.tracers.compiled.warm import is_warm

    return tracer_speed("compiled", radiance) if is_warm() else None


def _povray() -> tuple[str, str]:
    from radwrap.tracers.povray import find_povray

    with Programs() as programs:
        found = find_povray(programs)
    return found.version, found.program


def _extra(name: str) -> tuple[str, str]:
    """That all of an extra's packages are there."""
    require(name, name)
    return ", ".join(EXTRAS[name]), ""


def _hidapi() -> tuple[str, str]:
    module = next(hidapi_modules(), None)
    if module is None:
        raise EnvironmentFailure("hidapi cannot be loaded")
    try:
        told = distribution_version("hidapi")
    except PackageNotFoundError:  # of the system, or another package by that name
        told = "unknown version"
    return told, f"module {module.__name__}"
