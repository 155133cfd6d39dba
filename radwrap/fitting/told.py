"""What a fit found, as values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radwrap.fitting.suspects import Suspect
from radwrap.fitting.verdict import Test, Verdict
from radwrap.images import GrayImage
from radwrap.manifest import finite
from radwrap.scene.scene import Scene

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class FittedKey:
    """A key and what was found for it.

    Attributes
    ----------
    key, unit : str
        Of the scene file.
    begin, value : float
        Where the fit began, and what it found, in `unit`.
    sigma : float or None
        Standard uncertainty by noise, rounding and the prediction; None where the captures do not determine the key.
    interval : tuple of float or None
        95 %; likewise.
    sigma_noise, sigma_prediction : float or None
        What of it is by noise and rounding, and what by the prediction's rays.
    at_bound : bool
        Whether the value lies at a bound, where no interval is worth much.
    """

    key: str
    unit: str
    begin: float
    value: float
    sigma: float | None
    interval: tuple[float, float] | None
    sigma_noise: float | None
    sigma_prediction: float | None
    at_bound: bool

    def told(self) -> str:
        """In words."""
        unit = f" {self.unit}" if self.unit else ""
        if self.sigma is None or self.interval is None:
            return f"{self.key} = {self.value:.6g}{unit} (not determined by the captures)"
        low, high = self.interval
        bound = "; at its bound" if self.at_bound else ""
        return f"{self.key} = {self.value:.6g}{unit} +- {self.sigma:.2g} (95 %: {low:.6g} to {high:.6g}{bound})"


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A scene fitted to captures.

    Attributes
    ----------
    scene : Scene
        With the values that were found.
    keys : tuple of FittedKey
        In the order in which they were asked for.
    covariance, correlation : ndarray, shape (keys, keys)
        Covariance in the keys' units; NaN where a key is not determined.
    undetermined : tuple of str
        Directions that the captures do not determine, in words.
    verdict : Verdict
        Whether the scene explains the captures.
    looks_like : tuple of Suspect
        What captures that are not explained look like, what explains most first.
    converged : bool
        Whether the fit stands.
    residual : ndarray, shape (captures * rows, columns)
        (captured - predicted)/expected deviation; NaN where a pixel is masked or censored. States of the bench stand
        one below the other; repeats are one.
    sigma : ndarray, shape (captures * rows, columns)
        That deviation [gray level].
    grays : tuple of GrayImage
        Prediction at the values, as the camera gives it, for each state.
    censored : int
        Pixels that say only "at least" or "at most", and agree.
    manifest : Mapping
        What fit.json holds.
    """

    scene: Scene
    keys: tuple[FittedKey, ...]
    covariance: Array
    correlation: Array
    undetermined: tuple[str, ...]
    verdict: Verdict
    looks_like: tuple[Suspect, ...]
    converged: bool
    residual: Array
    sigma: Array
    grays: tuple[GrayImage, ...]
    censored: int
    manifest: Mapping[str, Any]

    @property
    def gray(self) -> GrayImage:
        """That of the first state."""
        return self.grays[0]

    @property
    def explained(self) -> bool:
        """Whether the scene explains the captures within its errors; never where nothing can be judged."""
        return self.verdict.explained

    def lines(self) -> list[str]:
        """The answer in words, a line each."""
        told = [key.told() for key in self.keys]
        told += [f"not determined: {direction}" for direction in self.undetermined]
        if not self.converged:
            return [*told, "The fit did not converge: the values are those of its last step."]
        if not self.verdict.is_judged:
            return [
                *told,
                "Whether the scene explains the captures cannot be judged: as many values were fitted as pixels count. "
                "Free fewer keys, or let more pixels count.",
            ]
        pixels = self.verdict.pixels
        numbers = f"chi-square {pixels.chi_square:.4g} of {pixels.freedom} degrees of freedom"
        if self.explained:
            told.append(f"The scene explains the captures within its errors: yes ({numbers}).")
            if not pixels.by_noise:
                told.append(
                    "Noise by itself does not explain them, only with the error of the prediction: a finer tolerance "
                    "would say more."
                )
            return told
        told.append(f"The scene explains the captures within its errors: no ({numbers}). Most is left here:")
        told += [f"  {block.told()}" for block in self.verdict.worst]
        return [*told, *(f"It looks as if {one.told()}." for one in self.looks_like)]


def as_manifest(
    fit_keys: tuple[FittedKey, ...], verdict: Verdict, covariance: Array, correlation: Array
) -> dict[str, Any]:
    """What fit.json tells of values and verdict."""
    return {
        "keys": [
            {
                "key": key.key,
                "unit": key.unit,
                "begin": key.begin,
                "value": key.value,
                "sigma": key.sigma,
                "interval_95": key.interval,
                "sigma_noise": key.sigma_noise,
                "sigma_prediction": key.sigma_prediction,
                "at_bound": key.at_bound,
            }
            for key in fit_keys
        ],
        "covariance": _matrix(covariance),
        "correlation": _matrix(correlation),
        "explained": verdict.explained if verdict.is_judged else None,
        "pixels": _test(verdict.pixels),
        "blocks": None if verdict.blocks is None else _test(verdict.blocks),
        "worst_blocks": [
            {
                "rows": block.rows,
                "columns": block.columns,
                "mean_gray": block.mean_gray,
                "deviations": block.deviations,
                "pixels": block.pixels,
                **({} if block.capture is None else {"capture": block.capture}),
            }
            for block in verdict.worst
        ],
    }


def _matrix(values: Array) -> list[list[float | None]]:
    return [[finite(float(value)) for value in row] for row in values]


def _test(test: Test) -> dict[str, Any]:
    return {
        "chi_square": test.chi_square,
        "degrees_of_freedom": test.freedom,
        "by_prediction": test.prediction,
        "largest_explained": finite(test.largest),
        "passed": test.passed if test.is_judged else None,
    }
