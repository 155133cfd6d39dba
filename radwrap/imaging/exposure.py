"""From radiance to radiant exposure, Eqs. 1 to 3.

H(p) = tau / f^2 * integral over the aperture of L cos^4(theta) dA
     = tau A / f^2 * sum_i w_i mean_j(L_ij cos^4(theta_ij)),

with j over the rays of the pixel. cos^4 is each ray's own. A lens has its image
distance v in place of f, its transmission as a factor, and theta is the angle of
the ray between lens and sensor.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.images import ExposureImage, Provenance
from radwrap.scene.camera import Camera

_LARGEST_FLOAT32 = float(np.finfo(np.float32).max)


def radiant_exposure(
    mean_radiance: NDArray[np.float64], camera: Camera, area: float, provenance: Provenance
) -> ExposureImage:
    """Radiant exposure on the sensor.

    Parameters
    ----------
    mean_radiance : ndarray of float64, shape (rows, columns)
        Area-weighted mean over the aperture of L cos^4(theta) [W m^-2 sr^-1].
    camera : Camera
        For tau and f.
    area : float
        Area A of the aperture [m^2].
    provenance : Mapping
        Goes along with the image.

    Returns
    -------
    ExposureImage
        H [J m^-2].

    Raises
    ------
    InputError
        If it is too large for a float32.
    """
    with np.errstate(over="ignore"):
        values = mean_radiance * (camera.exposure_time * area * camera.transmission / camera.image_distance**2)
    if not (values <= _LARGEST_FLOAT32).all():
        raise InputError("the radiant exposure overflows", remedy="lower the radiance or the exposure time")
    return ExposureImage(values, provenance)
