"""The linear camera of EMVA 1288: its mean by exact arithmetic, its noise against the standard's formulas."""

import math
from dataclasses import replace
from decimal import Decimal, localcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.images import ExposureImage, read_gray
from radwrap.imaging.methods.rays import rays_over
from radwrap.imaging.optics.footprint import folded
from radwrap.imaging.response.noise import fixed_pattern, noise_variance, noisy_frame
from radwrap.imaging.response.sensor import gray_levels
from radwrap.manifest import plain
from radwrap.scene.camera import Sensor
from radwrap.scene.file.data_sheet import with_data_sheet
from radwrap.scene.file.sensor_tables import LinearSensorModel
from radwrap.scene.pixel_window import PixelWindow, box, strips
from radwrap.validate.closed_forms import sensor as closed
from radwrap.written import read_back
from tests.physics.conftest import Bench

EXACT = 1e-12  # a few roundings of float64
# Frames are drawn from fixed seeds, so that a test gives the same verdict each time; bounds are 5 standard errors of
# what is measured: a false alarm in 1.7e6.
SURE = 5.0

TABLE: dict[str, Any] = {
    "model": "linear",
    "rows": 200,
    "columns": 300,
    "pixel_width": "5 um",
    "pixel_height": "4 um",
    "bit_depth": 12,
    "wavelength": "650 nm",
    "quantum_efficiency": 0.6,
    "system_gain": "0.25 DN/e",
    "offset": 100,
    "full_well": "12 ke",
    "read_noise": "8 e",
}
MU_P_OF_H = closed.photons(1.0, 5e-6 * 4e-6, 650e-9)  # for each J/m^2


def scene_with(sensor: dict[str, Any], **camera: Any) -> radwrap.Scene:
    """A bright Lambertian sheet in front of a camera with some sensor."""
    view = Bench.camera(focal_length=0.01) | {"exposure_time": "20 ms"} | camera | {"sensor": sensor}
    sheet = {"type": "sheet", "material": "white", "size": ["1 m", "1 m"]}
    return Bench.scene(
        view, [Bench.lamp((0.3, 0, 0.5))], {"white": {"type": "lambertian", "reflectance": 0.5}}, [sheet]
    )


def sensor_of(exposure_time: str = "20 ms", **changes: Any) -> Sensor:
    table = {key: value for key, value in (TABLE | changes).items() if value is not None}
    return scene_with(table, exposure_time=exposure_time).camera.sensor


def even(sensor: Sensor, photons: float) -> ExposureImage:
    """An even field of so many photons a pixel."""
    return ExposureImage(np.full((sensor.rows, sensor.columns), photons / MU_P_OF_H))


@pytest.mark.parametrize("photons", [0, 1, 1000, 15000, 19999])
def test_mean_gray_level_by_exact_arithmetic(photons: float) -> None:
    sensor = sensor_of(dark_current="500 e/s")
    with localcontext() as context:
        context.prec = 40
        electrons = Decimal("0.6") * Decimal(photons) + Decimal(500) * Decimal("0.02")
        expected = float(Decimal(100) + Decimal("0.25") * min(electrons, Decimal(12000)))
    assert gray_levels(np.array([photons / MU_P_OF_H]), sensor)[0] == pytest.approx(expected, rel=EXACT)


def test_saturation_is_that_of_the_full_well_or_of_the_converter() -> None:
    assert sensor_of().saturation_gray == 100 + 0.25 * 12000
    assert sensor_of(full_well="50 ke").saturation_gray == 4095


def test_dark_current_doubles_with_temperature() -> None:
    heat = {"dark_current": "40 e/s", "dark_current_temperature": "25 degC", "doubling_temperature": "8 K"}
    for temperature, factor in (("25 degC", 1), ("33 degC", 2), ("49 degC", 8), ("17 degC", 0.5)):
        sensor = sensor_of("2 s", **heat, temperature=temperature)
        assert sensor.dark_gray == pytest.approx(100 + 0.25 * 40 * 2 * factor, rel=EXACT)


