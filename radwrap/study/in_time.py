"""Runs whose scenes change in the course of their exposure: each has instants of its own, and shares no rays."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from radwrap.errors import InputError
from radwrap.scene.file.load import scene_from_document
from radwrap.scene.instants import keys_of_time

# Without one of these words in it a scene file says nothing of time; a preset may say anything.
_WORDS: Final = ("velocity", "strobe", "shutter", "preset")


def changes_in_time(document: Mapping[str, Any], folder: Path) -> bool:
    """Whether the scene of a run is not that of one instant; what is wrong with it its own run will say."""
    text = json.dumps(document)
    if not any(word in text for word in _WORDS):
        return False
    try:
        return bool(keys_of_time(scene_from_document(document, folder=folder)))
    except InputError:
        return False
