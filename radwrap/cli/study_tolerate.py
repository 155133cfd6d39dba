"""``radwrap study tolerate``."""
from __future__ import annotations
import argparse
from typing import Any
def add_to(kinds: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
