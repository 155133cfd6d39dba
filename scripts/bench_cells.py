"""Real cells: what `radwrap render` takes on them, and plain Mitsuba 3 to the same true error, in the same run.

Each render is the whole command as a process, with start and files; its kernels
are compiled before. Its error is measured by rays that it did not use. Mitsuba
(`pip install "radwrap[bench]"`, and an LLVM) renders the same scene, as near as
its words go, by whole processes of three lengths, and is held against its own
converged image, the longest of them: t = a + b n, rms = c n^-1/2. Its sampler,
integrator and film are its plain ones; a pinhole has no diameter there, sheeting
is Lambertian, and a beam that is not Lambertian shines from a point, as it does
in radwrap. What does not end in the limit, or crashes, is a row too. Finished
rows are kept in the out folder by a hash of scene, options, versions, sources
and machine, so a run that was ended goes on where it was.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from cell_bench.cases import BOARD, CELLS, NAMES, ROOT, TENT, Case, case_of, sizes_of, sources_sha256
from cell_bench.kept import kept
from cell_bench.mitsuba_runs import VARIANT, Mitsuba, find_mitsuba, mitsuba_row
from cell_bench.renders import Asked, Truth, render_row
from cell_bench.report import Row, compared, comparisons, machine, told
from radwrap.files import write_bytes
from radwrap.images import read_image, write_png
from radwrap.manifest import versions

_FULL_PIXELS = 3e5  # from here on Mitsuba gets --samples as they are
# A board of dots is nearly all edges or nothing: it takes more rays to be sure of an error there. So do walks, each of
# which is off by more than what it is the mean of.
_TRUTH_RAYS = {BOARD: 1024, TENT: 8192}


def parsed(words: list[str]) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    default = ",".join((*CELLS, BOARD, TENT))
    parser.add_argument("--cells", default=default, help=f"names, of {', '.join(NAMES)}")
    parser.add_argument("--sizes", help="megapixels (default all of each scene but the tiny)")
    parser.add_argument(
        "--tolerances", default="0.5", help="gray levels (default 0.5); white_tent has --tent-tolerance"
    )
    parser.add_argument("--tracers", default="auto", help="words of --tracer (default auto)")
    parser.add_argument("--limit", type=float, default=60.0, help="longest time of a process [s]")
    parser.add_argument(
        "--samples", default="4,16,64", help="Mitsuba's, of each pixel; the last is its converged image"
    )
    parser.add_argument("--truth-pixels", type=int, default=1500)
    parser.add_argument(
        "--truth-rays",
        type=int,
        help="of each of two values of a pixel (default 256, of the board 1024, of the tent 8192)",
    )
    parser.add_argument("--tent-tolerance", type=float, default=2.0)
    parser.add_argument("--tent-budget", type=float, help="time for white_tent at 5 MP, such as 600 [s]; left out else")
    parser.add_argument("--no-mitsuba", action="store_true")
    parser.add_argument("--mitsuba-variant", default=VARIANT, help="scalar_rgb needs no LLVM, and is not a fair match")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "bench_cells", help="folder of rows and pictures")
    parser.add_argument("--json", type=Path, help="file of all rows (default bench_cells.json in the out folder)")
    return parser.parse_args(words)


def cases(arguments: argparse.Namespace) -> list[Case]:
    """What is measured, in order."""
    chosen = []
    for name in arguments.cells.split(","):
        # A name that is not known is refused by `case_of`.
        known = [size for size in sizes_of(name) if size >= 0.03]
        sizes = known if arguments.sizes is None else [float(size) for size in arguments.sizes.split(",")]
        chosen += [case_of(name, size) for size in sizes]
    return chosen


def all_asked(case: Case, arguments: argparse.Namespace) -> list[Asked]:
    """How a case is rendered."""
    tracers = arguments.tracers.split(",")
    if case.name != TENT:
        tolerances = [float(text) for text in arguments.tolerances.split(",")]
        return [Asked(case, tolerance, tracer, arguments.limit) for tolerance in tolerances for tracer in tracers]
    if case.megapixels < 1:
        return [Asked(case, arguments.tent_tolerance, tracer, arguments.limit) for tracer in tracers]
    if arguments.tent_budget is None:
        return []
    # Start, files and certificate come on top.
    limit = 2 * arguments.tent_budget + arguments.limit
    return [Asked(case, 0.1, tracer, limit, arguments.tent_budget) for tracer in tracers]


def measured_rows(case: Case, arguments: argparse.Namespace, mitsuba: Mitsuba | None) -> list[Row]:
    """All rows of a case, each said as it is there."""
    here = {key: value for key, value in machine().items() if key != "load"}
    common: Row = {"case": case.described(), "machine": here, "bench": sources_sha256(ROOT / "scripts" / "cell_bench")}
    pictures, rows = arguments.out / "pictures", arguments.out / "rows"
    found: list[Row] = []

    def add(key: Row, measure: Callable[[], Row]) -> None:
        row = kept(rows, {**common, **key}, measure)
        print(told(row), flush=True)
        found.append(row)

    stem = f"{case.name}_{case.megapixels:g}"
    truth = Truth(case, arguments.truth_pixels, arguments.truth_rays or _TRUTH_RAYS.get(case.name, 256))
    wanted = all_asked(case, arguments)
    for asked in wanted:
        key: dict[str, Any] = {
            "command": asked.command()[1:],
            "limit": asked.limit,
            "truth": [truth.pixels, truth.rays],
            "versions": versions(),
            "sources": sources_sha256(ROOT / "radwrap"),
        }
        key["command"].remove(str(case.file))  # the same scene in another folder is the same
        picture = pictures / f"{stem}_radwrap_{asked.tolerance:g}_{asked.tracer}.png"
        add(key, lambda asked=asked, picture=picture: render_row(asked, truth.of, picture))
    if mitsuba is not None and wanted:
        # A small image needs more samples for as much time.
        more = max(1, round(_FULL_PIXELS / (case.columns * case.rows)))
        samples = [more * int(text) for text in arguments.samples.split(",")]
        key = {
            "mitsuba": [mitsuba.version, mitsuba.variant, mitsuba.llvm],
            "samples": samples,
            "limit": arguments.limit,
        }
        picture = pictures / f"{stem}_mitsuba.npy"
        add(key, lambda: mitsuba_row(case, mitsuba, samples, arguments.limit, picture))
    return found


def side_by_side(folder: Path, case: Case) -> None:
    """One picture of radwrap's image and Mitsuba's, where there are both."""
    stem = f"{case.name}_{case.megapixels:g}"
    other, ours = folder / f"{stem}_mitsuba.npy", sorted(folder.glob(f"{stem}_radwrap_*.png"))
    if other.is_file() and ours:
        codes, _ = read_image(ours[0])
        write_png(folder / f"{stem}.png", np.hstack([codes, np.rint(np.load(other))]).astype(np.uint8))


def main(words: list[str]) -> int:
    """Measure, print, write."""
    arguments = parsed(words)
    try:
        chosen = cases(arguments)
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    found = None if arguments.no_mitsuba else find_mitsuba(arguments.mitsuba_variant)
    if isinstance(found, str):
        print(f"without Mitsuba: {found}", flush=True)
    mitsuba = found if isinstance(found, Mitsuba) else None
    here, rows = machine(), []
    print(f"{here['processor']}, {here['cores']} cores, load {here['load']:.1f} before", flush=True)
    for case in chosen:
        rows += measured_rows(case, arguments, mitsuba)
        side_by_side(arguments.out / "pictures", case)
    against = comparisons(rows)
    for row in against:
        print(compared(row))
    content = {"machine": here, "rows": rows, "comparisons": against}
    arguments.out.mkdir(parents=True, exist_ok=True)
    write_bytes(arguments.json or arguments.out / "bench_cells.json", json.dumps(content, indent=1).encode())
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
