"""``radwrap measure edge``: where the one straight edge of an image lies, and how wide it is blurred."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from radwrap.cli import options as shared
from radwrap.cli import raw_mosaic
from radwrap.cli.gauging import two_digits, with_sigma
from radwrap.errors import InputError
from radwrap.manifest import SCHEMA_VERSION, finite, json_text
from radwrap.measure.edges import MOST_BYTES, Edge, measure_edge
from radwrap.measure.edges.misfit import SIGNIFICANT
from radwrap.progress import Progress

_BYTES: Final = 30  # a pixel: of 1 to 64 million pixels 22 to 25 were measured beyond what the program itself takes
_STRIP_BYTES: Final = 200  # a pixel of the strip along the edge, which may be all of a small picture

# Correlation from which on a fitted gamma costs the place more than a factor of 1.7 in standard error.
HARDLY_APART = 0.8
# Share of the bright side that has exactly one gray level; light and noise seldom leave so much.
PLATEAU = 0.5
# Of the contrast. A box, which is the worst of the symmetric blurs that were tried, leaves 0.003 and no even part; two
# steps, fringes and lines beside the edge leave 0.01 and more, with an even part of more than 0.007.
LARGEST_MISFIT = 0.01
LARGEST_EVEN_MISFIT = 0.002


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = verbs.add_parser("edge", help="place, angle and blur of a straight edge", description=__doc__)
    parser.add_argument("image", metavar="IMAGE", type=Path, help="PNG, TIFF, PGM of 8 or 16 bits, or EXR")
    parser.add_argument(
        "--dark",
        metavar="G",
        type=shared.GRAY_LEVEL,
        help="gray level without light (default: the dark side counts as unlit)",
    )
    parser.add_argument(
        "--gamma",
        metavar="G",
        default="fitted",
        help='exponent of the response, a number or "fitted" (default fitted)',
    )
    parser.add_argument(
        "--region",
        metavar=("U0", "V0", "U1", "V1"),
        nargs=4,
        type=shared.whole(),
        help="first column and row, last column and row to look at (default: the whole image)",
    )
    parser.add_argument(
        "--pixel-aspect",
        metavar="A",
        type=shared.number(),
        default=1.0,
        help="height of a pixel over its width (default 1)",
    )
    parser.add_argument(
        "--saturation",
        metavar="G",
        type=shared.GRAY_LEVEL,
        help="pixels of this gray level and above are left out (default: full scale)",
    )
    raw_mosaic.add_to(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the verb."""
    image = raw_mosaic.read(arguments.image, arguments)
    shared.tell_memory("measure edge", image.values.size, _BYTES, min(image.values.size * _STRIP_BYTES, MOST_BYTES))
    progress = Progress("measuring the edge", 1)
    try:
        edge = measure_edge(
            image,
            dark=arguments.dark,
            gamma=_gamma(arguments.gamma),
            region=tuple(arguments.region) if arguments.region else None,
            pixel_aspect=arguments.pixel_aspect,
            saturation=arguments.saturation,
            progress=progress,
        )
    except InputError as error:
        raise _located(error, arguments.image) from error
    finally:
        progress.close()
    print(json_text(_json(edge, arguments)) if arguments.json else "\n".join(_lines(edge)) + "\n", end="")
    return 0


def _gamma(text: str) -> float | None:
    if text == "fitted":
        return None
    try:
        return float(text)
    except ValueError as error:
        raise InputError(f'"{text}" is neither a number nor "fitted"', where="gamma") from error


def _located(error: InputError, path: Path) -> InputError:
    """The file's name, or the option's, where the function speaks of its arguments."""
    options = ("region", "gamma", "dark", "pixel_aspect", "saturation")
    return InputError(error.what, where=error.where if error.where in options else str(path), remedy=error.remedy)


