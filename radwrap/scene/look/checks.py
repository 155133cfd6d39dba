"""Whether the parts of a scene go together; values alone were checked at the border."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.frames import Vector
from radwrap.scene.camera import Camera
from radwrap.scene.instants import at_time, pose_time, row_levels
from radwrap.scene.look.geometry import SurfacePoints, in_view, signed_distance
from radwrap.scene.look.intersections import Bounded
from radwrap.scene.look.planes import check_planes
from radwrap.scene.look.probes import (
    LIT_SHARE,
    lit_points,
    materials_of,
    merged,
    nearest_lit,
    seen_points,
    surface_points,
)
from radwrap.scene.look.sight import sources_in_sight
from radwrap.scene.look.smallness import small_parts, small_spots
from radwrap.scene.materials import GLASS_BEAD_OBSERVATION, CoefficientTable, GlassBeads, Material, PrintedSheeting
from radwrap.scene.mesh_files.normals import told_of
from radwrap.scene.scene import Scene
from radwrap.scene.sources import Emitter, IntensityTable, Luminaire, Patch, SingleSource, Source, TableBeam, WideSource
from radwrap.scene.targets import Flat, MeshPart, Polygon, Target, signed_area

# A source is sampled at its centre, which misses the irradiance by about (radius/distance)^2.
WIDE_SOURCE_LIMIT: Final = 0.01
# Above this a valid scene is warned of it.
_WIDTH_WARNING: Final = 1e-3
_DOUBT: Final = 0.01
# Photons of a joule, and so electrons, go with the wavelength: a share of it is that share of the signal.
_WAVELENGTH_SHARE: Final = 0.01
_RIM_POINTS: Final = 16
_PLACE: Final = 1e-9  # m; to so much the places of all surfaces are known
_ANGLE_TOLERANCE: Final = 1e-9  # rad, rounding of the angles


def check_shapes(scene: Scene) -> None:
    """Check the targets alone.

    Raises
    ------
    InputError
        If there is none, the camera touches one, a polygon is flat or crosses
        itself, or they lie too far from the origin for numbers to hold their places.
    """
    if not scene.targets:
        raise InputError("the scene is empty", where=f"{scene.origin}: targets", remedy="add [[targets]]")
    _check_places(scene)
    _check_polygons(scene)
    _check_clearance(scene)


def check_scene(scene: Scene) -> None:
    """Check what a scene, whose shapes were checked, needs to be traced.

    Raises
    ------
    InputError
        If it is unlit, surfaces overlap in one plane, a source is too wide for
        its distance, or sheeting is seen at angles its data do not cover.
    """
    lit = any(emitter.radiance > 0 for emitter in scene.emitters)
    if not lit and not scene.included:
        raise InputError(
            "there is no light",
            where=f"{scene.origin}: sources",
            remedy="add [[sources]] with a radiance above zero",
        )
    check_planes(scene)
    _check_source_widths(scene)
    _check_sheeting_angles(scene)


def checked_at_time(scene: Scene, time: float) -> Scene:
    """The scene `held` at a time [s], checked as the scene of its file was: what moves may meet the camera on its way.

    Raises
    ------
    InputError
        As `check_shapes` and `check_scene`, with the time.
    """
    then = at_time(scene, time)
    try:
        check_shapes(then)
        check_scene(then)
    except InputError as error:
        late = (time - pose_time(scene)) * 1e3
        when = f"{abs(late):.4g} ms {'before' if late < 0 else 'after'} the poses of the file hold, "
        raise InputError(when + error.what, where=error.where, remedy=error.remedy) from error
    return then


def _where(scene: Scene, kind: str, name: str) -> str:
    things = scene.sources if kind == "sources" else scene.targets
    index = next((i for i, thing in enumerate(things) if name == thing.name or name.startswith(f"{thing.name}.")), 0)
    return f"{scene.origin}: {kind}[{index}]"


def _check_places(scene: Scene) -> None:
    """Numbers must hold places finely enough, wherever the world's origin is."""
    placed = [("camera.position", scene.camera.pose.position)]
    placed += [(f"targets[{number}].position", target.pose.position) for number, target in enumerate(scene.targets)]
    placed += [(f"sources[{number}].position", _place_of(source)) for number, source in enumerate(scene.sources)]
    for key, place in placed:
        away = max(map(abs, place))
        if math.ulp(away) > _PLACE:
            raise InputError(
                f"lies {away:.3g} m from the origin, where numbers hold places to {math.ulp(away):.1g} m only",
                where=f"{scene.origin}: {key}",
                remedy="choose an origin nearer to the scene",
            )


