"""What was found of each part."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Part:
    """One part; u is the column, v the row, (0, 0) the centre of the first pixel; angles run from u towards v.

    Attributes
    ----------
    u, v, sigma_u, sigma_v : float
        Centroid of its area and standard errors [px].
    orientation, sigma_orientation : float
        Of the long principal axis, in -pi/2 to pi/2 [rad].
    orientation_ambiguous : bool
        Whether the second moments are too even, as of a disc, a square or a nut, to tell an axis.
    area, sigma_area : float
        Area [px^2], holes not counted.
    major_axis, minor_axis : float
        Axes of the ellipse of the same second moments; blur and pixel are taken out [px].
    rectangle : tuple of float
        Smallest rectangle about the half-level contour: centre u, v, length, width [px].
    rectangle_orientation : float
        Of its longer side, in -pi/2 to pi/2 [rad]; told also where the moments are even, then up to the part's
        own symmetry.
    contours : tuple of ndarray, shape (n, 2)
        Closed lines of half-covered pixels, the outer one first, then holes: u and v of their corners [px]; the last
        corner is the first.
    contrast, noise : float
        Background minus part, and what pixels differ from both levels [gray, or linear light where gamma was given].
    blur_radius : float
        Of the disc that would blur its rim as much [pixel widths].
    touches_border : bool
        Whether it is cut by the image's border; then nothing is told of the whole part.
    """

    u: float
    v: float
    sigma_u: float
    sigma_v: float
    orientation: float
    sigma_orientation: float
    orientation_ambiguous: bool
    area: float
    sigma_area: float
    major_axis: float
    minor_axis: float
    rectangle: tuple[float, float, float, float]
    rectangle_orientation: float
    contours: tuple[NDArray[np.float64], ...] = field(compare=False, repr=False)
    contrast: float
    noise: float
    blur_radius: float
    touches_border: bool


@dataclass(frozen=True, slots=True)
class Ground:
    """What was taken for the background.

    Attributes
    ----------
    gray : float
        Median gray level of its pixels.
    share, border_share : float
        Of all pixels, and of those at the image's border, that lie on it.
    other_share : float
        Share of all pixels beyond it on the side where no parts are looked for.
    """

    gray: float
    share: float
    border_share: float
    other_share: float


@dataclass(frozen=True, slots=True)
class Parts:
    """All parts of an image, from top to bottom.

    Attributes
    ----------
    kind : str
        "dark" parts on a bright background, or "bright" ones on a dark background.
    parts : tuple of Part
        At least one.
    ground : Ground
        The background.
    """

    kind: Literal["dark", "bright"]
    parts: tuple[Part, ...]
    ground: Ground
