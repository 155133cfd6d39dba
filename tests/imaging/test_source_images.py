"""Images of each source by one pass: those of a light basis bit by bit, by fewer rays."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("numba")

import radwrap
from radwrap.imaging.demand import SamplingPlan
from radwrap.imaging.relight import source_images as making
from radwrap.imaging.relight.relit import read_basis
from radwrap.imaging.relight.source_images import source_images, suffice
from radwrap.imaging.render_options import RenderOptions
from radwrap.scene.file.load import scene_from_document
from radwrap.scene.scene import Scene
from tests.fitting.conftest import tables
from tests.imaging.test_by_source import BOX
from tests.imaging.test_smooth_blocks import LENS
from tests.tracers.belt import scene_of

KERNEL = SamplingPlan("kernel", cell=2.0, layered=True, replicates=2)
RAYS = SamplingPlan("rays", rays=4, replicates=2)
OPTIONS = RenderOptions(tolerance=4.0, workers=1, tracer="compiled", seed=3)
SCENE = scene_from_document(tables())
# Smooth blocks, and two depths.
DEEP = scene_of(BOX, camera=LENS)
long = pytest.mark.long


@pytest.mark.parametrize(
    ("scene", "plan"),
    [
        pytest.param(SCENE, KERNEL, marks=long),
        pytest.param(SCENE, replace(KERNEL, layered=False), marks=long),
        (SCENE, RAYS),
        pytest.param(DEEP, KERNEL, marks=long),
    ],
)
def test_they_are_those_of_a_basis(scene: Scene, plan: SamplingPlan, tmp_path: Path) -> None:
    made = source_images(scene, tmp_path / "own", OPTIONS, plan)
    options = replace(OPTIONS, sampling=plan, method=plan.method, basis=True)
    rendered = radwrap.render(scene, tmp_path / "basis", options)
    basis = read_basis(tmp_path / "basis")
    assert made.sources == basis.sources and len(made.sources) in (3, 12)
    assert np.array_equal(made.images, basis.images) and made.images.std() > 0
    assert made.rays < rendered.run.rays


@pytest.mark.long
def test_what_lies_there_is_traced_again_unless_it_is_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    traced, trace = [], making._traced

    def counted(*given: object) -> np.ndarray:
        traced.append(1)
        return trace(*given)  # type: ignore[arg-type]

    monkeypatch.setattr(making, "_traced", counted)
    first = source_images(SCENE, tmp_path, OPTIONS, KERNEL)
    again = source_images(SCENE, tmp_path, OPTIONS, KERNEL)
    assert len(traced) == 1 and np.array_equal(first.images, again.images) and first.rays == again.rays
    other = source_images(SCENE, tmp_path, replace(OPTIONS, seed=4), KERNEL)
    assert len(traced) == 2 and not np.array_equal(first.images, other.images)
    (tmp_path / "source_images.npz").write_bytes(b"PK half of a file")
    back = source_images(SCENE, tmp_path, OPTIONS, KERNEL)
    assert len(traced) == 3 and np.array_equal(first.images, back.images)


def test_waves_and_bounces_ask_for_more() -> None:
    options = replace(OPTIONS, sampling=KERNEL)
    assert suffice(SCENE, options) and not suffice(SCENE, OPTIONS)
    assert not suffice(SCENE, replace(options, sampling=replace(KERNEL, wave_cell=1.0)))
    assert not suffice(SCENE, replace(options, bounces=1))
    assert not suffice(replace(SCENE, camera=replace(SCENE.camera, diffraction="on")), options)
