"""Who traces a scene: by what it holds, by counts, and by a comparison of both tracers."""

from __future__ import annotations

import math
import sys
from collections.abc import Collection, Generator, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

import radwrap
from radwrap.errors import EnvironmentFailure, InputError
from radwrap.imaging import tracer_choice
from radwrap.imaging.demand import SamplingPlan
from radwrap.imaging.forecast.wave_change import MOST_RAYS
from radwrap.imaging.relight.relit import read_basis, relit
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.tracer_choice import TracerUsed, candidate, compared, probe_rays, probed
from radwrap.imaging.tracing import laid_out
from radwrap.scene.scene import Scene
from radwrap.tracers.agreement import agreement
from radwrap.tracers.engine import Engine, EngineName
from radwrap.tracers.tracer import Tracer
from tests.cli.conftest import SMALL, scene_with

Floats = np.ndarray[Any, np.dtype[np.float64]]
# Radiance answers in float32.
FLOAT32: Final = 1e-6


def small(**changes: Any) -> Scene:
    return radwrap.scene_from_document(scene_with(changes))


PANE: Final = {"type": "sheet", "name": "pane", "material": "pane", "size": ["9 mm", "9 mm"]}


RING: Final[dict[str, Any]] = {
    "type": "ring",
    "name": "ring",
    "position": ["0 mm", "0 mm", "400 mm"],
    "look_at": ["0 mm", "0 mm", "0 mm"],
    "diameter": "60 mm",
    "radiance": "10 kW/m^2/sr",
    "beam": {"profile": "lambertian"},
}


def with_pane(table: dict[str, Any]) -> Scene:
    """A sheet of that material above the board."""
    pane = {**PANE, "position": ["0 mm", "0 mm", "60 mm"]}
    return small(materials={**SMALL["materials"], "pane": table}, targets=[*SMALL["targets"], pane])


