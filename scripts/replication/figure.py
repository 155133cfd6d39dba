"""What every script of a figure or table does at its end: verdicts, a PNG, and a JSON file."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from radwrap.errors import InputError, RadwrapError
from radwrap.files import make_folder, write_bytes
from radwrap.manifest import finite, json_text, versions
from replication.images import Image, Measured
from replication.published import ROOT, claims, judge, published, reasons

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SCHEMA: Final = 1
MOST_SEEDS: Final = 1000
INTERRUPTED: Final = 130  # as a shell tells Ctrl-C
_STYLE: Final = {"font.size": 8, "axes.titlesize": 9, "legend.fontsize": 7, "legend.frameon": False}
OURS, PAPER, THIRD = "C0", "C3", "C2"

Ours = Measured | float | Sequence[float] | None


@dataclass(frozen=True, slots=True)
class Task:
    """What a script was asked for.

    Attributes
    ----------
    out : Path
        Folder of PNG and JSON files; renders and studies lie below it.
    quick : bool
        Coarse images, few seeds: shows that everything runs, no verdict counts.
    seeds, variant_seeds : int
        Of Table 3, and of each of its variants.
    finished_only : bool
        Show the seeds of Table 3 that are finished, start none.
    """

    out: Path
    quick: bool
    seeds: int = 20
    variant_seeds: int = 3
    finished_only: bool = False

    def __post_init__(self) -> None:
        for name, number in (("--seeds", self.seeds), ("--variant-seeds", self.variant_seeds)):
            if not 1 <= number <= MOST_SEEDS:
                raise InputError(f"must lie between 1 and {MOST_SEEDS}, not {number}", where=name)


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """What a script made: picture, ours of each claim, and what else its JSON file should hold."""

    title: str
    picture: Figure
    ours: Mapping[str, Ours]
    assumed: Sequence[str]
    more: Mapping[str, Any]
    note: str = ""  # on what the claims that are not exact rest


def main(name: str, make: Callable[[Task], Made], about: str | None) -> int:
    """The command line of a script."""
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--out", type=Path, help="folder (default out/figures, of a quick run out/quick/figures)")
    parser.add_argument("--quick", action="store_true", help="coarse images and few seeds; no verdict counts")
    parser.add_argument("--seeds", type=int, default=20, help="of Table 3 (default 20)")
    parser.add_argument("--variant-seeds", type=int, default=3, help="of each variant of Table 3 (default 3)")
    parser.add_argument("--finished", action="store_true", help="show the seeds that are finished, start none")
    given = parser.parse_args()

    def work() -> None:
        out = given.out or default_folder(given.quick, "figures")
        task = Task(out, given.quick, given.seeds, given.variant_seeds, given.finished)
        for line in carry_out(name, make, task):
            print(line)

    return told_exit(work)


def default_folder(quick: bool, name: str) -> Path:
    """A quick run does not lie down on what the whole one made."""
    return ROOT / "out" / "quick" / name if quick else ROOT / "out" / name


def told_exit(work: Callable[[], None]) -> int:
    """Do it; the exit code. What goes wrong is one line on stderr, an interrupt too."""
    try:
        work()
    except KeyboardInterrupt:
        print("interrupted; the same command goes on with what is finished", file=sys.stderr)
        return INTERRUPTED
    except RadwrapError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    return 0


def carry_out(name: str, make: Callable[[Task], Made], task: Task) -> Iterator[str]:
    """Make a figure or table, judge its claims, write both files; a line for each claim."""
    start = time.monotonic()
    make_folder(task.out)
    with style():
        made = make(task)
        write_bytes(task.out / f"{name}.png", png(made.picture))
    told = [_judged(claim, made.ours[key], made.note) for key, claim in claims(name).items()]
    known = published()["assumptions"]
    content = {
        "schema_version": SCHEMA,
        "name": name,
        "title": made.title,
        "quick": task.quick,
        "claims": told,
        "assumptions": {key: known[key] for key in made.assumed},
        **made.more,
        "versions": versions(),
        "timing": {"wall_s": time.monotonic() - start},
    }
    write_bytes(task.out / f"{name}.json", json_text(content).encode())
    for one in told:
        yield f"{one['id']}: {one['verdict']}: {one['why']}"


def _judged(claim: Any, ours: Ours, note: str = "") -> dict[str, Any]:
    value, error = (ours.value, ours.error) if isinstance(ours, Measured) else (ours, 0.0)
    # An error that is not known holds nothing, and is null in the file; so is a value that is none.
    verdict, why = judge(claim, value, error if math.isfinite(error) else math.inf)
    value = finite(value) if isinstance(value, float) else value
    return {
        "id": claim.id,
        "place": claim.place,
        "claim": claim.claim,
        "kind": claim.kind,
        "measure": claim.measure,
        "unit": claim.unit,
        "printed": claim.printed,
        "ours": value,
        "error": finite(error),
        "difference": _difference(value, claim.printed) if _compares(claim) else None,
        "verdict": verdict,
        "why": f"{why}, {note}" if note and claim.kind == "in_kind" else why,
        "reason": reasons().get(claim.id, "") if verdict == "not_reproduced" else "",
        "doubt": claim.doubt,
    }


def _compares(claim: Any) -> bool:
    """Whether ours and the printed are of the same thing: a share of seeds is no effect."""
    return claim.printed is not None and not claim.measure.startswith("share of seeds")


def _difference(ours: Any, printed: Any) -> float | None:
    """Ours less printed; of lists the largest difference."""
    if ours is None:
        return None
    if isinstance(ours, int | float):
        return float(ours) - float(printed)
    return float(np.abs(np.asarray(ours) - np.asarray(printed)).max()) if len(ours) == len(printed) else None


# ------------------------------------------------------------------------------------------------------------- pictures


@contextmanager
def style() -> Iterator[None]:
    """Sizes of letters that all pictures share."""
    import matplotlib as mpl

    with mpl.rc_context(_STYLE):
        yield


def figure(width: float, height: float, rows: int = 1, columns: int = 1, **options: Any) -> tuple[Figure, Any]:
    """An empty picture with panels; width and height in inches."""
    from matplotlib.figure import Figure

    made = Figure(figsize=(width, height), layout="constrained")
    return made, made.subplots(rows, columns, squeeze=False, **options)


def png(picture: Figure) -> bytes:
    """The picture's bytes, the same each time."""
    content = BytesIO()
    picture.savefig(content, format="png", dpi=120, metadata={"Software": None})
    return content.getvalue()


def show(axes: Axes, image: Image, title: str, top: float) -> None:
    """A gray image, its gray levels stretched from dark to `top`."""
    sensor = image.scene.camera.sensor
    aspect = sensor.pixel_height / sensor.pixel_width
    axes.imshow(image.gray, cmap="gray", vmin=sensor.dark_gray, vmax=top, aspect=aspect, interpolation="nearest")
    axes.set(title=title, xticks=[], yticks=[])
