"""The scene file's tables of light sources as pydantic models."""

from __future__ import annotations

from typing import Annotated, ClassVar, Final, Literal

from pydantic import ConfigDict, Field, model_validator

from radwrap.scene.file.border import (
    Aimed,
    Angle,
    ComponentName,
    EfficacyValue,
    Factor,
    Instant,
    Interval,
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
    """Shape of the angular distribution."""
    width: PositiveAngle | None = None
    """Width of the beam, as width_definition says."""
    width_definition: WidthDefinition | None = None
    """What the width is."""
    file: FileName | None = None
    """CSV table of relative intensity over angle beside the scene."""

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


class StrobeModel(Model):
    """A source's strobe: pulses."""

    delay: Instant
    """Start of the first pulse, from the start of row 0's exposure; may be negative."""
    width: Interval
    """Length of each pulse."""
    period: Interval | None = None
    """From one pulse to the next; without it there is one pulse."""

    @model_validator(mode="after")
    def _apart(self) -> StrobeModel:
        if self.period is not None and self.period < self.width:
            raise ValueError("period must not be shorter than width")
        return self


class Spectral(Model):
    """What all sources have in common: a spectrum and a strobe, where the scene tells any."""

    model_config: ClassVar[ConfigDict] = ConfigDict(json_schema_extra=preset_or_all)

    name: Name
    """Unique in the scene."""
    preset: ComponentName | None = None
    """Name of a light of the catalog, of a lamp where that is the type; keys beside it replace its values."""
    spectrum: SpectrumModel | None = None
    """Spectrum of its light; every source has one, or none."""
    strobe: StrobeModel | None = None
    """Pulses of full level in which it shines; without this key it shines all the time."""


class Shining(Spectral):
    """What sources have in common whose level may be told in several ways."""

    radiance: RadianceValue | None = None
    """Radiance along the axis; one of the levels is given."""
    radiant_intensity: RadiantIntensityValue | None = None
    """Radiant intensity along the axis; in place of radiance."""
    radiant_flux: RadiantFluxValue | None = None
    """Radiant flux in all directions; in place of radiance."""
    luminance: LuminanceValue | None = None
    """Luminance along the axis; in place of radiance, and needs a spectrum."""
    luminous_intensity: LuminousIntensityValue | None = None
    """Luminous intensity along the axis; in place of radiance, and needs a spectrum."""
    luminous_flux: LuminousFluxValue | None = None
    """Luminous flux in all directions; in place of radiance, and needs a spectrum."""

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
    """Kind of source."""
    diameter: Size = default("5.08 mm")
    """Diameter of the disc that shines."""
    beam: BeamModel
    """Angular distribution."""


class LampModel(Shining, Aimed):
    """A lamp: a disc at a position, with a beam; what is given beside a preset replaces its value."""

    model_config: ClassVar[ConfigDict] = ConfigDict(json_schema_extra=preset_or_all)

    type: Literal["lamp"]
    """Kind of source."""
    diameter: Size
    """Diameter of the disc that shines."""
    beam: BeamModel
    """Angular distribution."""


class IesModel(Spectral, Aimed):
    """A luminaire of an IES LM-63 file."""

    type: Literal["ies"]
    """Kind of source."""
    file: FileName
    """IES LM-63 file beside the scene."""
    diameter: Size = default("10 mm")
    """Diameter of the sphere that shines."""
    luminous_efficacy: EfficacyValue = default("179 lm/W")
    """How many lumens a watt is."""


class DiscSourceModel(Shining, Aimed):
    """A plain Lambertian disc: one point where that will do, in patches where an error is asked for."""

    type: Literal["disc"]
    """Kind of source."""
    diameter: Size
    """Diameter of the disc that shines."""
    irradiance_error: AskedError | None = None
    """Largest relative error of irradiance by patches; without it the disc shines from its middle."""
    least_patches: Patches | None = None
    """Least number of patches, for finer half shadows."""

    @model_validator(mode="after")
    def _patches_of_a_wide_one(self) -> DiscSourceModel:
        if self.least_patches is not None and self.irradiance_error is None:
            raise ValueError("least_patches goes with irradiance_error")
        return self


class WideModel(Spectral):
    """What wide sources have in common."""

    irradiance_error: AskedError = 0.01
    """Largest relative error of irradiance where it shines from patches."""
    least_patches: Patches = 1
    """Least number of patches, for finer half shadows."""


class RectangleSourceModel(WideModel, Shining, Aimed):
    """A backlight or a bar."""

    type: Literal["rectangle"]
    """Kind of source."""
    size: tuple[Size, Size]
    """Width along its x axis and height along its y axis."""
    beam: BeamModel = default({"profile": "lambertian"})
    """Angular distribution of each of its places."""


class AreaRingModel(WideModel, Shining, Aimed):
    """A flat ring that shines all over."""

    type: Literal["area_ring"]
    """Kind of source."""
    diameter: Size
    """Outer diameter of the ring."""
    inner_diameter: Size
    """Inner diameter of the ring."""
    beam: BeamModel = default({"profile": "lambertian"})
    """Angular distribution of each of its places."""

    @model_validator(mode="after")
    def _has_area(self) -> AreaRingModel:
        if not self.inner_diameter < 0.9999 * self.diameter:
            raise ValueError("inner_diameter must be smaller than diameter")
        return self


class DomeModel(WideModel, Aimed):
    """A hemisphere that shines to its centre, with a hole for the camera."""

    type: Literal["dome"]
    """Kind of source."""
    radiance: RadianceValue
    """Radiance of its inside, in all directions."""
    diameter: Size
    """Diameter of the hemisphere."""
    opening_diameter: SizeOrZero = default("0 mm")
    """Diameter of the hole at its top."""

    @model_validator(mode="after")
    def _has_area(self) -> DomeModel:
        if not self.opening_diameter < 0.9999 * self.diameter:
            raise ValueError("opening_diameter must be smaller than diameter")
        return self


class CoaxialModel(WideModel):
    """Light along the camera's axis by a beam splitter: a disc as far behind the pinhole as its light goes further."""

    type: Literal["coaxial"]
    """Kind of source."""
    radiance: RadianceValue
    """Radiance of the lamp, before the splitter."""
    diameter: Size
    """Diameter of the lamp."""
    distance: Size
    """How much longer the way from the lamp to the target is than that from the pinhole to the target."""
    splitter_reflectance: Share = 0.5
    """Share of the light that the splitter reflects, 0 to 1."""
    splitter_transmittance: Share = 0.5
    """Share of the light that the splitter lets through, 0 to 1."""

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
    """Kind of source."""
    radiance: RadianceValue
    """Radiance from all sides."""


class LedChangeModel(Model):
    """How one LED of a ring differs."""

    index: Annotated[int, Field(strict=True, ge=0)]
    """Number of the LED, 0 is the first."""
    radiance_factor: Factor = 1.0
    """Factor on its radiance."""
    beam_width_factor: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=1e6)] = 1.0
    """Factor on its beam's width."""
    axis_tilt: Angle = default("0 deg")
    """Angle between its axis and the ring's."""
    axis_azimuth: Angle = default("0 deg")
    """Direction of the tilt, from the ring's x towards its y."""


