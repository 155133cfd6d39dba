"""What the server answers is what the commands write: codes, errors, profiles, scenes."""

from __future__ import annotations

import json
import resource
import shlex
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.images import read_image
from radwrap.imaging.page.thresholds import thresholds
from radwrap.imaging.page.turn import Turn, changes_of, rings_of, turn_of
from radwrap.imaging.response.sensor import gray_levels
from radwrap.scene.camera import Sensor
from radwrap.scene.file import turned as turned_module
from radwrap.scene.file.load import with_camera
from radwrap.scene.file.turned import with_levels
from tests.cli.conftest import SMALL, here, inside, scene_with
from tests.face.conftest import TWO, Served

EQ5: Final = Sensor(2, 2, 1e-4, 1e-4, gain=3.38e4, gamma=0.85, dark_gray=22, saturation_gray=181)
LINEAR: Final = {
    "model": "linear",
    "rows": 20,
    "columns": 24,
    "pixel_width": "100 um",
    "pixel_height": "110 um",
    "wavelength": "525 nm",
    "quantum_efficiency": 0.5,
    "system_gain": "0.01 DN/e",
    "offset": 4,
    "full_well": "20000 e",
    "read_noise": "5 e",
    "dark_current": "50 e/s",
}


# ----------------------------------------------------------------------------------------------------- Without a server


@pytest.mark.parametrize(
    "sensor",
    [
        EQ5,
        replace(EQ5, gamma=1.0, gain=2e5, dark_gray=0.5),
        replace(EQ5, bit_depth=12, saturation_gray=4095, gain=1e6, dark_gray=100.25),
        replace(EQ5, gain=1e-3),
        replace(EQ5, rounding=False),
        replace(EQ5, bit_depth=1, dark_gray=0, saturation_gray=1),
    ],
)
def test_ranks_among_thresholds_are_codes(sensor: Sensor) -> None:
    """Exactly, for random numbers of all sizes, at the thresholds themselves, and one float32 below each."""
    found = thresholds(sensor)
    assert (np.diff(found.values) >= 0).all()
    reached = found.values[np.isfinite(found.values)]
    random = np.random.default_rng(7)
    light = np.concatenate([10 ** random.uniform(-12, 3, 5000), [0.0], random.uniform(0, 1e-2, 5000)]).astype(
        np.float32
    )
    light = np.concatenate([light, reached, np.nextafter(reached, np.float32(0))])
    levels = gray_levels(light.astype(np.float64), sensor)
    assert np.array_equal(found.codes(light), np.rint(levels).astype(int))
    assert np.array_equal(light >= np.float32(found.saturated), levels >= sensor.saturation_gray)
    assert np.array_equal(light >= np.float32(found.lit), levels >= sensor.dark_gray + 0.5)


def camera(**sensor: Any) -> radwrap.Scene:
    return radwrap.scene_from_document(scene_with({f"camera.sensor.{key}": value for key, value in sensor.items()}))


def turned(scene: radwrap.Scene, turn: Turn) -> Sensor:
    return with_camera(scene, changes_of(turn, scene.camera)).camera.sensor


def full_exposure(sensor: Sensor) -> float:
    return float(((sensor.saturation_gray - sensor.dark_gray) / sensor.gain) ** (1 / sensor.gamma))


def test_no_turn_changes_no_key() -> None:
    scene = camera()
    assert changes_of(Turn((1.0,)), scene.camera) == {}
    same = Turn((0.5,), gain=1.0, gamma=0.85, dark_gray=22.0, bit_depth=8)
    assert changes_of(same, scene.camera) == {}


