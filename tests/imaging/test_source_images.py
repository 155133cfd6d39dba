"""Images of each source by one pass: those of a light basis bit by bit, by fewer rays."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("numba")

import radwrap
from radwrap.imaging.demand import SamplingPlan
from radwrap.imaging.relight import source_images as making
from radwrap.imaging.relight.relit import read_basis
from radwrap.imaging.relight.source_images import AimedRays, SourceImages, source_images, suffice
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.response.exposure import exposure_of_radiance
from radwrap.imaging.response.sensor import unclipped_gray
from radwrap.imaging.tracing import LaidOutScene
from radwrap.scene.file.load import scene_from_document
from radwrap.scene.scene import Scene
from radwrap.tracers.compiled.tracer import CompiledTracer
from tests.fitting.conftest import changed, tables
from tests.imaging.test_by_source import BOX
from tests.imaging.test_smooth_blocks import LENS
from tests.tracers.belt import scene_of

KERNEL = SamplingPlan("kernel", cell=2.0, layered=True, replicates=2)
RAYS = SamplingPlan("rays", rays=4, replicates=2)
OPTIONS = RenderOptions(tolerance=4.0, workers=1, tracer="compiled", seed=3)
SCENE = scene_from_document(tables())
# Smooth blocks, and two depths.
DEEP = scene_of(BOX, camera=LENS)
NEAR, FAR = "1.02 mm", "1.4 mm"  # from 1 mm; a pixel sees 2 mm
FEWER = 0.6  # of the rays of an even plan
LEAST = 0.3  # of the squared aim: a much smaller error would be wasted
SCATTER = 0.5  # of an error's square: that of 480 pixels, few of which have most of it
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
    traced, trace = [], making._Tiles.traced

    def counted(tiles: making._Tiles, *given: Any) -> tuple[np.ndarray, int]:
        traced.append(1)
        return trace(tiles, *given)

    monkeypatch.setattr(making._Tiles, "traced", counted)
    first = source_images(SCENE, tmp_path, OPTIONS, KERNEL)
    again = source_images(SCENE, tmp_path, OPTIONS, KERNEL)
    assert len(traced) == 1 and np.array_equal(first.images, again.images) and first.rays == again.rays
    other = source_images(SCENE, tmp_path, replace(OPTIONS, seed=4), KERNEL)
    assert len(traced) == 2 and not np.array_equal(first.images, other.images)
    (tmp_path / "source_images.npz").write_bytes(b"PK half of a file")
    back = source_images(SCENE, tmp_path, OPTIONS, KERNEL)
    assert len(traced) == 3 and np.array_equal(first.images, back.images)
    more = [np.full((20, 24), rays, dtype=np.intp) for rays in (4, 8)]
    aimed = [source_images(SCENE, tmp_path, OPTIONS, AimedRays(1.0, 2, one)) for one in more]
    assert len(traced) == 5 and aimed[1].rays > aimed[0].rays


def in_two_lights(folder: Path) -> Scene:
    """Two rings whose light a paint reflects otherwise: two bands, each source in one."""
    document = tables()
    (folder / "paint.csv").write_text("wavelength [nm],reflectance\n380,0.1\n500,0.2\n560,0.9\n780,0.4\n")
    document["materials"]["white"]["spectrum"] = {"file": "paint.csv"}
    ring = document["sources"][0]
    lights = {"blue": "450 nm", "red": "650 nm"}
    document["sources"] = [
        {**ring, "name": name, "spectrum": {"line": line, "width": "4 nm"}} for name, line in lights.items()
    ]
    return scene_from_document(document, folder=folder)


@pytest.mark.parametrize("plan", [pytest.param(KERNEL, marks=long), RAYS])
@pytest.mark.parametrize("bands", [1, 2])
def test_rays_are_those_that_the_tracer_gets(
    plan: SamplingPlan, bands: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In bands the light of all decides a kernel's rays: each is traced once in each band, and once for each source."""
    scene = SCENE if bands == 1 else in_two_lights(tmp_path)
    counted, shaded = [0], CompiledTracer._shaded

    def shade(tracer: CompiledTracer, block: np.ndarray, *rest: Any) -> Any:
        counted[0] += len(block)
        return shaded(tracer, block, *rest)

    def laid_out(*given: Any, **named: Any) -> LaidOutScene:
        made = LaidOutScene(*given, **named)  # which compares tracers
        counted[0] = 0
        return made

    monkeypatch.setattr(CompiledTracer, "_shaded", shade)
    monkeypatch.setattr(making, "LaidOutScene", laid_out)
    made = source_images(scene, tmp_path, replace(OPTIONS, basis=True), plan)
    depths = scene.camera.sensor.pixels
    assert made.rays == counted[0] + depths and len(made.sources) == 3 * bands
    if plan is RAYS:
        passes = 1 if bands == 1 else len(made.sources)  # how many each pixel gets is known
        assert counted[0] == passes * plan.replicates * (plan.rays or 0) * depths


def gray_of(made: SourceImages) -> np.ndarray:
    """Of the light of all, before saturation and rounding, shape (replicates, rows, columns)."""
    exposure = made.images.sum(axis=0, dtype=np.float64) * exposure_of_radiance(SCENE.camera)
    return np.asarray(unclipped_gray(exposure, SCENE.camera.sensor))