def _json(edge: Edge, arguments: argparse.Namespace) -> dict[str, Any]:
    return {
        "schema_version": SCHEMA_VERSION,
        "image": str(arguments.image),
        "pixel_convention": "u is the column, v the row; the centre of the first pixel is (0, 0)",
        "line": "u cos(angle) + v sin(angle) = offset [px], angle in rad",
        "angle": edge.angle,
        "sigma_angle": edge.sigma_angle,
        "angle_deg": math.degrees(edge.angle),
        "offset": edge.offset,
        "sigma_offset": edge.sigma_offset,
        "centre": list(edge.centre),
        "sigma_position": edge.sigma_position,
        "bright_side": edge.bright_side,
        "radius": edge.radius,
        "sigma_radius": finite(edge.sigma_radius),
        "transition_width": 2 * edge.radius,
        "pixel_aspect": arguments.pixel_aspect,
        "gamma": edge.gamma,
        "sigma_gamma": edge.sigma_gamma,
        "gamma_fitted": arguments.gamma == "fitted",
        "position_gamma_correlation": edge.position_gamma_correlation,
        "dark": arguments.dark,
        "low": edge.low,
        "sigma_low": edge.sigma_low,
        "high": edge.high,
        "sigma_high": edge.sigma_high,
        "covariance": {"of": ["offset", "angle", "radius", "gamma"], "values": edge.covariance.tolist()},
        "residual_rms": edge.residual_rms,
        "pixels": edge.pixels,
        "saturated_pixels": edge.saturated,
        "level_share": edge.level_share,
        "misfit": edge.misfit,
        "even_misfit": edge.even_misfit,
        "beyond_disc": finite(edge.beyond_disc),
        "warnings": list(warnings_of(edge)),
        "strip": {"half_width": edge.half_width, "length": edge.length},
    }


def _lines(edge: Edge) -> Iterator[str]:
    yield (
        f"edge: u cos a + v sin a = {with_sigma(edge.offset, edge.sigma_offset)} px, a = "
        f"{with_sigma(math.degrees(edge.angle), math.degrees(edge.sigma_angle))} deg"
    )
    u, v = edge.centre
    yield f"at ({u:.3f}, {v:.3f}), where it is known to {two_digits(edge.sigma_position)} px"
    yield f"blur: radius {with_sigma(edge.radius, edge.sigma_radius)} px, transition {2 * edge.radius:.3f} px"
    side = "above" if edge.bright_side == "positive" else "below"
    yield (
        f"levels: gray {with_sigma(edge.low, edge.sigma_low, 2)} and {with_sigma(edge.high, edge.sigma_high, 2)}, "
        f"bright where u cos a + v sin a is {side} the offset"
    )
    fitted = f"fitted +- {two_digits(edge.sigma_gamma)}" if edge.sigma_gamma > 0 else "given"
    yield f"gamma: {edge.gamma:.4f} ({fitted})"
    if edge.sigma_gamma > 0 and abs(edge.position_gamma_correlation) > HARDLY_APART:
        yield (
            f"place and gamma can hardly be separated (correlation {edge.position_gamma_correlation:+.2f}): "
            "with --gamma the place is better known"
        )
    yield from (f"warning: {text}" for text in warnings_of(edge))
    left = f", {edge.saturated} saturated ones left out" if edge.saturated else ""
    yield f"residual: {edge.residual_rms:.3g} gray rms over {edge.pixels} pixels{left}"


def warnings_of(edge: Edge) -> Iterator[str]:
    """What speaks against the numbers."""
    if edge.level_share > PLATEAU:
        yield (
            f"{edge.level_share:.0%} of the bright side has one and the same gray level: where that is not even light "
            "but the camera's saturation, place, blur and gamma are wrong; then name the level with --saturation"
        )
    if edge.sigma_gamma > 0 and edge.beyond_disc > SIGNIFICANT:
        yield (
            "the blur is not a disc: another gamma at another place then fits nearly as well, and both may be off by "
            "many standard errors; give --gamma"
        )
    if edge.misfit > LARGEST_MISFIT or edge.even_misfit > LARGEST_EVEN_MISFIT:
        off = max(edge.misfit, edge.even_misfit)
        yield (
            f"across the edge light differs by {off:.1%} of the contrast from a step with a symmetric blur: a second "
            "edge, a fringe, a shadow, saturation or coma moves the place by more than its standard error"
        )
