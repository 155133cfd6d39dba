"""The scene file's tables of lenses and spectra as pydantic models."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, model_validator

from radwrap.scene.file.border import (
    TERM_NUMBER,
    ComponentName,
    Model,
    OpticalPath,
    PositiveShare,
    Share,
    Size,
    SizeOrZero,
    Wavelength,
    exactly_one,
)

FileName = Annotated[str, Field(strict=True, min_length=1, max_length=1000)]
FNumber = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.1, le=1e6)]
TermNumber = Annotated[str, Field(strict=True, pattern=TERM_NUMBER)]


# Keys of a lens that say how it differs from a perfect one.
GLASS = ("wavefront", "mtf", "psf")


class FieldModel(Model):
    """An entry of [camera.lens.wavefront] fields."""

    height: SizeOrZero
    """How far from the axis, on the sensor."""
    coefficients: Annotated[dict[TermNumber, OpticalPath], Field(max_length=231)]
    """Number of a polynomial and its path there; longer is positive."""


class WavefrontModel(Model):
    """[camera.lens.wavefront]: what the glass adds to the path of light over the pupil, as Zernike coefficients."""

    convention: Literal["osa", "noll", "fringe"]
    """How the polynomials are numbered; osa and noll have unit rms, fringe has unit peak."""
    coefficients: Annotated[dict[TermNumber, OpticalPath], Field(min_length=1, max_length=231)] | None = None
    """Number of a polynomial and its path, the same for all of the image; longer is positive."""
    file: FileName | None = None
    """CSV table beside the scene, in place of coefficients: field_height_mm, index, coefficient [m]."""
    fields: Annotated[tuple[FieldModel, ...], Field(min_length=2, max_length=200)] | None = None
    """The same table in the scene's own file, from the axis on."""
    pupil_diameter: Size | None = None
    """Diameter of the disc that the polynomials belong to; default the opening's."""

    @model_validator(mode="after")
    def _one_place(self) -> WavefrontModel:
        exactly_one(self, "coefficients", "file", "fields")
        return self


class ContrastModel(Model):
    """[camera.lens.mtf]: what contrast a data sheet says that the lens leaves in focus."""

    file: FileName
    """CSV table beside the scene: frequency_per_mm, tangential, sagittal, and field_height_mm where it has several."""
    f_number: FNumber
    """F-number at which the contrast was measured or computed: the camera's own."""
    wavelength: Wavelength
    """Mean one of the light that it holds for."""


class PointSpreadModel(Model):
    """[camera.lens.psf]: how the lens was seen to spread the light of a point in focus."""

    file: FileName
    """Gray picture beside the scene, erect, linear in light, without a background: PNG, TIFF, PGM or EXR."""
    pitch: Size
    """Distance between its pixels on the sensor."""


class LensModel(Model):
    """[camera.lens]: a thin lens in the opening's plane."""

    preset: ComponentName | None = None
    """Name of a lens of the catalog; keys beside it, and camera.focal_length, replace its values."""
    focus_distance: Size
    """Distance along the axis from the lens to the plane that is sharp."""
    f_number: FNumber | None = None
    """Focal length over the opening's diameter; in place of aperture.diameter."""
    transmission: PositiveShare = 1.0
    """Share of the light that the lens lets through, 0 to 1."""
    falloff: Literal["cos4", "none"] | None = None
    """Falloff of the light towards the corners: cos^4 of the field angle, or none."""
    relative_illumination: tuple[tuple[SizeOrZero, PositiveShare], ...] | None = None
    """Pairs of image height and share of the light on the axis, from ["0 mm", 1.0] on; in place of falloff."""
    wavefront: WavefrontModel | None = None
    """How the lens differs from a perfect one, by Zernike polynomials."""
    mtf: ContrastModel | None = None
    """The same by a data sheet's contrast; in place of wavefront."""
    psf: PointSpreadModel | None = None
    """The same by a measured point spread, which has diffraction in it; in place of both."""

    @model_validator(mode="after")
    def _one_kind_of_glass(self) -> LensModel:
        given = [key for key in GLASS if getattr(self, key) is not None]
        if len(given) > 1:
            raise ValueError(f"has {' and '.join(given)}, which say the same: give one of them")
        return self

    @model_validator(mode="after")
    def _consistent(self) -> LensModel:
        table = self.relative_illumination
        if table is None:
            return self
        if self.falloff is not None:
            raise ValueError("relative_illumination takes the place of falloff: give one of them")
        heights = [height for height, _ in table]
        if not table or table[0] != (0.0, 1.0):
            raise ValueError('relative_illumination must begin with ["0 mm", 1.0], the axis')
        if any(a >= b for a, b in pairwise(heights)):
            raise ValueError("relative_illumination: heights must increase")
        return self


class CurveModel(Model):
    """A quantity over wavelength: a table in a file beside the scene."""

    file: FileName
    """CSV table beside the scene: wavelength [nm] and value."""


class TransmissionModel(Model):
    """[camera.filter]: what a filter before the lens lets through, by its name in the catalog, a file or a table."""

    preset: ComponentName | None = None
    """Name of a filter of the catalog."""
    file: FileName | None = None
    """CSV table beside the scene: wavelength [nm] and transmittance."""
    transmissions: Annotated[tuple[tuple[Wavelength, Share], ...], Field(min_length=2, max_length=10_000)] | None = None
    """Pairs of wavelength and transmittance; in place of file."""

    @model_validator(mode="after")
    def _one_curve(self) -> TransmissionModel:
        exactly_one(self, "file", "transmissions")
        wavelengths = [wavelength for wavelength, _ in self.transmissions or ()]
        if any(a >= b for a, b in pairwise(wavelengths)):
            raise ValueError("transmissions: wavelengths must increase")
        return self


class SpectrumModel(Model):
    """Spectrum of a source: a Gaussian line, a CIE illuminant, or a table in a file."""

    line: Wavelength | None = None
    """Mean wavelength of a Gaussian line."""
    width: Wavelength | None = None
    """Full width of that line at half maximum."""
    preset: Literal["A", "D65", "E"] | None = None
    """A CIE standard illuminant."""
    file: FileName | None = None
    """CSV table beside the scene: wavelength [nm] and relative power."""

    @model_validator(mode="after")
    def _one_kind(self) -> SpectrumModel:
        given = [key for key in ("line", "preset", "file") if getattr(self, key) is not None]
        if len(given) != 1:
            raise ValueError(f"needs exactly one of line and preset and file, not {len(given)}")
        if (self.line is None) != (self.width is None):
            raise ValueError("line and width (full, at half maximum) go together")
        if self.line is not None and self.width is not None and not self.width < self.line / 4:
            raise ValueError("width must be below a quarter of line")
        return self
