"""Rows of the bench as text, and what they say of each other."""

from __future__ import annotations

import os
import platform
from pathlib import Path
from typing import Any

import psutil

from cell_bench.solving import Speed, solved

Row = dict[str, Any]


def machine() -> dict[str, Any]:
    """What was measured on; the load is that of others, where nothing of ours runs yet."""
    model = platform.processor() or platform.machine()
    if Path("/proc/cpuinfo").is_file():
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        model = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), model)
    return {
        "processor": model,
        "cores": len(os.sched_getaffinity(0)),
        "memory_bytes": psutil.virtual_memory().total,
        "load": os.getloadavg()[0],
    }


def told(row: Row) -> str:
    """A row as a line."""
    head = f"{row['case']:11} {row['megapixels']:5g} MP  "
    if row["by"] == "mitsuba":
        return f"{head}{'Mitsuba ' + row['version']:36}{_mitsuba_told(row)}"
    name = "radwrap" if row["tracer"] == "auto" else f"radwrap ({row['tracer']})"
    asked = f"tolerance {row['tolerance']:g}" if row["budget_s"] is None else f"budget {row['budget_s']:g} s"
    text = f"{head}{name + ', ' + asked:36}"
    ahead = (
        f"forecast {_seconds(row['forecast_wall_s'])}" if "forecast_wall_s" in row else row.get("forecast_failure", "")
    )
    if "failure" in row:
        return f"{text}{row['failure']}; {ahead}, {row['peak_memory_bytes'] / 2**20:.0f} MiB"
    ratio = f" ({row['forecast_over_actual']:.2f} of actual)" if "forecast_over_actual" in row else ""
    return (
        f"{text}{row['wall_s']:.2f} s, {row['cpu_s']:.2f} s of processor, {row['peak_memory_bytes'] / 2**20:.0f} MiB; "
        f"rms {row['true_rms_gray']:.3f} (truth's noise {row['truth_noise_rms_gray']:.3f}), "
        f"certified {row['certified_rms_gray']:.3f}{'' if row['met'] else ' NOT MET'}; {row['rays']:.3g} rays by "
        f"{row['method']}, {row['traced_by']}; {ahead}{ratio}; mean gray {row['mean_gray']:.1f}"
    )


def _mitsuba_told(row: Row) -> str:
    if "failure" in row:
        return str(row["failure"])
    speed = speed_of(row)
    return (
        f"{speed.start_s:.2f} s + {speed.sample_s:.3f} s n (to {speed.time_residual:.0%}), rms {speed.noise_gray:.2f} "
        f"n^-1/2 (to {speed.noise_residual:.1%}); {row['peak_memory_bytes'] / 2**20:.0f} MiB; "
        f"mean gray {row['mean_gray']:.1f}"
    )


def _seconds(value: float) -> str:
    if value < 600:
        return f"{value:.1f} s"
    return f"{value / 60:.0f} min" if value < 2 * 3600 else f"{value / 3600:.1f} h"


def speed_of(row: Row) -> Speed:
    """Of a row of Mitsuba's."""
    return Speed(**row["speed"])


def _processor_speed(row: Row) -> Speed | None:
    """As `speed_of`, of processor time; None where that cannot be solved."""
    samples = row["samples"]
    try:
        return solved(samples[:-1], row["cpu_s"], row["rms_to_converged_gray"], samples[-1])
    except ValueError:
        return None


def comparisons(rows: list[Row]) -> list[Row]:
    """Each render against Mitsuba at the same case: time to the same true rms error, and error after the same time."""
    plain = {(row["case"], row["megapixels"]): row for row in rows if row["by"] == "mitsuba" and "speed" in row}
    found = []
    for row in rows:
        other = plain.get((row["case"], row["megapixels"]))
        if row["by"] != "radwrap" or other is None:
            continue
        speed, processor = speed_of(other), _processor_speed(other)
        ended = "failure" not in row
        # A true error that is lost in the truth's own noise would ask for no end of samples.
        target = max(row["true_rms_gray"], row["truth_noise_rms_gray"]) if ended else row["tolerance"]
        found.append(
            {
                **{key: row[key] for key in ("case", "megapixels", "tolerance", "tracer", "budget_s")},
                "ended": ended,
                "rms_gray": target,
                "radwrap_s": row["wall_s"],
                "mitsuba_s": speed.seconds_to(target),
                "mitsuba_samples": speed.samples_to(target),
                "mitsuba_s_to_tolerance": speed.seconds_to(row["tolerance"]),
                "mitsuba_rms_after_same_time": speed.rms_after(row["wall_s"]),
                "radwrap_over_mitsuba": row["wall_s"] / speed.seconds_to(target),
                # Other work on the machine changes processor time less than time.
                "radwrap_cpu_s": row["cpu_s"],
                "mitsuba_cpu_s": processor and processor.seconds_to(target),
                "mean_gray_ratio": row["mean_gray"] / other["mean_gray"] if ended else None,
            }
        )
    return found


def compared(row: Row) -> str:
    """A comparison as a line."""
    ours = f"{row['radwrap_s']:.2f} s" if row["ended"] else f"more than {row['radwrap_s']:.0f} s"
    after = row["mitsuba_rms_after_same_time"]
    left = f"after our time it has rms {'-' if after is None else f'{after:.3f}'}"
    gray = f"; mean gray {row['mean_gray_ratio']:.3f} of Mitsuba's" if row["mean_gray_ratio"] else ""
    head = f"{row['case']:11} {row['megapixels']:5g} MP  tolerance {row['tolerance']:g}, {row['tracer']}: "
    mitsuba = f"Mitsuba {row['mitsuba_s']:.2f} s ({row['mitsuba_samples']:.3g} samples)"
    ratio = f"{row['radwrap_over_mitsuba']:.2g} x its time{'' if row['ended'] else ' or more'}"
    if row["mitsuba_cpu_s"]:
        ratio += f" ({row['radwrap_cpu_s'] / row['mitsuba_cpu_s']:.2g} x in processor time)"
    return (
        f"{head}rms {row['rms_gray']:.3f}: {ours}, {mitsuba}, {ratio}; Mitsuba to the tolerance "
        f"{row['mitsuba_s_to_tolerance']:.2f} s; {left}{gray}"
    )
