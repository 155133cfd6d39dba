"""Tables of a file of captures as pydantic models; nothing of them goes further than `series`."""

from __future__ import annotations

from typing import Annotated, Any, Final

from pydantic import Field

from radwrap.scene.file.border import Model, default

_MOST: Final = 1000  # states: all captures are in memory
_Text = Annotated[str, Field(strict=True, min_length=1)]


class StateModel(Model):
    """[[captures]]: images of the bench in one state, and the keys that have other values there."""

    files: Annotated[list[_Text], Field(min_length=1)]
    set: dict[str, Any] = default({})


class SeriesModel(Model):
    """A file of captures."""

    captures: Annotated[list[StateModel], Field(min_length=1, max_length=_MOST)]
