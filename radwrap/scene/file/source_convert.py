"""From the tables of light sources to frozen values in SI."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final, TypeVar

from radwrap.errors import InputError
from radwrap.frames import Pose, along, normalised, rotation_about
from radwrap.scene.file import source_tables as tables
from radwrap.scene.file.beside import named_file
from radwrap.scene.file.intensity_files import read_beam, read_luminaire
from radwrap.scene.file.poses import pose_of
from radwrap.scene.file.ring_calibration import read_calibration
from radwrap.scene.file.spectral import axial_radiance
from radwrap.scene.sources import (
    Beam,
    Emitter,
    LedChange,
    Luminaire,
    Ring,
    SingleSource,
    Source,
    WideSource,
    cosine_power_spread,
    dimmed,
    gaussian_spread,
    half_width,
)
from radwrap.scene.wide_shapes import Annulus, Rectangle, WideShape, Zone, area

_Read = TypeVar("_Read")
# Full width at half maximum of a power of the cosine [rad]: much narrower, and the cosine is 1 to all digits.
# A Gaussian or a cone is told by the angle itself.
_NARROWEST: Final = math.radians(1e-3)
_ROUNDING: Final = 1e-5  # share of such a width, where it comes out of its cosine


def _beam(table: tables.BeamModel, where: str, key: str, assumed: dict[str, str], folder: Path) -> Beam:
    beam = _any_beam(table, where, key, assumed, folder)
    _check_width(beam, f"{where}.beam.{'width' if table.file is None else 'file'}")
    return beam


def _any_beam(table: tables.BeamModel, where: str, key: str, assumed: dict[str, str], folder: Path) -> Beam:
    if table.file is not None:
        return from_file(table.file, f"{where}.beam.file", folder, read_beam)
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


def _check_width(beam: Beam, where: str) -> None:
    width = abs(2 * half_width(beam))
    if beam.profile == "cosine_power" and width < _NARROWEST * (1 - _ROUNDING):
        raise InputError(
            f"makes a beam {math.degrees(width):.2g} deg wide at half its intensity",
            where=where,
            remedy=f"{math.degrees(_NARROWEST):g} deg is the narrowest power of a cosine; take a gaussian",
        )


def _check_beam_factors(table: tables.RingModel, beam: Beam, where: str) -> None:
    for index, led in enumerate(table.leds):
        place = f"{where}.leds[{index}].beam_width_factor"
        _check_width(replace(beam, spread=beam.spread * led.beam_width_factor), place)
        if beam.profile == "lambertian" and led.beam_width_factor != 1:
            raise InputError("a lambertian beam has no width", where=place, remedy="leave it out")
        if beam.profile == "cone" and beam.spread * led.beam_width_factor > math.pi / 2:
            raise InputError("a cone cannot be wider than a half space", where=place, remedy="choose a smaller one")


def from_file(name: str, where: str, folder: Path, read: Callable[[Path], _Read]) -> _Read:
    """What is read from a file in the scene's folder; what is wrong with it is told with the key that names it."""
    path = named_file(folder, name, where)
    try:
        return read(path)
    except InputError as error:
        raise InputError(str(error), where=where) from error


def _disc_area(diameter: float) -> float:
    return math.pi * diameter**2 / 4


def _calibrated_radiances(table: tables.RingModel, where: str, folder: Path) -> tuple[float, ...]:
    """Radiance of each LED of a ring that was measured [W m^-2 sr^-1]; empty where it was not."""
    if table.calibration is None or table.drive_levels is None:
        return ()
    levels = table.drive_levels if isinstance(table.drive_levels, tuple) else (table.drive_levels,) * table.count
    intensities = from_file(
        table.calibration, f"{where}.calibration", folder, lambda path: read_calibration(path).intensities(levels)
    )
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


def sources_from_tables(
    model: tuple[tables.SourceModel, ...], camera: Pose, *, assumed: dict[str, str], origin: str, folder: Path
) -> tuple[Source, ...]:
    """Convert all sources of a scene.

    Through the beam splitter of a coaxial source the camera sees all light dimmed: that factor is on every source.

    Raises
    ------
    InputError
        If values that are right one by one do not go together.
    """
    coaxial = [(i, table) for i, table in enumerate(model) if isinstance(table, tables.CoaxialModel)]
    if len(coaxial) > 1:
        raise InputError(
            "a second beam splitter before the camera",
            where=f"{origin}: sources[{coaxial[1][0]}]",
            remedy="describe both lights by one",
        )
    sources = [
        _coaxial(table, camera)
        if isinstance(table, tables.CoaxialModel)
        else source_from_table(table, f"{origin}: sources[{i}]", f"sources[{i}]", assumed, folder)
        for i, table in enumerate(model)
    ]
    for _, table in coaxial:
        sources = [dimmed(source, table.splitter_transmittance) for source in sources]
    return tuple(sources)


