"""``radwrap render``."""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict
from typing import Any

from radwrap.cli import options as shared
from radwrap.errors import InputError
from radwrap.imaging.synthesis import RenderOptions, forecast, method_of, render
from radwrap.manifest import json_text
from radwrap.scene.scene import Scene

_DESCRIPTION = (
    "Predicts the gray image of a scene. Writes gray.png, radiant_exposure.exr and manifest.json into DIR; a killed "
    "run goes on where it was when it is started again."
)


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = verbs.add_parser("render", help="predict the gray image of a scene", description=_DESCRIPTION)
    shared.add_scene(parser)
    parser.add_argument("--out", metavar="DIR", help="folder for gray.png, radiant_exposure.exr and manifest.json")
    parser.add_argument(
        "--method",
        choices=("pinhole", "viewpoints"),
        help="infinitesimal pinhole, or finite pinhole by sub-viewpoints (default, unless the diameter is 0)",
    )
    parser.add_argument(
        "--viewpoints",
        metavar="N",
        type=int,
        help=f"sub-viewpoints (default {RenderOptions().viewpoints}); not with the method pinhole",
    )
    parser.add_argument(
        "--layout",
        choices=("rings", "hexagonal", "sunflower", "uneven"),
        default="rings",
        help="how sub-viewpoints lie (default rings)",
    )
    parser.add_argument(
        "--pixel-samples", metavar="K", type=int, default=1, help="K x K rays a pixel and sub-viewpoint (default 1)"
    )
    parser.add_argument(
        "--pixel-sampling",
        choices=("centre", "jitter"),
        default="centre",
        help="rays at the centres of the pixel's strata, or drawn inside them",
    )
    parser.add_argument("--seed", metavar="S", type=int, default=0, help="seed of all that is drawn (default 0)")
    parser.add_argument("--workers", metavar="W", type=int, help="tracer processes at a time (default: all cores)")
    parser.add_argument(
        "--keep-viewpoints",
        action="store_true",
        help="keep the images of the sub-viewpoints in DIR/viewpoints: not listed in manifest.json, and deleted by a "
        "later run into DIR that goes without this option",
    )
    parser.add_argument("--truth", action="store_true", help="write depth, parts and true positions too")
    parser.add_argument("--dry-run", action="store_true", help="only say what rays, memory and time it would take")
    parser.add_argument(
        "--max-pixels", metavar="N", type=float, default=64e6, help="largest sensor (default 64e6 pixels)"
    )
    shared.add_radiance(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the verb."""
    scene = shared.load(arguments)
    options = _options(arguments)
    if arguments.viewpoints is not None and method_of(scene, options) == "pinhole":
        reason = "with --method pinhole" if arguments.method else "as the pinhole's diameter is 0"
        raise InputError(f"there are no sub-viewpoints {reason}", where="--viewpoints", remedy="leave it out")
    if arguments.dry_run:
        return _dry_run(scene, options, as_json=arguments.json)
    if not arguments.out:
        raise InputError("is missing", where="--out", remedy="name a folder for the images")
    result = render(scene, arguments.out, options)
    manifest = result.manifest
    for warning in manifest["warnings"]:
        print(f"radwrap: warning: {warning}", file=sys.stderr)
    if arguments.json:
        print(json_text(manifest), end="")
        return 0
    gray, error = manifest["gray"], manifest["error"]
    off = "unknown" if error["rms_gray"] is None else f"{error['rms_gray']:.2g} rms, {error['max_gray']:.2g} at most"
    print(
        f"{arguments.out}/gray.png: gray {gray['min']:g} to {gray['max']:g}, mean {gray['mean']:.1f}; "
        f"{manifest['saturated_fraction']:.1%} saturated, {manifest['dark_fraction']:.1%} dark\n"
        f"error in gray levels: {off} ({error['note']})"
    )
    return 0


def _options(arguments: argparse.Namespace) -> RenderOptions:
    # NaN and infinity are no counts either.
    if not 1 <= arguments.max_pixels <= 1e12:
        raise InputError("must lie between 1 and 1e12", where="--max-pixels")
    return RenderOptions(
        method=arguments.method,
        viewpoints=RenderOptions().viewpoints if arguments.viewpoints is None else arguments.viewpoints,
        layout=arguments.layout,
        pixel_samples=arguments.pixel_samples,
        pixel_sampling=arguments.pixel_sampling,
        seed=arguments.seed,
        workers=arguments.workers,
        keep_viewpoints=arguments.keep_viewpoints,
        truth=arguments.truth,
        trust=arguments.trust,
        radiance=arguments.radiance,
        max_pixels=int(arguments.max_pixels),
        tracer_timeout=shared.timeout(arguments),
        progress=True,
    )


def _dry_run(scene: Scene, options: RenderOptions, *, as_json: bool) -> int:
    cost = forecast(scene, options)
    if as_json:
        figures = asdict(cost)
        print(
            json_text(
                {
                    "rays": figures["rays"],
                    "memory_bytes": figures["memory_bytes"],
                    "timing": {"wall_s": figures["seconds"]},
                }
            ),
            end="",
        )
    else:
        print(cost)
    return 0
