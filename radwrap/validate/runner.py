"""All checks, one after the other, and what they found."""

from __future__ import annotations

import traceback
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from radwrap.errors import EnvironmentFailure, InputError, RadwrapError, TracerError
from radwrap.imaging.render_options import RenderOptions
from radwrap.manifest import SCHEMA_VERSION, versions
from radwrap.progress import Progress
from radwrap.validate import (
    bounces,
    calibration,
    edges,
    extremes,
    furnace,
    interiors,
    lamps,
    openings,
    ring,
    sensor,
    sheeting,
)
from radwrap.validate.bench import Bench
from radwrap.validate.case import Case, Check, Finding, Missing, Plot

SECTIONS: Final = {
    1: "Lamps",
    2: "CIE 171:2006, electric light",
    3: "Furnace and reciprocity",
    4: "Aperture",
    5: "Sheeting bench",
    6: "Ring",
    7: "Sensor",
    8: "Edge model, Tsai, Lenth",
    10: "Extremes",  # 9, the paper's figures and tables, is `make replication`
}
_MODULES: Final = (lamps, interiors, bounces, furnace, openings, edges, sheeting, ring, sensor, calibration, extremes)
CHECKS: Final[tuple[Check, ...]] = tuple(
    sorted((check for module in _MODULES for check in module.CHECKS), key=lambda check: int(check.name.split(".")[0]))
)


@dataclass(frozen=True, slots=True, eq=False)
class ScoreCard:
    """What all checks found.

    Attributes
    ----------
    cases : tuple of Case
        In the order of the sections.
    plots : tuple of (str, Plot)
        Name of the check, and what it shows.
    """

    cases: tuple[Case, ...]
    plots: tuple[tuple[str, Plot], ...] = field(default=())

    @property
    def misses(self) -> tuple[Case, ...]:
        """Cases that do not keep their limit, or have no value."""
        return tuple(case for case in self.cases if not case.passed)

    def as_json(self) -> dict[str, Any]:
        """All cases; the same scenes give the same numbers."""
        return {
            "schema_version": SCHEMA_VERSION,
            "versions": versions(),
            "cases": [case.as_json() for case in self.cases],
            "passed": len(self.cases) - len(self.misses),
            "missed": len(self.misses),
        }


def chosen(names: Sequence[str]) -> tuple[Check, ...]:
    """Checks that a user asked for: by section ("4"), by check ("4.merging"), or by case; all where nothing is named.

    Raises
    ------
    InputError
        If nothing has a name.
    """
    found = []
    for name in names:
        # A section is a whole number: "1" is not the beginning of "1.5".
        stem = f"{name}." if name.isdigit() else name
        fitting = [c for c in CHECKS if c.name.startswith(stem) or any(case.startswith(stem) for case in c.cases)]
        if not fitting:
            known = ", ".join(check.name for check in CHECKS)
            raise InputError(
                f'there is no "{name}" to run', where="names", remedy=f"name a section, 1 to 8 or 10, or {known}"
            )
        found += fitting
    return tuple(check for check in CHECKS if not names or check in found)


def validate(options: RenderOptions, names: Sequence[str] = ()) -> ScoreCard:
    """Run the checks.

    Parameters
    ----------
    options : RenderOptions
        For workers, the seed, which Radiance, and whether progress is shown.
    names : sequence of str
        What to run, as in `chosen`.
    """
    checks = chosen(names)
    progress = Progress("validating", len(checks), shown=options.progress)
    cases: list[Case] = []
    plots: list[tuple[str, Plot]] = []
    quiet = RenderOptions(
        tracer=options.tracer,
        seed=options.seed,
        workers=options.workers,
        radiance=options.radiance,
        tracer_timeout=options.tracer_timeout,
    )
    try:
        for check in checks:
            for finding in _found(check, Bench(quiet)):
                if isinstance(finding, Plot):
                    plots.append((check.name, finding))
                else:
                    cases.append(finding)
            progress.add(1)
    finally:
        progress.close()
    return ScoreCard(_only(tuple(cases), names), tuple(plots))


def _only(cases: tuple[Case, ...], names: Sequence[str]) -> tuple[Case, ...]:
    """A single case where its full name was given."""
    full = set(names) & {case.name for case in cases}
    if len(full) < len(set(names)):
        return cases
    return tuple(case for case in cases if not full or case.name in full)


def _found(check: Check, bench: Bench) -> list[Finding]:
    """What a check found; a case that it promised and did not find is there without a value."""
    found: list[Finding] = []
    why = "it did not come out"
    try:
        found.extend(check.run(bench))
    except Missing as error:
        why = f"missing: {error}"
    except RadwrapError as error:
        if isinstance(error, EnvironmentFailure) and not isinstance(error, TracerError):
            raise  # without Radiance or disk space nothing can be said of any case
        why = f"failed: {error}"
    except Exception as error:  # noqa: BLE001  (one broken case must not hide the others)
        why = f"failed: {traceback.format_exception_only(error)[-1].strip()}"
    there = {finding.name for finding in found if isinstance(finding, Case)}
    unknown = there - set(check.cases)
    if unknown:
        raise AssertionError(f"{check.name} does not announce {', '.join(sorted(unknown))}")
    absent = [name for name in check.cases if name not in there]
    return [*found, *(Case(name, "", None, None, 0.0, note=why) for name in absent)]
