"""``radwrap convert``: scenes and meshes as files that other programs read."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from radwrap.cli import options as shared
from radwrap.errors import InputError
from radwrap.files import check_result
from radwrap.manifest import json_text
from radwrap.process import Limits
from radwrap.scene.bands import one_band
from radwrap.scene.instants import held, keys_of_time
from radwrap.scene.scene import Scene
from radwrap.tracers.installation import find_radiance
from radwrap.tracers.radiance import RadianceOptions
from radwrap.units import LENGTH, parse_quantity

_DESCRIPTION = (
    "A scene becomes OUT.rad with its function and data files beside it, named OUT.* (oconv OUT.rad works in that "
    "folder), OUT.vf (its central view), OUT.pov for POV-Ray 3.7, or OUT.glb, a preview of its shapes. Of a scene, "
    "or a file of only one target, OUT.svg and OUT.pdf are the target to print, at its true size. A mesh (.stl, "
    ".obj, .ply, .off, .glb, .step) becomes OUT.rad, and its repairs are listed. So does a luminaire (.ies)."
)
_PRINTS: Final = (".svg", ".pdf")
_OF_SCENES: Final = (".rad", ".vf", ".pov", ".glb")
_MESHES: Final = (".stl", ".obj", ".ply", ".off", ".glb", ".step", ".stp")


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = verbs.add_parser(
        "convert",
        description=_DESCRIPTION,
    )
    shared.add_scene(parser)
    parser.add_argument("out", metavar="OUT", help="file to write: .rad, .vf, .pov, .glb, .svg or .pdf; of a mesh .rad")
    parser.add_argument(
        "--length-unit",
        metavar="LENGTH",
        help='length of a mesh file\'s unit, such as "1 mm"; STL, OBJ, PLY and OFF name none',
    )
    parser.add_argument(
        "--materials", metavar="FILE.toml", help='[materials."NAME"] tables for the materials that a mesh names'
    )
    parser.add_argument(
        "--polygons", action="store_true", help="a mesh as polygons in place of Radiance's compiled mesh"
    )
    parser.add_argument("--paper", choices=("a4", "letter"), help="paper of a target to print (default a4)")
    parser.add_argument("--target", metavar="NAME", help="target to print, where a scene has several")
    shared.add_radiance(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the verb."""
    check_result(Path(arguments.out))
    suffix = Path(arguments.scene).suffix.lower()
    if suffix in _MESHES:
        return _convert_mesh(arguments)
    for option in ("length_unit", "materials", "polygons"):
        if getattr(arguments, option):
            raise InputError("goes only with a mesh", where=f"--{option.replace('_', '-')}", remedy="leave it out")
    out = Path(arguments.out)
    if suffix == ".ies":
        from radwrap.convert.ies_files import write_luminaire

        _only_rad(out)
        return _told(write_luminaire(Path(arguments.scene), out, _radiance(arguments)), arguments)
    if out.suffix in _PRINTS:
        return _print(arguments)
    if out.suffix not in _OF_SCENES:
        raise InputError(
            f'cannot write "{out.suffix or out.name}"',
            where=str(out),
            remedy="end the name in .rad, .vf, .pov, .glb, .svg or .pdf",
        )
    for option in ("paper", "target"):
        if getattr(arguments, option):
            raise InputError("goes with a target to print", where=f"--{option}", remedy="end OUT in .svg or .pdf")
    scene = one_band(_one_instant(shared.load(arguments)), "sources")
    # Each writer has its own libraries.
    match out.suffix:
        case ".rad":
            from radwrap.convert.radiance_files import write_scene

            written = write_scene(scene, out, _radiance(arguments))
        case ".vf":
            from radwrap.convert.radiance_files import write_view

            written = write_view(scene, out)
        case ".pov":
            from radwrap.convert.povray_files import write_povray

            written = write_povray(scene, out, _radiance(arguments))
        case _:
            from radwrap.convert.preview_files import write_preview

            written = write_preview(scene, out)
    return _told(written, arguments)


def _one_instant(scene: Scene) -> Scene:
    """The scene as files can hold it, with a warning where it changes in the course of its exposure."""
    if keys := keys_of_time(scene):
        print(
            f"radwrap: warning: {', '.join(keys)}: files know one instant; everything stands where its pose is, and "
            "all light shines",
            file=sys.stderr,
        )
    return held(scene)


