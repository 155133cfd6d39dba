"""What the page's server knows: the scene as it was traced last, and images for any turn of its knobs.

Nothing here is a tab's own: each request tells the whole turn. So tabs do not disturb each other, and a tab that was
lost loses nothing. A basis has a number; a request for another one than the present is refused.
"""

from __future__ import annotations

import json
import math
import shutil
import threading
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import Cancelled, InputError, RadwrapError
from radwrap.face.coarse import Coarse, coarse_of
from radwrap.face.layout import seen_at
from radwrap.face.ray_knobs import ray_changes, ray_knobs
from radwrap.face.recipe import Recipe, lines
from radwrap.face.renderer import Renderer
from radwrap.imaging.forecast.effects import Effect
from radwrap.imaging.other_camera import SceneText, basis_in_other_camera, growth_of
from radwrap.imaging.output.run_manifest import MANIFEST, RunManifest, read_run_manifest
from radwrap.imaging.page.described import described, told_left_out, told_of, told_thresholds
from radwrap.imaging.page.thresholds import Thresholds, thresholds
from radwrap.imaging.page.turn import Turn, changes_of
from radwrap.imaging.relight.relit import Relighter, Relit, read_basis
from radwrap.imaging.relight.relit_uncertainty import relit_squares
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.tolerance.uncertainty import combined
from radwrap.scene.catalog.places import SCENE
from radwrap.scene.file.load import with_changes
from radwrap.scene.file.turned import with_levels
from radwrap.scene.scene import Scene

Array = NDArray[np.float64]
_KEPT: Final = 2  # images: that of a tab, and that of another or the one before


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """One turn of the knobs, with all that is known of it.

    Attributes
    ----------
    relit : Relit
        The image and its certificate.
    squares : Mapping[str, ndarray]
        What each cause adds, see `relit_squares`.
    sigma : ndarray, shape (rows, columns)
        Of all causes [gray level].
    relighter : Relighter
        Of its camera.
    changes : Mapping
        Keys of the scene file that are turned.
    thresholds : Thresholds
        Of its sensor.
    """

    relit: Relit
    squares: Mapping[str, Array]
    sigma: Array
    relighter: Relighter
    changes: Mapping[str, Any]
    thresholds: Thresholds


