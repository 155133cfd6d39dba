"""From a scene file to SI, and what is said of a wrong one."""

import copy
import math
import tomllib
from pathlib import Path
from typing import Any

import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.scene.file.described import described_schema
from radwrap.scene.file.document import SceneModel
from radwrap.scene.materials import CoefficientTable, GlassBeads, PerturbedNormal
from radwrap.scene.scene import Scene
from radwrap.scene.sources import Ring, emitters, gaussian_spread
from radwrap.scene.targets import Box, DotBoard, PolygonShape, RadFile, surfaces

ROOT = Path(__file__).parents[2]
SCENES = sorted((ROOT / "rad_scenes").rglob("scene.toml"))
START = ROOT / "radwrap" / "data" / "init" / "scene.toml"


@pytest.fixture
def document() -> dict[str, Any]:
    return tomllib.loads(START.read_text())


def load(document: dict[str, Any], **changes: Any) -> Scene:
    return radwrap.scene_from_document(document, changes)


@pytest.mark.parametrize("path", [*SCENES, START], ids=lambda path: path.parent.name)
def test_every_shipped_scene_loads(path: Path) -> None:
    scene = radwrap.load_scene(path)
    assert scene.targets
    assert scene.emitters


def test_values_are_in_si(document: dict[str, Any]) -> None:
    scene = load(document)
    camera = scene.camera
    assert (camera.focal_length, camera.exposure_time) == (0.0125, 0.387)
    assert camera.pose.position == (0, 0, 0.79)
    assert camera.principal_point == (95.5, 82.0)
    assert (camera.sensor.pixel_width, camera.sensor.pixel_height) == (13.75e-6, 16e-6)
    assert camera.aperture.area == pytest.approx(math.pi * 1e-8 / 4, rel=1e-15)
    ring = scene.sources[0]
    assert isinstance(ring, Ring)
    assert ring.beam.spread == pytest.approx(math.radians(7.6) / 2.354820045030949, rel=1e-15)
    board = scene.targets[0]
    assert isinstance(board, DotBoard)
    assert board.width == pytest.approx(4 * 19.05e-3 + 15.875e-3 + 20e-3)
    assert scene.materials["sheeting"] == PerturbedNormal(0.6, 0.02)


def test_radiant_intensity_becomes_radiance_of_the_disc(document: dict[str, Any]) -> None:
    del document["sources"][0]["radiance"]
    scene = load(document, **{"sources[0].radiant_intensity": "47.1 mW/sr"})
    assert scene.emitters[0].radiance == pytest.approx(0.0471 / (math.pi * 0.00254**2))
    assert scene.emitters[0].radiant_intensity == pytest.approx(0.0471)


def test_the_four_widths_of_a_gaussian_differ_fourfold() -> None:
    spreads = [gaussian_spread(7.6, definition) for definition in ("fwhm", "half_angle", "1/e^2_full", "sigma")]
    # exp(-t^2/2s^2) is 1/2 at t = s sqrt(2 ln 2) = 1.17741 s, and exp(-2) at t = 2 s
    assert spreads == pytest.approx([7.6 / 2.35482, 7.6 / 1.17741, 7.6 / 4, 7.6], rel=1e-5)
    assert max(spreads) / min(spreads) == pytest.approx(4)


def test_what_the_file_does_not_say_is_listed_as_assumed(document: dict[str, Any]) -> None:
    del document["camera"]["aperture"]
    del document["sources"][0]["beam"]["width_definition"]
    assumed = load(document).assumed
    assert assumed["camera.aperture.diameter"] == "0.1 mm" or "camera.aperture" in assumed
    assert assumed["sources[0].beam.width_definition"] == "fwhm"
    assert assumed["camera.principal_point"] == "[95.5 px, 82 px]"
    assert "camera.focal_length" not in assumed
    assert (
        load(document, **{"camera.aperture.diameter": "0 mm"}).assumed["camera.aperture.exposure_diameter"] == "0.1 mm"
    )