class MisalignmentModel(Model):
    """Turn of a whole ring, about the world's y axis, then about its z axis."""

    about_y: Angle = default("0 deg")
    """Angle about the world's y axis, through the ring's centre."""
    about_z: Angle = default("0 deg")
    """Angle about the world's z axis, applied second."""


class RingModel(Shining, Aimed):
    """LEDs evenly on a circle."""

    type: Literal["ring"]
    """Kind of source."""
    count: Annotated[int, Field(strict=True, ge=1, le=4096)]
    """How many LEDs."""
    diameter: Size
    """Diameter of the circle through the LEDs' centres."""
    first_angle: Angle = default("0 deg")
    """Angle of LED 0, from the ring's x towards its y."""
    led_diameter: Size = default("5.08 mm")
    """Diameter of the disc of each LED."""
    beam: BeamModel
    """Angular distribution of each LED."""
    misalignment: MisalignmentModel = default({})
    """Turn of the whole ring."""
    leds: tuple[LedChangeModel, ...] = ()
    """LEDs that differ from the others."""
    calibration: Annotated[str, Field(strict=True, min_length=1, max_length=1000)] | None = None
    """JSON beside the scene that says what each drive level shines; in place of radiance."""
    drive_levels: Share | tuple[Share, ...] | None = None
    """Drive level of all LEDs, or of each, as a share of full drive, 0 to 1; goes with calibration."""

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
            raise ValueError("leds: an index appears twice")
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
