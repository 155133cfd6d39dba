"""The scene file's tables of materials as pydantic models."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, ClassVar, Literal

from pydantic import ConfigDict, Field, model_validator

from radwrap.scene.file.border import Angle, Coefficient, ComponentName, Model, Share, preset_or_all
from radwrap.scene.file.optics_tables import CurveModel

_PERTURBED = ("reflectance", "roughness")
_TABLE = ("observation_angles", "entrance_angles", "coefficients", "interpolation")
_FUNCTION = ("function", "anchor")
_FILE = ("file", "interpolation")
Roughness = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1e-3, le=0.5)]
FileName = Annotated[str, Field(strict=True, min_length=1, max_length=1000)]


class Coloured(Model):
    """What all materials have in common: a factor on their reflectance over wavelength."""

    spectrum: CurveModel | None = None
    """Factor on the reflectance over wavelength."""


class FromCatalog(Model):
    """A material that may stand in radwrap's own catalog; what is given beside the preset replaces its value."""

    preset: ComponentName | None = None
    """Name of a material in radwrap's catalog; keys beside it replace its values."""


class LambertianModel(Coloured):
    """Diffuse material."""

    type: Literal["lambertian"]
    """Kind of material."""
    reflectance: Share
    """Share of the light that is reflected, 0 to 1."""


class SpecularModel(Coloured, FromCatalog):
    """Gaussian lobe over a diffuse part; two roughnesses are along the target's x and across it."""

    model_config: ClassVar[ConfigDict] = ConfigDict(json_schema_extra=preset_or_all)

    type: Literal["specular"]
    """Kind of material."""
    diffuse_reflectance: Share = 0.0
    """Share of the light that is reflected evenly, 0 to 1."""
    specular_reflectance: Share
    """Share of the light in the lobe, 0 to 1."""
    roughness: Roughness | tuple[Roughness, Roughness]
    """Width of the Gaussian lobe, without unit; two along the target's x axis and across it."""

    @model_validator(mode="after")
    def _conserves(self) -> SpecularModel:
        if self.diffuse_reflectance + self.specular_reflectance > 1:
            raise ValueError("diffuse_reflectance + specular_reflectance must not exceed 1")
        return self


