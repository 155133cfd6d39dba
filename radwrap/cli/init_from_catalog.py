"""``radwrap init DIR --camera ... --lens ... --light ... --part ...``: a scene that renders at once."""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final

from radwrap.cli import options as shared
from radwrap.errors import InputError
from radwrap.files import make_folder, write_bytes
from radwrap.progress import note
from radwrap.reading import FileKind, read_bytes
from radwrap.scene.catalog.component import Component
from radwrap.scene.catalog.places import find, listed
from radwrap.scene.file.first_scene import GROUND_REFLECTANCE, PART_REFLECTANCE, ChosenLight, Part, first_scene

OPTIONS: Final = ("camera", "lens", "light", "part")
SCENE: Final = "scene.toml"
_LONG: Final = 1.0  # s; who exposes longer on purpose is rare at a machine
_LIGHTS: Final = ("lights", "leds", "lamps")
_PART: Final = FileKind("mesh file", 256 << 20)
_COARSE_PIXELS: Final = 20_000  # a thousandth of them is enough for a quantile
_QUANTILE: Final = 99.9
_SAMPLES: Final = 2  # a side of each pixel
_FIRST_EXPOSURE: Final = 1e-3  # of the coarse picture; exposure grows with it [s]


def add_options(parser: argparse.ArgumentParser) -> None:
    """What a scene may be put together from."""
    once = partial(parser.add_argument, action=shared.Once)
    once("--camera", metavar="NAME", help="a sensor of the catalog, see `radwrap catalog list sensors`")
    once("--lens", metavar="NAME", help="a lens of the catalog")
    parser.add_argument(
        "--light",
        metavar="NAME=LEVEL",
        action="append",
        help='a light, LED or lamp of the catalog, such as generic_ring_90mm_24led="50 mW/sr"; without a level that of '
        "its file is assumed; may be repeated",
    )
    once("--filter", metavar="NAME", help="a filter of the catalog, before the lens; not needed")
    once("--part", metavar="FILE", help="mesh of the part, which the camera looks at along -z")
    once("--length-unit", metavar="UNIT", help='what a length of 1 in the mesh is, such as "mm"')


def is_asked(arguments: argparse.Namespace) -> bool:
    """Whether a scene is to be put together; then all of it is named.

    Raises
    ------
    InputError
        If only some of it is, or a template besides.
    """
    given = [name for name in OPTIONS if getattr(arguments, name)]
    if not given:
        if arguments.length_unit is not None:
            raise InputError("goes with --part", where="--length-unit")
        if arguments.filter is not None:
            raise InputError("goes with --camera", where="--filter")
        return False
    for other in ("template", "example"):
        if getattr(arguments, other) is not None:
            raise InputError(f"goes without --{other}", where=f"--{given[0]}", remedy="leave one of them out")
    for name in OPTIONS:
        if name not in given:
            raise InputError(
                "is missing", where=f"--{name}", remedy=f"{', '.join(f'--{n}' for n in OPTIONS)} go together"
            )
    return True


def has_mosaic(arguments: argparse.Namespace) -> bool:
    """Whether the camera's pixels have several colours."""
    return "mosaic" in find("sensors", arguments.camera, None, "--camera").values


def write_scene(arguments: argparse.Namespace, folder: Path) -> tuple[Path, list[str]]:
    """Write the scene and the part into a folder.

    Returns
    -------
    Path, list of str
        The scene's file, and what was assumed in it.

    Raises
    ------
    InputError
        If a name or the part's file is wrong, light cannot reach the part, or files are there already.
    """
    sensor = find("sensors", arguments.camera, None, "--camera")
    lens = find("lenses", arguments.lens, None, "--lens")
    lights = [_light(text) for text in arguments.light]
    source = Path(arguments.part)
    if source.name == SCENE:
        raise InputError("has the scene's name", where="--part", remedy="rename it")
    part = _part(source, arguments.length_unit)
    content = read_bytes(source, _PART, f"--part {source}")
    document = first_scene(part, sensor, lens, lights, _FIRST_EXPOSURE)
    if arguments.filter is not None:
        document["camera"]["filter"] = {"preset": _filter(arguments.filter, lights)}
    is_new = not folder.exists()
    make_folder(folder)
    for name in (part.file, SCENE):
        if (folder / name).exists():
            raise InputError("is there already", where=str(folder / name), remedy="choose another folder")
    write_bytes(folder / part.file, content)
    try:
        exposure = _exposure(document, folder, sensor, lens)
    except BaseException:
        (folder / part.file).unlink(missing_ok=True)
        if is_new:
            folder.rmdir()
        raise
    document["camera"]["exposure_time"] = f"{exposure * 1e3:.4g} ms"
    if exposure > _LONG:
        note(f"an exposure of {exposure:.3g} s: hardly any light arrives; look at levels, distance and filter")
    assumed = _assumed(lights, document)
    write_bytes(folder / SCENE, _text(document, assumed).encode())
    return folder / SCENE, assumed


def _light(text: str) -> ChosenLight:
    name, equals, level = text.partition("=")
    where = f"--light {name}"
    bare = name.partition("@")[0]
    kinds = [kind for kind in _LIGHTS if any(known == bare for known, _, _ in listed(kind))]
    if len(kinds) > 1:
        raise InputError(f"is in {' and in '.join(kinds)}", where=where, remedy="rename your own")
    component: Component = find(kinds[0] if kinds else "lights", name, None, where)
    if equals and not level:
        raise InputError("has no level after =", where=where, remedy="give one, or leave = out")
    return ChosenLight(component, level or None)


