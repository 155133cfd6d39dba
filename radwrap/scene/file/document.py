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
    Point,
    Share,
    Size,
    SizeOrZero,
    TargetBase,
    Wavelength,
    default,
    exactly_one,
)
from radwrap.scene.file.material_tables import MaterialModel
from radwrap.scene.file.optics_tables import GLASS, CurveModel, LensModel, TransmissionModel
from radwrap.scene.file.pattern_tables import (
    CharucoModel,
    ChessboardModel,
    CirclesModel,
    SiemensStarModel,
    Usaf1951Model,
)
from radwrap.scene.file.sensor_tables import AnySensorModel, GrayLevel
from radwrap.scene.file.source_tables import SourceModel

BendNumber = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-1e6, le=1e6)]


class ApertureModel(Model):
    """[camera.aperture]."""

    shape: Literal["round", "square", "annular", "half_disc"] = "round"
    """Shape of the opening."""
    diameter: SizeOrZero = default("0.1 mm")
    """Diameter of the opening, or the side of a square one. 0 is an infinitesimal pinhole."""
    inner_diameter: SizeOrZero | None = None
    """Diameter of the stop in the middle of an annular opening."""
    rotation: Angle = default("0 deg")
    """Rotation of the opening, from the camera's x right towards its y down."""
    exposure_diameter: Size | None = None
    """Diameter of the opening whose area sets the level of the exposure where diameter is 0."""

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
    """Formula of the distortion: OpenCV's distorts, Tsai's undistorts."""
    k1: BendNumber | None = None
    """Radial coefficient of r^2, in units of the focal length."""
    k2: BendNumber | None = None
    """Radial coefficient of r^4."""
    p1: BendNumber | None = None
    """First tangential coefficient."""
    p2: BendNumber | None = None
    """Second tangential coefficient."""
    k3: BendNumber | None = None
    """Radial coefficient of r^6."""
    k4: BendNumber | None = None
    """Coefficient of r^2 in the radial formula's denominator."""
    k5: BendNumber | None = None
    """Coefficient of r^4 in the radial formula's denominator."""
    k6: BendNumber | None = None
    """Coefficient of r^6 in the radial formula's denominator."""
    s1: BendNumber | None = None
    """Thin prism: what moves x by r^2."""
    s2: BendNumber | None = None
    """Thin prism: what moves x by r^4."""
    s3: BendNumber | None = None
    """Thin prism: what moves y by r^2."""
    s4: BendNumber | None = None
    """Thin prism: what moves y by r^4."""
    kappa1: Curvature | None = None
    """Tsai's coefficient, x = xd (1 + kappa1 rd^2)."""

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
    by_name = {"required": [*others, "lens"], "properties": {"lens": {"type": "object", "required": ["preset"]}}}
    schema["anyOf"] = [{"required": [*others, "calibration"]}, by_name, {"required": required}]


class CameraModel(Aimed):
    """[camera]."""

    model_config: ClassVar[ConfigDict] = ConfigDict(json_schema_extra=_from_calibration)

    calibration: Annotated[str, Field(strict=True, min_length=1, max_length=1000)] | None = None
    """File of a calibration beside the scene: OpenCV's, or JSON of `radwrap calibrate camera`."""
    distortion: DistortionModel | None = None
    """Distortion of the lens."""
    translation: Point | None = None
    """Another name of position."""
    focal_length: Size
    """Focal length of the lens; for a pinhole, its distance from the sensor."""
    principal_point: tuple[PixelPosition, PixelPosition] | None = None
    """Column and row where the optical axis meets the sensor; default the sensor's middle."""
    exposure_time: Duration
    """Exposure time of one frame."""
    aperture: ApertureModel = default({})
    """The opening."""
    sensor: AnySensorModel
    """Pixels and response."""
    lens: LensModel | None = None
    """Without it the camera is a pinhole."""
    wavelength: Wavelength | None = None
    """Wavelength of the light, where neither spectra nor a linear sensor give it."""
    diffraction: Literal["auto", "on", "off"] = "auto"
    """Whether images have diffraction: where it matters, always, or never."""
    spectral_response: CurveModel | None = None
    """Relative response of the sensor over wavelength."""
    filter: TransmissionModel | None = None
    """Transmittance of a filter over wavelength."""

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

    @model_validator(mode="after")
    def _one_wavelength(self) -> CameraModel:
        if self.wavelength is not None and self.sensor.model == "linear":
            raise ValueError("wavelength: sensor.wavelength gives it already; leave this one out")
        return self

    @model_validator(mode="after")
    def _one_response(self) -> CameraModel:
        if self.spectral_response is not None and self.sensor.filters is not None:
            raise ValueError("spectral_response: sensor.filters give it already; leave this one out")
        return self

    @model_validator(mode="after")
    def _an_opening_for_waves(self) -> CameraModel:
        if self.diffraction == "on" and not self.opening_diameter:
            raise ValueError('diffraction: "on" needs an opening, and the aperture\'s diameter is 0; leave it out')
        return self

    @model_validator(mode="after")
    def _waves_for_glass(self) -> CameraModel:
        for key in GLASS:
            if getattr(self.lens, key, None) is not None:
                if not self.opening_diameter:
                    raise ValueError(f"lens.{key} needs an opening, and the aperture's diameter is 0; leave it out")
                if self.diffraction == "off":
                    raise ValueError(
                        f'diffraction: "off" leaves out what lens.{key} does to waves; leave one of them out'
                    )
        return self

    @property
    def opening_diameter(self) -> float:
        """Diameter of the opening [m]: the aperture's own, or focal length over f-number."""
        if self.lens is None or self.lens.f_number is None:
            return self.aperture.diameter
        return self.focal_length / self.lens.f_number


