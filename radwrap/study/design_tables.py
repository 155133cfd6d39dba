"""Tables of a design file as pydantic models; nothing of them goes further than `design`."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Any, Final, Literal

from pydantic import BeforeValidator, Field, model_validator

from radwrap.scene.file.border import Flag, Model, Whole, default, exactly_one

_LARGEST_SEED: Final = 2**32 - 1
MOST_RUNS: Final = 1_000_000


def _whole(low: int, high: int) -> Callable[[Any], int]:
    def read(value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise ValueError(f"must be a whole number from {low} to {high}, not {value!r}")
        return value

    return read


def _one_of(*names: str) -> Callable[[Any], str]:
    def read(value: Any) -> str:
        if not isinstance(value, str) or value not in names:
            raise ValueError(f"must be one of {', '.join(names)}, not {value!r}")
        return value

    return read


def _number(value: Any) -> Any:
    """A number as it was written: what a study was run with is told with the same digits."""
    if value is None:  # left out
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"must be a number, not {value!r}")
    if not math.isfinite(value):
        raise ValueError("is not a finite number")
    return value


def _tolerance(value: Any) -> Any:
    """A number, or a text with a unit, whose limits are those of `RenderOptions`."""
    return value if isinstance(value, str) else _number(value)


Number = Annotated[Any, BeforeValidator(_number)]
Tolerance = Annotated[Any, BeforeValidator(_tolerance)]
Text = Annotated[str, Field(strict=True, min_length=1)]
Table = dict[str, Any]


class FactorModel(Model):
    """[factors.NAME]; what a level may be hangs on its key."""

    label: Text | None = None
    key: Text | None = None
    keys: Annotated[tuple[Text, ...], Field(min_length=1)] | None = None
    levels: Any = None
    range: Any = None
    draws: Annotated[str, BeforeValidator(_one_of("each run", "once"))] = "each run"

    @model_validator(mode="after")
    def _one_of_each(self) -> FactorModel:
        exactly_one(self, "key", "keys")
        exactly_one(self, "levels", "range")
        return self


class FullModel(Model):
    """[design]: all combinations of all levels."""

    kind: Literal["full"]


class FractionalModel(Model):
    """[design]: the combinations that generators name."""

    kind: Literal["fractional"]
    generators: Text


class LatinHypercubeModel(Model):
    """[design]: points of ranges."""

    kind: Literal["latin_hypercube"]
    runs: Annotated[int, BeforeValidator(_whole(2, MOST_RUNS))]


class ListModel(Model):
    """[design]: rows of levels, or a CSV file of them; what a row may hold hangs on the factors."""

    kind: Literal["list"]
    runs: Any


Combinations = Annotated[FullModel | FractionalModel | LatinHypercubeModel | ListModel, Field(discriminator="kind")]


class RenderModel(Model):
    """[render]: options of a render that a study may name; their limits are those of `RenderOptions`."""

    method: Literal["pinhole", "viewpoints", "kernel", "rays"] | None = None
    tolerance: Tolerance = None
    max_error: Number = None
    budget_rays: Number = None
    viewpoints: Whole | None = None
    layout: Literal["rings", "hexagonal", "sunflower", "uneven"] | None = None
    pixel_samples: Whole | None = None
    pixel_sampling: Literal["centre", "jitter"] | None = None
    max_pixels: Whole | None = None
    basis: Flag | None = None

    def given(self) -> dict[str, Any]:
        """What is not left out, but for the basis."""
        return self.model_dump(exclude_unset=True, exclude={"basis"})


class DesignModel(Model):
    """A design file; [responses] hang on what they measure."""

    title: Text | None = None
    scene: Text
    set: Table = default({})
    channel: Literal["red", "green", "blue"] | None = None
    seed: Annotated[int, BeforeValidator(_whole(0, _LARGEST_SEED))] = 0
    replicates: Annotated[int, BeforeValidator(_whole(1, MOST_RUNS))] = 1
    design: Combinations
    render: RenderModel = default({})
    factors: dict[str, FactorModel]
    responses: dict[str, Table]
    analysis: Annotated[str, BeforeValidator(_one_of("lenth", "anova", "none"))] | None = None