def _place_of(source: Source) -> Vector:
    return source.emitter.position if isinstance(source, SingleSource) else source.pose.position


def _check_polygons(scene: Scene) -> None:
    for target in scene.targets:
        if not isinstance(target, Polygon):
            continue
        where = _where(scene, "targets", target.name) + ".vertices"
        largest = max(abs(value) for vertex in target.vertices for value in vertex)
        if abs(signed_area(target.vertices)) <= 1e-12 * largest**2:
            raise InputError("the polygon has no area", where=where)
        sides = list(zip(target.vertices, target.vertices[1:] + target.vertices[:1], strict=True))
        if any(_meet(a, b) for a, b in combinations(sides, 2)):
            raise InputError("the polygon's sides cross or touch", where=where)


_Corner = tuple[float, float]


def _meet(first: tuple[_Corner, _Corner], second: tuple[_Corner, _Corner]) -> bool:
    """Whether two sides of a polygon have a point in common, other than the corner where one follows the other."""

    def turn(a: _Corner, b: _Corner, c: _Corner) -> float:
        return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])

    def between(a: _Corner, b: _Corner, c: _Corner) -> bool:
        return min(a[0], b[0]) <= c[0] <= max(a[0], b[0]) and min(a[1], b[1]) <= c[1] <= max(a[1], b[1])

    (a, b), (c, d) = first, second
    if b == c or d == a:
        # Neighbours: they meet in their corner alone unless one runs back along the other.
        ahead, corner, behind = (a, b, d) if b == c else (c, d, b)
        along = (ahead[0] - corner[0]) * (behind[0] - corner[0]) + (ahead[1] - corner[1]) * (behind[1] - corner[1])
        return turn(ahead, corner, behind) == 0 and along > 0
    turns = turn(a, b, c), turn(a, b, d), turn(c, d, a), turn(c, d, b)
    if turns[0] * turns[1] < 0 and turns[2] * turns[3] < 0:
        return True
    ends = ((a, b, c), (a, b, d), (c, d, a), (c, d, b))
    return any(value == 0 and between(*end) for value, end in zip(turns, ends, strict=True))


def _check_clearance(scene: Scene) -> None:
    """No sub-viewpoint may lie in or on a target: it would see its inside, or nothing."""
    eye = scene.camera.pose.position
    for target in scene.targets:
        distance = signed_distance(target, eye)
        if distance <= max(scene.camera.aperture.reach, 1e-9):
            place = "inside" if distance < 0 else "on"
            raise InputError(
                f'the camera\'s pinhole lies {place} the target "{target.name}"',
                where=f"{scene.origin}: camera.position",
                remedy="move the camera or the target",
            )


def source_width_error(targets: Bounded, emitter: Emitter) -> float:
    """Largest (radius/distance)^2 over the points of targets that a source lights: the error of sampling its centre.

    0 where it is nowhere above the limit of the warning, and for a patch, which was made small enough.
    """
    worst = 0.0
    if isinstance(emitter, Patch):
        return worst
    for target in targets.nearer_than(emitter.position, emitter.radius / math.sqrt(_WIDTH_WARNING)):
        # What is nearest is no nearer than this, lit or not.
        distance = max(signed_distance(target, emitter.position), 0.0)
        if emitter.radius**2 <= max(worst, _WIDTH_WARNING) * distance**2:
            continue
        worst = max(worst, (emitter.radius / max(nearest_lit(target, emitter), 1e-300)) ** 2)
    return worst


def _check_source_widths(scene: Scene) -> None:
    targets = Bounded.of(scene.targets)
    for emitter in scene.emitters:
        error = source_width_error(targets, emitter) if emitter.radiance > 0 else 0.0
        if error > WIDE_SOURCE_LIMIT:
            raise InputError(
                f'"{emitter.name}" is too wide for its distance: its irradiance would be off '
                f"by up to {min(error, 1):.0%}",
                where=_where(scene, "sources", emitter.name) + ".diameter",
                remedy=_of_a_wide_one(scene, emitter),
            )


def _of_a_wide_one(scene: Scene, emitter: Emitter) -> str:
    if any(
        isinstance(source, SingleSource) and source.kind == "disc" and source.emitter is emitter
        for source in scene.sources
    ):
        return "move it away, or ask for an irradiance_error, such as 0.01, for which it is cut into patches"
    return "move it away, or describe it by several smaller sources"


