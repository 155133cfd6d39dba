"""``radwrap measure region`` and ``measure uniformity``: gray levels of areas."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from radwrap.cli import gauging
from radwrap.cli import options as shared
from radwrap.errors import InputError
from radwrap.images import read_gray
from radwrap.manifest import SCHEMA_VERSION, finite, json_text
from radwrap.measure.gauges import Box, Response, contrast_of, measure_region, measure_uniformity
from radwrap.measure.gauges.uniformity import CELLS


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add both verbs."""
    region = verbs.add_parser(
        "region",
        help="mean, spread, contrast and contrast-to-noise of regions",
        description="Mean and spread of gray levels in a rectangle, and what sets it apart from another one. Several "
        "frames of the same scene tell temporal noise from structure.",
    )
    region.add_argument(
        "images",
        metavar="IMAGE",
        type=Path,
        nargs="+",
        help="PNG, TIFF, PGM of 8 or 16 bits, or EXR; frames of one scene",
    )
    _add_box(region, "--region", "which pixels (default: the whole image)")
    _add_box(region, "--against", "the region to hold it against")
    region.add_argument("--dark", metavar="G", type=shared.GRAY_LEVEL, help="gray level without light (default 0)")
    region.add_argument(
        "--noise",
        choices=["spatial", "temporal"],
        default="spatial",
        help="what the contrast is held against: standard deviation over a region's pixels (default), or of a pixel",
    )
    shared.add_json(region)
    region.set_defaults(run=run_region)
    even = verbs.add_parser(
        "uniformity",
        help="how evenly an area is lit",
        description="1 - sd/mean and (max - min)/(max + min) of light over an area, by the means of its cells.",
    )
    even.add_argument("image", metavar="IMAGE", type=Path, help="PNG, TIFF, PGM of 8 or 16 bits, or EXR")
    _add_box(even, "--region", "which pixels (default: the whole image)")
    gauging.add_response(even)
    even.add_argument(
        "--cells",
        metavar="N",
        type=shared.whole(1, 1 << 20),
        default=CELLS,
        help=f"cells a side, at most: extremes of single pixels are those of noise (default {CELLS})",
    )
    shared.add_json(even)
    even.set_defaults(run=run_uniformity)


def _add_box(parser: argparse.ArgumentParser, name: str, purpose: str) -> None:
    parser.add_argument(
        name,
        metavar=("U0", "V0", "U1", "V1"),
        nargs=4,
        type=shared.whole(),
        help=f"first column and row, last column and row: {purpose}",
    )


def run_region(arguments: argparse.Namespace) -> int:
    """Carry out ``measure region``."""
    frames = [read_gray(path) for path in arguments.images]
    rows, columns = frames[0].values.shape
    told: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "images": list(map(str, arguments.images)),
        "dark": arguments.dark or 0.0,
        "certified_rms_gray": gauging.certified(arguments.images[0]),
    }
    whole = [0, 0, columns - 1, rows - 1]
    try:
        first = measure_region(frames, Box(*(arguments.region or whole)))
        told["region"] = _numbers(asdict(first)) | {"box": arguments.region or whole}
        if arguments.against is not None:
            second = _against(frames, arguments.against)
            told["against"] = _numbers(asdict(second)) | {"box": arguments.against}
            contrast = contrast_of(first, second, dark=arguments.dark or 0.0, noise=arguments.noise)
            told["contrast"] = _numbers(asdict(contrast))
    except InputError as error:
        raise gauging.located(error, arguments.images[0]) from error
    print(json_text(told) if arguments.json else "\n".join(_region_lines(told)) + "\n", end="")
    return 0


def _against(frames: list[Any], box: list[int]) -> Any:
    try:
        return measure_region(frames, Box(*box))
    except InputError as error:
        where = "against" if error.where == "region" else error.where
        raise InputError(error.what, where=where, remedy=error.remedy) from error


def _numbers(values: dict[str, Any]) -> dict[str, Any]:
    return {name: finite(value) if isinstance(value, float) else value for name, value in values.items()}


def _region_lines(told: dict[str, Any]) -> Iterator[str]:
    error = told["certified_rms_gray"]
    rendering = "" if error is None else f", rendering at most {error:.4g} rms"
    for name in ("region", "against"):
        if name in told:
            one = told[name]
            noise = "" if one["noise"] is None else f", noise of a pixel {one['noise']:.4g} +- {one['noise_sigma']:.2g}"
            yield (
                f"{name}: mean {one['mean']:.4f} +- {one['mean_sigma']:.4f} gray{rendering}; sd {one['sd']:.4f} +- "
                f"{one['sd_sigma']:.4f}{noise}; {one['low']:g} to {one['high']:g}, {one['pixels']} pixels"
            )
            if one["saturated"]:
                yield f"  warning: {one['saturated']} pixels are at full scale: mean and sd are too low"
    if "contrast" in told:
        contrast = told["contrast"]
        yield f"contrast (Michelson): {contrast['michelson']:.5f} +- {contrast['michelson_sigma']:.5f}"
        ratio = contrast["contrast_to_noise"]
        if ratio is None:
            yield "contrast-to-noise: none, as there is no noise"
        else:
            yield f"contrast-to-noise ({contrast['noise']}): {ratio:.3f} +- {contrast['contrast_to_noise_sigma']:.3f}"


def run_uniformity(arguments: argparse.Namespace) -> int:
    """Carry out ``measure uniformity``."""
    image = read_gray(arguments.image)
    try:
        found = measure_uniformity(
            image,
            response=Response(
                arguments.dark, 1.0 if arguments.gamma is None else arguments.gamma, arguments.saturation
            ),
            box=None if arguments.region is None else Box(*arguments.region),
            cells=arguments.cells,
        )
    except InputError as error:
        raise gauging.located(error, arguments.image) from error
    told = {
        "schema_version": SCHEMA_VERSION,
        "image": str(arguments.image),
        "certified_rms_gray": gauging.certified(arguments.image),
        **_numbers(asdict(found)),
    }
    if arguments.json:
        print(json_text(told), end="")
        return 0
    print(f"1 - sd/mean: {found.by_deviation:.5f} +- {found.by_deviation_sigma:.5f}")
    print(f"(max - min)/(max + min): {found.by_extremes:.5f} +- {found.by_extremes_sigma:.5f}")
    places = (f"({u:.1f}, {v:.1f})" for u, v in (found.brightest, found.darkest))
    print("brightest at {}, darkest at {} px; {} x {} cells".format(*places, *found.cells))
    return 0
