"""Tables of a design file as pydantic models; nothing of them goes further than `design`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Final

from pydantic import BeforeValidator, Field, model_validator

from radwrap.scene.file.border import Model, default, exactly_one

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


class DesignModel(Model):
    """A design file; [design] hangs on its kind, [render] and [responses] on what they name."""

    title: Text | None = None
    scene: Text
    set: Table = default({})
    seed: Annotated[int, BeforeValidator(_whole(0, _LARGEST_SEED))] = 0
    replicates: Annotated[int, BeforeValidator(_whole(1, MOST_RUNS))] = 1
    design: Table
    render: Table = default({})
    factors: dict[str, FactorModel]
    responses: dict[str, Table]
    analysis: Annotated[str, BeforeValidator(_one_of("lenth", "anova", "none"))] | None = None
