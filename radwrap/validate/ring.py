"""Section 6: the ring of twelve LEDs of 47.1 mW/sr, 25 mm wide, at 1 m from a diffuse plane."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.validate import bench as on
from radwrap.validate.bench import Bench
from radwrap.validate.case import Case, Check, Finding, Plot
from radwrap.validate.closed_forms.sources import disc_irradiance_beside

_PRINTED: Final = 1e-4  # of the printed four digits; discs of 5.08 mm at 1 m are off by 6e-6
_SYMMETRY: Final = 1e-6
_QUADRATURE: Final = 1e-4
_REFLECTANCE: Final = 0.5
_RADIUS, _LED = 0.0125, 2.54e-3
_COUNT: Final = 12
_RADIANCE: Final = 2324.0
_GAUSSIAN: Final = {"profile": "gaussian", "width": "7.6 deg", "width_definition": "fwhm"}
_CONE: Final = {"profile": "cone", "width": "80 deg", "width_definition": "fwhm"}
_CASES: Final = ("6.irradiance_isotropic", "6.irradiance_aimed", "6.irradiance_parallel")


def _ring(beam: dict[str, Any], height: float = 1.0, **more: Any) -> dict[str, Any]:
    return {
        "type": "ring",
        "name": "ring",
        "position": on.metres(0, 0, height),
        "look_at": on.metres(0, 0, 0),
        "count": _COUNT,
        "diameter": on.metres(2 * _RADIUS)[0],
        "radiance": f"{_RADIANCE} W/m^2/sr",
        "beam": beam,
        **more,
    }


def _measured(bench: Bench, source: dict[str, Any], points: Any) -> NDArray[np.float64]:
    scene = on.scene(on.camera(), [source], {"it": on.lambertian(_REFLECTANCE)}, [on.sheet()])
    return bench.irradiance(scene, points, _REFLECTANCE)


def _on_axis(bench: Bench) -> Iterator[Finding]:
    tilt = math.atan(_RADIUS)
    aimed = [
        {"index": k, "axis_tilt": f"{tilt!r} rad", "axis_azimuth": on.degrees(30 * k + 180)[0]} for k in range(_COUNT)
    ]
    sources = (_ring(_CONE), _ring(_GAUSSIAN, leds=aimed), _ring(_GAUSSIAN))
    for name, source, printed in zip(_CASES, sources, (0.5651, 0.5651, 0.5514), strict=True):
        found = float(_measured(bench, source, [(0.0, 0.0, 0.0)])[0])
        yield Case(name, "twelve LEDs of 47.1 mW/sr at 1 m", printed, found, _PRINTED)


def _symmetric(bench: Bench) -> Iterator[Finding]:
    worst, radii = 0.0, (_RADIUS, 0.05, 0.2)
    turns = np.radians(7.0 + 30 * np.arange(_COUNT))
    for radius in radii:
        points = np.column_stack([radius * np.cos(turns), radius * np.sin(turns), 0 * turns])
        found = _measured(bench, _ring(_GAUSSIAN), points)
        worst = max(worst, float(np.ptp(found) / found.mean()))
    yield Case("6.symmetry_30_deg", "range over the mean", 0.0, worst, _SYMMETRY, "absolute")
    x = np.linspace(-0.25, 0.25, 101)
    profile = _measured(bench, _ring(_GAUSSIAN), np.column_stack([x, 0 * x, 0 * x]))
    yield Plot("Ring with the 7.6 degree beam at 1 m", "x [m]", "E [W m$^{-2}$]", {"radwrap": (x, profile)})


def _by_quadrature(bench: Bench) -> Iterator[Finding]:
    height, points = 0.8, ((0.0, 0.0), (0.06, 0.03))
    found = _measured(bench, _ring({"profile": "lambertian"}, height), [(*point, 0.0) for point in points])
    turns = [2 * math.pi * k / _COUNT for k in range(_COUNT)]
    for name, point, ours in zip(("axis", "aside"), points, found.tolist(), strict=True):
        beside = [(point[0] - _RADIUS * math.cos(turn), point[1] - _RADIUS * math.sin(turn)) for turn in turns]
        expected = sum(disc_irradiance_beside(_RADIANCE, _LED, height, place) for place in beside)
        yield Case(f"6.discs_{name}", "quadrature over the discs at 0.8 m", expected, ours, _QUADRATURE)


CHECKS: Final = (
    Check("6.irradiance", _CASES, _on_axis),
    Check("6.symmetry", ("6.symmetry_30_deg",), _symmetric),
    Check("6.discs", ("6.discs_axis", "6.discs_aside"), _by_quadrature),
)