def test_gamma_and_bits_keep_the_exposure_of_saturation() -> None:
    scene = camera()
    before = scene.camera.sensor
    for turn in (Turn((1.0,), gamma=0.5), Turn((1.0,), bit_depth=12), Turn((1.0,), gamma=1.0, bit_depth=10)):
        after = turned(scene, turn)
        assert full_exposure(after) == pytest.approx(full_exposure(before), rel=1e-12)
    twelve = turned(scene, Turn((1.0,), bit_depth=12))
    assert (twelve.saturation_gray, twelve.dark_gray) == pytest.approx((181 * 4095 / 255, 22 * 4095 / 255))
    assert turned(scene, Turn((1.0,), gain=2.0)).gain == pytest.approx(2 * before.gain, rel=1e-15)
    assert turned(scene, Turn((1.0,), dark_gray=5.0)) == replace(before, dark_gray=5.0)


def test_a_linear_camera_is_turned_in_its_own_words() -> None:
    scene = radwrap.scene_from_document(scene_with({"camera.sensor": LINEAR}))
    changes = changes_of(Turn((1.0,), exposure_time="10 ms", gain=2.0, dark_gray=8.0, bit_depth=10), scene.camera)
    assert changes == {
        "camera.exposure_time": "10 ms",
        "camera.sensor.bit_depth": 10,
        "camera.sensor.system_gain": f"{0.01 * 2 * 1023 / 255!r} DN/e",
        "camera.sensor.offset": 8 * 1023 / 255,
    }
    made = turned(scene, Turn((1.0,), exposure_time="10 ms"))
    assert made.linear is not None and made.linear.dark_signal == pytest.approx(0.5)


BAD: Final[dict[str, tuple[Any, str]]] = {
    "no object": ([], "turn"),
    "unknown": ({"path": "/etc/passwd"}, "turn"),
    "too few": ({"levels": [1.0]}, "levels"),
    "negative": ({"levels": [1.0, -1e-9]}, "level b"),
    "text": ({"levels": [1.0, "1"]}, "level b"),
    "true": ({"levels": [1.0, True]}, "level b"),
    "huge": ({"levels": [1.0, 1e300]}, "level b"),
    "nan": ({"levels": [1.0, float("nan")]}, "level b"),
    "unknown knob": ({"knobs": {"rows": "5"}}, "knobs"),
    "number": ({"knobs": {"gain": 1}}, "gain"),
    "nan gain": ({"knobs": {"gain": "nan"}}, "gain"),
    "1e300": ({"knobs": {"gain": "1e300"}}, "gain"),
    "unit": ({"knobs": {"gain": "1 mm"}}, "gain"),
    "comma": ({"knobs": {"gamma": "0,5"}}, "gamma"),
    "half a bit": ({"knobs": {"bit_depth": "8.5"}}, "bit_depth"),
    "17 bits": ({"knobs": {"bit_depth": "17"}}, "bit_depth"),
    "long": ({"knobs": {"gain": "1" * 100_000}}, "gain"),
    "400 digits": ({"knobs": {"exposure_time": f"0.{'3' * 400} s"}}, "exposure_time"),
}


@pytest.mark.parametrize("fault", list(BAD))
def test_bad_turns_name_the_knob(fault: str) -> None:
    told, where = BAD[fault]
    with pytest.raises(InputError) as caught:
        turn_of(told, ["a", "b"])
    assert caught.value.where == where and len(str(caught.value)) < 300


@pytest.mark.parametrize(
    ("source", "key"),
    [
        ({"radiance": "2 kW/m^2/sr"}, "radiance"),
        ({"radiant_intensity": "20 mW/sr"}, "radiant_intensity"),
        ({"radiant_flux": "5 mW"}, "radiant_flux"),
    ],
)
def test_a_turned_scene_tells_its_level_as_it_did(source: dict[str, str], key: str) -> None:
    lamp = {name: value for name, value in SMALL["sources"][0].items() if name != "radiance"}
    scene = radwrap.scene_from_document(scene_with({"sources": [{**lamp, **source}]}))
    made = with_levels(scene, {"lamp": 0.25}, {"camera.exposure_time": "64 ms"})
    (before,), (after,) = scene.emitters, made.emitters
    assert after.radiance == pytest.approx(before.radiance / 4, rel=1e-12)
    assert set(json.loads(made.document)["sources"][0]) == set(json.loads(scene.document)["sources"][0])
    assert key in made.document and made.camera.exposure_time == 0.064


