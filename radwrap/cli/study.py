"""``radwrap study``: what matters to a vision system, found on predicted images."""

from __future__ import annotations

import argparse
from typing import Any

from radwrap.cli import study_analyse, study_run, study_tolerate


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = verbs.add_parser("study", description=__doc__)
    kinds: argparse._SubParsersAction[Any] = parser.add_subparsers(title="what", required=True, metavar="WHAT")
    for module in (study_run, study_analyse, study_tolerate):
        module.add_to(kinds)
