"""Predicted images of the paper's scenes, kept on the disk, and what the figures read from them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import radwrap
from radwrap.errors import InputError
from radwrap.imaging.response.sensor import gray_levels
from radwrap.measure.dots import METHODS
from radwrap.study.image_error import blur_radii, error_fields, image_error
from radwrap.study.responses import Response, answer
from radwrap.study.seen import Answer, Seen
from replication.published import ROOT

# 60 x 52 pixels for the same field of view: for --quick alone.
COARSE: Final[Mapping[str, Any]] = {
    "camera.sensor.rows": 52,
    "camera.sensor.columns": 60,
    "camera.sensor.pixel_width": "44 um",
    "camera.sensor.pixel_height": "50.77 um",
}
FEW_DRAWS: Final = {"draws": 4}  # of error bars, for --quick alone
TOLERANCE: Final = 0.3  # gray levels rms
SEED: Final = 1


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """A predicted image.

    Attributes
    ----------
    scene : Scene
    result : Rendered
    gray : ndarray, shape (rows, columns)
        Gray levels before rounding.
    bound : float
        Certified 95 % bound of their rms error [gray].
    """

    scene: radwrap.Scene
    result: radwrap.Rendered
    gray: NDArray[np.float64]
    bound: float

    @property
    def above_dark(self) -> NDArray[np.float64]:
        """Gray levels above the dark one."""
        found: NDArray[np.float64] = self.gray - self.scene.camera.sensor.dark_gray
        return found

    @property
    def axis_row(self) -> int:
        """Row nearest to the camera's axis."""
        return round(self.scene.camera.principal_point[1])


def predicted(
    scene: str, name: str, out: Path, *, quick: bool, changes: Mapping[str, Any] | None = None, **options: Any
) -> Image:
    """Render a scene of rad_scenes, or take the finished image from an earlier run."""
    keys = {**(changes or {}), **(COARSE if quick else {})}
    loaded = radwrap.load_scene(ROOT / "rad_scenes" / scene / "scene.toml", keys)
    how = {"seed": SEED, **({} if "method" in options else {"tolerance": TOLERANCE}), **options}
    result = radwrap.render(loaded, out / "renders" / name, **how)
    gray = gray_levels(result.radiant_exposure.values, loaded.camera.sensor)
    return Image(loaded, result, gray, result.run.error.rms_gray_upper95)


def focal_lengths(image: Image, *, quick: bool) -> dict[str, Answer]:
    """F by every centre method that works, and its error by the image's certificate [m]; the dots are sought once."""
    seen, found = _seen(image), {}
    for method in METHODS:
        options = {"method": method, **(FEW_DRAWS if quick else {})}
        try:
            found[method] = answer(Response("f", "focal_length", "mm", options), seen)
        except InputError:
            continue
    return found


def _seen(image: Image) -> Seen:
    radii = blur_radii(image.scene)
    error = image_error(image.gray, image.bound, radii)
    return Seen(image.scene, image.result.gray, image.gray, error, error_fields(image.gray.shape, radii, 0))


@dataclass(frozen=True, slots=True)
class Measured:
    """A number with its error."""

    value: float
    error: float

    def over(self, other: Measured) -> Measured:
        """The ratio."""
        if other.value == 0:
            return Measured(math.nan, math.nan)
        ratio = self.value / other.value
        shares = [one.error / one.value if one.value else 0.0 for one in (self, other)]
        return Measured(ratio, abs(ratio) * math.hypot(*shares))


def peak(image: Image) -> Measured:
    """Largest gray above dark."""
    return Measured(float(image.above_dark.max()), image.bound)


def lit_area(image: Image, share: float = 0.1) -> Measured:
    """Number of pixels above a share of the peak above dark."""
    limit = share * float(image.above_dark.max())
    low, area, high = (float((image.above_dark > limit + shift).sum()) for shift in (image.bound, 0.0, -image.bound))
    return Measured(area, (high - low) / 2)


def largest_step(image: Image) -> Measured:
    """Largest difference of neighbours in the row through the axis, over the peak above dark."""
    row = image.above_dark[image.axis_row]
    step = Measured(float(np.abs(np.diff(row)).max()), math.sqrt(2) * image.bound)
    return step.over(peak(image))


def middle_share(image: Image) -> Measured:
    """Share of pixels between 25 and 75 % of the peak above dark."""
    top = float(image.above_dark.max())

    def share(shift: float) -> float:
        return float(((image.above_dark > 0.25 * top + shift) & (image.above_dark < 0.75 * top + shift)).mean())

    return Measured(share(0.0), max(abs(share(sign * image.bound) - share(0.0)) for sign in (-1, 1)))