def test_quantum_efficiency_is_linear_between_wavelengths() -> None:
    table = [["600 nm", 0.5], ["700 nm", 0.3]]
    read = sensor_of(quantum_efficiency=None, quantum_efficiencies=table).linear
    assert read is not None
    assert read.quantum_efficiency == pytest.approx(0.4, rel=EXACT)


def test_power_law_behind_keeps_dark_and_saturation_and_bends_between() -> None:
    straight, bent = sensor_of(), sensor_of(gamma=0.5)
    exposures = np.linspace(0, 20000, 9) / MU_P_OF_H
    shares = (gray_levels(exposures, straight) - 100) / 3000
    assert gray_levels(exposures, bent) == pytest.approx(100 + 3000 * np.sqrt(shares), rel=EXACT)


@pytest.mark.parametrize(("full_well", "top"), [("12 ke", 3100), ("50 ke", 4095)])
def test_the_look_up_table_spans_dark_to_where_the_signal_ends(full_well: str, top: float) -> None:
    """G0 + (Gs - G0) ((y - G0)/(Gs - G0))^gamma of y = offset + K mu_e, with Gs of the full well or the converter."""
    sensor = sensor_of(gamma=0.5, full_well=full_well, dark_current="4000 e/s", read_noise="0 e")
    dark = 100 + 0.25 * 80
    assert (sensor.dark_gray, sensor.saturation_gray) == (dark, top)
    for electrons in (400.0, 6000.0, 80_000.0):
        expected = dark + (top - dark) * math.sqrt(min(0.25 * electrons / (top - dark), 1.0))
        assert gray_levels(even(sensor, electrons / 0.6).values, sensor)[0, 0] == pytest.approx(expected, rel=EXACT)
        # A table that rises keeps medians; that of Poisson's distribution lies within an electron of its mean.
        frame = noisy_frame(even(sensor, electrons / 0.6), sensor, fixed_pattern(sensor), 0, 0).values
        spread = math.sqrt(math.pi / 2 / frame.size * (electrons + 80))
        slope = 0.25 * (top - dark) / (2 * (expected - dark))
        assert abs(np.median(frame) - expected) <= 0.5 + slope * (1 + SURE * spread)


def test_power_law_and_linear_cameras_give_the_same_bytes(tmp_path: Path) -> None:
    """Gamma 1, no noise: K of Eq. 5 is K eta A lambda/(h c)."""
    small = TABLE | {"rows": 10, "columns": 12, "offset": 7, "pixel_width": "50 um", "pixel_height": "40 um"}
    gain = 0.25 * 0.6 * 100 * MU_P_OF_H
    law = {
        **{key: small[key] for key in ("rows", "columns", "pixel_width", "pixel_height", "bit_depth")},
        **{"gain": f"{gain!r} (J/m^2)^-1", "gamma": 1.0, "dark_gray": 7, "saturation_gray": 3007},
    }
    # One is dim, one saturates in its middle.
    for time in ("20 ms", "400 ms"):
        files = []
        for kind, table in (("linear", small), ("law", law)):
            out = tmp_path / kind
            radwrap.render(scene_with(table, exposure_time=time), out, method="pinhole")
            files.append((out / "gray.png").read_bytes())
        assert files[0] == files[1]
        levels = read_gray(tmp_path / "law" / "gray.png").values
        assert levels.max() > 100


@pytest.mark.parametrize("photons", [0, 2000, 12000])
def test_noise_is_that_of_the_standard(photons: float) -> None:
    """var_y = K^2 sd^2 + 1/12 + K (mu_y - mu_y.dark) over 20 frames of 60 000 pixels."""
    sensor = sensor_of()
    pattern = fixed_pattern(sensor)
    frames = np.stack([noisy_frame(even(sensor, photons), sensor, pattern, 3, k).values for k in range(20)])
    mean = closed.transfer_mean(0.6 * photons, gain=0.25, offset=100)
    variance = closed.transfer_variance(0.6 * photons, gain=0.25, read_noise=8)
    assert abs(frames.mean() - mean) < SURE * math.sqrt(variance / frames.size)
    assert abs(frames.var() / variance - 1) < SURE * math.sqrt(2 / frames.size)
    assert noise_variance(even(sensor, photons).values, sensor)[0, 0] == pytest.approx(variance, rel=1e-9)