@dataclass(slots=True)
class Traced:
    """A basis that was traced, and the images that were asked for last.

    Attributes
    ----------
    number : int
        Of the basis in this session.
    scene : Scene
        Whose levels are all 1.
    folder : Path
        Of the basis.
    run : RunManifest
        Of its render.
    relighter : Relighter
        Of the scene's own camera.
    recipe : Recipe or None
        How the basis is made again; None where the folder stays.
    place : str
        What a recipe calls its folder.
    coarse : Coarse or None
        How it was traced where it stands for another that is not there yet.
    replaces : int
        Number of the basis whose knobs go on in this one: a coarse one that stood for it, or that of which rays have
        changed; 0 where there was none.
    ray_knobs : Mapping
        See `ray_knobs`; of the scene without larger pixels.
    ray_knobs_of_file : Mapping
        Those of the scene as it was opened.
    """

    number: int
    scene: Scene
    folder: Path
    run: RunManifest
    relighter: Relighter
    recipe: Recipe | None = None
    place: str = ""
    coarse: Coarse | None = None
    replaces: int = 0
    ray_knobs: Mapping[str, str] = field(default_factory=dict)
    ray_knobs_of_file: Mapping[str, str] = field(default_factory=dict)
    _images: OrderedDict[Turn, Image] = field(default_factory=OrderedDict)
    _one: threading.Lock = field(default_factory=threading.Lock)

    @property
    def sources(self) -> tuple[str, ...]:
        """Names of the sources."""
        return self.relighter.basis.sources

    def image(self, turn: Turn) -> Image:
        """The image of a turn; one is made at a time.

        Raises
        ------
        InputError
            If a value is wrong, or the image overflows.
        """
        with self._one:
            if turn in self._images:
                self._images.move_to_end(turn)
                return self._images[turn]
            made = self._made(turn)
            self._images[turn] = made
            while len(self._images) > _KEPT:
                self._images.popitem(last=False)
            return made

    def _made(self, turn: Turn) -> Image:
        basis = self.relighter.basis
        changes = changes_of(turn, self.scene.camera)
        turned = basis_in_other_camera(basis, SceneText.of(self.scene), changes)
        relighter = self.relighter if turned is basis else self.relighter.in_camera(turned)
        factors = np.array(turn.factors)
        relit = relighter.image(factors)
        squares = relit_squares(turned, factors, relit)
        return Image(relit, squares, combined(squares).sigma, relighter, changes, thresholds(turned.sensor))

    def plane(self, number: int) -> NDArray[np.float32]:
        """Mean of L cos^4(theta) in the light of a source alone, shape (rows, columns) [W m^-2 sr^-1]."""
        mean: Array = self.relighter.basis.images[number].mean(axis=0, dtype=np.float64)
        return mean.astype(np.float32)

    def described(self) -> dict[str, Any]:
        """What a page shows of it."""
        block = 0 if self.coarse is None else self.coarse.block
        told = described(self.scene, self.relighter.basis, self.run)
        rays = {"ray_knobs": self.ray_knobs, "ray_knobs_of_file": self.ray_knobs_of_file}
        return {"basis": self.number, "coarse": block, "replaces": self.replaces, **told, **rays}

    def told(self, turn: Turn, image: Image) -> dict[str, Any]:
        """What a page shows of an image."""
        command, python = self.lines(turn, image)
        return {
            "basis": self.number,
            **told_of(image.relit, image.relighter.basis, image.sigma),
            "thresholds": told_thresholds(image.thresholds),
            "left_out": None if (effects := self.left_out(turn, image)) is None else told_left_out(effects),
            "command": command,
            "python": python,
        }

    def left_out(self, turn: Turn, image: Image) -> list[Effect] | None:
        """What is left out of a turn's image, without a ray: it grows as gray levels do if all light has one factor.

        Returns
        -------
        list of Effect or None
            None where it is not known: with levels that differ, another gamma, and where what was saturated is so no
            longer.
        """
        effects = list(self.run.left_out.values())
        if not any(effect.rms_gray_upper95 or effect.rays for effect in effects):
            return effects  # the scene alone says that there are none, in any light
        level, *others = turn.factors
        if any(other != level for other in others):
            return None
        basis, turned = self.relighter.basis, image.relighter.basis
        times = level * turned.exposure_of_radiance / basis.exposure_of_radiance
        if times == 0.0:
            return [effect.grown(0.0, self.run.tolerance) for effect in effects]
        before = image.relit.radiant_exposure.values / times
        growth = growth_of(basis.sensor, turned.sensor, times, before, self.run.error.rms_gray_upper95)
        return [effect.grown(growth, self.run.tolerance) for effect in effects] if math.isfinite(growth) else None

    def lines(self, turn: Turn, image: Image) -> tuple[str, str]:
        """The lines of a shell and of Python that make the same gray.png; empty for a coarse picture."""
        if self.coarse is not None:  # nobody wants it twice
            return "", ""
        folder = str(self.folder) if self.recipe is None else self.place
        return lines(self.recipe, folder, self.sources, turn, image.changes, scene_folder=_named_files(self.scene))

    def pixel(self, image: Image, column: int, row: int) -> dict[str, Any]:
        """What is known of one pixel."""
        shape = image.sigma.shape
        if not (0 <= row < shape[0] and 0 <= column < shape[1]):
            raise InputError(f"lies outside {shape[1]} x {shape[0]} pixels", where=f"pixel ({column}, {row})")
        exposure = float(image.relit.radiant_exposure.values[row, column])
        basis = image.relighter.basis
        level = float(gray_levels(np.array([exposure]), basis.sensor)[0])
        return {
            "code": int(image.relit.gray.codes[row, column]),
            "gray": level,
            "sigma": float(image.sigma[row, column]),
            "radiant_exposure": exposure,
            "parts": {name: math.sqrt(float(square[row, column])) for name, square in image.squares.items()},
            "saturated": level >= basis.sensor.saturation_gray,
            "sees": seen_at(self.scene, column, row),
        }


