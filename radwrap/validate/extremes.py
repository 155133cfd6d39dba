"""Extremes: the right number or one clear error, never a silent wrong number."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any, Final

from radwrap.errors import InputError
from radwrap.scene.file.load import scene_from_document
from radwrap.scene.scene import Scene
from radwrap.validate import bench as on
from radwrap.validate.bench import Bench
from radwrap.validate.case import Case, Check, Finding
from radwrap.validate.closed_forms.aperture import pinhole_exposure
from radwrap.validate.closed_forms.sources import point_irradiance, small_disc_intensity

_FLOAT32: Final = 1e-6  # radiances come as float32
_VIEWPOINTS: Final = 1e-4  # the light is a little uneven over what a wider opening sees
_HEIGHT, _ASIDE, _RHO, _LEVEL = 1.0, 0.1, 0.5, 2000.0
_RADIUS: Final = 0.0025
_CLOSED: Final = "H = tau A/f^2 rho/pi I cos^2/d^2"
_REFUSED: Final = "one clear error"
_BAD: Final[tuple[Any, ...]] = (math.nan, math.inf, -math.inf, "nan", "inf m", "nan m", "", [], {})


def _document(**camera: Any) -> dict[str, Any]:
    """One pixel on the axis sees a diffuse sheet, beside a Lambertian lamp of 5 mm."""
    lamp = on.lamp((0, _ASIDE, _HEIGHT), (0, _ASIDE, 0), half_angle=None, diameter=2 * _RADIUS)
    del lamp["radiant_intensity"]
    return {
        "camera": on.camera(**camera),
        "sources": [{**lamp, "radiance": f"{_LEVEL!r} W/m^2/sr"}],
        "materials": {"it": on.lambertian(_RHO)},
        "targets": [on.sheet(2.0)],
    }


def _due(level: float = _LEVEL, tilt: float = 0.0, radius: float = _RADIUS) -> float:
    """Radiant exposure of the pixel in one second."""
    intensity = small_disc_intensity(level, radius, _HEIGHT / math.hypot(_ASIDE, _HEIGHT))
    # The lamp lies in the plane that the tilt leaves alone.
    received = point_irradiance(intensity, _HEIGHT, _ASIDE) * math.cos(tilt)
    return float(pinhole_exposure(_RHO / math.pi * received, on.DIAMETER, on.FOCAL_LENGTH))


def _scene(changes: Mapping[str, Any] | None = None, **camera: Any) -> Scene:
    return scene_from_document(_document(**camera), changes, origin="validate")


def _exposure(bench: Bench, scene: Scene, **how: Any) -> float:
    method = {} if "viewpoints" in how else {"method": "pinhole"}
    return float(bench.render(scene, **method, **how).radiant_exposure.values[0, 0])


def _moved(factor: float, offset: float = 0.0) -> Scene:
    """All lengths larger, opening and sensor too, and moved along x: H depends on neither."""

    def place(*values: float) -> list[str]:
        return on.metres(*(value * factor + move for value, move in zip(values, (offset, 0.0, 0.0), strict=True)))

    camera: dict[str, Any] = {"focal_length": on.metres(on.FOCAL_LENGTH * factor)[0]}
    camera |= {"aperture": {"diameter": on.metres(on.DIAMETER * factor)[0]}}
    changes = {
        "camera.position": place(0, 0, 1),
        "camera.look_at": place(0, 0, 0),
        "sources[0].position": place(0, _ASIDE, _HEIGHT),
        "sources[0].look_at": place(0, _ASIDE, 0),
        "sources[0].diameter": on.metres(2 * _RADIUS * factor)[0],
        "targets[0].position": place(0, 0, 0),
        "targets[0].size": on.metres(2 * factor, 2 * factor),
    }
    return _scene(changes, pitch=(1e-6 * factor, 1e-6 * factor), **camera)


def _openings(bench: Bench) -> Iterator[Finding]:
    def wide(metres: float) -> dict[str, Any]:
        return {"aperture": {"diameter": on.metres(metres)[0]}}

    small = _exposure(bench, _scene(**wide(1e-6)))
    yield Case("10.pinhole_1um", _CLOSED, _due() * 1e-4, small, _FLOAT32)
    none = _scene(aperture={"diameter": "0 m", "exposure_diameter": on.metres(on.DIAMETER)[0]})
    yield Case("10.pinhole_0", _CLOSED, _due(), _exposure(bench, none), _FLOAT32)
    for count in (1, 61):
        found = _exposure(bench, _scene(), viewpoints=count)
        yield Case(f"10.viewpoints_{count}", _CLOSED, _due(), found, _VIEWPOINTS)


def _levels(bench: Bench) -> Iterator[Finding]:
    for seconds in (0.0, 1e-9, 1e6):
        found = _exposure(bench, _scene(exposure_time=f"{seconds!r} s"))
        measure: Any = "relative" if seconds else "absolute"
        limit = _FLOAT32 if seconds else 0.0
        yield Case(f"10.time_{seconds:g}s", _CLOSED, seconds * _due(), found, limit, measure)
    for level in (1e-12, 1e12):
        found = _exposure(bench, _scene({"sources[0].radiance": f"{level!r} W/m^2/sr"}))
        yield Case(f"10.radiance_{level:g}", _CLOSED, _due(level), found, _FLOAT32)
    for gamma in (0.1, 3.0):
        gain = 100 / _due() ** gamma
        sensor = {"gamma": gamma, "gain": f"{gain!r} (J/m^2)^-{gamma}", "dark_gray": 22}
        gray = bench.render(_scene(sensor=sensor), method="pinhole").gray.values
        yield Case(f"10.gamma_{gamma:g}", "Eq. 5", 122.0, float(gray[0, 0]), gamma * _FLOAT32)
    sensor = {"gain": "1e308 (J/m^2)^-1", "saturation_gray": 181, "bit_depth": 8}
    gray = bench.render(_scene(sensor=sensor, exposure_time="1e6 s"), method="pinhole").gray.values
    yield Case("10.gain_overflows", "saturated", 181.0, float(gray[0, 0]), 0.0, "absolute")


def _places(bench: Bench) -> Iterator[Finding]:
    for distance in (2 * on.FOCAL_LENGTH, 1e3):
        found = _exposure(bench, _scene(position=(0.0, 0.0, distance), pitch=(1e-9, 1e-9)))
        yield Case(f"10.distance_{distance:g}m", _CLOSED, _due(), found, _FLOAT32)
    for name, scene in (("1e-3", _moved(1e-3)), ("1e3", _moved(1e3)), ("offset_1e6m", _moved(1.0, 1e6))):
        yield Case(f"10.scene_{name}", _CLOSED, _due(), _exposure(bench, scene), _FLOAT32)
    found = _exposure(bench, _scene({"sources[0].diameter": "1 um"}))
    yield Case("10.led_1um", _CLOSED, _due(radius=5e-7), found, _FLOAT32)
    tilt = {"targets[0].rotation": on.degrees(0, 89.9, 0), "targets[0].size": on.metres(0.6, 0.6)}
    tilted = _scene(tilt, pitch=(1e-9, 1e-9))
    yield Case("10.grazing", _CLOSED, _due(tilt=math.radians(89.9)), _exposure(bench, tilted), _FLOAT32)
    board = {"type": "board", "material": "it", "dot_material": "dot", "rows": 3, "columns": 3}
    board |= {"pitch": "10 mm", "dot_diameter": "10 mm"}
    document = _document() | {"targets": [board]}
    document["materials"]["dot"] = on.lambertian(_RHO / 5)
    touching = scene_from_document(document, origin="validate")
    yield Case("10.dots_that_touch", f"a dot's middle, {_CLOSED}", _due() / 5, _exposure(bench, touching), _FLOAT32)


def _refusals(bench: Bench) -> Iterator[Finding]:
    wide = _is_refused(lambda: _scene({"sources[0].diameter": "1 m"}))
    yield Case("10.led_1m", _REFUSED, 1.0, wide, 0.0, "absolute")
    large = _scene(size=(1000, 1001))
    many = _is_refused(lambda: bench.render(large, method="pinhole", max_pixels=1_000_000))
    yield Case("10.too_many_pixels", _REFUSED, 1.0, many, 0.0, "absolute")
    document = _document()
    leaves = list(_leaves(document))
    tried = [_is_refused(partial(_load_with, document, at, bad)) for at in leaves for bad in _bad_at(at)]
    source = f"{len(leaves)} fields, each NaN, infinite, empty or of another kind: share with one clear error"
    yield Case("10.bad_values", source, 1.0, sum(tried) / len(tried), 0.0, "absolute")
    below = [at for at in leaves if at[-1] in _POSITIVE]
    tried = [_is_refused(partial(_load_with, document, at, _negative(document, at))) for at in below]
    yield Case("10.negative_values", "share with one clear error", 1.0, sum(tried) / len(tried), 0.0, "absolute")
    tried = [_is_refused(partial(_load_with, document, at, None)) for at in below if at not in _DEFAULTS]
    yield Case("10.missing_values", "share with one clear error", 1.0, sum(tried) / len(tried), 0.0, "absolute")
    bench.tick()


_POSITIVE: Final = (
    *("rows", "columns", "pixel_width", "pixel_height", "gain", "gamma", "focal_length", "exposure_time"),
    *("radiance", "diameter", "reflectance", "saturation_gray", "bit_depth"),
)


# Where leaving out means the paper's value.
_DEFAULTS: Final = (("camera", "aperture", "diameter"),)


def _bad_at(at: tuple[Any, ...]) -> Iterator[Any]:
    """What no field takes; "nan" is a name like another."""
    yield from (bad for bad in _BAD if at[-1] != "name" or not isinstance(bad, str) or not bad)


def _leaves(of: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Where in a document its values lie."""
    if isinstance(of, dict | list):
        for key, value in of.items() if isinstance(of, dict) else enumerate(of):
            yield from _leaves(value, (*at, key))
    else:
        yield at


