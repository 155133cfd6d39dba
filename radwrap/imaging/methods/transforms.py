"""Fourier transforms of large images, in place: numpy's own take each array anew, which takes as long as they do."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

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


class Room:
    """Arrays that are made once and used again: to take a large one anew takes as long as to fill it thrice."""

    def __init__(self) -> None:
        self._made: dict[tuple[object, ...], NDArray[Any]] = {}

    def arrays(self, number: int, shape: Sequence[int], kind: type[np.generic] = np.complex128) -> NDArray[Any]:
        """So many of a shape and kind; whatever they were used for last is still in them."""
        key = *shape, kind
        if key not in self._made or len(self._made[key]) < number:
            self._made[key] = np.empty((number, *shape), dtype=kind)
        return self._made[key][:number]


def spectrum_of(values: Array, shape: Sequence[int], first: int = 0, out: Complex | None = None) -> Complex:
    """Transform of an image, with zeros beside it up to a shape, as `numpy.fft.rfft2` has it.

    Rows before the first of those that are given hold zeros too.
    """
    end, (height, width) = first + values.shape[-2], shape
    whole = (*values.shape[:-2], height, width // 2 + 1)
    found = np.empty(whole, dtype=np.complex128) if out is None else out
    np.fft.rfft(values, width, axis=-1, out=found[..., first:end, :])
    found[..., :first, :] = 0.0
    found[..., end:, :] = 0.0
    return np.asarray(np.fft.fft(found, axis=-2, out=found))


def correlated(
    spectra: Iterable[Complex], weights: Iterable[Complex], shape: Sequence[int], step: int = 1, *, spent: bool = False
) -> Array:
    """Sum of images, each gathered by weights: by the images' transforms and the conjugate ones of the weights.

    Of every so many rows and columns, a power of two that divides the shape: frequencies that these do not tell from
    each other are added up before they are transformed. Spectra that are spent are written over; all but the first may
    then be made one after the other in the same array.
    """
    total: Complex | None = None
    for spectrum, weight in zip(spectra, weights, strict=True):
        product = np.multiply(spectrum, weight, out=spectrum if spent else None)
        total = product if total is None else np.add(total, product, out=total)
    if total is None:
        return np.zeros([size // step for size in shape])
    height, width = (size // step for size in shape)
    if step > 1:
        total = total.reshape(*total.shape[:-2], step, height, total.shape[-1]).sum(axis=-3)
    np.fft.ifft(total, axis=-2, out=total)
    for half in (shape[1] >> turn for turn in range(1, step.bit_length())):
        # Of a row, which is real: the frequency g + half is the conjugate one of half - g.
        low, high = total[..., : half // 2 + 1], total[..., half - half // 2 : half + 1]
        total = low + np.conj(high[..., ::-1])
    found = np.asarray(np.fft.irfft(total, width, axis=-1))
    return found if step == 1 else np.divide(found, step**2, out=found)
