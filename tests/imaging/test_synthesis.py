"""Rendering from Python: what comes back, what it costs, how far it may be off."""

import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.imaging.demand import SamplingPlan
from radwrap.imaging.forecast.cost import check_size, estimate
from radwrap.imaging.forecasting import forecast
from radwrap.imaging.tolerance.certificate import certify_by_independent_rays
from radwrap.imaging.tracing import traced_scene

START = Path(__file__).parents[2] / "radwrap" / "data" / "init" / "scene.toml"


def scene(**changes: Any) -> radwrap.Scene:
    document = tomllib.loads(START.read_text())
    document["camera"]["sensor"] |= {"rows": 33, "columns": 48, "pixel_width": "55 um", "pixel_height": "80 um"}
    document["camera"]["diffraction"] = "off"  # it has its own tests
    return radwrap.scene_from_document(document, changes)


def test_a_result_holds_images_and_manifest_and_shows_itself(tmp_path: Path) -> None:
    result = radwrap.render(scene(), tmp_path / "out", viewpoints=7)
    assert result.radiant_exposure.values.shape == (33, 48)
    assert result.gray.codes.dtype == np.uint8
    assert result.manifest["viewpoints"] == 7
    assert result.manifest["gray"]["max"] == result.gray.values.max()
    assert result._repr_png_().startswith(b"\x89PNG")
    assert {path.name for path in (tmp_path / "out").iterdir() if not path.name.startswith(".")} == {
        "gray.png",
        "radiant_exposure.exr",
        "manifest.json",
    }


def test_a_result_holds_the_truth_that_was_asked_for(tmp_path: Path) -> None:
    """A board turned by no angle, 0.79 m away: all of it has that depth, whatever the pixel."""
    flat = scene(**{"targets[0].rotation": ["0 deg", "0 deg", "0 deg"]})
    assert radwrap.render(flat, tmp_path, viewpoints=1).truth is None
    truth = radwrap.render(flat, tmp_path, viewpoints=1, truth=True).truth
    assert truth is not None
    depth, mask = truth["depth"], truth["mask"]
    assert depth.shape == mask.shape == (33, 48)
    assert depth.dtype == np.float32 and mask.dtype == np.uint16
    assert set(np.unique(mask)) - {0} == {truth["parts"]["board.surface"], truth["parts"]["board.dots"]}
    assert depth[mask > 0] == pytest.approx(0.79, rel=1e-6)
    middle = next(dot for dot in truth["targets"]["board"]["dots"] if (dot["row"], dot["column"]) == (2, 2))
    assert mask[round(middle["v"]), round(middle["u"])] == truth["parts"]["board.dots"]
    # As it comes from the folder, also of a run that was finished before.
    again = radwrap.render(flat, tmp_path, viewpoints=1, truth=True).truth
    assert again is not None and (again["depth"] == depth).all()


@pytest.mark.long
def test_files_of_an_older_run_do_not_stay_beside_the_new_image(tmp_path: Path) -> None:
    radwrap.render(scene(), tmp_path, viewpoints=1, truth=True)
    assert (tmp_path / "truth.json").is_file()
    (tmp_path / ".gray.part.png").write_bytes(b"half")
    radwrap.render(scene(**{"camera.exposure_time": "1 ms"}), tmp_path, viewpoints=1)
    assert {path.name for path in tmp_path.iterdir()} == {
        ".radwrap.lock",
        "gray.png",
        "radiant_exposure.exr",
        "manifest.json",
    }


def test_nothing_stays_where_no_folder_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    radwrap.render(scene(), viewpoints=1)
    assert list(tmp_path.iterdir()) == []


def test_the_manifest_suffices_to_make_the_image_again(tmp_path: Path) -> None:
    import json

    first = radwrap.render(scene(), tmp_path / "a", viewpoints=7, pixel_samples=2, pixel_sampling="jitter", seed=5)
    told = first.manifest
    again = radwrap.render(
        radwrap.scene_from_document(json.loads(told["scene"])),
        tmp_path / "b",
        method=told["method"],
        viewpoints=told["viewpoints"],
        layout=told["layout"],
        pixel_samples=told["pixel_samples"],
        pixel_sampling=told["pixel_sampling"],
        seed=told["seed"],
    )
    assert again.manifest["files"] == told["files"]
    assert again.manifest["scene_sha256"] == told["scene_sha256"]


def test_a_sensor_that_does_not_round_keeps_its_fractions(tmp_path: Path) -> None:
    smooth = radwrap.render(scene(**{"camera.sensor.rounding": False}), tmp_path / "a", viewpoints=7)
    rounded = radwrap.render(scene(), tmp_path / "b", viewpoints=7)
    assert (smooth.gray.values % 1 != 0).any()
    assert np.array_equal(np.rint(smooth.gray.values), rounded.gray.values)
    assert (tmp_path / "a" / "gray.exr").is_file()


