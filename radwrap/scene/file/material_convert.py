"""From the tables of materials to frozen values, and where a material may be."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

from radwrap.errors import InputError
from radwrap.scene.file import material_tables as tables
from radwrap.scene.file.material_files import read_brdf, read_coefficients, read_print
from radwrap.scene.file.source_convert import from_file
from radwrap.scene.materials import (
    Anisotropic,
    CoefficientTable,
    Glass,
    GlassBeads,
    Lambertian,
    Material,
    Mirror,
    PerturbedNormal,
    PrintedImage,
    PrintedSheeting,
    Sheeting,
    Specular,
)
from radwrap.scene.targets import Box, Disc, MeshPart, Polygon, Sheet, Target

# Materials that only some targets can have, and why.
_PLACES: Final[tuple[tuple[type, tuple[type, ...], str], ...]] = (
    (PrintedImage, (Sheet,), "an image can be printed only on a sheet"),
    (Mirror, (Sheet, Polygon, Disc, Box), "sources are followed only in flat mirrors"),
    (Glass, (Sheet, Polygon, Disc), "glass is a thin flat pane"),
)

# Normals this near to x (cosine) leave no direction on their face.
_ALONG: Final = 1 - 1e-9


def material_from_table(
    table: tables.MaterialModel, where: str, key: str, assumed: dict[str, str], folder: Path
) -> Material:
    """Convert a material.

    Raises
    ------
    InputError
        If its file is not what it should be.
    """
    match table:
        case tables.LambertianModel():
            return Lambertian(table.reflectance)
        case tables.SpecularModel():
            if isinstance(table.roughness, tuple):
                return Anisotropic(table.diffuse_reflectance, table.specular_reflectance, *table.roughness)
            return Specular(table.diffuse_reflectance, table.specular_reflectance, table.roughness)
        case tables.MirrorModel():
            return Mirror(table.reflectance)
        case tables.GlassModel():
            return Glass(table.transmittance, table.refractive_index)
        case tables.BrdfModel():
            return from_file(table.file, f"{where}.file", folder, read_brdf)
        case tables.PrintModel():
            black, white = table.black_reflectance, table.white_reflectance
            return from_file(
                table.file, f"{where}.file", folder, lambda path: read_print(path, table.encoding, black, white)
            )
    sheeting = _sheeting(table, where, key, assumed, folder)
    if table.print_coverage is None or table.print_reflectance is None:
        return sheeting
    return PrintedSheeting(sheeting, table.print_coverage, table.print_reflectance)


def _sheeting(
    table: tables.RetroreflectiveModel, where: str, key: str, assumed: dict[str, str], folder: Path
) -> Sheeting:
    if table.preset is not None:
        assumed[f"{key}.preset"] = f"{table.preset}: the least values of its class, not those of a sheet"
    if table.reflectance is not None and table.roughness is not None:
        return PerturbedNormal(table.reflectance, table.roughness)
    if table.outside is None:
        assumed[f"{key}.outside"] = "refuse"
    if table.anchor is not None:
        return GlassBeads(table.anchor, table.outside or "refuse")
    if table.interpolation is None:
        assumed[f"{key}.interpolation"] = "log"
    observation = tuple(abs(angle) for angle in table.observation_angles or ())
    entrance = tuple(abs(angle) for angle in table.entrance_angles or ())
    coefficient = table.coefficients or ()
    if table.file is not None:
        measured = from_file(table.file, f"{where}.file", folder, read_coefficients)
        observation, entrance, coefficient = measured.observation, measured.entrance, measured.coefficient
        if measured.rotations > 1:
            assumed[f"{key}.file"] = (
                f"the mean over {measured.rotations} rotation angles, from which single ones differ by up to "
                f"{measured.spread:.1%}"
            )
    return CoefficientTable(observation, entrance, coefficient, table.interpolation or "log", table.outside or "refuse")


def check_places(targets: tuple[Target, ...], materials: Mapping[str, Material], origin: str) -> None:
    """Refuse materials on targets that cannot have them.

    Raises
    ------
    InputError
        Naming the target's key.
    """
    for index, target in enumerate(targets):
        for key in ("material", "dot_material", "edge_material", "pattern_material"):
            material = materials.get(getattr(target, key, ""))
            for kind, fitting, why in _PLACES:
                if isinstance(material, kind) and not isinstance(target, fitting):
                    where = f"{origin}: targets[{index}].{key}"
                    raise InputError(why, where=where, remedy="use another material or target")
            if isinstance(material, Anisotropic) and _faces_its_grain(target):
                raise InputError(
                    f'a face of "{target.name}" looks along the target\'s x, where brushing has no direction',
                    where=f"{origin}: targets[{index}].{key}",
                    remedy="describe its sides as sheets with a direction of their own, or give one roughness",
                )


def _faces_its_grain(target: Target) -> bool:
    if isinstance(target, MeshPart):
        return bool((np.abs(target.mesh.normals[:, 0]) > _ALONG).any())
    return isinstance(target, Box)
