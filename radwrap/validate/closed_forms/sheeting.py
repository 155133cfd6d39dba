"""Retroreflection at the angles of ASTM E808: a patch at the origin faces +z, all angles in degrees as printed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# ASTM D4956 Type III, white, minimum R_A [cd lx^-1 m^-2]: (observation, entrance) [deg].
D4956_III_WHITE: Final[Mapping[tuple[float, int], float]] = {
    (0.1, -4): 300.0,
    (0.1, 30): 180.0,
    (0.2, -4): 250.0,
    (0.2, 30): 150.0,
    (0.5, -4): 95.0,
    (0.5, 30): 65.0,
}
# Ward's profile of glass beads: observation angle [deg] -> R_A over that at half a degree.
WARD_PROFILE: Final[Mapping[float, float]] = {
    0.1: 3.85,
    0.2: 3.43,
    0.33: 2.53,
    0.5: 1.0,
    0.716: 0.758,
    0.906: 0.604,
    1.0: 0.549,
    1.5: 0.374,
}
_WARD_ENTRANCE: Final = 2220.0  # deg^2


def light_direction(entrance: float) -> Array:
    """Unit vector to the light, at the entrance angle to the normal [deg]."""
    beta = math.radians(entrance)
    return np.array([math.sin(beta), 0.0, math.cos(beta)])


def view_direction(observation: float, entrance: float, around: float = 0.0) -> Array:
    """Unit vector to the viewer, at the observation angle to the light.

    Parameters
    ----------
    observation, entrance : float
        Angles of ASTM E808 [deg].
    around : float
        On which side of the light [deg]: 0 is away from the normal where the entrance angle is above 0, 90 across.

    Returns
    -------
    ndarray, shape (3,)
    """
    alpha, turn, beta = math.radians(observation), math.radians(around), math.radians(entrance)
    away, across = np.array([math.cos(beta), 0.0, -math.sin(beta)]), np.array([0.0, 1.0, 0.0])
    aside = math.cos(turn) * away + math.sin(turn) * across
    view: Array = math.cos(alpha) * light_direction(entrance) + math.sin(alpha) * aside
    return view


def glass_beads(anchor: float, observation: float, entrance: float = 0.0) -> float:
    """R_A of glass beads after Ward: straight in the logarithm between nodes, times exp(-beta^2/2220 deg^2).

    Parameters
    ----------
    anchor : float
        R_A at half a degree and no entrance angle.
    observation, entrance : float
        [deg].

    Returns
    -------
    float
        In the anchor's unit.
    """
    logarithm = np.interp(observation, list(WARD_PROFILE), np.log(list(WARD_PROFILE.values())))
    return anchor * math.exp(float(logarithm) - entrance**2 / _WARD_ENTRANCE)


def perturbed_normal_lobe(reflectance: float, roughness: float, observation: float) -> float:
    """L/E_perp of the paper's perturbed normal, which is the same at each entrance angle.

    Parameters
    ----------
    reflectance, roughness : float
        rho and a.
    observation : float
        [deg].

    Returns
    -------
    float
        [sr^-1]; rho/(4 pi a^2) at its peak.
    """
    half = math.radians(observation) / 2
    fall = math.exp(-((math.tan(half) / roughness) ** 2)) * math.cos(2 * half) / math.cos(half) ** 6
    return reflectance / (4 * math.pi * roughness**2) * fall
