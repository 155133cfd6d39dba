"""What the verbs of gauges have in common: the camera, the way to lengths, truth, and the certified error."""

from __future__ import annotations

import argparse
import math
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from radwrap.calibrate.calibrated_plane import plane_from_calibration
from radwrap.cli import options as shared
from radwrap.cli import raw_mosaic
from radwrap.errors import InputError
from radwrap.images import GrayImage
from radwrap.imaging.output.run_manifest import MANIFEST
from radwrap.manifest import SCHEMA_VERSION, finite, read_manifest
from radwrap.measure.gauges import WAYS, Plane, Response, Scale
from radwrap.reading import FileKind, read_json
from radwrap.scene.file.load import load_scene
from radwrap.scene.look.faces import Face
from radwrap.scene.scene import Scene
from radwrap.study.placed_calipers import aspect_of, named_face, plane_of, response_of
from radwrap.units import ANGLE, LENGTH, parse_quantity

BYTES: Final = 120  # a pixel, as measured
MM: Final = 1e-3
_MOST_DIGITS: Final = 12
_CALIBRATION: Final = FileKind("calibration", 1 << 20, "make one by `radwrap calibrate camera --json`")
_SCALE: Final = re.compile(r"\s*([^\s+]+)\s*(?:\+-\s*(\S+)\s*)?")
# Names of what functions refuse, by the option that gives it.
_OPTIONS: Final = frozenset(
    {
        *(
            "at",
            "radius",
            "inner_radius",
            "band",
            "inside",
            "arc",
            "angle",
            "length",
            "dark",
            "gamma",
            "saturation",
            "pixel_aspect",
        ),
        *(
            "region",
            "against",
            "mm_per_px",
            "plane",
            "shape",
            "cells",
            "noise",
            "truth",
            "against_truth",
            "scene",
            "pose_sigma",
        ),
    }
)


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """An image, and what is known of how it came about.

    Attributes
    ----------
    path : Path
        Of the image.
    image : GrayImage
        Its gray levels.
    response : Response
        Of the camera.
    aspect : float
        Height of a pixel over its width.
    scale : Scale or None
        Of all of the image.
    scene : Scene or None
        What --scene names.
    face : Face or None
        Of the target that the caliper is placed on.
    plane : Plane or None
        That plane.
    truth : str or None
        The target that the caliper is placed on.
    calibrated : bool
        Whether the plane is that of a calibration's board.
    other_plane : bool
        Whether the plane is another one than that of the target that the caliper is placed on.
    """

    path: Path
    image: GrayImage
    response: Response
    aspect: float
    scale: Scale | None
    scene: Scene | None
    face: Face | None
    plane: Plane | None
    truth: str | None
    calibrated: bool = False
    other_plane: bool = False

    @property
    def unit(self) -> str:
        """Of lengths that are told."""
        return "px" if self.scale is None and self.plane is None else "mm"

    @property
    def relative_sigma(self) -> float:
        """Standard error of the way to lengths, as a share."""
        if self.plane is not None:
            return self.plane.relative_sigma
        return 0.0 if self.scale is None else self.scale.relative_sigma

    def told(self, length: float, measured_in: str) -> float:
        """A length in the unit that is told: of [px] or [m]."""
        if measured_in == "m":
            return length / MM
        return length if self.scale is None else length * self.scale.length / MM

    def pixels(self, text: str, where: str, at: tuple[float, float]) -> float:
        """A length that an option gives, in pixels or with a unit, near a place of the image [px]."""
        bare = text.removesuffix("px").strip()
        try:
            value = float(bare)
        except ValueError:
            value = math.nan
        if not math.isnan(value):
            return value
        try:
            length = parse_quantity(text, LENGTH)
        except InputError as error:
            raise InputError(f'"{text}" is neither pixels nor a length', where=where, remedy=error.remedy) from error
        if self.scale is not None:
            return length / self.scale.length
        if self.plane is None:
            raise InputError("needs a scale", where=where, remedy="give --mm-per-px, or --scene and --plane, or pixels")
        ends = np.array(at) + np.array([[-0.5, 0], [0.5, 0], [0, -0.5], [0, 0.5]])
        there = self.plane.to_plane(ends)
        size = math.sqrt(abs(float(np.linalg.det(np.stack([there[1] - there[0], there[3] - there[2]])))) / self.aspect)
        return length / size


