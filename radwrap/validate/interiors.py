"""Section 2: the electric cases of CIE 171:2006, as formulas."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from radwrap.errors import InputError
from radwrap.validate import bench as on
from radwrap.validate.bench import Bench
from radwrap.validate.case import Case, Check, Finding, Missing, Plot
from radwrap.validate.closed_forms.aperture import cos4
from radwrap.validate.closed_forms.sources import disc_irradiance, point_irradiance, rectangle_factor

_LIMIT: Final = 0.01  # ours; 5 % a point and 10 % overall are in use
_REFLECTANCE: Final = 0.5
_FLUX: Final = 10_000.0
_HEIGHT: Final = 3.0
_DISTANCES: Final = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0)
_RATIOS: Final = (0.05, 0.1, 0.5, 1.0, 2.0)
_ASKED: Final = 0.005  # irradiance error that wide sources are asked for


def _point_source(bench: Bench) -> Iterator[Finding]:
    """A floor below a point source, by one image whose six pixels see r = 0, 1, ... 5 m."""
    source = on.lamp((0.0, 0.0, _HEIGHT), radiant_intensity=_FLUX / (4 * math.pi), half_angle=89.0)
    eye = 2.0
    camera = on.camera(
        (0.0, 0.0, eye),
        size=(1, len(_DISTANCES)),
        pitch=(on.FOCAL_LENGTH / eye, 1e-6),
        principal_point=["0 px", "0 px"],
    )
    scene = on.scene(camera, [source], {"it": on.lambertian(_REFLECTANCE)}, [on.sheet(14.0)])
    r = np.array(_DISTANCES)
    found = on.radiances(scene, bench.exposure(scene))[0] / cos4(r, 0.0, eye) * math.pi / _REFLECTANCE
    expected = point_irradiance(_FLUX / (4 * math.pi), _HEIGHT, r)
    for distance, reference, ours in zip(_DISTANCES, expected.tolist(), found.tolist(), strict=True):
        yield Case(
            f"2.point_source_{distance:g}_m", "CIE 171:2006, Phi/(4 pi) h/(h^2+r^2)^1.5", reference, ours, _LIMIT
        )
    yield Plot(
        "Point source, 10 000 lm at 3 m",
        "r [m]",
        "E [lx]",
        {"reference": (r, expected), "radwrap": (r, found)},
    )


def _lit_from_below(source: dict[str, Any], points: Any, bench: Bench) -> list[float]:
    """Irradiance at points of the sheet z = 0 by a source of radiance 1."""
    try:
        scene = on.scene(on.camera((0.0, 0.0, 0.1)), [source], {"it": on.lambertian(_REFLECTANCE)}, [on.sheet(8.0)])
    except InputError as error:
        raise Missing(f"wide sources in patches: {error}") from error
    eyes = np.asarray(points, dtype=np.float64) + np.array([0.0, 0.0, 0.05])
    values: list[float] = (bench.radiance(scene, eyes, points) * math.pi / _REFLECTANCE).tolist()
    return values


def _parallel_square(bench: Bench) -> Iterator[Finding]:
    """1 x 1 m, 1 m above a point under its centre and one under its corner; the factor is E/(pi L)."""
    source = {
        "type": "rectangle",
        "name": "square",
        "position": on.metres(0, 0, 1),
        "look_at": on.metres(0, 0, 0),
        "size": on.metres(1, 1),
        "radiance": "1 W/m^2/sr",
        "irradiance_error": _ASKED,
    }
    values = _lit_from_below(source, [(0.0, 0.0, 0.0), (0.5, 0.5, 0.0)], bench)
    for place, reach, found in (("centre", (-0.5, 0.5), values[0]), ("corner", (-1.0, 0.0), values[1])):
        factor = rectangle_factor(reach, reach, 1.0)
        yield Case(f"2.parallel_square_{place}", "CIE 171:2006, closed form", factor, found / math.pi, _LIMIT)


def _disc_name(ratio: float) -> str:
    return f"2.disc_{ratio:g}_of_h"


def _disc(ratio: float) -> Check:
    def run(bench: Bench) -> Iterator[Finding]:
        """E = pi L R^2/(R^2 + h^2) below the middle of a disc at h = 1 m."""
        source = {
            "type": "disc",
            "name": "disc",
            "position": on.metres(0, 0, 1),
            "look_at": on.metres(0, 0, 0),
            "diameter": on.metres(2 * ratio)[0],
            "radiance": "1 W/m^2/sr",
        }
        try:
            (found,) = _lit_from_below(source, [(0.0, 0.0, 0.0)], bench)
        except Missing:  # too wide to shine from one point: in patches
            (found,) = _lit_from_below({**source, "irradiance_error": _ASKED}, [(0.0, 0.0, 0.0)], bench)
        yield Case(_disc_name(ratio), "pi L R^2/(R^2 + h^2)", disc_irradiance(1.0, ratio, 1.0), found, _LIMIT)

    return Check(_disc_name(ratio), (_disc_name(ratio),), run)


CHECKS: Final = (
    Check("2.point_source", tuple(f"2.point_source_{distance:g}_m" for distance in _DISTANCES), _point_source),
    Check("2.parallel_square", ("2.parallel_square_centre", "2.parallel_square_corner"), _parallel_square),
    *map(_disc, _RATIOS),
)
