"""``radwrap calibrate``: a camera from points, a sensor's response from frames."""

from __future__ import annotations

import argparse
from typing import Any

from radwrap.cli import calibrate_camera, calibrate_sensor


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = verbs.add_parser("calibrate", description=__doc__)
    kinds: argparse._SubParsersAction[Any] = parser.add_subparsers(title="what", required=True, metavar="WHAT")
    for module in (calibrate_camera, calibrate_sensor):
        module.add_to(kinds)