def add_response(parser: argparse.ArgumentParser) -> None:
    """--dark, --gamma and --saturation."""
    parser.add_argument(
        "--dark", metavar="G", type=shared.GRAY_LEVEL, help="gray level without light; needed with --gamma"
    )
    parser.add_argument("--gamma", metavar="G", type=shared.number(), help="exponent of the response (default 1)")
    parser.add_argument(
        "--saturation",
        metavar="G",
        type=shared.GRAY_LEVEL,
        help="pixels of this gray level and above are left out (default: full scale)",
    )


def add_look(parser: argparse.ArgumentParser, *, plane: bool) -> None:
    """IMAGE and the options that all gauges of edges have."""
    parser.add_argument("image", metavar="IMAGE", type=Path, help="PNG, TIFF, PGM of 8 or 16 bits, or EXR")
    parser.add_argument(
        "--edge",
        choices=WAYS,
        default="model",
        help="how edges are found: by a fit of the blurred step (default), by the gradient, or by moments of gray "
        "levels along scan lines",
    )
    add_response(parser)
    parser.add_argument(
        "--pixel-aspect", metavar="A", type=shared.number(), help="height of a pixel over its width (default 1)"
    )
    if plane:
        parser.add_argument(
            "--mm-per-px",
            metavar="S",
            help='width of a pixel in the object, with its standard error: "0.0512 +- 0.0001"',
        )
    parser.add_argument(
        "--scene",
        metavar="SCENE.toml",
        help="scene that the image was rendered from: gives the camera's response and pixels where no option does, "
        "and what --truth and --plane name",
    )
    shared.add_changes(parser)
    raw_mosaic.add_to(parser)
    if plane:
        parser.add_argument(
            "--calibration",
            metavar="FILE.json",
            type=Path,
            help="measure in the plane of this calibration's board, in mm; of radwrap calibrate camera --json, whose "
            "covariance gives the scale's error",
        )
        parser.add_argument(
            "--height",
            metavar="LENGTH",
            help="height of what is measured above that board, along its z axis (default 0)",
        )
    parser.add_argument("--truth", metavar="TARGET", help="place the caliper on this target of the scene")
    if plane:
        parser.add_argument(
            "--plane",
            metavar="TARGET",
            help="measure in the face that this target turns to the camera, in mm; default that of --truth",
        )
        parser.add_argument(
            "--pose-sigma",
            metavar="LENGTH",
            help="standard error of that face's distance from the camera (default: the scene's pose is exact)",
        )
    shared.add_json(parser)


def look(arguments: argparse.Namespace, verb: str) -> Look:
    """Read what the options of `add_look` name."""
    changes = shared.overrides_of(arguments)
    scene = None if arguments.scene is None else load_scene(arguments.scene, changes)
    image = raw_mosaic.read(arguments.image, arguments, scene)
    shared.tell_memory(verb, image.values.size, BYTES)
    named = [name for name in ("truth", "plane", "pose_sigma") if getattr(arguments, name, None) is not None]
    if scene is None and (named or changes):
        raise InputError("needs a scene", where=(*named, "set")[0], remedy="give --scene")
    if scene is not None:
        check_size(scene, image, arguments.image)
    aspect = _aspect(arguments.pixel_aspect, scene)
    scale = _scale(getattr(arguments, "mm_per_px", None))
    face, plane = _plane(arguments, scene)
    calibrated = _calibrated(arguments, image)
    if calibrated is not None:
        if plane is not None or scale is not None:
            raise InputError("is given beside another scale", where="calibration", remedy="leave one of them out")
        plane = calibrated
    if scale is not None and plane is not None:
        if arguments.plane is not None:
            raise InputError("is given beside a plane", where="mm_per_px", remedy="leave one of them out")
        plane = None
    known = response(arguments, scene)
    found = Look(arguments.image, image, known, aspect, scale, scene, face, plane, arguments.truth)
    named_plane = getattr(arguments, "plane", None)
    other = calibrated is not None or named_plane not in {None, arguments.truth}
    return replace(found, calibrated=calibrated is not None, other_plane=other)


