"""Whether parts stand inside each other: the door to FCL, by trimesh's collision manager.

FCL finds where surfaces cross; a part that lies wholly inside another crosses
nothing, which rays from its bodies find. A mesh that is not closed has no
inside: its box in its own frame stands for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.extras import require
from radwrap.frames import Pose, rotation_about_fixed_axes
from radwrap.scene.mesh import Mesh, contains, mesh_of
from radwrap.scene.targets import MeshPart
from radwrap.units import ANGLE, LENGTH, parse_quantity

Array = NDArray[np.float64]

OVERLAPS: Final = "parts that must not overlap"  # what needs FCL, for messages
_MM: Final = 1e3  # FCL's own limits are of numbers about 1: it gets millimetres
_BOX_FACES: Final = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """What stands for a part: its mesh, or its box.

    Attributes
    ----------
    mesh : Mesh
        In the part's frame [m].
    pieces : ndarray of float64, shape (n, 3)
        A corner of each connected piece [m].
    is_box : bool
        Whether the mesh is not closed.
    solid : trimesh.Trimesh
        The same for FCL [mm].
    """

    mesh: Mesh
    pieces: Array
    is_box: bool
    solid: Any = field(repr=False)


def body_of(part: MeshPart) -> Body:
    """What stands for a part."""
    import trimesh

    mesh = part.mesh if part.closed else _box(part.mesh)
    solid = trimesh.Trimesh(mesh.vertices * _MM, mesh.faces, process=False)
    return Body(mesh, mesh.vertices[_piece_corners(mesh)], not part.closed, solid)


def _box(mesh: Mesh) -> Mesh:
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    faces = [(side[0], side[n], side[n + 1]) for side in _BOX_FACES for n in (1, 2)]
    return mesh_of(low + corners * (high - low), np.array(faces, dtype=np.intp))


def _piece_corners(mesh: Mesh) -> NDArray[np.intp]:
    """The first vertex of each piece that hangs together."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    first, second = mesh.faces[:, [0, 1]].ravel(), mesh.faces[:, [1, 2]].ravel()
    size = len(mesh.vertices)
    graph = coo_array((np.ones(len(first), dtype=np.int8), (first, second)), shape=(size, size))
    _, labels = connected_components(graph, directed=False)
    _, corners = np.unique(labels[np.unique(mesh.faces)], return_index=True)
    return np.unique(mesh.faces)[corners]


class Standing:
    """Parts that stand in an image, none of which crosses or holds another.

    Parameters
    ----------
    bodies : Mapping of str to Body
        By category.

    Raises
    ------
    EnvironmentFailure
        If python-fcl is not installed.
    """

    def __init__(self, bodies: Mapping[str, Body]) -> None:
        require("dataset", OVERLAPS)
        import trimesh.collision

        untyped: Any = trimesh.collision
        self._manager: Any = untyped.CollisionManager()
        self._bodies = bodies
        self._known: set[str] = set()
        self._placed: dict[str, tuple[Body, Pose]] = {}

    def place(self, table: Mapping[str, Any], category: str) -> bool:
        """Whether a target of the scene stands free where its table says; it is then one of those that stand.

        A name that was refused may be asked for again.
        """
        name, body, pose = table["name"], self._bodies[category], pose_of_table(table)
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = pose.rotation, np.asarray(pose.position) * _MM
        if name in self._known:
            self._manager.set_transform(name, matrix)
        else:
            self._manager.add_object(name, body.solid, matrix)
            self._known.add(name)
        others = [one for other, one in self._placed.items() if other != name]
        if self._manager.in_collision_internal() or any(_holds((body, pose), one) for one in others):
            return False
        self._placed[name] = body, pose
        return True


def _holds(one: tuple[Body, Pose], other: tuple[Body, Pose]) -> bool:
    """Whether of two parts whose surfaces do not cross one has a piece inside the other."""
    return _inside(*one, *other) or _inside(*other, *one)


def _inside(inner: Body, inner_pose: Pose, outer: Body, outer_pose: Pose) -> bool:
    world = inner.pieces @ np.asarray(inner_pose.rotation).T + np.asarray(inner_pose.position)
    local = (world - np.asarray(outer_pose.position)) @ np.asarray(outer_pose.rotation)
    low, high = outer.mesh.vertices.min(axis=0), outer.mesh.vertices.max(axis=0)
    return any(contains(outer.mesh, point) for point in local if ((point >= low) & (point <= high)).all())


def pose_of_table(table: Mapping[str, Any]) -> Pose:
    """Pose of a target as its table in the scene's file writes it."""
    x, y, z = (parse_quantity(one, LENGTH) for one in table.get("position", ("0 m",) * 3))
    angles = [parse_quantity(one, ANGLE) for one in table.get("rotation", ("0 deg",) * 3)]
    return Pose((x, y, z), rotation_about_fixed_axes(angles, table.get("rotation_order", "xyz")))
