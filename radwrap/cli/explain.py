"""``radwrap explain``: what a scene amounts to and which effects it needs, before an image is made."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final

from radwrap.cli import options as shared
from radwrap.errors import InputError
from radwrap.imaging.forecast.effects import effects
from radwrap.imaging.forecast.explain import explain
from radwrap.imaging.mosaicked import brightest_colour, plane_of
from radwrap.imaging.render_options import RenderOptions
from radwrap.manifest import json_text
from radwrap.scene.mosaic import COLOURS

# Depths of a target that differ by less are one [share].
_FLAT: Final = 1e-4
# Values that a scene seldom says because they are what anybody expects.
_QUIET: Final = re.compile(
    r".*\.(name|rotation|rotation_order|position|up|first_angle|channel|rounding|device_seed|gamma)"
    r"|.*\.(misalignment|defects)\.\w+|camera\.aperture\.(shape|rotation)"
)


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = verbs.add_parser(
        "explain",
        description="Shows what a scene amounts to, and by a few thousand rays which effects it needs: the error in "
        "gray levels of leaving each out.",
    )
    shared.add_scene(parser)
    shared.add_tolerance(parser, "rms error that is wanted")
    parser.add_argument(
        "--seed", metavar="S", type=shared.whole(), default=0, help="seed of all random draws (default 0)"
    )
    parser.add_argument(
        "--assumed", action="store_true", help="list all values that were assumed because the scene does not give them"
    )
    parser.add_argument(
        "--channel",
        choices=COLOURS,
        help="colour of a colour camera whose pixels are looked at (default: that with most light)",
    )
    parser.add_argument("--no-rays", action="store_true", help="closed forms only; needs no Radiance")
    shared.add_tracer(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the verb."""
    scene = shared.load(arguments)
    mosaic, colour = scene.camera.sensor.mosaic, arguments.channel
    if mosaic is not None:
        colour = colour or brightest_colour(scene)
        scene = plane_of(scene, colour)
    elif colour is not None:
        raise InputError(
            "is a colour of a raw mosaic, and the scene's sensor has none", where="--channel", remedy="leave it out"
        )
    measured: dict[str, Any] = {}
    if not arguments.no_rays:
        options = RenderOptions(
            tolerance=arguments.tolerance,
            seed=arguments.seed,
            **shared.tracer_options(arguments),
        )
        measured = effects(scene, options)
    found = explain(scene, measured.get("tracer", {}).get("whole") or ()) | measured
    if mosaic is not None:
        found = {"mosaic": mosaic.pattern, "channel": colour} | found
    print(
        json_text(found) if arguments.json else "\n".join(_lines(found, all_assumed=arguments.assumed)) + "\n", end=""
    )
    return 0


def _asked_first(found: Mapping[str, Any]) -> Iterator[str]:
    """What an engineer asks: millimetres, sharpness, levels and noise, bits, exposure."""
    if "channel" in found:
        yield f"the {found['channel']} pixels of the raw mosaic {found['mosaic']}, as if all had their filter"
    for seen in found["in_sight"]:
        width, height = (f"{size * 1e3:.4g}" for size in seen["field_of_view"])
        across, down = (f"{size * 1e3:.3g}" for size in seen["pixel"])
        pixel = f"{across} mm/px" if across == down else f"{across} x {down} mm/px"
        near, far = seen["nearest"], seen["farthest"]
        deep = f"{near * 1e3:.5g} mm" if far - near < _FLAT * far else f"{near * 1e3:.5g} to {far * 1e3:.5g} mm"
        blur = " to ".join(dict.fromkeys(f"{radius:.2g}" for radius in sorted(seen["blur_radius_px"])))
        yield f"{seen['target']}: {width} x {height} mm in view, {pixel}, {deep} away, blur radius {blur} px"
        wanted = seen["exposure_for_80_percent"]
        there = "" if wanted is None else f"; {wanted * 1e3:.4g} ms bring that to 80 %"
        yield f"{seen['target']}: {_level(seen['middle'])}; at most {_level(seen['peak'])}{there}"
    if not found["in_sight"]:
        yield "no target is in sight"
    if focus := found.get("focus"):
        far = focus["farthest_sharp"]
        end = "infinity" if far is None else f"{far * 1e3:.5g} mm"
        yield f"depth of focus: {focus['nearest_sharp'] * 1e3:.5g} mm to {end} (blur radius below a pixel)"
    yield f"exposure: {found['advice']}"
    if wanted := found["exposure_for_80_percent"]:
        on = found["expected_peak"]["target"]
        yield f"exposure for 80 % at the brightest point in view, on {on}: {wanted * 1e3:.4g} ms"
    if eight := found["eight_bits"]:
        enough = "are enough" if eight["enough"] else "are too few"
        yield (
            f"8 bits {enough}: their step is {eight['step']:g} gray of this camera, one frame's noise on "
            f"{eight['target']} {eight['noise']:.2g}"
        )
    for one in found["motion"]:
        yield from _motion(one)


