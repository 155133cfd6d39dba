"""Targets to print: SVG, a file for each sheet, and PDF, all sheets in one file; vectors at their true size.

Both are written here, in a few operators: nothing is rounded to pixels, and the same target gives the same bytes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Final

from radwrap.convert.print_pages import TEXT, Page, Paper, pages
from radwrap.files import make_folder, write_bytes
from radwrap.scene.patterns.layouts import Layout
from radwrap.scene.patterns.marks import FlatDisc, Mark, Place

_MM: Final = 1e3
_POINTS: Final = 72 / 25.4  # PDF's unit, of which an inch has 72, in a millimetre
_ARCS: Final = 8  # of a circle in PDF, which has cubic curves only: off by 4e-6 of the radius
_REACH: Final = 4 / 3 * math.tan(math.pi / 2 / _ARCS)  # of the curve's inner points along the tangents, in radii


def write_svg(name: str, layout: Layout, path: Path, paper: Paper) -> tuple[Path, ...]:
    """Write a target as SVG, one file for each sheet: OUT.svg, or OUT.row1_column1.svg and so on; the files."""
    made = {
        path if not page.name else path.with_suffix(f".{page.name}.svg"): _svg(page).encode()
        for page in pages(name, layout, paper)
    }
    return _written(made, path)


def write_pdf(name: str, layout: Layout, path: Path, paper: Paper) -> tuple[Path, ...]:
    """Write a target as PDF, a page for each sheet; the file."""
    return _written({path: _pdf(pages(name, layout, paper))}, path)


def _written(made: dict[Path, bytes], path: Path) -> tuple[Path, ...]:
    make_folder(path.parent)
    for place, content in made.items():
        write_bytes(place, content)
    return tuple(made)


def _number(value: float) -> str:
    """A length in millimetres, to the nanometre."""
    text = f"{value * _MM:.6f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def _svg(page: Page) -> str:
    width, height = map(_number, page.size)

    def at(place: Place) -> str:
        return f"{_number(place[0])} {_number(page.size[1] - place[1])}"

    def shape(mark: Mark) -> str:
        if isinstance(mark, FlatDisc):
            x, y = at((mark.x, mark.y)).split()
            return f'<circle cx="{x}" cy="{y}" r="{_number(mark.radius)}"/>'
        return f'<path d="M{" L".join(map(at, mark.vertices))} Z"/>'

    window = page.window
    left, top = at((window.left, window.top)).split()
    size = f'width="{_number(window.right - window.left)}" height="{_number(window.top - window.bottom)}"'
    x, y = at(page.text_place).split()
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}mm" height="{height}mm" '
        f'viewBox="0 0 {width} {height}">',
        f'<clipPath id="plate"><rect x="{left}" y="{top}" {size}/></clipPath>',
        # Edges of marks that touch are not to show as hairlines.
        '<g clip-path="url(#plate)" shape-rendering="crispEdges">',
        *map(shape, page.marks),
        "</g>",
        *map(shape, page.guides),
        f'<text x="{x}" y="{y}" font-family="Helvetica, Arial, sans-serif" font-size="{_number(TEXT)}">'
        f"{page.text}</text>",
        "</svg>",
    ]
    return "\n".join(lines) + "\n"


def _pdf(sheets: Sequence[Page]) -> bytes:
    """A PDF 1.4 file: its catalog, pages, one font that every reader has, and contents."""
    kids = " ".join(f"{4 + 2 * number} 0 R" for number in range(len(sheets)))
    objects = [
        "<< /Type /Catalog /Pages 2 0 R >>",
        f"<< /Type /Pages /Kids [{kids}] /Count {len(sheets)} >>",
        "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>",
    ]
    for number, page in enumerate(sheets):
        box = " ".join(f"{side * _MM * _POINTS:.6f}" for side in page.size)
        objects.append(
            f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {box}] /Resources << /Font << /F1 3 0 R >> >> "
            f"/Contents {5 + 2 * number} 0 R >>"
        )
        content = "\n".join(_content(page)) + "\n"
        objects.append(f"<< /Length {len(content)} >>\nstream\n{content}endstream")
    text = "%PDF-1.4\n"
    places = []
    for number, body in enumerate(objects, 1):
        places.append(len(text))
        text += f"{number} 0 obj\n{body}\nendobj\n"
    table = "".join(f"{place:010d} 00000 n \n" for place in places)
    count = len(objects) + 1
    start = len(text)
    text += f"xref\n0 {count}\n0000000000 65535 f \n{table}trailer\n<< /Size {count} /Root 1 0 R >>\n"
    text += f"startxref\n{start}\n%%EOF\n"
    return text.encode("ascii")


def _content(page: Page) -> Iterator[str]:
    yield f"{_POINTS!r} 0 0 {_POINTS!r} 0 0 cm 0 g"
    window = page.window
    size = f"{_number(window.right - window.left)} {_number(window.top - window.bottom)}"
    yield f"q {_number(window.left)} {_number(window.bottom)} {size} re W n"
    yield from _filled(page.marks)
    yield "Q"
    yield from _filled(page.guides)
    x, y = page.text_place
    yield f"BT /F1 {_number(TEXT)} Tf {_number(x)} {_number(y)} Td ({page.text}) Tj ET"


def _filled(marks: Sequence[Mark]) -> Iterator[str]:
    """All marks as one path, so that none shows a hairline where it touches another."""
    if not marks:
        return
    for mark in marks:
        if isinstance(mark, FlatDisc):
            yield from _circle(mark)
        else:
            first, *others = mark.vertices
            yield " ".join([f"{_at(first)} m", *(f"{_at(place)} l" for place in others), "h"])
    yield "f"


def _circle(disc: FlatDisc) -> Iterator[str]:

    def on(turn: float, ahead: float = 0.0) -> str:
        """A point of the circle, or of its tangent there."""
        cosine, sine = math.cos(turn), math.sin(turn)
        return _at((disc.x + disc.radius * (cosine - ahead * sine), disc.y + disc.radius * (sine + ahead * cosine)))

    turns = [2 * math.pi * number / _ARCS for number in range(_ARCS + 1)]
    yield f"{on(0.0)} m"
    for start, end in pairwise(turns):
        yield f"{on(start, _REACH)} {on(end, -_REACH)} {on(end)} c"
    yield "h"


def _at(place: Place) -> str:
    return f"{_number(place[0])} {_number(place[1])}"