def _named_files(scene: Scene) -> str | None:
    """Where files lie that the scene's camera names, if it names any."""
    camera = json.loads(scene.document)["camera"]
    named = "calibration" in camera or "data_sheet" in camera.get("sensor", {})
    named = named or any(one.key.startswith("camera.") and one.component.place == SCENE for one in scene.components)
    return str(scene.folder) if named else None


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
    ) -> None:
        self.study = study
        self._options, self._work, self._recipe = dict(options), work, recipe
        self.out = out
        self._scene = scene
        self._ray_knobs_of_file = ray_knobs(scene)
        self._renderer = Renderer(work)
        self._number = 0  # of bases
        self._traces = 0
        self._traced: Traced | None = None
        self._status = Status("stopped")
        self._guard = threading.Lock()
        self._thread: threading.Thread | None = None
        self._measuring = threading.Lock()  # effects

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
        scene = traced.scene
        factors, changes = turn.factors, changes_of(turn, scene.camera)
        if changes or any(factor != 1.0 for factor in factors):
            scene = with_levels(scene, dict(zip(traced.sources, factors, strict=True)), changes)
        with self._guard:
            tracing = self._thread is not None and self._thread.is_alive()
            if tracing or not self._measuring.acquire(blocking=False):
                raise InputError("is under way", where="trace", remedy="wait for its end")
            self._renderer.begin()
        try:
            return self._renderer.effects(self._request(scene, self._options))
        finally:
            self._measuring.release()

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
            if (self._traced is None or anew) and not (folder / MANIFEST).exists():  # a finished one is read at once
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
        """A coarse picture for the time until the asked one is there; what keeps it from being made is told by that.

        Returns
        -------
        int
            Number of the basis that the next one replaces.
        """
        coarse = coarse_of(scene, self._options)
        if coarse is None:
            return replaces
        folder = self._work / f"coarse_{trace}"
        try:
            self._render(coarse.scene, coarse.options, folder)
            found = self._read(coarse.scene, folder, coarse=coarse, replaces=replaces, ray_knobs=ray_knobs(scene))
        except Cancelled:
            raise
        except (RadwrapError, OSError, MemoryError):
            return replaces
        finally:
            self._status = Status("tracing")
        self._show(found)
        self._scene, self._recipe = scene, recipe  # a trace that is stopped now goes on with them
        return found.number

    def _show(self, found: Traced) -> None:
        """A basis takes the place of the one before, whose folder is of no use if it is not for keeping."""
        before, self._traced = self._traced, found
        if before is not None and before.folder.parent == self._work:
            shutil.rmtree(before.folder, ignore_errors=True)

    def _render(self, scene: Scene, options: Mapping[str, Any], folder: Path) -> None:
        request = {**self._request(scene, options), "out": str(folder.absolute())}
        self._renderer.render(request, lambda progress: self._progressed(int(progress["done"]), int(progress["of"])))

    @staticmethod
    def _request(scene: Scene, options: Mapping[str, Any]) -> dict[str, Any]:
        folder = str(scene.folder.absolute())
        return {"document": scene.document, "origin": scene.origin, "folder": folder, "options": dict(options)}

    def _read(self, scene: Scene, folder: Path, **more: Any) -> Traced:
        relighter = Relighter(read_basis(folder))
        self._number += 1
        more = {"ray_knobs": ray_knobs(scene), "ray_knobs_of_file": self._ray_knobs_of_file, **more}
        return Traced(self._number, scene, folder, read_run_manifest(folder), relighter, **more)

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