def _coaxial(table: tables.CoaxialModel, camera: Pose) -> WideSource:
    """A disc behind the pinhole, where a mirror in the splitter's place would show it."""
    back = along(camera.position, camera.z_axis, -table.distance)
    level, error = table.radiance * table.splitter_reflectance, table.irradiance_error
    shape = Annulus(0.0, table.diameter / 2)
    pose = replace(camera, position=back)
    return WideSource(table.name, "coaxial", pose, shape, level, Beam("lambertian"), error, table.least_patches)


def source_from_table(table: tables.SourceModel, where: str, key: str, assumed: dict[str, str], folder: Path) -> Source:
    """Convert a source; one that is wide has no patches yet, see `wide_sources.divided`."""
    if isinstance(table, tables.SurroundModel):
        return _surround(table)
    if isinstance(table, tables.CoaxialModel):
        raise TypeError("a coaxial source needs its camera")
    if isinstance(table, tables.LampModel) and table.preset is not None:
        assumed[f"{key}.preset"] = f"{table.preset}, whose values are assumptions"
    if table.position is None:
        raise InputError("is missing", where=f"{where}.position")
    if isinstance(table, tables.RectangleSourceModel | tables.AreaRingModel | tables.DomeModel):
        return _wide(table, where, key, assumed, folder)
    pose = pose_of(table, where, key, assumed, has_roll=isinstance(table, tables.RingModel | tables.IesModel))
    if isinstance(table, tables.RingModel):
        beam = _beam(table.beam, where, key, assumed, folder)
        _check_beam_factors(table, beam, where)
        measured = _calibrated_radiances(table, where, folder)
        # Of a measured ring all dark nothing can be a multiple.
        radiance = max(measured, default=0.0) or axial_radiance(
            table, _disc_area(table.led_diameter), beam, folder, where
        )
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
    if isinstance(table, tables.IesModel):
        return SingleSource("ies", _luminaire(table, pose, where, folder))
    if isinstance(table, tables.DiscSourceModel) and table.irradiance_error is not None:
        return _wide_disc(table, pose, where, folder)
    beam = (
        Beam("lambertian")
        if isinstance(table, tables.DiscSourceModel)
        else _beam(table.beam, where, key, assumed, folder)
    )
    emitter = Emitter(
        table.name,
        pose.position,
        normalised(pose.z_axis),
        table.diameter / 2,
        axial_radiance(table, _disc_area(table.diameter), beam, folder, where),
        beam,
    )
    return SingleSource(table.type, emitter)


def _luminaire(table: tables.IesModel, pose: Pose, where: str, folder: Path) -> Luminaire:
    intensities = from_file(table.file, f"{where}.file", folder, read_luminaire)
    radius = table.diameter / 2
    return Luminaire(
        table.name,
        pose.position,
        normalised(pose.z_axis),
        radius,
        intensities.peak / table.luminous_efficacy / (math.pi * radius**2),
        Beam("lambertian"),
        pose.x_axis,
        pose.y_axis,
        intensities,
    )


def _wide(
    table: tables.RectangleSourceModel | tables.AreaRingModel | tables.DomeModel,
    where: str,
    key: str,
    assumed: dict[str, str],
    folder: Path,
) -> WideSource:
    pose = pose_of(table, where, key, assumed, has_roll=isinstance(table, tables.RectangleSourceModel))
    shape: WideShape
    beam = Beam("lambertian")
    match table:
        case tables.RectangleSourceModel():
            shape = Rectangle(*table.size)
        case tables.AreaRingModel():
            shape = Annulus(table.inner_diameter / 2, table.diameter / 2)
        case tables.DomeModel():
            shape = Zone(table.diameter / 2, math.asin(table.opening_diameter / table.diameter), math.pi / 2)
    if not isinstance(table, tables.DomeModel):
        beam = _beam(table.beam, where, key, assumed, folder)
    if isinstance(table, tables.DomeModel):
        radiance = table.radiance
    else:
        radiance = axial_radiance(table, area(shape), beam, folder, where)
    return WideSource(table.name, table.type, pose, shape, radiance, beam, table.irradiance_error, table.least_patches)


def _wide_disc(table: tables.DiscSourceModel, pose: Pose, where: str, folder: Path) -> WideSource:
    shape, beam, error = Annulus(0.0, table.diameter / 2), Beam("lambertian"), table.irradiance_error or 0.0
    level = axial_radiance(table, _disc_area(table.diameter), beam, folder, where)
    return WideSource(table.name, "disc", pose, shape, level, beam, error, table.least_patches or 1)


def _surround(table: tables.SurroundModel) -> WideSource:
    """A sphere of 1 m, made as large as the scene needs by `wide_sources.divided`."""
    pose = Pose((0.0, 0.0, 0.0), rotation_about("x", 0.0))
    shape = Zone(1.0, 0.0, math.pi)
    return WideSource(
        table.name,
        "surround",
        pose,
        shape,
        table.radiance,
        Beam("lambertian"),
        table.irradiance_error,
        table.least_patches,
    )
