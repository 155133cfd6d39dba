"""Contours of parts: closed lines where half of a pixel is covered."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from radwrap.images import GrayImage, write_png
from radwrap.measure.parts import find_parts
from tests.cli.conftest import here


def ring(side: int = 100, outer: float = 30.0, inner: float = 14.0) -> NDArray[np.float64]:
    """A bright ring about (52.3, 47.6), blurred over a pixel and a half."""
    v, u = np.indices((side, side))
    away = np.hypot(u - 52.3, v - 47.6)
    inside = np.clip((outer - away) / 1.5 + 0.5, 0, 1) * np.clip((away - inner) / 1.5 + 0.5, 0, 1)
    light: NDArray[np.float64] = 20 + 180 * inside
    return light


def test_a_ring_has_an_outer_line_and_that_of_its_hole() -> None:
    (part,) = find_parts(GrayImage(np.rint(ring()))).parts
    assert len(part.contours) == 2
    for line, radius in zip(part.contours, (30.0, 14.0), strict=True):
        assert line[0] == pytest.approx(line[-1])
        away = np.hypot(line[:, 0] - 52.3, line[:, 1] - 47.6)
        assert away.mean() == pytest.approx(radius, abs=0.05)
        assert away.std() < 0.1


def test_lines_go_around_the_area() -> None:
    (part,) = find_parts(GrayImage(np.rint(ring()))).parts
    areas = [0.5 * abs(float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))) for x, y in (c.T for c in part.contours)]
    assert areas[0] - areas[1] == pytest.approx(part.area, rel=0.01)


def test_a_part_at_the_border_has_a_closed_line_too() -> None:
    (part,) = find_parts(GrayImage(np.rint(ring()[:, :60]))).parts
    assert part.touches_border and all(line[0] == pytest.approx(line[-1]) for line in part.contours)
    assert max(float(line[:, 0].max()) for line in part.contours) <= 59.6


def test_they_are_told_where_they_are_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "ring.png"
    write_png(path, np.rint(ring()).astype(np.uint8))
    plain = json.loads(here(["measure", "parts", path, "--json"], capsys).success().stdout)
    assert "contours" not in plain["parts"][0]
    told = json.loads(here(["measure", "parts", path, "--json", "--contours"], capsys).success().stdout)
    assert [len(line) > 50 for line in told["parts"][0]["contours"]] == [True, True]
