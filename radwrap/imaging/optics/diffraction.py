"""The wavelength of a scene's light, and the Airy disc of its opening by closed form: rays know no waves."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from radwrap.imaging.optics.view import View
from radwrap.scene.camera import ASSUMED_WAVELENGTH
from radwrap.scene.scene import Scene

# First zero of the Airy pattern, J1(pi x) = 0, in wavelengths over aperture angle.
_FIRST_ZERO: Final = 1.2196698912665045
# An Airy disc of a smaller radius than this share of a pixel blurs nothing that the pixel does not [px].
_MATTERS: Final = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Light:
    """Light for which one wavelength stands.

    Attributes
    ----------
    view : View
        The camera in this light alone.
    wavelength : float
        It [m].
    spread : float
        How far what waves add may be off by that, over what they add: see `WavelengthGroup`.
    names : frozenset of str, optional
        Names of the sources; None where it is the light of all.
    """

    view: View
    wavelength: float
    spread: float = 0.0
    names: frozenset[str] | None = None


def light_of_all(scene: Scene, view: View) -> Light:
    """The light of all sources, as one."""
    spread = 0.0 if scene.spectral is None else scene.spectral.wavelength_spread
    return Light(view, wavelength_of(scene)[0], spread)


def wavelength_of(scene: Scene) -> tuple[float, bool]:
    """Wavelength at which diffraction is looked at [m], and whether the scene tells it.

    Of spectra the mean over the light that counts, else that of the linear sensor, else that of the camera, else 550
    nm.
    """
    camera = scene.camera
    if scene.spectral is not None:
        return scene.spectral.wavelength, True
    if camera.sensor.linear is not None:
        return camera.sensor.linear.wavelength, True
    return (ASSUMED_WAVELENGTH, False) if camera.wavelength is None else (camera.wavelength, True)


def diffraction(scene: Scene) -> dict[str, Any] | None:
    """The Airy disc of the camera's opening, 1.22 lambda v/d; None for an infinitesimal pinhole.

    Returns
    -------
    dict
        ``wavelength`` [m], ``wavelength_assumed``, ``airy_radius`` on the
        sensor [m], ``airy_radius_px`` along columns and rows [px],
        ``matters``: whether it is larger than half a pixel; ``asked``: ``camera.diffraction``.
    """
    camera = scene.camera
    if camera.aperture.is_infinitesimal:
        return None
    wavelength, known = wavelength_of(scene)
    radius = _FIRST_ZERO * wavelength * camera.image_distance / camera.aperture.diameter
    pixels = [radius / camera.sensor.pixel_width, radius / camera.sensor.pixel_height]
    return {
        "wavelength": wavelength,
        "wavelength_assumed": not known,
        "airy_radius": radius,
        "airy_radius_px": pixels,
        "matters": max(pixels) > _MATTERS,
        "asked": camera.diffraction or "off",
    }


def diffraction_warning(found: Mapping[str, Any] | None) -> Iterator[str]:
    """What a user should know of it, where it matters."""
    if found is not None and found["matters"] and found["asked"] == "off":
        yield (
            'diffraction at the opening is left out, as camera.diffraction is "off": its Airy disc has a radius of '
            f"{max(found['airy_radius_px']):.2g} pixels at {found['wavelength'] * 1e9:.4g} nm"
        )
