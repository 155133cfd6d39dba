"""Luminaires of LM-63 and beam tables: the irradiance is what the file says."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.scene.file.intensity_files import read_luminaire
from radwrap.validate.closed_forms.sources import gaussian_intensity, point_irradiance, sigma_of_fwhm

POINT_SOURCE = 2e-6  # float32, and spheres of 1 mm at 1 m: (r/d)^2 = 2.5e-7
QUARTER_DEGREE = 2e-5  # straight lines over 0.25 deg of a cosine: (step^2)/8 = 2.4e-6, and of its square
SMOOTH = 2e-3  # a smooth curve through steps of 5 deg of a cosine, and of 15 deg around
EFFICACY = 179.0
HEIGHT = 1.0
PLACES = np.array([(0.1, 0.05), (0.5, 0.0), (0.0, 0.5), (-0.4, 0.3), (0.3, -0.6), (-0.2, -0.2)])
Distribution = Callable[[float, float], float]


def lm63(vertical: list[float], horizontal: list[float], of: Distribution, form: int = 1, tilt: str = "NONE") -> str:
    rows = [" ".join(repr(of(v, h)) for v in vertical) for h in horizontal]
    numbers = [f"1 -1 1 {len(vertical)} {len(horizontal)} {form} 2 0 0 0", "1 1 50"]
    angles = [" ".join(map(repr, vertical)), " ".join(map(repr, horizontal))]
    return "\n".join(["IESNA:LM-63-2002", "[TEST] made by a formula", f"TILT={tilt}", *numbers, *angles, *rows, ""])


def steps(last: float, step: float, first: float = 0.0) -> list[float]:
    return np.arange(first, last + step / 2, step).tolist()


def lit(bench: Any, folder: Path, text: str, name: str = "lamp.ies", **more: Any) -> radwrap.Scene:
    (folder / name).write_text(text)
    source = {
        "type": "ies",
        "name": "lamp",
        "file": name,
        "position": bench.metres(0, 0, HEIGHT),
        "look_at": bench.metres(0, 0, 0),
        "up": [0, 1, 0],
        "diameter": "1 mm",
    } | more
    sheet = {"type": "sheet", "material": "gray", "size": ["4 m", "4 m"]}
    tables = {
        "camera": bench.camera(position=(0, 0, 5)),
        "sources": [source],
        "materials": {"gray": {"type": "lambertian", "reflectance": 0.5}},
        "targets": [sheet],
    }
    return radwrap.scene_from_document(tables, folder=folder)


def irradiance(bench: Any, scene: radwrap.Scene) -> np.ndarray:
    points = np.column_stack([PLACES, np.zeros(len(PLACES))])
    got: np.ndarray = bench.irradiance(scene, points, 0.5)
    return got


def expected(of: Distribution) -> np.ndarray:
    radius = np.hypot(*PLACES.T)
    polar = np.degrees(np.arctan2(radius, HEIGHT))
    azimuth = np.degrees(np.arctan2(PLACES[:, 1], PLACES[:, 0])) % 360
    candela = np.array([of(p, a) for p, a in zip(polar, azimuth, strict=True)])
    return point_irradiance(candela / EFFICACY, HEIGHT, radius)


def test_an_isotropic_lamp_is_cie_171(bench: Any, tmp_path: Path) -> None:
    """10 000 lm at 3 m in CIE 171; here at 1 m."""
    text = lm63([0, 90, 180], [0], lambda v, h: 10_000 / (4 * math.pi))
    got = irradiance(bench, lit(bench, tmp_path, text))
    assert got == pytest.approx(expected(lambda v, h: 10_000 / (4 * math.pi)), rel=POINT_SOURCE)


def cosine(v: float, h: float) -> float:
    return max(math.cos(math.radians(v)), 0.0) * 100


@pytest.mark.parametrize("horizontal", [[0.0], steps(90, 15), steps(180, 15), steps(360, 15), steps(270, 15, 90)])
def test_every_symmetry_of_type_c(bench: Any, tmp_path: Path, horizontal: list[float]) -> None:
    """Lobes that have the symmetry and no other; azimuth 0 is the world's x, 90 deg its y."""
    turns: dict[float, Distribution] = {
        0.0: cosine,
        90.0: lambda v, h: cosine(v, h) * (2 + math.cos(2 * math.radians(h))),
        180.0: lambda v, h: cosine(v, h) * (2 + math.cos(math.radians(h))),
        270.0: lambda v, h: cosine(v, h) * (2 + math.sin(math.radians(h))),
        360.0: lambda v, h: cosine(v, h) * (2 + math.sin(math.radians(h)) + 0.5 * math.cos(math.radians(2 * h))),
    }
    of = turns[horizontal[-1]]
    got = irradiance(bench, lit(bench, tmp_path, lm63(steps(90, 1), horizontal, of)))
    rel = QUARTER_DEGREE * 10 if len(horizontal) == 1 else SMOOTH * 4
    assert got == pytest.approx(expected(of), rel=rel)


def test_light_upwards_is_not_lost(bench: Any, tmp_path: Path) -> None:
    text = lm63(steps(180, 5, 90), [0], lambda v, h: 100.0)
    down = irradiance(bench, lit(bench, tmp_path, text, look_at=bench.metres(0, 0, 2)))
    assert down == pytest.approx(expected(lambda v, h: 100.0), rel=POINT_SOURCE)


