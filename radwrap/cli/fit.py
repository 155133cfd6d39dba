"""``radwrap fit``."""

from __future__ import annotations

import argparse
from typing import Any

from radwrap.cli import options as shared
from radwrap.errors import CheckFailed, InputError, ToleranceNotMet
from radwrap.fitting.fit import fit
from radwrap.fitting.series import read_series
from radwrap.imaging.render_options import RenderOptions
from radwrap.manifest import json_text

_DESCRIPTION = (
    "Finds values of scene keys for which the prediction agrees with captured images, how sure they are, and whether "
    "the scene then explains the captures within noise and the error of the prediction. Numbers of the scene file "
    "and poses can be free. Writes fit.json, scene.toml with the values, residual.png, "
    "residual.exr and index.html into DIR. Exit code 1: the scene does not explain the captures, or nothing is left to "
    "judge by; 3: no convergence."
)


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = verbs.add_parser("fit", description=_DESCRIPTION)
    parser.add_argument("scene", metavar="SCENE.toml", help="scene file where the fit begins")
    parser.add_argument("captures", metavar="CAPTURE.png", nargs="*", help="captured image; several are repeats")
    parser.add_argument(
        "--captures",
        dest="series",
        metavar="CAPTURES.toml",
        help="file of captures of the bench in several states, each with its own values of some keys; in place "
        "of CAPTURE",
    )
    parser.add_argument(
        "--free",
        metavar="KEY[=LOW:HIGH]",
        action="append",
        default=[],
        help='key of the scene whose value is sought, such as --free "camera.exposure_time=1 ms:4 ms"; [*] frees every '
        "entry of a list by itself; may be repeated",
    )
    shared.add_changes(parser)
    parser.add_argument("--out", metavar="DIR", help="folder for the results")
    shared.add_tolerance(parser, "rms error of the prediction")
    parser.add_argument(
        "--noise",
        metavar="SIGMA",
        type=shared.number(0),
        help="standard deviation of one capture, before rounding [gray level] (default: that of the linear sensor, or "
        "the scatter of repeats)",
    )
    parser.add_argument(
        "--mask", metavar="MASK.png", help="picture that marks the pixels to use: those that are not black"
    )
    parser.add_argument("--robust", action="store_true", help="give less weight to single pixels that are far off")
    parser.add_argument(
        "--seed", metavar="S", type=shared.whole(), default=0, help="seed of all random draws (default 0)"
    )
    parser.add_argument(
        "--workers", metavar="W", type=shared.whole(), help="number of tracer processes (default: all cores)"
    )
    shared.add_tracer(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the verb."""
    out = shared.out_folder(arguments, "results")
    options = RenderOptions(
        tolerance=arguments.tolerance,
        seed=arguments.seed,
        workers=arguments.workers,
        **shared.tracer_options(arguments),
        progress=True,
    )
    if bool(arguments.captures) == bool(arguments.series):
        raise InputError("is missing, or there are both", where="CAPTURE", remedy="name images, or --captures FILE")
    found = fit(
        arguments.scene,
        read_series(arguments.series) if arguments.series else arguments.captures,
        arguments.free,
        out,
        options,
        changes=shared.overrides_of(arguments),
        noise=arguments.noise,
        mask=arguments.mask,
        robust=arguments.robust,
    )
    print(json_text(found.manifest) if arguments.json else "\n".join(found.lines()) + "\n", end="")
    if not found.converged:
        return ToleranceNotMet.exit_code
    return 0 if found.explained else CheckFailed.exit_code
