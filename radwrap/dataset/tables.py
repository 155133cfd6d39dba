"""Tables of a dataset's file as pydantic models; nothing of them goes further than `document`."""

from __future__ import annotations

from typing import Annotated, Any, Final, Literal

from pydantic import Field, field_validator, model_validator

from radwrap.scene.file.border import Direction, Flag, Model, Name, Point, default, exactly_one

MOST_IMAGES: Final = 1_000_000
MOST_COPIES: Final = 1000  # of one target in one image
_MOST_FOLD: Final = 360
CONTINUOUS: Final = "continuous"  # of a symmetry: any angle
_LARGEST_SEED: Final = 2**32 - 1

Text = Annotated[str, Field(strict=True, min_length=1)]
COCO: Final = "coco"
BOP: Final = "bop"
YOLO: Final = "yolo"
FormatName = Literal["coco", "bop", "yolo"]
SegmentationName = Literal["rle", "polygons"]
DISTRIBUTIONS: Final = ("uniform", "normal", "log_uniform", "choice", "rotation")


class VaryModel(Model):
    """[[vary]]: a key of the scene, and what its value is drawn from."""

    key: Text
    uniform: Any = None
    normal: Any = None
    log_uniform: Any = None
    choice: Any = None
    rotation: Any = None
    weights: Any = None

    @model_validator(mode="after")
    def _one_distribution(self) -> VaryModel:
        exactly_one(self, *DISTRIBUTIONS)
        if self.weights is not None and self.choice is None:
            raise ValueError("weights go with choice")
        return self


class PartsModel(Model):
    """[[parts]]: how often a target of the scene stands there, and where."""

    target: Name
    count: Any = 1
    x: Any = default("0 mm")
    y: Any = default("0 mm")
    z: Any = default("0 mm")
    rotation: Any = default("any")


class SymmetryModel(Model):
    """[[symmetries]]: a turn after which a part looks the same."""

    target: Name
    axis: Direction
    through: Point = default(("0 mm", "0 mm", "0 mm"))
    fold: Any

    @field_validator("fold")
    @classmethod
    def _turns(cls, value: Any) -> Any:
        # Of a union of types the message would name each by itself.
        if value == CONTINUOUS or (type(value) is int and 2 <= value <= _MOST_FOLD):
            return value
        raise ValueError(f'must be a whole number from 2 to {_MOST_FOLD}, or "{CONTINUOUS}", not {value!r}')


class DatasetModel(Model):
    """A dataset's file."""

    title: Text | None = None
    scene: Text
    set: dict[str, Any] = default({})
    images: Annotated[int, Field(strict=True, ge=1, le=MOST_IMAGES)]
    seed: Annotated[int, Field(strict=True, ge=0, le=_LARGEST_SEED)] = 0
    formats: Annotated[tuple[FormatName, ...], Field(min_length=1)] = ("coco",)
    segmentation: SegmentationName = "rle"
    tolerance: Any = 1
    noise: Flag = False
    shard: Annotated[int, Field(strict=True, ge=1, le=MOST_IMAGES)] = 1000
    vary: tuple[VaryModel, ...] = ()
    parts: tuple[PartsModel, ...] = ()
    symmetries: tuple[SymmetryModel, ...] = ()
