"""Checks before the trace: what a beam lights and a camera sees, between the points of any grid on the target."""

import copy
import math
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.scene.look.checks import source_width_error, warnings_of
from radwrap.scene.look.geometry import signed_distance
from radwrap.scene.look.intersections import Bounded, first_hit, nearest_point
from radwrap.scene.targets import Target

BENCH = Path(__file__).parents[2] / "rad_scenes" / "bench_board" / "scene.toml"

START = Path(__file__).parents[2] / "radwrap" / "data" / "init" / "scene.toml"

# The nearest lit point may lie where a beam's rim crosses a target's border: it is sought, not solved for.
SAMPLED = 0.05
SLOPE = 0.1  # within 6 degrees a sphere's surface, 20 degrees to the side, is up to 4 % nearer than on the axis
ROUNDING = 1e-12  # m, of closed forms in a scene of 1 m

TURNED = {"position": ["20 mm", "-30 mm", "10 mm"], "rotation": ["30 deg", "-20 deg", "50 deg"]}
TARGETS: dict[str, dict[str, Any]] = {
    "sheet": {"type": "sheet", "size": ["600 mm", "400 mm"]},
    "board": {
        "type": "board",
        "dot_material": "sheeting",
        "rows": 4,
        "columns": 6,
        "pitch": "100 mm",
        "dot_diameter": "60 mm",
    },
    "edge": {"type": "edge", "edge_material": "sheeting", "size": ["600 mm", "400 mm"], "edge_position": "80 mm"},
    "polygon": {
        "type": "polygon",
        "vertices": [[f"{x} mm", f"{y} mm"] for x, y in ((-300, -200), (300, -200), (0, -50), (250, 250))],
    },
    "disc": {"type": "disc", "diameter": "600 mm"},
    "sphere": {"type": "sphere", "diameter": "500 mm"},
    "cylinder": {"type": "cylinder", "diameter": "400 mm", "length": "300 mm"},
    "box": {"type": "box", "size": ["300 mm", "400 mm", "500 mm"]},
}


@pytest.fixture
def document() -> dict[str, Any]:
    return tomllib.loads(START.read_text())


def lit_by(document: dict[str, Any], target: dict[str, Any], **led: Any) -> dict[str, Any]:
    made = copy.deepcopy(document)
    made["targets"] = [{"name": "thing", "material": "black", **target}]
    made["sources"] = [
        {
            "type": "led",
            "name": "led",
            "radiance": "1 W/m^2/sr",
            "diameter": "2 mm",
            "beam": {"profile": "cone", "width": "6 deg", "width_definition": "half_angle"},
            **led,
        }
    ]
    return made


def metres(*values: float) -> list[str]:
    return [f"{float(value)!r} m" for value in values]


@pytest.mark.parametrize("name", TARGETS)
def test_a_close_narrow_beam_is_refused(document: dict[str, Any], name: str) -> None:
    """2 mm wide and 5.5 mm away, (r/d)^2 = 3.3 %; its spot is 1 mm wide, on a target of half a metre."""
    target = radwrap.scene_from_document(lit_by(document, TARGETS[name], **FAR)).targets[0]
    probe = np.array([0.0437, -0.0731, 1.0])
    distance, _ = first_hit(target, probe, np.array([[0.0, 0.0, -1.0]]))
    point = probe - [0, 0, distance[0]]
    place = metres(*(point + np.array([0, 0, 0.0055])))
    with pytest.raises(InputError, match=r"too wide for its distance: its irradiance would be off by up to [34]%"):
        radwrap.scene_from_document(lit_by(document, TARGETS[name], position=place, look_at=metres(*point)))
    further = lit_by(
        document, TARGETS[name], position=metres(*(point + np.array([0, 0, 0.02]))), look_at=metres(*point)
    )
    scene = radwrap.scene_from_document(further)
    assert source_width_error(Bounded.of(scene.targets), scene.emitters[0]) == pytest.approx(0.0025, rel=SLOPE)
    assert warnings_of(scene)[0].startswith('"led" is close to what it lights: irradiance off by up to 0.2')


