"""The light basis: linear to the last digits of a float32, honest about its error, and never traced twice."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.imaging.optics.view import LitView
from radwrap.imaging.relight import basis_pieces
from radwrap.imaging.relight.basis import freeze_tile, grid_pixels, shining, write_basis
from radwrap.imaging.relight.relit import Basis, read_basis, relit
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.tolerance.bounds import Bounded, resampling, stratified_mean, stratified_means
from radwrap.imaging.tolerance.certificate import certify_by_independent_rays, model_lacks
from radwrap.imaging.tolerance.planner import Outcome, render_to_tolerance
from radwrap.imaging.tolerance.plans import kernel_of
from radwrap.imaging.tolerance.replicates import Work
from radwrap.imaging.tracing import LaidOutScene, traced_scene
from radwrap.process import Programs
from radwrap.progress import Progress
from tests.cli.conftest import SMALL, scene_with

# Radiance answers in float32, so do the files: each sum of a few has some 1e-7 of the peak.
LINEAR: Final = 1e-5
FACTORS: Final = (0.3, 2.5, 0.0, 0.7)
SEED: Final = 3
# Of twice 512 rays at all pixels: below, the true error is not told from 0 [gray level].
REFERENCE: Final = 0.4


def lamp(name: str, at: tuple[float, float, float], radiance: str, diameter: float) -> dict[str, Any]:
    """An LED that lights the board [mm]."""
    place = [f"{value} mm" for value in at]
    changes = {"name": name, "position": place, "radiance": radiance, "diameter": f"{diameter} mm"}
    return {**SMALL["sources"][0], **changes}


# "rear" stands 4 mm behind "front", whose disc hides it from the board, whether it shines or not.
SOURCES: Final = [
    lamp("left", (-90, 30, 450), "60 kW/m^2/sr", 5),
    lamp("front", (30, 100, 450), "8 kW/m^2/sr", 12),
    lamp("rear", (30 + 0.26, 100 + 0.87, 450 + 3.9), "70 kW/m^2/sr", 2),
    lamp("low", (10, -80, 420), "40 kW/m^2/sr", 5),
]


def scene(factors: tuple[float, ...] = (1, 1, 1, 1), **changes: Any) -> radwrap.Scene:
    made = radwrap.scene_from_document(scene_with({"sources": SOURCES, **changes}))
    sources = tuple(
        replace(source, emitter=replace(source.emitter, radiance=source.emitter.radiance * factor))
        for source, factor in zip(made.sources, factors, strict=True)
    )
    return replace(made, sources=sources)


@dataclass(frozen=True)
class Made:
    """A basis, and how it was made."""

    scene: radwrap.Scene
    work: Work
    views: tuple[LitView, ...]
    options: RenderOptions
    outcome: Outcome
    out: Path
    basis: Basis

    def write(self) -> None:
        told = {"tolerance": 0.5, "max_error": None, "dark": [], "scene_sha256": "0" * 64}
        write_basis(self.out, self.work, self.views, self.outcome, told)

    @property
    def log(self) -> list[str]:
        return (self.work.folder / "basis" / "tracer_calls.log").read_text().splitlines()


DEEP: Final = {  # a second sheet nearer by: several layers, whose shares depend on the depth of what is seen
    "camera.aperture.diameter": "0.8 mm",
    "targets.1": {
        "type": "board",
        "name": "near",
        "position": ["30 mm", "10 mm", "120 mm"],
        "material": "white",
        "dot_material": "black",
        "rows": 1,
        "columns": 2,
        "pitch": "20 mm",
        "dot_diameter": "12 mm",
    },
}


# Each method and each tracer; their other pairs are long.
MADE: Final = [
    *("rays", "hybrid, deep, compiled"),
    *(
        pytest.param(name, marks=pytest.mark.long)
        for name in ("kernel", "kernel, deep", "rays, compiled", "kernel, deep, compiled", "hybrid, deep")
    ),
]


@pytest.fixture(scope="module", params=MADE)
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Made]:
    method, *how = request.param.split(", ")
    room = scene(**(DEEP if "deep" in how else {}))
    folder = tmp_path_factory.mktemp("basis")
    tracer = "radiance"
    if "compiled" in how:  # all sources in one pass
        tracer = "compiled"
        pytest.importorskip("numba")
    options = RenderOptions(method=method, tolerance=3.0, seed=SEED, tracer=tracer)  # type: ignore[arg-type]
    for name in ("work", "pieces", "out"):
        (folder / name).mkdir()
    with Programs() as programs:
        traced = LaidOutScene(room, options, programs, folder / "work")
        progress = Progress("", 1, shown=False)
        work = Work(traced.view(), folder / "pieces", programs, progress, traced.sha256(), SEED)
        outcome = render_to_tolerance(work, options.demand)
        views = traced.views_of(shining(room, traced.prepared))
        assert len(views) == (1 if tracer == "compiled" else len(FACTORS))
        half = Made(room, work, views, options, outcome, folder / "out", None)  # type: ignore[arg-type]
        half.write()
        yield replace(half, basis=read_basis(folder / "out"))


def test_relit_images_equal_those_of_a_scene_with_other_levels(made: Made) -> None:
    """Fresh rays by the same plan in the scene whose sources are scaled: equal to float32."""
    plan, basis, levels = made.outcome.ray_plan, made.basis, np.array(FACTORS)
    scaled = replace(made.scene, sources=scene(FACTORS).sources)
    relit_images, relit_grid, relit_lacks = (
        np.tensordot(levels, part.astype(float), 1) for part in (basis.images, basis.grid, basis.lacks)
    )
    peak = relit_images.max()
    assert peak > 0
    with traced_scene(scaled, made.options) as fresh:
        for replicate in range(len(relit_images)):
            changed = []
            for tile, (r0, r1, c0, c1) in enumerate(plan.tiles):
                frozen = freeze_tile(made.work, plan, replicate, tile, in_one_pass=False)
                ((values, change),) = frozen.trace(LitView(("all",), fresh), int)
                assert np.abs(values - relit_images[replicate, r0:r1, c0:c1]).max() < LINEAR * peak
                changed.append(change)
            assert np.abs(np.concatenate(changed) - relit_grid[replicate]).max(initial=0) < LINEAR * peak
        kernel = kernel_of(plan)
        if kernel is not None:
            assert basis.sample is not None
            lacks, rays = model_lacks(fresh, kernel.layers, basis.sample, seed=(SEED, 15))
            assert rays == basis.model_rays
            assert np.abs(lacks - relit_lacks).max() < LINEAR * peak


def test_all_factors_one_give_the_image_itself(made: Made) -> None:
    (image,) = relit(made.basis, [[1.0] * 4])
    exposure = made.outcome.radiance * made.work.view.exposure_of_radiance
    assert np.abs(image.radiant_exposure.values - exposure).max() < LINEAR * exposure.max()
    error, own = image.certificate, made.outcome.certificate
    # The same replicates; of the cells' size and the model another sample tells.
    assert error.discretisation_rms_gray == pytest.approx(own.discretisation_rms_gray, rel=0.05)
    assert error.method == own.method


def test_grid_pixels_are_those_of_the_tiles(made: Made) -> None:
    numbers = grid_pixels(made.outcome.ray_plan)
    assert len(numbers) == made.basis.grid.shape[-1] == len(set(numbers.tolist()))
    assert (len(numbers) > 0) == (kernel_of(made.outcome.ray_plan) is not None)


@pytest.mark.long
def test_certificates_of_relit_images_hold(made: Made) -> None:
    """Against independent rays at all pixels; and none is idle."""
    for factors in (FACTORS, (0.0, 1.0, 1.0, 0.0), (1.5, 0.2, 0.4, 0.9)):
        (image,) = relit(made.basis, [factors])
        with traced_scene(replace(made.scene, sources=scene(factors).sources)) as view:
            radiance = image.radiant_exposure.values / view.exposure_of_radiance
            true = certify_by_independent_rays(view, radiance, 71, pixels=480, rays=512).rms_gray
        assert true < image.certificate.rms_gray_upper95 < 3 * true + REFERENCE, factors


def test_a_planted_error_is_detected(made: Made) -> None:
    """One replicate of one source too bright: the certificate grows by what that does, where its own noise is less."""
    images = made.basis.images.copy()
    images[0, 0] *= 1.2 if made.outcome.method == "kernel" else 1.3
    good, bad = (next(relit(basis, [[1.0] * 4])) for basis in (made.basis, replace(made.basis, images=images)))
    moved = np.abs(good.gray.values - bad.gray.values).max()
    assert moved >= 1
    assert bad.certificate.discretisation_rms_gray > 1.2 * good.certificate.discretisation_rms_gray


def test_whole_pieces_are_not_traced_again(made: Made) -> None:
    before = {path.name: path.read_bytes() for path in (made.out / "basis").iterdir()}
    log = made.log
    made.write()
    assert made.log == log
    one, other = (0, 0) if len(made.views) == 1 else (1, 2)
    (made.work.folder / "basis" / f"tile_001_00000_0000{other}.exr").unlink()
    (made.work.folder / "basis" / f"tile_000_00000_0000{one}.exr").write_bytes(b"torn")
    made.write()
    assert sorted(made.log[len(log) :]) == [f"tile_000_00000 {one}", f"tile_001_00000 {other}"]
    assert {path.name: path.read_bytes() for path in (made.out / "basis").iterdir()} == before


# ---------------------------------------------------------------------------------------------------------- One by one


def test_a_dark_disc_still_hides_what_is_behind_it(tmp_path: Path) -> None:
    radwrap.render(scene(), tmp_path / "both", basis=True, tolerance=5.0)
    basis = read_basis(tmp_path / "both")
    light = basis.images.max(axis=(1, 2, 3))
    assert basis.sources == ("left", "front", "rear", "low")
    assert light[2] == 0.0 < light[[0, 1, 3]].min()
    # Without that disc it is no weak one.
    alone = replace(scene(), sources=(scene().sources[2],))
    radwrap.render(alone, tmp_path / "alone", basis=True, tolerance=5.0)
    assert read_basis(tmp_path / "alone").images.max() > light.max() / 10


def test_dark_sources_are_no_part_of_the_basis(tmp_path: Path) -> None:
    radwrap.render(scene((1, 0, 1, 1)), tmp_path, basis=True, tolerance=5.0)
    basis = read_basis(tmp_path)
    assert basis.sources == ("left", "rear", "low") and basis.dark == ("front",)


def test_each_led_of_a_ring_is_a_source(tmp_path: Path) -> None:
    ring = {
        "type": "ring",
        "name": "ring",
        "position": ["0 mm", "0 mm", "500 mm"],
        "look_at": ["0 mm", "0 mm", "0 mm"],
        "count": 3,
        "diameter": "60 mm",
        "led_diameter": "5 mm",
        "radiance": "60 kW/m^2/sr",
        "beam": {"profile": "lambertian"},
    }
    room = radwrap.scene_from_document(scene_with({"sources": [ring]}))
    radwrap.render(room, tmp_path, basis=True, tolerance=5.0)
    assert read_basis(tmp_path).sources == ("ring.led00", "ring.led01", "ring.led02")


def test_an_included_file_that_shines_is_refused(tmp_path: Path) -> None:
    light = "void light bulb 0 0 3 9 9 9 bulb sphere ball 0 0 4 0 0.3 0.3 0.01\n"
    (tmp_path / "bulb.rad").write_text(light)
    document = scene_with({"sources": SOURCES, "targets.1": {"type": "rad", "name": "bulb", "rad": "bulb.rad"}})
    room = replace(radwrap.scene_from_document(document), folder=tmp_path)
    with pytest.raises(InputError, match='"bulb" holds light of its own'):
        radwrap.render(room, tmp_path / "out", basis=True)


@pytest.mark.parametrize("how", [{"method": "pinhole"}, {"method": "viewpoints"}, {"viewpoints": 7}])
def test_methods_without_a_ray_plan_are_refused(how: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="basis: needs an image to tolerance"):
        RenderOptions(basis=True, **how)


def test_the_files_do_not_depend_on_the_workers(tmp_path: Path) -> None:
    one, three = (
        radwrap.render(scene(), tmp_path / str(workers), basis=True, workers=workers).manifest["files"]
        for workers in (1, 3)
    )
    assert one == three
    assert "basis/left.0.exr" in one and "basis.json" in one
    # What an older run wrote does not stay.
    radwrap.render(scene(), tmp_path / "1", tolerance=5.0)
    assert not (tmp_path / "1" / "basis").exists() and not (tmp_path / "1" / "basis.json").exists()


# ---------------------------------------------------------------------------------------------------- Arrays and bounds


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Basis:
    out = tmp_path_factory.mktemp("small")
    radwrap.render(scene(), out, basis=True, max_error=20.0)
    return read_basis(out)


def test_an_image_does_not_depend_on_the_others(small: Basis) -> None:
    levels = np.random.default_rng(1).random((37, 4))
    together = list(relit(small, levels))
    for number in (0, 17, 36):
        (alone,) = relit(small, levels[number : number + 1])
        assert np.array_equal(alone.radiant_exposure.values, together[number].radiant_exposure.values)
        assert alone.certificate == together[number].certificate
    backwards = list(relit(small, levels[::-1]))[::-1]
    assert [image.certificate for image in backwards] == [image.certificate for image in together]


def test_the_quantile_comes_where_it_was_asked_for(small: Basis) -> None:
    (image,) = relit(small, [[1.0] * 4])
    quantile = image.certificate.p99_gray_upper95
    assert quantile is not None and image.certificate.rms_gray < quantile
    assert image.keeps(small) and not image.keeps(replace(small, max_error=quantile * 0.99))


@pytest.mark.long
def test_rows_longer_than_an_image_is_wide_are_folded(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A tile of a large sensor has more pixels than an image file has columns; the files of the basis are the same."""
    radwrap.render(scene(), tmp_path / "plain", basis=True, tolerance=20)
    monkeypatch.setattr(basis_pieces, "_WIDEST", 37)
    radwrap.render(scene(), tmp_path / "folded", basis=True, tolerance=20)
    names = sorted(path.name for path in (tmp_path / "plain" / "basis").iterdir())
    assert names
    for name in names:
        plain, folded = ((tmp_path / place / "basis" / name).read_bytes() for place in ("plain", "folded"))
        assert plain == folded, name


