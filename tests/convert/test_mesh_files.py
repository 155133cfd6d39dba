"""Meshes become Radiance scenes without losing anything: 20 of them, numbers and outlines."""

import json
import math
import re
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from trimesh import creation

import radwrap
from radwrap.cli.main import main
from radwrap.imaging.optics.view import PixelPlan, ray_blocks, traced
from radwrap.process import Programs
from radwrap.scene.look.geometry import project
from radwrap.scene.mesh_files.polygons import ears
from radwrap.scene.targets import MeshShape
from radwrap.tracers.installation import find_radiance
from radwrap.tracers.radiance import NO_LIGHT, RadianceOptions, RadianceTracer, build, prepare

ROOT = Path(__file__).parents[2]
LAMBERTIAN = ROOT / "rad_scenes" / "crosscheck" / "lambertian" / "scene.toml"

KEPT = 1e-6  # asked for; STL and PLY hold float32, 6e-8
# Of the pixels, those whose centre lies this near to a side [px] may be on either side of it: Radiance's mesh has its
# corners on a grid of 2^-32 of its size, and rtrace sees each ray in float64.
TOUCHING = 1e-5


def turned(body: trimesh.Trimesh) -> trimesh.Trimesh:
    body.apply_transform(trimesh.transformations.euler_matrix(0.5, -0.7, 0.3))
    return body


def holed(body: trimesh.Trimesh, missing: int) -> trimesh.Trimesh:
    return trimesh.Trimesh(body.vertices, body.faces[missing:], process=False)


def flipped(body: trimesh.Trimesh) -> trimesh.Trimesh:
    faces = np.array(body.faces)
    faces[::3] = faces[::3, ::-1]
    return trimesh.Trimesh(body.vertices, faces, process=False)


def littered(body: trimesh.Trimesh) -> trimesh.Trimesh:
    """With triangles of no area, repeated ones, and vertices that nobody uses."""
    vertices = np.vstack([body.vertices, [[50.0, 50.0, 50.0]]])
    faces = np.vstack([body.faces, [[0, 0, 1], [2, 3, 2]], body.faces[:4, [2, 0, 1]]])
    return trimesh.Trimesh(vertices, faces, process=False)


def apart(body: trimesh.Trimesh) -> trimesh.Trimesh:
    """A soup: each triangle with corners of its own."""
    return trimesh.Trimesh(body.triangles.reshape(-1, 3), np.arange(3 * len(body.faces)).reshape(-1, 3), process=False)


def two_bodies() -> trimesh.Trimesh:
    other = creation.box(extents=(6, 6, 6))
    other.apply_translation((18, 0, 0))
    return trimesh.util.concatenate([creation.icosphere(subdivisions=2, radius=8), other])


# Sizes in mm, each with the format it goes through. What is broken has the numbers of the whole one.
MESHES: dict[str, tuple[trimesh.Trimesh, str]] = {
    "box": (creation.box(extents=(20, 12, 8)), "stl"),
    "icosphere": (creation.icosphere(subdivisions=3, radius=12), "stl"),
    "uv_sphere": (creation.uv_sphere(radius=10), "obj"),
    "cylinder": (creation.cylinder(radius=6, height=20), "ply"),
    "capsule": (creation.capsule(height=12, radius=5), "off"),
    "cone": (creation.cone(radius=8, height=16), "stl"),
    "annulus": (creation.annulus(r_min=5, r_max=12, height=6), "stl"),
    "torus": (creation.torus(major_radius=10, minor_radius=3), "glb"),
    "icosahedron": (turned(creation.icosahedron().apply_scale(12)), "obj"),
    "subdivided": (turned(creation.box(extents=(9, 14, 11)).subdivide().subdivide()), "ply"),
    "revolve": (creation.revolve(np.array([[0, -8], [6, -8], [6, 0], [3, 0], [3, 10], [0, 10.0]])), "stl"),
    "tiny": (creation.icosphere(subdivisions=2, radius=1e-3), "stl"),
    "large": (creation.torus(major_radius=9000, minor_radius=3000), "stl"),
    "far": (creation.box(extents=(10, 10, 10)).apply_translation((1000, 0, 0)), "ply"),
    "bodies": (two_bodies(), "stl"),
    "turned_over": (flipped(creation.icosphere(subdivisions=2, radius=10)), "obj"),
    "inside_out": (trimesh.Trimesh(*[(b := creation.torus(10, 3)).vertices, b.faces[:, ::-1]], process=False), "off"),
    "littered": (littered(creation.cylinder(radius=8, height=10)), "obj"),
    "soup": (apart(creation.icosphere(subdivisions=2, radius=9)), "stl"),
    "with_a_hole": (holed(creation.icosphere(subdivisions=2, radius=9), 7), "ply"),
}
WHOLE = {
    "turned_over": creation.icosphere(subdivisions=2, radius=10),
    "inside_out": creation.torus(10, 3),
    "littered": creation.cylinder(radius=8, height=10),
}


