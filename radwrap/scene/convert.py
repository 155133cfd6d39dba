"""From the validated tables of a scene file to frozen values in SI."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import count
from pathlib import Path

from radwrap.errors import InputError
from radwrap.scene import document as tables
from radwrap.scene.camera import Aperture, Camera, Sensor
from radwrap.scene.material_convert import check_places, material_from_table
from radwrap.scene.mesh import mesh_of
from radwrap.scene.poses import placed_pose, pose_of
from radwrap.scene.scene import Scene
from radwrap.scene.source_convert import sources_from_tables
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
from radwrap.units import parse_gain

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
    camera = _camera(model.camera, f"{origin}: camera", assumed)
    sources = sources_from_tables(model.sources, camera.pose, assumed=assumed, origin=origin, folder=folder)
    target_names = _target_names(model, assumed)
    targets = tuple(
        _part(table, name, f"{origin}: targets[{index}]", folder)
        if isinstance(table, tables.PartModel)
        else _target(table, name)
        for index, (table, name) in enumerate(zip(model.targets, target_names, strict=True))
    )
    for kind, things in (("sources", sources), ("targets", targets)):
        for index, thing in enumerate(things):
            if thing.name in names:
                raise InputError(f'the name "{thing.name}" stands there twice', where=f"{origin}: {kind}[{index}].name")
            names.add(thing.name)
    _check_materials(targets, model.materials, origin)
    materials = {
        name: material_from_table(table, f"{origin}: materials.{name}", f"materials.{name}", assumed, folder)
        for name, table in model.materials.items()
    }
    check_places(targets, materials, origin)
    _check_splitter(sources, targets, origin)
    return Scene(
        camera=camera,
        sources=sources,
        materials=materials,
        targets=targets,
        assumed=assumed,
        origin=origin,
        folder=folder,
        document=document,
    )


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
        for key in ("material", "dot_material", "edge_material"):
            name = getattr(target, key, None)
            if name is not None and name not in materials:
                raise InputError(
                    f'no material "{name}"',
                    where=f"{origin}: targets[{index}].{key}",
                    remedy=f"define [materials.{name}]",
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


def _camera(table: tables.CameraModel, where: str, assumed: dict[str, str]) -> Camera:
    sensor = table.sensor
    opening = table.aperture
    if opening.diameter == 0 and opening.exposure_diameter is None:
        assumed["camera.aperture.exposure_diameter"] = "0.1 mm"
    if opening.shape in ("round", "annular"):
        assumed.pop("camera.aperture.rotation", None)  # it changes nothing
    centre = ((sensor.columns - 1) / 2, (sensor.rows - 1) / 2)
    if table.principal_point is None:
        assumed["camera.principal_point"] = f"[{centre[0]:g} px, {centre[1]:g} px]"
    return Camera(
        pose=pose_of(table, where, "camera", assumed),
        focal_length=table.focal_length,
        principal_point=table.principal_point or centre,
        exposure_time=table.exposure_time,
        aperture=Aperture(
            shape=opening.shape,
            diameter=opening.diameter,
            inner_diameter=opening.inner_diameter or 0.0,
            rotation=opening.rotation,
            exposure_diameter=opening.exposure_diameter or _DEFAULT_EXPOSURE_DIAMETER,
        ),
        sensor=Sensor(
            rows=sensor.rows,
            columns=sensor.columns,
            pixel_width=sensor.pixel_width,
            pixel_height=sensor.pixel_height,
            gain=parse_gain(sensor.gain)[0],
            gamma=sensor.gamma,
            dark_gray=sensor.dark_gray,
            saturation_gray=sensor.saturation_gray,
            bit_depth=sensor.bit_depth,
            rounding=sensor.rounding,
            channel=sensor.channel,
        ),
    )


def _part(table: tables.PartModel, name: str, where: str, folder: Path) -> MeshPart:
    """A mesh with equal vertices joined, without triangles of no area, its neighbours wound alike."""
    from radwrap.scene.parts import cleaned, joined, read_part_file
    from radwrap.scene.winding import wound

    found = read_part_file(folder / table.part, folder=folder, length_unit=table.length_unit, where=f"{where}.part")
    vertices, faces, _ = cleaned(*joined(found.groups))
    if not len(faces):
        raise InputError("its triangles have no area", where=f"{where}.part", remedy="name another file")
    order = wound(vertices, faces)
    mesh = mesh_of(vertices, order.faces)
    told = f"{found.sha256}:{table.length_unit!r}"
    return MeshPart(name, placed_pose(table), table.material, table.part, told, mesh, order.closed)


def _target(table: tables.TargetModel, name: str) -> Target:
    pose = placed_pose(table)
    match table:
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
    raise TypeError(f"{type(table).__name__} is read with its file")
