"""``radwrap measure width`` and ``measure line``: straight edges, to a small part of a pixel."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from typing import Any

from radwrap.cli import gauging
from radwrap.cli import options as shared
from radwrap.errors import InputError, ToleranceNotMet
from radwrap.manifest import finite, json_text
from radwrap.measure.gauges import Line, StraightCaliper, Width, measure_line, measure_width
from radwrap.study.placed_calipers import AXES, line_caliper, width_caliper


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add both verbs."""
    width = verbs.add_parser(
        "width",
        help="width between two straight edges",
        description="Distance of two straight edges that face each other, to a small part of a pixel. Exit code 3 "
        "where place and direction are known, but the width is not.",
    )
    gauging.add_look(width, plane=True)
    _add_caliper(width)
    width.add_argument("--inside", choices=["bright", "dark"], help="what lies between them (default: as it is)")
    width.add_argument(
        "--across",
        choices=AXES,
        default="x",
        help="with --truth: the axis to measure along (default x)",
    )
    width.set_defaults(run=run_width)
    line = verbs.add_parser(
        "line",
        help="place and direction of a straight edge or stripe",
        description="Place and direction of one straight edge, or of a stripe's middle and its width. Unlike `measure "
        "edge` it needs a caliper, and leaves out what does not belong to the line; it fits no gamma.",
    )
    gauging.add_look(line, plane=False)
    _add_caliper(line)
    line.add_argument("--stripe", action="store_true", help="measure a stripe: its middle, and its width")
    line.set_defaults(run=run_line)


