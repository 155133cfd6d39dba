"""Raw images of a colour camera for any levels of the sources: of the bases of its colours, each pixel by its own."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.images import ExposureImage, GrayImage
from radwrap.imaging.other_camera import basis_in_other_camera, scene_text_of
from radwrap.imaging.output.folder import PLANES
from radwrap.imaging.output.run_manifest import MANIFEST, RunManifest, read_run_manifest
from radwrap.imaging.relight.basis import BASIS
from radwrap.imaging.relight.relit import Basis, Relit, read_basis, relit
from radwrap.imaging.relight.relit_uncertainty import relit_uncertainty
from radwrap.imaging.response.sensor import gray_levels, image_of_levels
from radwrap.imaging.run_files import TIMED_BASIS
from radwrap.imaging.timed_basis import MovingBasis, read_timed_basis
from radwrap.imaging.tolerance.raw_error import error_of_all, uncertainty_of_all, without_error
from radwrap.imaging.tolerance.uncertainty import Uncertainty, uncertainty
from radwrap.scene.mosaic import COLOURS, Colour, Pattern, composed, pixels_of
from radwrap.scene.tolerances import Tolerances

Array = NDArray[np.float64]

_NOTHING: Final[Mapping[str, Any]] = {}
_FILTERS: Final = ("camera.sensor.mosaic", "camera.sensor.filters")


@dataclass(frozen=True, slots=True, eq=False)
class RawBasis:
    """The light bases of a mosaic's colours.

    Attributes
    ----------
    pattern : str
        Of the mosaic.
    planes : Mapping of str to Basis
        Of each colour that gets light, as if all pixels had its filter.
    relative : Mapping of str to float
        A colour's radiant exposure as the mosaic's sensor counts it, over that of its basis.
    scene_sha256 : str
        Of the scene with the mosaic.
    """

    pattern: Pattern
    planes: Mapping[Colour, Basis]
    relative: Mapping[Colour, float]
    scene_sha256: str

    @property
    def first(self) -> Basis:
        """That of one colour, for what is the same in all."""
        return next(iter(self.planes.values()))

    @property
    def sources(self) -> tuple[str, ...]:
        """Names of the sources that any colour sees."""
        return tuple(dict.fromkeys(name for basis in self.planes.values() for name in basis.sources))

    @property
    def dark(self) -> tuple[str, ...]:
        """Names of those that none sees."""
        return tuple(name for name in self.first.dark if name not in self.sources)

    @property
    def tolerance(self) -> float:
        """That each colour was made to in the light of all sources [gray level]."""
        return self.first.tolerance

    @property
    def max_error(self) -> float | None:
        """Likewise for 99 % of the pixels."""
        return self.first.max_error


@dataclass(frozen=True, slots=True, eq=False)
class RawRelit:
    """A raw image in its own light: the image, how far its pixels scatter, and the colours it is composed of."""

    image: Relit
    uncertainty: Uncertainty
    colours: Mapping[Colour, Relit]

    def keeps(self, basis: RawBasis) -> bool:
        """Whether each colour keeps the tolerance that the bases were made for."""
        return all(image.keeps(basis.planes[colour]) for colour, image in self.colours.items())


def read_raw_basis(
    folder: Path, run: RunManifest, changes: Mapping[str, Any] = _NOTHING, scene_folder: Path | None = None
) -> RawBasis:
    """Read the bases that ``radwrap render --basis`` wrote of a scene with a mosaic.

    Parameters
    ----------
    folder : Path
        Of the run.
    run : RunManifest
        Its manifest.
    changes : Mapping
        Exposure time or electronics of the sensor that are others, see `basis_in_other_camera`.
    scene_folder : Path, optional
        Where files lie that its camera names.

    Raises
    ------
    InputError
        If there is none, one is not that of the run, or a change is one of the light; so is one of the filters.
    """
    made = run.mosaic
    if made is None:
        raise InputError("is not of a colour camera", where=str(folder / MANIFEST))
    for key in changes:
        if key.startswith(_FILTERS):
            raise InputError("changes which light a pixel gets", where=key, remedy="render that camera")
    own = {colour: plane for colour, plane in made.colours.items() if plane.light_of == colour}
    first = folder / PLANES / next(iter(own))
    if not any((first / name).is_file() for name in (BASIS, TIMED_BASIS)) or any(
        plane.share and colour not in own for colour, plane in made.colours.items()
    ):
        raise InputError("holds no light basis", where=str(folder), remedy="render with `basis`")
    planes: dict[Colour, Basis] = {}
    before: dict[Colour, Basis] = {}
    for colour in COLOURS:
        if colour in own:
            plane = partial(_plane, folder / PLANES / colour, scene_folder=scene_folder)
            before[colour] = plane({})
            if before[colour].scene_sha256 != own[colour].scene_sha256:
                raise InputError(
                    "is of another run", where=str(folder / PLANES / colour), remedy="make the basis again"
                )
            planes[colour] = plane(changes) if changes else before[colour]
    return RawBasis(made.pattern, planes, _relative(before, spectral=run.bands is not None), run.scene_sha256)


def _plane(folder: Path, changes: Mapping[str, Any], scene_folder: Path | None) -> Basis:
    """The basis of one colour."""
    if (folder / TIMED_BASIS).is_file():
        found = read_timed_basis(folder, read_run_manifest(folder), changes, scene_folder)
        if isinstance(found, MovingBasis):
            raise InputError("is a basis of a colour camera in which something moves", where=str(folder))
        return found
    basis = read_basis(folder)
    return basis_in_other_camera(basis, scene_text_of(folder, basis, scene_folder), changes)


def _relative(planes: Mapping[Colour, Basis], *, spectral: bool) -> dict[Colour, float]:
    """Without spectra a plane counts by its own quantum efficiency, the mosaic by the largest."""
    counted = {colour: basis.sensor.linear for colour, basis in planes.items()}
    known = {colour: one.quantum_efficiency for colour, one in counted.items() if one is not None}
    if spectral or len(known) < len(planes):
        return dict.fromkeys(planes, 1.0)
    return {colour: value / max(known.values()) for colour, value in known.items()}


def raw_relit(basis: RawBasis, factors: Sequence[Sequence[float]] | Array) -> Iterator[RawRelit]:
    """Raw images for any levels of the sources, shape (images, sources); see `relit`."""
    levels, sources = np.array(factors, dtype=np.float64), basis.sources
    if levels.ndim != 2 or levels.shape[1] != len(sources):
        raise InputError(f"have the shape {levels.shape}", where="factors", remedy="give one for each image and source")
    each = {
        colour: levels[:, [sources.index(name) for name in plane.sources]] for colour, plane in basis.planes.items()
    }
    images = {colour: relit(plane, each[colour]) for colour, plane in basis.planes.items()}
    for number in range(len(levels)):
        colours = {colour: next(made) for colour, made in images.items()}
        yield _raw_of(basis, colours, {colour: each[colour][number] for colour in colours})


def _raw_of(basis: RawBasis, colours: Mapping[Colour, Relit], factors: Mapping[Colour, Array]) -> RawRelit:
    pattern, camera = basis.pattern, basis.first.camera
    nothing = np.zeros((camera.sensor.rows, camera.sensor.columns))
    like = next(iter(colours.values()))
    exposures, levels, errors, sigmas = {}, {}, {}, {}
    for colour in COLOURS:
        if colour in colours:
            image, plane = colours[colour], basis.planes[colour]
            exposures[colour] = image.radiant_exposure.values * basis.relative[colour]
            levels[colour] = gray_levels(image.radiant_exposure.values, plane.sensor)
            errors[colour] = image.certificate
            sigmas[colour] = relit_uncertainty(plane, factors[colour], image)
        else:
            exposures[colour] = nothing
            levels[colour] = gray_levels(nothing, camera.sensor)
            errors[colour] = without_error(like.certificate)
            sigmas[colour] = uncertainty(ExposureImage(nothing), camera, Tolerances(), 0.0)
    pixels = {colour: pixels_of(pattern, colour, nothing.shape) for colour in COLOURS}
    certificate = error_of_all(pixels, errors, [image.certificate for image in colours.values()])
    raw = composed(pattern, levels)
    exposure = ExposureImage(composed(pattern, exposures), {"scene": basis.scene_sha256})
    gray: GrayImage = image_of_levels(raw, camera.sensor, exposure.provenance)
    saturated = float(np.mean(raw >= camera.sensor.saturation_gray))
    return RawRelit(Relit(exposure, gray, certificate, saturated), uncertainty_of_all(pattern, sigmas), dict(colours))
