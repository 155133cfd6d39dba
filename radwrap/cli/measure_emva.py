"""``radwrap measure emva``: photon transfer after EMVA 1288, from frames of even light and of none."""

from __future__ import annotations

import argparse
import io
import math
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from radwrap.cli import options as shared
from radwrap.cli import raw_mosaic, written_sensor
from radwrap.errors import InputError
from radwrap.files import write_bytes
from radwrap.manifest import SCHEMA_VERSION, json_text
from radwrap.measure.emva import PhotonTransfer, photon_transfer, read_stacks
from radwrap.scene.linear_sensor import LIGHT, PLANCK
from radwrap.units import LENGTH, parse_quantity

_TOP: Final = 1.05  # of a converter's range: what gain and full well, as measured, may lie above it
_UNITS = {"exposure_time": "s", "radiant_exposure": "J/m^2", "photons": "photon"}


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = verbs.add_parser(
        "emva",
        help="gain, noise, saturation, DSNU, PRNU and linearity from frames",
        description="FRAMES.csv names frames of even light: the columns file, one of exposure_time (s), "
        "radiant_exposure (J/m^2) and photons (a pixel), and dark (1 where no light fell; without that column, frames "
        "of exposure 0 are dark). Two frames or more of each exposure, files named from the table's own folder.",
    )
    parser.add_argument("frames", metavar="FRAMES.csv", help="a row for each frame")
    parser.add_argument("--pixel-width", metavar="LENGTH", help='with radiant_exposure, such as "13.8 um"')
    parser.add_argument("--pixel-height", metavar="LENGTH", help="likewise")
    parser.add_argument("--wavelength", metavar="LENGTH", help='with radiant_exposure, such as "650 nm"')
    parser.add_argument("--trust", action="store_true", help="let FRAMES.csv name files outside its folder")
    parser.add_argument("--plot", metavar="PNG", help="draw photon transfer, signal, SNR and linearity")
    written_sensor.add_options(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the verb."""
    picture = shared.file_to_write(arguments.plot, "--plot", ".png", others=[arguments.frames])
    component = written_sensor.file_of(arguments)
    path = Path(arguments.frames)
    kind, stacks = read_stacks(path, trust=arguments.trust, read=lambda file: raw_mosaic.one_colour(file).values)
    try:
        found = photon_transfer(kind, stacks, _photons(arguments, kind))
    except InputError as error:
        raise InputError(error.what, where=error.where or str(path), remedy=error.remedy) from error
    if picture is not None:
        write_bytes(picture, plot(found, kind))
    if component is not None:
        _write(component, arguments, found, stacks[0].mean.shape)
    told = {
        "schema_version": SCHEMA_VERSION,
        "exposure": kind,
        "exposure_unit": _UNITS[kind],
        **asdict(found),
        "steps": [{**asdict(step), "signal": step.signal, "snr": step.snr} for step in found.steps],
    }
    print(json_text(told) if arguments.json else "\n".join(_lines(found)) + "\n", end="")
    return 0


def _photons(arguments: argparse.Namespace, kind: str) -> float | None:
    """Photons a pixel for each unit of exposure, None where that is not known."""
    options = ("--pixel-width", "--pixel-height", "--wavelength")
    given = {option: getattr(arguments, option[2:].replace("-", "_")) for option in options}
    named = [option for option, text in given.items() if text is not None]
    if kind != "radiant_exposure" and named and arguments.write is None:
        raise InputError(f"goes with the column radiant_exposure, the file has {kind}", where=named[0])
    if kind == "photons":
        return 1.0
    if kind != "radiant_exposure" or not named:
        return None
    if len(named) < len(options):
        missing = next(option for option in options if option not in named)
        raise InputError("is missing", where=missing, remedy=f"{', '.join(options)} go together")
    width, height, wavelength = (_length(text, option) for option, text in given.items())
    return width * height * wavelength / (PLANCK * LIGHT)


def _write(path: Path, arguments: argparse.Namespace, found: PhotonTransfer, shape: tuple[int, ...]) -> None:
    """Write what was measured as a component of the catalog."""
    if found.quantum_efficiency is None:
        raise InputError(
            "needs the quantum efficiency, and exposure times do not give it",
            where="--write",
            remedy="give frames with radiant_exposure or photons",
        )
    if not found.saturated and found.full_well is None:
        raise InputError("needs the full well, and no frame reaches it", where="--write", remedy="expose longer")
    well = found.saturation_electrons if found.full_well is None else found.full_well
    top = found.dark_gray + well * found.gain
    if top > _TOP * 2**arguments.bit_depth:
        raise InputError(
            f"a converter of {arguments.bit_depth} bits has no level {top:.0f}, which the frames reach",
            where="--bit-depth",
        )
    measured: dict[str, Any] = {
        "rows": shape[0],
        "columns": shape[1],
        "quantum_efficiency": round(found.quantum_efficiency, 6),
        "system_gain": f"{found.gain:.6g} DN/e",
        "offset": round(found.dark_gray, 4),
        "full_well": f"{well:.6g} e",
        "read_noise": f"{found.read_noise:.6g} e",
    }
    if found.dark_current is not None:
        measured["dark_current"] = f"{max(found.dark_current, 0.0):.6g} e/s"
    if found.dsnu is not None:
        measured["dsnu"] = f"{found.dsnu:.6g} e"
    if found.prnu is not None:
        measured["prnu"] = round(found.prnu, 8)
    written_sensor.write_sensor(
        path,
        arguments,
        measured,
        assumed={},
        published={
            "dynamic_range": f"{20 * math.log10(found.dynamic_range):.2f} dB",
            "snr_max": f"{20 * math.log10(found.snr_max):.2f} dB",
        },
        citation=f"frames of {Path(arguments.frames).name}, by radwrap measure emva",
    )


def _length(text: str, option: str) -> float:
    try:
        value = parse_quantity(text, LENGTH)
    except InputError as error:
        raise InputError(error.what, where=option, remedy=error.remedy) from error
    if value <= 0:
        raise InputError("must be above zero", where=option)
    return value


def _lines(found: PhotonTransfer) -> Iterator[str]:
    least = "" if found.saturated else "at least "
    yield f"system gain: {found.gain:.5g} +- {found.gain_sigma:.2g} DN/e"
    if found.quantum_efficiency is not None:
        yield f"quantum efficiency: {found.quantum_efficiency:.2%}"
    yield f"dark level: {found.dark_gray:.4g}, read noise: {found.read_noise:.4g} e"
    if found.dark_current is not None:
        yield f"dark current: {found.dark_current:.4g} e/s"
    yield f"saturation: {least}{found.saturation_electrons:.5g} e, gray {found.saturation_gray:.5g}"
    if found.full_well is not None:
        yield f"full well, by the plateau: {found.full_well:.5g} e"
    yield f"SNR: up to {least}{found.snr_max:.4g} ({20 * math.log10(found.snr_max):.3g} dB)"
    yield f"dynamic range: {least}{found.dynamic_range:.4g} ({20 * math.log10(found.dynamic_range):.3g} dB)"
    if found.dsnu is not None or found.prnu is not None:
        yield f"DSNU: {_told(found.dsnu)} e ({_told(found.dsnu_all_pixels)} with defect pixels)"
        yield f"PRNU: {_told(found.prnu, 100)} % ({_told(found.prnu_all_pixels, 100)} with defect pixels)"
        yield f"defect pixels: {found.defects}"
    if found.linearity_error is not None:
        yield f"linearity error: {found.linearity_error:.3%} mean, {found.linearity_error_max:.3%} at most"
    for note in found.notes:
        yield f"note: {note}"


def _told(value: float | None, factor: float = 1.0) -> str:
    return "hidden" if value is None else f"{value * factor:.4g}"


def plot(found: PhotonTransfer, kind: str) -> bytes:
    """Four panels: photon transfer, signal, SNR, deviation from the line.

    Parameters
    ----------
    found : PhotonTransfer
        What was found.
    kind : str
        Name of the exposure.
    """
    import numpy as np
    from matplotlib.figure import Figure

    steps = found.steps
    exposure, signal, variance, dark, snr = (
        np.array([getattr(step, key) for step in steps])
        for key in ("exposure", "signal", "variance", "dark_variance", "snr")
    )
    label = f"{kind.replace('_', ' ')} [{_UNITS[kind]}]"
    figure = Figure(figsize=(11, 8), layout="constrained")
    axes = figure.subplots(2, 2)
    transfer, line, noise, deviation = axes.ravel()
    top = float(signal.max())
    transfer.plot(signal, variance - dark, "o", ms=4)
    transfer.plot([0, top], [0, found.gain * top], "-", lw=1)
    transfer.axvline(found.saturation_gray - steps[-1].dark_gray, color="0.6", lw=1)
    transfer.set(title=f"photon transfer: K = {found.gain:.4g} DN/e", xlabel="gray above dark", ylabel="variance")
    transfer.set_ylim(0, 1.1 * float((variance - dark).max()))
    line.plot(exposure, signal, "o", ms=4)
    line.plot([0, exposure.max()], [0, found.responsivity * exposure.max()], "-", lw=1)
    line.set(title="signal", xlabel=label, ylabel="gray above dark", ylim=(0, 1.1 * top))
    shown = (signal > 0) & (snr > 0) & (signal <= found.saturation_gray - steps[-1].dark_gray)
    electrons = signal[shown] / found.gain
    noise.loglog(electrons, snr[shown], "o", ms=4)
    dense = np.geomspace(max(float(electrons.min()), 1e-3), float(electrons.max()), 200)
    noise.loglog(dense, dense / np.sqrt(found.read_noise**2 + 1 / 12 / found.gain**2 + dense), "-", lw=1)
    noise.set(title=f"signal to noise: up to {found.snr_max:.4g}", xlabel="electrons", ylabel="SNR")
    off = 100 * (signal[shown] / (found.responsivity * exposure[shown]) - 1)
    deviation.plot(signal[shown], off, "o-", ms=4, lw=1)
    deviation.set(title="deviation from the fitted signal", xlabel="gray above dark", ylabel="%")
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=100, metadata={"Software": ""})
    return buffer.getvalue()
