"""From the validated tables of a scene file to frozen values in SI."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Final

from radwrap.errors import InputError
from radwrap.nearest import did_you_mean
from radwrap.scene.camera import ASSUMED_WAVELENGTH, Aperture, Camera, Lens, image_distance
from radwrap.scene.distortion import Distortion, bounded, opencv_distortion
from radwrap.scene.file import document as tables
from radwrap.scene.file.glass_convert import glass_from_table
from radwrap.scene.file.material_convert import check_places, material_from_table
from radwrap.scene.file.mosaic_convert import mosaic_from_table
from radwrap.scene.file.optics_tables import LensModel
from radwrap.scene.file.pattern_convert import pattern_target
from radwrap.scene.file.poses import placed_pose, pose_of
from radwrap.scene.file.sensor_tables import PixelsModel
from radwrap.scene.file.sensor_values import sensor_from_table
from radwrap.scene.file.source_convert import sources_from_tables
from radwrap.scene.file.spectral import tells_spectra, with_spectra
from radwrap.scene.file.time_convert import check_dark_current, motions_of, shutter_of, strobes_of
from radwrap.scene.mesh import mesh_of
from radwrap.scene.scene import Scene
from radwrap.scene.sensor_part import binned, cropped, whole_region
from radwrap.scene.sources import Source
from radwrap.scene.targets import (
    Box,
    Cylinder,
    Disc,
    DotBoard,
    EdgeTarget,
    MeshPart,
    Polygon,
    RadFile,
    Sheet,
    Sphere,
    Target,
)
from radwrap.scene.tolerances import Tolerances

_DEFAULT_EXPOSURE_DIAMETER = 1e-4


def scene_from_model(
    model: tables.SceneModel, *, assumed: dict[str, str], origin: str, folder: Path, document: str
) -> Scene:
    """Convert a validated scene file.

    Raises
    ------
    InputError
        Where values that are right one by one do not go together.
    """
    names: set[str] = set()
    camera = camera_from_table(model.camera, f"{origin}: camera", assumed, folder, spectral=tells_spectra(model))
    sources = sources_from_tables(model.sources, camera.pose, assumed=assumed, origin=origin, folder=folder)
    target_names = _target_names(model, assumed)
    targets = tuple(
        target_from_table(table, name, f"{origin}: targets[{index}]", folder)
        for index, (table, name) in enumerate(zip(model.targets, target_names, strict=True))
    )
    for kind, things in (("sources", sources), ("targets", targets)):
        for index, thing in enumerate(things):
            if thing.name in names:
                raise InputError(f'the name "{thing.name}" is given twice', where=f"{origin}: {kind}[{index}].name")
            names.add(thing.name)
    _check_materials(targets, model.materials, origin)
    materials = {
        name: material_from_table(table, f"{origin}: materials.{name}", f"materials.{name}", assumed, folder)
        for name, table in model.materials.items()
    }
    check_places(targets, materials, origin)
    _check_splitter(sources, targets, origin)
    scene = Scene(
        camera=camera,
        sources=sources,
        materials=materials,
        targets=targets,
        tolerances=Tolerances(**model.tolerances.model_dump()) if model.tolerances else None,
        assumed=assumed,
        origin=origin,
        folder=folder,
        document=document,
        motions=motions_of(model.targets, target_names),
        strobes=strobes_of(model.sources),
    )
    check_dark_current(scene, assumed)
    scene = with_spectra(scene, model)
    _check_wavelength(scene, assumed)
    return scene


# Below f/2, and behind openings of so few wavelengths, light's polarisation and its angles count.
_WIDEST_PARAXIAL: Final = 2.0
_SMALLEST_SCALAR: Final = 20.0


def _check_wavelength(scene: Scene, assumed: dict[str, str]) -> None:
    """See that one wavelength is told of the light, at most, and name the one that is taken where none is."""
    camera = scene.camera
    if scene.spectral is not None and camera.wavelength is not None:
        raise InputError(
            "the scene's spectra give the wavelength already",
            where=f"{scene.origin}: camera.wavelength",
            remedy="leave it out",
        )
    told = scene.spectral is not None or camera.sensor.linear is not None or camera.wavelength is not None
    if not told and not camera.aperture.is_infinitesimal:
        assumed["camera.wavelength"] = f"{ASSUMED_WAVELENGTH * 1e9:g} nm"
    if camera.diffraction is None:
        return
    wavelength = camera.wavelength or ASSUMED_WAVELENGTH
    if scene.spectral is not None:
        wavelength = scene.spectral.wavelength
    elif camera.sensor.linear is not None:
        wavelength = camera.sensor.linear.wavelength
    diameter = camera.aperture.diameter
    if camera.image_distance < _WIDEST_PARAXIAL * diameter or diameter < _SMALLEST_SCALAR * wavelength:
        assumed["camera.diffraction.model"] = "scalar, paraxial waves, near or beyond where they hold"


def _check_splitter(sources: tuple[Source, ...], targets: tuple[Target, ...], origin: str) -> None:
    for index, target in enumerate(targets):
        if isinstance(target, RadFile) and any(getattr(source, "kind", "") == "coaxial" for source in sources):
            raise InputError(
                "an included file may hold light, which the beam splitter of a coaxial source would dim",
                where=f"{origin}: targets[{index}]",
                remedy="describe it by targets and sources",
            )


def _check_materials(targets: tuple[Target, ...], materials: Mapping[str, object], origin: str) -> None:
    for index, target in enumerate(targets):
        for key in ("material", "dot_material", "edge_material", "pattern_material"):
            name = getattr(target, key, None)
            if name is not None and name not in materials:
                raise InputError(
                    f'no material "{name}"',
                    where=f"{origin}: targets[{index}].{key}",
                    remedy=did_you_mean(name, materials) or f"define [materials.{name}]",
                )


def _target_names(model: tables.SceneModel, assumed: dict[str, str]) -> list[str]:
    """Names of the targets; one that has none gets its number, another one where that name is taken."""
    taken = {thing.name for thing in (*model.sources, *model.targets) if thing.name}
    names = []
    for index, table in enumerate(model.targets):
        free = (f"target{number}" for number in count(index))
        name = table.name or next(name for name in free if name not in taken)
        if table.name is None:
            assumed[f"targets[{index}].name"] = name
            taken.add(name)
        names.append(name)
    return names


def camera_from_table(
    table: tables.CameraModel, where: str, assumed: dict[str, str], folder: Path, *, spectral: bool
) -> Camera:
    """Convert a validated ``[camera]``, whose files lie in a folder, of a scene that tells spectra or does not.

    Raises
    ------
    InputError
        Where values that are right one by one do not go together.
    """
    sensor = table.sensor
    opening = table.aperture
    if table.lens is not None and table.lens.f_number is not None:
        assumed.pop("camera.aperture.diameter", None)  # the lens tells it
    if opening.diameter == 0 and opening.exposure_diameter is None:
        assumed["camera.aperture.exposure_diameter"] = "0.1 mm"
    if opening.shape in ("round", "annular"):
        assumed.pop("camera.aperture.rotation", None)  # it changes nothing
    centre = ((sensor.columns - 1) / 2, (sensor.rows - 1) / 2)
    principal_point = table.principal_point or centre
    if table.principal_point is None:
        assumed["camera.principal_point"] = f"[{centre[0]:g} px, {centre[1]:g} px]"
    camera = Camera(
        pose=pose_of(table, where, "camera", assumed),
        focal_length=table.focal_length,
        principal_point=principal_point,
        exposure_time=table.exposure_time,
        aperture=Aperture(
            shape=opening.shape,
            diameter=table.opening_diameter,
            inner_diameter=opening.inner_diameter or 0.0,
            rotation=opening.rotation,
            exposure_diameter=opening.exposure_diameter or _DEFAULT_EXPOSURE_DIAMETER,
        ),
        sensor=replace(
            sensor_from_table(sensor, table.exposure_time, f"{where}.sensor", spectral=spectral),
            mosaic=mosaic_from_table(sensor, f"{where}.sensor", folder),
            shutter=shutter_of(sensor),
        ),
        distortion=_distortion(table, centre, where),
        lens=None
        if table.lens is None
        else _lens(table.lens, table, principal_point, f"{where}.lens", assumed=assumed, folder=folder),
        wavelength=table.wavelength,
        diffraction=None if table.diffraction == "off" or not table.opening_diameter else table.diffraction,
    )
    return _part_of(camera, sensor, assumed)


def _part_of(camera: Camera, table: PixelsModel, assumed: dict[str, str]) -> Camera:
    """The part of the sensor that is read out, by pixels as large as its scale says; all else is of the whole one."""
    number, region = table.binned_pixels, table.region
    if number == 1:
        return camera if table.roi is None else cropped(camera, region)
    whole = whole_region(region, number)
    if whole != region:
        assumed["camera.sensor.roi"] = str(list(whole))
    linear = camera.sensor.linear
    if linear is not None and (linear.hot_share or linear.dead_share):
        assumed["camera.sensor.defects"] = "none, as pixels are scaled"
    return binned(cropped(camera, whole), number)


def _distortion(table: tables.CameraModel, centre: tuple[float, float], where: str) -> Distortion | None:
    """The lens's distortion, where it has any, and how far it holds."""
    told, sensor = table.distortion, table.sensor
    if told is None:
        return None
    lens = table.lens
    f = table.focal_length if lens is None else image_distance(table.focal_length, lens.focus_distance)
    if told.kappa1 is not None:
        found = Distortion("tsai", (told.kappa1 * f**2,))
    else:
        radial_and_tangential = (told.k1, told.k2, told.p1, told.p2, told.k3, told.k4, told.k5, told.k6)
        values = (*radial_and_tangential, told.s1, told.s2, told.s3, told.s4)
        found = opencv_distortion(tuple(value or 0.0 for value in values))
    if not any(found.coefficients):
        return None
    cu, cv = table.principal_point or centre
    across = max(cu + 0.5, sensor.columns - 0.5 - cu, 0.0) * sensor.pixel_width
    down = max(cv + 0.5, sensor.rows - 0.5 - cv, 0.0) * sensor.pixel_height
    return bounded(found, math.hypot(across, down) / f, f"{where}.distortion")


