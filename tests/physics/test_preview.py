"""What is foretold without the tracer against the tracer: what each ray meets, and the brightest point in view."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.frames import rotation_about_fixed_axes
from radwrap.imaging.forecast import closed_form, preview
from radwrap.imaging.forecast.preview import brightest, look
from radwrap.scene.look.geometry import directions
from radwrap.scene.look.intersections import Bounded, first_hit, reached

LAMP_BEHIND = 1e-4  # m, of the eye: what it sees is lit, but for slivers along outlines
# The lamp's disc of 1 mm at 0.3 m and more, (r/z)^2, with the tracer's float32.
CLOSE_LAMP = 1e-5
OUTLINES = 0.02  # share of pixels on outlines, where rays in their last digits or slivers of shadow may differ
BETWEEN_PIXELS = 0.01  # the brightest point lies between pixel centres, a spot has 20 of them across
COUNTED = 0.1  # of 151 sub-viewpoints 19 see the disc of 3 mm, give or take those on its rim
RIM = 0.03  # the brightest point is a corner, up to a pixel of 2.7 mm from the next pixel's centre, 51 mm from the foot

MATT = {"type": "lambertian", "reflectance": 0.5}
MATERIALS = {"a": MATT, "b": MATT | {"reflectance": 0.8}}


def placed(kind: str, x: float, y: float, z: float = 0.0, **more: Any) -> dict[str, Any]:
    turn = ["35 deg", "-25 deg", "10 deg"]
    place = [f"{x} mm", f"{y} mm", f"{z} mm"]
    return {"type": kind, "name": kind, "material": "a", "position": place, "rotation": turn} | more


TARGETS = {
    "sheet": placed("sheet", 0, 0, size=["50 mm", "30 mm"]),
    "board": placed(
        "board", 0, 0, dot_material="b", rows=3, columns=4, pitch="12 mm", dot_diameter="9 mm", margin="3 mm"
    ),
    "edge": placed("edge", 0, 0, edge_material="b", size=["50 mm", "30 mm"], edge_position="4 mm"),
    "polygon": placed(
        "polygon", 0, 0, vertices=[[f"{x} mm", f"{y} mm"] for x, y in ((-30, -20), (30, -20), (0, -5), (25, 25))]
    ),
    "disc": placed("disc", 0, 0, diameter="50 mm"),
    "sphere": placed("sphere", 0, 0, diameter="50 mm"),
    "cylinder": placed("cylinder", 0, 0, diameter="30 mm", length="40 mm"),
    "box": placed("box", 0, 0, size=["20 mm", "40 mm", "50 mm"]),
}


def some(*names: str) -> list[Any]:
    """All kinds of targets, the others long."""
    return [name if name in names else pytest.param(name, marks=pytest.mark.long) for name in TARGETS]


def camera(bench: Any, eye: tuple[float, float, float], pixels: int = 60, field: float = 0.2) -> dict[str, Any]:
    found: dict[str, Any] = bench.camera(eye, rows=pixels, columns=pixels, pitch=(field * 0.01 / pixels,) * 2)
    return found


def pixel_rays(scene: radwrap.Scene) -> np.ndarray:
    sensor = scene.camera.sensor
    uv = np.stack(np.meshgrid(np.arange(sensor.columns), np.arange(sensor.rows)), axis=-1).reshape(-1, 2)
    return directions(scene.camera, uv.astype(float))


@pytest.mark.parametrize("names", [*([name] for name in TARGETS), ["disc", "box", "sphere"]], ids="-".join)
def test_every_ray_sees_what_the_tracer_sees(bench: Any, names: list[str]) -> None:
    eye = np.array([0.05, -0.1, 0.4])
    lamp = bench.lamp(eye * (1 + LAMP_BEHIND / np.linalg.norm(eye)))
    facing = bench.lamp((0.02, -0.05, 0.2), eye, diameter=8e-3, radiant_intensity=1e-6, name="facing")
    places = [["0 mm", "0 mm", "0 mm"], ["12 mm", "9 mm", "-20 mm"], ["-20 mm", "0 mm", "10 mm"]]
    targets = [TARGETS[name] | {"position": place} for name, place in zip(names, places, strict=False)]
    scene = bench.scene(camera(bench, eye), [lamp, facing], MATERIALS, targets)
    expected = bench.image(scene).ravel()
    seen = look(scene, pixel_rays(scene))
    found = np.where(seen.number < 0, 0.0, seen.value)
    off = np.abs(found - expected) > CLOSE_LAMP * expected
    assert off.mean() <= OUTLINES
    assert {name for number, name in enumerate(seen.names) if (seen.number == number).sum() > 20} == {
        (name, material) for name in names for material in (("a", "b") if name in ("board", "edge") else ("a",))
    } | {("facing", "light")}


@pytest.mark.parametrize("name", TARGETS)
def test_no_ray_that_meets_a_target_is_left_out_beforehand(bench: Any, name: str) -> None:
    random = np.random.default_rng(3)
    scene = bench.scene(
        camera(bench, np.array([0.05, -0.1, 0.4])), [bench.lamp((0.0, 0.0, 0.5))], MATERIALS, [TARGETS[name]]
    )
    (target,) = scene.targets
    for eye in random.uniform(-0.05, 0.05, (20, 3)):  # outside and inside
        rays = random.normal(size=(500, 3))
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        met = np.isfinite(first_hit(target, eye, rays)[0])
        numbers = [number for _, found in reached(Bounded.of(scene.targets), tuple(eye), rays) for number in found]
        assert set(np.flatnonzero(met)) <= set(numbers)
    far = np.array([[0.0, 0.0, 1.0]])
    assert not list(reached(Bounded.of(scene.targets), (0.0, 0.0, 1.0), far))  # behind
    assert not list(reached(Bounded.of(scene.targets), (1.0, 0.0, -1.0), far))  # beside


@pytest.mark.parametrize("name", some("board", "cylinder"))
def test_a_narrow_beam_on_a_large_target_is_found(bench: Any, name: str) -> None:
    """A spot of 2.4 mm, between the points of any grid on the target."""
    large = TARGETS[name] | {key: "600 mm" for key in ("diameter", "length") if key in TARGETS[name]}
    if "size" in large:
        large |= {"size": ["500 mm", "600 mm", "700 mm"][: len(large["size"])]}
    if name == "board":
        large |= {"pitch": "120 mm", "dot_diameter": "90 mm"}
    if name == "polygon":
        large |= {"vertices": [["-300 mm", "-200 mm"], ["300 mm", "-200 mm"], ["0 mm", "-50 mm"], ["250 mm", "250 mm"]]}
    eye, aim = (0.3, -0.2, 1.5), (0.0437, -0.0731, 0.1)
    led = bench.lamp((0.5, 0.1, 1.4), aim, half_angle=0.05)
    scene = bench.scene(camera(bench, eye, pixels=900, field=0.8), [led], MATERIALS, [large])
    expected = bench.image(scene).max()
    assert expected > 0
    peak = brightest(scene)
    assert peak is not None and peak.target == name
    assert peak.radiance == pytest.approx(expected, rel=BETWEEN_PIXELS)
    told = radwrap.explain(scene)
    assert told["expected_peak"]["irradiance"] == pytest.approx(peak.radiance * math.pi / 4 * 1e-8 / 1e-4, rel=1e-12)
    assert "no light" not in told["advice"]


@pytest.mark.parametrize("name", some("sheet", "sphere"))
def test_a_sharp_highlight_is_found(bench: Any, name: str) -> None:
    """Of a roughness that lets the lobe underflow at all rays of the first look but for the highlight's own."""
    glossy = {"type": "specular", "diffuse_reflectance": 0.0, "specular_reflectance": 0.5, "roughness": 0.004}
    lamp = bench.lamp((-0.25, 0.2, 0.6), (0, 0, 0), diameter=1e-4)
    target = TARGETS[name] | {"rotation": ["20 deg", "-10 deg", "10 deg"]}
    eye = mirrored_eye(target, np.array([-0.25, 0.2, 0.6])) if name != "sphere" else np.array([0.1, 0.3, 0.8])
    scene = bench.scene(camera(bench, eye, pixels=900, field=0.12), [lamp], {"a": glossy, "b": glossy}, [target])
    expected = bench.image(scene).max()
    peak = brightest(scene)
    assert peak is not None and expected > 0
    # Never less than a pixel has, and where the highlight is wide enough no more.
    assert peak.radiance >= expected * (1 - BETWEEN_PIXELS)
    assert peak.radiance <= expected * 1.5