@pytest.fixture
def worth_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Any scene has work enough for the compiled tracer."""
    monkeypatch.setattr(tracer_choice, "WORTH_COMPILED", 1)


def test_a_small_scene_is_left_to_radiance_by_a_count() -> None:
    scene, work = small(), 20 * 24
    certified = 17 * work  # so few pixels are all looked at, by two of each of four pairs, twice
    assert candidate(scene, RenderOptions()) == TracerUsed(
        "radiance", f"{certified} rays times sources at least, below {tracer_choice.WORTH_COMPILED}"
    )
    assert candidate(scene, RenderOptions(viewpoints=37)).reason.startswith(f"{37 * work} rays")
    many = RenderOptions(viewpoints=2100)
    assert candidate(scene, many) == TracerUsed("compiled", f"{2100 * work} rays times sources at least")
    assert candidate(scene, replace(many, tracer="radiance")) == TracerUsed("radiance", "asked for")


def test_of_waves_the_rays_count_that_measure_them() -> None:
    """A washer under 24 LEDs took Radiance 8 s at 102 x 85 pixels, and the compiled tracer 4 s."""
    assert tracer_choice.WAVE_RAYS == MOST_RAYS
    few, many = (small(sources=[RING | {"count": count}], **{"camera.diffraction": "auto"}) for count in (1, 12))
    assert candidate(few, RenderOptions()).reason.startswith(f"{17 * 20 * 24 + MOST_RAYS} rays")
    assert candidate(many, RenderOptions()).name == "compiled"
    assert candidate(many, RenderOptions(viewpoints=7)).name == "radiance"


def test_sources_of_a_basis_count_by_themselves() -> None:
    """Of each Radiance begins programs of its own and follows all primary rays anew."""
    few, many = (small(sources=[RING | {"count": count}]) for count in (3, 5))
    basis = RenderOptions(tolerance=8.0, basis=True)
    assert candidate(few, basis).name == "radiance"
    used = candidate(many, basis)
    assert used.name == "compiled" and "a basis of 5 sources" in used.reason
    assert candidate(many, replace(basis, basis=False)).name == "radiance"


def test_of_a_small_image_its_certificate_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracer_choice, "WORTH_COMPILED", 17 * 20 * 24)
    assert candidate(small(), RenderOptions()).name == "compiled"
    assert candidate(small(), RenderOptions(viewpoints=7)).name == "radiance"
    assert candidate(small(**{"camera.aperture.diameter": "0 mm"}), RenderOptions()).name == "radiance"


TENT: Final = {"type": "surround", "name": "tent", "radiance": "40 W/m^2/sr"}


def test_however_small_an_image_a_wide_light_is_not_cut_where_it_may_shine_whole() -> None:
    """Radiance took a minute for 40 x 32 pixels in a tent."""
    used = candidate(small(sources=[TENT]), RenderOptions())
    assert used == TracerUsed("compiled", "wide lights shine as a whole: tent")
    assert candidate(small(sources=[TENT]), RenderOptions(tracer="radiance")).name == "radiance"


@pytest.mark.parametrize(
    ("table", "told"),
    [
        ({"type": "mirror", "reflectance": 0.9}, "is a mirror"),
        ({"type": "glass", "transmittance": 0.9, "refractive_index": 1.5}, "is glass"),
    ],
)
def test_what_the_compiled_tracer_cannot_show_goes_to_radiance(
    table: dict[str, Any], told: str, worth_it: None
) -> None:
    scene = with_pane(table)
    used = candidate(scene, RenderOptions())
    assert used.name == "radiance" and used.reason == f"materials.pane {told}"
    with pytest.raises(InputError, match=told) as error:
        candidate(scene, RenderOptions(tracer="compiled"))
    assert error.value.where == "tracer"
    # A material that nothing wears is no reason.
    unused = small(materials={**SMALL["materials"], "spare": table})
    assert candidate(unused, RenderOptions()).name == "compiled"


def test_walks_are_counted_by_what_the_tolerance_asks_for() -> None:
    """Pixels times walks times places of each times sources and what else Radiance is asked for there."""
    scene = small()
    pixels, sources = 20 * 24, 1
    assert len(scene.emitters) == sources
    for bounces, tolerance, walks, places in ((1, 500.0, 24, 2), (2, 500.0, 24, 3), ("all", 500.0, 24, 4)):
        options = RenderOptions(bounces=bounces, tolerance=tolerance)
        work = pixels * walks * places * (sources + 2)
        assert candidate(scene, options).reason == (
            f"about {work} rays of walks times sources, below {tracer_choice.WORTH_COMPILED}"
        )
    sensor = scene.camera.sensor
    fine = math.ceil(((sensor.saturation_gray - sensor.dark_gray) / 2 / 0.5) ** 2)
    assert candidate(scene, RenderOptions(bounces="all")) == TracerUsed(
        "compiled", f"about {pixels * fine * 4 * 3} rays of walks times sources"
    )
    # Whether "auto" means walks is known once light was traced: it is decided as without them.
    assert candidate(scene, RenderOptions(bounces="auto")) == candidate(scene, RenderOptions())
    assert candidate(scene, RenderOptions(bounces="all", tracer="radiance")) == TracerUsed("radiance", "asked for")


def test_without_the_compiler_radiance_traces(worth_it: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "numba", None)
    assert candidate(small(), RenderOptions()) == TracerUsed("radiance", "numba is not installed")
    with pytest.raises(EnvironmentFailure, match="numba") as error:
        candidate(small(), RenderOptions(tracer="compiled"))
    assert "radwrap[fast]" in error.value.remedy


def test_a_compiler_that_is_switched_off_is_not_used(worth_it: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    assert candidate(small(), RenderOptions()) == TracerUsed("radiance", "NUMBA_DISABLE_JIT switches numba off")
    with pytest.raises(EnvironmentFailure, match="NUMBA_DISABLE_JIT"):
        candidate(small(), RenderOptions(tracer="compiled"))
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "0")
    assert candidate(small(), RenderOptions()).name == "compiled"


@dataclass(frozen=True)
class Planted:
    """An engine that answers what another one does, but for an error."""

    engine: Engine
    factor: float = 1.0
    lost: int = 0

    @property
    def name(self) -> EngineName:
        return "compiled"

    versions = property(lambda self: self.engine.versions)
    cpu_s = 0.0

    def tracer(self, scene: Scene, lit: Collection[str] | None = None, *, name: str = "scene") -> Tracer:
        return Off(self.engine.tracer(scene, lit, name=name), self.factor, self.lost)

    def numbered(self) -> Tracer:
        return self.engine.numbered()

    def bouncing(self, scene: Scene, materials: Any, orders: int | None, sure_steps: int = 3) -> Tracer:
        return self.engine.bouncing(scene, materials, orders, sure_steps)


@dataclass(frozen=True)
class Off:
    """A tracer whose radiance is off by a factor, and none of whose first lit rays brings light."""

    tracer: Tracer
    factor: float
    lost: int

    def trace(self, rays: Iterable[Floats]) -> Generator[Floats]:
        for values in self.tracer.trace(rays):
            wrong = values * self.factor
            wrong[np.flatnonzero(values)[: self.lost]] = 0.0
            yield wrong

    def trace_with_distances(self, rays: Iterable[Floats]) -> Generator[tuple[Floats, Floats]]:
        yield from self.tracer.trace_with_distances(rays)

    def distances(self, rays: Iterable[Floats]) -> Generator[Floats]:
        yield from self.tracer.distances(rays)


@pytest.mark.parametrize(
    ("factor", "lost", "agrees"),
    [(1.0, 0, True), (1 + 1e-5, 0, True), (1 + 1e-4, 0, False), (1.0, 2, True), (1.0, 3, False)],
)
def test_an_error_of_the_compiled_tracer_is_seen(factor: float, lost: int, agrees: bool, worth_it: None) -> None:
    """Of all rays by 1e-4, or of more rays than may meet a rim on its other side."""
    scene, asked = small(), TracerUsed("compiled", "asked for")
    with laid_out(scene, RenderOptions(tracer="compiled")) as traced:
        reference = traced.radiance_view().tracer
        planted = Planted(traced._engine, factor, lost)
        rays = probe_rays(scene.camera, planted.numbered())
        used = compared(asked, RenderOptions(), probed(reference, planted, scene, rays))
        assert used.probe is not None and used.probe.rays == 512 and used.probe.agree == agrees
        assert used.name == ("compiled" if agrees else "radiance")
        assert used.probe.differing == (lost if factor < 1 + 2e-5 else pytest.approx(512, abs=200))
        if not agrees:
            with pytest.raises(EnvironmentFailure, match=f"differ on {used.probe.differing} of 512 rays"):
                compared(asked, RenderOptions(tracer="compiled"), probed(reference, planted, scene, rays))


@dataclass(frozen=True)
class Told:
    """A tracer that answers what it was told."""

    values: Floats

    def trace(self, rays: Iterable[Floats]) -> Generator[Floats]:
        for _ in rays:
            yield self.values.copy()

    trace_with_distances = distances = trace  # type: ignore[assignment]  # nobody asks for distances here


def test_agreement_by_closed_forms() -> None:
    rays, ones = np.zeros((1000, 6)), np.ones(1000)
    same = agreement(Told(ones), Told(ones * (1 + 1e-5)), rays)
    assert same.agree and same.differing == 0
    assert same.largest_relative_difference == pytest.approx(1e-5)
    assert same.rms_relative_difference == pytest.approx(1e-5 * np.sqrt(0.998))  # but for two rays
    # The loss of a source of 80 on a few rays, as Radiance's meshes have it, is little together; of half a source not.
    for lost, agrees in ((1 / 80, False), (1e-3, True)):
        values = ones.copy()
        values[:20] -= lost
        found = agreement(Told(ones), Told(values), rays)
        assert found.differing == 20 and found.agree == agrees
        assert found.rms_relative_difference == pytest.approx(lost * np.sqrt(18 / 1000))
    values[:21] = 1 - 1e-3
    assert not agreement(Told(ones), Told(values), rays).agree
    # What is dark is held to a millionth of the brightest.
    dark = np.r_[1.0, np.zeros(999)]
    assert agreement(Told(dark), Told(dark + 1e-11), rays).agree
    assert not agreement(Told(dark), Told(dark + 1e-10), rays).agree
    assert agreement(Told(0 * ones), Told(0 * ones), rays).agree
    assert not agreement(Told(0 * ones), Told(1e-9 * ones), rays).agree
    assert agreement(Told(0 * ones), Told(1e-40 * ones), rays, nothing=1e-30).agree
    assert not agreement(Told(0 * ones), Told(1e-29 * ones), rays, nothing=1e-30).agree


def test_half_of_the_probe_lies_where_parts_end() -> None:
    """Rays in pairs 0.045 pixels or less from a step: neighbours there see different parts."""
    scene = small()
    with laid_out(scene, RenderOptions(tracer="compiled")) as traced:
        numbered = traced.numbered_tracer()
        rays = probe_rays(scene.camera, numbered)
        assert rays.shape == (512, 6)
        central = rays[:256]
        assert np.allclose(central[:, :3], scene.camera.pose.position)
        sides = scene.camera.sensor.pixel_width * 0.06
        right, up = np.asarray(scene.camera.pose.rotation).T[:2] * sides
        own = next(numbered.trace([central]))
        differs = np.zeros(256, dtype=bool)
        for turn in np.linspace(0, 2 * np.pi, 24, endpoint=False):
            near = central.copy()
            near[:, 3:] += np.cos(turn) * right + np.sin(turn) * up
            differs |= next(numbered.trace([near])) != own
        assert differs.mean() > 0.99


def seen_past_a_bar(look_at: list[str], **changes: Any) -> Scene:
    """A sheet of 1 mm in pixels of 20 um, and a bar between it and the camera, whose back takes some of the view."""
    bar = {
        "type": "rectangle",
        "name": "bar",
        "position": ["-0.8735 mm", "-0.0136 mm", "12.1654 mm"],
        "look_at": look_at,
        "up": [0.1, 0.2, 0.97],
        "size": ["7.9435 mm", "0.8874 mm"],
        "radiance": "100 W/m^2/sr",
    }
    pixels = {"rows": 40, "columns": 40, "pixel_width": "10 um", "pixel_height": "10 um", "gain": "1e5 (J/m^2)^-1"}
    camera = {
        "position": ["0 mm", "0 mm", "20 mm"],
        "look_at": ["0 mm", "0 mm", "0 mm"],
        "focal_length": "10 mm",
        "exposure_time": "10 ms",
        "aperture": {"diameter": "0.1 mm"},
        "sensor": {**pixels, "gamma": 1.0, "dark_gray": 4, "saturation_gray": 255},
    }
    return radwrap.scene_from_document(
        {
            "camera": camera,
            "sources": [bar | changes],
            "materials": {"white": {"type": "lambertian", "reflectance": 0.5}},
            "targets": [{"type": "sheet", "name": "sheet", "material": "white", "size": ["1 mm", "1 mm"]}],
        }
    )


@pytest.mark.parametrize(
    "scene",
    [
        # Radiance's patches there are larger by 4 nm, and half of the probe lies within 0.2 um of their rim.
        seen_past_a_bar(["2.3415 mm", "4.3499 mm", "0 mm"]),
        # A beam of 3 degrees that passes 40 degrees beside the sheet: below 1e-45, which float32 has not.
        seen_past_a_bar(["0 mm", "15 mm", "0 mm"], beam={"profile": "gaussian", "width": "3 deg"}),
    ],
    ids=["rim", "nothing"],
)
def test_what_no_image_shows_is_not_held_against_a_tracer(scene: Scene) -> None:
    with laid_out(scene, RenderOptions(tracer="compiled")) as traced:
        assert traced.tracers_agree()
        probe = traced.tracer_used.probe
        assert probe is not None and probe.agree and probe.differing <= 1


def test_both_tracers_make_the_same_image(tmp_path: Path) -> None:
    """To the last digits of Radiance's float32, with the same truth; the manifest says who traced."""
    scene, made = small(), {}
    for name in ("radiance", "compiled"):
        made[name] = radwrap.render(scene, tmp_path / name, tracer=name, tolerance=1.0, truth=True, workers=2)
        assert made[name].manifest["tracer"]["name"] == name
        assert ("numba" in made[name].manifest["versions"]) == (name == "compiled")
    first, second = made["radiance"], made["compiled"]
    expected = first.radiant_exposure.values
    assert np.abs(second.radiant_exposure.values - expected).max() <= FLOAT32 * expected.max()
    assert second.manifest["tracer"]["probe"]["agree"] and "probe" not in first.manifest["tracer"]
    assert first.truth is not None and second.truth is not None
    assert (first.truth["mask"] == second.truth["mask"]).all()
    assert np.abs(first.truth["depth"] - second.truth["depth"]).max() <= FLOAT32
    assert first.run.run_sha256 != second.run.run_sha256
    assert second.run.timing.tracer_cpu_s > 0
    alone = radwrap.render(scene, tmp_path / "alone", tracer="compiled", tolerance=1.0, truth=True, workers=1)
    for name in ("radiant_exposure.exr", "depth.exr", "mask.png"):
        assert (tmp_path / "alone" / name).read_bytes() == (tmp_path / "compiled" / name).read_bytes()
    assert alone.run.run_sha256 == second.run.run_sha256


