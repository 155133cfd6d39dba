"""Camera: pose, pinhole or lens, sensor."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal

from radwrap.frames import Pose
from radwrap.manifest import ONLY_WHERE_USED
from radwrap.scene.aberrations import LensGlass
from radwrap.scene.distortion import Distortion
from radwrap.scene.linear_sensor import LinearSensor
from radwrap.scene.mosaic import Mosaic
from radwrap.scene.pixel_window import PixelWindow
from radwrap.scene.shutter import Shutter

# Of light of which a scene says nothing [m].
ASSUMED_WAVELENGTH: Final = 550e-9

ApertureShape = Literal["round", "square", "annular", "half_disc"]
Diffraction = Literal["auto", "on"]
ColourChannel = Literal["equal", "red", "green", "blue"]


@dataclass(frozen=True, slots=True)
class Aperture:
    """The opening in the pinhole plane.

    Attributes
    ----------
    shape : str
        "round", "square", "annular" or "half_disc".
    diameter : float
        Diameter, for "square" the side [m]; 0 is the infinitesimal pinhole.
    inner_diameter : float
        Diameter of the stop in the middle of "annular" [m].
    rotation : float
        Turn about the axis, from the camera's x towards its y [rad]; the half
        disc lies on the +x side of its straight edge before it is turned.
    exposure_diameter : float
        Diameter whose area sets the level of the exposure where `diameter`
        is 0 [m].
    """

    shape: ApertureShape = "round"
    diameter: float = 1e-4
    inner_diameter: float = 0.0
    rotation: float = 0.0
    exposure_diameter: float = 1e-4

    @property
    def is_infinitesimal(self) -> bool:
        """Whether there is no opening to integrate over."""
        return self.diameter == 0.0

    @property
    def area(self) -> float:
        """Area A that sets the exposure [m^2]."""
        diameter = self.exposure_diameter if self.is_infinitesimal else self.diameter
        disc = math.pi * diameter**2 / 4
        match self.shape:
            case "square":
                return diameter**2
            case "half_disc":
                return disc / 2
            case "annular" if not self.is_infinitesimal:
                return disc - math.pi * self.inner_diameter**2 / 4
        return disc

    @property
    def reach(self) -> float:
        """Distance of the farthest opening point from the centre [m]."""
        return self.diameter / 2 * (math.sqrt(2) if self.shape == "square" else 1.0)


@dataclass(frozen=True, slots=True)
class Sensor:
    """Pixels and their response, Eq. 5: G = K H^gamma + G0.

    Attributes
    ----------
    rows, columns : int
        Number of pixels.
    pixel_width, pixel_height : float
        Pixel pitch along columns and rows [m].
    gain : float
        K [gray (J m^-2)^-gamma].
    gamma : float
        Exponent of the response.
    dark_gray : float
        G0, gray level without light.
    saturation_gray : float
        Highest gray level.
    bit_depth : int
        Bits of the digital output, 1 to 16.
    rounding : bool
        Whether gray levels are whole numbers.
    channel : str
        Which of the tracer's three channels the sensor sees; "equal" demands
        that all three agree.
    window : PixelWindow, optional
        Where in its pitch a pixel is sensitive; default all of it, alike.
    linear : LinearSensor, optional
        The linear camera whose mean response the values above are; it has noise.
    mosaic : Mosaic, optional
        The colour filters on its pixels, where they are not all alike.
    shutter : Shutter, optional
        When rows are exposed, where that is not all at once.
    """

    rows: int
    columns: int
    pixel_width: float
    pixel_height: float
    gain: float
    gamma: float
    dark_gray: float
    saturation_gray: float
    bit_depth: int = 8
    rounding: bool = True
    channel: ColourChannel = "equal"
    window: PixelWindow | None = field(default=None, metadata=ONLY_WHERE_USED)
    linear: LinearSensor | None = field(default=None, metadata=ONLY_WHERE_USED)
    mosaic: Mosaic | None = field(default=None, metadata=ONLY_WHERE_USED)
    shutter: Shutter | None = field(default=None, metadata=ONLY_WHERE_USED)

    @property
    def pixels(self) -> int:
        """Number of pixels."""
        return self.rows * self.columns

    @property
    def pixel_area(self) -> float:
        """Area of a pixel's pitch [m^2]."""
        return self.pixel_width * self.pixel_height

    @property
    def width(self) -> float:
        """Width of the sensitive area [m]."""
        return self.columns * self.pixel_width

    @property
    def height(self) -> float:
        """Height of the sensitive area [m]."""
        return self.rows * self.pixel_height


