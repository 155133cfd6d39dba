"""What a run leaves as JSON beside its manifest, as its readers need it: truth and light basis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Final

from pydantic import Field

from radwrap.scene.camera import Camera
from radwrap.scene.tolerances import Tolerances
from radwrap.written import Count, Hashes, Index, Positive, Rays, Sha256, Share

_MOST_REPLICATES: Final = 1024
_MOST_PIXELS: Final = 1 << 28


@dataclass(frozen=True, slots=True)
class PartNumbers:
    """Of truth.json: part -> its number in the mask."""

    parts: dict[str, Index]


@dataclass(frozen=True, slots=True)
class SampleFile:
    """Pixels at which the kernel's model was held against rays."""

    pixels: list[Index]
    stratum: list[Index]
    shares: list[Share]
    pairs: list[Count]
    rays: Rays

    def __post_init__(self) -> None:
        if not len(self.pixels) == len(self.stratum) == len(self.pairs):
            raise ValueError("its lists are of different lengths")
        if max(self.stratum, default=-1) >= len(self.shares):
            raise ValueError("a stratum has no share")


@dataclass(frozen=True, slots=True)
class WavesFile:
    """Diffraction that the images of a basis have: at which wavelength [m]."""

    wavelength: Positive


@dataclass(frozen=True, slots=True)
class BasisFile:
    """What basis.json holds."""

    sources: Annotated[tuple[str, ...], Field(min_length=1)]
    dark: tuple[str, ...]
    files: Hashes
    replicates: Annotated[int, Field(ge=2, le=_MOST_REPLICATES)]
    block: tuple[Count, Count]
    exposure_of_radiance: Positive
    camera: Camera
    grid_pixels: list[Index]
    model: SampleFile | None
    tolerance: Positive
    max_error: Positive | None
    scene_sha256: Sha256
    tolerances: Tolerances | None
    even: bool = False
    smooth_share: Annotated[float, Field(gt=0, le=1)] = 1.0
    every_pixel: bool = False
    waves: WavesFile | None = None

    def __post_init__(self) -> None:
        sensor = self.camera.sensor
        if min(sensor.rows, sensor.columns) < 1 or sensor.rows * sensor.columns > _MOST_PIXELS:
            raise ValueError(f"camera.sensor has {sensor.rows} rows and {sensor.columns} columns")
        if len(set(self.sources)) < len(self.sources):
            raise ValueError("two sources have one name")
        pixels = [*self.grid_pixels, *(self.model.pixels if self.model else [])]
        if max(pixels, default=0) >= sensor.rows * sensor.columns:
            raise ValueError("grid_pixels or model.pixels name a pixel that the sensor does not have")