RING: Final = {
    **{key: SMALL["sources"][0][key] for key in ("position", "look_at", "radiance", "beam")},
    "type": "ring",
    "name": "ring",
    "count": 4,
    "diameter": "60 mm",
    "leds": [{"index": 2, "radiance_factor": 0.5}],
}


def test_leds_of_a_ring_are_turned_one_by_one() -> None:
    scene = radwrap.scene_from_document(scene_with({"sources": [RING]}))
    factors = {"ring.led00": 0.0, "ring.led01": 1.0, "ring.led02": 3.0, "ring.led03": 0.1}
    made = with_levels(scene, factors, {})
    for before, after in zip(scene.emitters, made.emitters, strict=True):
        assert after.radiance == pytest.approx(before.radiance * factors[before.source], rel=1e-12)
    whole = with_levels(scene, dict.fromkeys(factors, 2.0), {})
    assert json.loads(whole.document)["sources"][0]["leds"] == RING["leds"]
    assert rings_of(list(factors)) == {"ring": list(factors)}


def test_a_level_that_did_not_arrive_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever kind of source comes to a scene file: one that is not turned in it is refused, not silently lost."""
    monkeypatch.setattr(turned_module, "_turn", lambda *_: None)
    with pytest.raises(InputError, match="cannot be given by another number"):
        with_levels(camera(), {"lamp": 0.5}, {})


# ------------------------------------------------------------------------------------------------------- With a server


def number(served: Served) -> int:
    return int(served.ready()["basis"])


# Share of the pixels whose light lies so near to the middle of two floats that 8 bits more do not tell the nearer one:
# some 1 %; where planes are float32 it is a third.
MISROUNDED: Final = 0.05
RANDOM: Final = np.random.default_rng(20261124)
TURNS: Final = [
    {
        "levels": [round(float(10 ** RANDOM.uniform(-2, 1)), 3), float(RANDOM.uniform(0, 2))],
        "knobs": {
            "exposure_time": f"{RANDOM.uniform(20, 900):.4g} ms",
            "gain": f"{RANDOM.uniform(0.5, 2):.3f}",
            "gamma": f"{RANDOM.uniform(0.5, 1.2):.3f}",
            "dark_gray": f"{RANDOM.uniform(0, 40):.3g}",
            "bit_depth": str(RANDOM.integers(6, 13)),
        },
    }
    for _ in range(3)
]


@pytest.mark.parametrize("turn", [{}, {"levels": [0.0, 0.0]}, {"levels": [2.0, 2.0]}, *TURNS])
def test_the_page_shows_what_its_command_writes(
    served: Served, turn: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Codes by ranks, gray.png, error and profile, against `radwrap relight` run by the line that the page tells."""
    basis = number(served)
    told, (levels, exposure, sigma) = served.post("/api/turn", {"basis": basis, "turn": turn}).blocks()
    words = shlex.split(told["command"].rpartition(" && ")[2])
    assert words[:2] == ["radwrap", "relight"] and words[-2:] == ["--out", "turned"]
    done = here([*words[1:-1], tmp_path / "turned", "--exposure", "--json"], capsys)
    assert done.code in (0, 3)  # a turn may be too bright for the tolerance
    one = done.json["images"]["gray"]
    assert told["keeps"] == one["met"] == (done.code == 0)
    assert told["error"] == one["error"]
    assert told["gray"] == one["gray"] and told["saturated_fraction"] == one["saturated_fraction"]
    written = read_image(tmp_path / "turned" / "gray.png")[0]
    ranks = told["thresholds"]["first"] + np.searchsorted(levels, exposure, side="right")
    assert np.array_equal(ranks, written.ravel())
    assert np.array_equal(exposure, read_image(tmp_path / "turned" / "gray.exr")[0].ravel())
    assert np.array_equal(sigma, read_image(tmp_path / "turned" / "gray_sigma" / "gray.exr")[0].ravel())
    made = (served.out / "basis" / "manifest.json").stat().st_mtime_ns
    exec(told["python"].replace("turned.png", str(tmp_path / "turned.png")), {})  # noqa: S102
    assert (served.out / "basis" / "manifest.json").stat().st_mtime_ns == made  # the same render: it was finished
    assert (tmp_path / "turned.png").read_bytes() == (tmp_path / "turned" / "gray.png").read_bytes()
    png = served.post("/api/png", {"basis": basis, "turn": turn})
    assert png.body == (tmp_path / "turned" / "gray.png").read_bytes()
    saturated = told["thresholds"]["saturated"]
    assert (exposure >= (np.inf if saturated is None else saturated)).mean() == told["saturated_fraction"]


