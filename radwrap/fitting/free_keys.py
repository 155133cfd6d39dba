"""What is free in a fit: keys of the scene file whose values are numbers."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

from radwrap.errors import InputError
from radwrap.fitting.poses import PREFIX, SHIFTS, TURNS, FreePose, aimed_keys, free_pose, with_poses
from radwrap.reading import shortened
from radwrap.scene.file.keys import expanded, found, set_all, with_all_leds
from radwrap.scene.file.load import scene_from_document, with_camera
from radwrap.scene.scene import Scene
from radwrap.units import DIMENSIONS, parse_gain

_QUANTITY: Final = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(?: (\S.*))?", re.ASCII)
_LAST_INDEX: Final = re.compile(r"(.+)\[(\d{1,9})\]")
_GAIN: Final = "camera.sensor.gain"
_GAMMA: Final = "camera.sensor.gamma"
_STEPS: Final = 50  # of a search for the last value that a scene takes: to 1e-9 of it
# Keys that change nothing of a scene but its camera.
_CAMERAS_OWN: Final = ("camera.exposure_time", "camera.sensor.")
_FAR: Final = 1e6  # times the value: whoever comes so far has no bound
_NEAR: Final = 1e-6  # likewise, towards zero
_SHIFT: Final = 1e-3  # of a value: a key of whole numbers does not take it


@dataclass(frozen=True, slots=True)
class FreeKey:
    """A key of the scene file whose value is sought.

    Attributes
    ----------
    key : str
        Key path, without ``[*]``.
    value : float
        Where the fit begins, in `unit`.
    unit : str
        As the scene file has it; empty for a plain number.
    low, high : float
        Bounds, in `unit`; infinite where there is none.
    """

    key: str
    value: float
    unit: str
    low: float = -math.inf
    high: float = math.inf

    @property
    def scale(self) -> float:
        """What a change of the value is measured by, in `unit`."""
        if self.value:
            return abs(self.value)
        span = self.high - self.low
        return span / 2 if math.isfinite(span) else 1.0

    def written(self, value: float) -> str | float:
        """The value as the scene file would hold it."""
        return f"{value!r} {self.unit}" if self.unit else value


@dataclass(frozen=True, slots=True, eq=False)
class FreeScene:
    """A scene some of whose keys are free.

    Attributes
    ----------
    scene : Scene
        At the values where the fit begins.
    keys : tuple of FreeKey
    poses : tuple of FreePose
        Whose numbers some keys are.
    """

    scene: Scene
    keys: tuple[FreeKey, ...]
    poses: tuple[FreePose, ...] = ()

    def written(self, values: Sequence[float]) -> dict[str, Any]:
        """Key -> value as the scene file would hold it; the unit of a power law's gain goes with gamma."""
        told = {key.key: key.written(float(value)) for key, value in zip(self.keys, values, strict=True)}
        if _GAMMA in told or _GAIN in told:
            document = json.loads(self.scene.document)
            gain = told.get(_GAIN, found(document, _GAIN))
            gamma = told.get(_GAMMA, found(document, _GAMMA))
            if isinstance(gain, str) and gamma is not None:
                told[_GAIN] = f"{parse_gain(gain)[0]!r} (J/m^2)^-{gamma!r}"
        return with_poses(self.poses, told)

    def at(self, values: Sequence[float]) -> Scene:
        """The scene at other values; InputError where it does not take them."""
        scene, written = self.scene, self.written(values)
        if scene.spectral is None and all(key.startswith(_CAMERAS_OWN) for key in written):
            return with_camera(scene, written)  # a third of the time
        return scene_from_document(json.loads(scene.document), written, origin=scene.origin, folder=scene.folder)