def test_defaults_that_change_the_image_are_all_listed(document: dict[str, Any]) -> None:
    document["camera"]["aperture"] = {"diameter": "0.1 mm"}
    document["targets"] += [{"type": "disc", "material": "black", "diameter": "1 mm"}]
    document["targets"][-1] |= {"position": ["0 mm", "0 mm", "-9 mm"]}
    document["materials"]["beads"] = {
        "type": "retroreflective",
        "model": "coefficient",
        "function": "glass_beads",
        "anchor": "95 1/sr",
    }
    document["materials"]["table"] = {
        "type": "retroreflective",
        "model": "coefficient",
        "observation_angles": ["0.1 deg", "2 deg"],
        "entrance_angles": ["0 deg", "60 deg"],
        "coefficients": [["3 1/sr", "2 1/sr"], ["2 1/sr", "1 1/sr"]],
    }
    assumed = load(document).assumed
    listed = {
        "materials.table.interpolation": "log",
        "materials.table.outside": "refuse",
        "materials.beads.outside": "refuse",
        "camera.up": "[0, 1, 0]",
        "sources[0].up": "[0, 1, 0]",
        "targets[1].name": "target1",
    }
    assert {key: assumed.get(key) for key in listed} == listed
    assert not assumed.keys() & {"materials.beads.interpolation", "targets[0].name", "materials.sheeting.outside"}
    said = {"materials.table.interpolation": "linear", "materials.table.outside": "hold", "camera.up": [0, 0.5, 0]}
    said |= {"materials.beads.outside": "hold", "sources[0].up": [0, 1, 0], "targets[1].name": "spot"}
    assert not load(document, **said).assumed.keys() & listed.keys()
    # World z, where the view is along y.
    across = {"camera.position": ["0 mm", "800 mm", "0 mm"], "targets[0].rotation": ["-90 deg", "0 deg", "0 deg"]}
    assert load(document, **across).assumed["camera.up"] == "[0, 0, 1]"


def test_what_has_no_meaning_is_not_listed(document: dict[str, Any]) -> None:
    for shape, more in (("round", {}), ("annular", {"inner_diameter": "0.05 mm"}), ("square", {}), ("half_disc", {})):
        document["camera"]["aperture"] = {"shape": shape, "diameter": "0.1 mm", **more}
        assert ("camera.aperture.rotation" in load(document).assumed) == (shape in ("square", "half_disc"))
    lamp = {"type": "disc", "name": "lamp", "position": ["0 mm", "0 mm", "1 m"], "look_at": ["0 mm"] * 3}
    document["sources"] = [lamp | {"diameter": "5 mm", "radiance": "1 W/m^2/sr"}]
    assert "sources[0].up" not in load(document).assumed


def test_the_order_of_rotations_is_listed(document: dict[str, Any]) -> None:
    del document["camera"]["look_at"]
    document["camera"]["rotation"] = ["180 deg", "0 deg", "0 deg"]
    assumed = load(document).assumed
    assert assumed["camera.rotation_order"] == "xyz" and "camera.up" not in assumed
    assert "camera.rotation_order" not in load(document, **{"camera.rotation_order": "xyz"}).assumed


def test_automatic_names_leave_given_ones_alone(document: dict[str, Any]) -> None:
    plain = {"type": "disc", "material": "black", "diameter": "1 mm"}
    document["targets"] = [plain | {"position": ["0 mm", "0 mm", f"{z} mm"]} for z in range(4)]
    document["targets"][0]["name"] = "target2"
    document["sources"][0]["name"] = "target1"
    assert [target.name for target in load(document).targets] == ["target2", "target3", "target4", "target5"]


def test_sensor_presets_can_be_changed_key_by_key(document: dict[str, Any]) -> None:
    sensor = load(document, **{"camera.sensor.rows": 20, "camera.sensor.bit_depth": 10}).camera.sensor
    assert (sensor.rows, sensor.columns, sensor.bit_depth, sensor.gain) == (20, 192, 10, 3.38e4)


def test_one_changed_value_makes_another_scene(document: dict[str, Any]) -> None:
    scene = load(document)
    other = radwrap.with_value(scene, "camera.exposure_time", "64 ms")
    assert other.camera.exposure_time == 0.064
    assert scene.camera.exposure_time == 0.387
    again = radwrap.with_value(other, "camera.exposure_time", "387 ms")
    assert again == scene
    leds = radwrap.with_value(scene, "sources[0].leds", [{"index": 3, "radiance_factor": 0.5}])
    assert leds.emitters[3].radiance == scene.emitters[3].radiance / 2


def test_camera_poses_agree_however_they_are_written(document: dict[str, Any]) -> None:
    scene = load(document)
    camera = document["camera"]
    camera["translation"] = camera.pop("position")
    del camera["look_at"]
    camera["rotation"] = ["180 deg", "0 deg", "0 deg"]
    turned = load(document)
    for ours, theirs in zip(turned.camera.pose.rotation, scene.camera.pose.rotation, strict=True):
        assert ours == pytest.approx(theirs, abs=1e-15)