@pytest.mark.parametrize("photons", [20_000, 40_000])
def test_read_noise_and_pattern_go_on_where_the_well_is_full(photons: float) -> None:
    """Half of the frames' light is cut at the full well itself, all of it beyond; the read-out comes after."""
    sensor = sensor_of(dsnu="3 e", defects={})
    exposure = even(sensor, photons)
    told = noise_variance(exposure.values, sensor)[0, 0]
    frame = noisy_frame(exposure, sensor, fixed_pattern(sensor), 3, 0).values
    behind = closed.transfer_variance(0, gain=0.25, read_noise=math.hypot(8, 3))
    if photons > 20_000:
        assert told == pytest.approx(behind, rel=EXACT)
        assert frame.var() == pytest.approx(told, rel=SURE * math.sqrt(2 / frame.size))
    else:
        assert told == pytest.approx(behind + 0.25**2 * 12000 / 4, rel=1e-9)


def test_highest_signal_to_noise_ratio_is_the_root_of_the_full_well() -> None:
    sensor = sensor_of(read_noise="0 e", full_well="10 ke", rounding=False)
    frame = noisy_frame(even(sensor, 9500 / 0.6), sensor, fixed_pattern(sensor), 1, 0).values
    ratio = (frame.mean() - 100) / frame.std()
    assert ratio == pytest.approx(math.sqrt(9500), rel=SURE / math.sqrt(2 * frame.size))


def test_fixed_pattern_stays_with_the_specimen() -> None:
    sensor = sensor_of(dsnu="40 e", prnu=0.03, read_noise="1 e")
    pattern = fixed_pattern(sensor)
    one, other = (noisy_frame(even(sensor, 10000), sensor, pattern, seed, 0).values for seed in (1, 2))
    dark = [noisy_frame(even(sensor, 0), sensor, pattern, seed, 0).values for seed in (1, 2)]
    number = one.size
    # The covariance of two frames is the spatial variance; what is drawn for each frame is not in it.
    spatial = np.cov(one.ravel(), other.ravel())[0, 1]
    assert np.cov(dark[0].ravel(), dark[1].ravel())[0, 1] == pytest.approx((0.25 * 40) ** 2, rel=2 * SURE / number**0.5)
    assert spatial == pytest.approx(0.25**2 * (40**2 + (0.03 * 6000) ** 2), rel=2 * SURE / number**0.5)
    another = fixed_pattern(replace(sensor, linear=replace(sensor.linear, device_seed=1)))  # type: ignore[type-var]
    assert abs(np.corrcoef(pattern.dark.ravel(), another.dark.ravel())[0, 1]) < SURE / number**0.5


def test_defect_pixels() -> None:
    sensor = sensor_of(defects={"hot": 0.01, "dead": 0.02}, read_noise="0 e")
    frame = noisy_frame(even(sensor, 10000), sensor, fixed_pattern(sensor), 0, 0).values
    for level, share in ((3100, 0.01), (100, 0.02)):
        found = float(np.mean(frame == level))
        assert abs(found - share) < SURE * math.sqrt(share / frame.size)


def test_noise_cut_by_the_converter_stays_in_its_range() -> None:
    sensor = sensor_of(offset=0, full_well="1000 ke", read_noise="100 e")
    for photons, level in ((0, 0), (1e7, 4095), (1e18, 4095)):
        frame = noisy_frame(even(sensor, photons), sensor, fixed_pattern(sensor), 0, 0).values
        assert 0 <= frame.min() <= frame.max() <= 4095
        assert np.median(frame) == level


