"""A small dataset from its file to its shards, in this process; what hangs on processes is in test_resume."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from radwrap.cli.main import main
from radwrap.dataset import run
from radwrap.dataset.run_lengths import run_lengths
from radwrap.files import sha256_of
from radwrap.imaging import tracer_choice
from tests.dataset.conftest import Write
from tests.study.conftest import OneThread

SMALL = """
images = 3
shard = 2
seed = 4
tolerance = 8

[[vary]]
key = "camera.exposure_time"
uniform = ["50 ms", "150 ms"]

[[parts]]
target = "block"
count = 2
x = ["-15 mm", "15 mm"]
y = ["-10 mm", "10 mm"]
"""


@pytest.fixture(autouse=True)
def _here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "LocalPool", OneThread)
    monkeypatch.setattr(tracer_choice, "WORTH_COMPILED", 1)  # the compiled tracer is loaded for the truth anyhow


def contents(out: Path) -> dict[str, str]:
    """Hash of each file, but for the lock."""
    return {str(one.relative_to(out)): sha256_of(one) for one in out.rglob("[!.]*") if one.is_file()}


def read(path: Path) -> Any:
    return json.loads(path.read_text())


def mask(path: Path) -> np.ndarray:
    found = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert found is not None and set(np.unique(found)) <= {0, 255}
    return found > 0


PULSED = """
images = 1
tolerance = 8

[set]
"camera.sensor.shutter" = "rolling"
"camera.sensor.line_time" = "2 ms"
"sources[0].strobe" = { delay = "-10 ms", width = "60 ms" }
"""


def test_rows_and_pulses_are_in_the_image_and_not_in_the_truth(
    dataset_file: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Row r begins 2 r ms late: of the pulse, which ends at 50 ms, it gathers 50 - 2 r ms; exposures are of 100 ms."""
    assert main(["dataset", "run", str(dataset_file(PULSED)), "--out", str(tmp_path / "pulsed")]) == 0
    assert (
        main(["dataset", "run", str(dataset_file("images = 1\ntolerance = 8")), "--out", str(tmp_path / "still")]) == 0
    )
    capsys.readouterr()
    pulsed, still = (tmp_path / name / "train" / "000000" for name in ("pulsed", "still"))
    for truth in ("depth/000000.png", "mask/000000_000000.png", "edges/000000.png"):
        assert (pulsed / truth).read_bytes() == (still / truth).read_bytes()
    lit, steady = (cv2.imread(str(one / "gray/000000.png"), -1)[:, 2].astype(float) - 20 for one in (pulsed, still))
    open_time = np.clip(50 - 2 * np.arange(len(lit)), 0, None) / 100
    assert lit / steady == pytest.approx(open_time, abs=0.03) and steady.min() > 30
    assert read(pulsed / "records/000000.json")["poses_at_s"] == pytest.approx(0.05)
    assert "poses_at_s" not in read(still / "records/000000.json")


LIT = """
images = 1
tolerance = 4

[set]
"sources[0].radiance" = "4000 kW/m^2/sr"
"materials.black" = { type = "lambertian", reflectance = 0.03 }
"targets[0].material" = "black"
"""
FLASH = """
"targets[1].velocity" = ["40 mm/s", "0 mm/s", "0 mm/s"]
"sources[0].strobe" = {{ delay = "{} ms", width = "5 ms" }}
"""
STANDS = """
"targets[1].position" = ["{} mm", "0 mm", "0 mm"]
"camera.exposure_time" = "5 ms"
"""


