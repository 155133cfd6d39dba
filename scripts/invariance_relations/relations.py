"""The table of relations: what each does, what must hold, where, and why only there. It stands before any run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, Literal

import numpy as np

from invariance_relations import rewriting, rigid
from invariance_relations.documents import Written

Array = np.ndarray[Any, Any]
Rewriting = Callable[[Written, np.random.Generator], Written | None]


def _everywhere(_: Written) -> bool:
    return True


def _as_it_is(image: Array) -> Array:
    return image


@dataclass(frozen=True, slots=True)
class Relation:
    """One relation.

    Attributes
    ----------
    rewrite : Callable
        The scene rewritten; None where it holds nothing of the kind.
    holds : str
        "to the byte", or "within bounds": rms difference below the sum of both 95 % bounds.
    domain : str
        Where it is asked for, and why only there.
    in_domain : Callable
        Whether a scene lies in the domain.
    image : Callable
        The first image as the second one shows it.
    recut : bool
        Whether wide sources may be cut otherwise, so that their `irradiance_error` is part of the bounds.
    seed : int
        What is added to the seed of the second image.
    """

    rewrite: Rewriting
    holds: Literal["to the byte", "within bounds"]
    domain: str
    in_domain: Callable[[Written], bool] = _everywhere
    image: Callable[[Array], Array] = _as_it_is
    recut: bool = False
    seed: int = 0


def _no_dark_current(written: Written) -> bool:
    return "dark_current" not in written.camera["sensor"]


def _no_splitter(written: Written) -> bool:
    return not written.has_source("coaxial")


def _all_around_is_free(written: Written) -> bool:
    return not written.has_source("surround") and not written.has_material("mirror", "glass")


RELATIONS: Final[Mapping[str, Relation]] = MappingProxyType(
    {
        "moved": Relation(
            rigid.moved,
            "within bounds",
            "all scenes, by 1 mm to 1 km; included files and meshes move by their pose",
            recut=True,
        ),
        "turned": Relation(
            rigid.turned,
            "within bounds",
            "all scenes; a ring's misalignment, which is told about the world's axes, goes into its rotation",
            recut=True,
        ),
        "mirrored": Relation(
            rigid.mirrored,
            "within bounds",
            "all scenes; prints, luminaires, meshes, included files, windings, openings, distortion, sensitivities "
            "and principal point are mirrored too, as each has a left and a right",
            image=np.fliplr,
            recut=True,
        ),
        "rolled": Relation(
            rigid.rolled,
            "within bounds",
            "all scenes; rows and columns change places in all that tells them apart",
            image=np.rot90,
            recut=True,
        ),
        "resized": Relation(
            rewriting.resized,
            "within bounds",
            "all scenes, by 1/100 to 100, defaults written out; intensities and fluxes with the square. A linear "
            "camera counts photons of the pixel's area: there by 1 to 100, quantum efficiency divided by the square",
            recut=True,
        ),
        "units": Relation(
            rewriting.in_other_units, "to the byte", "all scenes; powers of ten, which are the same number when read"
        ),
        "poses": Relation(
            rewriting.otherwise_posed,
            "within bounds",
            "all scenes; sines and cosines are rounded, so not to the byte",
            recut=True,
        ),
        "materials_order": Relation(
            rewriting.materials_in_another_order, "to the byte", "scenes of two materials or more"
        ),
        "sources_order": Relation(
            rewriting.sources_in_another_order,
            "within bounds",
            "scenes of two sources or more; their light is summed in another order, so not to the byte",
        ),
        "targets_order": Relation(
            rewriting.targets_in_another_order,
            "within bounds",
            "scenes of two targets or more; wide sources are cut by points of the targets, taken in another order",
            recut=True,
        ),
        "split": Relation(
            rewriting.split,
            "within bounds",
            "scenes without a coaxial light, of whose splitter there is but one; two of half the radiance in the same "
            "place, or a rectangle as two halves, a ring as every other LED",
            in_domain=_no_splitter,
            recut=True,
        ),
        "cut": Relation(
            rewriting.cut,
            "within bounds",
            "scenes with a sheet that bears no print, as a print is stretched over its sheet",
            recut=True,
        ),
        "mesh": Relation(
            rewriting.box_as_mesh,
            "within bounds",
            "scenes with a box; the mesh has its corners",
            recut=True,
        ),
        "part_outside": Relation(
            rewriting.with_a_part_outside,
            "within bounds",
            "scenes without mirrors, glass and a surround, in which a part outside the view is seen or casts a shadow",
            in_domain=_all_around_is_free,
            recut=True,
        ),
        "exposure": Relation(
            rewriting.longer_and_dimmer,
            "within bounds",
            "scenes without dark current, which flows for the exposure time",
            in_domain=_no_dark_current,
        ),
        "seeds": Relation(rewriting.unchanged, "within bounds", "all scenes", seed=1_000_003),
    }
)
