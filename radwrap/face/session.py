"""What the page's server knows: the scene as it was traced last, and images for any turn of its knobs.

Nothing here is a tab's own: each request tells the whole turn. So tabs do not disturb each other, and a tab that was
lost loses nothing. A basis has a number; a request for another one than the present is refused.
"""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from radwrap.errors import Cancelled, InputError, RadwrapError
from radwrap.face.coarse import stages_of
from radwrap.face.ray_knobs import ray_changes, ray_knobs
from radwrap.face.recipe import Recipe
from radwrap.face.renderer import Renderer
from radwrap.imaging.page.turn import Turn, changes_of
from radwrap.process import Child
from radwrap.scene.file.load import with_changes
from radwrap.scene.file.turned import with_levels
from radwrap.scene.scene import Scene

if TYPE_CHECKING:
    from radwrap.face.traced import Traced


_LOOK: Final = 0.02  # s
# In which a measurement ends whose page has hung up: that is seen, and the renderer obeys or is killed.
_ENDS_WITHIN: Final = 1.0  # s


@dataclass(frozen=True, slots=True)
class Status:
    """How far the session is.

    Attributes
    ----------
    state : str
        "tracing", "ready", "stopped" or "failed".
    done, of : int
        Rays, while it traces.
    error : RadwrapError or None
        Why it failed.
    """

    state: str
    done: int = 0
    of: int = 0
    error: RadwrapError | None = None


