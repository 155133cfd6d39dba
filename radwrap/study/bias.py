"""How far an algorithm's answer lies from the truth, as one thing changes at a time.

A prediction knows the truth: where the dots and the edge of a scene project to
through the pinhole's centre. What an algorithm finds in the predicted gray
image is compared with that.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.figure_png import figure_png
from radwrap.files import write_bytes
from radwrap.images import ExposureImage, GrayImage
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.response.sensor import gray_image
from radwrap.imaging.synthesis import render
from radwrap.imaging.truth import dot_places, edge_line
from radwrap.manifest import json_text
from radwrap.measure.dots import Method, find_dots
from radwrap.measure.edges import measure_edge
from radwrap.scene.camera import Sensor
from radwrap.scene.file.load import with_value
from radwrap.scene.scene import Scene
from radwrap.scene.targets import DotBoard, EdgeTarget


@dataclass(frozen=True, slots=True)
class BiasPoint:
    """What one algorithm made of one image.

    Attributes
    ----------
    value : float
        What was changed, in the unit of its study.
    method : str
        The algorithm.
    bias_u, bias_v : float
        Mean error along columns and rows [px]; of an edge the error across it and 0.
    scatter : float
        Standard deviation of the errors about their mean [px]; of an edge its reported standard error.
    failure : str
        Why there is no answer; empty where there is one.
    """

    value: float
    method: str
    bias_u: float = 0.0
    bias_v: float = 0.0
    scatter: float = 0.0
    failure: str = ""

    @property
    def bias(self) -> float:
        """Length of the mean error [px]."""
        return math.hypot(self.bias_u, self.bias_v)


@dataclass(frozen=True, slots=True)
class Study:
    """A curve for each algorithm.

    Attributes
    ----------
    name : str
        File name without ending.
    title : str
        What was studied.
    axis : str
        What was changed, with its unit.
    points : tuple of BiasPoint
        The answers.
    """

    name: str
    title: str
    axis: str
    points: tuple[BiasPoint, ...]


def dot_bias(
    value: float, scene: Scene, image: GrayImage, methods: Sequence[Method], **measure: Any
) -> list[BiasPoint]:
    """Errors of dot centres by each method against the true projected centres of the scene's first board."""
    board = next(target for target in scene.targets if isinstance(target, DotBoard))
    places = {(dot.row, dot.column): (dot.u, dot.v) for dot in dot_places(scene.camera, board)}
    points = []
    for method in methods:
        try:
            found = find_dots(
                image,
                board.rows,
                board.columns,
                method=method,
                pitch=board.pitch,
                dot_diameter=board.dot_diameter,
                **measure,
            )
        except InputError as error:
            points.append(BiasPoint(value, method, failure=str(error)))
            continue
        errors = np.array([np.subtract((dot.u, dot.v), places[dot.row, dot.column]) for dot in found.dots])
        points.append(_summary(value, method, errors))
    return points


def _summary(value: float, method: str, errors: NDArray[np.float64]) -> BiasPoint:
    mean = errors.mean(axis=0)
    scatter = float(np.sqrt(((errors - mean) ** 2).sum(axis=1).mean()))
    return BiasPoint(value, method, float(mean[0]), float(mean[1]), scatter)


def edge_bias(
    value: float, scene: Scene, image: GrayImage, methods: Mapping[str, Mapping[str, Any]]
) -> list[BiasPoint]:
    """Error of the edge's position by each way of fitting against the scene's true edge.

    Parameters
    ----------
    value : float
        What was changed.
    scene : Scene
        Holds one edge target.
    image : GrayImage
        Prediction.
    methods : Mapping
        Name -> arguments of `measure_edge`.
    """
    target = next(target for target in scene.targets if isinstance(target, EdgeTarget))
    line = edge_line(scene.camera, target)
    if line is None:
        raise InputError("the edge lies behind the camera", where=f"{scene.origin}: {target.name}")
    sensor = scene.camera.sensor
    points = []
    for name, arguments in methods.items():
        try:
            edge = measure_edge(image, pixel_aspect=sensor.pixel_height / sensor.pixel_width, **arguments)
        except InputError as error:
            points.append(BiasPoint(value, name, failure=str(error)))
            continue
        # The distance of the fitted line's middle point from the true line.
        error_px = float(line.normal @ np.asarray(edge.centre)) - line.offset
        points.append(BiasPoint(value, name, bias_u=error_px, scatter=edge.sigma_position))
    return points


def scaled_gray(exposure: ExposureImage, factor: float, sensor: Sensor) -> GrayImage:
    """Gray image for another exposure time: radiant exposure is proportional to it, so no ray is needed."""
    return gray_image(ExposureImage(exposure.values * factor), sensor)


def write_study(study: Study, folder: Path) -> tuple[Path, Path]:
    """Write a study's numbers as JSON and its curves as PNG; returns both files."""
    numbers, picture = folder / f"{study.name}.json", folder / f"{study.name}.png"
    rows = [asdict(point) for point in study.points]
    write_bytes(numbers, json_text({"title": study.title, "axis": study.axis, "points": rows}).encode())
    write_bytes(picture, _picture(study))
    return numbers, picture


def _picture(study: Study) -> bytes:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 6), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    for number, method in enumerate(dict.fromkeys(point.method for point in study.points)):
        points = [point for point in study.points if point.method == method]
        # Curves may lie on each other: markers differ in shape, and what failed stands on the lower border.
        marker, colour = "osD^v"[number % 5], f"C{number}"
        for axes, quantity in ((above, "bias"), (below, "scatter")):
            values = [math.nan if point.failure else getattr(point, quantity) for point in points]
            axes.plot([point.value for point in points], values, f"{marker}-", color=colour, label=method, alpha=0.8)
        failed = [point.value for point in points if point.failure]
        height = 0.04 + 0.05 * number
        below.plot(failed, [height] * len(failed), "x", color=colour, transform=below.get_xaxis_transform())
    above.set_title(study.title)
    above.set_ylabel("length of mean error [px]")
    below.set_ylabel("scatter [px]")
    below.set_xlabel(study.axis)
    for axes in (above, below):
        axes.set_yscale("log")
        axes.grid(visible=True, which="major", alpha=0.4)
    figure.legend(*above.get_legend_handles_labels(), loc="outside right upper", fontsize="small")
    if any(point.failure for point in study.points):
        figure.supxlabel("x on the lower border: that method gave no answer", fontsize="small", color="0.3")
    return figure_png(figure, dpi=110)


Measure = Callable[[float, Scene, ExposureImage], list[BiasPoint]]


def sweep(
    scene: Scene, key: str, values: Iterable[tuple[float, Any]], options: RenderOptions, measure: Measure
) -> tuple[BiasPoint, ...]:
    """Change one key of a scene, render, measure; all answers in order.

    Parameters
    ----------
    scene : Scene
        What is changed.
    key : str
        Key path in the scene file.
    values : iterable of (float, Any)
        Each value as a number for the axis, and as the scene file would hold it.
    options : RenderOptions
        How to render.
    measure : callable
        Number, changed scene and its radiant exposure -> answers.
    """
    points: list[BiasPoint] = []
    for number, value in values:
        changed = with_value(scene, key, value)
        points += measure(number, changed, render(changed, options=options).radiant_exposure)
    return tuple(points)
