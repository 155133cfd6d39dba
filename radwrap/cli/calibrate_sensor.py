"""``radwrap calibrate sensor``: K, gamma, dark and saturation from frames of known exposure (Eqs. 5 to 7)."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from radwrap.calibrate.response import PARAMETERS, Response, energy_in_cone, exposure_at_distance, fit_response
from radwrap.calibrate.response_fits import Array, PowerFit
from radwrap.cli import options as shared
from radwrap.errors import InputError
from radwrap.figure_png import figure_png
from radwrap.files import write_bytes
from radwrap.manifest import SCHEMA_VERSION, json_text
from radwrap.reading import FileKind, csv_rows, read_text, shortened, unusable
from radwrap.units import ANGLE, LENGTH, RADIANT_INTENSITY, Dimension, parse_quantity

EXPOSURE: Final = "radiant_exposure"
TIME: Final = "exposure_time"
GRAY: Final = "gray"
_FRAMES: Final = FileKind("file of frames", 64 << 20, "give a CSV file of frames")


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = verbs.add_parser(
        "sensor",
        help="K, gamma, dark and saturation from frames of known exposure",
        description="Fits G = K H^gamma + G0 up to saturation. FRAMES.csv has the columns radiant_exposure,gray "
        "(J/m^2) or exposure_time,gray (s) with --radiant-intensity and --distance (H = tau P_s/D^2) or --cone-angle "
        "(the paper's Eq. 6: an energy). Rows of equal exposure are repeats and give the noise.",
    )
    parser.add_argument("frames", metavar="FRAMES.csv", help="a row for each frame")
    parser.add_argument(
        "--radiant-intensity", metavar="P", help='radiant intensity of the source, such as "47.1 mW/sr"'
    )
    parser.add_argument("--distance", metavar="D", help='distance from source to sensor, such as "1 m"')
    parser.add_argument(
        "--cone-angle", metavar="A", help='full angle of the cone, such as "7 deg", for Eq. 6 as printed'
    )
    parser.add_argument(
        "--solid-angle",
        choices=("exact", "paper"),
        help="of the cone: 2 pi (1 - cos(A/2)), or the paper's pi tan^2(A/2) (default)",
    )
    parser.add_argument(
        "--dark", metavar="G", type=shared.GRAY_LEVEL, help="dark gray level (default: frames of exposure 0)"
    )
    parser.add_argument(
        "--saturation", metavar="G", type=shared.GRAY_LEVEL, help="highest gray level (default: the plateau)"
    )
    parser.add_argument(
        "--gamma",
        metavar="G",
        type=shared.number(),
        help="exponent where it is known: 1 of a linear camera (default: fitted)",
    )
    parser.add_argument(
        "--noise", metavar="G", type=shared.GRAY_LEVEL, help="standard deviation of a frame (default: repeats)"
    )
    parser.add_argument(
        "--quantisation",
        metavar="G",
        type=shared.GRAY_LEVEL,
        default=1.0,
        help="step of the gray levels, 0 for none (default 1)",
    )
    parser.add_argument(
        "--source-uncertainty",
        metavar="R",
        type=shared.number(),
        help="relative standard uncertainty of the source, such as 0.1",
    )
    parser.add_argument("--plot", metavar="PNG", help="draw frames, fits and residuals")
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the verb."""
    picture = shared.file_to_write(arguments.plot, "--plot", ".png", others=[arguments.frames])
    path = Path(arguments.frames)
    kind, values, gray, lines = read_frames(path)
    exposure, unit = _exposure(arguments, kind, values)
    source = arguments.source_uncertainty
    if source is not None and not 0 <= source < math.inf:
        raise InputError("must be a share such as 0.1", where="--source-uncertainty")
    try:
        response = fit_response(
            exposure,
            gray,
            dark=arguments.dark,
            saturation=arguments.saturation,
            quantisation=arguments.quantisation,
            noise=arguments.noise,
            gamma=arguments.gamma,
            exposure_unit=unit,
        )
    except InputError as error:
        raise InputError(error.what, where=str(path), remedy=error.remedy) from error
    if picture is not None:
        write_bytes(picture, plot(response, exposure, gray))
    found = report(response, exposure, gray, lines, source)
    print(json_text(found) if arguments.json else "\n".join(_lines(found)) + "\n", end="")
    return 0


