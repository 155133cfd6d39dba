"""What a scene amounts to, told before a ray is traced."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import replace
from typing import Any, Final

import numpy as np

from radwrap.errors import InputError
from radwrap.imaging.forecast.in_sight import ADVISED_SHARE, eight_bits, exposure_for_advice, in_sight, told
from radwrap.imaging.forecast.preview import Brightest, brightest, spread_look
from radwrap.imaging.forecast.time_effects import speeds
from radwrap.imaging.optics.diffraction import best_opening, diffraction, diffraction_warning, wavelength_of
from radwrap.imaging.response.exposure import exposure_of_radiance
from radwrap.imaging.response.sensor import unclipped_gray
from radwrap.manifest import SCHEMA_VERSION, finite, plain
from radwrap.scene.bands import scene_bands
from radwrap.scene.camera import Camera
from radwrap.scene.file.load import with_camera
from radwrap.scene.instants import averaged
from radwrap.scene.look.checks import warnings_of
from radwrap.scene.look.geometry import project
from radwrap.scene.look.wide_sources import divided
from radwrap.scene.scene import Scene
from radwrap.scene.sources import Ring, WideSource, emitters
from radwrap.scene.spectrum import Spectral

# Below this share of the gray range above dark the image is called dim; the advice aims at the other one.
_DIM_SHARE: Final = 0.25
_STROBED: Final = "sources are strobed: the width of their pulses sets their level, not only the exposure time"
# Relative errors of the exposure for which the number of bands is told.
_BAND_ERRORS: Final = (1e-4, 1e-3, 1e-2, 0.1)


def explain(scene: Scene, whole: Collection[str] = ()) -> dict[str, Any]:
    """Sum up a scene.

    Parameters
    ----------
    scene : Scene
        What is there.
    whole : collection of str
        Wide sources that shine as a whole, where the tracer is known (``tracer`` of `effects`): their half shadows come
        in no steps.

    Returns
    -------
    dict
        ``scene`` in SI; ``f_number`` (null for an infinitesimal pinhole);
        ``focus`` of a lens: ``image_distance``, and between which depths the
        circle of confusion is smaller than a pixel, ``nearest_sharp`` and
        ``farthest_sharp`` (null: infinitely far) [m];
        ``spectrum``, where the scene tells spectra: what counts of each
        source's radiance, what each material reflects of it, the bands that
        relative errors need;
        ``diffraction``: what the opening's Airy disc is, see `diffraction`;
        ``best_opening``: round openings for the depths in sight, see `BestOpening`; null where all lies in focus;
        ``targets``: for each its depth [m], blur radius [px] and R of Eq. 8
        [m], at its origin; ``rings``: observation angle at each target [deg];
        ``in_sight``: of each target that is seen its visible depths, what a pixel and the sensor cover there, blur,
        gray levels, electrons and signal-to-noise ratio, and the exposure time that brings the brightest of it to 80 %
        [s], see `InSight`; ``eight_bits``: whether they would do;
        ``exposure_for_80_percent``: the exposure time that brings ``expected_peak`` there [s];
        ``motion``: of each target in sight how fast it may run for half a pixel of smear, and how far it goes, see
        `speeds`;
        ``wide_sources``, where there are any: patches, and the error asked for and found;
        ``expected_peak``: gray, irradiance on the sensor [W m^-2] and radiant
        exposure [J m^-2] by closed form (no shadows, no blur but that of a
        source that is seen itself) and where; ``advice``; ``warnings``; ``assumed``.

    Examples
    --------
    >>> import radwrap
    >>> round(radwrap.explain(radwrap.load_scene("scene.toml"))["f_number"])
    125
    """
    changing = scene
    scene, refusal = _in_patches(averaged(scene))
    camera = scene.camera
    found = brightest(scene)
    airy, seen = diffraction(scene), in_sight(scene, found)
    best = best_opening(
        camera, wavelength_of(scene)[0], [depth for one in seen for depth in (one.nearest, one.farthest)]
    )
    peak = None if found is None else _peak(camera, found)
    # The level of pulses hangs on their width, and not on the exposure time.
    advised = None if found is None or changing.strobes else exposure_for_advice(camera, found.radiance)
    if changing.strobes:
        seen = tuple(replace(one, exposure_for_80_percent=None) for one in seen)
    return {
        "schema_version": SCHEMA_VERSION,
        "in_sight": told(seen),
        "eight_bits": eight_bits(scene, seen),
        "exposure_for_80_percent": advised,
        "scene": {
            "camera": plain(changing.camera),
            "sources": plain(_in_patches(changing)[0].sources if changing.strobes else scene.sources),
            "materials": plain(scene.materials),
            "targets": plain(scene.targets),
            **({"motions": plain(changing.motions)} if changing.motions else {}),
            **({"strobes": plain(changing.strobes)} if changing.strobes else {}),
        },
        "f_number": None if camera.aperture.is_infinitesimal else camera.focal_length / camera.aperture.diameter,
        "field_of_view_deg": [
            math.degrees(2 * math.atan(size / 2 / camera.image_distance))
            for size in (camera.sensor.width, camera.sensor.height)
        ],
        **({"focus": _focus(camera)} if camera.lens else {}),
        "diffraction": airy,
        "best_opening": None if best is None else plain(best, named=False),
        **({"spectrum": _spectrum(scene, scene.spectral)} if scene.spectral else {}),
        "targets": [_target(camera, target.name, target.pose.position) for target in scene.targets],
        "rings": [_ring(scene, source) for source in scene.sources if isinstance(source, Ring)],
        **_wide(scene),
        "motion": speeds(changing, {one.target: min(one.pixel) for one in seen}),
        "expected_peak": peak,
        "advice": _STROBED if changing.strobes else _advice(camera, peak, advised),
        "warnings": [*refusal, *warnings_of(scene, whole), *diffraction_warning(airy)],
        "assumed": dict(sorted(scene.assumed.items())),
    }


def _in_patches(scene: Scene) -> tuple[Scene, tuple[str, ...]]:
    """The scene with patches for wide sources, as Radiance has it; where it refuses, as it is, and a warning."""
    try:
        return divided(scene), ()
    except InputError as refusal:
        return scene, (f"Radiance cannot trace this scene: {refusal}",)


def blur_radius(camera: Camera, depth: float) -> float:
    """Radius of the blur on the sensor [m] of a point at `depth`, (d_p/2)(1 + f/D'); Eq. 8 seen from the sensor.

    Behind a lens the circle of confusion, (d/2) v |1/D' - 1/s|.
    """
    return camera.aperture.diameter / 2 * abs(float(camera.magnification(depth)))


def _spectrum(scene: Scene, spectral: Spectral) -> dict[str, Any]:
    """The integrals over wavelength; radiances of the scene's sources are already what counts."""
    reflectance = {
        source: dict(zip(spectral.materials, row, strict=True))
        for source, row in zip(spectral.sources, spectral.reflectance, strict=True)
    }
    needed = {f"{error:g}": scene_bands(scene, spectral, error) for error in _BAND_ERRORS}
    return {
        "counts": dict(zip(spectral.sources, spectral.counts, strict=True)),
        "reflectance": reflectance,
        "wavelength": spectral.wavelength,
        "bands": {error: [list(band.sources) for band in found.bands] for error, found in needed.items()},
    }


def _focus(camera: Camera) -> dict[str, float | None]:
    """Image distance, and between which depths the circle of confusion is smaller than a pixel [m]."""
    assert camera.lens is not None  # noqa: S101  (the caller knows)
    inverse = 1 / camera.lens.focus_distance
    pitch = min(camera.sensor.pixel_width, camera.sensor.pixel_height)
    spread = math.inf if camera.aperture.is_infinitesimal else pitch / camera.aperture.diameter / camera.image_distance
    return {
        "image_distance": camera.image_distance,
        "nearest_sharp": 1 / (inverse + spread),
        "farthest_sharp": 1 / (inverse - spread) if inverse > spread else None,
    }


def _target(camera: Camera, name: str, position: tuple[float, float, float]) -> dict[str, Any]:
    _, depths = project(camera, np.array([position]))
    depth = float(depths[0])
    if depth <= 0:
        return {"name": name, "depth": depth, "blur_radius_px": None, "pinhole_projection_radius": None}
    blur = blur_radius(camera, depth)
    return {
        "name": name,
        "depth": depth,
        "blur_radius_px": [blur / camera.sensor.pixel_width, blur / camera.sensor.pixel_height],
        "pinhole_projection_radius": blur * depth / camera.image_distance,
    }


def _ring(scene: Scene, ring: Ring) -> dict[str, Any]:
    """Angle at each target between the pinhole and the ring's LEDs, seen from the target's centre."""
    angles = {}
    leds = np.array([emitter.position for emitter in emitters(ring)])
    for target in scene.targets:
        origin = np.asarray(target.pose.position)
        to_eye = np.asarray(scene.camera.pose.position) - origin
        to_led = leds - origin
        cosine = to_led @ to_eye / (np.linalg.norm(to_led, axis=1) * np.linalg.norm(to_eye))
        angles[target.name] = finite(float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).mean()))
    return {"name": ring.name, "observation_angle_deg": angles}