def test_a_pixel_and_a_profile_are_those_of_the_files(served: Served) -> None:
    basis = number(served)
    turn = TURNS[0]
    told, (levels, exposure, sigma) = served.post("/api/turn", {"basis": basis, "turn": turn}).blocks()
    exposure, sigma = exposure.reshape(20, 24), sigma.reshape(20, 24)
    asked = {"basis": basis, "turn": turn, "profile": [1, 2, 22, 17]}
    rows = [line.split(",") for line in served.post("/api/profile", asked).body.decode().splitlines()]
    assert rows[0][0] == "distance_px" and len(rows) == 1 + 22
    table = np.array(rows[1:], dtype=float)
    assert table[0, 1:3].tolist() == [1, 2] and table[-1, 1:3].tolist() == [22, 17]
    assert np.allclose(np.diff(table[:, 0]), np.hypot(21, 15) / 21)
    u, v = table[:, 1].astype(int), table[:, 2].astype(int)
    assert np.array_equal(table[:, 6], exposure[v, u].astype(float))
    assert np.array_equal(table[:, 5].astype(np.float32), sigma[v, u])
    assert np.array_equal(table[:, 3], told["thresholds"]["first"] + np.searchsorted(levels, exposure[v, u], "right"))
    assert np.allclose(np.clip(np.rint(table[:, 4]), 0, None), table[:, 3])
    pixel = served.post("/api/pixel", {"basis": basis, "turn": turn, "column": int(u[9]), "row": int(v[9])}).json
    assert (pixel["code"], pixel["radiant_exposure"]) == (table[9, 3], table[9, 6])
    assert pixel["sigma"] == table[9, 5] and pixel["gray"] == table[9, 4]
    assert sum(part**2 for part in pixel["parts"].values()) == pytest.approx(pixel["sigma"] ** 2)


def test_a_wide_profile_is_the_mean_across_the_line(served: Served) -> None:
    """Along a row: of the rows beside it too, at the border of those that there are; its deviation is no smaller."""
    asked = {"basis": number(served), "profile": [3, 1, 20, 1], "width": 5}
    _, (_, exposure, sigma) = served.post("/api/turn", {"basis": asked["basis"]}).blocks()
    rows = [line.split(",") for line in served.post("/api/profile", asked).body.decode().splitlines()]
    table = np.array(rows[1:], dtype=float)
    strip = slice(0, 4), slice(3, 21)  # two rows above the line would be those of -1 and 0
    for column, values in ((6, exposure), (5, sigma)):
        mean = values.reshape(20, 24)[strip].astype(float).mean(axis=0)
        assert np.allclose(table[:, column], mean, rtol=1e-6)
    assert (table[:, 7] == 4).all() and rows[0][7] == "pixels"
    slanted = served.post("/api/profile", {**asked, "profile": [2, 2, 14, 14], "width": 3}).body.decode().splitlines()
    assert [line.rpartition(",")[2] for line in slanted[1:]] == ["3"] * 13
    for width in (0, 2, 101, 1.5, "3", True):
        assert "odd number" in served.post("/api/profile", {**asked, "width": width}).json["text"]