def free_scene(scene: Scene, asked: Sequence[str]) -> FreeScene:
    """Read what is to be free.

    Parameters
    ----------
    scene : Scene
        Whose keys they are.
    asked : sequence of str
        ``KEY`` or ``KEY=low:high``, units as in the scene file; ``[*]`` frees every entry of a list by itself.

    Raises
    ------
    InputError
        If a key has no number, is discrete, is named twice, or bounds are wrong.
    """
    if not asked:
        raise InputError("is missing", where="free", remedy='name a key, such as "camera.exposure_time"')
    document = with_all_leds(json.loads(scene.document), [text.partition("=")[0] for text in asked])
    filled = scene_from_document(document, origin=scene.origin, folder=scene.folder)
    begun: list[tuple[FreeKey, bool]] = []
    poses: list[FreePose] = []
    for text in asked:
        name, _, bounds = text.partition("=")
        name = name.strip()
        if name.startswith(PREFIX):
            pose = free_pose(filled, document, name.removeprefix(PREFIX))
            if bounds:
                raise InputError("takes no bounds", where=f"free {shortened(name)}")
            if pose in poses:
                raise InputError("is named twice", where=f"free {name}")
            poses.append(pose)
            units = (["mm"] * len(SHIFTS)) + (["deg"] * len(TURNS))
            begun += [(FreeKey(key, 0.0, unit), True) for key, unit in zip(pose.keys, units, strict=True)]
            continue
        for key in expanded(name, document):
            if any(other.key == key for other, _ in begun):
                raise InputError("is named twice", where=f"free {key}")
            one, document = _begun(filled, document, key, bounds.strip())
            _check_real(scene, document, one)
            begun.append((one, bool(bounds)))
    told = {key.key: key.written(key.value) for key, _ in begun}
    _check_apart(poses, told)
    start = scene_from_document(document, with_poses(poses, told), origin=scene.origin, folder=scene.folder)
    keys = tuple(key if key.key.startswith(PREFIX) else _checked(start, key, is_bounded) for key, is_bounded in begun)
    return FreeScene(start, keys, tuple(poses))


def holds(key: str, other: str) -> bool:
    """Whether a key is another one, or a table or list that holds it."""
    return other == key or other.startswith((f"{key}.", f"{key}["))


def _check_apart(poses: Sequence[FreePose], told: dict[str, Any]) -> None:
    """Refuse a key that a free pose decides."""
    of_poses = {key: value for key, value in told.items() if key.startswith(PREFIX)}
    decided = (*with_poses(poses, of_poses), *aimed_keys(poses))
    for key in told.keys() - of_poses.keys():
        if any(holds(one, key) for one in decided):
            raise InputError("belongs to a pose that is free too", where=f"free {key}", remedy="free one of them")


def _check_real(scene: Scene, document: dict[str, Any], key: FreeKey) -> None:
    """Refuse a key that takes whole numbers only."""
    if key.unit or not isinstance(found(document, key.key), int):
        return
    try:
        scene_from_document(document, {key.key: float(key.value)}, origin=scene.origin, folder=scene.folder)
    except InputError as error:
        raise InputError("takes whole numbers only: discrete keys cannot be fitted", where=f"free {key.key}") from error


def _begun(scene: Scene, document: dict[str, Any], key: str, bounds: str) -> tuple[FreeKey, dict[str, Any]]:
    """A key with its value, and the tables in which it stands; a value that the file leaves out is its default."""
    where = f"free {shortened(key, 200)}"
    value, document = _current(scene, document, key)
    low_text, colon, high_text = bounds.partition(":")
    if bounds and not colon:
        raise InputError(f'"{shortened(bounds)}" is not low:high', where=where)
    if value is None:
        if not bounds:
            raise InputError(
                "has no number in the scene, nor a default",
                where=where,
                remedy="check the spelling against `radwrap schema`; give it a value there, or KEY=low:high",
            )
        low, unit = _number(low_text.strip(), where)
        high = _in_unit(high_text.strip(), unit, where)
        return FreeKey(key, (low + high) / 2, unit, low, high), set_all(document, key, _toml(low, unit), scene.origin)
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise InputError("is not a number: only numbers can be fitted", where=where)
    number, unit = _number(str(value), where)
    if not bounds:
        return FreeKey(key, number, unit), document
    low, high = (_in_unit(text.strip(), unit, where) for text in (low_text, high_text))
    if not low < high:
        raise InputError("the lower bound is not below the upper one", where=where)
    if not low <= number <= high:
        raise InputError(
            f"the scene's value, {value}, lies outside its bounds", where=where, remedy="widen them, or set the value"
        )
    return FreeKey(key, number, unit, low, high), document


