"""The scene file's tables as pydantic models; nothing of this goes further than `load`."""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, Final, Literal

from pydantic import ConfigDict, Field, field_validator, model_validator

from radwrap.scene.file.border import (
    Aimed,
    Angle,
    AnyLength,
    Curvature,
    Duration,
    Model,
    Name,
    PixelPosition,
    Placed,
    Point,
    Share,
    Size,
    SizeOrZero,
    default,
    exactly_one,
)
from radwrap.scene.file.material_tables import MaterialModel
from radwrap.scene.file.optics_tables import CurveModel, LensModel
from radwrap.scene.file.sensor_tables import AnySensorModel, GrayLevel
from radwrap.scene.file.source_tables import SourceModel

BendNumber = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-1e6, le=1e6)]


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
        told = "diameter" in self.model_fields_set  # else a lens may have it
        if told and self.inner_diameter is not None and not self.inner_diameter < self.diameter:
            raise ValueError("inner_diameter must be smaller than diameter")
        if self.exposure_diameter is not None and self.diameter != 0:
            raise ValueError('exposure_diameter goes with diameter = "0 mm"')
        if 0 < self.diameter < 1e-9:
            raise ValueError('diameter must be "0 mm" or at least 1 nm')
        return self


class DistortionModel(Model):
    """[camera.distortion]: OpenCV's coefficients, or Tsai's."""

    model: Literal["opencv", "tsai"]
    k1: BendNumber | None = None
    k2: BendNumber | None = None
    p1: BendNumber | None = None
    p2: BendNumber | None = None
    k3: BendNumber | None = None
    k4: BendNumber | None = None
    k5: BendNumber | None = None
    k6: BendNumber | None = None
    kappa1: Curvature | None = None

    @model_validator(mode="after")
    def _one_formula(self) -> DistortionModel:
        if (self.model == "tsai") != (self.kappa1 is not None):
            raise ValueError('kappa1 goes with model = "tsai", and that needs it')
        given = sorted(self.model_fields_set - {"model", "kappa1"})
        if self.model == "tsai" and given:
            raise ValueError(f'{given[0]} goes with model = "opencv"')
        return self


def _from_calibration(schema: dict[str, Any]) -> None:
    """In the JSON schema: what a calibration tells need not stand in the scene."""
    required = schema.pop("required", [])
    others = [name for name in required if name != "focal_length"]
    schema["anyOf"] = [{"required": [*others, "calibration"]}, {"required": required}]


class CameraModel(Aimed):
    """[camera]."""

    model_config: ClassVar[ConfigDict] = ConfigDict(json_schema_extra=_from_calibration)

    calibration: Annotated[str, Field(strict=True, min_length=1, max_length=1000)] | None = None
    distortion: DistortionModel | None = None
    translation: Point | None = None
    focal_length: Size
    principal_point: tuple[PixelPosition, PixelPosition] | None = None
    exposure_time: Duration
    aperture: ApertureModel = default({})
    sensor: AnySensorModel
    lens: LensModel | None = None
    spectral_response: CurveModel | None = None
    filter: CurveModel | None = None

    @model_validator(mode="after")
    def _one_place(self) -> CameraModel:
        exactly_one(self, "position", "translation")
        return self

    @model_validator(mode="after")
    def _one_opening(self) -> CameraModel:
        told = "diameter" in self.aperture.model_fields_set
        if self.lens is not None:
            if not self.lens.focus_distance > self.focal_length:
                raise ValueError("lens.focus_distance must be larger than focal_length: nothing nearer has an image")
            if (self.lens.f_number is None) != told:
                raise ValueError(f"needs {'one' if told else 'either'} of lens.f_number and aperture.diameter")
        if self.aperture.inner_diameter is not None and not self.aperture.inner_diameter < self.opening_diameter:
            raise ValueError("aperture.inner_diameter must be smaller than the opening's diameter")
        return self

    @property
    def opening_diameter(self) -> float:
        """Diameter of the opening [m]: the aperture's own, or focal length over f-number."""
        if self.lens is None or self.lens.f_number is None:
            return self.aperture.diameter
        return self.focal_length / self.lens.f_number


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


# Of the polygon's extent; Radiance tells coordinates apart to a millionth.
_SHORTEST_SIDE: Final = 1e-6


class PolygonModel(TargetBase):
    """A flat polygon."""

    type: Literal["polygon"]
    material: Name
    vertices: Annotated[tuple[tuple[AnyLength, AnyLength], ...], Field(min_length=3, max_length=1000)]

    @field_validator("vertices")
    @classmethod
    def _apart(cls, vertices: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        extent = max(max(axis) - min(axis) for axis in zip(*vertices, strict=True))
        for number, (before, vertex) in enumerate(zip((vertices[-1], *vertices), vertices, strict=False)):
            if math.dist(before, vertex) <= _SHORTEST_SIDE * extent:
                raise ValueError(f"vertex {number} is where the one before it is, or nearly: leave it out")
        return vertices


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


class TolerancesModel(Model):
    """[tolerances]: half-widths of 95 % intervals; shares where they have no unit."""

    source_radiance: Share = 0.0
    each_source_radiance: Share = 0.0
    aperture_diameter: SizeOrZero = default("0 mm")
    exposure_time: Duration = default("0 ms")
    sensor_gain: Share = 0.0
    dark_gray: GrayLevel = 0.0


class SceneModel(Model):
    """A scene file."""

    title: str | None = None
    camera: CameraModel
    sources: tuple[SourceModel, ...] = ()
    materials: dict[Name, MaterialModel] = default({})
    targets: tuple[TargetModel, ...] = ()
    tolerances: TolerancesModel | None = None

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
