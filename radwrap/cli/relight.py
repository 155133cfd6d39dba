"""``radwrap relight``."""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from radwrap.cli import options as shared
from radwrap.errors import InputError, ToleranceNotMet
from radwrap.files import check_result, make_folder, sha256_of, sole_owner
from radwrap.images import PREVIEW_BITS, preview_codes, write_exr, write_png
from radwrap.imaging.output.assumed_values import Assumptions
from radwrap.imaging.output.run_manifest import RunManifest
from radwrap.imaging.raw_relighting import RawBasis
from radwrap.imaging.relight.levels import Levels, levels_of, read_levels
from radwrap.imaging.relight.relit import Basis
from radwrap.imaging.relighting import Shown, assumptions_of, basis_of, effects_of_levels, images_of, run_in
from radwrap.imaging.timed_basis import MovingBasis
from radwrap.manifest import SCHEMA_VERSION, json_text, plain, write_manifest

RESULT: Final = "relight.json"
SIGMAS: Final = "gray_sigma"  # a folder: no image's name can be that of another's file
PREVIEWS: Final = "preview"  # likewise
_DESCRIPTION = (
    "Makes images for any levels of the sources from the basis that radwrap render --basis wrote, without a ray. "
    "Writes NAME.png for each row of the table, or gray.png for --level; gray_sigma/NAME.exr, how far each gray level "
    "may be off; relight.json with each image's certified error; and preview/NAME.png for eyes of more than 8 bits, "
    "into DIR. Exposure time and the sensor's electronics may be others than those of the basis."
)


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = verbs.add_parser("relight", description=_DESCRIPTION)
    parser.add_argument("basis", metavar="BASIS_DIR", help="folder of a radwrap render --basis")
    parser.add_argument(
        "--levels",
        metavar="LEVELS.csv",
        help='table with the columns "name" and one for each source: the factor on its radiance in the scene',
    )
    parser.add_argument(
        "--level",
        metavar="NAME=FACTOR",
        action="append",
        default=[],
        help="one image, gray.png, with this factor on a source or on all LEDs of a ring; may be repeated, and what "
        "comes later replaces what came before (default 1 for each)",
    )
    parser.add_argument(
        "--set",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        dest="overrides",
        help='change the exposure time or a key of the sensor, such as --set camera.exposure_time="64 ms", with the '
        "error measured again; may be repeated",
    )
    shared.add_scene_folder(
        parser, "folder of the scene file; needed with --set where its camera names a data sheet or a calibration"
    )
    parser.add_argument("--out", metavar="DIR", required=True, help="folder for the images and relight.json")
    parser.add_argument("--exposure", action="store_true", help="also write radiant exposures, as NAME.exr [J/m^2]")
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the verb."""
    if arguments.levels and arguments.level:
        raise InputError("goes without --levels", where="--level", remedy="give one of the two")
    folder = Path(arguments.basis)
    changes = shared.changes_of(arguments.overrides)
    basis = basis_of(folder, changes, arguments.scene_folder)
    if arguments.levels:
        levels = read_levels(Path(arguments.levels), basis.sources, basis.dark)
    else:
        factors = levels_of(arguments.level, basis.sources, basis.dark)
        levels = Levels(("gray",), np.array([factors], dtype=np.float64))
    out = Path(arguments.out)
    basis_folder, real = (Path(os.path.realpath(folder)) for folder in (arguments.basis, out))  # links in a circle too
    if basis_folder in (real, *real.parents):
        raise InputError("is the folder of the basis, or lies in it", where="--out", remedy="choose another")
    make_folder(out)
    with sole_owner(out):
        run = _run_of(Path(arguments.basis), basis)
        assumed = assumptions_of(folder, basis, changes, arguments.scene_folder)
        result = _write(out, basis, levels, changes, run, assumed=assumed, with_exposure=arguments.exposure)
    failed = [name for name, image in result["images"].items() if not image["met"]]
    if arguments.json:
        print(json_text(result), end="")
    else:
        worst = max(image["error"]["rms_gray_upper95"] for image in result["images"].values())
        error = f"error in gray levels before rounding below {worst:.2g} rms (95 % for each)"
        print(f"{out}: {len(levels.names)} image{'s' if len(levels.names) > 1 else ''}; {error}")
        if run is not None and run.missing:
            print(f"left out of images and errors, in gray levels rms in the light of the basis: {run.missing}")
    if failed:
        more = f" and {len(failed) - 1} more" if len(failed) > 1 else ""
        raise ToleranceNotMet("the tolerance of the basis was not met", where=f"{failed[0]}{more}")
    return 0


def _run_of(folder: Path, basis: Basis | RawBasis | MovingBasis) -> RunManifest | None:
    """The manifest of the run that made a basis, where it still lies beside it: it tells what images lack."""
    run = run_in(folder)
    return run if run is not None and run.scene_sha256 == basis.scene_sha256 else None


def _write(
    out: Path,
    basis: Basis | RawBasis | MovingBasis,
    levels: Levels,
    changes: Mapping[str, Any],
    run: RunManifest | None,
    *,
    assumed: Assumptions | None,
    with_exposure: bool,
) -> dict[str, Any]:
    """Write all images, and what is told of them last."""
    check_result(out / RESULT)
    (out / RESULT).unlink(missing_ok=True)
    images: dict[str, Any] = {}
    for name, factors, shown in zip(levels.names, levels.factors, images_of(basis, levels.factors), strict=True):
        image = shown.image
        files = [f"{name}.png"]
        write_png(out / files[0], image.gray.codes)
        if image.gray.bit_depth > PREVIEW_BITS:
            files.append(f"{PREVIEWS}/{name}.png")
            make_folder(out / PREVIEWS)
            write_png(out / files[-1], preview_codes(image.gray))
        if with_exposure:
            files.append(f"{name}.exr")
            stored = image.radiant_exposure.values.astype(np.float32)
            write_exr(out / files[-1], stored, channel="radiant_exposure", metadata={"radwrap:unit": "J m^-2"})
        files.append(f"{SIGMAS}/{name}.exr")
        make_folder(out / SIGMAS)
        write_exr(out / files[-1], shown.uncertainty.sigma.astype(np.float32), channel="gray_sigma")
        images[name] = {
            "levels": dict(zip(basis.sources, factors.tolist(), strict=True)),
            **_summary(shown),
            "uncertainty": plain(shown.uncertainty.summary(), named=False),
            "met": shown.met,
            **_assumed(basis, assumed, factors, shown),
            "files": {file: sha256_of(out / file) for file in files},
        }
    result = {
        "schema_version": SCHEMA_VERSION,
        "scene_sha256": basis.scene_sha256,
        "tolerance": basis.tolerance,
        "max_error": basis.max_error,
        **({"changed": dict(changes)} if changes else {}),
        # As they are in the light and the camera of the basis; nothing tells how they change with each source.
        **({"left_out": {name: effect.as_manifest() for name, effect in run.left_out.items()}} if run else {}),
        "images": images,
    }
    write_manifest(out / RESULT, result)
    return result


def _assumed(
    basis: Basis | RawBasis | MovingBasis, told: Assumptions | None, factors: Any, shown: Shown
) -> dict[str, Any]:
    """What an image hangs on, as the manifest of a render has it."""
    if told is None or not isinstance(basis, Basis):
        return {}
    effects = effects_of_levels(basis, told, factors, shown)
    return {"assumed_effects": [plain(one, named=False) for one in effects]} if effects else {}


def _summary(shown: Shown) -> dict[str, Any]:
    gray = shown.image.gray.values
    colours = {colour: plain(one.certificate, named=False) for colour, one in shown.colours.items()}
    return {
        "gray": {"min": float(gray.min()), "max": float(gray.max()), "mean": float(gray.mean())},
        "saturated_fraction": shown.image.saturated_fraction,
        "error": plain(shown.image.certificate, named=False),
        **({"error_of_colours": colours} if colours else {}),
    }
