"""Photon transfer: what went into simulated frames comes back; and tables and frames that cannot be evaluated."""

import io
import json
import math
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from radwrap.cli.main import main
from radwrap.errors import InputError
from radwrap.images import ExposureImage, write_png
from radwrap.imaging.response.noise import fixed_pattern, linear_of, noisy_frame
from radwrap.measure.emva import Stack, photon_transfer, read_stacks
from radwrap.measure.emva.transfer import PhotonTransfer
from tests.physics.test_linear_sensor import MU_P_OF_H, sensor_of

GAIN = 0.005  # asked for by the validation plan, as a share
READ_NOISE = 0.02
STEPS = 24
LONGEST = 0.05  # s

CAMERA: dict[str, Any] = {"dsnu": "6 e", "prnu": 0.01, "dark_current": "20 ke/s"}


class Frames:
    """Frames of the test camera by name, made when they are read, and the table that names them."""

    def __init__(self, table: Path, *, stack: int = 8, **changes: Any) -> None:
        self._made: dict[str, tuple[float, float, int]] = {}
        self._changes = CAMERA | changes
        lines = ["file,exposure_time,dark"]
        for step in range(1, STEPS + 1):
            time = LONGEST * step / STEPS
            photons = 1.15 * 12000 / 0.6 * step / STEPS
            count = stack if step in (1, STEPS // 2 - 1) else 2
            for dark in (0, 1):
                for _ in range(count):
                    name = f"{len(self._made)}.png"
                    self._made[name] = (time, 0.0 if dark else photons, len(self._made))
                    lines.append(f"{name},{time!r},{dark}")
        table.write_text("\n".join(lines) + "\n")
        self.table = table

    def frame(self, path: Path) -> np.ndarray:
        time, photons, number = self._made[path.name]
        sensor = sensor_of(f"{time!r} s", **self._changes)
        exposure = ExposureImage(np.full((sensor.rows, sensor.columns), photons / MU_P_OF_H))
        return noisy_frame(exposure, sensor, fixed_pattern(sensor), 7, number).values

    def found(self) -> PhotonTransfer:
        kind, stacks = read_stacks(self.table, self.frame)
        photons_a_second = 1.15 * 12000 / 0.6 / LONGEST
        return photon_transfer(kind, stacks, photons_a_second)


def test_the_gains_standard_error_is_what_it_scatters_by() -> None:
    """Variances of 4 x 4 pixels and 201 frames are known to 2.5 % each, the bright ones as the dark ones.

    The slope through 40 even exposures then scatters by .025 sqrt(sum x^4)/sum x^2. Errors that are taken as equal for
    all give 1/1.34 of that.
    """
    random = np.random.default_rng(5)
    signal, gain, known = np.linspace(20, 800, 40), 0.1, 0.025
    dark = [Stack(0.0, True, 201, np.full((4, 4), 100.0), 0.01)]
    found = []
    for _ in range(400):
        variances = (gain * signal + 0.01) * (1 + known * random.standard_normal(signal.size))
        light = [
            Stack(s, False, 201, np.full((4, 4), 100.0 + s), v) for s, v in zip(signal, variances.tolist(), strict=True)
        ]
        found.append(photon_transfer("photons", [*dark, *light]))
    scatter = float(np.std([one.gain for one in found]))
    used = signal[signal <= 0.7 * signal[-1]]
    assert scatter == pytest.approx(gain * known * math.sqrt((used**4).sum()) / (used**2).sum(), rel=0.15)
    # 400 trials know a scatter to 3.5 %, and the mean of 400 standard errors is known better.
    assert np.mean([one.gain_sigma for one in found]) == pytest.approx(scatter, rel=0.12)


def test_what_went_in_comes_back(tmp_path: Path) -> None:
    found = Frames(tmp_path / "frames.csv").found()
    assert found.gain == pytest.approx(0.25, rel=GAIN)
    assert abs(found.gain - 0.25) < 4 * found.gain_sigma
    assert found.read_noise == pytest.approx(8, rel=READ_NOISE)
    assert found.quantum_efficiency == pytest.approx(0.6, rel=GAIN)
    assert found.dark_current == pytest.approx(20_000, rel=GAIN)
    assert found.dark_gray == pytest.approx(100, abs=0.1)
    # DSNU of 60 000 pixels, 8 frames: 0.3 % of itself, and of the frames' noise 0.5 %; PRNU likewise.
    assert found.dsnu == pytest.approx(6, rel=0.03)
    assert found.prnu == pytest.approx(0.01, rel=0.03)
    assert found.defects == 0
    # The variance is largest one step of 4.8 % before the full well at the most; dark electrons take part of it.
    assert found.saturated
    assert 0.9 * 12000 < found.saturation_electrons <= 12000
    # The plateau beyond tells the full well without that step.
    assert found.full_well == pytest.approx(12000, rel=GAIN)
    assert found.snr_max == pytest.approx(math.sqrt(found.saturation_electrons))
    assert found.linearity_error is not None and found.linearity_error < 1e-3
    assert found.notes == ()
    half = found.steps[STEPS // 2]
    electrons = half.signal / 0.25
    # The shot noise of the dark signal, 1 ke at the longest exposure, is part of it.
    dark = 20_000 * half.exposure
    assert half.snr == pytest.approx(electrons / math.sqrt(electrons + dark + 64 + 1 / 12 / 0.25**2), rel=0.02)


def test_a_bent_response_shows_as_linearity_error(tmp_path: Path) -> None:
    found = Frames(tmp_path / "frames.csv", gamma=0.85, dark_current="0 e/s").found()
    assert found.linearity_error is not None and found.linearity_error > 0.02


def test_defect_pixels_are_counted_and_kept_out(tmp_path: Path) -> None:
    share = 0.001
    found = Frames(tmp_path / "frames.csv", defects={"hot": share, "dead": 0.0}).found()
    assert abs(found.defects - share * 60_000) < 5 * math.sqrt(share * 60_000)
    assert found.dsnu == pytest.approx(6, rel=0.03)
    assert found.dsnu_all_pixels is not None and found.dsnu_all_pixels > 100


def test_noise_below_rounding_is_an_upper_limit(tmp_path: Path) -> None:
    found = Frames(tmp_path / "frames.csv", read_noise="0.5 e", dark_current="0 e/s", dsnu="0 e").found()
    assert found.read_noise == pytest.approx(math.sqrt(0.24 - 1 / 12) / 0.25, rel=GAIN)
    assert any("rounding hides" in note for note in found.notes)


def test_frames_without_saturation_say_so(tmp_path: Path) -> None:
    found = Frames(tmp_path / "frames.csv", full_well="20 ke", bit_depth=14).found()
    assert not found.saturated and found.full_well is None
    assert any("saturation is not reached" in note for note in found.notes)


def _by_hand(last: float) -> PhotonTransfer:
    """Of K = 0.5 exactly, 200 pixels and 2 frames; the last variance is a share of what it should be."""
    levels = np.arange(9) * 100.0
    stacks = [
        Stack(level, level == 0, 2, np.full((10, 20), 10 + level), 4 + 0.5 * level * (last if level == 800 else 1))
        for level in levels
    ]
    return photon_transfer("photons", stacks, 1.0)


def test_a_dip_of_the_variance_by_chance_is_no_saturation() -> None:
    """A variance of 200 pixels is known to 10 %: 15 % less is chance, 80 % less is not."""
    chance = _by_hand(0.85)
    assert not chance.saturated and chance.saturation_gray == 810
    assert any("saturation is not reached" in note for note in chance.notes)
    full = _by_hand(0.2)
    assert full.saturated and full.saturation_gray == 710
    assert full.saturation_electrons == pytest.approx(1400, rel=1e-9)
    assert full.full_well is None  # levels rise still: no plateau


QUIET: dict[str, Any] = {
    "bit_depth": 8,
    "offset": 20,
    "system_gain": "0.01875 DN/e",
    "dark_current": "0 e/s",
    "prnu": 0.0,
}


def test_rounding_of_a_quiet_camera_does_not_bend_the_gain(tmp_path: Path) -> None:
    """Noise of 0.36 gray about a whole gray level: rounded, its variance is 0.045 less than s^2 + 1/12.

    Through the origin that makes the slope 1.5 * 0.045/(0.7 * 225) = 2.3 % of K too large.
    """
    found = Frames(tmp_path / "frames.csv", **QUIET, read_noise="19.2 e", dsnu="0 e").found()
    assert abs(found.gain - 0.01875) < 4 * found.gain_sigma
    assert found.gain == pytest.approx(0.01875, rel=0.01)
    told = next(note for note in found.notes if "through the origin" in note)
    standard = float(told.split("gives ")[1].split()[0])
    assert standard / 0.01875 - 1 == pytest.approx(0.023, abs=0.006)


def test_how_far_rounding_pulls_the_dsnu_is_told(tmp_path: Path) -> None:
    """About a whole level the slope of E round(x + n) is 1 - 2 exp(-2 pi^2 s^2) cos(2 pi x); over pixels of a spread d

    its mean lacks 2 exp(-2 pi^2 (s^2 + d^2)), and so does the DSNU.
    """
    noise, spread = 0.4, 0.15
    changes = {"read_noise": f"{noise / 0.25} e", "dsnu": f"{spread / 0.25} e", "dark_current": "0 e/s"}
    found = Frames(tmp_path / "frames.csv", stack=16, **changes).found()
    lacks = 2 * math.exp(-2 * math.pi**2 * (noise**2 + spread**2))
    assert found.dsnu == pytest.approx(spread / 0.25 * (1 - lacks), rel=0.02)
    told = next(note for note in found.notes if "DSNU may be off" in note)
    assert float(told.split("by up to ")[1].rstrip("%")) / 100 > lacks


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Pictures of a folder with a blank, exposure by radiant exposure, plot and JSON."""
    folder = tmp_path / "two words"
    folder.mkdir()
    sensor = sensor_of(rows=60, columns=80)
    pattern = fixed_pattern(sensor)
    lines = ["file,radiant_exposure"]
    for step in range(9):
        level = 24000 * step / 8 / MU_P_OF_H
        for k in range(2):
            frame = noisy_frame(ExposureImage(np.full((60, 80), level)), sensor, pattern, 0, 2 * step + k)
            write_png(folder / f"{step} {k}.png", frame.codes)
            lines.append(f"{step} {k}.png,{level!r}")
    table = folder / "frames.csv"
    table.write_text("\n".join(lines) + "\n")
    light = ["--pixel-width", "5 um", "--pixel-height", "4 um", "--wavelength", "650 nm"]
    assert main(["measure", "emva", str(table), *light, "--json", "--plot", str(folder / "plot.png")]) == 0
    told = json.loads(capsys.readouterr().out)
    truth = linear_of(sensor)
    # 4800 pixels: some 2 % of each variance.
    assert told["gain"] == pytest.approx(truth.system_gain, rel=0.05)
    assert told["quantum_efficiency"] == pytest.approx(0.6, rel=0.05)
    assert len(told["steps"]) == 8 and told["exposure"] == "radiant_exposure"
    assert Image.open(io.BytesIO((folder / "plot.png").read_bytes())).size[0] > 800
    assert main(["measure", "emva", str(table)]) == 0
    assert "system gain: 0.2" in capsys.readouterr().out
    own = ["--write", str(folder / "own.toml"), "--revision", "2026-11-25"]
    assert main(["measure", "emva", str(table), *light, *own]) == 2
    assert "--bit-depth: is missing" in capsys.readouterr().err
    assert main(["measure", "emva", str(table), *light, *own, "--bit-depth", str(sensor.bit_depth - 2)]) == 2
    assert "has no level" in capsys.readouterr().err
    assert main(["measure", "emva", str(table), *light, *own, "--bit-depth", str(sensor.bit_depth)]) == 0
    written = tomllib.loads((folder / "own.toml").read_text())
    assert (written["rows"], written["columns"]) == (60, 80)
    assert float(written["system_gain"].split()[0]) == pytest.approx(told["gain"], rel=1e-5)
    assert main(["catalog", "check", str(folder / "own.toml")]) == 0
    capsys.readouterr()
    assert main(["measure", "emva", str(table), *light[:4]]) == 2
    assert "--wavelength: is missing" in capsys.readouterr().err


BAD = {
    "no file": (None, "no such file"),
    "header": ("name,exposure_time\n", 'has the columns "name,exposure_time"'),
    "two exposures": ("file,exposure_time,photons\n", "has the columns"),
    "unknown column": ("file,photons,gain\n", "has the columns"),
    "empty": ("file,exposure_time\n", "names no frames"),
    "one frame": ("file,exposure_time\na.png,0\n", "line 2: one frame of exposure_time 0, dark: noise needs two"),
    "twice": ("file,photons\na.png,1\na.png,1\n", 'line 3: "a.png" is in line 2 too'),
    "number": ("file,photons\na.png,one\n", 'line 2: photons "one" is not a number'),
    "negative": ("file,photons\na.png,-1\n", 'line 2: photons "-1" is not a number of 0 or more'),
    "nan": ("file,photons\na.png,nan\n", 'line 2: photons "nan" is not a finite number'),
    "cells": ("file,photons\na.png\n", "line 2: has 1 cells"),
    "dark": ("file,photons,dark\na.png,1,yes\n", 'line 2: dark "yes" is not 0 or 1'),
    "absent": ("file,photons\nc.png,0\nd.png,0\n", "c.png: no such image"),
    "size": ("file,photons\na.png,0\nb.png,0\n", '"b.png" differs in size'),
    "no dark": ("file,photons\na.png,1\na2.png,1\n", "no dark frames"),
    "elsewhere": (
        "file,photons\na.png,0\n../frames.png,0\n",
        'line 3: "../frames.png" lies outside the table\'s folder',
    ),
    "few": ("file,photons\na.png,0\na2.png,0\n", "0 exposures with light"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_tables_are_one_clear_error(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text, message = BAD[name]
    for file, shape in (("a", (4, 5)), ("a2", (4, 5)), ("b", (5, 4))):
        write_png(tmp_path / f"{file}.png", np.zeros(shape, dtype=np.uint8))
    if text is not None:
        (tmp_path / "frames.csv").write_text(text)
    assert main(["measure", "emva", str(tmp_path / "frames.csv")]) == InputError.exit_code
    told = capsys.readouterr().err
    assert message in told and len(told.splitlines()) == 1