def response(arguments: argparse.Namespace, scene: Scene | None) -> Response:
    """What options say of the camera's response, and for the rest the scene."""
    dark, gamma, saturation = arguments.dark, arguments.gamma, arguments.saturation
    known = Response() if scene is None else response_of(scene.camera)
    return Response(
        known.dark if dark is None else dark,
        known.gamma if gamma is None else gamma,
        known.saturation if saturation is None else saturation,
    )


def _aspect(given: float | None, scene: Scene | None) -> float:
    if given is not None:
        return given
    return 1.0 if scene is None else aspect_of(scene.camera)


def check_size(scene: Scene, image: GrayImage, path: Path) -> None:
    """Refuse an image that is not of the scene's sensor.

    Raises
    ------
    InputError
        With both sizes.
    """
    rows, columns = image.values.shape
    sensor = scene.camera.sensor
    if (rows, columns) != (sensor.rows, sensor.columns):
        raise InputError(
            f"has {columns} x {rows} pixels, the scene's sensor {sensor.columns} x {sensor.rows}",
            where=str(path),
            remedy="name the scene that it was rendered from, with its `scale` and `roi`",
        )


def _scale(text: str | None) -> Scale | None:
    if text is None:
        return None
    match = _SCALE.fullmatch(text)
    try:
        if match is None:
            raise ValueError
        length, sigma = float(match[1]), float(match[2] or 0.0)
    except ValueError as error:
        raise InputError(f'"{text}" is not a scale', where="mm_per_px", remedy='write "0.0512 +- 0.0001"') from error
    return Scale(length * MM, sigma * MM)


def _plane(arguments: argparse.Namespace, scene: Scene | None) -> tuple[Face | None, Plane | None]:
    """The face that the caliper is placed on, and the plane that is measured in: its own, unless another is named."""
    if scene is None:
        return None, None
    on, plane = (_face(scene, getattr(arguments, name, None), name) for name in ("truth", "plane"))
    face = plane or on
    if face is None:
        return None, None
    sigma = 0.0
    if getattr(arguments, "pose_sigma", None) is not None:
        try:
            sigma = abs(parse_quantity(arguments.pose_sigma, LENGTH))
        except InputError as error:
            raise InputError(error.what, where="pose_sigma", remedy=error.remedy) from error
    return on, plane_of(scene.camera, face, sigma)


def _calibrated(arguments: argparse.Namespace, image: GrayImage) -> Plane | None:
    """The plane of a calibration's board; lengths are known as they are where the caliper is, or in the middle."""
    path = getattr(arguments, "calibration", None)
    height = getattr(arguments, "height", None)
    if path is None:
        if height is not None:
            raise InputError("needs a calibration", where="height", remedy="give --calibration")
        return None
    try:
        above = 0.0 if height is None else parse_quantity(height, LENGTH)
    except InputError as error:
        raise InputError(error.what, where="height", remedy=error.remedy) from error
    rows, columns = image.values.shape
    at = getattr(arguments, "at", None) or ((columns - 1) / 2, (rows - 1) / 2)
    return plane_from_calibration(read_json(path, _CALIBRATION), str(path), (float(at[0]), float(at[1])), above)


def _face(scene: Scene, name: str | None, where: str) -> Face | None:
    try:
        return None if name is None else named_face(scene, name)
    except InputError as error:
        raise InputError(error.what, where=where, remedy=error.remedy) from error


def truth_face(found: Look) -> tuple[Face, Scene]:
    """The face that --truth names, and the scene."""
    if found.face is None or found.scene is None:
        raise InputError("is missing", where="at", remedy="place the caliper by --at, or by --scene and --truth")
    return found.face, found.scene


