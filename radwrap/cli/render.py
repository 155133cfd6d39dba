"""``radwrap render``."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from radwrap.cli import options as shared
from radwrap.errors import InputError, ToleranceNotMet
from radwrap.extras import require
from radwrap.imaging.forecast.cost import Cost, duration
from radwrap.imaging.forecast.photo_realistic import check_drawable, write_beside
from radwrap.imaging.forecasting import forecast
from radwrap.imaging.in_time.planning import Planned, planned
from radwrap.imaging.mosaicked import plane_of, refuse_for_mosaic, rendered_colours
from radwrap.imaging.output.colour_picture import write_colour
from radwrap.imaging.output.run_manifest import RunManifest
from radwrap.imaging.render_options import METHODS, RenderOptions
from radwrap.imaging.synthesis import render
from radwrap.manifest import json_text, plain
from radwrap.scene.colour_planes import refuse_mosaic
from radwrap.scene.instants import refuse_time
from radwrap.scene.look.checks import warnings_of
from radwrap.scene.scene import Scene
from radwrap.scene.sources import WideSource

# Of an image's error, what no rays make smaller is named from such a share on: squares add, so that it is half of it.
_MOST_OF_IT = 0.7
_DESCRIPTION = (
    "Predicts the gray image of a scene. Writes gray.png, radiant_exposure.exr and manifest.json into DIR; a killed "
    "run continues where it stopped when it is started again."
)


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = verbs.add_parser("render", description=_DESCRIPTION)
    shared.add_scene(parser)
    parser.add_argument("--out", metavar="DIR", help="folder for gray.png, radiant_exposure.exr and manifest.json")
    parser.add_argument(
        "--method",
        choices=METHODS,
        help="infinitesimal pinhole; finite pinhole by sub-viewpoints, as in the paper; by one image gathered with the "
        "opening's shape; by rays over pixel and opening; by one image that rays correct where it errs (default: the "
        "cheapest of the last three)",
    )
    shared.add_tolerance(parser, "largest rms error")
    parser.add_argument(
        "--max-error", metavar="G", type=shared.number(), help="largest error of 99 %% of the pixels, likewise"
    )
    parser.add_argument(
        "--budget", metavar="B", help='what a tolerance may cost: rays, "1e7", or time, "30 s" (then not reproducible)'
    )
    parser.add_argument("--viewpoints", metavar="N", type=shared.whole(), help="sub-viewpoints (default 37)")
    parser.add_argument(
        "--layout",
        choices=("rings", "hexagonal", "sunflower", "uneven"),
        default="rings",
        help="arrangement of the sub-viewpoints (default rings)",
    )
    parser.add_argument(
        "--pixel-samples",
        metavar="K",
        type=shared.whole(),
        default=1,
        help="K x K rays a pixel and sub-viewpoint (default 1)",
    )
    parser.add_argument(
        "--pixel-sampling",
        choices=("centre", "jitter"),
        default="centre",
        help="rays at the centres of the pixel's strata, or drawn inside them",
    )
    parser.add_argument(
        "--seed", metavar="S", type=shared.whole(), default=0, help="seed of all random draws (default 0)"
    )
    parser.add_argument(
        "--workers", metavar="W", type=shared.whole(), help="number of tracer processes (default: all cores)"
    )
    parser.add_argument(
        "--keep-viewpoints",
        action="store_true",
        help="keep the images of the sub-viewpoints in DIR/viewpoints: not listed in manifest.json, and deleted by a "
        "later run into DIR without this option",
    )
    parser.add_argument("--truth", action="store_true", help="also write depth, parts and true positions")
    parser.add_argument(
        "--basis",
        action="store_true",
        help="also write an image for each source; radwrap relight makes any levels from them",
    )
    parser.add_argument(
        "--frames",
        metavar="N",
        type=shared.whole(),
        default=0,
        help="write N frames with the noise of a linear camera too: frame_0000.png and so on",
    )
    parser.add_argument(
        "--bounces",
        metavar="N",
        default="0",
        help="how often light may go from surface to surface before it is seen: a number, all, or auto: all where it "
        "matters at this tolerance (default 0)",
    )
    parser.add_argument(
        "--photo-realistic",
        metavar="LIGHT",
        nargs="?",
        const="parallel",
        choices=("parallel", "point"),
        help="draw the scene the other way of Fig. 3 too (Lambert and Phong, one parallel or point light, no shadows, "
        "no sensor), and put both side by side with their difference",
    )
    parser.add_argument(
        "--demosaic",
        action="store_true",
        help="write colour.png too: the raw image of a colour camera, demosaiced by OpenCV",
    )
    parser.add_argument("--dry-run", action="store_true", help="only show what rays, memory and time it would take")
    parser.add_argument(
        "--max-pixels", metavar="N", type=shared.number(), default=64e6, help="largest sensor (default 64e6 pixels)"
    )
    shared.add_tracer(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the verb."""
    scene = shared.load(arguments)
    options = _options(arguments)
    if arguments.dry_run:
        return _dry_run(scene, options, as_json=arguments.json)
    mosaic = scene.camera.sensor.mosaic
    if arguments.demosaic:
        if mosaic is None:
            raise InputError("needs a colour camera, and all pixels of the scene's have one filter", where="--demosaic")
        require("measure", "--demosaic")
    if arguments.photo_realistic:
        refuse_mosaic(scene, "--photo-realistic")
        refuse_time(scene, "--photo-realistic")
        check_drawable(scene)
    # What no ray is needed for is said before the first; how wide lights shine is known once a tracer is chosen.
    early = warnings_of(scene, {source.name for source in scene.sources if isinstance(source, WideSource)})
    _warn(early)
    result = render(scene, shared.out_folder(arguments, "images"), options)
    told: Mapping[str, Any] = result.manifest
    _warn(warning for warning in result.run.warnings if warning not in early)
    if arguments.demosaic and mosaic is not None:
        write_colour(Path(arguments.out), result.gray.codes, mosaic.pattern)
    drawn = None
    if arguments.photo_realistic:
        drawn = write_beside(
            scene, Path(arguments.out), result.gray.codes, arguments.photo_realistic, result.run.run_sha256
        )
        told = {**told, "photo_realistic": drawn}
    if arguments.json:
        print(json_text(told), end="")
    else:
        _summarise(arguments, result.run, drawn)
    if missing := result.run.missing:
        sys.stdout.flush()
        bound = f"below {result.error.rms_gray_upper95:.2g} gray rms (95 %)"
        print(f"radwrap: the error, {bound}, does not include what is left out: {missing} gray rms", file=sys.stderr)
    if not result.run.met:
        raise ToleranceNotMet(f"the tolerance was not met; this is the best image that was found{_why(result.run)}")
    return 0


