"""From radiance to radiant exposure, Eqs. 1 to 3.

H(p) = tau / f^2 * integral over the aperture of L cos^4(theta) dA
     = tau A / f^2 * sum_i w_i mean_j(L_ij cos^4(theta_ij)),

with j over the rays of the pixel. cos^4 is each ray's own. A lens has its image
distance v in place of f, its transmission as a factor, and theta is the angle of
the ray between lens and sensor.
"""

from __future__ import annotations

import numpy as np

from radwrap.errors import InputError
from radwrap.images import ExposureImage, RadianceImage
from radwrap.scene.camera import Camera

_LARGEST_FLOAT32 = float(np.finfo(np.float32).max)


def exposure_of_radiance(camera: Camera) -> float:
    """Radiant exposure of an even field of radiance 1, but for cos^4: tau A/f^2 [s sr] (Eq. 3), of a lens tau A T/v^2.

    With an exposure time of 1 s this is the irradiance [sr].
    """
    return camera.exposure_time * camera.aperture.area * camera.transmission / camera.image_distance**2


def radiant_exposure(radiance: RadianceImage, camera: Camera) -> ExposureImage:
    """Radiant exposure on the sensor.

    Parameters
    ----------
    radiance : RadianceImage
        Mean over the opening of L cos^4(theta) [W m^-2 sr^-1], below 0 taken for 0; its provenance goes along.
    camera : Camera
        For tau, A and f.

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
        # Few rays to a light that is half hidden may be below no light by chance, which no sensor sees.
        values = np.maximum(radiance.values, 0.0) * exposure_of_radiance(camera)
    if not (values <= _LARGEST_FLOAT32).all():
        raise InputError("the radiant exposure overflows", remedy="lower the radiance or the exposure time")
    return ExposureImage(values, radiance.provenance)
