"""The wavelength of a scene's light, and the Airy disc of its opening by closed form: rays know no waves."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from radwrap.imaging.optics.view import View
from radwrap.scene.camera import ASSUMED_WAVELENGTH, Camera
from radwrap.scene.scene import Scene

# First zero of the Airy pattern, J1(pi x) = 0, in wavelengths over aperture angle.
_FIRST_ZERO: Final = 1.2196698912665045
# An Airy disc of a smaller radius than this share of a pixel blurs nothing that the pixel does not [px].
_MATTERS: Final = 0.5
# Round openings in units of sqrt(lambda v/|m|): whose edge is steepest in its middle, the maximum of the integral of
# what passes over frequencies, found to 1e-3 (it is flat); and whose edge in focus, 8 d/(3 pi lambda v), is as steep as
# that of the geometric disc, 4/(pi |m| d).
_STEEPEST: Final = 1.61
_IN_FOCUS: Final = 1e-9  # a magnification that is rounding
_BALANCED: Final = 1.5**0.5


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
    deviation : float
        Standard deviation of its wavelengths over their mean: see `WavelengthGroup`.
    """

    view: View
    wavelength: float
    spread: float = 0.0
    names: frozenset[str] | None = None
    deviation: float = 0.0


def light_of_all(scene: Scene, view: View) -> Light:
    """The light of all sources, as one."""
    wavelength = wavelength_of(scene)[0]
    if scene.spectral is None:
        return Light(view, wavelength)
    groups = scene.spectral.wavelength_groups()
    deviation = groups[0].deviation if len(groups) == 1 else 0.0
    return Light(view, wavelength, scene.spectral.wavelength_spread, deviation=deviation)


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


@dataclass(frozen=True, slots=True)
class BestOpening:
    """Round openings that suit the depths in view, by closed form.

    Attributes
    ----------
    steepest_diameter : float
        Whose edges are steepest in their middle where blur is largest [m].
    balanced_diameter : float
        Of a smaller one diffraction takes more of that slope than defocus [m].
    balanced_f_number : float
        Focal length over that.
    """

    steepest_diameter: float
    balanced_diameter: float
    balanced_f_number: float


def best_opening(camera: Camera, wavelength: float, depths: Iterable[float]) -> BestOpening | None:
    """Choose a round opening for depths [m]; None where all lies in focus, where a wider one is always sharper.

    Parameters
    ----------
    camera : Camera
        Its lens, or how far its pinhole lies from the sensor.
    wavelength : float
        [m]
    depths : iterable of float
        What is in view; that of the largest magnification counts.
    """
    largest = max((abs(float(camera.magnification(depth))) for depth in depths), default=0.0)
    if largest < _IN_FOCUS:
        return None
    unit = math.sqrt(wavelength * camera.image_distance / largest)
    balanced = _BALANCED * unit
    return BestOpening(_STEEPEST * unit, balanced, camera.focal_length / balanced)


def diffraction_warning(found: Mapping[str, Any] | None) -> Iterator[str]:
    """What a user should know of it, where it matters."""
    if found is not None and found["matters"] and found["asked"] == "off":
        yield (
            'diffraction at the opening is left out, as camera.diffraction is "off": its Airy disc has a radius of '
            f"{max(found['airy_radius_px']):.2g} pixels at {found['wavelength'] * 1e9:.4g} nm"
        )
