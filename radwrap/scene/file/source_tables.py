"""The scene file's tables of light sources as pydantic models."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Final, Literal

from pydantic import ConfigDict, Field, model_validator

from radwrap.scene.file.border import (
    Aimed,
    Angle,
    EfficacyValue,
    Factor,
    LuminanceValue,
    LuminousFluxValue,
    LuminousIntensityValue,
    Model,
    Name,
    PositiveAngle,
    RadianceValue,
    RadiantFluxValue,
    RadiantIntensityValue,
    Share,
    Size,
    SizeOrZero,
    default,
    exactly_one,
    preset_or_all,
    read_preset,
)
from radwrap.scene.file.optics_tables import SpectrumModel
from radwrap.scene.sources import WidthDefinition

PHOTOMETRIC: Final = ("luminance", "luminous_intensity", "luminous_flux")

FileName = Annotated[str, Field(strict=True, min_length=1, max_length=1000)]
AskedError = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1e-4, le=0.5)]
Patches = Annotated[int, Field(strict=True, ge=1, le=4096)]


class BeamModel(Model):
    """Angular distribution of a source."""

    profile: Literal["gaussian", "cosine_power", "cone", "lambertian", "table"]
    width: PositiveAngle | None = None
    width_definition: WidthDefinition | None = None
    file: FileName | None = None

    @model_validator(mode="after")
    def _consistent(self) -> BeamModel:
        if (self.profile == "table") != (self.file is not None):
            raise ValueError('file goes with profile = "table", and that needs it')
        if self.profile in ("lambertian", "table"):
            if self.width is not None or self.width_definition is not None:
                raise ValueError(f"a {self.profile} beam has no width")
            return self
        if self.width is None:
            raise ValueError(f"a {self.profile} beam needs its width")
        if self.profile == "cone" and self.width_definition in ("1/e^2_full", "sigma"):
            raise ValueError('the width of a cone is "fwhm" (full angle) or "half_angle"')
        return self


class Spectral(Model):
    """What all sources have in common: a spectrum, where the scene tells any."""

    name: Name
    spectrum: SpectrumModel | None = None


class Shining(Spectral):
    """What sources have in common whose level may be told in several ways."""

    radiance: RadianceValue | None = None
    radiant_intensity: RadiantIntensityValue | None = None
    radiant_flux: RadiantFluxValue | None = None
    luminance: LuminanceValue | None = None
    luminous_intensity: LuminousIntensityValue | None = None
    luminous_flux: LuminousFluxValue | None = None

    @model_validator(mode="after")
    def _one_level(self) -> Shining:
        self._check_level()
        return self

    def _check_level(self, *others: str) -> None:
        """One level; where that is told in lumens or candelas a spectrum says how many watts it is."""
        rare = [key for key in ("radiant_flux", *PHOTOMETRIC) if getattr(self, key) is not None]
        exactly_one(self, "radiance", "radiant_intensity", *rare, *others)
        if self.spectrum is None:
            for key in PHOTOMETRIC:
                if getattr(self, key) is not None:
                    raise ValueError(f"{key} needs spectrum: only that says how many watts it is")


class LedModel(Shining, Aimed):
    """A single LED."""

    type: Literal["led"]
    diameter: Size = default("5.08 mm")
    beam: BeamModel


class LampModel(Shining, Aimed):
    """A lamp: a disc at a position, with a beam; what is given beside a preset replaces its value."""

    model_config: ClassVar[ConfigDict] = ConfigDict(json_schema_extra=preset_or_all)

    type: Literal["lamp"]
    preset: Name | None = None
    diameter: Size
    beam: BeamModel

    @model_validator(mode="before")
    @classmethod
    def _with_preset(cls, table: Any) -> Any:
        if not isinstance(table, dict) or not isinstance(table.get("preset"), str):
            return table
        preset = read_preset("lamps", "lamp", table["preset"])
        if any(key in table for key in ("radiance", "radiant_flux", *PHOTOMETRIC)):
            preset.pop("radiant_intensity", None)
        return {**preset, **table}


class IesModel(Spectral, Aimed):
    """A luminaire of an IES LM-63 file."""

    type: Literal["ies"]
    file: FileName
    diameter: Size = default("10 mm")
    luminous_efficacy: EfficacyValue = default("179 lm/W")


class DiscSourceModel(Shining, Aimed):
    """A plain Lambertian disc: one point where that will do, in patches where an error is asked for."""

    type: Literal["disc"]
    diameter: Size
    irradiance_error: AskedError | None = None
    least_patches: Patches | None = None

    @model_validator(mode="after")
    def _patches_of_a_wide_one(self) -> DiscSourceModel:
        if self.least_patches is not None and self.irradiance_error is None:
            raise ValueError("least_patches goes with irradiance_error")
        return self


class WideModel(Spectral):
    """What wide sources have in common."""

    irradiance_error: AskedError = 0.01
    least_patches: Patches = 1


class RectangleSourceModel(WideModel, Shining, Aimed):
    """A backlight or a bar."""

    type: Literal["rectangle"]
    size: tuple[Size, Size]
    beam: BeamModel = default({"profile": "lambertian"})


class AreaRingModel(WideModel, Shining, Aimed):
    """A flat ring that shines all over."""

    type: Literal["area_ring"]
    diameter: Size
    inner_diameter: Size
    beam: BeamModel = default({"profile": "lambertian"})

    @model_validator(mode="after")
    def _has_area(self) -> AreaRingModel:
        if not self.inner_diameter < 0.9999 * self.diameter:
            raise ValueError("inner_diameter must be smaller than diameter")
        return self


class DomeModel(WideModel, Aimed):
    """A hemisphere that shines to its centre, with a hole for the camera."""

    type: Literal["dome"]
    radiance: RadianceValue
    diameter: Size
    opening_diameter: SizeOrZero = default("0 mm")

    @model_validator(mode="after")
    def _has_area(self) -> DomeModel:
        if not self.opening_diameter < 0.9999 * self.diameter:
            raise ValueError("opening_diameter must be smaller than diameter")
        return self


class CoaxialModel(WideModel):
    """Light along the camera's axis by a beam splitter: a disc as far behind the pinhole as its light goes further."""

    type: Literal["coaxial"]
    radiance: RadianceValue
    diameter: Size
    distance: Size
    splitter_reflectance: Share = 0.5
    splitter_transmittance: Share = 0.5

    @model_validator(mode="after")
    def _conserves(self) -> CoaxialModel:
        if self.splitter_reflectance + self.splitter_transmittance > 1:
            raise ValueError("splitter_reflectance + splitter_transmittance must not exceed 1")
        if self.splitter_reflectance == 0 or self.splitter_transmittance == 0:
            raise ValueError("a splitter of reflectance or transmittance 0 shows nothing")
        return self


