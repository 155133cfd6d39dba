"""Values of JSON that radwrap wrote and reads back: of the types and in the ranges that they had; the key where not."""

from __future__ import annotations

import json
from collections.abc import Iterable
from functools import cache
from typing import Annotated, Any, Final

from pydantic import Field, TypeAdapter, ValidationError

from radwrap.errors import InputError

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=1, le=2**31 - 1)]
Index = Annotated[int, Field(ge=0, le=2**31 - 1)]
Rays = Annotated[int, Field(ge=0)]  # more than fit into 32 bits
Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
# Beside the JSON file or below: nothing leads out of its folder.
InnerName = Annotated[str, Field(pattern=r"^[^/\\.\x00][^/\\\x00]*(/[^/\\.\x00][^/\\\x00]*)*$", max_length=1024)]
Hashes = dict[InnerName, Sha256]
_REMEDY: Final = "it was changed or damaged since radwrap wrote it: make it again"


def read_back(told: Any, shape: Any, where: str) -> Any:
    """Values of a shape.

    Parameters
    ----------
    told : Any
        What a JSON file holds.
    shape : type
        A dataclass or TypedDict; keys that it does not name are left out.
    where : str
        File, for messages.

    Raises
    ------
    InputError
        If it is of another shape, with the first key.
    """
    try:
        # As JSON, where an array may be a tuple, but a string is no number.
        return _reader(shape).validate_json(json.dumps(told, allow_nan=False), strict=True)
    except InputError as error:  # by a value that checks itself
        raise InputError(error.what, where=f"{where}: {error.where}", remedy=_REMEDY) from error
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        what = str(first["ctx"]["error"]) if first["type"] == "value_error" else first["msg"]
        more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
        what = f"{what[0].lower()}{what[1:]}{more}"
        raise InputError(what, where=f"{where}: {_key(first['loc'])}", remedy=_REMEDY) from error


def get_ready(*shapes: Any) -> None:
    """Build what `read_back` needs for some shapes, for who has time now and none later."""
    for shape in shapes:
        _reader(shape)


@cache
def _reader(shape: Any) -> TypeAdapter[Any]:
    """What checks values of a shape; to build it takes 20 ms, and a study reads a manifest for each of its images."""
    return TypeAdapter(shape)


def _key(steps: Iterable[int | str]) -> str:
    path = ""
    for step in steps:
        path += f"[{step}]" if isinstance(step, int) else f".{step}" if path else str(step)
    return path or "the file"
