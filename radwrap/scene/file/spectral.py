"""From the spectra that a scene names to the numbers that count: watts of lumens, and the integral of each pair."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final, assert_never

import numpy as np

from radwrap.errors import InputError
from radwrap.scene.bands import scaled
from radwrap.scene.file.curve_files import curve_beside
from radwrap.scene.file.material_tables import Coloured
from radwrap.scene.file.mosaic_convert import filter_curve
from radwrap.scene.file.sensor_tables import LinearSensorModel
from radwrap.scene.mosaic import COLOURS, Colour
from radwrap.scene.sources import Beam, Source, TableBeam, WideSource, dimmed, emitters
from radwrap.scene.spectrum import (
    Curve,
    Spectral,
    integral,
    line,
    lumens_per_watt,
    normalised_power,
    preset,
)
from radwrap.scene.wide_shapes import area

if TYPE_CHECKING:
    from radwrap.scene.file import document as tables
    from radwrap.scene.file.material_tables import MaterialModel
    from radwrap.scene.file.optics_tables import CurveModel, SpectrumModel, TransmissionModel
    from radwrap.scene.file.source_tables import Shining
    from radwrap.scene.scene import Scene

# Gauss nodes of a beam's flux, from the axis to where it ends: right to 1e-12.
_BEAM_NODES: Final = 64
_PIECE_NODES: Final = 4  # of a straight piece of a table, 0.05 deg wide
_BEAM_REACH: Final = 9.0  # standard deviations
# Wavelengths closer than this share are one: tables begin and end where their writer's numbers say.
_ROUNDING: Final = 1e-9
# Share of a source's light that may lie beside a table of quantum efficiencies, the tail of a line.
_UNKNOWN: Final = 1e-3


def source_spectrum(table: SpectrumModel, folder: Path, where: str) -> Curve:
    """Spectral power of a source, its integral 1 [m^-1].

    Raises
    ------
    InputError
        If its file is no table, or dark.
    """
    if table.line is not None and table.width is not None:
        return normalised_power(line(table.line, table.width), where)
    if table.preset is not None:
        return normalised_power(preset(table.preset), where)
    return normalised_power(curve_beside(table.file or "", folder, f"{where}.file"), where)


def axial_radiance(table: Shining, area: float, beam: Beam, folder: Path, where: str) -> float:
    """Radiance along the axis of a source of some area [m^2], however its level is told [W m^-2 sr^-1]."""
    per_watt = 1.0
    photometric = (table.luminance, table.luminous_intensity, table.luminous_flux)
    if table.spectrum is not None and any(level is not None for level in photometric):
        per_watt = lumens_per_watt(source_spectrum(table.spectrum, folder, f"{where}.spectrum"))
        if per_watt <= 0:
            raise InputError("no eye sees this light", where=f"{where}.spectrum", remedy="give its level in watts")
    if table.radiance is not None:
        return table.radiance
    if table.luminance is not None:
        return table.luminance / per_watt
    if table.luminous_intensity is not None:
        return table.luminous_intensity / per_watt / area
    if table.radiant_flux is not None:
        return table.radiant_flux / flux_of_beam(beam) / area
    if table.luminous_flux is not None:
        return table.luminous_flux / per_watt / flux_of_beam(beam) / area
    return (table.radiant_intensity or 0.0) / area


def flux_of_beam(beam: Beam) -> float:
    """Flux of a beam of axial intensity 1: the integral of I(theta)/I(0) over the half space in front [sr]."""
    if isinstance(beam, TableBeam):
        return _flux_of_table(beam)
    end = math.pi / 2
    match beam.profile:
        case "lambertian":
            pass
        case "cone":
            end = beam.spread
        case "gaussian" | "cosine_power":
            end = min(end, _BEAM_REACH * beam.spread)
        case "table":
            raise TypeError("a table is a TableBeam")
        case _:
            assert_never(beam.profile)
    places, weights = np.polynomial.legendre.leggauss(_BEAM_NODES)
    theta = end * (places + 1) / 2
    return float(math.pi * end * (weights * beam.relative_intensity(theta) * np.sin(theta)).sum())


def _flux_of_table(beam: TableBeam) -> float:
    """As `flux_of_beam`, piece by piece: between the table's angles the intensity is straight."""
    angles = beam.spread * np.linspace(0, math.pi / 2, len(beam.values))
    edges = np.append(angles[angles < math.pi / 2], math.pi / 2)
    places, weights = np.polynomial.legendre.leggauss(_PIECE_NODES)
    half = np.diff(edges)[:, np.newaxis] / 2
    theta = edges[:-1, np.newaxis] + half * (places + 1)
    return float(2 * math.pi * (half * weights * beam.relative_intensity(theta) * np.sin(theta)).sum())