def test_frames_are_the_same_bytes_whatever_the_workers(tmp_path: Path) -> None:
    small = TABLE | {"rows": 12, "columns": 14}
    contents = []
    for workers in (1, 2):
        out = tmp_path / str(workers)
        result = radwrap.render(scene_with(small), out, method="pinhole", frames=2, seed=5, workers=workers)
        names = [f"frame_{k:04d}.png" for k in range(2)]
        assert set(names) <= set(result.manifest["files"])
        contents.append([(out / name).read_bytes() for name in names])
    assert contents[0] == contents[1]
    assert contents[0][0] != contents[0][1]
    # Without the frames it is another result, and the old ones are gone.
    radwrap.render(scene_with(small), tmp_path / "1", method="pinhole", seed=5)
    assert not list((tmp_path / "1").glob("frame_*"))


def test_a_power_law_has_no_frames(tmp_path: Path) -> None:
    scene = Bench.scene(
        Bench.camera(), [Bench.lamp((0.3, 0, 0.5))], {"w": {"type": "lambertian", "reflectance": 0.5}},
        [{"type": "sheet", "material": "w", "size": ["1 m", "1 m"]}],
    )  # fmt: skip
    with pytest.raises(radwrap.InputError, match="the power law has no noise"):
        radwrap.render(scene, tmp_path, method="pinhole", frames=1)


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "no unit": ({"read_noise": 8}, r"camera\.sensor\.read_noise: 8 has no unit"),
    "wrong unit": ({"system_gain": "0.25 e/DN"}, r"camera\.sensor\.system_gain: .*not a unit of system gain"),
    "no efficiency": ({"quantum_efficiency": None}, r"camera\.sensor: needs quantum_efficiency"),
    "too efficient": ({"quantum_efficiency": 1.2}, r"camera\.sensor\.quantum_efficiency: must be at most 1"),
    "no well": ({"full_well": None}, r"camera\.sensor\.full_well: is missing"),
    "unknown": ({"ful_well": "1 e"}, r"camera\.sensor\.ful_well: unknown key"),
    "half of the heat": ({"temperature": "30 degC"}, r"camera\.sensor: .*go together"),
    "two efficiencies": (
        {"quantum_efficiencies": [["600 nm", 0.5], ["700 nm", 0.3]]},
        r"camera\.sensor: needs one of quantum_efficiency and quantum_efficiencies",
    ),
    "outside": (
        {"quantum_efficiency": None, "quantum_efficiencies": [["400 nm", 0.1], ["600 nm", 0.2]]},
        r"camera\.sensor: quantum_efficiencies: reach from 400 to 600 nm, the wavelength is 650 nm",
    ),
    "dark fills": ({"dark_current": "1e6 e/s"}, r"camera\.sensor\.dark_current: the dark signal of 2e\+04 electrons"),
    "heat overflows": (
        {
            "dark_current": "1 e/s",
            "dark_current_temperature": "25 degC",
            "doubling_temperature": "0.1 K",
            "temperature": "130 degC",
        },
        r"camera\.sensor\.dark_current: the dark signal of inf electrons",
    ),
    "no pixels": ({"defects": {"hot": 0.5, "dead": 0.5}}, r"camera\.sensor\.defects: no pixel is left"),
    "two windows": ({"fill_width": 0.5, "sensitivity_across": [1.0]}, r"camera\.sensor: needs one of fill_width"),
    "blind": ({"sensitivity_down": [0.0, 0.0]}, r"camera\.sensor: sensitivity_down: all are 0"),
    "NaN": ({"prnu": math.nan}, r"camera\.sensor\.prnu: is not a finite number"),
    "sheet": ({"data_sheet": "none.toml"}, r'camera\.sensor\.data_sheet: no file "none\.toml" beside the scene'),
    "escape": ({"data_sheet": "../../etc/passwd"}, r"lies outside the scene's folder"),
    "model": ({"model": "quadratic"}, r"camera\.sensor\.model: 'quadratic' is not one of"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_values_are_one_clear_error(name: str) -> None:
    changes, message = BAD[name]
    with pytest.raises(radwrap.InputError, match=message):
        sensor_of(**changes)


def test_a_data_sheet_gives_what_the_scene_does_not_say(tmp_path: Path) -> None:
    sheet = "\n".join(f"{key} = {value!r}" for key, value in TABLE.items() if key not in {"model", "wavelength"})
    (tmp_path / "sheet.toml").write_text(sheet.replace("'", '"'))
    table = {"model": "linear", "data_sheet": "sheet.toml", "wavelength": "650 nm"}
    white = {"type": "lambertian", "reflectance": 0.5}
    document = {
        "camera": Bench.camera() | {"exposure_time": "20 ms", "sensor": table},
        "sources": [Bench.lamp((0.3, 0, 0.5))],
        "materials": {"white": white},
        "targets": [{"type": "sheet", "material": "white", "size": ["1 m", "1 m"]}],
    }
    scene = radwrap.scene_from_document(document, folder=tmp_path)
    assert scene.camera.sensor == sensor_of()
    louder = radwrap.with_value(scene, "camera.sensor.read_noise", "20 e").camera.sensor.linear
    assert louder is not None
    assert louder.read_noise == 20
    for line, told in {
        'read_noise = "-1 e"': r'data_sheet: "sheet\.toml": read_noise: must be at least 0',
        'full_well = "0 e"': r'data_sheet: "sheet\.toml": full_well: must be above zero',
        "well = 3": r'data_sheet: "sheet\.toml": well: unknown key',
        "prnu = [1]": r'data_sheet: "sheet\.toml": prnu: must be',
    }.items():
        kept = [row for row in sheet.replace("'", '"').splitlines() if not row.startswith(line.split()[0])]
        (tmp_path / "sheet.toml").write_text("\n".join([*kept, line]))
        with pytest.raises(radwrap.InputError, match=told):
            radwrap.scene_from_document(document, folder=tmp_path)
    document["camera"]["sensor"] = table | {"read_noise": "-1 e"}
    with pytest.raises(radwrap.InputError, match=r"scene: camera\.sensor\.read_noise: must be"):
        radwrap.scene_from_document(document, folder=tmp_path)
    document["camera"]["sensor"] = table
    (tmp_path / "sheet.toml").write_text("rows = ")
    with pytest.raises(radwrap.InputError, match=r'data_sheet: "sheet.toml": is not TOML'):
        radwrap.scene_from_document(document, folder=tmp_path)


def test_a_sheets_efficiency_gives_way_and_holds_at_its_wavelength_alone(tmp_path: Path) -> None:
    sheet = "\n".join(f"{key} = {value!r}" for key, value in TABLE.items() if key != "model")
    (tmp_path / "sheet.toml").write_text(sheet.replace("'", '"'))

    def efficiency(**changes: Any) -> float:
        sensor = {"model": "linear", "data_sheet": "sheet.toml"} | changes
        found = with_data_sheet({"camera": {"sensor": sensor}}, "scene.toml", tmp_path)["camera"]["sensor"]
        model = LinearSensorModel.model_validate({k: v for k, v in found.items() if k != "data_sheet"})
        return model.efficiency()

    assert efficiency() == efficiency(wavelength="0.65 um") == 0.6
    table = [["400 nm", 0.1], ["500 nm", 0.3]]
    assert efficiency(wavelength="450 nm", quantum_efficiencies=table) == pytest.approx(0.2, rel=EXACT)
    assert efficiency(wavelength="450 nm", quantum_efficiency=0.4) == 0.4
    with pytest.raises(radwrap.InputError, match=r"data_sheet: its quantum_efficiency is that of 650 nm"):
        efficiency(wavelength="450 nm")


def test_a_sensor_comes_back_from_a_manifest() -> None:
    for sensor in (sensor_of(), sensor_of(fill_width=0.5, sensitivity_down=[1.0, 3.0])):
        assert read_back(plain(sensor), Sensor, "manifest") == sensor


# ------------------------------------------------------------------------------------------------ Spatial response


def test_profiles_and_their_inverse() -> None:
    assert box(0.5).share_below(np.array([-0.5, -0.25, 0.0, 0.125, 0.3])) == pytest.approx([0, 0, 0.5, 0.75, 1])
    profile = strips((0.0, 3.0, 0.0, 1.0))
    assert profile.share_below(np.array([-0.25, -0.125, 0.0, 0.25, 0.375])) == pytest.approx(
        [0, 0.375, 0.75, 0.75, 0.875]
    )
    shares = np.linspace(0.01, 0.99, 197)
    for each in (profile, box(0.3), box(1.0), strips((1.0, 2.0, 1.0))):
        assert each.share_below(each.place(shares)) == pytest.approx(shares, rel=EXACT)


def test_the_window_weights_what_kernel_rays_and_viewpoints_gather() -> None:
    """A step of light across the pixel at 0.2 pitch is seen as the share of the sensitivity beyond it."""
    window = PixelWindow(strips((1.0, 2.0, 4.0, 1.0)), box(0.5))
    beyond = 1 - (3 + 4 * 0.8) / 8  # 0.2 pitch lies at 0.8 of the third of four strips
    # The kernel's cells of 0.1 px are not a power of two, so that 0.2 is an edge of theirs.
    print_ = folded(np.zeros((1, 2)), np.ones(1), 0.1, window=window)
    cells = (print_.first[1] + np.arange(print_.weights.shape[1])) * 0.1 - 0.5
    assert print_.weights.sum() == pytest.approx(1, rel=EXACT)
    assert print_.weights[:, cells > 0.2 - 1e-9].sum() == pytest.approx(beyond, rel=1e-9)
    down = (print_.first[0] + np.arange(print_.weights.shape[0])) * 0.1 - 0.5
    assert print_.weights[(down > -0.2 - 1e-9) & (down < 0.2 - 1e-9)].sum() == pytest.approx(0.8, rel=1e-9)
    sensor = replace(sensor_of(), window=window)
    camera = replace(scene_with(TABLE).camera, sensor=sensor)
    _, u, _ = rays_over(camera, np.zeros(64), np.zeros(64), 4096, np.random.default_rng(0))
    assert float(np.mean(u > 0.2)) == pytest.approx(beyond, abs=1e-3)  # Sobol points: far below 1/4096 each
    places = window.places((np.stack(np.meshgrid(np.arange(50), np.arange(50)), axis=-1) + 0.5) / 50)
    assert float(np.mean(places[..., 0] > 0.2)) == pytest.approx(beyond, abs=0.01)  # strata of 1/50


def test_kernel_and_rays_agree_behind_a_window() -> None:
    """Where the window enters wrongly, an edge seen by one would lie elsewhere than by the other."""
    edge = {"type": "edge", "material": "dark", "edge_material": "white", "size": ["1 m", "1 m"]}
    table = TABLE | {
        **{"rows": 4, "columns": 20, "pixel_width": "100 um", "pixel_height": "100 um", "system_gain": "0.001 DN/e"},
        **{"full_well": "5000 ke", "sensitivity_across": [0.0, 0.0, 1.0, 3.0], "rounding": False},
    }
    camera = Bench.camera(focal_length=0.01) | {"exposure_time": "200 ms", "sensor": table}
    materials = {name: {"type": "lambertian", "reflectance": r} for name, r in (("dark", 0.05), ("white", 0.9))}
    scene = Bench.scene(camera, [Bench.lamp((0.0, 0.0, 0.9))], materials, [edge])
    images = [
        radwrap.render(scene, method=method, tolerance=1.0).gray.values
        for method in ("kernel", "rays")  # type: ignore[arg-type]
    ]
    plain_scene = radwrap.with_value(scene, "camera.sensor.sensitivity_across", [1.0])
    whole = radwrap.render(plain_scene, method="rays", tolerance=1.0).gray.values
    span = images[0].max() - images[0].min()
    assert span > 100
    # Two images to 1 gray rms each; the window moves the edge by 0.31 px, which is much more.
    assert float(np.sqrt(np.mean((images[0] - images[1]) ** 2))) < 1.5
    assert float(np.sqrt(np.mean((images[0] - whole) ** 2))) > 3.0
