"""From the validated tables of a scene file to frozen values in SI."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from itertools import count
from pathlib import Path

from radwrap.errors import InputError
from radwrap.frames import Pose, aim, default_up, normalised, rotation_about_fixed_axes
from radwrap.scene import document as tables
from radwrap.scene.camera import Aperture, Camera, Lens, image_distance
from radwrap.scene.distortion import Distortion, bounded, opencv_distortion
from radwrap.scene.material_tables import LambertianModel, MaterialModel, SpecularModel
from radwrap.scene.materials import (
    CoefficientTable,
    GlassBeads,
    Lambertian,
    Material,
    PerturbedNormal,
    Specular,
)
from radwrap.scene.mesh import mesh_of
from radwrap.scene.optics_tables import LensModel
from radwrap.scene.ring_calibration import read_calibration
from radwrap.scene.scene import Scene
from radwrap.scene.sensor_values import sensor_from_table
from radwrap.scene.sources import (
    Beam,
    Emitter,
    LedChange,
    Ring,
    SingleSource,
    Source,
    cosine_power_spread,
    gaussian_spread,
)
from radwrap.scene.spectral import axial_radiance, with_spectra
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
_ORIGIN = (0.0, 0.0, 0.0)


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
    sources = tuple(
        _source(table, f"{origin}: sources[{i}]", f"sources[{i}]", assumed, folder)
        for i, table in enumerate(model.sources)
    )
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
    scene = Scene(
        camera=_camera(model.camera, f"{origin}: camera", assumed),
        sources=sources,
        materials={name: _material(table, f"materials.{name}", assumed) for name, table in model.materials.items()},
        targets=targets,
        tolerances=Tolerances(**model.tolerances.model_dump()) if model.tolerances else None,
        assumed=assumed,
        origin=origin,
        folder=folder,
        document=document,
    )
    return with_spectra(scene, model)


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


def _pose(table: tables.Aimed, where: str, key: str, assumed: dict[str, str], *, has_roll: bool = True) -> Pose:
    """Pose of a camera or a source; a single disc has no roll, so nothing is assumed of it."""
    position = table.position or getattr(table, "translation", None)
    if position is None:
        raise InputError("is missing", where=f"{where}.position")
    if table.rotation is not None:
        if table.rotation_order is None:
            assumed[f"{key}.rotation_order"] = "xyz"
        return Pose(position, rotation_about_fixed_axes(table.rotation, table.rotation_order or "xyz"))
    look_at = table.look_at or _ORIGIN
    try:
        up = default_up(position, look_at)
    except ValueError as error:
        raise InputError(
            "is the position itself: a direction needs a length above zero",
            where=f"{where}.look_at",
            remedy="look at another point",
        ) from error
    if table.up is None and has_roll:
        assumed[f"{key}.up"] = f"[{', '.join(f'{value:g}' for value in up)}]"
    try:
        return aim(position, look_at, table.up)
    except ValueError as error:
        raise InputError(str(error), where=f"{where}.up", remedy="choose another up") from error


def _placed(table: tables.Placed) -> Pose:
    return Pose(table.position, rotation_about_fixed_axes(table.rotation, table.rotation_order))


def _camera(table: tables.CameraModel, where: str, assumed: dict[str, str]) -> Camera:
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
    return Camera(
        pose=_pose(table, where, "camera", assumed),
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
        sensor=sensor_from_table(sensor, table.exposure_time, f"{where}.sensor"),
        distortion=_distortion(table, centre, where),
        lens=None if table.lens is None else _lens(table.lens, table, principal_point, f"{where}.lens", assumed),
    )


def _distortion(table: tables.CameraModel, centre: tuple[float, float], where: str) -> Distortion | None:
    """The lens's distortion, where it has any, and how far it holds."""
    told, sensor = table.distortion, table.sensor
    if told is None:
        return None
    lens = table.lens
    f = table.focal_length if lens is None else image_distance(table.focal_length, lens.focus_distance)
    if lens is not None and (lens.relative_illumination is not None or lens.falloff == "none"):
        raise InputError(
            "a measured or missing falloff holds what the distortion does to the light too",
            where=f"{where}.distortion",
            remedy='leave out one of them, or set falloff = "cos4"',
        )
    if told.kappa1 is not None:
        found = Distortion("tsai", (told.kappa1 * f**2,))
    else:
        values = (told.k1, told.k2, told.p1, told.p2, told.k3, told.k4, told.k5, told.k6)
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
    assumed: dict[str, str],
) -> Lens:
    illumination = table.relative_illumination
    if illumination is not None:
        sensor = camera.sensor
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
        if corner > illumination[-1][0]:
            raise InputError(
                f"ends {illumination[-1][0] * 1e3:g} mm from the axis, the sensor at {corner * 1e3:.4g} mm",
                where=f"{where}.relative_illumination",
                remedy="add a height as large as that",
            )
    elif table.falloff is None:
        assumed["camera.lens.falloff"] = "cos4"
    elif table.falloff == "none":
        illumination = ((0.0, 1.0),)
    return Lens(table.focus_distance, table.transmission, illumination)


