"""A study's rows on the ring, one frame after the other, each for as long as a camera needs it.

What is done stands in play.json after every frame, so that an interrupted
play goes on where it was. In played.csv stand the factors that the ring
really showed, as ``radwrap relight`` reads them.
"""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from radwrap.errors import CheckFailed, InputError
from radwrap.files import write_bytes
from radwrap.imaging.relight.levels import Levels
from radwrap.led.ring import Frame, LedRing
from radwrap.manifest import SCHEMA_VERSION, plain, read_manifest, sha256_of_value, write_manifest

RECORD: Final = "play.json"
PLAYED: Final = "played.csv"
DARK: Final = "dark"


@dataclass(frozen=True, slots=True)
class Planned:
    """A frame to be shown.

    Attributes
    ----------
    name : str
        Of the capture.
    factors : tuple of float
        On each LED's radiant intensity in the scene.
    radiant_intensity : tuple of float
        Of each LED [W sr^-1].
    levels : tuple of float
        Of each LED, by the calibration.
    """

    name: str
    factors: tuple[float, ...]
    radiant_intensity: tuple[float, ...]
    levels: tuple[float, ...]


def led_name(number: int) -> str:
    """Name of the frame in which one LED is on alone."""
    return f"led{number:02d}"


def plan(ring: LedRing, nominal: Sequence[float], rows: Levels | None, *, alone: bool) -> tuple[Planned, ...]:
    """The frames of a play: dark, each LED alone where that is wanted, then the rows.

    Parameters
    ----------
    ring : LedRing
        With its calibration.
    nominal : sequence of float
        Radiant intensity of each LED in the scene [W sr^-1].
    rows : Levels, optional
        Factors on them.
    alone : bool
        Whether each LED is shown alone, for calibrations.

    Raises
    ------
    InputError
        If a row has the name of another frame, or a radiant intensity lies outside the calibration.
    """
    count = len(nominal)
    frames = [(DARK, (0.0,) * count)]
    if alone:
        lit = [number for number in range(count) if nominal[number] > 0]
        frames += [(led_name(number), tuple(float(n == number) for n in range(count))) for number in lit]
    taken = {name for name, _ in frames}
    if rows is not None:
        for name, factors in zip(rows.names, rows.factors.tolist(), strict=True):
            if name.lower() in taken:
                raise InputError(f'the name "{name}" is that of another frame', where="rows", remedy="choose another")
            frames.append((name, tuple(factors)))
    planned = []
    for name, factors in frames:
        wanted = tuple(factor * intensity for factor, intensity in zip(factors, nominal, strict=True))
        try:
            levels = ring.levels_of(wanted)
            ring.frame_of(levels)
        except InputError as error:
            where = f'frame "{name}"' + (f", {error.where}" if error.where else "")
            raise InputError(error.what, where=where, remedy=error.remedy) from error
        planned.append(Planned(name, factors, wanted, levels))
    return tuple(planned)


def play(
    ring: LedRing,
    frames: Sequence[Planned],
    out: Path,
    *,
    nominal: Mapping[str, float],
    trigger: Callable[[int, Planned], None],
    settle: float,
) -> dict[str, Any]:
    """Show every frame that is not done yet, and wait for the camera.

    Parameters
    ----------
    ring : LedRing
        The ring; it is dark afterwards.
    frames : sequence of Planned
        See `plan`.
    out : Path
        Folder of the records.
    nominal : Mapping[str, float]
        Name of each LED in the scene -> its radiant intensity there [W sr^-1].
    trigger : callable
        Gets number and frame; returns when the camera has it.
    settle : float
        From the frame's reading back to the trigger [s].

    Returns
    -------
    dict
        What stands in play.json.

    Raises
    ------
    CheckFailed
        If the ring no longer shows the frame after the trigger.
    """
    record = _record(ring, frames)
    done = _done(out, record, ring, frames)
    for number, frame in enumerate(frames):
        if frame.name in done:
            continue
        begin = datetime.now(UTC).isoformat(timespec="milliseconds")
        shown = ring.set_levels(frame.levels)
        time.sleep(settle)
        trigger(number, frame)
        ring.check()
        held = ring.readback()
        if held is not None and held != shown.held:
            raise CheckFailed("the ring no longer showed it after the trigger", where=f'frame "{frame.name}"')
        done[frame.name] = _entry(frame, shown, begin)
        _write(out, record, frames, done)
    ring.off()
    _write(out, record, frames, done)
    write_bytes(out / PLAYED, _played(ring, frames, done, nominal).encode())
    return read_manifest(out / RECORD)


def _record(ring: LedRing, frames: Sequence[Planned]) -> dict[str, Any]:
    told = {
        "schema_version": SCHEMA_VERSION,
        "emulated": ring.capabilities.emulated,
        "device": plain(asdict(ring.capabilities)),
        "drive": None if ring.drive is None else plain(asdict(ring.drive)),
        "calibration": plain(ring.calibration),
    }
    return {**told, "sequence_sha256": sha256_of_value({**told, "frames": [asdict(frame) for frame in frames]})}


def _entry(frame: Planned, shown: Frame, begin: str) -> dict[str, Any]:
    told = {"steps": list(shown.steps), "held": list(shown.held), "verified": shown.verified, "begin": begin}
    return {**plain(asdict(frame)), **told}


def _done(out: Path, record: Mapping[str, Any], ring: LedRing, frames: Sequence[Planned]) -> dict[str, Any]:
    """Frames that an interrupted play of the same sequence has shown.

    A frame was done only if the ring held what was sent, so that its entry is known beforehand, but for its time:
    any other was changed or damaged.
    """
    if not (out / RECORD).exists():
        return {}
    old = read_manifest(out / RECORD)
    if old.get("sequence_sha256") != record["sequence_sha256"]:
        raise InputError(
            "holds the play of another sequence, ring or calibration", where=str(out), remedy="choose another `out`"
        )
    shown, timing = old.get("frames"), old.get("timing")
    begins = timing.get("begin") if isinstance(timing, dict) else None
    done = {}
    if isinstance(shown, dict) and isinstance(begins, dict) and shown.keys() == begins.keys():
        for frame in frames:
            begin = begins.get(frame.name)
            if isinstance(begin, str):
                done[frame.name] = _entry(frame, ring.frame_of(frame.levels), begin)
        if shown == {name: _without_time(entry) for name, entry in done.items()}:
            return done
    raise InputError(
        "is not a complete record of this play", where=str(out / RECORD), remedy="remove it, or choose another `out`"
    )


def _without_time(entry: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in entry.items() if key != "begin"}


def _write(out: Path, record: Mapping[str, Any], frames: Sequence[Planned], done: Mapping[str, Any]) -> None:
    entries = {name: _without_time(entry) for name, entry in done.items()}
    timing = {"begin": {name: entry["begin"] for name, entry in done.items()}}
    complete = len(done) == len(frames)
    write_manifest(out / RECORD, {**record, "complete": complete, "frames": entries, "timing": timing})


def _played(ring: LedRing, frames: Sequence[Planned], done: Mapping[str, Any], nominal: Mapping[str, float]) -> str:
    """What was shown, as factors on the scene: held levels through the calibration."""
    calibration = ring.calibration
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    lit = [number for number, intensity in enumerate(nominal.values()) if intensity > 0]
    names = list(nominal)
    table.writerow(["name", *(names[number] for number in lit)])
    for frame in frames:
        held = done[frame.name]["held"]
        intensities = calibration.intensities(held) if calibration is not None else held
        table.writerow([frame.name, *(repr(intensities[number] / nominal[names[number]]) for number in lit)])
    return text.getvalue()
