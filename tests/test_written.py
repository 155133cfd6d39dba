"""JSON that radwrap wrote, damaged: an error with file and key, whatever stands there now."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import deepcopy
from typing import Any, Final

import pytest

from radwrap.errors import InputError
from radwrap.imaging.output.run_manifest import RunManifest
from radwrap.imaging.run_files import BasisFile
from radwrap.manifest import plain
from radwrap.scene.file.load import scene_from_document
from radwrap.written import read_back
from tests.cli.conftest import scene_with

HASH: Final = 64 * "a"
WRONG: Final = (None, "x", -1, [[]])


def _basis() -> dict[str, Any]:
    camera = scene_from_document(scene_with({})).camera
    return {
        "sources": ["lamp", "second"],
        "dark": [],
        "files": {"basis/lamp.0.exr": HASH},
        "replicates": 8,
        "block": [4, 4],
        "exposure_of_radiance": 1e-5,
        "camera": plain(camera),
        "grid_pixels": [0, 479],
        "model": {"pixels": [3, 4], "stratum": [0, 1], "shares": [0.5, 0.5], "pairs": [2, 2], "rays": 16},
        "tolerance": 0.5,
        "max_error": None,
        "scene_sha256": HASH,
        "tolerances": None,
    }


def _places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    items = value.items() if isinstance(value, dict) else enumerate(value[:1]) if isinstance(value, list) else ()
    for key, item in items:
        yield (*path, key)
        yield from _places(item, (*path, key))


def _changed(told: dict[str, Any], path: tuple[Any, ...], change: Callable[[Any, Any], None]) -> dict[str, Any]:
    copy = deepcopy(told)
    place: Any = copy
    for step in path[:-1]:
        place = place[step]
    change(place, path[-1])
    return copy


def test_a_basis_reads_back_as_it_was_written() -> None:
    told = read_back(_basis(), BasisFile, "basis.json")
    assert told.camera == scene_from_document(scene_with({})).camera
    assert told.block == (4, 4) and told.model.pairs == [2, 2]


def test_no_damage_to_a_basis_is_more_than_an_error_with_its_key() -> None:
    """Each key gone, and each place with each of many wrong values; what is left is of the right type."""
    told, refused = _basis(), 0
    for path in _places(told):
        changes: list[Callable[[Any, Any], None]] = [lambda place, key: place.__delitem__(key)]
        changes += [lambda place, key, value=value: place.__setitem__(key, value) for value in WRONG]
        for change in changes:
            damaged = _changed(told, path, change)
            try:
                found = read_back(damaged, BasisFile, "basis.json")
            except InputError as error:
                assert str(error).startswith("basis.json: ")
                refused += 1
            else:
                assert isinstance(found, BasisFile)
    assert refused > 100


@pytest.mark.parametrize(
    ("path", "value", "says"),
    [
        (("replicates",), -1, r"basis\.json: replicates: .*greater"),
        (("tolerance",), 0, r"basis\.json: tolerance: .*greater"),
        (("grid_pixels", 1), 480, "a pixel that the sensor does not have"),
        (("grid_pixels", 1), -1, r"basis\.json: grid_pixels\[1\]: "),
        (("model", "pixels", 0), 10**9, "a pixel that the sensor does not have"),
        (("model", "stratum", 0), 2, r"basis\.json: model: .*a stratum has no share"),
        (("camera", "sensor", "gain"), "1", r"basis\.json: camera\.sensor\.gain: "),
        (("camera", "sensor", "rows"), 10**9, r"camera\.sensor has 1000000000 rows"),
        (("files", "../x"), HASH, r"basis\.json: files\.\.\./x"),
        (("files", "a/../../x"), "b", r"basis\.json: files\."),
    ],
)
def test_ranges_of_a_basis(path: tuple[Any, ...], value: Any, says: str) -> None:
    damaged = _changed(_basis(), path, lambda place, key: place.__setitem__(key, value))
    with pytest.raises(InputError, match=says):
        read_back(damaged, BasisFile, "basis.json")


def test_a_manifest_without_a_key_is_none() -> None:
    with pytest.raises(
        InputError, match=r"manifest\.json: scene_sha256: field required \(and \d\d more\); .*make it again"
    ):
        read_back({}, RunManifest, "manifest.json")