def with_spectra(scene: Scene, model: tables.SceneModel) -> Scene:
    """The scene with its integrals over wavelength, where it tells spectra.

    Radiances become what counts of them, and reflectances means over the
    sources: what knows no bands is right where one is enough. Behind a mosaic
    they are those of the filter that passes most.

    Raises
    ------
    InputError
        If a source has no spectrum where one is needed, a table ends where there is light, or the sensor sees nothing.
    """
    if not tells_spectra(model):
        return scene
    powers = []
    for number, table in enumerate(model.sources):
        where = f"{scene.origin}: sources[{number}].spectrum"
        if table.spectrum is None:
            raise InputError("is missing: another spectrum of the scene needs it", where=where)
        powers.append(source_spectrum(table.spectrum, scene.folder, where))
    if scene.included:
        raise InputError(
            "has spectra, and the colours of an included Radiance file are none",
            where=f"{scene.origin}: targets[{scene.targets.index(scene.included[0])}].rad",
            remedy="describe the target by [materials], or leave the spectra out",
        )
    if scene.camera.sensor.channel != "equal":
        raise InputError(
            "picks a colour channel, but the scene has spectra", where=f"{scene.origin}: camera.sensor.channel"
        )
    sensor = model.camera.sensor
    colour = sensor.colour
    if sensor.pattern is None:
        found = _integrals(scene, model, powers, colour)
    else:
        planes = {name: _integrals(scene, model, powers, name) for name in COLOURS}
        colour, found = max(planes.items(), key=lambda plane: _whole(scene, plane[1]))
        found = replace(found, planes=planes)
    if not any(found.counts):
        raise _nothing_seen(scene, powers, _path(scene, model, colour))
    return _counted(scene, found)


def tells_spectra(model: tables.SceneModel) -> bool:
    """Whether a scene tells the spectrum of anything, or what its sensor makes of them."""
    camera = model.camera
    told = (camera.spectral_response, camera.filter, *(_colour(table) for table in model.materials.values()))
    by_filters = camera.sensor.filters is not None and not isinstance(camera.sensor, LinearSensorModel)
    return by_filters or any(table is not None for table in (*told, *(table.spectrum for table in model.sources)))


def _whole(scene: Scene, plane: Spectral) -> float:
    """All light that counts behind a filter [W sr^-1]."""
    return math.fsum(_intensity(source) * count for source, count in zip(scene.sources, plane.counts, strict=True))


def _path(scene: Scene, model: tables.SceneModel, colour: Colour | None) -> dict[str, Curve]:
    """What light passes before it counts, by the key that tells it; quantum efficiencies come besides."""
    found: dict[str, Curve] = {}
    if model.camera.spectral_response is not None:
        found["camera.spectral_response"] = _factor(
            model.camera.spectral_response, scene, "camera.spectral_response", math.inf
        )
    if model.camera.filter is not None:
        found["camera.filter"] = _transmission(model.camera.filter, scene)
    filters = model.camera.sensor.filters
    if filters is not None and colour is not None and not isinstance(model.camera.sensor, LinearSensorModel):
        key = f"camera.sensor.filters.{colour}"
        curve = filter_curve(getattr(filters, colour), f"{scene.origin}: {key}", scene.folder)
        if curve is not None:
            found[f"{key}.spectral_response"] = curve
    return found


