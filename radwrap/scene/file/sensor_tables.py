"""[camera.sensor] as pydantic models: the power law of Eq. 5, or the linear camera of a data sheet."""

from __future__ import annotations

import itertools
import math
import re
import tomllib
from importlib.resources import files
from typing import Annotated, Any, ClassVar, Final, Literal

from pydantic import BeforeValidator, ConfigDict, Discriminator, Field, Tag, model_validator

from radwrap.errors import InputError
from radwrap.nearest import did_you_mean
from radwrap.scene.file.border import (
    Count,
    ElectronRate,
    Electrons,
    Flag,
    Model,
    Name,
    Share,
    Size,
    SystemGain,
    Temperature,
    TemperatureDifference,
    default,
)
from radwrap.units import parse_gain

Gamma = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.01, le=10)]
GrayLevel = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0)]
# A fill factor: beyond this a pixel has no area worth the name.
FillShare = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.01, le=1)]
Column = Annotated[int, Field(strict=True, ge=0, lt=1_000_000)]
_SCALE: Final = r"^1/[1-9][0-9]{0,3}$"
_REGION = Field(description="first column and row, last column and row that are read out")
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
    columns: Count
    pixel_width: Size
    pixel_height: Size
    bit_depth: Annotated[int, Field(strict=True, ge=1, le=16)] = 8
    rounding: Flag = True
    channel: Literal["equal", "red", "green", "blue"] = "equal"
    fill_width: FillShare | None = None
    fill_height: FillShare | None = None
    sensitivity_across: Sensitivities | None = None
    sensitivity_down: Sensitivities | None = None
    roi: Annotated[tuple[Column, Column, Column, Column], _REGION] | None = None
    scale: Annotated[str, BeforeValidator(_scale), Field(pattern=_SCALE)] | None = None

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
    def binned_pixels(self) -> int:
        """How many pixels a side become one."""
        return int(self.scale.removeprefix("1/")) if self.scale else 1


class SensorModel(PixelsModel):
    """The power law: a preset, or all of it; what is given beside a preset replaces its value."""

    model_config: ClassVar[ConfigDict] = ConfigDict(json_schema_extra=_open_to("preset"))

    model: Literal["power_law"] | None = None
    preset: Name | None = None
    gain: str
    gamma: Gamma
    dark_gray: GrayLevel
    saturation_gray: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0)]

    @model_validator(mode="before")
    @classmethod
    def _with_preset(cls, table: Any) -> Any:
        if not isinstance(table, dict) or not isinstance(table.get("preset"), str):
            return table
        return {**sensor_preset(table["preset"]), **table}

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
        if not self.dark_gray < self.saturation_gray <= 2**self.bit_depth - 1:
            raise ValueError(f"needs dark_gray < saturation_gray <= {2**self.bit_depth - 1} ({self.bit_depth} bits)")
        return self


class DefectsModel(Model):
    """Shares of pixels that always saturate, and that never see light."""

    hot: Share = 0.0
    dead: Share = 0.0

    @model_validator(mode="after")
    def _some_work(self) -> DefectsModel:
        if self.hot + self.dead >= 1:
            raise ValueError("no pixel is left: hot and dead must be less than 1 together")
        return self


class LinearSensorModel(PixelsModel):
    """The linear camera of EMVA 1288; a data sheet may hold any of these keys."""

    model_config: ClassVar[ConfigDict] = ConfigDict(json_schema_extra=_open_to("data_sheet"))

    model: Literal["linear"]
    data_sheet: Annotated[str, Field(strict=True, min_length=1, max_length=1000)] | None = None
    wavelength: Size
    quantum_efficiency: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=1)] | None = None
    quantum_efficiencies: Annotated[tuple[tuple[Size, Share], ...], Field(min_length=2, max_length=10_000)] | None = (
        None
    )
    system_gain: SystemGain
    offset: GrayLevel
    full_well: Electrons
    read_noise: Electrons
    dark_current: ElectronRate = default("0 e/s")
    dark_current_temperature: Temperature | None = None
    doubling_temperature: TemperatureDifference | None = None
    temperature: Temperature | None = None
    dsnu: Electrons = default("0 e")
    prnu: Share = 0.0
    defects: DefectsModel = default({})
    device_seed: Annotated[int, Field(strict=True, ge=0, lt=2**63)] = 0
    gamma: Gamma = 1.0

    @model_validator(mode="after")
    def _consistent(self) -> LinearSensorModel:
        if self.quantum_efficiency is None and self.quantum_efficiencies is None:
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
        """Quantum efficiency at the wavelength, linear between the wavelengths of the table."""
        if self.quantum_efficiency is not None:
            return self.quantum_efficiency
        table = self.quantum_efficiencies or ()
        if any(a[0] >= b[0] for a, b in itertools.pairwise(table)):
            raise ValueError("quantum_efficiencies: wavelengths must increase")
        if not table[0][0] <= self.wavelength <= table[-1][0]:
            reach = f"{table[0][0] * 1e9:g} to {table[-1][0] * 1e9:g} nm"
            raise ValueError(
                f"quantum_efficiencies: reach from {reach}, the wavelength is {self.wavelength * 1e9:g} nm"
            )
        (a, low), (b, high) = next(
            pair for pair in itertools.pairwise(table) if pair[0][0] <= self.wavelength <= pair[1][0]
        )
        found = low + (high - low) * (self.wavelength - a) / (b - a)
        if not (math.isfinite(found) and found > 0):
            raise ValueError("quantum_efficiencies: nothing is seen at the wavelength")
        return found


def _kind(table: Any) -> str:
    model = table.get("model") if isinstance(table, dict) else getattr(table, "model", None)
    return model if isinstance(model, str) else "power_law"


AnySensorModel = Annotated[
    Annotated[SensorModel, Tag("power_law")] | Annotated[LinearSensorModel, Tag("linear")], Discriminator(_kind)
]


def sensor_presets() -> tuple[str, ...]:
    """Names of the sensors that radwrap knows."""
    folder = files("radwrap") / "data" / "sensors"
    return tuple(sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml")))


def sensor_preset(name: str) -> dict[str, Any]:
    """Table of a sensor that radwrap knows.

    Raises
    ------
    ValueError
        If it knows no such sensor.
    """
    known = sensor_presets()
    if name not in known:
        near = did_you_mean(name, known)
        raise ValueError(f'preset: no sensor "{name}"; {near or "known: " + ", ".join(known)}')
    return tomllib.loads((files("radwrap") / "data" / "sensors" / f"{name}.toml").read_text("utf-8"))
