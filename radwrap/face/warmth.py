"""What the renderer keeps between renders: the scene laid out once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import fields
from importlib import import_module
from pathlib import Path
from typing import Any

from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.warm import WarmScene
from radwrap.progress import Progressed


def load_tracer() -> None:
    """Load what the compiled tracer needs, and most scenes are traced by, before a scene is there."""
    with suppress(ImportError):  # a render says what it lacks
        import_module("radwrap.tracers.compiled.engine")
        warm = import_module("radwrap.tracers.compiled.warm")
        if warm.is_warm():  # then it compiles nothing, but takes machine code from where it is kept
            warm.warm_up()


class Warmth:
    """A warm scene that is laid out when the first render needs it."""

    def __init__(self) -> None:
        self._scene: WarmScene | None = None

    def __enter__(self) -> Warmth:
        return self

    def __exit__(self, *_: object) -> None:
        if self._scene is not None:
            self._scene.close()

    def render(
        self,
        request: Mapping[str, Any],
        cancelled: Callable[[], bool],
        told: Callable[[Progressed], object],
        lies: Callable[[Path], object],
    ) -> None:
        """Render a request, see `Renderer.render`, with its basis, into the folder that it names.

        `lies` is told where the warm scene is.
        """
        scene = request["scene"]
        options = RenderOptions(**{**request["options"], "basis": True})
        if self._scene is None:
            self._scene = WarmScene(scene, options)
            if self._scene.folder is not None:
                lies(self._scene.folder)
        # All of them: what the scene was laid out with may have been those of a coarse picture.
        changes = {one.name: getattr(options, one.name) for one in fields(options) if one.name != "progress"}
        out = Path(request["out"])
        self._scene.leave(scene, out, brief=request["brief"], cancelled=cancelled, progress=told, **changes)
