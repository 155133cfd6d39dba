"""Fourier transforms of large images, in place: numpy's own take each array anew, which takes as long as they do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


def fast_length(size: int) -> int:
    """Smallest number from `size` on that has no prime factor above 5: transforms of others are slow."""
    while True:
        rest = size
        for factor in (2, 3, 5):
            while rest % factor == 0:
                rest //= factor
        if rest == 1:
            return size
        size += 1


def spectrum_of(values: Array, shape: Sequence[int]) -> Complex:
    """Transform of an image, with zeros beside it up to a shape, as `numpy.fft.rfft2` has it."""
    rows, (height, width) = values.shape[-2], shape
    found = np.empty((*values.shape[:-2], height, width // 2 + 1), dtype=np.complex128)
    np.fft.rfft(values, width, axis=-1, out=found[..., :rows, :])
    found[..., rows:, :] = 0.0
    return np.asarray(np.fft.fft(found, axis=-2, out=found))


def correlated(spectra: Sequence[Complex], weights: Sequence[Complex], shape: Sequence[int]) -> Array:
    """Sum of images, each gathered by weights: by the images' transforms and the conjugate ones of the weights."""
    total = spectra[0] * weights[0]
    for spectrum, weight in zip(spectra[1:], weights[1:], strict=True):
        total += spectrum * weight
    np.fft.ifft(total, axis=-2, out=total)
    return np.asarray(np.fft.irfft(total, shape[1], axis=-1))