@dataclass(frozen=True, slots=True)
class Lens:
    """A thin lens in the plane of the opening, without aberrations but those that are told.

    Attributes
    ----------
    focus_distance : float
        Distance s from the lens to the plane of sharp focus [m]; larger than the focal length.
    transmission : float
        Share of the light that the glass lets through.
    relative_illumination : tuple of tuple of float, optional
        (height on the sensor [m], illumination as a share of the axis'), as measured: vignetting and cos^4 together,
        in place of cos^4; straight between the heights, held beyond them.
    glass : Wavefront, ContrastTable or PointSpread, optional
        How its waves differ from those of a perfect lens.
    """

    focus_distance: float
    transmission: float = 1.0
    relative_illumination: tuple[tuple[float, float], ...] | None = None
    glass: LensGlass | None = field(default=None, metadata=ONLY_WHERE_USED)


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole, or a thin lens, in front of a sensor.

    Attributes
    ----------
    pose : Pose
        world_from_camera: x right, y down, z forward; origin in the pinhole's centre.
    focal_length : float
        Focal length of the lens; without one the distance f from the pinhole to the sensor [m].
    principal_point : tuple of float
        Where the axis meets the sensor, (u, v) = (column, row) [px]; the
        centre of the first pixel is (0, 0).
    exposure_time : float
        tau [s].
    aperture : Aperture
        The opening.
    sensor : Sensor
        The pixels.
    distortion : Distortion, optional
        How a place on the sensor is off the one where the pinhole alone would put it.
    lens : Lens, optional
        Without it the opening is a pinhole.
    wavelength : float, optional
        At which diffraction is looked at, where neither spectra nor a linear sensor give it [m].
    diffraction : str, optional
        "on", or "auto" where images have it if it matters; without it light is rays.
    """

    pose: Pose
    focal_length: float
    principal_point: tuple[float, float]
    exposure_time: float
    aperture: Aperture
    sensor: Sensor
    distortion: Distortion | None = field(default=None, metadata=ONLY_WHERE_USED)
    lens: Lens | None = field(default=None, metadata=ONLY_WHERE_USED)
    wavelength: float | None = field(default=None, metadata=ONLY_WHERE_USED)
    diffraction: Diffraction | None = field(default=None, metadata=ONLY_WHERE_USED)

    @property
    def pitch(self) -> tuple[float, float]:
        """Width and height of a pixel [image distance]."""
        return self.sensor.pixel_width / self.image_distance, self.sensor.pixel_height / self.image_distance

    @property
    def image_distance(self) -> float:
        """Distance from the opening to the sensor [m]: f of a pinhole, f s/(s - f) of a lens focused at s."""
        if self.lens is None:
            return self.focal_length
        return image_distance(self.focal_length, self.lens.focus_distance)

    @property
    def shear(self) -> float:
        """k: the ray through the opening's point q to the erect image point x' has the direction (x' + k q, v).

        1 for a pinhole, whose rays meet in the pixel. Rays of a lens meet in
        the plane of focus s: k = -v/s.
        """
        return 1.0 if self.lens is None else -self.image_distance / self.lens.focus_distance

    @property
    def transmission(self) -> float:
        """Share of the light that passes the opening."""
        return 1.0 if self.lens is None else self.lens.transmission

    def magnification(self, depth: Any) -> Any:
        """M = k + v/z of what lies at a depth z [m], or depths: a point that is seen through q appears at x' - m q.

        1 + f/z for a pinhole; v (1/z - 1/s) for a lens: 0 in the plane of focus, below 0 behind it.
        """
        return self.shear + self.image_distance / depth

    def pencil_scale(self, depth: float) -> float:
        """Size of a pixel's pencil of rays at a depth [m], in terms of the opening: 1 + z/f, |1 - z/s| for a lens."""
        return abs(1 + self.shear * depth / self.image_distance)

    @property
    def without_lens(self) -> Camera:
        """The pinhole camera whose central rays are the same."""
        return self if self.lens is None else replace(self, focal_length=self.image_distance, lens=None)


def image_distance(focal_length: float, focus_distance: float) -> float:
    """Distance from a thin lens to its sensor [m]: f s/(s - f)."""
    return focal_length * focus_distance / (focus_distance - focal_length)
