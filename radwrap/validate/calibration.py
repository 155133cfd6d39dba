"""Section 8: Tsai's calibration from points, and Lenth's method on the paper's Table 3."""

from __future__ import annotations

import csv
import math
import tempfile
from collections.abc import Iterator
from io import StringIO
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from radwrap.calibrate.tsai import CameraCalibration, calibrate_camera
from radwrap.random_streams import generator
from radwrap.study.effects import analyse
from radwrap.study.levels import read_data
from radwrap.study.table import csv_text
from radwrap.validate.bench import Bench
from radwrap.validate.case import Case, Check, Finding, Plot
from radwrap.validate.printed import TABLE_3, TABLE_4

Array = NDArray[np.float64]

_EXACT: Final = 1e-9
_PRINTED: Final = 1e-9  # digits are the same, or differ by 0.01
_F: Final = 0.0125
_PIXEL: Final = (13.75e-6, 16e-6)
_CENTRE: Final = (95.5, 82.0)
_NOISE: Final = 0.05  # px
_TRIALS: Final = 200
_THREE_SIGMA: Final = 0.98  # of 200; with 43 degrees of freedom 99.55 % lie within 3 sigma
_NOMINAL: Final = 12.5  # mm, against which Table 3 takes its errors


def _about(axis: int, angle: float) -> Array:
    c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    x = [[1, 0, 0], [0, c, -s], [0, s, c]]
    y = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    z = [[c, -s, 0], [s, c, 0], [0, 0, 1]]
    return np.array([x, y, z][axis])


def _board() -> tuple[Array, Array]:
    """The paper's 5 x 5 dots at 0.79 m, turned by 46, 6 and -2 degrees, and their images by the definition."""
    line = (np.arange(5) - 2) * 0.01905
    x, y = np.meshgrid(line, line)
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(25)])
    turned = _about(0, 180.0) @ _about(2, -2.0) @ _about(1, 6.0) @ _about(0, 46.0)
    inside = points @ turned.T + np.array([0.0, 0.0, 0.79])
    return points, _F * inside[:, :2] / inside[:, 2:] / _PIXEL + _CENTRE


def _calibrated(points: Array, image: Array) -> CameraCalibration:
    return calibrate_camera(points, image, pixel_width=_PIXEL[0], pixel_height=_PIXEL[1], centre=_CENTRE)


def _tsai(bench: Bench) -> Iterator[Finding]:
    points, image = _board()
    exact = _calibrated(points, image)
    yield Case("8.tsai_f", "synthetic exact points", _F, exact.focal_length, _EXACT)
    yield Case("8.tsai_depth", "synthetic exact points", 0.79, exact.translation[2], _EXACT)
    bench.tick()
    random = generator(7)
    pulls = []
    for _ in range(_TRIALS):
        found = _calibrated(points, image + _NOISE * random.standard_normal(image.shape))
        pulls.append((found.focal_length - _F) / (found.sigma.focal_length or math.nan))
        bench.tick()
    share = float((np.abs(pulls) < 3).mean())
    source = f"share of {_TRIALS} noisy boards within 3 sigma"
    yield Case("8.tsai_f_coverage", source, float(1 - 2 * student.sf(3, 43)), share, _THREE_SIGMA, "at least")
    line = np.linspace(-4, 4, 201)
    curves = {
        "radwrap": (np.sort(pulls), np.linspace(0, 1, _TRIALS)),
        "reference: Student's t": (line, student.cdf(line, 43)),
    }
    yield Plot("Tsai, 0.05 px of noise: error of f over its sigma", "sigma", "share below", curves)


def _lenth(bench: Bench) -> Iterator[Finding]:
    """Effects of the 2^4 design over their pseudo standard error, as `study analyse` finds them from a table."""
    # The printed errors are rounded, which changes two entries of Table 4: they are computed from f.
    rows: list[dict[str, Any]] = list(csv.DictReader(StringIO(TABLE_3)))
    for row in rows:
        row["error_percent"] = abs(float(row["f [mm]"]) - _NOMINAL) / _NOMINAL * 100
    with tempfile.TemporaryDirectory(prefix="radwrap-") as folder:
        path = Path(folder) / "table3.csv"
        path.write_text(csv_text((*"ABCD", "f [mm]", "error_percent"), rows))
        for column, response in enumerate(("f", "error_percent")):
            found = {effect.name: effect.t for effect in analyse(read_data(path, response, [*"ABCD"])).effects}
            for name, printed in TABLE_4.items():
                ratio = found.get(name)
                ours = None if ratio is None else round(ratio, 2)
                full, source = f"8.lenth_{response}_{name}", "the paper's Table 4, printed digits"
                yield Case(full, source, float(printed[column]), ours, _PRINTED, "absolute")
    bench.tick()


CHECKS: Final = (
    Check("8.tsai", ("8.tsai_f", "8.tsai_depth", "8.tsai_f_coverage"), _tsai),
    Check("8.lenth", tuple(f"8.lenth_{what}_{name}" for what in ("f", "error_percent") for name in TABLE_4), _lenth),
)
