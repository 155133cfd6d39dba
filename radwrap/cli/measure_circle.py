"""``radwrap measure circle``: diameter and centre of a circle, a ring or an ellipse, to a small part of a pixel."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from typing import Any

from radwrap.cli import gauging
from radwrap.cli import options as shared
from radwrap.errors import InputError
from radwrap.manifest import finite, json_text
from radwrap.measure.gauges import Caliper, Circle, measure_circle
from radwrap.study.placed_calipers import RimName, RimPlace, rim_places, side_warnings


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = verbs.add_parser(
        "circle", help="diameter and centre of a circle, a ring or an ellipse", description=__doc__
    )
    gauging.add_look(parser, plane=True)
    parser.add_argument("--at", metavar=("U", "V"), nargs=2, type=shared.number(), help="approximate centre [px]")
    parser.add_argument("--radius", metavar="R", help='approximate radius: pixels, or "3.4 mm" where there is a scale')
    parser.add_argument("--inner-radius", metavar="R", help="approximate radius of a ring's hole, in the same units")
    parser.add_argument(
        "--band", metavar="B", help="rims lie within so much of their radius (default a fifth of it, 4 to 16 px)"
    )
    parser.add_argument(
        "--inside", choices=["bright", "dark"], help="what lies inside the outer rim (default: the stronger step)"
    )
    parser.add_argument(
        "--arc",
        metavar=("FIRST", "EXTENT"),
        nargs=2,
        help="only this part of the rim: first angle from u towards v, and extent, in degrees or with a unit",
    )
    parser.add_argument(
        "--shape",
        choices=["circle", "ellipse"],
        default="circle",
        help="what the rim is in the image, where it is measured in no plane (default circle)",
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the verb."""
    found = gauging.look(arguments, "measure circle")
    plane = None if arguments.shape == "ellipse" else found.plane
    try:
        rims: dict[str, tuple[RimPlace, Circle]] = {}
        places = _places(arguments, found)
        calipers = {
            name: Caliper(
                place.centre,
                place.radius,
                _band(arguments, found, place, [other.radius for other in places.values() if other is not place]),
                arguments.inside if name == "outer" else None,
                _arc(arguments),
            )
            for name, place in places.items()
        }
        for name, caliper in calipers.items():
            circle = measure_circle(
                found.image,
                caliper,
                response=found.response,
                form=arguments.shape,
                plane=plane,
                beside=next((other for other in calipers.values() if other is not caliper), None),
                way=arguments.edge,
                pixel_aspect=found.aspect,
            )
            rims[name] = places[name], circle
    except InputError as error:
        raise gauging.located(error, arguments.image) from error
    told = gauging.head(found, arguments.edge) | {"shape": arguments.shape}
    told |= {name: _told(found, place, circle) for name, (place, circle) in rims.items()}
    print(json_text(told) if arguments.json else "\n".join(_lines(told, list(rims))) + "\n", end="")
    return 0


def _places(arguments: argparse.Namespace, found: gauging.Look) -> dict[RimName, RimPlace]:
    """Outer and inner rim, by hand or by the scene's truth."""
    if arguments.at is None:
        return _true_places(found)
    if arguments.radius is None:
        raise InputError("is missing", where="radius", remedy="give the approximate radius of the circle")
    at = (arguments.at[0], arguments.at[1])
    places: dict[RimName, RimPlace] = {"outer": RimPlace(at, found.pixels(arguments.radius, "radius", at))}
    if arguments.inner_radius is not None:
        places["inner"] = RimPlace(at, found.pixels(arguments.inner_radius, "inner_radius", at))
        if places["inner"].radius >= places["outer"].radius:
            raise InputError("must be smaller than the radius", where="inner_radius")
    return places


def _true_places(found: gauging.Look) -> dict[RimName, RimPlace]:
    face, scene = gauging.truth_face(found)
    try:
        return rim_places(scene.camera, face, found.aspect)
    except InputError as error:
        raise InputError(error.what, where="truth", remedy="place it by --at") from error


def _band(arguments: argparse.Namespace, found: gauging.Look, place: RimPlace, others: list[float]) -> float:
    if arguments.band is not None:
        return found.pixels(arguments.band, "band", place.centre)
    return place.band(others)


def _arc(arguments: argparse.Namespace) -> tuple[float, float] | None:
    if arguments.arc is None:
        return None
    first, extent = (gauging.angle_of(text, "arc") for text in arguments.arc)
    return first, extent


def _told(found: gauging.Look, place: RimPlace, circle: Circle) -> dict[str, Any]:
    names = ["diameter"] if len(circle.diameters) == 1 else ["major_axis", "minor_axis"]
    told: dict[str, Any] = {}
    for number, name in enumerate(names):
        told |= gauging.length_with_errors(
            found,
            name,
            (circle.diameters[number], circle.diameters_sigma[number], circle.diameters_by_rendering[number]),
            circle.unit,
        )
    error = gauging.certified(found.path, found.image)
    told |= {
        "centre": list(circle.centre),
        "centre_sigma": list(circle.centre_sigma),
        "centre_rendering": None if error is None else [finite(by * error) for by in circle.centre_by_rendering],
        "inside": circle.inside,
        "blur_radius": finite(circle.blur),
        "blur_radius_sigma": finite(circle.blur_sigma),
        "misfit": finite(circle.misfit),
        "left_out": circle.left_out,
        "points": circle.points,
        "warnings": [*circle.warnings, *_side(found, place, circle)],
    }
    if circle.orientation is not None:
        told |= {"orientation": circle.orientation, "orientation_sigma": circle.orientation_sigma}
    if circle.centre_in_plane is not None and circle.centre_in_plane_sigma is not None:
        told["centre_mm"] = [value / gauging.MM for value in circle.centre_in_plane]
        told["centre_mm_sigma"] = [value / gauging.MM for value in circle.centre_in_plane_sigma]
    if place.true_diameter is not None:
        told["true_diameter_mm"] = place.true_diameter / gauging.MM
    return told


def _side(found: gauging.Look, place: RimPlace, circle: Circle) -> tuple[str, ...]:
    """What the scene knows of the part's side, where the diameter lies in the plane of the part's own face."""
    if circle.unit != "m" or found.other_plane:
        return ()
    relative = found.relative_sigma
    return side_warnings(place, circle.diameter, math.hypot(circle.diameter_sigma, relative * circle.diameter))


def _lines(told: dict[str, Any], rims: list[str]) -> Iterator[str]:
    for name in rims:
        rim = told[name]
        u, v = rim["centre"]
        su, sv = rim["centre_sigma"]
        if "diameter" in rim:
            yield f"{name}: diameter {gauging.in_words(rim, 'diameter', told['unit'])}"
        else:
            yield f"{name}: an ellipse's major axis {gauging.in_words(rim, 'major_axis', told['unit'])}"
            yield f"  minor axis {gauging.in_words(rim, 'minor_axis', told['unit'])}"
            yield f"  turned by {math.degrees(rim['orientation']):.3f} deg"
        centre = f"u {gauging.with_sigma(u, su)}, v {gauging.with_sigma(v, sv)} px"
        yield f"  centre {centre}; inside is {rim['inside']}"
        if rim["blur_radius"] is not None:
            yield f"  blur: radius {rim['blur_radius']:.3f} px; {rim['left_out']:.0%} of the rim left out"
        if "true_diameter_mm" in rim:
            yield f"  the scene's: {rim['true_diameter_mm']:.4f} mm"
        yield from (f"  warning: {text}" for text in rim["warnings"])
    if told["unit"] == "mm":
        yield f"scale: {told['scale_source']}"
