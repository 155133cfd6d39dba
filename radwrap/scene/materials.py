"""Materials: how a surface turns irradiance into radiance, E -> L.

Angles at retroreflective sheeting (ASTM E808): entrance beta between light and
normal, viewing nu between viewer and normal, observation alpha between
light and viewer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
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


Sheeting = PerturbedNormal | CoefficientTable | GlassBeads


@dataclass(frozen=True, slots=True)
class Anisotropic:
    """A Gaussian lobe as wide along the target's x as brushing leaves it, and otherwise across (Ward 1992).

    Attributes
    ----------
    diffuse_reflectance, specular_reflectance : float
        Shares of the two parts, their sum at most 1.
    roughness_x, roughness_y : float
        Root-mean-square slopes along the target's x and across it.
    """

    diffuse_reflectance: float
    specular_reflectance: float
    roughness_x: float
    roughness_y: float


@dataclass(frozen=True, slots=True)
class Mirror:
    """A flat mirror: sources are seen in it, and shine by it; its back is black.

    Attributes
    ----------
    reflectance : float
        0 to 1, at all angles.
    """

    reflectance: float


@dataclass(frozen=True, slots=True)
class Glass:
    """A thin pane: rays go through without bending, and are mirrored as Fresnel says.

    Attributes
    ----------
    transmittance : float
        Of the whole pane at right angles.
    refractive_index : float
        Of the glass.
    """

    transmittance: float
    refractive_index: float

    @property
    def transmissivity(self) -> float:
        """What one way through the glass leaves: T = (1-F)^2 t/(1 - F^2 t^2), F = ((n-1)/(n+1))^2."""
        fresnel = ((self.refractive_index - 1) / (self.refractive_index + 1)) ** 2
        through, back = (1 - fresnel) ** 2, self.transmittance * fresnel**2
        root = math.sqrt(through**2 + 4 * back * self.transmittance)
        return 2 * self.transmittance / (through + root)


@dataclass(frozen=True, slots=True)
class PrintedSheeting:
    """Black print over sheeting: a share of it is diffuse, and the rest is seen through.

    Attributes
    ----------
    sheeting : Sheeting
        What lies below.
    coverage : float
        What the print takes of the sheeting's light, there and back.
    reflectance : float
        Diffuse reflectance of where the print is.
    """

    sheeting: Sheeting
    coverage: float
    reflectance: float


@dataclass(frozen=True, slots=True)
class MeasuredBrdf:
    """A table of f = dL/dE, for direct light; straight between its nodes, held beyond them.

    Attributes
    ----------
    sha256 : str
        Of the file.
    incidence, viewing, azimuth : tuple of float
        Nodes [rad], increasing; azimuth between light and viewer about the normal, 0 where they are on one side.
    values : tuple of float
        f at the nodes [sr^-1], azimuth fastest.
    """

    sha256: str
    incidence: tuple[float, ...]
    viewing: tuple[float, ...]
    azimuth: tuple[float, ...]
    values: tuple[float, ...] = field(compare=False, repr=False)


@dataclass(frozen=True, slots=True)
class PrintedImage:
    """A diffuse print: an image stretched over a sheet, straight between its pixels' centres.

    Attributes
    ----------
    sha256 : str
        Of the reflectances.
    rows : tuple of tuple of float
        Reflectance of each pixel, top row first.
    """

    sha256: str
    rows: tuple[tuple[float, ...], ...] = field(compare=False, repr=False)


# What a face of it shows is the same from both sides.
TwoSided = Lambertian | Specular | Anisotropic | PrintedImage
Material = (
    Lambertian
    | Specular
    | PerturbedNormal
    | CoefficientTable
    | GlassBeads
    | Anisotropic
    | Mirror
    | Glass
    | PrintedSheeting
    | MeasuredBrdf
    | PrintedImage
)
