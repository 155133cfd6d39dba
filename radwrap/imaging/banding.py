"""Bands of a scene's light: how many a tolerance needs, and what they add to an image's error."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from radwrap.imaging.render_options import RenderOptions
from radwrap.scene.bands import Bands, allowed_error, gray_error, scene_bands
from radwrap.scene.scene import Scene
from radwrap.written import NotNegative

# Share of the tolerance that bands may take, at every pixel alike.
_SHARE: Final = 0.1
# Where sources are to be relit one by one bands must be exact: rounding apart.
_EXACT: Final = 1e-9


@dataclass(frozen=True, slots=True)
class BandsSummary:
    """Which sources share a band, and what bands change at most; the manifest's ``bands``."""

    sources: tuple[tuple[str, ...], ...]
    relative_error: NotNegative
    gray: NotNegative


@dataclass(frozen=True, slots=True)
class Banding:
    """The bands of a run.

    Attributes
    ----------
    bands : Bands or None
        None where the scene tells no spectra.
    gray : float
        What bands change of any pixel at most [gray level].
    """

    bands: Bands | None
    gray: float = 0.0

    def left(self, options: RenderOptions) -> RenderOptions:
        """The options with what bands leave of the tolerance."""
        if self.gray == 0.0:
            return options
        largest = None if options.max_error is None else options.max_error - self.gray
        return replace(options, tolerance=options.gray_tolerance - self.gray, max_error=largest)

    def summary(self) -> BandsSummary | None:
        """What the manifest says; None where the scene tells no spectra."""
        if self.bands is None:
            return None
        groups = tuple(tuple(band.sources) for band in self.bands.bands)
        return BandsSummary(sources=groups, relative_error=self.bands.error, gray=self.gray)


def banding(scene: Scene, options: RenderOptions, *, exact: bool = False) -> Banding:
    """The fewest bands that a run's tolerance allows, or that leave no error."""
    if scene.spectral is None:
        return Banding(None)
    sensor = scene.camera.sensor
    # Of a tolerance that hangs on the noise the least that it can be: no light is known yet.
    tolerance = options.asked_tolerance.in_gray(sensor)
    asked = tolerance if options.max_error is None else min(tolerance, options.max_error)
    allowed = _EXACT if exact or options.basis else allowed_error(sensor, _SHARE * asked)
    found = scene_bands(scene, scene.spectral, allowed)
    return Banding(found, gray_error(sensor, found.error))
