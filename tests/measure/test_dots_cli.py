"""`radwrap measure dots`: what goes in and out; and boards as the renderer gives them."""

import argparse
import json
from pathlib import Path

import numpy as np
import pytest

import radwrap
from radwrap.cli import measure_dots
from radwrap.errors import InputError
from radwrap.images import write_exr, write_png
from radwrap.measure.dots import find_dots_by

SCENE = Path(__file__).parents[2] / "rad_scenes" / "bench_board" / "scene.toml"
PITCH, DIAMETER = 19.05e-3, 15.875e-3


def run(*arguments: str) -> int:
    parser = argparse.ArgumentParser()
    measure_dots.add_to(parser.add_subparsers())
    parsed = parser.parse_args(["dots", *arguments])
    code: int = parsed.run(parsed)
    return code


def board(*, without: tuple[int, ...] = ()) -> np.ndarray:
    """5 x 4 bright dots on a pitch of 20 px, the first at (20, 15)."""
    v, u = np.mgrid[:100, :100].astype(float)
    gray = np.full((100, 100), 22.0)
    for dot in set(range(20)) - set(without):
        row, column = divmod(dot, 4)
        gray += 150 * np.clip(6.5 - np.hypot(u - 20 - 20 * column, v - 10 - 20 * row), 0, 1)
    return gray.astype(np.uint8)


def test_json_csv_table_and_overlay(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image = tmp_path / "a b.png"
    write_png(image, board())
    outputs = ["--overlay", str(tmp_path / "o.png"), "--csv", str(tmp_path / "d.csv")]
    lengths = ["--pitch", "20 mm", "--dot-diameter", "12 mm"]
    assert run(str(image), "--grid", "5x4", "--method", "conic", *lengths, *outputs, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["schema_version"] == 1
    assert (told["grid"], told["method"], told["contrast"]) == ([5, 4], "conic", "bright")
    assert [(dot["row"], dot["column"]) for dot in told["dots"]] == [(r, c) for r in range(5) for c in range(4)]
    for dot in told["dots"]:
        assert dot["u"] == pytest.approx(20 + 20 * dot["column"], abs=0.02)
        assert dot["v"] == pytest.approx(10 + 20 * dot["row"], abs=0.02)
        assert np.linalg.eigvalsh(dot["covariance"]).min() > 0
        assert dot["split"] is False
    lines = (tmp_path / "d.csv").read_text().splitlines()
    assert lines[0] == "row,column,u,v,var_u,cov_uv,var_v,area,saturated_fraction,split,unlike"
    assert len(lines) == 21
    assert float(lines[1].split(",")[2]) == told["dots"][0]["u"]
    assert (tmp_path / "o.png").read_bytes().startswith(b"\x89PNG")
    assert run(str(image), "--grid", "5x4") == 0
    assert "5 x 4 bright dots, method gray" in capsys.readouterr().out


def test_a_missing_dot_is_an_error_with_a_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    image = tmp_path / "board.png"
    write_png(image, board(without=(9, 10)))
    with pytest.raises(
        InputError, match=r"found 18 of 20 dots; missing: row 2 column 1, row 2 column 2; .* see .*o.png"
    ):
        run(str(image), "--grid", "5x4", "--overlay", str(tmp_path / "o.png"))
    assert (tmp_path / "o.png").read_bytes().startswith(b"\x89PNG")
    # Without --overlay the picture lies in the working folder.
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=r"see board\.dots\.png"):
        run(str(image), "--grid", "5x4")
    assert (tmp_path / "board.dots.png").is_file()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--grid", "5"], '--grid: "5" is not a grid; write rows x columns'),
        (["--grid", "5x-4"], "is not a grid"),
        (["--grid", "1x4"], "2 rows and 2 columns at least"),
        (["--grid", "5x4", "--method", "conic"], "needs the pitch"),
        (["--grid", "5x4", "--pitch", "20"], "--pitch: .* has no unit"),
        (["--grid", "5x3"], "dots continue"),
    ],
)
def test_wrong_options_are_told_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: list[str], message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    write_png(tmp_path / "a.png", board())
    with pytest.raises(InputError, match=message) as caught:
        run(str(tmp_path / "a.png"), *options)
    assert "\n" not in str(caught.value)


def test_pictures_that_are_none_are_told_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import cv2

    monkeypatch.chdir(tmp_path)
    blank, single, cut = tmp_path / "blank.png", tmp_path / "single.png", tmp_path / "cut.png"
    colour, nan, none = tmp_path / "colour.png", tmp_path / "nan.exr", tmp_path / "none.png"
    write_png(blank, np.full((50, 50), 22, np.uint8))
    write_png(single, np.full((1, 1), 22, np.uint8))
    write_png(cut, board())
    cut.write_bytes(cut.read_bytes()[: cut.stat().st_size // 2])
    cv2.imwrite(str(colour), np.dstack([board(), board(), 255 - board()]))
    values = board().astype(np.float32)
    values[3, 4] = np.nan
    write_broken_exr(nan, values)
    expected = {
        blank: "gray level 22 everywhere",
        single: "gray level 22 everywhere",
        cut: "not complete",
        colour: "is in colour",
        nan: "NaN or infinity",
        none: "no such image",
    }
    for path, message in expected.items():
        with pytest.raises(InputError, match=message) as caught:
            run(str(path), "--grid", "5x4")
        assert str(caught.value).startswith(str(path))


def write_broken_exr(path: Path, values: np.ndarray) -> None:
    """As another program might: ours reads back what it wrote, and NaN is not equal to itself."""
    write_exr(path, np.nan_to_num(values, nan=1234.5), channel="Y")
    import OpenImageIO as oiio  # noqa: N813

    spec = oiio.ImageSpec(values.shape[1], values.shape[0], 1, "float")
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec)
    assert output.write_image(values[:, :, np.newaxis])
    output.close()


@pytest.mark.parametrize(
    ("diameter", "options", "limits"),
    # The renderer samples 3 x 3 points of a pixel, or 19 of the pinhole: that leaves some 0.02 px in each centre.
    [
        pytest.param(
            *("0 mm", {"method": "pinhole", "pixel_samples": 3}, {"ellipse": 0.06, "conic": 0.03}),
            marks=pytest.mark.long,
        ),
        ("0.1 mm", {"viewpoints": 19}, {"ellipse": 0.09, "conic": 0.06}),
    ],
)
def test_rendered_boards(tmp_path: Path, diameter: str, options: dict[str, object], limits: dict[str, float]) -> None:
    """The paper's board under its ring: three LEDs in place of twelve. The blurred dots run together."""
    changes = {"sources[0].count": 3, "camera.aperture.diameter": diameter, "camera.diffraction": "off"}
    result = radwrap.render(radwrap.load_scene(SCENE, changes), tmp_path, truth=True, **options)
    dots = json.loads((tmp_path / "truth.json").read_text())["targets"]["board"]["dots"]
    truth = np.array([(dot["u"], dot["v"]) for dot in dots])
    found = find_dots_by(result.gray, 5, 5, pitch=PITCH, dot_diameter=DIAMETER)
    errors = {
        method: float(np.sqrt(np.mean(np.sum((one.centres - truth) ** 2, axis=1)))) for method, one in found.items()
    }
    for method, limit in limits.items():
        assert errors[method] < limit
    # The beam's fall-off draws weighted centres to its axis.
    assert 0.15 < errors["gray"] < 0.4
    assert all(dot.split for dot in found["gray"].dots) == (diameter == "0.1 mm")
