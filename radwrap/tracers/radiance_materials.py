"""Materials as Radiance text, and the words that all of it is written in."""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib.resources import files
from typing import Final, assert_never

from radwrap.frames import Vector
from radwrap.scene.materials import (
    GLASS_BEAD_ENTRANCE_SCALE,
    GLASS_BEAD_OBSERVATION,
    GLASS_BEAD_PROFILE,
    Anisotropic,
    CoefficientTable,
    Glass,
    GlassBeads,
    Lambertian,
    Material,
    MeasuredBrdf,
    Mirror,
    PerturbedNormal,
    PrintedImage,
    PrintedSheeting,
    Specular,
)
from radwrap.scene.targets import Sheet, Target
from radwrap.tracers.text_frame import TextFrame

FUNCTIONS: Final = "radwrap.cal"
MEASURED: Final = "measured.cal"  # only beside scenes that need it


@dataclass(frozen=True, slots=True)
class Placement:
    """Where a target lies, for materials that have a direction.

    Attributes
    ----------
    x_axis, y_axis : tuple of float
        Of the target, unit vectors in the world.
    middle : tuple of float
        The target's origin in the text.
    size : tuple of float
        Width and height of a sheet in the text's unit, 0 of other targets.
    """

    x_axis: Vector = (1.0, 0.0, 0.0)
    y_axis: Vector = (0.0, 1.0, 0.0)
    middle: Vector = (0.0, 0.0, 0.0)
    size: tuple[float, float] = (0.0, 0.0)


def placement(target: Target, frame: TextFrame) -> Placement:
    """Where a target lies in a text."""
    size = (target.width * frame.units, target.height * frame.units) if isinstance(target, Sheet) else (0.0, 0.0)
    return Placement(target.pose.x_axis, target.pose.y_axis, frame.point(target.pose.position), size)


_ANYWHERE: Final = Placement()


def has_direction(material: Material) -> bool:
    """Whether a material must be described for each target that has it, since it hangs on where that lies."""
    return isinstance(material, Anisotropic | PrintedImage)


def number(value: float) -> str:
    """A number that reads back as the same."""
    return repr(value + 0.0)  # + 0.0 turns -0.0 into 0.0


def primitive(modifier: str, kind: str, name: str, numbers: tuple[float, ...] = (), words: tuple[str, ...] = ()) -> str:
    """A primitive with its words and numbers."""
    strings = " ".join([str(len(words)), *words])
    reals = " ".join([str(len(numbers)), *map(number, numbers)])
    return f"{modifier} {kind} {name}\n{strings}\n0\n{reals}\n"


def functions_beside(stem: str, name: str) -> dict[str, bytes]:
    """A file of functions, for texts of that stem."""
    return {f"{stem}.{name}": (files("radwrap") / "data" / "cal" / name).read_bytes()}


def material_text(name: str, data: str, functions: str, material: Material) -> tuple[str, dict[str, bytes]]:
    """A material of that name, and the data files it needs, whose names begin with `data`."""
    return described(name, data, functions, material), data_files(data, functions, material)


