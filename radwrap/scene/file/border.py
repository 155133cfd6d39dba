"""Types of the scene file's values: how text becomes SI, and what the JSON schema says of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, WithJsonSchema, model_validator

from radwrap.errors import InputError
from radwrap.units import (
    ANGLE,
    ANGULAR_VELOCITY,
    COEFFICIENT_OF_RETROREFLECTION,
    CURRENT,
    CURVATURE,
    EFFICACY,
    ELECTRON_RATE,
    ELECTRONS,
    LENGTH,
    LUMINANCE,
    LUMINOUS_FLUX,
    LUMINOUS_INTENSITY,
    PIXEL,
    RADIANCE,
    RADIANT_FLUX,
    RADIANT_INTENSITY,
    SPEED,
    SYSTEM_GAIN,
    TEMPERATURE,
    TEMPERATURE_DIFFERENCE,
    TIME,
    Dimension,
    parse_quantity,
)

# No object of a scene is smaller or larger than this [m]: far beyond any machine-vision scene, well inside doubles.
SMALLEST_LENGTH = 1e-9
LARGEST_LENGTH = 1e9


def _reader(dimension: Dimension) -> Callable[[object], float]:
    def read(text: object) -> float:
        try:
            return parse_quantity(text, dimension)
        except InputError as error:
            raise ValueError(str(error)) from error

    return read


def _schema(dimension: Dimension) -> WithJsonSchema:
    description = f"{dimension.name}: one number, one blank, one unit of {', '.join(dimension.units)}"
    return WithJsonSchema({"type": "string", "pattern": dimension.pattern, "description": description})


AnyLength = Annotated[
    float, Field(ge=-LARGEST_LENGTH, le=LARGEST_LENGTH), BeforeValidator(_reader(LENGTH)), _schema(LENGTH)
]
Size = Annotated[float, Field(ge=SMALLEST_LENGTH, le=LARGEST_LENGTH), BeforeValidator(_reader(LENGTH)), _schema(LENGTH)]
SizeOrZero = Annotated[float, Field(ge=0, le=LARGEST_LENGTH), BeforeValidator(_reader(LENGTH)), _schema(LENGTH)]
Angle = Annotated[float, BeforeValidator(_reader(ANGLE)), _schema(ANGLE)]
PositiveAngle = Annotated[float, Field(gt=0), BeforeValidator(_reader(ANGLE)), _schema(ANGLE)]
Speed = Annotated[float, Field(ge=-1e9, le=1e9), BeforeValidator(_reader(SPEED)), _schema(SPEED)]
AngularVelocity = Annotated[
    float, Field(ge=-1e9, le=1e9), BeforeValidator(_reader(ANGULAR_VELOCITY)), _schema(ANGULAR_VELOCITY)
]
Instant = Annotated[float, Field(ge=-1e9, le=1e9), BeforeValidator(_reader(TIME)), _schema(TIME)]
Interval = Annotated[float, Field(ge=1e-12, le=1e9), BeforeValidator(_reader(TIME)), _schema(TIME)]
Duration = Annotated[float, Field(ge=0, le=1e9), BeforeValidator(_reader(TIME)), _schema(TIME)]
RadianceValue = Annotated[float, Field(ge=0, le=1e30), BeforeValidator(_reader(RADIANCE)), _schema(RADIANCE)]
RadiantIntensityValue = Annotated[
    float, Field(ge=0, le=1e30), BeforeValidator(_reader(RADIANT_INTENSITY)), _schema(RADIANT_INTENSITY)
]
RadiantFluxValue = Annotated[float, Field(ge=0, le=1e30), BeforeValidator(_reader(RADIANT_FLUX)), _schema(RADIANT_FLUX)]
LuminanceValue = Annotated[float, Field(ge=0, le=1e30), BeforeValidator(_reader(LUMINANCE)), _schema(LUMINANCE)]
LuminousIntensityValue = Annotated[
    float, Field(ge=0, le=1e30), BeforeValidator(_reader(LUMINOUS_INTENSITY)), _schema(LUMINOUS_INTENSITY)
]
LuminousFluxValue = Annotated[
    float, Field(ge=0, le=1e30), BeforeValidator(_reader(LUMINOUS_FLUX)), _schema(LUMINOUS_FLUX)
]
# From the width of a laser's line to thermal infrared.
Wavelength = Annotated[float, Field(ge=1e-10, le=1e-4), BeforeValidator(_reader(LENGTH)), _schema(LENGTH)]
EfficacyValue = Annotated[float, Field(gt=0, le=1e9), BeforeValidator(_reader(EFFICACY)), _schema(EFFICACY)]
Coefficient = Annotated[
    float,
    Field(gt=0, le=1e9),
    BeforeValidator(_reader(COEFFICIENT_OF_RETROREFLECTION)),
    _schema(COEFFICIENT_OF_RETROREFLECTION),
]
PixelPosition = Annotated[float, Field(ge=-1e9, le=1e9), BeforeValidator(_reader(PIXEL)), _schema(PIXEL)]
Electrons = Annotated[float, Field(ge=0, le=1e12), BeforeValidator(_reader(ELECTRONS)), _schema(ELECTRONS)]
ElectronRate = Annotated[float, Field(ge=0, le=1e12), BeforeValidator(_reader(ELECTRON_RATE)), _schema(ELECTRON_RATE)]
SystemGain = Annotated[float, Field(gt=0, le=1e9), BeforeValidator(_reader(SYSTEM_GAIN)), _schema(SYSTEM_GAIN)]
Temperature = Annotated[float, Field(ge=-273.15, le=1e3), BeforeValidator(_reader(TEMPERATURE)), _schema(TEMPERATURE)]
TemperatureDifference = Annotated[
    float, Field(ge=0.1, le=1e3), BeforeValidator(_reader(TEMPERATURE_DIFFERENCE)), _schema(TEMPERATURE_DIFFERENCE)
]
Current = Annotated[float, Field(ge=0, le=1e9), BeforeValidator(_reader(CURRENT)), _schema(CURRENT)]
Curvature = Annotated[float, Field(ge=-1e12, le=1e12), BeforeValidator(_reader(CURVATURE)), _schema(CURVATURE)]

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Share = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=1)]
PositiveShare = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=1)]
Factor = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=1e6)]
Count = Annotated[int, Field(strict=True, ge=1, le=1_000_000)]
Whole = Annotated[int, Field(strict=True)]
Flag = Annotated[bool, Field(strict=True)]
TERM_NUMBER = r"^(0|[1-9][0-9]{0,2})$"  # of a polynomial of a wavefront
# What glass adds to the path of light: a thousand waves and more.
LONGEST_PATH = 1e-3
OpticalPath = Annotated[
    float, Field(ge=-LONGEST_PATH, le=LONGEST_PATH), BeforeValidator(_reader(LENGTH)), _schema(LENGTH)
]
# Names become identifiers of Radiance's text.
Name = Annotated[str, Field(strict=True, pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,63}$")]
# NAME, or NAME@DATE of an older revision.
ComponentName = Annotated[str, Field(strict=True, min_length=1, max_length=100)]
Point = tuple[AnyLength, AnyLength, AnyLength]
Direction = tuple[Number, Number, Number]
RotationOrder = Literal["xyz", "xzy", "yxz", "yzx", "zxy", "zyx"]


class Model(BaseModel):
    """A table of the scene file; an unknown key is an error."""

    # Built when a scene is read, all tables at once: each by itself would hold its own copy of those inside it.
    model_config: ClassVar[ConfigDict] = ConfigDict(
        extra="forbid", frozen=True, validate_default=True, defer_build=True
    )


def default(value: Any) -> Any:
    """Value that is taken, and listed as assumed, where the file is silent; written as the user would."""
    return Field(default=value)


def exactly_one(model: Model, *keys: str) -> None:
    """Refuse a table that has none of some keys, or more than one."""
    given = [key for key in keys if getattr(model, key) is not None]
    if len(given) != 1:
        raise ValueError(f"needs exactly one of {', '.join(keys[:-1])} and {keys[-1]}, not {len(given)}")


def preset_or_all(schema: dict[str, Any]) -> None:
    """In the JSON schema: what is required without a preset is not with one."""
    schema["anyOf"] = [{"required": ["preset"]}, {"required": schema.pop("required", [])}]


class Placed(Model):
    """Something with a position and a rotation about fixed world axes."""

    position: Point = default(("0 m", "0 m", "0 m"))
    """Position of its origin in the world."""
    rotation: tuple[Angle, Angle, Angle] = default(("0 deg", "0 deg", "0 deg"))
    """Rotation about the world's fixed x, y and z axes."""
    rotation_order: RotationOrder = "xyz"
    """Order of the three turns, the first one first."""


