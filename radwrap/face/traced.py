"""What was traced, and images for any turn of its knobs."""

from __future__ import annotations

import json
import math
import threading
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap import images, written
from radwrap.errors import InputError
from radwrap.face.coarse import Coarse
from radwrap.face.layout import seen_at
from radwrap.face.recipe import Recipe, lines
from radwrap.imaging.forecast.effects import Effect
from radwrap.imaging.other_camera import SceneText, basis_in_other_camera, growth_of
from radwrap.imaging.output.run_manifest import RunManifest, read_run_manifest
from radwrap.imaging.page.described import described, told_left_out, told_of, told_thresholds
from radwrap.imaging.page.thresholds import Thresholds, thresholds
from radwrap.imaging.page.turn import Turn, changes_of
from radwrap.imaging.relight.relit import Relighter, Relit, read_basis
from radwrap.imaging.relight.relit_uncertainty import relit_squares
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.run_files import BasisFile
from radwrap.imaging.tolerance.uncertainty import combined
from radwrap.scene.catalog.places import SCENE
from radwrap.scene.scene import Scene

Array = NDArray[np.float64]
_LARGEST_LEFT: Final = 127  # of 8 bits
_AT_ONCE: Final = 1 << 18  # pixels: all of 5 megapixels would take 120 MiB more
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
        """Mean of L cos^4(theta) in the light of a source alone [W m^-2 sr^-1], in eight bits more than float32 has.

        Rounded to float32, planes made up to 1.6e-4 of the pixels of a picture of 16 bits differ by a code.

        Returns
        -------
        ndarray of float32
            The unit of what is left; each pixel's mean; what is left, four pixels' whole numbers of 8 bits in each.
        """
        mean: Array = self.relighter.basis.images[number].mean(axis=0, dtype=np.float64).ravel()
        high = mean.astype(np.float32)
        unit = np.float32(np.spacing(np.abs(high).max()) / (2 * _LARGEST_LEFT)) or np.float32(1.0)  # in the dark
        left = np.zeros(4 * -(-mean.size // 4), dtype=np.int8)
        for start in range(0, mean.size, _AT_ONCE):
            part = slice(start, min(start + _AT_ONCE, mean.size))
            wanted = np.rint((mean[part] - high[part]) / float(unit))
            left[part] = np.clip(wanted, -_LARGEST_LEFT, _LARGEST_LEFT)
        return np.concatenate([[unit], high, left.view(np.float32)], dtype=np.float32)

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


def get_ready() -> None:
    """Build and load what `read_traced` needs, while what it is to read is still traced: .08 s of the first picture."""
    written.get_ready(BasisFile, RunManifest)
    images.get_ready()


def read_traced(number: int, scene: Scene, folder: Path, **more: Any) -> Traced:
    """What was traced into a folder; `more` is of `Traced`.

    Raises
    ------
    InputError
        If there is no whole basis.
    """
    relighter = Relighter(read_basis(folder))
    return Traced(number, scene, folder, read_run_manifest(folder), relighter, **more)


def _named_files(scene: Scene) -> str | None:
    """Where files lie that the scene's camera names, if it names any."""
    camera = json.loads(scene.document)["camera"]
    named = "calibration" in camera or "data_sheet" in camera.get("sensor", {})
    named = named or any(one.key.startswith("camera.") and one.component.place == SCENE for one in scene.components)
    return str(scene.folder) if named else None
