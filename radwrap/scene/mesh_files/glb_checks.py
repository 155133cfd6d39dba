"""What a binary glTF file asks of its readers, and what of it would be read otherwise than meant."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from typing import Any, Final

from radwrap.errors import InputError

# Extensions of colours, textures and lamps, which nobody reads here; all others change shapes or places.
_HARMLESS: Final = ("KHR_materials_", "KHR_texture_", "KHR_lights_", "EXT_texture_", "EXT_lights_")
_TRIANGLES: Final = (4, 5)  # a list, a strip
_MODES: Final = {0: "points", 1: "lines", 2: "a loop of lines", 3: "a strip of lines", 6: "a fan of triangles"}
_FLOAT: Final = 5126
MOST_NODES: Final = 100_000  # the library walks them one by one, a million in minutes


def check_glb(content: bytes, where: str) -> None:
    """Refuse by name what would be left out or misread.

    Raises
    ------
    InputError
        If it holds more than `MOST_NODES` nodes, it or a node needs an extension, or it holds lines, points, fans,
        skins, morph targets, or sparse, scaled or packed numbers; or is no glTF 2 file.
    """
    try:
        tree = _tree(content)
        count = len(tree.get("nodes", ()))
        found = next(_faults(tree), None)
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, RecursionError, struct.error) as error:
        raise InputError(f"is not a complete GLB file: {str(error)[:100]}", where=where) from error
    if count > MOST_NODES:
        raise InputError(
            f"holds {count} nodes, the limit is {MOST_NODES}", where=where, remedy="join its nodes into fewer meshes"
        )
    if found:
        raise InputError(f"{found}: that is not read here", where=where, remedy="export plain triangles")


def _tree(content: bytes) -> dict[str, Any]:
    magic, version, length, size, kind = struct.unpack("<4sIII4s", content[:20])
    if magic != b"glTF" or version != 2 or kind != b"JSON" or length > len(content) or size > length - 20:
        raise ValueError("its header does not fit")
    tree: dict[str, Any] = json.loads(content[20 : 20 + size])
    return tree


def _faults(tree: dict[str, Any]) -> Iterator[str]:
    for name in tree.get("extensionsRequired", ()):
        if not name.startswith(_HARMLESS):
            yield f'it needs the extension "{name[:60]}"'
    for number, node in enumerate(tree.get("nodes", ())):
        if "skin" in node:
            yield f"node {number} has a skin"
        for name in node.get("extensions", ()):
            if not name.startswith(_HARMLESS):
                yield f'node {number} has the extension "{name[:60]}"'
    accessors = tree.get("accessors", ())
    for number, mesh in enumerate(tree.get("meshes", ())):
        for primitive in mesh["primitives"]:
            mode = primitive.get("mode", 4)
            if mode not in _TRIANGLES:
                yield f"mesh {number} holds {_MODES.get(mode, 'unknown shapes')}"
            if primitive.get("targets"):
                yield f"mesh {number} has morph targets"
            places = accessors[primitive["attributes"]["POSITION"]]
            used = [places] + ([accessors[primitive["indices"]]] if "indices" in primitive else [])
            if places["componentType"] != _FLOAT or any(accessor.get("normalized") for accessor in used):
                yield f"mesh {number} has vertices that are not float32"
            if any("sparse" in accessor for accessor in used):
                yield f"mesh {number} has sparse numbers"
            if any("bufferView" not in accessor for accessor in used):
                yield f"mesh {number} has numbers that are not in the file"