@pytest.mark.long
def test_aimed_rays_keep_their_aim_by_fewer_rays_than_even_ones(tmp_path: Path) -> None:
    """Against 16 times as many rays in each pixel; both have twelve replicates, which are independent."""
    truth = gray_of(source_images(SCENE, tmp_path / "truth", OPTIONS, replace(RAYS, rays=1024, replicates=4)))
    even = source_images(SCENE, tmp_path / "even", replace(OPTIONS, seed=8), replace(RAYS, rays=64, replicates=12))
    off = gray_of(even).mean(axis=0) - truth.mean(axis=0)
    aim = float(np.sqrt((off**2).mean()))
    ratios, signed = [], []
    for seed in range(4):
        options = replace(OPTIONS, seed=20 + seed)
        made = source_images(SCENE, tmp_path / f"{seed}", options, AimedRays(aim, 12))
        off = gray_of(made).mean(axis=0) - truth.mean(axis=0)
        ratios.append(float((off**2).mean()) / aim**2)
        signed.append(float(off.mean()))
        assert made.rays < FEWER * even.rays
        by_replicates = gray_of(made).var(axis=0, ddof=1).mean() / 12
        assert by_replicates == pytest.approx((off**2).mean(), rel=SCATTER)
    assert LEAST < np.mean(ratios) < 1.2
    assert abs(np.mean(signed)) < 4 * np.std(signed, ddof=1) / 2


@pytest.mark.parametrize("bands", [1, 2])
def test_a_long_pass_that_is_killed_goes_on_with_its_finished_tiles(
    bands: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Killed in the third of four replicates: two are not traced again."""
    scene = SCENE if bands == 1 else in_two_lights(tmp_path)
    plan, options = replace(RAYS, replicates=4), replace(OPTIONS, basis=True)
    whole = source_images(scene, tmp_path / "whole", options, plan)
    monkeypatch.setattr(making, "_SHORT", 0)
    begun, freeze = [], making.freeze_tile
    killed_at = 2

    def frozen(work: Any, ray_plan: Any, replicate: int, *rest: int, **named: bool) -> Any:
        if replicate >= killed_at:
            raise KeyboardInterrupt
        begun.append(replicate)
        return freeze(work, ray_plan, replicate, *rest, **named)

    monkeypatch.setattr(making, "freeze_tile", frozen)
    with pytest.raises(KeyboardInterrupt):
        source_images(scene, tmp_path / "killed", options, plan)
    assert begun == [0, 1]
    killed_at = plan.replicates
    again = source_images(scene, tmp_path / "killed", options, plan)
    assert begun == [0, 1, 2, 3]
    assert np.array_equal(again.images, whole.images) and again.rays == whole.rays
    assert not list((tmp_path / "killed").rglob("*.exr"))  # what is whole needs no pieces
    # Half of a piece, or one by other rays, is none.
    monkeypatch.setattr(making, "remove_pieces", lambda _: None)
    source_images(scene, tmp_path / "killed", replace(options, seed=4), plan)
    next((tmp_path / "killed").rglob("000_00000.exr")).write_bytes(b"half")
    (tmp_path / "killed" / "source_images.npz").unlink()
    back = source_images(scene, tmp_path / "killed", options, plan)
    assert np.array_equal(back.images, whole.images)


@pytest.mark.long
def test_a_few_replicates_carry_all_of_them_to_a_scene_nearby(tmp_path: Path) -> None:
    """An edge goes by a hundredth of a pixel: what changes is known far better than the image, unless it goes far."""
    aimed = AimedRays(1.0, 12)
    whole = source_images(SCENE, tmp_path / "whole", OPTIONS, aimed)
    again = AimedRays(1.0, 3, whole.numbers)
    same = whole.carried(source_images(SCENE, tmp_path / "same", OPTIONS, again))
    assert same is not None  # as of a scene that is too far away
    assert np.array_equal(same.images, whole.images)  # by the very same rays nothing changes
    far = changed(SCENE, {"targets[0].edge_position": FAR})
    assert whole.carried(source_images(far, tmp_path / "far", OPTIONS, again)) is None
    moved = changed(SCENE, {"targets[0].edge_position": NEAR})
    carried = whole.carried(source_images(moved, tmp_path / "some", OPTIONS, again))
    assert carried is not None and carried.rays < 0.3 * whole.rays
    own = source_images(moved, tmp_path / "moved", OPTIONS, replace(again, replicates=12))
    before, by_few, by_all = (gray_of(one).mean(axis=0) for one in (whole, carried, own))
    noise = gray_of(own).var(axis=0, ddof=1).mean() / 12
    # By three of twelve the change is off by three quarters of the variance that three have of themselves.
    assert ((by_few - by_all) ** 2).mean() == pytest.approx(0.75 * carried.carrying * noise, rel=SCATTER)
    assert 0.02 < carried.carrying < 0.5
    assert abs(float((by_few - by_all).sum())) < 0.5 * abs(float((by_all - before).sum()))  # it did move
    # Once more from there, it is off by both changes.
    back = carried.carried(source_images(SCENE, tmp_path / "back", OPTIONS, again))
    assert back is not None and back.carrying == pytest.approx(2 * carried.carrying, rel=0.3)
    assert gray_of(back).mean(axis=0) == pytest.approx(before, abs=1e-3)


def test_waves_and_bounces_ask_for_more() -> None:
    options = replace(OPTIONS, sampling=KERNEL)
    assert suffice(SCENE, options) and not suffice(SCENE, OPTIONS)
    assert not suffice(SCENE, replace(options, sampling=replace(KERNEL, wave_cell=1.0)))
    assert not suffice(SCENE, replace(options, bounces=1))
    assert not suffice(replace(SCENE, camera=replace(SCENE.camera, diffraction="on")), options)