FAR = {"position": ["0 m", "0 m", "1 m"], "look_at": ["0 m", "0 m", "0 m"]}


@pytest.mark.parametrize("draws", [5, pytest.param(12, marks=pytest.mark.long)])
@pytest.mark.parametrize(
    ("name", "profile"),
    [
        pytest.param(name, profile, marks=[pytest.mark.long] if (i + j) % 2 else [])
        for i, name in enumerate(TARGETS)
        for j, profile in enumerate(["cone", "gaussian", "lambertian"])
    ],
)
def test_the_nearest_lit_point_is_found(document: dict[str, Any], name: str, profile: str, draws: int) -> None:
    """Against 100 000 rays drawn within the beam, for sources that stand and look anyhow.

    A point that is overlooked fails each draw that meets it: five draws of 24 cases, of which each looks at one at
    least, show a fault of a shape or a profile; twelve show rarer places too (long).
    """
    random = np.random.default_rng(7)
    beam: dict[str, Any] = {"profile": profile}
    if profile != "lambertian":
        beam |= {"width": "12 deg", "width_definition": "half_angle"}
    hits = 0
    for _ in range(draws):
        away = random.normal(size=3)
        place = away / np.linalg.norm(away) * random.uniform(0.45, 0.6)
        # Wide enough for an error that is looked for, narrow enough to be accepted.
        made = lit_by(
            document,
            TARGETS[name] | TURNED,
            position=metres(*place),
            look_at=metres(*random.uniform(-0.15, 0.15, 3)),
            diameter="50 mm",
            beam=beam,
        )
        made["camera"]["position"], made["camera"]["look_at"] = metres(0, 0, 3), metres(0, 0, 0)
        try:
            scene = radwrap.scene_from_document(made)
        except InputError as error:
            assert "too wide" in str(error)
            continue
        emitter = scene.emitters[0]
        rays = random.normal(size=(100_000, 3)) * 0.35 + np.asarray(emitter.axis)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        distance, _ = first_hit(scene.targets[0], np.asarray(emitter.position), rays)
        lit = emitter.beam.relative_intensity(np.arccos(np.clip(rays @ emitter.axis, -1, 1))) > 1e-4
        nearest = distance[lit].min()
        found = source_width_error(Bounded.of(scene.targets), emitter)
        if np.isfinite(nearest) and (0.025 / nearest) ** 2 > 1e-3:
            hits += 1
            assert found >= (0.025 / nearest) ** 2 * (1 - SAMPLED)
    assert hits >= draws // 4


@pytest.mark.parametrize("name", TARGETS)
def test_the_nearest_point_is_on_the_surface_and_nearest(document: dict[str, Any], name: str) -> None:
    target = radwrap.scene_from_document(lit_by(document, TARGETS[name] | TURNED, **FAR)).targets[0]
    random = np.random.default_rng(3)
    for _ in range(30):
        x, y, z = random.uniform(-0.6, 0.6, 3)
        near, normal = nearest_point(target, (x, y, z))
        assert math.hypot(*normal) == pytest.approx(1)
        distance = math.dist(near, (x, y, z))
        assert distance == pytest.approx(abs(signed_distance(target, (x, y, z))), abs=ROUNDING)
        assert distance <= surface_distances(target, np.array([x, y, z]), random).min() + ROUNDING


