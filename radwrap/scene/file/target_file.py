"""A target from a file: of a scene, or of its own table alone."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from radwrap.errors import InputError
from radwrap.reading import FileKind, read_toml
from radwrap.scene.file.convert import target_from_table
from radwrap.scene.file.document import TargetFileModel
from radwrap.scene.file.faults import validated
from radwrap.scene.file.keys import set_all
from radwrap.scene.file.load import scene_from_document
from radwrap.scene.patterns.layouts import CircleGrid, Layout
from radwrap.scene.targets import DotBoard, PatternTarget, Target

_TARGET_FILE: Final = FileKind(
    "target file", 16 << 20, "give a scene, or a file with a target's table: type, rows, columns, ..."
)
# What a target is made of plays no part where only its geometry counts.
_ANY_MATERIAL: Final = {"material": "plate", "pattern_material": "pattern"}
_ANY_BOARD: Final = {"material": "plate", "dot_material": "dots"}
_TYPES: Final = "chessboard, charuco, circles, siemens_star, usaf1951 or board"


def load_target(
    path: str | Path, name: str | None = None, overrides: Mapping[str, Any] | None = None
) -> tuple[str, Layout]:
    """Read a target with a pattern.

    Parameters
    ----------
    path : str or Path
        A scene file, or a TOML file that holds the keys of one target, in which materials may be left out.
    name : str, optional
        Of the target, where the scene has several.
    overrides : Mapping[str, Any], optional
        As of `load_scene`; of a target's own table such as ``{"rows": 5}``.

    Returns
    -------
    str
        The target's name.
    Layout
        What is where on it; a board of dots is a symmetric grid of discs.

    Raises
    ------
    InputError
        As `load_scene`, or if the file has no such target, or several and no name chooses one.
    """
    path = Path(path)
    document = read_toml(path, _TARGET_FILE)
    if "camera" in document:
        targets = scene_from_document(document, overrides, origin=path.name, folder=path.parent).targets
    else:
        for key, value in (overrides or {}).items():
            document = set_all(document, key, value, path.name)
        targets = (_alone(document, path.name),)
    found = {target.name: layout for target in targets if (layout := layout_of(target)) is not None}
    if name is not None:
        found = {key: layout for key, layout in found.items() if key == name}
    if len(found) == 1:
        ((name, layout),) = found.items()
        return name, layout
    if not found:
        what = "has no target with a pattern" if name is None else f'has no target "{name}" with a pattern'
        raise InputError(what, where=str(path), remedy=f"its type must be {_TYPES}")
    raise InputError(
        f"has several targets with a pattern: {', '.join(found)}",
        where=str(path),
        remedy="choose one, or put it into a file of its own",
    )


def layout_of(target: Target) -> Layout | None:
    """What is where on a target with a pattern; None of others."""
    if isinstance(target, PatternTarget):
        return target.layout
    if isinstance(target, DotBoard):
        return CircleGrid(target.rows, target.columns, target.pitch, target.dot_diameter, target.margin, False)
    return None


def _alone(document: dict[str, Any], origin: str) -> Target:
    given = (_ANY_BOARD if document.get("type") == "board" else _ANY_MATERIAL) | document
    remedy = "" if "type" in document else f"its type must be {_TYPES}"
    try:
        table = validated(TargetFileModel, {"target": given}, origin, remedy).target
        return target_from_table(table, table.name or "target", f"{origin}: target", Path())
    except InputError as error:
        raise InputError(
            error.what, where=(error.where or origin).replace(" target.", " ", 1), remedy=error.remedy
        ) from error
