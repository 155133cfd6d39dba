"""``radwrap catalog effects``: how an image, and what is measured in it, changes with values that nobody published."""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import math
import shlex
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from radwrap.cli import options as shared
from radwrap.errors import InputError
from radwrap.manifest import SCHEMA_VERSION, finite, json_text, plain

_IMAGE: Final = "gray.png"
_SHOWN: Final = 1e-6  # change of a number, over the larger of itself and 1, that is shown
_READINGS: Final = "_readings"  # behind the name of a number: what it may be where it is not known
_AT: Final = ("as rendered", "at the low end", "at the high end")
# What of a measurement is no result: settings, and counts of what was looked at.
_NO_RESULTS: Final = ("schema_version", "image", "covariance", "strip")


def add_to(kinds: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = kinds.add_parser(
        "effects",
        help="how an image, and a measurement in it, changes over the range of each assumed value",
        description="Reads what a render left in DIR and computes its image anew with each assumed value at both ends "
        "of its range, through the sensor model and without a ray. With --measure each of these images is measured.",
    )
    parser.add_argument("render", metavar="DIR", type=Path, help="folder of a render")
    parser.add_argument(
        "--measure",
        metavar="WORDS",
        help='what to measure, as words of `radwrap measure` without the image, such as "edge --dark 22"',
    )
    shared.add_scene_folder(parser, "where files lie that the scene names")
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the verb."""
    from radwrap.images import write_png
    from radwrap.imaging.output.assumed_values import assumed_ends, effects_of
    from radwrap.imaging.output.image_files import read_exposure
    from radwrap.imaging.output.run_manifest import read_run_manifest
    from radwrap.imaging.relight.basis_files import FOLDER
    from radwrap.imaging.relight.relit import Basis
    from radwrap.imaging.relighting import assumptions_of_run, basis_of, lights_of_levels
    from radwrap.imaging.response.sensor import gray_levels, image_of_levels

    folder: Path = arguments.render
    known = read_run_manifest(folder)
    for part, what in ((known.mosaic, "a raw mosaic"), (known.in_time, "of several instants")):
        if part is not None:
            raise InputError(f"is {what}, of which only the render's manifest says what it hangs on", where=str(folder))
    told = assumptions_of_run(known, arguments.scene_folder or folder)
    exposure = read_exposure(folder)
    basis = basis_of(folder) if (folder / FOLDER).is_dir() else None
    lights = lights_of_levels(basis, told) if isinstance(basis, Basis) else {}
    effects = [plain(one, named=False) for one in effects_of(told, exposure.values, lights)]
    if arguments.measure is not None:
        words = _words(arguments.measure)
        with tempfile.TemporaryDirectory() as place:
            image = Path(place) / _IMAGE

            def measured(light: Any, sensor: Any) -> dict[str, float]:
                seen = image_of_levels(gray_levels(light, sensor), sensor, exposure.provenance)
                write_png(image, seen.codes)
                try:
                    return dict(_numbers(_measured(words, image)))
                except InputError as error:
                    of, own = f"image of {folder}", str(image)
                    what, where = error.what.replace(own, of), error.where.replace(own, of)
                    remedy, _, _ = error.remedy.partition(f"; see {image.parent}")  # which is gone by then
                    raise InputError(what, where=where, remedy=remedy.replace(own, of)) from error

            before = measured(exposure.values, told.sensor)
            for effect, (_, ends) in zip(effects, assumed_ends(told, exposure.values, lights), strict=True):
                effect["measured"] = _changes(before, *(_or_why(measured, end.light, end.sensor) for end in ends))
    # How several sources share the light was known while the image was rendered, and is in no file but a basis.
    seen = {effect["key"] for effect in effects}
    effects += [plain(one, named=False) for one in known.assumed_effects or () if one.key not in seen]
    if arguments.json:
        print(json_text({"schema_version": SCHEMA_VERSION, "assumed_effects": effects}), end="")
    else:
        print(
            "\n".join(_lines(effects, measure=arguments.measure is not None))
            or "no value that the scene takes is assumed with a range"
        )
    return 0


def _words(text: str) -> list[str]:
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise InputError(f"{error}", where="--measure", remedy='such as "edge --dark 22"') from error
    if not words or words[0].startswith("-"):
        raise InputError("names nothing to measure", where="--measure", remedy='such as "edge --dark 22"')
    return words


def _measured(words: list[str], image: Path) -> Any:
    """What `radwrap measure` says of an image."""
    from radwrap.cli import measure

    parser = argparse.ArgumentParser(prog="--measure", exit_on_error=False)
    measure.add_to(parser.add_subparsers(required=True))
    heard = io.StringIO()
    try:
        with contextlib.redirect_stderr(heard):
            parsed = parser.parse_args(["measure", words[0], str(image), *words[1:], "--json"])
    except (argparse.ArgumentError, SystemExit) as error:
        said = str(error) if isinstance(error, argparse.ArgumentError) else heard.getvalue().strip()
        raise InputError(said.rpartition("error: ")[2], where="--measure", remedy="see `radwrap measure`") from error
    if getattr(parsed, "overlay", "") is None:
        # A picture that nobody asked for, such as of dots where some are missing, goes as the image does.
        parsed.overlay = str(image.with_suffix(".overlay.png"))
    written = io.StringIO()
    with contextlib.redirect_stdout(written):
        parsed.run(parsed)
    return json.loads(written.getvalue())


def _or_why(measured: Any, light: Any, sensor: Any) -> dict[str, float] | str:
    try:
        found: dict[str, float] = measured(light, sensor)
    except InputError as error:
        return error.what
    return found


def _numbers(value: Any, key: str = "") -> Iterator[tuple[str, float]]:
    """Key and value of each number of a measurement; NaN of one that is not known, and has readings in its place."""
    if isinstance(value, Mapping):
        for name, item in value.items():
            if item is None and f"{name}{_READINGS}" in value:
                yield f"{key}.{name}" if key else str(name), math.nan
            elif key or name not in _NO_RESULTS:
                yield from _numbers(item, f"{key}.{name}" if key else str(name))
    elif isinstance(value, list):
        for number, item in enumerate(value):
            yield from _numbers(item, f"{key}[{number}]")
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield key, float(value)


def _changes(before: Mapping[str, float], low: Any, high: Any) -> dict[str, Any]:
    """Of each number that changes its value, and the change at both ends; null where it cannot be measured.

    A number that is not known is there too, with `not_known`: where it is not.
    """
    found: dict[str, Any] = {"cannot": [one for one in (low, high) if isinstance(one, str)]}
    if not found["cannot"]:
        del found["cannot"]
    for key, value in before.items():
        ends = [None if isinstance(one, str) or key not in one else one[key] - value for one in (low, high)]
        unknown = [at for at, one in zip(_AT, (before, low, high), strict=True) if _is_unknown(one, key)]
        if unknown:
            known = [None if end is None else finite(end) for end in ends]
            found[key] = {"value": finite(value), "change": known, "not_known": unknown}
        elif any(end is not None and abs(end) > _SHOWN * max(abs(value), 1.0) for end in ends):
            found[key] = {"value": value, "change": ends}
    return found


def _is_unknown(measured: Any, key: str) -> bool:
    return isinstance(measured, Mapping) and math.isnan(measured.get(key, 0.0))


def _lines(effects: list[dict[str, Any]], *, measure: bool) -> Iterator[str]:
    for effect in effects:
        low, high = effect["mean_gray"]
        noise = "" if effect["noise"] is None else ", noise {:+.1%} to {:+.1%}".format(*effect["noise"])
        yield f"{effect['key']} from {effect['low']} to {effect['high']}: mean gray {low:+.3g} to {high:+.3g}{noise}"
        if measure and "measured" not in effect:
            yield "  cannot be measured: only a render with --basis keeps what each of several sources gives"
        for key, change in effect.get("measured", {}).items():
            if key == "cannot":
                yield f"  cannot be measured: {'; '.join(change)}"
                continue
            low, high = ("?" if one is None else f"{one:+.3g}" for one in change["change"])
            value = "?" if change["value"] is None else f"{change['value']:.6g}"
            unknown = f"; not known {', '.join(change['not_known'])}" if "not_known" in change else ""
            yield f"  {key} {value}: {low} to {high}{unknown}"
