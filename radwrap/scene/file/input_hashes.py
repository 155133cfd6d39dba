"""What scenes depend on besides their own tables, by hashes: another file or component makes other images."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from radwrap.errors import InputError
from radwrap.files import sha256_of
from radwrap.scene.catalog.presets import hashes_of, naming_presets, with_presets
from radwrap.scene.file.named_files import named_files


def input_hashes(
    documents: Sequence[Mapping[str, Any]], origin: str, folder: Path, *, trust: bool, beside: Any = ()
) -> dict[str, str]:
    """SHA-256 of each file and of each component of the catalog that some scenes name.

    Parameters
    ----------
    documents : sequence of Mapping
        Tables of the scenes.
    origin : str
        Their file, for messages.
    folder : Path
        Where it lies.
    trust : bool
        Whether they may name files outside of it.
    beside : JSON value, optional
        What may name files too, such as values that a scene gets later.

    Raises
    ------
    InputError
        If one of the files cannot be read.
    """
    home = folder.resolve()
    files = named_files({"scenes": list(documents), "beside": beside}, home, trust=trust)
    components: dict[str, str] = {}
    seen: set[str] = set()
    for document in documents:
        tables = naming_presets(document)
        if tables and (text := json.dumps(tables)) not in seen:
            seen.add(text)
            components |= hashes_of(with_presets(tables, origin, folder)[1])
    return {os.path.relpath(path, home): _file_hash(path) for path in files} | {
        f"catalog: {name}": sha256 for name, sha256 in sorted(components.items())
    }


def _file_hash(path: Path) -> str:
    try:
        return sha256_of(path)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", where=str(path), remedy="the scene names it") from error
