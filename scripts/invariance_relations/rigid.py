"""A scene moved, turned or mirrored as a whole, and its camera rolled.

Each function takes what was written and returns it rewritten. Nothing that
it is given changes.
"""

from __future__ import annotations

import json
import math
from typing import Any, Final

import numpy as np

from invariance_relations.documents import (
    ORIGIN,
    Table,
    Written,
    angle,
    length,
    lengths,
    matrix,
    metres,
    picture,
    placed,
    point,
    radians,
    read_pose,
    rotation_of,
    scaled,
    write_pose,
)
from invariance_relations.drawing import calibration_text, obj_text, rad_text
from invariance_relations.lights import ies_text
from radwrap.frames import Pose, default_up, multiply, rotation_about
from radwrap.images import png_bytes

Array = np.ndarray[Any, Any]

NEAREST_MOVE, FARTHEST_MOVE = 1e-3, 1e3  # m
_FLIP_X: Final = np.diag([-1.0, 1.0, 1.0])
_FLIP_Y: Final = np.diag([1.0, -1.0, 1.0])


def moved(written: Written, random: np.random.Generator) -> Written:
    """By a millimetre to a kilometre in any direction."""
    direction = random.normal(size=3)
    reach = math.exp(random.uniform(math.log(NEAREST_MOVE), math.log(FARTHEST_MOVE)))
    way = direction / np.linalg.norm(direction) * reach
    new = written.copied()
    for table in placed(new):
        table["position"] = lengths(np.array(point(table.get("position", ORIGIN))) + way)
        if "look_at" in table:
            table["look_at"] = lengths(np.array(point(table["look_at"])) + way)
    return new


def random_rotation(random: np.random.Generator) -> Array:
    """Any rotation, all alike."""
    orthogonal, upper = np.linalg.qr(random.normal(size=(3, 3)))
    orthogonal = orthogonal * np.sign(np.diag(upper))
    return orthogonal if np.linalg.det(orthogonal) > 0 else -orthogonal


def turned(written: Written, random: np.random.Generator) -> Written:
    """About the world's origin by any rotation; what looks at a point still does."""
    turn = random_rotation(random)
    new = written.copied()
    for table in placed(new):
        _unturn_misalignment(table)
        place = np.array(point(table.get("position", ORIGIN)))
        if "look_at" in table:
            aim = np.array(point(table["look_at"]))
            up = np.array(table.get("up", default_up(tuple(place), tuple(aim))))
            table |= {"position": lengths(turn @ place), "look_at": lengths(turn @ aim)}
            table["up"] = [float(value) for value in turn @ up]
        else:
            pose = read_pose(table)
            write_pose(table, Pose(tuple(turn @ place), rotation_of(turn @ matrix(pose.rotation))))
    return new


def _unturn_misalignment(table: Table) -> None:
    """A misalignment is told about the world's axes: it goes into the ring's own rotation."""
    told = table.pop("misalignment", None)
    if told is None:
        return
    about_y, about_z = (radians(told.get(key, "0 deg")) for key in ("about_y", "about_z"))
    turn = multiply(rotation_about("z", about_z), rotation_about("y", about_y))
    pose = read_pose(table)
    write_pose(table, Pose(pose.position, multiply(turn, pose.rotation)))


def mirrored(written: Written, _: np.random.Generator) -> Written:
    """In the plane x = 0: each part is turned and itself mirrored, the image from left to right."""
    new = written.copied()
    for table in placed(new):
        _unturn_misalignment(table)
        # A luminaire's angles count from its x, so its y is the axis that changes its sign.
        flip = _FLIP_Y if table.get("type") == "ies" else _FLIP_X
        pose = read_pose(table)
        place = _FLIP_X @ np.array(pose.position)
        write_pose(table, Pose(tuple(place), rotation_of(_FLIP_X @ matrix(pose.rotation) @ flip)))
    for source in new.sources:
        if source["type"] == "ring":
            _mirror_ring(source)
    for target in new.targets:
        _mirror_target(target)
    for name, content in new.files.items():
        new.files[name] = _mirrored_file(name, content)
    _mirror_camera(new)
    return new


def _mirror_ring(ring: Table) -> None:
    """Counted from x towards y, the mirrored LEDs stand in the other sense."""
    ring["first_angle"] = angle(math.pi - radians(ring["first_angle"]))
    for led in ring["leds"]:
        led["index"] = (ring["count"] - led["index"]) % ring["count"]
        led["axis_azimuth"] = angle(math.pi - radians(led["axis_azimuth"]))


def _mirror_target(target: Table) -> None:
    match target["type"]:
        case "edge":
            target["material"], target["edge_material"] = target["edge_material"], target["material"]
            target["edge_position"] = length(-metres(target["edge_position"]))
        case "polygon":
            target["vertices"] = [[length(-metres(x)), y] for x, y in reversed(target["vertices"])]