class Session:
    """The scene, its basis, and the process that traces.

    Parameters
    ----------
    scene : Scene
        As the command line has it.
    options : Mapping
        Of `RenderOptions`.
    work : Path
        A folder of the server's own.
    out : Path or None
        Where results are saved and the first basis stays; without it nothing stays.
    recipe : Recipe or None
        How the first basis is made without the page; None where that is not told.
    study : Mapping or None
        Results of a study, see `study_told`.
    ahead : Child, optional
        See `Renderer`.
    quick : Path, optional
        Another folder of the server's own, for coarse pictures: it may lie in memory, as these are small and not kept.
    """

    def __init__(
        self,
        scene: Scene,
        options: Mapping[str, Any],
        *,
        work: Path,
        out: Path | None,
        recipe: Recipe | None,
        study: Mapping[str, Any] | None = None,
        ahead: Child | None = None,
        quick: Path | None = None,
    ) -> None:
        self.study = study
        self._options, self._work, self._recipe = dict(options), work, recipe
        self._quick = quick or work
        self.out = out
        self._scene = scene
        self._ray_knobs_of_file = ray_knobs(scene)
        self._renderer = Renderer(work, ahead, more=() if quick is None else (quick,))
        self._number = 0  # of bases
        self._traces = 0
        self._traced: Traced | None = None
        self._status = Status("stopped")
        self._guard = threading.Lock()
        self._thread: threading.Thread | None = None
        self._measuring = threading.Lock()  # effects and trade
        self._measured_for: object = None

    @property
    def work(self) -> Path:
        """A folder of the server's own."""
        return self._work

    @property
    def status(self) -> Status:
        """How far it is."""
        return self._status

    @property
    def renderer_pid(self) -> int | None:
        """Of the process that traces."""
        return self._renderer.pid

    @property
    def present(self) -> Traced | None:
        """The present basis, if there is one."""
        return self._traced

    def traced(self, number: int | None = None) -> Traced:
        """The present basis.

        Raises
        ------
        InputError
            If there is none yet, or its number is not the one that is asked for.
        """
        found = self._traced
        if found is None or (number is not None and number != found.number):
            raise InputError("was traced again, or is not traced yet", where="basis", remedy="load the page again")
        return found

    def finished(self, number: int | None = None) -> Traced:
        """As `traced`, of a picture that has the asked tolerance; what a coarse one shows is not for keeping."""
        found = self.traced(number)
        if found.coarse is not None:
            what = "the picture is a coarse one, until the asked tolerance is reached"
            raise InputError(what, where="picture", remedy="wait for the trace's end, or trace again")
        return found

    def trace(self, turn: Turn | None = None) -> None:
        """Begin to trace: the scene, or that of the present basis with its knobs turned; not while one is traced.

        Its knobs then are at 1.

        Raises
        ------
        InputError
            If a trace is under way, or a scene file cannot tell such levels.
        """
        with self._guard:
            if self._thread is not None and self._thread.is_alive():
                raise InputError("is under way", where="trace", remedy="stop it first")
            scene, recipe = self._scene, self._recipe
            if turn is not None:
                present = self.finished()
                changes = changes_of(turn, present.scene.camera)
                scene = with_levels(present.scene, dict(zip(present.sources, turn.factors, strict=True)), changes)
                recipe = None
            self._begin(scene, recipe)

    def trace_with(self, told: Any) -> None:
        """Begin to trace the scene with other values of knobs that need rays; what is traced is stopped before.

        Raises
        ------
        InputError
            As `ray_changes` and `load_scene`; what is traced then goes on.
        """
        with self._guard:
            with_changes(self._scene, ray_changes(told, self._scene))
            if self._thread is not None:
                self._renderer.stop()
                self._thread.join()
            changes = ray_changes(told, self._scene)  # the trace may have come to its end
            if not changes and self._traced is not None and self._traced.coarse is None:
                self._status = Status("ready")
                return
            recipe = None if self._recipe is None else self._recipe.changed(changes)
            self._begin(with_changes(self._scene, changes), recipe, anew=True)

    def _begin(self, scene: Scene, recipe: Recipe | None, *, anew: bool = False) -> None:
        self._traces += 1
        self._end_measuring()
        self._renderer.begin()
        self._status = Status("tracing")
        self._thread = threading.Thread(target=self._carry_out, args=(scene, recipe, self._traces, anew), daemon=True)
        self._thread.start()

    def effects(self, traced: Traced, turn: Turn) -> Mapping[str, Any]:
        """What effects are worth in the light of a turn, measured by rays of their own; a trace that begins ends it.

        Raises
        ------
        InputError
            If a trace or another such measurement is under way, or a scene file cannot tell such levels.
        RadwrapError
            What measuring raised; `Cancelled` where a trace has begun.
        """
        return self._beside(traced, turn, self._renderer.effects)

    def trade(
        self,
        traced: Traced,
        turn: Turn,
        longest: float,
        told: Callable[[Mapping[str, Any]], object],
        unwanted: Callable[[], bool] = lambda: False,
    ) -> Mapping[str, Any]:
        """What accuracy costs in the light of a turn, see `measured_trade`; a trace that begins ends it.

        Parameters
        ----------
        traced : Traced
            The basis.
        turn : Turn
            Of its knobs.
        longest : float
            A setting that is expected to take longer is left out [s].
        told : callable
            Is told how far it is.
        unwanted : callable
            Whether it is to end before it begins: `end_trade` ends what has begun.

        Raises
        ------
        InputError, RadwrapError
            As `effects`.
        """
        more = {
            "longest": longest,
            "out": str(((self.out or self._work) / "trade").absolute()),
            "keeps": bool(self.out),
        }
        return self._beside(
            traced, turn, lambda request: self._renderer.trade({**request, **more}, told), told, unwanted
        )

    def end_trade(self, told: Callable[[Mapping[str, Any]], object]) -> None:
        """End the trade that tells this one how far it is, if it goes on: nobody waits for it any more."""
        with self._guard:
            if self._measured_for is told:
                self._renderer.stop()

    def _beside(
        self,
        traced: Traced,
        turn: Turn,
        measure: Callable[[Mapping[str, Any]], Mapping[str, Any]],
        who: object = None,
        unwanted: Callable[[], bool] = lambda: False,
    ) -> Mapping[str, Any]:
        """Measure by rays in the light of a turn, by the process that traces, which must be idle."""
        scene = traced.scene
        factors, changes = turn.factors, changes_of(turn, scene.camera)
        if changes or any(factor != 1.0 for factor in factors):
            scene = with_levels(scene, dict(zip(traced.sources, factors, strict=True)), changes)
        end = time.monotonic() + _ENDS_WITHIN
        while not self._begun_beside(who, unwanted, patient=time.monotonic() < end):
            time.sleep(_LOOK)
        try:
            return measure(self._request(scene, self._options))
        finally:
            self._measured_for = None
            self._measuring.release()

    def _begun_beside(self, who: object, unwanted: Callable[[], bool], *, patient: bool) -> bool:
        """Whether what is measured has the renderer to itself now; if not, there is a reason to wait a little."""
        with self._guard:
            if unwanted():
                raise Cancelled("was stopped", where="renderer")
            tracing = self._thread is not None and self._thread.is_alive()
            free = not tracing and self._measuring.acquire(blocking=False)
            if free:
                self._renderer.begin()
                self._measured_for = who
            elif tracing or not patient:
                what = "trace" if tracing else "measurement"
                raise InputError("is under way", where=what, remedy="wait for its end")
            return free

    def _end_measuring(self) -> None:
        """Effects that are measured hold the process that traces: they are given up for a trace."""
        if not self._measuring.acquire(blocking=False):
            self._renderer.stop()
            self._measuring.acquire()
        self._measuring.release()

    def stop(self) -> None:
        """Stop tracing."""
        self._renderer.stop()

    def _carry_out(self, scene: Scene, recipe: Recipe | None, trace: int, anew: bool) -> None:
        name = "basis" if trace == 1 else f"basis_{trace}"
        folder = (self.out or self._work) / name
        try:
            stood = self._traced.number if self._traced is not None and (anew or self._traced.coarse) else 0
            if (self._traced is None or anew) and not _is_finished(folder):  # such a one is read at once
                stood = self._show_coarse(scene, recipe, trace, stood)
            self._render(scene, self._options, folder)
            place = str(folder) if self.out else name
            self._show(self._read(scene, folder, recipe=recipe, place=place, replaces=stood))
            self._scene, self._recipe = scene, recipe
            self._status = Status("ready")
        except Cancelled:
            self._status = Status("stopped")
        except RadwrapError as error:
            self._status = Status("failed", error=error)
        except (OSError, MemoryError) as error:
            told = InputError(getattr(error, "strerror", None) or "not enough memory", where=str(folder))
            self._status = Status("failed", error=told)

    def _show_coarse(self, scene: Scene, recipe: Recipe | None, trace: int, replaces: int) -> int:
        """Coarse pictures for the time until the asked one is there; what keeps one from being made is told by that.

        Returns
        -------
        int
            Number of the basis that the next one replaces.
        """
        for number, coarse in enumerate(stages_of(scene, self._options)):
            folder = self._quick / f"coarse_{trace}_{number}"
            try:
                self._render(coarse.scene, coarse.options, folder, brief=True)
                found = self._read(coarse.scene, folder, coarse=coarse, replaces=replaces, ray_knobs=ray_knobs(scene))
            except Cancelled:
                raise
            except (RadwrapError, OSError, MemoryError):
                return replaces
            finally:
                self._status = Status("tracing")
            self._show(found)
            self._scene, self._recipe = scene, recipe  # a trace that is stopped now goes on with them
            replaces = found.number
        return replaces

    def _show(self, found: Traced) -> None:
        """A basis takes the place of the one before, whose folder is of no use if it is not for keeping."""
        before, self._traced = self._traced, found
        if before is not None and before.folder.parent in (self._work, self._quick):
            shutil.rmtree(before.folder, ignore_errors=True)

    def _render(self, scene: Scene, options: Mapping[str, Any], folder: Path, *, brief: bool = False) -> None:
        request = {**self._request(scene, options), "out": str(folder.absolute()), "brief": brief}
        self._renderer.render(request, lambda progress: self._progressed(int(progress["done"]), int(progress["of"])))

    @staticmethod
    def _request(scene: Scene, options: Mapping[str, Any]) -> dict[str, Any]:
        # The renderer works in another folder; names of files are told against the scene's.
        return {"scene": replace(scene, folder=scene.folder.absolute()), "options": dict(options)}

    def _read(self, scene: Scene, folder: Path, **more: Any) -> Traced:
        from radwrap.face.traced import read_traced  # loaded while the first picture is traced

        more = {"ray_knobs": ray_knobs(scene), "ray_knobs_of_file": self._ray_knobs_of_file, **more}
        found = read_traced(self._number + 1, scene, folder, **more)
        self._number += 1
        return found

    def _progressed(self, done: int, of: int) -> None:
        self._status = replace(self._status, done=done, of=of)

    def close(self) -> None:
        """End the process that traces."""
        self._renderer.stop()
        if self._thread is not None:
            self._thread.join(2.0)
        self._renderer.close()
        if self._thread is not None:
            self._thread.join(2.0)


def _is_finished(folder: Path) -> bool:
    """Whether a basis was written whole: there is its manifest."""
    if not folder.exists():
        return False
    from radwrap.imaging.output.run_manifest import MANIFEST

    return (folder / MANIFEST).exists()
