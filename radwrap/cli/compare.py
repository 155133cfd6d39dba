"""``radwrap compare``: a captured image beside the predicted one."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.cli import options as shared
from radwrap.cli import raw_mosaic
from radwrap.errors import CheckFailed, InputError
from radwrap.figure_png import figure_png
from radwrap.files import check_results, make_folder, write_bytes
from radwrap.images import GrayImage, read_gray, read_image, write_png
from radwrap.imaging.run_files import PartNumbers
from radwrap.manifest import SCHEMA_VERSION, json_text
from radwrap.measure.compare import REGISTRATIONS, Comparison, compare
from radwrap.measure.compare_statistics import Region, rectangle, regions_of_mask
from radwrap.progress import Progress
from radwrap.reading import FileKind, read_json
from radwrap.written import read_back

_BYTES: Final = 120  # a pixel: of 4 and 16 million pixels 105 and 109 were measured beyond the program itself

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

REPORT: Final = "report.png"
DIFFERENCE: Final = "diff.png"
RESULT: Final = "compare.json"
_SHOWN: Final = 1000  # pixels along the shorter side of a picture in the report, which has room for some 400
EQUAL: Final = 128  # code of no difference in diff.png; 0 is where nothing was compared
_TRUTH: Final = FileKind("truth.json", 64 << 20, "use truth.json of render --truth")


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = verbs.add_parser(
        "compare",
        description="Shows by how much a captured image differs from the predicted one, where, and whether exposure, "
        "dark level or geometry explains it. Differences are captured - predicted, on the predicted image's pixels.",
    )
    parser.add_argument("captured", metavar="CAPTURED", help="photograph: PNG, TIFF, PGM, EXR")
    parser.add_argument("predicted", metavar="PREDICTED", help="prediction, such as gray.png")
    parser.add_argument(
        "--register",
        choices=REGISTRATIONS,
        default="none",
        help="first move the captured image onto the predicted one (default none)",
    )
    parser.add_argument(
        "--region",
        metavar="NAME:U0,V0,U1,V1",
        action="append",
        default=[],
        help="statistics of columns U0 to U1 - 1, rows V0 to V1 - 1 of the predicted image; may be repeated",
    )
    parser.add_argument("--mask", metavar="PNG", help="statistics of each part in mask.png of render --truth")
    parser.add_argument("--truth", metavar="JSON", help="names of the parts (default: truth.json beside the mask)")
    parser.add_argument(
        "--dark", metavar="G", type=shared.GRAY_LEVEL, help="dark gray level (default: the prediction's smallest)"
    )
    parser.add_argument(
        "--saturation", metavar="G", type=shared.GRAY_LEVEL, help="highest gray level (default: full scale)"
    )
    parser.add_argument("--tolerance", metavar="G", type=shared.number(), help="fail if a pixel differs by more")
    parser.add_argument(
        "--allow-beyond",
        metavar="SHARE",
        type=shared.number(),
        default=0.0,
        help="share of pixels that may differ by more (default 0)",
    )
    parser.add_argument("--out", metavar="DIR", help=f"folder for {RESULT}, {DIFFERENCE} and {REPORT}")
    raw_mosaic.add_to(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the verb."""
    for name, highest in (("tolerance", math.inf), ("allow_beyond", 1.0), ("dark", math.inf), ("saturation", math.inf)):
        value = getattr(arguments, name)
        if value is not None and not (0 <= value <= highest and math.isfinite(value)):
            allowed = f"a number from 0 to {highest:g}" if math.isfinite(highest) else "a number of zero or more"
            raise InputError(f"must be {allowed}", where=f"--{name.replace('_', '-')}")
    if None not in (arguments.dark, arguments.saturation) and arguments.dark >= arguments.saturation:
        raise InputError(f"{arguments.dark:g} is not below --saturation {arguments.saturation:g}", where="--dark")
    if arguments.allow_beyond and arguments.tolerance is None:
        raise InputError("is of pixels beyond a tolerance", where="--allow-beyond", remedy="give --tolerance")
    if arguments.out:
        check_results(Path(arguments.out), (RESULT, DIFFERENCE, REPORT))
    captured, predicted = _images(arguments)
    shared.tell_memory("compare", captured.values.size, _BYTES)
    shape = (predicted.values.shape[0], predicted.values.shape[1])
    _check_saturated(captured, arguments.captured, arguments.saturation)
    _check_saturated(predicted, arguments.predicted, arguments.saturation)
    regions = [_rectangle(text, shape) for text in arguments.region]
    if arguments.mask:
        regions += _mask(Path(arguments.mask), arguments.truth)
    elif arguments.truth:
        raise InputError("goes with --mask", where="--truth")
    names = [region.name for region in regions]
    if twice := {name for name in names if names.count(name) > 1}:
        raise InputError(f'two regions have the name "{min(twice)}"', where="--region")
    progress = Progress("comparing", 1)
    comparison = compare(
        captured,
        predicted,
        register=arguments.register,
        regions=regions,
        tolerance=arguments.tolerance,
        dark=arguments.dark,
        saturation=arguments.saturation,
        progress=progress,
    )
    progress.close()
    found = report(comparison, arguments.register, arguments.tolerance, arguments.allow_beyond)
    found = {
        **found,
        "captured": arguments.captured,
        "predicted": arguments.predicted,
        "warnings": list(_warnings(captured, predicted, comparison, arguments.saturation)),
    }
    if arguments.out:
        folder = Path(arguments.out)
        make_folder(folder)
        write_bytes(folder / RESULT, json_text(found).encode())
        write_png(folder / DIFFERENCE, difference_codes(comparison))
        write_bytes(folder / REPORT, plot(comparison))
    print(json_text(found) if arguments.json else "\n".join(_lines(found)) + "\n", end="")
    if found["tolerance"] and not found["tolerance"]["passed"]:
        raise CheckFailed(
            f"{found['difference']['beyond']:.3%} of the pixels differ by more than {arguments.tolerance:g} gray, "
            f"{arguments.allow_beyond:.3%} may",
            where=arguments.captured,
        )
    return 0