def _integrals(scene: Scene, model: tables.SceneModel, powers: list[Curve], colour: Colour | None) -> Spectral:
    """The integrals over wavelength, of pixels with one filter or none; all counts are 0 where nothing is seen."""
    path = _path(scene, model, colour)
    glass = path.get("camera.filter")
    response = next((curve for key, curve in path.items() if key.endswith("spectral_response")), None)
    # What a dark source would send need not be told.
    shining = [power for source, power in zip(scene.sources, powers, strict=True) if _intensity(source) > 0]
    if glass is not None:
        _check_cover(glass, shining, [response] if response else [], f"{scene.origin}: camera.filter")
    passed = list(path.values())
    electrons = [] if response else _efficiencies(scene, model, shining, [glass] if glass else [], colour)
    passed += electrons
    used = [name for name in scene.materials if name in _used(scene)]
    curves: dict[str, Curve] = {}
    for name in used:
        if (table := _colour(model.materials[name])) is not None:
            curves[name] = _factor(table, scene, f"materials.{name}.spectrum", 1.0)
            _check_cover(curves[name], shining, passed, f"{scene.origin}: materials.{name}.spectrum")
    counts = [integral(power, *passed) for power in powers]
    rows = [
        tuple(integral(power, *passed, curves[name]) / count if name in curves and count > 0 else 1.0 for name in used)
        for power, count in zip(powers, counts, strict=True)
    ]
    materials = {name: scene.materials[name] for name in used}
    names = tuple(source.name for source in scene.sources)
    found = Spectral(names, tuple(counts), materials, tuple(rows), *_wavelengths(scene, powers, passed))
    return replace(found, counts_electrons=bool(electrons))


def _efficiencies(
    scene: Scene, model: tables.SceneModel, shining: list[Curve], glass: list[Curve], colour: Colour | None
) -> list[Curve]:
    """What of the exposure counts by a linear sensor's table: electrons, over those at its own wavelength.

    A quantum efficiency counts photons, of which a joule holds as many more as the wavelength is longer.
    """
    sensor = model.camera.sensor
    if not isinstance(sensor, LinearSensorModel):
        return []
    behind = getattr(sensor.filters, colour) if colour else sensor
    where = f"{scene.origin}: camera.sensor{f'.filters.{colour}' if colour else ''}.quantum_efficiencies"
    if behind.quantum_efficiencies is None:
        if colour is None:
            return []
        raise InputError("is missing: the scene's spectra need it, in place of quantum_efficiency", where=where)
    places, shares = zip(*behind.quantum_efficiencies, strict=True)
    known = Curve((places[0], places[-1]), (1.0, 1.0))
    for power in shining:
        whole = integral(power, *glass)
        if integral(power, *glass, known) < (1 - _UNKNOWN) * whole:
            raise InputError(
                f"its table, {places[0] * 1e9:g} to {places[-1] * 1e9:g} nm, does not cover the light",
                where=where,
                remedy=f"give {'' if colour else 'camera.spectral_response, '}a longer table, or camera.filter",
            )
    own = sensor.efficiency()
    photons = Curve(known.ends, (places[0] / sensor.wavelength, places[-1] / sensor.wavelength))
    return [Curve(places, tuple(share / own for share in shares)), photons]


def _nothing_seen(scene: Scene, powers: list[Curve], path: Mapping[str, Curve]) -> InputError:
    """Nothing of the light gets to the sensor: which keys do not go together, and from where to where each reaches."""
    spectra = {f"sources[{number}].spectrum": power for number, power in enumerate(powers)}
    reaches = [f"{key} {_reach(curve)}" for key, curve in (spectra | dict(path)).items()]
    return InputError(
        f"the sensor sees nothing of the light: {', '.join(reaches)}",
        where=f"{scene.origin}: {' and '.join(['sources', *path])}",
        remedy="compare the spectra",
    )


def _reach(curve: Curve) -> str:
    if curve.support is None:
        return "is 0 everywhere"
    low, high = curve.support
    return f"reaches from {low * 1e9:.5g} to {high * 1e9:.5g} nm"