def in_a_corner() -> Scene:
    """Two sheets that light each other."""
    gray = {"type": "lambertian", "reflectance": 0.5}
    shiny = {"type": "specular", "diffuse_reflectance": 0.3, "specular_reflectance": 0.4, "roughness": 0.1}
    sheet = {"type": "sheet", "size": ["80 mm", "80 mm"]}
    wall = {**sheet, "name": "wall", "material": "shiny"}
    wall |= {"position": ["15 mm", "0 mm", "40 mm"], "rotation": ["0 deg", "-90 deg", "0 deg"]}
    floor = {**sheet, "name": "floor", "material": "gray"}
    return small(materials={"gray": gray, "shiny": shiny}, targets=[floor, wall])


def test_both_tracers_walk_the_same_ways(tmp_path: Path) -> None:
    """The manifest holds the comparison of walks; a warm scene comes by it in the same way."""
    scene, made = in_a_corner(), {}
    how: dict[str, Any] = {"bounces": "all", "sampling": SamplingPlan("rays", rays=16, replicates=2)}
    for name in ("radiance", "compiled"):
        made[name] = radwrap.render(scene, tmp_path / name, tracer=name, workers=2, **how)
    first, second = made["radiance"], made["compiled"]
    assert "walks" not in first.manifest["tracer"]
    walks = second.manifest["tracer"]["walks"]
    assert walks["agree"] and walks["rays"] == 512 and walks["differing"] < 0.02 * 512
    assert walks["largest_relative_difference"] > 0  # walks, not direct light
    assert first.manifest["rays"] == second.manifest["rays"]
    both = [one.radiant_exposure.values for one in (first, second)]
    # Some walks of a few per pixel pass the wall's rim on its other side.
    assert math.sqrt(np.mean((both[1] - both[0]) ** 2)) < 0.01 * both[0].max()
    assert np.median(np.abs(both[1] - both[0])) <= FLOAT32 * both[0].max()
    alone = radwrap.render(scene, tmp_path / "alone", tracer="compiled", workers=1, **how)
    assert (tmp_path / "alone" / "gray.png").read_bytes() == (tmp_path / "compiled" / "gray.png").read_bytes()
    assert alone.run.run_sha256 == second.run.run_sha256
    with radwrap.warm(scene, RenderOptions(tracer="compiled", **how)) as live:
        assert (live.render().radiant_exposure.values == both[1]).all()
        assert live.render().manifest["tracer"]["walks"] == walks


