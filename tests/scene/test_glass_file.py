"""Wavefronts of a lens as a scene file has them: numbers, units, tables beside the scene, and what is refused."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import radwrap
from radwrap.errors import InputError
from radwrap.scene.aberrations import ContrastTable, PointSpread, Wavefront

Array = NDArray[np.float64]

FOLDER = Path(__file__).parents[2] / "rad_scenes" / "real_lens"
SCENE = FOLDER / "scene.toml"
INLINE = {"convention": "osa", "coefficients": {"7": "45 nm", "4": "-0.02 um"}}
CORNER_MM = math.hypot(192, 160) / 2 * 3.45e-3


def glass(wavefront: dict[str, Any], folder: Path = FOLDER) -> Wavefront:
    document = radwrap.load_scene(SCENE).document
    scene = radwrap.scene_from_document(json.loads(document), {"camera.lens.wavefront": wavefront}, folder=folder)
    assert scene.camera.lens is not None and isinstance(scene.camera.lens.glass, Wavefront)
    return scene.camera.lens.glass


def by_order(found: Wavefront, row: int = 0) -> dict[tuple[int, int], float]:
    return {order: value for order, value in zip(found.orders, found.coefficients[row], strict=True) if value}


def test_coefficients_are_paths_of_unit_rms_whatever_their_convention() -> None:
    assert by_order(glass(INLINE)) == {(3, -1): 45e-9, (2, 0): pytest.approx(-20e-9)}
    noll = {"convention": "noll", "coefficients": {"7": "45 nm", "4": "-20 nm"}}
    assert by_order(glass(noll)) == {(3, -1): 45e-9, (2, 0): -20e-9}
    # Coma of peak 1 is 8 times that of rms 1 squared; defocus 2 rho^2 - 1 three times.
    fringe = {"convention": "fringe", "coefficients": {"8": "45 nm", "4": "-20 nm"}}
    found = by_order(glass(fringe))
    assert found == {(3, -1): pytest.approx(45e-9 / math.sqrt(8)), (2, 0): pytest.approx(-20e-9 / math.sqrt(3))}


def test_the_pupil_is_the_opening_unless_another_is_told() -> None:
    assert glass(INLINE).pupil_diameter == pytest.approx(25e-3 / 4)
    assert glass({**INLINE, "pupil_diameter": "10 mm"}).pupil_diameter == 10e-3
    scene = radwrap.load_scene(SCENE, {"camera.lens.wavefront": INLINE})
    assert scene.assumed["camera.lens.wavefront.pupil_diameter"] == "6.25 mm"


def test_a_table_of_heights_is_read_in_any_order(tmp_path: Path) -> None:
    (tmp_path / "lens.csv").write_text(
        "index,field_height_mm,coefficient\n# coma grows\n7,0.5,4.5e-8\n12,0,1e-8\n7,0,0\n12,0.5,2e-8\n"
    )
    found = glass({"convention": "osa", "file": "lens.csv"}, tmp_path)
    assert found.heights == (0.0, 0.5e-3)
    assert by_order(found, 1) == {(3, -1): 4.5e-8, (4, 0): 2e-8} and by_order(found) == {(4, 0): 1e-8}
    assert dict(zip(found.orders, found.at(0.25e-3, 0.0), strict=True))[3, 1] == pytest.approx(2.25e-8)


def test_a_table_stands_in_the_scene_too(tmp_path: Path) -> None:
    lines = "0,4,1e-8\n0.25,4,2e-8\n0.25,7,3e-8\n0.5,7,4e-8\n"
    (tmp_path / "lens.csv").write_text(f"field_height_mm,index,coefficient\n{lines}")
    fields = [
        {"height": "0 mm", "coefficients": {"4": "10 nm"}},
        {"height": "0.25 mm", "coefficients": {"4": "20 nm", "7": "30 nm"}},
        {"height": "0.5 mm", "coefficients": {"7": "40 nm"}},
    ]
    one, other = (
        glass({"convention": "noll", **table}, tmp_path) for table in ({"file": "lens.csv"}, {"fields": fields})
    )
    assert one.orders == other.orders and one.heights == other.heights
    assert np.array(one.coefficients) == pytest.approx(np.array(other.coefficients), abs=1e-18)


FIELDS = [{"height": f"{height} mm", "coefficients": {"11": "1 nm"}} for height in (0, 0.3, 0.5)]


@pytest.mark.parametrize(
    ("wavefront", "told"),
    [
        ({"convention": "noll", "fields": FIELDS[1:]}, "wavefront.fields: has heights from 0.3 to 0.5 mm"),
        ({"convention": "noll", "fields": FIELDS[:2]}, "wavefront.fields: has heights from 0 to 0.3 mm"),
        ({"convention": "noll", "fields": FIELDS[::-1]}, "wavefront.fields: needs heights that increase"),
        ({"convention": "noll", "fields": [one | {"coefficients": {}} for one in FIELDS]}, "has no term at any height"),
        ({"convention": "noll", "fields": FIELDS, "file": "lens.csv"}, "exactly one of coefficients, file and fields"),
        ({"coefficients": {"7": "45 nm"}}, "camera.lens.wavefront.convention"),
        ({"convention": "osa"}, "exactly one of coefficients, file and fields"),
        ({"convention": "osa", "coefficients": {"7": 45e-9}}, "camera.lens.wavefront.coefficients"),
        ({"convention": "osa", "coefficients": {"seven": "45 nm"}}, "camera.lens.wavefront.coefficients"),
        ({"convention": "osa", "coefficients": {"a": "45 nm"}}, "'a' is not the number of a polynomial"),
        ({"convention": "osa", "coefficients": {"7": "45 mm"}}, "camera.lens.wavefront.coefficients.7"),
        (
            {"convention": "noll", "coefficients": {"0": "45 nm"}},
            "0 is not the number of a term of the convention noll",
        ),
        (
            {"convention": "fringe", "coefficients": {"38": "45 nm"}},
            "38 is not the number of a term of the convention fringe",
        ),
        ({**INLINE, "pupil_diameter": "5 mm"}, "is smaller than the opening of 6.25 mm"),
        ({"convention": "osa", "file": "../lens.csv"}, "lies outside the scene's folder"),
        ({"convention": "osa", "file": "none.csv"}, "camera.lens.wavefront.file"),
    ],
)
def test_what_is_wrong_is_named(wavefront: dict[str, Any], told: str) -> None:
    with pytest.raises(InputError, match=re.escape(told)):
        glass(wavefront)


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        ("0,4,1e-9\n0.5,4,0.3", "coefficients are paths in metres"),
        ("0,4,1e-9\n0.3,4,2e-9", f"the sensor from 0 to {CORNER_MM:.4g} mm"),
        ("0.1,4,1e-9\n0.5,4,2e-9", "add the axis"),
        ("0,7,4e-8\n0.5,7,5e-8", "not alike from all sides, 40 nm rms"),
        ("0,4,1e-9\n0,4,2e-9\n0.5,4,2e-9", "a term twice at the height 0 mm"),
        ("0,4.5,1e-9\n0.5,4,2e-9", "whole numbers of terms"),
        ("0,999,1e-9\n0.5,4,2e-9", "999 is not the number of a term"),
        ("0,4,nan\n0.5,4,2e-9", "line 2: holds what is not a finite number"),
        ("", "has no line of numbers"),
    ],
)
def test_what_is_wrong_in_a_table_is_named(tmp_path: Path, lines: str, told: str) -> None:
    (tmp_path / "lens.csv").write_text(f"field_height_mm,index,coefficient\n{lines}\n")
    with pytest.raises(InputError, match=re.escape(told)) as refused:
        glass({"convention": "osa", "file": "lens.csv"}, tmp_path)
    assert "lens.csv" in str(refused.value) or "wavefront.file" in str(refused.value)


def test_a_wavefront_needs_waves_and_an_opening() -> None:
    with pytest.raises(InputError, match=r'"off" leaves out what lens.wavefront does'):
        radwrap.load_scene(SCENE, {"camera.diffraction": "off"})
    tables = json.loads(radwrap.load_scene(SCENE).document)
    del tables["camera"]["lens"]["f_number"]
    tables["camera"]["aperture"] = {"diameter": "0 mm"}
    with pytest.raises(InputError, match=r"lens.wavefront needs an opening"):
        radwrap.scene_from_document(tables, folder=FOLDER)


def contrast(
    folder: Path, lines: str, head: str = "frequency_per_mm,tangential,sagittal", **more: Any
) -> ContrastTable:
    (folder / "mtf.csv").write_text(f"{head}\n{lines}\n")
    tables = json.loads(radwrap.load_scene(SCENE).document)
    del tables["camera"]["lens"]["wavefront"]
    told = {"file": "mtf.csv", "f_number": 4, "wavelength": "500 nm", **more}
    scene = radwrap.scene_from_document(tables, {"camera.lens.mtf": told}, folder=folder)
    assert scene.camera.lens is not None and isinstance(scene.camera.lens.glass, ContrastTable)
    assert "camera.lens.mtf.phase" in scene.assumed and "camera.lens.mtf.beyond" in scene.assumed
    return scene.camera.lens.glass


def limit(per_mm: float) -> float:
    """Contrast of a perfect lens of f/4 at 500 nm, whose highest frequency is 500 per mm."""
    s = per_mm / 500
    return 2 / math.pi * (math.acos(s) - s * math.sqrt(1 - s**2))


def test_contrast_is_told_over_that_of_a_perfect_lens(tmp_path: Path) -> None:
    found = contrast(tmp_path, f"100,{0.8 * limit(100)},{0.8 * limit(100)}\n200,{0.5 * limit(200)},{0.5 * limit(200)}")
    assert found.frequencies == (0.0, 100e3, 200e3) and found.heights is None
    assert found.tangential[0] == found.sagittal[0] == pytest.approx((1.0, 0.8, 0.5))


def test_contrast_over_the_field_is_read_in_any_order(tmp_path: Path) -> None:
    lines = "100,0.5,0.6,0.5\n200,0.2,0.3,0.5\n200,0.4,0.4,0\n100,0.7,0.7,0\n0,1,1,0\n0,1,1,0.5"
    found = contrast(tmp_path, lines, "frequency_per_mm,tangential,sagittal,field_height_mm")
    assert found.heights == (0.0, 0.5e-3) and found.frequencies == (0.0, 100e3, 200e3)
    tangential, sagittal = found.at(0.3e-3, 0.4e-3)
    assert tangential == pytest.approx((1.0, 0.5 / limit(100), 0.2 / limit(200)))
    assert sagittal == pytest.approx((1.0, 0.6 / limit(100), 0.3 / limit(200)))


@pytest.mark.parametrize(
    ("lines", "more", "told"),
    [
        ("100,0.9,0.5", {}, "is 0.9 at 100 per mm, and a perfect lens leaves 0.747 at f/4 and 500 nm"),
        ("100,-0.1,0.5", {}, "is -0.1 at 100 per mm"),
        ("0,0.9,1\n100,0.5,0.5", {}, "must be 1 at the frequency 0"),
        (
            "100,0.5,0.5",
            {"f_number": 2.8},
            "is 2.8, and the camera's 4: contrast of another opening does not apply",
        ),
        ("100,0.7,0.5", {}, "differs on the axis by direction"),
        ("100,0.5,0.5\n100,0.6,0.6", {}, "has the frequency 100 per mm 2 times, and needs it once"),
        ("-100,0.5,0.5", {}, "needs frequencies above 0"),
        ("600,0,0", {}, "no frequency that a perfect lens leaves contrast of"),
        ("100,nan,0.5", {}, "mtf.csv: line 2: holds what is not a finite number"),
        ("100,0.5,0.5\n# beyond\n\n200,0.3,.l", {}, "mtf.csv: line 5: holds what is not a number"),
        ("100,0.5,0.5\n200,0.3", {}, "mtf.csv: line 3: has 2 cells, and there are 3 columns"),
        ("", {}, "has no line of numbers"),
        # At 300 per mm contrast is right, and nearest to its limit.
        ("100,-0.1,0.5\n200,0.4,0.4\n300,0.28,0.28", {}, "tangential: is -0.1 at 100 per mm"),
    ],
)
def test_what_is_wrong_in_a_data_sheet_is_named(tmp_path: Path, lines: str, more: dict[str, Any], told: str) -> None:
    with pytest.raises(InputError, match=re.escape(told)):
        contrast(tmp_path, lines, **more)


def test_a_bad_row_is_named_with_its_height(tmp_path: Path) -> None:
    lines = "100,0.5,0.5,0\n100,0.5,0.9,0.5"
    with pytest.raises(InputError, match=r"sagittal at 0\.5 mm: is 0\.9 at 100 per mm"):
        contrast(tmp_path, lines, "frequency_per_mm,tangential,sagittal,field_height_mm")


def test_a_lens_has_one_kind_of_glass() -> None:
    with pytest.raises(InputError, match="wavefront and mtf, which say the same"):
        radwrap.load_scene(SCENE, {"camera.lens.mtf": {"file": "contrast.csv", "f_number": 4, "wavelength": "590 nm"}})


def test_the_example_of_a_data_sheet_is_read() -> None:
    scene = radwrap.load_scene(FOLDER / "data_sheet.toml")
    assert scene.camera.lens is not None and isinstance(scene.camera.lens.glass, ContrastTable)
    assert scene.camera.lens.glass.tangential[2][-1] < scene.camera.lens.glass.sagittal[2][-1]


def point(folder: Path, light: Array, **more: Any) -> PointSpread:
    """A picture of 16 bits, as PGM has it."""
    rows, columns = light.shape
    head = f"P5\n{columns} {rows}\n65535\n".encode()
    (folder / "point.pgm").write_bytes(head + np.round(light).astype(">u2").tobytes())
    tables = json.loads(radwrap.load_scene(SCENE).document)
    del tables["camera"]["lens"]["wavefront"]
    told = {"file": "point.pgm", "pitch": "0.5 um", **more}
    scene = radwrap.scene_from_document(tables, {"camera.lens.psf": told}, folder=folder)
    assert scene.camera.lens is not None and isinstance(scene.camera.lens.glass, PointSpread)
    assert "camera.lens.psf.middle" in scene.assumed
    return scene.camera.lens.glass


def spot(sigma: float, size: int = 41, middle: tuple[float, float] = (20.0, 20.0)) -> Array:
    row, column = np.indices((size, size + 2))
    return 60000 * np.exp(-((row - middle[0]) ** 2 + (column - middle[1]) ** 2) / (2 * sigma**2))


def test_a_picture_of_a_point_is_its_light_about_its_middle(tmp_path: Path) -> None:
    found = point(tmp_path, spot(3.0, middle=(19.3, 21.8)))
    assert found.middle == pytest.approx((19.3, 21.8), abs=1e-3)
    assert np.sum(found.rows) == pytest.approx(1.0)
    # A Gaussian holds .999 within sqrt(2 ln 1000) of its deviations.
    assert found.reach == pytest.approx(math.sqrt(2 * math.log(1000)) * 3.0 * 0.5e-6, rel=0.03)
    assert found.pitch == 0.5e-6


@pytest.mark.parametrize(
    ("light", "told"),
    [
        (np.zeros((9, 9)), "needs values of 0 or more, some above 0"),
        (spot(3.0) + 2000, "where the light must have ended"),
        (spot(0.6), "at the highest frequency that its pixels resolve"),
    ],
)
def test_what_is_wrong_in_a_picture_of_a_point_is_named(tmp_path: Path, light: Array, told: str) -> None:
    with pytest.raises(InputError, match=re.escape(told)):
        point(tmp_path, light)


def test_a_picture_that_is_none_is_named_with_its_key(tmp_path: Path) -> None:
    (tmp_path / "point.pgm").write_text("nothing")
    tables = json.loads(radwrap.load_scene(SCENE).document)
    tables["camera"]["lens"] = {
        "focus_distance": "500 mm",
        "f_number": 4,
        "psf": {"file": "point.pgm", "pitch": "1 um"},
    }
    with pytest.raises(InputError, match=r"camera\.lens\.psf\.file"):
        radwrap.scene_from_document(tables, folder=tmp_path)
    (tmp_path / "point.pgm").unlink()
    with pytest.raises(InputError) as missing:
        radwrap.scene_from_document(tables, folder=tmp_path)
    assert str(missing.value) == 'scene: camera.lens.psf.file: no file "point.pgm" beside the scene'