def lay(name: str, folder: Path) -> tuple[Path, list[str], float]:
    """Write a mesh; the options it needs, and the length of its unit in mm."""
    body, kind = MESHES[name]
    path = folder / f"{name}.{kind}"
    path.write_bytes(content if isinstance(content := body.export(file_type=kind), bytes) else content.encode())
    return path, [] if kind == "glb" else ["--length-unit", "1 mm"], 1000.0 if kind == "glb" else 1.0


def polygons_in(text: str) -> np.ndarray:
    """Corners of all triangles of a Radiance text, shape (n, 3, 3)."""
    found = re.findall(r"^part(?:_\d+)? polygon \S+\n0\n0\n9 (.*)$|^\w+ polygon \S+\n0\n0\n9 (.*)$", text, re.MULTILINE)
    return np.array([list(map(float, (a or b).split())) for a, b in found]).reshape(-1, 3, 3)


def volume(corners: np.ndarray) -> float:
    corners = corners - corners.mean(axis=(0, 1))
    return float(np.linalg.det(corners).sum() / 6)


def area(corners: np.ndarray) -> float:
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(np.linalg.norm(across, axis=1).sum() / 2)


@pytest.mark.parametrize("name", MESHES)
def test_volume_area_and_bounds_are_kept(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, options, unit = lay(name, tmp_path)
    assert main(["convert", str(path), str(tmp_path / "out.rad"), "--polygons", "--json", *options]) == 0
    found = json.loads(capsys.readouterr().out)
    corners = polygons_in((tmp_path / "out.rad").read_text())
    body = WHOLE.get(name, MESHES[name][0])
    assert len(corners) == sum(group["triangles"] for group in found["groups"].values())
    assert area(corners) == pytest.approx(body.area * unit**2, rel=KEPT)
    size = float(np.ptp(body.triangles.reshape(-1, 3), axis=0).max()) * unit
    for ours, theirs in (
        (corners.min(axis=(0, 1)), body.triangles.min(axis=(0, 1))),
        (corners.max(axis=(0, 1)), body.triangles.max(axis=(0, 1))),
    ):
        assert ours == pytest.approx(theirs * unit, rel=KEPT, abs=KEPT * size)
    (report, *others) = found["groups"].values()
    told = {key: sum(group[key] for group in (report, *others)) for key in ("flipped", "holes", "open_sides")}
    if name == "with_a_hole":
        assert told["holes"] >= 1 and report["volume_m3"] is None
    else:
        assert told["holes"] == told["open_sides"] == 0
        assert volume(corners) == pytest.approx(body.volume * unit**3, rel=KEPT)
        assert sum(g["volume_m3"] for g in (report, *others)) == pytest.approx(
            body.volume * (unit * 1e-3) ** 3, rel=KEPT
        )
    assert told["flipped"] == {"turned_over": math.ceil(320 / 3), "inside_out": len(MESHES[name][0].faces)}.get(name, 0)
    assert report["left_out"] == (
        {"degenerate": 2, "duplicate": 4} if name == "littered" else {"degenerate": 0, "duplicate": 0}
    ) or name in ("revolve", "capsule", "uv_sphere")


def outline(scene: radwrap.Scene) -> tuple[np.ndarray, np.ndarray]:
    """Which pixels' centres see the mesh, by projecting its triangles with numpy alone; and which touch a side."""
    (shape,) = (surface.shape for surface in scene.surfaces)
    assert isinstance(shape, MeshShape)
    uv, depth = project(scene.camera, shape.vertices)
    assert (depth > 0).all()
    rows, columns = scene.camera.sensor.rows, scene.camera.sensor.columns
    v, u = (grid.ravel().astype(float) for grid in np.indices((rows, columns)))
    seen, touched = np.zeros(len(u), dtype=bool), np.zeros(len(u), dtype=bool)
    for corners in uv[shape.faces]:
        (low_u, low_v), (high_u, high_v) = corners.min(axis=0) - TOUCHING, corners.max(axis=0) + TOUCHING
        near = (u >= low_u) & (u <= high_u) & (v >= low_v) & (v <= high_v)
        if not near.any():
            continue
        sides = np.roll(corners, -1, axis=0) - corners
        length = np.maximum(np.hypot(*sides.T), 1e-12)
        turn = (sides[:, :1] * (v[near] - corners[:, 1:]) - sides[:, 1:] * (u[near] - corners[:, :1])) / length[:, None]
        seen[near] |= (turn >= 0).all(axis=0) | (turn <= 0).all(axis=0)
        touched[near] |= (np.abs(turn) <= TOUCHING).any(axis=0)
    return seen.reshape(rows, columns), touched.reshape(rows, columns)


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.long] if number % 3 else []) for number, name in enumerate(MESHES)],
)
def test_the_rendered_outline_is_the_projected_one(name: str, tmp_path: Path) -> None:
    path, _, unit = lay(name, tmp_path)
    body = MESHES[name][0]
    points = body.triangles.reshape(-1, 3) * unit * 1e-3
    middle, size = points.mean(axis=0), float(np.ptp(points, axis=0).max())
    (tmp_path / "scene.toml").write_text(LAMBERTIAN.read_text())
    metres = [f"{value!r} m" for value in (-middle).tolist()]
    target = {"part": path.name, "material": "white", "position": metres}
    if path.suffix != ".glb":
        target["length_unit"] = "1 mm"
    eye = [f"{share * size!r} m" for share in (0.9, -1.3, 4.0)]
    changes: dict[str, Any] = {"targets": [target], "camera.position": eye, "camera.focal_length": "6 mm"}
    changes |= {
        "sources[0].position": [f"{share * size!r} m" for share in (20, 20, 30)],
        "sources[0].diameter": f"{size} m",
    }
    scene = radwrap.load_scene(tmp_path / "scene.toml", changes)
    options = RadianceOptions(find_radiance())
    with Programs() as programs:
        work = tmp_path / "work"
        work.mkdir()
        prepared = prepare(scene, options, programs, work)
        build(prepared.identity, prepared.scene.files, work, options, programs, harmless=(NO_LIGHT,))
        tracer = RadianceTracer(options, programs, work, prepared.scene, harmless=(NO_LIGHT,))
        blocks = ray_blocks(scene.camera, (0.0, 0.0), PixelPlan())
        rendered = np.concatenate([np.isfinite(far) for _, far in traced(tracer.distances, blocks)])
    expected, touched = outline(scene)
    differs = rendered.reshape(expected.shape) != expected
    assert 60 < expected.sum() < expected.size - 60
    assert not (differs & ~touched).any()
    assert touched.sum() < 20


