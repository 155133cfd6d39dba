"""One image of a light basis: other levels of its sources, another exposure time, other electronics of the sensor."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.imaging.other_camera import basis_in_other_camera, scene_text_of
from radwrap.imaging.output.assumed_values import AssumedEffect, Assumptions, effects_of, with_assumed_level
from radwrap.imaging.output.folder import PLANES
from radwrap.imaging.output.run_manifest import RunManifest, read_run_manifest
from radwrap.imaging.raw_relighting import RawBasis, raw_relit, read_raw_basis
from radwrap.imaging.relight.levels import levels_of
from radwrap.imaging.relight.relit import Basis, Relit, read_basis, relit
from radwrap.imaging.relight.relit_uncertainty import relit_uncertainty
from radwrap.imaging.timed_basis import MovingBasis, moving_relit, read_timed_basis
from radwrap.imaging.tolerance.uncertainty import Uncertainty
from radwrap.scene.catalog.presets import with_presets
from radwrap.scene.file.load import camera_with
from radwrap.scene.mosaic import Colour

_NOTHING: Final[Mapping[str, Any]] = {}


def relight(
    folder: str | Path,
    levels: Mapping[str, float] = _NOTHING,
    changes: Mapping[str, Any] = _NOTHING,
    *,
    scene_folder: str | Path | None = None,
) -> Relit:
    """Make an image of a light basis without a ray, as ``radwrap relight`` does: the same gray levels and error.

    Parameters
    ----------
    folder : str or Path
        Of a render with ``basis=True``.
    levels : Mapping[str, float]
        Name of a source, or of a ring for all its LEDs -> factor on its radiance in the scene; what comes later
        replaces what came before, and what is not named stays as it is.
    changes : Mapping
        Keys of the scene file with other values: the exposure time and the sensor's electronics, such as
        ``{"camera.exposure_time": "64 ms"}``.
    scene_folder : str or Path, optional
        Of the scene file; needed with changes where its camera names a data sheet or a calibration.

    Returns
    -------
    Relit
        ``gray``, ``radiant_exposure`` [J m^-2], and ``certificate``, measured anew in this light and camera.

    Raises
    ------
    InputError
        If the folder holds no whole basis, a name is unknown, a value is wrong, or a change needs rays.

    Examples
    --------
    >>> import radwrap
    >>> made = radwrap.render(radwrap.load_scene("scene.toml"), "lit", tolerance=8, basis=True)
    >>> dimmer = radwrap.relight("lit", {"ring": 0.5}, {"camera.exposure_time": "64 ms"})
    >>> bool(dimmer.gray.values.mean() < made.gray.values.mean())
    True
    """
    folder = Path(folder)
    for name, told in (("levels", levels), ("changes", changes)):
        if not isinstance(told, Mapping):
            raise InputError("must be a dict", where=name, remedy='such as {"ring": 0.5}' if name == "levels" else None)
    basis = basis_of(folder, changes, None if scene_folder is None else Path(scene_folder))
    factors = levels_of([_told(name, factor) for name, factor in levels.items()], basis.sources, basis.dark)
    return next(images_of(basis, np.array([factors]))).image


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """An image of a basis, and what is known of it.

    Attributes
    ----------
    image : Relit
    uncertainty : Uncertainty
        How far a captured frame may be off.
    met : bool
        Whether it keeps the tolerance that the basis was made for.
    colours : Mapping of str to Relit
        Of a raw image those it is composed of.
    """

    image: Relit
    uncertainty: Uncertainty
    met: bool
    colours: Mapping[Colour, Relit]


def basis_of(
    folder: Path, changes: Mapping[str, Any] = _NOTHING, scene_folder: Path | None = None
) -> Basis | RawBasis | MovingBasis:
    """The basis in a folder, or those of a mosaic's colours, or of instants, in another camera where keys are changed.

    Raises
    ------
    InputError
        As `relight`.
    """
    run = run_in(folder)
    if run is not None and run.mosaic is not None:
        return read_raw_basis(folder, run, changes, scene_folder)
    if run is None and (folder / PLANES).is_dir():
        raise InputError(
            "holds colours of an unfinished render", where=str(folder), remedy="render again with the same command"
        )
    if run is not None and run.in_time is not None:
        return read_timed_basis(folder, run, changes, scene_folder)
    basis = read_basis(folder)
    return basis_in_other_camera(basis, scene_text_of(folder, basis, scene_folder), changes) if changes else basis


def images_of(basis: Basis | RawBasis | MovingBasis, factors: NDArray[np.float64]) -> Iterator[Shown]:
    """Images for any levels of the sources, shape (images, sources); errors as `relit`."""
    if isinstance(basis, RawBasis):
        for raw in raw_relit(basis, factors):
            yield Shown(raw.image, raw.uncertainty, raw.keeps(basis), raw.colours)
        return
    if isinstance(basis, MovingBasis):
        for moving in moving_relit(basis, factors):
            yield Shown(moving.image, moving.uncertainty, moving.keeps, {})
        return
    for levels, image in zip(factors, relit(basis, factors), strict=True):
        yield Shown(image, relit_uncertainty(basis, levels, image), image.keeps(basis), {})


def assumptions_of(
    folder: Path,
    basis: Basis | RawBasis | MovingBasis,
    changes: Mapping[str, Any] = _NOTHING,
    scene_folder: Path | None = None,
) -> Assumptions | None:
    """What images of a basis hang on that nobody published.

    None where that is not known any more: its run's manifest is gone, a component is another one by now, or cannot be
    found from here; and of raw images and of what moves.
    """
    run = run_in(folder)
    if run is None or not isinstance(basis, Basis) or run.scene_sha256 != basis.scene_sha256:
        return None
    try:
        return assumptions_of_run(run, scene_folder or folder, changes)
    except InputError:
        return None


def assumptions_of_run(run: RunManifest, folder: Path, changes: Mapping[str, Any] = _NOTHING) -> Assumptions:
    """What the image of a run hangs on that nobody published, from its manifest.

    Parameters
    ----------
    run : RunManifest
        The run's manifest.
    folder : Path
        Where files lie that its camera names, and components that its scene's folder has.
    changes : Mapping
        Keys of the camera with other values, as of `relight`.

    Raises
    ------
    InputError
        If a component is another one by now, or a file or component cannot be found from here.
    """
    spectral = run.bands is not None
    other = camera_with(run.scene, changes, origin="scene", folder=folder, spectral=spectral)
    tables = json.loads(run.scene)["sources"]
    taken = (*other.components, *with_presets({"sources": tables}, "scene", folder)[1])
    known = {one.key: one.sha256 for one in run.components or ()}
    for one in taken:
        if known.get(one.key, one.component.sha256) != one.component.sha256:
            raise InputError(
                f'"{one.component.name}" is another component than the run took',
                where=one.key,
                remedy="render the scene again",
            )
    names = tuple(table["name"] for table in tables)
    return Assumptions(other.camera.sensor, taken, names, other.document, "scene", folder, spectral)


def effects_of_levels(
    basis: Basis, told: Assumptions, factors: NDArray[np.float64], shown: Shown
) -> tuple[AssumedEffect, ...]:
    """How an image of a basis changes over the range of each assumed value, the level of each source included.

    Parameters
    ----------
    basis : Basis
        Of which the image was made.
    told : Assumptions
        As `assumptions_of` gives it.
    factors : ndarray, shape (sources,)
        Levels of the image.
    shown : Shown
        The image.
    """
    return effects_of(told, shown.image.radiant_exposure.values, lights_of_levels(basis, told, factors))


def lights_of_levels(
    basis: Basis, told: Assumptions, factors: NDArray[np.float64] | None = None
) -> dict[str, NDArray[np.float64]]:
    """Light of each source whose level is assumed, of a basis; arguments as `effects_of_levels`.

    Returns
    -------
    dict of str to ndarray, shape (rows, columns)
        Name of a source -> its part of the exposure [J m^-2]; without factors, as it was rendered.
    """
    parts: dict[str, NDArray[np.float64]] = {}
    levels = np.ones(len(basis.sources)) if factors is None else factors
    for name in with_assumed_level(told):
        mine = np.array([source == name or source.startswith(f"{name}.") for source in basis.sources])
        (alone,) = relit(basis, np.where(mine, levels, 0.0)[np.newaxis])
        parts[name] = alone.radiant_exposure.values
    return parts


def run_in(folder: Path) -> RunManifest | None:
    """The run that left a folder, where its manifest is there and can be read."""
    try:
        return read_run_manifest(folder)
    except InputError:
        return None


def _told(name: str, factor: float) -> str:
    """As the command has it."""
    if isinstance(factor, bool) or not isinstance(factor, int | float | np.integer | np.floating):
        raise InputError("must be a number", where=f'levels["{name}"]')
    return f"{name}={float(factor)!r}"