def read_frames(path: Path) -> tuple[str, Array, Array, tuple[int, ...]]:
    """Read a table of frames.

    Returns
    -------
    kind : str
        "radiant_exposure" [J m^-2] or "exposure_time" [s].
    values, gray : ndarray, shape (n,)
        That quantity and the gray level of each frame.
    lines : tuple of int
        Line of each frame in the file, from 1.

    Raises
    ------
    InputError
        If there is no such file, or it is no such table.
    """
    rows = csv_rows(read_text(path, _FRAMES), str(path))
    header = [name.strip() for name in next(rows, (1, []))[1]]
    kinds = [kind for kind in (EXPOSURE, TIME) if kind in header]
    if len(kinds) != 1 or GRAY not in header or len(set(header)) != len(header):
        raise InputError(
            f'has the columns "{shortened(",".join(header))}"',
            where=str(path),
            remedy=f'the first line must read "{EXPOSURE},{GRAY}" (J/m^2) or "{TIME},{GRAY}" (s)',
        )
    columns = header.index(kinds[0]), header.index(GRAY)
    numbers, lines = [], []
    for line, row in rows:
        if not any(cell.strip() for cell in row):
            continue
        where = f"{path}: line {line}"
        if len(row) != len(header):
            raise InputError(f"has {len(row)} cells, the first line has {len(header)}", where=where)
        numbers.append([_number(row[column], where) for column in columns])
        if numbers[-1][0] < 0:
            raise InputError(f"the {kinds[0]} is negative", where=where)
        lines.append(line)
    if not numbers:
        raise InputError("holds no frames", where=str(path), remedy="write a row for each frame below the first line")
    table = np.array(numbers)
    return kinds[0], table[:, 0], table[:, 1], tuple(lines)


def _number(cell: str, where: str) -> float:
    try:
        value = float(cell)
    except ValueError as error:
        raise InputError(
            f'"{shortened(cell)}" is not a number', where=where, remedy="write 0.016, with a point"
        ) from error
    if why := unusable(value):
        raise InputError(f'"{shortened(cell)}" {why}', where=where)
    return value


def _quantity(text: str, dimension: Dimension, option: str) -> float:
    try:
        value = parse_quantity(text, dimension)
    except InputError as error:
        raise InputError(error.what, where=option, remedy=error.remedy) from error
    if value <= 0:
        raise InputError("must be above zero", where=option)
    return value


def _exposure(arguments: argparse.Namespace, kind: str, values: Array) -> tuple[Array, str]:
    """Exposures and their unit, from whichever column and options there are."""
    given = [
        option
        for option in ("--radiant-intensity", "--distance", "--cone-angle", "--solid-angle")
        if getattr(arguments, option[2:].replace("-", "_")) is not None
    ]
    if kind == EXPOSURE:
        if given:
            raise InputError(f"goes with the column {TIME}, the file has {EXPOSURE}", where=given[0])
        return values, "J/m^2"
    # What is missing is named at once, not one option after the other.
    missing = [] if "--radiant-intensity" in given else ["--radiant-intensity"]
    if ("--distance" in given) == ("--cone-angle" in given):
        missing.append(
            "only one of --distance and --cone-angle" if "--distance" in given else "--distance or --cone-angle"
        )
    if missing:
        raise InputError(
            f"the column {TIME} needs {' and '.join(missing)}",
            where="options",
            remedy="--distance reads Eq. 6 as energy per area, --cone-angle as printed",
        )
    intensity = _quantity(arguments.radiant_intensity, RADIANT_INTENSITY, "--radiant-intensity")
    if "--distance" in given:
        if "--solid-angle" in given:
            raise InputError("goes with --cone-angle", where="--solid-angle")
        return exposure_at_distance(values, intensity, _quantity(arguments.distance, LENGTH, "--distance")), "J/m^2"
    angle = _quantity(arguments.cone_angle, ANGLE, "--cone-angle")
    if angle >= math.pi:
        raise InputError("must be less than 180 deg", where="--cone-angle")
    return energy_in_cone(values, intensity, angle, arguments.solid_angle or "paper"), "J"


