"""``radwrap crosscheck``: the same scene by Radiance and by POV-Ray."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from radwrap.cli import options as shared
from radwrap.errors import CheckFailed
from radwrap.imaging.render_options import RenderOptions
from radwrap.manifest import json_text
from radwrap.scene.scene import Scene
from radwrap.study.crosscheck import CrosscheckOptions, crosscheck
from radwrap.study.crosscheck_colours import colours_as_json, crosscheck_colours, write_colours
from radwrap.study.crosscheck_report import as_json, write_crosscheck

_DESCRIPTION = (
    "Traces a scene by Radiance and by POV-Ray 3.7, merges and exposes both by the same code, and compares them pixel "
    "by pixel. Writes crosscheck.json and crosscheck.png into DIR; a killed run continues where it stopped."
)


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = verbs.add_parser("crosscheck", description=_DESCRIPTION)
    shared.add_scene(parser)
    parser.add_argument("--out", metavar="DIR", help="folder for crosscheck.json and crosscheck.png")
    parser.add_argument(
        "--viewpoints", metavar="N", type=shared.whole(), help="sub-viewpoints of a finite pinhole (default 37)"
    )
    parser.add_argument(
        "--pixel-samples",
        metavar="K",
        type=shared.whole(),
        default=2,
        help="K x K rays a pixel and sub-viewpoint (default 2)",
    )
    parser.add_argument(
        "--area-samples",
        metavar="N",
        type=shared.whole(),
        default=0,
        help="let POV-Ray's sources shine from N x N points of their discs (default 0: from their centres)",
    )
    parser.add_argument(
        "--tolerance",
        metavar="T",
        type=shared.number(),
        default=0.005,
        help="largest relative rms difference (default 0.005)",
    )
    parser.add_argument("--povray", metavar="PROGRAM", help="another povray program")
    parser.add_argument(
        "--workers", metavar="W", type=shared.whole(), help="Radiance processes at a time (default: all cores)"
    )
    shared.add_radiance(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the verb; exit code 1 where the two differ and no closed form says why."""
    scene = shared.load(arguments)
    out = shared.out_folder(arguments, "result")
    options = CrosscheckOptions(
        RenderOptions(
            tracer="radiance",  # which is what is checked
            viewpoints=arguments.viewpoints,
            pixel_samples=arguments.pixel_samples,
            workers=arguments.workers,
            **shared.tracer_options(arguments),
            progress=True,
        ),
        arguments.area_samples,
        arguments.tolerance,
        arguments.povray,
    )
    if scene.camera.sensor.mosaic is not None:
        return _colours(scene, out, options, as_text=not arguments.json)
    result = crosscheck(scene, out, options)
    write_crosscheck(result, out)
    found = as_json(result)
    print(json_text(found) if arguments.json else "\n".join(_lines(found)) + "\n", end="")
    return 0 if found["agrees"] else CheckFailed.exit_code


def _colours(scene: Scene, out: Path, options: CrosscheckOptions, *, as_text: bool) -> int:
    """The same of a colour camera, colour by colour."""
    found = colours_as_json(scene, crosscheck_colours(scene, out, options))
    write_colours(found, out)
    if as_text:
        for colour, one in found["colours"].items():
            print("\n".join([f"{colour} pixels of the raw mosaic {found['mosaic']}", *_lines(one)]))
    else:
        print(json_text(found), end="")
    return 0 if found["agrees"] else CheckFailed.exit_code


def _lines(found: Mapping[str, Any]) -> Iterator[str]:
    heads = f"{'rms':>10} {'median':>10} {'max':>10} {'beyond':>8} {'rms/peak':>10} {'gray rms':>9}"
    yield f"{'term':10} {'pixels':>7} {heads}"
    for name, term in (("all", {**found["radiance"], "gray": found["gray"]}), *found["terms"].items()):
        shares = [_percent(term[f"relative_{key}"], 10) for key in ("rms", "median", "maximum")]
        yield (
            f"{name:10} {term['pixels']:7} {' '.join(shares)} {_percent(term['beyond_tolerance'], 8)} "
            f"{_percent(term['rms_of_peak'], 10)} {term['gray']['rms']:9.4f}  {term.get('verdict', '')}"
        )
    for reason, numbers in found["explained"].items():
        yield (
            f"{reason}: closed forms expect {numbers['expected_rms']:.3g} rms, measured {numbers['measured_rms']:.3g}, "
            f"{numbers['left_rms']:.2g} left; right is {numbers['who_is_right']}"
        )
    for beam in found["replaced_beams"]:
        yield (
            f'"{beam["source"]}": Gaussian beam replaced in both by cos^{beam["cosine_power"]:.4g}, '
            f"which differs by up to {beam['largest_difference_of_peak']:.2g} of its peak"
        )
    yield from (found[name] for name in ("diffraction", "in_time") if name in found)
    yield f"they {'agree' if found['agrees'] else 'DIFFER'} within {found['tolerance']:.2%} or as closed forms say"


def _percent(value: float | None, width: int) -> str:
    return f"{'-':>{width}}" if value is None else f"{100 * value:{width - 2}.4f} %"
