"""What a run leaves as JSON beside its manifest, as its readers need it: truth and light basis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Final

from pydantic import Field

from radwrap.scene.camera import Camera
from radwrap.scene.shutter import Strobe
from radwrap.scene.tolerances import Tolerances
from radwrap.written import Count, Hashes, Index, InnerName, NotNegative, Positive, Rays, Sha256, Share

# Of a scene that changes in the course of its exposure: what tells of its light bases, and their folder.
TIMED_BASIS: Final = "basis_in_time.json"
BASES: Final = "instants"
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
    parts: list[tuple[InnerName, Count, Count]] | None = None  # with rows and columns, where one file holds all

    def __post_init__(self) -> None:
        sensor = self.camera.sensor
        if min(sensor.rows, sensor.columns) < 1 or sensor.rows * sensor.columns > _MOST_PIXELS:
            raise ValueError(f"camera.sensor has {sensor.rows} rows and {sensor.columns} columns")
        if len(set(self.sources)) < len(self.sources):
            raise ValueError("two sources have one name")
        pixels = [*self.grid_pixels, *(self.model.pixels if self.model else [])]
        if max(pixels, default=0) >= sensor.rows * sensor.columns:
            raise ValueError("grid_pixels or model.pixels name a pixel that the sensor does not have")


@dataclass(frozen=True, slots=True)
class RowsFile:
    """Of a basis in time of a scene in which nothing moves.

    Attributes
    ----------
    basis : str
        Folder of the basis: of all rows alike, each source as it is in the row that it shines into longest.
    largest : dict
        Source of that basis -> how long it shines into that row, as a share of the exposure time.
    strobes : dict
        Likewise -> its pulses; those that always shine are not in it.
    missed : dict
        Source that the basis lacks, as none of its pulses meets an exposure -> its pulses.
    """

    basis: InnerName
    largest: dict[str, Positive]
    strobes: dict[str, Strobe]
    missed: dict[str, Strobe]


@dataclass(frozen=True, slots=True)
class InstantFile:
    """An instant's basis: its number among the times of its light, its folder, and its first row in the image."""

    number: Index
    basis: InnerName
    first: Index


@dataclass(frozen=True, slots=True)
class LightFile:
    """The instants of sources that shine at the same times, as `imaging.time_steps.Steps` has them."""

    sources: tuple[str, ...]
    strobe: Strobe | None
    first: float
    last: float
    times: list[float]
    weights: list[list[NotNegative]]
    without_every_second: list[list[NotNegative]]
    instants: list[InstantFile]

    def __post_init__(self) -> None:
        for rows in (self.weights, self.without_every_second):
            if not rows or any(len(row) != len(self.times) for row in rows):
                raise ValueError("its weights are not of its times")
        if any(instant.number >= len(self.times) for instant in self.instants):
            raise ValueError("an instant has no time")


@dataclass(frozen=True, slots=True)
class TimedBasisFile:
    """What basis_in_time.json holds: rows of one basis where nothing moves, else the bases of instants."""

    scene_sha256: Sha256
    camera: Camera
    tolerance: Positive
    rows: RowsFile | None
    lights: tuple[LightFile, ...]

    def __post_init__(self) -> None:
        if (self.rows is None) == (not self.lights):
            raise ValueError("it has no light, or two kinds of it")
