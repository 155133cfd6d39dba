"""How a picture of the page is made again without it: as a line for a shell, and as one for Python."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from radwrap.imaging.page.turn import Turn, relight_python, relight_words, spelled


@dataclass(frozen=True, slots=True)
class Recipe:
    """How a basis is made from its scene file.

    Attributes
    ----------
    words : tuple of str
        Of the command, without its folder.
    scene : str
        The scene's file.
    overrides : Mapping
        Keys that the command changes -> values.
    options : Mapping
        Of `radwrap.render`, as far as they are not usual.
    turned : Mapping
        Keys that the page has changed since -> values as the scene file has them.
    """

    words: tuple[str, ...]
    scene: str
    overrides: Mapping[str, Any]
    options: Mapping[str, Any]
    turned: Mapping[str, Any] = field(default_factory=dict)

    def changed(self, changes: Mapping[str, Any]) -> Recipe:
        """With other values of some keys."""
        return replace(self, turned={**self.turned, **changes})

    def command(self, folder: str) -> list[str]:
        """Words of the command that makes the basis in a folder."""
        sets = (f"{key}={json.dumps(value, ensure_ascii=False)}" for key, value in self.turned.items())
        return [*self.words, *(word for text in sets for word in ("--set", text)), "--out", folder]

    def python(self, folder: str) -> str:
        """The expression that does the same."""
        options = "".join(f", {name}={value!r}" for name, value in self.options.items())
        changes = {**self.overrides, **self.turned}
        scene = f"radwrap.load_scene({self.scene!r}{f', {changes!r}' if changes else ''})"
        return f"radwrap.render({scene}, {folder!r}, basis=True{options})"


def lines(
    recipe: Recipe | None,
    folder: str,
    sources: Sequence[str],
    turn: Turn,
    changes: Mapping[str, Any],
    *,
    scene_folder: str | None,
) -> tuple[str, str]:
    """The line of the shell and that of Python which make gray.png of a turn.

    Parameters
    ----------
    recipe : Recipe or None
        Of the basis; None where its folder is there.
    folder : str
        Of the basis.
    sources, turn, changes
        As of `relight_words`.
    scene_folder : str or None
        Where files lie that the scene's camera names.
    """
    where = [] if scene_folder is None or not changes else ["--scene-folder", scene_folder]
    made = () if recipe is None else recipe.command(folder)
    shell = spelled(made, [*relight_words(folder, "turned", sources, turn, changes), *where])
    place = scene_folder if where else None
    steps = ["import radwrap", *([] if recipe is None else [recipe.python(folder)])]
    return shell, "; ".join([*steps, relight_python(folder, "turned.png", sources, turn, changes, scene_folder=place)])