def mirrored_eye(target: dict[str, Any], light: np.ndarray) -> np.ndarray:
    """An eye that sees the light mirrored at the target's centre, or at the face of a solid above it."""
    turn = [math.radians(float(angle.split()[0])) for angle in target["rotation"]]
    normal = np.array(rotation_about_fixed_axes(turn))[:, 2]
    foot = normal * {"box": 0.025, "cylinder": 0.02}.get(target["type"], 0.0)
    to_light = light - foot
    return foot + 2 * (to_light @ normal) * normal - to_light


def test_a_polygon_ends_at_its_sides(bench: Any) -> None:
    """A lamp over the notch of an L: nothing there is lit, whatever the bounding rectangle says."""
    corners = [(0, 0), (200, 0), (200, 40), (40, 40), (40, 200), (0, 200)]
    shape = placed("polygon", 0, 0, vertices=[[f"{x} mm", f"{y} mm"] for x, y in corners], rotation=["0 deg"] * 3)
    eye = (0.1, 0.1, 1.0)
    lamp = bench.lamp((0.15, 0.15, 0.1), (0.15, 0.15, 0), half_angle=20.0)
    scene = bench.scene(
        bench.camera(eye, (0.1, 0.1, 0), rows=90, columns=90, pitch=(3e-5, 3e-5)), [lamp], MATERIALS, [shape]
    )
    assert bench.image(scene).max() == 0
    told = radwrap.explain(scene)
    assert told["expected_peak"]["radiant_exposure"] == 0
    assert told["advice"].startswith("no light was found")
    wide = bench.lamp((0.15, 0.15, 0.1), (0.15, 0.15, 0), half_angle=75.0)
    scene = radwrap.with_value(scene, "sources", [wide])
    assert brightest(scene).radiance == pytest.approx(bench.image(scene).max(), rel=RIM)


