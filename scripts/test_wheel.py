"""Examples and tutorials from the wheel, in an empty environment for each Python that is there: ``make test-wheel``.

The wheel is built into a folder of its own. Each environment lies outside of the repository and gets the wheel and the
extra that the tutorials need. Its own Python runs them by `docs_site/lessons.py`, and finds no radwrap but the wheel's.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

HERE: Final = Path(__file__).resolve().parent
PYTHONS: Final = ("3.11", "3.12", "3.13", "3.14")
TUTORIALS: Final = ("first_image", "choose_a_ring", "how_exact")
EXTRA: Final = "measure"  # choose_a_ring measures
MEGABYTE: Final = 1 << 20
QUIET: Final = ("--quiet", "--quiet", "--disable-pip-version-check")
# Said in each environment: the tutorials by their paths, after the folder that holds what runs them.
RUN: Final = """
import sys, tempfile
from pathlib import Path
import radwrap
assert Path(radwrap.__file__).is_relative_to(sys.prefix), radwrap.__file__
from radwrap.cli.init_examples import names
scenes = Path(sys.argv[1]).parent / "rad_scenes"
assert set(names()) == {path.parent.relative_to(scenes).as_posix() for path in scenes.glob("*/**/*.toml")}
print("  examples:", len(names()))
sys.path.append(sys.argv[1])
from docs_site.lessons import run
for path in map(Path, sys.argv[2:]):
    with tempfile.TemporaryDirectory() as folder:
        run(path.read_text("utf-8"), Path(folder), path.name)
    print("  passed:", path.stem, flush=True)
"""


def main() -> int:
    """0 if all tutorials pass in each Python that is there, 1 if one does not, 4 if there is none."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("pythons", nargs="*", metavar="PYTHON", help="programs; otherwise those on the path")
    pythons = options.parse_args().pythons or found()
    if not pythons:
        print(f"error: there is none of Python {', '.join(PYTHONS)}; name one", file=sys.stderr)
        return 4
    with tempfile.TemporaryDirectory() as folder:
        wheel = built(Path(folder))
        print(f"{wheel.name}: {wheel.stat().st_size / MEGABYTE:.2f} MiB")
        places = [Path(folder) / f"environment {number}" for number in range(len(pythons))]
        passed = [passes(python, wheel, place) for python, place in zip(pythons, places, strict=True)]
    return 0 if all(passed) else 1


def found() -> list[str]:
    """Programs on the path, and pyenv's, one of each version."""
    programs = []
    for version in PYTHONS:
        pyenv = sorted(Path.home().glob(f".pyenv/versions/{version}.*/bin/python"))
        program = shutil.which(f"python{version}", path=os.environ.get("PATH"))
        if pyenv or program:
            programs.append(str(pyenv[-1]) if pyenv else str(program))
    return programs


def built(folder: Path) -> Path:
    """The wheel of this clone."""
    call([sys.executable, "-m", "pip", "wheel", *QUIET, "--no-deps", "--no-build-isolation", "-w", folder, HERE.parent])
    (wheel,) = folder.glob("*.whl")
    return wheel


def passes(python: str, wheel: Path, environment: Path) -> bool:
    """Whether the tutorials pass in an environment of a Python; says its size too."""
    call([python, "-m", "venv", environment])
    own = environment / "bin" / "python"
    version = subprocess.run([own, "--version"], capture_output=True, text=True, check=True).stdout.strip()
    call([own, "-m", "pip", "install", *QUIET, wheel])
    print(f"{version}: {size(environment) / MEGABYTE:.0f} MiB", flush=True)
    call([own, "-m", "pip", "install", *QUIET, f"{wheel}[{EXTRA}]"])
    print(f"  with {EXTRA}: {size(environment) / MEGABYTE:.0f} MiB", flush=True)
    texts = [HERE.parent / "docs" / "tutorials" / f"{name}.md" for name in TUTORIALS]
    # -I: neither the folder that it happens to run in nor the user's packages count.
    return subprocess.run([own, "-I", "-c", RUN, HERE, *texts], cwd=environment, check=False).returncode == 0


def size(folder: Path) -> int:
    """Of all files under a folder [B], links aside."""
    return sum(path.lstat().st_size for path in folder.rglob("*") if path.is_file() and not path.is_symlink())


def call(argv: list[str | Path]) -> None:
    """Run a command that must not fail."""
    subprocess.run(argv, check=True)


if __name__ == "__main__":
    raise SystemExit(main())
