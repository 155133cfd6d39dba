"""Section 1: lamps of known flux."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from radwrap.validate import bench as on
from radwrap.validate.bench import Bench
from radwrap.validate.case import Case, Check, Finding

_FLUX: Final = 100.0  # lm; radwrap's W stands for lm here, as both are the same integral over different spectra
_DIGITS: Final = 2e-5  # of the printed numbers; the lamp of 1 mm at 1 m is off by 2.5e-7
_REFLECTANCE: Final = 0.5
_LAMPS: Final = {"lambertian": (_FLUX / math.pi, None, 31.831), "isotropic": (_FLUX / (4 * math.pi), 85.0, 7.9577)}


def _lamps(bench: Bench) -> Iterator[Finding]:
    """E = I/d^2 below the lamp, by the radiance of a diffuse sheet in a rendered image."""
    for kind, (intensity, half_angle, printed) in _LAMPS.items():
        source = on.lamp((0.0, 0.0, 1.0), radiant_intensity=intensity, half_angle=half_angle)
        camera = on.camera((0.3, 0.0, 1.0))
        scene = on.scene(camera, [source], {"it": on.lambertian(_REFLECTANCE)}, [on.sheet()])
        found = float(on.radiances(scene, bench.exposure(scene))[0, 0]) * math.pi / _REFLECTANCE
        yield Case(f"1.{kind}_100_lm", "LuxCoreRender issue 580", printed, found, _DIGITS)


def _symmetry(bench: Bench) -> Iterator[Finding]:
    """The flux that goes through a half sphere of sheets' normals: the intensity integrated is the flux."""
    theta, weight = np.polynomial.legendre.leggauss(24)
    angles = np.arccos((theta + 1) / 2)
    source = on.lamp((0.0, 0.0, 1.0), radiant_intensity=_FLUX / math.pi, half_angle=None)
    points = np.column_stack([np.tan(angles), 0 * angles, 0 * angles])
    scene = on.scene(on.camera(), [source], {"it": on.lambertian(_REFLECTANCE)}, [on.sheet(2e4)])
    irradiance = bench.irradiance(scene, points, _REFLECTANCE)
    # E = I cos^3 at the height 1; the flux into a half space is 2 pi times the integral of I over cos(theta).
    flux = float(2 * math.pi * (irradiance / np.cos(angles) ** 3) @ weight / 2)
    yield Case("1.lambertian_flux", "integral of I over the half space", _FLUX, flux, _DIGITS)


CHECKS: Final = (
    Check("1.lamps", tuple(f"1.{kind}_100_lm" for kind in _LAMPS), _lamps),
    Check("1.flux", ("1.lambertian_flux",), _symmetry),
)