def _print(arguments: argparse.Namespace) -> int:
    """A target as a file to print."""
    from radwrap.convert.print_files import write_pdf, write_svg
    from radwrap.scene.file.target_file import load_target

    out = Path(arguments.out)
    name, layout = load_target(arguments.scene, arguments.target, shared.overrides_of(arguments))
    write = write_pdf if out.suffix == ".pdf" else write_svg
    return _told(write(name, layout, out, arguments.paper or "a4"), arguments)


def _told(written: tuple[Path, ...], arguments: argparse.Namespace) -> int:
    if arguments.json:
        print(json_text({"files": [str(path) for path in written]}), end="")
    else:
        print("\n".join(map(str, written)))
    return 0


def _only_rad(out: Path) -> None:
    if out.suffix != ".rad":
        raise InputError(f'cannot write "{out.name}" of that', where=str(out), remedy="end the name in .rad")


def _radiance(arguments: argparse.Namespace) -> RadianceOptions:
    limits = Limits(silence=shared.time_of(arguments.tracer_timeout, "--tracer-timeout"))
    return RadianceOptions(find_radiance(arguments.radiance), arguments.trust, limits)


def _convert_mesh(arguments: argparse.Namespace) -> int:
    from radwrap.convert.mesh_files import DEFAULT_MATERIAL, read_groups, write_mesh
    from radwrap.scene.file.load import load_materials

    out = Path(arguments.out)
    _only_rad(out)
    for given, option in ((arguments.overrides, "set"), (arguments.scale, "scale"), (arguments.roi, "roi")):
        if given:
            raise InputError("goes with a scene only", where=f"--{option}", remedy="leave it out")
    groups = read_groups(Path(arguments.scene), _unit(arguments.length_unit))
    materials = load_materials(arguments.materials) if arguments.materials else {}
    written = write_mesh(groups, out, materials, _radiance(arguments), polygons=arguments.polygons)
    assumed = {group.name: DEFAULT_MATERIAL.reflectance for group in groups if group.name not in materials}
    report = {group.name: {"material": group.word, **group.report} for group in groups}
    warnings = [group.warning for group in groups if group.warning is not None]
    for warning in warnings:
        print(f"radwrap: warning: {warning}", file=sys.stderr)
    if arguments.json:
        found = {
            "files": [str(path) for path in written],
            "groups": report,
            "assumed_reflectance": assumed,
            "warnings": warnings,
        }
        print(json_text(found), end="")
        return 0
    print("\n".join(map(str, written)))
    for group in groups:
        print("\n".join(_lines(group.name, group.report)))
        if group.name in assumed:
            print(f'"{group.name}": reflectance {assumed[group.name]:g} assumed; --materials says another')
    return 0


def _unit(text: str | None) -> float | None:
    if text is None:
        return None
    try:
        unit = parse_quantity(text, LENGTH)
    except InputError as error:
        raise InputError(str(error), where="--length-unit") from error
    if not 1e-9 <= unit <= 1e6:
        raise InputError("must lie between 1 nm and 1000 km", where="--length-unit")
    return unit


def _lines(name: str, report: dict[str, Any]) -> Iterator[str]:
    size = [1e3 * (high - low) for low, high in zip(*report["bounds_m"], strict=True)]
    inside = "no inside" if report["volume_m3"] is None else f"{report['volume_m3'] * 1e9:.6g} mm^3"
    yield (
        f'"{name}": {report["triangles"]} triangles, {" x ".join(f"{side:.6g}" for side in size)} mm, '
        f"{report['area_m2'] * 1e6:.6g} mm^2, {inside}"
    )
    left = report["left_out"]
    faults = {
        "degenerate left out": left["degenerate"],
        "repeated left out": left["duplicate"],
        "turned over": report["flipped"],
        "holes (not filled)": report["holes"],
        "sides of more than two triangles": report["crowded_sides"],
    }
    told = ", ".join(f"{number} {what}" for what, number in faults.items() if number)
    yield f'"{name}": {told or "nothing to repair"}'
