"""How the runs of a study are sampled: pilots of all that is rendered, and the strictest of them for every run."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any, Final

from radwrap.errors import InputError
from radwrap.files import make_folder
from radwrap.imaging.demand import SamplingPlan, sampling_plan
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.tolerance.replicates import Work
from radwrap.imaging.tolerance.sampling import Pilot, pilot, strictest
from radwrap.imaging.tracing import laid_out
from radwrap.imaging.with_waves import even_waves
from radwrap.manifest import SCHEMA_VERSION, read_manifest, sha256_of_value, write_manifest
from radwrap.process import Programs
from radwrap.progress import Progress
from radwrap.scene.scene import Scene

# What tells apart the renders of a study that are not compared as equals: a factor may be an option of the render.
ASKED: Final = ("method", "tolerance", "max_error", "budget_rays")

# What a render asks for -> how it is sampled.
Plans = Mapping[RenderOptions, SamplingPlan]


def write_pilot(path: Path, scene: Scene, options: RenderOptions) -> None:
    """Look at what an image needs, and write that into a file.

    Raises
    ------
    InputError, TracerError, EnvironmentFailure
        As a render of the scene.
    """
    quiet = Progress("", 1, shown=False)
    with (
        tempfile.TemporaryDirectory(prefix="radwrap-") as folder,
        Programs() as programs,
        laid_out(scene, options) as traced,
    ):
        work = Work(traced.view(), Path(folder), programs, quiet, traced.sha256(), options.seed)
        left = traced.banding.left(options)
        found, waves = pilot(work, left.demand), even_waves(scene, work, left)
        if waves is not None:
            found = replace(found, wave_cell=waves.wave_cell, wave_far=waves.wave_far)
    make_folder(path.parent)
    write_manifest(path, {"schema_version": SCHEMA_VERSION, **asdict(found)})


def read_pilot(path: Path) -> Pilot | None:
    """What a pilot found; None where there is none, or none that is whole."""
    try:
        told = read_manifest(path)
        perhaps = (told["cell"], told["wave_cell"], told["wave_far"])
        numbers = [told["rays"], told["pixels"], told["covered"], *(one for one in perhaps if one is not None)]
        if all(type(one) in (int, float) and math.isfinite(one) and one > 0 for one in numbers):
            return Pilot(**{one.name: told[one.name] for one in fields(Pilot)})
    except (InputError, KeyError):
        pass
    return None


def asked(options: RenderOptions) -> RenderOptions:
    """What a render asks for, without what does not change how it should be sampled."""
    return RenderOptions(**{name: getattr(options, name) for name in ASKED})


def plans_of(pilots: Sequence[tuple[RenderOptions, Pilot | None]]) -> dict[RenderOptions, SamplingPlan]:
    """The strictest plan for each kind of render that has a pilot which did not fail."""
    kinds: dict[RenderOptions, list[Pilot]] = {}
    for options, found in pilots:
        if found is not None:
            kinds.setdefault(asked(options), []).append(found)
    return {kind: strictest(some, kind.demand) for kind, some in kinds.items()}


def told_of(plans: Plans) -> dict[str, Any]:
    """For study.json: how a study is sampled, with its own hash."""
    told = as_json(plans)
    return {"sampling": told, "sampling_sha256": sha256_of_value(told)}


def as_json(plans: Plans) -> list[dict[str, Any]]:
    """As `plans_from_json` reads them."""
    return [{"render": {name: getattr(kind, name) for name in ASKED}, **plan.as_json()} for kind, plan in plans.items()]


def plans_from_json(told: Any, where: str) -> dict[RenderOptions, SamplingPlan]:
    """Read back how a study is sampled.

    Raises
    ------
    InputError
        Naming the key.
    """
    if not isinstance(told, list):
        raise InputError("must be an array", where=where)
    plans = {}
    for number, entry in enumerate(told):
        place = f"{where}[{number}]"
        if not isinstance(entry, dict) or not isinstance(entry.get("render"), dict):
            raise InputError("must be a table with the table render", where=place)
        if set(entry["render"]) != set(ASKED):
            raise InputError(f"must be a table of {', '.join(ASKED)}", where=f"{place}.render")
        plan = {name: value for name, value in entry.items() if name != "render"}
        plans[_kind(entry["render"], f"{place}.render")] = sampling_plan(plan, place)
    return plans


def _kind(told: Mapping[str, Any], where: str) -> RenderOptions:
    for name in ASKED[1:]:
        value = told[name]
        if not (value is None and name != "tolerance") and type(value) not in (int, float):
            raise InputError("must be a number", where=f"{where}.{name}")
    if told["method"] not in (None, "kernel", "rays"):
        raise InputError('must be null, "kernel" or "rays"', where=f"{where}.method")
    try:
        return RenderOptions(**told)
    except InputError as error:
        raise InputError(error.what, where=f"{where}.{error.where}") from error