def report(
    response: Response, exposure: Array, gray: Array, lines: tuple[int, ...], source: float | None = None
) -> dict[str, Any]:
    """What ``--json`` prints; `source` is the relative standard uncertainty of the source."""
    left_out = [
        {
            "line": lines[item.frame],
            "exposure": float(exposure[item.frame]),
            "gray": float(gray[item.frame]),
            "fits": list(item.fits),
            "reason": item.reason,
        }
        for item in response.left_out
    ]
    return {
        "schema_version": SCHEMA_VERSION,
        "gain": response.scene_gain,
        "K": response.gain,
        "K_unit": response.gain_unit,
        "gamma": response.gamma,
        "dark_gray": response.dark_gray,
        "saturation_gray": response.saturation_gray,
        "sigma": dict(response.sigma),
        "K_sigma_with_source": None if source is None else response.gain_sigma_with_source(source),
        "covariance": {"parameters": list(PARAMETERS), "matrix": response.covariance.tolist()},
        "eq7": _fit(response.eq7),
        "direct": _fit(response.direct),
        "exposure_unit": response.exposure_unit,
        "frames": len(gray),
        "left_out": left_out,
        "noise": {"source": response.noise_source, "gray": response.noise_gray},
        "misfit_probability": response.misfit_probability,
        "residual_rms_gray": response.residual_rms_gray,
        "residuals_gray": response.residuals.tolist(),
    }


def _fit(fit: PowerFit) -> dict[str, Any]:
    return {
        "K": fit.gain,
        "gamma": fit.gamma,
        "dark_gray": fit.dark_gray,
        "sigma": dict(fit.sigma),
        "frames": len(fit.frames),
        "chi_square": fit.chi_square,
        "degrees_of_freedom": fit.degrees_of_freedom,
    }


def _lines(found: Mapping[str, Any]) -> Iterator[str]:
    unit = found["K_unit"]
    for name, title in (("direct", "direct fit"), ("eq7", "Eq. 7")):
        fit = found[name]
        sigma = fit["sigma"]
        yield (
            f"{title}: K {fit['K']:.5g} +- {sigma['K']:.2g} {unit if name == 'direct' else ''}".rstrip()
            + f", gamma {fit['gamma']:.5g} +- {sigma['gamma']:.2g}, dark {fit['dark_gray']:.4g} +- "
            f"{sigma['dark_gray']:.2g}; {fit['frames']} of {found['frames']} frames"
        )
    yield f"saturation: {found['saturation_gray']:.4g} +- {found['sigma']['saturation_gray']:.2g}"
    if found["K_sigma_with_source"] is not None:
        yield f"K with the uncertainty of the source: +- {found['K_sigma_with_source']:.2g}"
    origin = {"given": "as given", "repeats": "from repeats", "residuals": "from the residuals"}
    noise = f"{found['noise']['gray']:.3g} {origin[found['noise']['source']]}"
    yield f"residuals: {found['residual_rms_gray']:.3g} gray rms; noise of a frame {noise}"
    if found["misfit_probability"] is not None and found["misfit_probability"] < 0.01:
        yield f"warning: the frames do not follow the power law (chance {found['misfit_probability']:.1g})"
    if found["gain"] is not None:
        yield f'for a scene: gain = "{found["gain"]}", gamma = {found["gamma"]!r}'
    for item in found["left_out"]:
        yield f"left out of {' and '.join(item['fits'])}: line {item['line']}, gray {item['gray']:g}, {item['reason']}"


