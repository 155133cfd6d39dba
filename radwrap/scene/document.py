"""The scene file's tables as pydantic models; nothing of this goes further than `load`."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import ConfigDict, Field, model_validator

from radwrap.errors import InputError
from radwrap.scene.border import (
    Aimed,
    Angle,
    AnyLength,
    Count,
    Duration,
    Flag,
    Model,
    Name,
    PixelPosition,
    Placed,
    Point,
    Size,
    SizeOrZero,
    default,
    exactly_one,
    preset_names,
    preset_or_all,
    read_preset,
)
from radwrap.scene.material_tables import MaterialModel
from radwrap.scene.source_tables import SourceModel
from radwrap.units import parse_gain


class ApertureModel(Model):
    """[camera.aperture]."""

    shape: Literal["round", "square", "annular", "half_disc"] = "round"
    diameter: SizeOrZero = default("0.1 mm")
    inner_diameter: SizeOrZero | None = None
    rotation: Angle = default("0 deg")
    exposure_diameter: Size | None = None

    @model_validator(mode="after")
    def _consistent(self) -> ApertureModel:
        if (self.shape == "annular") != (self.inner_diameter is not None):
            raise ValueError('inner_diameter goes with shape = "annular", and that needs it')
        if self.inner_diameter is not None and not self.inner_diameter < self.diameter:
            raise ValueError("inner_diameter must be smaller than diameter")
        if self.exposure_diameter is not None and self.diameter != 0:
            raise ValueError('exposure_diameter goes with diameter = "0 mm"')
        if 0 < self.diameter < 1e-9:
            raise ValueError('diameter must be "0 mm" or at least 1 nm')
        return self


class SensorModel(Model):
    """[camera.sensor]: a preset, or all of it; what is given beside a preset replaces its value."""

    model_config: ClassVar[ConfigDict] = ConfigDict(json_schema_extra=preset_or_all)

    preset: Name | None = None
    rows: Count
    columns: Count
    pixel_width: Size
    pixel_height: Size
    gain: str
    gamma: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.01, le=10)]
    dark_gray: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0)]
    saturation_gray: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0)]
    bit_depth: Annotated[int, Field(strict=True, ge=1, le=16)] = 8
    rounding: Flag = True
    channel: Literal["equal", "red", "green", "blue"] = "equal"

    @model_validator(mode="before")
    @classmethod
    def _with_preset(cls, table: Any) -> Any:
        if not isinstance(table, dict) or not isinstance(table.get("preset"), str):
            return table
        return {**read_preset("sensors", "sensor", table["preset"]), **table}

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


def sensor_presets() -> tuple[str, ...]:
    """Names of the sensors that radwrap knows."""
    return preset_names("sensors")


class CameraModel(Aimed):
    """[camera]."""

    translation: Point | None = None
    focal_length: Size
    principal_point: tuple[PixelPosition, PixelPosition] | None = None
    exposure_time: Duration
    aperture: ApertureModel = default({})
    sensor: SensorModel

    @model_validator(mode="after")
    def _one_place(self) -> CameraModel:
        exactly_one(self, "position", "translation")
        return self


class TargetBase(Placed):
    """What all targets have in common."""

    name: Name | None = None


class SheetModel(TargetBase):
    """A flat rectangle."""

    type: Literal["sheet"]
    material: Name
    size: tuple[Size, Size]


class BoardModel(TargetBase):
    """A calibration board of dots."""

    type: Literal["board"]
    material: Name
    dot_material: Name
    rows: Annotated[int, Field(strict=True, ge=1, le=1000)]
    columns: Annotated[int, Field(strict=True, ge=1, le=1000)]
    pitch: Size
    dot_diameter: Size
    margin: SizeOrZero = default("10 mm")

    @model_validator(mode="after")
    def _dots_apart(self) -> BoardModel:
        if self.dot_diameter > self.pitch and self.rows * self.columns > 1:
            raise ValueError("dots overlap: dot_diameter must not exceed pitch")
        return self


class EdgeModel(TargetBase):
    """Two materials that meet at a straight edge."""

    type: Literal["edge"]
    material: Name
    edge_material: Name
    size: tuple[Size, Size]
    edge_position: AnyLength = default("0 mm")

    @model_validator(mode="after")
    def _edge_inside(self) -> EdgeModel:
        if not abs(self.edge_position) < self.size[0] / 2:
            raise ValueError("edge_position lies outside the target")
        return self


class PolygonModel(TargetBase):
    """A flat polygon."""

    type: Literal["polygon"]
    material: Name
    vertices: Annotated[tuple[tuple[AnyLength, AnyLength], ...], Field(min_length=3, max_length=1000)]


class DiscModel(TargetBase):
    """A flat disc."""

    type: Literal["disc"]
    material: Name
    diameter: Size


class SphereModel(TargetBase):
    """A sphere."""

    type: Literal["sphere"]
    material: Name
    diameter: Size


class CylinderModel(TargetBase):
    """A closed cylinder about its z axis."""

    type: Literal["cylinder"]
    material: Name
    diameter: Size
    length: Size


class BoxModel(TargetBase):
    """A box."""

    type: Literal["box"]
    material: Name
    size: tuple[Size, Size, Size]


class RadModel(TargetBase):
    """An included Radiance file."""

    type: Literal["rad"] = "rad"
    rad: Annotated[str, Field(strict=True, min_length=1, max_length=1000)]
    length_unit: Size = default("1 m")


class PartModel(TargetBase):
    """A triangle mesh from a file."""

    type: Literal["part"] = "part"
    part: Annotated[str, Field(strict=True, min_length=1, max_length=1000)]
    material: Name
    length_unit: Size | None = None


TargetModel = Annotated[
    SheetModel
    | BoardModel
    | EdgeModel
    | PolygonModel
    | DiscModel
    | SphereModel
    | CylinderModel
    | BoxModel
    | PartModel
    | RadModel,
    Field(discriminator="type"),
]


class SceneModel(Model):
    """A scene file."""

    title: str | None = None
    camera: CameraModel
    sources: tuple[SourceModel, ...] = ()
    materials: dict[Name, MaterialModel] = default({})
    targets: tuple[TargetModel, ...] = ()

    @model_validator(mode="before")
    @classmethod
    def _files_name_their_type(cls, table: Any) -> Any:
        """A target that names a Radiance file or a mesh needs no type beside it."""
        if not isinstance(table, dict) or not isinstance(table.get("targets"), list):
            return table
        targets = [
            next(
                ({"type": key, **target} for key in ("rad", "part") if isinstance(target, dict) and key in target),
                target,
            )
            for target in table["targets"]
        ]
        return {**table, "targets": targets}
