"""Targets to print: what a reader of PDF or SVG would draw is the target's geometry, in millimetres."""

import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from radwrap.cli.main import main
from radwrap.convert.print_pages import PAPERS, Paper, Window, pages
from radwrap.scene.file.target_file import load_target
from radwrap.scene.patterns.marks import FlatDisc, Mark

TARGETS = Path(__file__).parents[2] / "rad_scenes" / "targets"
NAMES = sorted(path.stem for path in TARGETS.glob("*.toml"))
WRITTEN = 2e-6  # mm: numbers are written to the nanometre
ARC = 1e-5  # of a radius: cubic curves are no circles
BIG = 'type = "charuco"\nrows = 6\ncolumns = 9\nsquare_size = "46 mm"\nmarker_size = "34 mm"\n'
BIG += 'dictionary = "DICT_5X5_100"'
Path2 = list[np.ndarray]
SVG = "{http://www.w3.org/2000/svg}"


def streams(pdf: bytes) -> list[str]:
    """Contents of the pages, by the file's own table of objects."""
    text = pdf.decode("ascii")
    start = int(re.findall(r"startxref\n(\d+)\n%%EOF\n$", text)[0])
    assert text[start:].startswith("xref\n")
    places = [int(line[:10]) for line in text[start:].splitlines()[3:] if line.endswith(" n ")]
    bodies = [text[place : text.index("endobj", place)] for place in places]
    assert [int(body.split()[0]) for body in bodies] == list(range(1, len(bodies) + 1))
    found = []
    for body in bodies:
        if "stream" in body:
            content = body.split("stream\n", 1)[1].rsplit("endstream", 1)[0]
            assert len(content) == int(re.findall(r"/Length (\d+)", body)[0])
            found.append(content)
    return found


def drawn(content: str) -> Iterator[tuple[Path2, list[float]]]:
    """Filled paths, in mm, each with the rectangle that it is cut at: the operators that these files have."""
    scale, clip, path, numbers = 1.0, [], [], []
    kept: list[list[float]] = []
    for word in re.sub(r"\([^)]*\)", "", content).split():
        if re.fullmatch(r"-?\d+(\.\d+)?", word):
            numbers.append(float(word))
            continue
        points = np.array(numbers).reshape(-1, 2) * scale * 25.4 / 72 if len(numbers) % 2 == 0 else np.empty((0, 2))
        match word:
            case "cm":
                scale *= numbers[0]
            case "m":
                path.append(points)
            case "l":
                path[-1] = np.vstack([path[-1], points])
            case "c":
                share = np.linspace(0, 1, 33)[1:, np.newaxis]
                a, (b, c, d) = path[-1][-1], points
                curve = (1 - share) ** 3 * a + 3 * share * (1 - share) ** 2 * b + 3 * share**2 * (1 - share) * c
                path[-1] = np.vstack([path[-1], curve + share**3 * d])
            case "re":
                clip = points.ravel().tolist()
            case "q":
                kept.append(clip)
            case "Q":
                clip = kept.pop()
            case "f":
                yield path, clip
                path = []
            case "g" | "h" | "W" | "n" | "BT" | "ET" | "Tf" | "Td" | "Tj" | "/F1":
                pass
            case _:
                raise AssertionError(word)
        numbers = []


def agrees(outline: np.ndarray, mark: Mark) -> bool:
    if isinstance(mark, FlatDisc):
        middle, radius = np.array([mark.x, mark.y]) * 1e3, mark.radius * 1e3
        return bool(np.abs(np.hypot(*(outline - middle).T) - radius).max() < ARC * radius + WRITTEN)
    return bool(np.abs(outline - np.array(mark.vertices) * 1e3).max() < WRITTEN)


@pytest.mark.parametrize("name", NAMES)
def test_the_pdf_draws_the_targets_geometry(name: str, tmp_path: Path) -> None:
    out = tmp_path / "out.pdf"
    assert main(["convert", str(TARGETS / f"{name}.toml"), str(out)]) == 0
    _, layout = load_target(TARGETS / f"{name}.toml")
    (content,) = streams(out.read_bytes())
    (plate, clip), (guides, none) = drawn(content)
    assert not none
    width, height = layout.size
    middle = np.array([105.0, 5 + 0.5 * (22 + 287) - 5])  # of what can be printed on A4, above the bar
    assert clip == pytest.approx([*(middle - np.array([width, height]) * 500), width * 1e3, height * 1e3], abs=WRITTEN)
    marks = list(layout.marks())
    assert len(plate) == len(marks)
    assert all(agrees(outline - middle, mark) for outline, mark in zip(plate, marks, strict=True))
    assert np.ptp(guides[0], axis=0) == pytest.approx([100.0, 1.0], abs=WRITTEN)


@pytest.mark.parametrize("name", NAMES)
def test_the_svg_draws_the_targets_geometry(name: str, tmp_path: Path) -> None:
    out = tmp_path / "out.svg"
    assert main(["convert", str(TARGETS / f"{name}.toml"), str(out), "--paper", "letter"]) == 0
    root = ElementTree.fromstring(out.read_bytes())  # noqa: S314  (it is our own)
    assert (root.get("width"), root.get("height")) == ("215.9mm", "279.4mm")
    assert root.get("viewBox") == "0 0 215.9 279.4"
    _, layout = load_target(TARGETS / f"{name}.toml")
    middle = np.array([215.9 / 2, 279.4 - (22 + 269.4) / 2])
    (group,) = root.findall(f"{SVG}g")
    for shape, mark in zip(group, layout.marks(), strict=True):
        if shape.tag == f"{SVG}circle":
            assert isinstance(mark, FlatDisc)
            x, y, radius = (float(shape.get(key, "")) for key in ("cx", "cy", "r"))
            assert (x - middle[0], middle[1] - y, radius) == pytest.approx(
                (mark.x * 1e3, mark.y * 1e3, mark.radius * 1e3), abs=WRITTEN
            )
        else:
            corners = np.array(re.findall(r"-?[\d.]+", shape.get("d", "")), dtype=float).reshape(-1, 2)
            assert agrees((corners - middle) * [1, -1], mark)


