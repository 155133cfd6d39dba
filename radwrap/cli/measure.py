"""``radwrap measure``: what an algorithm sees in a gray image, predicted or captured."""

from __future__ import annotations

import argparse
from typing import Any, Final

from radwrap.cli import (
    measure_circle,
    measure_dots,
    measure_edge,
    measure_emva,
    measure_levels,
    measure_parts,
    measure_straight,
)

_KINDS: Final = (
    measure_dots,
    measure_edge,
    measure_circle,
    measure_straight,
    measure_levels,
    measure_parts,
    measure_emva,
)


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = verbs.add_parser("measure", description=__doc__)
    kinds: argparse._SubParsersAction[Any] = parser.add_subparsers(title="what", required=True, metavar="WHAT")
    for module in _KINDS:
        module.add_to(kinds)
