"""Triangle meshes as targets: distances against other ways to the same number, and files that lie."""

import math
import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import radwrap
from radwrap.errors import EnvironmentFailure, InputError
from radwrap.scene.look.checks import warnings_of
from radwrap.scene.look.geometry import signed_distance
from radwrap.scene.look.intersections import first_hit, nearest_point
from radwrap.scene.mesh import contains, mesh_hit, mesh_of, nearest_on
from radwrap.scene.mesh_files.parts import MOST_FACES, cleaned, read_part_file
from radwrap.scene.mesh_files.polygons import triangulated
from radwrap.scene.mesh_files.winding import wound

ROUNDING = 1e-9
BALL = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
BENCH = Path(__file__).parents[2] / "rad_scenes" / "crosscheck" / "lambertian" / "scene.toml"


def scene_with(folder: Path, name: str, **more: Any) -> radwrap.Scene:
    target = {"part": name, "material": "white", "length_unit": "1 mm", **more}
    (folder / "scene.toml").write_text(BENCH.read_text())
    return radwrap.load_scene(folder / "scene.toml", {"targets": [target]})


def test_rays_meet_a_mesh_as_they_meet_each_of_its_triangles() -> None:
    rng = np.random.default_rng(1)
    torus = trimesh.creation.torus(1.0, 0.4)
    mesh = mesh_of(np.asarray(torus.vertices), np.asarray(torus.faces))
    origins = rng.normal(size=(300, 3)) * 2
    rays = rng.normal(size=(300, 3)) - origins
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    found, normals = mesh_hit(mesh, origins, rays)
    expected = np.full(300, np.inf)
    for a, b, c in torus.triangles:
        # The crossing with the plane, and the same side of all three planes through a side and the normal.
        n = np.cross(b - a, c - a)
        with np.errstate(divide="ignore"):
            t = ((a - origins) @ n) / (rays @ n)
        p = origins + t[:, np.newaxis] * rays
        inside = [np.cross(e - s, p - s) @ n >= 0 for s, e in ((a, b), (b, c), (c, a))]
        expected = np.where(np.all(inside, axis=0) & (t > 0) & (t < expected), t, expected)
    assert 50 < np.isfinite(expected).sum() < 290
    assert found == pytest.approx(expected, rel=ROUNDING)
    met = np.isfinite(found)
    assert np.linalg.norm(normals[met], axis=1) == pytest.approx(1.0)
    assert (normals[~met] == 0).all()


def test_nearest_points_and_insides_of_a_box_are_known() -> None:
    box = trimesh.creation.box(extents=(2, 4, 6))
    mesh = mesh_of(np.asarray(box.vertices), np.asarray(box.faces))
    for point in np.random.default_rng(2).normal(size=(100, 3)) * (2, 3, 4):
        beyond = np.abs(point) - (1, 2, 3)
        inside = (beyond < 0).all()
        expected = -beyond.max() if inside else np.linalg.norm(np.maximum(beyond, 0))
        place, normal = nearest_on(mesh, point)
        assert np.linalg.norm(place - point) == pytest.approx(expected, rel=ROUNDING)
        assert contains(mesh, point) == inside
        assert np.abs(normal).max() == pytest.approx(1.0)


def test_a_corner_of_no_triangle_is_not_near() -> None:
    """A file may hold one, or a triangle without area that is left out."""
    vertices = np.array([[40.0, 0, 5], [41, 0, 5], [40, 1, 5], [-97, -37, 10]])
    place, normal = nearest_on(mesh_of(vertices, np.array([[0, 1, 2]])), np.array([-97.0, -37, 6]))
    np.testing.assert_allclose(place, [40, 0, 5])
    np.testing.assert_allclose(normal, [0, 0, 1])