@pytest.mark.long
def test_what_moves_is_where_the_flash_found_it(
    dataset_file: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Truth is of 50 ms: a flash then shows the block in its mask, one 45 ms later 1.8 mm beside it."""
    centres, masks = {}, {}
    for name, more in (
        ("then", FLASH.format("47.5")),
        ("later", FLASH.format("92.5")),
        ("here", STANDS.format(0)),
        ("beside", STANDS.format(1.8)),
    ):
        path = dataset_file(LIT + more)
        assert main(["dataset", "run", str(path), "--out", str(tmp_path / name)]) == 0
        folder = tmp_path / name / "train" / "000000"
        gray = cv2.imread(str(folder / "gray/000000.png"), -1).astype(float)
        block = np.clip(gray - 0.3 * gray.max(), 0, None)  # without the table
        centres[name] = float((block * np.arange(48)).sum() / block.sum())
        masks[name] = mask(folder / "mask_visib/000000_000000.png")
    capsys.readouterr()
    assert (masks["then"] == masks["here"]).all() and (masks["later"] == masks["here"]).all()
    assert (masks["here"] != masks["beside"]).any()
    assert centres["then"] == pytest.approx(centres["here"], abs=0.05)
    assert centres["later"] == pytest.approx(centres["beside"], abs=0.05)
    assert abs(centres["later"] - centres["then"]) > 1


def test_a_dataset_is_whole_goes_on_and_agrees_with_itself(
    dataset_file: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, path = tmp_path / "out", dataset_file(SMALL)
    assert main(["dataset", "run", str(path), "--out", str(out), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["images"], told["made"], told["objects"], told["missed"]) == (3, 3, {"block": 6}, {})
    before = contents(out)

    for shard, numbers in (("000000", (0, 1)), ("000001", (2,))):
        folder = out / "train" / shard
        coco, manifest = read(folder / "coco.json"), read(folder / "manifest.json")
        assert [one["id"] for one in coco["images"]] == [one["image"] for one in manifest["images"]] == list(numbers)
        assert coco["categories"] == [{"id": 1, "name": "block"}]
        for image, entry in zip(coco["images"], manifest["images"], strict=True):
            gray = cv2.imread(str(folder / image["file_name"]), cv2.IMREAD_UNCHANGED)
            assert gray is not None and gray.shape == (image["height"], image["width"]) == (40, 48)
            assert 0 <= entry["error"]["rms_gray_upper95"] <= 8 and entry["met"]
            assert 50 <= float(entry["values"]["camera.exposure_time"].split()[0]) <= 150
            record = read(folder / "records" / Path(image["file_name"]).with_suffix(".json").name)
            assert {name: sha256_of(folder / name) for name in record["files"]} == record["files"]
            found = {one["name"]: one for one in coco["annotations"] if one["image_id"] == image["id"]}
            stem = Path(image["file_name"]).stem
            for number, one in enumerate(record["objects"]):
                visible = mask(folder / "mask_visib" / f"{stem}_{number:06d}.png")
                whole = mask(folder / "mask" / f"{stem}_{number:06d}.png")
                assert (whole | ~visible).all() and visible.sum() == one["px_count_visib"]
                if one["px_count_visib"] == 0:
                    assert one["name"] not in found
                    continue
                annotation = found[one["name"]]
                x, y, width, height = annotation["bbox"]
                cut = visible[y : y + height, x : x + width]
                assert cut.sum() == visible.sum() == annotation["area"] == sum(run_lengths(visible)[1::2])
                assert cut.any(axis=1)[[0, -1]].all() and cut.any(axis=0)[[0, -1]].all()

    # What is lost is made again, the same to the byte; what is whole is not touched.
    kept = (out / "train" / "000000" / "records" / "000000.json").stat().st_mtime_ns
    for lost in ("000000/records/000001.json", "000000/gray/000001.png", "000001/coco.json"):
        (out / "train" / lost).unlink()
    cut = next((out / "train" / "000001" / "gray").glob("*.png"))
    cut.write_bytes(cut.read_bytes()[:50])
    assert main(["dataset", "run", str(path), "--out", str(out)]) == 0
    assert "3 images, 2 of them made now; 6 block" in capsys.readouterr().out
    assert contents(out) == before
    assert (out / "train" / "000000" / "records" / "000000.json").stat().st_mtime_ns == kept

    # Another dataset does not go into its folder, unless that is asked for.
    other = dataset_file(SMALL.replace("images = 3", "images = 1").replace("count = 2", "count = 0"))
    assert main(["dataset", "run", str(other), "--out", str(out)]) == 2
    assert "holds another dataset" in capsys.readouterr().err
    assert contents(out) == before
    assert main(["dataset", "run", str(other), "--out", str(out), "--force"]) == 0
    assert read(out / "train" / "000000" / "coco.json")["annotations"] == []
    assert not (out / "train" / "000001").exists()

    # What no dataset wrote is never removed.
    (tmp_path / "own" / "train").mkdir(parents=True)
    (tmp_path / "own" / "train" / "mine.txt").write_text("mine")
    assert main(["dataset", "run", str(other), "--out", str(tmp_path / "own"), "--force"]) == 2
    assert 'holds a folder "train" that no dataset wrote' in capsys.readouterr().err
    assert (tmp_path / "own" / "train" / "mine.txt").read_text() == "mine"
    (tmp_path / "calibrated").mkdir()
    (tmp_path / "calibrated" / "camera.json").write_text("mine")
    assert main(["dataset", "run", str(other), "--out", str(tmp_path / "calibrated"), "--force"]) == 2
    assert 'holds a file "camera.json" that no dataset wrote' in capsys.readouterr().err
    assert (tmp_path / "calibrated" / "camera.json").read_text() == "mine"


LINEAR = (
    '[set]\n"camera.sensor" = { model = "linear", rows = 20, columns = 24, pixel_width = "0.1 mm", '
    'pixel_height = "0.1 mm", offset = 20, wavelength = "650 nm", quantum_efficiency = 0.5, '
    'system_gain = "0.01 DN/e", full_well = "20 ke", read_noise = "300 e" }\n"camera.exposure_time" = "1 us"'
)


def test_noise_is_that_of_one_frame(dataset_file: Write, tmp_path: Path) -> None:
    """Of read noise of 300 electrons 3 gray levels: within five standard errors of 480 pixels, rounding included."""
    images = []
    for noise in ("true", "false"):
        path = dataset_file(f"images = 1\ntolerance = 8\nnoise = {noise}\n{LINEAR}")
        assert main(["dataset", "run", str(path), "--out", str(tmp_path / noise)]) == 0
        image = cv2.imread(str(tmp_path / noise / "train" / "000000" / "gray" / "000000.png"), cv2.IMREAD_UNCHANGED)
        assert image is not None
        images.append(image.astype(float))
    sigma = np.sqrt(9 + 1 / 12)
    assert abs((images[0] - images[1]).std() - sigma) < 5 * sigma / np.sqrt(2 * 480)


def test_an_image_that_cannot_be_made_is_named(
    dataset_file: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = dataset_file('images = 2\n[[parts]]\ntarget = "block"\ncount = 2')
    assert main(["dataset", "run", str(path), "--out", str(tmp_path / "out")]) == 2
    assert 'dataset.toml: parts[0]: image 0: "block_2" found no place' in capsys.readouterr().err