def plot(response: Response, exposure: Array, gray: Array) -> bytes:
    """PNG of frames, both fits and residuals; equal input gives equal bytes."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

    figure = Figure(figsize=(9, 6.4), dpi=120, layout="constrained")
    grid = figure.add_gridspec(2, 2, height_ratios=(2.2, 1))
    linear, logarithmic, below = (
        figure.add_subplot(grid[0, 0]),
        figure.add_subplot(grid[0, 1]),
        figure.add_subplot(grid[1, :]),
    )
    unit = "J m$^{-2}$" if response.exposure_unit == "J/m^2" else "J"
    scale, prefix = _prefix(float(exposure.max()))
    name = f"exposure [{prefix}{unit}]"
    used = np.isin(np.arange(len(gray)), response.direct.frames)
    lit = exposure > 0
    dense = np.linspace(0, exposure.max(), 500)
    above = np.geomspace(exposure[lit].min(), exposure.max(), 200)

    linear.plot(dense * scale, np.minimum(response.direct.gray(dense), response.saturation_gray), "-", color="C0")
    linear.plot(exposure[used] * scale, gray[used], "o", ms=4, color="k", label="used")
    linear.plot(exposure[~used] * scale, gray[~used], "o", ms=4, mfc="none", color="0.5", label="left out")
    for level, text in ((response.dark_gray, "dark"), (response.saturation_gray, "saturation")):
        linear.axhline(level, color="0.7", lw=0.8, ls=":")
        linear.annotate(
            f"{text} {level:.4g}",
            (1, level),
            (-4, 4),
            ("axes fraction", "data"),
            "offset points",
            ha="right",
            fontsize=8,
        )
    linear.set(xlabel=name, ylabel="gray level", ylim=(0, response.saturation_gray * 1.1))
    linear.legend(loc="center right", frameon=False, fontsize=8)

    clear = lit & (gray > response.eq7.dark_gray)
    straight = np.isin(np.arange(len(gray)), response.eq7.frames)
    for marks, colour, fill in ((clear & straight, "k", "k"), (clear & ~straight, "0.5", "none")):
        logarithmic.loglog(
            exposure[marks] * scale, gray[marks] - response.eq7.dark_gray, "o", ms=4, color=colour, mfc=fill
        )
    for fit, colour, title in ((response.direct, "C0", "direct"), (response.eq7, "C1", "Eq. 7")):
        label = rf"{title}: $\gamma$ = {fit.gamma:.4f} $\pm$ {fit.sigma['gamma']:.1g}"
        line = "-" if title == "direct" else "--"
        logarithmic.loglog(above * scale, fit.gray(above) - fit.dark_gray, line, color=colour, label=label)
    logarithmic.set(xlabel=name, ylabel="gray level above dark")
    for axis in (logarithmic.xaxis, logarithmic.yaxis):
        # A response spans one to three decades: powers of ten alone would leave an axis with one label.
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FormatStrFormatter("%g"))
        axis.set_minor_formatter(NullFormatter())
    logarithmic.legend(loc="upper left", frameon=False, fontsize=8)

    below.axhline(0, color="0.7", lw=0.8)
    below.plot(exposure[used] * scale, response.residuals[used], "o", ms=3, color="k")
    below.plot(exposure[~used] * scale, response.residuals[~used], "o", ms=3, mfc="none", color="0.5")
    below.set(xlabel=name, ylabel="measured - fitted [gray]")
    figure.suptitle(
        f"G = K H$^\\gamma$ + G$_0$:  K = {response.gain:.4g} $\\pm$ {response.sigma['K']:.2g} {response.gain_unit},"
        f"  residual {response.residual_rms_gray:.2g} gray rms",
        fontsize=10,
    )
    return figure_png(figure)


def _prefix(largest: float) -> tuple[float, str]:
    """Factor and SI prefix that bring a number to 1 to 1000."""
    for factor, prefix in ((1.0, ""), (1e3, "m"), (1e6, "µ"), (1e9, "n")):
        if largest * factor >= 1:
            return factor, prefix
    return 1e12, "p"