@pytest.mark.long
@pytest.mark.parametrize("paper", ["a4", "letter"])
def test_tiles_show_every_place_of_a_large_plate_once(paper: Paper, tmp_path: Path) -> None:
    source = tmp_path / "big.toml"
    source.write_text(BIG)
    _, layout = load_target(source)
    sheets = pages("big", layout, paper)
    assert len(sheets) == 4
    seen = []
    for page in sheets:
        window = page.window
        assert page.size in (PAPERS[paper], PAPERS[paper][::-1])
        assert window.left > 0.01 and window.bottom > 0.02 and window.right < page.size[0] and window.top < page.size[1]
        seen.append((window.right - window.left) * (window.top - window.bottom))
    assert sum(seen) == pytest.approx(layout.size[0] * layout.size[1])
    # Cut at the windows, all marks together have the area of the layout's.
    area = sum(cut_area(mark, page.window) for page in sheets for mark in page.marks)
    assert area == pytest.approx(sum(cut_area(mark, None) for mark in layout.marks()))
    out = tmp_path / "big.pdf"
    assert main(["convert", str(source), str(out), "--paper", paper]) == 0
    assert len(streams(out.read_bytes())) == 4
    assert main(["convert", str(source), str(tmp_path / "big.svg"), "--paper", paper]) == 0
    assert len(list(tmp_path.glob("big.row*_column*.svg"))) == 4


def cut_area(mark: Mark, window: Window | None) -> float:
    """Area of an upright rectangle within a window."""
    assert not isinstance(mark, FlatDisc)
    low, high = np.min(mark.vertices, axis=0), np.max(mark.vertices, axis=0)
    if window is not None:
        low = np.maximum(low, [window.left, window.bottom])
        high = np.minimum(high, [window.right, window.top])
    return float(np.prod(np.maximum(high - low, 0.0)))


def test_the_same_target_gives_the_same_bytes_and_a_board_is_printed_too(tmp_path: Path) -> None:
    board = TARGETS.parent / "bench_board" / "scene.toml"
    for name in ("a.pdf", "b.pdf"):
        assert main(["convert", str(board), str(tmp_path / name)]) == 0
    assert (tmp_path / "a.pdf").read_bytes() == (tmp_path / "b.pdf").read_bytes()
    (content,) = streams((tmp_path / "a.pdf").read_bytes())
    (plate, _), _ = drawn(content)
    assert len(plate) == 25


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["rad_scenes/fig11_edge/scene.toml", "OUT.pdf"], "has no target with a pattern"),
        (["rad_scenes/targets/circles.toml", "OUT.pdf", "--target", "nut"], 'has no target "nut"'),
        (["rad_scenes/targets/circles.toml", "OUT.rad", "--paper", "a4"], "--paper: goes with a target to print"),
        (["BARE", "OUT.pdf", "--set", "rows=0"], "big.toml: rows"),
        (["BARE", "OUT.pdf", "--set", "row=4"], "big.toml: row: unknown key"),
        (["BARE", "OUT.pdf", "--set", 'rows="6"'], "big.toml: rows: "),
        (["BARE", "OUT.png"], 'cannot write ".png"'),
        (["BARE", "OUT.pdf", "--set", "square_size=60 m"], "sheets, more than 400; check its units"),
        (["MARKED", "OUT.pdf"], 'marked.toml: dictionary: OpenCV has no dictionary "DICT_4X4_5"; did you mean'),
        (["TWICE", "OUT.pdf"], "has several targets with a pattern: target, other"),
    ],
)
def test_what_cannot_be_printed_is_one_clear_error(
    arguments: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "big.toml").write_text(BIG)
    twice = (TARGETS / "circles.toml").read_text()
    other = '\n[[targets]]\ntype = "circles"\nname = "other"\nposition = ["0 m", "0 m", "-1 m"]\nmaterial = "ink"\n'
    other += 'pattern_material = "paper"\nrows = 1\ncolumns = 1\npitch = "9 mm"\ndot_diameter = "7 mm"\n'
    (tmp_path / "twice.toml").write_text(twice + other)
    marked = 'type = "charuco"\nrows = 4\ncolumns = 5\nsquare_size = "10 mm"\nmarker_size = "8 mm"\n'
    (tmp_path / "marked.toml").write_text(marked + 'dictionary = "DICT_4X4_5"\n')
    places = {
        "MARKED": str(tmp_path / "marked.toml"),
        "BARE": str(tmp_path / "big.toml"),
        "TWICE": str(tmp_path / "twice.toml"),
    }
    root = TARGETS.parents[1]
    words = [places.get(word, word.replace("OUT", str(tmp_path / "out"))) for word in arguments]
    words[0] = words[0] if words[0].startswith("/") else str(root / words[0])
    assert main(["convert", *words]) == 2
    assert said in capsys.readouterr().err
    assert not list(tmp_path.glob("out*"))