def _wide(scene: Scene) -> dict[str, Any]:
    """What stands for wide sources; nothing where there is none."""
    told = [
        {
            "name": source.name,
            "patches": len(source.patches),
            "irradiance_error_asked": source.irradiance_error,
            "irradiance_error": source.reached,
            "largest_share_of_a_patch": source.step,
        }
        for source in scene.sources
        if isinstance(source, WideSource)
    ]
    return {"wide_sources": told} if told else {}


def _peak(camera: Camera, found: Brightest) -> dict[str, Any]:
    """Brightest point in view by closed form."""
    irradiance = found.radiance * exposure_of_radiance(replace(camera, exposure_time=1.0))
    exposure = found.radiance * exposure_of_radiance(camera)
    gray = float(unclipped_gray(np.array([exposure]), camera.sensor)[0])
    return {
        "target": found.target,
        "material": found.material,
        "irradiance": irradiance,
        "radiant_exposure": exposure,
        "gray": min(gray, camera.sensor.saturation_gray),
        "gray_without_saturation": finite(gray),
    }


def unsaturated(scene: Scene) -> Scene:
    """The scene, with the advised exposure time where its peak saturates: effects on a saturated image are none."""
    camera = scene.camera
    # A look that misses a highlight finds no saturation where effects on all that is around it can be measured.
    value = spread_look(_in_patches(scene)[0])[0].value
    brightest_seen = float(np.nanmax(value, initial=0.0))
    gray = unclipped_gray(np.array([brightest_seen * exposure_of_radiance(camera)]), camera.sensor)[0]
    if brightest_seen <= 0 or (camera.exposure_time and gray < camera.sensor.saturation_gray):
        return scene
    advised = exposure_for_advice(camera, brightest_seen)
    return with_camera(scene, {"camera.exposure_time": f"{advised!r} s"})


def _advice(camera: Camera, peak: dict[str, Any] | None, advised: float | None) -> str:
    if peak is None:
        return "nothing that is known beforehand was found in view"
    sensor = camera.sensor
    gray, span = peak["gray_without_saturation"], sensor.saturation_gray - sensor.dark_gray
    if advised is None:
        return "no light was found on what the camera sees: check that sources shine there"
    goal = (
        f"an exposure time of {advised * 1e3:.4g} ms brings the brightest point in view, on {peak['target']}, to "
        f"{ADVISED_SHARE:.0%} of the range"
    )
    if camera.exposure_time == 0:
        return f"the exposure time is 0 s, so the image stays dark; {goal}"
    if gray is None or gray >= sensor.saturation_gray:
        return f"saturated; {goal}"
    if gray - sensor.dark_gray < _DIM_SHARE * span:
        return f"dim; {goal}, or a {'lower f-number' if camera.lens else 'wider pinhole'} does"
    return "the exposure fits the sensor"