def _toml(number: float, unit: str) -> str | float:
    return f"{number!r} {unit}" if unit else number


def _current(scene: Scene, document: dict[str, Any], key: str) -> tuple[Any, dict[str, Any]]:
    """What stands at a key, or is taken there because the file is silent."""
    value = found(document, key)
    if value is not None:
        return value, document
    if key in scene.assumed:
        return scene.assumed[key], document
    entry = _LAST_INDEX.fullmatch(key)
    if entry is not None and entry[1] in scene.assumed:
        texts = [text.strip() for text in scene.assumed[entry[1]].strip("[]").split(",")]
        values = [_toml(*_number(text, key)) for text in texts]
        if int(entry[2]) < len(values):
            return values[int(entry[2])], set_all(document, entry[1], values, scene.origin)
    return None, document


def _number(text: str, where: str) -> tuple[float, str]:
    match = _QUANTITY.fullmatch(text)
    if match is None:
        raise InputError(
            f'"{shortened(text)}" is not a number: only numbers can be fitted',
            where=where,
            remedy='a unit stands after a blank, as in "2 ms"',
        )
    return float(match[1]), match[2] or ""


def _in_unit(text: str, unit: str, where: str) -> float:
    """A bound in the unit of the key's own value."""
    number, own = _number(text, where)
    if own == unit or unit.startswith("(J/m^2)"):  # the unit of a gain is told by gamma
        return number
    kind = next((kind for kind in DIMENSIONS if own in kind.units and unit in kind.units), None)
    if kind is None:
        raise InputError(
            f'"{shortened(text)}" has another unit than the scene\'s value, "{unit}"' if own else f"{text} has no unit",
            where=where,
        )
    return number * kind.units[own] / kind.units[unit]


def _checked(scene: Scene, key: FreeKey, is_bounded: bool) -> FreeKey:
    """The key with the bounds that the scene itself has; a key of whole numbers is refused."""
    free = FreeScene(scene, (key,))
    where = f"free {key.key}"
    refusal = _refusal(free)

    def takes(value: float) -> bool:
        return refusal(value) is None

    shift = _SHIFT * key.scale
    if not (takes(key.value + shift) or takes(key.value - shift)):
        raise InputError(f"the scene takes no value near its own: {refusal(key.value + shift)}", where=where)
    if is_bounded:
        for name, bound in (("lower", key.low), ("upper", key.high)):
            told = refusal(bound)
            if told is not None:
                raise InputError(f"the scene does not take the {name} bound: {told}", where=where)
        return key
    low, high = -math.inf, math.inf
    if not key.value:
        low, high = (end if takes(way) else 0.0 for end, way in ((low, -shift), (high, shift)))
    if key.value and not takes(-key.value):
        low = _last_taken(takes, key.value, _NEAR * key.value)
    if key.value and not takes(_FAR * key.value):
        high = _last_taken(takes, key.value, _FAR * key.value)
    if key.value < 0:
        low, high = high if math.isfinite(high) else -math.inf, low if math.isfinite(low) else math.inf
    return FreeKey(key.key, key.value, key.unit, low, high)


def _refusal(free: FreeScene) -> Callable[[float], str | None]:
    def told(value: float) -> str | None:
        try:
            free.at([value])
        except InputError as error:
            return error.what
        return None

    return told


def _last_taken(takes: Callable[[float], bool], good: float, bad: float) -> float:
    """Between a value that is taken and one that may not be, the last one that is."""
    if takes(bad):
        return bad
    for _ in range(_STEPS):
        middle = math.copysign(math.sqrt(good * bad), good)
        if middle in (good, bad):
            break
        good, bad = (middle, bad) if takes(middle) else (good, middle)
    return good
