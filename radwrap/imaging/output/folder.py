"""The folder of a run: whether it is whole, and how a new run's files take the place of an older one's."""

from __future__ import annotations

import shutil
from collections.abc import Collection, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

from radwrap.errors import InputError
from radwrap.files import move_files, sha256_of
from radwrap.imaging.forecast import photo_realistic
from radwrap.imaging.methods.pieces import remove_pieces
from radwrap.imaging.output.colour_picture import COLOUR
from radwrap.imaging.output.image_files import EXPOSURE, GRAY, PREVIEW, UNROUNDED
from radwrap.imaging.output.run_manifest import MANIFEST, read_run_manifest
from radwrap.imaging.output.sigma_file import SIGMA
from radwrap.imaging.output.truth_files import DEPTH, PARTS, TRUTH
from radwrap.imaging.relight.basis import BASIS
from radwrap.imaging.relight.basis_files import FOLDER
from radwrap.imaging.response.noise import frames_in
from radwrap.imaging.run_files import BASES, TIMED_BASIS
from radwrap.imaging.tolerance.kept_replicates import REPLICATES
from radwrap.scene.mosaic import COLOURS, Colour

# Folder of a mosaic's colours: the run of each, as of a monochrome camera behind its filter.
PLANES: Final = "planes"
# Folder of a moving scene's renders while they are made.
INSTANTS: Final = ".instants"
# What every run leaves, and what some do.
ALWAYS: Final = (EXPOSURE, GRAY, MANIFEST)
_SOMETIMES: Final = (PREVIEW, UNROUNDED, SIGMA, DEPTH, PARTS, TRUTH, REPLICATES, COLOUR, *photo_realistic.FILES)


def is_whole(folder: Path, run_sha256: str | None = None) -> bool:
    """Whether a run lies there, every file of it as its manifest says: any run, or the one of this hash."""
    try:
        known = read_run_manifest(folder)
        if run_sha256 not in (None, known.run_sha256):
            return False
        return all(sha256_of(folder / name) == sha256 for name, sha256 in known.files.items())
    except (InputError, OSError):
        return False


def publish(made: Path, folder: Path, files: Sequence[str], planes: Collection[Colour] = ()) -> None:
    """Put whole files in place of an older run's, which stood until now: a disk that fills loses none.

    Parameters
    ----------
    made, folder : Path
        Where the files are, and where they go to.
    files : sequence of str
        Their names.
    planes : collection of str
        Colours of a mosaic whose own runs lie in the folder and stay.
    """
    _remove_old(folder)
    _remove_planes(folder / PLANES, planes)
    move_files(made, folder, files)
    move_files(made, folder, [MANIFEST])


def _remove_old(folder: Path) -> None:
    """From here on an old manifest no longer fits the files, and what only an older run wrote fits nothing."""
    if (folder / BASIS).exists():
        remove_pieces(folder / FOLDER)
    if (folder / TIMED_BASIS).exists():
        shutil.rmtree(folder / BASES, ignore_errors=True)
    shutil.rmtree(folder / INSTANTS, ignore_errors=True)
    for name in (MANIFEST, BASIS, TIMED_BASIS, *_SOMETIMES, *frames_in(folder)):
        (folder / name).unlink(missing_ok=True)


def _remove_planes(folder: Path, stay: Collection[Colour]) -> None:
    """Remove the runs of colours that an older run had and this one has not."""
    for colour in COLOURS:
        if colour not in stay:
            shutil.rmtree(folder / colour, ignore_errors=True)
    with suppress(OSError):  # it is not there, or not empty
        folder.rmdir()