def _why(made: RunManifest) -> str:
    """What keeps an image from its tolerance though more rays were taken, where that is the most of it."""
    lasting = None if made.diffraction is None else made.diffraction.lasting_gray
    asked = made.tolerance
    of_rms = asked is not None and made.error.rms_gray_upper95 > asked
    if lasting is None or not of_rms or lasting < _MOST_OF_IT * made.error.rms_gray_upper95:
        return ""
    return (
        f": {lasting:.2g} gray of its error is not known of diffraction (light behind near edges, from far away, "
        "or of a lens that differs over the field), and no more rays make that smaller"
    )


def _warn(warnings: Iterable[str]) -> None:
    for warning in warnings:
        print(f"radwrap: warning: {warning}", file=sys.stderr, flush=True)


def _summarise(arguments: argparse.Namespace, made: RunManifest, drawn: Mapping[str, Any] | None) -> None:
    gray, error = made.gray, made.error
    print(
        f"{arguments.out}/gray.png: gray {gray.min:g} to {gray.max:g}, mean {gray.mean:.1f}; "
        f"{made.saturated_fraction:.1%} saturated, {made.dark_fraction:.1%} dark\n"
        f"error in gray levels before rounding: {error.rms_gray:.2g} rms (pixels at rims: far more), below "
        f"{error.rms_gray_upper95:.2g} (95 %), by {error.method}{_beside(made)}; method {made.method}, "
        f"{made.rays:.3g} rays"
    )
    if made.in_time is not None:
        instants = "one instant" if made.in_time.instants == 1 else f"{made.in_time.instants} instants"
        print(
            f"motion, strobes and shutter: {instants}; all at once and at rest the image would differ by "
            f"{made.in_time.about_rms_gray:.2g} gray rms"
        )
    if made.mosaic is not None:
        colours = made.mosaic.colours.items()
        told = ", ".join(f"{colour} below {plane.error.rms_gray_upper95:.2g}" for colour, plane in colours)
        print(f"raw mosaic {made.mosaic.pattern}: {told}")
    if drawn is not None:
        apart = drawn["gray_difference"]
        print(
            f"{arguments.out}/comparison.png: drawn with a {arguments.photo_realistic} light, {apart['rms']:.1f} gray "
            f"rms from the predicted image (at most {apart['largest']:.0f})"
        )