def _motion(one: Mapping[str, Any]) -> Iterator[str]:
    """How fast a target may run, and how far it goes."""
    if one["half_pixel_speed"] is not None:
        yield (
            f"{one['target']}: half a pixel of smear at {one['half_pixel_speed']:.3g} m/s, as light comes in for "
            f"{one['light_time'] * 1e3:.4g} ms"
        )
    if one["smear"] is not None:
        yield f"{one['target']}: it moves by {one['image_speed']:.4g} px/s at most, {one['smear']:.3g} px meanwhile"


def _level(level: Mapping[str, Any]) -> str:
    """Gray level, electrons and signal-to-noise ratio, as far as they are known."""
    told = [f"gray {level['gray']:.4g}"]
    if level["electrons"] is not None:
        told.append(f"{level['electrons']:.3g} electrons")
        told.append("saturated" if level["snr"] is None else f"SNR {level['snr']:.3g}")
    return ", ".join(told)


def _assumed(found: Mapping[str, Any], *, whole: bool) -> Iterator[str]:
    """Values that were taken because the scene is silent: those that change the image of a usual cell, or all."""
    quiet = 0
    for key, value in found["assumed"].items():
        if not whole and _QUIET.fullmatch(key):
            quiet += 1
            continue
        yield f"assumed: {key} = {value}"
    if quiet:
        yield f"assumed: {quiet} values besides that seldom matter; --assumed lists them"