class TargetBase(Placed):
    """What all targets have in common."""

    name: Name | None = None
    """Unique in the scene; default by its number."""
    velocity: tuple[Speed, Speed, Speed] | None = None
    """Velocity of its origin along the world's axes; its pose holds at the middle of the frame's first exposure."""
    angular_velocity: tuple[AngularVelocity, AngularVelocity, AngularVelocity] | None = None
    """Turns about its origin, along the world's axes: the vector's direction is the axis, its length the speed."""


class Aimed(Model):
    """Something that looks along its own z axis: by look_at (and up), or by rotation."""

    position: Point | None = None
    """Position of its origin in the world."""
    look_at: Point | None = None
    """A point in the world that its z axis goes through; in place of rotation."""
    up: Direction | None = None
    """Direction in the world that is up in the image or on the source; without unit."""
    rotation: tuple[Angle, Angle, Angle] | None = None
    """Rotation about the world's fixed x, y and z axes; in place of look_at."""
    rotation_order: RotationOrder | None = None
    """Order of the three turns, the first one first."""

    @model_validator(mode="after")
    def _one_attitude(self) -> Aimed:
        exactly_one(self, "look_at", "rotation")
        if self.up is not None and self.look_at is None:
            raise ValueError("up goes with look_at")
        if self.rotation_order is not None and self.rotation is None:
            raise ValueError("rotation_order goes with rotation")
        return self