@pytest.mark.parametrize(
    ("changes", "key", "words"),
    [
        ({"camera.focal_length": "12,5 mm"}, "camera.focal_length", "NUMBER UNIT"),
        ({"camera.focal_length": 12.5}, "camera.focal_length", "no unit"),
        ({"camera.focal_length": "12.5 deg"}, "camera.focal_length", "not a unit of length"),
        ({"camera.focal_length": "0 mm"}, "camera.focal_length", "at least 1e-06 mm, not '0 mm'"),
        ({"camera.focal_length": "-1 mm"}, "camera.focal_length", "at least"),
        ({"camera.exposure_time": "-1 ms"}, "camera.exposure_time", "at least"),
        ({"camera.focus": "1 mm"}, "camera.focus", "unknown key"),
        ({"camera.aperture.colour": "red"}, "camera.aperture.colour", "unknown key"),
        ({"sources[0].beam.width": "7.6 mm"}, "sources[0].beam.width", "not a unit of angle"),
        ({"sources[0].beam": {"profile": "cosine_power", "width": "1e-6 deg"}}, "sources[0].beam.width", "narrowest"),
        (
            {
                "sources[0].leds": [{"index": 3, "beam_width_factor": 1e-5}],
                "sources[0].beam": {"profile": "cosine_power", "width": "7 deg"},
            },
            "sources[0].leds[0].beam_width_factor",
            "0.001 deg is the narrowest",
        ),
        ({"sources[0].radiance": "2324 W/m^2"}, "sources[0].radiance", "not a unit of radiance"),
        ({"sources[0].radiant_intensity": "1 W/sr"}, "sources[0]", "exactly one"),
        ({"sources[0].type": "laser"}, "sources[0].type", "not one of"),
        ({"targets[0]": {"name": "board"}}, "targets[0].type: is missing", ""),
        ({"materials.black.type": 3}, "materials.black.type", "'3' is not one of 'lambertian'"),
        ({"sources[0].leds": [{"index": 12}]}, "sources[0]", "LEDs 0 to 11"),
        (
            {
                "sources[0].leds": [{"index": 1}, {"index": 3, "beam_width_factor": 2.3}],
                "sources[0].beam": {"profile": "cone", "width": "40 deg", "width_definition": "half_angle"},
            },
            "sources[0].leds[1].beam_width_factor",
            "wider than a half space",
        ),
        (
            {
                "sources[0].leds": [{"index": 3, "beam_width_factor": 0.5}],
                "sources[0].beam": {"profile": "lambertian"},
            },
            "sources[0].leds[0].beam_width_factor",
            "no width",
        ),
        ({"targets[0].rows": 0}, "targets[0].rows: must be at least 1, not 0", ""),
        ({"targets[0].rows": 5.5}, "targets[0].rows", "must be an integer, not 5.5"),
        ({"targets[0].rows": True}, "targets[0].rows", "must be an integer, not True"),
        ({"camera": 3}, "camera: ", "must be a table, not 3"),
        ({"camera.aperture": [1]}, "camera.aperture: ", "must be a table, not an array"),
        ({"materials": "x"}, "materials: ", "must be a table, not 'x'"),
        ({"sources[0].beam": "gaussian"}, "sources[0].beam: ", "must be a table, not 'gaussian'"),
        ({"targets[0]": 3}, "targets[0]: ", "must be a table, not 3"),
        ({"targets": {"a": 1}}, "targets: ", "must be an array, not a table"),
        ({"camera.position": "0 mm"}, "camera.position: ", "must be an array, not '0 mm'"),
        ({"camera.position": ["0 mm"] * 4}, "camera.position: ", "at most 3 entries, not 4"),
        ({"camera.sensor.gamma": "0.85"}, "camera.sensor.gamma: ", "must be a number, not '0.85'"),
        ({"camera.sensor.rounding": 1}, "camera.sensor.rounding: ", "must be true or false, not 1"),
        ({"title": 3}, "title: ", "must be a string, not 3"),
        ({"targets[0].dot_diameter": "20 mm"}, "targets[0]", "overlap"),
        ({"targets[0].material": "gold"}, "targets[0].material", "no material"),
        ({"targets[0].name": "two words"}, "targets[0].name", "is not a name"),
        ({"targets[0].name": "ring"}, "targets[0].name", "twice"),
        ({"materials.black.reflectance": 1.5}, "materials.black.reflectance: must be at most 1, not 1.5", ""),
        ({"materials.black.reflectance": math.nan}, "materials.black.reflectance", "finite"),
        ({"materials.sheeting.anchor": "95 cd/lx/m^2"}, "materials.sheeting", "does not go"),
        ({"camera.sensor.gamma": 0.9}, "camera.sensor", "its unit says gamma"),
        ({"camera.sensor.saturation_gray": 300}, "camera.sensor", "saturation_gray <= 255"),
        ({"camera.sensor.dark_gray": 200}, "camera.sensor", "dark_gray < saturation_gray"),
        ({"camera.sensor.preset": "nikon"}, "camera.sensor.preset", 'no sensor "nikon"; known: ams_cmv12000, '),
        ({"camera.look_at": ["0 mm", "0 mm", "790 mm"]}, "camera.look_at", "length above zero"),
        ({"camera.up": [0, 0, 1]}, "camera.up", "parallel"),
        ({"camera.up": [0, 0, 0]}, "camera.up", "length above zero"),
        ({"camera.rotation": ["0 deg", "0 deg", "0 deg"]}, "camera", "exactly one"),
        ({"camera.position": ["0 mm"] * 3, "camera.look_at": ["0 mm", "0 mm", "1 mm"]}, "camera", "lies on"),
        ({"targets": []}, "targets", "empty"),
        ({"sources": []}, "sources", "no light"),
        ({"sources[0].radiance": "0 W/m^2/sr"}, "sources", "no light"),
        ({"sources[0].led_diameter": "300 mm", "sources[0].count": 1}, "sources[0].diameter", "too wide"),
        ({"sources[0].led_diameter": "300 mm"}, "sources[0].count", "overlap"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_in_one_line_with_its_place(
    document: dict[str, Any], changes: dict[str, Any], key: str, words: str
) -> None:
    with pytest.raises(InputError) as caught:
        radwrap.scene_from_document(document, changes, origin="scene.toml")
    message = str(caught.value)
    assert message.startswith(f"scene.toml: {key}"), message
    assert words in message, message
    assert "\n" not in message


def test_key_paths_that_lead_nowhere_are_refused(document: dict[str, Any]) -> None:
    for key in ("targets[9].rows", "camera.focal_length.x", "[0]", "", "targets[x].rows", "camera..x"):
        with pytest.raises(InputError):
            load(copy.deepcopy(document), **{key: 1})


def solid(document: dict[str, Any], **target: Any) -> dict[str, Any]:
    return {**document, "targets": [{"name": "thing", "material": "black", **target}]}


@pytest.mark.parametrize(
    "target",
    [
        {"type": "box", "size": ["1 m", "1 m", "2 m"]},
        {"type": "sphere", "diameter": "2 m"},
        {"type": "cylinder", "diameter": "1 m", "length": "2 m"},
    ],
)
def test_a_camera_inside_a_solid_is_refused(document: dict[str, Any], target: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="inside the target"):
        load(solid(document, **target))


def test_polygons_need_an_area_and_no_crossing_sides(document: dict[str, Any]) -> None:
    def polygon(*points: tuple[int, int]) -> dict[str, Any]:
        return solid(document, type="polygon", vertices=[[f"{x} mm", f"{y} mm"] for x, y in points])

    with pytest.raises(InputError, match="no area"):
        load(polygon((0, 0), (1, 1), (2, 2)))
    with pytest.raises(InputError, match="cross"):
        load(polygon((0, 0), (10, 10), (10, 0), (0, 8)))
    clockwise = load(polygon((0, 0), (0, 10), (10, 10), (10, 0)))
    shape = surfaces(clockwise.targets[0])[0].shape
    assert isinstance(shape, PolygonShape)
    assert shape.vertices[0][0] == 0.01  # turned about, so that its front looks along +z


def test_boxes_look_outwards() -> None:
    import numpy as np

    from radwrap.frames import Pose

    box = Box("box", Pose(), "m", (1.0, 2.0, 3.0))
    faces = surfaces(box)
    assert len(faces) == 6
    area = 0.0
    for face in faces:
        assert isinstance(face.shape, PolygonShape)
        a, b, c, d = (np.array(vertex) for vertex in face.shape.vertices)
        normal = np.cross(b - a, c - a)
        assert normal @ (a + b + c + d) > 0
        area += np.linalg.norm(normal)
    assert area == pytest.approx(2 * (2 + 3 + 6))


def test_sheeting_by_table_and_function(document: dict[str, Any]) -> None:
    document["materials"]["sheeting"] = {
        "type": "retroreflective",
        "model": "coefficient",
        "observation_angles": ["0.1 deg", "0.2 deg", "1 deg"],
        "entrance_angles": ["-4 deg", "60 deg"],
        "coefficients": [["300 cd/lx/m^2", "180 cd/lx/m^2"], ["250 1/sr", "150 1/sr"], ["50 1/sr", "30 1/sr"]],
    }
    table = load(document).materials["sheeting"]
    assert isinstance(table, CoefficientTable)
    assert table.entrance[0] == pytest.approx(math.radians(4))
    document["materials"]["sheeting"]["coefficients"].pop()
    with pytest.raises(InputError, match="3 rows"):
        load(document)
    document["materials"]["sheeting"] = {
        "type": "retroreflective",
        "model": "coefficient",
        "function": "glass_beads",
        "anchor": "95 cd/lx/m^2",
    }
    assert load(document).materials["sheeting"] == GlassBeads(95.0)


def test_sheeting_is_not_asked_beyond_its_data(document: dict[str, Any]) -> None:
    document["materials"]["sheeting"] = {
        "type": "retroreflective",
        "model": "coefficient",
        "observation_angles": ["0.1 deg", "0.5 deg"],
        "entrance_angles": ["-4 deg", "60 deg"],
        "coefficients": [["300 1/sr", "180 1/sr"], ["95 1/sr", "65 1/sr"]],
    }
    with pytest.raises(InputError, match=r"observation angles 0\.8.* cover 0\.1 to 0\.5 deg"):
        load(document)
    document["materials"]["sheeting"]["outside"] = "hold"
    assert load(document).targets
    document["materials"]["sheeting"] |= {"outside": "refuse", "observation_angles": ["0.1 deg", "2 deg"]}
    document["materials"]["sheeting"]["entrance_angles"] = ["-4 deg", "30 deg"]
    with pytest.raises(InputError, match="entrance angles up to 4"):
        load(document)


def test_included_files_stay_names(document: dict[str, Any]) -> None:
    scene = load({**document, "targets": [*document["targets"], {"rad": "room.rad"}]})
    target = scene.included[0]
    assert target == RadFile("target1", target.pose, "room.rad", 1.0)
    assert scene.assumed["targets[1].length_unit"] == "1 m"


def test_files_that_are_no_scene(tmp_path: Path) -> None:
    for content, words in ((b"\xff\xfe", "UTF-8"), (b"[camera", "TOML"), (b"d = 2020-01-01", "date"), (b"", "missing")):
        path = tmp_path / "scene.toml"
        path.write_bytes(content)
        with pytest.raises(InputError, match=words):
            radwrap.load_scene(path)
    with pytest.raises(InputError, match="no such scene"):
        radwrap.load_scene(tmp_path / "none.toml")
    with pytest.raises(InputError, match="not a regular file"):
        radwrap.load_scene(tmp_path)


def test_ring_leds_lie_on_their_circle_and_differ_as_told(document: dict[str, Any]) -> None:
    document["sources"][0]["leds"] = [{"index": 1, "beam_width_factor": 2.0, "radiance_factor": 0.5}]
    scene = load(document)
    leds = emitters(scene.sources[0])
    assert len(leds) == 12
    for led in leds:
        assert math.hypot(led.position[0], led.position[1]) == pytest.approx(0.0125)
        assert led.axis == pytest.approx((0, 0, -1))
    assert leds[1].beam.spread == 2 * leds[0].beam.spread
    assert leds[1].radiance == leds[0].radiance / 2


def test_each_key_of_the_schema_has_one_line_and_its_units() -> None:
    """What stands below a field of a model, and the units of its type: a new field without a line fails here."""
    schema = described_schema()
    tables = {"SceneModel": schema, **schema["$defs"]}
    keys = {f"{name}.{key}": rule for name, table in tables.items() for key, rule in table["properties"].items()}
    assert len(keys) > 350
    units = ": one number, one blank"
    own = {name: rule["description"].split(units)[0] for name, rule in keys.items()}
    # Before the units stands a sentence, and the name of the quantity.
    assert not [name for name, line in own.items() if line.count(". ") < (units in keys[name]["description"])]
    assert not [name for name, line in own.items() if not line.strip()]
    assert keys["LensModel.focus_distance"]["description"].endswith("one unit of m, cm, mm, um, nm, km, in, ft.")
    assert keys["SheetModel.size"]["description"].count("one unit of") == 1
    assert keys["SpecularModel.type"]["description"] == "Kind of material.", "once, whatever its bases"
    assert keys["RingModel.radiance"]["description"].startswith("Radiance along the axis"), (
        "of the class that it is made of"
    )


def test_the_schema_describes_quantities_and_presets() -> None:
    schema = SceneModel.model_json_schema()
    camera = schema["$defs"]["CameraModel"]["properties"]
    assert camera["focal_length"]["pattern"].startswith("^")
    assert "mm" in camera["focal_length"]["description"]
    assert {"required": ["preset"]} in schema["$defs"]["SensorModel"]["anyOf"]
    assert schema["additionalProperties"] is False
