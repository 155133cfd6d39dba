"""Binary glTF files: what is not read is refused by name, and nothing is placed before it is counted."""

import copy
import json
import struct
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from radwrap.errors import InputError
from radwrap.scene.mesh_files import parts
from radwrap.scene.mesh_files.glb_checks import MOST_NODES
from radwrap.scene.mesh_files.parts import read_part_file

PLACES = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes()
NUMBERS = np.array([0, 1, 2], "<u4").tobytes()
PLAIN: dict[str, Any] = {
    "asset": {"version": "2.0"},
    "scene": 0,
    "scenes": [{"nodes": [0]}],
    "nodes": [{"mesh": 0}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
    "accessors": [
        {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"},
    ],
    "bufferViews": [
        {"buffer": 0, "byteOffset": 0, "byteLength": 36},
        {"buffer": 0, "byteOffset": 36, "byteLength": 12},
    ],
    "buffers": [{"byteLength": 48}],
}


def laid(folder: Path, change: Callable[[dict[str, Any]], object], numbers: bytes = NUMBERS) -> Path:
    """One triangle as a GLB file, with a change to what it says of itself."""
    tree = copy.deepcopy(PLAIN)
    change(tree)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", 48, b"BIN\0") + PLACES + numbers
    path = folder / "a.glb"
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)
    return path


def read(path: Path) -> Any:
    return read_part_file(path, folder=path.parent, length_unit=None, where="here").groups


def primitive(tree: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = tree["meshes"][0]["primitives"][0]
    return found


def second(tree: dict[str, Any], **changes: Any) -> None:
    """One more primitive beside the plain one, which must not vanish without a word."""
    tree["meshes"][0]["primitives"].append({**primitive(tree), **changes})


REFUSED: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "quantized": (lambda t: t.update(extensionsRequired=["KHR_mesh_quantization"]), '"KHR_mesh_quantization"'),
    "instances": (lambda t: t.update(extensionsRequired=["EXT_mesh_gpu_instancing"]), '"EXT_mesh_gpu_instancing"'),
    "packed": (lambda t: t.update(extensionsRequired=["EXT_meshopt_compression"]), '"EXT_meshopt_compression"'),
    "whole numbers": (lambda t: t["accessors"][0].update(componentType=5122, normalized=True), "not float32"),
    "scaled": (lambda t: t["accessors"][0].update(normalized=True), "not float32"),
    "sparse": (lambda t: t["accessors"][0].update(sparse={"count": 1}), "mesh 0 has sparse numbers"),
    "elsewhere": (lambda t: t["accessors"][0].pop("bufferView"), "numbers that are not in the file"),
    "lines": (lambda t: second(t, mode=1), "mesh 0 holds lines"),
    "fan": (lambda t: second(t, mode=6), "a fan of triangles"),
    "morphs": (lambda t: primitive(t).update(targets=[{"POSITION": 0}]), "morph targets"),
    "many": (lambda t: t["nodes"][0].update(extensions={"EXT_mesh_gpu_instancing": {}}), "node 0 has the extension"),
    "skin": (lambda t: t["nodes"][0].update(skin=0), "node 0 has a skin"),
    "no tree": (lambda t: t.update(meshes=[{}]), "not a complete GLB"),
    "not there": (lambda t: primitive(t).update(indices=7), "not a complete GLB"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_read_is_refused_by_name(name: str, tmp_path: Path) -> None:
    change, told = REFUSED[name]
    with pytest.raises(InputError, match=told):
        read(laid(tmp_path, change))


def test_colours_may_ask_for_extensions(tmp_path: Path) -> None:
    for change in (lambda _: None, lambda t: t.update(extensionsRequired=["KHR_materials_unlit"])):
        ((vertices, faces),) = read(laid(tmp_path, change)).values()
        assert trimesh.Trimesh(vertices, faces).area == pytest.approx(0.5)


def test_vertices_that_are_not_there_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="names vertices that it does not hold"):
        read(laid(tmp_path, lambda _: None, np.array([0, 1, 77], "<u4").tobytes()))


def test_placed_triangles_are_counted_before_they_are_placed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A small file can place one mesh a million times; placing them took 5.6 GB."""

    def many(tree: dict[str, Any]) -> None:
        tree.update(
            nodes=[{"mesh": 0, "translation": [2 * i, 0, 0]} for i in range(9)], scenes=[{"nodes": [*range(9)]}]
        )

    ((_, faces),) = read(laid(tmp_path, many)).values()
    assert len(faces) == 9
    monkeypatch.setattr(parts, "MOST_FACES", 8)
    monkeypatch.setattr(trimesh.Scene, "dump", lambda _: pytest.fail("placed before they were counted"))
    with pytest.raises(InputError, match="more than 8 triangles"):
        read(laid(tmp_path, many))


def test_nodes_are_counted_before_they_are_walked(tmp_path: Path) -> None:
    path = laid(tmp_path, lambda tree: tree["nodes"].extend({} for _ in range(MOST_NODES)))
    began = time.process_time()
    with pytest.raises(InputError, match=f"holds {MOST_NODES + 1} nodes"):
        read(path)
    assert time.process_time() - began < 2.0
    assert read(laid(tmp_path, lambda tree: tree["nodes"].append({})))