def _images(arguments: argparse.Namespace) -> tuple[GrayImage, GrayImage]:
    """Both images; of raw mosaics that of one colour, where one is asked for, else pixel by pixel as they are."""
    paths = Path(arguments.captured), Path(arguments.predicted)
    known = {pattern for path in paths if (pattern := raw_mosaic.known_pattern(path)) is not None}
    if len(known) > 1:
        raise InputError(f"and {paths[1]} are of two mosaics: {' and '.join(sorted(known))}", where=str(paths[0]))
    if arguments.mosaic is None and known:
        (arguments.mosaic,) = known  # a photograph has no manifest
    if arguments.channel is not None:
        return raw_mosaic.read(paths[0], arguments), raw_mosaic.read(paths[1], arguments)
    if arguments.mosaic is not None and arguments.register != "none":
        raise InputError(
            f"would mix the colours of the raw mosaic {arguments.mosaic}", where="--register", remedy="give --channel"
        )
    return read_gray(paths[0]), read_gray(paths[1])


def _highest(image: GrayImage, saturation: float | None) -> float:
    return 2**image.bit_depth - 1 if saturation is None else saturation


def _check_saturated(image: GrayImage, file: str, saturation: float | None) -> None:
    if (image.values >= _highest(image, saturation)).all():
        raise InputError("is saturated all over: it shows nothing", where=file, remedy="shorten the exposure")


def _rectangle(text: str, shape: tuple[int, int]) -> Region:
    name, colon, numbers = text.rpartition(":")
    try:
        u0, v0, u1, v1 = (int(number) for number in numbers.split(","))
    except ValueError as error:
        raise InputError(f'"{text}" is not NAME:U0,V0,U1,V1', where="--region") from error
    if not (colon and name):
        raise InputError(f'"{text}" has no name', where="--region", remedy="write NAME:U0,V0,U1,V1")
    return rectangle(name, (u0, v0, u1, v1), shape)


def _mask(path: Path, truth: str | None) -> list[Region]:
    """Regions of a mask, with their names from truth.json where there is one."""
    mask, _ = read_image(path)
    if mask.dtype.kind != "u":
        raise InputError(
            f"is not a mask: it holds {mask.dtype}", where=str(path), remedy="use mask.png of render --truth"
        )
    beside = path.with_name("truth.json")
    names: dict[int, str] = {}
    if truth or beside.is_file():
        file = Path(truth) if truth else beside
        parts = read_back(read_json(file, _TRUTH), PartNumbers, str(file)).parts
        names = {number: name for name, number in parts.items()}
    return regions_of_mask(mask, names)


