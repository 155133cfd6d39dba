"""``radwrap catalog import``: a sensor from the results of an EMVA 1288 measurement."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from radwrap.cli import options as shared
from radwrap.cli import written_sensor
from radwrap.errors import InputError
from radwrap.manifest import SCHEMA_VERSION, json_text
from radwrap.scene.catalog.emva_xml import read_emva_xml


def add_to(kinds: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = kinds.add_parser(
        "import",
        help="a sensor from the XML of an EMVA 1288 measurement",
        description="Reads the XML that the EMVA's reference implementation writes. It gives neither size, pitch, "
        "wavelength, bits nor dark level: give them as options.",
    )
    parser.add_argument("file", metavar="EMVA.xml", help="results of a measurement")
    parser.add_argument("--rows", metavar="N", type=shared.whole(1, 65535), help="of the sensor")
    parser.add_argument("--columns", metavar="N", type=shared.whole(1, 65535), help="of the sensor")
    parser.add_argument("--pixel-width", metavar="LENGTH", help='such as "3.45 um"')
    parser.add_argument("--pixel-height", metavar="LENGTH", help="likewise")
    parser.add_argument("--wavelength", metavar="LENGTH", help='wavelength of the measurement, such as "525 nm"')
    parser.add_argument("--offset", metavar="G", type=shared.GRAY_LEVEL, help="gray level without light")
    written_sensor.add_options(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the verb."""
    path = None if arguments.write is None else written_sensor.file_of(arguments)
    if path is None:
        raise InputError("is missing", where="--write", remedy="name the file to write")
    for option in ("rows", "columns"):
        if getattr(arguments, option) is None:
            raise InputError("is missing", where=f"--{option}", remedy="the XML does not give it")
    source = Path(arguments.file)
    found = read_emva_xml(source)
    measured: dict[str, Any] = {
        "rows": arguments.rows,
        "columns": arguments.columns,
        "quantum_efficiency": round(found["qe"] / 100, 6),
        "system_gain": f"{found['k']:.6g} DN/e",
        "full_well": f"{found['u_e_sat']:.6g} e",
        "read_noise": f"{found['sigma_d']:.6g} e",
    }
    if "u_i_mean" in found:
        measured["dark_current"] = f"{found['u_i_mean']:.6g} e/s"
    if "dsnu1288" in found:
        measured["dsnu"] = f"{found['dsnu1288']:.6g} e"
    if "prnu1288" in found:
        measured["prnu"] = round(found["prnu1288"] / 100, 8)
    assumed: dict[str, tuple[Any, str]] = {}
    if arguments.offset is None:
        assumed["offset"] = (0.0, "the XML does not give the dark level")
    else:
        measured["offset"] = arguments.offset
    totals = {
        "dynamic_range": ("dr_db", "dB"),
        "snr_max": ("snr_max_db", "dB"),
        "absolute_sensitivity_threshold": ("u_e_min", "e"),
    }
    published = {key: f"{found[name]:.4f} {unit}" for key, (name, unit) in totals.items() if name in found}
    written_sensor.write_sensor(
        path,
        arguments,
        measured,
        assumed=assumed,
        published=published,
        citation=f"EMVA 1288 results in {source.name}",
    )
    if arguments.json:
        print(json_text({"schema_version": SCHEMA_VERSION, "components": [{"file": str(path)}]}), end="")
    else:
        print(path)
    return 0