def _lens(
    table: LensModel,
    camera: tables.CameraModel,
    principal_point: tuple[float, float],
    where: str,
    *,
    assumed: dict[str, str],
    folder: Path,
) -> Lens:
    illumination, sensor = table.relative_illumination, camera.sensor
    across, down = (
        max(centre + 0.5, count - 0.5 - centre) * pitch
        for centre, count, pitch in zip(
            principal_point,
            (sensor.columns, sensor.rows),
            (sensor.pixel_width, sensor.pixel_height),
            strict=True,
        )
    )
    corner = math.hypot(across, down)
    if illumination is not None:
        if corner > illumination[-1][0]:
            raise InputError(
                f"ends {illumination[-1][0] * 1e3:g} mm from the axis, the sensor at {corner * 1e3:.4g} mm",
                where=f"{where}.relative_illumination",
                remedy="add a height as large as that, or take a lens that covers the sensor",
            )
    elif table.falloff is None:
        assumed["camera.lens.falloff"] = "cos4"
    elif table.falloff == "none":
        illumination = ((0.0, 1.0),)
    glass = glass_from_table(table, camera, corner, where, folder=folder, assumed=assumed)
    return Lens(table.focus_distance, table.transmission, illumination, glass)


def _part(table: tables.PartModel, name: str, where: str, folder: Path) -> MeshPart:
    """A mesh with equal vertices joined, without triangles of no area, its neighbours wound alike."""
    from radwrap.scene.mesh_files.parts import cleaned, joined, read_part_file
    from radwrap.scene.mesh_files.winding import wound

    found = read_part_file(folder / table.part, folder=folder, length_unit=table.length_unit, where=f"{where}.part")
    vertices, faces, _ = cleaned(*joined(found.groups))
    if not len(faces):
        raise InputError("its triangles have no area", where=f"{where}.part", remedy="name another file")
    order = wound(vertices, faces)
    mesh = mesh_of(vertices, order.faces)
    told = f"{found.sha256}:{table.length_unit!r}"
    lean = max(found.leaning.values(), default=0.0)
    return MeshPart(name, placed_pose(table), table.material, table.part, told, mesh, order.closed, lean)