def test_a_beam_table_is_its_gaussian(bench: Any, tmp_path: Path) -> None:
    """A table in steps of half a degree against the Gaussian that it was made of, 7 deg wide."""
    spread = math.radians(sigma_of_fwhm(7))
    lines = "".join(f"{a},{gaussian_intensity(math.radians(a), spread):.12f}\n" for a in steps(30, 0.5))
    (tmp_path / "beam.csv").write_text("# an LED\nangle_deg,relative_intensity\n" + lines)
    led = {
        "type": "led",
        "name": "led",
        "radiant_intensity": "1 W/sr",
        "diameter": "1 mm",
        "position": bench.metres(0, 0, 1),
        "look_at": bench.metres(0, 0, 0),
        "beam": {"profile": "table", "file": "beam.csv"},
    }
    tables = {
        "camera": bench.camera(position=(0, 0, 5)),
        "sources": [led],
        "materials": {"gray": {"type": "lambertian", "reflectance": 0.5}},
        "targets": [{"type": "sheet", "material": "gray", "size": ["1 m", "1 m"]}],
    }
    scene = radwrap.scene_from_document(tables, folder=tmp_path)
    for degrees in (0.0, 1.3, 3.5, 6.1):
        theta = math.radians(degrees)
        got = float(bench.irradiance(scene, [(math.tan(theta), 0, 0)], 0.5)[0])
        assert got == pytest.approx(gaussian_intensity(theta, spread) * math.cos(theta) ** 3, rel=SMOOTH)


GOOD = lm63(steps(90, 15), [0], cosine)


@pytest.mark.parametrize(
    ("edition", "told", "factor"),
    [("[TEST] of 1986", 0.8, 0.8), ("IESNA91", 0.8, 0.8), ("IESNA:LM-63-1995", 1, 1), ("IES:LM-63-2019", 1.1, 1)],
)
def test_the_lamps_factor_is_that_of_its_edition(tmp_path: Path, edition: str, told: float, factor: float) -> None:
    """As in ies2rad for the old ones; since 2019 the number tells how the file was made."""
    text = GOOD.replace("IESNA:LM-63-2002", edition).replace("1 1 50", f"0.5 {told} 50")
    (tmp_path / "lamp.ies").write_text(text)
    assert read_luminaire(tmp_path / "lamp.ies").peak == pytest.approx(100 * 0.5 * factor, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (lm63(steps(90, 15), [0], cosine, form=2), "photometry of Type B"),
        (lm63(steps(90, 15), [0], cosine, form=3), "photometry of Type A"),
        (GOOD.replace("TILT=NONE", "TILT=../x"), "names another file"),
        (GOOD.replace("TILT=NONE", "no"), "no TILT"),
        (GOOD[:-30], "ends too early|no number"),
        (GOOD + "1 2", "continues after"),
        (GOOD.replace("1 1 50", "1 nan 50"), "NaN"),
        (GOOD.replace("0.0 15.0", "15.0 0.0"), "must be two or more, and increase|vertical angles"),
        (GOOD.replace("1 -1 1 7 1 1", "1 -1 1 1e9 1 1"), "from 1 to 1000"),
        (GOOD.replace("1 -1 1 7", "1 -1 -1 7"), "at least 0"),
        (GOOD.replace("TILT=NONE", "TILT=INCLUDE\n1 2\n90 0\n1 1"), "angles of its tilt must increase"),
        (GOOD.replace("1 1 50", "1 0.8 50"), r"gives 0.8 for a factor that its edition of LM-63 \(2002\)"),
    ],
)
def test_bad_luminaires_are_told_with_the_key(bench: Any, tmp_path: Path, text: str, told: str) -> None:
    with pytest.raises(InputError, match=rf"sources\[0\].file: .*({told})"):
        lit(bench, tmp_path, text)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("angle,i\n0,1\n", "its first line"),
        ("angle_deg,relative_intensity\n0,1\n10,0.5\n", "ends at 10 deg with 50%"),
        ("angle_deg,relative_intensity\n0,0\n10,1\n20,0\n", "on the axis above 0"),
        ("angle_deg,relative_intensity\n0,1\n10,inf\n", "NaN or infinity"),
        ("angle_deg,relative_intensity\n0,1\n10,x\n", "not a number"),
        ("angle_deg,relative_intensity\n1,1\n10,0\n", "from 0"),
        ("angle_deg,relative_intensity\n0,1e-320\n10,1e300\n20,0\n", "numbers beyond"),
        ("angle_deg,relative_intensity\n0,1e-9\n10,1\n20,0\n", "times as bright aside"),
        ("angle_deg,relative_intensity\n0,1e-320\n10,1e-316\n20,0\n", "on the axis above 0"),
        ("angle_deg,relative_intensity\n0,1\n1e-310,1e5\n20,0\n", "increase by more than"),
        ("angle_deg,relative_intensity\n0," + "1" * 200_000 + "\n", "is not CSV: field larger"),
    ],
)
def test_bad_tables_are_told_with_the_key(bench: Any, tmp_path: Path, text: str, told: str) -> None:
    (tmp_path / "b.csv").write_text(text)
    beam = {"profile": "table", "file": "b.csv"}
    lamp = {**bench.lamp((0, 0, 1)), "beam": beam}
    tables = {"camera": bench.camera(), "sources": [lamp], "targets": [], "materials": {}}
    with pytest.raises(InputError, match=rf"sources\[0\].beam.file: .*{told}"):
        radwrap.scene_from_document(tables, folder=tmp_path)


def test_files_outside_the_folder_are_refused(bench: Any, tmp_path: Path) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    (tmp_path / "lamp.ies").write_text(GOOD)
    with pytest.raises(InputError, match="outside the scene's folder"):
        lit(bench, inner, GOOD, file="../lamp.ies")