def surface_distances(target: Target, point: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """From a point to where rays from far away meet the target."""
    starts = random.normal(size=(2000, 3)) * 2
    rays = random.uniform(-0.3, 0.3, (2000, 3)) - starts
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    distance, _ = first_hit(target, starts, rays)
    met = np.isfinite(distance)
    assert met.sum() > 100
    found: np.ndarray = np.linalg.norm(starts[met] + distance[met, np.newaxis] * rays[met] - point, axis=1)
    return found


SHEETING = {
    "type": "retroreflective",
    "model": "coefficient",
    "observation_angles": ["0.1 deg", "5 deg"],
    "entrance_angles": ["0 deg", "60 deg"],
    "coefficients": [["300 1/sr", "180 1/sr"], ["95 1/sr", "65 1/sr"]],
}


def seen_from_near(document: dict[str, Any], target: dict[str, Any]) -> dict[str, Any]:
    """A camera whose whole field lies between two points of a grid on a large target, an LED beside it."""
    made = lit_by(document, target, position=metres(0.01, 0, 1), look_at=metres(0.033, 0.021, 0))
    made["materials"]["black"] = SHEETING
    made["camera"] |= {"position": metres(0, 0, 1), "look_at": metres(0.033, 0.021, 0)}
    return made


@pytest.mark.parametrize("size", ["0.1 m", "9 m"])
def test_sheeting_is_checked_where_the_camera_looks(document: dict[str, Any], size: str) -> None:
    made = seen_from_near(document, {"type": "sheet", "size": [size, size]})
    assert not warnings_of(radwrap.scene_from_document(made))
    made["sources"][0]["position"] = metres(0.2, 0, 1)
    with pytest.raises(InputError, match=r"observation angles 11\.\d to 11\.\d deg"):
        radwrap.scene_from_document(made)
    made["sources"][0]["position"] = metres(0.01, 0, 1)
    made["targets"][0]["rotation"] = ["70 deg", "0 deg", "0 deg"]
    with pytest.raises(InputError, match="entrance angles up to 7"):
        radwrap.scene_from_document(made)


def test_sheeting_is_not_checked_where_a_polygon_is_not(document: dict[str, Any]) -> None:
    """Its bounding rectangle reaches far to the side; what there is of it is a strip in the middle and a far tip."""
    made = seen_from_near(document, {"type": "polygon", "vertices": [metres(x, y) for x, y in TIP]})
    made["camera"]["look_at"] = metres(0, 0, 0)
    made["sources"][0] |= {"look_at": metres(0, 0, 0), "beam": {"profile": "lambertian"}}
    made["camera"]["focal_length"] = "0.5 mm"
    made["materials"]["black"]["entrance_angles"][1] = "20 deg"
    assert radwrap.scene_from_document(made).targets
    made["targets"][0]["vertices"][2] = metres(0.6, 0.6)
    with pytest.raises(InputError, match="entrance angles up to 4"):
        radwrap.scene_from_document(made)


TIP = ((-0.2, -0.2), (0.2, -0.2), (0.02, 0.3), (-0.2, 0.02))


def test_a_target_that_fills_the_view_is_in_view(document: dict[str, Any]) -> None:
    made = lit_by(document, {"type": "sheet", "size": ["9 m", "9 m"]}, **FAR)
    made["camera"] |= {"position": metres(0, 0, 1), "look_at": metres(0.5, 0.3, 0)}
    assert not warnings_of(radwrap.scene_from_document(made))
    made["camera"]["look_at"] = metres(0.5, 0.3, 2)
    assert warnings_of(radwrap.scene_from_document(made)) == ("no target is in the camera's view",)


def test_places_that_numbers_cannot_hold_are_refused() -> None:
    """A double at 9e8 m comes in steps of 1.2e-7 m, at 1e6 m of 1.2e-10 m."""

    def moved(away: str) -> radwrap.Scene:
        near, far = [away, "0 m", "0 m"], [away, "0 m", "0.79 m"]
        things = {"camera": far, "sources[0]": far, "targets[0]": near}
        places = {f"{thing}.position": place for thing, place in things.items()}
        return radwrap.load_scene(BENCH, places | {"camera.look_at": near, "sources[0].look_at": near})

    moved("1e6 m")
    with pytest.raises(InputError, match=r"sources\[0\].position: lies 1e\+07 m from the origin"):
        radwrap.load_scene(BENCH, {"sources[0].position": ["0 m", "1e7 m", "0.5 m"]})
    with pytest.raises(InputError, match=r"lies 9e\+08 m from the origin, where numbers hold places to 1e-07 m only"):
        moved("9e8 m")
