"""What LEDs may do, and what PWM does to an exposure."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
import pytest

from radwrap.errors import InputError
from radwrap.led.drive import Drive, check_ripple, decimal, read_drive, ripple

GOOD: Final = """
count = 12
wavelength = "850 nm"
rated_current = "100 mA"
drive_current = "50 mA"
max_level = 0.5
max_sum = 3.0
max_on_time = "20 s"
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "drive.toml"
    path.write_text(text)
    return path


def test_a_drive_file_is_in_si(tmp_path: Path) -> None:
    drive = read_drive(written(tmp_path, GOOD))
    assert drive == Drive(12, 850e-9, 0.1, 0.05, 0.5, 3.0, 20.0)


BAD: Final = {
    'rated_current = "100 mA"': ("", "drive.toml: rated_current: is missing"),
    '"50 mA"': ('"150 mA"', "drive_current: is 0.15 A, the LEDs are rated for 0.1 A"),
    "max_level = 0.5": ("max_level = 1.5", "max_level: must lie above 0 and not above 1"),
    "max_sum = 3.0": ("max_sum = nan", "max_sum: is not a finite number"),
    '"20 s"': ("20", "max_on_time: 20 has no unit"),
    "count = 12": ("count = 12.0", "count: must be an integer"),
    '"850 nm"': ('"850 nm"\ncolour = 1', "colour: unknown key"),
    'wavelength = "850 nm"': ('wavelength = "850 mm"', "wavelength: 0.85 m is not a wavelength of an LED"),
    "max_sum = 3": ("max_sum = -3", "max_sum: must be above zero"),
    "= 0.5": ('= "0.5"', "max_level: must be a number, not '0.5'"),
    '"50 mA"\nmax': ('"0 mA"\nmax', "drive_current: must be above zero"),
    "count =": ("cont =", 'cont: unknown key (and 1 more); did you mean "count"?'),
    '"850 nm"\n': ('"850 nm"\nzzz = 1\n', "zzz: unknown key; known are count, wavelength"),
    "max_level =": ("max_level ==", "is not TOML"),
}


@pytest.mark.parametrize("what", list(BAD))
def test_bad_drive_files_are_refused(tmp_path: Path, what: str) -> None:
    with pytest.raises(InputError) as caught:
        read_drive(written(tmp_path, GOOD.replace(what, BAD[what][0])))
    assert BAD[what][1] in str(caught.value)


def test_no_drive_file_says_why_there_is_no_light(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="rated current there is no light"):
        read_drive(tmp_path / "none.toml")


def test_levels_beyond_the_limits_are_refused() -> None:
    drive = Drive(4, 850e-9, 0.1, 0.05, 0.5, 1.2, 20.0)
    drive.check((0.5, 0.5, 0.2, 0.0))
    for levels, told in (
        ((0.6, 0, 0, 0), "LED 0: level 0.6 is above max_level"),
        ((0.4, 0.4, 0.4, 0.1), "sum, 1.3, is above max_sum"),
        ((0, 0, 0), "3 levels for 4 LEDs"),
        ((0, float("nan"), 0, 0), "LED 1: nan is not a level"),
        ((0, 0, -0.1, 0), "LED 2: -0.1 is not a level"),
    ):
        with pytest.raises(InputError) as caught:
            drive.check(levels)
        assert told in str(caught.value)


def test_steps_are_the_nearest_that_exceed_no_limit() -> None:
    drive = Drive(4, 850e-9, 0.1, 0.05, 0.2503, 1.0008, 20.0)
    # 1024.82 of 4096 each, in sum 4099.28: three may be rounded up.
    assert sorted(drive.to_steps((0.2502,) * 4, 4096)) == [1024, 1025, 1025, 1025]
    # 1025.19 and 1024.41; 63.83 of 255 is 63 for max_level's sake.
    assert drive.to_steps((0.25029, 0.2501, 0, 0), 4096) == (1025, 1024, 0, 0)
    assert drive.to_steps((0.2503, 0.2, 0, 0), 255) == (63, 51, 0, 0)
    for level in (1e-5, 0.0019):
        with pytest.raises(InputError, match=r"LED 3: .* it would be dark; give 0, or"):
            drive.to_steps((0, 0, 0, level), 255)


@pytest.mark.parametrize("text", ["1_0e-2", "\uff10.2", "nan", "inf", "1e999", "-0.1", "", " 0.1", "٣"])
def test_numbers_that_not_everybody_reads_alike_are_refused(text: str) -> None:
    assert decimal("2.5e-1") == 0.25
    with pytest.raises(InputError, match=r"--level: .* is not a number of 0 or more"):
        decimal(text, "--level")


def exposure(duty: float, exposure_time: float, phase: np.ndarray) -> np.ndarray:
    """Time for which a pulsed light of period 1 is on from `phase` on: the integral of its square wave."""

    def on_until(moment: np.ndarray) -> np.ndarray:
        whole = np.floor(moment)
        return whole * duty + np.minimum(moment - whole, duty)

    return on_until(phase + exposure_time) - on_until(phase)


@pytest.mark.parametrize("duty", [0.01, 0.3, 0.5, 0.97])
def test_ripple_is_a_bound_and_is_reached(duty: float) -> None:
    phase = np.linspace(0, 1, 2001)
    worst = 0.0
    for exposure_time in np.linspace(3.0, 4.0, 101):
        error = np.abs(exposure(duty, exposure_time, phase) / (duty * exposure_time) - 1).max()
        bound = ripple([duty], 1.0, exposure_time)
        assert error <= bound * (1 + 1e-9)
        worst = max(worst, error / bound)
    assert worst > 0.98  # the exposure times are 0.01 periods apart


def test_ripple_is_refused_told_or_passed_over() -> None:
    levels, frequency = (0.1, 1.0, 0.0), 1526.0
    assert check_ripple(levels, frequency, 0.13) is None  # 0.45 %
    told = check_ripple(levels, frequency, 0.03)
    assert told is not None and "2 %" in told
    with pytest.raises(InputError, match="59 %"):
        check_ripple(levels, frequency, 1e-3)
    assert check_ripple((1.0, 0.0), frequency, 1e-6) is None, "always on or off: no ripple"
    assert "not known" in str(check_ripple(levels, None, 0.13))