def test_planes_add_up_to_the_picture(served: Served) -> None:
    basis = number(served)
    described = served.ready()
    told, planes = served.post("/api/planes", {"basis": basis}).blocks()
    factors = [0.7, 1.9]
    _, (_, exposure, _) = served.post("/api/turn", {"basis": basis, "turn": {"levels": factors}}).blocks()
    pixels = told["pixels"]
    light = [plane[1 : 1 + pixels] + float(plane[0]) * plane[1 + pixels :].view(np.int8)[:pixels] for plane in planes]
    mixed = np.maximum(np.array(factors) @ np.stack(light), 0) * described["exposure_of_radiance"]
    # Their eight bits more than a float32 has: rounded once, as by the server, nearly all floats are the server's.
    assert np.mean(mixed.astype(np.float32) != exposure) < MISROUNDED
    assert np.abs(mixed - exposure).max() < 1e-7 * exposure.max()


@pytest.mark.parametrize(
    ("path", "told", "says"),
    [
        ("turn", {"basis": 99}, "load the page again"),
        ("turn", {"basis": True}, "number of a basis"),
        ("turn", {"basis": 1, "turn": {"knobs": {"exposure_time": "5 mm"}}}, '"mm" is not a unit of time'),
        ("turn", {"basis": 1, "turn": {"knobs": {"exposure_time": "nan s"}}}, "exposure_time"),
        ("turn", {"basis": 1, "turn": {"levels": [1]}}, "there must be 2 numbers"),
        ("turn", {"basis": 1, "turn": {"levels": [1, None]}}, "must be a number"),
        ("pixel", {"basis": 1, "column": 24, "row": 0}, "lies outside 24 x 20 pixels"),
        ("pixel", {"basis": 1, "column": -1, "row": 0}, "lies outside"),
        ("pixel", {"basis": 1, "column": 1.5, "row": 0}, "needs column and row"),
        ("profile", {"basis": 1, "profile": [0, 0, 24, 0]}, "24 x 20 pixels"),
        ("profile", {"basis": 1, "profile": [0, 0, True, 0]}, "24 x 20 pixels"),
        ("profile", {"basis": 1, "profile": "/etc/passwd"}, "24 x 20 pixels"),
    ],
)
def test_bad_requests_are_told(served: Served, path: str, told: dict[str, Any], says: str) -> None:
    served.ready()
    answer = served.post(f"/api/{path}", told)
    assert answer.status == 422 and says in answer.json["text"]


@pytest.mark.parametrize("room", [0, 300, 900])  # byte of a file: none fits, then the small ones do
def test_a_full_disk_is_told_and_nothing_half_is_left(served: Served, room: int) -> None:
    asked = {"basis": number(served), "turn": {"levels": [0.5, 1.5]}, "profile": [0, 0, 5, 5]}
    before = {path.name for path in served.out.iterdir()}
    limits = resource.prlimit(served.process.pid, resource.RLIMIT_FSIZE)
    resource.prlimit(served.process.pid, resource.RLIMIT_FSIZE, (room, limits[1]))
    try:
        answer = served.post("/api/save", asked)
    finally:
        resource.prlimit(served.process.pid, resource.RLIMIT_FSIZE, limits)
    assert answer.status == 422 and "free disk space" in answer.json["text"]
    assert {path.name for path in served.out.iterdir()} - {".radwrap.lock"} == before - {".radwrap.lock"}
    assert served.post("/api/save", asked).status == 200  # the page goes on
    shutil.rmtree(served.out / "turn_0001")