def described(name: str, data: str, functions: str, material: Material, place: Placement = _ANYWHERE) -> str:
    """Text of a material of that name; its data file's name begins with `data`."""
    measured = _measured(functions)
    words: tuple[str, ...]
    table: tuple[str, ...]
    numbers: tuple[float, ...]
    match material:
        case Lambertian(reflectance):
            return primitive("void", "plastic", name, (reflectance, reflectance, reflectance, 0, 0))
        case Specular(diffuse, specular, roughness):
            # Metal keeps the specular share the same at all angles; its colour multiplies both parts.
            colour = diffuse + specular
            share = specular / colour if colour else 0.0
            return primitive("void", "metal", name, (colour, colour, colour, share, roughness))
        case Anisotropic(diffuse, specular, along, across):
            colour = diffuse + specular
            share = specular / colour if colour else 0.0
            x, y, z = map(number, place.x_axis)
            numbers = (colour, colour, colour, share, along, across)
            return primitive("void", "metal2", name, numbers, (x, y, z, "."))
        case Mirror(reflectance):
            return primitive("void", "mirror", name, (reflectance, reflectance, reflectance))
        case Glass():
            through = material.transmissivity
            return primitive("void", "glass", name, (through, through, through, material.refractive_index))
        case MeasuredBrdf():
            ends = (math.degrees(material.incidence[-1]), math.degrees(material.viewing[-1]))
            table = ("brdf_as_told", _data_name(data), measured, "incidence_deg", "viewing_deg", "azimuth_deg")
            front = primitive("void", "metdata", f"front.{name}", (1.0, 1.0, 1.0, 1.0, *ends), table)
            return front + _front_only(name, functions)
        case PrintedImage():
            words = ("as_told", _data_name(data), measured, "print_row", "print_column")
            pattern = primitive("void", "brightdata", f"print.{name}", _print_numbers(material, place), words)
            return pattern + primitive(f"print.{name}", "plastic", name, (1.0, 1.0, 1.0, 0.0, 0.0))
        case PrintedSheeting(sheeting, coverage, reflectance):
            below = described(f"sheeting.{name}", data, functions, sheeting)
            ink = primitive("void", "plastic", f"print.{name}", (reflectance, reflectance, reflectance, 0, 0))
            mix = (f"print.{name}", f"sheeting.{name}", "print_share", measured)
            over = primitive("void", "mixfunc", f"front.{name}", (coverage,), mix)
            return below + ink + over + _front_only(name, functions)
        case PerturbedNormal(reflectance, roughness):
            words = ("turned_x", "turned_y", "turned_z", functions)
            return (
                primitive("void", "texfunc", f"turned.{name}", (), words)
                + primitive(
                    f"turned.{name}", "metal", f"front.{name}", (reflectance, reflectance, reflectance, 1, roughness)
                )
                + _front_only(name, functions)
            )
        case CoefficientTable():
            function = f"{material.interpolation}_table"
            limits = (material.observation[0], material.observation[-1], material.entrance[0], material.entrance[-1])
            table = (function, _data_name(data), functions, "observation_deg", "entrance_deg")
            numbers = (1.0, 1.0, 1.0, 1.0, *map(math.degrees, limits))
            return primitive("void", "metdata", f"front.{name}", numbers, table) + _front_only(name, functions)
        case GlassBeads(anchor):
            words = ("glass_beads", _data_name(data), functions, "observation_deg")
            limits_deg = (GLASS_BEAD_OBSERVATION[0], GLASS_BEAD_OBSERVATION[-1], 0.0, 90.0)
            numbers = (1.0, 1.0, 1.0, 1.0, *limits_deg, anchor, GLASS_BEAD_ENTRANCE_SCALE)
            return primitive("void", "metdata", f"front.{name}", numbers, words) + _front_only(name, functions)


def _measured(functions: str) -> str:
    """Name of the file of functions for measured things, beside the other one."""
    return functions.removesuffix(FUNCTIONS) + MEASURED


def _print_numbers(image: PrintedImage, place: Placement) -> tuple[float, ...]:
    """Where a sheet lies, for the functions that ask an image of it."""
    width, height = place.size
    sides = (*(value / width for value in place.x_axis), *(value / height for value in place.y_axis))
    return (*place.middle, *sides, float(len(image.rows[0])), float(len(image.rows)))


def _front_only(name: str, functions: str) -> str:
    """Mix the front's material with a black back, which sheeting has."""
    black = primitive("void", "plastic", f"back.{name}", (0, 0, 0, 0, 0))
    words = (f"front.{name}", f"back.{name}", "front", functions)
    return black + primitive("void", "mixfunc", name, (), words)


def _data_name(data: str) -> str:
    return f"{data}.dat"


def data_files(name: str, functions: str, material: Material) -> dict[str, bytes]:
    """Radiance data files: the nodes of each dimension, then the values, last dimension fastest."""
    beside: dict[str, bytes] = {}
    if isinstance(material, MeasuredBrdf | PrintedImage | PrintedSheeting):
        beside = functions_beside(functions.removesuffix(f".{FUNCTIONS}"), MEASURED)
    match material:
        case CoefficientTable():
            axes: tuple[tuple[float, ...], ...] = (
                tuple(map(math.degrees, material.observation)),
                tuple(map(math.degrees, material.entrance)),
            )
            values = [value for row in material.coefficient for value in row]
            if material.interpolation == "log":
                values = [math.log(value) for value in values]
        case GlassBeads():
            axes = (GLASS_BEAD_OBSERVATION,)
            values = [math.log(value) for value in GLASS_BEAD_PROFILE]
        case MeasuredBrdf():
            angles = (material.incidence, material.viewing, material.azimuth)
            axes = tuple(tuple(map(math.degrees, nodes)) for nodes in angles)
            values = list(material.values)
        case PrintedImage(_, rows):
            axes = (tuple(map(float, range(len(rows)))), tuple(map(float, range(len(rows[0])))))
            values = [value for row in rows for value in row]
        case PrintedSheeting(sheeting):
            return {**beside, **data_files(name, functions, sheeting)}
        case Lambertian() | Specular() | Anisotropic() | Mirror() | Glass() | PerturbedNormal():
            return {}
        case _:
            assert_never(material)
    lines = [str(len(axes))]
    lines += [f"0 0 {len(nodes)} {' '.join(map(number, nodes))}" for nodes in axes]
    lines += [number(value) for value in values]
    return {**beside, _data_name(name): ("\n".join(lines) + "\n").encode()}
