"""``radwrap led calibrate``: what each LED shines at each level, from a table or from captures."""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from radwrap.cli import options as shared
from radwrap.errors import InputError
from radwrap.led.calibration import read_table, scaled, write_calibration
from radwrap.led.drive import read_drive
from radwrap.led.play import DARK, RECORD, led_name
from radwrap.manifest import SCHEMA_VERSION, json_text, read_manifest
from radwrap.reading import parse_json
from radwrap.scene.file.ring_calibration import RingCalibration
from radwrap.written import Count, Positive, Share, read_back

_FREEZING: Final = 273.15  # K, of 0 degrees Celsius
_DESCRIPTION = (
    "Writes a calibration: level to radiant intensity of each LED. From a measured table, or from the captures of "
    "radwrap led play --alone (dark.png, led00.png, ... beside its play.json) against a light basis of the same "
    "scene: radwrap render SCENE --basis."
)


def add_to(what: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = what.add_parser("calibrate", help="measure level to radiant intensity", description=_DESCRIPTION)
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument(
        "--table", metavar="CSV", help="columns led, level, radiant_intensity and, where known, standard_error"
    )
    source.add_argument("--captures", metavar="DIR", help="folder of a radwrap led play --alone, with the images")
    parser.add_argument(
        "--basis", metavar="DIR", help="folder of a radwrap render --basis of the scene, for --captures"
    )
    parser.add_argument("--suffix", metavar="S", default=".png", help="suffix of the captures' names (default .png)")
    parser.add_argument("--drive", metavar="DRIVE.toml", help="for --table: the current at which it was measured")
    parser.add_argument("--serial", metavar="S", default="", help="for --table: name of the device that drove the LEDs")
    parser.add_argument(
        "--temperature", metavar="C", type=shared.number(), help="temperature of the surroundings [degrees Celsius]"
    )
    parser.add_argument("--date", metavar="D", help="date of the measurement, ISO 8601 (default: now)")
    parser.add_argument("--out", metavar="FILE", required=True, help="calibration to write")
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the verb."""
    shared.file_to_write(arguments.out, "--out", others=[arguments.table, arguments.drive, arguments.captures])
    calibration, told = _from_table(arguments) if arguments.table else _from_captures(arguments)
    write_calibration(Path(arguments.out), calibration)
    if arguments.json:
        print(json_text({"schema_version": SCHEMA_VERSION, "emulated": calibration.emulated, "leds": told}), end="")
        return 0
    for led in told:
        print(
            f"LED {led['led']}: {1e3 * led['radiant_intensity']:.4g} mW/sr at level {led['level']:.4g}, "
            f"standard error {1e3 * led['standard_error']:.2g} mW/sr"
        )
    print(f"{arguments.out}: {'of an emulated ring' if calibration.emulated else 'written'}")
    return 0


def _when(arguments: argparse.Namespace) -> tuple[str, float | None]:
    date = arguments.date or datetime.now(UTC).isoformat(timespec="seconds")
    try:
        datetime.fromisoformat(date)
    except ValueError as error:
        raise InputError(f'"{date}" is not a date of ISO 8601', where="--date") from error
    if arguments.temperature is None:
        return date, None
    kelvin = arguments.temperature + _FREEZING
    if not (math.isfinite(kelvin) and kelvin > 0):
        raise InputError(f"{arguments.temperature} is not a temperature in degrees Celsius", where="--temperature")
    return date, kelvin


def _told(calibration: RingCalibration) -> list[dict[str, Any]]:
    return [
        {
            "led": number,
            "level": table.levels[-1],
            "radiant_intensity": table.radiant_intensity[-1],
            "standard_error": table.standard_error[-1],
        }
        for number, table in enumerate(calibration.leds)
    ]


def _from_table(arguments: argparse.Namespace) -> tuple[RingCalibration, list[dict[str, Any]]]:
    if not arguments.drive:
        raise InputError(
            "needs the current at which it was measured", where="--table", remedy="give --drive DRIVE.toml"
        )
    date, temperature = _when(arguments)
    calibration = RingCalibration(
        leds=read_table(Path(arguments.table)),
        serial=arguments.serial,
        date=date,
        temperature=temperature,
        current=read_drive(Path(arguments.drive)).drive_current,
        emulated=False,
        source=f"table {Path(arguments.table).name}",
    )
    return calibration, _told(calibration)


def _from_captures(arguments: argparse.Namespace) -> tuple[RingCalibration, list[dict[str, Any]]]:
    from radwrap.cli import raw_mosaic
    from radwrap.imaging.output.run_manifest import read_run_manifest
    from radwrap.imaging.relight.relit import read_basis, relit
    from radwrap.led.from_scene import leds_of
    from radwrap.led.self_calibration import check_dark, factor
    from radwrap.scene.file.load import scene_from_document

    if not arguments.basis:
        raise InputError("needs what the scene predicts", where="--captures", remedy="give --basis DIR")
    date, temperature = _when(arguments)
    folder = Path(arguments.captures)
    record = read_manifest(folder / RECORD)
    read_back(record, _Record, str(folder / RECORD))
    basis = read_basis(Path(arguments.basis))
    manifest = read_run_manifest(Path(arguments.basis))
    scene = scene_from_document(
        parse_json(manifest.scene, "the basis' scene"), origin="the basis' scene", folder=Path(arguments.basis)
    )
    leds = leds_of(scene)
    _check_record(record, len(leds), str(folder / RECORD))

    def captured(name: str) -> Any:
        path = folder / f"{name}{arguments.suffix}"
        values = raw_mosaic.one_colour(path).values
        if values.shape != (basis.sensor.rows, basis.sensor.columns):
            raise InputError(f"has {values.shape} pixels, the scene's sensor another number", where=str(path))
        return values

    check_dark(captured(DARK), basis.sensor)
    intensities, errors, levels = [], [], []
    told = []
    for number, led in enumerate(leds):
        if led.name not in basis.sources:
            raise InputError("is dark in the scene, so nothing is predicted for it", where=led.name)
        alone = [float(name == led.name) for name in basis.sources]
        (predicted,) = relit(basis, [alone])
        name = led_name(number)
        try:
            found = factor(captured(name), predicted.radiant_exposure.values, basis.sensor)
        except InputError as error:
            raise InputError(
                error.what, where=str(folder / f"{name}{arguments.suffix}"), remedy=error.remedy
            ) from error
        intensities.append(found.value * led.radiant_intensity)
        errors.append(found.standard_error * led.radiant_intensity)
        levels.append(record["frames"][name]["held"][number])
        told.append({"factor": found.value, "factor_standard_error": found.standard_error, "pixels": found.pixels,
                     "residual_rms_gray": found.residual_rms})  # fmt: skip
    calibration = RingCalibration(
        leds=scaled(intensities, errors, levels),
        serial=record["device"]["serial"],
        date=date,
        temperature=temperature,
        current=record["drive"]["drive_current"],
        emulated=record["emulated"],
        source=f"captures against scene {basis.scene_sha256[:16]}",
    )
    return calibration, [{**one, **more} for one, more in zip(_told(calibration), told, strict=True)]


@dataclass(frozen=True, slots=True)
class _Frame:
    held: list[Share]


@dataclass(frozen=True, slots=True)
class _Device:
    serial: str
    count: Count


@dataclass(frozen=True, slots=True)
class _Drive:
    drive_current: Positive


@dataclass(frozen=True, slots=True)
class _Record:
    """Of a play's record what a calibration needs."""

    frames: dict[str, _Frame]
    complete: bool
    emulated: bool
    device: _Device
    drive: _Drive | None


def _check_record(record: Mapping[str, Any], count: int, where: str) -> None:
    wanted = [DARK, *(led_name(number) for number in range(count))]
    missing = [name for name in wanted if name not in record["frames"]]
    whole = record["complete"] and record["drive"] is not None and record["device"]["count"] == count
    short = [name for name in wanted if name not in missing and len(record["frames"][name]["held"]) != count]
    missing += short
    if missing or not whole:
        problem = f"has no frame {missing[0]}" if missing else "is not complete"
        raise InputError(problem, where=where, remedy="play it with --alone, to its end")