def test_saving_writes_a_folder_that_the_server_names(served: Served, tmp_path: Path) -> None:
    """The saved scene renders, by a command of its own, to about the picture that was saved."""
    basis = number(served)
    turn = {"levels": [0.5, 1.5], "knobs": {"exposure_time": "300 ms"}}
    asked = {"basis": basis, "turn": turn, "profile": [0, 0, 5, 5], "folder": "/tmp/elsewhere", "name": "../x"}  # noqa: S108
    answer = served.post("/api/save", asked).json
    folder = Path(answer["folder"])
    assert folder.parent == served.out and answer["note"] == ""
    names = {"gray.png", "gray_sigma.exr", "radiant_exposure.exr", "scene.toml", "profile.csv", "turn.json"}
    assert {path.name for path in folder.iterdir()} == names
    assert (folder / "gray.png").read_bytes() == served.post("/api/png", {"basis": basis, "turn": turn}).body
    told = json.loads((folder / "turn.json").read_bytes())
    assert told["levels"] == {"lamp": 0.5, "second": 1.5} and told["changed"] == {"camera.exposure_time": "300 ms"}
    inside("render", folder / "scene.toml", "--tolerance", 2, "--out", tmp_path / "anew").success()
    ours, anew = (read_image(place / "gray.png")[0].astype(float) for place in (folder, tmp_path / "anew"))
    assert np.sqrt(((ours - anew) ** 2).mean()) < 2 * 2  # both keep the tolerance of 2
    shutil.rmtree(folder)
    (served.out / ".radwrap.lock").unlink()


# ------------------------------------------------------------------------------------------------------------ Left out


def left_out(served: Served, levels: list[float], **knobs: str) -> dict[str, float] | None:
    """Root mean squares of what is left out of a turn [gray level]."""
    turn = {"levels": levels, "knobs": knobs}
    told, _ = served.post("/api/turn", {"basis": number(served), "turn": turn}).blocks()
    return told["left_out"] and {effect["name"]: effect["rms_gray"] for effect in told["left_out"]}


def test_what_is_left_out_grows_as_its_gray_levels(served: Served) -> None:
    """By Eq. 5, K (t f)^gamma, as a render of that exposure measures it."""
    own = {effect["name"]: effect["rms_gray"] for effect in served.ready()["left_out"]}
    assert own["diffraction"] > 0.1 and own["bounces"] == 0.0
    for levels, knobs, growth in (
        ([1.0, 1.0], {}, 1.0),
        ([0.5, 0.5], {}, 0.5**0.85),
        ([0.5, 0.5], {"exposure_time": "387 ms", "gain": "1.5"}, 1.5 * 0.5**0.85),
        ([1.0, 1.0], {"exposure_time": "193.5 ms", "dark_gray": "5"}, 0.5**0.85),
        ([0.0, 0.0], {}, 0.0),
        ([1.0, 1.0], {"bit_depth": "12"}, 4095 / 255),
    ):
        found = left_out(served, levels, **knobs)
        assert found == {name: pytest.approx(growth * value, rel=1e-9) for name, value in own.items()}, knobs
    fresh = radwrap.render(
        radwrap.scene_from_document(scene_with({**TWO, "camera.exposure_time": "193.5 ms"})), tolerance=2.0
    )
    assert fresh.left_out["diffraction"].rms_gray == pytest.approx(0.5**0.85 * own["diffraction"], rel=1e-6)


@pytest.mark.parametrize(("levels", "knobs"), [([1.0, 0.5], {}), ([1.0, 1.0], {"gamma": "0.7"})])
def test_what_is_left_out_of_other_light_is_not_known(
    served: Served, levels: list[float], knobs: dict[str, str]
) -> None:
    assert left_out(served, levels, **knobs) is None


def test_what_reads_a_basis_is_built_before_there_is_one(served: Served) -> None:
    """While its renderer traces, a server has time; of a picture that is there each hundredth of a second counts."""
    served.ready()
    code = """
import sys
from pathlib import Path
from radwrap import load_scene, written
from radwrap.face.traced import get_ready, read_traced
get_ready()
built = written._reader.cache_info().misses
read_traced(1, load_scene(Path(sys.argv[1])), Path(sys.argv[2]))
print(written._reader.cache_info().misses - built, "OpenImageIO" in sys.modules)
"""
    argv = [sys.executable, "-c", code, served.scene, served.out / "basis"]
    said = subprocess.run(argv, capture_output=True, text=True, check=True)
    assert said.stdout.split() == ["0", "True"]