def angle_of(text: str, where: str) -> float:
    """An angle that an option gives, in degrees or with a unit [rad]."""
    try:
        return math.radians(float(text))
    except ValueError:
        pass
    try:
        return parse_quantity(text, ANGLE)
    except InputError as error:
        raise InputError(error.what, where=where, remedy=error.remedy) from error


def certified(path: Path, image: GrayImage | None = None) -> float | None:
    """Certified bound of the rendered image's rms error [gray], where its manifest lies beside it.

    Of one colour of a raw mosaic that colour's own.
    """
    manifest = path.parent / MANIFEST
    if not manifest.is_file():
        return None
    told = read_manifest(manifest)
    colour = None if image is None else image.provenance.get("colour")
    error = told["mosaic"]["colours"][colour].get("error") if colour and "mosaic" in told else told.get("error")
    if path.name not in told.get("files", {}) or not isinstance(error, dict):
        return None
    bound = error.get("rms_gray_upper95")
    return float(bound) if isinstance(bound, int | float) and math.isfinite(bound) else None


def head(found: Look, way: str) -> dict[str, Any]:
    """What all results begin with."""
    told: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "image": str(found.path),
        "pixel_convention": "u is the column, v the row; the centre of the first pixel is (0, 0)",
        "angles": "rad, from u towards v",
        "edge": way,
        "unit": found.unit,
        "dark": found.response.dark,
        "gamma": found.response.gamma,
        "pixel_aspect": found.aspect,
        "scale_relative_sigma": found.relative_sigma,
        "scale_source": _source(found),
        "certified_rms_gray": certified(found.path, found.image),
    }
    return told


def _source(found: Look) -> str:
    if found.plane is not None and found.calibrated:
        return "the calibration, its errors by their covariance"
    if found.plane is not None:
        known = "its distance's error given" if found.plane.relative_sigma > 0 else "taken as exact"
        return f"the scene's pose, {known}"
    if found.scale is not None:
        return "given" if found.scale.sigma > 0 else "given without an error"
    return "none"


def length_with_errors(found: Look, name: str, values: tuple[float, float, float], measured_in: str) -> dict[str, Any]:
    """A length: value, standard error of noise, that of the scale, and what the rendering's error may change.

    `values` are the length, its standard error, and what an error of one gray level may change.
    """
    value, sigma, by_rendering = values
    error = certified(found.path, found.image)
    told = {
        name: found.told(value, measured_in),
        f"{name}_sigma": found.told(sigma, measured_in),
        f"{name}_sigma_scale": found.told(value, measured_in) * found.relative_sigma,
        f"{name}_rendering": None if error is None else finite(found.told(by_rendering * error, measured_in)),
    }
    return {**told, f"{name}_px": value} if found.scale is not None and measured_in == "px" else told


def with_sigma(value: float, sigma: float, least: int = 4) -> str:
    """A value and its standard error with two digits of it; at least so many decimals, and none more where it is 0."""
    digits = least if not 0 < sigma < math.inf else min(max(least, 1 - math.floor(math.log10(sigma))), _MOST_DIGITS)
    return f"{value:.{digits}f} +- {sigma:.{digits}f}"


def two_digits(sigma: float, least: int = 4) -> str:
    """A standard error alone, likewise."""
    return with_sigma(sigma, sigma, least).split(" ")[0]


def in_words(told: dict[str, Any], name: str, unit: str) -> str:
    """The same in a line."""
    text = f"{with_sigma(told[name], told[f'{name}_sigma'])} {unit}"
    if told[f"{name}_sigma_scale"] > 0:
        text += f", scale +- {two_digits(told[f'{name}_sigma_scale'])}"
    if told[f"{name}_rendering"] is not None:
        text += f", rendering about {two_digits(told[f'{name}_rendering'])}"
    return text


def located(error: InputError, path: Path) -> InputError:
    """The file's name, or the option's, where the function speaks of its arguments."""
    return InputError(error.what, where=error.where if error.where in _OPTIONS else str(path), remedy=error.remedy)