def _warnings(
    captured: GrayImage, predicted: GrayImage, comparison: Comparison, saturation: float | None
) -> Iterator[str]:
    if captured.bit_depth != predicted.bit_depth:
        yield (
            f"the captured file holds {captured.bit_depth} bits, the predicted one {predicted.bit_depth}: "
            "their gray levels may be on different scales"
        )
    for name, image in (("captured", captured), ("predicted", predicted)):
        if np.ptp(image.values) == 0:
            yield f"the {name} image is blank: gray {image.values[0, 0]:g} all over"
        share = float(np.mean(image.values >= _highest(image, saturation)))
        if share > 0:
            yield f"{share:.2%} of the {name} image is saturated and left out of gain and causes"
    if comparison.levels.gain is None:
        yield "gain and offset cannot be determined: the predicted image is even"


def report(comparison: Comparison, register: str, tolerance: float | None, allowed: float = 0.0) -> dict[str, Any]:
    """What ``--json`` prints of a comparison."""
    u, v = comparison.worst
    edges, captured, predicted = comparison.histograms()
    warp = comparison.warp
    beyond = comparison.overall.beyond
    return {
        "schema_version": SCHEMA_VERSION,
        "columns": comparison.predicted.shape[1],
        "rows": comparison.predicted.shape[0],
        "registration": {
            "kind": register,
            "captured_from_predicted": warp.tolist(),
            "shift_px": [float(warp[0, 2]), float(warp[1, 2])] if register == "translation" else None,
            "covered": float(np.isfinite(comparison.captured).mean()),
        },
        "difference": asdict(comparison.overall),
        "worst": {
            "u": u,
            "v": v,
            "captured": float(comparison.captured[v, u]),
            "predicted": float(comparison.predicted[v, u]),
        },
        "levels": asdict(comparison.levels),
        "causes": asdict(comparison.causes),
        "regions": {name: asdict(region) for name, region in comparison.regions.items()},
        "tolerance": None
        if tolerance is None or beyond is None
        else {"gray": tolerance, "allowed_beyond": allowed, "beyond": beyond, "passed": beyond <= allowed},
        "profiles": {
            "row": {"v": v, **_profile(comparison, (v, slice(None)))},
            "column": {"u": u, **_profile(comparison, (slice(None), u))},
        },
        "histogram": {"edges": edges.tolist(), "captured": captured.tolist(), "predicted": predicted.tolist()},
    }


def _profile(comparison: Comparison, line: tuple[Any, Any]) -> dict[str, list[float | None]]:
    captured = [None if math.isnan(value) else value for value in comparison.captured[line].tolist()]
    return {"captured": captured, "predicted": comparison.predicted[line].tolist()}


def _lines(found: Mapping[str, Any]) -> Iterator[str]:
    yield _statistics_line("difference", found["difference"])
    worst = found["worst"]
    yield (
        f"largest at column {worst['u']}, row {worst['v']}: "
        f"captured {worst['captured']:.4g}, predicted {worst['predicted']:.4g}"
    )
    registration = found["registration"]
    if registration["shift_px"]:
        yield "registered: shift {:.3f}, {:.3f} px".format(*registration["shift_px"])
    elif registration["kind"] == "homography":
        yield f"registered: homography {registration['captured_from_predicted']}"
    levels = found["levels"]
    if levels["gain"] is not None:
        correlation = "" if levels["correlation"] is None else f", correlation {levels['correlation']:.4f}"
        yield (
            f"captured = {levels['gain']:.4f} x predicted {levels['offset']:+.2f} gray "
            f"(+- {levels['gain_sigma']:.2g}, {levels['offset_sigma']:.2g}){correlation}"
        )
    causes = found["causes"]
    shift = "" if causes["shift"] is None else " by {:.2f}, {:.2f} px".format(*causes["shift"])
    factor = "" if causes["exposure_factor"] is None else f" x {causes['exposure_factor']:.3f}"
    if factor:  # a prediction without a dark place has another smallest level than a sensor without light
        factor += f" above {causes['dark_gray']:.4g} gray"
    geometry = "not known" if causes["geometry"] is None else f"{causes['geometry']:.3g}"
    yield (
        f"rms that stays: as is {causes['as_is']:.3g}, after dark level {causes['dark_level']:.3g}, "
        f"exposure{factor} {causes['exposure']:.3g}, geometry{shift} {geometry}, all {causes['all_together']:.3g}"
    )
    yield f"mainly: {causes['mainly'] or 'none of the three by itself'}"
    for name, region in found["regions"].items():
        yield _statistics_line(f'region "{name}"', region)
    for warning in found["warnings"]:
        yield f"warning: {warning}"