def _colour(material: MaterialModel) -> CurveModel | None:
    """The spectrum of a material; of kinds that cannot have one none."""
    return material.spectrum if isinstance(material, Coloured) else None


def _factor(table: CurveModel, scene: Scene, key: str, largest: float) -> Curve:
    return curve_beside(table.file, scene.folder, f"{scene.origin}: {key}", largest)


def _transmission(table: TransmissionModel, scene: Scene) -> Curve:
    """Transmittance of the filter, from its table or its file."""
    if table.transmissions is not None:
        wavelengths, shares = zip(*table.transmissions, strict=True)
        return Curve(wavelengths, shares)
    return curve_beside(table.file or "", scene.folder, f"{scene.origin}: camera.filter", 1.0)


def _used(scene: Scene) -> set[str]:
    return {surface.material for surface in scene.surfaces}


def _check_cover(curve: Curve, powers: list[Curve], passed: list[Curve], where: str) -> None:
    """What a table does not tell nobody knows: it must reach as far as light does that counts."""
    for power in powers:
        reaches = [c.support for c in (power, *passed)]
        low = max(math.inf if reach is None else reach[0] for reach in reaches)
        high = min(-math.inf if reach is None else reach[1] for reach in reaches)
        first, last = curve.ends
        if low < high and (first > low * (1 + _ROUNDING) or last < high * (1 - _ROUNDING)):
            raise InputError(
                f"its table, {first * 1e9:g} to {last * 1e9:g} nm, does not cover the light, "
                f"{low * 1e9:.5g} to {high * 1e9:.5g} nm",
                where=where,
            )


def _wavelengths(
    scene: Scene, powers: list[Curve], passed: list[Curve]
) -> tuple[float, float, tuple[float, ...], tuple[float, ...]]:
    """Mean over the light that counts [m], how far it is from standing for all, and both of each source."""
    moments = np.zeros((len(powers), 3))
    for moment, source, power in zip(moments, scene.sources, powers, strict=True):
        wavelength = Curve(power.ends, power.ends)
        each = (integral(power, *passed, *(wavelength,) * order) for order in range(3))
        moment[:] = [_intensity(source) * value for value in each]
    lit = moments[moments[:, 0] > 0]
    whole, first, second = lit.sum(axis=0).tolist()
    if not whole > 0:
        return 0.0, 0.0, (), ()
    mean = first / whole
    apart = float(np.abs(lit[:, 1] - mean * lit[:, 0]).sum()) / whole
    means, spreads = zip(*map(_line, moments.tolist()), strict=True)
    return mean, apart / mean + _half_variance(whole, mean, second), means, spreads


def _line(moments: Sequence[float]) -> tuple[float, float]:
    """A source's mean wavelength [m], and how far it is from standing for its light; 0 of one that is dark."""
    whole, first, second = moments
    return (first / whole, _half_variance(whole, first / whole, second)) if whole > 0 else (0.0, 0.0)


def _half_variance(whole: float, mean: float, second: float) -> float:
    return max(second / whole / mean**2 - 1, 0.0) / 2


def _intensity(source: Source) -> float:
    if isinstance(source, WideSource):  # its patches come later
        return source.radiance * area(source.shape)
    return math.fsum(emitter.radiant_intensity for emitter in emitters(source))


def _counted(scene: Scene, spectral: Spectral) -> Scene:
    counts: Mapping[str, float] = dict(zip(spectral.sources, spectral.counts, strict=True))
    weights = [_intensity(source) * counts[source.name] for source in scene.sources]
    whole = math.fsum(weights) or 1.0
    means = [
        math.fsum(w * value for w, value in zip(weights, column, strict=True)) / whole
        for column in zip(*spectral.reflectance, strict=True)
    ]
    coloured = {
        name: material if mean == 1.0 else scaled(material, mean)
        for (name, material), mean in zip(spectral.materials.items(), means, strict=True)
    }
    sources = tuple(dimmed(source, counts[source.name]) for source in scene.sources)
    return replace(scene, sources=sources, materials={**scene.materials, **coloured}, spectral=spectral)
