"""What diffraction at the opening would add: it is told, not modelled. Rays know no waves."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

from radwrap.scene.scene import Scene

# First zero of the Airy pattern, J1(pi x) = 0, in wavelengths over aperture angle.
_FIRST_ZERO: Final = 1.2196698912665045
_ASSUMED_WAVELENGTH: Final = 550e-9
# An Airy disc of a smaller radius than this share of a pixel blurs nothing that the pixel does not [px].
_MATTERS: Final = 0.5


def diffraction(scene: Scene) -> dict[str, Any] | None:
    """The Airy disc of the camera's opening, 1.22 lambda v/d; None for an infinitesimal pinhole.

    Returns
    -------
    dict
        ``wavelength`` [m], ``wavelength_assumed``, ``airy_radius`` on the
        sensor [m], ``airy_radius_px`` along columns and rows [px],
        ``matters``: whether it is larger than half a pixel.
    """
    camera = scene.camera
    if camera.aperture.is_infinitesimal:
        return None
    known = scene.spectral or camera.sensor.linear
    wavelength = known.wavelength if known else _ASSUMED_WAVELENGTH
    radius = _FIRST_ZERO * wavelength * camera.image_distance / camera.aperture.diameter
    pixels = [radius / camera.sensor.pixel_width, radius / camera.sensor.pixel_height]
    return {
        "wavelength": wavelength,
        "wavelength_assumed": known is None,
        "airy_radius": radius,
        "airy_radius_px": pixels,
        "matters": max(pixels) > _MATTERS,
    }


def diffraction_warning(found: Mapping[str, Any] | None) -> Iterator[str]:
    """What a user should know of it, where it matters."""
    if found is not None and found["matters"]:
        yield (
            "diffraction at the opening is not modelled: its Airy disc has a radius of "
            f"{max(found['airy_radius_px']):.2g} pixels at {found['wavelength'] * 1e9:.4g} nm"
        )
