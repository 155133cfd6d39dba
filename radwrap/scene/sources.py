"""Light sources: discs that shine to their front with a beam.

A beam is a far-field radiant intensity I(theta) = I(0) g(theta), as data
sheets give it. "gaussian", "cosine_power" and "cone" describe g itself;
"lambertian" is g = cos(theta), the disc of constant radiance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal, assert_never

import numpy as np
from numpy.typing import NDArray

from radwrap.frames import (
    Pose,
    Vector,
    apply_rotation,
    multiply,
    normalised,
    rotation_about,
    to_world,
)
from radwrap.scene.wide_shapes import WideShape

Profile = Literal["gaussian", "cosine_power", "cone", "lambertian", "table"]
WidthDefinition = Literal["fwhm", "half_angle", "1/e^2_full", "sigma"]


@dataclass(frozen=True, slots=True)
class Beam:
    """Angular distribution of radiant intensity.

    Attributes
    ----------
    profile : str
        "gaussian", "cosine_power", "cone", "lambertian" or "table".
    spread : float
        "gaussian": standard deviation of exp(-theta^2/(2 spread^2)) [rad];
        "cosine_power": of cos(theta)^(1/spread^2), the standard deviation of
        the Gaussian that it meets on the axis [rad];
        "cone": angle from the axis to the rim [rad]; "lambertian": not used.
    """

    profile: Profile
    spread: float = 0.0

    def relative_intensity(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        """I(theta)/I(0) at angles theta to the axis [rad]; 0 behind the disc."""
        match self.profile:
            case "gaussian":
                relative = np.exp(-((theta / self.spread) ** 2) / 2)
            case "cosine_power":
                relative = np.power(np.maximum(np.cos(theta), 0.0), self.spread**-2)
            case "cone":
                relative = np.where(theta < self.spread, 1.0, 0.0)
            case "table":
                raise TypeError("a table is a TableBeam")
            case "lambertian":
                relative = np.cos(theta)
            case _:
                assert_never(self.profile)
        in_front: NDArray[np.float64] = np.where(np.cos(theta) > 0.0, relative, 0.0)
        return in_front


@dataclass(frozen=True, slots=True)
class TableBeam(Beam):
    """A measured beam; its `spread` is a factor on all angles.

    Attributes
    ----------
    sha256 : str
        Of the file.
    doubt : float
        What straight lines between the file's angles would change, as a share of the peak.
    values : tuple of float
        I(theta)/I(0) in even steps from 0 to 90 deg.
    """

    sha256: str = ""
    doubt: float = 0.0
    values: tuple[float, ...] = field(default=(), compare=False, repr=False)

    def relative_intensity(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        """I(theta)/I(0) at angles theta to the axis [rad]; 0 behind the disc."""
        nodes = np.linspace(0, math.pi / 2, len(self.values))
        relative = np.interp(theta / self.spread, nodes, self.values, right=0.0)
        in_front: NDArray[np.float64] = np.where(np.cos(theta) > 0.0, relative, 0.0)
        return in_front


@dataclass(frozen=True, slots=True)
class IntensityTable:
    """Measured intensity in all directions.

    Attributes
    ----------
    sha256 : str
        Of the file.
    peak : float
        Largest intensity, in the file's unit [cd].
    doubt : float
        What straight lines between the file's angles would change, as a share of the peak.
    rows : tuple of tuple of float
        Share of the peak: a row for each azimuth in even steps of a full turn, or one for all; in it even steps of the
        polar angle from 0 to 180 deg.
    """

    sha256: str
    peak: float
    doubt: float
    rows: tuple[tuple[float, ...], ...] = field(compare=False, repr=False)

    def share(self, polar: NDArray[np.float64], azimuth: NDArray[np.float64]) -> NDArray[np.float64]:
        """Share of the peak at angles [rad], straight between the table's steps."""
        table = np.asarray(self.rows)
        height = np.clip(polar / math.pi, 0.0, 1.0) * (table.shape[1] - 1)
        turn = np.mod(azimuth / (2 * math.pi), 1.0) * (table.shape[0] - 1)
        low, first = np.floor(height).astype(int), np.floor(turn).astype(int)
        above, after = np.minimum(low + 1, table.shape[1] - 1), np.minimum(first + 1, table.shape[0] - 1)
        up, on = height - low, turn - first
        shares: NDArray[np.float64] = (1 - on) * ((1 - up) * table[first, low] + up * table[first, above]) + on * (
            (1 - up) * table[after, low] + up * table[after, above]
        )
        return shares


def gaussian_spread(width: float, definition: WidthDefinition) -> float:
    """Standard deviation [rad] of a Gaussian beam whose width is given in one of four ways.

    Parameters
    ----------
    width : float
        The width as stated [rad].
    definition : str
        "fwhm": full width at half maximum; "half_angle": axis to half maximum;
        "1/e^2_full": full width at exp(-2) of the maximum; "sigma": the
        standard deviation itself.
    """
    to_half_maximum = math.sqrt(2 * math.log(2))
    divisor = {"fwhm": 2 * to_half_maximum, "half_angle": to_half_maximum, "1/e^2_full": 4.0, "sigma": 1.0}
    return width / divisor[definition]


