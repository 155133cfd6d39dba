"""Transforms in place are numpy's, to the last bit."""

import numpy as np
import pytest

from radwrap.imaging.methods.transforms import correlated, fast_length, spectrum_of


@pytest.mark.parametrize("shape", [(12, 15), (16, 18)])
def test_a_spectrum_is_that_of_the_image_with_zeros_beside_it(shape: tuple[int, int]) -> None:
    values = np.random.default_rng(0).normal(size=(3, 12, 13))
    assert (spectrum_of(values, shape) == np.fft.rfft2(values, shape)).all()


@pytest.mark.parametrize("width", [15, 16])
def test_images_are_gathered_by_their_weights(width: int) -> None:
    random, shape = np.random.default_rng(1), (9, width)
    images, weights = random.normal(size=(2, 2, 9, width))
    expected = np.zeros(shape)
    for image, weight in zip(images, weights, strict=True):
        for (row, column), value in np.ndenumerate(weight):
            expected += value * np.roll(image, (-row, -column), axis=(0, 1))
    spectra, conjugate = ([np.fft.rfft2(each) for each in both] for both in (images, weights))
    found = correlated(spectra, [np.conj(each) for each in conjugate], shape)
    assert found == pytest.approx(expected, abs=1e-12)


def test_lengths_are_products_of_small_primes() -> None:
    assert [fast_length(size) for size in (1, 7, 11, 97, 1294)] == [1, 8, 12, 100, 1296]


@pytest.mark.parametrize("step", [2, 4, 8])
def test_every_so_many_rows_and_columns_are_those_of_all(step: int) -> None:
    shape, random = (3 * step, 5 * step), np.random.default_rng(step)
    images, weights = random.normal(size=(2, 2, *shape))
    spectra, conjugate = ([spectrum_of(each, shape) for each in both] for both in (images, weights))
    every = correlated(spectra, conjugate, shape, step)
    assert every == pytest.approx(correlated(spectra, conjugate, shape)[::step, ::step], abs=1e-10)


def test_rows_before_the_first_are_dark() -> None:
    values = np.random.default_rng(1).normal(size=(3, 7))
    below = np.concatenate([np.zeros((4, 7)), values])
    assert (spectrum_of(values, (9, 8), 4) == spectrum_of(below, (9, 8))).all()