def test_a_lit_disc_that_is_seen_is_the_peak(bench: Any) -> None:
    sheet = TARGETS["sheet"]
    facing = bench.lamp((0.025, 0.0, 0.2), (0.05, 0, 0.4), diameter=8e-3, radiant_intensity=1.0, name="facing")
    away = bench.lamp((0.025, 0.0, 0.2), (0.0, 0, 0), diameter=8e-3, radiant_intensity=1.0, name="facing")
    eye = (0.05, 0, 0.4)
    scene = bench.scene(camera(bench, eye), [facing], MATERIALS, [sheet])
    peak = brightest(scene)
    assert (peak.target, peak.material) == ("facing", "light")
    assert peak.radiance == pytest.approx(bench.image(scene).max(), rel=1e-4)  # its middle lies between pixels
    turned = radwrap.with_value(scene, "sources", [away])
    assert brightest(turned).target == "sheet"


@pytest.mark.parametrize("diameter", [pytest.param(3e-3, marks=pytest.mark.long), 6e-3])
def test_a_lit_disc_that_is_smaller_than_its_blur(bench: Any, diameter: float) -> None:
    """Of 3 and 6 mm, 0.2 m away; its blur is 0.4 mm (1 + 0.2/0.01) = 8.4 mm wide there."""
    facing = bench.lamp((0.025, 0.0, 0.2), (0.05, 0, 0.4), diameter=diameter, radiant_intensity=1.0, name="facing")
    made = camera(bench, (0.05, 0, 0.4), pixels=21) | {"aperture": {"diameter": "0.4 mm"}}
    scene = bench.scene(made, [facing], MATERIALS, [TARGETS["sheet"]])
    middle = radwrap.render(scene, viewpoints=151, layout="sunflower").radiant_exposure.values.max()
    peak = radwrap.explain(scene)["expected_peak"]
    assert peak["radiant_exposure"] == pytest.approx(middle, rel=COUNTED)
    assert peak["target"] == "facing"


