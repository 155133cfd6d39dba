"""Tables of a design file as pydantic models; nothing of them goes further than `document`."""

from __future__ import annotations

from typing import Annotated, Any, Final, Literal

from pydantic import Field, model_validator

from radwrap.scene.file.border import Model, default, exactly_one
from radwrap.study.design_tables import RenderModel

FEWEST_RENDERS: Final = 3  # one to search by, one to decide by, one to check by
MOST_RENDERS: Final = 100_000
_LARGEST_SEED: Final = 2**32 - 2  # the check takes the next one
_LARGEST_BATCH: Final = 256

Text = Annotated[str, Field(strict=True, min_length=1)]
Aim = Literal["minimise", "maximise"]


class KeyModel(Model):
    """[keys.NAME]: what may be changed, and how far."""

    key: Text | None = None
    keys: Annotated[tuple[Text, ...], Field(min_length=1)] | None = None
    low: Any = None
    high: Any = None
    step: Any = None
    scale: Literal["linear", "log"] = "linear"
    choices: Annotated[list[Any], Field(min_length=2)] | None = None
    cost: list[Any] | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> KeyModel:
        exactly_one(self, "key", "keys")
        exactly_one(self, "low", "choices")
        if (self.low is None) != (self.high is None):
            raise ValueError("needs both low and high")
        if self.keys is not None and self.choices is None:
            raise ValueError("several keys need choices, each with a value for every key")
        if self.cost is not None and self.choices is None:
            raise ValueError("cost goes with choices, one for each")
        if self.low is None and (self.step is not None or self.scale != "linear"):
            raise ValueError("step and scale go with low and high")
        if self.step is not None and self.scale != "linear":
            raise ValueError("step goes with a linear scale")
        return self


class ToleranceModel(Model):
    """[tolerances.NAME]: what something may be off by."""

    key: Text | None = None
    keys: Annotated[tuple[Text, ...], Field(min_length=1)] | None = None
    by: Any

    @model_validator(mode="after")
    def _one_kind(self) -> ToleranceModel:
        exactly_one(self, "key", "keys")
        return self


class ObjectiveModel(Model):
    """[[objectives]]: what is to become small or large."""

    of: Text
    aim: Aim


class ConstraintModel(Model):
    """[[constraints]]: what must stay within limits."""

    of: Text
    at_least: Any = None
    at_most: Any = None

    @model_validator(mode="after")
    def _some_limit(self) -> ConstraintModel:
        if self.at_least is None and self.at_most is None:
            raise ValueError("needs at_least, at_most, or both")
        return self


class ProblemModel(Model):
    """A design file; [responses] hang on what they measure."""

    title: Text | None = None
    scene: Text
    set: dict[str, Any] = default({})
    seed: Annotated[int, Field(strict=True, ge=0, le=_LARGEST_SEED)] = 0
    budget: Annotated[int, Field(strict=True, ge=FEWEST_RENDERS, le=MOST_RENDERS)]
    batch: Annotated[int, Field(strict=True, ge=1, le=_LARGEST_BATCH)] = 8
    coarse: Annotated[float, Field(ge=1, le=100, allow_inf_nan=False)] = 4.0
    case: Literal["nominal", "worst"] = "nominal"
    tolerances: dict[str, ToleranceModel] = default({})
    render: RenderModel = default({})
    keys: Annotated[dict[str, KeyModel], Field(min_length=1)]
    responses: dict[str, dict[str, Any]] = default({})
    objectives: Annotated[tuple[ObjectiveModel, ...], Field(min_length=1, max_length=2)]
    constraints: tuple[ConstraintModel, ...] = ()
