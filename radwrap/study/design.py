"""A study as a user writes it: DESIGN.toml to frozen values, everything checked that can be checked without a ray.

Errors name the file and the key, such as ``design.toml: factors.A.levels[1]``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final, Literal, cast

from radwrap.errors import InputError
from radwrap.imaging.mosaicked import plane_of
from radwrap.imaging.render_options import RenderOptions
from radwrap.measure.mosaic import USUAL_COLOUR, Colour, RawChannel
from radwrap.reading import FileKind, read_toml
from radwrap.scene.file.faults import validated
from radwrap.scene.file.keys import with_all_leds
from radwrap.scene.file.load import load_scene
from radwrap.scene.scene import Scene
from radwrap.study.design_responses import read_responses
from radwrap.study.design_tables import DesignModel, FactorModel, RenderModel
from radwrap.study.factors import Factor, Level, quantity, read_draw
from radwrap.study.responses import Response

Kind = Literal["full", "fractional", "latin_hypercube", "list"]
Analysis = Literal["lenth", "anova", "none"]

_DESIGN_FILE: Final = FileKind("design file", 64 << 20)


@dataclass(frozen=True, slots=True)
class Design:
    """A study, checked.

    Attributes
    ----------
    title : str
        For people.
    origin : str
        File it was read from, for messages.
    folder : Path
        Of the base scene, against which its files are resolved.
    scene_origin : str
        Name of the base scene's file.
    document : Mapping
        Tables of the base scene, with what ``[set]`` changes, and every LED listed where a factor names LEDs.
    seed : int
        Of all that is drawn; replicate r renders with seed + r.
    replicates : int
        How often the whole design is run.
    kind : str
        "full", "fractional", "latin_hypercube" or "list".
    plan : Mapping
        Options of the kind.
    render : Mapping
        Options of `RenderOptions`.
    basis : bool or None
        Whether runs that differ only in the levels of sources are made from a light basis; None: where it pays.
    factors : tuple of Factor
    responses : tuple of Response
    analysis : str
        "lenth", "anova" or "none".
    home : Path
        Folder of the design's own file, below which the user's functions lie.
    channel : RawChannel, optional
        Of a colour camera the colour whose pixels are measured; the base scene then has that filter on all pixels.
    """

    title: str
    origin: str
    folder: Path
    scene_origin: str
    document: Mapping[str, Any]
    seed: int
    replicates: int
    kind: Kind
    plan: Mapping[str, Any]
    render: Mapping[str, Any]
    basis: bool | None
    factors: tuple[Factor, ...]
    responses: tuple[Response, ...]
    analysis: Analysis | None
    home: Path = Path()
    channel: RawChannel | None = None


def read_design(path: Path) -> Design:
    """Read a design file and its base scene.

    Raises
    ------
    InputError
        What is wrong, with file and key.
    """
    origin = path.name
    told = validated(DesignModel, read_toml(path, _DESIGN_FILE), origin, "docs/study.md shows a design file")
    scene, channel = _of_one_colour(load_scene(path.parent / told.scene, told.set), told.channel, origin)
    plan = told.design.model_dump(exclude={"kind"})
    responses = read_responses(told.responses, path.parent, f"{origin}: responses")
    factors = _factors(told.factors, told.design.kind, f"{origin}: factors")
    _check_names(factors, responses, origin)
    _check_filters(factors, channel, origin)
    render_options(told.render.given(), f"{origin}: render")
    return Design(
        title=told.title or path.stem,
        origin=origin,
        folder=scene.folder,
        scene_origin=scene.origin,
        document=with_all_leds(json.loads(scene.document), [key for factor in factors for key in factor.keys]),
        seed=told.seed,
        replicates=told.replicates,
        kind=told.design.kind,
        plan=_with_file(plan, path.parent, factors, f"{origin}: design.runs"),
        render=told.render.given(),
        basis=told.render.basis,
        factors=factors,
        responses=responses,
        analysis=cast("Analysis | None", told.analysis),
        home=path.parent,
        channel=channel,
    )


def _check_filters(factors: tuple[Factor, ...], channel: RawChannel | None, origin: str) -> None:
    """Refuse to vary which filters the pixels of a raw image have."""
    for factor in factors:
        if channel is not None and any(key.startswith("camera.sensor.mosaic") for key in factor.keys):
            raise InputError(
                "varies the mosaic, of which the study measures one colour",
                where=f"{origin}: factors.{factor.name}",
                remedy="run one study for each colour",
            )


def _of_one_colour(scene: Scene, colour: Colour | None, origin: str) -> tuple[Scene, RawChannel | None]:
    """The scene with one filter on all pixels, as its pixels of that colour see it, and which these are."""
    mosaic = scene.camera.sensor.mosaic
    if mosaic is None:
        if colour is not None:
            raise InputError(
                "is a colour of a raw mosaic, and all pixels of the scene's sensor have one filter",
                where=f"{origin}: channel",
                remedy='leave it out, or set camera.sensor.mosaic to a pattern such as "RGGB"',
            )
        return scene, None
    channel = RawChannel(mosaic.pattern, colour or USUAL_COLOUR)
    return plane_of(scene, channel.colour), channel


# ---------------------------------------------------------------------------------------------------------- the design


def _with_file(plan: Mapping[str, Any], folder: Path, factors: tuple[Factor, ...], where: str) -> Mapping[str, Any]:
    """The runs of a list, also where they stand in a CSV file."""
    runs = plan.get("runs")
    if not isinstance(runs, str):
        return plan
    from radwrap.study.table import read_table

    table = read_table(folder / runs)
    names = [factor.name for factor in factors]
    if sorted(table.columns) != sorted(names):
        raise InputError(f"its columns must be {', '.join(names)}", where=where)
    return {"runs": [[row[name] for name in names] for row in table.rows]}


# --------------------------------------------------------------------------------------------------------- the factors


def _factors(tables: Mapping[str, FactorModel], kind: Kind, where: str) -> tuple[Factor, ...]:
    if not tables:
        raise InputError("there is none", where=where)
    return tuple(_factor(name, told, kind, f"{where}.{name}") for name, told in tables.items())


def _factor(name: str, told: FactorModel, kind: Kind, where: str) -> Factor:
    keys = (told.key,) if told.key is not None else told.keys or ()
    label = told.label or name
    if told.range is not None:
        if kind != "latin_hypercube":
            raise InputError(f"{kind} needs levels", where=f"{where}.range", remedy='or kind = "latin_hypercube"')
        span, unit = _range(told.range, f"{where}.range")
        return Factor(name, label, keys, (), span, unit)
    if kind == "latin_hypercube":
        raise InputError('latin_hypercube needs range = ["LOW", "HIGH"]', where=where)
    levels = _levels(told.levels, len(keys), f"{where}.levels", is_list=told.keys is not None)
    return Factor(name, label, keys, levels, draw_once=told.draws == "once")


def _range(pair: Any, where: str) -> tuple[tuple[float, float], str]:
    ends = [quantity(value, where) for value in pair] if isinstance(pair, list) and len(pair) == 2 else [None]
    if ends[0] is None or ends[-1] is None or ends[0][1] != ends[-1][1] or not ends[0][0] < ends[-1][0]:
        raise InputError("must be two numbers or quantities of the same unit, the lower first", where=where)
    return (ends[0][0], ends[-1][0]), ends[0][1]


def _levels(given: Any, keys: int, where: str, *, is_list: bool) -> tuple[Level, ...]:
    named: list[tuple[str, Any, str]]
    if isinstance(given, dict):
        named = [(name, value, f"{where}.{name}") for name, value in given.items()]
    elif isinstance(given, list):
        names = _names_of(given)
        named = [(name, value, f"{where}[{i}]") for i, (name, value) in enumerate(zip(names, given, strict=True))]
    else:
        raise InputError("must be an array, or a table of named levels", where=where)
    if len(named) < 2 or len({name for name, _, _ in named}) < len(named):
        raise InputError("needs two or more different levels", where=where)
    for name, _, place in named:
        # A table of results gives names back without blanks around them, and a row is one line.
        if not name or name != name.strip() or not name.isprintable():
            raise InputError(f"{name!r} cannot name a level", where=place, remedy="name it by printable text")
    return tuple(Level(name, _values(value, keys, place, is_list=is_list)) for name, value, place in named)


def _names_of(values: list[Any]) -> list[str]:
    """Levels as tables name them: by their value, where that is short, else L and H, or their number."""
    if all(isinstance(value, str | int | float) for value in values):
        return [str(value) for value in values]
    return ["L", "H"] if len(values) == 2 else [str(number) for number in range(1, len(values) + 1)]


def _values(value: Any, keys: int, where: str, *, is_list: bool) -> tuple[Any, ...]:
    given = value if is_list else [value]
    if not isinstance(given, list) or len(given) != keys:
        raise InputError(f"needs a value for each of the {keys} keys", where=where)
    return tuple(read_draw(item, where) if isinstance(item, dict) else item for item in given)


# -------------------------------------------------------------------------------------------- the rest of what is asked


def _check_names(factors: tuple[Factor, ...], responses: tuple[Response, ...], origin: str) -> None:
    """Names become columns of a table, and letters of interactions."""
    names = [factor.name for factor in factors] + [response.name for response in responses]
    taken = {"run", "replicate", "seed", "warnings", "error", "met", "image_error"}
    errors = {f"{response.name}_error": response.name for response in responses}
    for name in names:
        if not name.isidentifier() or name in taken or names.count(name) > 1:
            raise InputError(
                "cannot name a column", where=f"{origin}: {name}", remedy="use letters, digits and _, each name once"
            )
        if name in errors:
            raise InputError(
                f"is the name of a column already: the error of {errors[name]}",
                where=f"{origin}: {name}",
                remedy="choose another",
            )


def check_render_option(key: str, value: Any, where: str) -> None:
    """Refuse what is no option of a render, or of the wrong type."""
    if key == "tolerance" and isinstance(value, str):
        raise InputError("must be gray levels, so that levels can be compared", where=f"{where}: tolerance")
    validated(RenderModel, {key: value}, where)


def render_options(options: Mapping[str, Any], where: str, **more: Any) -> RenderOptions:
    """Options of a render; raises InputError with the place in the design file."""
    known = {entry.name for entry in fields(RenderOptions)}
    assert known >= set(options)  # noqa: S101  (checked one by one)
    try:
        return RenderOptions(**options, **more)
    except InputError as error:
        raise InputError(error.what, where=f"{where}.{error.where}") from error