def test_no_time_is_not_no_light(bench: Any) -> None:
    scene = bench.scene(camera(bench, (0, 0, 0.4)), [bench.lamp((0, 0.1, 0.4))], MATERIALS, [TARGETS["sheet"]])
    advised = radwrap.explain(scene)["expected_peak"]
    told = radwrap.explain(radwrap.with_value(scene, "camera.exposure_time", "0 s"))
    assert told["advice"].startswith("the exposure time is 0 s, so the image stays dark; an exposure time of ")
    seconds = float(told["advice"].split(" of ")[1].split(" ms")[0]) / 1e3
    assert advised["irradiance"] * seconds == pytest.approx(0.8 * 65535, rel=1e-3)  # gain 1, gamma 1


WIDE: dict[str, dict[str, Any]] = {
    "measured falloff": {"lens": {"focus_distance": "1 m", "relative_illumination": [["0 mm", 1.0], ["8 mm", 0.9]]}},
    "stretch": {"distortion": {"model": "opencv", "k1": -0.2}},
}


@pytest.mark.parametrize("name", WIDE)
def test_the_peak_is_weighed_as_the_image_is(bench: Any, name: str) -> None:
    """A spot near the image's corner, 24 degrees off the axis, where cos^4 is 0.7."""
    led = bench.lamp((0.35, 0.25, 0.5), (0.35, 0.25, 0), half_angle=2.0)
    made = camera(bench, (0, 0, 1.0), pixels=200, field=1.0) | WIDE[name]
    sheet = placed("sheet", 0, 0, size=["2 m", "2 m"], rotation=["0 deg"] * 3)
    scene = bench.scene(made, [led], MATERIALS, [sheet])
    expected = bench.image(scene).max()
    assert brightest(scene).radiance == pytest.approx(expected, rel=BETWEEN_PIXELS)
    plain = bench.scene({key: value for key, value in made.items() if key not in WIDE[name]}, [led], MATERIALS, [sheet])
    assert abs(brightest(plain).radiance / expected - 1) > 10 * BETWEEN_PIXELS


def test_many_targets_are_shaded_by_material(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """100 sheets of two materials are shaded twice for a lamp, and look as each does by itself."""
    sheets = [
        {
            "type": "sheet",
            "name": f"s{number}",
            "material": "ab"[number % 2],
            "size": ["6 mm", "6 mm"],
            "position": [f"{10 * (number % 10) - 45} mm", f"{10 * (number // 10) - 45} mm", "0 mm"],
            "rotation": ["0 deg", "0 deg", f"{number} deg"],
        }
        for number in range(100)
    ]
    lamps, eye = [bench.lamp((0.0, 0.0, 0.5))], camera(bench, np.array([0.0, 0.0, 0.4]))
    scene = bench.scene(eye, lamps, MATERIALS, sheets)
    rays = np.array([target.pose.position for target in scene.targets]) - scene.camera.pose.position
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    alone = [
        look(replace(scene, targets=(target,)), ray[np.newaxis]).value[0]
        for target, ray in zip(scene.targets, rays, strict=True)
    ]
    shaded = []
    monkeypatch.setattr(preview, "radiance", lambda *what: shaded.append(what[0]) or closed_form.radiance(*what))
    seen = look(scene, rays)
    assert len(shaded) == 2
    assert [seen.names[number][0] for number in seen.number] == [target.name for target in scene.targets]
    np.testing.assert_allclose(seen.value, alone, rtol=1e-12)