def _check_sheeting_angles(scene: Scene) -> None:
    camera = scene.camera
    for target in scene.targets:
        limits = {name: found for name in materials_of(target) if (found := _sheeting_limits(scene.materials[name]))}
        if not limits:
            continue
        spread = (*surface_points(target, camera.pose.position), *seen_points(target, camera))
        for emitter in scene.emitters:
            if emitter.radiance > 0:
                lit = () if isinstance(emitter, Patch) else lit_points(target, emitter)
                for group in merged([*spread, *lit]):
                    if group.material in limits:
                        _check_angles(scene, group, emitter, limits[group.material])


def _sheeting_limits(material: Material) -> tuple[float, float, float] | None:
    """(smallest alpha, largest alpha, largest beta) [rad] that the data cover."""
    if isinstance(material, PrintedSheeting):
        return _sheeting_limits(material.sheeting)
    if isinstance(material, CoefficientTable) and material.outside == "refuse":
        return material.observation[0], material.observation[-1], material.entrance[-1]
    if isinstance(material, GlassBeads) and material.outside == "refuse":
        return math.radians(GLASS_BEAD_OBSERVATION[0]), math.radians(GLASS_BEAD_OBSERVATION[-1]), math.pi / 2
    return None


def sheeting_angles(
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    light: NDArray[np.float64],
    eye: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Observation angle alpha and entrance angle beta [rad] at points of a surface, each shape (n,)."""
    to_light, to_eye = light - points, eye - points
    to_light = to_light / np.linalg.norm(to_light, axis=1, keepdims=True)
    to_eye = to_eye / np.linalg.norm(to_eye, axis=1, keepdims=True)
    # From the chord: acos loses half the digits at the small angles that matter here.
    alpha = 2 * np.arcsin(np.minimum(np.linalg.norm(to_light - to_eye, axis=1) / 2, 1.0))
    beta = np.arccos(np.clip((to_light * normals).sum(axis=1), -1.0, 1.0))
    return alpha, beta


def _check_angles(
    scene: Scene,
    group: SurfacePoints,
    emitter: Emitter,
    limits: tuple[float, float, float],
) -> None:
    seen = in_view(scene.camera, group.points)
    lit = emitter.relative_intensity_at(group.points) > LIT_SHARE
    eye = np.asarray(scene.camera.pose.position)
    alpha, beta = sheeting_angles(group.points, group.normals, np.asarray(emitter.position), eye)
    front = (beta < math.pi / 2) & (((eye - group.points) * group.normals).sum(axis=1) > 0)
    counted = seen & lit & front
    if not counted.any():
        return
    low, high, entrance = limits
    steepest = beta[counted].max()
    points, normals, light = group.points[counted], group.normals[counted], np.asarray(emitter.position)
    through = [alpha[counted], *(sheeting_angles(points, normals, light, rim)[0] for rim in _rim(scene.camera))]
    least, most = min(part.min() for part in through), max(part.max() for part in through)
    where = f"{scene.origin}: materials.{group.material}"
    remedy = 'give data that cover them, or set outside = "hold"'
    if least < low - _ANGLE_TOLERANCE or most > high + _ANGLE_TOLERANCE:
        raise InputError(
            f'"{group.target}" is seen at observation angles {math.degrees(least):.3g} to {math.degrees(most):.3g} deg '
            f'under "{emitter.name}", its data cover {math.degrees(low):.3g} to {math.degrees(high):.3g} deg',
            where=where,
            remedy=remedy,
        )
    if steepest > entrance + _ANGLE_TOLERANCE:
        raise InputError(
            f'"{group.target}" is lit at entrance angles up to {math.degrees(steepest):.3g} deg by "{emitter.name}", '
            f"its data end at {math.degrees(entrance):.3g} deg",
            where=where,
            remedy=remedy,
        )


def _rim(camera: Camera) -> NDArray[np.float64]:
    """Points around the opening of a lens, which is wide enough to see sheeting at many angles; shape (n, 3) [m]."""
    if camera.lens is None:
        return np.empty((0, 3))
    turn = 2 * math.pi * np.arange(_RIM_POINTS) / _RIM_POINTS
    across = camera.aperture.reach * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    rim: NDArray[np.float64] = camera.pose.position + across @ np.asarray(camera.pose.rotation)[:, :2].T
    return rim


def _late_pulses(scene: Scene) -> Iterator[str]:
    """Sources whose pulses meet the exposure of no row."""
    if scene.strobes and scene.camera.exposure_time:
        for name, level in row_levels(scene).items():
            if name in scene.strobes and not level.any():
                yield f'"{name}" is dark in the image: none of its pulses meets the exposure of any row (see `strobe`)'


def warnings_of(scene: Scene, whole: Collection[str] = ()) -> tuple[str, ...]:
    """What a user should know of a scene that is valid, one line each.

    Parameters
    ----------
    scene : Scene
        The scene.
    whole : collection of str
        Wide sources that shine as a whole: what their patches would do wrong does not count.
    """
    found = []
    targets = Bounded.of(scene.targets)
    for emitter in scene.emitters:
        is_centre = emitter.radiance > 0 and emitter.source not in whole
        error = source_width_error(targets, emitter) if is_centre else 0.0
        if error > _WIDTH_WARNING:
            found.append(f'"{emitter.name}" is close to what it lights: irradiance off by up to {error:.2%}')
    if not scene.included and not any(_is_seen(scene.camera, target) for target in scene.targets):
        found.append("no target is in the camera's view")
    found += _unknown_widths(scene)
    found += _half_shadows(scene, whole)
    found += _doubtful_tables(scene)
    found += _other_wavelength(scene)
    found += _late_pulses(scene)
    found += filter(None, (told_of(one.name, one.leaning) for one in scene.targets if isinstance(one, MeshPart)))
    return (*found, *small_parts(scene), *small_spots(scene), *sources_in_sight(scene))


def _unknown_widths(scene: Scene) -> Iterator[str]:
    """A line for each disc beside an included file, of whose surfaces nothing is known here."""
    for source in scene.sources if scene.included else ():
        if isinstance(source, SingleSource) and source.kind == "disc":
            yield (
                f'"{source.name}" shines from its middle, which is off by about (radius/distance)^2; how far the '
                f'surfaces of "{scene.included[0].name}" are from it is not known'
            )


def _doubtful_tables(scene: Scene) -> Iterator[str]:
    """A line for each measured beam whose angles lie so far apart that its curve is a guess."""
    doubts = {}
    for emitter in scene.emitters:
        measured = emitter.table if isinstance(emitter, Luminaire) else emitter.beam
        if isinstance(measured, IntensityTable | TableBeam) and measured.doubt > _DOUBT:
            doubts[emitter.source.split(".")[0]] = measured.doubt
    for name, doubt in doubts.items():
        yield (
            f'the table of "{name}" has few angles: straight lines between them would change its intensity by up to '
            f"{doubt:.1%} of the peak"
        )


def _other_wavelength(scene: Scene) -> Iterator[str]:
    """A line where a linear camera counts the photons of another wavelength than the scene's light has.

    What counts is the mean by energy: mu_p = integral of E lambda/(h c), and that over E is its mean lambda/(h c).
    """
    linear = scene.camera.sensor.linear
    if linear is None or scene.spectral is None or scene.spectral.wavelength <= 0 or scene.spectral.counts_electrons:
        return
    share = linear.wavelength / scene.spectral.wavelength - 1
    if abs(share) > _WAVELENGTH_SHARE:
        light, told = scene.spectral.wavelength * 1e9, linear.wavelength * 1e9
        yield (
            f"the mean wavelength of the light that counts is {light:.4g} nm, camera.sensor.wavelength {told:.4g} nm: "
            f'photons are off by {share:+.1%}; write wavelength = "{light:.4g} nm" with the quantum efficiency there'
        )


def _half_shadows(scene: Scene, whole: Collection[str]) -> Iterator[str]:
    """A line for each wide source whose patches show in half shadows."""
    if len(scene.targets) == 1 and isinstance(scene.targets[0], Flat):
        return
    for source in scene.sources:
        if not isinstance(source, WideSource) or source.name in whole:
            continue
        if source.step > source.irradiance_error:
            yield (
                f'half shadows under "{source.name}" come in steps of up to {source.step:.1%} of its light where it '
                f"shines from its {len(source.patches)} patches: least_patches makes them finer"
            )


def _is_seen(camera: Camera, target: Target) -> bool:
    spread = surface_points(target, camera.pose.position)
    return any(in_view(camera, group.points).any() for group in spread) or bool(seen_points(target, camera))