def _mirrored_file(name: str, content: bytes) -> bytes:
    """Prints, meshes and luminaires have a left and a right; tables of angles from an axis have none."""
    kind = name.rsplit(".", 1)[1]
    if kind == "png":
        return png_bytes(np.ascontiguousarray(np.fliplr(picture(content))))
    if kind == "ies":
        lines = content.decode().splitlines()
        vertical, horizontal, *candela = (np.array(line.split(), dtype=np.float64) for line in lines[4:])
        return ies_text(vertical, (360 - horizontal)[::-1], np.array(candela)[::-1])
    if kind in ("obj", "rad"):
        vertices, faces = read_faces(name, content)
        flipped = [[-x, y, z] for x, y, z in vertices]
        return (obj_text if kind == "obj" else rad_text)(flipped, [face[::-1] for face in faces])
    return content


def read_faces(name: str, content: bytes) -> tuple[list[list[float]], list[list[int]]]:
    """Vertices and triangles of a file that `drawing` wrote."""
    lines = [line.split() for line in content.decode().splitlines()]
    if name.endswith(".obj"):
        vertices = [[float(x) for x in words[1:]] for words in lines if words[0] == "v"]
        return vertices, [[int(x) - 1 for x in words[1:]] for words in lines if words[0] == "f"]
    corners = [[float(x) for x in words[6:]] for words in lines if words[1] == "polygon"]
    vertices = [face[k : k + 3] for face in corners for k in (0, 3, 6)]
    return vertices, [[k, k + 1, k + 2] for k in range(0, len(vertices), 3)]


def _mirror_camera(written: Written) -> None:
    camera, sensor = written.camera, written.camera["sensor"]
    columns = sensor["columns"]
    if "principal_point" in camera:
        u, v = camera["principal_point"]
        camera["principal_point"] = [f"{columns - 1 - float(u.split(' ')[0])!r} px", v]
    if "p2" in camera.get("distortion", {}):
        camera["distortion"]["p2"] = -camera["distortion"]["p2"]
    if "rotation" in camera["aperture"]:
        camera["aperture"]["rotation"] = angle(math.pi - radians(camera["aperture"]["rotation"]))
    if "sensitivity_across" in sensor:
        sensor["sensitivity_across"] = sensor["sensitivity_across"][::-1]
    if "calibration" in camera:
        told = json.loads(written.files["camera.json"])
        (fx, _x, u, _y, fy, v, *_rest), (k1, k2, p1, p2) = told["camera_matrix"], told["distortion_coefficients"]
        size = (told["image_width"], told["image_height"])
        written.files["camera.json"] = calibration_text((fx, fy), (columns - 1 - u, v), (k1, k2, p1, -p2), size)


def rolled(written: Written, _: np.random.Generator) -> Written:
    """The camera a quarter of a turn about its axis, with rows for columns: the image lies on its side."""
    new = written.copied()
    camera, sensor = new.camera, new.camera["sensor"]
    pose = read_pose(camera)
    write_pose(camera, Pose(pose.position, multiply(pose.rotation, rotation_about("z", math.pi / 2))))
    columns = sensor["columns"]
    _swap(sensor, "rows", "columns")
    _swap(sensor, "pixel_width", "pixel_height")
    _swap(sensor, "fill_width", "fill_height")
    if "sensitivity_across" in sensor:
        _swap(sensor, "sensitivity_across", "sensitivity_down")
        sensor["sensitivity_down"] = sensor["sensitivity_down"][::-1]
    if "principal_point" in camera:
        u, v = (float(text.split(" ")[0]) for text in camera["principal_point"])
        camera["principal_point"] = [f"{v!r} px", f"{columns - 1 - u!r} px"]
    if "p1" in camera.get("distortion", {}):
        bend = camera["distortion"]
        bend["p1"], bend["p2"] = -bend["p2"], bend["p1"]
    if "rotation" in camera["aperture"]:
        camera["aperture"]["rotation"] = angle(radians(camera["aperture"]["rotation"]) - math.pi / 2)
    if "calibration" in camera:
        told = json.loads(new.files["camera.json"])
        (fx, _x, u, _y, fy, v, *_rest), (k1, k2, p1, p2) = told["camera_matrix"], told["distortion_coefficients"]
        size = (told["image_height"], told["image_width"])
        new.files["camera.json"] = calibration_text((fy, fx), (v, columns - 1 - u), (k1, k2, -p2, p1), size)
        # A calibration sets the scale by the pixels' height: what was their width by the file is it now.
        sensor["pixel_height"] = scaled(sensor["pixel_height"], fy / fx)
    return new


def _swap(table: Table, a: str, b: str) -> None:
    if a in table:
        table[a], table[b] = table[b], table[a]
