"""``radwrap dataset``: images with truth, to learn from."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from radwrap.cli import options as shared
from radwrap.cli.study_run import add_workers, worker_options
from radwrap.errors import ToleranceNotMet
from radwrap.manifest import json_text

_DESCRIPTION = (
    "Draws new values of a scene for each image, renders it to a tolerance, and writes it with its truth: masks, "
    "boxes, depth, poses, visible shares and edges. The same seed gives the same bytes, whatever the number of "
    "workers; a killed run continues where it stopped."
)


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = verbs.add_parser("dataset", description=__doc__)
    kinds: argparse._SubParsersAction[Any] = parser.add_subparsers(title="what", required=True, metavar="WHAT")
    made = kinds.add_parser("run", help="make all images of a dataset", description=_DESCRIPTION)
    made.add_argument(
        "dataset", metavar="DATASET.toml", type=Path, help="scene, number of images, distributions; see docs/dataset.md"
    )
    made.add_argument("--out", metavar="DIR", help="folder for the shards")
    add_workers(made)
    made.add_argument("--force", action="store_true", help="remove another dataset from the folder first")
    shared.add_tracer(made)
    shared.add_json(made)
    made.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the verb."""
    from radwrap.dataset.document import read_dataset
    from radwrap.dataset.run import DATASET, RunOptions, run_dataset
    from radwrap.files import check_results

    out = shared.out_folder(arguments, "shards")
    dataset = read_dataset(arguments.dataset)
    check_results(out, (DATASET,))
    options = RunOptions(
        **worker_options(arguments),
        force=arguments.force,
        progress=True,
        **shared.tracer_options(arguments),
    )
    told = run_dataset(dataset, out, options)
    if arguments.json:
        print(json_text(told), end="")
    else:
        objects = ", ".join(f"{number} {name}" for name, number in told["objects"].items())
        print(f"{out}: {told['images']} images, {told['made']} of them made now; {objects}")
    if missed := told["missed"]:
        number, bound = next(iter(missed.items()))
        raise ToleranceNotMet(
            f"{len(missed)} images do not keep the tolerance, the first is {number} ({bound} gray rms)",
            where=str(out),
        )
    return 0