def _load_with(document: dict[str, Any], at: tuple[Any, ...], value: Any) -> Scene:
    """A scene with another value at a place; None leaves it out."""
    changed = copy.deepcopy(document)
    inner: Any = changed
    for key in at[:-1]:
        inner = inner[key]
    if value is None:
        del inner[at[-1]]
    else:
        inner[at[-1]] = value
    return scene_from_document(changed, origin="validate")


def _negative(document: dict[str, Any], at: tuple[Any, ...]) -> Any:
    value: Any = document
    for key in at:
        value = value[key]
    return f"-{value}" if isinstance(value, str) else -value


def _is_refused(what: Callable[[], object]) -> float:
    """1 where there is an error that names a place."""
    try:
        what()
    except InputError as error:
        return float(bool(error.where))
    return 0.0


CHECKS: Final = (
    Check("10.openings", ("10.pinhole_1um", "10.pinhole_0", "10.viewpoints_1", "10.viewpoints_61"), _openings),
    Check(
        "10.levels",
        (
            *("10.time_0s", "10.time_1e-09s", "10.time_1e+06s", "10.radiance_1e-12", "10.radiance_1e+12"),
            *("10.gamma_0.1", "10.gamma_3", "10.gain_overflows"),
        ),
        _levels,
    ),
    Check(
        "10.places",
        (
            *("10.distance_0.02m", "10.distance_1000m", "10.scene_1e-3", "10.scene_1e3", "10.scene_offset_1e6m"),
            *("10.led_1um", "10.grazing", "10.dots_that_touch"),
        ),
        _places,
    ),
    Check(
        "10.refusals",
        ("10.led_1m", "10.too_many_pixels", "10.bad_values", "10.negative_values", "10.missing_values"),
        _refusals,
    ),
)