def cosine_power_spread(width: float, definition: WidthDefinition) -> float:
    """Spread [rad] of a beam cos(theta)^n with n = 1/spread^2; arguments as `gaussian_spread`.

    The angle from the axis to the stated share of the maximum must be below
    90 degrees, where every such beam is dark.
    """
    if definition == "sigma":
        return width
    angle, share = {"fwhm": (width / 2, 0.5), "half_angle": (width, 0.5), "1/e^2_full": (width / 2, math.exp(-2))}[
        definition
    ]
    return math.sqrt(math.log(math.cos(angle)) / math.log(share))


def half_width(beam: Beam) -> float:
    """Angle from the axis at which a beam's intensity falls to half of that on the axis, or of its peak [rad]."""
    match beam:
        case TableBeam():
            values = np.asarray(beam.values)
            last = int(np.flatnonzero(values >= values.max() / 2)[-1])
            return beam.spread * math.pi / 2 * max(last, 1) / (len(values) - 1)
        case Beam():
            match beam.profile:
                case "gaussian" | "cosine_power":
                    return beam.spread * math.sqrt(2 * math.log(2))
                case "cone":
                    return beam.spread
                case "lambertian":
                    return math.pi / 3
                case "table":
                    raise TypeError("a table is a TableBeam")
                case _:
                    assert_never(beam.profile)
        case _:
            assert_never(beam)