class RetroreflectiveModel(Coloured):
    """Retroreflector: the paper's perturbed normal, or measured R_A by function, table or file."""

    model_config: ClassVar[ConfigDict] = ConfigDict(json_schema_extra=preset_or_all)

    type: Literal["retroreflective"]
    """Kind of material."""
    preset: ComponentName | None = None
    """Name of a sheeting in radwrap's data; keys beside it replace its values."""
    model: Literal["perturbed_normal", "coefficient"]
    """How retroreflection is described."""
    reflectance: Share | None = None
    """Share of the light that the perturbed normal sends back, 0 to 1."""
    roughness: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1e-4, le=0.5)] | None = None
    """Width of the Gaussian lobe that the perturbed normal sends back, without unit."""
    function: Literal["glass_beads"] | None = None
    """R_A by a formula."""
    anchor: Coefficient | None = None
    """R_A of that formula at an observation angle of 0.5 deg and an entrance angle of 0 deg."""
    observation_angles: tuple[Angle, ...] | None = None
    """Rows of the table of R_A: angles between light and eye."""
    entrance_angles: tuple[Angle, ...] | None = None
    """Columns of the table of R_A: angles between light and normal."""
    coefficients: tuple[tuple[Coefficient, ...], ...] | None = None
    """The table of R_A: a row for each observation angle."""
    interpolation: Literal["linear", "log"] | None = None
    """Interpolation between the angles of a table: of R_A or of its logarithm."""
    outside: Literal["refuse", "hold"] | None = None
    """Angles beyond the data: refuse them, or hold the outermost value."""
    file: FileName | None = None
    """CSV table of R_A beside the scene."""
    print_coverage: Share | None = None
    """Share of the sheeting's light that a print over it takes, 0 to 1."""
    print_reflectance: Share | None = None
    """Diffuse reflectance of that print, 0 to 1."""

    @model_validator(mode="after")
    def _consistent(self) -> RetroreflectiveModel:
        if self.model == "perturbed_normal":
            self._only(_PERTURBED, needed=_PERTURBED)
        elif self.file is not None:
            self._only((*_FILE, "outside"), needed=_FILE[:1])
        elif self.function is not None:
            self._only((*_FUNCTION, "outside"), needed=_FUNCTION)
        else:
            self._only((*_TABLE, "outside"), needed=_TABLE[:3])
            self._check_table()
        if (self.print_coverage is None) != (self.print_reflectance is None):
            raise ValueError("print_coverage and print_reflectance go together")
        return self

    def _only(self, allowed: tuple[str, ...], needed: tuple[str, ...]) -> None:
        given = [key for key in (*_PERTURBED, *_FUNCTION, *_TABLE, "file", "outside") if getattr(self, key) is not None]
        for key in needed:
            if key not in given:
                raise ValueError(f'model "{self.model}" needs {key}')
        for key in given:
            if key not in allowed:
                raise ValueError(f"{key} does not go with {' and '.join(needed)}")

    def _check_table(self) -> None:
        for key in ("observation_angles", "entrance_angles"):
            angles = [abs(angle) for angle in getattr(self, key)]
            if len(angles) < 2 or any(a >= b for a, b in pairwise(angles)):
                raise ValueError(f"{key} needs two or more angles, increasing without regard to sign")
            if angles[-1] >= 1.55:
                raise ValueError(f"{key} must stay below 88.8 degrees")
        rows, columns = len(self.observation_angles or ()), len(self.entrance_angles or ())
        table = self.coefficients or ()
        if len(table) != rows or any(len(row) != columns for row in table):
            raise ValueError(f"coefficients needs {rows} rows (observation) of {columns} values (entrance)")


class MirrorModel(Model):
    """Flat mirror."""

    type: Literal["mirror"]
    """Kind of material."""
    reflectance: Share
    """Share of the light that is mirrored, 0 to 1."""


class GlassModel(FromCatalog):
    """Thin pane."""

    model_config: ClassVar[ConfigDict] = ConfigDict(json_schema_extra=preset_or_all)

    type: Literal["glass"]
    """Kind of material."""
    transmittance: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=1)]
    """Share of the light that goes straight through the pane, 0 to 1."""
    refractive_index: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1, le=4)] = 1.52
    """Refractive index of the glass; it decides what its faces mirror."""

    @model_validator(mode="after")
    def _reflects_too(self) -> GlassModel:
        fresnel = ((self.refractive_index - 1) / (self.refractive_index + 1)) ** 2
        clear = (1 - fresnel) / (1 + fresnel)
        if self.transmittance > clear:
            raise ValueError(
                f"transmittance: clear glass of that refractive_index has {clear:.4f}, the rest is mirrored"
            )
        return self


class BrdfModel(Model):
    """Measured table of f, for direct light."""

    type: Literal["measured_brdf"]
    """Kind of material."""
    file: FileName
    """Table of f [1/sr] beside the scene."""


class PrintModel(Model):
    """Image printed on a sheet."""

    type: Literal["print"]
    """Kind of material."""
    file: FileName
    """Picture beside the scene that is stretched over the sheet, its top row at +y."""
    encoding: Literal["linear", "srgb"]
    """How the file's codes become shares of the way from black to white."""
    black_reflectance: Share
    """Reflectance where the picture is black, 0 to 1."""
    white_reflectance: Share
    """Reflectance where the picture is white, 0 to 1."""


MaterialModel = Annotated[
    LambertianModel | SpecularModel | RetroreflectiveModel | MirrorModel | GlassModel | BrdfModel | PrintModel,
    Field(discriminator="type"),
]
