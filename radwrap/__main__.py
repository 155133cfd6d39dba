"""``python -m radwrap``: the command line, where its program is not on the path."""

from __future__ import annotations

from radwrap.cli.program import program

if __name__ == "__main__":
    program()