def _statistics_line(title: str, values: Mapping[str, Any]) -> str:
    beyond = "" if values["beyond"] is None else f", beyond the tolerance {values['beyond']:.2%}"
    return (
        f"{title}: rms {values['rms']:.3g}, mean {values['mean']:+.3g}, median {values['median']:+.3g}, "
        f"95 % within {values['quantile_95']:.3g}, 99 % within {values['quantile_99']:.3g}, "
        f"largest {values['maximum']:.3g} gray{beyond}; {values['pixels']} pixels"
    )


def difference_codes(comparison: Comparison) -> NDArray[np.uint8]:
    """Difference as 8 bits: 128 is none, 0 not compared; a code is one gray level, or more if +-127 would not do."""
    difference = comparison.difference
    scale = max(1.0, comparison.overall.maximum / 127)
    codes = np.clip(EQUAL + np.rint(np.nan_to_num(difference) / scale), 1, 255)
    return np.where(np.isfinite(difference), codes, 0).astype(np.uint8)


def plot(comparison: Comparison) -> bytes:
    """PNG of both images, their difference, profiles and histograms; equal input gives equal bytes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 7.2), dpi=110, layout="constrained")
    axes = figure.subplots(2, 3)
    u, v = comparison.worst
    top = max(float(np.nanmax(comparison.captured)), float(comparison.predicted.max()))
    for axis, image, title in (
        (axes[0, 0], comparison.captured, "captured"),
        (axes[0, 1], comparison.predicted, "predicted"),
    ):
        shown = _drawn(axis, image, cmap="gray", vmin=0, vmax=top)
        axis.set_title(title)
        figure.colorbar(shown, ax=axis, label="gray level", shrink=0.85)
    # The few largest differences must not hide the others.
    reach = max(comparison.overall.quantile_99, 1.0)
    shown = _drawn(axes[0, 2], comparison.difference, cmap="RdBu_r", vmin=-reach, vmax=reach)
    axes[0, 2].set_facecolor("0.8")
    axes[0, 2].axhline(v, color="k", lw=0.6, ls=":")
    axes[0, 2].axvline(u, color="k", lw=0.6, ls=":")
    axes[0, 2].set_title("captured - predicted")
    figure.colorbar(shown, ax=axes[0, 2], label="gray (99 % of pixels within)", shrink=0.85, extend="both")
    _draw_profile(axes[1, 0], comparison, (v, slice(None)), f"row {v}", "column")
    _draw_profile(axes[1, 1], comparison, (slice(None), u), f"column {u}", "row")
    edges, captured, predicted = comparison.histograms()
    last = int(np.flatnonzero(captured + predicted).max()) + 2
    for counts, colour, title in ((captured, "C3", "captured"), (predicted, "C0", "predicted")):
        axes[1, 2].stairs(counts[:last], edges[: last + 1], color=colour, label=title)
    axes[1, 2].set(yscale="log", ylim=(0.7, None), xlabel="gray level", ylabel="pixels", title="histogram")
    axes[1, 2].legend(frameon=False, fontsize=8)
    overall, causes = comparison.overall, comparison.causes
    figure.suptitle(
        f"difference: rms {overall.rms:.3g}, mean {overall.mean:+.3g}, largest {overall.maximum:.3g} gray"
        f" at ({u}, {v}); mainly: {causes.mainly or 'none of dark level, exposure, shift by itself'}",
        fontsize=11,
    )
    return figure_png(figure)


def _drawn(axis: Axes, image: NDArray[np.float64], **colours: Any) -> AxesImage:
    """An image as every so many of its pixels show it: more than these have no room."""
    step = max(1, min(image.shape) // _SHOWN)
    some = image[::step, ::step]
    right, bottom = some.shape[1] * step - 0.5, some.shape[0] * step - 0.5
    return axis.imshow(some, interpolation="nearest", extent=(-0.5, right, bottom, -0.5), **colours)


def _draw_profile(axis: Axes, comparison: Comparison, line: tuple[Any, Any], title: str, name: str) -> None:
    axis.plot(comparison.captured[line], color="C3", lw=1, label="captured")
    axis.plot(comparison.predicted[line], color="C0", lw=1, label="predicted")
    axis.set(title=f"{title} (largest difference)", xlabel=f"{name} [px]", ylabel="gray level")
    axis.legend(frameon=False, fontsize=8)
    axis.margins(x=0)