def test_materials_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "two.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nusemtl Steel (dull)\nf 1 2 3\nusemtl 2nd\nf 1 2 4\n"
    )
    (tmp_path / "materials.toml").write_text('[materials."Steel (dull)"]\ntype = "lambertian"\nreflectance = 0.25\n')
    argv = ["convert", str(tmp_path / "two.obj"), str(tmp_path / "o ut" / "out.rad"), "--length-unit", "1 in"]
    assert main([*argv, "--materials", str(tmp_path / "materials.toml")]) == 0
    told = capsys.readouterr().out
    assert '"2nd": reflectance 0.5 assumed' in told and 'Steel (dull)": reflectance' not in told
    text = (tmp_path / "o ut" / "out.rad").read_text()
    assert "void plastic Steel_dull\n0\n0\n5 0.25 0.25 0.25 0.0 0.0\n" in text
    assert "void plastic m_2nd\n0\n0\n5 0.5 0.5 0.5 0.0 0.0\n" in text
    found = find_radiance()
    done = subprocess.run(
        [found.program("oconv"), "out.rad"],
        cwd=tmp_path / "o ut",
        env={"PATH": str(found.programs), "RAYPATH": f".:{found.library}"},
        capture_output=True,
        check=True,
    )
    assert done.stderr == b""
    (tmp_path / "materials.toml").write_text('[materials."Stel"]\ntype = "lambertian"\nreflectance = 0.25\n')
    assert main([*argv, "--materials", str(tmp_path / "materials.toml")]) == 2
    assert 'the mesh has no material "Stel"; it has: Steel (dull), 2nd' in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ([], "does not say its unit of length"),
        (["--length-unit", "1"], "--length-unit"),
        (["--length-unit", "1 mm", "--set", "a=1"], "--set: goes with a scene only"),
        (["--length-unit", "1 mm", "--scale", "1/2"], "--scale: goes with a scene only"),
        (["--length-unit", "1 mm", "--roi", "0", "0", "8", "8"], "--roi: goes with a scene only"),
        (["--length-unit", "-1 mm"], "--length-unit: must lie between"),
    ],
)
def test_bad_options(options: list[str], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, _, _ = lay("box", tmp_path)
    assert main(["convert", str(path), str(tmp_path / "out.rad"), *options]) == 2
    assert told in capsys.readouterr().err
    assert not (tmp_path / "out.rad").exists()


def test_a_mesh_is_written_as_rad_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, options, _ = lay("box", tmp_path)
    assert main(["convert", str(path), str(tmp_path / "out.stl"), *options]) == 2
    assert "end the name in .rad" in capsys.readouterr().err
    assert main(["convert", str(LAMBERTIAN), str(tmp_path / "out.rad"), "--polygons"]) == 2
    assert "--polygons: goes only with a mesh" in capsys.readouterr().err


def test_a_scene_for_povray(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = ROOT / "rad_scenes" / "crosscheck" / "mirror" / "scene.toml"
    assert main(["convert", str(scene), str(tmp_path / "out.pov")]) == 0
    text = (tmp_path / "out.pov").read_text()
    assert "camera { perspective location" in text and "reflection { 1.0 }" in text
    capsys.readouterr()
    assert main(["convert", str(ROOT / "rad_scenes" / "fig11_edge" / "scene.toml"), str(tmp_path / "no.pov")]) == 2
    assert "no Gaussian beam" in capsys.readouterr().err
    assert not (tmp_path / "no.pov").exists()


def test_a_preview_has_the_scene_s_sizes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = radwrap.load_scene(ROOT / "rad_scenes" / "crosscheck" / "shadows" / "scene.toml")
    assert (
        main(["convert", str(ROOT / "rad_scenes" / "crosscheck" / "shadows" / "scene.toml"), str(tmp_path / "o.glb")])
        == 0
    )
    found = trimesh.load_scene(tmp_path / "o.glb")
    assert set(found.geometry) == {thing.name for thing in (*scene.surfaces, *scene.emitters)}
    areas = {name: body.area for name, body in found.geometry.items()}
    assert areas["target0"] == pytest.approx(0.16)
    assert areas["target1"] == pytest.approx(math.pi * 0.025**2, rel=0.01)  # a ball of flat triangles
    assert areas["target5"] == pytest.approx(math.pi * 0.007**2, rel=0.01)
    capsys.readouterr()
    mirror = ROOT / "rad_scenes" / "crosscheck" / "mirror" / "scene.toml"
    assert main(["convert", str(mirror), str(tmp_path / "m.glb")]) == 2
    assert "a Radiance file, are not known" in capsys.readouterr().err


def test_polygons_are_cut_into_triangles_of_the_same_area() -> None:
    star = np.array([[0, 0], [4, 1], [8, 0], [7, 4], [8, 8], [4, 3], [0, 8], [1, 4]], dtype=float)
    corners = np.column_stack([star, star[:, 0] * 0.3])
    triangles = corners[ears(corners)]
    assert len(triangles) == 6
    x, y = star.T
    flat = abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2
    assert area(triangles) == pytest.approx(flat * math.sqrt(1 + 0.3**2))


def test_convert_warns_of_normals_that_it_does_not_use(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "roof.obj").write_text("v 0 0 0\nv 9 0 0\nv 0 9 0\nvn 0.6 0 0.8\nf 1//1 2//1 3//1\n")
    argv = ["convert", str(tmp_path / "roof.obj"), str(tmp_path / "roof.rad"), "--length-unit", "1 mm", "--polygons"]
    assert main(argv) == 0
    assert capsys.readouterr().err.count("normals") == 1
    assert main([*argv[:2], str(tmp_path / "again.rad"), *argv[3:], "--json"]) == 0
    output = capsys.readouterr()
    (warning,) = json.loads(output.out)["warnings"]
    assert "36.9 deg" in warning
    assert warning in output.err