def test_more_than_eight_bits_make_a_png_of_sixteen(tmp_path: Path) -> None:
    changes = {"camera.sensor.bit_depth": 12, "camera.sensor.saturation_gray": 4000, "camera.sensor.dark_gray": 300}
    result = radwrap.render(scene(**changes, **{"camera.sensor.gain": "7e5 (J/m^2)^-0.85"}), tmp_path, viewpoints=7)
    assert result.gray.codes.dtype == np.uint16
    assert result.gray.values.max() > 1000


def test_the_image_does_not_depend_on_the_workers() -> None:
    one, three = (radwrap.render(scene(), viewpoints=7, workers=workers) for workers in (1, 3))
    assert one.manifest["files"] == three.manifest["files"]


@pytest.mark.parametrize(
    ("how", "rays", "pixels"),
    [
        ({"viewpoints": 7}, 48, 500),
        pytest.param({"method": "pinhole"}, 48, 500, marks=pytest.mark.long),
        pytest.param({"tolerance": 2.0}, 256, 500, marks=pytest.mark.long),  # test_lens
        pytest.param({"method": "rays", "tolerance": 2.0}, 256, 500, marks=pytest.mark.long),  # test_certificate
        *(pytest.param(how, 256, 1500, marks=pytest.mark.long) for how in ({"tolerance": 2.0}, {"method": "rays"})),
    ],
)
def test_the_stated_error_is_about_the_true_one(how: dict[str, Any], rays: int, pixels: int) -> None:
    """Against other rays at other pixels; the bound holds, and is no idle one. 48 rays know large errors to 1 %.

    500 pixels know the rms to some 10 %: an error that is stated twice too small or too large is seen by them too.
    """
    smooth = scene(**{"camera.sensor.rounding": False})
    result = radwrap.render(smooth, **how)
    with traced_scene(smooth) as view:
        radiance = result.radiant_exposure.values / view.exposure_of_radiance
        true = certify_by_independent_rays(view, radiance, 77, pixels=pixels, rays=rays).rms_gray
    error = result.manifest["error"]
    assert 0.6 * true < error["rms_gray"] < 1.6 * true
    assert true < error["rms_gray_upper95"] < 3 * true


def test_large_sensors_are_refused_with_their_cost() -> None:
    big = scene(**{"camera.sensor.rows": 40_000, "camera.sensor.columns": 40_000})
    with pytest.raises(InputError, match=r"1\.6e\+09 pixels .* rays, .* GiB of memory, .* (hours|days)"):
        radwrap.render(big)
    check_size(big, 2_000_000_000, 37, 2)


@pytest.mark.long
def test_replicates_that_are_kept_count_in_the_forecast() -> None:
    plan = SamplingPlan("kernel", cell=0.5)
    plain, planned = (forecast(scene(), radwrap.RenderOptions(workers=1, sampling=some)) for some in (None, plan))
    # Each at least as float32 on the disk and twice as float64.
    assert planned.memory_bytes - plain.memory_bytes >= 12 * 20 * 33 * 48
    assert planned.rays == 12 * 4 * 33 * 48
    big = scene(**{"camera.sensor.rows": 8000, "camera.sensor.columns": 10_000})
    told = [re.search(r"([\d.e+]+) GiB", str(error.value)) for error in map(refusal_of, [big] * 2, [None, plan])]
    assert told[0] and told[1] and float(told[1][1]) > 4 * float(told[0][1])


def refusal_of(big: radwrap.Scene, plan: SamplingPlan | None) -> pytest.ExceptionInfo[InputError]:
    """Why a sensor is too large."""
    with pytest.raises(InputError) as error:
        radwrap.render(big, sampling=plan, workers=1)
    return error


def test_a_forecast_measures_the_time_of_a_ray() -> None:
    cost = forecast(scene(), radwrap.RenderOptions(viewpoints=7, workers=2))
    assert cost.rays == 33 * 48 * 7
    assert 1e-7 < cost.seconds / cost.rays < 1e-3
    assert estimate(scene(), 7 * 33 * 48, 2).seconds == pytest.approx(cost.rays * 7.8e-6 / 2)


@pytest.mark.parametrize(
    "options", [{"viewpoints": 0}, {"pixel_samples": 0}, {"workers": 0}, {"seed": -1}, {"tracer_timeout": float("nan")}]
)
def test_options_out_of_range_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="must lie between"):
        radwrap.render(scene(), **options)