class SheetModel(TargetBase):
    """A flat rectangle."""

    type: Literal["sheet"]
    """Kind of target."""
    material: Name
    """Name of a material."""
    size: tuple[Size, Size]
    """Width along its x axis and height along its y axis."""


class BoardModel(TargetBase):
    """A calibration board of dots."""

    type: Literal["board"]
    """Kind of target."""
    material: Name
    """Name of the material between the dots."""
    dot_material: Name
    """Name of the material of the dots."""
    rows: Annotated[int, Field(strict=True, ge=1, le=1000)]
    """How many rows of dots."""
    columns: Annotated[int, Field(strict=True, ge=1, le=1000)]
    """How many columns of dots."""
    pitch: Size
    """Distance between the centres of neighbouring dots."""
    dot_diameter: Size
    """Diameter of each dot."""
    margin: SizeOrZero = default("10 mm")
    """Distance from the outermost dots' rims to the board's edges."""

    @model_validator(mode="after")
    def _dots_apart(self) -> BoardModel:
        if self.dot_diameter > self.pitch and self.rows * self.columns > 1:
            raise ValueError("dots overlap: dot_diameter must not exceed pitch")
        return self


class EdgeModel(TargetBase):
    """Two materials that meet at a straight edge."""

    type: Literal["edge"]
    """Kind of target."""
    material: Name
    """Name of the material where x < edge_position."""
    edge_material: Name
    """Name of the material where x > edge_position."""
    size: tuple[Size, Size]
    """Width along its x axis and height along its y axis."""
    edge_position: AnyLength = default("0 mm")
    """x of the edge, from the middle of the target."""

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
    """Kind of target."""
    material: Name
    """Name of a material."""
    vertices: Annotated[tuple[tuple[AnyLength, AnyLength], ...], Field(min_length=3, max_length=1000)]
    """Corners (x, y) in the target's plane, in order."""

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
    """Kind of target."""
    material: Name
    """Name of a material."""
    diameter: Size
    """Diameter of the disc."""


class SphereModel(TargetBase):
    """A sphere."""

    type: Literal["sphere"]
    """Kind of target."""
    material: Name
    """Name of a material."""
    diameter: Size
    """Diameter of the sphere."""


class CylinderModel(TargetBase):
    """A closed cylinder about its z axis."""

    type: Literal["cylinder"]
    """Kind of target."""
    material: Name
    """Name of a material."""
    diameter: Size
    """Diameter of the cylinder."""
    length: Size
    """Length along its z axis, half to each side of its origin."""


class BoxModel(TargetBase):
    """A box."""

    type: Literal["box"]
    """Kind of target."""
    material: Name
    """Name of a material."""
    size: tuple[Size, Size, Size]
    """Lengths along its x, y and z axes."""


class RadModel(TargetBase):
    """An included Radiance file."""

    type: Literal["rad"] = "rad"
    """Kind of target."""
    rad: Annotated[str, Field(strict=True, min_length=1, max_length=1000)]
    """Radiance file beside the scene."""
    length_unit: Size = default("1 m")
    """What a length of 1 in the file is."""


class PartModel(TargetBase):
    """A triangle mesh from a file."""

    type: Literal["part"] = "part"
    """Kind of target."""
    part: Annotated[str, Field(strict=True, min_length=1, max_length=1000)]
    """STL, OBJ, PLY, GLB or STEP file beside the scene."""
    material: Name
    """Name of a material."""
    length_unit: Size | None = None
    """What a length of 1 in the file is."""


TargetModel = Annotated[
    SheetModel
    | BoardModel
    | EdgeModel
    | ChessboardModel
    | CharucoModel
    | CirclesModel
    | SiemensStarModel
    | Usaf1951Model
    | PolygonModel
    | DiscModel
    | SphereModel
    | CylinderModel
    | BoxModel
    | PartModel
    | RadModel,
    Field(discriminator="type"),
]


class TargetFileModel(Model):
    """A file that holds one target with a pattern, and nothing else."""

    target: Annotated[
        BoardModel | ChessboardModel | CharucoModel | CirclesModel | SiemensStarModel | Usaf1951Model,
        Field(discriminator="type"),
    ]
    """Its table."""


class TolerancesModel(Model):
    """[tolerances]: half-widths of 95 % intervals; shares where they have no unit."""

    source_radiance: Share = 0.0
    """Radiance of all sources together, as a share, 0 to 1."""
    each_source_radiance: Share = 0.0
    """Radiance of each source by itself, as a share, 0 to 1."""
    aperture_diameter: SizeOrZero = default("0 mm")
    """Diameter of the opening."""
    exposure_time: Duration = default("0 ms")
    """Exposure time of one frame."""
    sensor_gain: Share = 0.0
    """Gain K, or the responsivity of a linear camera, as a share, 0 to 1."""
    dark_gray: GrayLevel = 0.0
    """Dark gray level."""


class SceneModel(Model):
    """A scene file."""

    title: str | None = None
    """What the scene is, in words."""
    camera: CameraModel
    """Where it is, its lens and its sensor."""
    sources: tuple[SourceModel, ...] = ()
    """What shines."""
    materials: dict[Name, MaterialModel] = default({})
    """Materials by name: how surfaces reflect."""
    targets: tuple[TargetModel, ...] = ()
    """What is seen."""
    tolerances: TolerancesModel | None = None
    """How far the real cell may differ: half-widths of 95 % intervals."""

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
