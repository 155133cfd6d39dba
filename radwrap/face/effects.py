"""Effects that a picture of the page could lack, measured in its light, and what is advised."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from radwrap.imaging.forecast.effects import effects
from radwrap.imaging.forecast.explain import explain
from radwrap.imaging.render_options import RenderOptions
from radwrap.manifest import plain

_TOLD: Final = ("effects", "effects_exposure_time", "tolerance")


def measured_effects(request: Mapping[str, Any]) -> dict[str, Any]:
    """Effects of a scene, measured by rays, and what closed forms advise; in the process that traces.

    Parameters
    ----------
    request : Mapping
        ``scene``, and ``options`` of `RenderOptions`.

    Returns
    -------
    dict
        ``effects``, ``effects_exposure_time`` [s], ``exposure_time`` of the scene [s], ``tolerance``: see `effects`;
        ``method``, ``why``: of the planner; ``advice``, ``best_opening``, ``eight_bits``: see `explain`.

    Raises
    ------
    InputError, TracerError, EnvironmentFailure
        As `effects`.
    """
    scene = request["scene"]
    found = effects(scene, RenderOptions(**request["options"]))
    closed = explain(scene, found["tracer"].get("whole") or ())
    told = {
        **{key: found[key] for key in _TOLD},
        "exposure_time": scene.camera.exposure_time,
        "method": found["planner"]["method"],
        "why": found["planner"]["why"],
        "advice": closed["advice"],
        "best_opening": closed["best_opening"],
        "eight_bits": closed["eight_bits"],
    }
    plainly: dict[str, Any] = plain(told)
    return plainly