def _filter(name: str, lights: list[ChosenLight]) -> str:
    """The name of a filter, where light is known over wavelength."""
    find("filters", name, None, "--filter")
    for light in lights:
        if "spectrum" not in light.component.values:
            raise InputError(
                f"lets through what hangs on wavelength, and {light.component.name} has no spectrum",
                where=f"--filter {name}",
                remedy="take LEDs, see `radwrap catalog list leds`",
            )
    return name


def _part(path: Path, unit: str | None) -> Part:
    """The part's box; a unit is told as "mm" or as a length, "25.4 mm"."""
    from radwrap.scene.mesh_files.parts import joined, read_part_file
    from radwrap.units import LENGTH, parse_quantity

    told = None if unit is None else unit if " " in unit else f"1 {unit}"
    try:
        length = None if told is None else parse_quantity(told, LENGTH)
    except InputError as error:
        raise InputError(error.what, where="--length-unit", remedy=error.remedy) from error
    if length is not None and not length > 0:
        raise InputError("must be above zero", where="--length-unit")
    found = read_part_file(path, folder=path.parent, length_unit=length, where="--part")
    vertices, faces = joined(found.groups)
    used = vertices[faces.ravel()]
    low, high = ([float(value) for value in corner] for corner in (used.min(axis=0), used.max(axis=0)))
    return Part(path.name, told, (low[0], low[1], low[2]), (high[0], high[1], high[2]))


def _exposure(document: Mapping[str, Any], folder: Path, sensor: Component, lens: Component) -> float:
    """Exposure time that brings the 99.9 % quantile of a coarse picture to 80 % of the range [s].

    Behind a mosaic that of the colour that gets most light, each as if all pixels had its filter.
    """
    from radwrap.scene.file.optics_tables import GLASS
    from radwrap.scene.mosaic import COLOURS

    pixels = sensor.values["rows"] * sensor.values["columns"]
    block = max(1, round(math.sqrt(pixels / _COARSE_PIXELS)))
    # A pinhole's picture has no waves; a lens whose glass shapes them does not let the scene leave them out.
    changes: dict[str, Any] = {} if any(key in lens.values for key in GLASS) else {"camera.diffraction": "off"}
    if block > 1:
        changes["camera.sensor.scale"] = f"1/{block}"
    planes = [{"camera.sensor.mosaic": colour} for colour in COLOURS] if "mosaic" in sensor.values else [{}]
    advised = [_exposure_of_one(document, changes | plane, folder) for plane in planes]
    found = [time for time in advised if time is not None]
    if not found:
        raise InputError("no light reaches what the camera sees", where="--light", remedy="choose another light")
    return min(found)


def _exposure_of_one(document: Mapping[str, Any], changes: Mapping[str, Any], folder: Path) -> float | None:
    """As `_exposure`, of a camera whose pixels are all alike; None where nothing is seen."""
    import numpy as np

    from radwrap.imaging.forecast.in_sight import exposure_for_advice
    from radwrap.imaging.optics.falloff import whole_falloff
    from radwrap.imaging.response.exposure import exposure_of_radiance
    from radwrap.imaging.synthesis import render
    from radwrap.scene.file.load import scene_from_document

    scene = scene_from_document(document, changes, origin=SCENE, folder=folder)
    exposure = render(scene, method="pinhole", pixel_samples=_SAMPLES, bounces=0).radiant_exposure.values
    brightest = float(np.percentile(exposure, _QUANTILE)) / exposure_of_radiance(scene.camera)
    # From a wide opening's rim light comes slanted: less than through its middle.
    on_axis = np.array([[0.0, 0.0, scene.camera.image_distance]])
    brightest *= float(whole_falloff(scene.camera, on_axis)[0])
    return exposure_for_advice(scene.camera, brightest)


def _assumed(lights: list[ChosenLight], document: Mapping[str, Any]) -> list[str]:
    """What the user did not say and the image hangs on."""
    told = []
    for number, light in enumerate(lights):
        if light.level is None:
            key, value = next((key, value) for key, value in light.component.values.items() if key.startswith("radian"))
            told.append(f"sources[{number}].{key} = {value}, of the file {light.component.name}")
    told.append(f"materials.part.reflectance = {PART_REFLECTANCE}, matte")
    if "ground" in document["materials"]:
        told.append(f"materials.ground.reflectance = {GROUND_REFLECTANCE}, matte")
    return told


def _text(document: Mapping[str, Any], assumed: list[str]) -> str:
    """The scene's file."""
    from radwrap.scene.catalog.written import toml_value

    lines = [
        "# `radwrap explain scene.toml` says what this scene amounts to, `radwrap catalog show NAME` what a preset is.",
        "# Assumed, as nothing was given:",
        *(f"# - {line}" for line in assumed),
        "# What presets assume, manifest.json lists.",
        f"title = {toml_value(document['title'])}",
    ]

    def table(head: str, values: Mapping[str, Any]) -> None:
        lines.extend(("", head, *(f"{key} = {toml_value(value)}" for key, value in values.items())))

    table("[camera]", document["camera"])
    for one in document["sources"]:
        table("[[sources]]", one)
    for name, one in document["materials"].items():
        table(f"[materials.{name}]", one)
    for one in document["targets"]:
        table("[[targets]]", one)
    return "\n".join(lines) + "\n"