def test_walks_that_differ_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Direct light is the same; what is off by a thousandth are the walks alone."""
    from radwrap.tracers.compiled.engine import CompiledEngine

    asked = CompiledEngine.bouncing

    def brighter(engine: Any, *how: Any) -> Any:
        return Off(asked(engine, *how), 1.001, 0)

    monkeypatch.setattr(CompiledEngine, "bouncing", brighter)
    monkeypatch.setattr(tracer_choice, "WORTH_COMPILED", 1)
    scene, how = in_a_corner(), RenderOptions(bounces=2, tolerance=20.0)
    with laid_out(scene, how) as traced:
        used = traced.tracer_used
        assert used.name == "radiance" and used.probe is not None and used.probe.agree
        assert used.walks is not None and not used.walks.agree
        assert used.reason == f"the compiled tracer and Radiance differ on {used.walks.differing} of 512 walks"
    with pytest.raises(EnvironmentFailure, match="of 512 walks"), laid_out(scene, replace(how, tracer="compiled")):
        pass
    with laid_out(scene, replace(how, bounces=0)) as traced:
        assert traced.tracer_used.name == "compiled" and traced.tracer_used.walks is None


def test_walks_that_nobody_knows_are_not_compared(worth_it: None) -> None:
    """With "auto" sheeting is refused where bounces matter, and by whoever comes to trace them."""
    beads = {"type": "retroreflective", "model": "coefficient", "function": "glass_beads", "outside": "hold"}
    scene = with_pane({**beads, "anchor": "95 cd/lx/m^2"})
    with laid_out(scene, RenderOptions(bounces="auto")) as traced:
        assert traced.tracer_used.name == "compiled" and traced.tracer_used.walks is None


def test_a_basis_by_the_compiled_tracer_adds_up(tmp_path: Path) -> None:
    """One image for each source, whose sum is the image with all of them."""
    lamp = SMALL["sources"][0]
    scene = small(sources=[lamp, {**lamp, "name": "other", "position": ["-60 mm", "20 mm", "400 mm"]}])
    made = radwrap.render(scene, tmp_path, tracer="compiled", tolerance=1.0, basis=True)
    (again,) = relit(read_basis(tmp_path), [[1.0, 1.0]])
    expected = made.radiant_exposure.values
    assert np.abs(again.radiant_exposure.values - expected).max() <= 10 * FLOAT32 * expected.max()
