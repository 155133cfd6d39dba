"""How long a path tracer takes to an error: t = a + b n, rms = c n^-1/2."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls


@dataclass(frozen=True, slots=True)
class Speed:
    """Time and error against the samples n of a pixel.

    Attributes
    ----------
    start_s, sample_s : float
        a and b of t = a + b n [s].
    noise_gray : float
        c of rms = c n^-1/2 [gray level].
    time_residual, noise_residual : float
        Largest relative difference of what was measured from these.
    """

    start_s: float
    sample_s: float
    noise_gray: float
    time_residual: float
    noise_residual: float

    def samples_to(self, rms_gray: float) -> float:
        """Samples of a pixel until an error, 1 at least."""
        return max(1.0, (self.noise_gray / rms_gray) ** 2)

    def seconds_to(self, rms_gray: float) -> float:
        """Time of the whole process until an error [s]."""
        return self.start_s + self.sample_s * self.samples_to(rms_gray)

    def rms_after(self, seconds: float) -> float | None:
        """Error after a time; None where it is over before the first sample of each pixel is done [gray level]."""
        samples = (seconds - self.start_s) / self.sample_s
        return None if samples < 1 else self.noise_gray / math.sqrt(samples)


def solved(
    samples: Sequence[int], seconds: Sequence[float], rms_gray: Sequence[float], converged_samples: int
) -> Speed:
    """Speed from runs of several lengths.

    Parameters
    ----------
    samples : sequence of int
        n of each run; two at least.
    seconds : sequence of float
        Time of each, and where there is one more, of the converged image [s].
    rms_gray : sequence of float
        Of the difference of each and the converged image [gray level].
    converged_samples : int
        N of the converged image, whose own noise is in each of these: rms^2 = c^2 (1/n + 1/N).

    Raises
    ------
    ValueError
        If longer runs did not take longer.
    """
    counts = [*samples, converged_samples][: len(seconds)]
    # Relative errors are alike in runs of all lengths, so each weighs as 1/t; neither number is below 0.
    lines = np.stack([np.ones(len(counts)), np.asarray(counts, dtype=np.float64)], axis=1)
    (start, slope), _ = nnls(lines / np.asarray(seconds)[:, np.newaxis], np.ones(len(counts)))
    if slope <= 0:
        raise ValueError("longer runs of Mitsuba did not take longer; the machine was too busy to measure on")
    noise = np.asarray(rms_gray) / np.sqrt(1 / np.asarray(samples) + 1 / converged_samples)
    mean = float(np.exp(np.log(noise).mean()))
    line = start + slope * np.asarray(counts)
    return Speed(
        float(start),
        float(slope),
        mean,
        float(np.abs(line / np.asarray(seconds) - 1).max()),
        float(np.abs(noise / mean - 1).max()),
    )
