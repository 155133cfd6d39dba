"""The colour planes of a mosaic: when the light of one is that of another, but for a factor."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from radwrap.errors import InputError
from radwrap.scene.mosaic import COLOURS, Colour, Mosaic
from radwrap.scene.scene import Scene
from radwrap.scene.spectrum import Spectral

# Relative difference of integrals that are one: rounding alone.
_ROUNDING: Final = 1e-9
# Relative difference of wavelengths whose waves are one: the footprint's width goes with the wavelength.
_ONE_WAVELENGTH: Final = 1e-3


def mosaic_of(scene: Scene) -> Mosaic:
    """The mosaic that a scene's sensor has.

    Raises
    ------
    InputError
        If it has none.
    """
    mosaic = scene.camera.sensor.mosaic
    if mosaic is None:
        raise InputError("the pixels have no mosaic of colour filters", where=f"{scene.origin}: camera.sensor.mosaic")
    return mosaic


def refuse_mosaic(scene: Scene, what: str = "what is asked") -> None:
    """For what knows one filter on all pixels; `what` names it.

    Raises
    ------
    InputError
        If the scene's pixels have several.
    """
    mosaic = scene.camera.sensor.mosaic
    if mosaic is not None:
        raise InputError(
            f'is "{mosaic.pattern}", and {what} knows one colour only',
            where=f"{scene.origin}: camera.sensor.mosaic",
            remedy='look at one colour: with "red", "green" or "blue" all pixels have its filter',
        )


def shares_of_light(scene: Scene) -> Mapping[Colour, float | None]:
    """Of each colour, its radiant exposure over that of the colour that gets most, the same in every pixel.

    1 of the colour that gets most; 0 of one that gets none; None where no one number is right for all pixels.
    """
    mosaic = mosaic_of(scene)
    whole = scene.spectral
    if whole is not None:
        waves = scene.camera.diffraction is not None
        return {colour: _share(whole.planes[colour], whole, waves=waves) for colour in COLOURS}
    if mosaic.relative is None:
        raise ValueError("filters by the power law count with spectra")
    return dict(zip(COLOURS, mosaic.relative, strict=True))


def _share(plane: Spectral, whole: Spectral, *, waves: bool) -> float | None:
    if not any(plane.counts):
        return 0.0
    lit = [i for i, count in enumerate(whole.counts) if count > 0]
    if any(count > 0 for i, count in enumerate(plane.counts) if i not in lit):
        return None
    shares = [plane.counts[i] / whole.counts[i] for i in lit]
    pairs = [pair for i in lit for pair in zip(plane.reflectance[i], whole.reflectance[i], strict=True)]
    alike = all(map(_near, shares, [shares[0]] * len(lit))) and all(_near(a, b) for a, b in pairs)
    if not alike or (waves and not _near(plane.wavelength, whole.wavelength, _ONE_WAVELENGTH)):
        return None
    return shares[0]


def _near(a: float, b: float, relative: float = _ROUNDING) -> bool:
    return math.isclose(a, b, rel_tol=relative)