@dataclass(frozen=True, slots=True)
class Emitter:
    """One shining disc.

    Attributes
    ----------
    name : str
        Unique in the scene.
    position : tuple of float, shape (3,)
        Centre in the world [m].
    axis : tuple of float, shape (3,)
        Unit vector into which it shines.
    radius : float
        Radius of the disc [m].
    radiance : float
        Radiance along the axis [W m^-2 sr^-1].
    beam : Beam
        Angular distribution.
    """

    name: str
    position: Vector
    axis: Vector
    radius: float
    radiance: float
    beam: Beam

    @property
    def source(self) -> str:
        """Name of the light that is switched and dimmed as one."""
        return self.name

    @property
    def radiant_intensity(self) -> float:
        """Radiant intensity along the axis, I(0) = radiance x area [W sr^-1]."""
        return self.radiance * math.pi * self.radius**2

    def relative_intensity_at(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """I(theta)/I(0) in the direction of points of the world, shape (n, 3) [m]."""
        away = points - np.asarray(self.position)
        distance = np.maximum(np.linalg.norm(away, axis=1), 1e-300)
        return self.beam.relative_intensity(np.arccos(np.clip(away @ np.asarray(self.axis) / distance, -1.0, 1.0)))


@dataclass(frozen=True, slots=True)
class Luminaire(Emitter):
    """A small sphere that shines in all directions as a table says; its `radiance` is that of the peak.

    Azimuth 0 is the source's x, 90 deg its -y: with z down and "up" along the world's y these are the world's x and y.

    Attributes
    ----------
    x_axis, y_axis : tuple of float
        Of the source, unit vectors in the world.
    table : IntensityTable
        The distribution.
    """

    x_axis: Vector
    y_axis: Vector
    table: IntensityTable

    def relative_intensity_at(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Share of the peak in the direction of points of the world, shape (n, 3) [m]."""
        away = points - np.asarray(self.position)
        x, y, z = (away @ np.asarray(axis) for axis in (self.x_axis, self.y_axis, self.axis))
        return self.table.share(np.arctan2(np.hypot(x, y), z), np.arctan2(-y, x))


@dataclass(frozen=True, slots=True)
class Patch(Emitter):
    """A flat piece of a wide source, which shines from the mean of its corners.

    Its `radius` is that of a disc of the same area.

    Attributes
    ----------
    corners : tuple of tuple of float
        In the world [m], counter-clockwise seen from where it shines to.
    whole : str
        Name of the wide source.
    """

    corners: tuple[Vector, ...]
    whole: str

    @property
    def source(self) -> str:
        """Name of the wide source."""
        return self.whole


@dataclass(frozen=True, slots=True)
class SingleSource:
    """A source of one disc: an LED, a lamp or a plain Lambertian disc.

    Attributes
    ----------
    kind : str
        "led", "lamp", "disc" or "ies".
    emitter : Emitter
        The disc.
    """

    kind: Literal["led", "lamp", "disc", "ies"]
    emitter: Emitter

    @property
    def name(self) -> str:
        """Name of the source."""
        return self.emitter.name


@dataclass(frozen=True, slots=True)
class LedChange:
    """How one LED of a ring differs from the others.

    Attributes
    ----------
    index : int
        Number of the LED, 0 is the first.
    radiance_factor : float
        Factor on the radiance.
    beam_width_factor : float
        Factor on the beam's width.
    axis_tilt : float
        Angle between its axis and the ring's [rad].
    axis_azimuth : float
        Direction of the tilt, from the ring's x towards its y [rad].
    """

    index: int
    radiance_factor: float = 1.0
    beam_width_factor: float = 1.0
    axis_tilt: float = 0.0
    axis_azimuth: float = 0.0


@dataclass(frozen=True, slots=True)
class Ring:
    """LEDs evenly on a circle.

    Attributes
    ----------
    name : str
        Unique in the scene.
    pose : Pose
        world_from_ring; the LEDs lie in its xy plane and shine along +z.
    count : int
        Number of LEDs.
    diameter : float
        Diameter of the circle through the LEDs' centres [m].
    first_angle : float
        Angle of LED 0, from the ring's x towards its y [rad].
    led_radius : float
        Radius of each disc [m].
    radiance : float
        Radiance of each LED along its axis [W m^-2 sr^-1].
    beam : Beam
        Angular distribution of each LED.
    misalignment_y, misalignment_z : float
        The whole ring is turned about the world's fixed y axis, then about
        its fixed z axis, both through the ring's centre: R = Rz Ry [rad].
    changes : tuple of LedChange
        LEDs that differ.
    """

    name: str
    pose: Pose
    count: int
    diameter: float
    first_angle: float
    led_radius: float
    radiance: float
    beam: Beam
    misalignment_y: float = 0.0
    misalignment_z: float = 0.0
    changes: tuple[LedChange, ...] = ()

    @property
    def turned_pose(self) -> Pose:
        """world_from_ring after the misalignment."""
        misalignment = multiply(rotation_about("z", self.misalignment_z), rotation_about("y", self.misalignment_y))
        return replace(self.pose, rotation=multiply(misalignment, self.pose.rotation))


@dataclass(frozen=True, slots=True)
class WideSource:
    """A source too wide to shine from one point: a surface of even radiance, cut into patches.

    Attributes
    ----------
    name : str
        Unique in the scene.
    kind : str
        "rectangle", "disc", "area_ring", "dome", "coaxial" or "surround".
    pose : Pose
        world_from_source; see `wide_shapes` for how it lies and shines.
    shape : WideShape
        The surface.
    radiance : float
        Along the surface's normal [W m^-2 sr^-1].
    beam : Beam
        Angular distribution of each piece of it.
    irradiance_error : float
        Largest relative error of what a visible point gets of it, as asked for.
    least_patches : int
        So many patches at least, for finer half shadows.
    patches : tuple of Patch
        What stands for it; made for the scene by `wide_sources.outlined` or `wide_sources.divided`.
    is_outline : bool
        Whether its patches are but a few that show where it is, whose light is held to no error.
    reached : float
        Largest error that was found.
    step : float
        Largest share that one patch has of what a point gets.
    """

    name: str
    kind: Literal["rectangle", "disc", "area_ring", "dome", "coaxial", "surround"]
    pose: Pose
    shape: WideShape
    radiance: float
    beam: Beam
    irradiance_error: float
    least_patches: int
    patches: tuple[Patch, ...] = field(default=(), compare=False, repr=False)
    is_outline: bool = field(default=False, compare=False)
    reached: float = field(default=0.0, compare=False)
    step: float = field(default=0.0, compare=False)


Source = SingleSource | Ring | WideSource


def dimmed(source: Source, factor: float) -> Source:
    """The source with a factor on its radiance, and on that of patches which it is cut into."""
    if isinstance(source, SingleSource):
        return replace(source, emitter=replace(source.emitter, radiance=source.emitter.radiance * factor))
    if isinstance(source, WideSource):
        patches = tuple(replace(patch, radiance=patch.radiance * factor) for patch in source.patches)
        return replace(source, radiance=source.radiance * factor, patches=patches)
    return replace(source, radiance=source.radiance * factor)


def emitters(source: Source) -> tuple[Emitter, ...]:
    """The discs or patches that a source consists of, dark ones included."""
    if isinstance(source, WideSource):
        return source.patches
    if isinstance(source, SingleSource):
        return (source.emitter,)
    pose = source.turned_pose
    return tuple(_led(source, pose, index) for index in range(source.count))


def _led(ring: Ring, pose: Pose, index: int) -> Emitter:
    change = next((change for change in ring.changes if change.index == index), LedChange(index))
    angle = ring.first_angle + 2 * math.pi * index / ring.count
    place = (ring.diameter / 2 * math.cos(angle), ring.diameter / 2 * math.sin(angle), 0.0)
    tilt, azimuth = change.axis_tilt, change.axis_azimuth
    axis = (math.sin(tilt) * math.cos(azimuth), math.sin(tilt) * math.sin(azimuth), math.cos(tilt))
    return Emitter(
        name=f"{ring.name}.led{index:02d}",
        position=to_world(pose, place),
        axis=normalised(apply_rotation(pose.rotation, axis)),
        radius=ring.led_radius,
        radiance=ring.radiance * change.radiance_factor,
        beam=replace(ring.beam, spread=ring.beam.spread * change.beam_width_factor),
    )
