"""The manifest of a run: what was made, of what, with what, and how far it is off."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.banding import BandsSummary
from radwrap.imaging.forecast.cost import Foretold
from radwrap.imaging.forecast.effects import Effect
from radwrap.imaging.optics.aperture import Layout
from radwrap.imaging.optics.view import PixelSampling
from radwrap.imaging.output.assumed_values import AssumedEffect
from radwrap.imaging.render_options import Method
from radwrap.imaging.tolerance.certificate import Certificate
from radwrap.imaging.tolerance.lit_noise import ToleranceAsked
from radwrap.imaging.tolerance.search_record import SearchRecord
from radwrap.imaging.tolerance.uncertainty import UncertaintySummary
from radwrap.imaging.tracer_choice import TracerUsed
from radwrap.manifest import ONLY_WHERE_USED, SCHEMA_VERSION, plain, read_manifest, write_manifest
from radwrap.scene.mosaic import Colour, Pattern
from radwrap.scene.scene import Scene
from radwrap.written import Count, Hashes, NotNegative, Positive, Rays, Sha256, Share, read_back

MANIFEST: Final = "manifest.json"
# Names of effects that do not speak for themselves.
_NAMES: Final = {"bounces": "light between surfaces", "finite_aperture": "the finite aperture"}

Bounces = int | Literal["all"]


@dataclass(frozen=True, slots=True)
class Extent:
    """Least, largest and mean value of an image."""

    min: float
    max: float
    mean: float

    @classmethod
    def of(cls, values: NDArray[np.float64]) -> Extent:
        """Of an image's values."""
        return cls(float(values.min()), float(values.max()), float(values.mean()))


@dataclass(frozen=True, slots=True)
class BouncesTraced:
    """Light from surface to surface that was traced: how often it goes at most, and about what it changes."""

    orders: Rays | Literal["all"]
    about_rms_gray: NotNegative


@dataclass(frozen=True, slots=True)
class DiffractionTaken:
    """Diffraction that the image has: at which wavelength [m], about what it changes, and rays for it.

    Where sources differ, ``wavelength`` is their mean, and ``wavelengths`` are those that were taken. ``lasting_gray``
    is what of the error no more rays make smaller: light behind near edges, from far away, or of a lens
    that differs over the field.
    """

    wavelength: Positive
    about_rms_gray: NotNegative
    rays: Rays
    wavelengths: tuple[Positive, ...] | None = field(default=None, metadata=ONLY_WHERE_USED)
    lasting_gray: NotNegative | None = field(default=None, metadata=ONLY_WHERE_USED)


@dataclass(frozen=True, slots=True)
class ComponentUsed:
    """A component of the catalog: where the scene names it, which file it was, and all its values."""

    key: str
    kind: str
    name: str
    place: str
    revision: str
    sha256: Sha256
    used: tuple[str, ...]
    values: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class PlaneMade:
    """The pixels of one colour of a mosaic.

    Attributes
    ----------
    pixels : int
        How many.
    light_of : str
        Colour of the render that their light is taken from.
    share : float
        Their radiant exposure over that render's.
    run_sha256, scene_sha256 : str
        Of that render.
    tolerance : float or None
        That it was made to [gray level].
    gray : Extent
        Of the pixels' gray levels.
    error : Certificate
        How far they may be off, before rounding.
    """

    pixels: Count
    light_of: Colour
    share: NotNegative
    run_sha256: Sha256
    scene_sha256: Sha256
    tolerance: Positive | None
    gray: Extent
    error: Certificate


@dataclass(frozen=True, slots=True)
class MosaicMade:
    """The mosaic of a raw image: its pattern, a hash of its filters, and what was made of each colour."""

    pattern: Pattern
    filters_sha256: Sha256
    colours: Mapping[Colour, PlaneMade]


@dataclass(frozen=True, slots=True)
class InTime:
    """What happens in the course of the exposure: renders at instants, and about what it changes.

    ``about_rms_gray`` is the difference from the image of the middle of the first exposure, all rows alike.
    """

    instants: Count
    about_rms_gray: NotNegative


@dataclass(frozen=True, slots=True)
class Timing:
    """What a run took, and what was said of that before: the one part of a manifest that differs between equal runs."""

    wall_s: NotNegative
    tracer_cpu_s: NotNegative
    workers: Count
    reused_viewpoints: Rays
    forecast: Foretold | None = field(default=None, metadata=ONLY_WHERE_USED)