def _beam(table: tables.BeamModel, where: str, key: str, assumed: dict[str, str]) -> Beam:
    if table.profile == "lambertian" or table.width is None:
        return Beam("lambertian")
    if table.width_definition is None:
        assumed[f"{key}.beam.width_definition"] = "fwhm"
    definition = table.width_definition or "fwhm"
    if table.profile == "gaussian":
        return Beam("gaussian", gaussian_spread(table.width, definition))
    if table.profile == "cosine_power":
        if definition != "sigma" and table.width / (1 if definition == "half_angle" else 2) >= math.pi / 2:
            raise InputError("a power of the cosine is dark from 90 degrees on", where=f"{where}.beam.width")
        return Beam("cosine_power", cosine_power_spread(table.width, definition))
    half = table.width if definition == "half_angle" else table.width / 2
    if half > math.pi / 2:
        raise InputError("a cone cannot be wider than a half space", where=f"{where}.beam.width")
    return Beam("cone", half)


def _check_beam_factors(table: tables.RingModel, beam: Beam, where: str) -> None:
    for index, led in enumerate(table.leds):
        place = f"{where}.leds[{index}].beam_width_factor"
        if beam.profile == "lambertian" and led.beam_width_factor != 1:
            raise InputError("a lambertian beam has no width", where=place, remedy="leave it out")
        if beam.profile == "cone" and beam.spread * led.beam_width_factor > math.pi / 2:
            raise InputError("a cone cannot be wider than a half space", where=place, remedy="choose a smaller one")


def _calibrated_radiances(table: tables.RingModel, where: str, folder: Path) -> tuple[float, ...]:
    """Radiance of each LED of a ring that was measured [W m^-2 sr^-1]; empty where it was not."""
    if table.calibration is None or table.drive_levels is None:
        return ()
    place = f"{where}.calibration"
    path = (folder / table.calibration).resolve()
    if not path.is_relative_to(folder.resolve()):
        raise InputError("lies outside the scene's folder", where=place, remedy="copy it beside the scene file")
    levels = table.drive_levels if isinstance(table.drive_levels, tuple) else (table.drive_levels,) * table.count
    try:
        intensities = read_calibration(path).intensities(levels)
    except InputError as error:
        raise InputError(str(error), where=place) from error
    return tuple(intensity / (math.pi * table.led_diameter**2 / 4) for intensity in intensities)


def _changes(table: tables.RingModel, radiances: tuple[float, ...], radiance: float) -> tuple[LedChange, ...]:
    """How the LEDs differ: as the file says, and as they were measured."""
    told = {
        led.index: LedChange(led.index, led.radiance_factor, led.beam_width_factor, led.axis_tilt, led.axis_azimuth)
        for led in table.leds
    }
    if not radiances:
        return tuple(told.values())
    own = [told.get(index, LedChange(index)) for index in range(table.count)]
    return tuple(
        replace(led, radiance_factor=led.radiance_factor * measured / radiance)
        for led, measured in zip(own, radiances, strict=True)
    )


def _source(table: tables.SourceModel, where: str, key: str, assumed: dict[str, str], folder: Path) -> Source:
    if table.position is None:
        raise InputError("is missing", where=f"{where}.position")
    pose = _pose(table, where, key, assumed, has_roll=isinstance(table, tables.RingModel))
    if isinstance(table, tables.RingModel):
        beam = _beam(table.beam, where, key, assumed)
        _check_beam_factors(table, beam, where)
        measured = _calibrated_radiances(table, where, folder)
        # Of a measured ring all dark nothing can be a multiple.
        radiance = max(measured, default=0.0) or axial_radiance(table, table.led_diameter, beam, folder, where)
        return Ring(
            name=table.name,
            pose=pose,
            count=table.count,
            diameter=table.diameter,
            first_angle=table.first_angle,
            led_radius=table.led_diameter / 2,
            radiance=radiance,
            beam=beam,
            misalignment_y=table.misalignment.about_y,
            misalignment_z=table.misalignment.about_z,
            changes=_changes(table, measured if any(measured) else (), radiance),
        )
    beam = Beam("lambertian") if isinstance(table, tables.DiscSourceModel) else _beam(table.beam, where, key, assumed)
    emitter = Emitter(
        table.name,
        pose.position,
        normalised(pose.z_axis),
        table.diameter / 2,
        axial_radiance(table, table.diameter, beam, folder, where),
        beam,
    )
    return SingleSource(table.type, emitter)


def material_from_table(table: MaterialModel) -> Material:
    """A material on its own.

    Raises
    ------
    InputError
        If it has a spectrum, which alone says nothing.
    """
    if table.spectrum is not None:
        raise InputError("goes with the spectra of a scene's sources", where="spectrum", remedy="leave it out here")
    return _material(table, "materials", {})


def _material(table: MaterialModel, key: str, assumed: dict[str, str]) -> Material:
    match table:
        case LambertianModel():
            return Lambertian(table.reflectance)
        case SpecularModel():
            return Specular(table.diffuse_reflectance, table.specular_reflectance, table.roughness)
    if table.reflectance is not None and table.roughness is not None:
        return PerturbedNormal(table.reflectance, table.roughness)
    if table.outside is None:
        assumed[f"{key}.outside"] = "refuse"
    if table.anchor is not None:
        return GlassBeads(table.anchor, table.outside or "refuse")
    if table.interpolation is None:
        assumed[f"{key}.interpolation"] = "log"
    return CoefficientTable(
        observation=tuple(abs(angle) for angle in table.observation_angles or ()),
        entrance=tuple(abs(angle) for angle in table.entrance_angles or ()),
        coefficient=table.coefficients or (),
        interpolation=table.interpolation or "log",
        outside=table.outside or "refuse",
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
    return MeshPart(name, _placed(table), table.material, table.part, told, mesh, order.closed)


def _target(table: tables.TargetModel, name: str) -> Target:
    pose = _placed(table)
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
