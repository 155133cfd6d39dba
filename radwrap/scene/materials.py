"""Materials: how a surface turns irradiance into radiance, E -> L.

Angles at retroreflective sheeting (ASTM E808): entrance beta between light and
normal, viewing nu between viewer and normal, observation alpha between
light and viewer.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

# Encapsulated and exposed glass beads, after Ward: R_A against the observation angle [deg], relative to 0.5 deg.
# The published pieces meet at 0.5 deg with a jump of 7.6 %; here the nodes on both sides are kept and joined
# through 1 at 0.5 deg, straight in the logarithm, so the curve is continuous and the anchor is exact.
GLASS_BEAD_OBSERVATION: Final = (0.1, 0.2, 0.33, 0.5, 0.716, 0.906, 1.0, 1.5, 2.0)
GLASS_BEAD_PROFILE: Final = (3.85, 3.43, 2.53, 1.0, 0.758, 0.604, 0.549, 0.374, 0.287)
# Entrance factor exp(-beta^2/2220) with beta in degrees, after the same source.
GLASS_BEAD_ENTRANCE_SCALE: Final = 2220.0


@dataclass(frozen=True, slots=True)
class Lambertian:
    """Diffuse: L = rho E / pi in every direction.

    Attributes
    ----------
    reflectance : float
        rho, 0 to 1.
    """

    reflectance: float


@dataclass(frozen=True, slots=True)
class Specular:
    """Gaussian lobe about the mirror direction (Ward 1992) over a diffuse part; Sec. 3.3.

    Attributes
    ----------
    diffuse_reflectance, specular_reflectance : float
        Shares of the two parts, their sum at most 1.
    roughness : float
        Root-mean-square slope a of the surface.
    """

    diffuse_reflectance: float
    specular_reflectance: float
    roughness: float


@dataclass(frozen=True, slots=True)
class PerturbedNormal:
    """The paper's retroreflector: a specular lobe whose normal is turned to the viewer (Sec. 3.3).

    L = E_perp rho exp(-tan^2(alpha/2)/a^2) cos(alpha) / (4 pi a^2 cos^6(alpha/2)),
    whatever the entrance angle.

    Attributes
    ----------
    reflectance : float
        rho, 0 to 1.
    roughness : float
        a, width of the lobe.
    """

    reflectance: float
    roughness: float


@dataclass(frozen=True, slots=True)
class CoefficientTable:
    """Sheeting by measured R_A: L = R_A E_perp / cos(nu).

    Attributes
    ----------
    observation, entrance : tuple of float
        Nodes alpha and beta [rad], increasing; beta without sign.
    coefficient : tuple of tuple of float
        R_A at the nodes, a row for each observation angle [cd lx^-1 m^-2 = sr^-1].
    interpolation : str
        "linear" or "log" (straight in ln R_A).
    outside : str
        "refuse" a scene that needs angles outside the table, or "hold" the value at its edge.
    """

    observation: tuple[float, ...]
    entrance: tuple[float, ...]
    coefficient: tuple[tuple[float, ...], ...]
    interpolation: Literal["linear", "log"] = "log"
    outside: Literal["refuse", "hold"] = "refuse"


@dataclass(frozen=True, slots=True)
class GlassBeads:
    """Sheeting by a function: R_A = anchor g(alpha) exp(-beta^2/2220 deg^2), glass beads after Ward.

    Attributes
    ----------
    anchor : float
        R_A at alpha = 0.5 deg, beta = 0 [cd lx^-1 m^-2 = sr^-1].
    outside : str
        "refuse" a scene that needs alpha outside 0.1 to 2 deg, or "hold" the value at the edge.
    """

    anchor: float
    outside: Literal["refuse", "hold"] = "refuse"


Material = Lambertian | Specular | PerturbedNormal | CoefficientTable | GlassBeads