@dataclass(frozen=True, slots=True, kw_only=True)
class RunManifest:
    """What manifest.json holds, under the same names.

    Attributes
    ----------
    schema_version : int
        Another version's manifest is not read.
    scene_sha256, run_sha256 : str
        Hash of the scene, and of all that decides any file.
    method, layout, viewpoints, pixel_samples, pixel_sampling, rays_per_pixel, rays
        As in `MethodUsed`.
    tolerance, max_error : float or None
        That the image was made to [gray level]; None where the rays were fixed beforehand.
    tolerance_asked : ToleranceAsked or None
        The tolerance as it was asked for, where that is not in gray levels.
    plan : SearchRecord or None
        How the image to that tolerance came about.
    seed : int
        Of all that is drawn.
    trust : bool
        Whether included files may run programs.
    tracer : TracerUsed
        Which tracer, and why.
    versions, assumed : Mapping[str, str]
        Of everything that a file depends on; key of the scene -> default that was taken.
    components : tuple of ComponentUsed or None
        What the scene takes from the catalog: enough to make the image again without the files.
    assumed_effects : tuple of AssumedEffect or None
        What those of its values decide that nobody published, where a range is known.
    camera : Mapping
        As `radwrap.manifest.plain` gives it.
    scene : str
        The scene's document, as JSON.
    warnings : tuple of str
        For the user.
    radiant_exposure, gray : Extent
        Of the image [J m^-2] and [gray level].
    saturated_fraction, dark_fraction : float
        Shares of the pixels.
    error : Certificate
        How far the gray levels may be off, before rounding.
    uncertainty : UncertaintySummary or None
        How far a captured frame may be off, where the scene states tolerances or noise.
    bands : BandsSummary or None
        Where the scene tells spectra.
    left_out : Mapping[str, Effect]
        Effect -> what leaving it out costs.
    bounces : BouncesTraced or None
        Where light from surface to surface was traced.
    diffraction : DiffractionTaken or None
        Where the image has it.
    mosaic : MosaicMade or None
        Where the pixels have different colour filters.
    in_time : InTime or None
        Where targets move, sources are strobed or rows have times of their own.
    files : Mapping[str, str]
        File -> its SHA-256.
    timing : Timing
        What it took.
    """

    schema_version: int = SCHEMA_VERSION
    scene_sha256: Sha256
    run_sha256: Sha256
    method: Method
    layout: Layout | None
    viewpoints: Count | None
    pixel_samples: Count | None
    pixel_sampling: PixelSampling | None
    tolerance: Positive | None = field(default=None, metadata=ONLY_WHERE_USED)
    tolerance_asked: ToleranceAsked | None = field(default=None, metadata=ONLY_WHERE_USED)
    max_error: Positive | None = None
    rays_per_pixel: NotNegative
    rays: Rays
    plan: SearchRecord | None = field(default=None, metadata=ONLY_WHERE_USED)
    seed: int
    trust: bool
    tracer: TracerUsed | None = field(default=None, metadata=ONLY_WHERE_USED)
    versions: Mapping[str, str]
    assumed: Mapping[str, str]
    components: tuple[ComponentUsed, ...] | None = field(default=None, metadata=ONLY_WHERE_USED)
    assumed_effects: tuple[AssumedEffect, ...] | None = field(default=None, metadata=ONLY_WHERE_USED)
    camera: Mapping[str, Any]
    scene: str
    warnings: tuple[str, ...]
    radiant_exposure: Extent
    gray: Extent
    saturated_fraction: Share
    dark_fraction: Share
    error: Certificate
    uncertainty: UncertaintySummary | None = field(default=None, metadata=ONLY_WHERE_USED)
    bands: BandsSummary | None = field(default=None, metadata=ONLY_WHERE_USED)
    left_out: Mapping[str, Effect]
    bounces: BouncesTraced | None = field(default=None, metadata=ONLY_WHERE_USED)
    diffraction: DiffractionTaken | None = field(default=None, metadata=ONLY_WHERE_USED)
    mosaic: MosaicMade | None = field(default=None, metadata=ONLY_WHERE_USED)
    in_time: InTime | None = field(default=None, metadata=ONLY_WHERE_USED)
    files: Hashes
    timing: Timing

    @property
    def missing(self) -> str:
        """What is left out although it matters, in gray levels, for those who read the error; "" where nothing is."""
        needed = (left for left in self.left_out.values() if left.needed)
        return ", ".join(
            f"{_NAMES.get(left.name, left.name)} {left.rms_gray:.2g} (at most {left.rms_gray_upper95:.2g})"
            for left in needed
        )

    @property
    def met(self) -> bool:
        """Whether the tolerance is kept; what has none keeps it."""
        if self.in_time is not None:
            return self.tolerance is None or self.error.rms_gray_upper95 <= self.tolerance
        return self.plan is None or self.plan.met


def components_used(scene: Scene) -> tuple[ComponentUsed, ...] | None:
    """What a scene takes from the catalog, None where that is nothing."""
    found = [(taken, taken.component) for taken in scene.components]
    return (
        tuple(
            ComponentUsed(
                key=taken.key,
                kind=one.kind,
                name=one.name,
                place=one.place,
                revision=one.revision,
                sha256=one.sha256,
                used=taken.used,
                values=dict(one.values),
            )
            for taken, one in found
        )
        or None
    )


def write_run_manifest(folder: Path, manifest: RunManifest) -> None:
    """Write manifest.json, whole or not at all."""
    told = plain(manifest, named=False)
    if manifest.plan is None:  # None is also what a tolerance without a largest error says
        del told["max_error"]
    write_manifest(folder / MANIFEST, told)


def run_manifest_of(told: Mapping[str, Any], where: str) -> RunManifest:
    """The values of a manifest.json that was read; keys that are not known are left out.

    Raises
    ------
    InputError
        If it is damaged, with the key.
    """
    found: RunManifest = read_back(told, RunManifest, where)
    return found


def read_run_manifest(folder: Path) -> RunManifest:
    """Read the manifest.json of a folder.

    Raises
    ------
    InputError
        If there is none of this schema version, or it is damaged.
    """
    return run_manifest_of(read_manifest(folder / MANIFEST), str(folder / MANIFEST))
