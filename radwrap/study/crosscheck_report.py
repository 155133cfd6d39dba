"""A cross-check in numbers and in one picture."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.figure_png import figure_png
from radwrap.files import write_bytes
from radwrap.manifest import SCHEMA_VERSION, sha256_of_value, versions, write_manifest
from radwrap.scene.scene import Scene
from radwrap.study.crosscheck import Crosscheck

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

RESULT: Final = "crosscheck.json"
PICTURE: Final = "crosscheck.png"
# Below this share of a term's brightest pixel a relative difference says nothing.
_DARK: Final = 1e-3
_GRAY_TOLERANCE: Final = 0.5
# A closed form explains a difference if it leaves no more than this share of it.
EXPLAINED: Final = 0.2
# Where pixels mix bright and dark, a single one says nothing relative to itself: there the median of all must be right.
_MIXED: Final = frozenset({"aperture", "edges", "mirror", "shadow"})
WAVES_NOTE: Final = "the geometric part is compared: both trace rays, and neither has diffraction or aberrations"
TIME_NOTE: Final = "one instant is compared: everything stands where its pose is, and all light shines for all rows"
SHEETING_NOTE: Final = (
    "POV-Ray has no retroreflection: sheeting is not checked here; corner cubes check only the geometry"
)


def as_json(result: Crosscheck) -> dict[str, Any]:
    """Everything but the pixels."""
    whole = np.ones(result.radiance.shape, dtype=bool)
    return {
        "schema_version": SCHEMA_VERSION,
        "scene": result.scene.origin,
        "scene_sha256": sha256_of_value([result.scene.document, result.options.area_samples]),
        "tolerance": result.options.tolerance,
        "viewpoints": result.viewpoints,
        "pixel_samples": result.options.render.pixel_samples,
        "area_samples": result.options.area_samples,
        "agrees": agrees(result),
        "radiance": _difference(result, whole),
        "gray": _gray_difference(result, whole),
        "peak_gray": float(result.gray[0].max()),
        "terms": {
            name: {
                **_difference(result, mask),
                "gray": _gray_difference(result, mask),
                **dict(zip(("measure", "measured"), measured(result, name), strict=True)),
                "verdict": verdict(result, name),
            }
            for name, mask in result.seen.terms.items()
        },
        "closed_form": _against_closed_form(result),
        "explained": explained(result),
        "replaced_beams": list(result.beams),
        "note": SHEETING_NOTE,
        **({"diffraction": WAVES_NOTE} if _has_waves(result.scene) else {}),
        **({"in_time": TIME_NOTE} if result.changing else {}),
        "versions": {**versions(), **result.versions},
        "timing": {f"{name}_s": seconds for name, seconds in result.wall_s.items()},
    }


def _has_waves(scene: Scene) -> bool:
    return scene.camera.diffraction is not None and not scene.camera.aperture.is_infinitesimal


def agrees(result: Crosscheck) -> bool:
    """Whether every term agrees, or differs as closed forms say."""
    return all(verdict(result, name) != "differs" for name in result.seen.terms)


def verdict(result: Crosscheck, term: str) -> str:
    """Whether a term "agrees", is "explained" by closed forms, or "differs"."""
    mask = result.seen.terms[term]
    if measured(result, term)[1] <= result.options.tolerance:
        return "agrees"
    expected = sum(result.seen.expected.values(), np.zeros(mask.shape))
    difference = (result.povray - result.radiance)[mask]
    left = _rms(difference - expected[mask])
    return "explained" if left <= EXPLAINED * _rms(difference) else "differs"


def measured(result: Crosscheck, term: str) -> tuple[str, float]:
    """The measure by which both differ most on a term, and how much.

    All pixels count, relative to the brightest of the term, and bright ones relative to themselves: by their rms, or
    where pixels mix bright and dark by their median.
    """
    found = _difference(result, result.seen.terms[term])
    names = ("rms_of_peak", "relative_median" if term in _MIXED else "relative_rms")
    values = {name: abs(found[name]) for name in names if found[name] is not None}
    return max(values.items(), key=lambda item: item[1])


def _rms(values: Array) -> float:
    return math.sqrt(float(np.mean(values**2))) if values.size else 0.0


def _difference(result: Crosscheck, mask: Mask) -> dict[str, Any]:
    """POV-Ray less Radiance, relative to Radiance where that is not dark, and to the brightest of all pixels."""
    ours, theirs = result.radiance[mask], result.povray[mask]
    peak = max(float(ours.max()), float(theirs.max())) or 1.0
    bright = ours > _DARK * peak
    relative = (theirs - ours)[bright] / ours[bright]
    some = bool(bright.any())
    return {
        "pixels": int(mask.sum()),
        "relative_rms": _rms(relative) if some else None,
        "relative_median": float(np.median(relative)) if some else None,
        "relative_maximum": float(np.abs(relative).max()) if some else None,
        "beyond_tolerance": float(np.mean(np.abs(relative) > result.options.tolerance)) if some else None,
        "rms_of_peak": _rms(theirs - ours) / peak,
        "maximum_of_peak": float(np.abs(theirs - ours).max()) / peak,
    }


def _gray_difference(result: Crosscheck, mask: Mask) -> dict[str, float]:
    difference = (result.gray[1] - result.gray[0])[mask]
    return {
        "rms": _rms(difference),
        "median": float(np.median(difference)),
        "maximum": float(np.abs(difference).max()),
        "beyond_half": float(np.mean(np.abs(difference) > _GRAY_TOLERANCE)),
    }


def _against_closed_form(result: Crosscheck) -> dict[str, float] | None:
    """Each tracer against E rho/pi on diffuse pixels out of shadows: who is right where they differ."""
    mask = result.seen.terms.get("diffuse")
    if mask is None:
        return None
    expected = result.seen.closed_form
    mask = mask & (np.nan_to_num(expected) > _DARK * np.nanmax(expected))
    return {
        "pixels": int(mask.sum()),
        "radiance_relative_rms": _rms(result.radiance[mask] / expected[mask] - 1),
        "povray_relative_rms": _rms(result.povray[mask] / expected[mask] - 1),
    }


def explained(result: Crosscheck) -> dict[str, Any]:
    """For each reason that closed forms know: what they expect, what was measured, and what is left of it."""
    found = {}
    for reason, expected in result.seen.expected.items():
        mask = expected != 0
        if "aperture" in result.seen.terms or "edges" in result.seen.terms:
            mask &= ~result.seen.terms.get("aperture", result.seen.terms.get("edges", ~mask))
        if not mask.any():
            continue
        difference = (result.povray - result.radiance)[mask]
        found[reason] = {
            "pixels": int(mask.sum()),
            "expected_rms": _rms(expected[mask]),
            "measured_rms": _rms(difference),
            "left_rms": _rms(difference - expected[mask]),
            "who_is_right": _RIGHT[reason],
        }
    return found


_RIGHT: Final = {
    "highlight": "neither: two models of a rough surface, cos^n and a Gaussian of the slope; radwrap's is Radiance's",
    "extended source": "POV-Ray, which integrates the disc; Radiance samples its centre, off by (radius/distance)^2",
}


def write_crosscheck(result: Crosscheck, out: Path) -> tuple[Path, ...]:
    """Write picture and numbers, the numbers last."""
    write_bytes(out / PICTURE, picture(result))
    write_manifest(out / RESULT, as_json(result))
    return out / PICTURE, out / RESULT


def picture(result: Crosscheck) -> bytes:
    """PNG of both images, their difference, and a line through where they differ most; same input, same bytes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 7), dpi=100, layout="constrained")
    axes = figure.subplots(2, 2)
    top = float(max(result.radiance.max(), result.povray.max())) or 1.0
    for axis, image, title in ((axes[0, 0], result.radiance, "Radiance"), (axes[0, 1], result.povray, "POV-Ray")):
        shown = axis.imshow(image, cmap="gray", vmin=0, vmax=top, interpolation="nearest")
        axis.set_title(title)
        figure.colorbar(shown, ax=axis, label="L cos^4 [W m$^{-2}$ sr$^{-1}$]", shrink=0.85)
    difference = 100 * (result.povray - result.radiance) / top
    reach = max(float(np.abs(difference).max()), 1e-6)
    shown = axes[1, 0].imshow(difference, cmap="RdBu_r", vmin=-reach, vmax=reach, interpolation="nearest")
    axes[1, 0].set_title("POV-Ray - Radiance")
    figure.colorbar(shown, ax=axes[1, 0], label="% of the brightest pixel", shrink=0.85)
    most = np.abs(difference) if difference.any() else result.radiance
    row = int(np.unravel_index(most.argmax(), most.shape)[0])
    axes[1, 0].axhline(row, color="k", lw=0.6, ls=":")
    _profile(axes[1, 1], result, row, difference)
    whole = _difference(result, np.ones(result.radiance.shape, dtype=bool))
    word = "agree" if agrees(result) else "differ"
    figure.suptitle(
        f"{_title(result)}: they {word}; rms {100 * whole['rms_of_peak']:.2g} %, "
        f"largest {100 * whole['maximum_of_peak']:.2g} % of the brightest pixel"
    )
    return figure_png(figure)


def _title(result: Crosscheck) -> str:
    return str(json.loads(result.scene.document).get("title") or result.scene.origin)


def _profile(axis: Any, result: Crosscheck, row: int, difference: Array) -> None:
    axis.plot(result.radiance[row], color="C0", lw=2.5, alpha=0.5, label="Radiance")
    axis.plot(result.povray[row], color="C3", lw=1, label="POV-Ray")
    axis.set(title=f"row {row} (largest difference)", xlabel="column [px]", ylabel="L cos^4 [W m$^{-2}$ sr$^{-1}$]")
    axis.legend(frameon=False, fontsize=8, loc="upper left")
    other = axis.twinx()
    other.plot(difference[row], color="k", lw=0.7, ls=":")
    other.set_ylabel("difference [% of the brightest pixel], dotted")
