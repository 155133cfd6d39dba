"""[camera.sensor] as pydantic models: the power law of Eq. 5, or the linear camera of a data sheet."""

from __future__ import annotations

import itertools
import math
import re
from typing import Annotated, Any, ClassVar, Final, Literal, get_args

from pydantic import BeforeValidator, ConfigDict, Discriminator, Field, Tag, model_validator

from radwrap.errors import InputError
from radwrap.scene.file.border import (
    ComponentName,
    Count,
    ElectronRate,
    Electrons,
    Flag,
    Interval,
    Model,
    Share,
    Size,
    SystemGain,
    Temperature,
    TemperatureDifference,
    default,
)
from radwrap.scene.file.mosaic_tables import FiltersModel, MosaicName, efficiency_between
from radwrap.scene.mosaic import COLOURS, Colour, Pattern
from radwrap.units import ONE_IN, parse_gain

Gamma = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.01, le=10)]
GrayLevel = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0)]
# A fill factor: beyond this a pixel has no area worth the name.
FillShare = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.01, le=1)]
Column = Annotated[int, Field(strict=True, ge=0, lt=1_000_000)]
_SCALE: Final = f"^{ONE_IN}$"

Sensitivity = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=1e6)]
Sensitivities = Annotated[tuple[Sensitivity, ...], Field(min_length=1, max_length=256)]


def _scale(value: Any) -> Any:
    if value is not None and not (isinstance(value, str) and re.fullmatch(_SCALE, value)):
        raise ValueError(f'must be "1/N" with a whole number N, not {value!r}')
    return value


def _open_to(*keys: str) -> Any:
    """In the JSON schema: what is required without one of these keys is not with it."""

    def change(schema: dict[str, Any]) -> None:
        required = schema.pop("required", [])
        always = [name for name in required if name == "model"]
        schema["anyOf"] = [*({"required": [*always, key]} for key in keys), {"required": required}]

    return change


class PixelsModel(Model):
    """What both kinds of sensor have in common."""

    rows: Count
    """How many rows of pixels."""
    columns: Count
    """How many columns of pixels."""
    pixel_width: Size
    """Pitch of the columns."""
    pixel_height: Size
    """Pitch of the rows."""
    bit_depth: Annotated[int, Field(strict=True, ge=1, le=16)] = 8
    """Bits of a gray level."""
    rounding: Flag = True
    """Whether gray levels are whole."""
    channel: Literal["equal", "red", "green", "blue"] = "equal"
    """Which of the tracer's three channels is seen; equal demands that all three agree."""
    mosaic: MosaicName | None = None
    """Colour filters of the first two pixels of the first row, then of the second; one colour: all have its filter."""
    filters: FiltersModel | None = None
    """The colour filters of a mosaic."""
    fill_width: FillShare | None = None
    """Middle share of the pitch along a row that sees light, 0.01 to 1."""
    fill_height: FillShare | None = None
    """Middle share of the pitch along a column that sees light, 0.01 to 1."""
    sensitivity_across: Sensitivities | None = None
    """Relative sensitivities of equal strips of a pixel, along a row."""
    sensitivity_down: Sensitivities | None = None
    """Relative sensitivities of equal strips of a pixel, along a column."""
    roi: tuple[Column, Column, Column, Column] | None = None
    """What is read out: first column and row, last column and row [px]."""
    shutter: Literal["global", "rolling", "global_reset"] | None = None
    """Which rows are exposed when: all at once, one after the other, or from one start to ends one after the other."""
    line_time: Interval | None = None
    """Time from one row of the image to the next, of a shutter that is not global."""
    readout: Literal["down", "up"] | None = None
    """Whether the first row is read out first (down, the default) or the last one."""
    scale: Annotated[str, BeforeValidator(_scale), Field(pattern=_SCALE)] | None = None
    """"1/N": N x N pixels become one with their sum of electrons; gray levels stay."""

    @model_validator(mode="after")
    def _one_window(self) -> PixelsModel:
        for fill, strips in (("fill_width", "sensitivity_across"), ("fill_height", "sensitivity_down")):
            values = getattr(self, strips)
            if getattr(self, fill) is not None and values is not None:
                raise ValueError(f"needs one of {fill} and {strips}, not both")
            if values is not None and not any(values):
                raise ValueError(f"{strips}: all are 0, so the pixel sees nothing")
        return self

    @model_validator(mode="after")
    def _whole_shutter(self) -> PixelsModel:
        in_rows = self.shutter not in (None, "global")
        if in_rows and self.line_time is None:
            raise ValueError(f'line_time: is missing, and shutter = "{self.shutter}" needs it')
        for name in ("line_time", "readout"):
            if not in_rows and getattr(self, name) is not None:
                raise ValueError(f'{name}: goes with shutter = "rolling" or "global_reset"; leave it out')
        return self

    @model_validator(mode="after")
    def _whole_mosaic(self) -> PixelsModel:
        if (self.mosaic is None) != (self.filters is None):
            missing = "filters.red, filters.green and filters.blue" if self.filters is None else "mosaic"
            raise ValueError(f"{missing}: mosaic and filters go together, and this is missing")
        if self.mosaic is not None and self.channel != "equal":
            raise ValueError("channel: the filters of the mosaic say what a pixel sees; leave this one out")
        if self.pattern is not None and self.binned_pixels > 1:
            raise ValueError("scale: pixels of a mosaic have different filters and are not added up; leave it out")
        left, top, right, bottom = self.region
        # Ends before the beginning are the region's own fault, which is found elsewhere.
        if self.pattern is not None and right >= left and bottom >= top and min(right - left, bottom - top) < 1:
            raise ValueError("mosaic: needs two rows and two columns of pixels at least")
        return self

    @model_validator(mode="after")
    def _some_pixels(self) -> PixelsModel:
        left, top, right, bottom = self.region
        if not (left <= right < self.columns and top <= bottom < self.rows):
            raise ValueError(
                f"roi: must be first column and row, last column and row, within {self.columns} x {self.rows} pixels"
            )
        if min(right - left, bottom - top) + 1 < self.binned_pixels:
            raise ValueError(f"scale: no whole pixel is left of {right - left + 1} x {bottom - top + 1}")
        return self

    @property
    def region(self) -> tuple[int, int, int, int]:
        """First column and row, last column and row of what is read out."""
        return self.roi or (0, 0, self.columns - 1, self.rows - 1)

    @property
    def pattern(self) -> Pattern | None:
        """The pattern of a mosaic of several colours."""
        return next((known for known in get_args(Pattern) if known == self.mosaic), None)

    @property
    def colour(self) -> Colour | None:
        """The one colour whose filter all pixels have."""
        return next((known for known in COLOURS if known == self.mosaic), None)

    @property
    def binned_pixels(self) -> int:
        """How many pixels a side become one."""
        return int(self.scale.removeprefix("1/")) if self.scale else 1


