"""Camera: pose, pinhole, sensor."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final, Literal

from radwrap.frames import Pose
from radwrap.manifest import ONLY_WHERE_USED
from radwrap.scene.distortion import Distortion
from radwrap.scene.linear_sensor import LinearSensor
from radwrap.scene.pixel_window import PixelWindow

ApertureShape = Literal["round", "square", "annular", "half_disc"]
ColourChannel = Literal["equal", "red", "green", "blue"]

# Beyond this the float32 of radiant_exposure.exr and the sensor's power law lose their meaning.
MAX_EXPOSURE_TIME: Final = 1e9


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
class Camera:
    """A pinhole in front of a sensor.

    Attributes
    ----------
    pose : Pose
        world_from_camera: x right, y down, z forward; origin in the pinhole's centre.
    focal_length : float
        Distance f from the pinhole to the sensor [m].
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
    """

    pose: Pose
    focal_length: float
    principal_point: tuple[float, float]
    exposure_time: float
    aperture: Aperture
    sensor: Sensor
    distortion: Distortion | None = field(default=None, metadata=ONLY_WHERE_USED)

    @property
    def pitch(self) -> tuple[float, float]:
        """Width and height of a pixel [f]."""
        return self.sensor.pixel_width / self.focal_length, self.sensor.pixel_height / self.focal_length
