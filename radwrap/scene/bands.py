"""How many bands a scene's light needs: sources under which all materials look alike share one.

With direct light a source i on a material j adds L_i W_ij to a pixel, with
W_ij the integral over wavelength of the source's spectrum, the material's
reflectance, filter and sensor response: a number, and no approximation. So a
band is a group of sources: each counts with V_i, its W on a white surface, and
each material has one reflectance r_j in it, which stands for W_ij/V_i of all
its sources. Each source belongs to one band, so that bands cost no shadow ray.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, assert_never

from radwrap.errors import InputError
from radwrap.scene.camera import Sensor
from radwrap.scene.colour_planes import refuse_mosaic
from radwrap.scene.materials import (
    Anisotropic,
    CoefficientTable,
    Glass,
    GlassBeads,
    Lambertian,
    Material,
    MeasuredBrdf,
    Mirror,
    PerturbedNormal,
    PrintedImage,
    PrintedSheeting,
    Sheeting,
    Specular,
)
from radwrap.scene.scene import Scene
from radwrap.scene.sources import emitters
from radwrap.scene.spectrum import Spectral

# Up to so many kinds of light the fewest bands are found by trying; of more, the first that fits is taken.
_TRIED: Final = 12
# Relative error of one band that stands for all, where a verb knows no bands.
ONE_BAND_ERROR: Final = 1e-3


@dataclass(frozen=True, slots=True)
class Band:
    """Sources under which each material has one reflectance.

    Attributes
    ----------
    sources : tuple of str
        Names.
    materials : Mapping[str, Material]
        As they look in this band.
    """

    sources: tuple[str, ...]
    materials: Mapping[str, Material]


@dataclass(frozen=True, slots=True)
class Bands:
    """All light of a scene.

    Attributes
    ----------
    bands : tuple of Band
        Each source is in one.
    error : float
        Largest relative error of what a source adds to any pixel.
    """

    bands: tuple[Band, ...]
    error: float


def allowed_error(sensor: Sensor, gray: float) -> float:
    """Largest relative error of the exposure that changes no pixel by more than this [gray level]."""
    return float((1 + gray / (sensor.saturation_gray - sensor.dark_gray)) ** (1 / sensor.gamma) - 1)


def gray_error(sensor: Sensor, error: float) -> float:
    """What a relative error of the exposure does to any pixel at most [gray level]."""
    return float((sensor.saturation_gray - sensor.dark_gray) * ((1 + error) ** sensor.gamma - 1))


def scene_bands(scene: Scene, spectral: Spectral, allowed: float) -> Bands:
    """Bands of a scene's light; sources that are dark in it have none."""
    lit = {source.name for source in scene.sources if any(disc.radiance > 0 for disc in emitters(source))}
    return bands_of(spectral, allowed, lit)


def bands_of(spectral: Spectral, allowed: float, shining: Collection[str] | None = None) -> Bands:
    """Fewest bands whose relative error is no larger than allowed, of all sources or of those that are named."""
    rows = spectral.reflectance
    lit = [
        i
        for i, (name, counts) in enumerate(zip(spectral.sources, spectral.counts, strict=True))
        if counts > 0 and (shining is None or name in shining)
    ]
    groups = fewest_groups([rows[i] for i in lit], allowed)
    bands, error = [], 0.0
    for group in groups:
        members = [lit[i] for i in group]
        middle = [_middle(column) for column in zip(*(rows[i] for i in members), strict=True)]
        error = max([error, *(off for _, off in middle)])
        factors = dict(zip(spectral.materials, (value for value, _ in middle), strict=True))
        materials = {name: scaled(material, factors[name]) for name, material in spectral.materials.items()}
        bands.append(Band(tuple(spectral.sources[i] for i in members), materials))
    return Bands(tuple(bands), error)


def fewest_groups(rows: Sequence[Sequence[float]], allowed: float) -> list[list[int]]:
    """Partition rows into the fewest groups in each of which one value stands for each column, to a relative error."""
    fits = [[all(_middle(pair)[1] <= allowed for pair in zip(a, b, strict=True)) for b in rows] for a in rows]

    # What fits pair by pair fits as a whole: the middle of a column depends on its largest and smallest value alone.
    def placed(groups: list[list[int]], row: int, most: int) -> list[list[int]] | None:
        if row == len(rows):
            return groups
        for group in groups:
            if all(fits[row][other] for other in group):
                found = placed([[*g, row] if g is group else g for g in groups], row + 1, most)
                if found or most == len(rows):  # any number will do: the first that fits
                    return found
        return placed([*groups, [row]], row + 1, most) if len(groups) < most else None

    if len(rows) > _TRIED:
        return placed([], 0, len(rows)) or []
    return next((found for most in range(len(rows) + 1) if (found := placed([], 0, most)) is not None), [])


def _middle(values: Sequence[float]) -> tuple[float, float]:
    """What stands for some values, and its largest relative error."""
    low, high = min(values), max(values)
    if low == high:
        return low, 0.0
    return (math.sqrt(low * high), math.sqrt(high / low) - 1) if low > 0 else (high, math.inf)


def scaled(material: Material, factor: float) -> Material:
    """A material that reflects by a factor more.

    Raises
    ------
    InputError
        If it cannot.
    """
    if factor == 1:  # also of kinds that no spectrum can colour
        return material
    if factor == 0:
        return Lambertian(0.0)
    match material:
        case Lambertian() | PerturbedNormal():
            return replace(material, reflectance=material.reflectance * factor)
        case Specular() | Anisotropic():
            return replace(
                material,
                diffuse_reflectance=material.diffuse_reflectance * factor,
                specular_reflectance=material.specular_reflectance * factor,
            )
        case CoefficientTable():
            rows = tuple(tuple(value * factor for value in row) for row in material.coefficient)
            return replace(material, coefficient=rows)
        case GlassBeads():
            return replace(material, anchor=material.anchor * factor)
        case PrintedSheeting(sheeting, coverage, reflectance):
            below = scaled(sheeting, factor)
            if isinstance(below, Sheeting):
                return PrintedSheeting(below, coverage, reflectance * factor)
        case Mirror() | Glass() | MeasuredBrdf() | PrintedImage():
            pass
        case _:
            assert_never(material)
    raise InputError(f"a spectrum cannot colour a {type(material).__name__}")


def one_band(scene: Scene, where: str) -> Scene:
    """The scene in one band, for what knows no more.

    Raises
    ------
    InputError
        If one is not enough, or there is one for each colour of a mosaic.
    """
    if scene.spectral is None:
        return scene
    refuse_mosaic(scene)
    found = scene_bands(scene, scene.spectral, ONE_BAND_ERROR)
    if len(found.bands) > 1:
        raise InputError(
            f"the scene's colours need {len(found.bands)} bands, and this knows one",
            where=f"{scene.origin}: {where}",
            remedy="leave out the spectra of sources or materials, or sources until one band is enough",
        )
    materials = found.bands[0].materials if found.bands else scene.materials
    return replace(scene, materials={**scene.materials, **materials}, spectral=None)