def _beside(made: RunManifest) -> str:
    """Whether the image has diffraction, and what the certified error does not hold, where it matters."""
    taken = made.diffraction
    waves = "" if taken is None else f"; with diffraction at {taken.wavelength * 1e9:.4g} nm"
    return f"{waves}; left out: {made.missing} gray rms" if made.missing else waves


def _options(arguments: argparse.Namespace) -> RenderOptions:
    # NaN and infinity are no counts either.
    if not 1 <= arguments.max_pixels <= 1e12:
        raise InputError("must lie between 1 and 1e12", where="--max-pixels")
    options = RenderOptions(
        method=arguments.method,
        tolerance=arguments.tolerance,
        max_error=arguments.max_error,
        **_budget(arguments.budget),
        viewpoints=arguments.viewpoints,
        layout=arguments.layout,
        pixel_samples=arguments.pixel_samples,
        pixel_sampling=arguments.pixel_sampling,
        seed=arguments.seed,
        workers=arguments.workers,
        keep_viewpoints=arguments.keep_viewpoints,
        truth=arguments.truth,
        bounces=_bounces(arguments.bounces),
        basis=arguments.basis,
        frames=arguments.frames,
        max_pixels=int(arguments.max_pixels),
        **shared.tracer_options(arguments),
        progress=True,
    )
    if arguments.tolerance is not None and options.fixed_method is not None:
        raise InputError(
            f"{options.fixed_method} has a fixed number of rays and keeps no tolerance",
            where="--tolerance",
            remedy="leave it out, or leave out the method and its options",
        )
    return options


def _bounces(text: str) -> Any:
    """A number, or a word that `RenderOptions` knows."""
    return int(text) if text.isdecimal() and len(text) < 10 else text


def _budget(text: str | None) -> dict[str, Any]:
    """Rays, or seconds where a unit says so."""
    if text is None:
        return {}
    if " " in text.strip():
        return {"budget_seconds": shared.time_of(text, "--budget")}
    try:
        return {"budget_rays": float(text)}
    except ValueError as error:
        raise InputError(
            f'"{text}" is not a number', where="--budget", remedy='write "1e7" for rays or "30 s"'
        ) from error


def _dry_run(scene: Scene, options: RenderOptions, *, as_json: bool) -> int:
    if scene.camera.sensor.mosaic is not None:
        return _dry_run_of_colours(scene, options, as_json=as_json)
    plan = planned(scene, options)
    # All that this process has done so far, of which nearly all is to load libraries and the scene.
    cost = forecast(plan.still, plan.options, started=time.process_time())
    if as_json:
        print(json_text(_as_json(cost, plan)), end="")
        return 0
    print(cost)
    print(", ".join(f"{part} {duration(seconds)}" for part, seconds in cost.parts.items()))
    for one in cost.cheaper:
        print(one)
    if plan.instants:
        print(_besides(plan))
    return 0


def _as_json(cost: Cost, plan: Planned) -> dict[str, Any]:
    timing = plain(cost.foretold, named=False)
    more = {"instants": plan.instants} if plan.instants else {}
    return {"rays": cost.rays, "memory_bytes": cost.memory_bytes, **more, "timing": timing}


def _besides(plan: Planned) -> str:
    return (
        f"that is the middle of the exposure; {plan.instants} more instants at least, each of some rows and to a "
        "larger error, so that each takes about as long or less"
    )


def _dry_run_of_colours(scene: Scene, options: RenderOptions, *, as_json: bool) -> int:
    """What each plane of a mosaic costs that is rendered; pixels that saturate may need more planes."""
    refuse_for_mosaic(scene, options)
    single = replace(options, frames=0)
    plans = {colour: planned(plane_of(scene, colour), single) for colour in rendered_colours(scene, options)}
    costs = {colour: forecast(plan.still, plan.options) for colour, plan in plans.items()}
    if as_json:
        told = {colour: _as_json(cost, plans[colour]) for colour, cost in costs.items()}
        print(json_text({"rays": sum(cost.rays for cost in costs.values()), "colours": told}), end="")
        return 0
    for colour, cost in costs.items():
        print(f"{colour}: {cost}")
        if plans[colour].instants:
            print(_besides(plans[colour]))
    return 0