def test_a_mesh_target_is_where_its_pose_says(tmp_path: Path) -> None:
    BALL.copy().apply_scale(20).export(tmp_path / "ball.stl")
    scene = scene_with(tmp_path, "ball.stl", position=["10 mm", "0 mm", "30 mm"], rotation=["0 deg", "90 deg", "0 deg"])
    target = scene.targets[0]
    assert signed_distance(target, (0.01, 0.0, 0.13)) == pytest.approx(0.08, rel=2e-3)  # a ball of flat triangles
    assert signed_distance(target, (0.01, 0.0, 0.03)) < 0
    assert nearest_point(target, (0.01, 0.0, 0.13))[0] == pytest.approx([0.01, 0.0, 0.05], abs=2e-4)
    distance, _ = first_hit(target, np.array([0.01, 0.0, 0.13]), np.array([[0.0, 0.0, -1.0]]))
    assert distance[0] == pytest.approx(0.08, rel=2e-3)
    with pytest.raises(InputError, match="pinhole lies inside"):
        scene_with(tmp_path, "ball.stl", position=["0 mm", "0 mm", "500 mm"])
    assert radwrap.explain(scene)["expected_peak"]["target"] == "target0"


def test_another_file_is_another_scene(tmp_path: Path) -> None:
    BALL.copy().apply_scale(20).export(tmp_path / "ball.stl")
    first = scene_with(tmp_path, "ball.stl").targets[0]
    assert scene_with(tmp_path, "ball.stl").targets[0] == first
    assert scene_with(tmp_path, "ball.stl", length_unit="1.1 mm").targets[0] != first
    BALL.copy().apply_scale(21).export(tmp_path / "ball.stl")
    assert scene_with(tmp_path, "ball.stl").targets[0] != first


def test_flipped_triangles_are_turned_and_counted() -> None:
    flipped = np.random.default_rng(3).random(len(BALL.faces)) < 0.3
    faces = np.where(flipped[:, np.newaxis], BALL.faces[:, ::-1], BALL.faces)
    found = wound(np.asarray(BALL.vertices), faces)
    assert found.flipped == flipped.sum() and found.closed and found.bodies == 1
    assert trimesh.Trimesh(BALL.vertices, found.faces).volume == pytest.approx(BALL.volume)
    inside_out = wound(np.asarray(BALL.vertices), np.asarray(BALL.faces[:, ::-1]))
    assert inside_out.flipped == len(BALL.faces)
    opened = wound(np.asarray(BALL.vertices), np.asarray(BALL.faces[5:]))
    assert (opened.closed, opened.holes) == (False, opened.holes) and 1 <= opened.holes <= 5
    assert opened.flipped == 0


def test_degenerate_and_repeated_triangles_are_left_out_and_counted() -> None:
    vertices = np.vstack([BALL.vertices, BALL.vertices[:1]])  # the same vertex twice
    faces = np.vstack([BALL.faces, [[0, 0, 1], [0, 1, len(BALL.vertices)]], BALL.faces[:2, [1, 2, 0]]])
    unique, kept, told = cleaned(vertices, faces)
    assert (told.degenerate, told.duplicate) == (2, 2)
    assert len(unique) == len(BALL.vertices) and len(kept) == len(BALL.faces)


def read(path: Path, unit: float | None = 1e-3) -> Any:
    return read_part_file(path, folder=path.parent, length_unit=unit, where="here")