class SensorModel(PixelsModel):
    """The power law: a preset, or all of it; what is given beside a preset replaces its value."""

    model_config: ClassVar[ConfigDict] = ConfigDict(json_schema_extra=_open_to("preset"))

    model: Literal["power_law"] | None = None
    """The power law G = K H^gamma + G0."""
    preset: ComponentName | None = None
    """Name of a sensor of the catalog; keys beside it replace its values."""
    gain: str
    """K of the power law, such as "3.38e4 (J/m^2)^-0.85"."""
    gamma: Gamma
    """Exponent of the power law."""
    dark_gray: GrayLevel
    """Gray level without light, G0."""
    saturation_gray: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0)]
    """Gray level at which a pixel is full."""

    @model_validator(mode="after")
    def _consistent(self) -> SensorModel:
        try:
            gain, exponent = parse_gain(self.gain)
        except InputError as error:
            raise ValueError(f"gain: {error}") from error
        if gain <= 0:
            raise ValueError("gain: must be above zero")
        if exponent != self.gamma:
            raise ValueError(f"gain: its unit says gamma {exponent:g}, but gamma is {self.gamma:g}")
        if self.filters is not None:
            self.filters.check_kind(linear=False)
        if not self.dark_gray < self.saturation_gray <= 2**self.bit_depth - 1:
            raise ValueError(f"needs dark_gray < saturation_gray <= {2**self.bit_depth - 1} ({self.bit_depth} bits)")
        return self


class DefectsModel(Model):
    """Shares of pixels that always saturate, and that never see light."""

    hot: Share = 0.0
    """Share of the pixels that are always full, 0 to 1."""
    dead: Share = 0.0
    """Share of the pixels that never see light, 0 to 1."""

    @model_validator(mode="after")
    def _some_work(self) -> DefectsModel:
        if self.hot + self.dead >= 1:
            raise ValueError("no pixel is left: hot and dead must be less than 1 together")
        return self


