"""A scene that stays laid out between its renders, for whoever turns its knobs."""

from __future__ import annotations

import json
import shutil
import tempfile
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, TypeVar

from radwrap.errors import InputError
from radwrap.files import disk_in_memory
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.rendered import Rendered, load_result
from radwrap.imaging.synthesis import Warmth, rendered
from radwrap.imaging.tracing import LaidOutScene
from radwrap.kept import Kept
from radwrap.process import Programs
from radwrap.progress import Progressed
from radwrap.scene.file.load import scene_from_document
from radwrap.scene.scene import Scene

_T = TypeVar("_T")
# byte; what a warm scene keeps at most: hits of ten million rays.
KEPT_AT_MOST: Final = 256 << 20


class WarmScene:
    """A scene that was laid out, and keeps what its renders have in common; see `warm`.

    What is kept belongs to this object, takes at most `KEPT_AT_MOST` bytes, and is gone with `close`. Each kept value
    is known by all that it hangs on, so that a render gives the bytes that it would give without it.
    """

    def __init__(self, scene: Scene, options: RenderOptions) -> None:
        self._scene, self._options = scene, options
        self._kept = Kept(KEPT_AT_MOST)
        self._one = threading.Lock()
        self._folder: Path | None = Path(tempfile.mkdtemp(prefix="radwrap-", dir=disk_in_memory()))
        try:
            with tempfile.TemporaryDirectory(dir=self._folder) as work, Programs() as programs:
                LaidOutScene(scene, options, programs, Path(work), kept=self._kept)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> WarmScene:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def folder(self) -> Path | None:
        """Where it lies; what a process that was killed left there is for others to remove."""
        return self._folder

    def close(self) -> None:
        """Keep nothing any more; a render that is under way is waited for."""
        with self._one:
            folder, self._folder = self._folder, None
            self._kept.clear()
            if folder is not None:
                shutil.rmtree(folder, ignore_errors=True)

    def render(
        self,
        scene: Scene | Mapping[str, Any] | None = None,
        out: str | Path | None = None,
        *,
        cancelled: Callable[[], bool] | None = None,
        progress: bool | Callable[[Progressed], object] | None = None,
        **changes: Any,
    ) -> Rendered:
        """Predict the gray image of the scene, or of another that has much in common with it.

        One render goes on at a time; another thread that asks for one waits.

        Parameters
        ----------
        scene : Scene or Mapping, optional
            Another scene, or values of keys of the scene file that differ, such as
            ``{"sources[0].radiance": "2500 W/m^2/sr"}``. Default the scene that was laid out.
        out, cancelled, progress
            As in `render`.
        **changes
            Single options that differ from those that the scene was laid out with, such as ``tolerance=0.2``.

        Returns
        -------
        Rendered
            The same bytes as `render` gives, but for the manifest's ``timing``.

        Raises
        ------
        InputError, EnvironmentFailure, Cancelled
            As `render`; the first also after `close`.
        """
        how: dict[str, Any] = {"cancelled": cancelled, "progress": progress, "changes": changes}
        return self._made(self._changed(scene), out, load_result, **how)

    def leave(
        self,
        scene: Scene,
        out: Path,
        *,
        brief: bool,
        cancelled: Callable[[], bool],
        progress: Callable[[Progressed], object],
        **changes: Any,
    ) -> None:
        """As `render`, into a folder that another process reads: here nothing of it is read.

        It may be `brief` where that process is of this radwrap, and wants the basis only: its parts are one file then,
        and there are no pictures, which takes less time.
        """
        how: dict[str, Any] = {"cancelled": cancelled, "progress": progress, "changes": changes}
        self._made(scene, out, lambda _scene, _out: None, brief=brief, **how)

    def _made(
        self,
        scene: Scene,
        out: str | Path | None,
        then: Callable[[Scene, Path], _T],
        *,
        brief: bool = False,
        **how: Any,
    ) -> _T:
        with self._one:
            if self._folder is None:
                raise InputError("is closed", where="warm", remedy="lay the scene out again")
            warmth = Warmth(self._kept, self._folder, brief)
            return rendered(scene, out, self._options, then, warmth=warmth, **how)

    def _changed(self, scene: Scene | Mapping[str, Any] | None) -> Scene:
        if isinstance(scene, Scene):
            return scene
        base = self._scene
        if not scene:
            return base
        return scene_from_document(json.loads(base.document), scene, origin=base.origin, folder=base.folder)


def warm(scene: Scene, options: RenderOptions | None = None) -> WarmScene:
    """Lay a scene out once for many renders; use as ``with radwrap.warm(scene) as live: live.render(...)``.

    Parameters
    ----------
    scene : Scene
        What is there.
    options : RenderOptions, optional
        How it is rendered, where a render does not say otherwise.

    Raises
    ------
    InputError, EnvironmentFailure
        As `render`.

    Examples
    --------
    >>> import radwrap
    >>> with radwrap.warm(radwrap.load_scene("scene.toml")) as live:
    ...     first = live.render(tolerance=8)
    ...     dimmer = live.render({"sources[0].radiance": "1162 W/m^2/sr"}, tolerance=8)
    >>> bool(dimmer.gray.values.mean() < first.gray.values.mean())
    True
    """
    return WarmScene(scene, options or RenderOptions())