def _add_caliper(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--at", metavar=("U", "V"), nargs=2, type=shared.number(), help="the caliper's middle [px]")
    parser.add_argument(
        "--angle",
        metavar="A",
        help="angle of the edges' normal, from u towards v, in degrees or with a unit (default 0)",
    )
    parser.add_argument("--length", metavar="L", help="length along the edges: pixels, or mm where there is a scale")
    parser.add_argument("--band", metavar="B", help="edges lie within so much of the middle, along the normal")


def run_width(arguments: argparse.Namespace) -> int:
    """Carry out ``measure width``."""
    found = gauging.look(arguments, "measure width")
    try:
        caliper, true_width = _caliper_of_width(arguments, found)
        width = measure_width(
            found.image,
            caliper,
            response=found.response,
            inside=arguments.inside,
            plane=found.plane,
            way=arguments.edge,
            pixel_aspect=found.aspect,
        )
    except InputError as error:
        raise gauging.located(error, arguments.image) from error
    told = gauging.head(found, arguments.edge) | _told_width(found, width)
    if true_width is not None:
        told["true_width_mm"] = true_width / gauging.MM
    print(json_text(told) if arguments.json else "\n".join(_width_lines(told)) + "\n", end="")
    return ToleranceNotMet.exit_code if width.width is None else 0


def run_line(arguments: argparse.Namespace) -> int:
    """Carry out ``measure line``."""
    found = gauging.look(arguments, "measure line")
    try:
        caliper = _given(arguments, found) if arguments.at is not None else _true_line(found)
        line = measure_line(
            found.image,
            caliper,
            response=found.response,
            stripe=arguments.stripe,
            way=arguments.edge,
            pixel_aspect=found.aspect,
        )
    except InputError as error:
        raise gauging.located(error, arguments.image) from error
    told = gauging.head(found, arguments.edge) | _told_line(found, line)
    print(json_text(told) if arguments.json else "\n".join(_line_lines(told)) + "\n", end="")
    return 0


def _given(arguments: argparse.Namespace, found: gauging.Look) -> StraightCaliper:
    """The caliper that options place."""
    at = (arguments.at[0], arguments.at[1])
    for name in ("length", "band"):
        if getattr(arguments, name) is None:
            raise InputError("is missing", where=name, remedy="--at goes with --length and --band")
    angle = 0.0 if arguments.angle is None else gauging.angle_of(arguments.angle, "angle")
    length, band = (found.pixels(getattr(arguments, name), name, at) for name in ("length", "band"))
    return StraightCaliper(at, angle, length, band)


def _caliper_of_width(arguments: argparse.Namespace, found: gauging.Look) -> tuple[StraightCaliper, float | None]:
    if arguments.at is not None:
        return _given(arguments, found), None
    face, scene = gauging.truth_face(found)
    try:
        return width_caliper(scene.camera, face, arguments.across, found.aspect)
    except InputError as error:
        raise InputError(error.what, where="truth", remedy="place it by --at") from error


def _true_line(found: gauging.Look) -> StraightCaliper:
    """A caliper along the edge of the target that --truth names."""
    _, scene = gauging.truth_face(found)
    try:
        return line_caliper(scene, found.truth or "", found.aspect)
    except InputError as error:
        raise InputError(error.what, where="truth", remedy="place it by --at") from error


def _told_width(found: gauging.Look, width: Width) -> dict[str, Any]:
    return {
        **_told_length(found, width, width.unit),
        "inside": width.inside,
        "centre": list(width.centre),
        "angle": width.angle,
        "angle_sigma": width.angle_sigma,
        "slant": width.slant,
        "slant_sigma": width.slant_sigma,
        "blur_radius": finite(width.blur),
        "misfit": finite(width.misfit),
        "left_out": width.left_out,
        "points": width.points,
        "warnings": list(width.warnings),
    }


def _told_line(found: gauging.Look, line: Line) -> dict[str, Any]:
    error = gauging.certified(found.path, found.image)
    told: dict[str, Any] = {
        "line": "u cos(angle) + v sin(angle) = offset [px]",
        "angle": line.angle,
        "angle_sigma": line.angle_sigma,
        "offset": line.offset,
        "centre": list(line.centre),
        "position_sigma": line.position_sigma,
        "position_rendering": None if error is None else finite(error * line.position_by_rendering),
        "bright_side": line.bright_side,
        "blur_radius": finite(line.blur),
        "blur_radius_sigma": finite(line.blur_sigma),
        "misfit": finite(line.misfit),
        "left_out": line.left_out,
        "points": line.points,
        "warnings": list(line.warnings),
    }
    if line.inside is not None:
        told |= {"inside": line.inside} | _told_length(found, line, "px")
    return told


def _told_length(found: gauging.Look, of: Line | Width, unit: str) -> dict[str, Any]:
    """The width with its errors; where it is not known, the widths and blurs that look alike."""
    if of.width is None or of.width_sigma is None or of.width_by_rendering is None:
        alike = [{"width": found.told(width, unit), "blur_radius": blur} for width, blur in of.readings]
        return {"width": None, "width_readings": alike}
    return gauging.length_with_errors(found, "width", (of.width, of.width_sigma, of.width_by_rendering), unit)


def _width_lines(told: dict[str, Any]) -> Iterator[str]:
    yield f"width: {_width_in_words(told)}; {told['inside']} inside"
    u, v = told["centre"]
    yield f"  about u {u:.3f}, v {v:.3f} px, normal at {math.degrees(told['angle']):.4f} deg"
    if "true_width_mm" in told:
        yield f"  the scene's: {told['true_width_mm']:.4f} mm"
    yield from _more(told)
    if told["unit"] == "mm":
        yield f"scale: {told['scale_source']}"


def _width_in_words(told: dict[str, Any]) -> str:
    return "not known" if told["width"] is None else gauging.in_words(told, "width", told["unit"])


def _line_lines(told: dict[str, Any]) -> Iterator[str]:
    u, v = told["centre"]
    yield (
        f"line: u cos a + v sin a = {told['offset']:.4f} px, a = "
        f"{gauging.with_sigma(math.degrees(told['angle']), math.degrees(told['angle_sigma']))} deg"
    )
    by = told["position_rendering"]
    rendering = "" if by is None else f", rendering about {gauging.two_digits(by)}"
    yield f"  at u {u:.3f}, v {v:.3f}, where it is known to {gauging.two_digits(told['position_sigma'])} px{rendering}"
    if "width" in told:
        yield f"  width {_width_in_words(told)}; {told['inside']} inside"
    yield from _more(told)


def _more(told: dict[str, Any]) -> Iterator[str]:
    if told["blur_radius"] is not None:
        yield f"  blur: radius {told['blur_radius']:.3f} px; {told['left_out']:.0%} of the edge left out"
    yield from (f"  warning: {text}" for text in told["warnings"])