class LinearSensorModel(PixelsModel):
    """The linear camera of EMVA 1288; a data sheet may hold any of these keys."""

    model_config: ClassVar[ConfigDict] = ConfigDict(json_schema_extra=_open_to("data_sheet", "preset"))

    model: Literal["linear"]
    """The linear camera of EMVA 1288."""
    preset: ComponentName | None = None
    """Name of a sensor of the catalog; keys beside it replace its values."""
    data_sheet: Annotated[str, Field(strict=True, min_length=1, max_length=1000)] | None = None
    """TOML file beside the scene that holds what the scene does not say of the sensor."""
    wavelength: Size
    """Wavelength of the light whose photons are counted."""
    quantum_efficiency: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=1)] | None = None
    """Electrons for each photon at the wavelength, 0 to 1; fill factor and microlens included."""
    quantum_efficiencies: Annotated[tuple[tuple[Size, Share], ...], Field(min_length=2, max_length=10_000)] | None = (
        None
    )
    """Pairs of wavelength and quantum efficiency; in place of quantum_efficiency."""
    system_gain: SystemGain
    """K of EMVA 1288."""
    offset: GrayLevel
    """Gray level without light and dark current."""
    full_well: Electrons
    """Number of electrons at which a pixel is full."""
    read_noise: Electrons
    """Standard deviation of a pixel in the dark, for each frame."""
    dark_current: ElectronRate = default("0 e/s")
    """Dark current of a pixel, at the temperature of the sensor or as it is."""
    dark_current_temperature: Temperature | None = None
    """Temperature at which the dark current was measured."""
    doubling_temperature: TemperatureDifference | None = None
    """Temperature difference that doubles the dark current."""
    temperature: Temperature | None = None
    """Temperature of the sensor."""
    dsnu: Electrons = default("0 e")
    """Standard deviation of the dark signal between pixels."""
    prnu: Share = 0.0
    """Standard deviation of responsivity between pixels, as a share, 0 to 1."""
    defects: DefectsModel = default({})
    """Pixels that are hot or dead."""
    device_seed: Annotated[int, Field(strict=True, ge=0, lt=2**63)] = 0
    """Which specimen: decides DSNU, PRNU and defects."""
    gamma: Gamma = 1.0
    """Exponent of a look-up table behind the converter, which keeps dark and saturation."""

    @model_validator(mode="after")
    def _consistent(self) -> LinearSensorModel:
        told = self.quantum_efficiency is not None or self.quantum_efficiencies is not None
        if self.filters is not None:
            if told:
                raise ValueError("needs one of filters and quantum_efficiency or quantum_efficiencies, not both")
            self.filters.check_kind(linear=True)
        elif not told:
            raise ValueError("needs quantum_efficiency, or quantum_efficiencies with wavelengths")
        if self.quantum_efficiency is not None and self.quantum_efficiencies is not None:
            raise ValueError("needs one of quantum_efficiency and quantum_efficiencies, not both")
        self.efficiency()
        heat = (self.dark_current_temperature, self.doubling_temperature, self.temperature)
        if any(value is not None for value in heat) and any(value is None for value in heat):
            raise ValueError("dark_current_temperature, doubling_temperature and temperature go together")
        if not self.full_well > 0:
            raise ValueError("full_well: must be above zero")
        if not self.offset < 2**self.bit_depth - 1:
            raise ValueError(f"offset: must be less than {2**self.bit_depth - 1} ({self.bit_depth} bits)")
        return self

    def efficiency(self) -> float:
        """Quantum efficiency at the wavelength, linear between those of the table; of filters the largest of three."""
        if self.filters is not None:
            return max(self.filters.efficiencies(self.wavelength))
        if self.quantum_efficiency is not None:
            return self.quantum_efficiency
        table = self.quantum_efficiencies or ()
        if any(a[0] >= b[0] for a, b in itertools.pairwise(table)):
            raise ValueError("quantum_efficiencies: wavelengths must increase")
        found = efficiency_between(table, self.wavelength)
        if not (math.isfinite(found) and found > 0):
            raise ValueError("quantum_efficiencies: nothing is seen at the wavelength")
        return found


def _kind(table: Any) -> str:
    model = table.get("model") if isinstance(table, dict) else getattr(table, "model", None)
    return model if isinstance(model, str) else "power_law"


AnySensorModel = Annotated[
    Annotated[SensorModel, Tag("power_law")] | Annotated[LinearSensorModel, Tag("linear")], Discriminator(_kind)
]
