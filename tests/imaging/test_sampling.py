"""One plan for many images: no light decides where its rays go, and its replicates tell its error."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.imaging.demand import Budget, Demand, SamplingPlan, sampling_plan
from radwrap.imaging.relight.relit import read_basis, relit
from radwrap.imaging.tolerance.kept_replicates import KeptReplicates, read_replicates
from radwrap.imaging.tolerance.sampling import Pilot, strictest
from radwrap.scene.scene import Scene
from tests.study.conftest import EDGE

KERNEL: Final = SamplingPlan("kernel", cell=0.5, replicates=4)
RAYS: Final = SamplingPlan("rays", rays=8, replicates=4)
FLOAT32: Final = 1e-6  # relative; of sums of a few values that are rounded so


@pytest.fixture(scope="module")
def scene() -> Scene:
    return radwrap.scene_from_document(EDGE)


@pytest.mark.parametrize("plan", [KERNEL, pytest.param(RAYS, marks=pytest.mark.long)])
def test_a_darker_image_is_sampled_by_the_same_rays(scene: Scene, plan: SamplingPlan) -> None:
    """Radiant exposure is proportional to the exposure time, noise and all; a search by itself takes fewer rays."""
    darker = radwrap.with_value(scene, "camera.exposure_time", "13 ms")
    bright, dark = (radwrap.render(one, sampling=plan, workers=1) for one in (scene, darker))
    scaled = dark.radiant_exposure.values * (100 / 13)
    assert np.abs(scaled / bright.radiant_exposure.values - 1).max() < FLOAT32
    replicates = [one.manifest["plan"]["attempts"][0]["rays"] for one in (bright, dark)]
    assert replicates[0] == replicates[1]


@pytest.mark.long
def test_a_search_by_each_image_samples_darker_ones_coarser(scene: Scene) -> None:
    """Why there is a plan: the tolerance is absolute."""
    darker = radwrap.with_value(scene, "camera.exposure_time", "13 ms")
    rays = [radwrap.render(one, tolerance=0.3, workers=1).manifest["rays"] for one in (scene, darker)]
    assert rays[1] < 0.5 * rays[0]


@pytest.mark.parametrize("plan", [KERNEL, pytest.param(RAYS, marks=pytest.mark.long)])
def test_replicates_are_kept_and_a_basis_gives_the_same(scene: Scene, plan: SamplingPlan, tmp_path: Path) -> None:
    made = radwrap.render(scene, tmp_path, sampling=plan, basis=True, workers=1)
    kept = read_replicates(tmp_path, scene.camera.sensor.rows)
    exposure = made.radiant_exposure.values
    assert len(kept.images) == plan.replicates
    assert np.abs(kept.images.mean(axis=0) / exposure - 1).max() < FLOAT32
    assert bool(kept.change.any()) == (plan.method == "kernel")
    (image,) = relit(read_basis(tmp_path), [[1.0, 1.0, 1.0]])
    assert image.replicates is not None
    assert np.abs(image.replicates.images / kept.images - 1).max() < FLOAT32
    assert np.abs(image.replicates.change - kept.change).max() < FLOAT32 * exposure.max()
    found, known = image.certificate, made.manifest["error"]
    assert found.discretisation_rms_gray == pytest.approx(known["discretisation_rms_gray"], rel=1e-3)


def test_changes_have_the_variance_of_the_mean() -> None:
    """Of n images of variance 1 the mean has 1/n; 20000 pixels know that to 1 %, here to four times that."""
    number = 12
    images = np.random.default_rng(0).standard_normal((number, 100, 200))
    changes = KeptReplicates(images, np.zeros((100, 200))).changes()
    assert float((changes**2).mean()) == pytest.approx(1 / number, rel=0.04)
    assert np.abs(changes.sum(axis=0)).max() < 1e-12


def pilot(cell: float | None, rays: int = 64, *, layered: bool = False) -> Pilot:
    return Pilot(cell, layered, rays, 3000.0, 4000.0)


def test_the_strictest_pilot_decides() -> None:
    demand = Demand(0.5)
    found = strictest([pilot(0.5), pilot(0.25, layered=True), pilot(0.5, 16)], demand)
    assert found == SamplingPlan("kernel", cell=0.25, layered=True)
    # Where the kernel's model does not hold for one of them, all are sampled by rays.
    assert strictest([pilot(0.5), pilot(None, 256)], demand) == SamplingPlan("rays", rays=256)
    assert strictest([pilot(0.5, 4)], Demand(0.5, method="rays")) == SamplingPlan("rays", rays=4)
    # 12 replicates of 4000 px and a ray in each cell of 0.25 px are 768000 rays.
    poor = Demand(0.5, budget=Budget(rays=767_999))
    assert strictest([pilot(0.25)], poor) == SamplingPlan("kernel", cell=0.5)


def test_a_plan_survives_json() -> None:
    for plan in (KERNEL, RAYS):
        assert sampling_plan(plan.as_json(), "sampling[0]") == plan


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("method", "pinhole"),
        ("cell", 0.3),
        ("cell", math.nan),
        ("cell", -0.5),
        ("cell", None),
        ("cell", "0.5"),
        ("cell", 1e-300),
        ("rays", 8),
        ("layered", 1),
        ("replicates", 1),
        ("replicates", 12.0),
        ("replicates", 10**6),
    ],
)
def test_a_plan_that_was_changed_is_refused_by_its_key(key: str, value: Any) -> None:
    with pytest.raises(InputError) as error:
        sampling_plan({**KERNEL.as_json(), key: value}, "study.json: sampling[0]")
    assert error.value.where == f"study.json: sampling[0].{key}"


def test_a_plan_of_other_keys_is_refused() -> None:
    for told in ([], None, {}, {**KERNEL.as_json(), "more": 1}):
        with pytest.raises(InputError, match="sampling"):
            sampling_plan(told, "sampling")
