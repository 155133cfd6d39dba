"""``radwrap measure region`` and ``measure uniformity``: gray levels of areas."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import asdict, astuple
from pathlib import Path
from typing import Any

from radwrap.cli import gauging, raw_mosaic
from radwrap.cli import options as shared
from radwrap.cli.gauging import two_digits, with_sigma
from radwrap.errors import InputError
from radwrap.images import GrayImage
from radwrap.manifest import SCHEMA_VERSION, finite, json_text
from radwrap.measure.gauges import Box, Contrast, contrast_of, measure_region, measure_uniformity
from radwrap.measure.gauges.uniformity import CELLS
from radwrap.scene.file.load import load_scene
from radwrap.scene.scene import Scene
from radwrap.study.placed_calipers import region_of


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add both verbs."""
    region = verbs.add_parser(
        "region",
        help="mean, spread, contrast and contrast-to-noise of regions",
        description="Mean and spread of gray levels in a rectangle, and what sets it apart from another one. Several "
        "frames of the same scene separate temporal noise from structure.",
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
    _add_scene(region)
    region.add_argument(
        "--against-truth", metavar="TARGET", help="hold it against the largest rectangle that shows only this target"
    )
    region.add_argument(
        "--dark",
        metavar="G",
        type=shared.GRAY_LEVEL,
        help="gray level without light (default that of --scene, else 0)",
    )
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
    _add_scene(even)
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


def _add_scene(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--scene", metavar="SCENE.toml", help="scene that the image was rendered from")
    shared.add_changes(parser)
    parser.add_argument(
        "--truth", metavar="TARGET", help="measure the largest rectangle of pixels that shows only this target"
    )


def _scene(arguments: argparse.Namespace, image: GrayImage, path: Path) -> Scene | None:
    """The scene that --scene names, whose sensor must have the image's size."""
    changes = shared.overrides_of(arguments)
    if arguments.scene is None:
        named = [name for name in ("truth", "against_truth") if getattr(arguments, name, None) is not None]
        if named or changes:
            raise InputError("needs a scene", where=(*named, "set")[0], remedy="give --scene")
        return None
    scene = load_scene(arguments.scene, changes)
    gauging.check_size(scene, image, path)
    return scene


def _box_of(arguments: argparse.Namespace, scene: Scene | None, box: str, truth: str) -> list[int] | None:
    """The pixels that one option gives, or those of the target that the other one names."""
    given, name = getattr(arguments, box), getattr(arguments, truth)
    if name is None or scene is None:
        return None if given is None else list(given)
    if given is not None:
        raise InputError(f"is given beside `{truth}`", where=box, remedy="leave one of them out")
    try:
        return list(astuple(region_of(scene, name)))
    except InputError as error:
        raise InputError(error.what, where=truth, remedy=error.remedy) from error


def run_region(arguments: argparse.Namespace) -> int:
    """Carry out ``measure region``."""
    frames = [raw_mosaic.one_colour(path) for path in arguments.images]
    rows, columns = frames[0].values.shape
    scene = _scene(arguments, frames[0], arguments.images[0])
    dark = arguments.dark
    if dark is None:
        dark = 0.0 if scene is None else scene.camera.sensor.dark_gray
    box = _box_of(arguments, scene, "region", "truth")
    against = _box_of(arguments, scene, "against", "against_truth")
    told: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "images": list(map(str, arguments.images)),
        "dark": dark,
        "certified_rms_gray": gauging.certified(arguments.images[0]),
    }
    whole = [0, 0, columns - 1, rows - 1]
    saturation = None if scene is None else scene.camera.sensor.saturation_gray
    try:
        first = measure_region(frames, Box(*(box or whole)), saturation=saturation)
        told["region"] = _numbers(asdict(first)) | {"box": box or whole}
        if against is not None:
            second = _against(frames, against, saturation)
            told["against"] = _numbers(asdict(second)) | {"box": against}
            contrast = contrast_of(first, second, dark=dark, noise=arguments.noise)
            told["contrast"] = _contrast(contrast, told["certified_rms_gray"])
    except InputError as error:
        raise gauging.located(error, arguments.images[0]) from error
    print(json_text(told) if arguments.json else "\n".join(_region_lines(told)) + "\n", end="")
    return 0


def _contrast(contrast: Contrast, error: float | None) -> dict[str, Any]:
    """Its numbers, and what errors of the certified rms at each pixel would change."""
    numbers = _numbers(asdict(contrast))
    for name in ("michelson", "contrast_to_noise"):
        by = numbers.pop(f"{name}_by_rendering")
        numbers[f"{name}_rendering"] = None if error is None or by is None else finite(by * error)
    return numbers


def _against(frames: list[Any], box: list[int], saturation: float | None) -> Any:
    try:
        return measure_region(frames, Box(*box), saturation=saturation)
    except InputError as error:
        where = "against" if error.where == "region" else error.where
        raise InputError(error.what, where=where, remedy=error.remedy) from error


def _numbers(values: dict[str, Any]) -> dict[str, Any]:
    return {name: finite(value) if isinstance(value, float) else value for name, value in values.items()}


def _region_lines(told: dict[str, Any]) -> Iterator[str]:
    error = told["certified_rms_gray"]
    rendering = "" if error is None else f", rendering about {error:.4g} rms"
    for name in ("region", "against"):
        if name in told:
            one = told[name]
            noise = "" if one["noise"] is None else f", noise of a pixel {one['noise']:.4g} +- {one['noise_sigma']:.2g}"
            yield (
                f"{name}: mean {with_sigma(one['mean'], one['mean_sigma'])} gray{rendering}; sd "
                f"{with_sigma(one['sd'], one['sd_sigma'])}{noise}; {one['low']:g} to {one['high']:g}, "
                f"{one['pixels']} pixels"
            )
            if one["saturated"]:
                yield f"  warning: {one['saturated']} pixels are saturated: mean and sd are too low"
    if "contrast" in told:
        contrast = told["contrast"]
        told_contrast = with_sigma(contrast["michelson"], contrast["michelson_sigma"], 5)
        yield f"contrast (Michelson): {told_contrast}{_rendering(contrast['michelson_rendering'], 5)}"
        ratio = contrast["contrast_to_noise"]
        if ratio is None:
            yield "contrast-to-noise: none, as there is no noise"
        else:
            told_ratio = with_sigma(ratio, contrast["contrast_to_noise_sigma"], 3)
            by = _rendering(contrast["contrast_to_noise_rendering"], 3)
            yield f"contrast-to-noise ({contrast['noise']}): {told_ratio}{by}"


def _rendering(by: float | None, least: int) -> str:
    return "" if by is None else f", rendering about {two_digits(by, least)}"


def run_uniformity(arguments: argparse.Namespace) -> int:
    """Carry out ``measure uniformity``."""
    image = raw_mosaic.one_colour(arguments.image)
    scene = _scene(arguments, image, arguments.image)
    box = _box_of(arguments, scene, "region", "truth")
    try:
        found = measure_uniformity(
            image,
            response=gauging.response(arguments, scene),
            box=None if box is None else Box(*box),
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
    print(f"1 - sd/mean: {with_sigma(found.by_deviation, found.by_deviation_sigma, 5)}")
    print(f"(max - min)/(max + min): {with_sigma(found.by_extremes, found.by_extremes_sigma, 5)}")
    places = (f"({u:.1f}, {v:.1f})" for u, v in (found.brightest, found.darkest))
    print("brightest at {}, darkest at {} px; {} x {} cells".format(*places, *found.cells))
    return 0