def _lines(found: Mapping[str, Any], *, all_assumed: bool) -> Iterator[str]:
    yield from _asked_first(found)
    camera = found["scene"]["camera"]
    sensor = camera["sensor"]
    width, height = found["field_of_view_deg"]
    opening = "infinitesimal" if found["f_number"] is None else f"{camera['aperture']['diameter'] * 1e3:g} mm"
    number = "" if found["f_number"] is None else f", F number {found['f_number']:.4g}"
    kind = "pinhole" if found.get("focus") is None else "lens"
    yield (
        f"camera: f {camera['focal_length'] * 1e3:g} mm, {kind} {opening}{number}, exposure "
        f"{camera['exposure_time'] * 1e3:g} ms, field of view {width:.2f} x {height:.2f} deg"
    )
    yield (
        f"sensor: {sensor['columns']} x {sensor['rows']} pixels of {sensor['pixel_width'] * 1e6:g} x "
        f"{sensor['pixel_height'] * 1e6:g} um, G = {sensor['gain']:g} H^{sensor['gamma']:g} + {sensor['dark_gray']:g}, "
        f"saturated at {sensor['saturation_gray']:g}"
    )
    if focus := found.get("focus"):
        far = focus["farthest_sharp"]
        yield (
            f"lens: focused at {camera['lens']['focus_distance']:.4g} m, image at "
            f"{focus['image_distance'] * 1e3:.5g} mm; blurred by less than a pixel from "
            f"{focus['nearest_sharp']:.4g} m to {'infinity' if far is None else f'{far:.4g} m'}"
        )
    if airy := found["diffraction"]:
        u, v = airy["airy_radius_px"]
        yield (
            f"diffraction: Airy radius {airy['airy_radius'] * 1e6:.3g} um, {u:.2g} x {v:.2g} px, at "
            f"{airy['wavelength'] * 1e9:.4g} nm{' (assumed)' if airy['wavelength_assumed'] else ''}; "
            f"{_decided(airy['asked'], found.get('effects', ()))}"
        )
    if best := found["best_opening"]:
        yield (
            f"round opening for the depths in sight: {best['steepest_diameter'] * 1e3:.3g} mm has the steepest edges; "
            f"below {best['balanced_diameter'] * 1e3:.3g} mm (beyond F number {best['balanced_f_number']:.3g}) "
            "diffraction costs more than defocus"
        )
    for source in found["scene"]["sources"]:
        yield f"source: {_source(source)}"
    if spectrum := found.get("spectrum"):
        for name, counts in spectrum["counts"].items():
            factors = ", ".join(
                f"{factor:.4g} of {material}" for material, factor in spectrum["reflectance"][name].items()
            )
            yield f"spectrum of {name}: {counts:.4g} of its radiance counts; reflectance {factors}"
        needed = ", ".join(f"{len(groups)} to {error}" for error, groups in spectrum["bands"].items())
        yield f"bands for a relative error: {needed}; mean wavelength {spectrum['wavelength'] * 1e9:.4g} nm"
    for target in found["targets"]:
        if target["blur_radius_px"] is None:
            yield f"target {target['name']}: its origin lies behind the camera"
            continue
        u, v = target["blur_radius_px"]
        yield (
            f"target {target['name']}: origin {target['depth']:.4g} m along the axis, blur radius there {u:.3g} x "
            f"{v:.3g} px, {target['pinhole_projection_radius'] * 1e3:.3g} mm on the target"
        )
    for ring in found["rings"]:
        for name, angle in ring["observation_angle_deg"].items():
            if angle is not None:
                yield f"ring {ring['name']}: seen from {name} at an observation angle of {angle:.3f} deg"
    whole = found.get("tracer", {}).get("whole") or ()
    for wide in found.get("wide_sources", ()):
        yield f"source {wide['name']}: {_wide(wide, shines_whole=wide['name'] in whole)}"
    if peak := found["expected_peak"]:
        yield (
            f"expected peak: gray {peak['gray']:.1f} ({peak['radiant_exposure']:.3g} J/m^2) on {peak['target']} "
            f"({peak['material']}), by closed form without shadows and blur"
        )
    exposure = found.get("effects_exposure_time", camera["exposure_time"])
    if exposure != camera["exposure_time"]:
        yield f"effects and method are those of an exposure of {exposure * 1e3:.4g} ms, as the scene's saturates"
    for effect in found.get("effects", ()):
        needed = "needed" if effect["needed"] else "not needed"
        yield (
            f"effect {effect['name']}: {needed}; {effect['rms_gray']:.3g} gray rms "
            f"(at most {effect['rms_gray_upper95']:.3g}) if left out: {effect['left_out']}"
        )
    if tracer := found.get("tracer"):
        yield f"tracer: {tracer['name']} ({tracer['reason']}){_probe(tracer)}"
    if planner := found.get("planner"):
        asked = found.get("tolerance_asked", {"asked": "gray levels rms"})["asked"]
        yield f"method for a tolerance of {found['tolerance']:g} ({asked}): {planner['method']} ({planner['why']})"
    for warning in found["warnings"]:
        yield f"warning: {warning}"
    yield from _assumed(found, whole=all_assumed)


def _decided(asked: str, effects: Iterable[Mapping[str, Any]]) -> str:
    """Whether images have diffraction."""
    if asked != "auto":
        return "images have it" if asked == "on" else 'left out (camera.diffraction = "off")'
    needed = [effect["needed"] for effect in effects if effect["name"] == "diffraction"]
    if not needed:
        return "images have it where it matters at their tolerance"
    return f"images of this tolerance {'have it' if needed[0] else 'do without it'}"


def _wide(wide: Mapping[str, Any], *, shines_whole: bool) -> str:
    """What stands for a wide source."""
    if shines_whole:
        return f"shines as a whole; {wide['patches']} patches are what is seen of it and hides"
    return (
        f"{wide['patches']} patches, off by up to {wide['irradiance_error']:.2%} at what is seen; "
        f"{wide['irradiance_error_asked']:.2%} was asked for"
    )


def _probe(tracer: Mapping[str, Any]) -> str:
    """What the comparison of both tracers showed, where there was one."""
    probe = tracer.get("probe")
    return f"; both were compared: {probe['differing']} of {probe['rays']} rays differ" if probe else ""


def _source(source: Mapping[str, Any]) -> str:
    if source["is"] == "Ring":
        return (
            f"{source['name']}, ring of {source['count']} discs on {source['diameter'] * 1e3:g} mm, "
            f"{source['radiance']:g} W/m^2/sr each, {source['beam']['profile']}"
        )
    if source["is"] == "WideSource":
        return f"{source['name']}, {source['kind']}, {source['radiance']:g} W/m^2/sr, {source['beam']['profile']}"
    emitter = source["emitter"]
    return f"{emitter['name']}, {source['kind']}, {emitter['radiance']:g} W/m^2/sr, {emitter['beam']['profile']}"