STL = trimesh.creation.box().export(file_type="stl")
PLY_HEAD = (
    "ply\nformat binary_little_endian 1.0\nelement vertex {0}\nproperty float x\nproperty float y\nproperty float z\n"
    "element face {0}\nproperty list uchar int vertex_indices\nend_header\n"
)
TEXT_PLY = (
    "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    "element face {}\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n"
)
# A triangle between quadrangles: as long as three faces like the first, were the first of four corners.
MIXED_PLY = (
    PLY_HEAD.replace("face {0}", "face 3").format(5).encode()
    + struct.pack("<15f", *range(15))
    + struct.pack("<B4iB3iB5i", 4, 0, 1, 2, 3, 3, 0, 1, 2, 5, 0, 1, 2, 3, 4)
)
HOSTILE = {
    "empty.stl": (b"", "not a complete STL"),
    "claims.stl": (STL[:80] + struct.pack("<I", 10**9) + STL[84:], "not a complete STL"),
    "cut.stl": (STL[:-7], "not a complete STL"),
    "nothing.stl": (STL[:80] + struct.pack("<I", 0), "no triangles"),
    "nan.stl": (STL[:96] + struct.pack("<f", math.nan) + STL[100:], "NaN or infinity"),
    "infinite.stl": (STL[:96] + struct.pack("<f", math.inf) + STL[100:], "NaN or infinity"),
    "far.stl": (STL[:96] + struct.pack("<f", 1e30) + STL[100:], "reaches beyond"),
    "claims.ply": (PLY_HEAD.format(10**9).encode(), "claims 1000000000"),
    "broken.ply": (b"ply\nformat ascii 1.0\nelement vertex x\n", "not a complete PLY|no triangles"),
    "claims.off": (b"OFF\n1000000000 1000000000 0\n0 0 0\n", "claims 1000000000"),
    "broken.off": (b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n", "not a complete OFF|does not hold"),
    "nan.obj": (b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "NaN or infinity"),
    "index.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "does not hold"),
    "empty.obj": (b"# nothing\n", "no triangles|not a complete OBJ"),
    "up.obj": (b"mtllib ../../secret.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not a file in its folder"),
    "root.obj": (b"mtllib /etc/passwd\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not a file in its folder"),
    "back.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf\t-4\t-2\t-1\nv 0 0 1\n", "line 5: there is no vertex -4"),
    "zero.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\nf 1 2 3\n", "line 4: vertices are counted from 1"),
    "side.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2\n", "less than three corners"),
    "surface.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\ncstype bezier\n", "line 5 begins a free-form surface"),
    "bow.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3 4\n", "sides cross"),
    "star.off": (b"OFF 5 1 0\n0 3 0\n2 -2 0\n-3 1 0\n3 1 0\n-2 -2 0\n5 0 1 2 3 4\n", "sides cross"),
    "less.off": (b"OFF\n4 3 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 1 2\n3 0 1 3\n", "holds less than it claims"),
    "more.off": (b"OFF\n4 1 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 1 2\n3 0 1 3\n", "holds more than it claims"),
    "less.ply": (TEXT_PLY.format(5).encode() + b"3 0 1 2\n", "holds less than it claims"),
    "more.ply": (TEXT_PLY.format(1).encode() + b"3 0 1 2\n3 0 2 1\n", "claims 4 rows, and holds 5"),
    "mixed.ply": (MIXED_PLY, "read only from text"),
    "junk.glb": (b"glTF\x02\x00\x00\x00\xff\xff\xff\x7f", "not a complete GLB"),
    "name.3ds": (b"x", "not a mesh file"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_are_refused(name: str, tmp_path: Path) -> None:
    content, told = HOSTILE[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=told):
        read(tmp_path / name, None if name.endswith(".glb") else 1e-3)
    if not name.endswith((".glb", ".3ds")):
        # The same through a scene: one line that names the key.
        with pytest.raises(InputError, match=r"targets\[0\]\.part"):
            scene_with(tmp_path, name)


def lined(path: Path, *lines: str) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """What a text holds, in its own unit."""
    path.write_text("\n".join((*lines, "")))
    found: dict[str, tuple[np.ndarray, np.ndarray]] = read(path, 1.0).groups
    return found


def size(group: tuple[np.ndarray, np.ndarray]) -> float:
    return float(trimesh.Trimesh(*group, process=False).area)


SQUARE = ("v 0 0 0", "v 10 0 0", "v 10 10 0", "v 0 10 0")
NOTCHED = [(0, 0), (10, 0), (10, 10), (5, 2), (0, 10)]  # a square less a notch of 40


@pytest.mark.parametrize("first", range(5))
def test_polygons_are_not_fanned_over_a_notch(first: int, tmp_path: Path) -> None:
    corners = NOTCHED[first:] + NOTCHED[:first]
    obj = [*(f"v {x} {y} 3" for x, y in corners), "f 1 2 3 4 5"]
    off = ["OFF", "5 1 0", *(f"{x} {y} 3" for x, y in corners), "5 0 1 2 3 4 200 0 0"]
    ply = [*TEXT_PLY.replace("vertex 3", "vertex 5").format(1).splitlines()[:-3], *off[2:-1], "5 0 1 2 3 4"]
    for name, lines in {"a.obj": obj, "a.off": off, "a.ply": ply}.items():
        (group,) = lined(tmp_path / name, *lines).values()
        assert size(group) == pytest.approx(60.0)
        assert len(group[1]) == 3


def test_faces_of_one_file_keep_their_order_and_shapes() -> None:
    """Triangles, squares and notched ones in turn, as one list: areas say which is which."""
    vertices = np.array([(x, y, 0.0) for x, y in [*NOTCHED, (0, 4)]], dtype=float)
    faces = [(0, 1, 2), (0, 1, 2, 3, 4), (0, 1, 3, 5), (1, 2, 3), (0, 1, 2, 3)]
    corners, counts = np.array([c for face in faces for c in face]), np.array(list(map(len, faces)))
    found = triangulated(vertices, corners, counts, "here")
    each = np.split(found, np.cumsum(counts - 2)[:-1])
    assert [size((vertices, part)) for part in each] == pytest.approx([50.0, 60.0, 20.0, 25.0, 35.0])
    assert (found[0] == faces[0]).all() and set(each[3].ravel()) == {1, 2, 3}


@pytest.mark.parametrize("noise", [0.0, 1e-9])
def test_slivers_are_left_out_and_refuse_no_mesh(noise: float) -> None:
    """Four corners in a line, whose sides rounding crosses, beside a square."""
    line = [(0, 0, 0), (3, noise, 0), (1, 0, 0), (2, noise, noise)]
    vertices = np.array([(0, 0, 1), (10, 0, 1), (10, 10, 1), (0, 10, 1), *line], dtype=float)
    found = triangulated(vertices, np.arange(8), np.array([4, 4]), "here")
    assert len(found) == 4 and size((vertices, found)) == pytest.approx(100.0, rel=1e-7)


def test_obj_counts_backwards_from_each_face(tmp_path: Path) -> None:
    later = ("v 0 0 50", "v 20 0 50", "v 20 20 50")
    (group,) = lined(tmp_path / "a.obj", *SQUARE[:3], "f -3 -2 -1", *later, "f -3 -2 -1").values()
    assert size(group) == pytest.approx(50.0 + 200.0)
    found = lined(tmp_path / "b.obj", *SQUARE[:3], "usemtl a", "f\t-3\t-2\t-1", *later, "usemtl b # 2", "f 4/1 5 6//3")
    assert {name: size(group) for name, group in found.items()} == pytest.approx({"a": 50.0, "b # 2": 200.0})
    assert set(found["a"][0][:, 2]) == {0.0}


def test_obj_lines_go_on_after_a_backslash(tmp_path: Path) -> None:
    found = lined(tmp_path / "a.obj", *SQUARE, "usemtl a", "f 1 2 \\", " 3 4", "usemtl b", "f 1 2 3 # 4")
    assert {name: size(group) for name, group in found.items()} == pytest.approx({"a": 100.0, "b": 50.0})


def test_material_files_beside_a_mesh_are_not_read(tmp_path: Path) -> None:
    """Textures in them could name any file; names of materials come from the mesh itself."""
    (tmp_path / "m.mtl").write_text("newmtl steel\nmap_Kd ../../etc/passwd\n")
    (tmp_path / "a.obj").write_text(
        "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nusemtl steel\nf 1/1/1 2/2/2 3/3/3\n"
        "usemtl brass\nf 1//1 2//1 4//1\n"
    )
    found = read(tmp_path / "a.obj")
    assert found.material_files == ("m.mtl",)
    assert {name: len(faces) for name, (_, faces) in found.groups.items()} == {"steel": 1, "brass": 1}


def test_units_are_demanded_where_the_file_has_none(tmp_path: Path) -> None:
    ball = BALL.copy()
    for suffix in ("stl", "obj", "ply", "off"):
        ball.export(tmp_path / f"ball.{suffix}")
        with pytest.raises(InputError, match="does not say its unit"):
            read(tmp_path / f"ball.{suffix}", None)
        vertices, _ = read(tmp_path / f"ball.{suffix}", 0.0254).groups["part"]
        assert np.abs(vertices).max() == pytest.approx(0.0254, rel=1e-6)
    (tmp_path / "ball.glb").write_bytes(ball.export(file_type="glb"))
    (vertices, _), *others = read(tmp_path / "ball.glb", None).groups.values()
    assert not others and np.abs(vertices).max() == pytest.approx(1.0, rel=1e-6)
    with pytest.raises(InputError, match="a unit of their own"):
        read(tmp_path / "ball.glb", 1e-3)


def test_a_mesh_outside_the_folder_is_refused(tmp_path: Path) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    BALL.export(tmp_path / "ball.stl")
    (inner / "link.stl").symlink_to(tmp_path / "ball.stl")
    for name in ("../ball.stl", "link.stl", str(tmp_path / "ball.stl")):
        with pytest.raises(InputError, match="outside the folder"):
            scene_with(inner, name)
    with pytest.raises(InputError, match="no file"):
        scene_with(inner, "none.stl")
    (inner / "folder.stl").mkdir()
    with pytest.raises(InputError, match="not a regular file"):
        scene_with(inner, "folder.stl")


def test_step_files_need_cascadio(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("cascadio", reason="cascadio is not installed: STEP files were not read")
    (tmp_path / "junk.step").write_text("ISO-10303-21;\n")
    with pytest.raises(InputError, match=r"not a complete STEP|no triangles"):
        read(tmp_path / "junk.step", None)
    monkeypatch.setitem(sys.modules, "cascadio", None)
    with pytest.raises(EnvironmentFailure, match=r'cascadio is not installed; pip install "radwrap\[step\]"'):
        read(tmp_path / "junk.step", None)


def test_there_is_a_limit() -> None:
    assert MOST_FACES == 10_000_000


def roof(lean: float, *, sliver: bool = False) -> str:
    """Two triangles in one plane, the normals at whose corners lean by an angle [deg] in the file."""
    up, aside = (f"vn {math.sin(math.radians(a)):.9f} 0 {math.cos(math.radians(a)):.9f}\n" for a in (0.0, lean))
    text = "v 0 0 0\nv 9 0 0\nv 0 9 0\nv 9 9 0\nv 4.5 4.5 1e-4\n" + up + aside
    thin = "f 2//1 5//1 3//1\n" if sliver else ""  # upright, of .0006 mm^2
    return text + "f 1//1 2//-1 3//1\nusemtl other\nf 2//1 4//-2 3//9\n" + thin


def test_normals_of_the_file_that_are_not_used_are_told_once(tmp_path: Path) -> None:
    for lean in (0.5, 20.0):
        (tmp_path / f"roof_{lean:g}.obj").write_text(roof(lean))
        found = read_part_file(tmp_path / f"roof_{lean:g}.obj", folder=tmp_path, length_unit=1e-3, where="here")
        assert found.leaning == pytest.approx({"part": math.radians(lean), "other": 0.0}, abs=1e-7)
    (tmp_path / "thin.obj").write_text(roof(0.0, sliver=True))
    lines = {
        name: [
            line for line in warnings_of(scene_with(tmp_path, name, position=["0 mm"] * 2 + ["40 mm"])) if "vn" in line
        ]
        for name in ("roof_0.5.obj", "thin.obj", "roof_20.obj")
    }
    assert lines["roof_0.5.obj"] == lines["thin.obj"] == []
    (told,) = lines["roof_20.obj"]
    assert "20 deg" in told
