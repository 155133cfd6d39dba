"""The one tracer of all runs of a study."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from radwrap.imaging.tracer_choice import candidate
from radwrap.imaging.tracing import laid_out
from radwrap.scene.file.load import scene_from_document
from radwrap.scene.instants import averaged
from radwrap.study.design import Design, render_options
from radwrap.study.runs import Run
from radwrap.tracers.engine import EngineName


def one_tracer(design: Design, runs: Iterable[Run], options: Mapping[str, Any]) -> EngineName:
    """Who traces all runs: what was asked for, else what the scene of the design would be traced by alone.

    Where a run has what only Radiance can show, Radiance traces all of them.

    Parameters
    ----------
    design : Design
        The study.
    runs : iterable of Run
        All of it.
    options : Mapping
        Of `RenderOptions`, besides those of the design; who is asked for among them.

    Raises
    ------
    InputError, EnvironmentFailure
        As `laid_out`.
    """
    how = render_options(design.render, f"{design.origin}: render", **options)
    if how.tracer != "auto":
        return how.tracer
    if any(_only_radiance(run.document) for run in runs):
        return "radiance"
    scene = averaged(scene_from_document(design.document, origin=design.scene_origin, folder=design.folder))
    if candidate(scene, how).name == "radiance":
        return "radiance"
    with laid_out(scene, how) as traced:
        return traced.tracer_used.name


def _only_radiance(document: Mapping[str, Any]) -> bool:
    """Whether a scene file names a mirror, glass, or a Radiance file."""
    # As it was written: what is wrong with it its own run will say.
    materials, targets = document.get("materials"), document.get("targets")
    tables = [*(materials.values() if isinstance(materials, Mapping) else ()), *(targets or ())]
    tables = [table for table in tables if isinstance(table, Mapping)]
    return any(table.get("type") in ("mirror", "glass") or "rad" in table for table in tables)