def test_dark_and_glaring_images(small: Basis) -> None:
    dark, glaring = relit(small, [[0.0] * 4, [1e6] * 4])
    assert (dark.gray.values == 22).all() and dark.certificate.rms_gray_upper95 == 0
    assert glaring.saturated_fraction == (glaring.gray.values == 181).mean() > 0.5
    with pytest.raises(InputError, match="image 2 overflows"):
        list(relit(small, [[1.0] * 4, [1e200] * 4]))


@pytest.mark.parametrize("factors", [[[1.0] * 3], [1.0] * 4, [[1.0, 1.0, -1e-9, 1.0]], [[1.0, float("nan"), 0, 0]]])
def test_bad_factors_are_refused(small: Basis, factors: Any) -> None:
    with pytest.raises(InputError, match="factors"):
        relit(small, factors)


def _one_by_one(values: np.ndarray, stratum: np.ndarray, shares: np.ndarray, drawn: list[np.ndarray]) -> float:
    """The bootstrap-t bound from resamples that are laid out sample by sample."""

    def mean_and_error(parts: list[np.ndarray]) -> tuple[float, float]:
        mean = sum(share * part.mean() for share, part in zip(shares, parts, strict=True))
        variance = sum(share**2 * part.var(ddof=1) / len(part) for share, part in zip(shares, parts, strict=True))
        return mean, float(np.sqrt(variance))

    strata = [values[stratum == k] for k in range(len(shares))]
    mean, error = mean_and_error(strata)
    t = []
    for row in range(len(drawn[0])):
        again = [np.repeat(part, times[row].astype(int)) for part, times in zip(strata, drawn, strict=True)]
        moved, spread = mean_and_error(again)
        t.append((moved - mean) / spread if spread > 1e-12 else 0.0)
    return max(mean, 0.0) + max(1.959963985, -float(np.quantile(t, 0.025))) * error


@pytest.mark.parametrize("kind", ["normal", "heavy", "single"])
def test_bounds_of_counted_resamples_are_those_of_resamples(kind: str) -> None:
    random = np.random.default_rng(4)
    stratum, shares = np.repeat([0, 1, 2], [20, 10, 10]), np.array([0.1, 0.2, 0.7])
    make: dict[str, Callable[[], np.ndarray]] = {
        "normal": lambda: random.normal(size=40),
        "heavy": lambda: np.exp(3 * random.normal(size=40)),
        "single": lambda: np.eye(40)[3],
    }
    values = make[kind]()
    again = resampling(stratum, shares, (1, 2))
    assert all((times.sum(axis=1) == n).all() for times, n in zip(again.drawn, (20, 10, 10), strict=True))
    bound = stratified_mean(values, stratum, shares, (1, 2))
    assert bound.upper == pytest.approx(_one_by_one(values, stratum, shares, list(again.drawn)), rel=1e-9)
    both = stratified_means(np.stack([values, np.zeros(40)]), again)
    assert both[1] == Bounded(0.0, 0.0)
    assert (both[0].mean, both[0].upper) == pytest.approx((bound.mean, bound.upper), rel=1e-12)