class SurroundModel(WideModel):
    """The same radiance from all sides."""

    type: Literal["surround"]
    radiance: RadianceValue


class LedChangeModel(Model):
    """How one LED of a ring differs."""

    index: Annotated[int, Field(strict=True, ge=0)]
    radiance_factor: Factor = 1.0
    beam_width_factor: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=1e6)] = 1.0
    axis_tilt: Angle = default("0 deg")
    axis_azimuth: Angle = default("0 deg")


class MisalignmentModel(Model):
    """Turn of a whole ring, about the world's y axis, then about its z axis."""

    about_y: Angle = default("0 deg")
    about_z: Angle = default("0 deg")


class RingModel(Shining, Aimed):
    """LEDs evenly on a circle."""

    type: Literal["ring"]
    count: Annotated[int, Field(strict=True, ge=1, le=4096)]
    diameter: Size
    first_angle: Angle = default("0 deg")
    led_diameter: Size = default("5.08 mm")
    beam: BeamModel
    misalignment: MisalignmentModel = default({})
    leds: tuple[LedChangeModel, ...] = ()
    calibration: Annotated[str, Field(strict=True, min_length=1, max_length=1000)] | None = None
    drive_levels: Share | tuple[Share, ...] | None = None

    @model_validator(mode="after")
    def _one_level(self) -> RingModel:
        self._check_level("calibration")
        if (self.calibration is None) != (self.drive_levels is None):
            raise ValueError("calibration and drive_levels go together")
        if isinstance(self.drive_levels, tuple) and len(self.drive_levels) != self.count:
            raise ValueError(f"drive_levels: {len(self.drive_levels)} levels for {self.count} LEDs")
        return self

    @model_validator(mode="after")
    def _leds_exist(self) -> RingModel:
        indices = [led.index for led in self.leds]
        if len(set(indices)) < len(indices):
            raise ValueError("leds: an index stands there twice")
        if indices and max(indices) >= self.count:
            raise ValueError(f"leds: index {max(indices)} is too large, the ring has LEDs 0 to {self.count - 1}")
        return self


SourceModel = Annotated[
    LedModel
    | LampModel
    | IesModel
    | DiscSourceModel
    | RingModel
    | RectangleSourceModel
    | AreaRingModel
    | DomeModel
    | CoaxialModel
    | SurroundModel,
    Field(discriminator="type"),
]