def target_from_table(table: tables.TargetModel, name: str, where: str, folder: Path) -> Target:
    """Convert a validated entry of ``[[targets]]``.

    Raises
    ------
    InputError
        If its file cannot be read, or values that are right one by one do not go together.
    """
    pose = placed_pose(table)
    match table:
        case tables.PartModel():
            return _part(table, name, where, folder)
        case tables.SheetModel():
            return Sheet(name, pose, table.material, *table.size)
        case tables.BoardModel():
            return DotBoard(
                name,
                pose,
                table.material,
                table.dot_material,
                table.rows,
                table.columns,
                table.pitch,
                table.dot_diameter,
                table.margin,
            )
        case tables.EdgeModel():
            return EdgeTarget(name, pose, table.material, table.edge_material, *table.size, table.edge_position)
        case tables.PolygonModel():
            return Polygon(name, pose, table.material, table.vertices)
        case tables.DiscModel():
            return Disc(name, pose, table.material, table.diameter)
        case tables.SphereModel():
            return Sphere(name, pose, table.material, table.diameter)
        case tables.CylinderModel():
            return Cylinder(name, pose, table.material, table.diameter, table.length)
        case tables.BoxModel():
            return Box(name, pose, table.material, table.size)
        case tables.RadModel():
            return RadFile(name, pose, table.rad, table.length_unit)
        case _:
            return pattern_target(table, name, where)
