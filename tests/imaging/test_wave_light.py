"""Light at many depths: by even places, by layers and cell by cell waves add the same."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from radwrap.imaging.methods.central import CentralImage
from radwrap.imaging.methods.kernel import coarsened, region_of
from radwrap.imaging.methods.transforms import Room
from radwrap.imaging.optics.smooth import SmoothField
from radwrap.imaging.tolerance import wave_gather
from radwrap.imaging.tolerance.sorted_light import added_one_by_one, in_phases
from radwrap.imaging.tolerance.wave_behind import Laid, by_layer
from radwrap.imaging.tolerance.wave_gather import kept_transforms
from radwrap.imaging.tolerance.wave_light import Parted, by_layers, parted
from radwrap.imaging.tolerance.wave_parts import waves_of
from radwrap.imaging.tolerance.wave_plan import WavePlan, plan_waves
from radwrap.scene.camera import Aperture
from tests.imaging.planes import Array, view
from tests.imaging.test_own_rays import WAVELENGTH, near_and_far, stripes

ROUNDING = 1e-12  # of the largest value


def layer_by_layer(light: Parted, shape: tuple[int, int], layers: int) -> Array:
    """Light of each layer, whatever it is kept as."""
    found = np.zeros((layers, *shape))
    for sheet in light.sheets:
        number = int(sheet.place)
        found[number] += (1 - sheet.place + number) * sheet.values
        if sheet.place > number:
            found[number + 1] += (sheet.place - number) * sheet.values
    if (few := light.few) is not None:
        np.add.at(found, (few.layers, few.rows, few.columns), few.light)
    return found


def steps(random: np.random.Generator, shape: tuple[int, int]) -> Array:
    """A floor, two faces, a wall and cells that edges cross."""
    places = np.full(shape, 0.25)
    places[:, 20:60], places[10:30, 80:] = 4.0, 2.7
    places[30:34, 80:] = random.uniform(0.25, 2.7, (4, shape[1] - 80))
    places[:, 19], places[:, 60] = random.uniform(0.25, 4.0, (2, shape[0]))
    return places


@pytest.mark.parametrize("few", [0, 20, 200, 10**9])
@pytest.mark.parametrize("dark", [False, True])
def test_parted_light_is_that_of_all_layers(few: int, *, dark: bool) -> None:
    random, shape = np.random.default_rng(2), (60, 130)
    places, values = steps(random, shape), random.uniform(1.0, 2.0, shape)
    values[:, 100:] *= not dark
    behind = np.where(places > 1, -0.5, 0.0) * values
    laid: Laid = ((values, places), (behind, np.full(shape, 0.25)))
    found, expected = parted(laid, 5, few, Room()), np.zeros((5, *shape))
    for number, light in by_layer(laid).items():
        expected[number] = light
    assert np.abs(layer_by_layer(found, shape, 5) - expected).max() < ROUNDING * values.max()
    assert all(values.any() for values in (sheet.values for sheet in found.sheets))
    for sheet in found.sheets:
        assert not sheet.values[: sheet.lit[0]].any() and not sheet.values[sheet.lit[1] :].any()
    if few == 10**9:
        assert [sheet.place for sheet in found.sheets] == [0.25, 2.7, 4.0] and found.few is not None
    if few == 0:
        assert found.few is None and all(sheet.place.is_integer() for sheet in found.sheets)


def test_what_float32_leaves_of_a_flat_face_is_even() -> None:
    random, shape = np.random.default_rng(3), (40, 50)
    places = np.full(shape, 1.3) + random.choice([0.0, 2e-7], shape)
    light = parted(((np.ones(shape), places),), 3, 10, Room())
    assert len(light.sheets) == 1 and light.few is None and (light.sheets[0].values == 1).all()


def test_no_light_has_no_sheets_and_one_layer_needs_no_places() -> None:
    nothing = np.zeros((20, 30))
    dark = parted(((nothing, nothing),), 3, 10, Room())
    assert not dark.sheets and dark.few is None
    one = parted(((nothing + 2, None),), 1, 10, Room())
    assert [sheet.place for sheet in one.sheets] == [0] and one.few is None


@pytest.mark.parametrize("step", [1, 2, 4])
def test_cells_that_are_added_one_by_one_are_sums_by_weights(step: int) -> None:
    random, pixels, reach = np.random.default_rng(4), (7, 9), (5, 6)
    cells = random.normal(size=tuple(step * size + 2 * far + 3 for size, far in zip(pixels, reach, strict=True)))
    near = random.normal(size=(2, 2 * reach[0] + 1, 2 * reach[1] + 1))
    layers = random.integers(0, 2, cells.shape)
    expected = np.zeros(pixels)
    for i, j in np.ndindex(pixels):
        part = np.s_[1 + step * i : 1 + step * i + near.shape[1], 2 + step * j : 2 + step * j + near.shape[2]]
        expected[i, j] = sum((cells * (layers == number))[part].ravel() @ near[number].ravel() for number in (0, 1))
    rows, columns = (at.ravel() for at in np.indices(cells.shape))
    found = np.zeros(pixels)
    weights = np.stack([in_phases(one, step) for one in near])
    added_one_by_one(rows, columns, layers.ravel(), cells.ravel(), weights, (1, 2), step, found)
    assert found == pytest.approx(expected, abs=1e-11)


def two_depths(cell: float) -> WavePlan:
    of = view(Aperture("round", 2e-4), (0.5, near_and_far), (1.0, stripes), rows=60, columns=75)
    plan = plan_waves(of, WAVELENGTH, 0.25, 1, even_cell=cell)
    return replace(plan, smooth=cast("SmoothField", object()))  # which says that the compiler is there


@pytest.mark.parametrize("cell", [0.25, 0.5, 1.0])
def test_waves_add_the_same_whatever_light_is_kept_as(cell: float, monkeypatch: pytest.MonkeyPatch) -> None:
    plan, random = two_depths(cell), np.random.default_rng(5)
    first, shape = region_of(plan.kernel, 0)
    layers = np.array(plan.kernel.layers)
    near = np.hypot(*(at - size / 2 for at, size in zip(np.indices(shape), shape, strict=True))) < min(shape) / 3
    depth = np.where(near, layers[-1], 0.7 * layers[0] + 0.3 * layers[1])
    depth[near] += (layers[0] - layers[1]) * random.uniform(0, 0.3, near.sum()) * (random.random(near.sum()) < 0.05)
    central = CentralImage(first, random.uniform(1.0, 2.0, shape) + near, depth, 0)
    kinds = list[NDArray[np.bool_]]()

    def changed() -> list[Array]:
        of_tile = waves_of([plan], 0, central, coarsened(central), transforms=kept_transforms())
        return [part for changed in of_tile for part in changed]

    def noted(laid: Laid, number: int, few: int, room: Room) -> Parted:
        light = parted(laid, number, few, room)
        kinds.append(np.array([any(sheet.place % 1 for sheet in light.sheets), light.few is not None]))
        return light

    monkeypatch.setattr(wave_gather, "parted", noted)
    found = changed()
    assert np.any(kinds, axis=0).all()
    monkeypatch.setattr(wave_gather, "parted", lambda laid, *_: by_layers(laid))
    for one, expected in zip(found, changed(), strict=True):
        assert np.abs(one - expected).max() < ROUNDING * central.values.max()
