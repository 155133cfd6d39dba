"""Section 5: a photometric bench for sheeting, R_A = L cos(nu)/E_perp at the angles of ASTM E808 and E810."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.scene.scene import Scene
from radwrap.validate import bench as on
from radwrap.validate.bench import Bench
from radwrap.validate.case import Case, Check, Finding, Plot
from radwrap.validate.closed_forms.sheeting import (
    D4956_III_WHITE,
    glass_beads,
    light_direction,
    perturbed_normal_lobe,
    view_direction,
)

Array = NDArray[np.float64]

_R_A: Final = 1e-5
_LOBE: Final = 1e-6
_LAMP, _EYE, _INTENSITY = 1.3, 1.0, 0.5  # the lamp stands behind the viewer, who casts no shadow
_IRRADIANCE: Final = _INTENSITY / _LAMP**2

_TABLE: Final[Mapping[str, Any]] = {
    "type": "retroreflective",
    "model": "coefficient",
    "observation_angles": ["0.1 deg", "0.2 deg", "0.5 deg"],
    "entrance_angles": ["-4 deg", "30 deg"],
    "coefficients": [[f"{D4956_III_WHITE[alpha, beta]} cd/lx/m^2" for beta in (-4, 30)] for alpha in (0.1, 0.2, 0.5)],
    "outside": "refuse",
}
_ANCHOR: Final = 95.0
_BEADS: Final[Mapping[str, Any]] = {
    "type": "retroreflective",
    "model": "coefficient",
    "function": "glass_beads",
    "anchor": f"{_ANCHOR} cd/lx/m^2",
    "outside": "refuse",
}
# The two angles under which the ring of 25 mm is seen, at 1 m and 0.79 m.
_SEEN: Final = (0.716, 0.906)
_BENCH: Final = [(alpha, beta) for alpha in (0.2, 0.5) for beta in (-4, 30)]

_ENTRANCES: Final = (0.0, 5.0, 30.0, 60.0, 80.0, 85.0)
_OBSERVATIONS: Final = (0.0, 0.2, 0.716, 0.906, 2.0)
_RHO, _ROUGHNESS = 0.6, 0.02


def _patch(material: Mapping[str, Any], beta: float, eye: Array) -> Scene:
    lamp = on.lamp(_LAMP * light_direction(beta), diameter=2e-4, radiant_intensity=_INTENSITY)
    disc = {"type": "disc", "material": "it", "diameter": "20 mm"}
    return on.scene(on.camera(_EYE * eye), [lamp], {"it": dict(material)}, [disc])


def _bench_names() -> tuple[str, ...]:
    return tuple(f"5.r_a_{alpha:g}_{beta:g}" for alpha, beta in (*_BENCH, *((alpha, 0) for alpha in _SEEN)))


def _coefficients(bench: Bench) -> Iterator[Finding]:
    """Each by a rendered image of one pixel."""
    asked = [(alpha, beta, _TABLE, D4956_III_WHITE[alpha, beta], "ASTM D4956 type III") for alpha, beta in _BENCH]
    asked += [(alpha, 0, _BEADS, glass_beads(_ANCHOR, alpha), "Ward's glass beads") for alpha in _SEEN]
    for name, (alpha, beta, material, reference, source) in zip(_bench_names(), asked, strict=True):
        eye = view_direction(alpha, beta, 90.0)
        scene = _patch(material, beta, eye)
        found = float(on.radiances(scene, bench.exposure(scene))[0, 0]) * eye[2] / _IRRADIANCE
        yield Case(name, f"{source}; ASTM E810 geometry", reference, found, _R_A)


def _perturbed(bench: Bench) -> Iterator[Finding]:
    material = {"type": "retroreflective", "model": "perturbed_normal", "reflectance": _RHO, "roughness": _ROUGHNESS}
    seen = [(alpha, turn) for alpha in _OBSERVATIONS for turn in (0.0, 90.0, 180.0)]
    expected = np.array([perturbed_normal_lobe(_RHO, _ROUGHNESS, alpha) for alpha, _ in seen])
    for beta in _ENTRANCES:
        eyes = np.array([view_direction(alpha, beta, turn) for alpha, turn in seen])
        scene = _patch(material, beta, eyes[0])
        found = bench.radiance(scene, eyes * _EYE, np.zeros((len(eyes), 3))) / _IRRADIANCE
        worst = int(np.abs(found / expected - 1).argmax())
        name = f"5.lobe_entrance_{beta:g}_deg"
        yield Case(name, "the paper's lobe; the worst of 15 views", float(expected[worst]), float(found[worst]), _LOBE)
    alpha = np.array([angle for angle, turn in seen if turn == 90.0])
    line = np.linspace(0, 2, 101)
    curves = {
        "reference": (line, np.array([perturbed_normal_lobe(_RHO, _ROUGHNESS, angle) for angle in line.tolist()])),
        "radwrap, entrance 85 deg": (alpha, found[1::3]),
    }
    yield Plot("Lobe of the perturbed normal", "observation angle [deg]", "L/E_perp [1/sr]", curves)


CHECKS: Final = (
    Check("5.r_a", _bench_names(), _coefficients),
    Check("5.lobe", tuple(f"5.lobe_entrance_{beta:g}_deg" for beta in _ENTRANCES), _perturbed),
)
